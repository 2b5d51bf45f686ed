"""The accounts of all nodes of a take: counts by sensor, and the rows that the take stores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

import msgspec

from mocapella.model.session import UnknownEnd
from mocapella.recording.ledger import NodeLedger

Node = tuple[str, int]
"""A sensor's name and a node's number."""


class Accounts:
    """The accounts of a take's nodes. One thread changes them; others may read the counts.

    Attributes:
        nodes: account of each node.
        pending: number of frames that wait for the next commit.
        duplicates: number of repeated frames.
    """

    def __init__(self, nodes: dict[Node, NodeLedger]) -> None:
        self.nodes = nodes
        self.pending = self.duplicates = 0
        self._changed: set[Node] = set()

    @property
    def stored(self) -> int:
        """Number of the take's frames on the disk, over all sensors."""
        return sum(self.frames.values())

    @property
    def frames(self) -> dict[str, int]:
        """Number of stored frames by sensor."""
        return self._by_sensor(lambda ledger: ledger.stored)

    @property
    def gaps(self) -> dict[str, int]:
        """Number of frames by sensor that are missing between the first and the last of each of its nodes."""
        return self._by_sensor(lambda ledger: ledger.gap)

    @property
    def lost(self) -> dict[str, int]:
        """Number of frames by sensor that belong to the take and are not on the disk: sent less stored."""
        return self._by_sensor(lambda ledger: ledger.lost)

    @property
    def unknown(self) -> tuple[UnknownEnd, ...]:
        """Nodes that have not said their last frame."""
        afters = ((node, self.nodes[node].unknown_after) for node in sorted(self.nodes))
        return tuple(UnknownEnd(sensor, node_id, after) for (sensor, node_id), after in afters if after is not None)

    def change(self, node: Node, change: Callable[[NodeLedger], bool]) -> None:
        """Change the account of a node; if ``change`` returns true, its row is stored with the next commit."""
        if change(self.nodes.setdefault(node, NodeLedger())):
            self._changed.add(node)

    def agree_on_all(self) -> None:
        """Let the account of each node without an agreement, such as one that answers nothing, begin with what came."""
        for node, ledger in self.nodes.items():
            if not ledger.agreed and ledger.expect(ledger.first):
                self._changed.add(node)

    def receive(self, node: Node, number: int) -> bool:
        """Add a frame; return False if it is there already or does not belong to the take."""
        ledger = self.nodes.get(node)
        if ledger is None:
            ledger = self.nodes[node] = NodeLedger()
        if not ledger.receive(number):
            self.duplicates += ledger.has(number)
            return False
        self.pending += 1
        return True

    def take_rows(self, *, last: bool = False) -> list[bytes]:
        """Return the rows that have changed since the last call; with ``last``, also those without an end."""
        if last:
            self._changed.update(node for node, ledger in self.nodes.items() if ledger.unknown_after is not None)
        changed, self._changed = self._changed, set()
        return [msgspec.json.encode(self.nodes[node].row(*node)) for node in sorted(changed) if self.nodes[node].agreed]

    def commit(self) -> None:
        """Note that all received frames are on the disk."""
        self.pending = 0
        for ledger in self.nodes.values():
            ledger.commit()

    def recount(self, found: Mapping[Node, NodeLedger]) -> None:
        """Correct the counts of stored frames after a disk has failed; all other received frames count as pending.

        Args:
            found: accounts of the frames that were read back from the disk, by node.
        """
        received = self.stored + self.pending
        for node, ledger in self.nodes.items():
            ledger.stored = found[node].stored if node in found else 0
        self.pending = max(0, received - self.stored)

    def _by_sensor(self, count: Callable[[NodeLedger], int]) -> dict[str, int]:
        found: Counter[str] = Counter()
        for (sensor, _), ledger in list(self.nodes.items()):  # a copy: another thread may add a node
            found[sensor] += count(ledger)
        return {sensor: number for sensor, number in found.items() if number}
