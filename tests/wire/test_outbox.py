"""What a node keeps for a recording server: in memory, on the disk, and for how long."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest
from support.programs import free_port, wait_until
from support.take_making import frame

from mocapella.errors import RecordingError, UnstoredFramesError, WireError
from mocapella.wire.delivery import (
    MOST_FRAMES,
    MOST_GAPS,
    FrameAnswer,
    FrameRequest,
    check_number,
    read_answer,
    read_request,
)
from mocapella.wire.keys import of_node
from mocapella.wire.node import NodeLink
from mocapella.wire.outbox import MOST_TAKES, READ_FOR_S, Outbox
from mocapella.wire.server import ServerLink
from mocapella.wire.spool import NEGLECTED_S, SPILL_AFTER_S, Spooler

OPEN = FrameRequest("take", 0)


class Shelf:
    """In place of a disk: a dictionary, which may refuse."""

    def __init__(self) -> None:
        self.parts: dict[int, list[bytes]] = {}
        self.kept: dict[str, list[int]] = {}
        self.full = self.closed = False

    def write(self, first: int, frames: Sequence[bytes]) -> None:
        if self.full:
            raise RecordingError("full")
        self.parts[first] = list(frames)

    def read(self, first: int) -> Sequence[bytes]:
        return self.parts[first]

    def remove(self, first: int) -> None:
        del self.parts[first]

    def keep(self, take: str, frames: Iterable[tuple[int, bytes]], _numbers: range) -> Path:
        if self.full:
            raise RecordingError("full")
        self.kept[take] = [number for number, _ in frames]
        return Path(take)

    def close(self) -> None:
        self.closed = True


def filled(count: int, most: int = 4, shelf: Shelf | None = None) -> Outbox:
    outbox = Outbox(most, shelf)
    for number in range(count):
        outbox.add(b"%d" % number, number)
    return outbox


def numbers(outbox: Outbox, *wanted: tuple[int, int]) -> list[int]:
    return [int(data) for data in outbox.wanted(FrameRequest("take", 0, wanted=list(wanted)))]


def test_without_a_take_the_newest_stay_in_memory() -> None:
    outbox = filled(10)
    assert (outbox.oldest, outbox.next, outbox.dropped) == (6, 10, 0)
    assert numbers(outbox, (0, 7), (9, 20)) == [6, 7, 9]
    assert not outbox.spill()


def test_what_a_take_lacks_goes_to_the_disk_and_what_is_acknowledged_is_forgotten() -> None:
    shelf = Shelf()
    outbox = filled(3, shelf=shelf)
    outbox.update(OPEN, 0)
    assert outbox.spill()
    for number in range(3, 6):
        outbox.add(b"%d" % number, number)
    assert outbox.spill()
    assert sorted(shelf.parts) == [0, 3]
    assert numbers(outbox, (0, 9)) == [0, 1, 2, 3, 4, 5]
    outbox.update(FrameRequest("take", 4), 0)
    assert (sorted(shelf.parts), outbox.oldest) == ([3], 3)
    outbox.update(FrameRequest("take", 6, end=6, closed=True), 0)
    assert (shelf.parts, outbox.holds, outbox.dropped) == ({}, {}, 0)


def test_frames_after_an_ended_takes_end_are_kept_until_it_is_closed_because_it_may_go_on() -> None:
    shelf = Shelf()
    outbox = filled(3, shelf=shelf)
    outbox.update(OPEN, 0)
    assert outbox.spill()
    outbox.update(FrameRequest("take", 2, end=2), 0)  # the server ends the take, and is killed before it is closed
    for number in range(3, 8):
        outbox.add(b"%d" % number, number)
    assert outbox.spill()
    assert numbers(outbox, (0, 9)) == list(range(8))
    outbox.update(FrameRequest("take", 2), 0)  # the take goes on
    assert numbers(outbox, (2, 9)) == list(range(2, 8))
    outbox.update(FrameRequest("take", 8, end=8, closed=True), 0)
    assert (shelf.parts, outbox.holds, outbox.dropped) == ({}, {}, 0)


@pytest.mark.parametrize(
    ("stored", "end", "held"), [(3, 3, []), (3, None, ["take"]), (2, 3, ["take"]), (2, 2, ["take"]), (3, 4, ["take"])]
)
def test_a_node_that_leaves_is_free_once_the_server_knows_its_end_and_has_all_frames(
    stored: int, end: int | None, held: list[str]
) -> None:
    outbox = filled(3)
    outbox.update(OPEN, 0)
    outbox.leave()
    outbox.update(FrameRequest("take", stored, end=end), 0)
    assert list(outbox.holds) == held


def test_a_damaged_part_is_an_error_and_never_gives_a_frame_another_number() -> None:
    shelf = Shelf()
    outbox = filled(4, shelf=shelf)
    outbox.update(OPEN, 0)
    outbox.spill()
    outbox.add(b"4", 4)
    del shelf.parts[0][1]
    with pytest.raises(RecordingError, match="frames 0 to 3 are damaged"):
        outbox.frame(2)
    assert list(outbox.frames(range(6))) == [(4, b"4")]
    assert outbox.frame(5) is None


def test_frames_that_were_spilled_are_found_by_the_time_since_a_take_began() -> None:
    shelf = Shelf()
    outbox = filled(2, shelf=shelf)
    outbox.update(OPEN, 0)
    outbox.spill()
    outbox.add(b"2", 2)
    outbox.spill()
    assert outbox.update(FrameRequest("new", age_ns=8), now_ns=10).first == 2
    assert outbox.update(FrameRequest("old", age_ns=10), now_ns=10).first == 0


def test_without_room_the_oldest_are_dropped_and_counted() -> None:
    shelf = Shelf()
    outbox = filled(3, shelf=shelf)
    outbox.update(FrameRequest("take", 1), 0)
    outbox.spill()
    shelf.full = True
    for number in range(3, 3 + 2 * 4 + 1):
        outbox.add(b"%d" % number, number)
    assert (outbox.oldest, outbox.dropped, shelf.parts) == (4, 3, {})  # of the take: 1, 2 and 3


def test_a_spooler_makes_room_with_the_oldest_part_and_says_what_is_lost() -> None:
    shelf, said = Shelf(), list[str]()
    outbox = filled(2, shelf=shelf)
    outbox.update(OPEN, 0)
    spooler = Spooler(outbox, shelf, said.append)
    late_ns = int((SPILL_AFTER_S + 1) * 1e9)
    spooler.update(1)
    assert shelf.parts == {}  # acknowledged frames do not wait that long
    spooler.update(late_ns)
    assert sorted(shelf.parts) == [0]
    shelf.full = True
    for number in range(2, 7):
        outbox.add(b"%d" % number, number)
    spooler.update(late_ns)
    assert (shelf.parts, outbox.oldest) == ({}, 2)
    assert said == ["2 frames of an open take are lost: memory and disk are full"]
    spooler.close()


def test_frames_are_spilled_when_the_oldest_has_waited_longer_than_the_limit() -> None:
    shelf = Shelf()
    outbox = filled(2, shelf=shelf)
    outbox.update(OPEN, 0)
    spooler = Spooler(outbox, shelf, print)
    spooler.update(int(SPILL_AFTER_S * 1e9))
    assert shelf.parts == {}
    spooler.update(int(SPILL_AFTER_S * 1e9) + 1)
    assert sorted(shelf.parts) == [0]


def test_each_loss_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    outbox, said = Outbox(2), list[str]()
    outbox.update(OPEN, 0)
    spooler = Spooler(outbox, None, said.append)
    for number in range(5):
        outbox.add(b"%d" % number, number)
    spooler.update(10)
    for number in range(5, 8):
        outbox.add(b"%d" % number, number)
    spooler.update(10)
    spooler.update(10)
    assert [int(line.split()[0]) for line in said] == [1, 3]


def test_only_frames_that_a_take_needs_are_spilled() -> None:
    shelf = Shelf()
    free = filled(2, shelf=shelf)
    assert not free.spill()  # no take
    empty = Outbox(4, shelf)
    empty.update(OPEN, 0)
    assert not empty.spill()
    nowhere = filled(2)
    nowhere.update(OPEN, 0)
    assert not nowhere.spill()
    assert shelf.parts == {}
    free.update(OPEN, 0)
    assert free.spill()
    assert shelf.parts == {0: [b"0", b"1"]}


def test_what_a_closed_take_lacks_is_kept_in_a_file_at_once_and_not_held_any_more() -> None:
    shelf, said = Shelf(), list[str]()
    outbox = filled(4, shelf=shelf)
    outbox.update(FrameRequest("bad", 1, end=3, closed=True), 0)
    outbox.update(FrameRequest("good", 4), 0)
    spooler = Spooler(outbox, shelf, said.append)
    spooler.update(0)
    assert (shelf.kept, list(outbox.holds)) == ({"bad": [1, 2]}, ["good"])
    spooler.close()
    assert (spooler.missing, spooler.kept, shelf.closed) == (2, ["bad"], True)


def test_frames_that_cannot_be_kept_leave_the_parts_on_the_disk() -> None:
    shelf, said = Shelf(), list[str]()
    outbox = filled(4, shelf=shelf)
    outbox.update(OPEN, 0)
    outbox.spill()
    shelf.full = True
    spooler = Spooler(outbox, shelf, said.append)
    spooler.close()
    assert (spooler.missing, sorted(shelf.parts), shelf.closed) == (4, [0], False)
    assert "cannot be kept" in said[0]


def test_the_first_frame_since_a_take_began_is_told_by_durations_only() -> None:
    outbox = filled(10, most=5)
    assert outbox.update(FrameRequest("take", age_ns=3), now_ns=10).first == 7
    assert outbox.update(FrameRequest("old", age_ns=8), now_ns=10).first == 0  # some are gone, and count as lost
    assert outbox.update(FrameRequest("new", age_ns=0), now_ns=10).first == 10


def test_a_late_or_repeated_request_for_the_first_frame_forgets_none_and_takes_no_acknowledgement_back() -> None:
    shelf = Shelf()
    outbox = filled(10, shelf=shelf, most=20)
    began = FrameRequest("take", age_ns=5)
    assert outbox.update(began, now_ns=10).first == 5
    assert outbox.update(began, now_ns=13).first == 5  # 3 ns later on its way, and the same first frame
    assert outbox.oldest == 5
    outbox.update(FrameRequest("take", 8), 13)
    assert outbox.update(began, now_ns=14).first == 5
    outbox.update(FrameRequest("take", 6), 14)
    assert outbox.holds["take"].stored == 8


def test_a_take_that_a_present_server_does_not_ask_about_any_more_does_not_fill_the_disk() -> None:
    shelf, said, since_ns = Shelf(), list[str](), list[int]()
    outbox = filled(4, shelf=shelf)
    outbox.update(FrameRequest("missed", 2), 0)
    spooler = Spooler(outbox, shelf, said.append, lambda: since_ns[0] if since_ns else None)
    late_ns = int((NEGLECTED_S + 1) * 1e9)
    spooler.update(late_ns)
    assert shelf.kept == {}  # no server is there: it may come back
    since_ns.append(late_ns)
    spooler.update(2 * late_ns - 2 * 10**9)
    assert shelf.kept == {}  # it was not there for so long
    outbox.update(FrameRequest("open", 4), 2 * late_ns)
    shelf.full = True
    for _ in range(2):
        spooler.update(2 * late_ns)
    assert [text for text in said if "cannot be kept" in text] == ["2 frames that a take lacks cannot be kept: full"]
    shelf.full = False
    spooler.update(2 * late_ns)
    assert (shelf.kept, list(outbox.holds)) == ({"missed": [2, 3]}, ["open"])
    spooler.close()
    assert spooler.missing == 2


def test_a_store_that_fails_for_a_moment_costs_no_frame() -> None:
    shelf = Shelf()
    outbox = filled(4, shelf=shelf)
    outbox.update(OPEN, 0)
    outbox.spill()
    outbox.add(b"4", 4)
    parts, gone = dict(shelf.parts), dict[tuple[int, int], str]()
    request = FrameRequest("take", 0, wanted=[(1, 9)])

    def given(at_s: float) -> list[bytes]:
        outbox.update(request, round(at_s * 1e9))
        return list(outbox.wanted(request, gone))

    shelf.parts[0] = []
    for k in range(100):  # requests follow each other fast
        assert given(0.99 * READ_FOR_S * k / 100) == [b"4"]
    shelf.parts = dict(parts)
    assert given(READ_FOR_S) == [b"1", b"2", b"3", b"4"]
    outbox._read = (-1, ())
    shelf.parts[0] = []
    assert given(1.5 * READ_FOR_S) == [b"4"]  # it fails anew
    assert given(2.4 * READ_FOR_S) == [b"4"]
    assert gone == {}
    assert given(2.5 * READ_FOR_S) == [b"4"]
    assert list(gone) == [(1, 3)]


def test_an_answer_and_the_number_of_takes_have_limits() -> None:
    outbox = filled(2 * MOST_FRAMES, most=2 * MOST_FRAMES)
    assert len(numbers(outbox, (0, 10**6))) == MOST_FRAMES
    for k in range(2 * MOST_TAKES):
        outbox.update(FrameRequest(f"take {k}", 0), 0)
    assert len(outbox.holds) == MOST_TAKES


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{}",
        b"\xff",
        b'{"take": ""}',
        b'{"take": "a", "stored": -1}',
        b'{"take": "a", "stored": 1e30}',
        b'{"take": "a", "wanted": [[0]]}',
        b'{"take": "a", "wanted": [' + b",".join([b"[0, 1]"] * (MOST_GAPS + 1)) + b"]}",
        b"[" * 10_000,
    ],
)
def test_a_request_that_is_none_is_refused(data: bytes) -> None:
    with pytest.raises(WireError, match="request for frames"):
        read_request(data)
    with pytest.raises(WireError, match="answer about frames"):
        read_answer(data)


@pytest.mark.parametrize("value", [None, -1, "3", 2**62, 10**30, True])
def test_a_last_number_that_is_none_is_refused(value: object) -> None:
    with pytest.raises(WireError, match="0 or more"):
        check_number(value)


def test_messages_are_read_as_they_were_written() -> None:
    import msgspec

    request = FrameRequest("take", 3, 5, 9, True, [(3, 4)])
    assert read_request(msgspec.json.encode(request)) == request
    answer = FrameAnswer(9, 3, 1, True, [(3, 4)])
    assert read_answer(msgspec.json.encode(answer)) == answer


def test_a_node_whose_server_never_comes_back_says_how_many_frames_it_keeps_and_where() -> None:
    shelf = Shelf()
    link = NodeLink(f"tcp/127.0.0.1:{free_port()}", "front", spool=lambda node: shelf)
    link.farewell_s = 0.0
    for number in range(3):
        link.outbox.add(b"%d" % number, time.monotonic_ns())
    link.outbox.update(FrameRequest("take", 1), 0)
    with pytest.raises(UnstoredFramesError, match=r"front: 2 frames are not stored .*they are in take: mocapella take"):
        link.close()
    assert shelf.kept == {"take": [1, 2]}


def test_an_error_of_the_run_is_not_hidden_by_frames_that_are_not_stored() -> None:
    said: list[str] = []
    link = NodeLink(f"tcp/127.0.0.1:{free_port()}", "front", say=said.append)
    link.farewell_s = 0.0
    link.outbox.add(b"0", time.monotonic_ns())
    link.outbox.update(OPEN, 0)

    def fails() -> None:
        with link:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert said == ["front: 1 frames are not stored by the server; they are lost"]


def test_a_request_that_is_nonsense_is_answered_with_an_error() -> None:
    address, nonsense = f"tcp/127.0.0.1:{free_port()}", list[str]()
    server = ServerLink(address, on_nonsense=nonsense.append)
    try:
        with NodeLink(address, "front") as link:
            wait_until("it is connected", lambda: server.probe_clock(link.node) != [])
            replies = list(server._session.get(of_node("record", link.node), payload=b"{}", timeout=10.0))
            assert [reply.ok for reply in replies] == [None]
            assert replies[0].err is not None
            assert b"request for frames" in replies[0].err.payload.to_bytes()
            link.publish(frame("front", 0))
            got, answers, ended = list[bytes](), list[FrameAnswer](), threading.Event()
            request = FrameRequest("take", 0, wanted=[(0, 9)])
            server.request_frames(link.node, request, lambda *one: got.append(one[1]), answers.append, ended.set)
            assert ended.wait(30.0)
            assert (len(got), answers) == (1, [FrameAnswer(1, 0, 0)])
            link.outbox.release("take")
    finally:
        server.close()
    assert nonsense == []


def test_memory_is_crowded_beyond_what_it_is_meant_for() -> None:
    outbox = Outbox(4)
    outbox.update(OPEN, 0)
    crowded = []
    for number in range(6):
        outbox.add(b"%d" % number, number)
        crowded.append(outbox.crowded)
    assert crowded == [False, False, False, False, True, True]


def test_an_answer_ends_with_the_frame_that_fills_it() -> None:
    outbox = Outbox(8)
    for number in range(8):
        outbox.add(bytes(1024 * 1024), number)
    assert sum(1 for _ in outbox.wanted(FrameRequest("take", 0, wanted=[(0, 7)]))) == 4


def test_frames_that_come_while_others_are_spilled_stay_in_memory() -> None:
    class Slow(Shelf):
        def write(self, first: int, frames: Sequence[bytes]) -> None:
            super().write(first, frames)
            outbox.add(b"4", 4)

    outbox = filled(4, shelf=Slow())
    outbox.update(OPEN, 0)
    assert outbox.spill()
    assert outbox.oldest == 0
    assert numbers(outbox, (0, 9)) == [0, 1, 2, 3, 4]


def test_frames_that_are_dropped_while_they_are_sent_end_the_answer() -> None:
    outbox = filled(4)
    asked = outbox.wanted(FrameRequest("take", 0, wanted=[(0, 3)]))
    assert next(asked) == b"0"
    outbox.add(b"4", 4)
    outbox.add(b"5", 5)  # no room for 1 any more
    assert list(asked) == []


def test_a_node_that_goes_on_with_earlier_numbers_has_none_of_their_frames() -> None:
    outbox = Outbox(10, first=100, lost=6)
    assert (outbox.next, outbox.oldest, outbox.frame(99)) == (100, 100, None)
    for k in range(100, 103):
        outbox.add(b"%d" % k, k)
    assert outbox.frame(100) == b"100"
    later, before = FrameRequest("later", None, 200 - 101), FrameRequest("before", None, 200 - 90)
    assert outbox.update(before, 200).first == 94  # it has the lost ones, too: they count as lost
    assert outbox.update(later, 200).first == 101
    assert outbox.oldest == 100
    outbox.release("later")
    outbox.release("before")
    for k in range(103, 120):
        outbox.add(b"%d" % k, k)
    assert outbox.update(FrameRequest("forgotten", None, 200 - 90), 200).first == 94


def test_frames_that_were_lost_before_the_first_spilled_ones_belong_to_a_take_that_began_before() -> None:
    outbox = Outbox(10, Shelf(), first=100, lost=6)
    outbox.update(FrameRequest("open", 100), 0)
    for k in range(100, 105):
        outbox.add(b"%d" % k, k)
    assert outbox.spill()
    assert outbox.update(FrameRequest("before", None, 200 - 90), 200).first == 94


def test_an_empty_outbox_has_nothing_to_drop() -> None:
    outbox = filled(0)
    outbox.drop_oldest()
    assert (outbox.dropped, outbox.next) == (0, 0)


def test_a_spooler_runs_only_while_a_take_is_open_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.wire.spool._EVERY_S", 0.001)
    shelf = Shelf()
    outbox = filled(2, shelf=shelf)
    spooler = Spooler(outbox, shelf, lambda text: None)
    updated = threading.Event()
    monkeypatch.setattr(spooler, "update", lambda now_ns: updated.set())
    spooler.begin()
    assert spooler._thread is None
    outbox.update(OPEN, 0)
    spooler.begin()
    thread = spooler._thread
    spooler.begin()
    assert spooler._thread is thread is not None
    assert updated.wait(60.0)
    spooler.close()
    assert not thread.is_alive()


def test_the_oldest_frame_has_waited_since_it_was_sent() -> None:
    outbox = Outbox(4)
    outbox.add(b"0", 100)
    outbox.add(b"1", 130)
    assert outbox.waiting_ns(150) == 0  # nobody waits for it
    outbox.update(OPEN, 140)
    assert outbox.waiting_ns(150) == 50


def test_a_take_that_is_released_leaves_the_newest_frames_in_memory_and_none_on_the_disk() -> None:
    shelf = Shelf()
    outbox = Outbox(4, shelf)
    outbox.update(OPEN, 0)
    for number in range(4):
        outbox.add(b"%d" % number, number)
    assert outbox.spill()
    for number in range(4, 10):
        outbox.add(b"%d" % number, number)
    outbox.release("take")
    assert shelf.parts == {}
    assert (outbox.oldest, outbox.next) == (6, 10)


def test_a_disk_that_was_full_for_a_while_costs_no_frame_that_was_stored_later() -> None:
    shelf = Shelf()
    outbox = filled(4, shelf=shelf)
    outbox.update(FrameRequest("take", 2), 0)
    spooler = Spooler(outbox, shelf, lambda text: None, lambda: 1)
    shelf.full = True
    spooler.update(int((NEGLECTED_S + 1) * 1e9))
    shelf.full = False
    outbox.update(FrameRequest("take", 4, end=4, closed=True), int((NEGLECTED_S + 2) * 1e9))
    spooler.close()
    assert (spooler.missing, shelf.kept) == (0, {})
