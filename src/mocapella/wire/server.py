"""A server's link to the bus. Callbacks run on zenoh's threads, and must return quickly: they only pass bytes on."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec
import zenoh

from mocapella.decoding import decode_json
from mocapella.errors import InputError, WireError
from mocapella.model.limits import MAX_COMMAND_BYTES
from mocapella.model.session import CommandReply
from mocapella.supervision import Boundary
from mocapella.wire import keys
from mocapella.wire.address import parse_address
from mocapella.wire.clock import ClockProbe, read_clock
from mocapella.wire.delivery import FrameAnswer, FrameRequest, read_answer
from mocapella.wire.doorbell import Doorbell
from mocapella.wire.session import open_server
from mocapella.wire.session_key import session_key, session_name

OnFrame = Callable[[keys.NodeKey, bytes, int], None]
"""Called with the node, the message, and its arrival on the server's monotonic clock [ns]."""
OnAlive = Callable[[keys.NodeKey, bool], None]
"""Called with a node, and whether its liveliness token has appeared or disappeared."""
OnNonsense = Callable[[str], None]
"""Called with a description of a message that cannot be read."""

REQUEST_TIMEOUT_S = 2.0
"""How long a node may take to answer a request for frames [s]."""
_PROBES = 8
_MAX_CLIENT = 32
"""Bytes of a client's identity that are read."""
_MOST_SENDER = 120


class Answer:
    """Answers a command: a function to be called once, with the encoded reply.

    Args:
        query: the command's query on the bus.

    Attributes:
        client: zenoh id that the sending program claims, as hex of its text; empty if it claims none. Not verified.
        sender: program, user and machine that the sender claims, such as ``the view of anna@lab``; empty if none.
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        said = b"" if query.attachment is None else query.attachment.to_bytes()[: _MAX_CLIENT + 4 * _MOST_SENDER]
        self.client = said[:_MAX_CLIENT].hex()
        _, _, words = said.decode("utf-8", "replace").partition(" ")
        self.sender = "".join(letter for letter in words if letter.isprintable())[:_MOST_SENDER]

    def __call__(self, data: bytes) -> None:
        """Send the encoded reply."""
        self._query.reply(self._query.key_expr, data)
        self._query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub has no annotation here


OnCommand = Callable[[str, dict[str, Any], Answer], None]
"""Called with a command's verb and arguments, and the function that sends the reply."""
OnMember = Callable[[keys.NodeKey, dict[str, Any], Answer], None]
"""Called with a node that joins or leaves, the arguments of its query, and the function that sends the reply."""


