"""Who may load the view and open its socket, over real sockets; and what a browser may change."""

from __future__ import annotations

import contextlib
import errno
import http.client
import logging
import os
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import viser
from hypothesis import example, given
from hypothesis import strategies as st
from support.programs import wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import CloseCode
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from mocapella.errors import SettingsError
from mocapella.model.session import CommandReply
from mocapella.viewer import Viewer, page
from mocapella.viewer.commands import MOST_WAITING, Commander
from mocapella.viewer.gui_guard import may_change
from mocapella.viewer.page import MAX_MESSAGE_BYTES, MOST_CONNECTIONS, MOST_PAGES
from mocapella.viewer.page_door import TOKEN_VARIABLE, PageDoor, users_token

PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
TOKEN = os.environ[TOKEN_VARIABLE]


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    made = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    yield made
    made.close()


@pytest.fixture(scope="module")
def port(viewer: Viewer) -> int:
    return viewer._server.get_port()


def get(port: int, path: str, **headers: str) -> tuple[int, str, str]:
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as answer:
            return answer.status, answer.read().decode(), answer.headers.get("Set-Cookie", "")


def opens_socket(port: int, path: str = "/", **headers: str) -> bool:
    """Whether a WebSocket is accepted; one that is not gets 403."""
    at = f"ws://127.0.0.1:{port}{path}"
    try:
        with connect(at, additional_headers=headers, subprotocols=[PROTOCOL], open_timeout=30):
            return True
    except InvalidStatus as refused:
        if refused.response.status_code == 403:
            return False
        raise


def test_the_printed_address_loads_the_page_and_its_cookie_the_rest(port: int) -> None:
    status, page, cookie = get(port, f"/?token={TOKEN}")
    assert (status, "<title>Mocapella</title>" in page) == (200, True)
    assert cookie.endswith("HttpOnly; SameSite=Strict")
    carried = {"Cookie": cookie.split(";")[0]}
    assert get(port, "/", **carried)[0] == 200
    assert opens_socket(port, **carried, Origin=f"http://127.0.0.1:{port}")
    assert not opens_socket(port, **carried, Host=f"127.0.0.1:{port}")  # named twice


