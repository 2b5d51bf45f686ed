from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.standing_people import (
    KINECT,
    RIGHT_HAND,
    RIGHT_SHOULDER,
    inverse,
    moved,
    see,
    sensor_at,
    somebody,
    without,
)

from mocapella.errors import SettingsError, WireError
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.model.depth import depth_frame
from mocapella.model.observations import Arrival, BodyFrame, JointState
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import SensorPose
from mocapella.schema import encode_scene
from mocapella.tracker import Tracker, make_tracker, methods_making
from mocapella.tracker.method import METHODS
from mocapella.tracker.stand_still import StandStillTracker, StandStillTrackerSettings

ME, YOU = somebody(0), somebody(1)
FRONT, SIDE, BACK = sensor_at(0.1), sensor_at(1.4, distance=3.0), sensor_at(3.0, across=-0.4)
QUICK = {"frames": 3}


def run(tracker: Tracker, arrivals: Iterable[Arrival]) -> list[Scene]:
    return [tracker.update(arrival) for arrival in arrivals]


def standing(frames: range, *people: np.ndarray, **sensors: np.ndarray) -> list[Arrival]:
    return [see(name, T, people, frame) for frame in frames for name, T in sensors.items()]


def tracking(*people: np.ndarray, **sensors: np.ndarray) -> Tracker:
    tracker = make_tracker("stand-still", sensors_expected=len(sensors), settings=QUICK)
    last = run(tracker, standing(range(4), *people, **sensors))[-1]
    assert last.state.phase is Phase.TRACKING
    return tracker


def test_one_person_seen_without_noise_is_found_to_the_micrometre_also_when_walking() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE, back=BACK)
    for frame in range(4, 40):
        step = rigid(rotation_about_y(0.1 * frame), [0.05 * frame, 0, 0.02 * frame])
        truth = moved(apply(step, ME), RIGHT_HAND, 0.3 * np.sin(frame))
        scene = run(tracker, standing(range(frame, frame + 1), truth, front=FRONT, side=SIDE, back=BACK))[-1]
        (person,) = scene.people
        np.testing.assert_allclose(person.positions, truth, atol=1e-6)
        assert [view.sensor for view in person.views] == ["back", "front", "side"]
        for view, T_sensor_world in zip(person.views, (BACK, FRONT, SIDE), strict=True):
            np.testing.assert_allclose(view.T_world_sensor, inverse(T_sensor_world), atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(0.5, 4.5), st.floats(-2, 2), st.floats(-1, 1))
def test_turning_and_moving_a_sensor_changes_nothing_in_the_world(
    yaw: float, distance: float, across: float, height: float
) -> None:
    elsewhere = sensor_at(yaw, distance, across, height)
    one = tracking(ME, front=FRONT, side=SIDE).update(see("front", FRONT, [YOU], 9)).people[0]
    other = tracking(ME, front=FRONT, side=elsewhere).update(see("front", FRONT, [YOU], 9)).people[0]
    np.testing.assert_allclose(other.positions, one.positions, atol=5e-6)
    np.testing.assert_allclose(other.views[1].positions, one.views[1].positions, atol=5e-6)


def test_a_joint_that_one_sensor_cannot_see_is_filled_by_the_other() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE)
    truth = moved(ME, RIGHT_HAND, 0.5)
    tracker.update(see("side", SIDE, [truth], 4))
    (person,) = tracker.update(see("front", FRONT, [truth], 4, states=without(RIGHT_HAND))).people
    np.testing.assert_allclose(person.positions[RIGHT_HAND], truth[RIGHT_HAND], atol=1e-6)
    assert person.states[RIGHT_HAND] == JointState.TRACKED
    guessed = without(RIGHT_HAND)
    guessed[0, RIGHT_HAND] = JointState.INFERRED
    (person,) = tracker.update(see("front", FRONT, [ME], 5, states=guessed)).people
    np.testing.assert_allclose(person.positions[RIGHT_HAND], truth[RIGHT_HAND], atol=1e-6)
    (person,) = tracker.update(see("side", SIDE, [ME], 5, states=without(RIGHT_HAND))).people
    np.testing.assert_allclose(person.positions[RIGHT_HAND], ME[RIGHT_HAND], atol=1e-6)
    assert person.states[RIGHT_HAND] == JointState.INFERRED
    (person,) = tracker.update(see("front", FRONT, [ME], 6, states=without(RIGHT_HAND))).people
    assert person.states[RIGHT_HAND] == JointState.NOT_TRACKED
    assert np.isnan(person.positions[RIGHT_HAND]).all()


