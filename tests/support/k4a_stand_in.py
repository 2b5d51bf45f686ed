"""The stand-in for the libraries of an Azure Kinect, `k4a_stand_in.c`: built, and what its bodies are."""

from __future__ import annotations

import atexit
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from mocapella.model.observations import BodyFrame
from mocapella.sources.k4a_libraries import load_camera_library

SOURCE = Path(__file__).with_suffix(".c")
FAILED = 1
FIRST_USEC = STEP_USEC = 33333
FLAGS = ("-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-pthread")
NAMES = {"k4a": "libk4a.so.1.4.1", "k4abt": "libk4abt.so.1.1.2"}


def build(folder: Path) -> Path:
    """Build both libraries into a folder, and return it; skip the test without Linux and a C compiler."""
    if sys.platform != "linux" or shutil.which("cc") is None:
        pytest.skip("needs Linux and cc (Debian: build-essential)")
    for name, defined in (("k4a", ()), ("k4abt", ("-DK4ABT",))):
        command = ["cc", *FLAGS, *defined, str(SOURCE), "-o", str(folder / NAMES[name])]
        subprocess.run(command, check=True, timeout=120)
    return folder


class Pluggable:
    """The stand-in's library ``k4a`` with the plug of a fake camera: without it there is no device, and no image.

    Args:
        camera: has ``plugged``, and counts in ``started`` and ``stopped``.
        library: the loaded library.
    """

    def __init__(self, camera: Any, library: Any) -> None:
        self._camera, self._library = camera, library

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, name)

    def k4a_device_get_installed_count(self) -> int:
        return int(self._library.k4a_device_get_installed_count()) if self._camera.plugged else 0

    def k4a_device_get_capture(self, *arguments: Any) -> int:
        return int(self._library.k4a_device_get_capture(*arguments)) if self._camera.plugged else FAILED

    def k4a_device_start_cameras(self, *arguments: Any) -> int:
        self._camera.started += 1
        return int(self._library.k4a_device_start_cameras(*arguments))

    def k4a_device_stop_cameras(self, device: Any) -> None:
        self._camera.stopped += 1
        self._library.k4a_device_stop_cameras(device)


@cache
def built_once() -> Path:
    """The folder of both libraries, built once a process; skips the test as `build` does."""
    folder = Path(tempfile.mkdtemp(prefix="k4a-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return build(folder)


def k4a(camera: Any) -> Pluggable:
    """The library ``k4a`` for a fake camera."""
    return Pluggable(camera, load_camera_library([built_once()]))


class Log(NamedTuple):
    """What a stand-in wrote: (what, number) for each call that opens, starts, stops, closes or releases something."""

    lines: list[tuple[str, int]]

    @property
    def words(self) -> list[str]:
        return [what for what, _ in self.lines]

    def check_released(self) -> None:
        """Each handle was released once, and all before their camera was closed; the tracker before its camera."""
        counts = Counter(self.words)
        for opened, closed in (
            *(("open", "close"), ("start", "stop"), ("create", "destroy"), ("create", "shutdown")),
            *(("capture", "release"), ("frame", "frame-release"), ("image", "image-release")),
        ):
            assert counts[opened] == counts[closed], (opened, closed, counts)
        order = [what for what in self.words if what in {"shutdown", "destroy", "stop", "close"}]
        if "create" in counts:
            assert order == ["shutdown", "destroy", "stop", "close"]
            assert self.words[-4:] == order
        elif "start" in counts:
            assert order == ["stop", "close"]


def read_log(path: Path) -> Log:
    lines = path.read_text().splitlines() if path.exists() else []
    return Log([(what, int(number)) for what, number in (line.rsplit(" ", 1) for line in lines)])


def number_of(frame: BodyFrame) -> int:
    """The image of a frame, by its time."""
    usec, rest = divmod(frame.time_ns, 1000)
    number, left = divmod(usec - FIRST_USEC, STEP_USEC)
    assert (rest, left) == (0, 0)
    return number


def check_frame(frame: BodyFrame) -> None:
    """The bodies are those that the stand-in makes of that image, in camera space, to the float."""
    number = np.float64(number_of(frame))
    joint = np.arange(32.0)
    assert frame.topology.name == "azure_kinect"
    assert frame.tracking_ids.tolist() == [7, 8]
    assert frame.tracked.all()
    for body in range(2):
        x_mm, z_mm = np.full(32, -300.25 + 600.5 * body + 3.125 * number), 2000 + 1.75 * number + joint
        wanted = np.stack([-1e-3 * x_mm, -1e-3 * (40.5 * joint - 800), 1e-3 * z_mm], axis=1).astype(np.float32)
        states = np.array([0, 1, 2, 2])[(np.arange(32) + body) % 4]
        states[29:] = 0  # no level of confidence, or no number
        wanted[states == 0] = np.nan
        np.testing.assert_array_equal(frame.states[body], states)
        np.testing.assert_array_equal(frame.positions[body], wanted)
