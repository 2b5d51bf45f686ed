from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.walking_people import BACK, FRONT, KINECT_V2, LEFT, MIRROR, SIDE, Walker, errors, standing_at

from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.errors import SettingsError, WireError
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.bodies import Bodies
from mocapella.model.observations import Arrival, JointState, body_frame
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import SensorPose
from mocapella.schema import encode_scene
from mocapella.testing.walking import frame_of, walking_arrivals
from mocapella.tracker import make_tracker
from mocapella.tracker.arrivals import Heard
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.default_settings import DefaultSettings
from mocapella.tracker.people import SMOOTHING, People, PeopleSettings

PLACES = {"front": FRONT, "side": SIDE}
RATE = 30.0


def seen(bodies: Bodies, t: float, sequence: int, ids: Mapping[int, int] | None = None) -> Arrival:
    """A frame as it arrives; ``ids`` gives bodies other tracking ids."""
    return Arrival(frame_of(bodies, round(1e9 * t), sequence, ids), round(1e9 * t))


def frames(
    walkers: Mapping[int, Walker],
    seconds: float,
    places: Mapping[str, np.ndarray] = PLACES,
    begin: float = 0.0,
    **how: float,
) -> list[Arrival]:
    """What sensors see of people, in the order of capture."""
    return walking_arrivals(walkers, seconds, places, begin_s=begin, **how)


def run(tracker: DefaultTracker, arrivals: Sequence[Arrival]) -> list[Scene]:
    return [tracker.update(arrival) for arrival in arrivals]


def in_world(scene: Scene, truth: np.ndarray) -> np.ndarray:
    """The truth told in the world of the scene: its floor is found, so it may lie elsewhere than ours."""
    place = next(place for place in scene.sensors if place.sensor == "front")
    assert place.T_world_sensor is not None
    return apply(place.T_world_sensor @ inverse(FRONT), truth)


def told(places: Mapping[str, np.ndarray] = PLACES, settings: DefaultSettings | None = None) -> DefaultTracker:
    """A tracker that is told where the sensors stand."""
    tracker = DefaultTracker(settings, sensors_expected=len(places))
    tracker.start_from(places)
    return tracker


def test_sensors_find_each_other_from_somebody_who_walks_and_the_skeleton_is_where_the_person_is() -> None:
    tracker = DefaultTracker(sensors_expected=2)
    walker = Walker()
    arrivals = frames({1: walker}, 9.0, noise=0.01)
    scenes = run(tracker, arrivals)
    assert scenes[0].state.phase is Phase.WAITING_FOR_SENSORS
    assert Phase.CALIBRATING in {scene.state.phase for scene in scenes}
    assert scenes[-1].state.phase is Phase.TRACKING
    found = {place.sensor: place.T_world_sensor for place in scenes[-1].sensors if place.T_world_sensor is not None}
    metres, radians = errors(inverse(found["front"]) @ found["side"], inverse(FRONT) @ SIDE)
    assert metres < 0.03
    assert radians < np.radians(1.0)
    (person,) = scenes[-1].people
    off = np.linalg.norm(person.positions - in_world(scenes[-1], walker.at(arrivals[-1].at_ns / 1e9)), axis=-1)
    assert np.median(off) < 0.05
    assert person.sd is not None
    assert (person.sd > 0).all()


def test_the_same_frames_give_the_same_scenes_to_the_bit_and_a_snapshot_goes_on_alike() -> None:
    arrivals = frames({1: Walker(), 2: Walker(centre=(0.8, 3.4), phase=2.0)}, 4.0, noise=0.01)
    one, other = told(), told()
    first = [encode_scene(scene) for scene in run(one, arrivals[:150])]
    assert first == [encode_scene(scene) for scene in run(other, arrivals[:150])]
    restored = DefaultTracker(sensors_expected=2)
    restored.restore(one.snapshot())
    rest = [encode_scene(scene) for scene in run(one, arrivals[150:])]
    assert rest == [encode_scene(scene) for scene in run(restored, arrivals[150:])]
    one.reset()
    one.start_from(PLACES)
    assert first == [encode_scene(scene) for scene in run(one, arrivals[:150])]


