"""What a take and its nodes go through after an outage: much that is missing, ends that are missed or come again, and
frames that nobody can store."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.programs import wait_until
from support.record_bus import NODE, Harness, frame

from mocapella.errors import RecordingError
from mocapella.live import record_path
from mocapella.live.record_path import MOST_REQUESTS, MOST_UNTOLD, ClosedTakes, _Batch, _Contact, request_of
from mocapella.live.recorder import NodeState, WantedFrames
from mocapella.recording import disk, take_writer
from mocapella.recording.take import FRAMES
from mocapella.recording.take_reader import read_take
from mocapella.wire import outbox
from mocapella.wire.delivery import MOST_FRAMES, FrameAnswer, FrameRequest
from mocapella.wire.keys import NodeKey
from mocapella.wire.outbox import Outbox


@pytest.fixture
def harness(monkeypatch: pytest.MonkeyPatch) -> Iterator[Harness]:
    monkeypatch.setattr(record_path, "ON_THE_WAY_S", 0.0)
    monkeypatch.setattr(record_path, "GIVE_UP_S", 1.0)
    made = Harness()
    yield made
    made.bus.may_answer.set()
    made.service.finish()


class SlowBus:
    """In place of the bus: keeps the requests that ask for frames until `answer`."""

    def __init__(self, harness: Harness) -> None:
        self._at_once = harness.bus.request_frames
        self.waiting: list[tuple[FrameRequest, Callable[[], None]]] = []
        self.most = 0

    def request_frames(self, node: NodeKey, request: FrameRequest, *calls: Callable[..., None]) -> None:
        if not request.wanted:
            self._at_once(node, request, *calls)  # type: ignore[arg-type]
            return
        self.waiting.append((request, lambda: self._at_once(node, request, *calls)))  # type: ignore[arg-type]
        self.most = max(self.most, len(self.waiting))

    def answer(self) -> None:
        self.waiting.pop(0)[1]()


def test_after_an_outage_several_requests_are_under_way_and_each_frame_is_sent_once(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_path, "MOST_FRAMES", 10)
    monkeypatch.setattr(record_path, "_Contact", lambda: _Contact(frames=10))
    slow = SlowBus(harness)
    monkeypatch.setattr(harness.bus, "request_frames", slow.request_frames)
    harness.bus.connected.clear()
    harness.service.begin(tmp_path / "a.mcap")
    harness.send(95)
    harness.bus.connected.append(NODE)
    wait_until("all requests are under way", lambda: len(slow.waiting) == MOST_REQUESTS)
    wanted = [span for request, _ in slow.waiting for span in request.wanted]
    assert wanted == [(0, 9), (10, 19), (20, 29), (30, 39)]
    harness.record(94)  # live frames are taken meanwhile
    wait_until("it is stored", lambda: harness.service.health().frames == 1)

    def all_are_stored() -> bool:
        if slow.waiting:
            slow.answer()
        return harness.service.health().frames == 95

    wait_until("all are stored", all_are_stored)
    assert slow.most == MOST_REQUESTS
    assert harness.bus.served == 94
    monkeypatch.setattr(harness.bus, "request_frames", slow._at_once)
    assert harness.service.finish().lost == 0


def test_a_request_asks_for_no_frame_that_another_one_has_asked_for() -> None:
    state = NodeState(True, 3, 100, None, ((3, 9), (20, 20), (30, 60)))
    request = request_of("take", state, None, 0, 50, under_way=[(45, 99), (5, 6), (20, 20)], most=12)
    assert request.wanted == [(3, 4), (7, 9), (30, 36)]
    assert request_of("take", state, None, 0, 50, under_way=[(0, 99)]).wanted == []
    assert request_of("take", state, None, 0, 5).wanted == [(3, 4)]


def test_requests_adapt_to_what_an_answer_has_brought() -> None:
    contact = _Contact()

    def learn(count: int, *, answered: bool = True) -> tuple[int, int]:
        batch = _Batch([(0, contact.frames - 1)])
        batch.count, batch.answered = count, answered
        contact.learn(batch)
        return contact.most, contact.frames

    assert learn(40) == (MOST_REQUESTS, 40)  # large frames: no more have room
    assert learn(40) == (MOST_REQUESTS, 80)
    assert learn(6, answered=False) == (1, 3)  # a slow link: too much for the time
    assert learn(0, answered=False) == (1, 1)
    assert [learn(contact.frames)[0] for _ in range(5)] == [2, 3, 4, 4, 4]
    assert contact.frames == 32
    assert learn(0) == (1, 32)  # the node cannot read them now: the same, but no others beside
    for _ in range(9):
        learn(contact.frames)
    assert contact.frames == MOST_FRAMES


def test_a_take_whose_server_was_killed_while_it_closed_it_takes_the_later_frames(
    harness: Harness, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    harness.begin(path)
    harness.send(10)
    harness.recorder.account(NODE, lambda ledger: ledger.expect(0))
    wait_until("they are stored", lambda: harness.service.health().frames == 10)
    harness.recorder.account(NODE, lambda ledger: ledger.finish(10))  # the take's end, not the node's
    wait_until("the end is stored", lambda: harness.recorder.states[NODE].end == 10)
    killed = harness.kill()
    harness.send(10)
    harness.service.begin(path, resume=True)
    harness.send(10)
    health = harness.service.finish()
    killed()
    assert (health.frames, health.lost, health.unknown) == (30, 0, ())
    (frames,) = read_take(path).complete()
    assert (frames.first, frames.last, frames.lost, frames.end_known) == (0, 29, 0, True)


def test_the_end_of_a_node_that_has_left_stays_when_the_take_goes_on(harness: Harness, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    harness.begin(path)
    harness.send(4)
    harness.service.leaving(NODE, 4)
    wait_until("they are stored", lambda: (s := harness.recorder.states.get(NODE)) is not None and s.whole)
    killed = harness.kill()
    harness.bus.connected.clear()
    harness.service.begin(path, resume=True)
    health = harness.service.finish()
    killed()
    assert (health.frames, health.lost, health.unknown) == (4, 0, ())
    assert read_take(path).clean


def test_a_take_that_is_interrupted_tells_no_node_that_it_is_over_and_goes_on(harness: Harness, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    harness.begin(path)
    harness.send(4)
    wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 4)
    harness.service.interrupt()
    harness.service.interrupt()  # without a take, it does nothing
    assert "a recording to it goes on with it" in harness.service.health().problem
    (hold,) = harness.bus.outbox.holds.values()
    assert not hold.closed
    harness.send(3)
    harness.service.begin(path, resume=True)
    harness.send(2)
    health = harness.service.finish()
    assert (health.frames, health.lost, health.unknown) == (9, 0, ())
    take = read_take(path)
    assert (take.clean, take.problems, len(take.interruptions)) == (True, (), 1)


def test_a_node_that_missed_the_end_of_a_take_hears_of_it_when_it_is_there_again(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_path, "ASK_EVERY_S", 0.0)
    harness.begin(tmp_path / "a.mcap")
    harness.send(4)
    wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 4)
    harness.bus.connected.clear()
    harness.service.finish()
    harness.service.tell_closed()
    harness.send(3)
    (hold,) = harness.bus.outbox.holds.values()
    assert not hold.closed
    harness.service.begin(tmp_path / "b.mcap")  # another take does not hide the first
    harness.bus.connected.append(NODE)
    harness.service.tell_closed()
    hold = next(hold for hold in harness.bus.outbox.holds.values() if hold.closed)
    assert hold.numbers(7) == range(4, 7)  # its end is unknown
    harness.bus.outbox.release(next(take for take, one in harness.bus.outbox.holds.items() if one is hold))
    harness.service.tell_closed()
    assert not any(hold.closed for hold in harness.bus.outbox.holds.values())  # it is told once


def test_a_take_that_failed_and_goes_on_is_not_called_closed(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_path, "ASK_EVERY_S", 0.0)
    path = tmp_path / "a.mcap"
    harness.begin(path)
    harness.send(4)
    wait_until("they are acknowledged", lambda: harness.bus.outbox.oldest == 4)
    harness.bus.connected.clear()

    def fails(_fd: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(disk, "_data_sync", fails)
        harness.record(4)
        wait_until("the disk fails", lambda: not harness.service.health().active)
        harness.service.finish()
    harness.service.begin(path, resume=True)
    real, closed = harness.bus.request_frames, list[bool]()

    def ask(node: NodeKey, request: FrameRequest, *calls: Callable[..., None]) -> None:
        closed.append(request.closed)
        real(node, request, *calls)  # type: ignore[arg-type]

    monkeypatch.setattr(harness.bus, "request_frames", ask)
    harness.bus.connected.append(NODE)
    harness.service.tell_closed()
    harness.send(2)
    wait_until("they are stored", lambda: harness.bus.outbox.oldest == 6)
    assert not any(closed)
    assert harness.service.finish().lost == 0


def test_a_take_that_goes_on_is_called_closed_to_nobody() -> None:
    told: list[FrameRequest] = []

    class Silent:
        """Nodes that never answer."""

        def request_frames(self, _node: NodeKey, request: FrameRequest, *calls: Callable[[], None]) -> None:
            told.append(request)
            calls[-1]()

    closed = ClosedTakes(Silent())  # type: ignore[arg-type]
    for number in range(MOST_UNTOLD + 1):
        closed.add(NodeKey("front", number), FrameRequest(f"take {number}", 1, closed=True))
    assert closed.tell([NodeKey("front", 0)]) == []  # the oldest is forgotten
    (event,) = closed.tell([NodeKey("front", 1)])
    assert event.is_set()
    assert closed.tell([NodeKey("front", 1)]) == []  # not again within a second
    closed.forget("take 2")
    assert closed.tell([NodeKey("front", 2)]) == []
    assert [request.take for request in told] == ["take 1"]


def _too_large(_harness: Harness, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(take_writer, "MAX_ENTRY_BYTES", 10)


def _not_encodable(harness: Harness, patch: pytest.MonkeyPatch) -> None:
    add = harness.recorder._writer._file.add

    def fails(topic: str, *rest: Any, **options: Any) -> None:
        if not topic.startswith(FRAMES):  # the account of nodes, which may be written meanwhile
            return add(topic, *rest, **options)
        raise UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed")

    patch.setattr(harness.recorder._writer._file, "add", fails)


@pytest.mark.parametrize("harm", [_too_large, _not_encodable])
def test_a_frame_that_cannot_be_written_costs_that_frame_only(
    harness: Harness,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    harm: Callable[[Harness, pytest.MonkeyPatch], None],
) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(3)
    wait_until("they are stored", lambda: harness.service.health().frames == 3)
    with monkeypatch.context() as patch:
        harm(harness, patch)
        harness.send(1)
        wait_until("it is noticed", lambda: harness.service.health().unwritten == 1)
    harness.send(3)
    wait_until("it holds back no acknowledgement", lambda: harness.bus.outbox.oldest == 7)
    served = harness.bus.served
    health = harness.service.finish()
    assert (health.frames, health.lost, health.unwritten, health.problem) == (6, 1, 1, "")
    assert served == 7  # it is asked for once
    assert any("an entry is not in the take" in text for text in harness.said)
    assert harness.said[-1].endswith("; 1 frames are missing; 1 entries could not be written")
    (frames,) = read_take(tmp_path / "a.mcap").complete()
    assert (frames.stored, frames.missing) == (6, ((3, 3),))


def test_entries_that_cannot_be_written_never_end_the_recording(harness: Harness, tmp_path: Path) -> None:
    harness.service.begin(tmp_path / "a.mcap")
    harness.recorder.scene(b"a scene", -1)  # a time that no file can hold
    harness.recorder.command("name", {"name": object()}, 5, 0)
    harness.recorder.account(NODE, lambda _ledger: bool(1 / 0))
    harness.record(0)
    wait_until("the frame is stored", lambda: harness.service.health().frames == 1)
    assert harness.service.finish().unwritten == 2


def test_a_frame_that_nobody_can_decode_is_asked_for_once_and_lost(harness: Harness, tmp_path: Path) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(2)
    for _ in range(2):
        harness.bus.outbox.add(b"no frame", time.monotonic_ns())
    harness.send(2)
    wait_until("it holds back no acknowledgement", lambda: harness.bus.outbox.oldest == 6)
    health = harness.service.finish()
    assert (health.frames, health.lost) == (4, 2)
    (frames,) = read_take(tmp_path / "a.mcap").complete()
    assert frames.missing == ((2, 3),)


def test_an_answers_order_tells_the_number_of_a_frame_that_cannot_be_decoded() -> None:
    wanted = WantedFrames([(3, 4), (8, 8)])
    assert wanted.unreadable() == 3
    wanted.take(4)
    assert wanted.unreadable() == 8
    assert wanted.unreadable() is None


def test_frames_that_a_node_cannot_read_any_more_are_lost_and_hold_back_nothing(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Damaged:
        """A store whose only part lacks a frame."""

        def write(self, first: int, frames: object) -> None: ...
        def remove(self, first: int) -> None: ...
        def read(self, _first: int) -> list[bytes]:
            return [frame(2)]

    monkeypatch.setattr(outbox, "READ_FOR_S", 0.0)
    harness.bus.outbox = Outbox(1000, Damaged())
    harness.bus.connected.clear()
    harness.service.begin(tmp_path / "a.mcap")
    harness.send(2)
    harness.record(0, 1)
    harness.bus.outbox.update(FrameRequest(harness.recorder.take_id, 0), 0)
    harness.bus.outbox.update(FrameRequest(harness.recorder.take_id, 2), 0)
    harness.send(2)
    assert harness.bus.outbox.spill()
    harness.send(2)
    harness.bus.connected.append(NODE)
    wait_until("they hold back no acknowledgement", lambda: harness.bus.outbox.oldest == 6)
    health = harness.service.finish()
    assert (health.frames, health.lost) == (4, 2)


def test_a_node_gives_up_only_what_it_was_asked_for(harness: Harness, tmp_path: Path) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.send(1)
    harness.record(0)
    wait_until("it is stored", lambda: harness.service.health().frames == 1)
    answer = FrameAnswer(1, 0, gone=[(0, 2**61)])
    done = threading.Event()

    def hear(ledger: record_path.NodeLedger) -> bool:
        record_path.hear_answer(ledger, answer=answer, first=None, end=None, wanted=[(0, 0)])
        record_path.hear_answer(ledger, answer=answer, first=None, end=None)
        done.set()
        return False

    harness.recorder.account(NODE, hear)
    assert done.wait(60.0)
    health = harness.service.finish()
    assert (health.frames, health.lost) == (1, 0)


def test_an_undecodable_frame_beyond_what_was_asked_for_is_nobodys_loss(harness: Harness, tmp_path: Path) -> None:
    harness.begin(tmp_path / "a.mcap")
    harness.recorder.sent_again(WantedFrames([]), NODE, b"no frame", time.monotonic_ns())
    harness.send(1)
    wait_until("the frame is stored", lambda: harness.service.health().frames == 1)
    assert (harness.service.finish().lost, harness.service.health().unwritten) == (0, 0)


def test_a_disk_that_fails_as_a_frame_is_written_stops_the_recording(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise RecordingError("the disk is gone")

    harness.begin(tmp_path / "a.mcap")
    monkeypatch.setattr(harness.recorder._writer, "write_frame", fails)
    harness.send(1)
    wait_until("it is noticed", lambda: harness.recorder.failed)
    health = harness.service.finish()
    assert "what was committed is safe" in health.problem
    assert (health.frames, health.lost, health.unwritten) == (0, 1, 0)
