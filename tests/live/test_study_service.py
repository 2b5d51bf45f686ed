"""Laws of a study's session in the server: labels, events and takes follow the steps, whatever the researcher does."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.programs import wait_until

from mocapella.errors import DiskFullError, MocapellaError, NotNowError, SettingsError, TakeExistsError
from mocapella.live.study_service import StudyRecording, StudyService
from mocapella.model.session import STUDY_EVENT, Setup
from mocapella.studies.progress import NOTHING_TRACKED, StudyEvent, StudyState
from mocapella.studies.protocol import StudyProtocol, protocol_from_toml
from mocapella.studies.task_runs import empty_runs, valid_runs

S = 1_000_000_000
PROTOCOL = protocol_from_toml(
    """
title = "Two tasks"
participants = { codes = ["P01", "P02"] }
[block]
width_m = 2.0
depth_m = 2.0
start = "middle"
points = [{ name = "middle", x_m = 0, y_m = 0 }, { name = "front", x_m = 0, y_m = 1 }]
[[placements]]
name = "side-by-side"
number = 7
text = "Put both beside each other."
[[placements]]
name = "opposite"
number = 8
sensors = 3
[[tasks]]
name = "stand"
scenario = 21
text = "Get ready to stand."
steps = [{ text = "Stand.", seconds = 3, stand = ["middle"] }, { text = "Step.", stand = ["middle"], foot = ["front"] }]
[[tasks]]
name = "sit"
scenario = 22
minimum_s = 2
pause_s = 4
repetitions = 2
steps = [{ text = "Sit down.", tone_hz = 880 }]
"""
)


class Store:
    def __init__(self, saved: StudyState | None = None) -> None:
        self.protocol: StudyProtocol = PROTOCOL
        self.notes: tuple[str, ...] = ()
        self.saved, self.events = saved, list[StudyEvent]()
        self.broken: Exception | None = None

    def load(self) -> StudyState | None:
        return self.saved

    def save(self, state: StudyState, events: tuple[StudyEvent, ...]) -> None:
        if self.broken is not None:
            raise self.broken
        self.saved = state
        self.events += events

    def begin(self, participant: str) -> None:
        if participant == "P02":
            raise NotNowError("P02 has not consented")

    def take(self, state: StudyState, *, again: bool = False) -> Path:
        return Path(f"{state.participant}-{state.planned.placement.name}{'-again' if again else ''}.mcap")

    def keep(self, take: Path) -> None:
        raise AssertionError("the server does this")


class Room:
    """A study's session, with a clock and what the server would do."""

    def __init__(self, saved: StudyState | None = None) -> None:
        self.setup = Setup("stand-still", sensors_expected=2)
        self.log: list[tuple[str, Any]] = []
        self.now_ns, self.results, self.full, self.closed = 100 * S, 0, False, ""
        self.store = Store(saved)
        self.service = StudyService(
            self.store,
            StudyRecording(
                setup=lambda: self.setup,
                set_up=self._set_up,
                recalibrate=lambda: self.log.append(("recalibrate", None)),
                record=self._record,
                end_take=lambda: self.log.append(("end", None)),
                note=self._note,
                results=lambda: self.results,
            ),
            lambda: self.now_ns,
        )

    def _set_up(self, setup: Setup) -> None:
        self.setup = setup
        self.log.append(("setup", setup))

    def _record(self, path: Path) -> None:
        if self.full:
            raise DiskFullError("the disk is full")
        if path.name == self.closed:
            raise TakeExistsError(f"{path} exists")
        self.log.append(("record", path.name))

    def _note(self, verb: str, arguments: Mapping[str, Any]) -> None:
        assert verb == STUDY_EVENT
        self.log.append(("event", arguments["what"]))

    def do(self, name: str, **arguments: Any) -> str:
        return self.service.carry_out(f"study-{name}", arguments)

    def wait(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / 0.05))):
            self.now_ns += round(0.05 * S)
            self.results += 1
            self.service.beat()

    @property
    def status(self) -> Any:
        return self.service.status()

    def names(self, of: str) -> list[Any]:
        return [what for kind, what in self.log if kind == of]


