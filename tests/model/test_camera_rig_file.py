from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.errors import InputError
from mocapella.geometry.lens import project
from mocapella.geometry.twists import exp_twist
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig

LENS = np.array([600.0, 590.0, 320.0, 240.0, -0.3, 0.1, 1e-3, -2e-3, 0.0])


def rig(twist: np.ndarray | None = None, *, sure: bool = True) -> CameraRig:
    T = exp_twist(np.arange(6) / 7 if twist is None else twist)
    covariance = 1e-6 * np.diag(np.arange(1.0, 7)) if sure else np.full((6, 6), np.nan)
    return CameraRig({"left.1": PlacedCamera(Camera("left.1", (640, 480), LENS, 0.01), T, covariance, -0.002)})


@given(arrays(np.float64, 6, elements=st.floats(-3, 3)), st.booleans())
def test_what_is_written_is_read_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, twist: np.ndarray, sure: bool
) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    written = rig(twist, sure=sure)
    save_camera_rig(path, written)
    (name, got), (_, had) = *load_camera_rig(path).cameras.items(), *written.cameras.items()
    assert (name, got.camera.name, got.camera.size_px) == ("left.1", "left.1", (640, 480))
    assert (got.camera.readout_s, got.clock_s) == (0.01, -0.002)
    for a, b in (
        (got.camera.lens, had.camera.lens),
        (got.T_camera_world, had.T_camera_world),
        (got.covariance, had.covariance),
    ):
        np.testing.assert_array_equal(a, b)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("mocapella camera rig", "other", "field format: 'other'"),
        ("version = 1", "version = 2", "field version: 2"),
        ("readout_s", "readout", "field cameras.left.1.readout: is not known"),
        ("distortion", "distortions", "field cameras.left.1.distortions: is not known"),
        ("600.0", '"x"', "field cameras.left.1.focal_px"),
        ("600.0", "-600.0", "no focal length is 0 or less"),
        ("640", "640.5", "is no size of a picture"),
        ("T_camera_world = [\n    [\n        0.", "T_camera_world = [\n    [\n        9.", "is no rigid motion"),
        ("version = 1", "version = ", "is no TOML"),
        ("left.1", "left 1", "sensor name 'left 1' cannot be used"),
    ],
)
def test_a_file_that_was_changed_is_refused_by_name(tmp_path: Path, before: str, after: str, says: str) -> None:
    path = tmp_path / "rig.toml"
    save_camera_rig(path, rig())
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    with pytest.raises(InputError) as error:
        load_camera_rig(path)
    assert says in str(error.value)
    assert str(path) in str(error.value)


def test_a_missing_field_or_file_and_a_folder_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    with pytest.raises(InputError, match="is not there; name the file or folder of a rig, or calibrate"):
        load_camera_rig(path)
    path.write_text('format = "mocapella camera rig"\nversion = 1\n[cameras.a]\nsize_px = [1, 2]\n')
    with pytest.raises(InputError, match="focal_px: is missing"):
        load_camera_rig(path)
    path.write_text("a = 1\n")
    with pytest.raises(InputError, match="holds no cameras"):
        load_camera_rig(path)
    with pytest.raises(InputError, match="cannot be written"):
        save_camera_rig(tmp_path / "no" / "rig.toml", rig())


FOREIGN = """[cam_0]
size = [640.0, 480.0]
matrix = [[600.0, 0.0, 320.0], [0.0, 590.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, 0.2, 0.0, 0.0]
rotation = [0.0, 0.0, 1.5707963267948966]
translation = [1.0, 2.0, 3.0]
"""


def test_a_rotation_vector_turns_as_opencv_has_it(tmp_path: Path) -> None:
    path = tmp_path / "Calib.toml"
    path.write_text(FOREIGN)
    placed = load_camera_rig(path).cameras["cam_0"]
    np.testing.assert_allclose(placed.T_camera_world @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)
    np.testing.assert_array_equal(placed.camera.lens, [600, 590, 320, 240, 0.1, 0.2, 0, 0, 0])
    assert np.isnan(placed.covariance).all()


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("translation = [1.0, 2.0, 3.0]", "", "field cam_0.translation: is missing"),
        ("[0.1, 0.2, 0.0, 0.0]", "[0.1]", "field cam_0.distortions"),
        ("[0.0, 0.0, 1.5707963267948966]", "[0.0, 1.0]", "field cam_0.rotation"),
        ("[[600.0, 0.0", "[[600.0, 5.0", "field cam_0.matrix"),
        ("[1.0, 2.0, 3.0]", "[1.0, 2.0]", "field cam_0.translation"),
        ("size =", "fisheye = true\nsize =", "field cam_0.fisheye"),
        ("size =", "ignore = true\nsize =", "all its cameras are ignored"),
    ],
)
def test_others_files_are_refused_by_name_too(tmp_path: Path, before: str, after: str, says: str) -> None:
    path = tmp_path / "Calib.toml"
    path.write_text(FOREIGN.replace(before, after))
    with pytest.raises(InputError) as error:
        load_camera_rig(path)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("charuco_4cam/camera_array.toml", ["cam_0", "cam_1", "cam_2", "cam_3"]),
        ("charuco_4cam/config.toml", ["cam_0", "cam_1", "cam_2", "cam_3"]),
        ("mediapipe_holistic_4cam/config.toml", ["cam_0", "cam_1", "cam_2", "cam_3"]),
        ("pose2sim_single_person/calibration/Calib_qualisys.toml", ["cam_01", "cam_02", "cam_03", "cam_04"]),
    ],
)
def test_the_recordings_rigs_are_read(camera_recordings: Path, file: str, names: list[str]) -> None:
    found = load_camera_rig(camera_recordings / file)
    assert list(found.cameras) == names
    for placed in found.cameras.values():
        width, height = placed.camera.size_px
        ahead = project([0, 0, 1.0], placed.camera.lens)
        assert 0.4 < ahead[0] / width < 0.6
        assert 0.4 < ahead[1] / height < 0.6
