"""The web page of the live view, served on one network interface."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http
import inspect
import io
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
import viser
import viser.infra
import viser.infra._infra
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosedError
from websockets.http11 import Request, Response

from mocapella.errors import AddressInUseError, SettingsError
from mocapella.viewer.commands import SendCommand
from mocapella.viewer.page_door import PageDoor, users_token
from mocapella.viewer.page_messages import MESSAGES_HZ, MessageQuota, PageInbox
from mocapella.viewer.page_refusals import PageRefusals
from mocapella.viewer.study_page import SOCKET, StudyPages

_INFRA: Final[Any] = viser.infra._infra
_THEIR_SOCKETS: Final[Any] = _INFRA.websockets
_THEIR_TITLE: Final = b"<title>Viser</title>"
_SHEET: Final = '.mantine-Paper-root[style*="max-height: 60%"]'
"""Selector of the panel in a narrow window, where the library lays it over the lower part of the 3D scene."""
_STYLE: Final = f"""
@media (max-width: 36em) {{
  :has(> {_SHEET}) {{ flex-direction: column; }}
  :has(> {_SHEET}) > :not({_SHEET}, .mantine-Notifications-root) {{ height: auto !important; min-height: 0; }}
  {_SHEET} {{ position: relative !important; flex: none; width: 100% !important; max-height: 45% !important; }}
  {_SHEET} [style*="width: 20em"] {{ width: 100% !important; }}
}}"""
_HEAD: Final = f"<title>Mocapella</title><style>{_STYLE}</style>".encode()
"""Title and style of the page. In a narrow window the panel is below the scene, and does not cover it."""
_TOP, _BOTTOM = np.array([30.0, 41.0, 60.0]), np.array([9.0, 12.0, 19.0])
"""Background colours at the top and at the bottom of the view: red, green and blue, 0 to 255."""
MAX_MESSAGE_BYTES: Final = 1 << 20
"""Longest message of a browser, in bytes; a longer one ends the browser's connection."""
MOST_CONNECTIONS: Final = 256
"""Largest number of open connections."""
MOST_PAGES: Final = 64
"""Largest number of open pages, which each have one connection."""
HANDSHAKE_S: Final = 8.0
"""Longest time from connection to the end of the browser's request; then the connection is closed [s]."""
MOST_NEW: Final = 4096
"""Largest number of connections that wait to be accepted, if the system allows it. Further ones are dropped, and
browsers try again after a second."""
NEW_AT_ONCE: Final = 16
"""Number of connections that are accepted before others are answered: so few that no request that has come is dropped
for later connections, see `MOST_CONNECTIONS`."""
FLOOD_PAUSE_S: Final = 2.0
"""After a page was cut off because it flooded, new pages of its machine wait up to this time [s]."""


@contextlib.contextmanager
def unprinted() -> Iterator[None]:
    """Suppress the messages that viser prints within the ``with`` block, because standard output is for results.

    Output of other threads to ``sys.stdout`` is lost, too.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        yield


class PageServer(viser.ViserServer):
    """The web server of viser, without its public tunnel, and with a check of every request; made by `open_page`.

    Attributes:
        door: decides which requests are answered.
        refusals: counts the refused requests.
        study: the pages of a study, beside the view.
    """

    door: PageDoor
    refusals: PageRefusals
    study: StudyPages

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None instead of opening a public tunnel, so that no page can publish images of people."""
        return None

    @property
    def url(self) -> str:
        """Address of the page, with the operator's token."""
        return self._address(self.door.query())

    @property
    def watch_url(self) -> str:
        """Address of the page, with the watcher's token."""
        return self._address(self.door.query(watch=True))

    def operates(self, client: viser.ClientHandle) -> bool:
        """Return whether a browser's socket was opened with the operator's token; False after it has left."""
        sockets: Any = self._websock_server
        return getattr(sockets._live_connections.get(client.client_id), "operates", False)

    def study_url(self, page: str) -> str:
        """Address of a study's page, of its path without ``/``: the participant's has the watcher's token."""
        return self._address(self.door.query(watch=page != "study"), page)

    def _address(self, query: str, page: str = "") -> str:
        host = self.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.get_port()}/{page}{query}"


