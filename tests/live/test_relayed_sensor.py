"""When frames of a program that keeps them are live, and when they are acknowledged, in place of a bus and its time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest
from support.messages import plain_frame

from mocapella.errors import UnstoredFramesError
from mocapella.live import relaying
from mocapella.live.relaying import CALM_S, FRESH_S, HEARD_S, SETTLE_S, RelayedSensor
from mocapella.model.observations import BodyFrame
from mocapella.sources.bridge_messages import BridgeStart
from mocapella.wire.delivery import FrameRequest
from mocapella.wire.keys import NodeKey
from mocapella.wire.outbox import Outbox

S = 1_000_000_000
NODE = NodeKey("front", 9)


class Link:
    """In place of a node's link: remembers what is published live."""

    def __init__(self, first: int) -> None:
        self.outbox = Outbox(1000, first=first)
        self.heard_s, self.left, self.detached = float("-inf"), True, False
        self.node, self.address = NODE, "nowhere"
        self.relayed: list[tuple[BodyFrame, bool]] = []
        self.unstored = ""

    @property
    def published(self) -> int:
        return self.outbox.next

    def relay(self, frame: BodyFrame, *, live: bool) -> None:
        self.relayed.append((frame, live))
        self.outbox.add(b"", frame.sent_ns)

    def detach(self) -> None:
        self.detached = True


class Member:
    """In place of a membership: served from the beginning."""

    def __init__(self, *_: Any) -> None:
        self.served = threading.Event()
        self.served.set()
        self.refusal = None

    def wait(self) -> None: ...


class Relayed:
    """A sensor, its link, and the time, which passes as the test says."""

    def __init__(self, start: BridgeStart, clock_ns: Callable[[], int] | None = None) -> None:
        self.now_ns = 100 * S
        self.sensor = RelayedSensor("nowhere", start, lambda _: None, clock_ns=clock_ns or (lambda: self.now_ns))
        self.link: Link = self.sensor._link  # type: ignore[assignment]

    def send(self, number: int, sent_ns: int) -> None:
        """Send a frame, whose time is one of the program's clock."""
        frame = msgspec.structs.replace(plain_frame(), sensor="front", sequence=number, node_id=9, sent_ns=sent_ns)
        self.sensor.frame(frame)

    def acknowledged(self, now_ns: int, heard_before_ns: int = 0) -> int:
        self.now_ns = now_ns
        self.link.heard_s = (now_ns - heard_before_ns) / S
        return self.sensor.acknowledged()


def begin(*, first: int = 0, following: int = 0, now_ns: int = 100 * S) -> BridgeStart:
    return BridgeStart("front", 9, first, 0, following, now_ns)


@pytest.fixture(autouse=True)
def no_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def opened(connect: str, sensor: str, *, say: Any, start: Any) -> Iterator[Link]:
        link = Link(start.first)
        yield link
        if link.unstored:
            raise UnstoredFramesError(link.unstored)

    monkeypatch.setattr(relaying, "open_link", opened)
    monkeypatch.setattr(relaying, "Membership", Member)


def test_with_a_calm_server_exactly_the_frames_that_are_older_than_a_while_are_acknowledged() -> None:
    relayed = Relayed(begin())
    calm = round(CALM_S * S)
    assert relayed.acknowledged(100 * S) == 0  # calm from now on
    for k in range(5):
        relayed.now_ns = (100 + k) * S
        relayed.send(k, relayed.now_ns)
    assert relayed.acknowledged(100 * S + calm - 1) == 0
    for k in range(5):
        for _ in range(3):  # asking again changes nothing
            assert relayed.acknowledged((100 + k) * S + calm) == k + 1
        assert len(relayed.sensor._sent) == 4 - k  # nothing else is kept
        assert relayed.acknowledged((100 + k) * S + calm + S - 1) == k + 1


