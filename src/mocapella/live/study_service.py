"""Run a study's session in the server: the protocol's steps, the labels of the results, the takes and the events.

All methods but `status` are called between two steps of the tracker.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import NotNowError, SettingsError, TakeExistsError, one_of
from mocapella.model.session import STUDY_EVENT, Setup
from mocapella.model.study_status import FloorMap, MapPoint, PlannedPart, StudyStatus
from mocapella.settings import parse
from mocapella.studies.participants import number_of
from mocapella.studies.progress import (
    ENDED,
    NOTHING_TRACKED,
    WAIT,
    StudyAction,
    StudyEvent,
    StudyState,
    advance,
    begin,
    due_ns,
    interrupted,
    logging,
    possible,
    ran_ns,
)
from mocapella.studies.protocol import Instruction, PlannedTask, StudyProtocol, plan
from mocapella.supervision import Boundary

PREFIX: Final = "study-"
"""Beginning of the names of the commands of a study."""
SAVED_EVERY_NS: Final = NS_PER_S
"""Interval at which the state is kept while nothing changes; a power failure costs as much of a running task [ns]."""
SHOWN_EVERY_NS: Final = NS_PER_S // 10
"""Interval at which the shown state follows the time: more often than it is published, and not with each frame [ns]."""


class StudyStore(Protocol):
    """Where a study's session is kept."""

    @property
    def protocol(self) -> StudyProtocol:
        """The study."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the researcher must know, such as an edited protocol."""

    def load(self) -> StudyState | None:
        """Return the state of a session that has not ended; None if there is none."""

    def save(self, state: StudyState, events: tuple[StudyEvent, ...]) -> None:
        """Keep the state, with the events since it was last kept, durably; on a thread of its own.

        Raises:
            Exception: it cannot be kept; it is tried again with the next state.
        """

    def begin(self, participant: str) -> None:
        """Check that a participant may begin now.

        Raises:
            NotNowError: the participant has not consented, or has taken part.
        """

    def take(self, state: StudyState, *, again: bool = False) -> Path:
        """Return the path of the take of the present placement; with ``again`` of a further one."""

    def keep(self, take: Path) -> None:
        """Note a finished take; on any thread."""


@dataclass(frozen=True)
class StudyRecording:
    """What a study's session does with the server.

    Attributes:
        setup: returns the server's setup.
        set_up: uses a setup, and notes it in the take.
        recalibrate: calibrates anew.
        record: begins the take at a path, or goes on with it.
        end_take: ends the take, if there is one, without waiting for it.
        note: writes an entry into the take: a name and its arguments.
        results: returns the number of results with tracked people so far.
    """

    setup: Callable[[], Setup]
    set_up: Callable[[Setup], object]
    recalibrate: Callable[[], object]
    record: Callable[[Path], object]
    end_take: Callable[[], object]
    note: Callable[[str, Mapping[str, Any]], object]
    results: Callable[[], int]


