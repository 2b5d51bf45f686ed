"""Bodies of an Azure Kinect or Orbbec Femto, live, by the vendor's libraries.

A thread of its own takes images from the camera and hands them to the body tracker, whose queue holds three; `read`
takes the bodies out. So the tracker is never without work, and images that it is too slow for are dropped at once.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import ExitStack
from ctypes import byref, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mocapella.errors import InputError, one_of
from mocapella.model.azure_kinect import AZURE_KINECT, STATES, camera_space
from mocapella.model.limits import COORDINATE
from mocapella.model.observations import BodyFrame, JointState, body_frame
from mocapella.settings import check
from mocapella.sources.k4a_devices import open_device
from mocapella.sources.k4a_libraries import (
    CALIBRATION_BYTES,
    DEPTH_MODE,
    DEPTH_SIZE_PX,
    FPS,
    JOINT,
    MOUNTED,
    NO_BODY,
    OK,
    PROCESSING,
    TIMEOUT,
    DeviceConfiguration,
    TrackerConfiguration,
    load_libraries,
)

WAIT_MS: Final = 100
"""Longest wait in a library at a time, so that a stop is noticed [ms]."""
LOST_S: Final = 5.0
"""Time without an image after which the camera is lost: not every driver reports that it was unplugged [s]."""
BROKEN_OF: Final = 30
"""Number of images in a row that have no new time, or that the tracker refuses, until the run ends with an error.

The tracker refuses an image without depth.
"""
_START: Final = "use another USB 3 port and its power supply; on Linux it needs a display (OpenGL)"
_TIMES: Final = "for a Femto on Windows, run Orbbec's script obsensor_metadata_win10.ps1 (docs/sensors.md)"
_AGAIN: Final = "plug it in again, with its power supply, and start the node again"


@dataclass(frozen=True)
class AzureKinectSettings:
    """How the camera and the body tracker run.

    Attributes:
        fps: frame rate: 5, 15 or 30 [Hz].
        processing: execution of the body tracker's network: ``gpu``, ``cpu``, ``cuda``, ``tensorrt`` or ``directml``.
        mounted: how the sensor is turned, seen from in front of it: ``upright``, ``clockwise``, ``counterclockwise`` or
            ``upside-down``. It helps the tracker; positions stay in the camera's space.
        model: file of the tracker's network; the library's own if None.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    fps: int = 30
    processing: str = "gpu"
    mounted: str = "upright"
    model: Path | None = None

    def __post_init__(self) -> None:
        check(self.fps in FPS, "fps", self.fps, "5, 15 or 30")
        for name, choices in (("processing", PROCESSING), ("mounted", MOUNTED)):
            value = getattr(self, name)
            check(value in choices, name, value, f"one of {one_of(value, choices)}")


@dataclass
class AzureKinectReport:
    """Counts of a run.

    Attributes:
        frames: number of frames of bodies.
        dropped: number of images that were dropped because the tracker's queue was full.
        refused: number of images that the tracker refused.
        bodies_skipped: number of bodies whose skeleton could not be read.
        repeated: number of frames that were dropped because they repeat the time of the frame before.
        clock_jumps: number of times that the device's clock went back.
    """

    frames: int = 0
    dropped: int = 0
    refused: int = 0
    bodies_skipped: int = 0
    repeated: int = 0
    clock_jumps: int = 0


