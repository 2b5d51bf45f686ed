"""The state of a study session with one participant, and how actions and time change it.

`advance` is a pure function of values: the view and the recorder hold one `StudyState` and replace it. A task's phases:

    waiting → instruction → running ⇄ paused → between → the next task, or done

``waiting`` is before the first task, and wherever the sensors' placement changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal

import msgspec

from mocapella.errors import NotNowError, SettingsError, visible
from mocapella.studies.protocol import Instruction, PlannedTask

StudyPhase = Literal["waiting", "instruction", "running", "paused", "between", "done", "aborted"]
Do = Literal["wait", "next", "repeat", "pause", "resume", "mark", "abort"]
What = Literal[
    "waiting", "instruction", "started", "step", "paused", "resumed", "finished", "repeated", "mark", "too-early",
    "aborted", "done", "interrupted",
]  # fmt: skip

ENDED: Final[tuple[StudyPhase, ...]] = ("done", "aborted")
"""Phases of a session that has ended."""
NOTHING_TRACKED: Final = "no person was tracked"
"""End of the note of the event `finished` of a task during which no result had a tracked person."""
LONGEST_NOTE: Final = 500
"""Most characters of a note."""
_S: Final = 1_000_000_000


class StudyAction(msgspec.Struct, frozen=True):
    """What the researcher, or the clock, does.

    Attributes:
        do: ``wait`` lets time pass; ``next`` begins the task, its next step, or the next task; ``repeat`` begins the
            task again; ``mark`` notes ``text``; ``abort`` ends the session.
        text: the note of ``mark``, or the reason of ``abort``.
        forced: whether ``next`` ends a task before its minimum duration.
    """

    do: Do
    text: str = ""
    forced: bool = False


WAIT: Final = StudyAction("wait")


class Mark(msgspec.Struct, frozen=True):
    """A note of the researcher.

    Attributes:
        at_ns: when [ns], on the clock of `StudyState`.
        index: place of the task in the plan.
        text: the note.
    """

    at_ns: int
    index: int
    text: str


class StudyState(msgspec.Struct, frozen=True):
    """Where a session is in the participant's plan. All times are of one clock, Unix time [ns], and never decrease.

    Attributes:
        participant: the participant's code.
        plan: the participant's tasks, kept so that a protocol that is edited meanwhile changes nothing.
        at_ns: time of the last action or tick.
        since_ns: when the phase, or in ``running`` the step, began or was resumed.
        index: place in ``plan`` of the present task; the last one's in ``done``.
        attempt: number of the attempt at this task, from 1; ``repeat`` adds one.
        step: place of the present step, from 0.
        phase: what happens now.
        step_ran_ns: how long the step was running before ``since_ns``.
        task_ran_ns: how long the task's earlier steps were running.
        marks: all notes so far.
    """

    participant: str
    plan: tuple[PlannedTask, ...]
    at_ns: int
    since_ns: int
    index: int = 0
    attempt: int = 1
    step: int = 0
    phase: StudyPhase = "waiting"
    step_ran_ns: int = 0
    task_ran_ns: int = 0
    marks: tuple[Mark, ...] = ()

    @property
    def planned(self) -> PlannedTask:
        """The present task."""
        return self.plan[self.index]

    @property
    def instruction(self) -> Instruction:
        """The present step."""
        return self.planned.task.steps[self.step]


class StudyEvent(msgspec.Struct, frozen=True):
    """A transition, or a note.

    Attributes:
        participant: the participant's code.
        what: what happened; ``too-early`` is a ``next`` before the minimum duration, which changed nothing.
        at_ns: when, on the clock of `StudyState` [ns].
        index, placement, task, scenario, repetition, attempt, step: the task it is about, as in `StudyState` and
            `PlannedTask`.
        note: text of a mark, or a remark.
    """

    participant: str
    what: What
    at_ns: int
    index: int
    placement: str
    task: str
    scenario: int
    repetition: int
    attempt: int
    step: int
    note: str = ""


Advanced = tuple[StudyState, tuple[StudyEvent, ...]]


def begin(participant: str, plan: tuple[PlannedTask, ...], at_ns: int) -> Advanced:
    """Return the state before a participant's first task.

    Raises:
        SettingsError: the plan has no task.
    """
    if not plan:
        raise SettingsError(f"participant {participant!r} has no task; check the groups and placements of the tasks")
    return _to(StudyState(participant, plan, at_ns, at_ns), at_ns, "waiting")


def logging(state: StudyState) -> bool:
    """Whether frames are logged now: only while a task is running."""
    return state.phase == "running"


def ran_ns(state: StudyState) -> int:
    """Return how long the present attempt has been running, without pauses [ns]."""
    return state.task_ran_ns + _step_ran_ns(state, state.at_ns)


def due_ns(state: StudyState) -> int | None:
    """Return when the state changes by itself [ns]: the end of a step or of a pause; None if it does not."""
    task = state.planned.task
    if state.phase == "between":
        return state.since_ns + _ns(task.pause_s) if task.pause_s else None
    if state.phase != "running" or state.instruction.seconds is None:
        return None
    left = _ns(state.instruction.seconds) - state.step_ran_ns
    if _is_last(state):
        left = max(left, _ns(task.minimum_s) - state.task_ran_ns - state.step_ran_ns)
    return state.since_ns + max(left, 0)


def advance(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    """Return the state after an action, and the events on the way to it.

    What is due until ``at_ns`` happens first, each at its own time, so that the result does not depend on how often
    time is let pass.

    Args:
        state: the state before.
        action: the action.
        at_ns: when [ns]; a time before the state's is taken as the state's, because clocks can be set back.

    Raises:
        NotNowError: the action is not possible in this phase; names the phases that allow it.
    """
    at_ns = max(at_ns, state.at_ns)
    events: list[StudyEvent] = []
    while (due := due_ns(state)) is not None and due <= at_ns:
        state, new = _finish_step(state, due) if state.phase == "running" else _leave(state, due)
        events += new
    state = msgspec.structs.replace(state, at_ns=at_ns)
    if action.do != "wait":
        allowed, act = _ACTIONS[action.do]
        if state.phase not in allowed:
            raise NotNowError(f"{action.do} is not possible while {state.phase}; it is while {', '.join(allowed)}")
        state, new = act(state, action, at_ns)
        events += new
    return state, tuple(events)


def possible(state: StudyState) -> tuple[Do, ...]:
    """Return the actions that `advance` does not refuse in a state, without ``wait``."""
    return tuple(do for do, (phases, _) in _ACTIONS.items() if state.phase in phases)


def interrupted(state: StudyState) -> Advanced:
    """Return the state to resume a session with after the server has ended: a running task is paused.

    The pause begins at the last time that the state knows, because nothing was recorded since.
    """
    if state.phase != "running":
        return state, ()
    return _to(_stopped(state, state.at_ns), state.at_ns, "interrupted", phase="paused")


def _next(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    if state.phase == "waiting":
        return _to(state, at_ns, "instruction", phase="instruction")
    if state.phase == "instruction":
        return _to(state, at_ns, "started", phase="running", step=0, step_ran_ns=0, task_ran_ns=0)
    if state.phase == "between":
        return _leave(state, at_ns)
    missing = _ns(state.planned.task.minimum_s) - ran_ns(state)
    if not _is_last(state) or missing <= 0:
        return _finish_step(state, at_ns)
    note = f"{missing / _S:.1f} s before the minimum duration"
    if action.forced:
        return _finish_step(state, at_ns, note)
    return state, (_event(state, "too-early", at_ns, note),)


def _repeat(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    again, event = _to(state, at_ns, "repeated", action.text)
    fresh = msgspec.structs.replace(again, attempt=again.attempt + 1)
    shown, more = _to(fresh, at_ns, "instruction", phase="instruction", step=0, step_ran_ns=0, task_ran_ns=0)
    return shown, event + more


def _pause(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    return _to(_stopped(state, at_ns), at_ns, "paused", action.text, phase="paused")


def _resume(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    return _to(state, at_ns, "resumed", action.text, phase="running")


def _mark(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    text = visible(action.text.strip())[:LONGEST_NOTE]
    marks = (*state.marks, Mark(at_ns, state.index, text))
    return msgspec.structs.replace(state, marks=marks), (_event(state, "mark", at_ns, text),)


def _abort(state: StudyState, action: StudyAction, at_ns: int) -> Advanced:
    return _to(_stopped(state, at_ns), at_ns, "aborted", action.text, phase="aborted")


def _finish_step(state: StudyState, at_ns: int, note: str = "") -> Advanced:
    """End a running step at a time: begin the next one, or end the task."""
    ran = state.task_ran_ns + _step_ran_ns(state, at_ns)
    if _is_last(state):
        return _to(state, at_ns, "finished", note, phase="between", step_ran_ns=0, task_ran_ns=ran)
    return _to(state, at_ns, "step", step=state.step + 1, step_ran_ns=0, task_ran_ns=ran)


def _leave(state: StudyState, at_ns: int) -> Advanced:
    """Go from between two tasks to the next one, if there is one."""
    if state.index + 1 == len(state.plan):
        return _to(state, at_ns, "done", phase="done")
    same = state.plan[state.index + 1].placement == state.planned.placement
    fresh = msgspec.structs.replace(state, index=state.index + 1, attempt=1, step=0, step_ran_ns=0, task_ran_ns=0)
    phase: Literal["instruction", "waiting"] = "instruction" if same else "waiting"
    return _to(fresh, at_ns, phase, phase=phase)


_ACTIONS: Final[dict[Do, tuple[tuple[StudyPhase, ...], Callable[[StudyState, StudyAction, int], Advanced]]]] = {
    "next": (("waiting", "instruction", "running", "between"), _next),
    "repeat": (("running", "paused", "between"), _repeat),
    "pause": (("running",), _pause),
    "resume": (("paused",), _resume),
    "mark": (("waiting", "instruction", "running", "paused", "between"), _mark),
    "abort": (("waiting", "instruction", "running", "paused", "between"), _abort),
}
"""The phases that allow each action, and the function that carries it out."""


def _to(state: StudyState, at_ns: int, what: What, note: str = "", **changes: object) -> Advanced:
    """Change fields of the state at a time; the event names the changed state's task."""
    changed = msgspec.structs.replace(state, since_ns=at_ns, at_ns=at_ns, **changes)
    return changed, (_event(changed, what, at_ns, visible(note.strip())[:LONGEST_NOTE]),)


def _event(state: StudyState, what: What, at_ns: int, note: str = "") -> StudyEvent:
    planned = state.planned
    return StudyEvent(
        participant=state.participant,
        what=what,
        at_ns=at_ns,
        index=state.index,
        placement=planned.placement.name,
        task=planned.task.name,
        scenario=planned.task.scenario,
        repetition=planned.repetition,
        attempt=state.attempt,
        step=state.step,
        note=note,
    )


def _stopped(state: StudyState, at_ns: int) -> StudyState:
    return msgspec.structs.replace(state, step_ran_ns=_step_ran_ns(state, at_ns))


def _step_ran_ns(state: StudyState, at_ns: int) -> int:
    return state.step_ran_ns + (at_ns - state.since_ns if state.phase == "running" else 0)


def _is_last(state: StudyState) -> bool:
    return state.step + 1 == len(state.planned.task.steps)


def _ns(seconds: float) -> int:
    return round(seconds * _S)
