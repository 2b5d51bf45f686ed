"""Laws of the queue between the bus and the tracker."""

from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from mocapella.live.inbox import Inbox, ReceivedMessage
from mocapella.wire.keys import NodeKey

FRONT, SIDE = NodeKey("front", 1), NodeKey("side", 2)


@given(st.lists(st.sampled_from([FRONT, SIDE]), max_size=40), st.integers(1, 5))
def test_the_newest_of_each_sensor_survive_in_the_order_of_arrival(nodes: list[NodeKey], depth: int) -> None:
    inbox = Inbox(depth)
    messages = [ReceivedMessage(node, b"%d" % i, i) for i, node in enumerate(nodes)]
    for message in messages:
        inbox.put(message)
    expected = sorted(message for node in (FRONT, SIDE) for message in [x for x in messages if x.node == node][-depth:])
    taken = []
    while (message := inbox.take(0.0)) is not None:
        taken.append(message)
    assert taken == sorted(expected, key=lambda message: message.arrived_ns)


def test_a_flood_from_one_sensor_does_not_crowd_out_another() -> None:
    inbox = Inbox(3)
    inbox.put(ReceivedMessage(SIDE, b"side", 0))
    for i in range(1, 1000):
        inbox.put(ReceivedMessage(FRONT, b"", i))
    assert inbox.take(0.0) == ReceivedMessage(SIDE, b"side", 0)


def test_waking_returns_at_once_with_nothing() -> None:
    inbox = Inbox()
    result: list[ReceivedMessage | None] = []
    thread = threading.Thread(target=lambda: result.append(inbox.take(60.0)))
    thread.start()
    inbox.wake()
    thread.join(10.0)
    assert result == [None]


def test_a_node_that_is_gone_leaves_nothing() -> None:
    inbox = Inbox()
    inbox.put(ReceivedMessage(FRONT, b"", 1))
    inbox.forget(FRONT)
    assert inbox.take(0.0) is None