def test_a_person_is_shown_from_any_sensor_also_from_one_that_has_lost_them() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE)
    truth = moved(ME, RIGHT_HAND, 0.5)
    tracker.update(see("side", SIDE, [truth], 4))
    (person,) = tracker.update(see("front", FRONT, [], 4)).people
    np.testing.assert_allclose(person.seen_from("side"), apply(SIDE, truth), atol=1e-6)
    np.testing.assert_allclose(person.seen_from("front"), apply(FRONT, truth), atol=1e-6)
    assert person.seen_from("back") is None
    lost = person.view_of("front")
    assert lost is not None
    assert not lost.states.any()
    assert np.isnan(lost.positions).all()


def test_somebody_whom_a_sensor_lost_and_found_again_is_the_same_person() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE)
    walked = ME + np.array([0.8, 0, 0.3])
    run(tracker, [see("front", FRONT, [], 4), see("side", SIDE, [walked], 4)])
    scene = tracker.update(see("front", FRONT, [walked], 5, ids=[7]))
    assert (scene.state.phase, tracker.report.calibrations) == (Phase.TRACKING, 1)
    (person,) = scene.people
    assert (person.id, [view.tracking_id for view in person.views]) == (0, [7, 1])
    np.testing.assert_allclose(person.views[0].positions, walked, atol=1e-6)


def test_somebody_new_is_not_taken_for_whom_the_sensor_lost() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE)
    run(tracker, [see("front", FRONT, [], 4), see("side", SIDE, [ME], 4)])
    scene = tracker.update(see("front", FRONT, [ME + np.array([1.5, 0, 0])], 5, ids=[7]))
    assert (scene.state.phase, scene.state.reason) == (Phase.CALIBRATING, "front: a new person arrived")
    strict = make_tracker("stand-still", settings={**QUICK, "regain_within_m": 0})
    run(strict, standing(range(4), ME, front=FRONT))
    assert strict.update(see("front", FRONT, [ME], 5, ids=[7])).state.phase is Phase.CALIBRATING


def test_a_body_that_could_not_be_placed_has_no_view_and_disturbs_nobody() -> None:
    tracker = make_tracker("stand-still", settings=QUICK)
    hidden = without(RIGHT_SHOULDER, 2)
    scene = run(tracker, [see("front", FRONT, [ME, YOU], frame, states=hidden) for frame in range(4)])[-1]
    assert scene.state.phase is Phase.TRACKING
    assert [[view.tracking_id for view in person.views] for person in scene.people] == [[1]]
    np.testing.assert_allclose(scene.people[0].positions, ME, atol=1e-6)


def test_two_people_who_differ_in_shape_are_told_apart_and_both_stand_at_the_origin() -> None:
    tall = YOU * [1.0, 1.6, 1.0]
    here, there = ME + np.array([0.5, 0, 0.2]), tall - np.array([0.6, 0, 0.3])
    tracker = tracking(here, there, front=FRONT, side=SIDE)
    arrival = see("side", SIDE, [there, here], 4, ids=[2, 1])
    scene = tracker.update(arrival)
    assert [person.id for person in scene.people] == [0, 1]
    assert [[view.tracking_id for view in person.views] for person in scene.people] == [[1, 1], [2, 2]]
    for person, shape in zip(scene.people, (ME, tall), strict=True):
        np.testing.assert_allclose(person.positions, shape, atol=1e-6)  # the known flaw of the method


