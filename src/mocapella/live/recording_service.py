"""Start, continue and finish takes: connects the session, the bus and the recorder."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocapella import __version__
from mocapella.errors import NotNowError
from mocapella.live.record_path import ClosedTakes, RecordPath, Requests
from mocapella.live.recorder import Recorder
from mocapella.live.session import Session
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.part_types import PART_TYPES
from mocapella.model.session import RecordingHealth
from mocapella.recording.take import TakeInfo, new_take_id
from mocapella.recording.take_writer import TakeWriter
from mocapella.registry import OURS, Table
from mocapella.tracker import METHODS
from mocapella.wire.keys import NodeKey

FAILED_S = 0.5
"""Longest wait for the last frame numbers of a failed take, before a new one begins [s]; tracking pauses meanwhile."""


def outcome(health: RecordingHealth) -> str:
    """Return how a take ended as one line for users, with the number of missing frames."""
    lost = f"; {health.lost} frames are missing" if health.lost else ""
    lost += f"; {health.unwritten} entries could not be written" if health.unwritten else ""
    unknown = "".join(f"; {end}" for end in health.unknown)
    return (health.problem or f"recorded {health.frames} frames in {health.path}") + lost + unknown


def packages_of(method: str) -> dict[str, str]:
    """Return the packages that a run of a method may use, for the metadata of a take.

    Any sensor may send any type of frame, so all frame types of other packages are included.

    Args:
        method: key of `METHODS`.

    Returns:
        Package and version by type and name of each plug-in, such as ``tracking method heat``; and those of Mocapella.
    """
    used: list[tuple[Table[Any], Iterable[str]]] = [
        (METHODS, (method,)),
        (FRAME_TYPES, FRAME_TYPES),
        (PART_TYPES, METHODS[method].parts),
    ]
    found = {f"{t.what} {n}": p for t, names in used for n, p in t.plugins().items() if n in names}
    return {OURS: f"{OURS} {__version__}", **found}


class RecordingService:
    """Records at most one take at a time, started and finished on any thread.

    Args:
        session: its setup, settings and tracker snapshot are stored at the start of a take.
        link: sends requests for frames to the nodes.
        nodes: returns the connected nodes.
        say: receives messages for the user, such as the result of a take.
        reserve_bytes: free disk space to leave [bytes].
        between_steps: lock that the tracking thread holds during a step, so that a take ends between two steps; None
            if no other thread tracks.
        hurry: while it is set, the end of a take waits for no missing frame and no node, and leaves the take
            interrupted, so that a later process can continue it. None never hurries.

    Attributes:
        recorder: recorder of the present take; None if there is none. Copy the reference before use: another thread may
            end the take at any time.
    """

    def __init__(
        self,
        session: Session,
        link: Requests,
        nodes: Callable[[], Iterable[NodeKey]],
        say: Callable[[str], None],
        *,
        reserve_bytes: int,
        between_steps: AbstractContextManager[object] | None = None,
        hurry: threading.Event | None = None,
    ) -> None:
        self.recorder: Recorder | None = None
        self._session, self._link, self._nodes, self._say = session, link, nodes, say
        self._reserve_bytes = reserve_bytes
        self._hurry = hurry or threading.Event()
        self._between_steps = between_steps or nullcontext()
        self._tracker = session.trackers  # of the present run
        self._health: Callable[[], RecordingHealth] = RecordingHealth
        self._changing = threading.Lock()
        self._record_path: RecordPath | None = None
        self._closed = ClosedTakes(link)

    def health(self) -> RecordingHealth:
        """Return the state of the present take, or the result of the last one; inactive before the first."""
        return self._health()

    def begin(self, path: Path, *, resume: bool = False, newest: Mapping[NodeKey, int] | None = None) -> str:
        """Start a take at ``path``, and return a message; with ``resume``, continue one that exists there.

        ``newest`` has the sequence number of each node's newest tracked frame: a new take begins after it. The take
        begins with a snapshot of the tracker, so that it can be replayed although it begins mid-session. A previous
        take whose recording has failed is finished first.

        Raises:
            NotNowError: a take is being recorded already, or is being ended.
            TakeExistsError, DiskFullError, RecordingError: the take cannot be created; nothing is.
        """
        if not self._changing.acquire(blocking=False):
            raise NotNowError("the previous take is being closed; try again in a moment")
        try:
            return self._begin(path, resume, newest or {})
        finally:
            self._changing.release()

    def _begin(self, path: Path, resume: bool, newest: Mapping[NodeKey, int]) -> str:
        health = self.health()
        if health.active:
            raise NotNowError(
                f"already recording {health.path}; end that first (mocapella record --stop, or in the view)"
            )
        self._end(0.0 if self.recorder is None else FAILED_S)
        memory = self._session.memory()  # before the take exists, in case it cannot be made
        fresh = not (resume and path.exists())
        first = {node: sequence + 1 for node, sequence in newest.items()} if fresh else {}
        create = TakeWriter.resume_or_create if resume else TakeWriter.create
        writer = create(path, info=self._info(), reserve_bytes=self._reserve_bytes)
        self._closed.forget(writer.take_id)
        recorder = Recorder(writer, self._say, first)
        self._tracker = self._session.trackers
        self._command(recorder, "restore", memory)
        if not self._session.running:
            self._command(recorder, "stop", {})
        self._record_path = RecordPath(recorder, self._link, self._nodes, first, fresh=fresh, hurry=self._hurry)
        self.recorder, self._health = recorder, recorder.health
        return f"recording {path}"

    def tell_closed(self) -> None:
        """Tell nodes that were away when a take was closed, and are connected again, of its end; return at once."""
        self._closed.tell(self._nodes())

    @property
    def active(self) -> bool:
        """Whether frames are being recorded now."""
        recorder = self.recorder
        return recorder is not None and not recorder.failed

    def leaving(self, node: NodeKey, end: int) -> None:
        """Note that a node leaves; ``end`` is the sequence number after its last frame."""
        record_path = self._record_path
        if record_path is not None:
            record_path.leaving(node, end)

    def record_command(self, verb: str, arguments: Mapping[str, Any], by: str = "") -> None:
        """Record a command that was carried out, for the replay; without a take, do nothing.

        The replay carries it out before the session's next step. After ``start``, ``setup`` or ``use-rig`` a new run of
        the take begins instead, because they make a new tracker or change the labels. If the tracker goes on, the run
        begins with its snapshot.

        Args:
            verb: name of the command.
            arguments: its arguments by name, of types that msgspec encodes as JSON.
            by: who sent it; empty if unknown.
        """
        recorder = self.recorder
        if recorder is None:
            return
        if verb not in ("start", "setup", "use-rig"):
            self._command(recorder, verb, arguments, by)
            return
        continues = self._session.trackers == self._tracker
        self._tracker = self._session.trackers
        recorder.run(replace(self._info(), continues=continues))
        if continues:
            self._command(recorder, "restore", self._session.memory())
        if not self._session.running:
            self._command(recorder, "stop", {})

    def finish(self) -> RecordingHealth:
        """Finish the take and return its result; missing frames are requested until they arrive or are given up.

        Without a take, the last result is returned.
        """
        with self._changing:
            self._end()
            return self._health()

    def interrupt(self) -> None:
        """Close the take at once, so that a later process can continue it; without a take, do nothing."""
        with self._changing:
            self._end(0.0, interrupted=True)

    def _end(self, give_up_s: float | None = None, *, interrupted: bool = False) -> None:
        with self._between_steps:  # from here on no scene and no frame of a later number belongs to the take
            recorder, self.recorder = self.recorder, None
        record_path = self._record_path
        if recorder is None or record_path is None:
            return
        record_path.finish(give_up_s)
        interrupted = interrupted or self._hurry.is_set()
        ended = recorder.close(interrupted=interrupted)
        self._record_path = None
        if not interrupted:  # else the nodes keep their frames for it
            record_path.close(self._closed)
        self._health = lambda: ended
        self._say(outcome(ended))

    def _command(self, recorder: Recorder, verb: str, arguments: Mapping[str, Any], by: str = "") -> None:
        recorder.command(verb, arguments, time.monotonic_ns(), self._session.next_step, by)

    def _info(self) -> TakeInfo:
        return TakeInfo(
            setup=self._session.setup,
            started_unix_ns=time.time_ns(),
            started_ns=time.monotonic_ns(),
            method_settings=self._session.method_settings,
            packages=packages_of(self._session.setup.method),
            take_id=new_take_id(),
        )
