"""Compare the clocks of the nodes with the server's, on a thread that may wait for their answers.

Offsets are estimated by Cristian's algorithm, from the times of question, reading and answer (`mocapella.wire.clock`).
They serve latencies and notices; capture times are converted by arrival times (`mocapella.wire.clock.SensorClock`).
"""

from __future__ import annotations

import threading
import time
from dataclasses import asdict
from functools import partial

from mocapella.errors import WireError
from mocapella.live.recording_service import RecordingService
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.supervision import Boundary
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import ServerLink

PROBE_EVERY_S = 1.0
_ANSWER_S = 1.0
"""Longest time for the answers of a node [s]."""


class ClockWatch:
    """Probes the clocks of all connected nodes, one after the other, once a second (`PROBE_EVERY_S`).

    Args:
        link: sends the probes to the nodes.
        registry: receives the offsets; used under ``lock``.
        lock: lock of the registry.
        recording: stores the raw probes.
        errors: catches unexpected errors.
    """

    def __init__(
        self,
        link: ServerLink,
        registry: SensorRegistry,
        lock: threading.RLock,
        recording: RecordingService,
        errors: Boundary,
    ) -> None:
        self._link, self._registry, self._lock, self._recording, self._errors = link, registry, lock, recording, errors

    def run(self, ended: threading.Event) -> None:
        """Probe all clocks every `PROBE_EVERY_S`, until ``ended`` is set. Without answers, error bounds grow."""
        while not ended.wait(PROBE_EVERY_S):
            with self._lock:
                nodes = self._registry.nodes()
            for node in nodes:
                if not ended.is_set():
                    self._errors.run("clock probe", partial(self._compare, node))

    def _compare(self, node: NodeKey) -> None:
        try:
            probes = self._link.probe_clock(node, timeout=_ANSWER_S)
        except WireError as error:
            with self._lock:
                self._registry.rejected(node, str(error))
            return
        now_ns = time.monotonic_ns()
        with self._lock:
            estimate = self._registry.compare_clock(node, probes, now_ns)
        recorder = self._recording.recorder
        if recorder is not None and estimate is not None:
            times = [[p.sent_ns, p.far_ns, p.received_ns] for p in probes]
            row = {"sensor": node.sensor, "node_id": node.node_id, "probes": times, "estimate": asdict(estimate)}
            recorder.clock(row, now_ns)
