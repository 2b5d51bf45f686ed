"""What one camera learns of its background, and where in its image limbs are looked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.silhouette_room import Room, bent, ring

from mocapella.kinematics.limb_search import Evidence
from mocapella.kinematics.silhouette_fit import eye, figure, seen_at
from mocapella.model.rigged_mesh import landmarks_at, posed
from mocapella.sensing.background_memory import MemorySettings
from mocapella.sensing.region_contour import RegionSettings
from mocapella.tracker import silhouette_camera
from mocapella.tracker.silhouette_camera import Ball, SilhouetteCamera
from mocapella.tracker.silhouette_settings import SilhouetteSettings

ROOM = Room(rig=ring(1, size=(160, 120), focal=150.0))
NAME, PLACED = next(iter(ROOM.rig.cameras.items()))
EYE = eye(PLACED)
POSE = bent(ROOM.mesh, {})
IMAGE = ROOM.images(POSE)[NAME]
STEP_PX = 2


@pytest.mark.parametrize("background", [None, MemorySettings()])
def test_a_background_is_learnt_of_segmented_images_if_there_is_one(background: MemorySettings | None) -> None:
    camera = SilhouetteCamera(EYE, STEP_PX, SilhouetteSettings(background=background))

    def learns() -> bool:
        camera.learn(IMAGE, None)
        return camera.background is not None and bool(camera.background.known.any())

    assert not learns(), "before the body's outline is known"
    assert camera.look(figure(ROOM.mesh), posed(ROOM.mesh, POSE), SilhouetteSettings())
    assert not learns(), "before the image is segmented"
    camera.segment(IMAGE, None, near=True)
    assert learns() == (background is not None)


def shown(evidence: Evidence, points: np.ndarray) -> np.ndarray:
    """Whether the evidence has a sample beside each point (n, 3) in the world, to the pixel."""
    rows, columns = evidence.strange.shape
    off_px = seen_at(points, EYE) - evidence.origin_px
    return np.asarray(((off_px >= -1) & (off_px < evidence.step_px * np.array([columns, rows]) + 1)).all(axis=1))


def test_limbs_are_looked_for_where_they_can_reach_and_everywhere_if_one_is_too_near() -> None:
    camera = SilhouetteCamera(EYE, STEP_PX, SilhouetteSettings())
    assert camera.look(figure(ROOM.mesh), posed(ROOM.mesh, POSE), SilhouetteSettings())
    landmarks = dict(zip(ROOM.mesh.landmarks, landmarks_at(ROOM.mesh, POSE), strict=True))
    hand, feet = landmarks["left hand"], np.array([landmarks["left toe"], landmarks["right toe"]])
    rng = np.random.default_rng(0)
    for radius_m in (0.1, 0.3):
        directions = rng.normal(size=(500, 3))
        sphere = hand + radius_m * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        found = camera.evidence(IMAGE, None, [Ball(hand, radius_m)])
        assert shown(found, sphere).all()
        assert not shown(found, feet).any()
    C = np.linalg.inv(PLACED.T_camera_world)[:3, 3]
    found = camera.evidence(IMAGE, None, [Ball(hand, 0.1), Ball(C, 0.1)])
    assert shown(found, np.array(list(landmarks.values()))).all()


def searches(monkeypatch: pytest.MonkeyPatch, step_px: int) -> list[RegionSettings]:
    """How the contour is searched at a stride: usually, near the final outline, and for a rough pose."""
    asked: list[RegionSettings] = []

    def noted(_image: Any, expected: Any, *, settings: RegionSettings, **_more: Any) -> Any:
        asked.append(settings)
        return SimpleNamespace(silhouette=expected, surety=None)

    monkeypatch.setattr(silhouette_camera, "region_contour", noted)
    camera = SilhouetteCamera(EYE, step_px, SilhouetteSettings())
    for near, wide in ((False, False), (True, False), (False, True), (True, True)):
        camera.wide = wide
        camera.forget_frame()
        assert camera.look(figure(ROOM.mesh), posed(ROOM.mesh, POSE), SilhouetteSettings())
        camera.segment(IMAGE, None, near=near)
    assert asked[2] == asked[3]
    return asked[:3]


def test_a_rough_pose_is_searched_twice_as_far_at_the_same_cost_of_the_farthest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The cost grows with the squared distance from the expected outline."""
    usual, near, wide = searches(monkeypatch, STEP_PX)
    assert wide.band_px == 2 * usual.band_px > near.band_px
    assert wide.prior_weight * wide.band_px**2 == pytest.approx(usual.prior_weight * usual.band_px**2)


def test_a_search_at_twice_the_stride_is_the_same_in_an_image_of_half_the_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for fine, coarse in zip(searches(monkeypatch, 2), searches(monkeypatch, 4), strict=True):
        for name in ("band_px", "window_px", "unsure_px"):
            assert getattr(coarse, name) == pytest.approx(2 * getattr(fine, name))
        assert coarse.fewest_px2 == pytest.approx(4 * fine.fewest_px2)
        assert coarse.prior_weight * coarse.band_px**2 == pytest.approx(fine.prior_weight * fine.band_px**2)


def test_evidence_of_a_rough_pose_reaches_twice_as_far() -> None:
    camera = SilhouetteCamera(EYE, STEP_PX, SilhouetteSettings())
    usual = camera._reach
    camera.wide = True
    assert camera._reach == 2 * usual
    assert usual == SilhouetteSettings().margin_steps * STEP_PX
    soft = SilhouetteSettings().correspondences.soft_steps
    assert camera._wide_correspondences.soft_steps == 2 * soft