def test_what_is_no_snapshot_is_refused() -> None:
    with pytest.raises(WireError):
        DefaultTracker().restore(b"\x93\x01\x02\x03")


def test_people_keep_their_numbers_where_they_cross_and_where_a_sensor_swaps_its_ids() -> None:
    places = {"front": FRONT, "side": SIDE, "left": LEFT}
    people = {1: Walker(phase=0.0), 2: Walker(centre=(0.0, 3.5), phase=np.pi), 3: Walker(centre=(1.9, 3.2), speed=0.4)}
    tracker = told(places)
    numbers: dict[int, set[int]] = {1: set(), 2: set(), 3: set()}
    for k, arrival in enumerate(frames(people, 8.0, places, noise=0.01)):
        if arrival.frame.sensor == "front" and k > 300:
            arrival.frame.tracking_ids[:] = [{1: 2, 2: 1}.get(int(body), body) for body in arrival.frame.tracking_ids]
        scene = tracker.update(arrival)
        for person in scene.people:
            near = {
                who: np.linalg.norm(in_world(scene, walker.at(arrival.at_ns / 1e9))[0] - person.positions[0])
                for who, walker in people.items()
            }
            numbers[min(near, key=lambda who: near[who])].add(person.id)
    assert all(len(given) == 1 for given in numbers.values()), numbers


def test_somebody_whom_one_sensor_sees_is_a_person_and_who_is_seen_no_more_is_predicted_and_then_gone() -> None:
    walker = Walker()
    tracker = told()
    run(tracker, frames({1: walker}, 2.0, noise=0.005))
    alone = [arrival for arrival in frames({1: walker}, 1.0, begin=2.0, noise=0.005) if arrival.frame.sensor == "side"]
    (person,) = run(tracker, alone)[-1].people
    assert [view.sensor for view in person.views] == ["side"]
    assert (person.states == JointState.TRACKED).all()
    empty = frames({}, 2.0, begin=3.0)
    scenes = run(tracker, empty)
    sd = [scene.people[0].sd for scene in scenes[:20] if scene.people]
    assert all((scene.people[0].states == JointState.INFERRED).all() for scene in scenes[10:20])
    assert (sd[-1] > sd[8]).all()
    assert not scenes[-1].people


@pytest.mark.parametrize("shown_for_s", [0.5, 1.0])
def test_who_is_seen_no_more_is_told_of_for_as_long_as_is_set_and_no_longer(shown_for_s: float) -> None:
    places = {"front": FRONT}
    tracker = told(places, DefaultSettings(shown_for_s=shown_for_s))
    run(tracker, frames({1: Walker()}, 2.0 + 1 / RATE, places))  # the last one is at 2 s
    scenes = run(tracker, frames({}, 2.0, places, begin=2.0 + 1 / RATE))
    assert sum(bool(scene.people) for scene in scenes) == round(shown_for_s * RATE)


def test_a_body_that_is_thrown_about_as_it_is_lost_does_not_take_the_person_along() -> None:
    walker, rng = Walker(), np.random.default_rng(5)
    tracker = told()
    run(tracker, frames({1: walker}, 2.0, noise=0.005))
    place = tracker.update(frames({1: walker}, 0.02, begin=2.0)[0]).people[0].positions
    for k, arrival in enumerate(frames({1: walker}, 0.3, begin=2.05)):
        arrival.frame.positions[:] += (0.04 * k if k < 3 else rng.uniform(0.3, 1.0)) * np.float32(1)
        tracker.update(arrival)
    (person,) = run(tracker, frames({}, 0.5, begin=2.4))[-1].people
    assert np.linalg.norm(person.positions - place, axis=-1).max() < 0.5


