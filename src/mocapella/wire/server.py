"""What a server does on the bus. Callbacks come on the bus's own threads and must only hand the bytes on."""

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
from mocapella.wire.clock import ClockProbe, read_clock
from mocapella.wire.session import open_server

OnFrame = Callable[[keys.NodeKey, bytes, int], None]
"""Called with the node, the message, and when it arrived on the server's monotonic clock [ns]."""
OnAlive = Callable[[keys.NodeKey, bool], None]
OnCommand = Callable[[str, dict[str, Any], Callable[[bytes], None]], None]
"""Called with the verb, its arguments, and the function that answers it."""
OnNonsense = Callable[[str], None]

_CACHES = "@adv/pub/**"
"""Where, under its key, an advanced publisher's cache answers."""
_HISTORY_TIMEOUT_S = 30.0
_PROBES = 8
_RECOVER_EVERY = timedelta(seconds=0.5)


class ServerLink:
    """The server's end of the bus. It listens at once; callbacks come after `serve`.

    Raises:
        AddressInUseError, BusError: as `open_server`.
    """

    def __init__(self, listen: str, *, on_nonsense: OnNonsense) -> None:
        self._session = open_server(listen)
        self._on_nonsense = on_nonsense
        drop = zenoh.CongestionControl.DROP
        self._scene = self._session.declare_publisher(keys.SCENE, congestion_control=drop, express=True)
        self._status = self._session.declare_publisher(keys.STATUS, congestion_control=drop)
        self._record: Any = None
        self._serving: list[Any] = []

    def serve(self, *, on_frame: OnFrame, on_truth: OnFrame, on_alive: OnAlive, on_command: OnCommand) -> None:
        """Take in what the nodes send and what is commanded, and say that a server is here."""
        session, liveliness = self._session, self._session.liveliness()
        self._serving = [
            session.declare_subscriber(keys.ALL_LIVE, self._handing_on(on_frame)),
            session.declare_subscriber(keys.ALL_TRUTH, self._handing_on(on_truth)),
            session.declare_queryable(keys.ALL_COMMANDS, self._answering(on_command)),
            liveliness.declare_subscriber(keys.ALL_SENSORS_ALIVE, self._watching(on_alive), history=True),
            liveliness.declare_token(keys.SERVER_ALIVE),
        ]

    def publish_scene(self, data: bytes) -> None:
        """To whoever reads results; who reads too slowly misses some."""
        self._scene.put(data)

    def publish_status(self, data: bytes) -> None:
        """To whoever shows the session."""
        self._status.put(data)

    def start_record_path(self, on_frame: OnFrame) -> None:
        """Begin to take in the record path; what is lost on the way from now on is fetched from the node's cache.

        Nothing of what came before: with a history, or with the heartbeat as the sign of a loss, the bus may fetch
        all that a node has kept (measured; docs/decisions/0004-two-paths.md). `fetch_history` asks for what is wanted.
        """
        self._record = ext.declare_advanced_subscriber(
            self._session,
            keys.ALL_RECORD,
            self._handing_on(on_frame),
            recovery=ext.RecoveryConfig(
                periodic_queries=_RECOVER_EVERY,  # type: ignore[arg-type]  # a timedelta, whatever zenoh's stub says
                heartbeat=None,
            ),
            subscriber_detection=True,
        )

    def fetch_history(self, on_frame: OnFrame, history_s: float) -> None:
        """Ask the caches of all nodes that are connected for what they published in the last ``history_s`` seconds.

        Returns at once; the frames come as those of the record path do, also those that came before.
        """
        hand_on = self._handing_on(on_frame)
        self._session.get(
            f"{keys.ALL_RECORD}/{_CACHES}?_anyke;_time=[now(-{history_s:.3f}s)..]",
            lambda reply: None if reply.ok is None else hand_on(reply.ok),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_HISTORY_TIMEOUT_S,
        )

    def stop_record_path(self) -> None:
        """Take in no more of it."""
        if self._record is not None:
            self._record.undeclare()
            self._record = None

    def probe_clock(self, node: keys.NodeKey, timeout: float = 1.0) -> list[ClockProbe]:
        """Ask the node for its monotonic clock some times, one after the other, until it leaves one unanswered.

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
        """Leave the bus; everybody sees the server's liveliness token go."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _handing_on(self, hand_on: OnFrame) -> Callable[[zenoh.Sample], None]:
        def callback(sample: zenoh.Sample) -> None:
            arrived = time.monotonic_ns()
            try:
                node = keys.node_of(str(sample.key_expr))
            except WireError as error:
                self._on_nonsense(str(error))
                return
            hand_on(node, sample.payload.to_bytes(), arrived)

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

            def answer(data: bytes) -> None:
                query.reply(query.key_expr, data)
                query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation here

            on_command(verb, arguments, answer)

        return callback
