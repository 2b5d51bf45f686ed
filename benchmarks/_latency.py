"""A reader that measures latencies, as one process: python -m benchmarks._latency ADDRESS FILE.

At its end (SIGTERM) it writes the file: an array (scenes, 2) of the arrival on the monotonic clock, and the time since
the frame's capture [ns].
"""

from __future__ import annotations

import sys
import time

import numpy as np
import zenoh

from mocapella.live.signals import stop_on_signals
from mocapella.schema import decode_scene
from mocapella.wire import keys
from mocapella.wire.session import open_reader

PATIENCE_S = 60.0


def main() -> None:
    address, file = sys.argv[1:]
    found: list[tuple[int, int]] = []

    def take(sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        found.append((now_ns, now_ns - decode_scene(sample.payload.to_bytes()).at_ns))

    with stop_on_signals() as stop:
        session = open_reader(address, timeout=PATIENCE_S)
        subscriber = session.declare_subscriber(keys.SCENE, take)
        stop.wait()
        subscriber.undeclare()  # type: ignore[no-untyped-call]
        session.close()  # type: ignore[no-untyped-call]
    np.save(file, np.array(found, np.int64).reshape(-1, 2))


if __name__ == "__main__":
    main()