def test_a_server_that_is_not_heard_is_not_calm_and_the_calm_begins_again() -> None:
    relayed = Relayed(begin())
    relayed.send(0, 100 * S)
    heard, calm = round(HEARD_S * S), round(CALM_S * S)
    assert relayed.acknowledged(100 * S, heard) == 0
    assert relayed.acknowledged(100 * S + calm, heard) == 1  # just heard, all the time
    relayed.send(1, 101 * S)
    later = 100 * S + 3 * calm
    assert relayed.acknowledged(later, heard + S // 1000) == 1
    assert relayed.acknowledged(later + S) == 1
    assert relayed.acknowledged(later + S + calm - 1) == 1
    assert relayed.acknowledged(later + S + calm) == 2


def test_a_sensor_that_no_server_serves_has_no_calm_one() -> None:
    relayed = Relayed(begin())
    relayed.send(0, 100 * S)
    relayed.sensor._membership.served.clear()
    assert [relayed.acknowledged(k * S) for k in (100, 200)] == [0, 0]


def test_takes_are_acknowledged_to_the_one_that_has_stored_least_and_end_the_calm() -> None:
    relayed = Relayed(begin(first=3))
    for k in range(3, 9):
        relayed.send(k, 100 * S)
    assert relayed.acknowledged(100 * S) == 3
    relayed.link.outbox.update(FrameRequest("one", 7), 0)
    relayed.link.outbox.update(FrameRequest("two", 5), 0)
    assert relayed.acknowledged(200 * S) == 5
    relayed.link.outbox.update(FrameRequest("two", 99), 0)
    relayed.link.outbox.update(FrameRequest("one", 99), 0)
    assert relayed.acknowledged(200 * S) == 9  # no more than there are


@pytest.mark.parametrize("problem", ["", "some are not stored"])
def test_at_the_end_all_is_acknowledged_unless_something_is_not_stored(problem: str) -> None:
    relayed = Relayed(begin())
    for k in range(3):
        relayed.send(k, 100 * S)
    relayed.link.unstored = problem
    assert relayed.acknowledged(100 * S) == 0
    assert not relayed.sensor.closed
    relayed.sensor.end()
    relayed.sensor.wait()
    assert relayed.sensor.closed
    assert relayed.sensor.problem == relayed.sensor.unstored == problem
    assert relayed.acknowledged(100 * S) == (0 if problem else 3)


def test_a_server_that_did_not_hear_the_end_leaves_the_frames_to_the_program() -> None:
    relayed = Relayed(begin())
    relayed.send(0, 100 * S)
    relayed.link.left = False
    relayed.sensor.end()
    relayed.sensor.wait()
    assert "no server at nowhere has heard the end of front" in (relayed.sensor.problem or "")
    assert (relayed.acknowledged(100 * S), relayed.sensor.unstored) == (0, "")


def test_a_frame_is_live_if_it_is_new_to_the_program_and_younger_than_a_second() -> None:
    relayed = Relayed(begin(first=5, following=6, now_ns=7 * S))  # the program's clock is 93 s behind
    fresh = round(FRESH_S * S)
    for number, sent_ns in ((5, 7 * S), (6, 7 * S), (7, 7 * S - fresh + 1), (8, 7 * S - fresh), (9, 0), (10, 9 * S)):
        relayed.send(number, sent_ns)
    assert [live for _, live in relayed.link.relayed] == [False, True, True, False, True, True]
    here = [100 * S, 100 * S, 100 * S - fresh + 1, 100 * S - fresh, 100 * S, 100 * S]  # never later than now
    assert [frame.sent_ns for frame, _ in relayed.link.relayed] == here


@pytest.mark.parametrize(("stored", "offered_s"), [(0, SETTLE_S), (1, SETTLE_S), (2, 0.0)])
def test_frames_of_a_program_that_vanished_are_offered_until_a_take_has_them_or_for_a_while(
    stored: int, offered_s: float
) -> None:
    now_s = [0.0]
    relayed = Relayed(begin(now_ns=0), lambda: round(now_s[0] * S))
    for k in range(2):
        relayed.send(k, 0)
    relayed.link.outbox.update(FrameRequest("take", stored), 0)
    hurry = relayed.sensor._hurry
    waits: list[float] = []

    def wait(seconds: float) -> bool:
        waits.append(seconds)
        now_s[0] += 0.25
        return False

    hurry.wait = wait  # type: ignore[assignment, method-assign]
    relayed.sensor.gone()
    relayed.sensor.wait()
    assert (relayed.sensor.closed, relayed.link.detached, relayed.sensor.problem) == (True, True, None)
    assert now_s[0] == offered_s
