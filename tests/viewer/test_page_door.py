"""Who may load the view and open its socket, over real sockets; and what a browser may change."""

from __future__ import annotations

import contextlib
import http.client
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
from mocapella.viewer import Viewer
from mocapella.viewer.commands import MOST_WAITING, Commander
from mocapella.viewer.gui_guard import LONGEST_TEXT, may_change
from mocapella.viewer.page import MAX_MESSAGE_BYTES
from mocapella.viewer.page_door import TOKEN_VARIABLE, PageDoor, users_token

PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
TOKEN = os.environ[TOKEN_VARIABLE]


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    viewer = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True))
    yield viewer._server.get_port()
    viewer.close()


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
    assert (door.refusal(f"/{door.query()}", {"Host": named}) == "") == ours


@example("//[", {"Host": "127.0.0.1"})
@example("/?token=\udcff", {"Host": "127.0.0.1"})
@example("/", {"Host": "127.0.0.1", "Cookie": 'mocapella-view-1="\udcff"'})
@example(f"/?token={TOKEN[:-1]}", {"Host": "127.0.0.1", "Origin": "http://["})
@given(st.text(max_size=200), st.dictionaries(st.sampled_from(["Host", "Origin", "Cookie"]), st.text(max_size=80)))
def test_any_request_is_answered_or_refused(path: str, headers: dict[str, str]) -> None:
    door = PageDoor(TOKEN, "127.0.0.1")
    if TOKEN not in path and TOKEN not in headers.get("Cookie", ""):
        assert door.refusal(path, headers)
    assert door.cookie(path, 80) is None


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


def test_a_browser_changes_only_the_value_of_a_control_that_it_shows() -> None:
    assert may_change(control(), {"value": True})
    assert may_change(control(), {"value": "take-1"})
    assert may_change(control(), {"value": [0.5, 1]})
    assert not may_change(control(disabled=True), {"value": True})
    assert not may_change(control(visible=False), {"value": True})
    for updates in ({}, {"disabled": False}, {"value": 1, "visible": True}, {"update_cb": []}):
        assert not may_change(control(), updates)
    for value in ("x" * (LONGEST_TEXT + 1), [0] * 17, [[1]], {"a": 1}, None, b"x", float("nan"), float("inf")):
        assert not may_change(control(), {"value": value})


def test_a_value_is_one_that_the_control_can_have() -> None:
    choice, slider = control(value="a", options=("a", "b")), control(value=2, min=1, max=9.5)
    box, text = control(value=False), control(value="")
    assert may_change(choice, {"value": "b"})
    assert may_change(slider, {"value": 9.5})
    assert may_change(box, {"value": True})
    assert may_change(text, {"value": "x"})
    for handle, value in (
        (choice, "junk"), (choice, 1), (choice, ["a"]), (slider, 0), (slider, 10), (slider, True), (slider, "2"),
        (box, 1), (box, "x"), (text, 1), (text, True),
    ):  # fmt: skip
        assert not may_change(handle, {"value": value})


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
    assert len(commander._waiting) == MOST_WAITING
    commander.send("record", {"name": "a"}, other)  # type: ignore[arg-type]
    commander.forget(flood)  # type: ignore[arg-type]
    go_on.set()
    wait_until("the other's command", lambda: "record" in done)
    commander.close()
    assert done == ["first", "record"]
