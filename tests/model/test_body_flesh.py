"""Laws of the limbs that make a body's surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.body_flesh import ARM, LEG, body_limbs, joint_places
from mocapella.model.body_proportions import AVERAGE, Lengths, Sex, body_shape, lengths_of


@pytest.mark.parametrize("sex", ["female", "male"])
@given(times=st.floats(0.3, 3.0), girth=st.floats(0.7, 1.5))
def test_a_body_of_another_size_is_the_same_body(sex: Sex, times: float, girth: float) -> None:
    flesh, lengths = body_shape(sex).flesh, lengths_of(sex, 1.7, AVERAGE)
    larger = Lengths(**{name: times * value for name, value in dataclasses.asdict(lengths).items()})
    limbs, scaled = body_limbs(flesh, lengths, girth), body_limbs(flesh, larger, girth)
    np.testing.assert_allclose(scaled[:, :8], times * limbs[:, :8], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(scaled[:, 8], limbs[:, 8])
    for name, place in joint_places(lengths).items():
        np.testing.assert_allclose(joint_places(larger)[name], times * place, rtol=1e-9)


@pytest.mark.parametrize("sex", ["female", "male"])
def test_shoes_stand_on_the_ground(sex: Sex) -> None:
    lengths = lengths_of(sex, 1.7, AVERAGE)
    limbs = body_limbs(body_shape(sex).flesh, lengths, 1.0)
    ankle = joint_places(lengths)["left ankle"]
    shoe = limbs[(limbs[:, 8] == LEG) & (limbs[:, 4] < 0.8 * ankle[1])]  # that end far below the ankle
    assert len(shoe) >= 5
    lowest = shoe[:, 4] - shoe[:, 7]
    np.testing.assert_allclose(lowest, -0.002, atol=0.004)
    assert shoe[:, 5].min() < ankle[2] - 0.01  # from behind the ankle
    assert shoe[:, 5].max() > ankle[2] + 0.08  # to the toes


@pytest.mark.parametrize("sex", ["female", "male"])
@pytest.mark.parametrize("height", [1.1, 1.7])
def test_a_hand_hangs_from_the_wrist_to_the_fingertip_with_its_thumb_forward(sex: Sex, height: float) -> None:
    lengths = lengths_of(sex, height, AVERAGE)
    limbs, places = body_limbs(body_shape(sex).flesh, lengths, 1.0), joint_places(lengths)
    wrist, tip = places["left wrist"], places["left fingertip"]
    hand = limbs[(limbs[:, 8] == ARM) & (limbs[:, 4] < wrist[1] - 0.01 * height)]  # that end below the wrist
    ends, radii = hand[:, :6].reshape(-1, 3), hand[:, 6:8].ravel()
    assert (ends[:, 1] < wrist[1]).all()
    assert (ends[:, 1] - radii).min() == pytest.approx(tip[1], abs=0.03 * lengths.hand)
    share = (wrist[1] - ends[:, 1]) / (wrist[1] - tip[1])
    np.testing.assert_allclose(ends[:, 0], wrist[0] + share * (tip[0] - wrist[0]), atol=1e-9)
    behind, before = wrist[2] - (ends[:, 2] - radii).min(), (ends[:, 2] + radii).max() - wrist[2]
    assert 0.1 * lengths.hand < behind < before < 0.5 * lengths.hand
