"""`mocapella.calibrate` and `mocapella.triangulate`: the commands' results, of files and of arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.filmed_boards import BOARD, film

import mocapella
from mocapella.calibration.cameras import CameraCalibration
from mocapella.errors import CalibrationError, InputError, SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.library.triangulation import tracks_of_arrays
from mocapella.model.board import BoardView
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.sensing import boards

TOML = 'kind = "charuco"\ncolumns = 6\nrows = 5\nsquare_m = 0.06\n'
NOTHING = np.full((6, 6), np.nan)
LENS = np.array([600.0, 600, 320, 240, 0, 0, 0, 0, 0])


@pytest.fixture
def images(monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """Two cameras' images, whose pixels say which view they are, and a detector that reads that."""
    views = {(v.camera, v.frame): v for v in film(instants=14, noise_px=0.2).views}

    class Reader(boards.BoardDetector):
        def update(self, image: Any, camera: str, frame: int) -> BoardView | None:
            self.report.pictures += 1
            view = views.get((camera, int(image.flat[0]) // 10))
            if view is not None:
                self.report.found += 1
                self.report.corners += len(view.ids)
            return view

    monkeypatch.setattr(boards, "BoardDetector", Reader)
    stack = np.repeat(10 * np.arange(14, dtype=np.uint8), 16).reshape(14, 4, 4)
    return {"c0": stack, "c1": np.repeat(stack[..., None], 3, axis=3)}


def test_arrays_and_files_give_the_same_rig(images: dict[str, np.ndarray], tmp_path: Path) -> None:
    import cv2

    (tmp_path / "board.toml").write_text(TOML)
    for name, stack in images.items():
        (tmp_path / name).mkdir()
        for k, image in enumerate(stack):
            cv2.imwrite(str(tmp_path / name / f"{k:02}.png"), image)
    found = mocapella.calibrate(images, BOARD)
    assert isinstance(found, CameraCalibration)
    assert list(found.rig.cameras) == ["c0", "c1"]
    truth = film(instants=1).T_camera_first[1]
    first, second = (found.rig.cameras[name].T_camera_world for name in ("c0", "c1"))
    np.testing.assert_allclose(second @ inverse(first), truth, atol=0.01)
    of_files = mocapella.calibrate([tmp_path / "c0", tmp_path / "c1"], tmp_path / "board.toml")
    for name in ("c0", "c1"):
        np.testing.assert_array_equal(of_files.rig.cameras[name].camera.lens, found.rig.cameras[name].camera.lens)


@pytest.mark.slow
def test_known_lenses_times_and_more_images_are_used(images: dict[str, np.ndarray], tmp_path: Path) -> None:
    first = mocapella.calibrate(images, BOARD)
    save_camera_rig(tmp_path / "rig.toml", first.rig)
    times = {"c0": [k / 30 for k in range(14)], "c1": [k / 30 + 0.004 for k in range(14)]}
    for rig in (first.rig, tmp_path / "rig.toml"):
        found = mocapella.calibrate(images, BOARD, rig=rig, times=times, tolerance_s=0.008, origin=3)
        for name in images:
            np.testing.assert_allclose(
                found.rig.cameras[name].camera.lens, first.rig.cameras[name].camera.lens, rtol=1e-4
            )
        assert found.shared_instants == first.shared_instants
    some = mocapella.calibrate(images, BOARD, frames="even")
    assert some.instants == 7
    more = mocapella.calibrate(images, BOARD, frames="even", alone={"c0": images["c0"]})
    assert more.cameras["c0"].views == 2 * some.cameras["c0"].views


@pytest.mark.parametrize(
    ("more", "error", "words"),
    [
        ({"tolerance_s": 0.01}, SettingsError, "a tolerance has no meaning without timestamps"),
        ({"times": {"c0": [0.0]}}, SettingsError, "times of c1 are missing; there are c0"),
        ({"alone": {"c9": []}}, SettingsError, "alone c9: no such camera; there are c0, c1"),
        ({"origin": 77}, SettingsError, "origin 77: no camera has that frame"),
        ({"frames": "all"}, SettingsError, "all"),
        ({"rig": CameraRig({})}, SettingsError, "the rig has no camera 'c0'"),
        ({"rig": "gone.toml"}, InputError, "gone.toml"),
        ({"alone": {"c0": np.zeros((1, 4, 4))}}, SettingsError, "float64; give"),
    ],
)
def test_a_mistake_is_named(
    images: dict[str, np.ndarray], more: dict[str, Any], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        mocapella.calibrate(images, BOARD, **more)


def test_a_camera_that_never_sees_the_board_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"camera left: .*\(the board\)"):
        mocapella.calibrate({"left": np.zeros((2, 40, 60), np.uint8)}, BOARD)
    with pytest.raises(SettingsError):
        mocapella.calibrate({"a b": np.zeros((2, 40, 60), np.uint8)}, BOARD)


def rig() -> CameraRig:
    cameras = {}
    for name, angle in {"left": 0.0, "right": 0.8}.items():
        cameras[name] = PlacedCamera(
            Camera(name, (640, 480), LENS), rigid(rotation_about_y(angle), [0, 0, 2.0]), NOTHING
        )
    return CameraRig(cameras)


def seen(truth: np.ndarray) -> dict[str, np.ndarray]:
    return {name: project(apply(one.T_camera_world, truth), LENS) for name, one in rig().cameras.items()}


@given(st.integers(0, 1000), st.integers(1, 5), st.sampled_from(["robust", "linear", "weighted-linear"]))
def test_triangulate_undoes_project(seed: int, points: int, solver: str) -> None:
    truth = np.random.default_rng(seed).uniform(-0.3, 0.3, (3, points, 3))
    found = mocapella.triangulate(seen(truth), rig(), solver=solver, fps=50.0)
    np.testing.assert_allclose(found.tracks.positions, truth, atol=1e-6)
    assert found.points.individuals == ("points",)
    assert found.points.rate_hz == pytest.approx(50.0)
    np.testing.assert_allclose(found.points.times_s, [0.0, 0.02, 0.04])
    np.testing.assert_allclose(found.points.positions[:, 0], truth, atol=1e-6)


def test_confidences_names_and_gaps_are_kept() -> None:
    truth = np.random.default_rng(0).uniform(-0.3, 0.3, (4, 2, 3))
    pixels = {name: np.concatenate([one, np.ones((4, 2, 1))], axis=2) for name, one in seen(truth).items()}
    pixels["left"][1, 0, 2] = 0.1
    pixels["right"][2, 1] = np.nan
    found = mocapella.triangulate(pixels, rig(), names=["nose", "chin"], fps=10)
    assert found.points.keypoints == ("nose", "chin")
    unknown = np.isnan(found.points.positions[:, 0, :, 0])
    assert np.argwhere(unknown).tolist() == [[1, 0], [2, 1]]
    np.testing.assert_array_equal(found.points.states[:, 0] == 0, unknown)
    assert repr(found).startswith("<6 of 8 points of 4 frames; 0.00 px>")
    assert len(found.points.to_pandas()) == 8


def test_files_are_read_and_written_as_by_the_command(tmp_path: Path) -> None:
    truth = np.random.default_rng(0).uniform(-0.3, 0.3, (2, 3, 3))
    rows = ["frame,camera,point,x_px,y_px"]
    for name, one in seen(truth).items():
        rows += [f"{i},{name},p{p},{one[i, p, 0]},{one[i, p, 1]}" for i in range(2) for p in range(3)]
    (tmp_path / "points.csv").write_text("\n".join(rows) + "\n")
    save_camera_rig(tmp_path / "rig.toml", rig())
    told: list[str] = []
    found = mocapella.triangulate(tmp_path / "points.csv", tmp_path / "rig.toml", fps=60, progress=told.append)
    assert told[-1] == "triangulating 2 frames"
    np.testing.assert_allclose(found.tracks.positions, truth, atol=1e-4)
    found.save(tmp_path / "out.trc")
    again = mocapella.load(tmp_path / "out.trc")
    assert again.points is not None
    np.testing.assert_allclose(again.points.positions[:, 0], truth, atol=1e-4)
    same = mocapella.triangulate([tmp_path / "points.csv"], rig())
    with pytest.raises(SettingsError, match=r"no rising times; give triangulate\(…, fps=\)"):
        same.points  # noqa: B018
    tracks = tracks_of_arrays(seen(truth))
    np.testing.assert_allclose(mocapella.triangulate(tracks, rig()).tracks.positions, truth, atol=1e-6)


@pytest.mark.parametrize(
    ("points", "more", "error", "words"),
    [
        ({}, {}, SettingsError, "arrays are none; give"),
        ({"left": np.zeros((2, 3, 4))}, {}, SettingsError, r"left \(2, 3, 4\)"),
        ({"left": np.zeros((2, 3, 2)), "right": np.zeros((3, 3, 2))}, {}, SettingsError, "equal frames and points"),
        ({"left": np.zeros((2, 3, 2))}, {"names": ["a", "a", "b"]}, SettingsError, "2 different names for 3 points"),
        ({"middle": np.zeros((2, 3, 2))}, {}, InputError, "the rig has no such camera"),
        ({"left": np.zeros((2, 3, 2))}, {"fps": 0.0}, SettingsError, "fps is 0.0"),
        ({"left": np.zeros((2, 3, 2))}, {"solver": "robst"}, SettingsError, "did you mean robust"),
        ("gone.csv", {}, InputError, "gone.csv"),
    ],
)
def test_what_cannot_be_triangulated_is_named(
    points: Any, more: dict[str, Any], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        mocapella.triangulate(points, rig(), **more)


def test_a_rig_of_one_camera_is_refused() -> None:
    one = CameraRig({"left": rig().cameras["left"]})
    with pytest.raises(InputError, match="has 1 camera"):
        mocapella.triangulate({"left": np.zeros((2, 3, 2))}, one)