def test_a_joint_that_no_sensor_sees_is_inferred_with_growing_uncertainty_and_follows_the_body() -> None:
    tracker, walker = told(), Walker()
    hand = KINECT_V2.index("HandRight")
    run(tracker, frames({1: walker}, 3.0, noise=0.005))
    unsure = []
    for arrival in frames({1: walker}, 0.6, begin=3.0, noise=0.005):
        arrival.frame.states[:, hand] = JointState.NOT_TRACKED
        arrival.frame.positions[:, hand] = np.nan
        scene = tracker.update(arrival)
        (person,) = scene.people
        unsure.append(person.sd[hand])
    assert person.states[hand] == JointState.INFERRED
    assert unsure[-1] > 1.2 * unsure[2]
    assert np.linalg.norm(person.positions[hand] - in_world(scene, walker.at(arrival.at_ns / 1e9))[hand]) < 0.3


def test_a_sensor_that_mirrors_labels_is_repaired_and_told_of() -> None:
    """Somebody who walks an eight is seen from behind half of the time, with the labels of a front view."""
    tracker, walker = told(), Walker()
    arrivals, wrong, told_wrong, mirrored = frames({1: walker}, 9.0, noise=0.01), 0, 0, []
    shoulders = [KINECT_V2.index("ShoulderLeft"), KINECT_V2.index("ShoulderRight")]
    for arrival in arrivals:
        truth = walker.at(arrival.at_ns / 1e9)
        across = apply(inverse(PLACES[arrival.frame.sensor]), truth)[shoulders, 0]
        from_behind = bool(across[0] > across[1])
        if from_behind:  # a sensor calls the left side right
            arrival.frame.positions[:] = arrival.frame.positions[:, MIRROR]
        scene = tracker.update(arrival)
        if scene.people and arrival.at_ns > 4e9:
            view = scene.people[0].view_of(arrival.frame.sensor)
            mirrored.append(view.mirrored)
            told_wrong += view.mirrored != from_behind
            left, right = scene.people[0].positions[shoulders]
            true_left, true_right = in_world(scene, truth)[shoulders]
            wrong += bool((left - right) @ (true_left - true_right) < 0)
    assert wrong < 0.1 * len(arrivals)
    assert told_wrong < 0.1 * len(mirrored)
    assert set(mirrored) == {False, True}


def test_bones_keep_their_lengths() -> None:
    tracker = told()
    parents, children = (list(ends) for ends in zip(*KINECT_V2.bones, strict=True))
    lengths = []
    for scene in run(tracker, frames({1: Walker()}, 5.0, noise=0.02))[120:]:
        positions = scene.people[0].positions
        lengths.append(np.linalg.norm(positions[parents] - positions[children], axis=-1))
    spread = np.std(lengths, axis=0) / np.mean(lengths, axis=0)
    assert spread.mean() < 0.03


@pytest.mark.parametrize("smoothing", SMOOTHING)
def test_each_way_of_smoothing_follows_and_steadies(smoothing: str) -> None:
    settings = {"people": {"smoothing": smoothing, "facing": None}}
    tracker = make_tracker("default", sensors_expected=2, settings=settings)
    assert isinstance(tracker, DefaultTracker)
    tracker.start_from(PLACES)
    walker = Walker(speed=0.0)
    off = []
    for arrival, scene in zip(arrivals := frames({1: walker}, 4.0, noise=0.02), run(tracker, arrivals), strict=True):
        if arrival.at_ns > 2e9:
            off.append(scene.people[0].positions - in_world(scene, walker.at(arrival.at_ns / 1e9)))
    assert np.sqrt(np.mean(np.square(off))) < 0.015


def test_an_unknown_smoothing_is_refused_with_what_there_is() -> None:
    with pytest.raises(SettingsError, match="did you mean kalman"):
        make_tracker("default", settings={"people": {"smoothing": "kalmann"}})


