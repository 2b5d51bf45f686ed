"""The rig that the real clip is followed with, and which keypoints count as inside of the body."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.tracker import recordings
from mocapella.evaluation.silhouette_video import GROWN_PX, filmed_rig, images_of, near, rig_of
from mocapella.kinematics.silhouette_fit import Outline


@pytest.fixture
def clip() -> Path:
    folder = recordings() / "pose2sim_single_person"
    if not folder.is_dir():
        pytest.skip(f"needs {folder}")
    return folder


def test_the_cameras_of_the_real_clip_fit_its_images(clip: Path) -> None:
    rig, calibrated = filmed_rig(clip), rig_of(clip)
    images = next(images_of(clip, rig.cameras))
    assert list(rig.cameras) == list(calibrated.cameras)
    for name, placed in rig.cameras.items():
        assert placed.camera.size_px == images[name].shape[1::-1]
        assert (placed.camera.lens == calibrated.cameras[name].camera.lens).all()
    assert any(placed.camera.size_px != calibrated.cameras[name].camera.size_px for name, placed in rig.cameras.items())


RADIUS_PX, MIDDLE_PX = 20.0, np.array([53.0, 312.0])


def disc() -> Outline:
    """An outline whose window begins at x = -7, y = 262, and in which is no other thing."""
    x0, y0 = -7, 262
    y, x = np.mgrid[y0 : y0 + 101, x0 : x0 + 121]
    mask = np.hypot(x - MIDDLE_PX[0], y - MIDDLE_PX[1]) <= RADIUS_PX
    none = np.empty((0, 2))
    return Outline((x0, y0), 1, mask.astype(np.uint8), none, none, none, np.empty(0, np.int32), np.empty(0))


@given(st.floats(0, 2 * np.pi), st.floats(0, 200))
def test_a_keypoint_is_near_a_body_up_to_15_pixels_outside_of_it(turn: float, away_px: float) -> None:
    assert GROWN_PX == 15  # as the score's attribute says
    beyond = away_px - RADIUS_PX - 15
    (found,) = near(disc(), MIDDLE_PX + away_px * np.array([[np.cos(turn), np.sin(turn)]]))
    if abs(beyond) > 1.5:  # the disc and the point are of whole pixels
        assert found == (beyond < 0)


def test_a_keypoint_beyond_the_window_is_not_near_even_where_the_body_reaches_its_edge() -> None:
    full = msgspec.structs.replace(disc(), mask=np.ones((101, 121), np.uint8))
    x, y = (axis.ravel() for axis in np.mgrid[-9:117, 260:366])
    within = (x >= -7) & (x < -7 + 121) & (y >= 262) & (y < 262 + 101)
    np.testing.assert_array_equal(near(full, np.stack([x, y], axis=1).astype(np.float64)), within)


def test_of_no_keypoints_none_is_near() -> None:
    assert near(disc(), np.empty((0, 2))).tolist() == []
