"""The recording thread: writes messages to a take, and commits them to the disk about twelve times a second.

Only this thread writes to the take, so neither the tracker nor the bus waits for a disk. A frame is acknowledged to its
node only after the commit that holds it (`mocapella.live.record_path`).
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import islice
from typing import Any, Final, NamedTuple

from mocapella.errors import MocapellaError, RecordingError, WireError
from mocapella.live.sequence_leaps import LeapGuard
from mocapella.model.session import RecordingHealth, SessionStatus
from mocapella.recording.ledger import NodeLedger
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import decode_frame, decode_truth
from mocapella.supervision import Boundary
from mocapella.wire.delivery import MOST_GAPS
from mocapella.wire.keys import NodeKey

COMMIT_EVERY_S: Final = 0.08
"""Longest time from a frame's arrival to the write that makes it durable [s]."""
_QUEUE_BYTES: Final = 512 * 1024 * 1024
_CROWDED_BYTES: Final = 64 * 1024 * 1024
_CROWDED_OUT: Final = f"the disk is too slow: {_QUEUE_BYTES >> 20} MiB wait for it"


class NodeState(NamedTuple):
    """State of a node's frames at the last commit.

    Attributes:
        agreed: whether the number of the take's first frame of this node is known.
        stored: every frame below this number that belongs to the take is on the disk, or lost.
        after: number after the last frame known to exist.
        end: number after the last frame that belongs to the take; None if it is not known yet.
        gaps: (first, last) of the missing frames that the node may still have; at most `MOST_GAPS`.
    """

    agreed: bool
    stored: int
    after: int
    end: int | None
    gaps: tuple[tuple[int, int], ...]

    @property
    def whole(self) -> bool:
        """Whether the end is known and nothing before it is missing."""
        return self.end is not None and self.stored >= self.end


class WantedFrames:
    """The frames that one request to a node asks for, and the progress of its answer; used by the recorder's thread.

    Args:
        ranges: first and last sequence number of each range of frames, ascending.
    """

    def __init__(self, ranges: Sequence[tuple[int, int]]) -> None:
        self.ranges = tuple(ranges)
        self._last = -1

    def take(self, sequence: int) -> None:
        """Check that a frame that the node has sent was requested, and note that it has arrived.

        Args:
            sequence: sequence number of the frame.

        Raises:
            WireError: the number is in none of ``ranges``.
        """
        if not any(first <= sequence <= last for first, last in self.ranges):
            raise WireError(f"sequence {sequence} was not asked for")
        self._last = max(self._last, sequence)

    def unreadable(self) -> int | None:
        """Return the sequence number of a frame that the node has sent and that cannot be decoded; note its arrival.

        Nodes send the requested frames in ascending order, so it is the next requested number; None if none is left.
        """
        number = next((max(first, self._last + 1) for first, last in self.ranges if self._last < last), None)
        self._last = self._last if number is None else number
        return number


class _Counts(NamedTuple):
    """Committed and missing frames by sensor, and the file size; written on the recorder's thread, read on any."""

    frames: dict[str, int]
    gaps: dict[str, int]
    size_bytes: int


