"""The record path of a take: acknowledges stored frames to their nodes, and requests missing ones.

One request to a node is under way at a time. It acknowledges what the last commit stored, and lists the gaps; the
answer has those frames in order and the number of the node's next frame. So a take is complete once each node has said
its end and nothing before it is missing. A clock is only used to wait for frames that may still be on their way.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

from mocapella.live.recorder import NodeState, Recorder
from mocapella.recording.ledger import NodeLedger
from mocapella.supervision import Boundary
from mocapella.wire.delivery import FrameAnswer, FrameRequest
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import REQUEST_TIMEOUT_S, OnFrame

ON_THE_WAY_S: Final = 0.3
"""A frame that has not arrived this long after its node said that it was sent is requested [s]."""
ASK_EVERY_S: Final = 1.0
"""A node without news is asked this often for the number of its next frame [s]."""
GIVE_UP_S: Final = 5.0
"""The end of a take waits this long for the next missing frame, or for a node's answer [s]."""
CLOSE_S: Final = 1.0
"""How long the end of a take waits for its nodes to hear of it [s]."""
_POLL_S: Final = 0.25
EVER_NS: Final = 2**61
"""Age of a resumed take: a node that it does not know sends all frames that it has."""
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
        """Ask a node for missing frames, and return at once (`mocapella.wire.server.ServerLink.request_frames`)."""
        ...


@dataclass
class _Contact:
    """What is known of the requests to one node; times are monotonic [s].

    Attributes:
        under_way: whether a request is not answered yet.
        answered: whether the node has ever answered.
        mute: whether the node answers no requests, like a program that only publishes frames.
        asked_s: when the last request was sent.
        told: the last state that the node was told.
        settled: frames below this number were sent so long ago that they are missing if they are not here.
        mark, mark_s: number of the next frame in an earlier answer, which becomes ``settled`` in time.
    """

    under_way: bool = False
    answered: bool = False
    mute: bool = False
    asked_s: float = float("-inf")
    told: tuple[int, int | None] | None = None
    settled: int = 0
    mark: int = 0
    mark_s: float = float("-inf")

    def hear(self, next_number: int, now_s: float) -> None:
        """Take over the number of the node's next frame."""
        self.answered, self.mute = True, False
        if now_s - self.mark_s >= ON_THE_WAY_S:
            self.settled, self.mark, self.mark_s = self.mark, next_number, now_s


