"""Simulated hands as keypoints: postures, errors of the set size, equal bits of equal seeds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.hand import TIPS
from mocapella.sources.simulate.hand_keypoints import (
    HANDS_AT,
    HandDetectorErrors,
    HandKeypointScene,
    SimulatedHands,
    hand_frames,
    hand_keypoint_scene,
    hand_keypoint_scenes,
    hand_shapes,
    posture_landmarks,
)

EXACT = HandDetectorErrors(white=0.0, slow=0.0)


def some(name: str, errors: HandDetectorErrors, seconds: float = 1.0) -> tuple[HandKeypointScene, list[SimulatedHands]]:
    scene = dataclasses.replace(hand_keypoint_scene(name), errors=errors)
    return scene, list(hand_frames(scene, 1, seconds=seconds))


@pytest.mark.parametrize("name", list(hand_keypoint_scenes()))
def test_equal_seeds_give_equal_bits_and_times_rise(name: str) -> None:
    scene = hand_keypoint_scene(name)
    one, two = (list(hand_frames(scene, 5, seconds=0.2)) for _ in range(2))
    assert [item.at_ns for item in one] == sorted(item.at_ns for item in one)
    assert len(one) == 6 * len(scene.rig.cameras)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.frame.positions_px, b.frame.positions_px)


def test_without_errors_pixels_are_projections() -> None:
    scene, items = some("person", EXACT)
    for item in items:
        placed = scene.rig.cameras[item.frame.sensor]
        for side, first in HANDS_AT.items():
            true = project(apply(placed.T_camera_world, item.hands[side]), placed.camera.lens)
            np.testing.assert_allclose(item.frame.positions_px[0, first : first + 21], true, atol=1e-3)


def test_a_fist_brings_the_tips_to_the_palm() -> None:
    shape = hand_shapes(0)["right"]
    flat, fist = (posture_landmarks(shape, name, 1.0, np.eye(4)) for name in ("open", "fist"))
    far = np.linalg.norm(flat[list(TIPS[1:])], axis=1)
    assert (np.linalg.norm(fist[list(TIPS[1:])], axis=1) < 0.7 * far).all()
    pinch = posture_landmarks(shape, "pinch", 1.0, np.eye(4))
    assert np.linalg.norm(pinch[4] - pinch[8]) < 0.5 * np.linalg.norm(flat[4] - flat[8])
    spread = posture_landmarks(shape, "spread", 1.0, np.eye(4))
    assert np.linalg.norm(spread[8] - spread[20]) > 1.2 * np.linalg.norm(flat[8] - flat[20])


def test_errors_have_the_size_that_is_set() -> None:
    scene, items = some("fist", HandDetectorErrors(white=0.02, slow=0.0), seconds=3.0)
    errors = []
    for item in items:
        placed = scene.rig.cameras[item.frame.sensor]
        true = project(apply(placed.T_camera_world, item.hands["right"]), placed.camera.lens)
        errors.append((item.frame.positions_px[0] - true) / np.ptp(true, axis=0).max())
    assert np.std(errors) == pytest.approx(0.02, rel=0.1)


def test_tips_are_missing_and_one_camera_remains() -> None:
    _, items = some("fist", dataclasses.replace(EXACT, missing_tips=0.5))
    missing = np.isnan([item.frame.positions_px[0, :, 0] for item in items])
    assert 0.35 < missing[:, list(TIPS)].mean() < 0.65
    assert not np.delete(missing, list(TIPS), axis=1).any()
    scene, items = some("one-camera", dataclasses.replace(EXACT, one_camera_after_s=0.5))
    first = next(iter(scene.rig.cameras))
    late = [item for item in items if item.at_ns >= 1.5e9]
    assert {item.cameras["left"] for item in late} == {1}
    for item in late:
        seen = np.isfinite(item.frame.positions_px[0, HANDS_AT["left"], 0])
        assert seen == (item.frame.sensor == first)


def test_a_camera_that_exchanges_hands_does_so_in_every_image() -> None:
    scene, items = some("camera-exchanged", dataclasses.replace(EXACT, exchanged=1))
    names = list(scene.rig.cameras)
    for item in items:
        placed = scene.rig.cameras[item.frame.sensor]
        true = project(apply(placed.T_camera_world, item.hands["left"]), placed.camera.lens)
        own = "right" if item.frame.sensor == names[-1] else "left"
        np.testing.assert_allclose(item.frame.positions_px[0, HANDS_AT[own]], true[0], atol=1e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("white", -0.1), ("slow", 2.0), ("missing_tips", 1.5), ("outliers", -1.0), ("confused", 2.0), ("slow_s", 0.0),
     ("exchanged", -1), ("one_camera_after_s", 0.0)],
)  # fmt: skip
def test_invalid_errors_of_a_detector_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=name):
        HandDetectorErrors(**{name: value})  # type: ignore[arg-type]