class ServerLink:
    """A server's link to the bus. It listens at once; callbacks run after `serve`.

    Args:
        listen: address to listen at, ``[SESSION@]tls/HOST:PORT``.
        on_nonsense: value of the attributes ``on_nonsense`` and ``on_refused``, which may be replaced later.
        errors: value of the attribute ``errors``; None makes a `Boundary` that only logs.

    Attributes:
        on_nonsense: is called with a description of each message that cannot be read.
        on_refused: is called with a message at the first attempt of each program that has a wrong key.
        errors: catches unexpected errors of the callbacks that `serve` registers.

    Raises:
        AddressInUseError: another program listens there.
        BusError: ``listen`` is no address, or it cannot listen there for another reason.
        KeyFileError: the session's key cannot be used.
        SettingsError: ``SESSION`` is no name of a session.
    """

    def __init__(self, listen: str, *, on_nonsense: OnNonsense, errors: Boundary | None = None) -> None:
        self.errors = errors or Boundary()
        address = parse_address(listen)
        key = session_key(session_name(address.session))
        self._session = open_server(listen)
        self.on_nonsense = self.on_refused = on_nonsense
        self._bell = Doorbell(
            address,
            key,
            note=self._on_ring,
            guard=lambda answer: self.errors.run("ring at the door", answer),
        )
        drop = zenoh.CongestionControl.DROP
        self._scene = self._session.declare_publisher(keys.SCENE, congestion_control=drop, express=True)
        self._status = self._session.declare_publisher(keys.STATUS, congestion_control=drop)
        self._connected: set[keys.NodeKey] = set()
        self._expected: dict[keys.NodeKey, zenoh.Publisher] = {}
        self._serving: list[Any] = []

    def _on_ring(self, text: str) -> None:
        self.on_refused(text)

    def serve(
        self,
        *,
        on_frame: OnFrame,
        on_truth: OnFrame,
        on_alive: OnAlive,
        on_command: OnCommand,
        on_join: OnMember,
        on_leave: OnMember,
    ) -> None:
        """Receive messages of nodes and commands, and declare the server's liveliness token.

        The callbacks run on the bus's threads until `close`.

        Args:
            on_frame: called for each live frame, with its node, its encoded bytes, and its arrival on the server's
                monotonic clock [ns].
            on_truth: called with the same three for each ground truth of a simulated frame.
            on_alive: called with a node, and True when it connects, False when it disconnects; with True also for each
                node that is connected already.
            on_command: called for each command, with its verb, its arguments by name, and the function that sends the
                reply.
            on_join: called for each node that asks to serve its sensor, with the node, the arguments of its query by
                name, and the function that sends the reply.
            on_leave: called for each node that is about to leave, with the same three.
        """
        session, liveliness = self._session, self._session.liveliness()
        self._serving = [
            session.declare_subscriber(keys.ALL_LIVE, self._forwarding(on_frame)),
            session.declare_subscriber(keys.ALL_TRUTH, self._forwarding(on_truth)),
            session.declare_queryable(keys.ALL_COMMANDS, self._answering(on_command)),
            session.declare_queryable(keys.ALL_JOIN, self._admitting(on_join)),
            session.declare_queryable(keys.ALL_LEAVE, self._admitting(on_leave)),
            liveliness.declare_subscriber(keys.ALL_SENSORS_ALIVE, self._watching(on_alive), history=True),
            liveliness.declare_token(keys.SERVER_ALIVE),
        ]

    @property
    def refused(self) -> int:
        """Number of attempts of programs with a wrong key that asked for the reason (`mocapella.wire.doorbell`)."""
        return self._bell.refused

    def publish_scene(self, data: bytes) -> None:
        """Publish an encoded scene; slow readers miss some."""
        self._scene.put(data)

    def publish_status(self, data: bytes) -> None:
        """Publish the session's status, encoded as JSON."""
        self._status.put(data)

    def awaits_expected(self, node: keys.NodeKey) -> bool:
        """Whether a connected node wants to be told where people are expected in its images; always on one thread."""
        for gone in [one for one in self._expected if one not in self._connected]:
            self._expected.pop(gone).undeclare()  # type: ignore[no-untyped-call]
        if node not in self._connected:
            return False
        publisher = self._expected.get(node)
        if publisher is None:
            key = keys.of_node("expect", node)
            publisher = self._session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.DROP, express=True
            )
            self._expected[node] = publisher
        return publisher.matching_status

    def publish_expected(self, node: keys.NodeKey, data: bytes) -> None:
        """Tell a node that awaits it (`awaits_expected`) where people are expected (`mocapella.wire.expected`)."""
        self._expected[node].put(data)

    def request_frames(
        self,
        node: keys.NodeKey,
        request: FrameRequest,
        on_frame: OnFrame,
        on_answer: Callable[[FrameAnswer], None],
        on_end: Callable[[], None],
    ) -> None:
        """Tell a node which of its frames are stored, and ask for those that are missing; return at once.

        The callbacks run on the bus's threads; ``errors`` catches their unexpected errors.

        Args:
            node: the node to ask.
            request: the numbers of the stored frames and of the missing ones.
            on_frame: called for each frame that the node sends, in order, with the node, the encoded bytes, and the
                arrival on the server's monotonic clock [ns].
            on_answer: called with the node's state after its frames, if it comes within `REQUEST_TIMEOUT_S`.
            on_end: called last, without arguments, whether or not the node answers.
        """
        on_end = self.errors.wrap("end of an answer", on_end)

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None:
                return
            data, arrived = reply.ok.payload.to_bytes(), time.monotonic_ns()
            if reply.ok.encoding != zenoh.Encoding.APPLICATION_JSON:
                on_frame(node, data, arrived)
                return
            try:
                on_answer(read_answer(data))
            except WireError as error:
                self.on_nonsense(f"{node.sensor}: {error}")

        try:
            self._session.get(
                keys.of_node("record", node),
                zenoh.handlers.Callback(self.errors.wrap("answer of a node", on_reply), on_end),
                payload=msgspec.json.encode(request),
                congestion_control=zenoh.CongestionControl.BLOCK,  # of the replies, too
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=REQUEST_TIMEOUT_S,
            )
        except zenoh.ZError:  # this server is closing
            on_end()

    def probe_clock(self, node: keys.NodeKey, timeout: float = 1.0) -> list[ClockProbe]:
        """Query the node's monotonic clock eight times in sequence, all within ``timeout`` seconds.

        Return the probes that were answered in that time; an empty list if none was.

        Raises:
            WireError: an answer is no time.
        """
        answers: list[ClockProbe] = []
        key = keys.of_node("clock", node)
        deadline = time.monotonic() + timeout
        for asked in range(_PROBES):
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                break
            sent = time.monotonic_ns()
            for reply in self._session.get(key, timeout=left_s):
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
                self.on_nonsense(str(error))
                return
            pass_on(node, sample.payload.to_bytes(), arrived)

        return self.errors.wrap("message of the bus", callback)

    def _watching(self, on_alive: OnAlive) -> Callable[[zenoh.Sample], None]:
        def callback(sample: zenoh.Sample) -> None:
            try:
                node = keys.node_of(str(sample.key_expr))
            except WireError as error:
                self.on_nonsense(str(error))
                return
            there = sample.kind == zenoh.SampleKind.PUT
            (self._connected.add if there else self._connected.discard)(node)
            on_alive(node, there)

        return self.errors.wrap("token of the bus", callback)

    def _answering(self, on_command: OnCommand) -> Callable[[zenoh.Query], None]:
        def callback(query: zenoh.Query) -> None:
            verb = str(query.key_expr).rpartition("/")[2]
            arguments = self._arguments(query, f"command {verb}")
            if arguments is not None:
                on_command(verb, arguments, Answer(query))

        return self.errors.wrap("command of the bus", callback)

    def _admitting(self, on_member: OnMember) -> Callable[[zenoh.Query], None]:
        """Wrap the callback of a joining or leaving node, named by the key: access control protects no payloads."""

        def callback(query: zenoh.Query) -> None:
            try:
                node = keys.node_of(str(query.key_expr))
            except WireError as error:
                self._refuse(query, str(error))
                return
            arguments = self._arguments(query, node.sensor)
            if arguments is not None:
                on_member(node, arguments, Answer(query))

        return self.errors.wrap("node of the bus", callback)

    def _arguments(self, query: zenoh.Query, what: str) -> dict[str, Any] | None:
        """Return the arguments of a query; if they are invalid, answer that and return None."""
        if query.payload is not None and len(query.payload) > MAX_COMMAND_BYTES:
            self.on_nonsense(f"{what}: {len(query.payload)} bytes; at most {MAX_COMMAND_BYTES} are read")
            self._refuse(query, "the arguments are too long")
            return None
        payload = query.payload.to_bytes() if query.payload is not None else b"{}"
        try:
            return decode_json(payload or b"{}", dict[str, Any], what="JSON object")
        except InputError as error:
            self.on_nonsense(f"{what}: the arguments are no JSON object ({error})")
            self._refuse(query, "the arguments are no JSON object")
            return None

    def _refuse(self, query: zenoh.Query, message: str) -> None:
        query.reply_err(msgspec.json.encode(CommandReply(ok=False, message=message)))
