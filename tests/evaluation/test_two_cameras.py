"""A second depth camera fills in what the first cannot see, in rendered scenes with truth."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation.two_cameras import beside, looks_of, two_camera_scores
from mocapella.geometry.rigid import apply
from mocapella.model.arms import SeenArms
from mocapella.model.hand import TIPS
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.sources.simulate.depth_scene import DepthShot, load_depth_scene
from mocapella.sources.simulate.seen_arms import SeenArmSettings, SimulatedArms
from mocapella.tracker.arms import ArmsTracker


def test_another_camera_sees_the_very_same_scene() -> None:
    scene = load_depth_scene("fist", seed=1, sensor="exact")
    other = beside(scene, 60.0)
    for at_s in (0.3, 1.7):
        one, two = scene.at(at_s), other.at(at_s)
        np.testing.assert_allclose(two.arms[0].points, apply(other.T_camera_first, one.arms[0].points), atol=1e-12)
        np.testing.assert_allclose(two.arms[0].T_camera_palm, other.T_camera_first @ one.arms[0].T_camera_palm)
        np.testing.assert_array_equal(one.arms[0].angles, two.arms[0].angles)
        # The image shows it where the truth says it is.
        seen = two.arms[0].seen.copy()
        seen[list(TIPS)] = False
        x, y, z = two.arms[0].points[seen].T
        px = (
            np.rint(two.lens[0] * x / z + two.lens[2]).astype(int),
            np.rint(two.lens[1] * y / z + two.lens[3]).astype(int),
        )
        assert seen.sum() > 5
        assert (np.abs(two.exact_m[px[1], px[0]] - z) < 0.06).all()
    np.testing.assert_array_equal(scene.from_camera(np.eye(4)).at(0.3).exact_m, scene.at(0.3).exact_m)


@pytest.mark.slow
def test_fingertips_that_one_camera_cannot_see_are_those_of_the_other() -> None:
    scene = load_depth_scene("fist", seed=101, sensor="exact")
    told = two_camera_scores(scene, (SimulatedArms(seed=1).look, SimulatedArms(seed=2).look), fps=15.0, seconds=3.0)
    first, fused = told["first"], told["fused"]
    assert first["tips_of_one_camera"] > 20
    assert first["tips_of_one_camera_median_mm"] > 20
    assert fused["tips_of_one_camera_median_mm"] < 10
    assert fused["tips_measured"] > 0.99 > first["tips_measured"]
    assert fused["tip_p95_mm"] < 0.5 * first["tip_p95_mm"]
    assert fused["palm_median_mm"] < min(first["palm_median_mm"], told["second"]["palm_median_mm"])
    assert (fused["ids"], fused["followed"]) == (1, 1.0)


def test_without_motion_a_second_camera_has_no_place_and_no_score() -> None:
    scene = load_depth_scene("still", seed=1, sensor="exact")
    told = two_camera_scores(scene, (SimulatedArms().look, SimulatedArms().look), fps=5.0, seconds=1.0, rig=False)
    assert math.isnan(told["place"]["known_after_s"])
    assert told["fused"]["instants"] == 0


def test_each_frame_is_from_when_its_image_was_taken() -> None:
    """The cameras take turns, half an interval apart."""
    arrivals: list[Arrival] = []

    class Heard(ArmsTracker):
        def update(self, arrival: Arrival) -> Scene:
            arrivals.append(arrival)
            return super().update(arrival)

    def look(_shot: DepthShot) -> SeenArms:
        return SeenArms((), "it does not look")

    two_camera_scores(load_depth_scene("still", seed=1, sensor="exact"), (look, look), fps=5.0, seconds=0.4, make=Heard)
    np.testing.assert_allclose([one.frame.time_ns / 1e9 for one in arrivals], [0.0, 0.1, 0.2, 0.3], atol=1e-8)
    assert [one.at_ns for one in arrivals] == [one.frame.time_ns for one in arrivals]


class Kept:
    """A detector that keeps what it is given."""

    name = "kept"

    def __init__(self) -> None:
        self.given: list[tuple[np.ndarray, float]] = []

    def update(self, depth: np.ndarray, at_s: float) -> SeenArms:
        self.given.append((depth, at_s))
        return SeenArms((), "it does not look")

    def reset(self) -> None:
        self.given.clear()


def test_each_detector_is_given_the_depth_of_its_own_camera_in_metres() -> None:
    shot = load_depth_scene("still", seed=1, sensor="exact").at(0.3)
    one, two = Kept(), Kept()
    looks = looks_of((one, two))
    assert looks[1](shot).reason == "it does not look"
    looks[1](msgspec.structs.replace(shot, unit_m=2 * shot.unit_m))
    assert one.given == []
    (depth, at_s), (twice, _) = two.given
    there = np.isfinite(shot.exact_m)
    assert there.any()
    assert (depth.dtype, at_s) == (np.float32, 0.3)
    np.testing.assert_allclose(depth, np.where(there, shot.exact_m, 0), atol=shot.unit_m)
    np.testing.assert_allclose(twice, 2 * depth)


def test_a_scene_of_two_arms_is_refused() -> None:
    look = SimulatedArms().look
    with pytest.raises(SettingsError, match="one with one arm"):
        two_camera_scores(load_depth_scene("two-hands", sensor="exact"), (look, look))


def test_simulated_looks_have_the_errors_that_they_say() -> None:
    scene = load_depth_scene("fist", seed=101, sensor="exact")
    shots = [scene.at(k / 5) for k in range(12)]
    looks = SimulatedArms(SeenArmSettings(measured_sd_m=0.002, inferred_sd_m=0.03), seed=3)
    away, states = [], []
    for shot in shots:
        (arm,), (truth,) = looks.look(shot).arms, shot.arms
        np.testing.assert_array_equal(arm.states == 2, truth.seen)
        away.append((arm.points - truth.points) / arm.sd[:, None])
        states.append(arm.states)
    errors, measured = np.array(away), np.array(states) == 2
    assert 0.8 < np.sqrt(np.mean(errors[measured] ** 2)) < 1.2
    assert 0.6 < np.sqrt(np.mean(errors[~measured] ** 2)) < 1.5
    looks.reset()
    np.testing.assert_array_equal(looks.look(shots[0]).arms[0].points, looks_again(shots[0]))


def looks_again(shot: object) -> np.ndarray:
    fresh = SimulatedArms(SeenArmSettings(measured_sd_m=0.002, inferred_sd_m=0.03), seed=3)
    return np.asarray(fresh.look(shot).arms[0].points)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "changed", [{"measured_sd_m": -1.0}, {"lasts_s": 0.0}, {"left_sure": 0.4}, {"wrong_side": 2.0}]
)
def test_settings_out_of_range_are_refused(changed: dict[str, float]) -> None:
    with pytest.raises(SettingsError):
        SeenArmSettings(**changed)
