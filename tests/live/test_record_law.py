"""The law of the record path, on a model of its parts: *sent = stored + lost*, each frame once, nothing acknowledged
lost. Node and server are killed at any point; messages are dropped, repeated and reordered."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from support.take_making import frame_bytes, info

from mocapella.errors import RecordingError
from mocapella.live.record_path import EVER_NS, hear_answer, request_of
from mocapella.live.recorder import NodeState, state_of
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.wire.delivery import FrameRequest
from mocapella.wire.outbox import Outbox

NODE = ("front", 7)
EVERYTHING = 2**62
FRAMES = [frame_bytes(NODE[0], number, NODE[1]) for number in range(256)]


class Shelf:
    """In place of a disk: a dictionary, which may refuse."""

    def __init__(self) -> None:
        self.parts: dict[int, list[bytes]] = {}
        self.full = False

    def write(self, first: int, frames: Sequence[bytes]) -> None:
        if self.full:
            raise RecordingError("full")
        self.parts[first] = list(frames)

    def read(self, first: int) -> Sequence[bytes]:
        return self.parts[first]

    def remove(self, first: int) -> None:
        del self.parts[first]


class RecordPathModel(RuleBasedStateMachine):
    """A node, a server with a real take on the disk, and a bus that loses, repeats and reorders."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name) / "take.mcap"
        self.shelf = Shelf()
        self.outbox = Outbox(4, self.shelf)
        self.alive = True
        self.now_ns = 0
        self.flying: list[int] = []
        self.acknowledged = self.first = 0
        self.given_up: set[int] = set()
        self.requests: list[FrameRequest] = []
        self.before: int | None = None
        self.held_since: int | None = None
        self.writer: TakeWriter | None = None
        self.state: NodeState | None = None

    @initialize(before=st.integers(0, 6))
    def begin(self, before: int) -> None:
        """The node may have sent frames before the take began, which the server knows of."""
        for _ in range(before):
            self.send()
        self.flying.clear()
        self.before = self.first = before
        self.begin_take(0)

    def begin_take(self, started_ns: int) -> None:
        self.writer = TakeWriter.resume_or_create(self.path, info=info(started_ns), reserve_bytes=0)
        ledger = self.writer.accounts.nodes.get(NODE)
        self.state = None if ledger is None else state_of(ledger)

    @precondition(lambda self: self.alive)
    @rule()
    def send(self) -> None:
        self.now_ns += 1
        self.flying.append(self.outbox.next)
        self.outbox.add(FRAMES[self.outbox.next], self.now_ns)

    @precondition(lambda self: self.flying)
    @rule(data=st.data(), repeated=st.booleans(), lost=st.booleans())
    def carry(self, data: st.DataObject, repeated: bool, lost: bool) -> None:
        """One frame of the live path arrives, in any order, or never."""
        number = data.draw(st.sampled_from(self.flying))
        if not repeated:
            self.flying.remove(number)
        if not lost:
            self.arrive(number)

    def arrive(self, number: int) -> None:
        if self.writer is not None and number >= (self.before or 0):
            self.writer.write_frame(
                FRAMES[number], sensor=NODE[0], node_id=NODE[1], sequence=number, log_ns=self.now_ns
            )

    @precondition(lambda self: self.writer is not None)
    @rule()
    def commit(self) -> None:
        assert self.writer is not None
        self.writer.flush()
        if NODE in self.writer.accounts.nodes:
            self.state = state_of(self.writer.accounts.nodes[NODE])

    @precondition(lambda self: self.flying and self.writer is not None)
    @rule(data=st.data())
    def cannot_be_written(self, data: st.DataObject) -> None:
        """A frame arrives that the take cannot hold."""
        assert self.writer is not None
        number = data.draw(st.sampled_from(self.flying))
        self.flying.remove(number)
        self.writer.accounts.change(NODE, lambda ledger: ledger.give_up(number))
        self.given_up.add(number)

    @precondition(lambda self: self.alive and self.requests)
    @rule(data=st.data())
    def repeat_request(self, data: st.DataObject) -> None:
        """A request reaches the node again, or late; its answer is lost."""
        self.outbox.update(data.draw(st.sampled_from(self.requests)), self.now_ns)

    @precondition(lambda self: self.alive and self.writer is not None and self.state is not None)
    @rule(told=st.booleans(), whole=st.booleans(), sends_on=st.integers(0, 8))
    def kill_server_that_closes_its_take(self, told: bool, whole: bool, sends_on: int) -> None:
        """The take's end is on the disk, and the node may have heard it; yet the take goes on later."""
        assert self.writer is not None
        end = self.outbox.next
        self.writer.accounts.change(NODE, lambda ledger: ledger.finish(end))
        self.commit()
        if whole:
            self.ask(1000, True, False)
            self.commit()
        if told:
            self.ask(0, False, False)
        self.kill_server()
        for _ in range(sends_on):
            self.send()

    def request(self, under_way: Sequence[tuple[int, int]] = (), most: int = 256) -> FrameRequest:
        assert self.writer is not None
        made = request_of(
            self.writer.take_id, self.state, self.before, EVER_NS, EVERYTHING, under_way=under_way, most=most
        )
        self.requests.append(made)
        return made

    @precondition(lambda self: self.alive and self.writer is not None and self.state is not None)
    @rule(most=st.integers(1, 5), backwards=st.booleans())
    def ask_for_several(self, most: int, backwards: bool) -> None:
        """Requests that are under way at the same time ask for different frames; answers come in any order."""
        first = self.request(most=most)
        second = self.request(first.wanted, most)
        assert not {n for a, b in first.wanted for n in range(a, b + 1)} & {
            n for a, b in second.wanted for n in range(a, b + 1)
        }
        for request in (second, first) if backwards else (first, second):
            self.outbox.update(request, self.now_ns)
            self.acknowledged = max(self.acknowledged, request.stored or 0)
            for frame in self.outbox.wanted(request):
                self.arrive(FRAMES.index(frame))

    @precondition(lambda self: self.alive and self.writer is not None)
    @rule(arriving=st.integers(0, 12), answered=st.booleans(), ends=st.booleans())
    def ask(self, arriving: int, answered: bool, ends: bool) -> None:
        """A request reaches the node; only some of the frames of its answer, or not all of it, come back."""
        assert self.writer is not None
        request = self.request()
        agreed = request.stored is not None
        if self.before is not None:
            self.writer.accounts.change(NODE, lambda ledger: not ledger.agreed and ledger.expect(self.before or 0))
        if self.held_since is None:
            self.held_since = self.outbox.oldest
        answer = self.outbox.update(request, self.now_ns)
        self.acknowledged = max(self.acknowledged, request.stored or 0)
        for frame in list(self.outbox.wanted(request))[:arriving]:
            self.arrive(FRAMES.index(frame))
        if answered:
            end = answer.next if ends and answer.leaving else None
            first = None if agreed else answer.first
            self.writer.accounts.change(NODE, lambda ledger: hear_answer(ledger, answer=answer, first=first, end=end))

    @precondition(lambda self: self.alive)
    @rule(full=st.booleans())
    def spill(self, full: bool) -> None:
        self.shelf.full = full
        if not self.outbox.spill() and self.outbox.crowded:
            self.outbox.drop_oldest()

    @precondition(lambda self: self.writer is not None)
    @rule()
    def kill_server(self) -> None:
        """What was not committed is gone; a later start resumes the take."""
        assert self.writer is not None
        for fd in {self.writer._fd, self.writer._lock_fd} - {None}:
            os.close(fd)
        self.writer, self.before, self.state = None, None, None
        self.flying.clear()

    @precondition(lambda self: self.writer is None)
    @rule()
    def restart_server(self) -> None:
        self.begin_take(self.now_ns)

    @precondition(lambda self: self.alive)
    @rule()
    def kill_node(self) -> None:
        self.alive = False

    @invariant()
    def nothing_acknowledged_is_lost(self) -> None:
        if self.path.exists() and self.path.stat().st_size:
            there = read_numbers(self.path)
            assert len(there) == len(set(there))
            missing = set(range(self.first, self.acknowledged)) - set(there)
            gone = range(self.outbox.oldest) if self.outbox.dropped else ()
            assert missing <= set(gone) | self.given_up
            assert len(missing - self.given_up) <= self.outbox.dropped

    def teardown(self) -> None:
        try:
            self.end()
        finally:
            self.folder.cleanup()

    def end(self) -> None:
        """The take ends: what its node, if it lives, still has is fetched, and the sum must be exact."""
        if self.before is None and self.writer is None and not self.path.exists():
            return
        if self.writer is None:
            self.restart_server()
        writer = self.writer
        assert writer is not None
        sent, oldest = self.outbox.next, self.outbox.oldest
        if self.alive:
            self.outbox.leave()
            for _ in range(60):
                self.ask(1000, True, True)
                self.commit()
        writer.accounts.agree_on_all()
        report = writer.close()
        there = read_numbers(self.path)
        stored, lost = len(there), sum(report.lost.values())
        assert sum(report.frames.values()) == stored == len(set(there))
        take = read_take(self.path)
        nodes = take.complete()
        if self.alive:
            first = nodes[0].first
            assert first in (self.first, 0)  # 0: the server was killed before it had stored which the first was
            assert sent - first == stored + lost
            missing = set(range(first, sent)) - set(there)
            assert missing <= set(range(oldest)) | self.given_up  # only what the node had no longer
            held = range(self.held_since or 0, sent)  # all frames from the first request on, but for those dropped
            assert len(missing & set(held) - self.given_up) <= self.outbox.dropped
            assert take.clean
        elif nodes:
            assert [end.after for end in report.unknown] == [nodes[0].last]
            assert not take.clean
            assert not report.clean
            assert lost + stored == nodes[0].last + 1 - nodes[0].first <= sent


def read_numbers(path: Path) -> list[int]:
    return [ref.sequence for ref in read_take(path)._index.frames]


RecordPathModel.TestCase.settings = settings(max_examples=50, stateful_step_count=25, deadline=None)
TestRecordPath = RecordPathModel.TestCase
