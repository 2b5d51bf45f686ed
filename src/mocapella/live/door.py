"""What arrives from the bus, on the bus's threads: admitted, refused, and only passed on."""

from __future__ import annotations

import platform
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec

from mocapella.errors import SettingsError, WireError
from mocapella.live.command_queue import Answer, CommandQueue
from mocapella.live.inbox import Inbox, ReceivedMessage
from mocapella.live.recorder import Recorder
from mocapella.live.sensor_registry import NodeStanding, SensorRegistry
from mocapella.model.observations import check_sensor_name
from mocapella.model.session import CommandReply
from mocapella.wire.keys import NodeKey, parse_node_id
from mocapella.wire.node import JoinReply


class Door:
    """Passes messages to the tracker's and the recorder's threads.

    A node's messages are recorded once it has a seat; a stranger's are first looked at by the tracker's thread.

    Args:
        registry: decides who is admitted; used under ``lock``.
        lock: of the registry.
        inbox: of the tracker's thread.
        commands: of the tracker's thread.
        recorder: returns that of the present take, or None.
    """

    def __init__(
        self,
        registry: SensorRegistry,
        lock: threading.RLock,
        inbox: Inbox,
        commands: CommandQueue,
        recorder: Callable[[], Recorder | None],
    ) -> None:
        self._registry, self._lock, self._inbox, self._commands = registry, lock, inbox, commands
        self._recorder = recorder

    def frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """Pass a live frame to the tracker."""
        with self._lock:
            standing = self._registry.standing(node, arrived_ns)
        if standing is not NodeStanding.REFUSED:
            self._inbox.put(ReceivedMessage(node, data, arrived_ns, standing is NodeStanding.STRANGER))

    def recorded_frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """Pass a frame of the record path to the recorder."""
        recorder = self._recorder()
        if recorder is not None and self._is_seated(node):
            recorder.frame(node, data, arrived_ns)

    def truth(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """Pass a simulation's ground truth to the recorder."""
        recorder = self._recorder()
        if recorder is not None and self._is_seated(node):
            recorder.truth(node.sensor, data, arrived_ns)

    def alive(self, node: NodeKey, alive: bool) -> None:
        """Note that a node has joined or left the bus."""
        with self._lock:
            self._registry.set_connected(node, alive, time.monotonic_ns())
        if not alive:
            self._inbox.forget(node)

    def command(self, verb: str, arguments: dict[str, Any], answer: Answer) -> None:
        """Answer a join at once; pass any other command to the tracker, or refuse it if too many wait."""
        if verb == "join":
            answer(msgspec.json.encode(self._join(arguments)))
            return
        refusal = self._commands.put(verb, arguments, answer)
        if refusal:
            answer(msgspec.json.encode(CommandReply(False, refusal)))
        else:
            self._inbox.wake()

    def _is_seated(self, node: NodeKey) -> bool:
        with self._lock:
            return self._registry.holds(node)

    def _join(self, arguments: dict[str, Any]) -> JoinReply:
        try:
            sensor = check_sensor_name(str(arguments.get("sensor"))[:80])
            node = NodeKey(sensor, parse_node_id(str(arguments.get("node_id"))))
        except (SettingsError, WireError) as error:
            return JoinReply(False, str(error))
        with self._lock:
            refusal = self._registry.join(node, time.monotonic_ns())
            self._registry.set_local(node, arguments.get("machine") == platform.node())
        return JoinReply(not refusal, refusal)
