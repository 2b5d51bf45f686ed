"""The callbacks of the bus: what reaches the recorder, the tracker and the nodes, in place of a bus."""

from __future__ import annotations

import platform
import threading
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from mocapella.live.command_queue import CommandQueue
from mocapella.live.door import Door
from mocapella.live.inbox import Inbox
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.model.session import Setup
from mocapella.wire.keys import NodeKey
from mocapella.wire.node import JoinReply

A, B = NodeKey("front", 1), NodeKey("front", 2)


class Recording:
    """In place of the recording service and its recorder: remembers what it is told."""

    def __init__(self) -> None:
        self.recorder: Recording | None = self
        self.active = True
        self.told: list[tuple[Any, ...]] = []

    def leaving(self, node: NodeKey, end: int) -> None:
        self.told.append(("leaving", node, end))

    def frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        self.told.append(("frame", node, data, arrived_ns))

    def truth(self, sensor: str, data: bytes, arrived_ns: int) -> None:
        self.told.append(("truth", sensor, data, arrived_ns))


class Hall:
    """A door, and all that is behind it."""

    def __init__(self, full: str = "") -> None:
        self.registry, self.inbox, self.recording = SensorRegistry(), Inbox(), Recording()
        self.refused: list[str] = []
        self.door = Door(
            self.registry, threading.RLock(), self.inbox, CommandQueue(), lambda: self.recording,  # type: ignore[arg-type, return-value]
            full=lambda: full, refused=self.refused.append,
        )  # fmt: skip

    def ask(self, call: Callable[..., None], node: NodeKey, **arguments: Any) -> JoinReply:
        answers: list[bytes] = []
        call(node, arguments, answers.append)
        (answer,) = answers
        return msgspec.json.decode(answer, type=JoinReply)


def test_a_node_that_joins_is_seated_and_ends_nothing() -> None:
    hall = Hall()
    assert hall.ask(hall.door.join, A) == JoinReply(True, recording=True)
    assert hall.registry.holds(A)
    assert hall.recording.told == []


@pytest.mark.parametrize("end", [0, 7])
def test_the_recording_learns_the_end_of_a_node_that_leaves(end: int) -> None:
    hall = Hall()
    hall.ask(hall.door.join, A)
    assert hall.ask(hall.door.leave, A, next=end).accepted
    assert hall.recording.told == [("leaving", A, end)]


def test_a_node_without_the_name_ends_nothing_when_it_leaves() -> None:
    hall = Hall()
    hall.ask(hall.door.join, A)
    reply = hall.ask(hall.door.leave, B, next=7)
    assert not reply.accepted
    assert "another node serves the sensor front" in reply.message
    assert hall.recording.told == []


@pytest.mark.parametrize("end", [-1, None, "seven"])
def test_a_node_that_leaves_with_an_invalid_number_is_told_so(end: object) -> None:
    hall = Hall()
    reply = hall.ask(hall.door.leave, A, next=end)
    assert (reply.accepted, reply.message.partition(" is ")[0]) == (False, "next")
    assert hall.recording.told == []


@pytest.mark.parametrize(("machine", "local"), [(platform.node(), True), (platform.node() + "x", False), (None, False)])
def test_a_node_is_local_if_it_names_this_machine(machine: str | None, local: bool) -> None:
    hall = Hall()
    hall.ask(hall.door.join, A, machine=machine)
    (health,) = hall.registry.health(0, Setup(), {}, {})
    assert health.local == local


def test_a_full_server_puts_off_new_nodes_and_keeps_proven_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    hall = Hall(full="too many files are open")
    assert hall.ask(hall.door.join, A) == JoinReply(False, "too many files are open", later=True)
    assert hall.refused == ['sensor "front" was refused: too many files are open']
    assert not hall.registry.holds(A)
    monkeypatch.setattr(hall.registry, "proven", lambda node: True)
    assert hall.ask(hall.door.join, A).accepted
    assert len(hall.refused) == 1


def test_only_a_seated_nodes_frames_are_recorded_and_only_a_refused_nodes_are_not_tracked() -> None:
    hall = Hall()
    hall.door.frame(A, b"before", 1)
    hall.door.alive(A, True)
    hall.door.frame(A, b"seated", 2)
    hall.door.truth(A, b"true", 3)
    hall.door.frame(B, b"refused", 4)
    hall.door.truth(B, b"false", 5)
    assert hall.recording.told == [("frame", A, b"seated", 2), ("truth", "front", b"true", 3)]
    tracked = []
    while (message := hall.inbox.take(0.0)) is not None:
        tracked.append((message.data, message.stranger))
    assert sorted(tracked) == [(b"before", True), (b"seated", False)]
    hall.recording.recorder = None
    hall.door.frame(A, b"without a take", 6)
    hall.door.truth(A, b"without a take", 7)
    assert len(hall.recording.told) == 2
    hall.door.alive(A, False)
    assert hall.inbox.take(0.0) is None
