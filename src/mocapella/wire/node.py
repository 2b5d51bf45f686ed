"""A sensor node's link to the bus: live frames, lost frames on request, clock probes, queries, a liveliness token.

Live path: frames are published once, and dropped if the network is too slow. Record path: with zenoh queries, a
recording server requests the frames that it lacks, by sequence number, and acknowledges those on its disk
(docs/decisions/0021-acknowledged-frames.md).
"""

from __future__ import annotations

import contextlib
import json
import platform
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Final

import msgspec
import zenoh

from mocapella.decoding import decode_json
from mocapella.errors import InputError, NameTakenError, UnstoredFramesError, WireError
from mocapella.model.frame_types import HISTORY_FRAMES
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.truth import Truth
from mocapella.schema import encode_frame, encode_truth
from mocapella.supervision import Boundary
from mocapella.wire import keys
from mocapella.wire.delivery import read_request
from mocapella.wire.door import find_door, node_users
from mocapella.wire.doorbell import why_not
from mocapella.wire.outbox import Outbox
from mocapella.wire.session import open_node_at
from mocapella.wire.spool import Spool, Spooler

FAREWELL_S: Final = 10.0
"""Longest wait of a node that ends for the next acknowledgement of its frames [s]."""

OnQuestion = Callable[[bytes, Callable[[bytes], None]], None]
"""Called with a query's payload, and the function that sends its one answer."""


def new_node_id() -> int:
    """Return a random number from 1 to 2**63, so that the frames of two starts of a node are never confused."""
    return secrets.randbits(63) + 1


@dataclass(frozen=True)
class NodeStart:
    """Identity and first number of a node whose frames another program numbers and keeps.

    Attributes:
        node_id: the node's id.
        first: number of the first frame that is published; earlier ones were published before.
        lost: number of frames directly before ``first`` that the program has lost.
    """

    node_id: int
    first: int = 0
    lost: int = 0


@dataclass(frozen=True)
class JoinReply:
    """The server's answer to a node that asks to serve a sensor, or that leaves.

    Attributes:
        accepted: False if another node holds the sensor's name, if the server is short of file descriptors, or if a
            leaving node gives an invalid frame number; True otherwise, for a leaving node, too.
        message: why the node is not accepted; empty if it is.
        recording: whether a take is being recorded; a leaving node then waits until its frames are acknowledged.
        later: whether a node that was not accepted should ask again: the server is short of file descriptors.
    """

    accepted: bool
    message: str = ""
    recording: bool = False
    later: bool = False


