"""A bad network between two namespaces: python -m benchmarks._bad_link FIRST SECOND; needs root on Linux.

Packets are lost at random, delayed at random within limits, in their order, repeated, or overtake others. A line with
the fields of `Limits` on standard input changes them; fields at its end may be left out. The end of the input ends the
link. It is perfect at first; with a loss of 1 it is down, and neither side is told.
"""

from __future__ import annotations

import fcntl
import heapq
import os
import random
import selectors
import struct
import subprocess
import sys
import time
from contextlib import suppress
from typing import Final, NamedTuple

ADDRESSES: Final = ("10.99.7.1", "10.99.7.2")
READY: Final = "joined"
_MAKE_INTERFACE: Final = 0x400454CA  # TUNSETIFF of linux/if_tun.h
_LAYER_3_WITHOUT_HEAD: Final = 0x1001  # IFF_TUN | IFF_NO_PI
_LONGEST: Final = 65_536
WAITING_S: Final = 0.2
"""Packets that would wait longer for a narrow link are lost [s]."""


class Limits(NamedTuple):
    """What happens to packets.

    Attributes:
        delay_ms, jitter_ms: each packet is late by the first and a random part of the second [ms].
        loss, repeated, overtaking: shares of packets that are lost, that come twice, and that overtake earlier ones.
        mbit: largest rate in each direction; further packets wait, up to `WAITING_S` [Mbit/s]. 0 is no limit.
    """

    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    mbit: float = 0.0
    repeated: float = 0.0
    overtaking: float = 0.0


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
        self.coming: list[tuple[float, int, bytes]] = []
        self._count, self._last_s, self._free_s = 0, 0.0, 0.0

    def take(self, packet: bytes, limits: Limits, chance: random.Random) -> None:
        """Put a packet on its way to here, or lose it."""
        now_s = time.monotonic()
        if chance.random() < limits.loss or self._free_s - now_s > WAITING_S:
            return
        if limits.mbit:
            self._free_s = max(self._free_s, now_s) + 8 * len(packet) / (1e6 * limits.mbit)
        at_s = max(now_s, self._free_s) + limits.delay_ms / 1e3
        if chance.random() >= limits.overtaking:
            at_s = self._last_s = max(at_s + chance.uniform(0, limits.jitter_ms / 1e3), self._last_s)
        for _ in range(2 if chance.random() < limits.repeated else 1):
            self._count += 1
            heapq.heappush(self.coming, (at_s, self._count, packet))

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
                os.write(self.file, heapq.heappop(self.coming)[2])


def join(first: str, second: str) -> None:
    """Carry packets between two namespaces until the input ends."""
    ends = (End(first, 0), End(second, 1))
    chance = random.Random(7)
    limits = Limits()
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
                limits = Limits(*map(float, line.split()))
                continue
            end, to = key.data
            for packet in end.packets():
                to.take(packet, limits, chance)
        now_s = time.monotonic()
        for end in ends:
            end.deliver(now_s)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


if __name__ == "__main__":
    join(*sys.argv[1:])
