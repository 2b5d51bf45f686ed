"""The record path of a take: acknowledges stored frames to their nodes, and requests missing ones.

A request acknowledges what the last commit stored, and lists the gaps; the answer has those frames in order and the
number of the node's next frame. After an outage, several requests to a node are under way, each for other frames. A
take is complete once the last frame of each node is known and none before it is missing. Times are used only to wait
for frames that may still be on their way. Frames are identified by sequence number, called number here.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

from mocapella.live.recorder import NodeState, Recorder, WantedFrames
from mocapella.recording.ledger import NodeLedger
from mocapella.supervision import Boundary
from mocapella.wire.delivery import MOST_FRAMES, MOST_GAPS, FrameAnswer, FrameRequest
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import REQUEST_TIMEOUT_S, OnFrame

ON_THE_WAY_S: Final = 0.3
"""A frame is requested if it has not arrived this long after its node reported it as sent [s]."""
ASK_EVERY_S: Final = 1.0
"""Interval of requests to a node without missing frames, for the number of its next frame [s]."""
GIVE_UP_S: Final = 5.0
"""The end of a take waits this long for the next missing frame, or for a node's answer [s]."""
CLOSE_S: Final = 1.0
"""Longest wait for the nodes' answers to the message that a take is closed [s]."""
_POLL_S: Final = 0.25
MOST_REQUESTS: Final = 4
"""Largest number of requests to one node that are under way at the same time."""
MOST_UNTOLD: Final = 256
"""Largest number of nodes that are remembered because they have missed the end of a take."""
EVER_NS: Final = 2**61
"""Age stated for a resumed take, so that all frames of a node that it does not know belong to it [ns]."""
_EVERYTHING: Final = 2**62


class Requests(Protocol):
    """The part of a server's link that `RecordPath` uses; a test replaces it."""

    def request_frames(
        self,
        node: NodeKey,
        request: FrameRequest,
        on_frame: OnFrame,
        on_answer: Callable[[FrameAnswer], None],
        on_end: Callable[[], None],
    ) -> None:
        """Ask a node for missing frames, and return at once.

        Args:
            node: the node.
            request: the frames to send, and the numbers of the stored ones.
            on_frame: called with each frame in order: node, encoded frame, arrival on the monotonic clock [ns].
            on_answer: called once with the state of the node's frames, if it answers in time.
            on_end: called last, in any case.
        """
        ...


class _Batch:
    """Frames that one request asks for.

    Attributes:
        wanted: the frames.
        count: number of frames that the answer has brought.
        answered: whether the answer is complete.
        landed: whether the recorder has taken what the answer brought; the next commit stores it.
    """

    def __init__(self, ranges: Sequence[tuple[int, int]]) -> None:
        self.wanted = WantedFrames(ranges)
        self.size = sum(last - first + 1 for first, last in ranges)
        self.count = 0
        self.answered = self.landed = False

    def land(self, _ledger: NodeLedger) -> bool:
        """Set ``landed``, on the recorder's thread; the ledger does not change."""
        self.landed = True
        return False


