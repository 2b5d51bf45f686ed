"""The stand-in for the libraries of an Azure Kinect, `k4a_stand_in.c`: built, and what its bodies are."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mocapella.model.observations import BodyFrame

SOURCE = Path(__file__).with_suffix(".c")
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
            *(("capture", "release"), ("frame", "frame-release")),
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
