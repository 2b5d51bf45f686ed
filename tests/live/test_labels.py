"""Other labels (participant, placement, scenario) restart nothing: people keep ids and names, and takes replay."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.programs import free_port, wait_until

import mocapella
from mocapella.live.recorded import track_again
from mocapella.live.recordings import open_recording
from mocapella.live.server import Server, ServerSettings
from mocapella.live.session import Session
from mocapella.live.track_again import Changes
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import PLACEMENTS, SCENARIOS, Setup
from mocapella.recording.take import trackers_of
from mocapella.recording.take_reader import read_take
from mocapella.schema import encode_scene
from mocapella.sources.simulate import SimulatedSensor, load_scene, merge
from mocapella.wire.node import NodeLink
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

SETUP = Setup("stand-still", sensors_expected=2)
SETTINGS = {"frames": 30}


def arrivals(seconds: float = 3.0) -> list[Arrival]:
    room = load_scene("obstacle")
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names[:2]]
    return [Arrival(item.frame, item.truth.room_ns) for item in merge(sensors, 0.0, seconds)]


ARRIVALS = arrivals()
LABELS = st.builds(
    dict,
    participant=st.integers(0, 99),
    placement=st.sampled_from(["", *PLACEMENTS]),
    scenario=st.sampled_from(["", *SCENARIOS]),
)


@given(changes=st.dictionaries(st.integers(0, len(ARRIVALS) - 1), LABELS, max_size=5))
@settings(max_examples=10, deadline=None)
def test_scenes_are_the_same_to_the_bit_whatever_labels_are_given_meanwhile(changes: dict[int, dict[str, Any]]) -> None:
    plain, labelled = Session(SETUP, SETTINGS), Session(SETUP, SETTINGS)
    for number, arrival in enumerate(ARRIVALS):
        if number in changes:
            labelled.carry_out("setup", asdict(replace(SETUP, **changes[number])))
            assert labelled.setup == replace(SETUP, **changes[number])
        one, other = plain.step(arrival), labelled.step(arrival)
        assert one is not None
        assert other is not None
        assert encode_scene(one) == encode_scene(other)
    assert labelled.trackers == 1


@pytest.mark.parametrize("other", [{"method": "default"}, {"sensors_expected": 3}, {"sensors": {"a": {"height": 1.0}}}])
def test_what_is_no_label_makes_a_new_tracker(other: dict[str, Any]) -> None:
    session = Session(SETUP, SETTINGS)
    session.carry_out("name", {"person": 0, "name": "Ada"})
    session.carry_out("setup", {**asdict(SETUP), **other})
    assert session.trackers == 2
    assert session.names == {}


def test_a_session_says_its_labels() -> None:
    session = Session(SETUP, SETTINGS)
    words = session.carry_out("setup", asdict(replace(SETUP, participant=7, placement="right-90", scenario="walk")))
    assert words == "labelled: participant 7, right-90, walk"
    assert session.carry_out("setup", asdict(SETUP)) == "labelled: no labels"


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A take of a server that got other labels twice, while people were tracked; one of them has a name."""
    folder = tmp_path_factory.mktemp("takes")
    address = f"tcp/127.0.0.1:{free_port()}"
    server = Server(ServerSettings(address, takes=folder, setup=SETUP, method_settings=SETTINGS))
    names = sorted({arrival.frame.sensor for arrival in ARRIVALS})
    with ExitStack() as stack:
        stack.callback(server.close)
        links = {name: stack.enter_context(NodeLink(address, name)) for name in names}
        reader = open_reader(address)
        stack.callback(reader.close)  # type: ignore[no-untyped-call]
        wait_until("both nodes join", lambda: all(link.join() for link in links.values()))

        def command(verb: str, arguments: dict[str, Any] | None = None) -> None:
            reply = send_command(reader, verb, arguments or {}, 20.0)
            assert reply.ok, reply.message

        def send(some: list[Arrival]) -> None:
            for arrival in some:
                before = server.summary.frames_in
                links[arrival.frame.sensor].publish(arrival.frame)
                wait_until("a frame is tracked", lambda before=before: server.summary.frames_in > before)  # type: ignore[misc]

        command("record", {"name": "walk"})
        send(ARRIVALS[:100])
        assert server.status().phase == Phase.TRACKING.value
        command("name", {"person": 0, "name": "Ada"})
        for scenario, some in (("walk", ARRIVALS[100:130]), ("steps", ARRIVALS[130:])):
            command("setup", asdict(replace(SETUP, participant=7, scenario=scenario)))
            assert server.status().setup.scenario == scenario
            send(some)
            assert server.status().phase == Phase.TRACKING.value
        command("record-stop")
    return folder / "walk.mcap"


def test_other_labels_are_a_run_of_the_same_tracker(take: Path) -> None:
    found = read_take(take)
    assert [(run.info.setup.scenario, run.info.continues) for run in found.runs] == [
        ("", False), ("walk", True), ("steps", True),
    ]  # fmt: skip
    assert trackers_of(found.runs) == {0: 0, 1: 0, 2: 0}
    steps = [scene.step for _, scene in found.scenes()]
    assert steps == list(range(len(ARRIVALS)))
    assert [len(list(found.scenes(run))) for run in range(3)] == [100, 30, len(ARRIVALS) - 130]


def test_the_take_replays_to_the_bit(take: Path) -> None:
    notes = open_recording(take).replay(lambda scene: None).notes
    assert notes["recorded_scenes"] == len(ARRIVALS)
    assert notes["differing_scenes"] == 0
    assert notes["problems"] == []


def test_people_keep_names_and_places_in_files(take: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    assert set(people.individuals) == {"Ada", "person_0", "person_1"}
    ada, other = people.of("Ada"), people.of("person_1")
    for run in (1, 2):
        assert ada.present[ada.runs == run].all()
        assert other.present[other.runs == run].all()
    assert [people.labels[run]["scenario"] for run in range(3)] == ["", "walk", "steps"]


def test_tracked_again_it_has_one_tracker_and_replays(take: Path, tmp_path: Path) -> None:
    scenes: list[tuple[int, Scene]] = []
    recording = open_recording(take, Changes(settings={"frames": 25}))
    runs = recording.runs_to_track()
    found = track_again(recording, runs, lambda run, scene: scenes.append((run, scene)), tmp_path / "b.mcap")
    assert [run for run, _ in scenes] == sorted(run for run, _ in scenes)
    assert {run for run, _ in scenes} == {0, 1, 2}
    assert found.notes["unusable"] == {}
    late = [scene for run, scene in scenes if run]
    assert {scene.state.phase for scene in late} == {Phase.TRACKING}
    assert late[-1].step == len(ARRIVALS) - 1
    assert {person.name for person in late[-1].people} == {"Ada", ""}
    notes = open_recording(tmp_path / "b.mcap").replay(lambda scene: None).notes
    assert notes["differing_scenes"] == 0