def test_a_snapshot_holds_a_sensor_layout_by_the_names_of_earlier_takes() -> None:
    walked = told()
    run(walked, frames({1: Walker()}, 8.0))
    layout = walked.layout()
    assert layout is not None
    tracker = make_tracker("default", sensors_expected=2)
    assert isinstance(tracker, DefaultTracker)
    tracker.use_layout(layout)
    run(tracker, frames({1: Walker()}, 0.2))
    data = tracker.snapshot()
    _, parts = msgspec.msgpack.decode(data)
    calibration = dict(parts[5][1])
    kind, fields = calibration["rig"]
    assert "layout" not in calibration
    assert kind == "Rig"
    assert {sensor[0] for _, sensor in fields["sensors"][1]} == {"RigSensor"}
    assert {pair[0] for pair in fields["pairs"][1]} == {"RigPair"}
    assert [pair[1]["told"] for _, pair in calibration["_pairs"][1]] == ["rig"]
    again = make_tracker("default", sensors_expected=2)
    again.restore(data)
    assert again.snapshot() == data
    assert isinstance(again, DefaultTracker)
    assert again._calibration.layout == layout


def test_frames_that_cannot_be_used_are_counted_and_change_nothing() -> None:
    tracker = told()
    arrivals = frames({1: Walker()}, 1.0, noise=0.01)
    last = run(tracker, arrivals)[-1]
    before = tracker.snapshot()
    again = tracker.update(arrivals[-2])
    assert tracker.report.rejected == {"repeats the time of the frame before": 1}
    np.testing.assert_array_equal(again.people[0].positions, last.people[0].positions)
    tracker._steps -= 1
    tracker._rejected.clear()
    assert tracker.snapshot() == before


def spoilt(arrival: Arrival, how: str) -> Arrival:
    frame = arrival.frame
    if how == "joints at the origin":
        frame.positions[:] = 0.0
    elif how == "not finite":
        frame.positions[:] = np.nan
        frame.states[:] = JointState.NOT_TRACKED
    elif how == "flickers":
        nobody = np.empty((0, 25, 3))
        empty = body_frame(frame.sensor, KINECT_V2, time_ns=frame.time_ns, positions=nobody)
        return Arrival(empty, arrival.at_ns) if frame.sequence % 2 else arrival
    elif how == "on a line":
        frame.positions[..., 1:] = 1.0
    elif how == "far away":
        frame.positions[:] *= 1e6
    return arrival


@pytest.mark.parametrize("how", ["joints at the origin", "not finite", "flickers", "on a line", "far away"])
def test_one_sensor_that_sends_nonsense_does_not_take_the_person_away(how: str) -> None:
    tracker, walker = told(), Walker()
    run(tracker, frames({1: walker}, 3.0, noise=0.01))
    for arrival in frames({1: walker}, 2.0, begin=3.0, noise=0.01):
        scene = tracker.update(spoilt(arrival, how) if arrival.frame.sensor == "side" else arrival)
        truth = in_world(scene, walker.at(arrival.at_ns / 1e9))
        assert any(np.linalg.norm(person.positions[0] - truth[0]) < 0.2 for person in scene.people)
        assert all(np.isfinite(person.positions[person.states > 0]).all() for person in scene.people)


def test_nobody_jumps_when_the_sensor_in_whose_space_all_is_told_goes_silent() -> None:
    places = {"front": FRONT, "side": SIDE, "back": BACK}
    walker, tracker = Walker(), told(places)
    before = None
    for arrival in frames({1: walker}, 8.0, places, noise=0.005):
        if arrival.frame.sensor == "front" and arrival.at_ns > 3e9:
            continue
        scene = tracker.update(arrival)
        if arrival.at_ns > 2e9:
            (person,) = scene.people
            if before is not None:
                assert np.linalg.norm(person.positions[0] - before) < 0.08
            before = person.positions[0]


@pytest.mark.parametrize("first", ["front", "side"])
def test_nobody_jumps_while_a_sensor_is_placed_better_whichever_sent_the_first_frame(first: str) -> None:
    off = SIDE.copy()
    off[:3, 3] += (0.2, 0.0, -0.15)
    tracker = told({"front": FRONT, "side": off})
    arrivals = frames({1: Walker()}, 6.0, noise=0.005)
    scenes = run(tracker, [one for one in arrivals if one.frame.sensor == first or one.at_ns > 0.1e9])
    middles = np.array([scene.people[0].positions[0] for scene in scenes if scene.people])
    place = {place.sensor: place.T_world_sensor for place in scenes[-1].sensors}["side"]
    assert place is not None
    assert np.linalg.norm(place[:3, 3] - off[:3, 3]) > 0.1  # it was placed better
    assert np.linalg.norm(np.diff(middles[10:], axis=0), axis=-1).max() < 0.05


