"""A node's own take: it begins with the node's first frame, whatever of it comes onto the disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest

from mocapella.live.node_disk import _record
from mocapella.live.recorder import Recorder
from mocapella.recording.ledger import NodeLedger
from mocapella.wire.keys import NodeKey

NODE = NodeKey("front", 7)


class Noted:
    """A recorder that keeps one node's ledger, and the numbers of its frames."""

    def __init__(self) -> None:
        self.ledger = NodeLedger()
        self.frames: list[tuple[bytes, int, int]] = []

    def account(self, node: NodeKey, change: Callable[[NodeLedger], Any]) -> None:
        assert node == NODE
        change(self.ledger)

    def frame(self, node: NodeKey, data: bytes, at_ns: int, sequence: int) -> None:
        assert node == NODE
        self.frames.append((data, at_ns, sequence))


@pytest.mark.parametrize(("numbers", "agreed"), [((0,), True), ((0, 1, 2), True), ((1,), False), ((5, 6), False)])
def test_the_first_frame_is_the_begin_of_the_take_and_all_are_recorded(numbers: tuple[int, ...], agreed: bool) -> None:
    """Later frames alone begin nothing: a take that goes on has its begin from before."""
    noted = Noted()
    for number in numbers:
        _record(cast(Recorder, noted), NODE, number, b"frame", 10 * number)
    assert noted.ledger.agreed == agreed
    assert noted.ledger.first == 0
    assert noted.frames == [(b"frame", 10 * number, number) for number in numbers]
