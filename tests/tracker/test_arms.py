"""The method arms: one depth camera and two, what is fused, who stays who, and where cameras are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from support.arm_frames import FPS, LENS, arm_at, frame, places, rig, run, seen

from mocapella.calibration.sensor_layout import decode_layout, encode_layout
from mocapella.errors import SettingsError, WireError
from mocapella.geometry.rigid import apply
from mocapella.model.arms import PALM, ArmFrame, SeenArm
from mocapella.model.depth import depth_frame
from mocapella.model.hand import TIPS
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import SensorPose
from mocapella.model.topology import topology
from mocapella.schema import encode_scene
from mocapella.tracker import make_tracker
from mocapella.tracker.arm_tracks import TO_SENSOR
from mocapella.tracker.arms import ArmsSettings, ArmsTracker

RNG = np.random.default_rng
Look = Callable[[float], list[SeenArm]]


def one(camera: str, seed: int = 0, hidden: Iterable[int] = (), **other: Any) -> Look:
    rng = RNG([seed, ord(camera)])
    return lambda t: [seen(arm_at(t), camera, rng, hidden=tuple(hidden), **other)]


def errors(scene: Scene, at: int | None = None) -> Any:
    """(23,) or one, of the first arm, from what was true at the instant of the scene [m]."""
    away = np.linalg.norm(scene.arms[0].points - arm_at(1e-9 * (scene.at_ns - 1)), axis=-1)
    return away if at is None else away[at]


# One camera.


def test_an_arm_of_one_camera_is_where_it_is_in_the_sensors_own_space() -> None:
    tracker = ArmsTracker()
    arm = seen(arm_at(0.0), "a", RNG(1), noise_m=0.0)
    scene = tracker.update(frame("a", [arm], 0.0))
    assert scene.state.phase is Phase.TRACKING
    (told,) = scene.arms
    np.testing.assert_allclose(told.points, arm_at(0.0), atol=1e-12)  # the world of `places` is that of camera a
    np.testing.assert_array_equal(told.states, arm.states)
    np.testing.assert_allclose(told.points, arm.points * [-1.0, -1.0, 1.0], atol=1e-12)
    assert (told.cameras, told.person, told.left, told.gesture) == (("a",), -1, True, "open")
    assert told.T_world_palm is not None
    assert scene.sensors[0].T_world_sensor is not None
    np.testing.assert_allclose(told.T_world_palm, TO_SENSOR, atol=1e-12)
    np.testing.assert_allclose(scene.sensors[0].T_world_sensor, np.eye(4), atol=1e-12)


def test_tilt_and_height_that_are_set_up_level_the_world() -> None:
    tracker = ArmsTracker(sensors={"a": SensorPose(tilt=0.3, height=1.2)})
    ahead = np.tile([0.0, 0.0, 1.0], (23, 1))  # on the optical axis, one metre away
    scene = tracker.update(frame("a", [seen(ahead, "a", RNG(1), noise_m=0.0)], 0.0))
    np.testing.assert_allclose(scene.arms[0].points[0], [0.0, 1.2 + np.sin(0.3), np.cos(0.3)], atol=1e-12)


def test_a_camera_that_sees_nothing_says_why_and_the_arm_keeps_its_number_when_it_is_back() -> None:
    tracker = ArmsTracker()
    gone = range(20, 38)
    for k in range(60):
        t = k / FPS
        arms = [] if k in gone else [seen(arm_at(t), "a", RNG(k))]
        scene = tracker.update(frame("a", arms, t, reason="" if arms else "no hand is seen; wait"))
        if k == 22:
            assert scene.arms[0].cameras == ()
            assert scene.arms[0].states.max() == 1
            assert scene.state.reason == "a: no hand is seen, wait"
            assert errors(scene, PALM) < 0.05
        if k == 37:
            assert scene.arms == ()
            assert scene.state.phase is Phase.TRACKING
    assert [(arm.id, arm.cameras) for arm in scene.arms] == [(0, ("a",))]
    # After longer than that it is another.
    scene = tracker.update(frame("a", [seen(arm_at(9.0), "a", RNG(1))], 9.0))
    assert [arm.id for arm in scene.arms] == [1]


def test_the_predicted_arm_is_ever_less_sure() -> None:
    tracker = ArmsTracker()
    for k in range(10):
        tracker.update(frame("a", [seen(arm_at(k / FPS), "a", RNG(k))], k / FPS))
    sd = [tracker.update(frame("a", [], (10 + k) / FPS)).arms[0].sd[PALM] for k in range(5)]
    assert (np.diff(sd) > 0).all()


def test_which_side_is_decided_by_all_that_was_seen() -> None:
    tracker = ArmsTracker()
    rng = RNG(2)
    wrong = {7, 8, 20, 33}
    for k in range(40):
        arm = seen(arm_at(k / FPS), "a", rng, left=k not in wrong, left_sure=0.9)
        scene = tracker.update(frame("a", [arm], k / FPS))
        assert scene.arms[0].left
        assert scene.arms[0].id == 0
    for k in range(40, 70):
        scene = tracker.update(frame("a", [seen(arm_at(k / FPS), "a", rng, left=False, left_sure=0.9)], k / FPS))
    assert not scene.arms[0].left


def test_two_arms_of_one_camera_stay_two_when_they_touch() -> None:
    tracker = ArmsTracker()
    rng = RNG(3)
    for k in range(60):
        t = k / FPS
        apart = abs(0.4 - 0.3 * t)  # touch at 1.33 s
        both = [
            seen(arm_at(t, left, (side * max(apart, 0.02), 0, 1.0)), "a", rng, left=left, number=n)
            for n, (left, side) in enumerate(((True, -1), (False, 1)))
        ]
        scene = tracker.update(frame("a", both[:: 1 if k % 2 else -1], t))
        assert [(arm.id, arm.left) for arm in scene.arms] in ([(0, True), (1, False)], [(0, False), (1, True)])
        told = {arm.left: arm.points[PALM, 0] for arm in scene.arms}
        assert abs(told[True] - arm_at(t, True, (-max(apart, 0.02), 0, 1.0))[PALM, 0]) < 0.03


# Two cameras.


@pytest.fixture(scope="module")
def fused() -> list[Scene]:
    """Two cameras that a rig places; each has other fingertips hidden, one hides the elbow, too."""
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    looks = {"a": one("a", hidden=(4, 8, 12)), "b": one("b", hidden=(16, 20, 22))}
    return [tracker.update(arrival) for arrival in run(4.0, looks)]


def test_what_either_camera_measures_is_measured(fused: list[Scene]) -> None:
    for scene in fused[2:]:
        (arm,) = scene.arms
        assert (arm.id, arm.cameras, arm.left) == (0, ("a", "b"), True)
        assert (arm.states == 2).all()
        assert errors(scene)[list(TIPS)].max() < 0.03  # what is hidden is inferred 4 cm away
    assert fused[0].state.phase is Phase.WAITING_FOR_SENSORS
    assert fused[-1].state.phase is Phase.TRACKING


def test_points_of_both_cameras_are_better_than_those_of_one(fused: list[Scene]) -> None:
    alone = ArmsTracker()
    single = [alone.update(arrival) for arrival in run(4.0, {"a": one("a", hidden=(4, 8, 12))})]
    hand = [0, *range(5, 8), PALM]

    def rms(scenes: list[Scene], points: list[int]) -> float:
        return float(np.sqrt(np.mean([errors(scene)[points] ** 2 for scene in scenes[10:]])))

    assert rms(fused, hand) < 0.9 * rms(single, hand)
    assert rms(fused, [4, 8, 12]) < 0.3 * rms(single, [4, 8, 12])
    sd = np.mean([scene.arms[0].sd[hand] for scene in fused[10:]])
    assert 0.4 < sd / (rms(fused, hand) / np.sqrt(3)) < 2.0


def test_cameras_that_are_not_in_step_are_brought_to_one_instant() -> None:
    """A hand at 2 m/s is 33 mm further when the other camera looks."""

    def line(t: float) -> Any:
        return np.asarray(arm_at(0.0) + np.array([2.0 * t - 1.0, 0.0, 0.0]))

    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    looks = {name: (lambda t, name=name: [seen(line(t), name, RNG(0), noise_m=0.0)]) for name in ("a", "b")}
    scenes = [tracker.update(arrival) for arrival in run(1.0, looks)]
    away = [np.abs(scene.arms[0].points - line(1e-9 * (scene.at_ns - 1))).max() for scene in scenes[12:]]
    assert max(away) < 0.002


def test_two_cameras_that_disagree_about_a_fingertip_do_not_meet_in_the_middle() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    rng = RNG(5)

    def liar(t: float) -> list[SeenArm]:
        arm = seen(arm_at(t), "b", rng)
        if t > 0.5:
            arm.points[8] += [0.0, 0.08, 0.0]
        return [arm]

    scenes = [tracker.update(arrival) for arrival in run(1.5, {"a": one("a"), "b": liar})]
    assert max(errors(scene, 8) for scene in scenes[4:]) < 0.02
    assert scenes[-1].arms[0].states[8] == 2


def test_a_hand_that_one_camera_takes_for_the_other_one_has_the_fingers_of_the_right_one() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    rng = RNG(6)
    swapped = [0, *range(17, 21), *range(13, 17), *range(9, 13), *range(5, 9), *range(1, 5), 21, 22]

    def mistaken(t: float) -> list[SeenArm]:
        return [seen(arm_at(t)[swapped], "b", rng, left=False, left_sure=0.6)]

    scenes = [tracker.update(arrival) for arrival in run(1.5, {"a": one("a", left_sure=0.9), "b": mistaken})]
    for scene in scenes[4:]:
        (arm,) = scene.arms
        assert arm.left
        assert arm.cameras == ("a", "b")
        assert errors(scene).max() < 0.02


def test_the_number_stays_when_one_camera_hands_the_arm_over_to_the_other() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    a, b = one("a"), one("b", number=7)
    looks = {
        "a": lambda t: a(t) if t < 1.0 or t > 2.5 else [],
        "b": lambda t: b(t) if t > 1.2 else [],  # for 0.2 s nobody sees it
    }
    scenes = [tracker.update(arrival) for arrival in run(3.0, looks)]
    assert {arm.id for scene in scenes for arm in scene.arms} == {0}
    assert {arm.cameras for scene in scenes for arm in scene.arms} == {("a",), (), ("b",), ("a", "b")}
    states = [int(scene.arms[0].states.max()) for scene in scenes if not scene.arms[0].cameras]
    assert states
    assert set(states) == {1}


def test_an_arm_that_was_taken_for_two_becomes_one() -> None:
    """Two cameras see it far apart at first: their places are wrong by that; then one is moved to where it belongs."""
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    rng = RNG(7)

    def late(t: float) -> list[SeenArm]:
        return [seen(arm_at(t) + np.array([0.3 if t < 0.5 else 0.0, 0.0, 0.0]), "b", rng)]

    scenes = [tracker.update(arrival) for arrival in run(1.5, {"a": one("a"), "b": late})]
    assert [arm.id for arm in scenes[20].arms] == [0, 1]
    assert [arm.id for arm in scenes[-1].arms] == [0]
    assert scenes[-1].arms[0].cameras == ("a", "b")


def test_what_holds_and_gestures_are_by_the_surer_and_do_not_flicker() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    rng = RNG(8)

    def says(camera: str, sure: float, gesture: str, grabbing: bool) -> Look:
        return lambda t: [
            seen(arm_at(t), camera, rng, gesture=gesture, gesture_sure=sure, grabbing=grabbing, left_sure=0.8)
        ]

    looks = {"a": says("a", 0.9, "fist", True), "b": says("b", 0.3, "open", False)}
    (scene,) = [tracker.update(arrival) for arrival in run(0.5, looks)][-1:]
    assert (scene.arms[0].gesture, scene.arms[0].grabbing) == ("fist", True)
    looks = {"a": says("a", 0.5, "fist", True), "b": says("b", 0.55, "open", False)}
    (scene,) = [tracker.update(arrival) for arrival in run(0.5, looks, begin_s=0.5)][-1:]
    assert (scene.arms[0].gesture, scene.arms[0].grabbing) == ("fist", True)
    assert scene.arms[0].gesture_sure == 0.5
    looks = {"a": says("a", 0.2, "fist", True), "b": says("b", 0.9, "open", False)}
    (scene,) = [tracker.update(arrival) for arrival in run(0.5, looks, begin_s=1.0)][-1:]
    assert (scene.arms[0].gesture, scene.arms[0].grabbing) == ("open", False)


# Where cameras are.


@pytest.mark.slow
def test_a_camera_is_placed_by_the_arm_that_both_see() -> None:
    delay_s = 0.012
    tracker = ArmsTracker(sensors_expected=2)
    scenes = [tracker.update(arrival) for arrival in run(8.0, {"a": one("a"), "b": one("b")}, delay_s={"b": delay_s})]
    begin, end = scenes[10], scenes[-1]
    assert begin.state.phase is Phase.CALIBRATING
    assert "b: move one arm about where another camera sees it too" in begin.state.reason
    assert [arm.cameras for arm in begin.arms] == [("a",)]
    assert [place.T_world_sensor is None for place in begin.sensors] == [False, True]
    assert end.state.phase is Phase.TRACKING
    assert end.arms[0].cameras == ("a", "b")
    found = end.sensors[1].T_world_sensor
    assert found is not None
    middle = np.array([[0.0, 0.0, 1.0]])
    true = places()["b"] @ TO_SENSOR
    off = np.linalg.norm(apply(found, apply(np.linalg.inv(true), middle)) - middle)
    assert off < 0.002
    assert 0.2 * off < end.sensors[1].position_sd < 0.003
    assert abs(tracker.delays_s["b"] - delay_s) < 0.003
    assert max(errors(scene, PALM) for scene in scenes[-40::2]) < 0.012
    assert tracker.report.calibrations == 1


@pytest.mark.parametrize(
    ("b", "said"),
    [
        (lambda t: [seen(arm_at(0.0), "b", RNG(1))], "move the arm farther about"),
        (lambda t: [seen(arm_at(1.5 * t + 2.0), "b", RNG(1))], "cm from another camera"),
        (lambda t: [], "move one arm about where another camera sees it too (0 % done)"),
    ],
)
def test_a_camera_that_cannot_be_placed_says_what_is_missing(b: Look, said: str) -> None:
    still = said.startswith("move the arm")
    tracker = ArmsTracker(sensors_expected=2)
    a = (lambda t: [seen(arm_at(0.0), "a", RNG(2))]) if still else one("a")
    scenes = [tracker.update(arrival) for arrival in run(5.0, {"a": a, "b": b})]
    assert scenes[-1].state.phase is Phase.CALIBRATING
    assert said in scenes[-1].state.reason
    assert said in scenes[-1].sensors[1].problem
    assert scenes[-1].sensors[1].T_world_sensor is None


def test_a_camera_of_the_rig_that_was_moved_is_told_of() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    rng = RNG(4)
    moved = {"a": one("a"), "b": lambda t: [seen(arm_at(t) + np.array([0.0, 0.09, 0.0]), "b", rng)]}
    scenes = [tracker.update(arrival) for arrival in run(6.0, moved)]
    assert "was it moved? recalibrate" in scenes[-1].state.reason
    assert "was it moved" in scenes[-1].sensors[1].problem
    assert "moved" not in scenes[20].state.reason


def test_a_camera_stands_as_calibrated_where_a_rig_says_so_and_without_one_it_is_the_world() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    for arrival in run(0.1, {"a": one("a"), "b": one("b")}):
        scene = tracker.update(arrival)
    for place in scene.sensors:
        assert (place.quality, place.position_sd, place.rotation_sd) == ("as calibrated", 0.0, 0.0)
        assert place.T_world_sensor is not None
        np.testing.assert_allclose(place.T_world_sensor, places()[place.sensor] @ TO_SENSOR, atol=1e-12)
    (alone,) = ArmsTracker().update(frame("a", [seen(arm_at(0.0), "a", RNG(1))], 0.0)).sensors
    assert (alone.quality, alone.position_sd, alone.rotation_sd) == ("", 0.0, 0.0)


def test_recalibrating_places_the_cameras_anew() -> None:
    tracker = ArmsTracker(sensors_expected=2)
    for arrival in run(5.0, {"a": one("a"), "b": one("b")}):
        scene = tracker.update(arrival)
        placed = [place.sensor for place in scene.sensors if place.T_world_sensor is not None]
        assert tracker.report.calibrations == ("b" in placed)  # once, though its place is improved
    assert scene.state.phase is Phase.TRACKING
    assert "b" in placed
    tracker.recalibrate("asked for")
    for arrival in run(1.0, {"a": one("a"), "b": one("b")}, begin_s=6.0):
        scene = tracker.update(arrival)
    assert scene.state.phase is Phase.CALIBRATING
    assert (tracker.report.calibrations, tracker.report.restarts) == (1, 1)


def test_places_that_were_found_can_be_kept_and_used_again() -> None:
    tracker = ArmsTracker(sensors_expected=2)
    assert tracker.layout() is None
    for arrival in run(5.0, {"a": one("a"), "b": one("b")}):
        found = tracker.update(arrival)
    kept = tracker.layout()
    assert kept is not None
    again = ArmsTracker(sensors_expected=2)
    again.use_layout(decode_layout(encode_layout(kept)))
    scenes = [again.update(arrival) for arrival in run(0.2, {"a": one("a"), "b": one("b")})]
    assert scenes[1].state.phase is Phase.TRACKING
    assert scenes[-1].arms[0].cameras == ("a", "b")
    for place, before in zip(scenes[-1].sensors, found.sensors, strict=True):
        assert place.T_world_sensor is not None
        assert before.T_world_sensor is not None
        np.testing.assert_allclose(place.T_world_sensor, before.T_world_sensor, atol=1e-12)
        assert place.position_sd == pytest.approx(before.position_sd)
    again.recalibrate("asked for")
    assert again.layout() is None
    assert ArmsTracker(rig=rig()).layout() is None  # the camera rig has its own file


# Frames, and memory.


def test_frames_that_cannot_be_used_are_counted_and_change_nothing() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=1)
    arm = seen(arm_at(0.0), "a", RNG(1))
    first = tracker.update(frame("a", [arm], 0.0))
    late = frame("a", [], -1.0)
    again = frame("a", [], 0.0)
    small = Arrival(ArmFrame("b", 1, 0, 5, 0, (320, 240), LENS, "m", (), ""), 5)
    kinds = (
        body_frame("c", topology("kinect_v2"), time_ns=1, positions=[]),
        marker_frame("d", ["x"], time_ns=1, size_px=(4, 4), positions_px=[[1, 1]]),
        depth_frame("e", np.ones((3, 4), np.uint16), unit_m=0.001, lens=LENS, time_ns=1),
    )
    wrong = [late, again, small, *(Arrival(one_kind, 2) for one_kind in kinds)]
    for k, arrival in enumerate(wrong):
        scene = tracker.update(arrival)
        assert scene.step == k + 1
        assert scene.arms == first.arms
    words = "\n".join(tracker.report.rejected)
    for said in ("goes backwards", "repeats", "320 × 240, the rig's 640 × 480", "skeletons", "markers", "node arm"):
        assert said in words
    assert (tracker.report.frames, tracker.report.kept) == (7, 1)
    # Images that a camera's node sends beside its arms are for the take.
    beside = depth_frame("a.depth", np.ones((3, 4), np.uint16), unit_m=0.001, lens=LENS, time_ns=1)
    scene = tracker.update(Arrival(beside, 2))
    assert (scene.step, scene.arms) == (7, first.arms)
    assert (tracker.report.frames, tracker.report.kept) == (8, 2)
    # A node that was started anew may have another clock.
    assert tracker.update(frame("a", [arm], -1.0, node_id=2)).step == 8
    assert tracker.report.kept == 3


@pytest.mark.parametrize("kept", [7, "front", {"front": 7}, [1]])
def test_a_snapshot_with_an_impossible_layout_is_refused(kept: object) -> None:
    tracker = make_tracker("arms", sensors_expected=2)
    tracker.reset()
    strange = make_tracker("arms", sensors_expected=2)
    strange._kept = kept  # type: ignore[attr-defined]
    with pytest.raises(WireError, match="no memory of this tracker"):
        tracker.restore(strange.snapshot())
    tracker.recalibrate("asked for")


def test_a_snapshot_goes_on_to_the_bit() -> None:
    arrivals = run(5.0, {"a": one("a", hidden=(4,)), "b": one("b", hidden=(8,))})
    whole, half = (make_tracker("arms", sensors_expected=2) for _ in range(2))
    for arrival in arrivals[:170]:
        whole.update(arrival)
    half.restore(whole.snapshot())
    for arrival in arrivals[170:]:
        assert encode_scene(whole.update(arrival)) == encode_scene(half.update(arrival))
    assert whole.snapshot() == half.snapshot()
    with pytest.raises(WireError):
        half.restore(b"nonsense")
    whole.reset()
    new = make_tracker("arms", sensors_expected=2)
    assert [encode_scene(whole.update(x)) for x in arrivals[:9]] == [encode_scene(new.update(x)) for x in arrivals[:9]]


def test_a_silent_camera_is_waited_for_and_the_other_goes_on() -> None:
    tracker = ArmsTracker(rig=rig(), sensors_expected=2)
    b = one("b")
    scenes = [tracker.update(x) for x in run(3.0, {"a": one("a"), "b": b}) if x.frame.sensor == "a" or x.at_ns < 1e9]
    assert scenes[-1].state.phase is Phase.WAITING_FOR_SENSORS
    assert scenes[-1].state.sensors_missing == 1
    assert [arm.cameras for arm in scenes[-1].arms] == [("a",)]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"tracks": {"fresh_s": 0}}, "fresh_s"),
        ({"tracks": {"shown_for_s": 2.0}}, "shown_for_s"),
        ({"tracks": {"gesture_margin": 2.0}}, "gesture_margin"),
        ({"tracks": {"one_m": -1.0}}, "one_m"),
        ({"tracks": {"acceleration_m_s2": -1.0}}, "acceleration_m_s2"),
        ({"tracks": {"fusion": {"gate_m": 0}}}, "gate_m"),
        ({"tracks": {"match": {"within_m": 11}}}, "within_m"),
        ({"places": {"instants": [5, 10]}}, "instants"),
        ({"places": {"space_m": 0}}, "space_m"),
        ({"silent_after_s": 0}, "silent_after_s"),
        ({"moved_m": 2}, "moved_m"),
        ({"track": {}}, "unknown key 'track'"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        make_tracker("arms", settings=settings)


def test_settings_are_those_of_the_method() -> None:
    assert isinstance(make_tracker("arms"), ArmsTracker)
    tracker = make_tracker("arms", settings={"silent_after_s": 2.0})
    assert isinstance(tracker, ArmsTracker)
    assert tracker.settings == ArmsSettings(silent_after_s=2.0)
