"""How one arm before two cameras is scored: what is true scores so, and each error is that of its own camera."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.evaluation.arms import MATCH_M
from mocapella.evaluation.two_cameras import Told, _Errors, _place_error, beside, two_camera_scores
from mocapella.geometry.rigid import apply, rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.arms import PALM, SeenArm, SeenArms
from mocapella.model.hand import TIPS, WRIST
from mocapella.model.observations import JointState
from mocapella.sources.simulate.depth_scene import ArmTruth, DepthShot
from mocapella.tracker.arm_tracks import TO_SENSOR

TRUE = np.random.default_rng(0).normal(0.0, 0.05, (23, 3)) + np.array([0.0, 0.0, 0.6])
EVERY, NONE = np.ones(23, np.bool_), np.zeros(23, np.bool_)


def told(off_m: float = 0.0, number: int = 7) -> Told:
    """An arm, all of whose joints are off by that along one axis."""
    return TRUE + np.array([0.0, off_m, 0.0]), np.full(23, JointState.TRACKED, np.uint8), number


def test_errors_are_distances_in_millimetres() -> None:
    errors = _Errors()
    errors.add([told(0.03)], TRUE, EVERY, NONE)
    errors.add([told(0.01)], TRUE, EVERY, NONE)
    table = errors.table()
    for name in ("tip", "wrist", "palm", "elbow"):
        assert table[f"{name}_median_mm"] == pytest.approx(20.0)
    assert table["tip_p95_mm"] == pytest.approx(30.0)
    assert (table["instants"], table["followed"], table["tips_measured"], table["ids"]) == (2, 1.0, 1.0, 1)
    assert (table["tips_of_one_camera"], math.isnan(table["tips_of_one_camera_median_mm"])) == (0, True)


def test_an_instant_without_an_arm_near_the_palm_counts_and_has_no_errors() -> None:
    errors = _Errors()
    errors.add([told(0.0)], TRUE, EVERY, NONE)
    errors.add([told(0.101)], TRUE, EVERY, NONE)
    errors.add([], TRUE, EVERY, NONE)
    unknown = told(0.0)
    unknown[0][PALM] = np.nan
    errors.add([unknown], TRUE, EVERY, NONE)
    assert (errors.table()["instants"], errors.table()["followed"], len(errors.tips)) == (4, 0.25, 5)
    assert (_Errors().table()["followed"], math.isnan(_Errors().table()["tip_median_mm"])) == (0.0, True)


def test_a_palm_ten_centimetres_away_is_still_the_arms() -> None:
    for off_m, followed in ((MATCH_M, 1), (np.nextafter(MATCH_M, 1), 0)):
        errors = _Errors()
        errors.add([(np.tile([off_m, 0.0, 0.0], (23, 1)), told()[1], 1)], np.zeros((23, 3)), EVERY, NONE)
        assert errors.followed == followed


def test_the_arm_of_the_nearest_palm_is_scored() -> None:
    errors = _Errors()
    errors.add([told(0.09, 1), told(0.02, 2), told(-0.05, 3)], TRUE, EVERY, NONE)
    errors.add([told(0.09, 4)], TRUE, EVERY, NONE)
    assert errors.ids == {2, 4}
    assert errors.tips == pytest.approx([0.02] * 5 + [0.09] * 5)


def test_tips_count_that_some_camera_sees_and_apart_those_that_this_one_does_not() -> None:
    errors, arm = _Errors(), told(0.01)
    seen, hidden = EVERY.copy(), NONE.copy()
    seen[TIPS[0]] = False
    hidden[TIPS[1]] = True
    arm[0][[TIPS[2], WRIST]] = np.nan
    arm[1][TIPS[3]] = JointState.INFERRED
    errors.add([arm], TRUE, seen, hidden)
    assert (len(errors.tips), errors.measured, len(errors.filled)) == (3, [True, False, True], 1)
    assert {name: len(of) for name, of in errors.other.items()} == {"wrist": 0, "palm": 1, "elbow": 1}
    assert errors.table()["tips_measured"] == pytest.approx(2 / 3, abs=1e-4)


@pytest.mark.parametrize("angle_deg", [30.0, -90.0])
def test_the_second_camera_sees_the_hands_centre_where_the_first_one_does(angle_deg: float) -> None:
    """It is in the middle of the sensor's range, times the scene's factor."""
    scene: Any = SimpleNamespace(
        sensor=SimpleNamespace(distance_m=(0.4, 0.8)), settings=SimpleNamespace(distance=1.5), from_camera=lambda T: T
    )
    T: Any = beside(scene, angle_deg)
    np.testing.assert_allclose(apply(T, np.array([[0.0, 0.0, 0.9]])), [[0.0, 0.0, 0.9]], atol=1e-12)
    assert np.degrees(np.arccos((np.trace(T[:3, :3]) - 1) / 2)) == pytest.approx(abs(angle_deg))


class Undrawn:
    """A scene of a still arm with blank images; each of the two cameras sees all but one tip of its own."""

    name, lens = "undrawn", np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0])
    sensor = SimpleNamespace(distance_m=(0.4, 0.8), size_px=(64, 48))
    settings = SimpleNamespace(arms=1, distance=1.0)

    def __init__(self, T_camera_first: np.ndarray | None = None) -> None:
        self.T_camera_first = np.eye(4) if T_camera_first is None else T_camera_first
        self._unseen = TIPS[0] if T_camera_first is None else TIPS[1]

    def from_camera(self, T_camera_first: np.ndarray) -> Undrawn:
        return Undrawn(T_camera_first)

    def at(self, at_s: float) -> DepthShot:
        points, blank = apply(self.T_camera_first, TRUE), np.zeros((48, 64), np.uint16)
        truth = ArmTruth(
            False, points, np.zeros(3), np.zeros(21), np.eye(4), np.arange(23) != self._unseen, np.zeros(5, np.bool_),
            np.full((5, 2), 9), "", "anybody",
        )  # fmt: skip
        return DepthShot(at_s, blank, 0.001, self.lens, (truth,), blank.astype(np.float32), blank.astype(np.uint8))


def off_by(shift_m: float) -> Any:
    def look(shot: DepthShot) -> SeenArms:
        (arm,) = shot.arms
        states = np.where(arm.seen, JointState.TRACKED, JointState.INFERRED).astype(np.uint8)
        points = arm.points + np.array([shift_m, 0.0, 0.0])
        return SeenArms((SeenArm(0, arm.left, 1.0, points, states, np.full(23, 0.002, np.float32), arm.angles),))

    return look


def test_each_camera_is_scored_at_its_own_instants_and_both_together_at_all() -> None:
    """From the second image on, when both have given one."""
    scene: Any = Undrawn()
    scores = two_camera_scores(scene, (off_by(0.0), off_by(0.02)), fps=5.0, seconds=0.6)
    first, second, fused = (scores[name] for name in ("first", "second", "fused"))
    assert [of["instants"] for of in (first, second, fused)] == [2, 3, 5]
    assert [of["followed"] for of in (first, second, fused)] == [1.0, 1.0, 1.0]
    assert first["palm_median_mm"] == pytest.approx(0.0, abs=1e-6)
    assert second["palm_median_mm"] == pytest.approx(20.0)
    assert 0.0 < fused["palm_median_mm"] < 20.0
    # Each camera lacks one tip that the other one sees; together they lack none, and have both from one camera.
    assert [of["tips_of_one_camera"] for of in (first, second, fused)] == [2, 3, 10]
    assert [of["tips_measured"] for of in (first, second)] == [0.8, 0.8]
    assert fused["tips_measured"] == 1.0


@pytest.mark.parametrize("axis", range(3))
def test_the_error_of_a_place_is_a_length_and_an_angle_about_any_axis(axis: int) -> None:
    true = rigid(exp_twist([0, 0, 0, 0.3, -0.8, 0.2])[:3, :3], [1.0, 2.0, 3.0]) @ TO_SENSOR
    turn = np.zeros(3)
    turn[axis] = np.radians(2.0)
    off = rigid(exp_twist([0, 0, 0, *turn])[:3, :3], np.roll([0.01, 0.0, 0.0], axis))
    place = SimpleNamespace(
        sensor="second", T_world_sensor=true @ off @ TO_SENSOR, position_sd=0.004, rotation_sd=np.radians(0.5)
    )
    first = SimpleNamespace(sensor="first", T_world_sensor=np.eye(4), position_sd=0.0, rotation_sd=0.0)
    tracker: Any = SimpleNamespace(places=[first, place])
    assert _place_error(tracker, true, 1.234) == {
        "known_after_s": 1.23, "position_error_mm": 10.0, "rotation_error_deg": 2.0,
        "position_sd_mm": 4.0, "rotation_sd_deg": 0.5,
    }  # fmt: skip
    place.T_world_sensor = None
    assert math.isnan(_place_error(tracker, true, 1.0)["known_after_s"])
    assert math.isnan(_place_error(SimpleNamespace(places=[first]), true, 1.0)["known_after_s"])  # type: ignore[arg-type]
