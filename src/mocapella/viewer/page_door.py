"""Access control of the live view: decide which requests may load the page and open its socket.

A page of another site that runs in the user's browser can send requests to this machine, and so can every local user.
So a request needs one of the view's two tokens, and must name this view as its host and its origin. The operator's
token allows to control the session, the watcher's to watch it. A token is in the URL that is printed; the answer to
that URL sets a cookie, which the page's further requests carry.
"""

from __future__ import annotations

import hashlib
import http.cookies
import ipaddress
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import parse_qs, urlsplit

from mocapella.decoding import read_whole
from mocapella.errors import SettingsError

TOKEN_VARIABLE: Final = "MOCAPELLA_VIEW_TOKEN"
"""Environment variable with a token that replaces the one in the user's file."""
SHORTEST_TOKEN: Final = 16
_TOKEN_BYTES: Final = 24
_WATCH_DIGITS: Final = 48
_MOST_BYTES: Final = 1000
_PARAMETER: Final = "token"
_ANY: Final = ("0.0.0.0", "::")  # compared with, not listened at
_LOCAL: Final = ("localhost", "127.0.0.1", "::1")


class Admission(NamedTuple):
    """Decision about one HTTP request.

    Attributes:
        refusal: reason for which the request is refused; empty if it is allowed.
        kind: short name of the reason, for counting: ``host``, ``origin`` or ``token``; empty if it is allowed.
        operates: whether the request has the operator's token. If not, its page only watches.
        cookie: header ``Set-Cookie`` for the answer; None unless the request is allowed and its query has a token.
    """

    refusal: str = ""
    kind: str = ""
    operates: bool = False
    cookie: str | None = None


@dataclass(frozen=True)
class PageDoor:
    """Decides which HTTP requests are answered.

    Attributes:
        token: the operator's token; a request must contain it, or `watch_token`, in its query or its cookie.
        host: address of the network interface that the page is served on.
    """

    token: str
    host: str

    @property
    def watch_token(self) -> str:
        """The watcher's token: a hash of the operator's token, so that it does not reveal that one."""
        return hashlib.sha256(f"mocapella watch {self.token}".encode()).hexdigest()[:_WATCH_DIGITS]

    def admit(self, path: str, headers: Mapping[str, str], port: int) -> Admission:
        """Decide whether a request is answered, and with which right.

        A token in the query counts before one in the cookie, so a browser has the right of the address opened last.

        Args:
            path: the request's path and query.
            headers: the request's headers by name; ``Host``, ``Origin`` and ``Cookie`` are read.
            port: TCP port of the view, which is part of the cookie's name.
        """
        named = headers.get("Host", "")
        if not self._is_ours(_host_of(named)):
            return Admission(
                f"the host {named[:80]!r} is not this view; open the address that mocapella printed", "host"
            )
        origin = headers.get("Origin")
        if origin is not None and origin != f"http://{named}":
            return Admission(f"a page of {origin[:80]!r} may not use this view", "origin")
        in_query = self._known(_in_query(path))
        token = in_query or self._known(_in_cookie(headers.get("Cookie", ""), _cookie_name(port)))
        if not token:
            return Admission(
                "the token is missing or wrong; open the address that mocapella printed, with its ?token=", "token"
            )
        cookie = f"{_cookie_name(port)}={in_query}; Path=/; HttpOnly; SameSite=Strict" if in_query else None
        return Admission(operates=token == self.token, cookie=cookie)

    def query(self, *, watch: bool = False) -> str:
        """Return the query of the page's URL, with the operator's token, or the watcher's if ``watch``."""
        return f"?{_PARAMETER}={self.watch_token if watch else self.token}"

    def _is_ours(self, host: str) -> bool:
        if host == self.host or (host in _LOCAL and self.host in (*_LOCAL, *_ANY)):
            return True
        return self.host in _ANY and _is_address(host)  # a name could be another site's, bound to this machine

    def _known(self, text: str) -> str:
        """Return the one of the two tokens that the text is; empty if it is none."""
        given = text.encode("utf-8", "surrogateescape")
        matches = [token for token in (self.token, self.watch_token) if secrets.compare_digest(given, token.encode())]
        return matches[0] if matches else ""


def _in_query(path: str) -> str:
    try:
        return parse_qs(urlsplit(path).query).get(_PARAMETER, [""])[0]
    except ValueError:  # an invalid path, such as //[
        return ""


def _in_cookie(header: str, name: str) -> str:
    try:
        found = http.cookies.SimpleCookie(header).get(name)
    except http.cookies.CookieError:
        return ""
    return "" if found is None else found.value


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

    The file is made if it is missing, and replaced, with a new token, if other users can read it or its token is
    invalid. Else the token stays the same, so that an open page continues with the next view at its address.

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
    """Return the token of the file; empty if there is no valid one, or if others could read or replace it."""
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
