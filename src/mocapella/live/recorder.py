"""The recording thread: writes messages to a take and flushes them several times a second.

Only this thread writes to the take, so neither the tracker nor the bus waits for a disk.
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
from mocapella.live.sequence_leaps import LeapGuard
from mocapella.model.session import RecordingHealth, SessionStatus
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import decode_frame, decode_truth
from mocapella.wire.keys import NodeKey

FLUSH_EVERY_S = 0.25
_QUEUE_BYTES = 512 * 1024 * 1024


def begin_take(path: Path, info: TakeInfo, *, reserve_bytes: int, resume: bool = False) -> tuple[TakeWriter, float]:
    """Return a writer for ``path``, and how far back to fetch frames [s] if an interrupted take goes on; else 0.

    Raises:
        TakeExistsError, DiskFullError, RecordingError: before anything is created.
    """
    cut_off = resume and path.exists()
    history_s = time.time() - path.stat().st_mtime + 5.0 if cut_off else 0.0
    create = TakeWriter.resume_or_create if resume else TakeWriter.create
    return create(path, info=info, reserve_bytes=reserve_bytes), history_s


class _Counts(NamedTuple):
    """Flushed and lost frames by sensor, and the file size; written on the recorder's thread, read on any."""

    frames: dict[str, int]
    lost: dict[str, int]
    size_bytes: int


class _Newest(NamedTuple):
    """A node's frame with the highest sequence number; ``sent_s`` is on the node's clock, ``arrived_s`` on ours."""

    sequence: int
    sent_s: float
    arrived_s: float


class Recorder:
    """Records one take on a thread of its own.

    It receives every tracked frame from the tracker, and all frames again by the record path, including those that
    were not tracked because the tracker fell behind or the live path dropped them.

    ``say`` is called with a message for the user, for example about a full disk. ``first`` has the sequence number of
    each node's first frame that belongs to the take.

    Attributes:
        missing: number of frames known to be missing from the take now.
        gaps: for each detected gap, a time [s] after which its frames were sent. The reader removes them.
        newcomers: the same for nodes whose first recorded frame has a sequence number above 0: earlier ones may exist.
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
        self._leaps = LeapGuard()
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
        """Write a frame; repeated frames are stored once."""
        if not self._put(len(data), partial(self._write_frame, node, data, arrived_ns)):
            self._overrun += 1

    def scene(self, data: bytes, at_ns: int) -> None:
        """Write a scene."""
        self._put(len(data), partial(self._writer.write_scene, data, at_ns))

    def truth(self, sensor: str, data: bytes, arrived_ns: int) -> None:
        """Write a simulation's ground truth."""
        self._put(len(data), partial(self._write_truth, sensor, data, arrived_ns))

    def status(self, status: SessionStatus, at_ns: int) -> None:
        """Write the session's status."""
        self._put(0, partial(self._writer.write_status, status, at_ns))

    def clock(self, probes: Mapping[str, Any], at_ns: int) -> None:
        """Write raw clock probes, so that the clock offset can be estimated again."""
        self._put(0, partial(self._writer.write_clock, probes, at_ns))

    def run(self, info: TakeInfo) -> None:
        """Begin the run of a new tracker."""
        self._put(0, partial(self._writer.start_run, info))

    def command(self, verb: str, arguments: Mapping[str, Any], at_ns: int, before_step: int, by: str = "") -> None:
        """Write a command that changed the session before a step, and who sent it, if that is known."""
        command = {"verb": verb, "arguments": dict(arguments)} | ({"by": by} if by else {})
        self._put(0, partial(self._writer.write_command, command, at_ns, before_step=before_step))

    def health(self) -> RecordingHealth:
        """Return the state at the last flush, or the result once the take has ended."""
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
        """Return by sensor the number of flushed frames, and of frames known to be missing."""
        return self._health.frames, self._health.lost

    def wait_for(self, missing: int, timeout: float) -> bool:
        """Wait until all messages are written and at most ``missing`` frames are missing; return False at timeout."""
        deadline = time.monotonic() + timeout
        written = threading.Event()
        self._queue.put(written.set)
        while time.monotonic() < deadline and self._thread.is_alive():
            if written.is_set() and self.missing <= missing:
                return True
            time.sleep(0.02)
        return False

    def close(self) -> RecordingHealth:
        """Write all waiting messages, finish the take, and return its result."""
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
            self._write_until_end()
            self._writer.close()
        except MocapellaError as error:
            self._stop(str(error))
        finally:
            if self._writer.report is None:  # an unexpected error, which the thread prints as it ends
                self._stop(f"recording to {self._writer.path} failed (see above); what was flushed is safe")

    def _stop(self, problem: str) -> None:
        self._problem = problem
        self._say(f"RECORDING STOPPED: {problem}")

    def _write_until_end(self) -> None:
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
                raise WireError(f"it names another node: {frame.sensor}/{frame.node_id:016x}")
            self._leaps.check(node, frame.sequence, arrived_ns)
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
        before, self.missing = self.missing, sum(self._writer.lost.values())  # missing before this newest frame
        if self.missing > before:
            self.gaps.append(self._gap_since(newest, self._newest.get(node)))
        self._newest[node] = max(newest, self._newest.get(node, newest))

    def _gap_since(self, after: _Newest, before: _Newest | None) -> float:
        """Return when the frame before a gap was sent, on our clock; not just its arrival, which may have been late."""
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
