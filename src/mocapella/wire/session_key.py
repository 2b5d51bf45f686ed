"""A session's key: its certificate authority, and one certificate for each user of the bus (`mocapella.wire.roles`).

It is a private file, made when the first program of this account needs it. Whoever reads the file has all rights.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import InputError, KeyFileError, SettingsError
from mocapella.wire.certificates import SERVER, Certified, issue, make_authority
from mocapella.wire.key_folder import key_folder, read_private, write_private
from mocapella.wire.role_key import RoleKey
from mocapella.wire.roles import SENSOR, check_user, sensor_of, users_of

DEFAULT_SESSION: Final = "default"
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")
MOST_SENSORS: Final = 64
"""Largest number of a session's sensors with keys that serve only that sensor."""


class SessionKey(msgspec.Struct, frozen=True):
    """The key of a session, as it is kept in ``<session>.json``.

    Attributes:
        session: name of the session.
        authority: the certificate authority, which signs the certificates.
        issued: certificate of the server (`SERVER`) and of each user, such as ``sensor.front``, by common name.
        sensors: names of the sensors that have keys of their own.
    """

    session: str
    authority: Certified
    issued: dict[str, Certified]
    sensors: tuple[str, ...] = ()

    def role_key(self, user: str, address: str) -> RoleKey:
        """Return the key that admits a program as ``user``, such as ``reader``, to the server at ``address``.

        Raises:
            SettingsError: there is no such user; ``sensor.NAME`` needs `with_sensor` first.
        """
        if check_user(user) not in self.issued:
            raise SettingsError(f"the session {self.session} has no key of the sensor {sensor_of(user)} alone")
        return RoleKey(self.session, user, address, self.authority.certificate, self.issued[user])

    def with_sensor(self, name: str) -> SessionKey:
        """Issue a certificate that serves the sensor ``name`` only; write the file, and return the new session key.

        If the sensor has one, this key is returned unchanged. A server knows the new one from its next start on.

        Raises:
            KeyFileError: the file cannot be written, or the session has `MOST_SENSORS` such certificates.
            SettingsError: the name is not valid for a sensor, or too long for a certificate.
        """
        user = check_user(f"{SENSOR}.{name}")
        if name in self.sensors:
            return self
        if len(self.sensors) >= MOST_SENSORS:
            raise KeyFileError(
                f"the session {self.session} has {MOST_SENSORS} sensors with keys of their own; "
                "renew it (mocapella session renew) and pair those in use"
            )
        issued = {**self.issued, user: issue(self.authority, user)}
        return _keep(SessionKey(self.session, self.authority, issued, tuple(sorted((*self.sensors, name)))))


def session_name(named: str = "") -> str:
    """Return the name of the session: the given one, else ``MOCAPELLA_SESSION``, else ``default``.

    Raises:
        SettingsError: the name is invalid.
    """
    name = named or os.environ.get("MOCAPELLA_SESSION") or DEFAULT_SESSION
    if not _NAME.fullmatch(name):
        raise SettingsError(
            f"session name {name[:80]!r} cannot be used; take 1 to 40 letters, digits, '_' or '-', such as lab-2"
        )
    return name


def session_file(session: str) -> Path:
    """Return the path of the file with a session's key, which may not exist yet.

    Raises:
        KeyFileError: the user has no home folder.
    """
    return key_folder() / f"{session}.json"


def session_key(session: str) -> SessionKey:
    """Return this account's key of a session; if there is none, make it and write it to `session_file`.

    An existing file is never replaced. The session's name is not checked; `session_name` does that.

    Raises:
        KeyFileError: the file cannot be read or written, is damaged or of another session, belongs to another user, or
            other users can open it.
    """
    path = session_file(session)
    text = read_private(path)
    if text is None:
        new = _new(session)
        if write_private(path, _text(new), replace=False):
            return new
        text = read_private(path) or ""  # another program was faster
    return read_session_key(text, session, path)


def read_session_key(text: str, session: str, path: Path) -> SessionKey:
    """Return the key of a session from the text of its file; ``path`` is named in errors.

    Raises:
        KeyFileError: the text is damaged, incomplete, or of another session.
    """
    try:
        key = decode_json(text, SessionKey)
    except InputError as error:
        raise KeyFileError(f"{path}: is no key of a session; remove it, and pair the nodes again") from error
    if key.session != session or not {SERVER, *users_of(key.sensors)} <= key.issued.keys():
        raise KeyFileError(
            f"{path}: is not the whole key of the session {session}; remove it, and pair the nodes again"
        )
    return key


def renew_session_key(session: str) -> SessionKey:
    """Make a new key for a session, in place of any earlier one in `session_file`.

    A running server keeps its key of the start. From its next start, it refuses every key that was given out
    before, also the keys of single sensors.

    Args:
        session: name of the session, as of `session_name`. A server admits only programs with a key of its session.

    Raises:
        KeyFileError: the new key cannot be written; the earlier one stays.
    """
    return _keep(_new(session))


def _new(session: str) -> SessionKey:
    authority = make_authority(session)
    return SessionKey(session, authority, {name: issue(authority, name) for name in (SERVER, *users_of([]))})


def _keep(key: SessionKey) -> SessionKey:
    write_private(session_file(key.session), _text(key))
    return key


def _text(key: SessionKey) -> str:
    return msgspec.json.encode(key).decode("ascii") + "\n"
