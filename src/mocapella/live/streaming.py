"""Send the newest results of a server to another program by UDP."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from mocapella.errors import NoServerError
from mocapella.model.scene import Scene
from mocapella.streams.stream import Encoder

_POLL_S: Final = 0.002


@dataclass(frozen=True)
class StreamSummary:
    """What a stream has sent.

    Attributes:
        scenes: number of scenes that were sent.
        datagrams, sent_bytes: number and size of their datagrams [1, bytes].
        most_people: largest number of people in one of them.
    """

    scenes: int = 0
    datagrams: int = 0
    sent_bytes: int = 0
    most_people: int = 0


def run_stream(
    newest: Callable[[], Scene | None],
    encoder: Encoder,
    send: Callable[[bytes], None],
    stop: threading.Event,
    *,
    seconds: float | None = None,
    silent_s: Callable[[], float] = lambda: 0.0,
    most_silent_s: float = 10.0,
) -> StreamSummary:
    """Send each new scene until ``stop`` is set; a scene that a newer one replaces before it is sent is left out.

    Args:
        newest: returns the newest scene once, None if there is no new one.
        encoder: encodes the scenes.
        send: sends a datagram.
        stop: ends the stream.
        seconds: time after which it ends; None for no end [s].
        silent_s: returns for how long nothing has come from the server [s].
        most_silent_s: longest such time [s].

    Raises:
        NoServerError: nothing has come from the server for ``most_silent_s``.
        SettingsError: the scene cannot be encoded, or the network refuses the receiver.
    """
    scenes = datagrams = sent = most = 0
    end = None if seconds is None else time.monotonic() + seconds
    while not stop.wait(_POLL_S) and (end is None or time.monotonic() < end):
        scene = newest()
        if scene is None:
            if silent_s() > most_silent_s:
                raise NoServerError("nothing comes from the server any more; start it and this command again")
            continue
        scenes, most = scenes + 1, max(most, len(scene.people))
        for data in encoder.datagrams(scene):
            send(data)
            datagrams, sent = datagrams + 1, sent + len(data)
    return StreamSummary(scenes, datagrams, sent, most)
