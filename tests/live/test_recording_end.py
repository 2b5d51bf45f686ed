"""Ends of takes, in the recording service alone: what is closed, what can go on, and what is recorded of commands."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.record_bus import NODE, Bus, frame

from mocapella.errors import NotNowError, TakeExistsError
from mocapella.live import record_path
from mocapella.live.recorder import Recorder
from mocapella.live.recording_service import RecordingService
from mocapella.live.session import Session
from mocapella.model.session import RecordingHealth, Setup
from mocapella.recording.take_reader import read_take
from mocapella.wire.keys import NodeKey


class Place:
    """A service without nodes, and what it said; `clean_up` ends whatever it left running."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.hurry = threading.Event()
        self.session = Session(Setup("stand-still"))
        self.service = RecordingService(
            self.session, Bus(), lambda: [], self.said.append, reserve_bytes=0, hurry=self.hurry
        )
        self._begun: list[tuple[Recorder, record_path.RecordPath]] = []

    def begin(self, path: Path, *, resume: bool = False, newest: dict[NodeKey, int] | None = None) -> Recorder:
        self.service.begin(path, resume=resume, newest=newest)
        recorder, requests = self.service.recorder, self.service._record_path
        assert recorder is not None
        assert requests is not None
        self._begun.append((recorder, requests))
        return recorder

    def clean_up(self) -> None:
        for recorder, requests in self._begun:
            requests.finish(0.0)
            recorder.close()


@pytest.fixture
def place() -> Iterator[Place]:
    made = Place()
    yield made
    made.clean_up()


def is_over(recorder: Recorder) -> bool:
    return not recorder._thread.is_alive()


def test_without_a_take_an_end_changes_nothing(place: Place) -> None:
    place.service.interrupt()
    place.service.leaving(NodeKey("front", 1), 3)
    place.service.record_command("start", {})
    assert place.service.finish() == place.service.health() == RecordingHealth()
    assert place.said == []
    assert not place.service.active


def test_a_finished_take_is_closed_once_and_its_result_stays(place: Place, tmp_path: Path) -> None:
    recorder = place.begin(tmp_path / "a.mcap")
    health = place.service.finish()
    assert is_over(recorder)
    assert (place.service.recorder, health.active, health.path) == (None, False, str(tmp_path / "a.mcap"))
    assert place.service.finish() == place.service.health() == health
    assert place.said == [f"recorded 0 frames in {tmp_path / 'a.mcap'}"]
    assert read_take(tmp_path / "a.mcap").clean


@pytest.mark.parametrize("hurried", [False, True])
def test_an_interrupted_take_is_closed_and_can_go_on(place: Place, tmp_path: Path, hurried: bool) -> None:
    recorder = place.begin(tmp_path / "a.mcap")
    if hurried:
        place.hurry.set()
        place.service.finish()
        place.hurry.clear()
    else:
        place.service.interrupt()
    assert is_over(recorder)
    again = place.begin(tmp_path / "a.mcap", resume=True)
    assert again.take_id == recorder.take_id
    place.service.finish()
    assert is_over(again)
    assert len(read_take(tmp_path / "a.mcap").interruptions) == 1
    with pytest.raises(TakeExistsError):  # one that is finished cannot
        place.service.begin(tmp_path / "a.mcap", resume=True)


def test_a_second_take_waits_for_the_end_of_the_first(place: Place, tmp_path: Path) -> None:
    place.begin(tmp_path / "a.mcap")
    with pytest.raises(NotNowError, match=r"already recording .*a\.mcap"):
        place.service.begin(tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()
    place.service.finish()
    place.begin(tmp_path / "b.mcap")
    assert place.service.finish().path == str(tmp_path / "b.mcap")


@pytest.mark.parametrize(
    ("verb", "makes_a_run"), [("recalibrate", False), ("start", True), ("setup", True), ("use-rig", True)]
)
def test_a_command_is_recorded_and_one_that_makes_a_new_tracker_begins_a_run(
    place: Place, tmp_path: Path, verb: str, makes_a_run: bool
) -> None:
    place.begin(tmp_path / "a.mcap")
    place.session.trackers += makes_a_run
    place.service.record_command(verb, {"some": 1}, "someone")
    place.service.finish()
    take = read_take(tmp_path / "a.mcap")
    commands = [(one.values["verb"], one.values.get("by")) for one in take.commands()]
    assert commands[0] == ("restore", None)  # of what the tracker knew at the beginning
    assert commands[1:] == ([] if makes_a_run else [(verb, "someone")])
    assert len(take.runs) == 1 + makes_a_run
    assert [run.info.continues for run in take.runs] == [False] * len(take.runs)


def test_a_setup_under_which_the_tracker_goes_on_begins_a_run_with_its_snapshot(place: Place, tmp_path: Path) -> None:
    place.begin(tmp_path / "a.mcap")
    place.service.record_command("setup", {})
    place.service.finish()
    take = read_take(tmp_path / "a.mcap")
    assert [run.info.continues for run in take.runs] == [False, True]
    assert [[one.values["verb"] for one in take.commands(run)] for run in (0, 1)] == [["restore"], ["restore"]]


@pytest.mark.parametrize("running", [True, False])
def test_a_session_that_does_not_run_is_recorded_as_stopped(place: Place, tmp_path: Path, running: bool) -> None:
    place.session.running = running
    place.begin(tmp_path / "a.mcap")
    place.session.trackers += 1
    place.service.record_command("setup", {})
    place.service.finish()
    verbs = [one.values["verb"] for one in read_take(tmp_path / "a.mcap").commands()]
    assert verbs == (["restore"] if running else ["restore", "stop", "stop"])


def test_a_new_take_begins_after_the_newest_frames_and_one_that_goes_on_has_all(place: Place, tmp_path: Path) -> None:
    def recorded(*numbers: int, resume: bool) -> int:
        recorder = place.begin(tmp_path / "a.mcap", resume=resume, newest={NODE: 4})
        for number in numbers:
            recorder.frame(NODE, frame(number), number, number)
        place.service.interrupt()
        return place.service.health().frames

    assert recorded(3, 4, 5, 6, resume=True) == 2  # there is none yet
    assert recorded(3, 7, resume=True) == 4
    assert place.service.health().active is False


def test_a_take_is_not_replaced_by_a_new_one(place: Place, tmp_path: Path) -> None:
    place.begin(tmp_path / "a.mcap")
    place.service.interrupt()
    with pytest.raises(TakeExistsError):
        place.service.begin(tmp_path / "a.mcap")
