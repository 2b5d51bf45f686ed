"""A sensor for the benchmark of kills: python -m benchmarks._kill_node …. It logs each acknowledged frame.

A line of the log is ``sent number``, or ``number sent_ns acknowledged_ns``, on the monotonic clock of the machine;
``end number`` at last, and ``said text`` is a message of the node's.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TextIO

import msgspec
import numpy as np

from mocapella.errors import UnstoredFramesError
from mocapella.live.node import Membership
from mocapella.live.node_disk import NodeDisk, open_link
from mocapella.live.signals import stop_on_signals
from mocapella.model.observations import body_frame
from mocapella.model.topology import topology
from mocapella.wire.node import FAREWELL_S, NodeLink

RATE_HZ = 60
POLL_S = 0.002


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("connect", "sensor", "folder"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--frames", type=int, default=0, help="end after so many; 0 for never")
    parser.add_argument("--farewell", type=float, default=FAREWELL_S, help="longest wait for the server at the end [s]")
    options = parser.parse_args()
    folder = Path(options.folder)
    positions = np.random.default_rng(0).normal(size=(1, 25, 3))
    frame = body_frame(options.sensor, topology("kinect_v2"), time_ns=0, positions=positions)
    disk = NodeDisk(folder / "spool", reserve_bytes=0, farewell_s=options.farewell)
    with stop_on_signals() as stop, (folder / f"{time.monotonic_ns()}.log").open("w", buffering=1) as log:
        try:
            with open_link(options.connect, options.sensor, disk) as link:
                print(f"node {link.node.node_id:016x} {options.sensor}", file=log)
                membership = Membership(link, stop, lambda text: print("said", time.monotonic_ns(), text, file=log))
                acknowledgements = Acknowledgements(link, log)
                due = time.monotonic()
                while not stop.wait(POLL_S):
                    if time.monotonic() >= due:
                        due += 1 / RATE_HZ
                        sent = link.publish(msgspec.structs.replace(frame, time_ns=time.monotonic_ns()))
                        acknowledgements.sent(sent.sent_ns)
                    acknowledgements.look()
                    if link.published == options.frames:
                        stop.set()
                membership.close()
        except UnstoredFramesError as error:
            print(f"unstored {error}", file=log)
        print(f"end {link.published}", file=log)


class Acknowledgements:
    """Logs when frames are acknowledged that the node still has; a take's claim also passes frames that are lost."""

    def __init__(self, link: NodeLink, log: TextIO) -> None:
        self._link, self._log = link, log
        self._times: list[int] = []
        self._next: dict[str, int] = {}
        self._oldest = 0

    def sent(self, sent_ns: int) -> None:
        print("sent", len(self._times), file=self._log)
        self._times.append(sent_ns)

    def look(self) -> None:
        for take, hold in self._link.outbox.holds.items():
            now_ns = time.monotonic_ns()
            first = max(self._next.get(take, hold.first), self._oldest)
            for number in range(first, min(hold.stored, len(self._times))):
                print(number, self._times[number], now_ns, file=self._log)
            self._next[take] = max(first, hold.stored)
        self._oldest = self._link.outbox.oldest


if __name__ == "__main__":
    main()