@dataclass
class _Contact:
    """What is known of the requests to one node; times are monotonic [s].

    Attributes:
        under_way: number of requests that are not answered yet.
        batches: frames that were asked for, and are not stored yet as far as known.
        most: requests that may be under way at the same time: fewer on a slow link.
        frames: frames that one request asks for: fewer if an answer has no room for more.
        answered: whether the node has ever answered.
        mute: whether the node answers no requests, like a program that only publishes frames.
        asked_s: when the last request was sent.
        told: the last state that the node was told.
        settled: frames below this number were sent so long ago that they are missing if they are not here.
        mark, mark_s: number of the next frame in an earlier answer, which becomes ``settled`` in time.
    """

    under_way: int = 0
    batches: tuple[_Batch, ...] = ()
    most: int = MOST_REQUESTS
    frames: int = MOST_FRAMES
    answered: bool = False
    mute: bool = False
    asked_s: float = float("-inf")
    told: tuple[int, int | None] | None = None
    settled: int = 0
    mark: int = 0
    mark_s: float = float("-inf")

    def hear(self, next_number: int, now_s: float) -> None:
        """Note the number of the node's next frame, and update ``settled``."""
        self.answered, self.mute = True, False
        if now_s - self.mark_s >= ON_THE_WAY_S:
            self.settled, self.mark, self.mark_s = self.mark, next_number, now_s

    def learn(self, batch: _Batch) -> None:
        """Adapt the size and number of requests to what an answer has brought."""
        if not batch.answered:  # too much for the time, as on a slow link
            self.most, self.frames = 1, max(1, min(batch.count, self.frames) // 2)
        elif batch.count == 0:  # the node cannot read them now
            self.most = 1
        elif batch.count < batch.size:  # too large for one answer
            self.frames = batch.count
        else:
            self.most, self.frames = min(self.most + 1, MOST_REQUESTS), min(2 * self.frames, MOST_FRAMES)


class RecordPath:
    """Requests a take's missing frames from their nodes, and acknowledges stored ones, until `finish`.

    The constructor starts a thread for it.

    Args:
        recorder: recorder of the take; its ``committed`` callback is replaced.
        link: sends requests to the nodes.
        nodes: returns the connected nodes.
        first: number of the first frame of each node that belongs to the take, where it is known.
        fresh: whether the take is new; else nodes that it does not know are asked for all their frames.
        hurry: while it is set, `finish` and `close` do not wait for nodes; None never hurries.
    """

    def __init__(
        self,
        recorder: Recorder,
        link: Requests,
        nodes: Callable[[], Iterable[NodeKey]],
        first: Mapping[NodeKey, int],
        *,
        fresh: bool,
        hurry: threading.Event | None = None,
    ) -> None:
        self._recorder, self._link, self._nodes = recorder, link, nodes
        self._first, self._fresh = dict(first), fresh
        self._began_ns = time.monotonic_ns()
        self._contacts: dict[NodeKey, _Contact] = {}
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._finishing, self._hurry = False, hurry or threading.Event()
        self._errors = Boundary()
        recorder.committed = self._committed
        self._thread = threading.Thread(target=self._run, name="record-path")
        self._thread.start()

    def leaving(self, node: NodeKey, end: int) -> None:
        """Note ``end``, the number after the last frame of a node that leaves; ignored if it is implausibly high."""
        if self._recorder.believes(node, end):
            self._recorder.account(node, partial(_leave, first=self._first.get(node), end=end))
        self._wake.set()

    def finish(self, give_up_s: float | None = None) -> None:
        """Ask every connected node for its last frame, and wait until no frame is missing, or no more arrive.

        Args:
            give_up_s: how long to wait without progress; `GIVE_UP_S` if None [s].
        """
        give_up_s = GIVE_UP_S if give_up_s is None else give_up_s
        self._finishing = True
        self._wake.set()
        before, since_s = self._progress(), time.monotonic()
        while not (self._whole() or self._hurry.is_set()) and time.monotonic() - since_s < give_up_s:
            time.sleep(0.02)
            now = self._progress()
            if now != before:
                before, since_s = now, time.monotonic()
        self._stop.set()
        self._wake.set()
        self._thread.join()

    def close(self, closed: ClosedTakes) -> None:
        """Tell the take's nodes that it is closed, after `finish` and the recorder's `close`; wait up to `CLOSE_S`.

        They learn which frames it lacks; these are not requested any more.

        Args:
            closed: sends the messages, later to nodes that do not answer now.
        """
        mute = {node for node, contact in list(self._contacts.items()) if contact.mute}
        for node, state in self._recorder.states.items():
            if node in mute:  # it answers nothing
                continue
            closed.add(node, FrameRequest(self._recorder.take_id, state.stored, end=state.end, closed=True))
        told = closed.tell(self._nodes())
        deadline = time.monotonic() + CLOSE_S
        for event in told if not self._hurry.is_set() else ():
            event.wait(max(0.0, deadline - time.monotonic()))

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wake.wait(_POLL_S)
            self._wake.clear()
            for node in self._nodes():
                self._errors.run("request for frames", partial(self._ask, node))

    def _committed(self) -> None:
        """Forget the requests whose frames are stored now; runs on the recorder's thread."""
        with self._lock:
            for contact in self._contacts.values():
                contact.batches = tuple(batch for batch in contact.batches if not batch.landed)
        self._wake.set()

    def _ask(self, node: NodeKey) -> None:
        with self._lock:
            contact = self._contacts.setdefault(node, _Contact())
        while self._ask_once(node, contact):
            pass

    def _ask_once(self, node: NodeKey, contact: _Contact) -> bool:
        """Send a request if one is due; return whether a further one may be."""
        batches = contact.batches  # before the state, which then has all frames of the forgotten ones
        now_s, state = time.monotonic(), self._state(node)
        request = self._request(state, contact, node, batches)
        if contact.under_way and not (request.wanted and contact.under_way < contact.most):
            return False
        told = None if request.stored is None else (request.stored, request.end)
        ends = self._finishing and (state is None or state.end is None)
        urgent = self._finishing and (state is None or not state.whole)
        news = (told != contact.told if told is not None else not contact.mute) or bool(request.wanted) or urgent
        if not news and now_s - contact.asked_s < ASK_EVERY_S:
            return False
        batch = _Batch(request.wanted)
        with self._lock:
            contact.under_way += 1
            contact.asked_s, contact.told = now_s, told
            contact.batches += (batch,) if batch.size else ()
        answered = partial(self._answered, node, contact, batch, agreed=told is not None, ends=ends)
        sent_again = partial(self._sent_again, batch)
        self._link.request_frames(node, request, sent_again, answered, partial(self._ended, node, contact, batch))
        return batch.size > 0

    def _sent_again(self, batch: _Batch, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        batch.count += 1
        self._recorder.sent_again(batch.wanted, node, data, arrived_ns)

    def _request(
        self, state: NodeState | None, contact: _Contact, node: NodeKey, batches: Sequence[_Batch]
    ) -> FrameRequest:
        first = self._first.get(node)
        if first is not None and (state is None or not state.agreed):
            self._recorder.account(node, partial(_expect, first=first))
        age_ns = time.monotonic_ns() - self._began_ns if self._fresh else EVER_NS
        busy = self._recorder.crowded or self._recorder.failed
        settled = (
            _EVERYTHING if state is not None and state.end is not None and not self._finishing else contact.settled
        )
        under_way = [asked for batch in batches for asked in batch.wanted.ranges]
        settled = 0 if busy else settled
        return request_of(
            self._recorder.take_id, state, first, age_ns, settled, under_way=under_way, most=contact.frames
        )

    def _answered(
        self, node: NodeKey, contact: _Contact, batch: _Batch, answer: FrameAnswer, *, agreed: bool, ends: bool
    ) -> None:
        batch.answered = True
        if not self._recorder.believes(node, answer.next):
            return
        contact.hear(answer.next, time.monotonic())
        end = answer.next if ends or answer.leaving else None
        first = None if agreed else answer.first
        wanted = batch.wanted.ranges
        self._recorder.account(node, partial(hear_answer, answer=answer, first=first, end=end, wanted=wanted))

    def _ended(self, node: NodeKey, contact: _Contact, batch: _Batch) -> None:
        contact.mute = not contact.answered and time.monotonic() - contact.asked_s < REQUEST_TIMEOUT_S / 2
        if batch.size:
            contact.learn(batch)
            self._recorder.account(node, batch.land)
        with self._lock:
            contact.under_way -= 1
        # The next commit wakes the thread, with a state that has the frames of the answer.

    def _state(self, node: NodeKey) -> NodeState | None:
        return self._recorder.states.get(node)

    def _whole(self) -> bool:
        """Whether the end of every connected node is known and, unless the recording failed, no frame is missing."""
        mute = {node for node, contact in list(self._contacts.items()) if contact.mute}
        states = [self._state(node) for node in self._nodes() if node not in mute]
        if self._recorder.failed:
            return all(state is not None and state.end is not None for state in states)
        return all(state is not None and state.whole for state in states)

    def _progress(self) -> list[tuple[int, int | None]]:
        return [(state.stored, state.end) for state in self._recorder.states.values()]


class ClosedTakes:
    """Tells nodes that a take is closed, absent nodes as soon as they are connected again.

    Until a node is told, it keeps its frames for the take. Any thread may call the methods.

    Args:
        link: sends the messages to the nodes.
    """

    def __init__(self, link: Requests) -> None:
        self._link = link
        self._untold: dict[tuple[NodeKey, str], FrameRequest] = {}
        self._asked_s: dict[tuple[NodeKey, str], float] = {}
        self._lock = threading.Lock()

    def add(self, node: NodeKey, request: FrameRequest) -> None:
        """Queue a message that tells a node that its take is closed; it replaces an earlier one about the same take.

        Of more than `MOST_UNTOLD` messages to all nodes, the oldest is discarded: its node keeps its frames.

        Args:
            node: the node.
            request: the message.
        """
        with self._lock:
            self._untold[node, request.take] = request
            while len(self._untold) > MOST_UNTOLD:
                self._asked_s.pop(forgotten := next(iter(self._untold)), None)
                del self._untold[forgotten]

    def forget(self, take: str) -> None:
        """Discard the messages about a take, because it is resumed."""
        with self._lock:
            for key in [key for key in self._untold if key[1] == take]:
                self._asked_s.pop(key, None)
                del self._untold[key]

    def tell(self, nodes: Iterable[NodeKey]) -> list[threading.Event]:
        """Send the messages to connected nodes, each at most every `ASK_EVERY_S`.

        Return an event for each sent message, which is set when it is answered or has failed.
        """
        if not self._untold:
            return []
        connected, now_s = set(nodes), time.monotonic()
        with self._lock:
            due = {
                key: request
                for key, request in self._untold.items()
                if key[0] in connected and now_s - self._asked_s.get(key, float("-inf")) >= ASK_EVERY_S
            }
            self._asked_s |= dict.fromkeys(due, now_s)
        told: list[threading.Event] = []
        for key, request in due.items():
            told.append(threading.Event())
            self._link.request_frames(key[0], request, lambda *_: None, partial(self._heard, key), told[-1].set)
        return told

    def _heard(self, key: tuple[NodeKey, str], _answer: FrameAnswer) -> None:
        with self._lock:
            self._untold.pop(key, None)
            self._asked_s.pop(key, None)


def request_of(
    take: str,
    state: NodeState | None,
    first: int | None,
    age_ns: int,
    settled: int,
    *,
    under_way: Sequence[tuple[int, int]] = (),
    most: int = MOST_FRAMES,
) -> FrameRequest:
    """Return the next request to a node.

    Args:
        take: identity of the take.
        state: state of the node's frames at the last commit; None if none has come.
        first: number of the node's first frame that belongs to the take; None if it was unknown when the take began.
        age_ns: time since the take began [ns]; the node determines the first frame from it if ``first`` is None.
        settled: frames below this number can be requested, because they are not on their way any more.
        under_way: (first, last) of frames that were asked for already.
        most: largest number of frames to ask for.
    """
    if state is None or not state.agreed:
        return FrameRequest(take, first, age_ns=age_ns)
    wanted: list[tuple[int, int]] = []
    for begin, end in _without(state.gaps, under_way):
        last = min(end, settled - 1, begin + most - 1)
        if begin <= last and len(wanted) < MOST_GAPS:
            wanted.append((begin, last))
            most -= last - begin + 1
    return FrameRequest(take, state.stored, end=state.end, wanted=wanted)


def _without(gaps: Iterable[tuple[int, int]], taken: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield what remains of ranges (first, last) without others."""
    for first, last in gaps:
        rest = first
        for begin, end in sorted(taken):
            if rest <= end and begin <= last:
                if rest < begin:
                    yield rest, begin - 1
                rest = end + 1
        if rest <= last:
            yield rest, last


def hear_answer(
    ledger: NodeLedger,
    *,
    answer: FrameAnswer,
    first: int | None,
    end: int | None,
    wanted: Sequence[tuple[int, int]] = (),
) -> bool:
    """Update the ledger of a node's frames by the node's answer; return whether the take must store the ledger.

    Args:
        ledger: sent, stored and lost frames of the node (`mocapella.recording.ledger`); updated.
        answer: the node's answer to a request.
        first: number of the node's first frame that belongs to the take; None if node and server have agreed on one.
        end: number after the node's last frame that belongs to the take; None while more may follow.
        wanted: (first, last) of the frames that the node was asked for; frames that it cannot read are given up.
    """
    news = first is not None and _expect(ledger, first=first)
    ledger.hear(answer.next, answer.oldest)
    for begin, last in wanted:
        for gone_first, gone_last in answer.gone:
            for number in range(max(begin, gone_first), min(last, gone_last) + 1):
                ledger.give_up(number)
    return (end is not None and ledger.finish(end, left=answer.leaving)) or news


def _expect(ledger: NodeLedger, *, first: int) -> bool:
    return not ledger.agreed and ledger.expect(first)


def _leave(ledger: NodeLedger, *, first: int | None, end: int) -> bool:
    news = first is not None and _expect(ledger, first=first)
    return ledger.finish(end, left=True) or news
