"""The bus's door, tried over a real socket: who has no key stays outside, and who has one can do what its role may."""

from __future__ import annotations

import base64
import json
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec
import pytest
import zenoh
from support.bus_doors import OpenServer, asks, joins, open_server_of
from support.programs import wait_until
from support.take_making import frame

from mocapella.errors import KeyFileError, NoServerError, NotAdmittedError
from mocapella.live.launch import free_port
from mocapella.schema import decode_frame
from mocapella.wire import keys
from mocapella.wire.certificates import SERVER
from mocapella.wire.delivery import FrameAnswer, FrameRequest
from mocapella.wire.door import KeyedAddress, find_door, keep_paired, node_users, server_tls
from mocapella.wire.doorbell import Ring
from mocapella.wire.node import NodeLink
from mocapella.wire.role_key import write_code
from mocapella.wire.roles import EVERYTHING, OPERATOR, PICTURES, READER, READERS, SENSOR, access_control
from mocapella.wire.session import open_client_at, open_node, open_reader
from mocapella.wire.session_key import SessionKey, renew_session_key, session_key

FRONT = keys.NodeKey("front", 0xFF)
LEFT = keys.NodeKey("left", 0xAA)
ALL_USERS = (SENSOR, "sensor.front", *READERS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The keys of these tests, apart from those of all others."""
    patch = pytest.MonkeyPatch()
    folder = tmp_path_factory.mktemp("keys") / "sessions"
    patch.setenv("MOCAPELLA_SESSIONS", str(folder))
    yield folder
    patch.undo()


@pytest.fixture(scope="module")
def foreign(folder: Path) -> SessionKey:
    return session_key("foreign")


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[OpenServer]:
    with open_server_of(session_key("lab").with_sensor("front")) as opened:
        yield opened


@pytest.fixture(scope="module")
def node(server: OpenServer) -> Iterator[zenoh.Session]:
    """A node that serves the sensor left and answers questions, with the key of all sensors."""
    with server.program(SENSOR, peer=True) as session:
        answers = [
            session.declare_queryable(keys.of_node(kind, LEFT), lambda query: query.reply(query.key_expr, b"left's"))
            for kind in ("ask", "clock")
        ]
        wait_until("its connection", lambda: joins(session, LEFT))
        yield session
        del answers


@pytest.mark.parametrize("user", [EVERYTHING, SENSOR])
def test_the_key_of_another_session_opens_nothing(server: OpenServer, foreign: SessionKey, user: str) -> None:
    before = len(server.commands)
    with pytest.raises(NotAdmittedError, match=r"is of the session lab.*session foreign.*mocapella session invite"):
        open_client_at(server.door(user, foreign), 0.5)
    assert len(server.commands) == before


def test_without_any_key_nothing_opens(server: OpenServer) -> None:
    locator = server.address.rpartition("@")[2]
    for text in (locator, locator.replace("tls/", "tcp/")):
        config = zenoh.Config()
        for name, value in (("mode", '"client"'), ("connect/endpoints", f'["{text}"]'),
                            ("connect/timeout_ms", "500"), ("scouting/multicast/enabled", "false")):  # fmt: skip
            config.insert_json5(name, value)
        with pytest.raises(zenoh.ZError):
            zenoh.open(config)


def test_a_refused_node_says_so_and_the_server_counts_and_notes_it(server: OpenServer, foreign: SessionKey) -> None:
    before = server.link.refused
    locator = server.address.rpartition("@")[2]
    with NodeLink(f"foreign@{locator}", "window") as link:
        assert "is of the session lab" in link.why_not_admitted()
        assert link.why_not_admitted().count("mocapella session invite") == 1
    assert server.link.refused >= before + 2
    assert sum('"window"' in note and "session foreign" in note for note in server.notes) == 1
    with NodeLink(server.address, "window") as link:
        assert link.why_not_admitted() == ""


def test_only_the_server_publishes_scenes_and_status(server: OpenServer, node: zenoh.Session) -> None:
    with server.program(READER) as reader, server.program(EVERYTHING) as forger:
        got: list[bytes] = []
        kept = [reader.declare_subscriber(key, lambda s: got.append(s.payload.to_bytes()))
                for key in (keys.SCENE, keys.STATUS)]  # fmt: skip
        wait_until("the subscription", lambda: (server.link.publish_status(b"true"), b"true" in got)[1])
        for rogue in (forger, node):
            rogue.put(keys.STATUS, b"forged")
            rogue.put(keys.SCENE, b"forged")
        asks(forger, keys.of_command("status"))  # what was sent before it has passed or was denied
        joins(node, LEFT)
        server.link.publish_scene(b"end")
        wait_until("the end", lambda: b"end" in got)
        assert b"forged" not in got
        del kept


def test_only_sensors_send_frames(server: OpenServer, node: zenoh.Session) -> None:
    node.put(keys.of_node("live", LEFT), b"a frame")
    wait_until("the frame", lambda: ("left", b"a frame") in server.frames)
    with server.program(EVERYTHING) as rogue:
        rogue.put(keys.of_node("live", LEFT), b"forged")
        rogue.put(keys.of_node("record", LEFT), b"forged")
        asks(rogue, keys.of_command("status"))
    assert ("left", b"forged") not in server.frames


def test_a_sensor_with_its_own_key_is_served_by_nobody_else(server: OpenServer, node: zenoh.Session) -> None:
    with server.program("sensor.front", peer=True) as front:
        wait_until("its connection", lambda: joins(front, FRONT))
        front.put(keys.of_node("live", FRONT), b"front's")
        front.put(keys.of_node("live", LEFT), b"front as left")
        node.put(keys.of_node("live", FRONT), b"left as front")
        node.put(keys.of_node("record", FRONT), b"left as front")
        joins(front, FRONT)
        joins(node, LEFT)
        wait_until("its frame", lambda: ("front", b"front's") in server.frames)
        said = {data for _, data in server.frames}
        assert not {b"front as left", b"left as front"} & said


def test_questions_to_a_sensor_with_its_own_key_reach_no_other(server: OpenServer, node: zenoh.Session) -> None:
    spied: list[str] = []

    def spy(query: zenoh.Query) -> None:
        spied.append(str(query.key_expr))

    with server.program("sensor.front", peer=True) as front, server.program(EVERYTHING) as operator:
        kept = [front.declare_queryable(keys.of_node("ask", FRONT), lambda query: query.reply(query.key_expr, b"mine")),
                node.declare_queryable("mocapella/v1/ask/*/*", spy)]  # fmt: skip
        wait_until("the answer", lambda: asks(operator, keys.of_node("ask", FRONT)) == [b"mine"])
        assert spied == []
        kept.clear()


@pytest.mark.parametrize(
    ("user", "rights"),
    [
        (EVERYTHING, {"results", "command", "frames", "ask"}),
        (OPERATOR, {"results", "command"}),
        (READER + PICTURES, {"results", "frames"}),
        (READER, {"results"}),
        (SENSOR, set()),
    ],
)
def test_each_role_does_what_it_may_and_no_more(
    server: OpenServer, node: zenoh.Session, user: str, rights: set[str]
) -> None:
    with server.program(user) as session:
        got: list[str] = []
        kept = [session.declare_subscriber(key, lambda s: got.append(str(s.key_expr)))
                for key in (keys.ALL_LIVE, keys.SCENE, "**")]  # fmt: skip
        assert bool(asks(session, keys.of_command("status"))) == ("results" in rights)
        assert bool(asks(session, keys.of_command("record"))) == ("command" in rights)
        assert bool(asks(session, keys.of_command("*"))) == ("command" in rights)
        assert bool(asks(session, keys.of_node("ask", LEFT))) == ("ask" in rights)
        with server.program(EVERYTHING) as witness:  # it gets all, so it knows when all was sent
            seen: list[str] = []
            kept += [witness.declare_subscriber(key, lambda s: seen.append(str(s.key_expr)))
                     for key in (keys.ALL_LIVE, keys.SCENE)]  # fmt: skip
            live = keys.of_node("live", LEFT)
            wait_until("a frame", lambda: (node.put(live, b"x"), live in seen)[1])
            wait_until("a scene", lambda: (server.link.publish_scene(b"x"), keys.SCENE in seen)[1])
        if "frames" in rights:
            wait_until("a frame", lambda: live in got)
        if "results" in rights:
            wait_until("a scene", lambda: keys.SCENE in got)
        allowed = {"results": keys.SCENE, "frames": live}
        assert set(got) == {key for right, key in allowed.items() if right in rights}
        del kept


@pytest.mark.parametrize(
    ("user", "sensors"),
    [(SENSOR, {"left"}), ("sensor.front", {"front"}), *((user, set[str]()) for user in READERS)],
)
@pytest.mark.parametrize("kind", ["join", "leave"])
def test_a_node_joins_and_leaves_under_the_names_that_its_key_serves(
    server: OpenServer, user: str, sensors: set[str], kind: str
) -> None:
    heard = server.joined if kind == "join" else server.left
    with server.program(user, peer=user.startswith(SENSOR)) as session:
        if user.startswith(SENSOR):
            wait_until("its connection", lambda: joins(session, FRONT if "front" in sensors else LEFT))
        del heard[:]
        for node in (FRONT, LEFT):
            assert asks(session, keys.of_node(kind, node)) == ([b"done"] if node.sensor in sensors else [])
        for key in (f"{kind}/*/*", f"{kind}/**", f"{kind}/front/*", "*/front/*", "**"):
            assert asks(session, f"mocapella/v1/{key}") == []
    assert {node.sensor for node in heard} == sensors


def test_a_sensor_learns_of_no_other_nodes(server: OpenServer, node: zenoh.Session) -> None:
    alive = keys.of_node("alive/sensor", LEFT)
    with node.liveliness().declare_token(alive), server.program(EVERYTHING) as witness:
        everybody = "mocapella/v1/alive/**"

        def there(session: zenoh.Session, key: str = keys.ALL_SENSORS_ALIVE) -> list[str]:
            return [str(r.ok.key_expr) for r in session.liveliness().get(key, timeout=0.4) if r.ok is not None]

        wait_until("the token", lambda: there(witness) == [alive])
        for user in (SENSOR, "sensor.front", READER):
            with server.program(user) as session:
                assert there(session) == []
                assert there(session, everybody) == []
                assert there(session, keys.SERVER_ALIVE) == [keys.SERVER_ALIVE]


def test_a_key_that_was_renewed_is_void(folder: Path) -> None:
    old = session_key("renewed")
    with open_server_of(renew_session_key("renewed")) as server, pytest.raises(NotAdmittedError):
        open_client_at(server.door(EVERYTHING, old), 0.5)


def test_a_key_made_after_the_server_started_is_told_apart(server: OpenServer) -> None:
    later = server.key.with_sensor("later")
    with open_client_at(server.door("sensor.later", later)) as session:
        assert asks(session, keys.of_node("join", keys.NodeKey("later", 1))) == []
    with NodeLink(server.address, "later") as link:
        assert "start it again" in link.why_not_admitted()


def test_one_user_of_one_machine_types_nothing(folder: Path) -> None:
    address = f"tls/127.0.0.1:{free_port()}"
    with NodeLink(address, "front") as link:  # the first to need the key makes it
        assert [file.name for file in folder.glob("default*")] == ["default.json"]
        assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o600}
        assert folder.stat().st_mode & 0o777 == 0o700
        with pytest.raises(NoServerError, match="start a server"):
            open_reader(address, 0.3)
        assert link.why_not_admitted() == ""


def test_what_listens_and_is_no_server_of_this_version_is_named(folder: Path) -> None:
    config = zenoh.Config()
    locator = f"tcp/127.0.0.1:{free_port()}"  # as a server of an earlier version
    for name, value in (("mode", '"peer"'), ("listen/endpoints", f'["{locator}"]'),
                        ("scouting/multicast/enabled", "false")):  # fmt: skip
        config.insert_json5(name, value)
    with (
        zenoh.open(config),
        pytest.raises(NotAdmittedError, match=r"is of an earlier version \(then start it with this"),
    ):
        open_reader(locator, 0.3)


def test_another_users_session_of_the_same_name_is_told_apart(server: OpenServer) -> None:
    theirs = session_key("default")
    with open_server_of(theirs) as other, NodeLink(other.address, "front") as link:
        assert link.why_not_admitted() == ""
        renew_session_key("default")
        with NodeLink(other.address, "front") as renewed:
            assert "has another key of the session default" in renewed.why_not_admitted()
            assert renewed.why_not_admitted().endswith("or start it again if it is yours")


def test_an_unexpected_error_does_not_silence_the_doorbell(
    server: OpenServer, foreign: SessionKey, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server.link, "on_refused", lambda text: 1 // 0)
    locator = server.address.rpartition("@")[2]
    with NodeLink(f"foreign@{locator}", "unlucky") as link:
        link.why_not_admitted()
        assert any("ZeroDivisionError" in reason for reason in server.link.errors.counts)
        assert "is of the session lab" in link.why_not_admitted()


def test_a_paired_key_opens_its_address_alone(server: OpenServer, folder: Path) -> None:
    locator = server.address.rpartition("@")[2]
    role = server.key.role_key(READER, locator)
    kept = keep_paired(role)
    assert kept.stat().st_mode & 0o777 == 0o600
    try:
        assert find_door(locator, READERS).key == role
        assert find_door("tcp" + locator.removeprefix("tls"), READERS).key == role
        assert find_door(f"foreign@{locator}", READERS).key.session == "foreign"
        assert find_door(locator, node_users("front")).key.session == "default"
        with open_reader(locator) as session:
            assert asks(session, keys.of_command("status")) == [b"done"]
    finally:
        kept.unlink()


@pytest.mark.parametrize("as_file", [False, True])
def test_a_pairing_code_or_its_file_is_an_address(server: OpenServer, tmp_path: Path, as_file: bool) -> None:
    text = write_code(server.key.role_key(SENSOR, server.address.rpartition("@")[2]))
    if as_file:
        (tmp_path / "sensor.key").write_text(text + "\n")
        text = str(tmp_path / "sensor.key")
    session = open_node(text, "left")
    try:
        wait_until("its connection", lambda: joins(session, LEFT))
    finally:
        session.close()  # type: ignore[no-untyped-call]
    with pytest.raises(KeyFileError, match=r"is of a sensor.*invite a reader"):
        open_reader(text)


def test_a_key_of_one_sensor_serves_no_other(server: OpenServer) -> None:
    text = write_code(server.key.role_key("sensor.front", "tls/127.0.0.1:7447"))
    with pytest.raises(KeyFileError, match=r"serves the sensor front only \(--name front\)"):
        find_door(text, node_users("left"))
    assert find_door(text, node_users("front")).key.user == "sensor.front"


def test_another_machine_without_a_key_is_told_how_to_get_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOCAPELLA_SESSION", "never-made")
    with pytest.raises(KeyFileError, match=r"invite sensor --at 192\.0\.2\.1:7447.*mocapella session join"):
        find_door("tcp/192.0.2.1:7447", node_users("front"))
    assert not (folder / "never-made.json").exists()


def test_a_sensors_key_cannot_act_as_the_server(server: OpenServer) -> None:
    """Else a node could take the port of its server, and get the frames and pictures of all others."""
    own = server.key.issued[SENSOR]
    impostor = msgspec.structs.replace(server.key, issued={**server.key.issued, SERVER: own})
    locator = f"tls/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    for name, value in (("mode", "peer"), ("listen/endpoints", [locator]), ("scouting/multicast/enabled", False),
                        ("transport/link/tls", server_tls(impostor))):  # fmt: skip
        config.insert_json5(name, json.dumps(value))
    door = KeyedAddress(locator, server.key.role_key(READER, locator), "a test")
    with zenoh.open(config), pytest.raises(NoServerError):
        open_client_at(door, 0.5)


def test_the_recipe_for_other_languages_opens_the_door(server: OpenServer, tmp_path: Path) -> None:
    """As docs/wire.md says it: base64, MessagePack, three PEM files."""
    data = write_code(server.key.role_key(READER, server.address.rpartition("@")[2])).removeprefix("mocapella-key-")
    session, user, address, authority, (certificate, private) = msgspec.msgpack.decode(
        base64.urlsafe_b64decode(data + "=" * (-len(data) % 4))
    )
    assert (session, user) == ("lab", "reader")
    for name, der, what in (("authority", authority, "CERTIFICATE"), ("certificate", certificate, "CERTIFICATE"),
                            ("key", private, "PRIVATE KEY")):  # fmt: skip
        body = base64.encodebytes(der).decode()
        (tmp_path / f"{name}.pem").write_text(f"-----BEGIN {what}-----\n{body}-----END {what}-----\n")
    config = zenoh.Config()
    tls = {"root_ca_certificate": str(tmp_path / "authority.pem"), "enable_mtls": True,
           "connect_certificate": str(tmp_path / "certificate.pem"),
           "connect_private_key": str(tmp_path / "key.pem"), "verify_name_on_connect": False}  # fmt: skip
    for name, value in (("mode", "client"), ("connect/endpoints", [address]), ("scouting/multicast/enabled", False),
                        ("transport/link/tls", tls)):  # fmt: skip
        config.insert_json5(name, json.dumps(value))
    with zenoh.open(config) as reader:
        assert asks(reader, keys.of_command("status")) == [b"done"]
    assert set(tls) <= set(re.findall(r"\w+", (Path(__file__).parents[2] / "docs" / "wire.md").read_text()))


RING = msgspec.json.encode(Ring("other", "0" * 16, SENSOR))
"""Without the spaces that make it as long as its answer, and longer."""


@pytest.mark.parametrize(
    "data",
    [
        RING,
        RING.ljust(511),
        RING.ljust(513),
        b"",
        b"x" * 512,
        b"[" * 512,
        b"{}".ljust(512),
        b"\xff" * 512,
        b"x" * 60000,
    ],
)
def test_nonsense_at_the_doorbell_is_not_answered(server: OpenServer, data: bytes) -> None:
    port = int(server.address.rpartition(":")[2])
    before = server.link.refused
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bell:
        bell.connect(("127.0.0.1", port))
        bell.settimeout(0.1)
        bell.send(data)
        with pytest.raises(TimeoutError):
            bell.recv(100)
    with NodeLink(server.address, "left") as link:
        assert link.why_not_admitted() == ""
    assert server.link.refused == before


def test_names_that_a_stranger_makes_up_reach_the_notices_as_plain_text(server: OpenServer) -> None:
    ring = {
        "session": "a\u202eb",
        "fingerprint": "0" * 16,
        "user": "\x1b[2J",
        "sensor": "<script>",
        "machine": "x" * 99,
    }
    port = int(server.address.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bell:
        bell.connect(("127.0.0.1", port))
        bell.settimeout(10.0)
        bell.send(json.dumps(ring).encode().ljust(512))
        assert len(bell.recv(512)) < 512
    wait_until("the note", lambda: any("?script?" in note for note in server.notes))
    (note,) = (note for note in server.notes if "?script?" in note)
    assert "session a?b," in note
    assert "x" * 64 + " was" in note


def test_strangers_without_end_are_counted_and_noted_a_few_times(server: OpenServer) -> None:
    before = server.link.refused
    bell = server.link._bell
    bell._noted.clear()
    for number in range(100):
        ring = Ring("other", "0" * 16, SENSOR, f"sensor-{number}")
        bell._answer(msgspec.json.encode(ring).ljust(512), "192.0.2.1")
    assert server.link.refused == before + 100
    assert len([note for note in server.notes if '"sensor-' in note and "192.0.2.1 was refused" in note]) == 32


def test_the_server_asks_nodes_for_their_clocks_and_nobody_else_may(server: OpenServer, node: zenoh.Session) -> None:
    key = keys.of_node("clock", LEFT)
    wait_until("the answer", lambda: b"left's" in asks(server.link._session, key))
    for user in ALL_USERS:
        with server.program(user) as other:
            assert asks(other, key) == []


ALL_LACK = FrameRequest("take", 0, wanted=[(0, 1)])
ALL_STORED = FrameRequest("take", 2, closed=True)


def sending(link: NodeLink, sensor: str) -> None:
    """Connect a node, and send two frames."""
    wait_until("its connection", lambda: joins(link._session, link.node))
    for _ in range(2):
        link.publish(frame(sensor, 1))


@contextmanager
def answering(session: zenoh.Session, key: str) -> Iterator[list[str]]:
    """Whatever a program with this session is asked on a key; it answers with a frame of its own."""
    asked: list[str] = []

    def answer(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.reply(query.key_expr, b"forged")

    kept = session.declare_queryable(key, answer)
    try:
        yield asked
    finally:
        kept.undeclare()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(("sensor", "user"), [("window", SENSOR), ("front", "sensor.front")])
def test_a_node_sends_again_what_a_take_lacks_and_hears_what_is_stored(
    server: OpenServer, sensor: str, user: str
) -> None:
    code = write_code(server.key.role_key(user, server.address.rpartition("@")[2]))
    with NodeLink(code, sensor) as link:
        sending(link, sensor)
        frames, answers = server.request(link.node, ALL_LACK)
        assert [decode_frame(data).sequence for data in frames] == [0, 1]
        assert answers == [FrameAnswer(next=2, oldest=0)]
        assert link.outbox.holds["take"].stored == 0
        server.request(link.node, ALL_STORED)
        assert (link.outbox.holds, link.outbox.oldest) == ({}, 0)


@pytest.mark.parametrize("user", ALL_USERS)
def test_nobody_but_the_server_acknowledges_or_asks_for_frames(server: OpenServer, user: str) -> None:
    """A forged acknowledgement would make a node drop frames that no disk has."""
    with NodeLink(server.address, "window") as link:
        sending(link, "window")
        server.request(link.node, FrameRequest("take", 0))
        forged = msgspec.json.encode(ALL_STORED)
        with server.program(user) as rogue:
            for key in (keys.of_node("record", link.node), keys.ALL_RECORD, "mocapella/v1/record/**", "**"):
                assert asks(rogue, key, payload=forged) == []
        assert link.outbox.holds["take"].stored == 0
        server.request(link.node, ALL_STORED)


@pytest.mark.parametrize("user", [SENSOR, *READERS])
def test_nobody_answers_for_a_sensor_with_its_own_key(server: OpenServer, user: str) -> None:
    code = write_code(server.key.role_key("sensor.front", server.address.rpartition("@")[2]))
    with NodeLink(code, "front") as link, server.program(user, peer=user == SENSOR) as rogue:
        sending(link, "front")
        for key in (keys.of_node("record", link.node), keys.ALL_RECORD, "mocapella/v1/record/front/*", "**"):
            with answering(rogue, key) as asked:
                frames, answers = server.request(link.node, ALL_LACK)
                assert (len(frames), len(answers)) == (2, 1)
                assert b"forged" not in frames
                assert asked == []
        server.request(link.node, ALL_STORED)


@pytest.mark.parametrize("user", ["sensor.front", *READERS])
def test_nobody_answers_for_a_sensor_that_the_key_does_not_serve(server: OpenServer, user: str) -> None:
    with server.program(user, peer=user == "sensor.front") as rogue:
        for key in (keys.of_node("record", LEFT), keys.ALL_RECORD, "**"):
            with answering(rogue, key) as asked:
                assert server.request(LEFT, ALL_LACK) == ([], [])
                assert asked == []


@pytest.mark.parametrize("user", ALL_USERS)
def test_nobody_but_the_server_hears_commands(server: OpenServer, user: str) -> None:
    with server.program(OPERATOR) as operator, server.program(user, peer=user.startswith(SENSOR)) as rogue:
        for key in (keys.of_command("record"), "mocapella/v1/command/**", "**"):
            with answering(rogue, key) as heard:
                wait_until("the answer", lambda: asks(operator, keys.of_command("record")) == [b"done"])
                assert heard == []


def test_a_client_gets_in_beside_connections_that_send_nothing(folder: Path) -> None:
    """More than the bus admits at a time; later it ends them, one after the other, and admits nobody meanwhile."""
    with open_server_of(session_key("mute")) as server, ExitStack() as stack:
        port = int(server.address.rpartition(":")[2])
        for _ in range(150):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60.0))
        with server.program(READER) as reader:
            wait_until("the answer", lambda: asks(reader, keys.of_command("status")) == [b"done"])


@pytest.mark.parametrize("user", ALL_USERS)
def test_the_record_path_has_no_messages_but_queries_of_the_server(user: str) -> None:
    found = access_control(["front"])
    (ids,) = (policy["rules"] for policy in found["policies"] if policy["subjects"] == [user])
    allowed = {
        (message, flow)
        for rule in found["rules"]
        if rule["id"] in ids and rule["permission"] == "allow" and any("/record/" in key for key in rule["key_exprs"])
        for message in rule["messages"]
        for flow in rule["flows"]
    }
    answers = {("declare_queryable", "ingress"), ("reply", "ingress"), ("query", "egress")}
    assert allowed == (answers if user.startswith(SENSOR) else set())


@pytest.mark.parametrize("user", ALL_USERS)
def test_only_a_sensors_own_node_is_told_where_people_are_expected(user: str) -> None:
    found = access_control(["front"])
    (ids,) = (policy["rules"] for policy in found["policies"] if policy["subjects"] == [user])
    rules = [
        (rule["permission"], rule["flows"], rule["messages"], [key for key in rule["key_exprs"] if "/expect/" in key])
        for rule in found["rules"]
        if rule["id"] in ids and any("/expect/" in key for key in rule["key_exprs"])
    ]
    own = "*" if user == SENSOR else "front"
    allowed = [
        ("allow", ["ingress"], ["declare_subscriber"], [f"mocapella/v1/expect/{own}/*"]),
        ("allow", ["egress"], ["put"], [f"mocapella/v1/expect/{own}/*"]),
    ]
    front = ["mocapella/v1/expect/front/*"]
    denied = [("deny", ["ingress"], ["declare_subscriber"], front), ("deny", ["egress"], ["put"], front)]
    assert rules == ([] if not user.startswith(SENSOR) else [*allowed, *denied] if user == SENSOR else allowed)