class RecordPath:
    """Requests a take's missing frames from their nodes, and acknowledges stored ones, until `finish`.

    The constructor starts a thread for it.

    Args:
        recorder: of the take; its ``committed`` callback is replaced.
        link: to the nodes.
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
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._finishing, self._hurry = False, hurry or threading.Event()
        self._errors = Boundary()
        recorder.committed = self._wake.set
        self._thread = threading.Thread(target=self._run, name="record-path")
        self._thread.start()

    def leaving(self, node: NodeKey, end: int) -> None:
        """Note ``end``, the number after the last frame of a node that leaves; ignored if it is implausibly high."""
        if self._recorder.believes(node, end):
            self._recorder.account(node, partial(_finish, first=self._first.get(node), end=end))
        self._wake.set()

    def finish(self, give_up_s: float | None = None) -> None:
        """Ask every connected node for its last frame, and wait until all frames are here or are given up.

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

    def close(self) -> None:
        """Tell the connected nodes the result, after `finish` and the recorder's `close`; wait up to `CLOSE_S`.

        Frames that the nodes still keep for the take are not requested any more.
        """
        ended = [self._close_at(node, state) for node in self._nodes() if (state := self._state(node)) is not None]
        deadline = time.monotonic() + CLOSE_S
        for event in ended if not self._hurry.is_set() else ():
            event.wait(max(0.0, deadline - time.monotonic()))

    def _close_at(self, node: NodeKey, state: NodeState) -> threading.Event:
        ended = threading.Event()
        request = FrameRequest(self._recorder.take_id, state.stored, end=state.end, closed=True)
        self._link.request_frames(node, request, lambda *_: None, lambda answer: None, ended.set)
        return ended

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wake.wait(_POLL_S)
            self._wake.clear()
            for node in self._nodes():
                self._errors.run("request for frames", partial(self._ask, node))

    def _ask(self, node: NodeKey) -> None:
        contact = self._contacts.setdefault(node, _Contact())
        now_s, state = time.monotonic(), self._state(node)
        if contact.under_way:
            return
        request = self._request(state, contact, node)
        told = None if request.stored is None else (request.stored, request.end)
        ends = self._finishing and (state is None or state.end is None)
        urgent = self._finishing and (state is None or not state.whole)
        news = (told != contact.told if told is not None else not contact.mute) or bool(request.wanted) or urgent
        if not news and now_s - contact.asked_s < ASK_EVERY_S:
            return
        contact.under_way, contact.asked_s, contact.told = True, now_s, told
        answered = partial(self._answered, node, contact, agreed=told is not None, ends=ends)
        sent_again = partial(self._recorder.sent_again, request.wanted)
        self._link.request_frames(node, request, sent_again, answered, partial(self._ended, contact))

    def _request(self, state: NodeState | None, contact: _Contact, node: NodeKey) -> FrameRequest:
        first = self._first.get(node)
        if first is not None and (state is None or not state.agreed):
            self._recorder.account(node, partial(_expect, first=first))
        age_ns = time.monotonic_ns() - self._began_ns if self._fresh else EVER_NS
        busy = self._recorder.crowded or self._recorder.failed
        settled = (
            _EVERYTHING if state is not None and state.end is not None and not self._finishing else contact.settled
        )
        return request_of(self._recorder.take_id, state, first, age_ns, 0 if busy else settled)

    def _answered(self, node: NodeKey, contact: _Contact, answer: FrameAnswer, *, agreed: bool, ends: bool) -> None:
        if not self._recorder.believes(node, answer.next):
            return
        contact.hear(answer.next, time.monotonic())
        end = answer.next if ends or answer.leaving else None
        first = None if agreed else answer.first
        self._recorder.account(node, partial(hear_answer, answer=answer, first=first, end=end))

    def _ended(self, contact: _Contact) -> None:
        contact.mute = not contact.answered and time.monotonic() - contact.asked_s < REQUEST_TIMEOUT_S / 2
        contact.under_way = False  # the next commit wakes the thread, with a state that has the frames of the answer

    def _state(self, node: NodeKey) -> NodeState | None:
        return self._recorder.states.get(node)

    def _whole(self) -> bool:
        """Whether every connected node has said its end and nothing is missing; a failed take only needs the ends."""
        mute = {node for node, contact in list(self._contacts.items()) if contact.mute}
        states = [self._state(node) for node in self._nodes() if node not in mute]
        if self._recorder.failed:
            return all(state is not None and state.end is not None for state in states)
        return all(state is not None and state.whole for state in states)

    def _progress(self) -> list[tuple[int, int | None]]:
        return [(state.stored, state.end) for state in self._recorder.states.values()]


def request_of(take: str, state: NodeState | None, first: int | None, age_ns: int, settled: int) -> FrameRequest:
    """Return the next request to a node.

    Args:
        take: identity of the take.
        state: of the node's frames at the last commit; None if none has come.
        first: number of the node's first frame that belongs to the take, if it was known when the take began.
        age_ns: time since the take began, which decides the first frame if it is not known.
        settled: frames below this number are not on their way any more.
    """
    if state is None or not state.agreed:
        return FrameRequest(take, first, age_ns=age_ns)
    wanted = [(begin, min(last, settled - 1)) for begin, last in state.gaps if begin < settled]
    return FrameRequest(take, state.stored, end=state.end, wanted=wanted)


def hear_answer(ledger: NodeLedger, *, answer: FrameAnswer, first: int | None, end: int | None) -> bool:
    """Update the account of a node's frames by the node's answer; return whether the take must store the account.

    Args:
        ledger: the account.
        answer: of the node.
        first: number of the node's first frame that belongs to the take; None if node and server have agreed on one.
        end: number after the node's last frame that belongs to the take; None while more may follow.
    """
    news = first is not None and _expect(ledger, first=first)
    ledger.hear(answer.next, answer.oldest)
    return (end is not None and ledger.finish(end)) or news


def _expect(ledger: NodeLedger, *, first: int) -> bool:
    return not ledger.agreed and ledger.expect(first)


def _finish(ledger: NodeLedger, *, first: int | None, end: int) -> bool:
    news = first is not None and _expect(ledger, first=first)
    return ledger.finish(end) or news
