"""``mocapella status``: what it says of a server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from support.programs import free_port, result_here, run_here

from mocapella.cli.status import lines
from mocapella.model.session import (
    CommandReply,
    Descriptors,
    PersonCondition,
    RecordingHealth,
    ServerHealth,
    SessionStatus,
)
from mocapella.testing import FakeServer, sensor_health, session_status

HEALTH = ServerHealth(
    errors={"frame: ValueError in a.py:1": 2}, turned_away={"commands": 3}, latency_ms={"p50": 1.25, "p99": 9.0},
    disk_free_bytes=5_000_000_000, reserve_bytes=1 << 30, ended=("view",), log="/logs/serve.jsonl",
    descriptors=Descriptors(95, 100),
)  # fmt: skip
STATUS = session_status(
    sensors=(sensor_health("front", dropped=4, behind=1, calibration="9 mm"), sensor_health("left", problem="gone")),
    people_conditions=(PersonCondition(2, "left knee: sensors and body model disagree by 50°"),),
    recording=RecordingHealth(True, "takes/a.mcap", frames=7, lost=1), health=HEALTH,
)  # fmt: skip


def serving(status: SessionStatus | None) -> FakeServer:
    def obey(verb: str, arguments: dict[str, Any]) -> CommandReply:
        assert verb == "status"
        return CommandReply(True, "", status)

    return FakeServer(obey=obey)


def test_all_that_matters_is_said_and_problems_come_last(tmp_path: Path) -> None:
    with serving(STATUS) as server:
        done = run_here(tmp_path, "status", "--connect", server.address)
    assert done.returncode == 0
    assert done.stderr.splitlines() == [
        "tracking",
        "90 results/s, 2 people; up for 60 s, " + STATUS.version,
        "front: good; 30 Hz, 900 frames, 4 dropped (1 because tracking was too slow), 0 rejected, latency 2.1 ms, "
        "clock +12.30 ± 0.40 ms, 9 mm",
        "left: gone; 30 Hz, 900 frames, 0 dropped, 0 rejected, latency 2.1 ms, clock +12.30 ± 0.40 ms",
        "person 2: left knee: sensors and body model disagree by 50°",
        "latency: p50 1.2 ms, p99 9.0 ms",
        "recording: takes/a.mcap, 7 frames, 1 lost",
        "disk: 5.0 GB left",
        "file descriptors: 95 of 100",
        "log: /logs/serve.jsonl",
        "ERROR: 2 × frame: ValueError in a.py:1",
        "PROBLEM: the view has ended",
        "PROBLEM: 2 unexpected errors; the first: frame: ValueError in a.py:1",
        "PROBLEM: 95 of 100 file descriptors are in use; new sensors are refused",
        "PROBLEM: turned away: 3 commands",
    ]


def test_one_of_a_kind_is_named_in_the_singular() -> None:
    counts = {"people": 1, "arms": 0, "of a plug-in": 1}
    front = sensor_health("front", frames=1)
    said = list(lines(session_status(counts=counts, sensors=(front,), recording=RecordingHealth(path="a", frames=1))))
    assert "results/s, 1 person, 0 arms, 1 of a plug-in; up for" in said[1]
    assert "front: good; 30 Hz, 1 frame, 0 dropped" in said[2]
    assert "last take: a, 1 frame, 0 lost" in said


def test_programs_get_it_as_json(tmp_path: Path) -> None:
    with serving(STATUS) as server:
        row = result_here(tmp_path, "status", "--connect", server.address)
    assert row["health"]["errors"] == HEALTH.errors
    assert [(one["person"], one["condition"][:9]) for one in row["people_conditions"]] == [(2, "left knee")]
    assert row["health"]["disk_free_bytes"] == 5_000_000_000
    assert [(sensor["name"], sensor["behind"]) for sensor in row["sensors"]] == [("front", 1), ("left", 0)]
    assert row["health"]["descriptors"] == {"used": 95, "limit": 100}
    assert row["recording"]["lost"] == 1


def test_no_server_and_no_status_are_errors(tmp_path: Path) -> None:
    nobody = run_here(tmp_path, "status", "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert (nobody.returncode, "mocapella serve" in nobody.stderr) == (1, True)
    with serving(None) as server:
        old = run_here(tmp_path, "status", "--connect", server.address)
    assert (old.returncode, "gave no status" in old.stderr) == (1, True)


def test_what_another_program_says_reaches_no_terminal_raw(tmp_path: Path) -> None:
    def obey(verb: str, arguments: dict[str, Any]) -> CommandReply:
        return CommandReply(False, "\x1b]0;owned\x07\u202eno")

    with FakeServer(obey=obey) as server:
        done = run_here(tmp_path, "record", "walk", "--connect", server.address)
    assert done.returncode == 1
    assert done.stderr == "mocapella: \\x1b]0;owned\\x07\\u202eno\n"