def open_page(host: str, port: int, panel_px: int, send: SendCommand | None = None) -> PageServer:
    """Serve an empty page with a control panel, on viser's own threads, until ``stop`` of the result is called.

    Args:
        host: address of the only network interface to serve on.
        port: TCP port; 0 takes a free one.
        panel_px: width of the panel.
        send: sends a command of a study's page to the server; None for none.

    Returns:
        The running server; its ``url`` has the operator's token.

    Raises:
        AddressInUseError: the port is in use.
        SettingsError: this machine cannot listen at the address, or the view's token is invalid or cannot be stored.
        InputError: the file of the view's token cannot be read.
    """
    _check_free(host, port)
    door, refusals = PageDoor(users_token(), host), PageRefusals()
    study = StudyPages(send, refusals)
    with unprinted(), _own_socket(door, refusals, study):
        server = PageServer(host=host, port=port, label="Mocapella", verbose=False)
    server.door, server.refusals, server.study = door, refusals, study
    if port not in (0, server.get_port()):
        server.stop()
        raise _in_use(host, port)
    server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, brand_color=(56, 132, 255))
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(panel_px)
    server.scene.set_up_direction("+y")
    # An environment map would cost a processor that draws without a GPU seconds for each page that is opened.
    server.scene.configure_environment_map(None)
    server.scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(70, 74, 90), intensity=3.0)
    shade = np.linspace(_TOP, _BOTTOM, 256)[:, None, :].repeat(8, axis=1)
    server.scene.set_background_image(shade.round().astype(np.uint8), format="png")
    return server


class _Page:
    """The library's page with our title and style: the part of `pathlib.Path` that its web server uses."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __truediv__(self, name: str) -> _Page:
        return _Page(self._path / name)

    def __hash__(self) -> int:
        return hash(self._path)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Page) and other._path == self._path

    def is_file(self) -> bool:
        return self._path.is_file()

    def read_bytes(self) -> bytes:
        content = self._path.read_bytes()
        return content.replace(_THEIR_TITLE, _HEAD, 1) if self._path.name == "index.html" else content


class _PageSocket(viser.infra.WebsockServer):
    """viser's web server, which serves its page under our title and admits requests by a `PageDoor`."""

    door: PageDoor
    refusals: PageRefusals
    study: StudyPages

    def __init__(self, *args: Any, http_server_root: Path, **keywords: Any) -> None:
        keywords["http_server_root"] = _Page(http_server_root)
        keywords["message_class"] = PageInbox(self.refusals)
        super().__init__(*args, **keywords)

    def _background_worker(self, ready_sem: threading.Semaphore) -> None:
        _AT.door, _AT.seats, _AT.study = self.door, _Seats(self.refusals), self.study  # this thread serves
        super()._background_worker(ready_sem)  # type: ignore[no-untyped-call,unused-ignore]


class _LoopEvent(asyncio.Event):
    """Event that other threads may set: its waiters are woken on the loop's own thread. Made on that thread.

    viser sets events from the drawing loop's thread. An `asyncio.Event` is not made for that: it changes its waiters
    while their loop does, raises an error into the drawing, and may wake nobody.
    """

    def __init__(self) -> None:
        super().__init__()
        self._loop_of_page = asyncio.get_event_loop()
        self._asked = False

    def set(self) -> None:
        if asyncio._get_running_loop() is self._loop_of_page:
            super().set()
        elif not self._asked:
            self._asked = True  # until `_hear`, so that the loop is not woken for each message of a drawing
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits
                self._loop_of_page.call_soon_threadsafe(self._hear)

    def _hear(self) -> None:
        self._asked = False
        super().set()


@dataclass
class _Messages(_INFRA.AsyncMessageBuffer):  # type: ignore[misc]
    """The library's messages to one page or to all, with events that any thread may set."""

    message_event: asyncio.Event = field(default_factory=_LoopEvent)
    flush_event: asyncio.Event = field(default_factory=_LoopEvent)


