"""Start, continue and finish takes: connects the session, the bus and the recorder."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from mocapella import __version__
from mocapella.errors import NotNowError
from mocapella.live.recorder import Recorder, begin_take
from mocapella.live.refetch import Refetch
from mocapella.live.session import Session
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.part_types import PART_TYPES
from mocapella.model.session import RecordingHealth
from mocapella.recording.take import TakeInfo
from mocapella.registry import OURS, Table
from mocapella.tracker import METHODS
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import OnFrame, ServerLink

STRAGGLERS_S = 0.2
"""How long frames already on their way are still recorded when a take ends [s]."""
CATCH_UP_S = 2.0
"""How long the end of a take waits for missing frames before requesting them again [s]."""


def outcome(health: RecordingHealth) -> str:
    """Describe how a take ended, with the number of missing frames."""
    lost = f"; {health.lost} frames are missing" if health.lost else ""
    return health.problem or f"recorded {health.frames} frames in {health.path}{lost}"


def packages_of(method: str) -> dict[str, str]:
    """Return the plug-in descriptors that a run of a method may use, with their packages, and our own version.

    Any sensor may send any type of frame, so all frame types of other packages are included.
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

    ``between_steps`` is held while the tracker loses the recorder, so that a take has a step completely or not at all.

    Attributes:
        recorder: of the present take; None if there is none. Read it once before use: another thread may end it at any
            time.
    """

    def __init__(
        self,
        session: Session,
        link: ServerLink,
        on_frame: OnFrame,
        say: Callable[[str], None],
        *,
        reserve_bytes: int,
        between_steps: AbstractContextManager[object] | None = None,
    ) -> None:
        self.recorder: Recorder | None = None
        self._session, self._link, self._on_frame, self._say = session, link, on_frame, say
        self._reserve_bytes = reserve_bytes
        self._between_steps = between_steps or nullcontext()
        self._health: Callable[[], RecordingHealth] = RecordingHealth
        self._changing = threading.Lock()
        self._refetch = Refetch()

    def health(self) -> RecordingHealth:
        """Return the state of the present take, or the result of the last one."""
        return self._health()

    def begin(self, path: Path, *, resume: bool = False, newest: Mapping[NodeKey, int] | None = None) -> str:
        """Start a take at ``path``; with ``resume``, continue an interrupted one.

        ``newest`` has the sequence number of each node's newest tracked frame: a new take begins after it.

        The take begins with a snapshot of the tracker, so that it can be replayed although it begins mid-session.

        Raises:
            NotNowError: a take is being recorded already, or is being ended.
            TakeExistsError, DiskFullError, RecordingError: before anything is created.
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
        self._end()
        fresh = not (resume and path.exists())
        first = {node: sequence + 1 for node, sequence in newest.items()} if fresh else {}
        writer, history_s = begin_take(path, self._info(), reserve_bytes=self._reserve_bytes, resume=resume)
        recorder = Recorder(writer, self._say, history_s, first)
        self._command(recorder, "restore", self._session.memory())
        if not self._session.running:
            self._command(recorder, "stop", {})
        now_s = time.monotonic()
        self._refetch = Refetch()
        if not fresh:  # a sensor may have started meanwhile
            self._refetch.newcomer(now_s - history_s, now_s)
        self.recorder, self._health = recorder, recorder.health
        self._link.start_record_path(self._on_frame)
        return f"recording {path}"

    def record_command(self, verb: str, arguments: Mapping[str, Any], by: str = "") -> None:
        """Record a command that was carried out, for the replay, and who sent it."""
        recorder = self.recorder
        if recorder is None:
            return
        if verb not in ("start", "setup", "use-rig"):
            self._command(recorder, verb, arguments, by)
            return
        recorder.run(self._info())  # they make a new tracker
        if not self._session.running:
            self._command(recorder, "stop", {})

    def finish(self) -> RecordingHealth:
        """Finish the take and return its result; missing frames are requested until they arrive or are given up."""
        with self._changing:
            recorder, given_up = self.recorder, self._refetch.given_up
            if recorder is not None:
                time.sleep(STRAGGLERS_S)
                while not recorder.wait_for(given_up, CATCH_UP_S) and self._ask_again(recorder, at_once=True):
                    pass
            self._end()
            return self._health()

    def fetch_missing(self) -> None:
        """Request missing frames from the nodes again, if due; called several times a second."""
        if self._changing.acquire(blocking=False):
            try:
                if self.recorder is not None:
                    self._ask_again(self.recorder)
            finally:
                self._changing.release()

    def _ask_again(self, recorder: Recorder, *, at_once: bool = False) -> bool:
        while recorder.gaps:
            self._refetch.opened(recorder.gaps.popleft())
        while recorder.newcomers:
            self._refetch.newcomer(recorder.newcomers.popleft(), time.monotonic())
        missing = recorder.missing  # read after the gaps: the recorder writes it before them
        back_s = self._refetch.update(missing, time.monotonic(), at_once=at_once)
        if back_s is not None:
            if missing:
                self._say(f"asking the nodes again for {missing} missing frames")
            self._link.fetch_history(self._on_frame, back_s)
        return back_s is not None

    def _end(self) -> None:
        with self._between_steps:
            recorder, self.recorder = self.recorder, None
        if recorder is None:
            return
        self._link.stop_record_path()
        ended = recorder.close()
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
        )
