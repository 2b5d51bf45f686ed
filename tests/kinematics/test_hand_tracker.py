"""A hand followed from its markers: laws, what is measured and what is inferred, losses and wrong input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.kinematic_hands import FULL, LEFT, RIGHT, THESIS, markers, random_angles, random_motion

from mocapella.errors import InputError, SettingsError
from mocapella.evaluation.hand_solvers import SolverScene, simulated_markers
from mocapella.geometry.rigid import apply
from mocapella.kinematics.hand_chain import hand_chain, jacobian, landmarks
from mocapella.kinematics.hand_settings import HandSettings
from mocapella.kinematics.hand_tracker import HandTracker, base_layout
from mocapella.model.hand import DIGIT_ANGLES, TIPS, Hand, HandPose, HandShape
from mocapella.model.observations import JointState

seeds = st.integers(0, 2**32 - 1)
THREE, ONE = base_layout(RIGHT, 3), base_layout(RIGHT, 1)
SD = 1e-4


def bent(rng: np.random.Generator) -> np.ndarray:
    """A hand that is neither straight nor at its limits, where the angles are well told."""
    angles = random_angles(THESIS, rng)[0]
    for row in DIGIT_ANGLES[1:]:
        angles[row[0]], angles[row[1]] = rng.uniform(0.2, 1.0), 0.1 * angles[row[1]]
        angles[row[2]] = rng.uniform(0.5, 1.5)
    angles[DIGIT_ANGLES[0, :4]] = rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), 0.5, 2 / 3
    return THESIS.limited(angles)


def still(tracker: HandTracker, points: np.ndarray, frames: int, sd: float = SD, begin: int = 0) -> Hand:
    for k in range(begin, begin + frames):
        hand = tracker.update(points, k / 60, np.full(len(points), sd))
    return hand


@pytest.mark.slow
@settings(max_examples=8)
@given(seeds)
@pytest.mark.parametrize("shape", [RIGHT, LEFT], ids=["right", "left"])
def test_with_three_base_markers_the_hand_is_found_again(shape: HandShape, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles, T = bent(rng), random_motion(rng)
    hand = still(HandTracker(THESIS, shape, THREE), markers(THESIS, shape, THREE, angles, T), 3)
    truth = landmarks(hand_chain(THESIS, shape), HandPose(angles, T))
    np.testing.assert_allclose(hand.landmarks[5:], truth[5:], atol=1e-3)
    np.testing.assert_allclose(hand.landmarks[4], truth[4], atol=1e-3)
    np.testing.assert_allclose(hand.T_world_palm, T, atol=0.01)
    np.testing.assert_allclose(hand.angles[5:], angles[5:], atol=0.03)
    assert THESIS.within(hand.angles)
    assert (hand.states[5:] == JointState.TRACKED).all()
    assert hand.handedness == shape.handedness


@settings(max_examples=6)
@given(seeds)
def test_moving_the_markers_moves_the_hand_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = markers(THESIS, LEFT, ONE, bent(rng), random_motion(rng)) + rng.normal(0, 0.001, (6, 3))
    motion = random_motion(rng)
    one, other = (still(HandTracker(THESIS, LEFT, ONE), x, 2, 0.001) for x in (points, apply(motion, points)))
    np.testing.assert_allclose(other.landmarks, apply(motion, one.landmarks), atol=1e-4)
    np.testing.assert_allclose(other.sd_m, one.sd_m, rtol=0.01)
    np.testing.assert_array_equal(other.states, one.states)


@settings(max_examples=12)
@given(seeds, st.floats(0, 0.3))
@pytest.mark.parametrize("layout", [THREE, ONE], ids=["three", "one"])
def test_limits_and_bones_are_held_whatever_the_markers(layout: np.ndarray, seed: int, away: float) -> None:
    rng = np.random.default_rng(seed)
    tracker = HandTracker(THESIS, RIGHT, layout)
    points = markers(THESIS, RIGHT, layout, bent(rng), np.eye(4))
    for k in range(3):
        x = points + rng.normal(0, away, points.shape)
        x[rng.random(len(x)) < 0.2] = rng.choice([np.nan, np.inf, 1e300])
        hand = tracker.update(x, k / 60)
        if np.isfinite(hand.landmarks).any():
            assert THESIS.within(hand.angles)
            bones = np.linalg.norm(np.diff(hand.landmarks[1:].reshape(5, 4, 3), axis=1), axis=-1)
            np.testing.assert_allclose(bones, RIGHT.lengths, atol=1e-9)
            assert (hand.sd_m > 0).all()


def test_with_one_base_marker_what_six_markers_do_not_say_is_inferred() -> None:
    rng = np.random.default_rng(5)
    angles, T = bent(rng), random_motion(rng)
    one = still(HandTracker(THESIS, RIGHT, ONE), markers(THESIS, RIGHT, ONE, angles, T), 5)
    three = still(HandTracker(THESIS, RIGHT, THREE), markers(THESIS, RIGHT, THREE, angles, T), 5)
    seen = [0, *TIPS]
    knuckles = [5, 9, 13, 17]
    assert (one.states[seen] == JointState.TRACKED).all()
    assert (one.states[knuckles] == JointState.INFERRED).all()
    assert (three.states[knuckles] == JointState.TRACKED).all()
    assert (one.sd_m[knuckles] > 3 * three.sd_m[knuckles]).all()


def test_the_standard_deviations_are_those_of_the_errors() -> None:
    rng = np.random.default_rng(6)
    angles, sd = bent(rng), 0.001
    truth = landmarks(hand_chain(THESIS, RIGHT), HandPose(angles, np.eye(4)))
    points = markers(THESIS, RIGHT, THREE, angles, np.eye(4))
    ratios = []
    for _ in range(60):
        hand = HandTracker(THESIS, RIGHT, THREE).update(points + rng.normal(0, sd, points.shape), 0.0, np.full(8, sd))
        ratios.append(((hand.landmarks - truth) ** 2).sum(axis=-1)[5:] / (3 * hand.sd_m[5:] ** 2))
    assert 0.5 < np.mean(ratios) < 1.5


def test_an_unseen_finger_is_as_unsure_at_any_frame_rate() -> None:
    """Motion and the posture at rest count by time, not by frames: a finger is hidden for 0.4 s."""
    points = markers(THESIS, RIGHT, THREE, bent(np.random.default_rng(5)), np.eye(4))
    unsure = []
    for rate_hz in (30, 120):
        tracker = HandTracker(THESIS, RIGHT, THREE)
        for k in range(round(0.8 * rate_hz) + 1):
            x = points.copy()
            if k > 0.4 * rate_hz:
                x[2] = np.nan
            hand = tracker.update(x, k / rate_hz, np.full(8, 0.001))
        unsure.append(hand.angles_sd[DIGIT_ANGLES[2, [0, 2]]])
    np.testing.assert_allclose(unsure[0], unsure[1], rtol=0.1)
    assert (unsure[0] > np.radians(5)).all()


@pytest.mark.slow
def test_with_one_base_marker_errors_are_hardly_larger_than_stated() -> None:
    """A marker of 4 mm: the directions in which six markers do not tell the hand are kept from frame to frame."""
    angles, _, points = simulated_markers(THESIS, RIGHT, SolverScene(0.004), 24, 240)
    free = THESIS.limits[:, 0] < THESIS.limits[:, 1]
    free[:5] = False  # the thumb
    median = []
    for every_s in (HandSettings().posture_every_s, 1 / 60):  # the latter: the posture at rest counts in each frame
        tracker = HandTracker(THESIS, RIGHT, ONE, HandSettings(posture_every_s=every_s))
        hands = [tracker.update(x[:6], k / 60, np.full(6, 0.004)) for k, x in enumerate(points)][20:]
        off = (np.array([hand.angles for hand in hands]) - angles[20:])[:, free]
        median.append(np.degrees(np.median(np.abs(off))))
        if every_s > 0.1:
            sd = np.array([hand.angles_sd for hand in hands])[:, free]
            assert np.sqrt(np.mean((off / sd) ** 2)) < 2.5
    assert median[0] < 6.0
    assert median[0] < median[1]


def test_a_surer_marker_counts_more_and_a_covariance_by_direction() -> None:
    points = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4))
    points[5] += [0.006, 0.006, 0.0]  # of the base
    even = HandTracker(THESIS, RIGHT, THREE).update(points, 0.0, np.full(8, 0.002))
    sd = np.full(8, 0.002)
    sd[5] = 0.02
    unsure = HandTracker(THESIS, RIGHT, THREE).update(points, 0.0, sd)
    assert unsure.residuals_m[5] > 1.2 * even.residuals_m[5]
    C = np.tile(0.002**2 * np.eye(3), (8, 1, 1))
    same = HandTracker(THESIS, RIGHT, THREE).update(points, 0.0, C)
    np.testing.assert_allclose(same.landmarks, even.landmarks, atol=1e-6)
    C[5, 0, 0] = 0.05**2  # nothing known along x
    along = HandTracker(THESIS, RIGHT, THREE).update(points, 0.0, C)
    assert abs(along.landmarks[0, 0]) < abs(even.landmarks[0, 0])


def test_a_marker_that_is_lost_is_predicted_and_recovered() -> None:
    angles = THESIS.natural
    points = markers(THESIS, RIGHT, THREE, angles, np.eye(4))
    tracker = HandTracker(THESIS, RIGHT, THREE)
    still(tracker, points, 10)
    gone = points.copy()
    gone[1] = np.nan
    hand = still(tracker, gone, 5, begin=10)
    assert hand.states[8] == JointState.INFERRED
    assert hand.states[12] == JointState.TRACKED
    assert np.isnan(hand.residuals_m[1])
    np.testing.assert_allclose(hand.landmarks[8], points[1], atol=0.005)
    longer = still(tracker, gone, 5, begin=15)
    assert longer.sd_m[8] > hand.sd_m[8] > 0.001
    back = still(tracker, points, 2, begin=20)
    assert back.states[8] == JointState.TRACKED
    np.testing.assert_allclose(back.landmarks[8], points[1], atol=1e-3)
    assert tracker.report.missing[1] == 10
    assert tracker.report.rejected == [0] * 8


def test_a_moving_hand_goes_on_while_nothing_is_seen_and_is_forgotten() -> None:
    tracker = HandTracker(THESIS, RIGHT, THREE, HandSettings(forget_after_s=0.3))
    points = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4))
    for k in range(30):
        tracker.update(points + np.array([0.01 * k, 0, 0]), k / 60)
    nothing = np.full((8, 3), np.nan)
    hand = tracker.update(nothing, 32 / 60)
    assert hand.landmarks[0, 0] == pytest.approx(0.32, abs=0.01)
    assert (hand.states == JointState.INFERRED).all()
    assert tracker.update(nothing, 1.0).states.tolist() == [JointState.NOT_TRACKED] * 21
    assert np.isnan(tracker.update(nothing, 1.1).landmarks).all()
    assert (tracker.report.predicted, tracker.report.lost) == (1, 2)
    assert np.isfinite(tracker.update(points, 1.2).landmarks).all()
    assert tracker.report.found == 2


def test_where_an_unseen_hand_is_predicted_does_not_depend_on_how_often_it_is_asked_for() -> None:
    points, nothing = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4)), np.full((8, 3), np.nan)
    found = []
    for asked in ([40], range(30, 41), [33, 34, 40]):
        tracker = HandTracker(THESIS, RIGHT, THREE)
        for k in range(30):
            tracker.update(points + np.array([0.01 * k, 0, 0]), k / 60)
        for k in asked:
            hand = tracker.update(nothing, k / 60)
        found.append(hand.landmarks)
    assert found[0][0, 0] > 0.33  # it has moved on
    np.testing.assert_allclose(found[1], found[0], atol=1e-5)
    np.testing.assert_allclose(found[2], found[0], atol=1e-5)


@settings(max_examples=12)
@given(seeds)
def test_three_base_markers_find_a_hand_that_was_turned_round_while_it_was_hidden(seed: int) -> None:
    """The prediction is half a turn off; three points of the palm say how it is held, whatever the fingers do."""
    rng = np.random.default_rng(seed)
    angles, T, turned = bent(rng), random_motion(rng), np.eye(4)
    axis = rng.normal(size=3)
    turned[:3, :3] = 2 * np.outer(axis, axis) / (axis @ axis) - np.eye(3)
    tracker = HandTracker(THESIS, RIGHT, THREE)
    still(tracker, markers(THESIS, RIGHT, THREE, angles, T @ turned), 5, 0.001)
    found = still(tracker, markers(THESIS, RIGHT, THREE, angles, T), 1, 0.001, begin=30)
    assert tracker.report.found == 1  # it was not forgotten
    truth = landmarks(hand_chain(THESIS, RIGHT), HandPose(angles, T))
    np.testing.assert_allclose(found.landmarks[[0, *TIPS]], truth[[0, *TIPS]], atol=0.005)


def test_a_marker_that_cannot_be_is_left_out_and_counted() -> None:
    points = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4))
    tracker = HandTracker(THESIS, RIGHT, THREE)
    good = still(tracker, points, 5, 0.001)
    wrong = points.copy()
    wrong[2] += [0.3, 0, 0]
    hand = still(tracker, wrong, 1, 0.001, begin=5)
    np.testing.assert_allclose(hand.landmarks, good.landmarks, atol=0.003)
    assert tracker.report.rejected == [0, 0, 1, 0, 0, 0, 0, 0]


def test_too_few_markers_begin_no_hand() -> None:
    points = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4))
    for seen in ([0, 1, 5, 6, 7], [0, 1, 2, 3, 4]):
        few = np.full((8, 3), np.nan)
        few[seen] = points[seen]
        tracker = HandTracker(THESIS, RIGHT, THREE)
        assert (tracker.update(few, 0.0).states == JointState.NOT_TRACKED).all()
        assert (tracker.report.lost, tracker.report.found) == (1, 0)


def test_the_same_inputs_give_the_same_hand_to_the_bit_also_after_a_reset() -> None:
    rng = np.random.default_rng(8)
    points = markers(THESIS, LEFT, ONE, bent(rng), np.eye(4)) + rng.normal(0, 0.002, (20, 6, 3))
    tracker = HandTracker(THESIS, LEFT, ONE)
    first = [tracker.update(x, k / 60).landmarks for k, x in enumerate(points)]
    tracker.reset()
    assert tracker.report.frames == 0
    np.testing.assert_array_equal(first, [tracker.update(x, k / 60).landmarks for k, x in enumerate(points)])


def test_a_time_before_the_last_is_the_last() -> None:
    tracker = HandTracker(THESIS, RIGHT, THREE)
    points = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4))
    tracker.update(points, 5.0)
    assert tracker.update(points, 1.0).at_s == 5.0


def test_wrong_input_is_refused_and_says_what_would_do() -> None:
    tracker = HandTracker(THESIS, RIGHT, THREE)
    good = np.zeros((8, 3))
    for points, at_s, sd, message in (
        (np.zeros((6, 3)), 0.0, None, r"points.*give \(8, 3\)"),
        (good, np.nan, None, "at_s.*seconds"),
        (good, 0.0, np.zeros(3), r"uncertainty.*\(8,\) standard deviations"),
    ):
        with pytest.raises(InputError, match=message):
            tracker.update(points, at_s, sd)
    for layout in (np.zeros((0, 3)), np.zeros(3), np.full((1, 3), np.nan), np.full((1, 3), 2.0)):
        with pytest.raises(SettingsError, match="base_markers"):
            HandTracker(THESIS, RIGHT, layout)
    with pytest.raises(SettingsError, match="1 to 4"):
        base_layout(RIGHT, 5)


@pytest.mark.parametrize(
    ("name", "last", "beyond"),
    [
        *((name, 360.0, 360.1) for name in ("flexion_sd_deg", "abduction_sd_deg", "thumb_sd_deg", "coupling_sd_deg")),
        ("outlier_sd", 1.0, 0.999),
        ("most_iterations", 1, 0),
        ("most_iterations", 1000, 1001),
    ],
)
def test_settings_at_their_limit_are_accepted_and_beside_it_refused(name: str, last: float, beyond: float) -> None:
    assert getattr(HandSettings(**{name: last}), name) == last
    with pytest.raises(SettingsError, match=name):
        HandSettings(**{name: beyond})


@pytest.mark.parametrize("name", list(HandSettings.__dataclass_fields__))
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        HandSettings(**{name: 0})


@pytest.mark.parametrize("sd", [1e-300, 1e-9, 1e-3, 10.0, 1e150])
def test_however_sure_or_unsure_the_markers_there_is_a_hand_within_limits(sd: float) -> None:
    rng = np.random.default_rng(10)
    for layout in (THREE, ONE):
        tracker = HandTracker(THESIS, RIGHT, layout)
        points = markers(THESIS, RIGHT, layout, bent(rng), np.eye(4)) + rng.normal(0, 0.002, (5 + len(layout), 3))
        hand = still(tracker, points, 3, sd)
        if np.isfinite(hand.landmarks).all():
            assert THESIS.within(hand.angles)
            assert np.isfinite(hand.sd_m).all()
        else:
            assert (hand.states == JointState.NOT_TRACKED).all()


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_a_marker_of_no_certainty_does_not_count(bad: float) -> None:
    points = markers(THESIS, RIGHT, THREE, THESIS.natural, np.eye(4))
    sd = np.full(8, 0.001)
    sd[3] = bad
    points[3] += 0.1
    hand = HandTracker(THESIS, RIGHT, THREE).update(points, 0.0, sd)
    assert hand.states[16] == JointState.INFERRED
    C = np.tile(1e-6 * np.eye(3), (8, 1, 1))
    C[3] = 1e-6 * np.ones((3, 3))  # flat
    assert HandTracker(THESIS, RIGHT, THREE).update(points, 0.0, C).states[16] == JointState.INFERRED


def test_the_fits_derivatives_are_those_of_the_chain() -> None:
    from mocapella.kinematics.hand_fit_kernels import digit_points
    from mocapella.kinematics.hand_solvers import digit_rows

    rng = np.random.default_rng(9)
    for shape in (RIGHT, LEFT):
        angles = rng.uniform(-1, 1, 21)
        J = jacobian(hand_chain(THESIS, shape), HandPose(angles, np.eye(4)))
        x = landmarks(hand_chain(THESIS, shape), HandPose(angles, np.eye(4)))
        for digit, row in enumerate(DIGIT_ANGLES):
            q = np.where(row >= 0, angles[row], 0.0)
            joints, axes = np.empty((4, 3)), np.empty((5, 3))
            digit_points(digit_rows(THESIS, shape)[digit], float(shape.mirror[0]), q, joints, axes)
            np.testing.assert_allclose(joints, x[4 * digit + 1 : 4 * digit + 5], atol=1e-12)
            for k, origin in enumerate((0, 0, 1, 2, 1)):
                if row[k] >= 0:
                    velocity = np.cross(axes[k], joints[3] - joints[origin])
                    np.testing.assert_allclose(velocity, J[TIPS[digit], :, 6 + row[k]], atol=1e-12)


def test_all_twenty_one_angles_can_be_free_and_what_a_tip_does_not_say_is_less_sure() -> None:
    rng = np.random.default_rng(11)
    angles = FULL.limited(bent(rng))
    points = markers(FULL, LEFT, THREE, angles, random_motion(rng))
    full, thesis = (still(HandTracker(model, LEFT, THREE), points, 3) for model in (FULL, THESIS))
    np.testing.assert_allclose(full.landmarks[list(TIPS)], points[:5], atol=1e-3)
    assert FULL.within(full.angles)
    assert (full.angles_sd > 0).all()
    distal = DIGIT_ANGLES[1:, 3]
    assert (full.angles_sd[distal] > 2 * thesis.angles_sd[distal]).all()
    wild = HandTracker(FULL, LEFT, THREE)
    for k in range(5):
        assert FULL.within(wild.update(points + rng.normal(0, 0.03, points.shape), k / 60).angles)
