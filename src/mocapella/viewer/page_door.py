"""Access control of the live view: decide which requests may load the page and open its socket.

A page of another site that runs in the user's browser can send requests to this machine, and so can every local user.
So a request needs the view's token, and must name this view as its host and its origin. The token is in the URL that is
printed; the answer to that URL sets a cookie, which the page's further requests carry.
"""

from __future__ import annotations

import http.cookies
import ipaddress
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs, urlsplit

from mocapella.decoding import read_whole
from mocapella.errors import SettingsError

TOKEN_VARIABLE: Final = "MOCAPELLA_VIEW_TOKEN"
"""Environment variable with a token that replaces the one in the user's file."""
SHORTEST_TOKEN: Final = 16
_TOKEN_BYTES: Final = 24
_MOST_BYTES: Final = 1000
_PARAMETER: Final = "token"
_ANY: Final = ("0.0.0.0", "::")  # compared with, not listened at
_LOCAL: Final = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True)
class PageDoor:
    """Decides which HTTP requests are answered.

    Attributes:
        token: secret that a request must contain, in its query or its cookie.
        host: address of the network interface that the page is served on.
    """

    token: str
    host: str

    def refusal(self, path: str, headers: Mapping[str, str]) -> str:
        """Return the reason for which a request is refused; an empty text if it is allowed.

        Args:
            path: the request's path and query.
            headers: the request's headers by name; ``Host``, ``Origin`` and ``Cookie`` are read.
        """
        named = headers.get("Host", "")
        if not self._is_ours(_host_of(named)):
            return f"the host {named[:80]!r} is not this view; open the address that mocapella printed"
        origin = headers.get("Origin")
        if origin is not None and origin != f"http://{named}":
            return f"a page of {origin[:80]!r} may not use this view"
        presented = (self._in_query(path), self._in_cookie(headers.get("Cookie", "")))
        if not any(self._is_token(one) for one in presented):
            return "the token is missing or wrong; open the address that mocapella printed, with its ?token="
        return ""

    def cookie(self, path: str, port: int) -> str | None:
        """Return the header ``Set-Cookie`` for the answer to a request; None unless its query has the token.

        Args:
            path: the request's path and query.
            port: TCP port of the view, which is part of the cookie's name.
        """
        if not self._is_token(self._in_query(path)):
            return None
        return f"{_cookie_name(port)}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def query(self) -> str:
        """Return the query of the page's URL, which contains the token."""
        return f"?{_PARAMETER}={self.token}"

    def _is_ours(self, host: str) -> bool:
        if host == self.host or (host in _LOCAL and self.host in (*_LOCAL, *_ANY)):
            return True
        return self.host in _ANY and _is_address(host)  # a name could be another site's, bound to this machine

    def _is_token(self, text: str) -> bool:
        return secrets.compare_digest(text.encode("utf-8", "surrogateescape"), self.token.encode())

    def _in_query(self, path: str) -> str:
        try:
            return parse_qs(urlsplit(path).query).get(_PARAMETER, [""])[0]
        except ValueError:  # a path that is none, such as //[
            return ""

    def _in_cookie(self, header: str) -> str:
        try:
            cookies = http.cookies.SimpleCookie(header)
        except http.cookies.CookieError:
            return ""
        values = [cookie.value for name, cookie in cookies.items() if name.startswith(_COOKIE)]
        return self.token if any(map(self._is_token, values)) else ""


_COOKIE: Final = "mocapella-view-"


def _cookie_name(port: int) -> str:
    """Return a name of its own for each port: browsers share cookies between the ports of a host."""
    return f"{_COOKIE}{port}"


def _host_of(header: str) -> str:
    """Return the host of a header ``Host``, without port and brackets."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def users_token() -> str:
    """Return the token of this user's views, from `TOKEN_VARIABLE`, or from a file that only the user can read.

    The file is made if it is missing, and replaced, with a new token, if other users can read it. Else the token stays
    the same, so that an open page continues with the next view at its address.

    Raises:
        SettingsError: the variable's token is too short or not alphanumeric, or the file cannot be written.
        InputError: the file cannot be read, or is too long.
    """
    given = os.environ.get(TOKEN_VARIABLE)
    if given is not None:
        if len(given) < SHORTEST_TOKEN or not given.isascii() or not given.isalnum():
            raise SettingsError(f"{TOKEN_VARIABLE}: needs {SHORTEST_TOKEN} or more letters and digits")
        return given
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    file = Path(base) / "mocapella" / "view-token"
    try:
        return _kept(file) or _made(file)
    except OSError as error:
        raise SettingsError(
            f"{file}: the view's token cannot be kept there ({error.strerror}); set {TOKEN_VARIABLE}"
        ) from error


def _kept(file: Path) -> str:
    """Return the token of the file; empty if there is none, or if others could read or replace it."""
    if not file.is_file() or (os.name == "posix" and file.stat().st_mode & 0o077):
        return ""
    token = read_whole(file, fix="delete it", most_bytes=_MOST_BYTES).decode("utf-8", "replace").strip()
    return token if len(token) >= SHORTEST_TOKEN and token.isascii() and token.isalnum() else ""


def _made(file: Path) -> str:
    token = secrets.token_hex(_TOKEN_BYTES)
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    part = file.with_name(f"{file.name}.{secrets.token_hex(4)}")
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as out:
        out.write(token)
    part.replace(file)
    return token
