"""Laws of the queue between the bus and the tracker."""

from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from mocapella.live.inbox import Inbox, ReceivedMessage
from mocapella.model.limits import STRANGERS_A_SECOND, STRANGERS_WAITING
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


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 30)), max_size=6))
def test_strangers_cost_a_sensor_nothing_whatever_they_send(runs: list[tuple[bool, int]]) -> None:
    """Runs of messages, of strangers or of a sensor: the sensor's are all there, in order."""
    order = [stranger for stranger, count in runs for _ in range(count)]
    now_ns = [0]
    inbox = Inbox(200, clock_ns=lambda: now_ns[0])
    for i, stranger in enumerate(order):
        inbox.put(ReceivedMessage(NodeKey(f"x{i}", i) if stranger else FRONT, b"", i, stranger))
    taken = []
    while (message := inbox.take(0.0)) is not None:
        taken.append(message)
        now_ns[0] += 1_000_000
    own = [i for i, stranger in enumerate(order) if not stranger]
    assert [message.arrived_ns for message in taken if not message.stranger] == own
    strangers = [message for message in taken if message.stranger]
    assert len(strangers) + inbox.strangers_dropped <= order.count(True)
    assert len(strangers) <= STRANGERS_WAITING
    assert inbox.strangers_dropped == max(0, order.count(True) - STRANGERS_WAITING)


def test_a_stranger_is_looked_at_although_sensors_never_pause_and_only_so_often() -> None:
    now_ns = [0]
    inbox = Inbox(clock_ns=lambda: now_ns[0])
    looked = 0
    for i in range(1000):  # a second
        inbox.put(ReceivedMessage(FRONT, b"", i))
        inbox.put(ReceivedMessage(NodeKey(f"x{i}", i), b"", i, stranger=True))
        message = inbox.take(0.0)
        assert message is not None
        looked += message.stranger
        now_ns[0] += 1_000_000
    assert STRANGERS_A_SECOND // 2 <= looked <= STRANGERS_A_SECOND


def test_messages_that_gave_way_to_newer_ones_are_counted_by_sensor_once() -> None:
    inbox = Inbox(2)
    for i in range(5):
        inbox.put(ReceivedMessage(FRONT, b"", i))
    inbox.put(ReceivedMessage(SIDE, b"", 9))
    assert inbox.take_skipped() == {FRONT: 3}
    assert inbox.take_skipped() == {}