def test_what_a_sensor_has_seen_moves_with_its_place_as_that_becomes_better_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    moved: dict[str, np.ndarray] = {}
    move_sensors = People.move_sensors

    def note(people: People, sensors: Sequence[str], T_new_old: np.ndarray) -> None:
        moved.update(zip(sensors, T_new_old, strict=True))
        move_sensors(people, sensors, T_new_old)

    monkeypatch.setattr(People, "move_sensors", note)
    off = SIDE.copy()
    off[:3, 3] += (0.08, 0.03, -0.05)
    tracker, moves, before = told({"front": FRONT, "side": off}), 0, None
    for arrival in frames({1: Walker()}, 3.0, noise=0.005):
        moved.clear()
        scene = tracker.update(arrival)
        found = {place.sensor: place.T_world_sensor for place in scene.sensors if place.T_world_sensor is not None}
        if len(found) < 2:
            continue
        now = inverse(found["front"]) @ found["side"]  # people's memory is in the space of the first sensor
        if before is not None and scene.people:
            np.testing.assert_allclose(moved.get("side", np.eye(4)) @ before, now, atol=1e-9)
            moves += "side" in moved
        assert "front" not in moved
        before = now
    assert moves > 10


def test_nobody_jumps_when_the_floor_is_found() -> None:
    reported = {name: SensorPose(0.0, float(T[1, 3]) + 0.1) for name, T in PLACES.items()}
    scenes = run(DefaultTracker(sensors_expected=2, sensors=reported), frames({1: Walker()}, 6.0, noise=0.005))
    places = [next(place for place in scene.sensors if place.sensor == "front").T_world_sensor for scene in scenes[20:]]
    heights = np.array([place[1, 3] for place in places if place is not None])
    assert heights.max() - heights[0] > 0.02  # it is found elsewhere
    assert np.abs(np.diff(heights)).max() < 0.006


@pytest.mark.parametrize("elapsed", [200, 400])
def test_a_snapshot_of_poses_under_way_goes_on_alike(elapsed: int) -> None:
    off = SIDE.copy()
    off[:3, 3] += (0.08, 0.03, -0.05)
    arrivals = frames({1: Walker()}, 8.0, noise=0.005)
    one, two = told({"front": FRONT, "side": off}), DefaultTracker(sensors_expected=2)
    run(one, arrivals[:elapsed])
    two.restore(one.snapshot())
    for arrival in arrivals[elapsed:]:
        assert encode_scene(one.update(arrival)) == encode_scene(two.update(arrival))


def test_one_sensor_alone_is_enough_to_track_and_says_that_it_is_alone() -> None:
    tracker = DefaultTracker(sensors_expected=1)
    scenes = run(tracker, frames({1: Walker()}, 2.0, {"front": standing_at(0, 0)}, noise=0.01))
    assert scenes[-1].state.phase is Phase.TRACKING
    assert len(scenes[-1].people) == 1


def test_poses_approach_refined_ones_in_steps_and_what_no_frame_changes_stays_the_same_object() -> None:
    tracker = told()
    scenes = run(tracker, frames({1: Walker()}, 4.0, noise=0.01))[30:]
    moved_s, kept = [], 0
    for before, scene in itertools.pairwise(scenes):
        if scene.sensors is not before.sensors:
            moved_s.append(scene.at_ns / 1e9)
        elif before.people and scene.people:
            old = {view.sensor: view for view in before.people[0].views if view.sensor != scene.sensor}
            assert all(view is old.get(view.sensor, view) for view in scene.people[0].views)
            kept += 1
    steps = np.diff(moved_s)
    assert len(steps) > 10
    assert np.median(steps) >= 0.03
    assert kept > len(steps)


