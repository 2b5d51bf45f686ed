"""How well a detector finds arms: what is perfect scores so, and every fault is counted where it should be."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from mocapella.evaluation.arms import FOUND_M, MATCH_M, ArmScores, in_image, jitter, matched, score
from mocapella.model.arm_quality import Misdetections
from mocapella.model.arms import ARM_JOINT_NAMES, ELBOW, PALM, SeenArm, SeenArms
from mocapella.model.hand import TIPS, WRIST
from mocapella.sources.simulate.depth_scene import ArmTruth, DepthShot

LENS = np.array([500.0, 500.0, 159.5, 119.5, 0, 0, 0, 0, 0])
OCCLUDED, HIDDEN = 1, 4  # which of the five tips
Change = Callable[[int, SeenArm], SeenArm | None]


def truth(k: int, at_x: float = 0.0) -> ArmTruth:
    """An arm that drifts; its tips are 5 cm apart, one before the palm, one without pixels."""
    points = np.tile([at_x + 0.001 * k, 0.0, 0.7], (23, 1))
    points[[*TIPS], 0] += 0.02 * np.arange(-2, 3)
    points[[*TIPS], 1] -= 0.08
    points[WRIST, 1], points[ELBOW, 1] = 0.05, 0.15
    seen, occluded = np.ones(23, np.bool_), np.zeros(5, np.bool_)
    occluded[OCCLUDED], seen[TIPS[HIDDEN]] = True, False
    return ArmTruth(
        False, points, np.zeros(3), np.zeros(21), np.eye(4), seen, occluded, np.ones((5, 2), np.int64), "", "average"
    )


def shots(count: int = 10, arms: int = 1) -> list[DepthShot]:
    depth = np.zeros((240, 320), np.uint16)
    return [
        DepthShot(k / 30, depth, 0.001, LENS, tuple(truth(k, 0.15 * n) for n in range(arms)), depth.astype(np.float32),
                  depth.astype(np.uint8))
        for k in range(count)
    ]  # fmt: skip


class Oracle:
    """Returns what is true, changed by a function of frame and arm."""

    name = "oracle"

    def __init__(self, all_shots: list[DepthShot], change: Change = lambda k, arm: arm) -> None:
        self.shots, self.change, self.k = all_shots, change, 0

    def update(self, depth: np.ndarray, at_s: float) -> SeenArms:
        assert depth.dtype == np.float32
        states = np.full(23, 2, np.uint8)
        arms = [
            self.change(self.k, SeenArm(n, arm.left, 1.0, arm.points.copy(), states.copy(), np.zeros(23, np.float32),
                                        arm.angles))
            for n, arm in enumerate(self.shots[self.k].arms)
        ]  # fmt: skip
        self.k += 1
        return SeenArms(tuple(arm for arm in arms if arm is not None))

    def reset(self) -> None:
        self.k = 0


def scored(change: Change = lambda k, arm: arm, count: int = 10, arms: int = 1) -> ArmScores:
    made = shots(count, arms)
    return score(Oracle(made, change), made)


def shifted(arm: SeenArm, point: int, by_m: float) -> SeenArm:
    arm.points[point, 2] += by_m
    return arm


def test_what_is_true_is_perfect() -> None:
    table = scored(arms=2).table()
    assert table == {
        "frames": 20, "followed": 1.0, "tip_median_mm": 0.0, "tip_p95_mm": 0.0, "named": 1.0, "inferred": 0.0,
        "occluded": 20, "occluded_found": 1.0, "hidden_median_mm": 0.0, "wrist_median_mm": 0.0, "palm_median_mm": 0.0,
        "elbow_median_mm": 0.0, "elbow_p95_mm": 0.0, "sided": 1.0, "longest_loss_frames": 0,
        "misdetections_per_minute": 0.0,
    }  # fmt: skip


def test_two_names_that_are_swapped_are_two_wrong_names_and_errors() -> None:
    def swap(k: int, arm: SeenArm) -> SeenArm:
        arm.points[[TIPS[2], TIPS[3]]] = arm.points[[TIPS[3], TIPS[2]]]
        return arm

    table = scored(swap).table()
    assert table["named"] == 0.5  # of four that are visible
    assert table["tip_p95_mm"] == 20.0
    assert table["occluded_found"] == 1.0


def test_a_tip_that_is_far_off_but_the_nearest_keeps_its_name() -> None:
    scores = scored(lambda k, arm: shifted(arm, TIPS[2], 0.019))
    assert (scores.named, scores.visible) == (40, 40)
    assert max(scores.tips) == pytest.approx(0.019)


def test_a_wrong_side_is_counted() -> None:
    assert scored(lambda k, arm: msgspec.structs.replace(arm, left=k < 3)).table()["sided"] == 0.7


def test_a_tip_before_the_palm_is_found_within_fifteen_millimetres() -> None:
    for off, found in ((0.0149, 1.0), (0.0151, 0.0)):
        table = scored(lambda k, arm, off=off: shifted(arm, TIPS[OCCLUDED], off)).table()  # type: ignore[misc]
        assert table["occluded_found"] == found


def test_a_visible_tip_that_is_inferred_has_no_error_and_is_not_found() -> None:
    def infer(k: int, arm: SeenArm) -> SeenArm:
        arm.states[TIPS[OCCLUDED]] = 1
        return shifted(arm, TIPS[OCCLUDED], 0.009)

    scores = scored(infer)
    assert (scores.inferred, len(scores.tips), scores.named) == (10, 30, 40)
    assert scores.occluded_found == 0
    assert max(scores.tips) == 0.0


def test_a_tip_without_pixels_is_scored_apart() -> None:
    scores = scored(lambda k, arm: shifted(arm, TIPS[HIDDEN], 0.03))
    np.testing.assert_allclose(scores.hidden, 0.03)
    assert (scores.visible, max(scores.tips)) == (40, 0.0)


def test_a_tip_that_is_not_known_is_neither_named_nor_measured() -> None:
    def unknown(k: int, arm: SeenArm) -> SeenArm:
        arm.points[[TIPS[0], TIPS[HIDDEN], ELBOW]] = np.nan
        return arm

    scores = scored(unknown)
    assert (scores.inferred, scores.named, len(scores.hidden), len(scores.elbow)) == (10, 30, 0, 0)
    assert math.isnan(scores.table()["elbow_median_mm"])


def test_an_elbow_that_is_not_visible_has_no_error_but_a_wrist_and_a_palm_have() -> None:
    made = shots(10)
    for shot in made[:4]:
        shot.arms[0].seen[[WRIST, PALM, ELBOW]] = False
    scores = score(Oracle(made), made)
    assert (len(scores.wrist), len(scores.palm), len(scores.elbow)) == (10, 10, 6)


def test_joints_have_errors_of_their_own() -> None:
    def off(k: int, arm: SeenArm) -> SeenArm:
        return shifted(shifted(shifted(arm, WRIST, 0.01), PALM, 0.02), ELBOW, 0.03)

    table = scored(off).table()
    assert [table[f"{name}_median_mm"] for name in ("wrist", "palm", "elbow")] == [10.0, 20.0, 30.0]


def test_frames_without_an_arm_are_counted_and_the_longest_run_after_it_was_found() -> None:
    lost = {0, 1, 2, 3, 5, 6, 8}
    scores = scored(lambda k, arm: None if k in lost else arm)
    assert (scores.frames, scores.followed, scores.lost) == (10, 3, 2)
    assert (scores.visible, scores.named, scores.occluded, scores.occluded_found) == (40, 12, 10, 3)
    never = scored(lambda k, arm: None)
    assert (never.followed, never.lost, never.table()["sided"]) == (0, 0, pytest.approx(math.nan, nan_ok=True))


def test_a_palm_ten_centimetres_away_is_another_arms() -> None:
    for off, followed in ((0.099, 10), (0.101, 0)):
        assert scored(lambda k, arm, off=off: shifted(arm, PALM, off)).followed == followed  # type: ignore[misc]
    made = shots(1, arms=2)
    seen = Oracle(made).update(np.zeros((2, 2), np.float32), 0.0)
    assert [matched(arm, seen) for arm in made[0].arms] == list(seen.arms)


@pytest.mark.parametrize(
    ("palm", "inside"),
    [
        ((0, 0, 0.7), True),
        ((0, 0, 0.04), False),
        ((0, 0, 0.05), False),
        ((0, 0, 0.051), True),
        ((-0.2, 0, 0.7), True),
        ((-0.21, 0, 0.7), False),
        ((0, 0.16, 0.7), False),
        ((0, 0.14, 0.7), True),
        ((0, -0.15, 0.7), False),
        ((0, -0.14, 0.7), True),
        ((0.21, 0, 0.7), False),
        ((0.2, 0, 0.7), True),
    ],
)
def test_an_arm_outside_the_image_is_not_asked_for(palm: tuple[float, float, float], inside: bool) -> None:
    (shot,) = shots(1)
    shot.arms[0].points[PALM] = palm
    assert in_image(shot.arms[0], shot) == inside
    assert score(Oracle([shot]), [shot]).frames == int(inside)


def test_sums_of_scores_are_those_of_all_frames() -> None:
    one, other = scored(), scored(lambda k, arm: None if k in (4, 5) else arm)
    one.add(other)
    assert (one.frames, one.followed, one.lost, len(one.tips)) == (20, 18, 2, 72)


def test_jitter_is_the_motion_about_the_mean_once_it_has_settled() -> None:
    made = shots(40)
    for shot in made:
        shot.arms[0].points[:] = truth(0).points

    def shaking(k: int, arm: SeenArm) -> SeenArm:
        return shifted(arm, TIPS[0], 0.5 if k < 15 else 0.001 * (-1) ** k)

    still = jitter(Oracle(made, shaking), made)
    assert tuple(still) == ARM_JOINT_NAMES
    assert still["thumb tip"] == pytest.approx(0.001, rel=1e-2)
    assert still["wrist"] == pytest.approx(0.0, abs=1e-12)
    assert all(math.isnan(value) for value in jitter(Oracle(made), made[:10]).values())


def test_limits_of_a_match_and_of_a_found_tip_are_still_within() -> None:
    """A tip within fifteen millimetres has its name although another one is nearer."""
    (shot,) = shots(1)
    true = shot.arms[0]
    true.points[[PALM, TIPS[OCCLUDED]]] = 0.0, 0.0, 0.0
    (arm,) = Oracle([shot]).update(np.zeros((2, 2), np.float32), 0.0).arms
    arm.points[PALM, 0] = MATCH_M
    assert matched(true, SeenArms((arm,))) is arm
    true.points[PALM, 2] = arm.points[PALM, 2] = 0.7
    arm.points[TIPS[OCCLUDED], 0], arm.points[TIPS[2]] = FOUND_M, [0.001, 0.0, 0.0]
    found = score(Oracle([shot], lambda k, _: arm), [shot])
    assert (found.frames, found.occluded_found, found.named) == (1, 1, 3)  # all visible ones but the other


@pytest.mark.parametrize(("settle", "known"), [(0, True), (1, True), (2, False)])
def test_jitter_is_known_from_two_frames_on_after_those_in_which_it_settles(settle: int, known: bool) -> None:
    made = shots(3)
    found = jitter(Oracle(made), made, settle=settle)
    assert all(math.isfinite(value) == known for value in found.values())


@pytest.mark.parametrize("unit_m", [0.001, 0.0005])
def test_a_detector_is_given_depths_in_metres(unit_m: float) -> None:
    given: list[np.ndarray] = []

    class Keeps(Oracle):
        def update(self, depth: np.ndarray, at_s: float) -> SeenArms:
            given.append(depth)
            return super().update(depth, at_s)

    made = [
        msgspec.structs.replace(shot, depth=np.full_like(shot.depth, round(0.7 / unit_m)), unit_m=unit_m)
        for shot in shots(2)
    ]
    score(Keeps(made), made)
    jitter(Keeps(made), made)
    np.testing.assert_allclose(given, 0.7, rtol=1e-6)


def test_a_tip_that_truly_moves_fast_is_no_misdetection_and_one_that_jumps_or_lags_is() -> None:
    made = shots()
    for k, shot in enumerate(made):
        shot.arms[0].points[TIPS[1], 1] += 0.08 * k  # 2.4 m/s
    found = score(Oracle(made), made)
    assert (found.misdetected.of_joints, found.compared_s) == (0, pytest.approx(9 / 30))

    def jumps(k: int, arm: SeenArm) -> SeenArm:
        return shifted(arm, TIPS[3], 0.06 if k >= 5 else 0.0)

    def lags(k: int, arm: SeenArm) -> SeenArm:
        arm.points[TIPS[1], 1] -= 0.08 * (k == 5)
        return arm

    assert score(Oracle(made, jumps), made).misdetected == Misdetections(jumped=1)
    assert score(Oracle(made, lags), made).misdetected == Misdetections(jumped=2)  # behind, and again there
    assert score(Oracle(made, jumps), made).table()["misdetections_per_minute"] == pytest.approx(60 / 0.3)


def test_arms_that_change_their_number_or_come_after_a_gap_are_not_compared_and_a_changed_side_counts() -> None:
    def renumbered(k: int, arm: SeenArm) -> SeenArm:
        return msgspec.structs.replace(shifted(arm, TIPS[3], 0.06 if k >= 5 else 0.0), id=int(k >= 5))

    def turned(k: int, arm: SeenArm) -> SeenArm:
        return msgspec.structs.replace(arm, left=k >= 5)

    assert scored(renumbered).misdetected == Misdetections()
    assert scored(turned).misdetected == Misdetections(swapped=1)
    made = [msgspec.structs.replace(shot, at_s=shot.at_s + 0.5 * (k >= 5)) for k, shot in enumerate(shots())]
    jumps = score(Oracle(made, lambda k, arm: shifted(arm, TIPS[3], 0.06 if k >= 5 else 0.0)), made)
    assert (jumps.misdetected, jumps.compared_s) == (Misdetections(), pytest.approx(8 / 30))
    both = ArmScores()
    for scores in (jumps, scored(turned)):
        both.add(scores)
    assert (both.misdetected, both.compared_s) == (Misdetections(swapped=1), pytest.approx(17 / 30))