@pytest.fixture
def room() -> Any:
    made = Room()
    yield made
    made.service.close()


def test_a_session_goes_through_all_tasks_and_labels_only_what_runs(room: Room) -> None:
    assert (room.status.phase, room.status.actions) == ("waiting", ("begin",))
    assert room.do("begin", participant="P01") == "participant P01: 6 tasks"
    assert room.status.advice == "Put both beside each other."
    assert [(part.title, part.placement, part.repetition) for part in room.status.plan][:3] == [
        ("stand", "side-by-side", 1), ("sit", "side-by-side", 1), ("sit", "side-by-side", 2),
    ]  # fmt: skip
    room.do("next")
    assert room.names("record") == ["P01-side-by-side.mcap"]
    assert (room.status.instruction, room.status.following) == ("Get ready to stand.", "Stand.")
    assert room.setup.scenario == ""
    room.do("next")
    assert (room.setup.participant, room.setup.placement, room.setup.scenario) == (1, "side-by-side", "stand")
    assert room.status.block.here == ("middle",)
    room.wait(1.0)
    assert room.status.step_left_s == pytest.approx(2.0, abs=0.1)
    assert room.status.logged == "logging stand: 20 results"
    room.wait(2.1)
    assert (room.status.step, room.status.instruction, room.status.block.next) == (2, "Step.", ("front",))
    room.do("next")
    assert (room.status.phase, room.setup.scenario) == ("between", "")
    room.do("next")
    room.do("next")
    assert room.setup.scenario == "sit"
    room.wait(0.5)
    with pytest.raises(NotNowError, match=r"1\.5 s before the minimum"):
        room.do("next")
    room.do("next", forced="yes")
    assert room.status.phase == "between"
    room.wait(4.1)  # the pause ends by itself
    assert room.status.phase == "instruction"


def test_another_placement_is_a_take_and_a_calibration_of_its_own(room: Room) -> None:
    room.do("begin", participant="P01")
    finish_placement(room)
    assert room.status.phase == "waiting"
    assert room.names("record") == ["P01-side-by-side.mcap"]
    room.do("next")
    assert room.names("record") == ["P01-side-by-side.mcap", "P01-opposite.mcap"]
    assert room.names("recalibrate") == [None]
    assert room.setup.sensors_expected == 3
    finish_placement(room)
    assert (room.status.phase, room.status.actions) == ("done", ("begin",))
    assert room.log[-1] == ("end", None)


def finish_placement(room: Room) -> None:
    placement = room.status.placement
    while room.status.placement == placement and room.status.phase not in ("done", "aborted"):
        room.do("next")
        room.wait(3.2 if room.status.phase == "running" else 0.1)
        if room.status.phase == "waiting":
            return


def test_a_participant_who_may_not_begin_or_is_unknown_is_refused(room: Room) -> None:
    with pytest.raises(NotNowError, match="consented"):
        room.do("begin", participant="P02")
    with pytest.raises(SettingsError, match="P01"):
        room.do("begin", participant="P1")
    with pytest.raises(SettingsError, match="participant"):
        room.do("begin")
    with pytest.raises(NotNowError, match="begin with a participant"):
        room.do("next")
    with pytest.raises(SettingsError, match="study-next"):
        room.do("nxt")
    room.do("begin", participant="P01")
    with pytest.raises(NotNowError, match="P01 takes part"):
        room.do("begin", participant="P01")


def test_a_take_that_cannot_be_recorded_begins_nothing(room: Room) -> None:
    room.do("begin", participant="P01")
    room.full = True
    with pytest.raises(DiskFullError):
        room.do("next")
    assert room.status.phase == "waiting"
    room.full = False
    room.do("next")
    assert room.status.phase == "instruction"