class _Keeper:
    """Keeps states on a thread of its own, because a disk may take longer than a frame; the newest counts.

    Attributes:
        problem: why the newest could not be kept; empty if it could.
    """

    def __init__(self, save: Callable[[StudyState, tuple[StudyEvent, ...]], None]) -> None:
        self.problem = ""
        self._save, self._errors = save, Boundary()
        self._changed = threading.Condition()
        self._state: StudyState | None = None
        self._events: tuple[StudyEvent, ...] = ()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="study state")
        self._thread.start()

    def put(self, state: StudyState, events: tuple[StudyEvent, ...]) -> None:
        """Keep a state, and the events on the way to it, soon."""
        with self._changed:
            self._state, self._events = state, self._events + events
            self._changed.notify()

    def close(self) -> None:
        """Keep what waits, and end."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._state is None and not self._ended:
                    self._changed.wait()
                state, events, self._state = self._state, self._events, None
            if state is None:
                return
            problem = self._errors.run("state of the study", partial(self._save, state, events))
            self.problem = f"the study's state cannot be kept: {problem}" if problem else ""
            if not problem:
                with self._changed:
                    self._events = self._events[len(events) :]


class StudyService:
    """A study's session.

    Args:
        store: where it is kept. A session that was interrupted goes on.
        recording: the server's session and take.
        now_ns: returns the wall clock, since 1970 [ns].
    """

    def __init__(self, store: StudyStore, recording: StudyRecording, now_ns: Callable[[], int]) -> None:
        self._store, self._recording, self._now_ns = store, recording, now_ns
        self._state: StudyState | None = None
        self._changes = self._results_before = self._results_task = self._saved_ns = self._shown_ns = 0
        self._recorded = ""
        self._keeper = _Keeper(store.save)
        self._actions: dict[str, Callable[[Mapping[str, Any]], str]] = {
            "begin": self._begin,
            "mark": lambda arguments: self._act("mark", arguments.get("note", "")),
            "abort": lambda arguments: self._act("abort", arguments.get("note", "")),
            "next": lambda arguments: self._act("next", forced=arguments.get("forced") == "yes"),
            **{name: self._plain(name) for name in ("repeat", "pause", "resume")},
        }
        self._shown = self._made_status(now_ns())

    @property
    def verbs(self) -> tuple[str, ...]:
        """Names of the commands."""
        return tuple(f"{PREFIX}{name}" for name in self._actions)

    def status(self) -> StudyStatus:
        """Return the shown status; on any thread."""
        return self._shown

    def go_on(self) -> str:
        """Go on with a session that was interrupted, if there is one; return a message, else an empty text.

        Raises:
            MocapellaError: its take or its state cannot be used.
        """
        state = self._store.load()
        if state is None:
            return ""
        state, events = interrupted(state)
        self._state = state
        self._results_task = 1  # of a task that was running before: their number is unknown, so it gives no warning
        if state.phase != "waiting":
            self._record(state)
        self._take_up(state, events)
        return f"participant {state.participant} goes on at {state.planned.task.name} ({state.phase})"

    def carry_out(self, verb: str, arguments: Mapping[str, Any]) -> str:
        """Carry out a command; return a message about its effect.

        Raises:
            SettingsError: the command or an argument is unknown.
            NotNowError: it is not possible now; says when it is.
            RecordingError, TakeExistsError, DiskFullError: the take cannot be recorded; nothing has changed.
        """
        name = verb.removeprefix(PREFIX)
        if name not in self._actions:
            raise SettingsError(f"unknown command {verb!r}; known: {one_of(verb, self.verbs)}")
        return self._actions[name](arguments)

    def beat(self) -> None:
        """Let time pass: steps end, and pauses. Call it at least ten times a second."""
        state = self._state
        if state is None or state.phase in ENDED:
            return
        now_ns = self._now_ns()
        due = due_ns(state)
        if (due is not None and now_ns >= due) or now_ns - self._saved_ns >= SAVED_EVERY_NS:
            self._take_up(*advance(state, WAIT, now_ns))
        elif not 0 <= now_ns - self._shown_ns < SHOWN_EVERY_NS:
            self._show(now_ns)

    def close(self) -> None:
        """Keep the newest state, and end."""
        if self._state is not None and self._state.phase not in ENDED:
            self._take_up(*advance(self._state, WAIT, self._now_ns()))
        self._keeper.close()

    def _plain(self, name: Any) -> Callable[[Mapping[str, Any]], str]:
        return lambda arguments: self._act(name)

    def _begin(self, arguments: Mapping[str, Any]) -> str:
        if self._state is not None and self._state.phase not in ENDED:
            raise NotNowError(f"participant {self._state.participant} takes part; finish or abort that session first")
        code = parse(_Who, arguments, where="study-begin").participant
        planned = plan(self._store.protocol, code)
        self._store.begin(code)
        self._take_up(*begin(code, planned, self._now_ns()))
        return f"participant {code}: {len(planned)} tasks"

    def _act(self, do: Any, text: str = "", *, forced: bool = False) -> str:
        if self._state is None:
            raise NotNowError("no participant yet; begin with a participant first")
        before = self._state
        state, events = advance(before, StudyAction(do, text, forced=forced), self._now_ns())
        if before.phase == "waiting" and state.phase == "instruction":
            self._place(before, state)
        self._take_up(state, events)
        early = next((event.note for event in events if event.what == "too-early"), "")
        if early:
            raise NotNowError(f"it is {early} of this task; wait, or end it all the same with Shift N")
        return ""

    def _place(self, before: StudyState, state: StudyState) -> None:
        """Begin a placement: its take, and a calibration of its own if sensors were moved for it."""
        placement = state.planned.placement
        if self._recorded != placement.name and before.index:
            self._recording.end_take()
            self._recording.recalibrate()
        setup = self._recording.setup()
        if setup.sensors_expected != placement.sensors:
            self._recording.set_up(replace(setup, sensors_expected=placement.sensors))
        self._record(state)

    def _record(self, state: StudyState) -> None:
        try:
            self._recording.record(self._store.take(state))
        except TakeExistsError:  # it was ended properly before the session was
            self._recording.record(self._store.take(state, again=True))
        self._recorded = state.planned.placement.name

    def _take_up(self, state: StudyState, events: tuple[StudyEvent, ...]) -> None:
        """Make a state the present one: keep it, note its events in the take, and label what follows.

        Events are noted before the labels of a task that begins, and after the labels of a task that ends, so that all
        results of a run of the take with a scenario are of the running task.
        """
        was_logged = self._state is not None and logging(self._state)
        ended = any(event.what == "finished" for event in events)
        if was_logged and (ended or not logging(state)):
            self._results_task += self._recording.results() - self._results_before
        events = tuple(map(self._with_note, events))
        self._keeper.put(state, events)
        before, self._state, self._saved_ns = self._state, state, state.at_ns
        if events:
            labels = self._labels(state)
            if not logging(state):
                self._label(labels)
            for event in events:
                self._recording.note(STUDY_EVENT, msgspec.to_builtins(event))
            if logging(state):
                self._label(labels)
            self._changes += before is None or _shown_step(before) != _shown_step(state)
            if logging(state) and (ended or not was_logged):
                self._results_before = self._recording.results()
        if state.phase in ENDED and events:
            self._recording.end_take()
            self._recorded = ""
        self._show(self._now_ns())

    def _with_note(self, event: StudyEvent) -> StudyEvent:
        """Count the results of an attempt from its start on, and note at its end if no person was tracked."""
        if event.what == "started":
            self._results_task = 0
        if event.what != "finished" or self._results_task:
            return event
        return msgspec.structs.replace(event, note="; ".join(filter(None, [event.note, NOTHING_TRACKED])))

    def _labels(self, state: StudyState) -> tuple[int, str, str]:
        task = state.planned.task.name if logging(state) else ""
        return number_of(state.participant), state.planned.placement.name, task

    def _label(self, labels: tuple[int, str, str]) -> None:
        participant, placement, scenario = labels
        setup = replace(self._recording.setup(), participant=participant, placement=placement, scenario=scenario)
        if setup != self._recording.setup():
            self._recording.set_up(setup)

    # What is shown.

    def _show(self, now_ns: int) -> None:
        self._shown, self._shown_ns = self._made_status(now_ns), now_ns

    def _made_status(self, now_ns: int) -> StudyStatus:
        protocol, state = self._store.protocol, self._state
        notes = (*self._store.notes, *filter(None, [self._keeper.problem]))
        known = StudyStatus(protocol.title, protocol.codes, notes=notes, changes=self._changes)
        if state is None:
            return msgspec.structs.replace(known, actions=("begin",))
        step, phase = _shown_step(state), state.phase
        now_ns = max(now_ns, state.at_ns)
        running = phase == "running"
        ran = ran_ns(state) + (now_ns - state.at_ns if running else 0)
        due = due_ns(state)
        task = state.planned.task
        results = self._recording.results() - self._results_before if running else 0
        return msgspec.structs.replace(
            known,
            participant=state.participant,
            placement=state.planned.placement.name,
            advice=state.planned.placement.text if phase == "waiting" else "",
            phase=phase,
            part=state.index,
            plan=_parts(state),
            instruction=_instruction(state),
            following=_following(state),
            step=state.step + 1 if step is not None else 0,
            steps=len(task.steps),
            elapsed_s=ran / NS_PER_S,
            step_left_s=None if due is None else max(0, due - now_ns) / NS_PER_S,
            step_s=(step.seconds or 0.0) if step is not None else task.pause_s if phase == "between" else 0.0,
            minimum_left_s=max(0.0, task.minimum_s - ran / NS_PER_S) if running else 0.0,
            block=_floor(protocol, state),
            tone=any(one.tone_hz is not None for part in state.plan for one in part.task.steps),
            tone_hz=_tone_hz(state),
            logged=f"logging {task.name}: {results} results" if running else "",
            results=results,
            marks=len(state.marks),
            actions=("begin",) if phase in ENDED else possible(state),
        )


@dataclass(frozen=True)
class _Who:
    participant: str


def _shown_step(state: StudyState) -> Instruction | None:
    return state.instruction if state.phase in ("running", "paused") else None


def _instruction(state: StudyState) -> str:
    step = _shown_step(state)
    if step is not None:
        return "Pause" if state.phase == "paused" else step.text
    if state.phase == "instruction":
        task = state.planned.task
        return task.text or task.steps[0].text
    return "Well done" if state.phase == "between" else ""


def _following(state: StudyState) -> str:
    task = state.planned.task
    if state.phase in ("running", "paused") and state.step + 1 < len(task.steps):
        return task.steps[state.step + 1].text
    if state.phase == "instruction":
        return task.steps[0].text if task.text else ""
    if state.phase in ("between", "running", "paused") and state.index + 1 < len(state.plan):
        return state.plan[state.index + 1].task.name
    return ""


def _parts(state: StudyState) -> tuple[PlannedPart, ...]:
    over = state.phase == "done"
    return tuple(_part(one, "done" if at < state.index or over else "later" if at > state.index else "now")
                 for at, one in enumerate(state.plan))  # fmt: skip


def _part(planned: PlannedTask, state: Any) -> PlannedPart:
    return PlannedPart(planned.task.name, planned.placement.name, planned.repetition, planned.task.repetitions, state)


def _tone_hz(state: StudyState) -> float | None:
    """Return the tone of the shown step, after a task that of its last step [Hz]; None for silence."""
    step = state.planned.task.steps[-1] if state.phase == "between" else _shown_step(state)
    return None if step is None else step.tone_hz


def _floor(protocol: StudyProtocol, state: StudyState) -> FloorMap | None:
    """Return the map of the block with the points of the task; None without a block."""
    block = protocol.block
    if block is None:
        return None
    used = {block.start, *(name for one in state.planned.task.steps for name in (*one.stand, *one.foot))}
    points = tuple(MapPoint(point.name, point.x_m, point.y_m) for point in block.points if point.name in used)
    step = _shown_step(state)
    here, then = ((), ()) if step is None else (step.stand, step.foot)
    if state.phase == "instruction":
        here = state.planned.task.steps[0].stand  # where to go before the task begins
    return FloorMap(block.width_m, block.depth_m, points, block.start, here, then)
