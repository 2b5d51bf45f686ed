"""An Azure Kinect as a depth camera with colour, by a stand-in for the vendor's library with its C interface."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.k4a_stand_in import built_once, read_log

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.lens import project
from mocapella.sources.depth_cameras.k4a import K4aCamera
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.device_checks import depth_cameras
from mocapella.sources.k4a_lens import COLOUR, DEPTH, K4aCalibration, lens_of
from mocapella.sources.k4a_libraries import load_camera_library, load_libraries

STOP = threading.Event()
WITH_COLOUR = DepthOptions(colour=True)
RADIAL = {DEPTH: (3.130577, 2.324939, 0.130416, 3.458652, 3.350115, 0.662942),
          COLOUR: (0.722746, -2.88559, 1.632723, 0.602199, -2.719626, 1.565053)}  # fmt: skip
"""Coefficients of a device; the stand-in has the same."""

Open = Callable[..., K4aCamera]


@pytest.fixture
def camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Open:
    """A camera of the stand-in, which is told how to behave by its variables; its log is tmp_path/log."""
    library = load_camera_library([built_once()])
    monkeypatch.setenv("K4A_LOG", str(tmp_path / "log"))

    def make(options: DepthOptions = WITH_COLOUR, which: str = "0", **told: Any) -> K4aCamera:
        for name, value in told.items():
            monkeypatch.setenv(f"K4A_{name.upper()}", str(value))
        return K4aCamera(which, f"k4a:{which}", options, package=library)

    return make


def filled(radial: tuple[float, ...], focal_px: float, size_px: tuple[int, int], model: int = 4) -> K4aCalibration:
    """A calibration whose depth camera has this lens, centred."""
    made = K4aCalibration()
    one: Any = made.cameras[DEPTH]
    one.model, one.width, one.height = model, *size_px
    middle = ((size_px[0] - 1) / 2, (size_px[1] - 1) / 2)
    one.parameters[:] = (*middle, focal_px, focal_px, *radial, 0.0, 0.0, 2e-4, -3e-4, 0.0)
    return made


def vendors(points: np.ndarray, radial: tuple[float, ...], focal_px: float, centre: tuple[float, float]) -> np.ndarray:
    """Pixels by the vendor's model, p2 = 2e-4 and p1 = -3e-4."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    s, (k1, k2, k3, k4, k5, k6), p1, p2 = x * x + y * y, radial, -3e-4, 2e-4
    ratio = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    u = x * ratio + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * ratio + 2 * p2 * x * y + p1 * (s + 2 * y * y)
    return np.stack([centre[0] + focal_px * u, centre[1] + focal_px * v], axis=1)


@given(
    k1=st.floats(-0.12, 0.3), k2=st.floats(-0.02, 0.1), k4=st.floats(-0.05, 0.05), focal_px=st.floats(500.0, 700.0)
)  # fmt: skip
def test_a_fitted_lens_projects_as_the_vendors_within_its_stated_error(
    k1: float, k2: float, k4: float, focal_px: float
) -> None:
    radial = (k1, k2, 0.0, k4, 0.0, 0.0)
    lens, error_px = lens_of(filled(radial, focal_px, (640, 576)), DEPTH)
    assert error_px < 1.0
    angle = np.linspace(0.0, 2 * math.pi, 25)
    rings = [np.stack([r * np.cos(angle), r * np.sin(angle), np.ones(25)], 1) for r in (0.0, 0.2, 0.45)]
    points = np.concatenate(rings)
    far = project(points, np.array(lens)) - vendors(points, radial, focal_px, (319.5, 287.5))
    assert np.abs(far).max() < error_px + 0.05


def test_the_lenses_of_a_device_are_fitted_to_a_pixel_or_two() -> None:
    for which, focal_px, size_px, largest_px in ((DEPTH, 503.9, (640, 576), 1.0), (COLOUR, 602.7, (1280, 720), 2.5)):
        lens, error_px = lens_of(filled(RADIAL[which], focal_px, size_px), DEPTH)
        assert error_px < largest_px
        x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.6, 0.6, 25), np.linspace(-0.5, 0.5, 25)))
        points = np.stack([x, y, np.ones_like(x)], axis=1)
        middle = ((size_px[0] - 1) / 2, (size_px[1] - 1) / 2)
        far = np.linalg.norm(project(points, np.array(lens)) - vendors(points, RADIAL[which], focal_px, middle), axis=1)
        assert far.max() < largest_px


def test_a_lens_of_another_model_or_beyond_its_angles_is_left_without_distortion() -> None:
    for known in (
        filled(RADIAL[DEPTH], 503.9, (640, 576), model=3),
        filled(RADIAL[DEPTH], 0.0, (640, 576)),
        filled((-5.0, 0.0, 0.0, 0.0, 0.0, 0.0), 503.9, (640, 576)),  # it turns back within the image
    ):
        lens, error_px = lens_of(known, DEPTH)
        assert (error_px, lens[4:]) == (math.inf, (0.0,) * 5)


