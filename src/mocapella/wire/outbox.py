"""Frames that a node has sent and a recording server may still request, by sequence number; without threads or clocks.

Without a take, the newest frames are kept in memory. While a take is open, also while its server is away, every frame
from the first unacknowledged one on is kept: in memory first, then in a `Store`. If there is no more space, the oldest
frames are dropped and counted.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

from mocapella.conventions import NS_PER_S
from mocapella.errors import RecordingError
from mocapella.wire.delivery import MOST_ANSWER_BYTES, MOST_FRAMES, FrameAnswer, FrameRequest

READ_FOR_S: Final = 10.0
"""Time for which reading frames from a failing store is tried again before they count as lost [s]."""
MOST_TAKES: Final = 8
"""Largest number of open takes for which a node keeps frames."""


class Store(Protocol):
    """Interface of a place on the disk for frames that do not fit into memory (a spool); its fake is a dictionary."""

    def write(self, first: int, frames: Sequence[bytes]) -> None:
        """Store consecutive frames; ``first`` is the first one's number.

        Raises:
            RecordingError: there is no space, or the disk failed; nothing is stored.
        """
        ...

    def read(self, first: int) -> Sequence[bytes]:
        """Return the frames that `write` stored under the number ``first``.

        Raises:
            RecordingError: they cannot be read.
        """
        ...

    def remove(self, first: int) -> None:
        """Remove the frames that `write` stored under the number ``first``; an error of the disk is ignored."""
        ...


@dataclass(frozen=True)
class Hold:
    """A take's claim on a node's frames: they stay available until the take has stored them.

    Attributes:
        stored: number of the first frame that is not acknowledged.
        end: number after the take's last frame, once a server has ended the take or heard that the node leaves; else
            None.
        closed: whether the take is closed, and lacks the frames from ``stored`` on.
        first: number of the first frame that belongs to the take.
        heard_ns: when a server last asked for frames of the take, on the node's monotonic clock.
    """

    stored: int
    end: int | None = None
    closed: bool = False
    first: int = 0
    heard_ns: int = 0

    def numbers(self, after: int) -> range:
        """Return the numbers of the claimed frames; ``after`` is the number of the node's next frame.

        Until the take is closed, frames after ``end`` are included: if its server is killed, the take is resumed.
        """
        return range(self.stored, min(self.end, after) if self.closed and self.end is not None else after)


class _Sent(NamedTuple):
    data: bytes
    sent_ns: int


class _Spilled(NamedTuple):
    first: int
    last: int
    last_sent_ns: int


class Outbox:
    """The frames of one node that are still available: consecutive numbers up to the newest.

    Methods may be called on any thread.

    Args:
        most: number of frames to keep in memory; up to twice as many while a take needs them.
        store: keeps frames of an open take that do not fit into memory; None drops them.
        first: number of the first frame that will be added: above 0 for a node that goes on with earlier numbers.
        lost: number of frames directly before ``first`` that the node has lost. Takes that began before count them.

    Attributes:
        dropped: number of frames that a take needed, and that are no longer available.
    """

    def __init__(self, most: int, store: Store | None = None, *, first: int = 0, lost: int = 0) -> None:
        self.dropped = 0
        self._most, self._store = most, store
        self._lock = threading.RLock()
        self._spilled: deque[_Spilled] = deque()
        self._memory: deque[_Sent] = deque()
        self._first, self._begin = first, first - lost
        self._next = first
        self._forgotten_ns = -1
        self._holds: dict[str, Hold] = {}
        self._leaving = False
        self._read: tuple[int, Sequence[bytes]] = (-1, ())
        self._now_ns = 0
        self._failing_since: dict[int, int] = {}

    @property
    def next(self) -> int:
        """Number that the next frame will get."""
        return self._next

    @property
    def oldest(self) -> int:
        """Number of the oldest frame that is available; `next` if there is none."""
        return self._spilled[0].first if self._spilled else self._next - len(self._memory)

    @property
    def crowded(self) -> bool:
        """Whether more frames are in memory than the limit `most`, so that some must be spilled to the disk."""
        return len(self._memory) > self._most

    @property
    def spilled(self) -> bool:
        """Whether frames have been moved from memory to the store on the disk."""
        return bool(self._spilled)

    @property
    def holds(self) -> dict[str, Hold]:
        """Claims on the node's frames, by take: one for each take that may still need some."""
        with self._lock:
            return dict(self._holds)

    def add(self, data: bytes, sent_ns: int) -> None:
        """Add the next frame; ``sent_ns`` is on the node's monotonic clock."""
        with self._lock:
            self._memory.append(_Sent(data, sent_ns))
            self._next += 1
            if len(self._memory) > self._most:
                self._make_room()

    def leave(self) -> None:
        """Note that the node sends no further frame."""
        with self._lock:
            self._leaving = True

    def update(self, request: FrameRequest, now_ns: int) -> FrameAnswer:
        """Update a take's claim on the node's frames from a server's request; return the state of the node.

        A claim ends when the take has all frames of a node that leaves, or is closed and lacks none. Beyond
        `MOST_TAKES` takes, a new claim is ignored. A late or repeated request never takes an acknowledgement back, and
        does not change the take's first frame.

        Args:
            request: state of the take.
            now_ns: the present time on the node's monotonic clock [ns]; ``request.age_ns`` counts back from it.
        """
        with self._lock:
            known = self._holds.get(request.take)
            if known is not None:
                first = known.first
            else:
                first = self._since(now_ns - request.age_ns) if request.stored is None else request.stored
            stored = first if request.stored is None else request.stored
            stored = stored if known is None else max(stored, known.stored)
            hold = Hold(stored, request.end, request.closed, first, now_ns)
            if self._settled(hold):
                self._holds.pop(request.take, None)
            elif request.take in self._holds or len(self._holds) < MOST_TAKES:
                self._holds[request.take] = hold
            self._forget()
            self._now_ns = now_ns
            return FrameAnswer(self._next, self.oldest, first, self._leaving)

    def wanted(self, request: FrameRequest, gone: dict[tuple[int, int], str] | None = None) -> Iterator[bytes]:
        """Yield the requested frames that are available, in order, up to the limits of one answer.

        Args:
            request: has the numbers, in ``wanted``.
            gone: filled with the reason for each range (first, last) of frames that the store has failed to read for
                at least `READ_FOR_S` at the time of the last `update`; None drops the reasons.
        """
        count = size = 0
        for first, last in request.wanted:
            number = max(first, self.oldest)
            while number <= min(last, self._next - 1) and count < MOST_FRAMES and size < MOST_ANSWER_BYTES:
                try:
                    data = self.frame(number)
                except RecordingError as error:
                    part = self._part_of(number)
                    behind = min(part.last, last)
                    since_ns = self._failing_since.setdefault(part.first, self._now_ns)
                    if gone is not None and self._now_ns - since_ns >= READ_FOR_S * NS_PER_S:
                        gone[number, behind] = str(error)
                    number, count = behind + 1, count + 1
                    continue
                if data is None:  # dropped meanwhile
                    return
                yield data
                number, count, size = number + 1, count + 1, size + len(data)

    def frame(self, number: int) -> bytes | None:
        """Return a frame's bytes by its number; None if it is not available.

        Raises:
            RecordingError: the store cannot be read, or its content is damaged.
        """
        with self._lock:
            place = number - (self._next - len(self._memory))
            if not self.oldest <= number < self._next:
                return None
            if place >= 0:
                return self._memory[place].data
            part = self._part_of(number)
        return self._stored(part)[number - part.first]  # the disk is not waited for under the lock

    def _part_of(self, number: int) -> _Spilled:
        with self._lock:
            parts = (part for part in self._spilled if part.first <= number <= part.last)
            return next(parts, _Spilled(number, number, 0))  # else it was forgotten meanwhile

    def _stored(self, part: _Spilled) -> Sequence[bytes]:
        """Read a part, or return it if it was the last one that was read."""
        last = self._read
        if last[0] != part.first:
            assert self._store is not None
            last = part.first, self._store.read(part.first)
        if len(last[1]) != part.last - part.first + 1:
            raise RecordingError(f"spooled frames {part.first} to {part.last} are damaged; they count as lost")
        self._failing_since.pop(part.first, None)
        self._read = last
        return last[1]

    def frames(self, numbers: range) -> Iterator[tuple[int, bytes]]:
        """Yield number and bytes of the available frames among ``numbers``; unreadable ones are left out."""
        for number in numbers:
            try:
                data = self.frame(number)
            except RecordingError:
                continue
            if data is not None:
                yield number, data

    def release(self, take: str) -> None:
        """Drop the claim of a take."""
        with self._lock:
            self._holds.pop(take, None)
            self._forget()

    def waiting_ns(self, now_ns: int) -> int:
        """Return the age of the oldest frame in memory that waits for an acknowledgement [ns]; 0 without an open take.

        Args:
            now_ns: the present time on the node's monotonic clock [ns].
        """
        with self._lock:
            return now_ns - self._memory[0].sent_ns if self._holds and self._memory else 0

    def spill(self) -> bool:
        """Move the frames in memory that a take needs to the store.

        Return False if there are none, there is no store, or it fails. Frames can be added while the disk is written.
        """
        with self._lock:
            self._forget()
            first, frames = self._next - len(self._memory), list(self._memory)
        if not frames or not self._holds or self._store is None:
            return False
        try:
            self._store.write(first, [frame.data for frame in frames])
        except RecordingError:
            return False
        with self._lock:
            self._spilled.append(_Spilled(first, first + len(frames) - 1, frames[-1].sent_ns))
            while self._memory and self._next - len(self._memory) < first + len(frames):
                self._memory.popleft()
            self._forget()
        return True

    def drop_oldest(self) -> None:
        """Drop the oldest group of frames in the store, as written together, or else the oldest frame in memory."""
        with self._lock:
            if self._spilled:
                part = self._spilled[0]
                self._count_dropped(part.first, part.last)
                self._forget_spilled()
            elif self._memory:
                number = self._next - len(self._memory)
                self._count_dropped(number, number)
                self._forgotten_ns = self._memory.popleft().sent_ns

    def _make_room(self) -> None:
        """Drop frames beyond the limit `most`; while a take needs frames, beyond twice the limit, after spilling."""
        if not self._holds:
            self._forgotten_ns = self._memory.popleft().sent_ns
        elif len(self._memory) > 2 * self._most:
            while self._spilled:  # numbers stay consecutive
                self.drop_oldest()
            self.drop_oldest()

    def _count_dropped(self, first: int, last: int) -> None:
        for hold in self._holds.values():
            needed = hold.numbers(self._next)
            self.dropped += max(0, min(last + 1, needed.stop) - max(first, needed.start))

    def _settled(self, hold: Hold) -> bool:
        over = hold.closed or (self._leaving and hold.end is not None)
        return over and not hold.numbers(self._next) and (hold.end is None or hold.end <= self._next)

    def _forget(self) -> None:
        """Drop what no take needs any more, unless there is no open take: then the newest frames stay."""
        if not self._holds:
            while self._spilled:
                self._forget_spilled()
            while len(self._memory) > self._most:
                self._forgotten_ns = self._memory.popleft().sent_ns
            return
        needed = min(hold.stored for hold in self._holds.values())
        while self._spilled and self._spilled[0].last < needed:
            self._forget_spilled()
        while not self._spilled and self._memory and self._next - len(self._memory) < needed:
            self._forgotten_ns = self._memory.popleft().sent_ns

    def _forget_spilled(self) -> None:
        part = self._spilled.popleft()
        self._failing_since.pop(part.first, None)
        self._forgotten_ns = part.last_sent_ns
        assert self._store is not None  # which has the part
        self._store.remove(part.first)

    def _since(self, began_ns: int) -> int:
        """Return the number of the first frame sent since a time, or of the first lost one directly before it.

        If such frames are no longer available, it is the node's first number.
        """
        if self._forgotten_ns >= began_ns:
            return self._begin
        later = sum(1 for sent in self._memory if sent.sent_ns >= began_ns)
        since = next((part.first for part in self._spilled if part.last_sent_ns >= began_ns), self._next - later)
        return self._begin if since == self._first else since
