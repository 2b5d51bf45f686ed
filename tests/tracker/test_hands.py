"""The method hands: markers of two cameras become a hand and what it holds; frames that cannot be used are refused."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
import pytest
from support.hand_frames import (
    CUBE,
    HZ,
    IN_PALM,
    hands_settings,
    landmarks_at,
    palm_at,
    scene,
    seen_by,
    tracker,
    watched,
)
from support.standing_people import see, sensor_at, somebody

from mocapella.errors import SettingsError, WireError
from mocapella.geometry.rigid import inverse, rigid, rotation_about_x
from mocapella.model.arms import ArmFrame
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.depth import depth_frame
from mocapella.model.hand import TIPS
from mocapella.model.hand_file import encode_hand_shape
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Phase, Scene
from mocapella.schema import decode_scene, encode_scene
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings
from mocapella.tracker import make_tracker
from mocapella.tracker.hands import HandsSettings, HandsTracker, ObjectSettings

ALL = (*scene().names, *CUBE.markers)
APART = rigid(rotation_about_x(0.4), [0.2, 0.05, -0.25])
"""``T_world_cube`` of a cube that no finger reaches."""


def run(made: HandsTracker, arrivals: Iterable[Arrival]) -> list[Scene]:
    return [made.update(arrival) for arrival in arrivals]


def bits(scenes: Iterable[Scene]) -> list[bytes]:
    return [encode_scene(made) for made in scenes]


def at_s(made: Scene) -> float:
    return (made.at_ns - 1) / 1e9


def test_a_moving_hand_that_two_cameras_see_in_turn_is_found_and_followed() -> None:
    scenes = run(tracker(), watched(0, 60))
    assert [made.state.phase for made in scenes[:3]] == [Phase.WAITING_FOR_SENSORS, Phase.TRACKING, Phase.TRACKING]
    assert [made.step for made in scenes] == list(range(120))
    assert {hand.id for made in scenes for hand in made.hands} == {0}
    away, states = [], []
    for made in scenes[20:]:
        (hand,) = made.hands
        assert not hand.left
        assert scene().model.within(hand.angles)
        away.append(np.linalg.norm(hand.landmarks - landmarks_at(at_s(made)), axis=-1))
        states.append(hand.states[list(TIPS)])
        assert made.points is not None
        assert made.points.names == scene().names
        assert (made.points.cameras == 2).all()
        np.testing.assert_allclose(made.points.positions[:5], hand.landmarks[list(TIPS)], atol=0.003)
    assert np.max(np.array(away)[:, list(TIPS)]) < 0.002
    assert np.median(away) < 0.01  # knuckles follow from habit
    assert np.mean(np.array(states) == JointState.TRACKED) > 0.99


def test_smoothing_comes_between_points_and_hand() -> None:
    plain, smooth = (
        run(tracker(smoothing=how), watched(0, 40))[-1] for how in (None, OneEuroSettings(min_cutoff_hz=1.0))
    )
    assert plain.points is not None
    assert smooth.points is not None
    lag = np.linalg.norm(plain.points.positions - smooth.points.positions, axis=-1)
    assert (lag > 1e-4).all()
    (hand,) = smooth.hands
    np.testing.assert_allclose(hand.landmarks[list(TIPS)], smooth.points.positions[:5], atol=0.004)


def test_smoothing_in_the_pictures_is_each_cameras_filter_before_the_rays() -> None:
    how, filters = OneEuroSettings(2.0, 0.05, per_component=True), {}
    arrivals = [*watched(0, 20), *watched(20, 25, hidden=("red",)), *watched(25, 40)]

    def filtered(arrival: Arrival) -> Arrival:
        frame = arrival.frame
        assert isinstance(frame, MarkerFrame)
        one = filters.setdefault(frame.sensor, OneEuro(how))
        px = one.update(frame.positions_px.astype(float), arrival.at_ns / 1e9).astype(np.float32)
        return Arrival(msgspec.structs.replace(frame, positions_px=px), arrival.at_ns)

    plain, ours, by_hand = (
        run(made, of)
        for made, of in (
            (tracker(), arrivals),
            (tracker(smoothing_2d=how), arrivals),
            (tracker(), map(filtered, arrivals)),
        )
    )
    for other, one, two in zip(plain[20:], ours[20:], by_hand[20:], strict=True):
        assert other.points is not None
        assert one.points is not None
        assert two.points is not None
        np.testing.assert_allclose(one.points.positions, two.points.positions, atol=1e-6)
        assert np.linalg.norm(one.points.positions - other.points.positions, axis=-1).max() > 1e-4  # it is late


def test_where_the_cameras_stand_is_told() -> None:
    (made,) = run(tracker(), watched(0, 1))[-1:]
    assert [place.sensor for place in made.sensors] == ["left", "right"]
    for place in made.sensors:
        eye = scene().cameras[place.sensor]
        assert place.T_world_sensor is not None
        np.testing.assert_allclose(place.T_world_sensor[:3, 3], eye.position_m, atol=1e-12)
        forward = np.subtract(eye.looks_at_m, eye.position_m)
        np.testing.assert_allclose(place.T_world_sensor[:3, 2], forward / np.linalg.norm(forward), atol=1e-12)
        np.testing.assert_allclose(place.T_world_sensor[:3, 1], [0, 1, 0], atol=1e-12)
        assert np.linalg.det(place.T_world_sensor[:3, :3]) == pytest.approx(1.0)


def test_the_order_of_a_frames_markers_and_others_in_it_do_not_matter() -> None:
    def turned(arrival: Arrival) -> Arrival:
        f, order = arrival.frame, [3, 0, 5, 1, 4, 2]
        assert hasattr(f, "positions_px")
        names = (*(f.names[i] for i in order), "black")
        px = np.concatenate([f.positions_px[order], [[100.0, 100.0]]])
        sd = np.append(f.sd_px[order], np.float32(0.1))
        frame = marker_frame(f.sensor, names, time_ns=f.time_ns, size_px=f.size_px, positions_px=px, sd_px=sd,
                             sequence=f.sequence)  # fmt: skip
        return Arrival(frame, arrival.at_ns)

    arrivals = list(watched(0, 10))
    assert bits(run(tracker(), arrivals)) == bits(run(tracker(), map(turned, arrivals)))


def test_the_same_arrivals_give_the_same_scenes_and_reset_is_as_newly_made() -> None:
    arrivals = list(watched(0, 15, in_palm=IN_PALM))
    how = {"smoothing": OneEuroSettings(), "smoothing_2d": OneEuroSettings(3.0, 0.1)}
    made = tracker(CUBE, **how)
    first = bits(run(made, arrivals))
    assert bits(run(tracker(CUBE, **how), arrivals)) == first
    made.update(see("left", sensor_at(0.0), [somebody()], 1))
    made.reset()
    assert (made.report.frames, made.report.rejected) == (0, {})
    assert bits(run(made, arrivals)) == first


@pytest.mark.parametrize("begun", [0, 1, 24])
def test_what_is_restored_goes_on_to_the_bit_alike(begun: int) -> None:
    def new() -> HandsTracker:
        return tracker(CUBE, smoothing=OneEuroSettings(), smoothing_2d=OneEuroSettings(3.0, 0.1))

    arrivals = [*watched(0, 10, in_palm=IN_PALM), *watched(10, 16, in_palm=IN_PALM, hidden=CUBE.markers)]
    made, later = new(), new()
    run(made, arrivals[:begun])
    made.update(see("left", sensor_at(0.0), [somebody()], 1))
    memory = made.snapshot()
    run(later, watched(30, 33))  # is forgotten
    later.restore(memory)
    assert later.report == made.report
    assert later.snapshot() == memory
    assert bits(run(later, arrivals[begun:])) == bits(run(made, arrivals[begun:]))
    assert later.snapshot() == made.snapshot()


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["closed-form", "fabrik", "newton"])
def test_a_solver_changes_the_hand_and_goes_on_to_the_bit_alike(solver: str) -> None:
    arrivals = list(watched(0, 12, in_palm=IN_PALM))
    usual, made, later = tracker(CUBE), tracker(CUBE, solver=solver), tracker(CUBE, solver=solver)
    assert bits(run(made, arrivals[:10])) != bits(run(usual, arrivals[:10]))
    later.restore(made.snapshot())
    assert bits(run(later, arrivals[10:])) == bits(run(made, arrivals[10:]))


def test_bytes_that_are_no_snapshot_are_refused() -> None:
    other = make_tracker("stand-still").snapshot()
    for data in (b"", b"\x93\x01", other):
        with pytest.raises(WireError):
            tracker().restore(data)


def test_scenes_go_through_the_codec() -> None:
    made = run(tracker(CUBE), watched(0, 12, in_palm=IN_PALM))[-1]
    assert (len(made.hands), len(made.objects)) == (1, 1)
    back = decode_scene(encode_scene(made))
    assert encode_scene(back) == encode_scene(made)
    np.testing.assert_array_equal(back.hands[0].landmarks, made.hands[0].landmarks)
    assert back.hands[0].holds == made.hands[0].holds == "cube"
    np.testing.assert_array_equal(back.objects[0].T_world_object, made.objects[0].T_world_object)


def frame_of(arrival: Arrival, **changed: Any) -> Arrival:
    return Arrival(msgspec.structs.replace(arrival.frame, **changed), arrival.at_ns)


NEXT = seen_by("left", 6 / HZ)


@pytest.mark.parametrize(
    ("arrival", "reason"),
    [
        (
            see("left", sensor_at(0.0), [somebody()], 1),
            "sends skeletons, which the method hands does not use: .*default",
        ),
        (
            Arrival(ArmFrame("left", 0, 0, 6, 6, (2, 2), np.ones(9), "m", ()), 6),
            "it sends arms, .*set up arms or default",
        ),
        (
            Arrival(depth_frame("left", np.ones((2, 2), np.uint16), unit_m=0.001, lens=np.ones(9), time_ns=6), 6),
            "it sends depth, which no method uses",
        ),
        (frame_of(NEXT, sensor="lft"), "the rig has no camera 'lft'; it has .*left"),
        (frame_of(NEXT, size_px=(320, 240)), "its images are 320 × 240, the rig's 640 × 480"),
        (frame_of(NEXT, names=("a", "b", "c", "d", "e", "f")), "none of its markers is wanted: .*red"),
        (seen_by("left", 4 / HZ), "time goes backwards"),
        (seen_by("left", 5 / HZ), "repeats the time of the frame before"),
    ],
)
def test_a_frame_that_cannot_be_used_is_counted_and_changes_nothing(arrival: Arrival, reason: str) -> None:
    made, other = tracker(), tracker()
    before, _ = (run(one, watched(0, 6))[-1] for one in (made, other))
    refused = made.update(arrival)
    assert (refused.step, refused.sensor, refused.sequence) == (12, arrival.frame.sensor, arrival.frame.sequence)
    assert refused.state == before.state
    np.testing.assert_array_equal(refused.hands[0].landmarks, before.hands[0].landmarks)
    (told,) = made.report.rejected
    assert re.search(reason, told)
    assert (made.report.frames, made.report.kept, made.report.rejected[told]) == (13, 12, 1)
    for here, there in zip(run(made, watched(6, 8)), run(other, watched(6, 8)), strict=True):
        assert encode_scene(msgspec.structs.replace(here, step=there.step)) == encode_scene(there)


def test_a_new_process_of_a_camera_may_begin_at_any_time_of_its_own_clock() -> None:
    made = tracker()
    run(made, watched(0, 6))
    frame = seen_by("left", 6 / HZ, node_id=7)
    made.update(frame_of(frame, time_ns=1))
    made.update(frame_of(seen_by("left", 7 / HZ, node_id=7), time_ns=2))
    assert made.report.rejected == {}
    made.update(frame_of(seen_by("left", 8 / HZ, node_id=7), time_ns=2))
    assert made.report.rejected == {"repeats the time of the frame before": 1}


def test_a_camera_that_is_silent_is_waited_for_until_it_speaks() -> None:
    made = tracker()
    assert run(made, watched(0, 6))[-1].state.phase is Phase.TRACKING
    alone = run(made, (seen_by("left", k / HZ) for k in range(6, 80)))
    silent = [made for made in alone if made.state.phase is Phase.WAITING_FOR_SENSORS]
    assert {made.state.sensors_missing for made in silent} == {1}
    assert at_s(silent[0]) == pytest.approx(5.5 / HZ + 1.0, abs=1.01 / HZ)
    assert silent[-1] is alone[-1]
    assert made.update(seen_by("right", 80 / HZ)).state.phase is Phase.TRACKING


def test_recalibrating_finds_the_hand_anew_and_says_why() -> None:
    made = tracker()
    run(made, watched(0, 6))
    made.recalibrate("somebody asked")
    first, second = run(made, watched(6, 7))
    assert (first.state.phase, first.state.reason) == (Phase.WAITING_FOR_SENSORS, "somebody asked")
    assert (second.state.phase, second.state.reason) == (Phase.TRACKING, "")
    assert (first.step, first.hands) == (12, ())
    assert [hand.id for hand in run(made, watched(7, 14))[-1].hands] == [1]


def test_without_any_marker_there_is_no_hand() -> None:
    for smoothing in (None, OneEuroSettings()):
        scenes = run(tracker(CUBE, smoothing=smoothing), watched(0, 3, hidden=ALL, cube=APART))
        for made in scenes:
            assert made.hands == ()
            assert made.points is not None
            assert np.isnan(made.points.positions).all()
            assert (made.objects[0].T_world_object, made.objects[0].state) == (None, JointState.NOT_TRACKED)


def test_a_hand_that_goes_is_lost_and_comes_back_as_another() -> None:
    made = tracker()
    assert [hand.id for hand in run(made, watched(0, 10))[-1].hands] == [0]
    gone = run(made, watched(10, 65, hidden=ALL))
    assert len(gone[0].hands) == 1  # for a moment it is where it moves to
    assert gone[-1].hands == ()
    assert gone[-1].points is not None
    assert np.isnan(gone[-1].points.positions).all()
    assert (gone[-1].points.cameras == 0).all()
    back = run(made, watched(65, 75))[-1]
    assert [hand.id for hand in back.hands] == [1]
    away = np.linalg.norm(back.hands[0].landmarks - landmarks_at(at_s(back)), axis=-1)
    assert away[list(TIPS)].max() < 0.002


def test_a_marker_that_is_hidden_is_inferred_and_the_hand_stays() -> None:
    made = tracker()
    run(made, watched(0, 20))
    last = run(made, watched(20, 45, hidden=["green"]))[-1]
    (hand,) = last.hands
    assert hand.id == 0
    assert hand.states[TIPS[2]] == JointState.INFERRED
    assert last.points is not None
    assert last.points.cameras[2] == 0
    assert hand.sd[TIPS[2]] > 3 * hand.sd[TIPS[1]]


def test_a_thing_with_three_markers_is_tracked_apart_from_the_hand() -> None:
    for made in run(tracker(CUBE), watched(0, 30, cube=APART))[20:]:
        (cube,) = made.objects
        assert (cube.name, cube.state) == ("cube", JointState.TRACKED)
        assert cube.T_world_object is not None
        np.testing.assert_allclose(cube.T_world_object[:3, 3], APART[:3, 3], atol=0.002)
        np.testing.assert_allclose(cube.T_world_object[:3, :3], APART[:3, :3], atol=0.05)
        assert made.hands[0].holds == ""
        np.testing.assert_allclose(np.abs(cube.outline), 0.5 * CUBE.size_m[0])


def test_a_thing_that_is_hidden_stays_where_it_was_seen_last() -> None:
    made = tracker(CUBE)
    seen = run(made, watched(0, 20, cube=APART))[-1].objects[0]
    hidden = run(made, watched(20, 70, cube=APART, hidden=CUBE.markers))[-1].objects[0]
    assert (seen.state, hidden.state) == (JointState.TRACKED, JointState.INFERRED)
    assert seen.T_world_object is not None
    assert hidden.T_world_object is not None
    # Its markers are predicted for a moment before they are lost.
    np.testing.assert_allclose(hidden.T_world_object[:3, 3], seen.T_world_object[:3, 3], atol=0.02)
    np.testing.assert_allclose(hidden.T_world_object[:3, :3], seen.T_world_object[:3, :3], atol=0.15)


def test_a_thing_that_is_held_goes_with_the_palm_while_it_is_hidden_and_is_let_go() -> None:
    made = tracker(CUBE)
    scenes = run(made, watched(0, 20, in_palm=IN_PALM))
    held = [one.hands[0].holds == "cube" for one in scenes if one.hands]
    assert not held[0]
    assert held[-1]
    hidden = run(made, watched(20, 70, in_palm=IN_PALM, hidden=CUBE.markers))
    states = [one.objects[0].state for one in hidden]
    assert states == sorted(states, reverse=True)
    assert states.count(JointState.TRACKED) < 0.1 * 2 * HZ
    assert states[-1] == JointState.INFERRED
    hidden = hidden[round(0.35 * 2 * HZ) :]  # until then its own markers are predicted
    carried, ways = [], []
    for one in hidden:
        (hand,), (cube,) = one.hands, one.objects
        assert hand.holds == "cube"
        assert hand.T_world_palm is not None
        assert cube.T_world_object is not None
        carried.append(inverse(hand.T_world_palm) @ cube.T_world_object)
        ways.append(cube.T_world_object[:3, 3] - (palm_at(at_s(one)) @ IN_PALM)[:3, 3])
    np.testing.assert_allclose(carried, np.broadcast_to(carried[0], (len(carried), 4, 4)), atol=1e-9)
    assert np.linalg.norm(ways, axis=-1).max() < 0.03
    apart = run(made, watched(70, 100, cube=APART))[-1]
    assert apart.hands[0].holds == ""
    assert apart.objects[0].state == JointState.TRACKED
    np.testing.assert_allclose(apart.objects[0].T_world_object[:3, 3], APART[:3, 3], atol=0.003)


def test_markers_that_do_not_fit_the_thing_are_not_believed() -> None:
    larger = tuple(tuple(3.0 * x for x in place) for place in CUBE.places_m)
    other = msgspec.convert({"name": "x", "markers": CUBE.markers, "places_m": larger}, ObjectSettings)
    (thing,) = run(tracker(other), watched(0, 10, cube=APART))[-1].objects
    assert (thing.state, thing.T_world_object) == (JointState.NOT_TRACKED, None)


def test_the_method_is_made_of_files_texts() -> None:
    texts = {"rig": encode_camera_rig(scene().rig), "hand": encode_hand_shape(scene().shape).decode()}
    values = {"base_places_m": [list(p) for p in hands_settings().base_places_m], "middle_sd_px": 0.0}
    made = make_tracker("hands", settings={**texts, **values}, sensors_expected=2)
    away = []
    for arrival in watched(0, 10):
        last = made.update(arrival)
    away = np.linalg.norm(last.hands[0].landmarks - landmarks_at(at_s(last)), axis=-1)
    assert away[list(TIPS)].max() < 0.002


def test_without_a_rig_the_method_says_what_to_do() -> None:
    with pytest.raises(SettingsError, match=r"--method hands --rig RIG\.toml"):
        make_tracker("hands")
    with pytest.raises(SettingsError, match=r"settings of hands: unknown key 'bse'; known: .*base"):
        make_tracker("hands", settings={"rig": encode_camera_rig(scene().rig), "bse": ["cyan"]})


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"base": ("red",)}, "each marker's name once"),
        ({"objects": (CUBE, CUBE)}, "each marker's name once"),
        ({"base": ()}, "at least one marker of the hand's base"),
        ({"base_places_m": ((0.0, 0.0, 0.0),) * 2}, "one place for each of cyan"),
        ({"middle_sd_px": -0.1}, "middle_sd_px"),
        ({"middle_sd_px": np.nan}, "middle_sd_px"),
        ({"solver": "fabric"}, "one of map, closed-form, .*did you mean fabrik"),
        ({"silent_after_s": 0.0}, "silent_after_s"),
        ({"silent_after_s": 4000.0}, "silent_after_s"),
    ],
)
def test_settings_that_cannot_be_are_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        HandsSettings(**changed)


def test_more_base_markers_than_have_usual_places_want_places() -> None:
    with pytest.raises(SettingsError, match="1 to 4"):
        HandsTracker(scene().rig, HandsSettings(base=("a", "b", "c", "d", "e")))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"name": ""}, "1 to 80 characters"),
        ({"name": 81 * "x"}, "1 to 80 characters"),
        ({"markers": ("a", "b"), "places_m": CUBE.places_m[:2]}, "three or more, each once"),
        ({"markers": ("a", "b", "a")}, "three or more, each once"),
        ({"places_m": CUBE.places_m[:2]}, "one for each of 3 markers"),
        ({"places_m": ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.001))}, "not on a line"),
        ({"places_m": ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (np.nan, 0.1, 0.0))}, "places_m"),
        ({"size_m": (0.1, 0.0, 0.1)}, "above 0, up to 5 m"),
        ({"size_m": (0.1, 6.0, 0.1)}, "above 0, up to 5 m"),
    ],
)
def test_things_that_cannot_be_are_refused(changed: dict[str, Any], said: str) -> None:
    given = {"name": CUBE.name, "markers": CUBE.markers, "places_m": CUBE.places_m, **changed}
    with pytest.raises(SettingsError, match=said):
        ObjectSettings(**given)


def test_cameras_that_are_swapped_are_said_to_be_and_a_replay_from_the_middle_says_so_too() -> None:
    def swapped(start: int, stop: int) -> Iterable[Arrival]:
        other = {"left": "right", "right": "left"}
        for one in watched(start, stop):
            frame = msgspec.structs.replace(one.frame, sensor=other[one.frame.sensor])
            yield Arrival(frame, one.at_ns)

    made = tracker()
    (last,) = run(made, swapped(0, 60))[-1:]
    assert last.state.reason.startswith("left and right seem to be swapped")
    again = tracker()
    again.restore(made.snapshot())
    assert bits(run(made, swapped(60, 70))) == bits(run(again, swapped(60, 70)))
    assert run(tracker(), watched(0, 60))[-1].state.reason == ""
