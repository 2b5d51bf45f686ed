"""The contents of a take so far, which each later part of an interrupted take begins with.

A recording that goes on needs the earlier frames' sequence numbers, not the frames. So it reads the newest part, and of
the parts before it only this account. Without an account that fits, it reads all parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import InputError
from mocapella.recording import take
from mocapella.recording.accounts import Node
from mocapella.recording.ledger import LedgerRow, NodeLedger
from mocapella.recording.mcap_scan import MessageRead, scan
from mocapella.recording.take_index import TakeIndex, add_files

_BEGINNING: Final = 4
"""Number of records at the beginning of a part among which its account is, after the two descriptions of its run."""
_Count = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]


@dataclass
class TakeSoFar:
    """Contents of a take's files so far, as far as a recording that goes on needs them.

    Attributes:
        sizes: size of each file [bytes].
        take_id: identity of the take; empty in older takes.
        next_run: number of the next run.
        scenes: number of stored scenes.
        first_ns, last_ns: smallest and largest log time, on the server's clock; None and 0 without messages.
        nodes: ledger by sensor and node.
    """

    sizes: list[int] = field(default_factory=list)
    take_id: str = ""
    next_run: int = 0
    scenes: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    nodes: dict[Node, NodeLedger] = field(default_factory=dict)

    def encode(self) -> bytes:
        """Return the account as JSON for the take's channel `mocapella.recording.take.EARLIER`."""
        nodes = [_Node(ledger.row(*node), ledger.agreed, ledger.received()) for node, ledger in self.nodes.items()]
        stored = _Account(
            self.sizes, self.take_id, self.next_run, self.scenes, self.last_ns, nodes, first_ns=self.first_ns
        )
        return msgspec.json.encode(stored)


class _Node(msgspec.Struct, frozen=True):
    row: LedgerRow
    agreed: bool
    received: list[tuple[_Count, _Count]]


class _Account(msgspec.Struct, frozen=True):
    sizes: list[_Count]
    take_id: str
    next_run: _Count
    scenes: _Count
    last_ns: int
    nodes: list[_Node]
    first_ns: int | None


def read_so_far(parts: Sequence[Path]) -> TakeSoFar:
    """Return the contents of an interrupted take so far, reading as few of its files as possible.

    A later file begins with the `TakeSoFar` of the earlier ones, which then need not be read, unless the size of one
    has changed. The recording of the take must have ended.

    Args:
        parts: the files of the take, in order.

    Raises:
        InputError, DamagedTakeError, SchemaVersionError: as in `mocapella.recording.take_index.index_take`.
    """
    try:
        sizes = [part.stat().st_size for part in parts]
    except OSError:
        sizes = []  # reading it all names the fault
    for number in range(len(sizes) - 1, 0, -1):
        account = _account_of(parts[number])
        if account is not None and account.sizes == sizes[:number]:
            return _continued(account, parts, number, sizes)
    return _continued(TakeSoFar(), parts, 0, sizes)


def _continued(so_far: TakeSoFar, parts: Sequence[Path], number: int, sizes: list[int]) -> TakeSoFar:
    """Add the files from ``parts[number]`` on to the contents of those before it."""
    index = TakeIndex()
    index.nodes, index.first_ns, index.last_ns = so_far.nodes, so_far.first_ns, so_far.last_ns
    add_files(index, parts[number:], number)
    index.close_accounts()
    return TakeSoFar(
        sizes=sizes,
        take_id=so_far.take_id or (index.runs[0].info.take_id if index.runs else ""),
        next_run=index.runs[-1].number + 1 if index.runs else so_far.next_run,
        scenes=so_far.scenes + len(index.scenes),
        first_ns=index.first_ns,
        last_ns=index.last_ns,
        nodes=index.nodes,
    )


def decode_so_far(data: bytes) -> TakeSoFar:
    """Decode the bytes that `TakeSoFar.encode` has returned.

    Raises:
        InputError: they are no such JSON, or ranges of sequence numbers overlap or are not in ascending order.
    """
    account = decode_json(data, _Account, what="account of a take")
    nodes = {(n.row.sensor, n.row.node_id): NodeLedger.restored(n.row, n.agreed, n.received) for n in account.nodes}
    return TakeSoFar(
        account.sizes, account.take_id, account.next_run, account.scenes, account.first_ns, account.last_ns, nodes
    )


def _account_of(part: Path) -> TakeSoFar | None:
    """Read the account at the beginning of a part; None if there is none that can be used."""
    try:
        with part.open("rb") as file:
            events = scan(file, part.stat().st_size, str(part))
            for event, _ in zip(events, range(_BEGINNING), strict=False):
                if isinstance(event, MessageRead) and event.topic == take.EARLIER:
                    return decode_so_far(event.data)
    except (OSError, InputError):
        pass  # reading it all names the fault
    return None
