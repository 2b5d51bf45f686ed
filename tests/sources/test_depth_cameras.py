"""Live depth cameras, each behind a stand-in for its package: unit, lens, times, and a plug that is pulled."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest
from support.fake_depth import SIZE, FakeCamera, depthai, freenect, openni2, pylibfreenect2, pyorbbecsdk, pyrealsense2
from support.k4a_stand_in import k4a
from support.programs import wait_until

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.kinect_depth import UNIT_M
from mocapella.sources.acquisition import Acquisition, AcquisitionSettings
from mocapella.sources.depth_cameras import CAMERAS
from mocapella.sources.depth_cameras import device as device_module
from mocapella.sources.depth_cameras.device import DepthDevice
from mocapella.sources.depth_cameras.freenect import FreenectCamera
from mocapella.sources.depth_cameras.freenect2 import Freenect2Camera
from mocapella.sources.depth_cameras.k4a import K4aCamera
from mocapella.sources.depth_cameras.oak import OakCamera
from mocapella.sources.depth_cameras.openni import OpenNiCamera
from mocapella.sources.depth_cameras.orbbec import OrbbecCamera
from mocapella.sources.depth_cameras.realsense import RealSenseCamera
from mocapella.sources.depth_options import DepthOptions, complete
from mocapella.sources.open_depth import open_depth

STOP = threading.Event()
QUICK = AcquisitionSettings(retry_s=0.02, longest_retry_s=0.05, silent_s=0.5, close_s=0.5)

Made = Callable[..., DepthDevice]
MAKERS: dict[str, tuple[Callable[[FakeCamera], Any], type[DepthDevice], str, Any, float]] = {
    "openni": (openni2, OpenNiCamera, "0", 101, 0.0001),
    "realsense": (pyrealsense2, RealSenseCamera, "", 0.00025, 0.00025),
    "orbbec": (pyorbbecsdk, OrbbecCamera, "0", 0.5, 0.0005),
    "oak": (depthai, OakCamera, "0", 0.001, 0.001),
    "freenect2": (pylibfreenect2, Freenect2Camera, "0", None, 0.001),
    "k4a": (k4a, K4aCamera, "0", None, 0.001),
    "freenect": (freenect, FreenectCamera, "0", None, 0.001),
}

SIZES = {"freenect": (640, 480), "freenect2": (512, 424), "k4a": (640, 576)}
"""Sizes of the images of real cameras; the stand-ins of others have `SIZE`."""


def made(kind: str, options: DepthOptions | None = None, **how: Any) -> tuple[FakeCamera, DepthDevice]:
    package, source, which, unit, _ = MAKERS[kind]
    camera = FakeCamera(unit)
    return camera, source(which, f"{kind}:{which}", options, package=package(camera), **how)


@pytest.mark.parametrize("kind", MAKERS)
def test_a_camera_says_its_unit_and_lens_and_gives_its_images(kind: str) -> None:
    _, source = made(kind)
    state = source.open()
    camera = complete(state, source.name)
    assert state.unit_m == pytest.approx(MAKERS[kind][-1])
    assert state.fps == 30
    assert state.colour is None
    assert camera.size_px == SIZES.get(kind, SIZE)
    assert state.problems == ()
    pictures = [source.read(STOP) for _ in range(3)]
    assert [picture.number for picture in pictures if picture] == [0, 1, 2]
    times = [picture.time_ns for picture in pictures if picture]
    assert times == sorted(set(times))
    for picture in pictures:
        assert picture is not None
        assert (picture.image.dtype, picture.size_px) == (np.uint16, camera.size_px)
    if kind != "freenect":
        assert [int(picture.image[0, 0]) for picture in pictures if picture] == [701, 702, 703]
    if kind not in SIZES:
        assert np.diff(times) == pytest.approx(1e9 / 30, rel=1e-3)  # the device's stamps, whenever they come
    source.close()


@pytest.mark.parametrize("kind", MAKERS)
def test_one_that_is_unplugged_is_looked_for_again_and_read_on(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_module, "LOST_S", 0.05)
    camera, source = made(kind)
    said: list[str] = []
    with Acquisition(source, QUICK, say=said.append) as acquisition:
        acquisition.start()
        wait_until("images", lambda: acquisition.report().taken > 3)
        before = acquisition.take(1.0)
        camera.plugged = False
        wait_until("lost", lambda: any("looking again" in text for text in said))
        camera.plugged = True
        wait_until("there again", lambda: any("there again" in text for text in said))
        acquisition.take(1.0)
        after = acquisition.take(1.0)
        assert before is not None
        assert after is not None
        assert after.time_ns > before.time_ns
        assert acquisition.report().lost == 1
    assert camera.stopped > 0


@pytest.mark.parametrize("kind", MAKERS)
def test_one_that_is_not_there_is_named(kind: str) -> None:
    camera, source = made(kind)
    camera.plugged = False
    with pytest.raises(InputError, match=f"{kind}:.*plug"):
        source.open()
    assert source.read(STOP) is None


@pytest.mark.parametrize("kind", MAKERS)
def test_a_package_that_is_not_installed_is_named_with_what_to_do(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _, source, which, *_ = MAKERS[kind]
    for module in source.packages:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(SettingsError, match="is not installed: install"):
        source(which, f"{kind}:{which}").open()


@pytest.mark.parametrize("kind", MAKERS)
def test_what_the_user_says_goes_before_what_the_camera_says(kind: str) -> None:
    width = SIZES.get(kind, SIZE)[0]
    lens = (0.7 * width, 0.8 * width, 3.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    state = made(kind, DepthOptions(unit_m=0.002, lens=lens))[1].open()
    assert (state.unit_m, state.lens) == (0.002, lens)
    with pytest.raises(InputError, match="outside the image"):
        made(kind, DepthOptions(lens=(6.0, 6.0, 9999.0, *lens[3:])))[1].open()


def test_the_door_makes_each_kind_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind, (_, source, *_) in MAKERS.items():
        for text in (f"{kind}:", f"{kind}:3"):
            opened = open_depth(text)
            assert isinstance(opened, source)
            assert opened.name == text
            assert opened.which == (text.partition(":")[2] or CAMERAS[kind][2])
    with pytest.raises(SettingsError, match=r"'kinect:0' cannot be used; name .*openni:0"):
        open_depth("kinect:0")
    with pytest.raises(SettingsError, match="cannot be used"):
        open_depth("")
    assert set(MAKERS) == set(CAMERAS)


def test_numbers_are_wanted_where_cameras_are_counted() -> None:
    for kind in ("openni", "freenect"):
        package, source, *_ = MAKERS[kind]
        with pytest.raises(SettingsError, match=f"write {kind}:0"):
            source("first", f"{kind}:first", package=package(FakeCamera(101))).open()
        with pytest.raises(InputError, match="no such camera"):
            source("1", f"{kind}:1", package=package(FakeCamera(101))).open()


def test_openni_is_unmirrored_and_its_lens_is_that_of_its_view() -> None:
    _, source = made("openni")
    state = source.open()
    assert state.lens is not None
    assert state.lens[:4] == pytest.approx((4 / math.tan(0.5), 3 / math.tan(0.4), 3.5, 2.5))
    camera = FakeCamera(101)
    stays = OpenNiCamera("0", "openni:0", package=openni2(camera, stays_mirrored=True)).open()
    assert "mirrored" in stays.problems[0]
    assert OpenNiCamera("0", "openni:0", package=openni2(FakeCamera(101), can_mirror=False)).open().problems == ()
    with pytest.raises(InputError, match="no depth sensor"):
        OpenNiCamera("0", "openni:0", package=openni2(FakeCamera(None))).open()
    with pytest.raises(InputError, match="pixels of the format 7"):
        OpenNiCamera("0", "openni:0", package=openni2(FakeCamera(7))).open()
    asked = FakeCamera(7)
    options = DepthOptions(size_px=(640, 480), fps=60)
    assert OpenNiCamera("0", "openni:0", options, package=openni2(asked)).open().unit_m == 0.001
    assert asked.asked == {"size": (640, 480), "fps": 60}


def test_a_kinects_disparities_become_depths_where_that_is_asked_for() -> None:
    camera, source = made("freenect", DepthOptions(kinect_raw=True))
    state = source.open()
    picture = source.read(STOP)
    assert picture is not None
    assert camera.asked["format"] == 0
    assert state.unit_m == UNIT_M
    assert float(picture.image[5, 5]) * UNIT_M == pytest.approx(3.8484, abs=UNIT_M)
    camera, source = made("freenect")
    state = source.open()
    assert (camera.asked["format"], state.unit_m) == (5, 0.001)
    assert state.lens is not None
    assert state.lens[0] == pytest.approx(575.8, abs=0.05)


@pytest.mark.parametrize("text", ["openni:0", "realsense:", "orbbec:0", "oak:0", "rendered:fist"])
def test_disparities_of_what_has_none_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match=rf"kinect-raw: {text.partition(':')[0]} gives depths"):
        open_depth(text, DepthOptions(kinect_raw=True))
    assert isinstance(open_depth("freenect:0", DepthOptions(kinect_raw=True)), FreenectCamera)


def test_a_realsense_is_asked_for_by_serial_size_and_rate() -> None:
    camera = FakeCamera(0.001)
    options = DepthOptions(size_px=(848, 480), fps=60)
    RealSenseCamera("0123", "realsense:0123", options, package=pyrealsense2(camera)).open()
    assert camera.asked == {"serial": "0123", "stream": ("depth", 848, 480, "z16", 60)}
    other = FakeCamera(0.001)
    RealSenseCamera("", "realsense:", DepthOptions(fps=90), package=pyrealsense2(other)).open()
    assert other.asked == {"stream": ("depth", "z16", 90)}


def test_a_distortion_that_is_not_ours_is_said_and_one_that_is_is_taken() -> None:
    bent = (0.1, 0.2, 0.01, 0.02, 0.3)
    for model, taken, problems in (("brown_conrady", bent, 0), ("inverse_brown_conrady", (0.0,) * 5, 1)):
        package = pyrealsense2(FakeCamera(0.001), model=model, coeffs=bent)
        state = RealSenseCamera("", "realsense:", package=package).open()
        assert state.lens == (6.0, 6.5, 3.25, 2.75, *taken)
        assert len(state.problems) == problems


def test_an_orbbec_is_found_by_number_or_serial_and_says_what_it_refuses() -> None:
    camera = FakeCamera(1.0)
    state = OrbbecCamera("CP1234", "orbbec:CP1234", package=pyorbbecsdk(camera)).open()
    assert camera.asked["device"] == "CP1234"
    assert state.lens == (6.0, 6.5, 3.25, 2.75, 0.1, 0.2, 0.01, 0.02, 0.3)
    with pytest.raises(InputError, match="no device CP99"):
        OrbbecCamera("CP99", "orbbec:CP99", package=pyorbbecsdk(FakeCamera(1.0))).open()
    silent = FakeCamera(1.0)
    with pytest.raises(InputError, match=r"orbbec:0: gave no image within 5 s; plug it in again"):
        OrbbecCamera("0", "orbbec:0", package=pyorbbecsdk(silent, silent=True)).open()
    assert silent.stopped == 1
    package = pyorbbecsdk(FakeCamera(1.0), obeys=False)
    assert OrbbecCamera("0", "orbbec:0", package=package).open().problems == ()
    assert OrbbecCamera("0", "orbbec:0", DepthOptions(fps=60), package=package).open().problems != ()


def test_an_oak_is_found_by_number_or_id_and_asked_for_size_and_rate() -> None:
    camera = FakeCamera()
    state = OakCamera("0", "oak:0", DepthOptions(size_px=(1280, 800), fps=15), package=depthai(camera)).open()
    assert camera.asked == {"device": "first", "size": (1280, 800), "fps": 15}
    assert state.lens == (6.0, 6.5, 3.25, 2.75, 0.0, 0.0, 0.0, 0.0, 0.0)
    OakCamera("14442C10D13F7FD000", "oak:14442C10D13F7FD000", package=depthai(camera)).open()
    assert (camera.asked["device"], camera.asked["size"]) == ("14442C10D13F7FD000", (640, 400))
    with pytest.raises(InputError, match=r"oak:1: there is no such camera; 1 of them is here"):
        OakCamera("1", "oak:1", package=depthai(camera)).open()
    with pytest.raises(InputError, match=r"oak:lost: cannot be opened \(Cannot find any device"):
        OakCamera("lost", "oak:lost", package=depthai(camera)).open()


def test_an_oak_that_cannot_be_used_is_closed_and_says_why() -> None:
    for how, why in (
        ({"version": "2.30.0"}, r"depthai 2.30.0; install depthai, version 3"),
        ({"pairs": 0}, "no pair of cameras for depth; name an OAK-D"),
        ({"silent": True}, "gave no image within 5 s; plug it in again"),
        ({"sockets": ("B", "C")}, "no colour camera beside its pair"),
    ):
        camera = FakeCamera()
        with pytest.raises(InputError, match=f"oak:0: .*{why}"):
            OakCamera("0", "oak:0", DepthOptions(colour=True), package=depthai(camera, **how)).open()
        assert camera.asked.get("closed", False) == ("version" not in how)


@pytest.mark.parametrize("platform", ["RVC2", "RVC4"])
def test_an_oaks_depth_with_colour_has_the_colour_cameras_lens(platform: str) -> None:
    camera = FakeCamera()
    state = OakCamera("0", "oak:0", DepthOptions(colour=True), package=depthai(camera, platform=platform)).open()
    assert state.colour is not None
    assert state.colour.T_colour_depth is None
    assert state.colour.lens == state.lens == (7.0, 7.5, 3.25, 2.75, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert ("aligned by" in camera.asked) == (platform == "RVC4")
    assert camera.asked["within"].total_seconds() == pytest.approx(0.5 / 30, abs=1e-6)


def test_a_kinect_v2_gives_whole_millimetres_and_its_images_back() -> None:
    camera, source = made("freenect2", DepthOptions(colour=True))
    state = source.open()
    picture = source.read(STOP)
    assert picture is not None
    assert picture.image[0, :4].tolist() == [701, 0, 0, 65535]  # not a number, infinite, too far
    assert camera.asked["held"] == 0
    assert state.lens == (365.5, 365.6, 256.5, 205.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert state.colour is not None
    assert (state.colour.lens, state.colour.T_colour_depth) == (state.lens, None)
    source.close()
    assert camera.asked["closed"]
    Freenect2Camera("0123456747", "freenect2:0123456747", package=pylibfreenect2(camera)).open()
    assert camera.asked["device"] == b"0123456747"
    with pytest.raises(InputError, match=r"freenect2:0123456748: there is no such camera; 1 of them is here"):
        Freenect2Camera("0123456748", "freenect2:0123456748", package=pylibfreenect2(camera)).open()
    with pytest.raises(InputError, match="freenect2:0: cannot be opened; plug it into a USB 3 port"):
        Freenect2Camera("0", "freenect2:0", package=pylibfreenect2(FakeCamera(), opens=False)).open()


def test_stamps_that_jump_begin_a_new_count_and_time_still_rises() -> None:
    times = count(100.0, 1 / 30)
    camera, source = made("realsense", clock=lambda: next(times))
    source.open()
    first = source.read(STOP)
    camera.frames = 100_000  # the device's clock has jumped by an hour
    second = source.read(STOP)
    camera.frames = 0
    third = source.read(STOP)
    assert first is not None
    assert second is not None
    assert third is not None
    assert first.time_ns < second.time_ns < third.time_ns < 102e9


@pytest.mark.parametrize("kind", MAKERS)
def test_a_camera_with_colour_gives_pairs_of_one_instant(kind: str) -> None:
    _, source = made(kind, DepthOptions(colour=True))
    state = source.open()
    assert state.colour is not None
    for _ in range(3):
        picture = source.read(STOP)
        assert picture is not None
        assert picture.colour is not None
        height, width = picture.image.shape if kind != "k4a" else (720, 1280)
        assert picture.colour.shape == (height, width, 3)
        blue, green, red = picture.colour[0, 0].tolist()
        assert (blue, green) == (0, 7)  # blue, green, red
        if kind != "freenect":
            assert int(picture.image[0, 0]) == 700 + red
    source.close()


@pytest.mark.parametrize("kind", ["realsense", "orbbec"])
def test_the_motion_between_both_cameras_is_the_packages(kind: str) -> None:
    _, source = made(kind, DepthOptions(colour=True))
    colour = source.open().colour
    assert colour is not None
    T = np.array(colour.T_colour_depth)
    assert T[:3, :3] == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]))  # columns and rows are not mixed up
    assert T[:3, 3] == pytest.approx([0.015, 0.0, 0.001])
    assert colour.size_px == SIZE


@pytest.mark.parametrize("kind", ["openni", "freenect"])
def test_depth_that_the_device_registers_has_the_colour_cameras_lens(kind: str) -> None:
    camera, source = made(kind, DepthOptions(colour=True))
    state = source.open()
    assert state.colour is not None
    assert state.colour.T_colour_depth is None
    assert state.colour.lens == state.lens
    if kind == "openni":
        assert camera.asked["registration"] == 1


def test_a_camera_without_colour_says_so() -> None:
    camera = FakeCamera(100)
    source = OpenNiCamera("0", "openni:0", DepthOptions(colour=True), package=openni2(camera, registers=False))
    with pytest.raises(InputError, match="no colour images"):
        source.open()