def test_people_stay_in_the_space_of_the_sensor_that_sees_them_while_others_are_tied_without_it() -> None:
    tracker = DefaultTracker(sensors_expected=3)
    run(tracker, frames({1: Walker(speed=0.0)}, 1.0, {"front": FRONT}))
    assert [person.id for person in tracker._shown] == [0]
    front = placed("front", trusted=False)
    alone, all_speak = (
        calibrated(placed("back", root="side"), placed("side", root="side"), front),
        heard_of("front", "side"),
    )
    assert tracker._choose_root(alone, all_speak) == "front"
    tracker._now_s += DefaultSettings().keep_root_s
    assert tracker._choose_root(alone, all_speak) == "back"
    tied = calibrated(*(placed(name, root="side") for name in ("back", "front", "side")))
    assert tracker._choose_root(tied, all_speak) == "side"  # who is tied to it moves along
    nobody = DefaultTracker(sensors_expected=3)
    run(nobody, frames({}, 1.0, {"front": FRONT}))
    assert nobody._choose_root(alone, all_speak) == "back"


def test_a_root_that_is_silent_for_long_is_replaced_by_a_trusted_sensor() -> None:
    tracker = DefaultTracker(sensors_expected=2)
    run(tracker, frames({1: Walker(speed=0.0)}, 1.0, {"front": FRONT}))
    two = calibrated(placed("front"), placed("side"))
    assert tracker._choose_root(two, heard_of("side")) == "front"
    tracker._now_s += DefaultSettings().keep_root_s / 2
    assert tracker._choose_root(two, heard_of("side", "front")) == "front"  # it speaks again
    tracker._now_s += DefaultSettings().keep_root_s / 2
    assert tracker._choose_root(two, heard_of("side")) == "front"
    tracker._now_s += DefaultSettings().keep_root_s + 0.1
    assert tracker._choose_root(calibrated(placed("front"), placed("side", trusted=False)), heard_of("side")) == "front"
    assert tracker._choose_root(two, heard_of("side")) == "side"


def test_people_of_a_sensor_that_left_disappear_and_those_of_another_one_are_shown_in_time() -> None:
    """The two sensors were never calibrated relative to each other."""
    tracker = DefaultTracker(DefaultSettings(keep_root_s=3.0), sensors_expected=1)
    run(tracker, frames({0: Walker()}, 2.0, {"one": FRONT}))
    scenes = run(tracker, frames({5: Walker(centre=(0.5, 3.9))}, 8.0, {"two": LEFT}, 2.5))
    shown = [
        (scene.at_ns / 1e9, [(len(one.views), int((one.states == 2).sum())) for one in scene.people])
        for scene in scenes
    ]
    assert not [at_s for at_s, people in shown if 3.6 < at_s < 5.0 and people]
    last = shown[-1][1]
    assert len(last) == 1
    assert last[0][0] == 1
    assert last[0][1] > 0


def heard_of(*names: str) -> Heard:
    """The newest frames of sensors, the first of which has sent its own now."""
    newest: dict[str, Any] = dict.fromkeys(names)
    return Heard("", names[0], False, newest)


def calibrated(*sensors: CalibratedSensor) -> PeopleState:
    return PeopleState({one.sensor: one for one in sensors}, (), False, 0, 0)


def placed(name: str, root: str = "", trusted: bool = True) -> CalibratedSensor:
    """A sensor at the origin of its root's world."""
    return CalibratedSensor(name, np.eye(4), np.eye(6), root or name, None, trusted, "", "")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("silent_after_s", 0),
        ("shown_for_s", 3601),
        ("keep_root_s", -1),
        ("people.view_age_s", 0),
        ("people.noise_memory_s", 0),
        ("people.turn_s", -0.1),
        ("people.sure_sd", 0),
        ("people.swap_s", 0),
        ("people.noise_gain", -1),
        ("people.swap_m", -0.01),
        ("people.least_worth", 0),
        ("people.least_worth", 1.1),
        ("people.smoothing", "none"),
        ("tracks.gate_m", 0),
    ],
)
def test_settings_out_of_range_are_refused_by_name(name: str, value: float | str) -> None:
    *group, field = name.split(".")
    settings = {group[0]: {field: value}} if group else {field: value}
    with pytest.raises(SettingsError, match=field):
        make_tracker("default", sensors_expected=1, settings=settings)