_AT: Final = threading.local()
"""`PageDoor`, `_Seats` and `StudyPages` of the page that a thread serves."""


class _Seats:
    """Bounds the connections of a page; used on the serving thread only.

    A connection beyond `MOST_CONNECTIONS` takes the place of the oldest whose request is not answered yet, so that
    connections that send nothing keep nobody out.
    """

    def __init__(self, refusals: PageRefusals) -> None:
        self.refusals = refusals
        self._asking: dict[_Connection, None] = {}
        self._pages: set[_Connection] = set()
        self._pauses_end_s: dict[str, float] = {}

    def take(self, connection: _Connection) -> None:
        self._asking[connection] = None
        if len(self._asking) + len(self._pages) > MOST_CONNECTIONS:
            oldest = next(iter(self._asking))
            del self._asking[oldest]
            oldest.transport.abort()
            self.refusals.add("connections", f"more than {MOST_CONNECTIONS} connections were open")

    def take_page(self, connection: _Connection) -> str:
        """Let a connection become a page's socket; return the reason if it may not."""
        if len(self._pages) >= MOST_PAGES:
            return f"{MOST_PAGES} pages are open; close one"
        self._asking.pop(connection, None)
        self._pages.add(connection)
        return ""

    def flooded(self, host: str, now_s: float) -> None:
        """Note that a page of a host was cut off because it flooded, at a time of the monotonic clock [s]."""
        self._pauses_end_s = {name: end_s for name, end_s in self._pauses_end_s.items() if end_s > now_s}
        self._pauses_end_s[host] = now_s + FLOOD_PAUSE_S

    def pause_s(self, host: str, now_s: float) -> float:
        """Return how long a new page of a host waits because another one flooded [s]."""
        return max(0.0, self._pauses_end_s.get(host, now_s) - now_s)

    def leave(self, connection: _Connection) -> None:
        self._asking.pop(connection, None)
        self._pages.discard(connection)


