"""A take is raw material: tracked again, it becomes a new take with the same frames, and is never changed itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.errors import DiskFullError, InputError, SettingsError, TakeExistsError
from mocapella.live.file_take import FileTake
from mocapella.live.recorded import track_again
from mocapella.live.recordings import open_recording
from mocapella.live.session import Session
from mocapella.live.track_again import Changes
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import Setup
from mocapella.model.truth import Truth
from mocapella.recording import disk
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_reader import Take, read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene, encode_truth
from mocapella.sources.simulate import SimulatedSensor, load_scene, merge

SETUP = Setup("stand-still", sensors_expected=2, participant=7, placement="right-90", scenario="obstacle")
SETTINGS = {"frames": 30}
STARTED = TakeInfo(SETUP, 1_700_000_000_000_000_000, 0, SETTINGS)


@cache
def arrivals(seconds: float = 3.0) -> list[Arrival]:
    """Two people before two sensors, who stand, are calibrated, and begin to walk."""
    room = load_scene("obstacle")
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names[:2]]
    return [Arrival(item.frame, item.truth.room_ns) for item in merge(sensors, 0.0, seconds)]


def truths() -> list[Truth]:
    """The ground truth of the first frame."""
    room = load_scene("obstacle")
    item = next(iter(merge([SimulatedSensor(room, room.sensor_names[0])], 0.0, 0.1)))
    return [item.truth]


class Live:
    """A session that is recorded, as a server does it."""

    def __init__(self, path: Path, session: Session | None = None, info: TakeInfo = STARTED) -> None:
        self.session = session or Session(info.setup, info.method_settings)
        self.writer = TakeWriter.create(path, info=info, reserve_bytes=0)
        self.shown: Callable[[Scene], Scene] = lambda scene: scene

    def command(self, verb: str, arguments: dict[str, Any] | None = None) -> None:
        self.note(verb, arguments)
        self.session.carry_out(verb, arguments or {})

    def note(self, verb: str, arguments: dict[str, Any] | None = None) -> None:
        self.writer.write_command({"verb": verb, "arguments": arguments or {}}, 0, self.session.next_step)

    def see(self, some: list[Arrival], tracks: Callable[[int], bool] = lambda k: True) -> None:
        for k, arrival in enumerate(some):
            frame = arrival.frame
            self.writer.write_frame(
                encode_frame(frame), sensor=frame.sensor, node_id=frame.node_id, sequence=frame.sequence,
                log_ns=arrival.at_ns + 2_000_000,
            )  # fmt: skip
            scene = self.session.step(arrival) if tracks(k) else None
            if scene is not None:
                self.writer.write_scene(encode_scene(self.shown(scene)), arrival.at_ns + 3_000_000)


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A take that begins with its tracker."""
    path = tmp_path_factory.mktemp("takes") / "walk-1.mcap"
    live = Live(path)
    live.see(arrivals())
    live.writer.close()
    return path


def again(path: Path, to: Path | None, **changes: Any) -> tuple[Any, list[Scene]]:
    scenes: list[Scene] = []
    recording = open_recording(path, Changes(**changes))
    runs = recording.runs_to_track()
    return track_again(recording, runs, lambda run, scene: scenes.append(scene), to), scenes


def scene_bytes(take: Take) -> list[bytes]:
    blocks = take.scene_blocks(np.arange(take.scene_count))
    return [
        data[begin : begin + length]
        for _, data, begins, lengths in blocks
        for begin, length in zip(begins.tolist(), lengths.tolist(), strict=True)
    ]


def raw(take: Take) -> list[tuple[int, bytes]]:
    return sorted((stored.log_ns, stored.raw) for stored in take.frames())


def replays_alike(path: Path) -> bool:
    notes = open_recording(path).replay(lambda scene: None).notes
    return bool(notes["recorded_scenes"]) and not notes["differing_scenes"]


def test_without_a_change_the_results_are_the_same_and_the_recording_is_not_touched(take: Path, tmp_path: Path) -> None:
    before = take.read_bytes()
    again(take, tmp_path / "b.mcap")
    old, new = read_take(take), read_take(tmp_path / "b.mcap")
    assert scene_bytes(new) == scene_bytes(old)
    assert raw(new) == raw(old)
    assert new.clean
    assert take.read_bytes() == before