def test_pairs_have_the_devices_pixels_lenses_motion_and_stamps(camera: Open, tmp_path: Path) -> None:
    source = camera()
    state = source.open()
    assert (state.size_px, state.fps, state.unit_m, state.problems) == ((640, 576), 30.0, 0.001, ())
    assert state.colour is not None
    assert state.colour.size_px == (1280, 720)
    T = np.array(state.colour.T_colour_depth)
    np.testing.assert_array_equal(T[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(T[:3, 3], [-0.032, -0.002, 0.004])
    times = []
    for number in range(4):
        picture = source.read(STOP)
        assert picture is not None
        assert picture.colour is not None
        assert (picture.image.shape, picture.colour.shape) == ((576, 640), (720, 1280, 3))
        rows, columns = np.indices((576, 640))
        np.testing.assert_array_equal(picture.image, 701 + number + rows + columns)
        assert (picture.colour == [0, 7, 1 + number]).all()
        times.append(picture.time_ns)
    assert np.diff(times) == pytest.approx(33_333_000, abs=2)
    source.close()
    source.close()
    assert source.read(STOP) is None
    log = read_log(tmp_path / "log")
    log.check_released()
    assert ("start", 10 * 2 + 2) in log.lines
    assert ("colour", 1) in log.lines


def test_depth_alone_leaves_the_colour_camera_off(camera: Open, tmp_path: Path) -> None:
    source = camera(DepthOptions(size_px=(320, 288), fps=15))
    state = source.open()
    picture = source.read(STOP)
    assert picture is not None
    assert (picture.image.shape, picture.colour, state.colour) == ((288, 320), None, None)
    assert state.lens is not None
    assert state.lens[2] == pytest.approx(166.03)
    source.close()
    log = read_log(tmp_path / "log")
    log.check_released()
    assert ("start", 10 * 1 + 1) in log.lines
    assert "colour" not in log.words


@pytest.mark.parametrize("options", [DepthOptions(size_px=(512, 512)), DepthOptions(fps=25)])
def test_a_size_or_rate_that_it_does_not_have_is_replaced_and_said(camera: Open, options: DepthOptions) -> None:
    source = camera(options)
    state = source.open()
    source.close()
    assert (state.size_px, state.fps) == ((640, 576), 30.0)
    assert state.problems == ("it does not support the requested size or rate, and uses its default",)


def test_a_lens_that_does_not_fit_is_said(camera: Open) -> None:
    source = camera(lens=3)
    problems = source.open().problems
    source.close()
    assert [text.partition(" camera")[0] for text in problems] == ["the depth", "the colour"]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"fail": "k4a_device_open"}, "k4a:0: cannot be opened; plug it in; no other program"),
        ({"fail": "k4a_device_start_cameras"}, "k4a:0: its cameras do not start; use another USB 3 port"),
        ({"fail": "k4a_device_get_calibration"}, "k4a:0: its calibration cannot be read; plug it in again"),
        ({"devices": 0}, "k4a:0: there is no camera; plug one in"),
    ],
)
def test_what_cannot_be_opened_is_named_and_released(
    camera: Open, tmp_path: Path, told: dict[str, Any], words: str
) -> None:
    source = camera(**told)
    with pytest.raises(InputError, match=words):
        source.open()
    assert source.read(STOP) is None
    read_log(tmp_path / "log").check_released()


def test_it_is_found_by_its_serial_number(camera: Open, tmp_path: Path) -> None:
    source = camera(which="000000001001", devices=2)
    source.open()
    source.close()
    assert ("start", 22) in read_log(tmp_path / "log").lines
    with pytest.raises(InputError, match="here: 000000001000, 000000001001; a number below 100"):
        camera(which="000000001009", devices=2).open()


@pytest.mark.parametrize("image", ["k4a_capture_get_depth_image", "k4a_capture_get_color_image"])
def test_a_capture_without_one_of_its_images_is_left_out(camera: Open, tmp_path: Path, image: str) -> None:
    source = camera(fail=f"{image}:2:2")
    source.open()
    numbers = [int(picture.image[0, 0]) for _ in range(3) if (picture := source.read(STOP)) is not None]
    source.close()
    assert numbers == [701, 704, 705]
    read_log(tmp_path / "log").check_released()


def test_a_lost_camera_ends_the_reading(camera: Open, tmp_path: Path) -> None:
    source = camera(fail="k4a_device_get_capture:3")
    source.open()
    assert [source.read(STOP) is None for _ in range(3)] == [False, False, True]
    source.close()
    read_log(tmp_path / "log").check_released()


def test_the_body_tracker_is_not_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only = tmp_path / "only"
    only.mkdir()
    (name,) = built_once().glob("libk4a.so*")
    (only / name.name).write_bytes(name.read_bytes())
    monkeypatch.setattr("mocapella.sources.k4a_libraries._usual_folders", lambda: iter(()))
    monkeypatch.setenv("MOCAPELLA_K4A", str(only))
    assert load_camera_library() is not None
    with pytest.raises(SettingsError, match="libk4abt is not installed"):
        load_libraries()
    found = {finding.what: finding for finding in depth_cameras()}["depth camera k4a:"]
    assert (found.verdict, "1.4.1" in found.found) == ("ok", True)
    monkeypatch.setenv("MOCAPELLA_K4A", "")
    with pytest.raises(SettingsError, match="libk4a is not installed: install the Azure Kinect Sensor SDK"):
        K4aCamera("0", "k4a:0").open()
    found = {finding.what: finding for finding in depth_cameras()}["depth camera k4a:"]
    assert (found.verdict, found.found) == ("note", "not installed")
