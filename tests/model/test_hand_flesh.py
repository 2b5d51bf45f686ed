"""The flesh of a hand at rest, before it is a mesh."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.hand import hand_model
from mocapella.model.hand_flesh import THENAR, digits_at_rest, finger_radii, hand_limbs

HANDS = st.floats(0.15, 0.22), st.floats(0.9, 1.1)


def limbs_of(length_m: float, broad: float) -> tuple[np.ndarray, np.ndarray]:
    """(21, 3) landmarks of a right hand, and (k, 9) its limbs."""
    model, breadth_m = hand_model("full"), broad * 0.085 * length_m / 0.189
    shape = model.shape("right", hand_length_m=length_m, hand_breadth_m=breadth_m)
    places = np.vstack([np.zeros(3), digits_at_rest(model, shape)[1]])
    rows = hand_limbs(places, finger_radii(length_m), hand_length_m=length_m, hand_breadth_m=breadth_m)
    return places, np.array(rows)


@given(*HANDS)
def test_the_ball_of_the_thumb_is_on_the_palms_side_of_its_bone(length_m: float, broad: float) -> None:
    """Fingers bend towards -y: there is the palm."""
    places, limbs = limbs_of(length_m, broad)
    base, knuckle = places[1:3]
    muscles = limbs[(limbs[:, 8] == THENAR) & (limbs[:, 6:8].min(axis=1) > 0.055 * length_m)]
    assert len(muscles) == 2
    along = (knuckle - base) / np.linalg.norm(knuckle - base)
    for end in muscles[:, :6].reshape(-1, 3):
        beside = (end - base) - ((end - base) @ along) * along
        assert beside[1] < 0
        assert np.linalg.norm(beside) < 0.08 * length_m


@given(*HANDS, st.floats(0.8, 1.25))
def test_a_hand_of_another_size_has_the_same_flesh_in_that_size(length_m: float, broad: float, size: float) -> None:
    (places, limbs), (others, larger) = limbs_of(length_m, broad), limbs_of(size * length_m, broad)
    np.testing.assert_allclose(others, size * places, atol=1e-12)
    np.testing.assert_allclose(larger[:, :8], size * limbs[:, :8], atol=1e-12)
    np.testing.assert_array_equal(larger[:, 8], limbs[:, 8])