def test_who_is_who_does_not_depend_on_which_sensor_spoke_first() -> None:
    tall = YOU * [1.0, 1.6, 1.0]
    one = run(
        make_tracker("stand-still", sensors_expected=3, settings=QUICK),
        standing(range(6), ME, tall, a=FRONT, b=SIDE, c=BACK),
    )
    other = run(
        make_tracker("stand-still", sensors_expected=3, settings=QUICK),
        standing(range(6), ME, tall, c=BACK, a=FRONT, b=SIDE),
    )

    def who(scene: Scene) -> list[list[tuple[str, int]]]:
        return [[(view.sensor, view.tracking_id) for view in person.views] for person in scene.people]

    assert who(one[-1]) == who(other[-1]) == [[("a", 1), ("b", 1), ("c", 1)], [("a", 2), ("b", 2), ("c", 2)]]


def test_the_states_of_a_session() -> None:
    tracker = make_tracker("stand-still", sensors_expected=2, settings=QUICK)
    scene = tracker.update(see("front", FRONT, [ME], 0))
    assert (scene.state.phase, scene.state.sensors_missing) == (Phase.WAITING_FOR_SENSORS, 1)
    scene = tracker.update(see("side", SIDE, [ME], 0))
    assert (scene.state.phase, scene.state.frames_remaining, scene.state.frames_wanted) == (Phase.CALIBRATING, 3, 3)
    scene = run(tracker, standing(range(1, 5), ME, front=FRONT, side=SIDE))[-1]
    assert (scene.state.phase, len(scene.people)) == (Phase.TRACKING, 1)
    scene = run(tracker, standing(range(5, 6), front=FRONT, side=SIDE))[-1]
    assert (scene.state.phase, scene.state.reason) == (Phase.NEEDS_RECALIBRATION, "all people have left")
    assert scene.people == ()
    scene = run(tracker, standing(range(6, 7), ME, front=FRONT, side=SIDE))[-1]
    assert (scene.state.phase, scene.state.reason) == (Phase.CALIBRATING, "side: a new person arrived")


def test_a_sensor_that_falls_silent_leaves_the_fusion_and_comes_back_as_it_was() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE)
    scene = tracker.update(see("front", FRONT, [ME], 60))
    assert (scene.state.phase, scene.state.reason) == (Phase.TRACKING, "side: silent")
    assert [view.sensor for view in scene.people[0].views] == ["front"]
    scene = tracker.update(see("side", SIDE, [YOU], 61))
    assert (scene.state.phase, scene.state.reason) == (Phase.TRACKING, "")
    np.testing.assert_allclose(scene.people[0].view_of("side").positions, YOU, atol=1e-6)  # type: ignore[union-attr]


def test_a_node_that_was_started_again_has_new_tracking_ids() -> None:
    tracker = tracking(ME, front=FRONT)
    scene = tracker.update(see("front", FRONT, [ME], 0, at=5, node_id=2))
    assert (scene.state.phase, scene.state.reason) == (Phase.CALIBRATING, "front: its node was started again")


def test_a_frame_that_cannot_be_used_is_counted_and_leaves_the_scene_as_it_was() -> None:
    tracker = tracking(ME, front=FRONT)
    before = tracker.update(see("front", FRONT, [ME], 5))
    late = tracker.update(see("front", FRONT, [YOU], 4))
    assert late.people is before.people
    assert (late.step, late.sequence, late.state) == (before.step + 1, 4, before.state)
    tracker.update(see("front", FRONT, [YOU], 5))
    tracker.update(see("front", FRONT, [YOU], 5))
    report = tracker.report
    assert (report.frames, report.kept, report.calibrations, report.restarts) == (8, 5, 1, 0)
    assert report.rejected == {"time goes backwards": 1, "repeats the time of the frame before": 2}