class NodeLink:
    """A sensor's link to the bus. A context manager: leaving it calls `close`.

    The constructor does not wait for a server; frames published before one is connected are kept like any others.

    Args:
        connect: address of the server, a pairing code, or a file with one.
        sensor: name of the sensor.
        history_frames: number of frames to keep in memory for a recording server.
        spool: function of the attribute ``node`` that returns the node's spool, for frames of an open take that do not
            fit into memory; None drops them.
        say: receives messages about frames that are not stored.
        start: identity of the node, if another program numbers its frames (`relay`); None takes a random id.

    Attributes:
        node: the sensor's name and the id of this node.
        address: address of the server, as zenoh takes it.
        outbox: the frames that are kept for a recording server.
        hurry: while it is set, `close` waits for no acknowledgement; may be replaced.
        errors: catches unexpected errors of the callbacks.
        heard_s: monotonic time of the server's last query or reply; negative infinity before the first [s].
        put_off: why the server accepted no new sensor at the last `join`; empty otherwise.
        farewell_s: how long `close` waits for the next acknowledgement, until all frames of an open take have one [s].
        left: whether a server has accepted the farewell of `close`.
        on_published: called with sequence number, encoded bytes and ``sent_ns`` of each published frame, on the
            publishing thread; None calls nothing.

    Raises:
        BusError: ``connect`` is no address.
        KeyFileError: there is no key for it, or it is of another sensor.
        SettingsError: ``SESSION`` in ``connect`` is no name of a session.
    """

    def __init__(
        self,
        connect: str,
        sensor: str,
        *,
        history_frames: int = HISTORY_FRAMES,
        spool: Callable[[keys.NodeKey], Spool] | None = None,
        say: Callable[[str], None] = lambda text: None,
        start: NodeStart | None = None,
    ):
        start = start or NodeStart(new_node_id())
        self.node = keys.NodeKey(sensor, start.node_id)
        self._door = find_door(connect, node_users(sensor))
        self.address = self._door.locator
        self.farewell_s = FAREWELL_S
        self.left = False
        self.on_published: Callable[[int, bytes, int], None] | None = None
        self._say = say
        self.errors = Boundary(lambda text: say(f"{sensor}: {text}"))
        self.heard_s = float("-inf")
        self.put_off = ""
        self.hurry = threading.Event()
        place = None if spool is None else spool(self.node)
        self.outbox = Outbox(history_frames, place, first=start.first, lost=start.lost)
        self._server_since_ns: int | None = None
        self._spooler = Spooler(
            self.outbox, place, lambda text: say(f"{sensor}: {text}"), lambda: self._server_since_ns
        )
        self._ended = threading.Event()
        self._detached = False
        self._session = open_node_at(self._door)
        self._live = self._session.declare_publisher(
            keys.of_node("live", self.node),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        self._record_key = keys.of_node("record", self.node)
        self._record = self._session.declare_queryable(
            self._record_key, self.errors.wrap("request for frames", self._deliver)
        )
        self._truth = self._session.declare_publisher(keys.of_node("truth", self.node))
        self._clock = self._session.declare_queryable(
            keys.of_node("clock", self.node), self.errors.wrap("clock probe", self._tell_time)
        )
        self._alive = self._session.liveliness().declare_token(keys.of_node("alive/sensor", self.node))

    @property
    def published(self) -> int:
        """Number of published frames, or of a relayed node the number of the next frame."""
        return self.outbox.next

    def publish(self, frame: SensorFrame, truth: Truth | None = None) -> SensorFrame:
        """Publish a frame under the next sequence number, and keep it in ``outbox``; publish its ground truth, if any.

        Returns:
            The published copy: ``sensor``, ``node_id``, ``sequence`` and ``sent_ns`` are set. ``frame`` is unchanged.
        """
        stamped = msgspec.structs.replace(
            frame,
            sensor=self.node.sensor,
            node_id=self.node.node_id,
            sequence=self.published,
            sent_ns=time.monotonic_ns(),
        )
        self._publish(stamped, live=True)
        if truth is not None:
            stamped_truth = msgspec.structs.replace(truth, sensor=self.node.sensor, sequence=stamped.sequence)
            self._truth.put(encode_truth(stamped_truth))
        return stamped

    def relay(self, frame: SensorFrame, *, live: bool) -> None:
        """Keep a frame of another program in ``outbox`` as it is; publish it, too, if ``live``.

        Its number must be `published`, its node id that of ``node``, and its ``sent_ns`` on this process's clock.
        """
        self._publish(frame, live=live)

    def _publish(self, frame: SensorFrame, *, live: bool) -> None:
        data = encode_frame(frame)
        self.outbox.add(data, frame.sent_ns)
        if live:
            self._live.put(data)
        if self.on_published is not None:
            self.on_published(frame.sequence, data, frame.sent_ns)

    def answer(self, on_question: OnQuestion) -> None:
        """Pass the queries that arrive for this node to a function from now on.

        Args:
            on_question: called for each query, on a thread of the bus, so it must return quickly. Its arguments are the
                encoded query (`mocapella.wire.questions`) and a function that sends the encoded answer, which may be
                called later, on any thread.
        """
        key = keys.of_node("ask", self.node)

        def callback(query: zenoh.Query) -> None:
            def reply(data: bytes) -> None:
                with contextlib.suppress(zenoh.ZError):  # the other side has left, or this node is closing
                    query.reply(key, data)
                    query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation here

            on_question(query.payload.to_bytes() if query.payload is not None else b"", reply)

        self._asked = self._session.declare_queryable(key, self.errors.wrap("question", callback))

    def expect(self, on_expected: Callable[[bytes], None]) -> None:
        """Pass what the server expects in this sensor's images to a function from now on.

        Args:
            on_expected: called for each message (`mocapella.wire.expected`), on a thread of the bus, so it must return
                quickly.
        """
        key = keys.of_node("expect", self.node)
        self._expects = self._session.declare_subscriber(
            key, self.errors.wrap("expected people", lambda sample: on_expected(sample.payload.to_bytes()))
        )

    def join(self, timeout: float = 1.0) -> bool:
        """Claim the sensor's name at the server; return whether it accepts the node.

        False if no server answers within ``timeout`` seconds, or if it accepts no new sensor now (``put_off``).

        Raises:
            NameTakenError: another connected node serves a sensor of this name.
        """
        answer = self._tell("join", timeout)
        self.put_off = answer.message if answer is not None and answer.later else ""
        if answer is not None and not answer.accepted and not answer.later:
            raise NameTakenError(answer.message)
        return answer is not None and answer.accepted

    def why_not_admitted(self) -> str:
        """Return why the server does not admit this node, with the remedy; empty if it does, or nothing listens."""
        return self.put_off or why_not(self._door, self.node.sensor)

    def server_is_there(self) -> bool:
        """Whether a server is connected now; waits up to half a second for its liveliness token.

        A server that hangs, or whose network is down, counts as connected for ten more seconds; see `heard_s`.
        """
        there = any(True for _ in self._session.liveliness().get(keys.SERVER_ALIVE, timeout=0.5))
        if not there:
            self._server_since_ns = None
        elif self._server_since_ns is None:
            self._server_since_ns = time.monotonic_ns()
        return there

    def close(self) -> None:
        """Tell the server the last frame's number, wait until all frames are acknowledged, and leave the bus.

        Only frames of an open take are waited for, and at most `farewell_s` without a further acknowledgement.

        Raises:
            UnstoredFramesError: frames of an open take are not acknowledged; names the files that keep them.
        """
        if self._detached:
            return
        try:
            self._ended.clear()
            self.outbox.leave()
            self._say_farewell()
        finally:
            self._session.close()  # type: ignore[no-untyped-call]
            self._spooler.close()
        if self._spooler.missing:
            kept = self._spooler.kept
            where = f"they are in {', '.join(kept)}: mocapella take merge TAKE FILE adds them"
            raise UnstoredFramesError(
                f"{self.node.sensor}: {self._spooler.missing} frames are not stored by the server; "
                + (where if kept else "they are lost")
            )

    def detach(self) -> None:
        """Leave the bus at once, without a farewell, and keep no frame: the program that keeps them will come back.

        A take's server calls the end of the node unknown until then. `close` does nothing afterwards.
        """
        self._detached = True
        self._session.close()  # type: ignore[no-untyped-call]
        for take in self.outbox.holds:
            self.outbox.release(take)
        self._spooler.close()

    def _say_farewell(self) -> None:
        """Wait for the acknowledgement of the last frame, if a take is open; a server may come back meanwhile."""
        deadline, stored = time.monotonic() + self.farewell_s, self._stored()
        answer: JoinReply | None = None
        while True:
            if answer is None:
                answer = self._tell("leave", min(0.5, self.farewell_s))
                self.left = answer is not None and answer.accepted
            recording = answer is not None and answer.accepted and answer.recording and not self._ended.is_set()
            if not (recording or self.outbox.holds) or self.hurry.is_set() or time.monotonic() >= deadline:
                return
            if (now := self._stored()) != stored:  # a long outage may be behind
                deadline, stored = time.monotonic() + self.farewell_s, now
            time.sleep(0.02)
            if not self.server_is_there():
                answer = None  # one that is started again does not know the last number

    def _stored(self) -> dict[str, int]:
        """Return the number up to which each take has the frames."""
        return {take: hold.stored for take, hold in self.outbox.holds.items()}

    def _tell(self, verb: str, timeout: float) -> JoinReply | None:
        """Tell the server that this node joins or leaves; return the answer, None without a server."""
        state = {"machine": platform.node(), "next": self.outbox.next}
        for reply in self._session.get(keys.of_node(verb, self.node), payload=json.dumps(state), timeout=timeout):
            if reply.ok is not None:
                self.heard_s = time.monotonic()
                with contextlib.suppress(InputError):  # of an older server, which does not know the verb
                    return decode_json(reply.ok.payload.to_bytes(), JoinReply, what="reply of a server")
        return None

    def _tell_time(self, query: zenoh.Query) -> None:
        self.heard_s = time.monotonic()
        query.reply(query.key_expr, str(time.monotonic_ns()).encode())

    def _deliver(self, query: zenoh.Query) -> None:
        """Answer a recording server: the frames that it lacks, and then this node's state."""
        with contextlib.suppress(zenoh.ZError):  # the other side has left, or this node is closing
            try:
                request = read_request(query.payload.to_bytes() if query.payload is not None else b"")
            except WireError as error:
                query.reply_err(str(error).encode())
                return
            self.heard_s = time.monotonic()
            answer = self.outbox.update(request, time.monotonic_ns())
            self._spooler.begin()
            gone: dict[tuple[int, int], str] = {}
            for data in self.outbox.wanted(request, gone):
                query.reply(self._record_key, data)
            for problem in dict.fromkeys(gone.values()):
                self._say(f"{self.node.sensor}: {problem}")
            answer = msgspec.structs.replace(answer, gone=list(gone))
            query.reply(self._record_key, msgspec.json.encode(answer), encoding=zenoh.Encoding.APPLICATION_JSON)
            query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation here
            if request.end is not None or request.closed:
                self._ended.set()

    def __enter__(self) -> NodeLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except UnstoredFramesError as unstored:
            if error is None:
                raise
            self._say(str(unstored))
