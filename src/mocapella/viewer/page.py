"""The web page, served on one interface."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import viser
import viser.infra

from mocapella.errors import AddressInUseError, SettingsError

_THEIR_TITLE: Final = b"<title>Viser</title>"
_TITLE: Final = b"<title>Mocapella</title>"
_TOP, _BOTTOM = np.array([30.0, 41.0, 60.0]), np.array([9.0, 12.0, 19.0])
"""The ground's colours, from the top of the picture to its bottom."""


@contextlib.contextmanager
def unprinted() -> Iterator[None]:
    """Suppress the messages that viser prints, because standard output is for results."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


@contextlib.contextmanager
def tolerated() -> Iterator[None]:
    """Ignore a race of viser 1.1, which sets an `asyncio.Event` from this thread while its own thread waits for it.

    The message is queued before the error, and the next call draws the rest.
    """
    try:
        yield
    except RuntimeError as error:
        if str(error) != "deque mutated during iteration":
            raise


class PageServer(viser.ViserServer):
    """The server of viser, without its public tunnel."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse to open a public tunnel, so that no page can publish images of people."""
        return None

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.get_port()}"


def open_page(host: str, port: int, panel_px: int) -> PageServer:
    """Serve an empty page with a control panel.

    Args:
        host: the interface to serve on, and no other.
        port: its port; 0 takes a free one.
        panel_px: width of the panel.

    Raises:
        AddressInUseError: the port is in use.
        SettingsError: an address that this machine cannot listen at.
    """
    _check_free(host, port)
    with unprinted(), _own_index():
        server = PageServer(host=host, port=port, label="Mocapella", verbose=False)
    if port not in (0, server.get_port()):
        server.stop()
        raise _in_use(host, port)
    server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, brand_color=(56, 132, 255))
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(panel_px)
    server.scene.set_up_direction("+y")
    server.scene.configure_environment_map("studio", environment_intensity=0.3)
    shade = np.linspace(_TOP, _BOTTOM, 256)[:, None, :].repeat(8, axis=1)
    server.scene.set_background_image(shade.round().astype(np.uint8), format="png")
    return server


class _Page:
    """The library's page under our title: the part of `pathlib.Path` that its web server uses."""

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
        return content.replace(_THEIR_TITLE, _TITLE, 1) if self._path.name == "index.html" else content


class _PageSocket(viser.infra.WebsockServer):
    """The library's web server, which serves its page under our title."""

    def __init__(self, *args: Any, http_server_root: Path, **keywords: Any) -> None:
        keywords["http_server_root"] = _Page(http_server_root)
        super().__init__(*args, **keywords)


@contextlib.contextmanager
def _own_index() -> Iterator[None]:
    """Let a `viser.ViserServer` that is made meanwhile use `_PageSocket`; it has no argument for the page."""
    infra: Any = viser.infra
    usual = infra.WebsockServer
    infra.WebsockServer = _PageSocket
    try:
        yield
    finally:
        infra.WebsockServer = usual


def _check_free(host: str, port: int) -> None:
    """Before the web server tries: it would silently take the next port instead."""
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
