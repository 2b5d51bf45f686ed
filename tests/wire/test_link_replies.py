"""What nodes, readers and the server make of replies and messages of the bus, with a scripted session."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import zenoh

from mocapella.errors import BusError, NameTakenError, NoServerError
from mocapella.model.limits import MAX_COMMAND_BYTES
from mocapella.model.session import CommandReply, RecordingHealth, SessionStatus, Setup
from mocapella.wire import keys
from mocapella.wire import node as node_module
from mocapella.wire import session as session_module
from mocapella.wire.delivery import FrameRequest
from mocapella.wire.node import JoinReply, NodeLink
from mocapella.wire.questions import AskPicture, NodeAnswer, ask_node, write_answer
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.server import Answer, ServerLink
from mocapella.wire.session import open_client_at


def payload(data: bytes | None) -> Any:
    return None if data is None else SimpleNamespace(to_bytes=lambda: data, __len__=lambda: len(data))


def reply(data: bytes, *, refused: bool = False) -> Any:
    said = SimpleNamespace(payload=payload(data))
    return SimpleNamespace(ok=None if refused else said, err=said if refused else None)


class Session:
    """Answers each query with what comes next, and remembers it."""

    def __init__(self, *answers: list[Any]) -> None:
        self.answers, self.asked = list(answers), list[dict[str, Any]]()
        self.info = SimpleNamespace(zid=lambda: "ab")
        self.there: list[Any] = []

    def get(self, key: str, **options: Any) -> list[Any]:
        self.asked.append({"key": key, **options})
        return self.answers.pop(0) if self.answers else []

    def declare_subscriber(self, key: str, callback: Callable[[Any], None]) -> None:
        setattr(self, key.replace("/", "_"), callback)

    def declare_publisher(self, *_: Any, **__: Any) -> Any:
        return SimpleNamespace(put=lambda _: None)

    def declare_queryable(self, *_: Any) -> None:
        return None

    def liveliness(self) -> Any:
        return SimpleNamespace(declare_token=lambda _: None, get=lambda *_, **__: self.there)

    def close(self) -> None:
        """Nothing."""


def joined(**fields: Any) -> list[Any]:
    return [reply(msgspec.json.encode(JoinReply(**fields)))]


@pytest.fixture
def make_node(monkeypatch: pytest.MonkeyPatch) -> Callable[[Session], NodeLink]:
    def made(session: Session) -> NodeLink:
        monkeypatch.setattr(node_module, "open_node_at", lambda _: session)
        return NodeLink("tcp/127.0.0.1:1", "front")

    return made


def test_a_node_joins_only_where_a_server_accepts_it(make_node: Callable[[Session], NodeLink]) -> None:
    node = make_node(Session([], joined(accepted=True), joined(accepted=False, message="taken"), [reply(b"old")]))
    assert not node.join()
    assert node.join()
    with pytest.raises(NameTakenError, match="taken"):
        node.join()
    assert not node.join()


def test_a_node_that_is_put_off_knows_why_until_it_is_accepted(make_node: Callable[[Session], NodeLink]) -> None:
    node = make_node(Session(joined(accepted=False, message="full", later=True), joined(accepted=True)))
    assert not node.join()
    assert (node.put_off, node.why_not_admitted()) == ("full", "full")
    assert node.join()
    assert node.put_off == ""


class Tick:
    """A clock that advances while a node waits, and what happens then."""

    def __init__(self, *events: Callable[[], object]) -> None:
        self.now, self.waits, self._events = 100.0, 0, list(events)

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.waits += 1
        if self._events:
            self._events.pop(0)()


def farewell(
    node: NodeLink, monkeypatch: pytest.MonkeyPatch, *events: Callable[[], object], seconds: float = 10.0
) -> int:
    """Let a node say farewell; return how often it waited."""
    tick = Tick(*events)
    monkeypatch.setattr(
        node_module, "time", SimpleNamespace(monotonic=tick.monotonic, monotonic_ns=time.monotonic_ns, sleep=tick.sleep)
    )
    node.farewell_s = seconds
    node._say_farewell()
    return tick.waits


def nothing() -> None:
    return None


def test_a_leaving_node_waits_while_a_take_holds_its_frames_also_without_a_server(
    make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make_node(Session())
    node.outbox.add(b"0", 0)
    node.outbox.update(FrameRequest("take", 0), 0)
    acknowledge = FrameRequest("take", 1, closed=True)
    assert farewell(node, monkeypatch, nothing, nothing, lambda: node.outbox.update(acknowledge, 0)) == 3


def test_a_leaving_node_waits_on_while_its_frames_are_being_stored(
    make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long that takes together; and then until nothing more is stored for as long as it waits."""
    node, step_s, seconds = make_node(Session()), 0.02, 0.05
    for number in range(10):
        node.outbox.add(b"0", number)
    node.outbox.update(FrameRequest("take", 0), 0)
    stored = [partial(node.outbox.update, FrameRequest("take", number), 0) for number in range(1, 10)]
    events = [event for one in stored for event in (nothing, one)]
    waits = farewell(node, monkeypatch, *events, seconds=seconds)
    assert len(events) <= waits <= len(events) + seconds / step_s + 2
    assert node.outbox.holds