def test_recalibrating_keeps_the_number_of_who_stays() -> None:
    tracker = tracking(ME, front=FRONT)
    tracker.recalibrate("somebody pressed the button")
    scene = tracker.update(see("front", FRONT, [ME], 5))
    assert (scene.state.phase, scene.state.reason, scene.people) == (
        Phase.CALIBRATING,
        "somebody pressed the button",
        (),
    )
    scene = run(tracker, standing(range(6, 9), ME, front=FRONT))[-1]
    assert [person.id for person in scene.people] == [0]
    elsewhere = ME + np.array([2.0, 0, 0])
    scene = run(tracker, [see("front", FRONT, [elsewhere], frame, ids=[7]) for frame in range(9, 13)])[-1]
    assert [person.id for person in scene.people] == [1]


def test_the_same_arrivals_give_the_same_bytes_also_after_a_reset() -> None:
    rng = np.random.default_rng(7)
    arrivals = []
    for frame in range(60):
        people = [ME + rng.normal(scale=0.004, size=ME.shape), YOU + rng.normal(scale=0.004, size=YOU.shape)]
        shown = people[: 1 + (frame > 20)] if frame < 45 else []
        arrivals += [see(name, T, shown, frame) for name, T in (("front", FRONT), ("side", SIDE), ("back", BACK))]
    tracker = make_tracker("stand-still", sensors_expected=3, settings=QUICK)
    first = [encode_scene(scene) for scene in run(tracker, arrivals)]
    tracker.reset()
    assert [encode_scene(scene) for scene in run(tracker, arrivals)] == first
    other = make_tracker("stand-still", sensors_expected=3, settings=QUICK)
    assert [encode_scene(scene) for scene in run(other, arrivals)] == first
    assert {scene.state.phase for scene in run(other, arrivals[:1])} == {Phase.NEEDS_RECALIBRATION}


def eventful_session() -> list[Arrival]:
    """Two people, one of whom a sensor cannot place; losses, a new tracking id, a silent sensor, everybody gone."""
    arrivals = []
    for frame in range(30):
        here, there = ME + np.array([0.01 * frame, 0, 0]), YOU - np.array([0.8, 0, 0])
        lost = 10 <= frame < 15
        ids = [2] if lost else [2, 1 if frame < 10 else 7]
        arrivals.append(see("front", FRONT, [there] if lost else [there, here], frame, ids=ids))
        if not 18 <= frame < 22:
            arrivals.append(see("side", SIDE, [here, there], frame, states=without(RIGHT_SHOULDER, 2)))
    late = [see(name, T, [], 90 + i) for i in range(3) for name, T in (("front", FRONT), ("side", SIDE))]
    return [*arrivals, see("front", FRONT, [YOU, ME], 80, ids=[2, 7]), *late]


def test_a_tracker_that_is_given_anothers_memory_goes_on_as_it_would_have() -> None:
    arrivals = eventful_session()
    tracker = make_tracker("stand-still", sensors_expected=2, settings=QUICK)
    memories, scenes = [], []
    for arrival in arrivals:
        memories.append(tracker.snapshot())
        scenes.append(encode_scene(tracker.update(arrival)))
    for step, memory in enumerate(memories):
        other = make_tracker("stand-still", sensors_expected=2, settings=QUICK)
        other.restore(memory)
        assert [encode_scene(scene) for scene in run(other, arrivals[step : step + 8])] == scenes[step : step + 8]


@pytest.mark.parametrize("method", methods_making("people"))
def test_images_that_are_sent_for_the_take_change_nothing(method: str) -> None:
    tracker, alone = (make_tracker(method, sensors_expected=1) for _ in range(2))
    for frame in range(3):
        (arrival,) = standing(range(frame, frame + 1), ME, front=FRONT)
        image = depth_frame("depth.depth", np.ones((2, 2), np.uint16), unit_m=0.001, lens=[2, 2, 1, 1], time_ns=frame)
        before, after = tracker.update(arrival), tracker.update(Arrival(image, arrival.at_ns))
        assert encode_scene(msgspec.structs.replace(before, step=0)) == encode_scene(
            msgspec.structs.replace(alone.update(arrival), step=0)
        )
        assert (after.sensor, after.people, after.state) == ("depth.depth", before.people, before.state)
    skeletons = BodyFrame in METHODS.find(method).frame_types  # else they are rejected, and the images are kept
    assert (tracker.report.frames, tracker.report.kept) == (6, 6 if skeletons else 3)
    assert all(reason.startswith("it sends skeletons") for reason in tracker.report.rejected)
    tracker.update(Arrival(msgspec.structs.replace(image, sensor="depth"), arrival.at_ns))
    assert "which no method uses" in " ".join(tracker.report.rejected)


