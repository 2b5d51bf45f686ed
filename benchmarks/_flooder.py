"""What floods, as one process: python -m benchmarks._flooder (slow PORT COUNT | press URL | commands ADDRESS) SECONDS.

It prints its figures as JSON. It has the lowest priority: others feel its requests, not its own work, which could be
done on another machine.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import selectors
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed

from benchmarks._page import Page
from mocapella.errors import BusError
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

BYTE_EVERY_S = 0.5
WAVE_S = 10.0
"""So long after a wave of slow connections the next one follows [s]."""
THREADS = 4


def slow(port: str, count: str, seconds: str) -> dict[str, float]:
    """Open connections that send a request byte by byte, in waves; how long the longest lived [s]."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    longest_s, end_s = 0.0, time.monotonic() + float(seconds)
    while time.monotonic() < end_s:
        began_s = time.monotonic()
        longest_s = max(longest_s, _wave(int(port), int(count)))
        time.sleep(max(0.0, min(began_s + WAVE_S, end_s) - time.monotonic()))
    return {"longest_s": longest_s}


def _wave(port: int, count: int) -> float:
    longest_s = 0.0
    with selectors.DefaultSelector() as selector:
        for _ in range(count):
            connection = socket.create_connection(("127.0.0.1", port), timeout=60)
            connection.setblocking(False)
            selector.register(connection, selectors.EVENT_READ, time.monotonic())
        while selector.get_map():
            for key, _ in selector.select(BYTE_EVERY_S):
                _end(selector, key.fileobj)
                longest_s = max(longest_s, time.monotonic() - key.data)
            for key in list(selector.get_map().values()):
                try:
                    key.fileobj.send(b"G")  # type: ignore[union-attr]
                except BlockingIOError:
                    pass
                except OSError:
                    _end(selector, key.fileobj)
                    longest_s = max(longest_s, time.monotonic() - key.data)
    return longest_s


def _end(selector: selectors.BaseSelector, connection: Any) -> None:
    selector.unregister(connection)
    connection.close()


def press(url: str, seconds: str) -> dict[str, float]:
    """Press Recalibrate without a pause, and come back when cut off, as a page does."""
    presses, cut_off, end_s = 0, 0, time.monotonic() + float(seconds)
    while time.monotonic() < end_s:
        with Page(url) as page, contextlib.suppress(ConnectionClosed, TimeoutError):
            button = page.button("Recalibrate")
            while time.monotonic() < end_s:
                page.press(button)
                presses += 1
        cut_off += page.ended
    return {"presses": presses, "cut_off": cut_off}


def commands(address: str, seconds: str) -> dict[str, float]:
    """Send the command without a pause, from several threads of one client."""
    end_s, replies = time.monotonic() + float(seconds), list[bool]()
    session = open_reader(address)

    def flood() -> None:
        while time.monotonic() < end_s:
            try:
                replies.append(send_command(session, "recalibrate", timeout=5.0).ok)
            except BusError:
                replies.append(False)

    threads = [threading.Thread(target=flood) for _ in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    session.close()  # type: ignore[no-untyped-call]
    return {"commands": len(replies), "refused": replies.count(False)}


def step_back() -> None:
    """Take the lowest priority, also as the group of processes by which Linux may share out the processors."""
    os.nice(19)
    with contextlib.suppress(OSError):  # there are no such groups, or they are another user's
        Path("/proc/self/autogroup").write_text("19", encoding="ascii")


if __name__ == "__main__":
    step_back()
    how = {"slow": slow, "press": press, "commands": commands}[sys.argv[1]]
    print(json.dumps(how(*sys.argv[2:])))