@pytest.mark.slow
def test_a_calibration_that_begins_again_makes_nobody_new_whichever_sensor_speaks_first() -> None:
    tracker, walker = told(), Walker()
    before = run(tracker, frames({1: walker}, 3.0, noise=0.005))
    tracker.recalibrate("asked for")
    later = frames({1: walker}, 12.0, begin=3.0, noise=0.005)
    first_of_side = next(i for i, arrival in enumerate(later) if arrival.frame.sensor == "side")
    scenes = run(tracker, later[first_of_side:])
    assert {person.id for scene in [*before[-1:], *scenes] for person in scene.people} == {0}
    assert all(len(scene.people) == 1 for scene in scenes)
    assert scenes[1].state.phase is Phase.CALIBRATING
    assert scenes[-1].state.phase is Phase.TRACKING


class Hyperextended(Walker):
    """Somebody whose left shank is 80° in front of the thigh's line from one second on, for three seconds."""

    def at(self, t: float) -> np.ndarray:
        joints = super().at(t)
        if not 1.0 < t < 4.0:
            return joints
        knee, *shank = (KINECT_V2.index(f"{part}Left") for part in ("Knee", "Ankle", "Foot"))
        across = joints[KINECT_V2.index("HipLeft")] - joints[KINECT_V2.index("HipRight")]
        turn = Rotation.from_rotvec(np.radians(-80.0) * across / np.linalg.norm(across))
        joints[shank] = joints[knee] + turn.apply(joints[shank] - joints[knee])
        return joints


def test_a_knee_beyond_the_models_limits_is_followed_and_the_scene_says_so_until_it_is_within_them() -> None:
    walker = Hyperextended(speed=0.0)
    arrivals = frames({1: walker}, 8.0, noise=0.005)
    scenes = run(told(settings=DefaultSettings(people=PeopleSettings(facing=None))), arrivals)  # the labels are right
    conditions = {arrival.at_ns / 1e9: scene.people[0].condition for arrival, scene in
                  zip(arrivals, scenes, strict=True) if scene.people}  # fmt: skip
    assert {text for at_s, text in conditions.items() if at_s < 1.0} == {""}
    assert any(text.startswith("left knee: sensors and body model disagree by") for text in conditions.values())
    assert {text for at_s, text in conditions.items() if at_s > 7.0} == {""}
    bent = max(k for k, arrival in enumerate(arrivals) if arrival.at_ns < 3.9e9)
    found, truth = scenes[bent].people[0].positions, in_world(scenes[bent], walker.at(arrivals[bent].at_ns / 1e9))
    ankle = KINECT_V2.index("AnkleLeft")
    assert np.linalg.norm(found[ankle] - truth[ankle]) < 0.06


@pytest.mark.parametrize("smoothing", SMOOTHING)
def test_a_snapshot_with_arrays_of_another_shape_is_refused(smoothing: str) -> None:
    settings = DefaultSettings(people=PeopleSettings(smoothing=smoothing))
    tracker = told(settings=settings)
    run(tracker, frames({1: Walker()}, 1.0))
    assert tracker._people is not None
    tracker._people.memory.view_positions = tracker._people.memory.view_positions[:, :, :10]
    again = DefaultTracker(settings, sensors_expected=2)
    with pytest.raises(WireError, match="view_positions"):
        again.restore(tracker.snapshot())
    assert run(again, frames({1: Walker()}, 0.1))[-1].people == ()


def test_a_snapshot_with_bodies_of_another_model_begins_them_anew() -> None:
    tracker = told()
    arrivals = frames({1: Walker()}, 2.0)
    run(tracker, arrivals[:60])
    assert tracker._people is not None
    tracker._people.memory.body = tracker._people.memory.body[:, :-7]
    again = DefaultTracker(sensors_expected=2)
    again.restore(tracker.snapshot())
    (person,) = run(again, arrivals[60:])[-1].people
    assert np.isfinite(person.positions).all()
