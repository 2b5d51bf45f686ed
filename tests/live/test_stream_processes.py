"""`mocapella stream` as users run it: a session, a stream, and a receiver at a real socket."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from support.programs import Program, free_port, run, run_here, wait_until

from mocapella.sources.osc import messages

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "09_receive_osc.py"

pytestmark = pytest.mark.slow


def heard(folder: Path, bus: int, stream: str, *options: str) -> tuple[dict[str, list[tuple[object, ...]]], Program]:
    """All that a stream sends in three seconds, by address, and its ended program."""
    found: dict[str, list[tuple[object, ...]]] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(1.0)
        to = f"127.0.0.1:{receiver.getsockname()[1]}"
        address = f"tcp/127.0.0.1:{bus}"
        options = ("--connect", address, "--seconds", "3", "--json", f"{stream}.json", *options)
        with Program(folder, stream, "stream", stream, "--to", to, *options) as program:
            while program.process.poll() is None:
                try:
                    datagram = receiver.recv(65_507)
                except TimeoutError:
                    continue
                for one in messages(datagram):
                    found.setdefault(one.address, []).append(one.arguments)
    return found, program


def test_people_who_move_are_sent_and_the_documented_receiver_prints_them(tmp_path: Path) -> None:
    bus, osc = free_port(), free_port()
    scene = ("--port", str(bus), "--scene", "stand")
    with Program(tmp_path, "demo", "demo", "--no-view", *scene) as demo:
        wait_until("people are tracked", demo.said("tracking"), timeout=300.0)
        found, _ = heard(tmp_path, bus, "osc")
        people = found["/mocapella/people"][-1]
        assert people
        head = found[f"/mocapella/people/{people[0]}/Head"][-1]
        assert len(head) == 5
        assert head[3] in (1, 2)
        told = json.loads((tmp_path / "osc.json").read_text())
        assert told["most_people"] >= 1
        assert told["scenes"] == len(found["/mocapella/people"])
        found, _ = heard(tmp_path, bus, "vmc")
        assert {"Hips", "LeftUpperArm", "RightLowerLeg"} <= {arguments[0] for arguments in found["/VMC/Ext/Bone/Pos"]}
        assert found["/VMC/Ext/OK"][-1] == (1, 3, 0, 1)

        receiver = subprocess.Popen(
            [sys.executable, str(EXAMPLE), str(osc)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        to = ("--to", f"127.0.0.1:{osc}", "--connect", f"tcp/127.0.0.1:{bus}")
        sent = run(tmp_path, "stream", "osc", *to, "--seconds", "4")
        receiver.send_signal(signal.SIGINT)
        printed, _ = receiver.communicate(timeout=30)
        assert sent.returncode == 0
        assert "/Head" in printed
        assert "measured" in printed
        assert "Traceback" not in printed
        assert demo.end() == 0


def test_the_page_shows_the_receiver() -> None:
    page = (ROOT / "docs" / "streams.md").read_text(encoding="utf-8")
    loop = page.split("```python\n")[1].split("```")[0]
    assert EXAMPLE.read_text(encoding="utf-8").endswith(loop)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--to", "9000"), "expected HOST:PORT, such as 127.0.0.1:9000"),
        (("--people", ","), "--people has no name; write names with commas, such as person_0,anna"),
        (("--connect", f"tcp/127.0.0.1:{free_port()}"), "start a server there (mocapella serve)"),
    ],
)
def test_what_cannot_be_sent_is_told_in_one_line(tmp_path: Path, options: tuple[str, str], message: str) -> None:
    done = run_here(tmp_path, "stream", "osc", *options)
    assert done.returncode == 1
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
