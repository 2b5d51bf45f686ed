"""Calibrations of other programs: OpenCV's file storage, EasyMocap, OpenPose, Anipose and Qualisys."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError
from mocapella.geometry.twists import exp_twist
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import decode_camera_rig, is_camera_rig, load_camera_rig

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "pose2sim_single_person" / "calibration"


def rig(seed: int, *, scale: float = 1.0) -> CameraRig:
    random = np.random.default_rng(seed)
    cameras = {}
    for k, name in enumerate(("cam_1", "cam_2", "cam_3")):
        lens = np.array([600.0 + k, 590.0, 320.0, 240.0, *random.uniform(-0.2, 0.2, 2), 1e-3, -2e-3, 0.01])
        T = exp_twist(np.r_[random.uniform(-3, 3, 3) * scale, random.uniform(-1, 1, 3)])
        cameras[name] = PlacedCamera(Camera(name, (640, 480), lens), T, np.full((6, 6), np.nan))
    return CameraRig(cameras)


def matrix(placed: PlacedCamera) -> np.ndarray:
    fx, fy, cx, cy = placed.camera.lens[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def store(path: Path, values: dict[str, Any]) -> Path:
    cv2 = pytest.importorskip("cv2")
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if isinstance(value, list):
            file.startWriteStruct(name, cv2.FileNode_SEQ)
            for one in value:
                file.write("", one)
            file.endWriteStruct()
        else:
            file.write(name, value)
    file.release()
    return path


def same(found: CameraRig, made: CameraRig, *, unit: float = 1.0) -> None:
    assert list(found.cameras) == list(made.cameras)
    for name, one in made.cameras.items():
        T = one.T_camera_world.copy()
        T[:3, 3] *= unit
        np.testing.assert_allclose(found.cameras[name].T_camera_world, T, atol=1e-9)
        np.testing.assert_allclose(found.cameras[name].camera.lens, one.camera.lens, atol=1e-9)
        assert found.cameras[name].camera.size_px == one.camera.size_px


@pytest.mark.parametrize("ending", [".yml", ".xml"])
@given(seed=st.integers(0, 10_000))
def test_a_folder_with_a_file_for_each_camera(ending: str, seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder, made = tmp_path_factory.mktemp("rig"), rig(seed)
    for name, one in made.cameras.items():
        values = {
            "image_width": 640, "image_height": 480, "camera_matrix": matrix(one),
            "distortion_coefficients": one.camera.lens[None, 4:], "R": one.T_camera_world[:3, :3].copy(),
            "T": one.T_camera_world[:3, 3:].copy(),
        }  # fmt: skip
        store(folder / f"{name}{ending}", values)
    same(load_camera_rig(folder), made)


def openpose(folder: Path, made: CameraRig) -> Path:
    for name, one in made.cameras.items():
        values = {
            "CameraMatrix": one.T_camera_world[:3].copy(), "Intrinsics": matrix(one),
            "Distortion": np.r_[one.camera.lens[4:], np.zeros(3)][:, None],
        }  # fmt: skip
        store(folder / f"{name}.xml", values)
    return folder


def test_openpose_has_a_file_for_each_camera(tmp_path: Path) -> None:
    made = rig(1)
    same(load_camera_rig(openpose(tmp_path, made)), made)


def easymocap(folder: Path, made: CameraRig, *, sized: bool = True) -> Path:
    intri: dict[str, Any] = {"names": list(made.cameras)}
    extri: dict[str, Any] = {"names": list(made.cameras)}
    for name, one in made.cameras.items():
        intri |= {f"K_{name}": matrix(one), f"dist_{name}": one.camera.lens[None, 4:]}
        intri |= {f"H_{name}": 480.0, f"W_{name}": 640.0} if sized else {}
        extri |= {
            f"R_{name}": np.zeros((3, 1)), f"Rot_{name}": one.T_camera_world[:3, :3].copy(),
            f"T_{name}": one.T_camera_world[:3, 3:].copy(),
        }  # fmt: skip
    store(folder / "intri.yml", intri)
    return store(folder / "extri.yml", extri)


@pytest.mark.parametrize("sized", [True, False])
def test_easymocaps_two_files_are_one_rig(sized: bool, tmp_path: Path) -> None:
    made = rig(2)
    easymocap(tmp_path, made, sized=sized)  # the principal point is in the middle of the image
    for path in (tmp_path, tmp_path / "intri.yml", tmp_path / "extri.yml"):
        same(load_camera_rig(path), made)


def test_a_stereo_pair_is_in_the_space_of_its_first_camera(tmp_path: Path) -> None:
    one, two, _ = rig(3).cameras.values()
    between = two.T_camera_world @ np.linalg.inv(one.T_camera_world)
    store(tmp_path / "intrinsics.yml", {"M1": matrix(one), "D1": one.camera.lens[None, 4:], "M2": matrix(two),
                                        "D2": two.camera.lens[None, 4:]})  # fmt: skip
    store(tmp_path / "extrinsics.yml", {"R": between[:3, :3].copy(), "T": between[:3, 3:].copy(), "R1": np.eye(3)})
    found = load_camera_rig(tmp_path / "extrinsics.yml").cameras
    assert list(found) == ["cam_1", "cam_2"]
    np.testing.assert_array_equal(found["cam_1"].T_camera_world, np.eye(4))
    np.testing.assert_allclose(found["cam_2"].T_camera_world, between, atol=1e-12)


def test_numbered_cameras_in_one_file(tmp_path: Path) -> None:
    made = rig(4)
    values: dict[str, Any] = {"nCameras": 3}
    for name, one in made.cameras.items():
        number = name.removeprefix("cam_")
        values |= {
            f"camera_matrix_{number}": matrix(one), f"camera_distortion_{number}": one.camera.lens[None, 4:],
            f"camera_pose_{number}": one.T_camera_world.copy(),
        }  # fmt: skip
    path = store(tmp_path / "several.xml", values)
    same(load_camera_rig(path), made)
    assert is_camera_rig(path.read_bytes())


def anipose(made: CameraRig, unit: float = 1.0) -> str:
    tables = {}
    for k, (name, one) in enumerate(made.cameras.items()):
        R = one.T_camera_world[:3, :3]
        angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
        axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (2 * np.sin(angle))
        tables[f"cam_{k}"] = {
            "name": name, "size": [640, 480], "matrix": matrix(one).tolist(),
            "distortions": one.camera.lens[4:].tolist(), "rotation": (angle * axis).tolist(),
            "translation": (unit * one.T_camera_world[:3, 3]).tolist(),
        }  # fmt: skip
    return tomli_w.dumps({**tables, "metadata": {"adjusted": False, "error": 0.5}})


def test_anipose_names_its_cameras_and_measures_in_millimetres() -> None:
    made = rig(5)
    same(decode_camera_rig(anipose(made)), made)
    same(decode_camera_rig(anipose(made, 1000.0)), made)


@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not here")
def test_qualisys_own_file_is_pose2sims_conversion_of_it_but_for_the_distortion() -> None:
    """Pose2Sim divides the distortion by 64, too; chessboard photographs of these cameras show the file's own."""
    own, converted = load_camera_rig(DATA / "Calib.qca.txt"), load_camera_rig(DATA / "Calib_qualisys.toml")
    assert list(own.cameras) == list(converted.cameras)
    for name, one in own.cameras.items():
        other = converted.cameras[name]
        np.testing.assert_allclose(one.T_camera_world, other.T_camera_world, atol=1e-6)
        np.testing.assert_allclose(one.camera.lens[:4], other.camera.lens[:4], atol=1e-6)
        np.testing.assert_allclose(one.camera.lens[4:6] / 64, other.camera.lens[4:6], atol=1e-6)
        assert one.camera.size_px == other.camera.size_px == (1088, 1920)


