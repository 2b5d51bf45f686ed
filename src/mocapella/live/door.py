"""Callbacks of the bus: admit or refuse nodes and messages, and pass messages on to the tracker and the recorder."""

from __future__ import annotations

import platform
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec

from mocapella.errors import WireError
from mocapella.live.command_queue import Answer, CommandQueue
from mocapella.live.inbox import Inbox, ReceivedMessage
from mocapella.live.recording_service import RecordingService
from mocapella.live.sensor_registry import NodeStanding, SensorRegistry
from mocapella.model.session import CommandReply
from mocapella.wire.delivery import check_number
from mocapella.wire.keys import NodeKey
from mocapella.wire.node import JoinReply


class Door:
    """Passes messages to the tracker's and the recorder's threads.

    A node has a *seat* if it holds its sensor's name in the registry. Its messages are recorded at once; those of a
    node without a seat (a *stranger*) are first validated by the tracker's thread. The methods are the callbacks of
    `mocapella.wire.server.ServerLink.serve`: ``data`` is an encoded message, ``arrived_ns`` its arrival on the server's
    monotonic clock [ns], and ``answer`` takes the encoded reply.

    Args:
        registry: decides who is admitted; used under ``lock``.
        lock: lock of the registry.
        inbox: queue of frames for the tracker's thread.
        commands: queue of commands for the tracker's thread.
        recording: returns the service that records takes.
        full: returns why no new sensor is admitted; an empty text if one is.
        refused: receives a message about each join that ``full`` refuses.
    """

    def __init__(
        self,
        registry: SensorRegistry,
        lock: threading.RLock,
        inbox: Inbox,
        commands: CommandQueue,
        recording: Callable[[], RecordingService],
        *,
        full: Callable[[], str] = lambda: "",
        refused: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._registry, self._lock, self._inbox, self._commands = registry, lock, inbox, commands
        self._recording, self._full, self._refused = recording, full, refused

    def frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """Pass a live frame to the recorder and to the tracker; drop it if another node holds the sensor's name."""
        with self._lock:
            standing = self._registry.standing(node, arrived_ns)
        recorder = self._recording().recorder
        if recorder is not None and standing is NodeStanding.SEATED:
            recorder.frame(node, data, arrived_ns)
        if standing is not NodeStanding.REFUSED:
            self._inbox.put(ReceivedMessage(node, data, arrived_ns, standing is NodeStanding.STRANGER))

    def truth(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """Pass a simulation's ground truth to the recorder, if a take is recorded and the node has a seat."""
        recorder = self._recording().recorder
        if recorder is not None and self._is_seated(node):
            recorder.truth(node.sensor, data, arrived_ns)

    def alive(self, node: NodeKey, alive: bool) -> None:
        """Note that a node has joined or left the bus."""
        with self._lock:
            self._registry.set_connected(node, alive, time.monotonic_ns())
        if not alive:
            self._inbox.forget(node)

    def command(self, verb: str, arguments: dict[str, Any], answer: Answer) -> None:
        """Pass a command to the tracker's queue, or answer at once with a refusal if too many wait."""
        refusal = self._commands.put(verb, arguments, answer)
        if refusal:
            answer(msgspec.json.encode(CommandReply(False, refusal)))
        else:
            self._inbox.wake()

    def _is_seated(self, node: NodeKey) -> bool:
        with self._lock:
            return self._registry.holds(node)

    def join(self, node: NodeKey, arguments: dict[str, Any], answer: Answer) -> None:
        """Answer a node that asks for its sensor's name, at once, with a `JoinReply`."""
        full = self._full()
        with self._lock:
            refuse = bool(full) and not self._registry.proven(node)
        if refuse:
            self._refused(f'sensor "{node.sensor}" was refused: {full}')
        reply = JoinReply(False, full, later=True) if refuse else self._admit(node, arguments, None)
        answer(msgspec.json.encode(reply))

    def leave(self, node: NodeKey, arguments: dict[str, Any], answer: Answer) -> None:
        """Answer a node that sends no more frames, at once, with a `JoinReply`.

        The recording learns the number after the node's last frame, ``arguments["next"]``.
        """
        try:
            reply = self._admit(node, arguments, check_number(arguments.get("next")))
        except WireError as error:
            reply = JoinReply(False, str(error))
        answer(msgspec.json.encode(reply))

    def _admit(self, node: NodeKey, arguments: dict[str, Any], end: int | None) -> JoinReply:
        with self._lock:
            refusal = self._registry.join(node, time.monotonic_ns())
            self._registry.set_local(node, arguments.get("machine") == platform.node())
        recording = self._recording()
        if end is not None and not refusal:
            recording.leaving(node, end)
        return JoinReply(not refusal, refusal, recording.active)
