"""Bodies of an Azure Kinect, by a stand-in for the vendor's libraries with their C interface."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from itertools import count, pairwise
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from support.k4a_stand_in import NAMES, build, check_frame, number_of, read_log
from support.programs import wait_until

from mocapella.cli.node_azure_kinect import AzureKinectKeys
from mocapella.errors import InputError, SettingsError
from mocapella.model.observations import BodyFrame
from mocapella.sources import k4a_libraries
from mocapella.sources.azure_kinect import BROKEN_OF, AzureKinect, AzureKinectSettings
from mocapella.sources.device_checks import azure_kinect
from mocapella.sources.k4a_libraries import (
    CALIBRATION_BYTES,
    JOINT,
    MOUNTED,
    PROCESSING,
    find_libraries,
    load_libraries,
)

Open = Callable[..., AzureKinect]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("k4a"))


@pytest.fixture
def camera(built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Open:
    """A camera of the stand-in, which is told how to behave by its variables; its log is tmp_path/log."""
    monkeypatch.setenv("K4A_LOG", str(tmp_path / "log"))

    def make(
        which: str = "0", settings: AzureKinectSettings | None = None, clock: Any = None, **told: Any
    ) -> AzureKinect:
        for name, value in told.items():
            monkeypatch.setenv(f"K4A_{name.upper()}", str(value))
        clocks = {} if clock is None else {"clock": clock}
        return AzureKinect("left", which, settings, folders=[built], **clocks)

    return make


def frames_of(camera: AzureKinect, number: int) -> list[BodyFrame]:
    stop = threading.Event()
    frames = [camera.read(stop) for _ in range(number)]
    return [frame for frame in frames if frame is not None]


def test_frames_are_the_trackers_to_the_float_and_everything_is_released(camera: Open, tmp_path: Path) -> None:
    with camera() as source:
        frames = frames_of(source, 8)
        assert source.serial == "000000001000"
    assert [frame.sensor for frame in frames] == ["left"] * 8
    for frame in frames:
        check_frame(frame)
        assert (frame.depth_size_px, frame.tilt, frame.height) == ((640, 576), 0.0, 0.0)
    assert all(a.time_ns < b.time_ns for a, b in pairwise(frames))
    assert source.report.frames == 8
    source.close()  # again
    read_log(tmp_path / "log").check_released()


def test_an_empty_room_is_a_frame_without_bodies(camera: Open) -> None:
    with camera(bodies=0) as source:
        (frame,) = frames_of(source, 1)
    assert (frame.bodies, frame.positions.shape) == (0, (0, 32, 3))


def test_settings_reach_the_libraries(camera: Open, tmp_path: Path) -> None:
    how = AzureKinectSettings(15, "cpu", "upside-down", Path("/models/lite.onnx"))
    with camera(settings=how):
        pass
    lines = read_log(tmp_path / "log").lines
    assert ("start", 10 * 2 + 1) in lines  # narrow and unbinned, 15 Hz
    assert ("create", 100 * 3 + 10 * 1 + 0) in lines
    assert ("/models/lite.onnx", 0) in lines


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"fps": 25}, "fps is 25; it must be 5, 15 or 30"),
        ({"processing": "cude"}, "did you mean cud"),
        ({"mounted": "sideways"}, "one of upright, clockwise"),
    ],
)
def test_settings_that_cannot_be_are_named(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        AzureKinectSettings(**settings)


@pytest.mark.parametrize(
    ("fails", "words"),
    [
        ("k4a_device_open", "azure-kinect 0: cannot be opened; plug it in; no other program"),
        ("k4a_device_start_cameras", "its depth camera does not start; use another USB 3 port"),
        ("k4a_device_get_calibration", "its calibration cannot be read; plug it in again"),
        ("k4abt_tracker_create", "does not start with processing gpu; .*a GPU with a driver.*processing=cpu"),
    ],
)
def test_what_cannot_be_opened_is_named_and_the_rest_is_released(
    camera: Open, tmp_path: Path, fails: str, words: str
) -> None:
    with pytest.raises(InputError, match=words), camera(fail=fails):
        pass
    log = read_log(tmp_path / "log")
    log.check_released()
    assert "capture" not in log.words


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"fail": "k4a_device_get_capture:3"}, r"gives no images any more \(unplugged\?\); plug it in again"),
        ({"fail": "k4abt_tracker_pop_result:3"}, "its body tracker failed; start the node again"),
        ({"fail": "k4abt_tracker_enqueue_capture:3"}, "its body tracker refuses the images"),
        ({"step": 0}, "its images have no time of their own; for a Femto on Windows"),
        ({"late": "k4a_device_get_capture:3", "clock": count().__next__}, "gives no images any more"),
    ],
)
def test_what_fails_while_it_runs_ends_it_and_everything_is_released(
    camera: Open, tmp_path: Path, told: dict[str, Any], words: str
) -> None:
    with camera(**told) as source, pytest.raises(InputError, match=words):
        frames_of(source, 1000)
    read_log(tmp_path / "log").check_released()


def test_images_that_the_tracker_refuses_are_counted(camera: Open) -> None:
    with camera(fail=f"k4abt_tracker_enqueue_capture:3:{BROKEN_OF - 1}") as source:
        frames = frames_of(source, 5)
    assert [number_of(frame) for frame in frames[:3]] == [0, 1, BROKEN_OF + 1]
    assert source.report.refused == BROKEN_OF - 1


@pytest.mark.parametrize("fails", ["k4abt_frame_get_body_skeleton", "k4abt_frame_get_body_id"])
def test_a_body_that_cannot_be_read_is_skipped(camera: Open, tmp_path: Path, fails: str) -> None:
    with camera(fail=f"{fails}:2") as source:
        first, second = frames_of(source, 2)
    assert (first.tracking_ids.tolist(), second.bodies) == ([7], 0)
    assert source.report.bodies_skipped == 3
    read_log(tmp_path / "log").check_released()


def test_images_that_the_tracker_is_too_slow_for_are_dropped(camera: Open, tmp_path: Path) -> None:
    with camera() as source:
        wait_until("some are dropped", lambda: source.report.dropped >= 3)
        frames = frames_of(source, 5)
    assert [number_of(frame) for frame in frames[:3]] == [0, 1, 2]
    assert number_of(frames[3]) >= 6
    assert source.report.refused == 0
    read_log(tmp_path / "log").check_released()


def test_a_stop_ends_the_wait_for_bodies(camera: Open, tmp_path: Path) -> None:
    with camera(late="k4abt_tracker_enqueue_capture") as source:
        stop, got = threading.Event(), []
        waiting = threading.Thread(target=lambda: got.append(source.read(stop)))
        waiting.start()
        wait_until("it waits", lambda: source.report.dropped >= 3)
        stop.set()
        waiting.join(60)
    assert got == [None]
    read_log(tmp_path / "log").check_released()


def test_an_unexpected_error_releases_everything(camera: Open, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.sources.azure_kinect.camera_space", lambda positions_mm: 1 / 0)
    with camera() as source, pytest.raises(ZeroDivisionError):
        frames_of(source, 1)
    read_log(tmp_path / "log").check_released()


def test_time_rises_where_the_devices_clock_goes_back(camera: Open) -> None:
    with camera(jump="2:-1000000000", usec=2_000_000_000) as source:
        times = [frame.time_ns for frame in frames_of(source, 6)]
    assert source.report.clock_jumps == 1
    steps = [b - a for a, b in pairwise(times)]
    assert min(steps) > 0
    assert max(steps) < 100_000_000_000


def test_a_camera_is_found_by_its_number_or_serial_number(camera: Open, tmp_path: Path) -> None:
    for which, opened in (("1", [1]), ("000000001002", [0, 1, 2])):
        with camera(which, devices=3) as source:
            assert source.serial == f"{1000 + opened[-1]:012d}"
        log = read_log(tmp_path / "log")
        assert [number for what, number in log.lines if what == "open"] == opened
        assert [number for what, number in log.lines if what == "close"] == opened
        (tmp_path / "log").unlink()


@pytest.mark.parametrize(
    ("which", "told", "words"),
    [
        ("0", {"devices": 0}, "there is no camera; plug one in; Microsoft's libk4a sees only an Azure Kinect"),
        ("2", {"devices": 2}, "there is no such camera; 2 of them are here, from 0"),
        ("4711", {"devices": 2}, "no camera with this serial number; here: 000000001000, 000000001001; a number"),
        ("4711", {"fail": "k4a_device_open"}, "here: one that cannot be opened"),
        ("4711", {"fail": "k4a_device_get_serialnum"}, "here: one without a serial number"),
    ],
)
def test_a_camera_that_is_not_there_is_named(
    camera: Open, tmp_path: Path, which: str, told: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words), camera(which, **told):
        pass
    read_log(tmp_path / "log").check_released()


def put(built: Path, folder: Path, name: str, as_name: str = "") -> Path:
    return Path(shutil.copy(built / NAMES[name], folder / (as_name or NAMES[name])))


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is installed."""
    monkeypatch.setattr(k4a_libraries, "_usual_folders", lambda: iter(()))
    monkeypatch.delenv("MOCAPELLA_K4A", raising=False)