def test_with_other_settings_it_is_a_take_of_its_own_that_replays_and_names_its_origin(
    take: Path, tmp_path: Path
) -> None:
    made, scenes = again(take, tmp_path / "b.mcap", settings={"frames": 15}, placement="parallel")
    old, new = read_take(take), read_take(tmp_path / "b.mcap")
    assert made.written.scenes == len(scenes) == len(arrivals())
    assert raw(new) == raw(old)
    assert scene_bytes(new) != scene_bytes(old)
    assert replays_alike(tmp_path / "b.mcap")
    assert new.info.method_settings == {"frames": 15}
    assert new.info.setup == replace(SETUP, placement="parallel")
    assert (new.info.started_unix_ns, new.info.started_ns) == (STARTED.started_unix_ns, STARTED.started_ns)
    assert new.take_id not in ("", old.take_id)
    origin = new.info.origin
    assert origin is not None
    assert (origin.file, origin.take_id) == ("walk-1.mcap", old.take_id)
    assert origin.changes == {"settings": {"frames": 15}, "placement": "parallel"}


def test_without_a_name_nothing_is_written(take: Path) -> None:
    made, scenes = again(take, None, settings={"frames": 15})
    assert made.written is None
    assert len(scenes) == made.summary.scenes_out == len(arrivals())
    assert [path.name for path in take.parent.iterdir()] == ["walk-1.mcap"]


@pytest.mark.parametrize("stopped", [False, True])
def test_frames_that_were_not_tracked_live_are_tracked_now(stopped: bool, tmp_path: Path) -> None:
    """The tracker was too slow for two frames in three, or was stopped."""
    live = Live(tmp_path / "a.mcap")
    if stopped:
        live.command("stop")
    live.see(arrivals(), lambda k: k % 3 == 0)
    live.writer.close()
    _, scenes = again(tmp_path / "a.mcap", tmp_path / "b.mcap")
    late = 2_000_000 if stopped else 0  # their smallest latency is all that is known of the clocks
    true = [arrival.at_ns + late for arrival in arrivals()]
    np.testing.assert_allclose([scene.at_ns for scene in scenes], true, atol=200_000)  # the simulated clocks drift
    assert {Phase.CALIBRATING, Phase.TRACKING} <= {scene.state.phase for scene in scenes}
    assert replays_alike(tmp_path / "b.mcap")


def test_names_follow_the_raw_bodies_to_other_ids_and_into_the_take(tmp_path: Path) -> None:
    """In the recording people have ids that a new tracker does not give."""

    def shown(scene: Scene) -> Scene:
        people = tuple(
            msgspec.structs.replace(one, id=one.id + 10, name=f"body {one.views[0].tracking_id}")
            for one in scene.people
        )
        return scene.with_parts(people=people)

    live = Live(tmp_path / "a.mcap")
    live.see(arrivals()[:100])
    live.note("name", {"person": 10, "name": "whoever"})
    live.shown = shown
    live.see(arrivals()[100:])
    live.writer.close()
    _, scenes = again(tmp_path / "a.mcap", tmp_path / "b.mcap", settings={"frames": 20})
    assert {person.id for person in scenes[-1].people} == {0, 1}
    for person in scenes[-1].people:
        assert person.name == f"body {person.views[0].tracking_id}"
    assert not any(person.name for scene in scenes[:100] for person in scene.people)
    assert replays_alike(tmp_path / "b.mcap")
    assert [command.values["verb"] for command in read_take(tmp_path / "b.mcap").commands()] == ["name", "name"]


def test_each_run_has_a_tracker_of_its_own_and_keeps_its_recalibrations(tmp_path: Path) -> None:
    live = Live(tmp_path / "a.mcap")
    live.see(arrivals()[:100])
    live.command("recalibrate")
    live.see(arrivals()[100:150])
    live.session.carry_out("setup", {"method": "stand-still", "sensors_expected": 2, "participant": 8})
    live.writer.start_run(replace(STARTED, setup=replace(SETUP, participant=8, placement="", scenario="")))
    live.see(arrivals()[150:])
    live.writer.close()
    again(tmp_path / "a.mcap", tmp_path / "b.mcap", settings={"frames": 25})
    new = read_take(tmp_path / "b.mcap")
    assert [run.info.setup.participant for run in new.runs] == [7, 8]
    assert [command.values["verb"] for command in new.commands()] == ["recalibrate"]
    assert [command.before_step for command in new.commands()] == [100]
    assert len(list(new.scenes(1))) == len(arrivals()) - 150
    assert replays_alike(tmp_path / "b.mcap")
    tracked: list[int] = []
    recording = open_recording(tmp_path / "a.mcap", Changes(settings={"frames": 25}))
    runs = recording.runs_to_track()
    wrong = replace(runs[1], info=replace(runs[1].info, method_settings={"frames": 0}))
    with pytest.raises(SettingsError, match="frames"):
        track_again(recording, [runs[0], wrong], lambda run, scene: tracked.append(run), tmp_path / "c.mcap")
    assert tracked == []
    assert not (tmp_path / "c.mcap").exists()


