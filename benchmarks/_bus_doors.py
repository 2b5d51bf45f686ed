"""Readers of what arrives on the bus and on sockets besides frames and scenes, with stand-ins for what carries it."""

from __future__ import annotations

import base64
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec

from benchmarks._door import BYTES, TEXT, Door, of_bytes, of_file


def bus_doors() -> list[Door]:
    """Return the doors of messages."""
    return [*_record_path(), *_answers(), *_asked(), *_commands(), *_rings()]


def key_doors(folder: Path) -> list[Door]:
    """Return the doors of keys, and of what a browser asks; ``folder`` is for the files."""
    from mocapella.viewer.page_door import PageDoor, _kept
    from mocapella.viewer.page_messages import decode_page_message
    from mocapella.wire.certificates import SERVER, Certified
    from mocapella.wire.door import read_key_file
    from mocapella.wire.role_key import PREFIX, RoleKey, read_code, write_code
    from mocapella.wire.roles import READER, users_of
    from mocapella.wire.session_key import SessionKey, read_session_key

    own = Certified(b"certificate", b"private")
    role = RoleKey("lab", READER, "tls/192.0.2.7:7447", b"authority", own)
    session = SessionKey("lab", own, dict.fromkeys((SERVER, *users_of(["front"])), own), ("front",))
    page = PageDoor("0123456789abcdef", "127.0.0.1")
    (folder / "token").touch(mode=0o600)

    def code(data: bytes) -> RoleKey:
        return read_code(PREFIX + base64.urlsafe_b64encode(data).decode("ascii").rstrip("="))

    def asked(data: bytes) -> None:
        text = data.decode("latin-1")
        path, _, rest = text.partition("|")
        host, _, cookie = rest.partition("|")
        page.admit(path, {"Host": host, "Origin": f"http://{host}", "Cookie": cookie}, 8080)

    return [
        of_bytes("pairing codes", [msgspec.msgpack.encode(role)], code, BYTES),
        of_file("key files", folder / "front.key", [write_code(role).encode()], read_key_file, TEXT),
        of_bytes("session keys", [msgspec.json.encode(session)],
                 lambda data: read_session_key(data.decode("latin-1"), "lab", Path("lab.json")), TEXT),
        of_file("view tokens", folder / "token", [b"0123456789abcdef0123\n"], _kept, TEXT),
        of_bytes("page requests", [b"/?token=0123456789abcdef|127.0.0.1:8080|mocapella-8080=0123456789abcdef"], asked,
                 TEXT),
        of_bytes("page messages", _page_messages(), decode_page_message, BYTES),
    ]  # fmt: skip


def _page_messages() -> list[bytes]:
    camera = {
        "type": "ViewerCameraMessage", "wxyz": [0, 0, 1, 0], "position": [0.5, 1.5, -4], "fov": 0.6, "near": 0.01,
        "far": 1000, "image_height": 720, "image_width": 900, "look_at": [0, 1, 0], "up_direction": [0, 1, 0],
    }  # fmt: skip
    update = {"type": "GuiUpdateMessage", "uuid": "7f1c", "updates": {"value": [1.5, True]}}
    click = {
        "type": "ScenePointerMessage", "event_type": "click", "ray_origin": [0, 1, -4], "ray_direction": [0, 0, 1],
        "screen_pos": [[0.5, 0.5]], "modifier": None,
    }  # fmt: skip
    return [msgspec.msgpack.encode(message) for message in (camera, update, click)]


def _record_path() -> list[Door]:
    from mocapella.decoding import decode_json
    from mocapella.wire.clock import read_clock
    from mocapella.wire.delivery import check_number, read_answer, read_request

    request = b'{"take":"0f","stored":5,"age_ns":7,"end":9,"closed":true,"wanted":[[5,6],[8,8]]}'
    return [
        of_bytes("requests for frames", [request], read_request, TEXT),
        of_bytes("answers about frames", [b'{"next":9,"oldest":2,"first":1,"leaving":true}'], read_answer, TEXT),
        of_bytes("numbers of frames", [b"17"], lambda data: check_number(decode_json(data)), TEXT),
        of_bytes("clocks", [b"123456789"], read_clock, TEXT),
    ]


def _replying(data: bytes) -> Any:
    """Return a session in which every question is answered with these bytes."""
    reply = SimpleNamespace(ok=_sample(data), err=None)
    return SimpleNamespace(get=lambda *_, **__: [reply], info=SimpleNamespace(zid=lambda: "0f"))


def _sample(data: bytes) -> Any:
    return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data))


