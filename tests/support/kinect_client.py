"""The Kinect v2 client, built against the stand-in for the SDK and run by mono; and what the stand-in has played."""

from __future__ import annotations

import json
import os
import pty
import shutil
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pytest

from mocapella.model.observations import BodyFrame

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "clients" / "kinect_v2"
STUB = ROOT / "tests" / "support" / "kinect_stub"


@dataclass(frozen=True)
class Built:
    """The programs.

    Attributes:
        client: the client.
        vectors: a program that writes test vectors with the client's encoder.
    """

    client: Path
    vectors: Path


def build(folder: Path) -> Built:
    """Build the client with its own Makefile, its warnings as errors; skip the test where that is impossible."""
    for tool in ("mcs", "mono", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool} (Debian: mono-mcs, mono-runtime, make)")
    library = folder / "Microsoft.Kinect.dll"
    compiler = ["mcs", "-langversion:5", "-warnaserror"]
    vectors = folder / "vectors.exe"
    for command in (
        [*compiler, "-target:library", f"-out:{library}", str(STUB / "Microsoft.Kinect.cs")],
        ["make", "-C", str(SOURCE), f"KINECT={library}", f"OUT={folder}"],
        [*compiler, f"-out:{vectors}", str(SOURCE / "BodyMessage.cs"), str(STUB / "Vectors.cs")],
    ):
        done = subprocess.run(command, check=False, timeout=300, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    return Built(folder / "kinect_v2.exe", vectors)


class Client:
    """The client in a process of its own; its output goes to a file.

    Args:
        built: the programs.
        folder: folder for the output, the spool and the log of the stand-in.
        arguments: after the name of the sensor.
        sensor: name of the sensor.
        name: name of the output's file.
        played: settings of the stand-in, without ``KINECT_STUB_``.
    """

    def __init__(
        self, built: Built, folder: Path, *arguments: str, sensor: str = "front", name: str = "client", **played: int
    ) -> None:
        self.log, self.stub_log, self.spool = folder / f"{name}.log", folder / f"{name}.stub", folder / "kinect-spool"
        environment = {**os.environ, "KINECT_STUB_LOG": str(self.stub_log), "TERM": "xterm"}
        environment |= {f"KINECT_STUB_{key.upper()}": str(value) for key, value in played.items()}
        command = ["mono", str(built.client), sensor, "--spool", str(self.spool), "--reserve-mib", "0", *arguments]
        self._terminal, slave = pty.openpty()  # mono hears Ctrl-C only at a terminal
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                command, cwd=folder, env=environment, stdin=slave, stdout=slave, stderr=log, start_new_session=True
            )
        os.close(slave)

    @property
    def output(self) -> str:
        return self.log.read_text(encoding="utf-8")

    @property
    def played(self) -> int:
        """Number of frames that the stand-in has played."""
        return self.stub_log.read_bytes().count(b"\n") if self.stub_log.exists() else 0

    def end(self, how: signal.Signals = signal.SIGINT, timeout: float = 120.0) -> int:
        """Send the signal and return the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        return self.process.wait(timeout)

    def kill(self) -> None:
        """Kill it, without a chance to do anything."""
        self.process.kill()
        self.process.wait()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()
        os.close(self._terminal)


def frames_played(path: Path) -> list[dict[str, Any]]:
    """Return what the stand-in has played; a last line that a kill has torn is left out."""
    lines = path.read_text(encoding="ascii").splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def floats(bits: list[int]) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return the float32 of their bits."""
    return np.array(bits, np.int32).view(np.float32)


def check_frame(frame: BodyFrame, played: dict[str, Any]) -> None:
    """Check every field of a frame against what the stand-in had, except id, number and time of sending."""
    assert frame.topology.name == "kinect_v2"
    assert frame.time_ns == played["ticks"] * 100
    assert frame.depth_size_px == (512, 424)
    x, y, z, w = floats(played["floor"]).astype(float)
    length = np.sqrt(x * x + y * y + z * z)
    known = length > 0
    assert frame.tilt == pytest.approx(np.arctan2(z, np.hypot(x, y)) if known else 0.0, abs=1e-6)
    assert frame.height == pytest.approx(w / length if known else 0.0, abs=1e-6)
    bodies = [body for body in played["bodies"] if body["tracked"]]
    assert frame.tracking_ids.tolist() == [body["id"] for body in bodies]
    assert frame.tracked.all()
    assert frame.clipped_edges.tolist() == [body["edges"] for body in bodies]
    assert frame.depth_px is not None or not bodies
    assert frame.orientations is not None or not bodies
    for b, body in enumerate(bodies):
        values = np.stack([floats(bits) for _, bits in body["joints"]])
        states = np.array([state for state, _ in body["joints"]])
        states[~np.isfinite(values[:, :3]).all(axis=1)] = 0
        np.testing.assert_array_equal(frame.states[b], states)
        gone = (states == 0)[:, None]
        np.testing.assert_array_equal(frame.positions[b], np.where(gone, np.nan, values[:, :3]))
        pixels, turns = values[:, 3:5], values[:, 5:]
        assert frame.depth_px is not None
        assert frame.orientations is not None
        np.testing.assert_array_equal(
            frame.depth_px[b], np.where(gone | np.isinf(pixels).any(axis=1, keepdims=True), np.nan, pixels)
        )
        np.testing.assert_array_equal(
            frame.orientations[b], np.where(gone | ~turns.any(axis=1, keepdims=True), np.nan, turns)
        )