class _Connection(ServerConnection):
    """A connection that `_Seats` counts.

    Attributes:
        operates: whether its request had the operator's token.
        of_study: whether it is the socket of a study's page.
    """

    operates = False
    of_study = False

    def __init__(self, *args: Any, seats: _Seats, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self._seats = seats
        self._quota = MessageQuota()

    @property
    def host(self) -> str:
        """Address of the browser's machine."""
        return str(self.remote_address[0])

    async def recv(self, decode: bool | None = None) -> Any:
        """Return a page's next message, as bytes; end the connection of a page that sends too many."""
        data = await super().recv(decode=False)
        now_s = time.monotonic()
        if not self._quota.take(now_s):
            self._seats.flooded(self.host, now_s)
            self._seats.refusals.add("messages", f"a page sent more than {MESSAGES_HZ:.0f} messages a second")
            self.transport.abort()  # its further messages are dropped
            raise ConnectionClosedError(None, None)
        return data

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._seats.take(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._seats.leave(self)
        super().connection_lost(exc)


class _GuardedServe(serve):
    """The socket server of viser's web server, which first asks the thread's `PageDoor` to admit a request."""

    def __init__(self, handler: Any, *args: Any, process_request: Callable[..., Any], **keywords: Any) -> None:
        door: PageDoor = _AT.door
        seats: _Seats = _AT.seats
        study: StudyPages = _AT.study

        async def served(connection: ServerConnection) -> None:
            assert isinstance(connection, _Connection)
            if connection.of_study:
                await study.serve(connection)
            else:
                await handler(connection)

        def refuse(connection: _Connection, status: http.HTTPStatus, kind: str, reason: str) -> Response:
            seats.refusals.add(kind, reason)
            return connection.respond(status, f"{reason}\n")

        async def guarded(connection: ServerConnection, request: Request) -> Response | None:
            assert isinstance(connection, _Connection)
            headers = {name: request.headers.get_all(name) for name in ("Host", "Origin", "Cookie")}
            repeated = [name for name, values in headers.items() if len(values) > 1]
            if repeated:
                return refuse(connection, http.HTTPStatus.FORBIDDEN, "header", f"the header {repeated[0]} is repeated")
            first = {name: values[0] for name, values in headers.items() if values}
            admission = door.admit(request.path, first, connection.local_address[1])
            if admission.refusal:
                return refuse(connection, http.HTTPStatus.FORBIDDEN, admission.kind, admission.refusal)
            connection.operates = admission.operates
            path = urlsplit(request.path).path
            connection.of_study = path == SOCKET
            page = study.page(path)
            response = _html(page) if page is not None else process_request(connection, request)
            if inspect.isawaitable(response):
                response = await response
            if response is None:
                if full := seats.take_page(connection):
                    return refuse(connection, http.HTTPStatus.SERVICE_UNAVAILABLE, "pages", full)
                # Only now, so that a page that leaves meanwhile leaves its seat.
                await asyncio.sleep(seats.pause_s(connection.host, time.monotonic()))
            if response is not None and admission.cookie is not None:
                response.headers["Set-Cookie"] = admission.cookie
            return response

        asyncio.get_running_loop().set_exception_handler(partial(_hear_error, seats.refusals))
        keywords["create_connection"] = partial(_Connection, seats=seats)
        keywords |= {"max_size": MAX_MESSAGE_BYTES, "open_timeout": HANDSHAKE_S, "backlog": NEW_AT_ONCE}
        super().__init__(served, *args, process_request=guarded, **keywords)

    async def __aenter__(self) -> Server:
        server = await super().__aenter__()
        for listening in server.sockets:
            with socket.socket(fileno=os.dup(listening.fileno())) as same:
                same.listen(MOST_NEW)  # asyncio's `backlog` is both numbers
        return server


def _html(page: bytes) -> Response:
    headers = {
        "Content-Type": "text/html; charset=utf-8",
        "Content-Length": str(len(page)),
        "Cache-Control": "no-store",
    }
    return Response(http.HTTPStatus.OK, "OK", Headers(headers), page)


def _hear_error(refusals: PageRefusals, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Count connections that cannot be accepted for want of file descriptors or memory; the loop soon tries again."""
    error = context.get("exception")
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
        refusals.add("resources", f"it cannot open more connections at present ({error.strerror})")
    else:
        loop.default_exception_handler(context)


class _GuardedSockets:
    """The package ``websockets`` as the library's web server sees it: with `_GuardedServe`."""

    asyncio = SimpleNamespace(server=SimpleNamespace(serve=_GuardedServe, ServerConnection=ServerConnection))

    def __getattr__(self, name: str) -> Any:
        return getattr(_THEIR_SOCKETS, name)


@contextlib.contextmanager
def _own_socket(door: PageDoor, refusals: PageRefusals, study: StudyPages) -> Iterator[None]:
    """Let a `viser.ViserServer` that is made within the ``with`` block use `_PageSocket`; it has no argument for it."""
    infra: Any = viser.infra
    _INFRA.AsyncMessageBuffer = _Messages  # stays, because later pages create their buffers by this name, too
    usual = infra.WebsockServer
    infra.WebsockServer = type("_PageSocket", (_PageSocket,), {"door": door, "refusals": refusals, "study": study})
    _INFRA.websockets = _GuardedSockets()
    try:
        yield
    finally:
        infra.WebsockServer = usual
        _INFRA.websockets = _THEIR_SOCKETS


def _check_free(host: str, port: int) -> None:
    """Raise an error if the port cannot be used; the web server would silently take the next one."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _in_use(host, port) from error
        raise SettingsError(
            f"the view cannot listen at {host}:{port} ({error.strerror or error}); take 127.0.0.1 and a port over 1023"
        ) from error


def _in_use(host: str, port: int) -> AddressInUseError:
    return AddressInUseError(
        f"the view's port {port} on {host} is in use; stop what listens there, or take another port"
    )
