"""What pages may send, and that the drawing bears whatever of it passes."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import psutil
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st
from support.browser import page_url
from support.programs import wait_until
from support.walkers import Room, status
from viser import _messages
from viser.infra._infra import AsyncMessageBuffer, WebsockClientConnection, _ClientHandleState
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from mocapella.errors import InputError
from mocapella.model.session import CommandReply
from mocapella.viewer import Viewer
from mocapella.viewer.commands import Commander
from mocapella.viewer.page import FLOOD_PAUSE_S, MOST_CONNECTIONS, _Seats
from mocapella.viewer.page_messages import (
    FARTHEST,
    LARGEST,
    LONGEST_TEXT,
    MESSAGES_HZ,
    MOST_AT_ONCE,
    USED,
    MessageQuota,
    decode_page_message,
)
from mocapella.viewer.page_refusals import PageRefusals
from mocapella.viewer.picture_plane import Plane

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [0, 0, 1, 0], "position": [0.5, 1.5, -4], "fov": 0.6, "near": 0.01,
    "far": 1000, "image_height": 720, "image_width": 900, "look_at": [0, 1, 0], "up_direction": [0, 1, 0],
}  # fmt: skip
UPDATE = {"type": "GuiUpdateMessage", "uuid": "7f1c", "updates": {"value": True}}
CLICK = {
    "type": "ScenePointerMessage", "event_type": "click", "ray_origin": [0, 1, -4], "ray_direction": [0, 0, 1],
    "screen_pos": [[0.5, 0.5]], "modifier": None,
}  # fmt: skip
VALID = {message["type"]: message for message in (CAMERA, UPDATE, CLICK)}

BAD_VECTORS: list[Any] = [
    [math.nan, 0, 0], [0, math.inf, 0], [0, 0, 2 * FARTHEST], [0, 0], [0, 0, 0, 0, 0], [], ["1", 0, 0], [None, 0, 0],
    [[0], 0, 0], [True, 0, 0], "abc", 3, None, {"0": 0}, [2**64 - 1, 0, 0], [-1e308, 0, 0],
]  # fmt: skip
BAD_SIZES: list[Any] = [-1, 0.5, 2 * int(FARTHEST), 2**64 - 1, "9", None, True, [900]]
BAD_DISTANCES: list[Any] = [-1.0, math.nan, math.inf, 1e308, "1", None, [1]]
BAD_VALUES: list[Any] = [
    None, math.nan, math.inf, -2 * LARGEST, 2**64 - 1, 1e308, "x" * (LONGEST_TEXT + 1), b"x", {"a": 1}, [[1]], [0] * 17,
    [math.nan], ["x" * (LONGEST_TEXT + 1)],
]  # fmt: skip
BAD: dict[str, dict[str, list[Any]]] = {
    "ViewerCameraMessage": {
        "wxyz": [*BAD_VECTORS, [0, 0, 0]], "position": BAD_VECTORS, "look_at": [*BAD_VECTORS, CAMERA["position"]],
        "up_direction": [*BAD_VECTORS, [0, 0, 0]], "fov": [0, -1, math.pi, math.nan, math.inf, 1e308, "1", None, [1]],
        "near": BAD_DISTANCES, "far": BAD_DISTANCES, "image_height": BAD_SIZES, "image_width": BAD_SIZES,
    },
    "GuiUpdateMessage": {
        "uuid": ["x" * 101, 5, None, b"x"],
        "updates": [
            {}, {"disabled": False}, {"value": 1, "visible": True}, {"update_cb": []}, {"__class__": 1}, {1: 1}, [],
            None, "value", *({"value": bad} for bad in BAD_VALUES),
        ],
    },
    "ScenePointerMessage": {
        "event_type": ["rect-select", "", 1, None], "ray_origin": BAD_VECTORS, "ray_direction": BAD_VECTORS,
        "screen_pos": [[], [[0, 0], [1, 1]], [[0]], [[math.nan, 0]], None, "ab"],
        "modifier": ["x" * 101, 1, ["alt"]],
    },
}  # fmt: skip
"""For each message and each of its fields, what it may not be."""


def packed(message: Any) -> bytes:
    return msgspec.msgpack.encode(message)


def test_what_viser_s_page_sends_passes_as_viser_decodes_it() -> None:
    assert VALID.keys() == BAD.keys() == {kind.__name__ for kind in USED}
    for message in VALID.values():
        assert decode_page_message(packed(message)) == _messages.Message.deserialize(packed(message))
    for value in (True, 5, -0.5, "take-1", "", [0.5, 1], ["a"], LARGEST):
        assert decode_page_message(packed({**UPDATE, "updates": {"value": value}})).updates == {"value": value}  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", list(BAD))
def test_each_field_is_of_its_form_and_range(kind: str) -> None:
    assert BAD[kind].keys() == VALID[kind].keys() - {"type"}
    for field, values in BAD[kind].items():
        for value in values:
            with pytest.raises(InputError, match="is no message of the view's page"):
                decode_page_message(packed({**VALID[kind], field: value}))
        with pytest.raises(InputError, match=f"missing required field `{field}`"):
            decode_page_message(packed({name: value for name, value in VALID[kind].items() if name != field}))
    for field in ("excluded_self_client", "x", "_impl"):
        with pytest.raises(InputError, match="unknown field"):
            decode_page_message(packed({**VALID[kind], field: 1}))


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\xc1", b"\x91" * 100_000, b"\x81\xa4type" * 10_000, packed([]), packed(None), packed({}),
        packed({"type": 3}), packed({"type": "Message"}), packed({"type": "x" * 100_000}), b"\xdd\xff\xff\xff\xff",
        b"\xdb\xff\xff\xff\xff", packed({**CAMERA, "x" * 100_000: 1}),
    ],
)  # fmt: skip
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        decode_page_message(data)


def test_messages_that_the_view_does_not_use_are_refused() -> None:
    names = {kind.__name__ for kind in _messages.Message.get_subclasses()} - VALID.keys()
    assert "ShareUrlRequest" in names
    for name in names:
        with pytest.raises(InputError, match="Invalid value"):
            decode_page_message(packed({"type": name}))


def test_a_page_sends_so_many_messages_at_once_and_in_the_mean() -> None:
    quota = MessageQuota()
    assert all(quota.take(100.0) for _ in range(MOST_AT_ONCE))
    assert not quota.take(100.0)
    quota, step_s = MessageQuota(), 0.75 / MESSAGES_HZ  # four thirds of the mean rate: lasts for four times as many
    taken = [quota.take(100.0 + k * step_s) for k in range(5 * MOST_AT_ONCE)]
    assert abs(taken.index(False) - 4 * MOST_AT_ONCE) <= 5


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    made = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    yield made
    made.close()


def page(viewer: Viewer, timeout_s: float = 60.0) -> ClientConnection:
    address = page_url(viewer._server.get_port()).replace("http", "ws")
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    return connect(address, subprotocols=[protocol], max_size=None, open_timeout=timeout_s)


def counted(viewer: Viewer, kind: str) -> int:
    return viewer._server.refusals._counts[kind]


def test_a_refused_message_is_counted_and_its_page_goes_on(viewer: Viewer) -> None:
    before, known = counted(viewer, "message"), len(viewer._server.get_clients())
    with page(viewer) as sender:
        for message in ({**CAMERA, "position": [math.nan] * 3}, {"type": "ShareUrlRequest"}):
            sender.send(packed(message))
        sender.send("a text")
        wait_until("they are counted", lambda: counted(viewer, "message") == before + 3)
        assert len(viewer._server.get_clients()) == known
        sender.send(packed(CAMERA))
        wait_until("the page is known", lambda: len(viewer._server.get_clients()) > known)
    assert any("a page's message cannot be used" in line for line in viewer._server.refusals.lines)


def test_a_page_that_floods_is_cut_off_and_others_are_not(viewer: Viewer) -> None:
    before = counted(viewer, "messages")
    with page(viewer) as other, page(viewer) as flood:
        with pytest.raises(ConnectionClosed):
            send_many(flood)
        assert counted(viewer, "messages") == before + 1
        other.ping().wait(60)


def test_after_a_flood_new_pages_of_the_machine_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.viewer.page.FLOOD_PAUSE_S", 3600.0)
    own = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    try:
        with page(own) as flood, pytest.raises(ConnectionClosed):
            send_many(flood)
        with pytest.raises(TimeoutError):
            page(own, timeout_s=1.0)
    finally:
        own.close()


def test_a_page_that_leaves_while_it_waits_keeps_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.viewer.page.MOST_PAGES", 1)
    own = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    try:
        with page(own) as flood, pytest.raises(ConnectionClosed):
            send_many(flood)
        with contextlib.suppress(TimeoutError, InvalidStatus):  # the pause may be over on a busy machine
            page(own, timeout_s=0.3).close()

        def opens() -> bool:
            with contextlib.suppress(InvalidStatus), page(own):
                return True
            return False

        time.sleep(1.2 * FLOOD_PAUSE_S)  # all that waited has gone on
        wait_until("there is a place", opens)
    finally:
        own.close()


def test_the_pause_after_a_flood_is_its_machines_and_ends() -> None:
    seats = _Seats(PageRefusals())
    assert seats.pause_s("::1", 10.0) == 0.0
    seats.flooded("::1", 10.0)
    assert [seats.pause_s("::1", at_s) for at_s in (10.0, 10.0 + 0.25 * FLOOD_PAUSE_S, 10.0 + 2 * FLOOD_PAUSE_S)] == [
        FLOOD_PAUSE_S, 0.75 * FLOOD_PAUSE_S, 0.0
    ]  # fmt: skip
    assert seats.pause_s("192.0.2.7", 10.0) == 0.0
    seats.flooded("192.0.2.7", 10.0 + 2 * FLOOD_PAUSE_S)
    assert seats.pause_s("::1", 10.0) == 0.0  # forgotten: a machine costs no memory for ever


def test_connections_wait_while_the_page_is_busy(viewer: Viewer) -> None:
    busy, free = threading.Event(), threading.Event()

    def work() -> None:
        busy.set()
        free.wait(60)

    sockets: Any = viewer._server._websock_server
    sockets._background_event_loop.call_soon_threadsafe(work)
    try:
        assert busy.wait(60)
        with contextlib.ExitStack() as stack:
            for _ in range(300):  # beyond what waits, the system drops requests, and they are sent again after 1 s
                stack.enter_context(socket.create_connection(("127.0.0.1", viewer._server.get_port()), timeout=0.9))
    finally:
        free.set()


def test_a_request_among_many_silent_connections_is_answered(viewer: Viewer) -> None:
    busy, free = threading.Event(), threading.Event()

    def work() -> None:
        busy.set()
        free.wait(60)

    def connected(stack: contextlib.ExitStack) -> socket.socket:
        return stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60))

    sockets, port = cast(Any, viewer._server._websock_server), viewer._server.get_port()
    before = psutil.Process().num_fds()
    with contextlib.ExitStack() as stack:
        sockets._background_event_loop.call_soon_threadsafe(work)
        try:
            assert busy.wait(60)
            asking = connected(stack)
            query = viewer.url.partition("/?")[2]
            asking.sendall(f"GET /?{query} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            for _ in range(2 * MOST_CONNECTIONS):  # that send nothing
                connected(stack)
        finally:
            free.set()
        assert asking.recv(12) == b"HTTP/1.1 200"
    wait_until("all are closed", lambda: psutil.Process().num_fds() <= before)


def send_many(flood: ClientConnection) -> None:
    for _ in range(20 * MOST_AT_ONCE):
        flood.send(packed(UPDATE))


class DrawnPage:
    """A page that draws the view, without a socket: its messages go to viser as they do from one."""

    def __init__(self, viewer: Viewer, *, operates: bool = True) -> None:
        self._viewer, self._room, self._number = viewer, Room(), 10**6
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        self._loop = loop
        own = _ClientHandleState(AsyncMessageBuffer(loop, persistent_messages=False), loop)
        self._connection: Any = WebsockClientConnection(self._number, own)
        sockets: Any = viewer._server._websock_server
        sockets._live_connections[self._number] = SimpleNamespace(operates=operates)
        for connected in sockets._client_connect_cb:
            loop.run_until_complete(connected(self._connection))
        self.send(CAMERA)
        self.draw()

    def send(self, message: Any) -> None:
        decoded = decode_page_message(packed(message))
        self._loop.run_until_complete(self._connection._handle_incoming_message(self._number, decoded))

    def draw(self) -> None:
        frames = self._room.frames(0.0)
        self._viewer.show(self._room.scene(0.0, frames), frames, status())

    def press(self, button: str) -> None:
        panel = self._viewer._browsers[self._number]._panel
        self.send({**UPDATE, "uuid": getattr(panel, button)._impl.uuid})

    def leave(self) -> None:
        self._viewer._server._connected_clients.pop(self._number, None)

    def close(self) -> None:
        self.leave()
        self._viewer._browsers.clear()
        self._loop.close()


@pytest.fixture(scope="module")
def drawn() -> Iterator[DrawnPage]:
    viewer = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    made = DrawnPage(viewer)
    yield made
    made.close()
    viewer.close()


@pytest.mark.parametrize(("operates", "sent"), [(True, ["stop", "recalibrate", "record"]), (False, [])])
def test_only_an_operator_s_press_of_an_enabled_button_is_sent(
    operates: bool, sent: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[str] = []
    monkeypatch.setattr(Commander, "send", lambda commander, verb, *_: found.append(verb))
    viewer = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    drawn = DrawnPage(viewer, operates=operates)
    try:
        for button in ("_start", "_record_stop", "_stop", "_start", "_recalibrate", "_record"):
            drawn.press(button)  # of a session that tracks and does not record
        assert found == sent
    finally:
        drawn.close()
        viewer.close()


def test_waiting_commands_of_a_page_that_has_left_are_dropped() -> None:
    go_on = threading.Event()

    def command(verb: str, arguments: dict[str, Any]) -> CommandReply:
        go_on.wait(60)
        return CommandReply(True)

    viewer = Viewer("127.0.0.1", 0, command=command)
    drawn = DrawnPage(viewer)
    assert viewer._commander is not None
    try:
        for button in ("_stop", "_recalibrate", "_record"):
            drawn.press(button)
        drawn.draw()
        assert viewer._commander._waiting
        drawn.leave()
        drawn.draw()
        assert not viewer._commander._waiting
    finally:
        go_on.set()
        drawn.close()
        viewer.close()


numbers = st.sampled_from([0.0, -0.0, 1e-300, 1e-9, 1.0, FARTHEST, -FARTHEST]) | st.floats(-FARTHEST, FARTHEST)
vectors = st.lists(numbers, min_size=3, max_size=3)
sizes = st.sampled_from([0, 1, int(FARTHEST)]) | st.integers(0, 4000)
cameras = st.fixed_dictionaries(
    {
        "type": st.just("ViewerCameraMessage"), "wxyz": st.lists(numbers, min_size=4, max_size=4),
        "position": vectors, "look_at": vectors, "up_direction": vectors, "near": st.just(0.01), "far": st.just(1e6),
        "fov": st.sampled_from([1e-300, math.nextafter(math.pi, 0)]) | st.floats(0.01, 3.0),
        "image_height": sizes, "image_width": sizes,
    }
)  # fmt: skip


@settings(max_examples=25)
@given(cameras)
def test_whatever_camera_passes_the_drawing_bears(drawn: DrawnPage, camera: dict[str, Any]) -> None:
    try:
        drawn.send(camera)
    except InputError:
        return
    with np.errstate(all="ignore"):
        drawn.draw()


@given(vectors, vectors)
def test_whatever_click_passes_meets_a_picture_within_it_or_not(origin: list[float], direction: list[float]) -> None:
    click: Any = decode_page_message(packed({**CLICK, "ray_origin": origin, "ray_direction": direction}))
    plane = Plane(np.array([0.0, 1.0, 2.0]), 1.6, (640, 480))
    with np.errstate(all="ignore"):
        at = plane.pixel(np.array(click.ray_origin), np.array(click.ray_direction))
    assert at is None or (-0.5 <= at[0] <= 639.5 and -0.5 <= at[1] <= 479.5)


leaves = st.sampled_from([None, True, -(2**63), 2**64 - 1, math.nan, 1e308, "x" * 2000, b"x"]) | numbers | st.text()
lists = st.lists(leaves, max_size=5)
fields = st.dictionaries(st.sampled_from(["value", "x"]), leaves | lists, max_size=2)
json_like = leaves | lists | fields | st.lists(lists)


@given(st.sampled_from(list(VALID)), st.data())
def test_a_field_of_any_kind_is_refused_or_of_the_message_s_own(kind: str, data: st.DataObject) -> None:
    """Whatever passes has viser's fields, finite numbers, and short texts."""
    field = data.draw(st.sampled_from([name for name in VALID[kind] if name != "type"]))
    try:
        message = decode_page_message(packed({**VALID[kind], field: data.draw(json_like)}))
    except InputError:
        return
    flat = [vars(message)]
    for value in flat:
        if isinstance(value, dict | list | tuple):
            flat += value.values() if isinstance(value, dict) else value  # type: ignore[arg-type]
        elif isinstance(value, int | float):
            assert abs(value) <= LARGEST
        else:
            assert value is None or (isinstance(value, str) and len(value) <= LONGEST_TEXT)
