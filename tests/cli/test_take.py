"""``mocapella take``: what is said of whole, interrupted and incomplete takes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.programs import free_port, result_here, run_here, wait_until
from support.take_making import frame, frame_bytes, small_take, unclosed_take

from mocapella.errors import RecordingError
from mocapella.live.node_disk import NodeDisk, open_link
from mocapella.live.server import Server, ServerSettings
from mocapella.model.session import Setup
from mocapella.recording.spool import DiskSpool, SpoolLimits
from mocapella.recording.take_reader import read_take


def test_a_whole_take_is_whole(tmp_path: Path) -> None:
    small_take(tmp_path / "a.mcap")
    row = result_here(tmp_path, "take", "check", "a")
    assert (row["whole"], row["frames"], row["lost"], row["interruptions"]) == (True, 24, 0, 0)
    assert result_here(tmp_path, "take", "info", "a") == row


def test_an_interrupted_take_is_not_whole_until_it_is_recovered(tmp_path: Path) -> None:
    unclosed_take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "take", "check", "a", "--json", "-")
    assert done.returncode == 1
    assert not json.loads(done.stdout)["whole"]
    assert "ends early" in done.stderr
    assert run_here(tmp_path, "take", "info", "a").returncode == 0
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