def test_a_leaving_node_does_not_wait_on_for_a_server_that_asks_and_stores_nothing(
    make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make_node(Session())
    node.outbox.add(b"0", 0)
    node.outbox.update(FrameRequest("take", 0), 0)
    asks = [partial(node.outbox.update, FrameRequest("take", 0), now_ns) for now_ns in range(1, 100)]
    assert farewell(node, monkeypatch, *asks, seconds=0.1) < 10


def test_a_leaving_node_waits_for_a_recording_server_to_hear_its_last_number(
    make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(joined(accepted=True, recording=True))
    session.there = ["server"]
    node = make_node(session)
    assert farewell(node, monkeypatch, nothing, node._ended.set) == 2
    assert [asked["key"] for asked in session.asked] == [keys.of_node("leave", node.node)]


def test_a_leaving_node_tells_a_server_that_was_started_again_too(
    make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(joined(accepted=True, recording=True), joined(accepted=True))
    node = make_node(session)
    assert farewell(node, monkeypatch) == 1
    assert len(session.asked) == 2


@pytest.mark.parametrize("answer", [{"accepted": True}, {"accepted": False, "recording": True}])
def test_a_leaving_node_waits_for_nobody_who_records_nothing_of_it(
    answer: dict[str, Any], make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert farewell(make_node(Session(joined(**answer))), monkeypatch) == 0


def test_a_leaving_node_waits_no_longer_than_told(
    make_node: Callable[[Session], NodeLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make_node(Session())
    node.outbox.add(b"0", 0)
    node.outbox.update(FrameRequest("take", 0), 0)
    assert 25 <= farewell(node, monkeypatch, seconds=0.51) <= 26  # of 0.02 s each
    assert farewell(node, monkeypatch, seconds=0.0) == 0


@pytest.mark.parametrize(
    ("request_of_take", "ended"),
    [
        (FrameRequest("take", 0), False),
        (FrameRequest("take", 0, end=0), True),
        (FrameRequest("take", 0, closed=True), True),
    ],
)
def test_a_node_hears_that_a_take_has_ended_or_is_closed(
    request_of_take: FrameRequest,
    ended: bool,
    make_node: Callable[[Session], NodeLink],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node = make_node(Session())
    monkeypatch.setattr(node._spooler, "begin", nothing)
    replies: list[bytes] = []
    query = SimpleNamespace(
        payload=payload(msgspec.json.encode(request_of_take)),
        reply=lambda _, data, **__: replies.append(data),
        drop=nothing,
    )
    node._deliver(query)  # type: ignore[arg-type]
    assert node._ended.is_set() == ended
    assert json.loads(replies[-1])["next"] == 0


def test_the_first_answer_of_a_node_counts_and_a_refusal_of_the_bus_is_none() -> None:
    answer = NodeAnswer(False, "no picture yet")
    denied = reply(b"denied", refused=True)
    session = Session([denied, reply(write_answer(answer))], [denied], [])
    assert ask_node(session, "left", AskPicture()) == answer  # type: ignore[arg-type]
    for _ in range(2):
        with pytest.raises(BusError, match="left: no answer within 2 s"):
            ask_node(session, "left", AskPicture(), timeout=2.0)  # type: ignore[arg-type]


def test_a_status_is_read_once_and_what_is_none_is_counted() -> None:
    session = Session()
    newest = Newest(session)  # type: ignore[arg-type]
    put = getattr(session, keys.STATUS.replace("/", "_"))
    assert newest.status() is None
    sent = SessionStatus(
        7, True, "tracking", 0, 0, 120, "", 7, 30.0, Setup(), (), RecordingHealth(), ("note",), 1.5, "0.1.0"
    )
    put(SimpleNamespace(payload=payload(msgspec.json.encode(sent))))
    status = newest.status()
    assert status is not None
    assert (status.revision, newest.status(), newest.refused) == (7, None, 0)
    put(SimpleNamespace(payload=payload(b"nonsense")))
    assert (newest.status(), newest.refused) == (None, 1)


@pytest.mark.parametrize("refused", [False, True])
def test_a_command_has_its_arguments_and_says_who_sends_it(refused: bool) -> None:
    answer = CommandReply(ok=not refused, message="done")
    session = Session([reply(msgspec.json.encode(answer), refused=refused)])
    got = send_command(session, "record", {"take": "walk"}, program="a test")  # type: ignore[arg-type]
    assert got == answer
    (asked,) = session.asked
    assert (asked["key"], json.loads(asked["payload"])) == (keys.of_command("record"), {"take": "walk"})
    assert asked["attachment"].startswith("ab".rjust(32, "0") + " a test of ")


def test_a_command_without_arguments_is_an_empty_object_and_silence_is_an_error() -> None:
    session = Session()
    with pytest.raises(NoServerError, match="within 2 s"):
        send_command(session, "stop", timeout=2.0)  # type: ignore[arg-type]
    assert json.loads(session.asked[0]["payload"]) == {}


def test_a_reader_waits_as_many_seconds_as_told(monkeypatch: pytest.MonkeyPatch) -> None:
    configs: list[Any] = []
    monkeypatch.setattr(session_module, "client_tls", lambda _: {})
    monkeypatch.setattr(session_module, "_open", lambda config, _: configs.append(config))
    open_client_at(SimpleNamespace(locator="tls/127.0.0.1:1", key=None), 2.5)  # type: ignore[arg-type]
    assert json.loads(configs[0].get_json("connect/timeout_ms")) == 2500


class Query:
    """A query of the bus that remembers what it is answered."""

    def __init__(self, data: bytes | None, attachment: bytes | None = None, key: str = "") -> None:
        self.key_expr, self.attachment, self.errors = key, payload(attachment), list[dict[str, Any]]()
        self.payload: Any = None if data is None else Bytes(data)

    def reply_err(self, data: bytes) -> None:
        self.errors.append(json.loads(data))


class Bytes(bytes):
    """A payload."""

    def to_bytes(self) -> bytes:  # type: ignore[override]
        return bytes(self)


@pytest.fixture
def server() -> Any:
    """A link without a bus."""
    link = object.__new__(ServerLink)
    nonsense: list[str] = []
    link.on_nonsense = nonsense.append
    link.errors = SimpleNamespace(wrap=lambda _, callback: callback)  # type: ignore[assignment]
    link._connected, link._expected = set(), {}
    return SimpleNamespace(link=link, nonsense=nonsense)


@pytest.mark.parametrize("data", [None, b"", b"{}", b'{"a": 1}', b"{" + b" " * (MAX_COMMAND_BYTES - 2) + b"}"])
def test_arguments_up_to_the_limit_are_read(server: Any, data: bytes | None) -> None:
    query = Query(data)
    assert server.link._arguments(query, "a command") == ({"a": 1} if data == b'{"a": 1}' else {})
    assert (server.nonsense, query.errors) == ([], [])


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"{" + b" " * (MAX_COMMAND_BYTES - 1) + b"}", f"at most {MAX_COMMAND_BYTES} are read"),
        (b"[]", "no JSON object"),
    ],
)
def test_arguments_beyond_it_and_what_are_none_are_refused_and_noted(server: Any, data: bytes, said: str) -> None:
    query = Query(data)
    assert server.link._arguments(query, "a command") is None
    assert said in server.nonsense[0]
    assert [error["ok"] for error in query.errors] == [False]


@pytest.mark.parametrize(("kind", "alive"), [(zenoh.SampleKind.PUT, True), (zenoh.SampleKind.DELETE, False)])
def test_a_token_says_whether_a_node_is_there(server: Any, kind: Any, alive: bool) -> None:
    told: list[tuple[str, bool]] = []
    watch = server.link._watching(lambda node, there: told.append((node.sensor, there)))
    key = keys.of_node("alive/sensor", keys.NodeKey("front", 5))
    watch(SimpleNamespace(key_expr=key, kind=kind))
    watch(SimpleNamespace(key_expr="no/key", kind=kind))
    assert told == [("front", alive)]
    assert len(server.nonsense) == 1


def test_a_publisher_of_expected_people_lasts_as_long_as_its_node_is_connected(server: Any) -> None:
    node, declared, undeclared = keys.NodeKey("front", 5), [], []

    def declare(key: str, **_: object) -> Any:
        declared.append(key)
        return SimpleNamespace(matching_status=True, undeclare=lambda: undeclared.append(key))

    server.link._session = SimpleNamespace(declare_publisher=declare)
    watch = server.link._watching(lambda *_: None)
    token = keys.of_node("alive/sensor", node)
    assert not server.link.awaits_expected(node)
    watch(SimpleNamespace(key_expr=token, kind=zenoh.SampleKind.PUT))
    assert server.link.awaits_expected(node)
    assert server.link.awaits_expected(node)
    watch(SimpleNamespace(key_expr=token, kind=zenoh.SampleKind.DELETE))
    assert not server.link.awaits_expected(node)  # a late frame makes none
    assert declared == undeclared == [keys.of_node("expect", node)]


@pytest.mark.parametrize(
    ("attachment", "client", "sender"),
    [
        (None, "", ""),
        (b"", "", ""),
        (b"0" * 31 + b"7 view of me", (b"0" * 31 + b"7").hex(), "view of me"),
        (("0" * 32 + " " + "😀" * 100).encode(), (b"0" * 32).hex(), "😀" * 100),
        (b"0" * 32 + b" " + b"x" * 130, (b"0" * 32).hex(), "x" * 120),
        (b"0" * 32 + b" a\x1b[2Jb\n", (b"0" * 32).hex(), "a[2Jb"),
    ],
)
def test_a_commands_sender_is_read_up_to_its_limit(attachment: bytes | None, client: str, sender: str) -> None:
    answer = Answer(Query(b"", attachment))  # type: ignore[arg-type]
    assert (answer.client, answer.sender) == (client, sender)
