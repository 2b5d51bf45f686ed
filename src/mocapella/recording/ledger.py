"""The ledger of one node's frames in a take: which belong to the take, which are stored, and which are lost.

Frames are identified by their sequence numbers. The law is *sent = stored + lost*: each frame from `NodeLedger.first`
to before `NodeLedger.end` is stored once, or counts as lost. While the end is unknown, `NodeLedger.unknown_after` is
the number of the last frame that is known to have been sent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated

import msgspec

from mocapella.errors import InputError
from mocapella.recording.sequences import SequenceRanges

_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]


class LedgerRow(msgspec.Struct, frozen=True, omit_defaults=True):
    """A node's ledger as stored in a take, besides its frames; a later row of the node replaces an earlier one.

    Attributes:
        sensor, node_id: identity of the node.
        first: sequence number of the node's first frame that belongs to the take.
        end: sequence number after the node's last frame that belongs to the take; None if the node has not reported it.
        heard: sequence number after the last frame that the node is known to have sent.
        oldest: the node no longer has frames below this sequence number, so they cannot be requested again.
        left: whether the node ended with the frame before ``end``; else only the take ended there.
    """

    sensor: str
    node_id: Annotated[int, msgspec.Meta(ge=0)]
    first: _Number
    end: _Number | None = None
    heard: _Number = 0
    oldest: _Number = 0
    left: bool = False


class NodeLedger:
    """Ledger of one node's frames in a take.

    Without a call of `expect`, the frames belong to the take from the first received one on, as in takes of older
    versions.

    Attributes:
        first: sequence number of the first frame that belongs to the take.
        end: sequence number after the last frame that belongs to the take; None until the node has reported it.
        heard: sequence number after the last frame that the node is known to have sent.
        oldest: the node no longer has frames below this sequence number, so they cannot be requested again.
        agreed: whether node and server agreed on ``first``.
        left: whether the node ended with the frame before ``end``; else only the take ended there.
        stored: number of frames on the disk.
        acknowledged: every frame below this sequence number that belongs to the take is on the disk, or is lost: the
            node no longer has it, or it was given up.
    """

    def __init__(self) -> None:
        self.first = self.heard = self.oldest = 0
        self.end: int | None = None
        self.agreed = self.left = False
        self.stored = self.acknowledged = 0
        self._received = SequenceRanges()
        self._settled: SequenceRanges = self._received

    @classmethod
    def restored(cls, row: LedgerRow, agreed: bool, received: Iterable[tuple[int, int]]) -> NodeLedger:
        """Make a ledger from its row and the ranges of received frames, all of which are on the disk.

        Args:
            row: the ledger's row.
            agreed: whether node and server had agreed on the row's ``first``.
            received: first and last sequence number of each range.

        Raises:
            InputError: the ranges overlap, touch, or are not in ascending order.
        """
        ledger = cls()
        try:
            ledger._received = ledger._settled = SequenceRanges.of(received)
        except ValueError as error:
            raise InputError(f"cannot be used: {error}", field=f"received frames of {row.sensor}") from error
        ledger.read(row)
        ledger.agreed = agreed
        ledger.commit()
        return ledger

    def received(self) -> list[tuple[int, int]]:
        """Return the first and last sequence number of each range of received frames, in ascending order."""
        return self._received.ranges

    def __len__(self) -> int:
        """Number of received frames, whether on the disk or not."""
        return len(self._received)

    def expect(self, first: int) -> bool:
        """Agree that the frames from sequence number ``first`` on belong to the take; return whether this is a change.

        A later call can lower the number, but never raise it.
        """
        if self.agreed and first >= self.first:
            return False
        self.first = min(first, self._received.first) if len(self._received) else first
        self.heard = max(self.heard, self.first)
        self.agreed = True
        return True

    def hear(self, after: int, oldest: int = 0) -> bool:
        """Note that the node has sent all frames below ``after`` and no longer has those below ``oldest``.

        Returns:
            Whether the ledger changed.
        """
        changed = after > self.heard or oldest > self.oldest
        self.heard, self.oldest = max(self.heard, after), max(self.oldest, oldest)
        return changed

    def finish(self, end: int, *, left: bool = False) -> bool:
        """Note that no frame from sequence number ``end`` on belongs to the take; return whether the ledger changed.

        A known end is kept, and an end below received frames is raised to include them.

        Args:
            end: the number.
            left: whether the node ends there; else only the take does.
        """
        if self.end is not None:
            news = left and not self.left
            self.left |= left
            return news
        self.left = left
        self.end = max(end, self._received.last + 1 if len(self._received) else self.first)
        self.heard = max(self.heard, self.end)
        return True

    def reopen(self) -> bool:
        """Forget the end, because the take is resumed, unless the node has left; return whether the ledger changed."""
        if self.end is None or self.left:
            return False
        self.end = None
        return True

    def give_up(self, number: int) -> bool:
        """Count a frame as lost that can never be stored, so that it is not requested; False if it was received."""
        if number in self._received:
            return False
        if self._settled is self._received:
            self._settled = self._received.copy()
        self._settled.add(number)
        if not self.agreed:
            self.first = self._settled.first
        self.heard = max(self.heard, number + 1)
        return True

    def wants(self, number: int) -> bool:
        """Whether the frame with this sequence number belongs to the take, as far as known, and was not received."""
        outside = (self.agreed and number < self.first) or (self.end is not None and number >= self.end)
        return not outside and number not in self._received

    def receive(self, number: int) -> bool:
        """Note a received frame by its sequence number; return False for a duplicate, or one outside the take."""
        return self.wants(number) and self.put_back(number)

    def put_back(self, number: int) -> bool:
        """Note a frame that is read from the take's file; return False if it was noted before."""
        if not self._received.add(number):
            return False
        if self._settled is not self._received:
            self._settled.add(number)
        self.first = self._settled.first if not self.agreed else min(self.first, number)
        self.heard = max(self.heard, number + 1)
        return True

    def put_back_run(self, first: int, count: int) -> bool:
        """Note frames that follow each other, as `put_back`; False, and none is noted, unless they are the last."""
        if self._settled is not self._received or not self._received.extend(first, count):
            return False
        self.first = self._settled.first if not self.agreed else min(self.first, first)
        self.heard = max(self.heard, first + count)
        return True

    def has(self, number: int) -> bool:
        """Whether the frame with this sequence number was received."""
        return number in self._received

    def commit(self) -> None:
        """Note that all received frames are on the disk: update ``stored`` and ``acknowledged``."""
        self.stored = len(self._received)
        self.acknowledged = self._settled.first_missing(max(self.first, self.oldest))

    @property
    def after(self) -> int:
        """Sequence number after the last frame that belongs to the take, as far as known."""
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
        """Number of frames that were not received between ``first`` and the last received frame."""
        return self._received.last + 1 - self.first - len(self._received) if len(self._received) else 0

    @property
    def unknown_after(self) -> int | None:
        """Sequence number of the last known frame while the end is unknown, or −1 without any; None if it is known."""
        return self.heard - 1 if self.agreed and self.end is None else None

    def missing(self, below: int | None = None) -> Iterator[tuple[int, int]]:
        """Yield (first, last) of each gap in the take's frames: before ``below``, or all gaps if it is None."""
        end = self.after if below is None else min(below, self.after)
        yield from self._received.gaps(self.first, end)

    def obtainable(self, below: int) -> Iterator[tuple[int, int]]:
        """Yield (first, last) of each gap before ``below`` in the frames that can still be requested from the node."""
        yield from self._settled.gaps(max(self.first, self.oldest), min(below, self.after))

    def row(self, sensor: str, node_id: int) -> LedgerRow:
        """Return the ledger as a row for the take."""
        return LedgerRow(sensor, node_id, self.first, self.end, self.heard, self.oldest, self.left)

    def read(self, row: LedgerRow) -> None:
        """Restore the ledger from a row of the take; frames that were noted before still count as received."""
        self.agreed, self.first, self.end, self.left = True, row.first, row.end, row.left
        if len(self._received):
            self.first = min(self.first, self._received.first)
        self.hear(max(row.heard, row.first), row.oldest)
