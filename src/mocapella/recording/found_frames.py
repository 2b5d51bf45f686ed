"""Find frames that a take lacks in other files: spools of nodes, or takes that nodes recorded themselves.

Node ids are random, so (sensor, node id, sequence number) identifies a frame in every file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mocapella.errors import DamagedTakeError
from mocapella.recording import take
from mocapella.recording.ledger import LedgerRow, NodeLedger
from mocapella.recording.take_index import TakeIndex
from mocapella.recording.take_refs import FrameRef


@dataclass(frozen=True)
class FoundFrames:
    """Frames to be added to a take.

    Attributes:
        frames: the file that has the frame, and the frame's position in it, for each frame.
        rows: ledgers of the nodes to be stored in the take, because frames were found or an end became known.
        log_ns: the frames' log time in the take, on the server's clock: the take's last one, because other files have
            other clocks.
    """

    frames: tuple[tuple[Path, FrameRef], ...]
    rows: tuple[LedgerRow, ...]
    log_ns: int

    @property
    def counts(self) -> Counter[str]:
        """Number of found frames by sensor."""
        return Counter(ref.sensor for _, ref in self.frames)

    @property
    def sources(self) -> list[Path]:
        """Files that have the frames."""
        return list(dict.fromkeys(path for path, _ in self.frames))

    def read(self) -> Iterator[tuple[str, bytes, int]]:
        """Read the frames: yield (topic in the take, encoded frame, sequence number) of each.

        Raises:
            DamagedTakeError: a file became shorter than when it was indexed.
        """
        for path in self.sources:
            with path.open("rb") as file:
                for ref in (ref for source, ref in self.frames if source == path):
                    file.seek(ref.ref.offset)
                    data = file.read(ref.ref.length)
                    if len(data) != ref.ref.length:
                        raise DamagedTakeError("became shorter while it was read", file=path)
                    yield take.FRAMES + ref.sensor, data, ref.sequence


def found_frames(index: TakeIndex, others: Sequence[tuple[Path, TakeIndex]]) -> FoundFrames:
    """Find the frames that belong to a take and are only in other files.

    A node without frames in the take is included if the other file is a spool of this take, with the same `take_id`.

    Args:
        index: index of the take; its ledgers are updated with the found frames.
        others: path and index of each other file.
    """
    frames: list[tuple[Path, FrameRef]] = []
    changed: dict[tuple[str, int], NodeLedger] = {}
    for path, other in others:
        same = _take_id(other) == _take_id(index) != ""
        for node, theirs in other.nodes.items():
            if node not in index.nodes and not same:
                continue
            ours = index.nodes.setdefault(node, NodeLedger())
            ends = theirs.end is not None and ours.finish(theirs.end, left=theirs.left)
            if (same and ours.expect(theirs.first)) or ends:
                changed[node] = ours
        for ref in other.frames:
            ledger = index.nodes.get((ref.sensor, ref.node_id))
            if ledger is not None and ledger.receive(ref.sequence):
                frames.append((path, ref))
                changed[ref.sensor, ref.node_id] = ledger
    rows = tuple(ledger.row(*node) for node, ledger in changed.items() if ledger.agreed)
    frames.sort(key=lambda found: (found[1].sensor, found[1].node_id, found[1].sequence))
    return FoundFrames(tuple(frames), rows, index.last_ns)


def _take_id(index: TakeIndex) -> str:
    return index.runs[0].info.take_id if index.runs else ""