def _answers() -> list[Door]:
    """Readers of a server's answers."""
    from mocapella.model.session import RecordingHealth, SensorHealth, SessionStatus, Setup
    from mocapella.wire.keys import NodeKey
    from mocapella.wire.node import NodeLink
    from mocapella.wire.reader import _decode_status, send_command

    sensor = SensorHealth("front", 1, True, False, True, 1, 30.0, 0.01, 9, 0, 0, 0.0, 0.001, 9, 0, 0.1, 1.5)
    status = msgspec.json.encode(
        SessionStatus(
            0, True, "tracking", 0, 0, 0, "", 9, 30.0, Setup(), (sensor,), RecordingHealth(), ("welcome",), 1.0, "0.1"
        )
    )

    def told(data: bytes) -> object:
        node = SimpleNamespace(outbox=SimpleNamespace(next=3), node=NodeKey("front", 1), _session=_replying(data))
        return NodeLink._tell(node, "join", 1.0)  # type: ignore[arg-type]

    return [
        of_bytes(
            "replies", [b'{"ok":true,"message":"done"}'], lambda data: send_command(_replying(data), "stop"), TEXT
        ),
        of_bytes("statuses", [status], _decode_status, TEXT, 0.5),
        of_bytes("replies to nodes", [b'{"accepted":true,"message":"","recording":true}'], told, TEXT),
    ]


def _asked() -> list[Door]:
    """Readers of questions to cameras, and of their answers."""
    from mocapella.decoding import decode_json
    from mocapella.live.board_cameras import NodeCameras
    from mocapella.live.view import Link
    from mocapella.model.board import Board
    from mocapella.wire.expected import read_expected
    from mocapella.wire.questions import read_answer, read_question

    cameras = NodeCameras(lambda *_: None, lambda: (), ["left"], Board("charuco", 7, 5, 0.03))  # type: ignore[arg-type, return-value]
    row: Any = SimpleNamespace(capture_offset=0.5)
    link: Any = SimpleNamespace(_session=_replying(b'{"ok":true}'))
    corners = (
        b'{"ok":true,"time_ns":5,"size_px":[640,480],"corners":{"ids":[0,3],"corners_px":[[1,2],[3.5,4]],"edge_px":9}}'
    )

    shown = b'{"ok":true,"positions_px":[[1,2],null],"controls":{"fps":30}}'
    controls = (
        b'{"ok":true,"descriptions":[{"name":"gain","unit":"","least":0,"most":9,"step":0.5,"default":0,"value":1}]}'
    )
    asked = [
        b'{"ask":"board","board":"columns = 5","explain":true}',
        b'{"ask":"set","values":{"gain":2.5},"automatic":{"exposure":false}}',
    ]

    return [
        of_bytes("questions", asked, read_question, TEXT),
        of_bytes("expected people", [b'{"time_ns":5,"regions_px":[[0,1,20.5,40]]}'], read_expected, TEXT),
        of_bytes("questions of the view", [b'{"ask":"picture","scale":0.5,"format":"png"}'],
                 lambda data: Link.ask(link, "left", decode_json(data, dict[str, Any]), 1.0), TEXT),
        of_bytes("answers", [shown, controls], read_answer, TEXT),
        of_bytes("corners of boards", [corners], lambda data: cameras._look("left", read_answer(data), row), TEXT),
    ]  # fmt: skip


def _commands() -> list[Door]:
    """Readers of commands to the server."""
    from mocapella.live.session import Session
    from mocapella.model.session import Setup
    from mocapella.wire.server import Answer, ServerLink

    server: Any = SimpleNamespace(on_nonsense=lambda _: None, _refuse=lambda *_: None)
    setup = Setup(method="stand-still")
    memory = Session(setup).memory()
    seeds = [
        {"verb": "restore", "arguments": {**memory, "names": {"1": "anna"}}},
        {"verb": "setup", "arguments": {"participant": 7, "method": "stand-still", "sensors_expected": 2}},
        {"verb": "name", "arguments": {"person": 1, "name": "anna"}},
        {"verb": "stop", "arguments": {}},
    ]

    def commanded(data: bytes) -> object:
        payload = SimpleNamespace(to_bytes=lambda: data)
        query: Any = SimpleNamespace(payload=_Sized(data), attachment=payload)
        sender = Answer(query).sender
        found = ServerLink._arguments(server, query, f"command of {sender}")
        if found is None:
            return None
        verb, arguments = found.get("verb"), found.get("arguments")
        if not (isinstance(verb, str) and isinstance(arguments, dict)):
            return None
        return Session(setup).carry_out(verb, arguments)

    return [of_bytes("commands", [msgspec.json.encode(seed) for seed in seeds], commanded, TEXT, 0.3)]


class _Sized:
    """A payload as zenoh has it."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def to_bytes(self) -> bytes:
        return self._data


def _rings() -> list[Door]:
    """Readers of rings."""
    from mocapella.wire.doorbell import _RING_BYTES, Doorbell, Ring
    from mocapella.wire.roles import READER

    bell: Any = SimpleNamespace(
        refused=0, _session="lab", _users={READER}, _fingerprint="0" * 16, _noted=set(), _note=lambda _: None
    )
    bell._refuse = lambda ring, host: Doorbell._refuse(bell, ring, host)
    ring = msgspec.json.encode(Ring("lab", "1" * 16, READER, "front", "pc"))

    def rung(data: bytes) -> bytes:
        return Doorbell._answer(bell, data.ljust(_RING_BYTES)[:_RING_BYTES], "192.0.2.7")

    return [
        of_bytes("rings", [ring], rung, TEXT),
    ]
