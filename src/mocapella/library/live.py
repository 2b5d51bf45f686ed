"""Results of a running server, one by one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Final

from mocapella.model.scene import Scene
from mocapella.wire.reader import Newest
from mocapella.wire.session import DEFAULT_ADDRESS, open_reader

POLL_S: Final = 0.002
"""Time between two looks for a new result [s]."""


def connect(address: str = DEFAULT_ADDRESS, *, seconds: float | None = None) -> Iterator[Scene]:
    """Yield the newest result of a running server whenever there is a new one; a slow loop skips results.

    for scene in mocapella.connect():
        print([person.id for person in scene.people])

    Args:
        address: [SESSION@]tls/HOST:PORT of the server, or a file of `mocapella session invite`.
        seconds: time after which the results end; None for no end [s].

    Raises:
        NoServerError: no server answers; when the first result is asked for.
        BusError, KeyFileError, NotAdmittedError, SettingsError: as in `mocapella.wire.session.open_reader`.
    """
    session = open_reader(address)
    try:
        newest = Newest(session)
        end = None if seconds is None else time.monotonic() + seconds
        while end is None or time.monotonic() < end:
            scene = newest.scene()
            if scene is None:
                time.sleep(POLL_S)
            else:
                yield scene
    finally:
        session.close()  # type: ignore[no-untyped-call]