@pytest.mark.usefixtures("nowhere")
def test_missing_libraries_are_named_with_what_to_install(built: Path, tmp_path: Path) -> None:
    remedy = (
        "Sensor SDK 1.4 .*Orbbec's K4A wrapper.* and the Azure Kinect Body Tracking SDK 1.1, or let MOCAPELLA_K4A name"
    )
    with pytest.raises(
        SettingsError, match=f"libk4a and libk4abt are not installed: install the Azure Kinect {remedy}"
    ):
        load_libraries()
    put(built, tmp_path, "k4a")
    with pytest.raises(SettingsError, match=r"^libk4abt is not installed: install the Azure Kinect Body Tracking SDK"):
        load_libraries([tmp_path])
    [sensor, tracker] = azure_kinect()
    assert (sensor.verdict, sensor.found, tracker.verdict, tracker.found) == ("note", "not installed") * 2
    assert "only if you have one" in tracker.advice
    assert "MOCAPELLA_K4A" in tracker.advice


@pytest.mark.usefixtures("nowhere")
def test_the_doctor_names_version_and_path_without_loading(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOCAPELLA_K4A", f"/nowhere:{tmp_path}:{built}")
    put(built, tmp_path, "k4a", "libk4a.so.1.10.0")
    put(built, tmp_path, "k4a", "libk4a.so.1.4.0")
    (tmp_path / "libk4a.so").symlink_to("libk4a.so.1.4.0")
    (tmp_path / "libk4abt.so").write_text("no library")
    [sensor, tracker] = azure_kinect()
    assert (sensor.verdict, sensor.found) == ("ok", f"1.10.0 ({tmp_path / 'libk4a.so.1.10.0'})")
    assert (tracker.verdict, tracker.found) == ("ok", f"version unknown ({tmp_path / 'libk4abt.so'})")


def test_libraries_are_found_where_the_systems_loader_looks_too(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that is named for Mocapella comes before the loader's, and a caller's before both."""
    monkeypatch.delenv("MOCAPELLA_K4A", raising=False)
    monkeypatch.setenv("LD_LIBRARY_PATH", f"/nowhere:{built}")
    own, callers = tmp_path / "own", tmp_path / "callers"

    def found(*folders: Path) -> set[Path]:
        return {library.path.parent for library in find_libraries(folders).values() if library is not None}

    assert found() == {built.resolve()}
    for folder in (own, callers):
        folder.mkdir()
        for name in ("k4a", "k4abt"):
            put(built, folder, name)
    monkeypatch.setenv("MOCAPELLA_K4A", str(own))
    assert found() == {own.resolve()}
    assert found(callers) == {callers.resolve()}


def foreign(path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(18)
        file.write(b"\xb7\x00" if k4a_libraries.platform.machine() != "aarch64" else b"\x3e\x00")


@pytest.mark.usefixtures("nowhere")
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (foreign, r"libk4abt\.so\.1\.1\.2 is built for (aarch64|x86_64), and this Python runs on "),
        (
            lambda path: path.rename(path.with_name("libk4abt.so.1.0.1")),
            "is version 1.0.1; install the Azure Kinect Body",
        ),
        (lambda path: path.write_text("no library"), r"cannot be loaded \(.*\): install .* completely"),
        (lambda path: shutil.copy(path.with_name(NAMES["k4a"]), path), "has no k4abt_tracker_create: install"),
    ],
)
def test_a_library_that_cannot_be_used_is_named(
    built: Path, tmp_path: Path, spoil: Callable[[Path], object], words: str
) -> None:
    put(built, tmp_path, "k4a")
    spoil(put(built, tmp_path, "k4abt"))
    with pytest.raises(SettingsError, match=words):
        load_libraries([tmp_path])


@pytest.mark.usefixtures("nowhere")
def test_the_doctor_says_what_is_wrong_with_a_library(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOCAPELLA_K4A", str(tmp_path))
    foreign(put(built, tmp_path, "k4a"))
    (sensor, _) = azure_kinect()
    assert sensor.verdict == "note"
    assert sensor.advice.startswith("it is built for ")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    (sensor, _) = azure_kinect()
    assert sensor.advice == "it cannot be read (Permission denied); allow this user to read it"


def test_layouts_are_those_of_the_headers() -> None:
    assert JOINT.itemsize == 32
    assert k4a_libraries.ctypes.sizeof(k4a_libraries.DeviceConfiguration) == 36
    assert k4a_libraries.ctypes.sizeof(k4a_libraries.TrackerConfiguration) == 24
    assert CALIBRATION_BYTES >= 1032


def test_the_command_offers_the_choices_of_the_libraries() -> None:
    hints = get_type_hints(AzureKinectKeys, include_extras=True)
    assert hints["processing"].__metadata__[0].choices == tuple(PROCESSING)
    assert hints["mounted"].__metadata__[0].choices == tuple(MOUNTED)