@pytest.mark.parametrize(
    "path", ["/", "//[", "/?token=", "/?token=wrong", f"/?token={TOKEN}x", "/assets/x.js", f"/{TOKEN}"]
)
def test_without_the_token_nothing_is_answered(port: int, path: str) -> None:
    status, text, cookie = get(port, path)
    assert (status, cookie) == (403, "")
    assert "open the address that mocapella printed" in text
    assert TOKEN not in text
    assert not opens_socket(port, path)
    assert get(port, "/", Cookie=f"mocapella-view-{port}=wrong")[0] == 403
    assert get(port, "/", Cookie=f"other={TOKEN}")[0] == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://[", "null", "https://127.0.0.1", "http://127.0.0.1:1"]
)
def test_a_page_of_another_origin_opens_no_socket(port: int, origin: str) -> None:
    assert not opens_socket(port, f"/?token={TOKEN}", Origin=origin)
    assert get(port, f"/?token={TOKEN}", Origin=origin)[0] == 403


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{}", "127.0.0.1.evil.example:{}", "[::1", ""])
def test_a_name_of_another_site_that_leads_here_is_refused(port: int, host: str) -> None:
    named = host.format(port)
    assert get(port, f"/?token={TOKEN}", Host=named)[0] == 403
    assert get(port, f"/?token={TOKEN}", Host=named, Origin=f"http://{named}")[0] == 403


@pytest.mark.parametrize("first", [b"GET /?token=\xff", b"GET //[", b"GET /?token=%ff"])
def test_a_request_that_is_none_is_refused_without_an_error(port: int, first: bytes) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=30) as raw:
        raw.sendall(first + f" HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        assert raw.recv(100).split()[1] in (b"403", b"400")


def test_a_huge_message_ends_its_connection(port: int) -> None:
    at = f"ws://127.0.0.1:{port}/?token={TOKEN}"
    with connect(at, subprotocols=[PROTOCOL], max_size=None, open_timeout=30) as link:
        with contextlib.suppress(ConnectionClosed):
            link.send(b"x" * (MAX_MESSAGE_BYTES + 1))
            for _ in link:
                pass
        assert link.close_code == CloseCode.MESSAGE_TOO_BIG


@pytest.mark.parametrize(
    ("listens", "named", "ours"),
    [
        ("127.0.0.1", "localhost:80", True),
        ("127.0.0.1", "[::1]:80", True),
        ("127.0.0.1", "192.0.2.7", False),
        ("192.0.2.7", "192.0.2.7:80", True),
        ("192.0.2.7", "localhost", False),
        ("0.0.0.0", "192.0.2.7:80", True),
        ("0.0.0.0", "lab.example:80", False),
        ("::", "[2001:db8::1]:80", True),
    ],
)
def test_the_host_is_an_address_of_this_view(listens: str, named: str, ours: bool) -> None:
    door = PageDoor(TOKEN, listens)
    assert (door.admit(f"/{door.query()}", {"Host": named}, 80).refusal == "") == ours


@example("//[", {"Host": "127.0.0.1"})
@example("/?token=\udcff", {"Host": "127.0.0.1"})
@example("/", {"Host": "127.0.0.1", "Cookie": 'mocapella-view-1="\udcff"'})
@example(f"/?token={TOKEN[:-1]}", {"Host": "127.0.0.1", "Origin": "http://["})
@given(st.text(max_size=200), st.dictionaries(st.sampled_from(["Host", "Origin", "Cookie"]), st.text(max_size=80)))
def test_any_request_is_answered_or_refused(path: str, headers: dict[str, str]) -> None:
    door = PageDoor(TOKEN, "127.0.0.1")
    admission = door.admit(path, headers, 80)
    if TOKEN not in path and TOKEN not in headers.get("Cookie", ""):
        assert admission.refusal
        assert admission.kind
    assert not admission.operates
    assert admission.cookie is None


def test_the_address_opened_last_gives_the_right() -> None:
    """Law: a known token in the query counts, else the one in this port's cookie; a watcher's never operates."""
    door, named = PageDoor(TOKEN, "127.0.0.1"), {"Host": "127.0.0.1:80"}
    right = {TOKEN: True, door.watch_token: False}
    for asked in (TOKEN, door.watch_token, "wrong", ""):
        for kept in (TOKEN, door.watch_token, "wrong"):
            cookies = f"mocapella-view-81={TOKEN}; mocapella-view-80={kept}"
            admission = door.admit(f"/?token={asked}", {**named, "Cookie": cookies}, 80)
            token = asked if asked in right else kept
            assert admission.operates == right.get(token, False)
            assert (admission.refusal == "") == (token in right)
            given = f"mocapella-view-80={asked}; Path=/; HttpOnly; SameSite=Strict"
            assert admission.cookie == (given if asked in right else None)


def test_a_watchers_token_does_not_tell_the_operators() -> None:
    door, other = PageDoor(TOKEN, "127.0.0.1"), PageDoor("another" + TOKEN, "127.0.0.1")
    assert len({TOKEN, door.watch_token, other.watch_token}) == 3
    assert TOKEN not in door.query(watch=True)
    assert PageDoor(door.watch_token, "127.0.0.1").watch_token != TOKEN


def test_each_refusal_is_counted_and_the_first_of_a_kind_is_logged(
    viewer: Viewer, port: int, caplog: pytest.LogCaptureFixture
) -> None:
    refusals = viewer._server.refusals
    before = refusals._counts.copy()
    refusals._logged_s.clear()
    with caplog.at_level(logging.WARNING, "mocapella.viewer"):
        for _ in range(3):
            get(port, "/?token=wrong")
            get(port, f"/?token={TOKEN}", Host="evil.example")
            opens_socket(port, f"/?token={TOKEN}", Origin="http://evil.example")
    now = refusals._counts - before
    assert dict(now) == {"token": 3, "host": 3, "origin": 3}
    assert sorted(record.reason for record in caplog.records) == ["host", "origin", "token"]
    assert any("a page of 'http://evil.example' may not use this view" in line for line in refusals.lines)
    assert all(TOKEN not in text for text in (caplog.text, *refusals.lines))


def test_connections_that_send_nothing_keep_nobody_out(viewer: Viewer, port: int) -> None:
    before = viewer._server.refusals._counts["connections"]
    with contextlib.ExitStack() as stack:
        mute = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=30))
            for _ in range(MOST_CONNECTIONS + 5)
        ]
        assert get(port, f"/?token={TOKEN}")[0] == 200
        for first in mute[:5]:  # had to go
            with contextlib.suppress(ConnectionResetError):
                assert first.recv(1) == b""
        mute[-1].setblocking(False)
        with pytest.raises(BlockingIOError):  # it may still ask
            mute[-1].recv(1)
        assert viewer._server.refusals._counts["connections"] - before >= 5


def test_a_request_that_comes_byte_by_byte_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    limits, theirs = list[float](), page.serve.__init__

    def listen(self: Any, *arguments: Any, **keywords: Any) -> None:
        limits.append(keywords["open_timeout"])
        theirs(self, *arguments, **keywords)

    monkeypatch.setattr(page.serve, "__init__", listen)
    monkeypatch.setattr(page, "HANDSHAKE_S", 0.5)
    viewer = Viewer("127.0.0.1", 0, command=None)
    try:
        with socket.create_connection(("127.0.0.1", viewer._server.get_port()), timeout=0.05) as slow:

            def cut_off() -> bool:
                try:
                    slow.sendall(b"G")
                    return slow.recv(1) == b""
                except TimeoutError:
                    return False
                except OSError:
                    return True

            wait_until("it is cut off", cut_off)
        assert limits == [0.5]
    finally:
        viewer.close()


