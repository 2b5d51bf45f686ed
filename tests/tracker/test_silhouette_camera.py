"""What one camera learns of its background, and where in its image limbs are looked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.silhouette_room import Room, bent, ring

from mocapella.kinematics.limb_search import Evidence
from mocapella.kinematics.silhouette_fit import eye, figure, seen_at
from mocapella.model.rigged_mesh import landmarks_at, posed
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background_memory import BackgroundMemory, MemorySettings
from mocapella.sensing.region_contour import RegionSettings
from mocapella.tracker import silhouette_camera
from mocapella.tracker.body_fitter import BodyFitter
from mocapella.tracker.limb_support import DISTINCT, LimbSupport
from mocapella.tracker.silhouette_camera import EVERY, Ball, SilhouetteCamera
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


@given(
    st.tuples(st.integers(-40, 90), st.integers(-40, 70)),
    st.tuples(st.integers(1, 60), st.integers(1, 60)),
    st.integers(0, 2**16),
)
def test_a_silhouette_covers_the_scored_samples_of_its_mask(
    at: tuple[int, int], shape: tuple[int, int], seed: int
) -> None:
    phi = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    silhouette = Silhouette((at[0] * STEP_PX, at[1] * STEP_PX), STEP_PX, phi)
    wide, high = EYE.size_px
    grid = STEP_PX * EVERY
    mask = silhouette.mask((wide, high))[::grid, ::grid]
    camera = SilhouetteCamera(EYE, STEP_PX, SilhouetteSettings())
    assert np.array_equal(camera._scored_in(silhouette, mask.shape), mask)


@pytest.mark.slow
@given(st.tuples(*[st.floats(-3.0, 3.0)] * 2, st.floats(0.05, 1.0)))
def test_evidence_of_limbs_is_the_score_of_its_part_of_the_image(ball: tuple[float, float, float]) -> None:
    camera = learnt()
    assert camera.look(figure(ROOM.mesh), posed(ROOM.mesh, POSE), SilhouetteSettings())
    found = camera.evidence(IMAGE, None, [Ball(np.array([*ball[:2], 0.0]), ball[2])])
    rows, columns = found.strange.shape
    assert rows > 0 < columns
    window = Silhouette(found.origin_px, STEP_PX, np.zeros((rows * EVERY, columns * EVERY), np.float32))
    assert camera.background is not None
    assert np.array_equal(found.strange, camera.background.strange(IMAGE, window, EVERY))


def learnt() -> SilhouetteCamera:
    """A camera that knows its empty room."""
    camera = SilhouetteCamera(EYE, STEP_PX, SilhouetteSettings())
    assert camera.background is not None
    for _ in range(2):
        camera.background.update(ROOM.walls()[NAME], None)
    return camera


@pytest.mark.slow
def test_foreground_is_scored_once_a_frame_and_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    scored: list[int] = []
    score = BackgroundMemory.strange

    def noted(self: BackgroundMemory, *args: Any) -> Any:
        scored.append(id(self))
        return score(self, *args)

    room = Room(rig=ring(2, size=(160, 120), focal=150.0))
    fitter = BodyFitter(room.mesh, room.rig)
    fitter.start(POSE, 0)
    fitter.learn_background(room.walls())
    monkeypatch.setattr(BackgroundMemory, "strange", noted)
    for k in range(1, 4):
        scored.clear()
        # Limbs are searched, too: they are where the images show the room.
        fitter.update(room.walls() if k == 2 else room.images(POSE), k * 10**9 // 60)
        assert sorted(scored) == sorted(set(scored))
        assert len(scored) == 2


@pytest.mark.slow
def test_foreground_is_scored_anew_once_the_background_has_changed() -> None:
    camera, image = learnt(), ROOM.images(POSE)[NAME]
    known = camera._scores(image)
    assert camera._scores(image) is known
    memory = camera.memory()
    camera.forget_background()
    assert not camera._scores(image).any()  # nothing is known any more
    camera.recall(memory)
    assert np.array_equal(camera._scores(image), known)


@pytest.mark.parametrize(
    ("focal", "background", "known", "measured"),
    [(600.0, True, True, True), (150.0, True, True, False), (600.0, True, False, False), (600.0, False, False, False)],
)
def test_edges_of_arms_are_compared_in_fine_pictures_of_known_rooms(
    focal: float, background: bool, known: bool, measured: bool
) -> None:
    room = Room(rig=ring(1, size=(640, 480), focal=focal))
    ((name, placed),) = room.rig.cameras.items()
    settings = SilhouetteSettings(background=MemorySettings() if background else None)
    camera, image = SilhouetteCamera(eye(placed), 1, settings), room.images(POSE)[name]
    if camera.background is not None and known:
        camera.background.update(room.walls()[name], None)
    assert camera.look(figure(room.mesh), posed(room.mesh, POSE), settings)
    camera.segment(image, None, near=True)
    arms = LimbSupport(room.mesh).arms
    found = camera.support(None, arms)
    assert found.excess is not None
    these = np.isfinite(found.excess)
    assert these.any() == measured
    assert arms[found.outline.part[these]].all()
    assert camera.support(None).excess is None
    if measured:
        assert found.excess[these].mean() > DISTINCT
