"""A bad network between two namespaces: python -m benchmarks._bad_link FIRST SECOND; needs root on Linux.

Packets are lost at random, and delayed at random within limits, in their order. A line ``delay_ms jitter_ms loss`` on
standard input changes the limits; the end of the input ends the link. It is perfect at first.
"""

from __future__ import annotations

import fcntl
import os
import random
import selectors
import struct
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress
from typing import Final

ADDRESSES: Final = ("10.99.7.1", "10.99.7.2")
READY: Final = "joined"
_MAKE_INTERFACE: Final = 0x400454CA  # TUNSETIFF of linux/if_tun.h
_LAYER_3_WITHOUT_HEAD: Final = 0x1001  # IFF_TUN | IFF_NO_PI
_LONGEST: Final = 65_536


class End:
    """One end of the link, and the packets on their way to it."""

    def __init__(self, namespace: str, number: int) -> None:
        name = f"badlink{number}"
        self.file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(self.file, _MAKE_INTERFACE, struct.pack("16sH22x", name.encode(), _LAYER_3_WITHOUT_HEAD))
        own, other = ADDRESSES[number], ADDRESSES[1 - number]
        _ip("link", "set", name, "netns", namespace)
        _ip("-n", namespace, "addr", "add", own, "peer", other, "dev", name)
        _ip("-n", namespace, "link", "set", name, "up")
        _ip("-n", namespace, "link", "set", "lo", "up")
        self.coming: deque[tuple[float, bytes]] = deque()

    def packets(self) -> list[bytes]:
        """All that has been sent from here."""
        found = []
        with suppress(BlockingIOError):
            while True:
                found.append(os.read(self.file, _LONGEST))
        return found

    def deliver(self, now_s: float) -> None:
        while self.coming and self.coming[0][0] <= now_s:
            with suppress(OSError):  # a packet that the interface does not take is lost
                os.write(self.file, self.coming.popleft()[1])


def join(first: str, second: str) -> None:
    """Carry packets between two namespaces until the input ends."""
    ends = (End(first, 0), End(second, 1))
    chance = random.Random(7)
    delay_s = jitter_s = loss = 0.0
    selector = selectors.DefaultSelector()
    for end, to in (ends, ends[::-1]):
        selector.register(end.file, selectors.EVENT_READ, (end, to))
    selector.register(sys.stdin, selectors.EVENT_READ, None)
    print(READY, flush=True)
    while True:
        due_s = min((end.coming[0][0] for end in ends if end.coming), default=time.monotonic() + 1)
        for key, _ in selector.select(max(due_s - time.monotonic(), 0)):
            if key.data is None:
                line = sys.stdin.readline()
                if not line:
                    return
                delay_ms, jitter_ms, loss = map(float, line.split())
                delay_s, jitter_s = delay_ms / 1e3, jitter_ms / 1e3
                continue
            end, to = key.data
            for packet in end.packets():
                if chance.random() >= loss:
                    at_s = time.monotonic() + delay_s + chance.uniform(0, jitter_s)
                    to.coming.append((max(at_s, to.coming[-1][0] if to.coming else 0), packet))
        now_s = time.monotonic()
        for end in ends:
            end.deliver(now_s)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


if __name__ == "__main__":
    join(*sys.argv[1:])
