"""Scenes as files: what is read back is what was written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocapella.errors import InputError, SettingsError
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_files import write_sequence
from mocapella.sources.simulate.silhouette_scene import SilhouetteScene, silhouette_scene


@pytest.fixture(scope="module")
def scene() -> SilhouetteScene:
    corruption = Corruption(wrong_frames=(2,))
    return silhouette_scene("runner", seed=1, cameras=2, size_px=(64, 48), seconds=0.15, corruption=corruption)


def frames_of(path: Path) -> list[np.ndarray]:
    film = cv2.VideoCapture(str(path))
    frames = []
    while True:
        there, frame = film.read()
        if not there:
            return frames
        frames.append(frame)


def test_films_rig_and_truth_are_those_of_the_scene(scene: SilhouetteScene, tmp_path: Path) -> None:
    folder = write_sequence(tmp_path / "out", scene, codec="lossless", masks=True)
    rig = load_camera_rig(folder / "rig.toml")
    assert list(rig.cameras) == ["camera1", "camera2"]
    for camera, name in enumerate(rig.cameras):
        np.testing.assert_array_equal(rig.cameras[name].T_camera_world, scene.rig.cameras[name].T_camera_world)
        np.testing.assert_array_equal(rig.cameras[name].camera.lens, scene.rig.cameras[name].camera.lens)
        frames, masks = frames_of(folder / f"{name}.avi"), frames_of(folder / f"{name}.mask.avi")
        assert len(frames) == len(masks) == len(scene) == 9
        for k, (frame, mask) in enumerate(zip(frames, masks, strict=True)):
            # Without loss but for the conversion of colours, which the codec may do.
            assert np.abs(frame.astype(int) - scene.images(k)[camera]).mean() < 4
            np.testing.assert_array_equal(mask[..., 0] > 127, scene.masks(k)[camera])
        np.testing.assert_array_equal(cv2.imread(str(folder / "empty" / f"{name}.png")), scene.background()[camera])
    truth = json.loads((folder / "truth.json").read_text())
    np.testing.assert_allclose(truth["times_s"], scene.times_s)
    assert truth["wrong_frames"] == [2]
    np.testing.assert_allclose(truth["people"][0]["angles_rad"], scene.poses().angles)
    np.testing.assert_allclose(truth["people"][0]["T_world_model"], scene.poses().T_world_model)
    np.testing.assert_allclose(truth["people"][0]["landmarks_m"][4], scene.landmarks(4), atol=1e-6)


def test_what_cannot_be_written_is_said(scene: SilhouetteScene, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="mjpeg"):
        write_sequence(tmp_path / "a", scene, codec="mjpg")
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InputError, match="cannot be written"):
        write_sequence(tmp_path / "file" / "b", scene)
