"""The camera's example ends with one line: without a camera and interrupted."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from support.programs import free_port, wait_until

from mocapella.sensing.colour_profile import save_profile
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "02_pi_camera.py"


def run(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Start the example, which Ctrl-C ends also where the tests run in a shell's background, which ignores it."""
    with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
        command = ["env", "--default-signal=INT", sys.executable, str(EXAMPLE), *words]
        return subprocess.Popen(command, stdout=out, stderr=err)


def profile(folder: Path) -> str:
    save_profile(folder / "left.json", pointed_at(load_hand_scene("demo", seed=3), "left"))
    return str(folder / "left.json")


def test_it_has_fewer_than_80_lines() -> None:
    assert len(EXAMPLE.read_text().splitlines()) < 80


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "says"), [("picamera:7", "needs the package picamera2"), ("camera:98", "camera:98: cannot be opened")]
)
def test_without_a_camera_it_ends_with_one_line(tmp_path: Path, source: str, says: str) -> None:
    process = run(tmp_path, source, profile(tmp_path), "127.0.0.1", str(free_port()))
    assert process.wait(300.0) == 1
    lines = [
        line for line in (tmp_path / "err").read_text().splitlines() if "VIDEOIO" not in line
    ]  # OpenCV's own warning
    assert len(lines) == 1
    assert says in lines[0]


@pytest.mark.slow
def test_a_camera_without_a_profile_of_its_colours_ends_with_one_line(tmp_path: Path) -> None:
    assert run(tmp_path, "picamera:0", "-", "127.0.0.1", str(free_port())).wait(300.0) == 1
    (line,) = (tmp_path / "err").read_text().splitlines()
    assert "picamera:0 needs a profile of its colours" in line


@pytest.mark.slow
def test_interrupted_it_ends_with_one_line_and_after_pictures_with_its_times(tmp_path: Path) -> None:
    port, start = free_port(), free_port()
    for begun in (False, True):
        process = run(tmp_path, "rendered:demo/left", "-", "127.0.0.1", str(port), "1000000", str(start))
        try:
            wait_until("it waits", lambda: "--size" in (tmp_path / "out").read_text(), timeout=300.0)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
                heard.bind(("127.0.0.1", port))
                heard.settimeout(0.2)

                def came(heard: socket.socket = heard) -> bool:
                    heard.sendto(b"start", ("127.0.0.1", start))
                    try:
                        return heard.recv(999).startswith(b"#")
                    except TimeoutError:
                        return False

                if begun:
                    wait_until("a picture", came, timeout=300.0)
            process.send_signal(signal.SIGINT)
            assert process.wait(60.0) == (0 if begun else 1)
        finally:
            process.kill()
            process.wait()
        assert ("milliseconds over" in (tmp_path / "out").read_text()) is begun
        assert (tmp_path / "err").read_text() == ("" if begun else "interrupted before the first picture\n")
