"""Access to a server over TLS with certificates on both sides: finds the user's key, and configures zenoh with it."""

from __future__ import annotations

import base64
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mocapella.decoding import decode_text, read_whole
from mocapella.errors import InputError, KeyFileError
from mocapella.wire.address import Address, parse_address
from mocapella.wire.certificates import SERVER
from mocapella.wire.key_folder import MOST_KEY_BYTES, key_folder, read_private, write_private
from mocapella.wire.role_key import RoleKey, is_code, read_code, write_code
from mocapella.wire.roles import READERS, SENSOR, access_control, sensor_of
from mocapella.wire.session_key import SessionKey, session_file, session_key, session_name

_NAME_A_FILE = "name a file of `mocapella session invite`"
_MARKS_OF_ADDRESS = ("tls/", "tcp/")


class KeyedAddress(NamedTuple):
    """The address of a server, and the TLS key with which it admits this program.

    Attributes:
        locator: address as zenoh takes it, ``tls/HOST:PORT``.
        key: the key, whose user determines what the program may do.
        origin: path of the key's file, or ``the pairing code``; for messages.
    """

    locator: str
    key: RoleKey
    origin: str


def find_door(connect: str, users: Sequence[str]) -> KeyedAddress:
    """Return the address of a server with the key for it; make a missing session key if it is on this machine.

    Args:
        connect: ``[SESSION@]tls/HOST:PORT``, a pairing code, or a file with one.
        users: names of the users (`mocapella.wire.roles`) whose key may be used, the preferred one first.

    Raises:
        BusError: the text is no address.
        KeyFileError: there is no key for it, or none of ``users``; says how to get one.
        SettingsError: ``SESSION`` is no name of a session.
    """
    if is_code(connect):
        return _opened(read_code(connect), "the pairing code", users)
    if not connect.rpartition("@")[2].startswith(_MARKS_OF_ADDRESS) and Path(connect).is_file():
        return _opened(read_key_file(Path(connect)), connect, users)
    address = parse_address(connect)
    for user in () if address.session else users:
        path = _paired_file(address, user)
        text = read_private(path)
        if text is not None:
            return KeyedAddress(address.locator, read_code(text, str(path)), str(path))
    return _own_door(address, users)


def node_users(sensor: str) -> tuple[str, str]:
    """Return the users that may serve the sensor NAME: ``sensor.NAME``, then ``sensor``."""
    return f"{SENSOR}.{sensor}", SENSOR


def keep_paired(key: RoleKey) -> Path:
    """Write a key from a pairing code to the folder of keys, for later use at its server's address; return the file.

    Raises:
        KeyFileError: the file cannot be written.
    """
    path = _paired_file(parse_address(key.address), key.user)
    write_private(path, write_code(key) + "\n")
    return path


def read_key_file(path: Path) -> RoleKey:
    """Read the key in a file of `mocapella session invite`; it may be readable to others, as a copied file often is.

    Raises:
        KeyFileError: it cannot be read, or is no key.
    """
    try:
        text = decode_text(read_whole(path, fix=_NAME_A_FILE, most_bytes=MOST_KEY_BYTES), file=path, fix=_NAME_A_FILE)
    except InputError as error:
        raise KeyFileError(str(error)) from None
    return read_code(text, str(path))


def client_tls(key: RoleKey) -> dict[str, Any]:
    """Return zenoh's configuration ``transport/link/tls`` of a node or reader with this key."""
    return {
        "root_ca_certificate_base64": _pem(key.authority, "CERTIFICATE"),
        "verify_name_on_connect": False,
        "enable_mtls": True,
        "connect_certificate_base64": _pem(key.own.certificate, "CERTIFICATE"),
        "connect_private_key_base64": _pem(key.own.private_key, "PRIVATE KEY"),
    }


def server_tls(key: SessionKey) -> dict[str, Any]:
    """Return zenoh's configuration ``transport/link/tls`` of the session's server."""
    own = key.issued[SERVER]
    return {
        "root_ca_certificate_base64": _pem(key.authority.certificate, "CERTIFICATE"),
        "enable_mtls": True,
        "listen_certificate_base64": _pem(own.certificate, "CERTIFICATE"),
        "listen_private_key_base64": _pem(own.private_key, "PRIVATE KEY"),
    }


def server_access(key: SessionKey) -> dict[str, Any]:
    """Return zenoh's configuration ``access_control`` of the session's server."""
    return access_control(key.sensors)


def _opened(key: RoleKey, origin: str, users: Sequence[str]) -> KeyedAddress:
    if key.user in users:
        return KeyedAddress(parse_address(key.address).locator, key, origin)
    only = sensor_of(key.user)
    wanted = f"serves the sensor {only} only (--name {only})" if only and users[-1] == SENSOR else f"is of a {key.user}"
    role = SENSOR if users[-1] == SENSOR else " or ".join(reversed(READERS))
    raise KeyFileError(f"{origin}: the key {wanted}; for this, invite a {role} (mocapella session invite)")


def _own_door(address: Address, users: Sequence[str]) -> KeyedAddress:
    """Return the address with a key from the session's own key, which this account has or makes."""
    name = session_name(address.session)
    path = session_file(name)
    if not address.local and not path.exists():
        role = users[-1] if users[-1] == SENSOR else users[0]
        raise KeyFileError(
            f"no key for {address.locator}: on its server's machine type `mocapella session invite {role} --at "
            f"{address.bare_host}:{address.port}`, and here `mocapella session join`"
        )
    key = session_key(name)
    user = next(user for user in users if user in key.issued)
    return KeyedAddress(address.locator, key.role_key(user, address.locator), str(path))


def _paired_file(address: Address, user: str) -> Path:
    host = re.sub(r"[^A-Za-z0-9.-]", "_", address.bare_host)
    return key_folder() / f"{host}_{address.port}.{user}.key"


def _pem(der: bytes, what: str) -> str:
    """Return base64 of the PEM text, as zenoh takes a certificate or key within its configuration."""
    body = "\n".join(textwrap.wrap(base64.b64encode(der).decode("ascii"), 64))
    return base64.b64encode(f"-----BEGIN {what}-----\n{body}\n-----END {what}-----\n".encode("ascii")).decode("ascii")