def test_what_the_recording_lacks_counts_as_lost_and_other_entries_are_kept(tmp_path: Path) -> None:
    live = Live(tmp_path / "a.mcap")
    live.see([arrival for arrival in arrivals() if arrival.frame.sequence not in (3, 4)])
    truth = truths()[0]
    live.writer.write_truth(encode_truth(truth), sensor=truth.sensor, log_ns=6)
    live.writer.write_clock({"sensor": "front", "probes": [[1, 2, 3]]}, 5)
    for node in list(live.writer.accounts.nodes):
        live.writer.accounts.change(node, lambda ledger: ledger.expect(0))
        live.writer.accounts.change(node, lambda ledger: ledger.finish(ledger.heard + 2))
    live.writer.close()
    again(tmp_path / "a.mcap", tmp_path / "b.mcap")
    old, new = read_take(tmp_path / "a.mcap"), read_take(tmp_path / "b.mcap")
    assert new.complete() == old.complete()
    assert sum(node.lost for node in new.complete()) == 8
    assert list(new.clock_probes()) == list(old.clock_probes())
    assert [log_ns for log_ns, _ in new.clock_probes()] == [5]
    ((log_ns, copied),) = new.truths(truth.sensor)
    assert (log_ns, encode_truth(copied)) == (6, encode_truth(truth))


def test_after_a_frame_whose_tracking_fails_the_new_take_replays_all_the_same(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Session.step

    def failing(self: Session, arrival: Arrival) -> Scene | None:
        scene = step(self, arrival)
        if arrival.frame.sequence == 40:
            raise ValueError("odd")
        return scene

    monkeypatch.setattr(Session, "step", failing)
    made, _ = again(take, tmp_path / "b.mcap", settings={"frames": 25})
    monkeypatch.setattr(Session, "step", step)
    assert made.summary.untracked == 2
    assert replays_alike(tmp_path / "b.mcap")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("a fault")])
