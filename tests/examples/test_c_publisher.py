"""The sensor program in C: builds without a warning, writes the test vector, and is heard through the bridge."""

from __future__ import annotations

import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

from mocapella.model.observations import BodyFrame
from mocapella.sources.bridge import Bridge, BridgeSettings

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 12


@pytest.fixture(scope="module")
def publisher(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program, built by its own Makefile, beside a copy of its source."""
    for tool in ("cc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool} (Debian: build-essential)")
    folder = tmp_path_factory.mktemp("c") / "publisher"
    shutil.copytree(ROOT / "examples" / "c_publisher", folder, ignore=shutil.ignore_patterns("publisher"))
    flags = "CFLAGS=-O2 -Wall -Wextra -Wconversion -Werror"
    subprocess.run(["make", "-C", str(folder), flags], check=True, timeout=120, capture_output=True)
    return folder / "publisher"


def test_it_writes_the_test_vector_byte_for_byte(publisher: Path) -> None:
    written = subprocess.run([publisher, "--vector"], check=True, timeout=30, capture_output=True).stdout
    assert written == (ROOT / "tests" / "vectors" / "frame_skeleton.bin").read_bytes()


def test_it_is_heard_through_the_bridge(publisher: Path) -> None:
    heard: list[BodyFrame] = []
    gone = threading.Event()
    settings = BridgeSettings(port=0)
    with Bridge(lambda _sensor, frame, _data: heard.append(frame), settings, lambda _sensor: gone.set()) as bridge:
        command = [publisher, "kitchen", str(bridge.address[1]), str(FRAMES)]
        subprocess.run(command, check=True, timeout=60)
        assert gone.wait(20), bridge.report
    assert [frame.sequence for frame in heard] == list(range(FRAMES))
    assert {frame.sensor for frame in heard} == {"kitchen"}
    assert len({frame.node_id for frame in heard}) == 1
    assert {b - a for a, b in zip([f.time_ns for f in heard], [f.time_ns for f in heard][1:], strict=False)} == {
        33333333
    }
    hand = np.array([frame.positions[0, frame.topology.parts["hand_right"]] for frame in heard])
    assert np.ptp(hand[:, 0]) > 0.05  # it waves


def test_it_prints_why_it_is_refused(publisher: Path) -> None:
    with Bridge(lambda *_: None, BridgeSettings(port=0)) as bridge:
        command = [publisher, "no/name", str(bridge.address[1]), "600"]
        done = subprocess.run(command, check=False, timeout=60, capture_output=True, text=True)
    assert done.returncode == 1
    assert "the bridge says: sensor name 'no/name' cannot be used" in done.stderr


def test_it_says_how_it_is_called(publisher: Path) -> None:
    done = subprocess.run([publisher], check=False, timeout=30, capture_output=True, text=True)
    assert done.returncode == 2
    assert "--vector | SENSOR [PORT [FRAMES]]" in done.stderr


def test_it_says_when_there_is_no_bridge(publisher: Path) -> None:
    done = subprocess.run([publisher, "front", "1", "1"], check=False, timeout=30, capture_output=True, text=True)
    assert done.returncode == 1
    assert "no bridge at 127.0.0.1:1" in done.stderr
