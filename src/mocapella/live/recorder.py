"""The recording thread: takes messages in, writes them, and makes them safe several times a second.

It is the only place that touches a take, so neither the tracker nor the bus waits for a disk.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from mocapella.errors import MocapellaError, WireError
from mocapella.model.session import RecordingHealth, SessionStatus
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import decode_frame, decode_truth
from mocapella.wire.keys import NodeKey

FLUSH_EVERY_S = 0.25
_QUEUE_BYTES = 512 * 1024 * 1024


def begin_take(path: Path, info: TakeInfo, *, reserve_bytes: int, resume: bool = False) -> tuple[TakeWriter, float]:
    """A writer for ``path``, and how many seconds ago the last was written of a take that was cut off, and some more.

    Raises:
        TakeExistsError, DiskFullError, RecordingError: before anything is created.
    """
    cut_off = resume and path.exists()
    history_s = time.time() - path.stat().st_mtime + 5.0 if cut_off else 0.0
    create = TakeWriter.resume_or_create if resume else TakeWriter.create
    return create(path, info=info, reserve_bytes=reserve_bytes), history_s


class _Counts(NamedTuple):
    """What is safe on the disk, by sensor; made on the recorder's thread, read on any."""

    frames: dict[str, int]
    lost: dict[str, int]
    size_bytes: int


class _Newest(NamedTuple):
    """Of a node's frames the one with the highest number; ``sent_s`` is on the node's clock, the other on ours."""

    sequence: int
    sent_s: float
    arrived_s: float


