"""``mocapella take``: what is said of whole, interrupted and incomplete takes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.programs import free_port, result_here, run_here, wait_until
from support.take_making import SECOND, STEP, frame, frame_bytes, info, record, scene_bytes, small_take, unclosed_take

from mocapella.errors import RecordingError
from mocapella.live.node_disk import NodeDisk, open_link
from mocapella.live.server import Server, ServerSettings
from mocapella.model.session import Setup
from mocapella.recording import take
from mocapella.recording.spool import DiskSpool, SpoolLimits
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.testing import session_status


def test_a_whole_take_is_whole(tmp_path: Path) -> None:
    small_take(tmp_path / "a.mcap")
    row = result_here(tmp_path, "take", "check", "a")
    assert (row["whole"], row["frames"], row["lost"], row["interruptions"]) == (True, 24, 0, 0)
    assert result_here(tmp_path, "take", "info", "a") == row | {"conditions": []}


def test_a_take_says_when_a_sensor_had_been_moved(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    for second, reason in enumerate(("", "left: it was moved", "left: it was moved", "")):
        writer.write_status(session_status(reason=reason), second * SECOND)
    writer.close()
    done = run_here(tmp_path, "take", "info", "a", "--json", "-")
    assert "left: from 1 to 3 s: it was moved" in done.stderr
    (one,) = json.loads(done.stdout)["conditions"]
    assert one == {"sensor": "left", "condition": "it was moved", "from_s": 1.0, "to_s": 3.0}


def test_an_interrupted_take_is_not_whole_until_it_is_recovered(tmp_path: Path) -> None:
    unclosed_take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "take", "check", "a", "--json", "-")
    assert done.returncode == 1
    assert not json.loads(done.stdout)["whole"]
    assert "ends early" in done.stderr
    told = run_here(tmp_path, "take", "info", "a", "--json", "-")
    assert told.returncode == 3
    assert not json.loads(told.stdout)["whole"]
    assert result_here(tmp_path, "take", "recover", "a")["whole"]
    assert run_here(tmp_path, "take", "check", "a").returncode == 0


def test_frames_of_a_spool_are_added_once(tmp_path: Path) -> None:
    small_take(tmp_path / "a.mcap")
    DiskSpool(tmp_path / "spool", "front", 1, SpoolLimits(0)).write(12, [frame_bytes("front", n) for n in (12, 13)])
    (file,) = (tmp_path / "spool").iterdir()
    assert result_here(tmp_path, "take", "merge", "a", str(file))["added"] == {"front": 2}
    again = run_here(tmp_path, "take", "merge", "a", str(file))
    assert "no frame added" in again.stderr


def test_a_node_records_on_its_own_disk_what_it_sent_also_without_a_server(tmp_path: Path) -> None:
    own = tmp_path / "own.mcap"
    address = f"tcp/127.0.0.1:{free_port()}"
    with open_link(address, "front", NodeDisk(tmp_path / "spool", own, 0)) as link:
        for number in range(5):
            link.publish(frame("front", number))
    take = read_take(own)
    (frames,) = take.complete()
    assert (frames.first, frames.last, frames.lost, frames.end_known) == (0, 4, 0, True)
    assert take.clean
    with (
        pytest.raises(RecordingError, match="nothing is overwritten"),
        open_link(address, "front", NodeDisk(record=own)),
    ):
        pytest.fail("began, though the take exists")


def test_a_node_that_failed_goes_on_with_its_take_when_it_is_started_again(tmp_path: Path) -> None:
    own, address = tmp_path / "own.mcap", f"tcp/127.0.0.1:{free_port()}"
    for failed in (True, False):
        with open_link(address, "front", NodeDisk(tmp_path / "spool", own, 0)) as link:
            for number in range(5):
                link.publish(frame("front", number))
            if failed:
                link.hurry.set()
    take = read_take(own)
    assert (take.clean, take.problems, len(take.interruptions)) == (True, (), 1)
    assert [(node.stored, node.lost) for node in take.complete()] == [(5, 0), (5, 0)]


def test_a_node_that_ends_waits_until_its_last_frame_is_stored(tmp_path: Path) -> None:
    """It ends right after its last frame; the server knows its end, and answers while the disk is written to."""
    address = f"tcp/127.0.0.1:{free_port()}"
    server = Server(ServerSettings(address, setup=Setup("stand-still"), reserve_bytes=0))
    try:
        server.record_to(tmp_path / "a.mcap")
        with open_link(address, "front", NodeDisk(tmp_path / "spool", reserve_bytes=0)) as link:
            wait_until("it joins", link.join)
            for number in range(40):
                link.publish(frame("front", number))
        health = server.status().recording
        assert (health.frames, link.outbox.holds) == (40, {})
    finally:
        server.close()
    take = read_take(tmp_path / "a.mcap")
    assert take.clean
    assert [(frames.last, frames.lost, frames.end_known) for frames in take.complete()] == [(39, 0, True)]
    assert not (tmp_path / "spool").exists()


def test_a_foreign_file_beside_a_closed_take_is_no_part_of_it(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap")
    foreign = small_take(tmp_path / "a.part2.mcap", count=20)
    before = foreign.read_bytes()
    DiskSpool(tmp_path / "spool", "front", 1, SpoolLimits(0)).write(12, [frame_bytes("front", 12)])
    (file,) = (tmp_path / "spool").iterdir()
    assert result_here(tmp_path, "take", "merge", "a", str(file))["added"] == {"front": 1}
    assert [(frames.sensor, frames.last) for frames in read_take(path).complete()] == [("front", 12), ("side", 11)]
    assert foreign.read_bytes() == before


def _damaged_commands(path: Path) -> None:
    """A take whose frames are whole, and none of whose commands can be carried out, one of them not even read."""
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    for step, values in enumerate(
        ({}, {"verb": 5, "arguments": 6}, {"verb": "restore", "arguments": {"tracker": "!"}})
    ):
        writer.write_command(values, 0, step)
    writer._write(take.COMMANDS, b'{"before_step": 3, "command": 7}', 0)
    writer.close()


def test_a_damaged_take_is_replayed_and_exported_as_far_as_it_can_be_with_an_exit_status_of_its_own(
    tmp_path: Path,
) -> None:
    _damaged_commands(tmp_path / "commands.mcap")
    unclosed_take(tmp_path / "torn.mcap", count=4)
    for name, problems in (("commands", 4), ("torn", 1)):
        done = run_here(tmp_path, "replay", name, "--json", "-")
        assert done.returncode == 3, done.stderr
        assert "Traceback" not in done.stderr
        (row,) = json.loads(done.stdout)
        assert (row["damaged"], row["frames_in"]) == (True, 8)
        assert len([problem for problem in row["problems"] if "unknown after" not in problem]) == problems
    for export in ("study-log", "json", "csv"):
        done = run_here(tmp_path, "export", export, "torn", "--json", "-")
        assert done.returncode == 3, done.stderr
        assert "ends early" in done.stdout


def test_entries_that_nobody_can_read_are_left_out_of_an_export(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    bad = scene_bytes(8, "front", 3).replace(b"kinect_v2", b"kinect_v9")
    writer.write_scene(bad, 4 * STEP)
    writer.close()
    done = run_here(tmp_path, "export", "json", "a", "--json", "-")
    assert done.returncode == 3, done.stderr
    written = json.loads(done.stdout)
    assert written["scenes"] == 8
    assert any("kinect_v9" in problem for problem in written["take_problems"])
