"""The rig that the real clip is followed with: its images are narrower than the calibration says."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.tracker import recordings
from mocapella.evaluation.silhouette_video import filmed_rig, images_of, rig_of


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