def test_without_file_descriptors_the_view_says_so_and_goes_on_once_there_are_some(
    viewer: Viewer, port: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    accept, attempts = socket.socket.accept, list[int]()

    def failing(listener: socket.socket) -> Any:
        if listener.getsockname()[1] == port and not attempts:
            attempts.append(1)
            raise OSError(errno.EMFILE, "Too many open files")
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", failing)
    with caplog.at_level(logging.WARNING):
        assert get(port, f"/?token={TOKEN}")[0] == 200
    assert attempts == [1]
    assert not any(record.name == "asyncio" for record in caplog.records)
    assert any("cannot open more connections at present (Too many open files)" in one for one in caplog.messages)
    assert viewer._server.refusals._counts["resources"] == 1


def test_the_pages_are_bounded_and_a_closed_one_makes_room(viewer: Viewer, port: int) -> None:
    at = f"ws://127.0.0.1:{port}/?token={TOKEN}"
    with contextlib.ExitStack() as stack:
        pages = [stack.enter_context(connect(at, subprotocols=[PROTOCOL], open_timeout=30)) for _ in range(MOST_PAGES)]
        with pytest.raises(InvalidStatus) as refused:
            connect(at, subprotocols=[PROTOCOL], open_timeout=30)
        assert refused.value.response.status_code == 503
        pages[0].close()

        def opens() -> bool:
            try:
                connect(at, subprotocols=[PROTOCOL], open_timeout=30).close()
            except InvalidStatus:
                return False
            return True

        wait_until("there is room", opens)


def test_a_users_token_stays_and_only_the_user_can_read_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(TOKEN_VARIABLE)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    token, file = users_token(), tmp_path / "mocapella" / "view-token"
    assert users_token() == token
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    file.chmod(0o644)  # others may have read it
    renewed = users_token()
    assert renewed != token
    file.write_text("short")
    assert users_token() not in (token, renewed, "short")


@pytest.mark.parametrize("token", ["", "short", "with spaces in its middle", "ümlautümlautümlaut"])
def test_a_token_that_is_too_weak_is_refused(token: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, token)
    with pytest.raises(SettingsError, match="16 or more letters and digits"):
        users_token()


def control(**state: Any) -> Any:
    return SimpleNamespace(**{"disabled": False, "visible": True, **state})


def test_a_browser_changes_only_a_control_that_it_shows() -> None:
    """That it changes nothing but the value is checked before: test_page_messages.py."""
    for value in (True, "take-1", [0.5, 1]):
        assert may_change(control(), value)
        assert not may_change(control(disabled=True), value)
        assert not may_change(control(visible=False), value)


def test_a_value_is_one_that_the_control_can_have() -> None:
    choice, slider = control(value="a", options=("a", "b")), control(value=2, min=1, max=9.5)
    box, text = control(value=False), control(value="")
    assert may_change(choice, "b")
    assert may_change(slider, 9.5)
    assert may_change(box, True)
    assert may_change(text, "x")
    for handle, value in (
        (choice, "junk"), (choice, 1), (choice, ["a"]), (slider, 0), (slider, 10), (slider, True), (slider, "2"),
        (box, 1), (box, "x"), (text, 1), (text, True),
    ):  # fmt: skip
        assert not may_change(handle, value)


class Browser:
    def add_notification(self, *_: Any, **__: Any) -> None:
        pass


def test_a_flood_of_one_browser_does_not_delay_another_and_ends_with_it() -> None:
    begun, go_on, done = threading.Event(), threading.Event(), list[str]()

    def command(verb: str, arguments: dict[str, Any]) -> CommandReply:
        begun.set()
        go_on.wait(60)
        done.append(verb)
        return CommandReply(True)

    flood, other = Browser(), Browser()
    commander = Commander(command)
    commander.send("first", {}, flood)  # type: ignore[arg-type]
    assert begun.wait(60)
    for k in range(1000):
        commander.send("recalibrate", {}, flood)  # type: ignore[arg-type]
        commander.send("name", {"person": k}, flood)  # type: ignore[arg-type]
    assert [len(own) for own in commander._waiting.values()] == [MOST_WAITING]
    commander.send("record", {"name": "a"}, other)  # type: ignore[arg-type]
    commander.forget(flood)  # type: ignore[arg-type]
    go_on.set()
    wait_until("the other's command", lambda: "record" in done)
    commander.close()
    assert done == ["first", "record"]


def test_browsers_take_turns_and_each_ones_commands_keep_their_order() -> None:
    begun, go_on, done = threading.Event(), threading.Event(), list[tuple[str, int]]()

    def command(verb: str, arguments: dict[str, Any]) -> CommandReply:
        begun.set()
        go_on.wait(60)
        done.append((verb, arguments["number"]))
        return CommandReply(True)

    browsers = {name: Browser() for name in ("a", "b", "c")}
    commander = Commander(command)
    commander.send("first", {"number": 0}, browsers["a"])  # type: ignore[arg-type]
    assert begun.wait(60)
    for name, count in (("a", 4), ("b", 2), ("c", 1)):
        for number in range(count):
            commander.send(name, {"number": number}, browsers[name])  # type: ignore[arg-type]
    go_on.set()
    wait_until("all are sent", lambda: len(done) == 8)
    commander.close()
    assert done[1:] == [("a", 0), ("b", 0), ("c", 0), ("a", 1), ("b", 1), ("a", 2), ("a", 3)]