class AzureKinect:
    """One camera and its body tracker. A context manager: entering opens both, leaving closes them, in order.

    Frames have the device's own time, which the server converts as that of every body sensor. Their tilt and height are
    unknown.

    Args:
        sensor: name of the sensor, for the frames.
        which: number of the camera, from 0, in one or two digits; or its serial number.
        settings: how it runs.
        folders: folders to search first for the libraries.
        clock: the monotonic clock, in seconds.

    Attributes:
        name: name in errors.
        serial: serial number, once it is open.
        report: counts so far.

    Raises:
        SettingsError: a library is missing or cannot be used; states the remedy.
    """

    def __init__(
        self,
        sensor: str,
        which: str = "0",
        settings: AzureKinectSettings | None = None,
        *,
        folders: Iterable[Path] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name, self.serial, self.report = f"azure-kinect {which}", "", AzureKinectReport()
        self._sensor, self._which, self._settings, self._clock = sensor, which, settings or AzureKinectSettings(), clock
        self._k4a, self._k4abt = load_libraries(folders)
        self._stop = threading.Event()
        self._failure: InputError | None = None
        self._device, self._tracker = c_void_p(), c_void_p()
        self._open = ExitStack()
        self._last_usec, self._last_ns, self._shift_ns, self._last_s = -1, -1, 0, 0.0

    def __enter__(self) -> AzureKinect:
        """Open the camera and load the tracker, which can take a minute. Signals are handled meanwhile.

        Raises:
            InputError: there is no such camera, it cannot be opened or started, or the tracker cannot be started.
        """
        opened: Future[ExitStack] = Future()

        def work() -> None:
            try:
                opened.set_result(self._opened())
            except Exception as error:  # noqa: BLE001 - raised again below, in the thread that waits
                opened.set_exception(error)

        # The vendor's code would keep the main thread from handling Ctrl-C.
        thread = threading.Thread(target=work, name="opening", daemon=True)
        thread.start()
        while thread.is_alive():  # on Windows, a wait without a limit would, too
            thread.join(WAIT_MS / 1000)
        self._open = opened.result()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the tracker and the camera, if they are open. May be called twice."""
        self._open.close()

    def read(self, stop: threading.Event) -> BodyFrame | None:
        """Wait for the next frame of bodies, which may have none; None if ``stop`` is set.

        Raises:
            InputError: the camera was unplugged, its images have no time, or the tracker failed.
        """
        repeated = 0
        while not stop.is_set():
            handle = c_void_p()
            result = self._k4abt.k4abt_tracker_pop_result(self._tracker, byref(handle), WAIT_MS)
            if result == OK:
                try:
                    frame = self._frame(handle)
                finally:
                    self._k4abt.k4abt_frame_release(handle)
                if frame is not None:
                    self.report.frames += 1
                    return frame
                repeated += 1
                if repeated >= BROKEN_OF:
                    raise InputError("its images have no time of their own", file=self.name, fix=_TIMES)
            elif self._failure is not None:
                raise self._failure
            elif result != TIMEOUT:
                raise InputError("its body tracker failed", file=self.name, fix="start the node again")
        return None

    def _opened(self) -> ExitStack:
        """Open everything; return what closes it, in reverse order. After an error, nothing is open."""
        s, k4a, k4abt = self._settings, self._k4a, self._k4abt
        with ExitStack() as opened:
            self._device, self.serial = open_device(k4a, self._which, self.name, opened)
            device = self._device
            camera = DeviceConfiguration(depth_mode=DEPTH_MODE, camera_fps=FPS[s.fps])
            started = k4a.k4a_device_start_cameras(device, byref(camera))
            self._need(started, "its depth camera does not start", _START)
            opened.callback(k4a.k4a_device_stop_cameras, device)
            calibration = ctypes.create_string_buffer(CALIBRATION_BYTES)
            known = k4a.k4a_device_get_calibration(device, DEPTH_MODE, 0, calibration)
            self._need(known, "its calibration cannot be read", _AGAIN)
            model = None if s.model is None else str(s.model).encode()
            tracker = TrackerConfiguration(MOUNTED[s.mounted], PROCESSING[s.processing], 0, model)
            made = k4abt.k4abt_tracker_create(calibration, tracker, byref(self._tracker))
            self._need(
                made, f"the body tracker does not start with processing {s.processing}",
                "the Body Tracking SDK prints the reason; it needs its model file and a GPU with a driver that it "
                "supports, or --set processing=cpu",
            )  # fmt: skip
            opened.callback(k4abt.k4abt_tracker_destroy, self._tracker)
            opened.callback(k4abt.k4abt_tracker_shutdown, self._tracker)
            feeder = threading.Thread(target=self._feed, name="camera")
            opened.callback(feeder.join)
            opened.callback(self._stop.set)
            feeder.start()
            return opened.pop_all()

    def _need(self, result: int, problem: str, fix: str) -> None:
        if result != OK:
            raise InputError(problem, file=self.name, fix=fix)

    def _feed(self) -> None:
        """Hand images to the tracker until the end; keep the error that ends it for `read`."""
        last_s, in_a_row = self._clock(), 0
        while not self._stop.is_set() and self._failure is None:
            handle = c_void_p()
            result = self._k4a.k4a_device_get_capture(self._device, byref(handle), WAIT_MS)
            if result == OK:
                taken = self._k4abt.k4abt_tracker_enqueue_capture(self._tracker, handle, 0)
                self._k4a.k4a_capture_release(handle)
                last_s, in_a_row = self._clock(), 0 if taken in (OK, TIMEOUT) else in_a_row + 1
                self.report.dropped += taken == TIMEOUT
                self.report.refused += in_a_row > 0
                if in_a_row >= BROKEN_OF:
                    fix = "start the node again"
                    self._failure = InputError("its body tracker refuses the images", file=self.name, fix=fix)
            elif result != TIMEOUT or self._clock() - last_s > LOST_S:
                self._failure = InputError("gives no images any more (unplugged?)", file=self.name, fix=_AGAIN)

    def _frame(self, handle: c_void_p) -> BodyFrame | None:
        """Return the tracker's frame; None if it repeats the last one's time."""
        k4abt = self._k4abt
        time_ns = self._time_ns(k4abt.k4abt_frame_get_device_timestamp_usec(handle))
        if time_ns is None:
            self.report.repeated += 1
            return None
        count = k4abt.k4abt_frame_get_num_bodies(handle)
        joints, ids = np.zeros((count, len(AZURE_KINECT)), JOINT), np.zeros(count, np.uint64)
        for k in range(count):
            ids[k] = k4abt.k4abt_frame_get_body_id(handle, k)
            if k4abt.k4abt_frame_get_body_skeleton(handle, k, joints[k : k + 1].ctypes.data) != OK:
                ids[k] = NO_BODY
        known = ids != NO_BODY
        self.report.bodies_skipped += count - int(known.sum())
        joints, ids = joints[known], ids[known]
        positions, levels = camera_space(joints["position"]), joints["confidence"]
        states = STATES[np.clip(levels, 0, len(STATES) - 1)]
        usable = (np.abs(positions) <= COORDINATE.high).all(axis=2) & (levels < len(STATES))
        states[~usable] = JointState.NOT_TRACKED
        return body_frame(
            self._sensor, AZURE_KINECT, time_ns=time_ns, positions=positions, states=states, tracking_ids=ids,
            tracked=(states > 0).any(axis=1), depth_size_px=DEPTH_SIZE_PX,
        )  # fmt: skip

    def _time_ns(self, usec: int) -> int | None:
        """Return the device's time as a time that rises from frame to frame [ns]; None if it is the last frame's.

        Where the device's clock goes back, the time goes on by the time that has passed here.
        """
        now_s, last_s = self._clock(), self._last_s
        if usec == self._last_usec:
            return None
        if usec * 1000 + self._shift_ns <= self._last_ns:
            self.report.clock_jumps += 1
            self._shift_ns = self._last_ns + max(1, round((now_s - last_s) * 1e9)) - usec * 1000
        self._last_usec, self._last_s, self._last_ns = usec, now_s, usec * 1000 + self._shift_ns
        return self._last_ns
