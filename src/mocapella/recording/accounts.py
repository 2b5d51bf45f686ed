"""The ledgers of all nodes of a take (`mocapella.recording.ledger`): frame counts by sensor, and rows for the take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

import msgspec

from mocapella.model.session import UnknownEnd
from mocapella.recording.ledger import NodeLedger

Node = tuple[str, int]
"""A node's key: the sensor's name, and the random number of the process that serves it."""


class Accounts:
    """The ledgers of a take's nodes: which frames were received, stored and lost. One thread writes, others may read.

    Args:
        nodes: the ledgers so far, such as of an interrupted take; kept and changed in place. Those of nodes that had
            not left are reopened (`NodeLedger.reopen`), because more frames may follow.

    Attributes:
        nodes: ledger of each node.
        pending: number of received frames that are not on the disk yet.
        duplicates: number of frames that were received more than once.
    """

    def __init__(self, nodes: dict[Node, NodeLedger]) -> None:
        self.nodes = nodes
        self.pending = self.duplicates = 0
        self._changed: set[Node] = {node for node, ledger in nodes.items() if ledger.reopen()}

    @property
    def stored(self) -> int:
        """Number of the take's frames on the disk, of all sensors together."""
        return sum(self.frames.values())

    @property
    def frames(self) -> dict[str, int]:
        """Number of frames on the disk by sensor; sensors without any are left out."""
        return self._by_sensor(lambda ledger: ledger.stored)

    @property
    def gaps(self) -> dict[str, int]:
        """Number of frames by sensor that are missing between the first and the last received frame of each node."""
        return self._by_sensor(lambda ledger: ledger.gap)

    @property
    def lost(self) -> dict[str, int]:
        """Number of frames by sensor that belong to the take and are not on the disk: sent minus stored."""
        return self._by_sensor(lambda ledger: ledger.lost)

    @property
    def unknown(self) -> tuple[UnknownEnd, ...]:
        """Nodes whose last frame in the take is not known."""
        afters = ((node, self.nodes[node].unknown_after) for node in sorted(self.nodes))
        return tuple(UnknownEnd(sensor, node_id, after) for (sensor, node_id), after in afters if after is not None)

    def change(self, node: Node, change: Callable[[NodeLedger], bool]) -> None:
        """Call ``change`` with a node's ledger; if it returns true, `take_rows` returns the ledger's row next time."""
        if change(self.nodes.setdefault(node, NodeLedger())):
            self._changed.add(node)

    def agree_on_all(self) -> None:
        """For each node without an agreed first frame, take its first received frame for the first of the take.

        Such nodes have not answered the server's requests, like programs that only publish frames.
        """
        for node, ledger in self.nodes.items():
            if not ledger.agreed and ledger.expect(ledger.first):
                self._changed.add(node)

    def wants(self, node: Node, number: int) -> bool:
        """Return whether an arrived frame belongs to the take and is new; count a known one in ``duplicates``.

        Args:
            node: the frame's node.
            number: the frame's sequence number.
        """
        ledger = self.nodes.setdefault(node, NodeLedger())
        self.duplicates += ledger.has(number)
        return ledger.wants(number)

    def receive(self, node: Node, number: int) -> None:
        """Note that a frame for which `wants` was true is added to the file, by its node and sequence number."""
        self.pending += self.nodes[node].receive(number)

    def take_rows(self, *, last: bool = False) -> list[bytes]:
        """Return the rows of the ledgers that have changed since the last call, as JSON to store in the take.

        With ``last``, at the end of a take, the rows of nodes with an unknown last frame are returned as well.
        """
        if last:
            self._changed.update(node for node, ledger in self.nodes.items() if ledger.unknown_after is not None)
        changed, self._changed = self._changed, set()
        return [msgspec.json.encode(self.nodes[node].row(*node)) for node in sorted(changed) if self.nodes[node].agreed]

    def commit(self) -> None:
        """Note that all received frames are on the disk, so that they can be acknowledged to their nodes."""
        self.pending = 0
        for ledger in self.nodes.values():
            ledger.commit()

    def recount(self, found: Mapping[Node, NodeLedger]) -> None:
        """Correct the numbers of stored frames after a disk has failed; all other received frames count as pending.

        Args:
            found: ledgers of the frames that were read back from the disk, by node.
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