class Recorder:
    """Records one take on a thread of its own, which the constructor starts.

    The recorder receives every frame as it arrives, again from the tracker with its scene, and missing frames on
    request. Messages are queued, and the methods return at once. When the recording has stopped by itself (`failed`),
    they are dropped. If one entry cannot be written, the recording goes on without it; it is counted and reported.
    While 512 MiB wait for the disk, frames are dropped, which are requested again later; scenes and ground truths are
    dropped for good, which is reported once.

    Args:
        writer: writer of the take; the recorder closes it.
        say: receives messages for the user, for example about a full disk; called on any thread.
        first: sequence number of each node's first frame that belongs to the take; earlier ones are not written.
        committed: called on the recorder's thread after each commit.

    Attributes:
        states: state of each node's frames at the last commit.
        committed: see above; may be replaced.
    """

    def __init__(
        self,
        writer: TakeWriter,
        say: Callable[[str], None],
        first: Mapping[NodeKey, int] | None = None,
        committed: Callable[[], None] = lambda: None,
    ) -> None:
        self._writer = writer
        self._first = dict(first or {})
        self._leaps = LeapGuard()
        self._say = say
        self.committed = committed
        self._queue: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._waiting_bytes = 0
        self._began = time.monotonic()
        self._problem = ""
        self._refused: set[tuple[str, str]] = set()
        self._unwritten = 0
        self._errors = Boundary(lambda text: say(f"an entry is not in the take: {text}"))
        self._closing = self._ended = self._interrupted = False
        self._health = _Counts({}, {}, 0)
        self.states: dict[NodeKey, NodeState] = {}
        self._publish_states()
        self._thread = threading.Thread(target=self._run, name="recorder")
        self._thread.start()

    @property
    def take_id(self) -> str:
        """Identity of the take."""
        return self._writer.take_id

    @property
    def failed(self) -> bool:
        """Whether the recording has stopped by itself."""
        return bool(self._problem)

    @property
    def crowded(self) -> bool:
        """Whether more than 64 MiB wait for the disk, so that no missing frames should be requested."""
        return self._waiting_bytes > _CROWDED_BYTES

    def frame(self, node: NodeKey, data: bytes, arrived_ns: int, sequence: int | None = None) -> None:
        """Write a frame; repeated frames are stored once.

        Args:
            node: the node that sent it; a frame that names another node is refused, and reported once.
            data: the encoded frame.
            arrived_ns: arrival on the server's monotonic clock [ns].
            sequence: number of the frame, if it was decoded before; None decodes it.
        """
        self._put(len(data), partial(self._write_frame, node, data, arrived_ns, sequence))

    def sent_again(self, wanted: WantedFrames, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        """Write a frame that the node was asked for; arguments as in `frame`.

        ``wanted`` has the frames of the request. A frame with another number is refused; one that cannot be decoded
        counts as lost.
        """
        self._put(len(data), partial(self._write_frame, node, data, arrived_ns, None, wanted))

    def account(self, node: NodeKey, change: Callable[[NodeLedger], bool]) -> None:
        """Change the ledger of a node's frames, also after the recording has stopped by itself.

        ``change`` is called with the ledger on the recorder's thread; it returns whether the take must store it.
        """
        work = partial(self._writer.accounts.change, node, change)
        self._queue.put(partial(self._attempt, "account of a node", work))

    def believes(self, node: NodeKey, after: int) -> bool:
        """Whether it is plausible that a node has sent all frames below ``after``; if not, report it once.

        A number that is too high would make the take count frames as lost that never existed.
        """
        try:
            self._leaps.check(node, after, time.monotonic_ns())
        except WireError as error:
            self._refuse(node.sensor, "numbers", str(error))
            return False
        return True

    def scene(self, data: bytes, at_ns: int) -> None:
        """Write an encoded scene; ``at_ns`` is its log time on the server's monotonic clock [ns]."""
        if not self._put(len(data), partial(self._writer.write_scene, data, at_ns)):
            self._refuse("the session", "scenes", _CROWDED_OUT)

    def truth(self, sensor: str, data: bytes, arrived_ns: int) -> None:
        """Write a simulation's encoded ground truth; refuse, and report once, one that cannot be decoded.

        ``arrived_ns`` is its arrival on the server's monotonic clock [ns].
        """
        if not self._put(len(data), partial(self._write_truth, sensor, data, arrived_ns)):
            self._refuse(sensor, "ground truths", _CROWDED_OUT)

    def status(self, status: SessionStatus, at_ns: int) -> None:
        """Write the session's status into the take, with its time on the server's clock [ns]."""
        self._put(0, partial(self._writer.write_status, status, at_ns))

    def clock(self, probes: Mapping[str, Any], at_ns: int) -> None:
        """Write raw clock probes at ``at_ns`` on the server's clock [ns], to estimate the clock offset again."""
        self._put(0, partial(self._writer.write_clock, probes, at_ns))

    def run(self, info: TakeInfo) -> None:
        """Write the beginning of a run: ``info`` has the setup and settings of the new tracker."""
        self._put(0, partial(self._writer.start_run, info))

    def command(self, verb: str, arguments: Mapping[str, Any], at_ns: int, before_step: int, by: str = "") -> None:
        """Write a command that changed the session.

        Args:
            verb: name of the command.
            arguments: its arguments, by name.
            at_ns: time of the command, on the server's monotonic clock [ns].
            before_step: number of the first scene that the tracker makes after the command.
            by: sender of the command; empty if unknown.
        """
        command = {"verb": verb, "arguments": dict(arguments)} | ({"by": by} if by else {})
        self._put(0, partial(self._writer.write_command, command, at_ns, before_step=before_step))

    def health(self) -> RecordingHealth:
        """Return the state at the last commit, or the result once the take has ended."""
        writer, counts = self._writer, self._health
        report = writer.report
        over = report is not None or bool(self._problem)
        frames, lost = (writer.accounts.frames, writer.accounts.lost) if over else (counts.frames, counts.gaps)
        return RecordingHealth(
            active=not over,
            path=str(writer.path),
            frames=sum(frames.values()),
            scenes=writer.scenes,
            lost=sum(lost.values()),
            size_bytes=counts.size_bytes if report is None else report.size_bytes,
            seconds=round(time.monotonic() - self._began, 2) if report is None else round(report.seconds, 2),
            problem=self._problem or (report.problem if report is not None else ""),
            unknown=writer.accounts.unknown if self._ended else (),
            unwritten=self._unwritten,
        )

    def stored_and_lost(self) -> tuple[dict[str, int], dict[str, int]]:
        """Return by sensor the number of committed frames, and of frames known to be missing."""
        return self._health.frames, self._health.gaps

    def close(self, *, interrupted: bool = False) -> RecordingHealth:
        """Write all waiting messages, finish the take, and return its result; a failure is its ``problem``.

        With ``interrupted``, `TakeWriter.resume_or_create` can continue the take.
        """
        self._interrupted = interrupted
        self._queue.put(None)
        self._thread.join()
        return self.health()

    def _put(self, size: int, write: Callable[[], None]) -> bool:
        """Queue an entry; return False if there is no room. There always is for size 0: such entries come only once."""
        if self._problem:  # which has been said
            return True
        if size and self._waiting_bytes + size > _QUEUE_BYTES:
            return False
        self._waiting_bytes += size
        self._queue.put(partial(self._take_out, size, write))
        return True

    def _take_out(self, size: int, write: Callable[[], None]) -> None:
        self._waiting_bytes -= size
        if not self._problem and self._attempt("entry of the take", write):
            self._unwritten += 1

    def _attempt(self, what: str, work: Callable[[], object]) -> str:
        """Call ``work``; return the description of an unexpected error, after which the recording goes on.

        Raises:
            RecordingError: the recording has stopped.
        """
        stopped: list[RecordingError] = []

        def attempt() -> None:
            try:
                work()
            except RecordingError as error:
                stopped.append(error)

        problem = self._errors.run(what, attempt)
        if stopped:
            raise stopped[0]
        return problem

    def _run(self) -> None:
        try:
            self._write_until_end()
            self._closing = True
            if not self._interrupted:
                self._writer.accounts.agree_on_all()
            self._writer.close(interrupted=self._interrupted)
        except MocapellaError as error:
            self._stop(str(error))
            if not self._closing:
                self._account_until_end()
                self._writer.accounts.agree_on_all()
        finally:
            self._ended = True
            if self._writer.report is None:  # an unexpected error, which the thread prints as it ends
                self._stop(f"recording to {self._writer.path} failed (see above); what was committed is safe")
                with suppress(Exception):  # without a proper end, the take is recovered when it is next read
                    self._writer.close(interrupted=True)
            self._publish_states()

    def _stop(self, problem: str) -> None:
        self._problem = problem
        self._say(f"RECORDING STOPPED: {problem}")

    def _write_until_end(self) -> None:
        commit_at = time.monotonic() + COMMIT_EVERY_S
        while True:
            try:
                work = self._queue.get(timeout=max(0.001, commit_at - time.monotonic()))
                if work is None:
                    return
                work()
            except queue.Empty:
                pass
            if time.monotonic() >= commit_at:
                self._commit()
                commit_at = time.monotonic() + COMMIT_EVERY_S

    def _commit(self) -> None:
        self._writer.flush()
        self._health = _Counts(self._writer.accounts.frames, self._writer.accounts.gaps, self._writer.size_bytes)
        self._publish_states()
        self.committed()

    def _account_until_end(self) -> None:
        """After a failure, go on with the ledgers, so that all lost frames are counted."""
        self._publish_states()
        while (work := self._queue.get()) is not None:
            work()
            self._publish_states()

    def _publish_states(self) -> None:
        self.states = {NodeKey(*node): state_of(ledger) for node, ledger in self._writer.accounts.nodes.items()}

    def _write_frame(
        self,
        node: NodeKey,
        data: bytes,
        arrived_ns: int,
        sequence: int | None,
        wanted: WantedFrames | None = None,
    ) -> None:
        try:
            if sequence is None:
                frame = decode_frame(data)
                if frame.key[:2] != node:
                    raise WireError(f"it names another node: {frame.sensor}/{frame.node_id:016x}")
                sequence = frame.sequence
            if wanted is None:
                self._leaps.check(node, sequence, arrived_ns)
            else:
                wanted.take(sequence)
        except WireError as error:
            self._refuse(node.sensor, "frames", str(error))
            if sequence is None and wanted is not None:
                self._give_up(node, wanted.unreadable())
            return
        if sequence < self._first.get(node, 0):  # from before the take began
            return
        if wanted is None:
            self._include(node, sequence)
        write = partial(
            self._writer.write_frame,
            data, sensor=node.sensor, node_id=node.node_id, sequence=sequence, log_ns=arrived_ns,
        )  # fmt: skip
        if self._attempt("frame of the take", write):
            self._unwritten += 1
            self._give_up(node, sequence)

    def _give_up(self, node: NodeKey, sequence: int | None) -> None:
        """Count a frame as lost that cannot be stored, so that it is not requested for ever."""
        if sequence is not None:
            self._writer.accounts.change(node, lambda ledger: ledger.give_up(sequence))

    def _include(self, node: NodeKey, sequence: int) -> None:
        """Let the node's part of the take begin with this frame, if it was on its way when the take began.

        The node sent it before the take began, and does not count it; but scenes may be made of it, and need it.
        """
        ledger = self._writer.accounts.nodes.get(node)
        if ledger is not None and ledger.agreed and sequence < ledger.first:
            self._writer.accounts.change(node, lambda known: known.expect(sequence))

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


def state_of(ledger: NodeLedger) -> NodeState:
    """Return the state of a node's frames; call it after a commit."""
    gaps = tuple(islice(ledger.obtainable(ledger.after), MOST_GAPS))
    return NodeState(ledger.agreed, ledger.acknowledged, ledger.after, ledger.end, gaps)
