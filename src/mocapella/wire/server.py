"""A server's link to the bus. Callbacks run on the bus's own threads, and must only pass the bytes on."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import msgspec
import zenoh
from zenoh import ext

from mocapella.errors import WireError
from mocapella.model.session import CommandReply
from mocapella.wire import keys
from mocapella.wire.address import parse_address
from mocapella.wire.clock import ClockProbe, read_clock
from mocapella.wire.doorbell import Doorbell
from mocapella.wire.session import open_server
from mocapella.wire.session_key import session_key, session_name

OnFrame = Callable[[keys.NodeKey, bytes, int], None]
"""Called with the node, the message, and its arrival on the server's monotonic clock [ns]."""
OnAlive = Callable[[keys.NodeKey, bool], None]
_MOST_SENDER = 120


class Answer:
    """Answers a command once, when it is called with the reply.

    Attributes:
        sender: what the program that sent the command says about itself; empty if nothing. Only an operator can have.
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        said = b"" if query.attachment is None else query.attachment.to_bytes()[: 4 * _MOST_SENDER]
        _, _, words = said.decode("utf-8", "replace").partition(" ")
        self.sender = "".join(letter for letter in words if letter.isprintable())[:_MOST_SENDER]

    def __call__(self, data: bytes) -> None:
        """Send the reply."""
        self._query.reply(self._query.key_expr, data)
        self._query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation here


OnCommand = Callable[[str, dict[str, Any], Answer], None]
"""Called with the verb, its arguments, and what answers it."""
OnNonsense = Callable[[str], None]

_CACHES = "@adv/pub/**"
"""Suffix of the key under which an advanced publisher's cache answers."""
_HISTORY_TIMEOUT_S = 30.0
_PROBES = 8
_RECOVER_EVERY = timedelta(seconds=0.5)


class ServerLink:
    """A server's link to the bus. It listens at once; callbacks run after `serve`.

    Raises:
        AddressInUseError, BusError, KeyFileError: as in `open_server`.
    """

    def __init__(self, listen: str, *, on_nonsense: OnNonsense) -> None:
        address = parse_address(listen)
        key = session_key(session_name(address.session))
        self._session = open_server(listen)
        self._bell = Doorbell(address, key, on_nonsense)
        self._on_nonsense = on_nonsense
        drop = zenoh.CongestionControl.DROP
        self._scene = self._session.declare_publisher(keys.SCENE, congestion_control=drop, express=True)
        self._status = self._session.declare_publisher(keys.STATUS, congestion_control=drop)
        self._record: Any = None
        self._serving: list[Any] = []

    def serve(self, *, on_frame: OnFrame, on_truth: OnFrame, on_alive: OnAlive, on_command: OnCommand) -> None:
        """Receive messages of nodes and commands, and declare the server's liveliness token."""
        session, liveliness = self._session, self._session.liveliness()
        self._serving = [
            session.declare_subscriber(keys.ALL_LIVE, self._forwarding(on_frame)),
            session.declare_subscriber(keys.ALL_TRUTH, self._forwarding(on_truth)),
            session.declare_queryable(keys.ALL_COMMANDS, self._answering(on_command)),
            liveliness.declare_subscriber(keys.ALL_SENSORS_ALIVE, self._watching(on_alive), history=True),
            liveliness.declare_token(keys.SERVER_ALIVE),
        ]

    @property
    def refused(self) -> int:
        """Number of times that a program with a wrong key has rung."""
        return self._bell.refused

    def publish_scene(self, data: bytes) -> None:
        """Publish a scene; slow readers miss some."""
        self._scene.put(data)

    def publish_status(self, data: bytes) -> None:
        """Publish the session's status."""
        self._status.put(data)

    def start_record_path(self, on_frame: OnFrame) -> None:
        """Begin to receive the record path; frames lost from now on are fetched from the node's cache.

        Earlier frames are not fetched: with a history, or with heartbeats to detect losses, the bus may fetch all that
        a node keeps (measured; docs/decisions/0004-two-paths.md). `fetch_history` requests earlier frames.
        """
        self._record = ext.declare_advanced_subscriber(
            self._session,
            keys.ALL_RECORD,
            self._forwarding(on_frame),
            recovery=ext.RecoveryConfig(
                periodic_queries=_RECOVER_EVERY,  # type: ignore[arg-type]  # a timedelta, whatever zenoh's stub says
                heartbeat=None,
            ),
            subscriber_detection=True,
        )

    def fetch_history(self, on_frame: OnFrame, history_s: float) -> None:
        """Request the frames of the last ``history_s`` seconds from the caches of all connected nodes.

        Returns at once; the frames arrive like those of the record path, also frames received before.
        """
        pass_on = self._forwarding(on_frame)
        self._session.get(
            f"{keys.ALL_RECORD}/{_CACHES}?_anyke;_time=[now(-{history_s:.3f}s)..]",
            lambda reply: None if reply.ok is None else pass_on(reply.ok),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_HISTORY_TIMEOUT_S,
        )

    def stop_record_path(self) -> None:
        """Stop receiving the record path."""
        if self._record is not None:
            self._record.undeclare()
            self._record = None

    def probe_clock(self, node: keys.NodeKey, timeout: float = 1.0) -> list[ClockProbe]:
        """Query the node's monotonic clock several times in sequence, until it leaves a query unanswered.

        Raises:
            WireError: an answer is no time.
        """
        answers: list[ClockProbe] = []
        key = keys.of_node("clock", node)
        for asked in range(_PROBES):
            sent = time.monotonic_ns()
            for reply in self._session.get(key, timeout=timeout):
                received = time.monotonic_ns()
                if reply.ok is not None:
                    answers.append(ClockProbe(sent, read_clock(reply.ok.payload.to_bytes()), received))
            if len(answers) <= asked:
                break
        return answers

    def close(self) -> None:
        """Leave the bus, which removes the server's liveliness token."""
        self._bell.close()
        self._session.close()  # type: ignore[no-untyped-call]

    def _forwarding(self, pass_on: OnFrame) -> Callable[[zenoh.Sample], None]:
        def callback(sample: zenoh.Sample) -> None:
            arrived = time.monotonic_ns()
            try:
                node = keys.node_of(str(sample.key_expr))
            except WireError as error:
                self._on_nonsense(str(error))
                return
            pass_on(node, sample.payload.to_bytes(), arrived)

        return callback

    def _watching(self, on_alive: OnAlive) -> Callable[[zenoh.Sample], None]:
        def callback(sample: zenoh.Sample) -> None:
            try:
                node = keys.node_of(str(sample.key_expr))
            except WireError as error:
                self._on_nonsense(str(error))
                return
            on_alive(node, sample.kind == zenoh.SampleKind.PUT)

        return callback

    def _answering(self, on_command: OnCommand) -> Callable[[zenoh.Query], None]:
        def callback(query: zenoh.Query) -> None:
            verb = str(query.key_expr).rpartition("/")[2]
            payload = query.payload.to_bytes() if query.payload is not None else b"{}"
            try:
                arguments = msgspec.json.decode(payload or b"{}", type=dict[str, Any])
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
                self._on_nonsense(f"command {verb}: the arguments are no JSON object ({error})")
                query.reply_err(msgspec.json.encode(CommandReply(ok=False, message="the arguments are no JSON object")))
                return
            on_command(verb, arguments, Answer(query))

        return callback