QUALISYS = (
    '<?xml version="1.0"?><calibration><cameras><camera serial="a" viewrotation="0">'
    '<fov_video left="0" top="0" right="639" bottom="479"/>'
    '<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="1000" y="0" z="2000"/>'
    '<intrinsic focalLengthU="64000" focalLengthV="64000" centerPointU="20480" centerPointV="15360" '
    'radialDistortion1="-0.1" radialDistortion2="0" radialDistortion3="0" tangentalDistortion1="0" '
    'tangentalDistortion2="0"/></camera></cameras></calibration>'
)
STORAGE = (
    "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ 600., 0., 320., 0., 600., 240., 0., 0., 1. ]\nR: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\nT: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n"
    "   data: [ 0., 0., 2. ]\n"
)


def test_the_examples_are_rigs() -> None:
    qualisys = decode_camera_rig(QUALISYS).cameras["a"]
    # The camera is at (1, 0, 2) m and looks along −z, with its y up; ours looks along its z, with y down.
    np.testing.assert_allclose(qualisys.T_camera_world @ [1, 0, 0, 1], [0, 0, 2, 1], atol=1e-12)
    np.testing.assert_allclose(qualisys.T_camera_world @ [1, 1, 0, 1], [0, -1, 2, 1], atol=1e-12)
    np.testing.assert_allclose(qualisys.camera.lens[:5], [1000, 1000, 320, 240, -0.1])
    assert decode_camera_rig(STORAGE).cameras["cam"].camera.size_px == (640, 480)
    assert is_camera_rig(QUALISYS)
    assert not is_camera_rig("<page></page>")
    assert not is_camera_rig("%YAML:1.0\n---\na: 1\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (QUALISYS.replace('viewrotation="0"', 'viewrotation="90"'), "is rotated in its view"),
        (QUALISYS.replace('x="1000"', 'x="far"'), "a.transform.x: 'far': is no number"),
        (QUALISYS.replace('r11="1"', 'r11="2"'), "is no rigid motion"),
        (QUALISYS.replace("transform", "place"), "has no intrinsic, transform or fov_video"),
        (QUALISYS.replace("<cameras>", "<!DOCTYPE x><cameras>"), "has a document type"),
        (QUALISYS[:-3], "is no XML"),
        ("<calibration></calibration>", "holds no camera"),
        (STORAGE.replace("rows: 3", "rows: 2"), "another number of values than rows and columns"),
        (STORAGE.replace("320.", "x"), "a value that is no number"),
        (STORAGE.replace("T: ", "X: "), "cam.translation: is missing"),
        ("%YAML:1.0\n---\na: 1\n", "holds no cameras"),
    ],
)
def test_damaged_calibrations_are_refused_by_name(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        decode_camera_rig(text, file="rig")


def test_a_folder_without_a_calibration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no cameras.*EasyMocap"):
        load_camera_rig(tmp_path)
