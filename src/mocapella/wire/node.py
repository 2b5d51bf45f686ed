"""A sensor node's link to the bus: frames on two paths, clock probes, queries, and a liveliness token.

Live path: best effort, newest wins. Record path: the advanced publisher keeps the last minutes in its cache, from which
a recording server fetches missed frames. Both drop frames when the link is full, because dropped frames of the record
path are fetched again; the *replies* must not be dropped, or the frames are lost (measured: with a blocking publisher
and dropping replies, a server that stood still for two seconds lost frames and delayed the sensor; see
docs/decisions/0004-two-paths.md).
"""

from __future__ import annotations

import contextlib
import json
import platform
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import msgspec
import zenoh
from zenoh import ext

from mocapella.errors import NameTakenError
from mocapella.model.frame_types import HISTORY_FRAMES
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.truth import Truth
from mocapella.schema import encode_frame, encode_truth
from mocapella.wire import keys
from mocapella.wire.door import find_door, node_users
from mocapella.wire.doorbell import why_not
from mocapella.wire.session import open_node_at

OnQuestion = Callable[[bytes, Callable[[bytes], None]], None]
"""Called with a query and the function that answers it once."""


def new_node_id() -> int:
    """Return a unique random number, so that frames of two starts are never confused."""
    return secrets.randbits(63) + 1


@dataclass(frozen=True)
class JoinReply:
    """The server's answer to a node that asks to serve a sensor."""

    accepted: bool
    message: str = ""


class NodeLink:
    """A sensor's link to the bus. A context manager: leaving it notifies the server at once.

    Args:
        connect: address of the server, a pairing code, or a file with one.
        sensor: name of the sensor.
        history_frames: number of frames to keep for a recording server.

    Attributes:
        node: identity on the bus.
        address: of the server.
        published: number of published frames.

    Raises:
        BusError: ``connect`` is no address.
        KeyFileError: there is no key for it, or it is of another sensor.
    """

    def __init__(self, connect: str, sensor: str, *, history_frames: int = HISTORY_FRAMES):
        self.node = keys.NodeKey(sensor, new_node_id())
        self._door = find_door(connect, node_users(sensor))
        self.address = self._door.locator
        self.published = 0
        alive = keys.of_node("alive/sensor", self.node)
        self._session = open_node_at(self._door)
        self._live = self._session.declare_publisher(
            keys.of_node("live", self.node),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        self._record = ext.declare_advanced_publisher(
            self._session,
            keys.of_node("record", self.node),
            cache=ext.CacheConfig(
                max_samples=history_frames,
                replies_config=ext.RepliesConfig(congestion_control=zenoh.CongestionControl.BLOCK),
            ),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.2, sporadic_heartbeat=None),
            publisher_detection=True,
            reliability=zenoh.Reliability.RELIABLE,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        self._truth = self._session.declare_publisher(keys.of_node("truth", self.node))
        clock_key = keys.of_node("clock", self.node)
        self._clock = self._session.declare_queryable(
            clock_key, lambda query: query.reply(clock_key, str(time.monotonic_ns()).encode())
        )
        self._alive = self._session.liveliness().declare_token(alive)

    def publish(self, frame: SensorFrame, truth: Truth | None = None) -> SensorFrame:
        """Number, stamp and publish a frame on both paths, with a simulation's ground truth."""
        stamped = msgspec.structs.replace(
            frame,
            sensor=self.node.sensor,
            node_id=self.node.node_id,
            sequence=self.published,
            sent_ns=time.monotonic_ns(),
        )
        data = encode_frame(stamped)
        self._live.put(data)
        self._record.put(data)
        self.published += 1
        if truth is not None:
            stamped_truth = msgspec.structs.replace(truth, sensor=self.node.sensor, sequence=stamped.sequence)
            self._truth.put(encode_truth(stamped_truth))
        return stamped

    def answer(self, on_question: OnQuestion) -> None:
        """Answer queries from now on; ``on_question`` must return quickly, because the bus waits for it."""
        key = keys.of_node("ask", self.node)

        def callback(query: zenoh.Query) -> None:
            def reply(data: bytes) -> None:
                with contextlib.suppress(zenoh.ZError):  # the other side has left, or this node is closing
                    query.reply(key, data)
                    query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation here

            on_question(query.payload.to_bytes() if query.payload is not None else b"", reply)

        self._asked = self._session.declare_queryable(key, callback)

    def join(self, timeout: float = 1.0) -> bool:
        """Claim the sensor's name at the server; return False if no server answers.

        Raises:
            NameTakenError: another connected node serves a sensor of this name.
        """
        who = {"sensor": self.node.sensor, "node_id": f"{self.node.node_id:016x}", "machine": platform.node()}
        for reply in self._session.get(keys.of_command("join"), payload=json.dumps(who), timeout=timeout):
            if reply.ok is None:
                continue
            answer = msgspec.json.decode(reply.ok.payload.to_bytes(), type=JoinReply)
            if not answer.accepted:
                raise NameTakenError(answer.message)
            return True
        return False

    def why_not_admitted(self) -> str:
        """Return why the server at the address does not admit this node, with the remedy; empty if none says so."""
        return why_not(self._door, self.node.sensor)

    def server_is_there(self) -> bool:
        """Whether a server is connected now."""
        return any(True for _ in self._session.liveliness().get(keys.SERVER_ALIVE, timeout=0.5))

    def close(self) -> None:
        """Leave the bus."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> NodeLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
