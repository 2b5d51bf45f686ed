"""What a recorder takes for the take, of frames on the live path and of those that are sent again."""

from __future__ import annotations

import errno
import threading
from functools import partial
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.take_making import SECOND, frame, info, scene_bytes

from mocapella.errors import RecordingError, WireError
from mocapella.live import recorder as recorders
from mocapella.live.record_path import ON_THE_WAY_S, RecordPath, _Contact, hear_answer
from mocapella.live.recorder import Recorder, WantedFrames
from mocapella.recording import disk
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame
from mocapella.testing.server import session_status
from mocapella.wire.delivery import FrameAnswer
from mocapella.wire.keys import NodeKey

FRONT = NodeKey("front", 1)


def encoded(number: int) -> bytes:
    return encode_frame(msgspec.structs.replace(frame("front", 1), sequence=number))


def test_a_frame_that_was_on_its_way_as_the_take_began_belongs_to_it(tmp_path: Path) -> None:
    """Its node has sent it before, so the node's first frame of the take is the next one: 14."""
    recorder = Recorder(TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0), lambda text: None)
    answer = FrameAnswer(next=16, oldest=0, first=14, leaving=False)
    recorder.account(FRONT, partial(hear_answer, answer=answer, first=14, end=None))
    for number in (13, 14, 15):
        recorder.frame(FRONT, encoded(number), SECOND, number)
    recorder.sent_again([(0, 9)], FRONT, encoded(9), SECOND)  # of a node that sends more than it was asked for
    recorder.account(FRONT, partial(hear_answer, answer=answer, first=None, end=16))
    health = recorder.close()
    assert (health.frames, health.lost) == (3, 0)


@given(st.sets(st.integers(0, 30), min_size=1), st.data())
def test_an_answer_has_each_wanted_number_once_whatever_can_be_decoded(numbers: set[int], data: st.DataObject) -> None:
    """A node sends the wanted frames in order, so one that cannot be decoded is the next of them."""
    order = sorted(numbers)
    starts = [n for n in order if n - 1 not in numbers]
    ends = [n for n in order if n + 1 not in numbers]
    wanted = WantedFrames(list(zip(starts, ends, strict=True)))
    for number in order:
        if data.draw(st.booleans()):
            wanted.take(number)
        else:
            assert wanted.unreadable() == number
    assert wanted.unreadable() is None
    for first, last in wanted.ranges:
        for other in (first - 1, last + 1):
            with pytest.raises(WireError, match=f"sequence {other} was not asked for"):
                wanted.take(other)


def test_what_was_tracked_before_the_take_does_not_belong_to_it(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    recorder = Recorder(writer, lambda text: None, {FRONT: 14})
    for number in (12, 13, 14):
        recorder.frame(FRONT, encoded(number), SECOND, number)
    health = recorder.close()
    assert (health.frames, health.lost) == (1, 0)


def test_a_disk_that_is_too_slow_costs_no_command_and_what_it_costs_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames can be asked for again; what changed the session cannot, and without it the take replays differently."""
    said: list[str] = []
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    recorder = Recorder(writer, said.append)
    monkeypatch.setattr(recorders, "_QUEUE_BYTES", -1)  # nothing has room
    for _ in range(3):
        recorder.scene(b"a scene", SECOND)
        recorder.truth("front", b"a truth", SECOND)
    recorder.command("recalibrate", {}, SECOND, before_step=1, by="the view")
    health = recorder.close()
    assert (health.problem, health.scenes) == ("", 0)
    assert [line.partition(": ")[0] for line in said] == [
        "scenes of the session are not recorded",
        "ground truths of front are not recorded",
    ]
    assert [command.values["verb"] for command in read_take(tmp_path / "walk.mcap").commands()] == ["recalibrate"]


def test_all_kinds_of_entries_are_written_and_a_wrong_truth_is_said_once(tmp_path: Path) -> None:
    said: list[str] = []
    recorder = Recorder(TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0), said.append)
    recorder.run(info(SECOND))
    recorder.status(session_status(), SECOND)
    recorder.clock({"front": [1, 2, 3]}, SECOND)
    recorder.scene(scene_bytes(0, "front", 0), SECOND)
    recorder.truth("front", (Path(__file__).parents[1] / "vectors" / "truth_two_people.bin").read_bytes(), SECOND)
    for _ in range(2):
        recorder.truth("front", b"\xff no truth", SECOND)
    health = recorder.close()
    take = read_take(tmp_path / "walk.mcap")
    assert (len(take.runs), len(list(take.statuses())), len(list(take.clock_probes())), health.scenes) == (2, 1, 1, 1)
    assert len(list(take.truths("front"))) == 1
    assert [line.partition(":")[0] for line in said] == ["truths of front are not recorded"]


def test_a_slow_disk_is_said_before_anything_is_dropped() -> None:
    assert recorders._CROWDED_BYTES <= 0.5 * recorders._QUEUE_BYTES


def test_what_waits_for_the_disk_is_crowded_and_after_a_failure_nothing_more_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    released, failing = threading.Event(), threading.Event()

    def waits_and_fails(fd: int) -> None:
        failing.set()
        released.wait(60.0)
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(disk, "_data_sync", waits_and_fails)
    monkeypatch.setattr(recorders, "_CROWDED_BYTES", 10)
    recorder = Recorder(writer, lambda text: None)
    assert not recorder.crowded
    recorder.run(info(SECOND))
    assert failing.wait(60.0)
    recorder.scene(scene_bytes(0, "front", 0), SECOND)  # waits, and is dropped as the recording has stopped
    assert recorder.crowded
    released.set()
    health = recorder.close()
    recorder.scene(scene_bytes(1, "front", 1), SECOND)
    recorder.truth("front", b"a truth", SECOND)
    assert "the disk failed" in health.problem
    assert (health.scenes, recorder.crowded, recorder.stored_and_lost()) == (0, False, ({}, {}))


def test_a_number_is_settled_once_it_was_said_long_enough_ago() -> None:
    contact = _Contact()
    for at_s, number, settled in ((0.0, 5, 0), (0.1, 9, 0), (ON_THE_WAY_S, 12, 5), (2 * ON_THE_WAY_S, 20, 12)):
        contact.hear(number, at_s)
        assert contact.settled == settled


def test_a_node_is_asked_no_second_time_while_a_request_is_under_way(tmp_path: Path) -> None:
    class Silent:
        """Never answers."""

        def __init__(self) -> None:
            self.asked = 0

        def request_frames(self, *_: object) -> None:
            self.asked += 1

    recorder = Recorder(TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0), lambda text: None)
    link, connected = Silent(), list[NodeKey]()
    path = RecordPath(recorder, link, lambda: connected, {}, fresh=True)
    path.finish(0.0)  # its thread has ended
    path._ask(FRONT)
    path._ask(FRONT)
    assert link.asked == 1
    recorder.close()


def test_an_error_as_the_take_is_closed_is_its_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    recorder = Recorder(writer, said.append)
    recorder.frame(FRONT, encoded(0), SECOND, 0)
    closes = writer.close

    def fails(*, interrupted: bool) -> None:
        closes(interrupted=interrupted)
        raise RecordingError("the disk failed")

    monkeypatch.setattr(writer, "close", fails)
    assert recorder.close().problem == "the disk failed"
    assert said == ["RECORDING STOPPED: the disk failed"]
