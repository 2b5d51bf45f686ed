"""Each fault of detectors that put keypoints together to people, alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.sources.simulate.crowd import CrowdPerson, CrowdScene, CrowdSettings, build_crowd
from mocapella.sources.simulate.keypoint_body import HALPE
from mocapella.sources.simulate.keypoint_camera import PHANTOM, KeypointCameraSettings, SimulatedKeypoints
from mocapella.sources.simulate.keypoint_faults import NO_FAULTS, KeypointFaults
from mocapella.sources.simulate.keypoint_parts import BELOW, HIPS, REACH
from mocapella.sources.simulate.occlusion import Box

NEAR = (CrowdPerson((-0.2, 0.0), "stand"), CrowdPerson((0.2, 0.0), "stand"))
APART = (CrowdPerson((-1.5, 0.0), "stand"), CrowdPerson((1.5, 0.0), "stand"))
TABLE = (Box((0.0, 1.0), (3.0, 1.0, 0.4)),)


def made(people: tuple[CrowdPerson, ...] = NEAR, boxes: tuple[Box, ...] = (), **faults: float) -> CrowdScene:
    camera = KeypointCameraSettings(faults=dataclasses.replace(NO_FAULTS, **faults))  # type: ignore[arg-type]
    settings = CrowdSettings("test", "a test", 0.5, people, camera=camera, boxes=boxes, seed=3)
    return build_crowd(dataclasses.replace(settings, ring=dataclasses.replace(settings.ring, height=1.5)))


def true_pixels(scene: CrowdScene, item: SimulatedKeypoints) -> np.ndarray:
    placed = scene.rig.cameras[item.frame.sensor]
    return project(apply(placed.T_camera_world, item.positions), placed.camera.lens)


def test_a_person_in_two_parts_is_two_detections_that_share_the_hips() -> None:
    for whole, parts in zip(made().frames(), made(split=1.0).frames(), strict=True):
        assert sorted(parts.detected.tolist()) == sorted([*whole.detected.tolist()] * 2)
        for person in whole.detected.tolist():
            full = whole.frame.found[whole.detected == person][0]
            halves = parts.frame.found[parts.detected == person]
            np.testing.assert_array_equal(halves.any(axis=0), full)
            np.testing.assert_array_equal(halves.all(axis=0), full & HIPS)
            assert sorted((half & BELOW).any() for half in halves) == [False, True]


def test_a_taken_limb_is_at_one_person_only() -> None:
    taken = 0
    scene = made(taken_limbs=1.0)
    for item in scene.frames():
        true = true_pixels(scene, item)
        for person, found, pixels in zip(item.detected, item.frame.found, item.frame.positions_px, strict=True):
            own, other = (np.linalg.norm(pixels - true[k], axis=-1) < 0.1 for k in (person, 1 - person))
            assert (own | other)[found].all()
            taken += int((other & ~own)[found].sum())
    assert taken > 0


def test_people_apart_keep_their_limbs() -> None:
    for plain, same in zip(made(APART).frames(), made(APART, taken_limbs=1.0).frames(), strict=True):
        true = true_pixels(made(APART), plain)
        near = np.nanmean(np.linalg.norm(true[0] - true[1], axis=-1)) < 2 * REACH * np.ptp(true[..., 1])
        assert near or np.array_equal(plain.frame.positions_px, same.frame.positions_px, equal_nan=True)


def test_hidden_keypoints_snap_to_their_limb_and_visible_ones_do_not() -> None:
    scene = made(boxes=TABLE, snapped=1.0)
    moved = 0
    for item in scene.frames():
        true = true_pixels(scene, item)
        for person, found, pixels in zip(item.detected, item.frame.found, item.frame.positions_px, strict=True):
            off = np.where(found, np.linalg.norm(pixels - true[person], axis=-1), 0.0) > 0.1
            assert not (off & item.visible[person]).any()
            moved += int(off.sum())
            knee, hip, ankle = (HALPE.index(f"L{name}") for name in ("Knee", "Hip", "Ankle"))
            if off[ankle] and not off[knee] and item.visible[person, knee]:
                a, b = true[person, ankle] - true[person, knee], pixels[ankle] - true[person, knee]
                assert 0.0 < a @ b / (a @ a) < 0.51
            assert not off[hip]
    assert moved > 0


def test_furniture_is_found_at_one_place_and_belongs_to_nobody() -> None:
    places: dict[str, list[np.ndarray]] = {}
    for item in made(furniture=4.0).frames():
        nobody = item.detected == PHANTOM
        assert (item.frame.confidences[nobody] < 0.55).all()
        for pixels in item.frame.positions_px[nobody]:
            places.setdefault(item.frame.sensor, []).append(np.nanmean(pixels, axis=0))
    assert places
    for found in places.values():
        assert len(np.unique(np.round(found, 1), axis=0)) <= 12
        assert len(found) > len(np.unique(np.round(found, 1), axis=0))


def test_other_scenes_keep_their_bits() -> None:
    for one, other in zip(made().frames(), made(furniture=1e-9).frames(), strict=True):
        np.testing.assert_array_equal(one.frame.positions_px, other.frame.positions_px)


@pytest.mark.parametrize("wrong", [{"split": 1.5}, {"taken_limbs": -0.1}, {"snapped": 2.0}, {"furniture": 21.0}])
def test_rates_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        KeypointFaults(**wrong)  # type: ignore[arg-type]