def test_what_ends_it_early_leaves_no_file(error: BaseException, take: Path, tmp_path: Path) -> None:
    def fail(run: int, scene: Scene) -> None:
        if scene.step == 50:
            raise error

    recording = open_recording(take)
    runs = recording.runs_to_track()
    with pytest.raises(type(error)):
        track_again(recording, runs, fail, tmp_path / "b.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_leaves_no_file_and_says_so(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocapella.live.new_take.FLUSH_BYTES", 100_000)
    free = iter([1 << 40] * 3)
    monkeypatch.setattr(disk, "free_bytes", lambda folder: next(free, 5))
    with pytest.raises(DiskFullError, match=r"0\.00 GiB are free.*; the unfinished take was removed"):
        again(take, tmp_path / "b.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_took_the_takes_place_is_left_alone(take: Path, tmp_path: Path) -> None:
    """Another program moved the unfinished take away, and wrote its own there."""
    recording, new = open_recording(take), tmp_path / "b.mcap"

    def steal(run: int, scene: Scene) -> None:
        if scene.step == 50:
            new.rename(tmp_path / "moved.mcap")
            new.write_bytes(b"mine")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track_again(recording, recording.runs_to_track(), steal, new)
    assert new.read_bytes() == b"mine"


def test_commands_and_memories_that_are_damaged_are_left_out(tmp_path: Path) -> None:
    live = Live(tmp_path / "a.mcap")
    live.note("restore", {"tracker": "AAAA", "names": [3]})
    for values in ({"verb": "recalibrate", "arguments": 7}, {"verb": None}, {}):
        live.writer.write_command(values, 0, 0)
    live.see(arrivals()[:20])
    live.writer.close()
    _, scenes = again(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert len(scenes) == 20
    assert replays_alike(tmp_path / "b.mcap")


def test_too_little_room_for_a_copy_and_a_name_in_use_are_said_before_anything(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "b.mcap").write_bytes(b"mine")
    with pytest.raises(TakeExistsError):
        again(take, tmp_path / "b.mcap")
    with pytest.raises(TakeExistsError):
        again(take, take)
    assert (tmp_path / "b.mcap").read_bytes() == b"mine"
    monkeypatch.setattr(disk, "free_bytes", lambda folder: disk.GIB + 1000)
    with pytest.raises(DiskFullError):
        again(take, tmp_path / "c.mcap")
    assert not (tmp_path / "c.mcap").exists()


def test_a_method_for_other_frames_is_refused_in_one_line(take: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it sends skeletons, which the method arms does not use: set up default or"):
        again(take, tmp_path / "b.mcap", method="arms")
    with pytest.raises(SettingsError, match="unknown key 'framse'"):
        again(take, tmp_path / "b.mcap", settings={"framse": 3})
    with pytest.raises(SettingsError, match="placement"):
        again(take, tmp_path / "b.mcap", placement="right-91")
    assert list(tmp_path.iterdir()) == []


def test_another_method_gets_no_setting_of_the_recorded_one(take: Path) -> None:
    recording = open_recording(take, Changes(method="default"))
    assert (recording.setup.method, recording.method_settings) == ("default", {})


def test_a_take_without_runs_or_of_a_missing_method_can_still_be_tracked(tmp_path: Path) -> None:
    """Only its frames are needed."""
    info = replace(STARTED, setup=replace(SETUP, method="gone"))
    live = Live(tmp_path / "a.mcap", Session(SETUP, SETTINGS), info)
    live.see(arrivals()[:30])
    live.writer.close()
    assert open_recording(tmp_path / "a.mcap").missing
    recording = open_recording(tmp_path / "a.mcap", Changes(method="stand-still"))
    assert recording.missing == []
    assert track_again(recording, recording.runs_to_track(), lambda run, scene: None).summary.scenes_out == 30


@pytest.mark.slow
def test_it_begins_with_the_poses_that_the_recorded_tracker_knew(tmp_path: Path) -> None:
    """The take begins in the middle of a session; it is too short for a calibration."""
    some = arrivals(12.0)
    setup = replace(SETUP, method="default")
    session = Session(setup)
    for arrival in some[:-30]:
        session.step(arrival)
    assert session.layout_now() is not None
    live = Live(tmp_path / "a.mcap", session, replace(STARTED, setup=setup, method_settings={}))
    live.note("restore", session.memory())
    live.see(some[-30:])
    live.writer.close()
    _, scenes = again(tmp_path / "a.mcap", tmp_path / "b.mcap", settings={"shown_for_s": 0.4})
    assert all(place.T_world_sensor is not None for place in scenes[-1].sensors)
    assert replays_alike(tmp_path / "b.mcap")
    _, scenes = again(tmp_path / "a.mcap", tmp_path / "c.mcap", recalibrate=True)
    assert any(place.T_world_sensor is None for place in scenes[-1].sensors)
    assert replays_alike(tmp_path / "c.mcap")
    layout = session.layout_now()
    _, given = again(tmp_path / "a.mcap", tmp_path / "d.mcap", layout=layout)
    assert all(place.T_world_sensor is not None for place in given[-1].sensors)
    assert replays_alike(tmp_path / "d.mcap")
    assert read_take(tmp_path / "d.mcap").info.origin.changes["layout"].startswith("of ")  # type: ignore[union-attr]
    with pytest.raises(SettingsError, match="the method stand-still starts from no sensor layout"):
        again(tmp_path / "a.mcap", None, method="stand-still", layout=layout)
    with pytest.raises(SettingsError, match="contradict each other"):
        Changes(layout=layout, recalibrate=True)


def test_a_take_of_videos_or_of_a_command_is_tracked_again_too(tmp_path: Path) -> None:
    """Such takes have the arrival's time as the time of storage, and no accounts."""
    session = Session(SETUP, SETTINGS)
    with FileTake(tmp_path / "a.mcap", SETUP, SETTINGS, reserve_bytes=0) as made:
        for arrival in arrivals()[:100]:
            scene = session.step(arrival)
            assert scene is not None
            made.write(arrival.frame, arrival, scene)
    again(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert scene_bytes(read_take(tmp_path / "b.mcap")) == scene_bytes(read_take(tmp_path / "a.mcap"))
