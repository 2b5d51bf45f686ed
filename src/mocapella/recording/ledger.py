"""Account of one node's frames in a take: which belong to it, which are stored, and which are lost.

The law is *sent = stored + lost*: of the frames from `NodeLedger.first` to before `NodeLedger.end`, each is stored
once, or counts as lost. While the end is unknown, the account says after which number nothing is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import msgspec

from mocapella.recording.sequences import SequenceRanges

_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]


class LedgerRow(msgspec.Struct, frozen=True, omit_defaults=True):
    """What a take stores of a node, besides its frames; the last row counts.

    Attributes:
        sensor, node_id: the node.
        first: number of its first frame that belongs to the take.
        end: number after its last frame that belongs to the take; None if the node has not said it.
        heard: number after the last frame that it is known to have sent.
        oldest: the node no longer has frames below this number.
    """

    sensor: str
    node_id: Annotated[int, msgspec.Meta(ge=0)]
    first: _Number
    end: _Number | None = None
    heard: _Number = 0
    oldest: _Number = 0


class NodeLedger:
    """Account of one node's frames. Without `expect`, a take only knows what came, as takes of older versions do.

    Attributes:
        first: number of the first frame that belongs to the take.
        end: number after the last frame that belongs to it; None until the node has said it.
        heard: number after the last frame that the node is known to have sent.
        oldest: the node no longer has frames below this number.
        agreed: whether node and server agreed on the first number.
        stored: number of frames on the disk.
        acknowledged: every frame below this number that belongs to the take and exists is on the disk.
    """

    def __init__(self) -> None:
        self.first = self.heard = self.oldest = 0
        self.end: int | None = None
        self.agreed = False
        self.stored = self.acknowledged = 0
        self._received = SequenceRanges()

    def __len__(self) -> int:
        """Number of received frames, on the disk or not."""
        return len(self._received)

    def expect(self, first: int) -> bool:
        """Include the frames from ``first`` on; return whether this changed the account.

        A first number is lowered by a later one, and never raised.
        """
        if self.agreed and first >= self.first:
            return False
        self.first = min(first, self._received.first) if len(self._received) else first
        self.heard = max(self.heard, self.first)
        self.agreed = True
        return True

    def hear(self, after: int, oldest: int = 0) -> bool:
        """Note that the node has sent all frames below ``after`` and has none below ``oldest``; return a change."""
        changed = after > self.heard or oldest > self.oldest
        self.heard, self.oldest = max(self.heard, after), max(self.oldest, oldest)
        return changed

    def finish(self, end: int) -> bool:
        """Note that no frame from ``end`` on belongs to the take; return whether this was news."""
        if self.end is not None:
            return False
        self.end = max(end, self._received.last + 1 if len(self._received) else self.first)
        self.heard = max(self.heard, self.end)
        return True

    def receive(self, number: int) -> bool:
        """Add a frame; return False if it is there already or does not belong to the take."""
        if (self.agreed and number < self.first) or (self.end is not None and number >= self.end):
            return False
        return self.put_back(number)

    def put_back(self, number: int) -> bool:
        """Add a frame that the take has, as when it is read; return False if it was added before."""
        if not self._received.add(number):
            return False
        self.first = self._received.first if not self.agreed else min(self.first, number)
        self.heard = max(self.heard, number + 1)
        return True

    def has(self, number: int) -> bool:
        """Whether a frame was received."""
        return number in self._received

    def commit(self) -> None:
        """Note that all received frames are on the disk."""
        self.stored = len(self._received)
        self.acknowledged = self._received.first_missing(max(self.first, self.oldest))

    @property
    def after(self) -> int:
        """Number after the last frame that belongs to the take, as far as known."""
        return self.heard if self.end is None else self.end

    @property
    def expected(self) -> int:
        """Number of frames that belong to the take, as far as known."""
        return max(0, self.after - self.first)

    @property
    def lost(self) -> int:
        """Number of frames that belong to the take and are not on the disk."""
        return self.expected - self.stored

    @property
    def gap(self) -> int:
        """Number of frames that are missing between the first and the last that was received."""
        return self._received.last + 1 - self.first - len(self._received) if len(self._received) else 0

    @property
    def unknown_after(self) -> int | None:
        """Number of the last frame that is known, if the node never said its end; −1: none. Else None."""
        return self.heard - 1 if self.agreed and self.end is None else None

    def missing(self, below: int | None = None) -> Iterator[tuple[int, int]]:
        """Yield the (first, last) of each gap among the frames that belong to the take, up to before ``below``."""
        end = self.after if below is None else min(below, self.after)
        yield from self._received.gaps(self.first, end)

    def obtainable(self, below: int) -> Iterator[tuple[int, int]]:
        """Yield the gaps as `missing` does, of frames that the node may still have."""
        yield from self._received.gaps(max(self.first, self.oldest), min(below, self.after))

    def row(self, sensor: str, node_id: int) -> LedgerRow:
        """Return what a take stores of the account."""
        return LedgerRow(sensor, node_id, self.first, self.end, self.heard, self.oldest)

    def read(self, row: LedgerRow) -> None:
        """Restore the account from a row of the take; frames that were received before still count."""
        self.agreed, self.first, self.end = True, row.first, row.end
        if len(self._received):
            self.first = min(self.first, self._received.first)
        self.hear(max(row.heard, row.first), row.oldest)