@pytest.mark.parametrize("error", [OSError("the disk is gone"), RuntimeError("the disk is gone")])
def test_a_state_that_cannot_be_kept_is_said_and_kept_later(room: Room, error: Exception) -> None:
    room.store.broken = error
    room.do("begin", participant="P01")
    wait_until("the problem is known", lambda: bool(room.service._keeper.problem))
    room.wait(0.1)
    assert any("the disk is gone" in note for note in room.status.notes)
    room.store.broken = None
    room.wait(1.2)
    wait_until("it is kept", lambda: room.store.saved is not None)
    wait_until("with its events", lambda: [event.what for event in room.store.events] == ["waiting"])
    wait_until("no problem is left", lambda: not room.service._keeper.problem)
    room.wait(0.1)
    assert room.status.notes == ()


ACTIONS = st.one_of(
    st.sampled_from(["begin", "next", "repeat", "pause", "resume", "abort"]),
    st.tuples(st.just("mark"), st.text(max_size=20)),
    st.tuples(st.just("wait"), st.floats(0.05, 5.0)),
    st.tuples(st.just("force"), st.none()),
)


@given(actions=st.lists(ACTIONS, max_size=40))
@settings(max_examples=60, deadline=None)
def test_whatever_is_done_only_running_tasks_have_a_scenario_and_no_event_is_lost(actions: list[Any]) -> None:
    room = Room()
    try:
        for action in actions:
            name, value = (action, None) if isinstance(action, str) else action
            before = room.status
            try:
                if name == "wait":
                    room.wait(value)
                elif name == "mark":
                    room.do("mark", note=value)
                elif name == "force":
                    room.do("next", forced="yes")
                else:
                    room.do(name, **({"participant": "P01"} if name == "begin" else {}))
                allowed = "next" if name == "force" else name
                assert name == "wait" or allowed in before.actions
            except MocapellaError:
                assert name not in ("wait", "mark") or "mark" not in before.actions
            running = room.status.phase == "running"
            assert bool(room.setup.scenario) == running
            assert (room.setup.scenario in ("stand", "sit")) == running
            assert bool(room.status.logged) == running
            takes = [kind for kind, _ in room.log if kind in ("record", "end")]
            if running:
                assert takes[-1] == "record"
    finally:
        room.service.close()
    assert [event.what for event in room.store.events] == room.names("event")
    times = [event.at_ns for event in room.store.events]
    assert times == sorted(times)
    # Labels of a task stand between its events, so that what is labelled was running.
    since = None
    for kind, what in room.log:
        if kind == "event" and what in ("started", "resumed"):
            since = what
        elif kind == "setup" and what.scenario:
            assert since is not None
        elif kind == "setup":
            since = None


def test_an_interrupted_session_goes_on_paused_with_its_take(room: Room) -> None:
    room.do("begin", participant="P01")
    room.do("next")
    room.do("next")
    room.wait(1.2)
    wait_until("it is kept", lambda: room.store.saved is not None and room.store.saved.at_ns > 100 * S)
    saved = msgspec.json.decode(msgspec.json.encode(room.store.saved), type=StudyState)
    other = Room(saved)
    try:
        other.now_ns = room.now_ns + 60 * S
        assert other.service.go_on() == "participant P01 goes on at stand (paused)"
        assert other.names("record") == ["P01-side-by-side.mcap"]
        assert other.names("event") == ["interrupted"]
        assert other.status.phase == "paused"
        assert other.status.elapsed_s == pytest.approx(1.2, abs=0.3)
        other.do("resume")
        assert other.setup.scenario == "stand"
    finally:
        other.service.close()


def finish_a_task(room: Room, results: int) -> None:
    """Begin the present task from its instruction, and end it after so many results."""
    room.do("next")
    room.results += results
    while room.status.phase == "running":
        room.do("next", forced="yes")


def ends(room: Room) -> list[str]:
    wait_until("all is kept", lambda: room.store.saved is not None and room.store.saved.phase == "between")
    return [event.note.rpartition("; ")[2] for event in room.store.events if event.what == "finished"]


