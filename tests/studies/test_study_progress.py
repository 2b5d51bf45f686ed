"""A study session as a state machine: no task is lost, none overlaps another, and only running ones are logged."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from support.study_protocols import protocols

from mocapella.errors import NotNowError, SettingsError
from mocapella.studies.progress import (
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
from mocapella.studies.protocol import Instruction, Placement, PlannedTask, Task, plan
from mocapella.studies.task_runs import task_runs, valid_runs

S = 1_000_000_000
NEXT, REPEAT, PAUSE = StudyAction("next"), StudyAction("repeat"), StudyAction("pause")
RESUME, ABORT = StudyAction("resume"), StudyAction("abort")


class SessionMachine(RuleBasedStateMachine):
    """Any actions at any times, with restarts in between."""

    @initialize(protocol=protocols(2))
    def start(self, protocol: Any) -> None:
        planned = next((some for code in protocol.codes if (some := plan(protocol, code))), None)
        if planned is None:
            planned = (PlannedTask(protocol.placements[0], protocol.tasks[0], 1),)
        self.now = 1000 * S
        self.state, events = begin("P1", planned, self.now)
        self.events: list[StudyEvent] = list(events)
        self.logged: list[tuple[int, int]] = []
        """(time, place in the plan) of moments that are logged."""

    def _act(self, action: StudyAction, later_ns: int) -> None:
        before, self.now = self.state, self.now + later_ns
        if logging(before):
            self.logged.append((before.at_ns, before.index))
        waited, waiting = advance(before, WAIT, self.now)
        try:
            self.state, events = advance(before, action, self.now)
            assert action.do == "wait" or action.do in possible(waited)
        except NotNowError:
            self.state, events = waited, waiting
            assert action.do not in ("wait", *possible(waited))
        self.events += events

    @rule(later=st.integers(-5 * S, 40 * S), do=st.sampled_from(["wait", "next", "next", "repeat", "pause", "resume"]))
    def act(self, later: int, do: Any) -> None:
        self._act(StudyAction(do), later)

    @rule(later=st.integers(0, S), forced=st.booleans())
    def go_on(self, later: int, forced: bool) -> None:
        self._act(StudyAction("next", forced=forced), later)

    @rule(text=st.text(max_size=9))
    def mark(self, text: str) -> None:
        marks = len(self.state.marks)
        self._act(StudyAction("mark", text), 0)
        assert len(self.state.marks) == marks + (self.state.phase not in {"done", "aborted"})

    @rule()
    def restart(self) -> None:
        again = msgspec.json.decode(msgspec.json.encode(self.state), type=StudyState)
        assert again == self.state
        self.state, events = interrupted(again)
        self.events += events
        assert not logging(self.state)

    @invariant()
    def times_never_decrease(self) -> None:
        times = [event.at_ns for event in self.events]
        assert times == sorted(times)
        assert self.state.since_ns <= self.state.at_ns
        assert not times or times[-1] <= self.state.at_ns

    @invariant()
    def no_task_is_lost_or_begun_before_its_turn(self) -> None:
        order = [event.index for event in self.events]
        assert all(after - before in {0, 1} for before, after in pairwise(order))
        finished = {run.index for run in task_runs(self.events) if run.finished}
        wanted = range(self.state.index + (self.state.phase in {"between", "done"}))
        missing = set(wanted) ^ finished
        assert not missing or (self.state.phase == "aborted" and missing == {self.state.index})
        assert (self.state.phase == "done") <= (finished == set(range(len(self.state.plan))))

    @invariant()
    def tasks_do_not_overlap_and_frames_are_logged_within_them_only(self) -> None:
        spans = [(*span, run.index) for run in task_runs(self.events) for span in run.spans]
        assert all(first <= last for first, last, _ in spans)
        assert all(before[1] <= after[0] for before, after in pairwise(spans))
        if not logging(self.state):
            for at_ns, index in self.logged:
                assert any(first <= at_ns <= last and index == own for first, last, own in spans)

    @invariant()
    def a_finished_task_lasted_its_minimum_unless_it_was_forced(self) -> None:
        forced = {(event.index, event.attempt) for event in self.events if event.what == "finished" and event.note}
        for run in task_runs(self.events):
            if run.finished and (run.index, run.attempt) not in forced:
                ran = sum(last - first for first, last in run.spans)
                assert ran >= round(self.state.plan[run.index].task.minimum_s * S)


TestSession = SessionMachine.TestCase
TestSession.settings = settings(max_examples=20, stateful_step_count=25, deadline=None)


@pytest.mark.slow
class TestManySessions(SessionMachine.TestCase):  # type: ignore[misc]
    settings = settings(max_examples=300, stateful_step_count=40, deadline=None)


def task(name: str = "walk", *steps: Instruction, **more: Any) -> Task:
    return Task(name, 3, steps or (Instruction("Walk.", 4.0), Instruction("Stop.", None)), **more)


def session(*tasks: Task, placements: int = 1) -> tuple[StudyState, tuple[StudyEvent, ...]]:
    places = [Placement(f"p{number}", number) for number in range(placements)]
    return begin("P1", tuple(PlannedTask(place, one, 1) for place in places for one in tasks), 0)


def after(state: StudyState, *actions: tuple[StudyAction, float]) -> tuple[StudyState, list[StudyEvent]]:
    """Return the state after actions, each so many seconds after the one before."""
    events, now = [], state.at_ns
    for action, later in actions:
        now += round(later * S)
        state, new = advance(state, action, now)
        events += new
    return state, events


@given(st.lists(st.integers(0, 9 * S), max_size=12), st.lists(st.sampled_from([0.0, 0.5, 3.0]), min_size=1, max_size=4))
def test_it_does_not_matter_how_often_time_is_let_pass(times: list[int], lengths: list[float]) -> None:
    steps = tuple(Instruction("a", length or None) for length in lengths)
    first, _ = session(task("a", *steps, minimum_s=5, pause_s=2), task("b"))
    first, _ = after(first, (NEXT, 1), (NEXT, 1))
    often, events = first, []
    now = first.at_ns
    for time in times:
        now += time
        often, new = advance(often, WAIT, now)
        events += new
    once, together = advance(first, WAIT, now)
    assert often == once
    assert tuple(events) == together


def test_a_task_goes_through_its_phases() -> None:
    state, first = session(task(pause_s=3))
    assert [event.what for event in first] == ["waiting"]
    state, events = after(state, (NEXT, 1), (NEXT, 1), (WAIT, 5), (NEXT, 1), (WAIT, 10))
    assert [(event.what, event.at_ns / S) for event in events] == [
        ("instruction", 1),
        ("started", 2),
        ("step", 6),
        ("finished", 8),
        ("done", 11),
    ]
    assert state.phase == "done"
    assert valid_runs(events)[0].spans == ((2 * S, 8 * S),)


def test_where_the_placement_changes_the_researcher_goes_on() -> None:
    state, _ = session(task(pause_s=1), placements=2)
    state, _ = after(state, (NEXT, 1), (NEXT, 1), (WAIT, 4), (NEXT, 1), (WAIT, 1))
    assert (state.phase, state.index) == ("waiting", 1)
    assert due_ns(state) is None


def test_next_does_not_end_a_task_before_its_minimum_unless_forced() -> None:
    state, _ = session(task("a", Instruction("Stand.", None), minimum_s=5))
    state, _ = after(state, (NEXT, 0), (NEXT, 0))
    held, events = after(state, (NEXT, 3))
    assert (held.phase, [event.what for event in events]) == ("running", ["too-early"])
    assert events[0].note == "2.0 s before the minimum duration"
    assert after(state, (NEXT, 5))[0].phase == "between"
    forced, events = after(state, (StudyAction("next", forced=True), 3))
    assert forced.phase == "between"
    assert events[0].note == "2.0 s before the minimum duration"


def test_a_timed_last_step_lasts_until_the_minimum() -> None:
    state, _ = after(session(task("a", Instruction("Stand.", 1.0), minimum_s=5))[0], (NEXT, 0), (NEXT, 0))
    assert due_ns(state) == 5 * S
    paused, _ = after(state, (PAUSE, 2), (RESUME, 8))
    assert due_ns(paused) == 13 * S


def test_a_pause_does_not_count() -> None:
    state, _ = after(session(task())[0], (NEXT, 0), (NEXT, 0), (PAUSE, 3), (RESUME, 60))
    assert due_ns(state) == 64 * S
    assert ran_ns(state) == 3 * S
    state, _ = after(state, (WAIT, 2))
    assert ran_ns(state) == 5 * S


def test_a_repeated_task_replaces_the_earlier_attempt() -> None:
    begun = [(NEXT, 1), (NEXT, 1), (WAIT, 4), (NEXT, 1)]
    state, events = after(session(task())[0], *begun, (REPEAT, 1), (NEXT, 1), (WAIT, 4), (NEXT, 1))
    assert [(run.attempt, run.finished) for run in task_runs(events)] == [(1, False), (2, True)]
    assert [run.attempt for run in valid_runs(events)] == [2]
    state, events = after(session(task())[0], *begun, (REPEAT, 1), (ABORT, 1))
    assert valid_runs(events) == ()
    assert state.phase == "aborted"


def test_a_repeated_task_begins_with_its_first_step_and_no_time() -> None:
    state, _ = after(session(task())[0], (NEXT, 1), (NEXT, 1), (WAIT, 5), (REPEAT, 1))
    assert (state.phase, state.step, ran_ns(state), state.attempt) == ("instruction", 0, 0, 2)


def test_a_clock_that_is_set_back_is_the_last_known_time() -> None:
    state, _ = after(session(task())[0], (NEXT, 5))
    state, events = advance(state, NEXT, 2 * S)
    assert (events[0].at_ns, state.at_ns) == (5 * S, 5 * S)


def test_a_restart_pauses_a_running_task_where_it_was_known_last() -> None:
    state, _ = after(session(task())[0], (NEXT, 0), (NEXT, 0), (WAIT, 2))
    paused, events = interrupted(state)
    assert (paused.phase, ran_ns(paused), events[0].what) == ("paused", 2 * S, "interrupted")
    assert interrupted(paused) == (paused, ())


@pytest.mark.parametrize(
    ("actions", "refused"),
    [
        ([], "repeat"),
        ([], "pause"),
        ([(NEXT, 1)], "resume"),
        ([(NEXT, 1), (NEXT, 1), (PAUSE, 1)], "next"),
        ([(ABORT, 1)], "next"),
        ([(ABORT, 1)], "abort"),
        ([(ABORT, 1)], "mark"),
    ],
)
def test_an_action_out_of_place_is_refused(actions: list[tuple[StudyAction, float]], refused: Any) -> None:
    state, _ = after(session(task())[0], *actions)
    with pytest.raises(NotNowError, match=rf"{refused} is not possible while {state.phase}; it is while "):
        advance(state, StudyAction(refused), state.at_ns)


def test_notes_are_cut_and_show_no_control_characters() -> None:
    _, events = after(session(task())[0], (StudyAction("mark", " \x1b[2J" + "a" * 900), 1))
    assert events[0].note.startswith("\\x1b[2J")
    assert len(events[0].note) == 500


def test_a_plan_without_a_task_is_refused() -> None:
    with pytest.raises(SettingsError, match="has no task; check the groups"):
        begin("P1", (), 0)
