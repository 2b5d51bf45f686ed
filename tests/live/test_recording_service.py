"""Takes begun and ended from several threads, gaps that are mended, accounts that add up, and bytes that are not what
they say."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.programs import wait_until
from support.record_bus import NODE, Bus, Harness, frame

from mocapella.errors import NotNowError
from mocapella.live import record_path, sequence_leaps
from mocapella.model.session import RecordingHealth
from mocapella.recording import disk
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.wire.delivery import FrameAnswer, FrameRequest
from mocapella.wire.outbox import Outbox


@pytest.fixture
def harness(monkeypatch: pytest.MonkeyPatch) -> Iterator[Harness]:
    monkeypatch.setattr(record_path, "ON_THE_WAY_S", 0.0)
    monkeypatch.setattr(record_path, "GIVE_UP_S", 1.0)
    made = Harness()
    yield made
    made.bus.may_answer.set()
    made.service.finish()


def test_frames_that_the_live_path_lost_are_asked_for_and_acknowledged_once_they_are_stored(
    harness: Harness, tmp_path: Path
) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(10)
    harness.record(0, 1, 2, 8, 9)
    wait_until("all are stored", lambda: harness.service.health().frames == 10)
    wait_until("all are acknowledged", lambda: harness.bus.outbox.oldest == 10)
    harness.send(2)
    assert harness.service.finish().lost == 0
    take = read_take(tmp_path / "a.mcap")
    (frames,) = take.complete()
    assert (frames.first, frames.last, frames.missing, frames.end_known) == (0, 11, (), True)
    assert take.clean
    assert harness.bus.outbox.holds == {}


def test_a_missing_frame_is_sent_once(harness: Harness, tmp_path: Path) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(50)
    wait_until("all are stored", lambda: harness.service.health().frames == 50)
    harness.service.finish()
    assert harness.bus.served == 50


def test_what_is_not_on_the_disk_is_never_acknowledged_and_a_slow_disk_holds_nobody_up(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(1)
    wait_until("it is acknowledged", lambda: harness.bus.outbox.oldest == 1)
    real, syncing, may_sync = disk._data_sync, threading.Event(), threading.Event()

    def slow(fd: int) -> None:
        syncing.set()
        assert may_sync.wait(30.0)
        real(fd)

    with monkeypatch.context() as patch:
        patch.setattr(disk, "_data_sync", slow)
        harness.send(5)
        harness.record(1, 2, 3, 4, 5)
        assert syncing.wait(30.0)
        harness.record(*range(1, 6))  # returns at once, though the disk is waited for
        assert (harness.bus.outbox.oldest, harness.service.health().frames) == (1, 1)
        may_sync.set()
        wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 6)


@pytest.mark.parametrize("step_s", [-7200.0, -5.0, 5.0, 3600.0])
def test_a_step_of_the_wall_clock_during_an_outage_changes_nothing(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    path = tmp_path / "a.mcap"
    harness.begin(path)
    harness.send(20)
    wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 20)
    killed = harness.kill()
    harness.send(20)
    real, real_ns = time.time, time.time_ns
    monkeypatch.setattr(time, "time", lambda: real() + step_s)
    monkeypatch.setattr(time, "time_ns", lambda: real_ns() + int(step_s * 1e9))
    os.utime(path, (real() - step_s, real() - step_s))
    harness.service.begin(path, resume=True)
    harness.send(20)
    assert harness.service.finish().lost == 0
    killed()
    take = read_take(path)
    assert [(frames.first, frames.last, frames.lost) for frames in take.complete()] == [(0, 59, 0)]
    assert len(take.interruptions) == 1


def test_a_take_begins_after_the_newest_frame_also_if_the_next_was_lost(harness: Harness, tmp_path: Path) -> None:
    harness.send(5)
    harness.service.begin(tmp_path / "a.mcap", newest={NODE: 4})
    harness.send(3)
    harness.record(3, 4, 6)  # 5 and 7 were lost on the way
    wait_until("they are there", lambda: harness.recorder.health().frames == 3)
    harness.service.finish()
    (frames,) = read_take(tmp_path / "a.mcap").complete()
    assert (frames.first, frames.last, frames.missing) == (5, 7, ())


def test_a_node_that_the_server_meets_later_gives_what_it_sent_since_the_take_began(
    harness: Harness, tmp_path: Path
) -> None:
    harness.bus.connected.clear()
    harness.send(5)
    harness.service.begin(tmp_path / "a.mcap")
    harness.send(3)
    harness.bus.connected.append(NODE)
    wait_until("they are there", lambda: harness.recorder.health().frames == 3)
    harness.service.finish()
    (frames,) = read_take(tmp_path / "a.mcap").complete()
    assert (frames.first, frames.last, frames.missing) == (5, 7, ())


def test_frames_that_the_node_has_no_longer_are_counted_as_lost(harness: Harness, tmp_path: Path) -> None:
    harness.bus.outbox = Outbox(3)
    harness.service.begin(tmp_path / "a.mcap", newest={NODE: -1})
    harness.bus.connected.clear()  # before the node hears of the take
    harness.send(10)
    harness.record(0, 1)
    harness.bus.connected.append(NODE)
    health = harness.service.finish()
    assert (health.frames, health.lost, health.unknown) == (5, 5, ())
    assert harness.said[-1].endswith("a.mcap; 5 frames are missing")
    (frames,) = read_take(tmp_path / "a.mcap").complete()
    assert (frames.first, frames.last, frames.lost, frames.missing) == (0, 9, 5, ((2, 6),))


def test_an_end_that_no_node_has_said_is_unknown_and_the_take_is_not_clean(harness: Harness, tmp_path: Path) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(4)
    harness.record(0, 1, 2)
    wait_until("all are stored", lambda: harness.service.health().frames == 4)
    harness.bus.connected.clear()  # killed: without a word
    health = harness.service.finish()
    assert [(end.sensor, end.after) for end in health.unknown] == [("front", 3)]
    assert "front: unknown after frame 3" in harness.said[-1]
    take = read_take(tmp_path / "a.mcap")
    assert not take.clean
    assert any("front: unknown after frame 3" in problem for problem in take.problems)
    assert not take.complete()[0].end_known


def test_a_node_that_leaves_says_its_end(harness: Harness, tmp_path: Path) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(4)
    wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 4)
    harness.bus.outbox.leave()
    harness.service.leaving(NODE, 4)
    wait_until("it hears that all is stored", lambda: harness.bus.outbox.holds == {})
    harness.bus.connected.clear()
    health = harness.service.finish()
    assert (health.frames, health.lost, health.unknown) == (4, 0, ())
    assert read_take(tmp_path / "a.mcap").clean


def test_a_program_that_only_publishes_is_recorded_and_its_end_is_unknown(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bus, "request_frames", lambda *rest: rest[-1]())  # ended at once, without an answer
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(3, 4)
    began = time.monotonic()
    health = harness.service.finish()
    assert time.monotonic() - began < 0.9 * record_path.GIVE_UP_S + 1.0
    assert (health.frames, health.lost, health.unknown[0].after) == (2, 0, 4)


def test_a_take_that_is_being_ended_is_waited_for_and_none_begins_meanwhile(harness: Harness, tmp_path: Path) -> None:
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0)
    wait_until("it is stored", lambda: harness.service.health().frames == 1)
    harness.bus.may_answer.clear()
    results: list[RecordingHealth] = []
    ends = [threading.Thread(target=lambda: results.append(harness.service.finish())) for _ in range(3)]
    for thread in ends:
        thread.start()
    wait_until("one of them ends it", harness.service._changing.locked)
    with pytest.raises(NotNowError, match="being closed"):
        harness.service.begin(tmp_path / "b.mcap")
    closing = harness.service.health()  # a client that asks now hears of this take, not of the one before or of none
    assert closing.active
    assert closing.path == str(tmp_path / "a.mcap")
    harness.bus.may_answer.set()
    for thread in ends:
        thread.join()
    assert [health.frames for health in results] == [1, 1, 1]
    assert not harness.service.health().active
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.service.health().active


def test_a_frame_under_another_nodes_key_does_not_get_into_a_take(harness: Harness, tmp_path: Path) -> None:
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0)
    harness.record(1, sensor="side")
    harness.record(2, node_id=2)
    harness.recorder.truth("front", b"no truth", 1003)
    harness.record(1)
    assert harness.service.finish().frames == 2
    take = read_take(tmp_path / "a.mcap")
    assert [(frames.sensor, frames.node_id, frames.stored) for frames in take.complete()] == [("front", 1, 2)]
    assert list(take.truths("front")) == []
    told = [text for text in harness.said if "not recorded" in text]  # once a sensor, not thirty times a second
    assert [text.partition(":")[0] for text in told] == [
        "frames of front are not recorded",
        "truths of front are not recorded",
    ]


def _unlink(path: Path, _patch: pytest.MonkeyPatch) -> None:
    path.unlink()


def _truncate(path: Path, _patch: pytest.MonkeyPatch) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _fail(_path: Path, patch: pytest.MonkeyPatch) -> None:
    def fails(_fd: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    patch.setattr(disk, "_data_sync", fails)


def _fill(_path: Path, patch: pytest.MonkeyPatch) -> None:
    def fails(_fd: int, _data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    patch.setattr(disk, "write_all", fails)


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (_unlink, "was removed while it was recorded"),
        (_truncate, "was changed by another program while it was recorded"),
        (_fail, "the disk failed"),
        (_fill, "the disk is full"),
    ],
)
def test_the_account_adds_up_after_a_recording_that_stopped_badly(
    harness: Harness,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    harm: Callable[[Path, pytest.MonkeyPatch], None],
    says: str,
) -> None:
    """The node goes on sending; what is readable afterwards and what is reported as lost is all that it sent."""
    path = tmp_path / "a.mcap"
    harness.begin(path)
    harness.send(20)
    wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 20)
    with monkeypatch.context() as patch:
        harm(path, patch)
        harness.send(20)
        wait_until("it is noticed", lambda: not harness.service.health().active)
        acknowledged = harness.bus.outbox.oldest
        harness.send(20)
        health = harness.service.finish()
    assert says in health.problem
    assert any("RECORDING STOPPED" in text for text in harness.said)
    assert acknowledged == 20
    readable = read_take(path).frame_count if path.exists() else 0
    assert (health.frames, health.lost, health.unknown) == (readable, 60 - readable, ())
    (hold,) = harness.bus.outbox.holds.values()  # the node hears of it, and keeps what was never on the disk
    assert (hold.closed, hold.numbers(60)) == (True, range(20, 60))
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.service.health().active


def test_it_records_from_the_begin_of_a_take_until_its_end_or_its_failure(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not harness.service.active
    harness.service.begin(tmp_path / "a.mcap")
    assert harness.service.active
    harness.service.finish()
    assert not harness.service.active
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.service.active
    with monkeypatch.context() as patch:
        _fail(tmp_path, patch)
        harness.record(0)
        wait_until("it is noticed", lambda: harness.recorder.failed)
        assert not harness.service.active  # though nobody has ended the take


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_recorder_that_fails_of_what_nobody_foresaw_says_so(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    harness.service.begin(tmp_path / "a.mcap")

    def fails(_self: TakeWriter) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(TakeWriter, "flush", fails)
        wait_until("it is noticed", lambda: not harness.service.health().active)
    assert "failed" in harness.service.finish().problem
    assert any("RECORDING STOPPED" in text for text in harness.said)
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.service.health().active


@pytest.mark.parametrize("restarted", [False, True])
def test_after_a_long_outage_the_backlog_and_the_next_live_frame_are_taken(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, restarted: bool
) -> None:
    """They arrive within a moment, in any order, and the numbers between them are what an hour of frames has."""
    monkeypatch.setattr(sequence_leaps, "ALWAYS", 10)
    an_hour_ago = max(0, time.monotonic_ns() - 3600 * 10**9)  # or since the machine was started
    harness.service.begin(tmp_path / "a.mcap")
    harness.bus.connected = []
    for k in (0, 1):
        harness.recorder.frame(NODE, frame(k), an_hour_ago)
    harness.send(61)
    if restarted:
        wait_until("they are stored", lambda: harness.service.health().frames == 2)
        end = harness.kill()
        harness.service.begin(tmp_path / "a.mcap", resume=True)
        end()
    wanted = harness.bus.outbox.wanted

    def live_after_the_first(request: FrameRequest, gone: dict[tuple[int, int], str]) -> Iterator[bytes]:
        for data in wanted(request, gone):
            yield data
            harness.record(60)

    monkeypatch.setattr(harness.bus.outbox, "wanted", live_after_the_first)
    harness.bus.connected = [NODE]
    wait_until("all are stored", lambda: harness.service.health().frames == 61)
    health = harness.service.finish()
    assert (health.frames, health.lost, health.unknown) == (61, 0, ())
    assert [text for text in harness.said if "not recorded" in text] == []


def test_a_number_that_no_sensor_can_count_to_is_refused_wherever_it_is_said(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forged, wanted = 2**61, harness.bus.outbox.wanted
    harness.begin(tmp_path / "a.mcap")
    harness.send(4)
    harness.record(0, 3)
    wait_until("the gap is mended", lambda: harness.service.health().frames == 4)
    harness.record(forged)
    update = harness.bus.outbox.update
    asked: list[FrameRequest] = []

    def lie(request: FrameRequest, now_ns: int) -> FrameAnswer:
        asked.append(request)
        update(request, now_ns)
        return FrameAnswer(forged, forged, leaving=True)

    monkeypatch.setattr(harness.bus.outbox, "update", lie)
    monkeypatch.setattr(harness.bus.outbox, "wanted", lambda *given: [*wanted(*given), frame(forged + 1), frame(9)])
    harness.service.leaving(NODE, forged)
    wait_until("the node has answered", lambda: len(asked) > 1)
    health = harness.service.finish()
    assert (health.frames, health.lost) == (4, 0)
    assert [row.after for row in health.unknown] == [3]
    assert len([text for text in harness.said if "of front are not recorded" in text]) == 2
