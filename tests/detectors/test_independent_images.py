"""Images that are no video: each is searched by itself, and nothing of the one before is continued."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.arm_settings import KinematicArmSettings
from mocapella.model.arms import SeenArm
from mocapella.model.camera import Camera
from mocapella.sources.simulate.depth_scene import load_depth_scene


@cache
def recording() -> tuple[Camera, list[np.ndarray]]:
    """Return a camera, and depth images [m] of a hand that turns, a third of a second apart."""
    scene = load_depth_scene("rotation", seed=1, sensor="exact")
    shots = [scene.at(k / 3) for k in range(2)]
    return Camera("exact", scene.sensor.size_px, scene.lens), [s.depth * np.float32(s.unit_m) for s in shots]


def detected(at_s: float, *, mirrored: bool = False, **settings: float) -> tuple[KinematicArmDetector, list[SeenArm]]:
    """Return a detector, and the arms of the two images, so far apart in time [s]."""
    camera, images = recording()
    detector = KinematicArmDetector(camera, KinematicArmSettings(**settings))  # type: ignore[arg-type]
    first = detector.update(images[0], 0.0)
    last = detector.update(images[1][:, ::-1] if mirrored else images[1], at_s)
    assert len(first.arms) == len(last.arms) == 1
    return detector, [first.arms[0], last.arms[0]]


@cache
def alone() -> SeenArm:
    camera, images = recording()
    return KinematicArmDetector(camera).update(images[1], 0.0).arms[0]


@pytest.mark.parametrize(("at_s", "settings"), [(0.31, {}), (60.0, {}), (1 / 30, {"independent_s": 0.0})])
def test_an_image_after_a_gap_gives_what_it_gives_alone_and_the_arm_keeps_its_id(
    at_s: float, settings: dict[str, float]
) -> None:
    _, (before, after) = detected(at_s, **settings)
    np.testing.assert_array_equal(after.points, alone().points)
    assert after.id == before.id == 0


@pytest.mark.parametrize(
    ("at_s", "settings"), [(0.29, {}), (0.31, {"independent_s": 1.0}), (1.0, {"independent_s": 3600.0})]
)
def test_an_image_without_a_gap_continues_the_one_before(at_s: float, settings: dict[str, float]) -> None:
    _, (_, after) = detected(at_s, **settings)
    assert not np.array_equal(after.points, alone().points)


def test_an_arm_of_the_other_side_after_a_gap_is_another_one() -> None:
    _, (before, after) = detected(1.0, mirrored=True)
    assert before.left != after.left
    assert (before.id, after.id) == (0, 1)


def test_a_gap_does_not_forget_what_is_known_of_the_camera() -> None:
    detector, _ = detected(1.0)
    before = detector._fattening._evidence
    detector.update(recording()[1][1], 2.0)
    assert detector._fattening._evidence <= before < 0
