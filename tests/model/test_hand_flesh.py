"""The flesh of a hand at rest, before it is a mesh."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.hand import PARENTS, hand_model
from mocapella.model.hand_flesh import BEYOND_TIP, CORE, THENAR, digits_at_rest, finger_radii, hand_limbs

HANDS = st.floats(0.15, 0.22), st.floats(0.9, 1.1)


def limbs_of(length_m: float, broad: float) -> tuple[np.ndarray, np.ndarray]:
    """(21, 3) landmarks of a right hand, and (k, 9) its limbs."""
    model, breadth_m = hand_model("full"), broad * 0.085 * length_m / 0.189
    shape = model.shape("right", hand_length_m=length_m, hand_breadth_m=breadth_m)
    places = np.vstack([np.zeros(3), digits_at_rest(model, shape)[1]])
    rows = hand_limbs(places, finger_radii(length_m), hand_length_m=length_m, hand_breadth_m=breadth_m)
    return places, np.array(rows)


def away(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Distance of a point from a line segment, and where along it the nearest point is, 0 to 1."""
    share = float(np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1))
    return float(np.linalg.norm(point - a - share * (b - a))), share


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
    assert [0.3 < away(end, base, knuckle)[1] < 0.9 for end in muscles[:, 3:6]] == [True, True]


@given(*HANDS)
def test_the_ball_of_the_little_finger_is_on_the_palms_side_at_the_edge(length_m: float, broad: float) -> None:
    places, limbs = limbs_of(length_m, broad)
    *_, (bone, _), ball = *limbs[limbs[:, 8] == CORE][:8].reshape(4, 2, 9), limbs[limbs[:, 8] == CORE][8]
    edge = np.sign(places[17, 0] - places[5, 0])
    assert edge * ball[0] > edge * bone[0]
    assert away(ball[3:6], bone[:3], places[17])[0] < 0.05 * length_m
    assert max(ball[1], ball[4]) < min(bone[1], bone[4])


@given(*HANDS, st.floats(0.8, 1.25))
def test_a_hand_of_another_size_has_the_same_flesh_in_that_size(length_m: float, broad: float, size: float) -> None:
    (places, limbs), (others, larger) = limbs_of(length_m, broad), limbs_of(size * length_m, broad)
    np.testing.assert_allclose(others, size * places, atol=1e-12)
    np.testing.assert_allclose(larger[:, :8], size * limbs[:, :8], atol=1e-12)
    np.testing.assert_array_equal(larger[:, 8], limbs[:, 8])


@given(*HANDS)
def test_no_flesh_is_far_from_the_bones(length_m: float, broad: float) -> None:
    places, limbs = limbs_of(length_m, broad)
    bones = [(places[parent], places[k]) for k, parent in enumerate(PARENTS) if parent >= 0]
    for end in limbs[:, :6].reshape(-1, 3):
        assert min(away(end, *bone)[0] for bone in bones) < 0.09 * length_m


@given(*HANDS)
def test_the_flesh_of_a_digit_follows_its_bones_without_a_step_and_ends_beyond_its_tip(
    length_m: float, broad: float
) -> None:
    places, limbs = limbs_of(length_m, broad)
    radii = finger_radii(length_m)
    for digit, joints in enumerate(places[1:].reshape(5, 4, 3)):
        rows = limbs[limbs[:, 8] == digit]
        np.testing.assert_array_equal(rows[1:, :3], rows[:-1, 3:6])
        np.testing.assert_array_equal(rows[1:, 6], rows[:-1, 7])
        np.testing.assert_array_equal(rows[[0, 2, 4], :3], joints[:3])
        np.testing.assert_array_equal([*rows[[0, 2, 4], 6], rows[-1, 7]], radii[digit])
        for bone in range(2):
            np.testing.assert_allclose(rows[2 * bone, 3:6], joints[bone : bone + 2].mean(axis=0))
            waist, mean = rows[2 * bone, 7], radii[digit, bone : bone + 2].mean()
            assert 0.9 * mean < waist < mean, "narrower between two joints"
        distance, share = away(rows[-1, 3:6], joints[2], joints[3])
        assert distance < 1e-12
        assert share < 1
        beyond = radii[digit, 3] - np.linalg.norm(joints[3] - rows[-1, 3:6])
        np.testing.assert_allclose(beyond, BEYOND_TIP * radii[digit, 3])


@given(*HANDS)
def test_skin_joins_the_thumb_to_the_index_finger_and_each_finger_to_the_next(length_m: float, broad: float) -> None:
    places, limbs = limbs_of(length_m, broad)
    of_thumb = limbs[limbs[:, 8] == THENAR][-2:]
    for row in of_thumb:
        distance, share = away(row[:3], places[1], places[2])
        assert distance < 1e-12, "on the metacarpal of the thumb"
        assert 0.5 < share < 0.8
        distance, share = away(row[3:6], places[0], places[5])
        assert distance < 0.1 * length_m, "beside that of the index finger"
        assert 0.5 < share < 0.9
    assert (np.diff(of_thumb[:, [2, 5]], axis=0) > 0).all(), "the second is farther from the wrist"
    assert (np.diff(of_thumb[:, 6:8], axis=0) < 0).all(), "and thinner"
    for finger, row in enumerate(limbs[limbs[:, 8] == CORE][-3:], start=1):
        for end, digit in ((row[:3], finger), (row[3:6], finger + 1)):
            distance, share = away(end, *places[1 + 4 * digit : 3 + 4 * digit])
            assert distance < 1e-12, "on the first bones of both"
            assert 0.25 < share < 0.35
        assert (row[6:8] < finger_radii(length_m)[finger : finger + 2, 0]).all(), "thinner than the fingers"


@given(*HANDS)
def test_a_metacarpal_of_the_palm_is_thickest_at_the_wrist_and_ends_below_the_knuckle(
    length_m: float, broad: float
) -> None:
    places, limbs = limbs_of(length_m, broad)
    palm = limbs[limbs[:, 8] == CORE][:8].reshape(4, 2, 9)
    for knuckle, (back, front) in zip(places[[5, 9, 13, 17]], palm, strict=True):
        np.testing.assert_array_equal(front[:3], back[3:6])
        assert back[6] > back[7] == front[6]
        assert back[2] < back[5] < front[5], "from the wrist outwards"
        share = away(back[3:6], back[:3], front[3:6])[1]
        assert back[4] < (1 - share) * back[1] + share * front[4], "bent towards the palm"
        np.testing.assert_allclose(front[3], knuckle[0])
        assert knuckle[1] - 0.02 * length_m < front[4] < knuckle[1], "towards the palm"
        assert knuckle[2] - 0.02 * length_m < front[5] < knuckle[2], "before the knuckle"
    across = palm[:, 0, 0]
    assert (np.diff(across * np.sign(places[5, 0] - places[17, 0])) < 0).all(), "side by side, as the fingers are"
    breadth = broad * 0.085 * length_m / 0.189
    np.testing.assert_allclose(np.ptp(across), 26 / 85 * breadth, err_msg="as wide as the hand is broad")
