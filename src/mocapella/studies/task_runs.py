"""When each task of a session was running, from its events: what a log of the task is cut to."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from mocapella.studies.progress import NOTHING_TRACKED, StudyEvent


class TaskRun(msgspec.Struct, frozen=True):
    """One attempt at a task.

    Attributes:
        participant, index, placement, task, scenario, repetition, attempt: as in `StudyEvent`.
        spans: (first, last) times of its running parts [ns], in their order; the last time is after the last frame.
        finished: whether the attempt came to the task's end, and was not repeated after it.
        empty: whether no person was tracked in it, as its last event says.
    """

    participant: str
    index: int
    placement: str
    task: str
    scenario: int
    repetition: int
    attempt: int
    spans: tuple[tuple[int, int], ...]
    finished: bool
    empty: bool = False

    def has(self, at_ns: int) -> bool:
        """Whether the task was running at a time [ns]."""
        return any(first <= at_ns < last for first, last in self.spans)


def task_runs(events: Iterable[StudyEvent]) -> tuple[TaskRun, ...]:
    """Return all attempts that were started, in their order.

    Args:
        events: the events of one session in their order; a running part that they do not end is left out.
    """
    found: dict[tuple[int, int], TaskRun] = {}
    began: int | None = None
    for event in events:
        key = event.index, event.attempt
        if event.what in {"started", "resumed"}:
            began = event.at_ns
            run = TaskRun(
                event.participant,
                event.index,
                event.placement,
                event.task,
                event.scenario,
                event.repetition,
                event.attempt,
                (),
                finished=False,
            )
            found.setdefault(key, run)
        elif began is not None and event.what in {"paused", "finished", "repeated", "aborted", "interrupted"}:
            run, span, began = found[key], (began, event.at_ns), None
            found[key] = msgspec.structs.replace(run, spans=(*run.spans, span))
        if event.what in {"finished", "repeated"} and key in found:
            finished = event.what == "finished"
            empty = finished and event.note.endswith(NOTHING_TRACKED)
            found[key] = msgspec.structs.replace(found[key], finished=finished, empty=empty)
    return tuple(found.values())


def valid_runs(events: Iterable[StudyEvent]) -> tuple[TaskRun, ...]:
    """Return the analysed attempt at each task, finished and not repeated, in the order of the plan."""
    return tuple(sorted((run for run in task_runs(events) if run.finished), key=lambda run: run.index))


def empty_runs(events: Iterable[StudyEvent]) -> tuple[TaskRun, ...]:
    """Return the `valid_runs` during which no person was tracked."""
    return tuple(run for run in valid_runs(events) if run.empty)