def test_a_task_during_which_nobody_was_tracked_is_noted_at_its_end(room: Room) -> None:
    room.do("begin", participant="P01")
    room.do("next")
    finish_a_task(room, results=0)
    assert ends(room) == [NOTHING_TRACKED]
    assert [run.empty for run in valid_runs(room.store.events)] == [True]
    room.do("repeat")
    finish_a_task(room, results=1)
    wait_until("it is kept", lambda: [run.attempt for run in valid_runs(room.store.events)] == [2])
    assert empty_runs(room.store.events) == ()


def test_results_of_all_parts_of_an_interrupted_task_count(room: Room) -> None:
    room.do("begin", participant="P01")
    room.do("next")
    room.do("next")
    room.results += 1
    room.do("pause")
    room.results += 5  # nobody's
    room.do("resume")
    while room.status.phase == "running":
        room.do("next", forced="yes")
    assert ends(room) == [""]


def test_results_in_a_pause_do_not_count(room: Room) -> None:
    room.do("begin", participant="P01")
    room.do("next")
    room.do("next")
    room.do("pause")
    room.results += 5
    room.do("resume")
    while room.status.phase == "running":
        room.do("next", forced="yes")
    assert ends(room) == [NOTHING_TRACKED]


def test_a_take_that_was_ended_properly_gets_a_second_one(room: Room) -> None:
    room.do("begin", participant="P01")
    room.closed = "P01-side-by-side.mcap"
    room.do("next")
    assert room.names("record") == ["P01-side-by-side-again.mcap"]


@given(waits=st.lists(st.floats(0.001, 0.09), min_size=1, max_size=30))
@settings(max_examples=20, deadline=None)
def test_what_is_shown_follows_the_time_and_is_not_made_for_each_frame(waits: list[float]) -> None:
    room = Room()
    try:
        room.do("begin", participant="P01")
        room.do("next")
        room.do("next")
        began_ns, made = room.now_ns, set()
        for seconds in waits:
            room.now_ns += round(seconds * S)
            room.service.beat()
            made.add(room.status)
            assert room.status.elapsed_s == pytest.approx((room.now_ns - began_ns) / S, abs=0.1001)
        assert len(made) <= 2 + (room.now_ns - began_ns) // (S // 10)
    finally:
        room.service.close()


def test_the_map_shows_where_the_first_step_begins_before_the_task(room: Room) -> None:
    room.do("begin", participant="P01")
    assert room.status.block.here == ()
    room.do("next")
    assert room.status.phase == "instruction"
    assert (room.status.block.here, room.status.block.next) == (("middle",), ())
    assert [point.name for point in room.status.block.points] == ["middle", "front"]
    while room.status.plan[room.status.part].title != "sit":
        room.do("next", forced="yes")
    assert [point.name for point in room.status.block.points] == ["middle"]  # points of other tasks are left out


def test_a_tone_is_that_of_the_step_and_at_the_end_that_of_the_last(room: Room) -> None:
    room.do("begin", participant="P01")
    heard = []
    for _ in range(20):
        room.do("next", forced="yes")
        heard.append((room.status.plan[room.status.part].title, room.status.phase, room.status.tone_hz))
        if room.status.phase == "between" and room.status.part == 1:
            break
    assert heard == [
        ("stand", "instruction", None), ("stand", "running", None), ("stand", "running", None),
        ("stand", "between", None),
        ("sit", "instruction", None), ("sit", "running", 880), ("sit", "between", 880),
    ]  # fmt: skip


def test_without_an_interrupted_session_nothing_goes_on(room: Room) -> None:
    assert room.service.go_on() == ""


def test_no_thread_is_left() -> None:
    before = threading.active_count()
    room = Room()
    room.do("begin", participant="P01")
    room.service.close()
    assert threading.active_count() == before
    assert room.store.saved is not None
    assert asdict(room.setup) == asdict(
        Setup("stand-still", sensors_expected=2, participant=1, placement="side-by-side")
    )
