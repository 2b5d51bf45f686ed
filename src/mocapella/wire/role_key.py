"""The key that a node or reader needs to be admitted by a server; as one line of text, it is a *pairing code*."""

from __future__ import annotations

import base64
import hashlib
from typing import Final

import msgspec

from mocapella.decoding import convert, decode_msgpack
from mocapella.errors import BusError, InputError, KeyFileError, SettingsError
from mocapella.wire.address import parse_address
from mocapella.wire.certificates import Certified
from mocapella.wire.roles import check_user

PREFIX: Final = "mocapella-key-"
"""Beginning of every pairing code."""
_MAX_CODE: Final = 8192


class RoleKey(msgspec.Struct, frozen=True, array_like=True):
    """A key that admits a program to a session's server as one user, which has rights (`mocapella.wire.roles`).

    Attributes:
        session: name of the session.
        user: such as ``sensor.front``.
        address: address of the server, ``tls/HOST:PORT``.
        authority: certificate of the session's authority (DER), the only one that is trusted.
        own: the user's certificate and private key.
    """

    session: str
    user: str
    address: str
    authority: bytes
    own: Certified


def fingerprint(authority: bytes) -> str:
    """Return 16 hex digits that name a session's authority, from its certificate (DER)."""
    return hashlib.sha256(authority).hexdigest()[:16]


def is_code(text: str) -> bool:
    """Whether a text begins like a pairing code; the rest is not checked."""
    return text.startswith(PREFIX)


def write_code(key: RoleKey) -> str:
    """Return the pairing code of a key."""
    return PREFIX + base64.urlsafe_b64encode(msgspec.msgpack.encode(key)).decode("ascii").rstrip("=")


def read_code(text: str, where: str = "the pairing code") -> RoleKey:
    """Read a pairing code; ``where`` names its origin in errors.

    Raises:
        KeyFileError: it is no pairing code, or was not copied whole.
    """
    code = text.strip()
    if not is_code(code) or len(code) > _MAX_CODE:
        raise KeyFileError(f"{where}: is no key; a key is one line that begins with {PREFIX}")
    data = code.removeprefix(PREFIX)
    try:
        packed = base64.b64decode(data + "=" * (-len(data) % 4), altchars=b"-_", validate=True)
        key = convert(decode_msgpack(packed), RoleKey, what="key")
        check_user(key.user)
        parse_address(key.address)
    except (ValueError, InputError, SettingsError, BusError) as error:
        raise KeyFileError(f"{where}: is damaged; copy the whole line that `mocapella session invite` wrote") from error
    return key