class Recorder:
    """One take being recorded, on a thread of its own.

    Every frame that is tracked comes to it from the tracker, and once more by the record path, with those that were
    not tracked because the tracker fell behind or the live path dropped them.

    ``say`` is called with a sentence when something happens that a person must know, such as a full disk. ``first`` has
    for a node the number of its first frame that belongs to the take.

    Attributes:
        missing: how many frames are known to be missing from the take now.
        gaps: a time [s] for each gap that was found: its frames were sent after it. Whoever reads them takes them out.
        newcomers: the same of nodes whose first frame here is not their first: there may be frames before it.
    """

    def __init__(
        self,
        writer: TakeWriter,
        say: Callable[[str], None],
        history_s: float = 0.0,
        first: Mapping[NodeKey, int] | None = None,
    ) -> None:
        self._writer = writer
        self._first = dict(first or {})
        self._say = say
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._waiting_bytes = 0
        self._overrun = 0
        self._began = time.monotonic()
        self._problem = ""
        self._newest: dict[NodeKey, _Newest] = {}
        self._not_before = self._began - history_s
        self.gaps: deque[float] = deque()
        self.newcomers: deque[float] = deque()
        self._refused: set[tuple[str, str]] = set()
        self.missing = 0
        self._health = _Counts({}, {}, 0)
        self._thread = threading.Thread(target=self._run, name="recorder")
        self._thread.start()

    def frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """A frame; it may come several times."""
        if not self._put(len(data), partial(self._write_frame, node, data, arrived_ns)):
            self._overrun += 1

    def scene(self, data: bytes, at_ns: int) -> None:
        """A result."""
        self._put(len(data), partial(self._writer.write_scene, data, at_ns))

    def truth(self, sensor: str, data: bytes, arrived_ns: int) -> None:
        """What a simulation knows."""
        self._put(len(data), partial(self._write_truth, sensor, data, arrived_ns))

    def status(self, status: SessionStatus, at_ns: int) -> None:
        """The session's status."""
        self._put(0, partial(self._writer.write_status, status, at_ns))

    def clock(self, probes: Mapping[str, Any], at_ns: int) -> None:
        """Raw clock probes, so that the estimate can be made again."""
        self._put(0, partial(self._writer.write_clock, probes, at_ns))

    def run(self, info: TakeInfo) -> None:
        """A new tracker begins."""
        self._put(0, partial(self._writer.start_run, info))

    def command(self, verb: str, arguments: Mapping[str, Any], at_ns: int, before_step: int) -> None:
        """A command that changed the session, and before which step."""
        command = {"verb": verb, "arguments": dict(arguments)}
        self._put(0, partial(self._writer.write_command, command, at_ns, before_step=before_step))

    def health(self) -> RecordingHealth:
        """How it goes, as of the last flush; how it ended, once it has."""
        health, report = self._health, self._writer.report
        if report is not None:
            frames, lost, size = report.frames, report.lost, report.size_bytes
        else:
            frames, lost, size = health.frames, health.lost, health.size_bytes
        return RecordingHealth(
            active=report is None and not self._problem,
            path=str(self._writer.path),
            frames=sum(frames.values()),
            scenes=self._writer.scenes,
            lost=sum(lost.values()) + self._overrun,
            size_bytes=size,
            seconds=round(time.monotonic() - self._began, 2) if report is None else round(report.seconds, 2),
            problem=self._problem or (report.problem if report is not None else ""),
        )

    def stored_and_lost(self) -> tuple[dict[str, int], dict[str, int]]:
        """Frames by sensor: in the take and safe; known to be missing."""
        return self._health.frames, self._health.lost

    def wait_for(self, missing: int, timeout: float) -> bool:
        """Until all that was handed over is written, and the take misses no more; False when the time is over."""
        deadline = time.monotonic() + timeout
        written = threading.Event()
        self._queue.put(written.set)
        while time.monotonic() < deadline and self._thread.is_alive():
            if written.is_set() and self.missing <= missing:
                return True
            time.sleep(0.02)
        return False

    def close(self) -> RecordingHealth:
        """Write what is waiting, end the take properly, and say how it ended."""
        self._queue.put(None)
        self._thread.join()
        return self.health()

    def _put(self, size: int, write: Callable[[], None]) -> bool:
        if self._problem or self._waiting_bytes + size > _QUEUE_BYTES:
            return False
        self._waiting_bytes += size
        self._queue.put(partial(self._take_out, size, write))
        return True

    def _take_out(self, size: int, write: Callable[[], None]) -> None:
        self._waiting_bytes -= size
        write()

    def _run(self) -> None:
        try:
            self._write_until_told()
            self._writer.close()
        except MocapellaError as error:
            self._stop(str(error))
        finally:
            if self._writer.report is None:  # of an error that nobody foresaw, which the thread prints as it ends
                self._stop(f"recording to {self._writer.path} failed (see above); what was flushed is safe")

    def _stop(self, problem: str) -> None:
        self._problem = problem
        self._say(f"RECORDING STOPPED: {problem}")

    def _write_until_told(self) -> None:
        flush_at = time.monotonic() + FLUSH_EVERY_S
        while True:
            try:
                write = self._queue.get(timeout=max(0.001, flush_at - time.monotonic()))
                if write is None:
                    return
                write()
            except queue.Empty:
                pass
            if time.monotonic() >= flush_at:
                self._writer.flush()
                self._health = _Counts(self._writer.frames, self._writer.lost, self._writer.size_bytes)
                flush_at = time.monotonic() + FLUSH_EVERY_S

    def _write_frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        try:
            frame = decode_frame(data)
            if frame.key[:2] != node:
                raise WireError(f"it says that it is of {frame.sensor}/{frame.node_id:016x}, another node")
        except WireError as error:
            self._refuse(node.sensor, "frames", str(error))
            return
        if frame.sequence < self._first.get(node, 0):  # from before the take began
            return
        if node not in self._newest and frame.sequence > self._first.get(node, 0):
            self.newcomers.append(self._not_before)
        self._writer.write_frame(
            data, sensor=node.sensor, node_id=node.node_id, sequence=frame.sequence, log_ns=arrived_ns
        )
        newest = _Newest(frame.sequence, frame.sent_ns / 1e9, arrived_ns / 1e9)
        before, self.missing = self.missing, sum(self._writer.lost.values())  # before the newest, which is waited for
        if self.missing > before:
            self.gaps.append(self._gap_since(newest, self._newest.get(node)))
        self._newest[node] = max(newest, self._newest.get(node, newest))

    def _gap_since(self, after: _Newest, before: _Newest | None) -> float:
        """When the frame before a gap was sent, on our clock; not by its arrival alone, which may have been late."""
        if before is None:
            return self._not_before
        apart_s = max(after.sent_s - before.sent_s, after.arrived_s - before.arrived_s)
        return max(after.arrived_s - apart_s, self._not_before)

    def _refuse(self, sensor: str, what: str, why: str) -> None:
        if (sensor, what) not in self._refused:
            self._refused.add((sensor, what))
            self._say(f"{what} of {sensor} are not recorded: {why}")

    def _write_truth(self, sensor: str, data: bytes, arrived_ns: int) -> None:
        try:
            decode_truth(data)
        except WireError as error:
            self._refuse(sensor, "truths", str(error))
            return
        self._writer.write_truth(data, sensor=sensor, log_ns=arrived_ns)