def test_what_is_no_memory_of_a_tracker_is_refused() -> None:
    with pytest.raises(WireError, match="no memory of this tracker"):
        make_tracker("stand-still").restore(b"nothing")


def test_scenes_are_not_changed_by_later_steps() -> None:
    tracker = tracking(ME, front=FRONT, side=SIDE)
    scene = tracker.update(see("front", FRONT, [ME], 5))
    before = encode_scene(scene)
    run(tracker, standing(range(6, 10), YOU, front=FRONT, side=SIDE))
    assert encode_scene(scene) == before


def test_a_views_tilt_and_height_are_what_was_set_up_or_else_what_the_frame_says() -> None:
    poses = {"side": SensorPose(tilt=0.2, height=1.5)}
    tracker = make_tracker("stand-still", sensors_expected=2, settings=QUICK, sensors=poses)
    (person,) = run(tracker, standing(range(4), ME, front=FRONT, side=SIDE))[-1].people
    assert [(view.tilt, view.height) for view in person.views] == [(0.0, 0.0), (0.2, 1.5)]


def test_the_default_is_the_thesis() -> None:
    tracker = StandStillTracker()
    wanted = tracker.settings
    assert (wanted.frames, wanted.still_within_m, wanted.compare_with) == (120, 0.1, "previous")
    assert (wanted.max_distance_m, wanted.silent_after_s) == (np.inf, 1.0)
    scenes = run(tracker, standing(range(120), ME, front=FRONT))
    assert [scene.state.phase for scene in scenes[-2:]] == [Phase.CALIBRATING, Phase.TRACKING]
    assert scenes[-1].topology is KINECT


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"method": "stand-stil"}, r"unknown tracking method 'stand-stil'; known: .*did you mean stand-still\?"),
        ({"settings": {"frame": 3}}, r"settings of stand-still: unknown key 'frame'; .*did you mean frames\?"),
        ({"settings": {"frames": "many"}}, r"settings of stand-still: Expected `int`"),
        ({"settings": {"compare_with": "next"}}, r"settings of stand-still: .*next"),
        ({"settings": {"max_distance_m": 0.0}}, r"max_distance_m is 0.0; it must be greater than 0 m"),
        ({"settings": {"regain_within_m": -1.0}}, r"regain_within_m is -1.0; it must be 0 m or more"),
        ({"settings": {"silent_after_s": 0.0}}, r"silent_after_s is 0.0; it must be above 0"),
        ({"sensors_expected": 0}, r"sensors_expected is 0; it must be 1 or more"),
    ],
)
def test_what_cannot_be_made_is_refused_with_what_can(how: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_tracker(**{"method": "stand-still", **how})  # type: ignore[arg-type]


def test_every_method_makes_a_tracker_that_answers_a_frame() -> None:
    for method in methods_making("people"):
        scene = make_tracker(method).update(see("front", FRONT, [ME], 0))
        assert (scene.step, scene.sensor) == (0, "front")


def test_the_page_on_the_method_lists_every_setting_with_its_default() -> None:
    page = (Path(__file__).parents[2] / "docs" / "methods" / "stand-still.md").read_text(encoding="utf-8")
    rows = [[cell.strip(" `") for cell in line.split("|")[1:3]] for line in page.splitlines() if line.startswith("| `")]
    written = {name: default for name, default in rows if name.isidentifier()}
    fields = dataclasses.fields(StandStillTrackerSettings)
    assert list(written) == [field.name for field in fields]
    for field in fields:
        said = written[field.name]
        if isinstance(field.default, str):
            assert said == field.default
        else:
            assert float(said.replace("no limit", "inf")) == field.default
