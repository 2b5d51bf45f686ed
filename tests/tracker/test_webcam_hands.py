"""Hands of the method webcams: at the wrists of people who walk, alone, seen by one camera, and with sides confused."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from support.webcam_hands import (
    LEFT,
    RIGHT,
    arm_alone,
    errors_of,
    frames,
    hands_of,
    of_side,
    palm_pose,
    person,
    posed,
    whole_body,
)
from support.webcam_people import last_of_each, run

from mocapella.compiled import on_first_compilation
from mocapella.errors import SettingsError, WireError
from mocapella.model.camera import CameraRig
from mocapella.model.observations import JointState
from mocapella.model.topology import topology
from mocapella.testing import check_tracker
from mocapella.tracker import warm_up
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_hands import ALONE_ID
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]

FOUR = circle_of_cameras(4)
SURE = np.full(21, 0.9)


def rig_of(cameras: int) -> CameraRig:
    return CameraRig({name: FOUR.cameras[name] for name in sorted(FOUR.cameras)[:cameras]})


def both(at_s: float) -> dict[bool, Float64]:
    left, right = hands_of(person(at_s), at_s)
    return {True: left, False: right}


def body(_name: str, at_s: float) -> list[tuple[Float64, Float64]]:
    return [whole_body(at_s)]


@pytest.mark.slow
def test_it_keeps_the_promises_of_a_tracker_with_hands() -> None:
    arrivals = frames(rig_of(2), body, seconds=0.5, of="halpe_136", offsets_s={"cam-1": 0.012})
    scenes = check_tracker(lambda: WebcamsTracker(rig_of(2)), arrivals)
    assert [hand.left for hand in scenes[-1].hands] == [True, False]


@pytest.mark.slow
def test_a_hand_alone_is_remembered_while_its_side_is_not_known() -> None:
    arrivals = frames(rig_of(2), lambda _, t: [(arm_alone("left")(t), SURE)], seconds=0.4, of="hand")
    assert check_tracker(lambda: WebcamsTracker(rig_of(2)), arrivals)[-1].hands


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [2, 3, 4])
def test_hands_of_a_walking_person_are_within_8_mm_at_2_pixels_of_noise(cameras: int) -> None:
    scenes = last_of_each(
        run(WebcamsTracker(rig_of(cameras)), frames(rig_of(cameras), body, seconds=2, of="halpe_136"))
    )
    (number,) = {one.id for scene in scenes[10:] for one in scene.people}
    assert {hand.id for scene in scenes[10:] for hand in scene.hands} == {2 * number, 2 * number + 1}
    assert all(hand.id == 2 * number + (not hand.left) for hand in scenes[-1].hands)
    for away in errors_of(scenes[15:], both).values():
        assert len(away) == 21 * len(scenes[15:])
        assert np.median(away) < 0.008
    measured = np.mean([hand.states == JointState.TRACKED for scene in scenes[15:] for hand in scene.hands])
    assert measured > 0.8


@pytest.mark.slow
def test_deviations_say_how_near_the_landmarks_are() -> None:
    scenes = last_of_each(run(WebcamsTracker(FOUR), frames(FOUR, body, seconds=2, of="halpe_136")))
    away = np.concatenate(list(errors_of(scenes[30:], both).values()))
    sds = np.concatenate([hand.sd for scene in scenes[30:] for hand in scene.hands])
    assert 0.3 < np.sqrt(np.mean(away**2) / 3) / np.sqrt(np.mean(sds**2)) < 3.0


@pytest.mark.slow
def test_cameras_at_different_times_see_one_hand() -> None:
    offsets = {f"cam-{i}": 0.008 * i for i in range(4)}
    scenes = run(WebcamsTracker(FOUR), frames(FOUR, body, seconds=2, of="halpe_136", offsets_s=offsets))
    complete = [scene for scene in scenes if scene.sensor == "cam-3"]
    for away in errors_of(complete[15:], both).values():
        assert np.median(away) < 0.012


def test_a_hand_that_one_camera_sees_is_inferred() -> None:
    def only_the_first(name: str, at_s: float, px: Any, sure: Any) -> Any:
        if name != "cam-0" and at_s > 1.0:
            sure[:, LEFT : LEFT + 21] = 0.0
        return px, sure

    arrivals = frames(FOUR, body, seconds=1.6, of="halpe_136", fault=only_the_first)
    scenes = last_of_each(run(WebcamsTracker(FOUR), arrivals))
    assert (of_side(scenes[28], left=True).states == JointState.TRACKED).mean() > 0.5
    for scene in scenes[34:]:
        assert (of_side(scene, left=True).states == JointState.INFERRED).all()
        assert (of_side(scene, left=False).states == JointState.TRACKED).any()
    assert np.median(errors_of(scenes[34:], both)[True]) < 0.07


def test_a_hand_that_only_one_camera_ever_saw_begins_at_its_wrist_and_is_inferred() -> None:
    def only_the_first(name: str, _: float, px: Any, sure: Any) -> Any:
        sure[:, LEFT : LEFT + 21] = 0.0
        if name != "cam-0":
            sure[:, RIGHT : RIGHT + 21] = 0.0
        return px, sure

    arrivals = frames(FOUR, body, seconds=1.0, of="halpe_136", fault=only_the_first)
    scenes = last_of_each(run(WebcamsTracker(FOUR), arrivals))
    hand = of_side(scenes[-1], left=False)
    assert (hand.states == JointState.INFERRED).all()
    assert np.median(errors_of(scenes[20:], both)[False]) < 0.08


@pytest.mark.slow
def test_hands_that_a_detector_confuses_keep_their_sides() -> None:
    def crossed(name: str, _: float, px: Any, sure: Any) -> Any:
        if name in ("cam-1", "cam-2"):
            px[:, LEFT : LEFT + 21], px[:, RIGHT:] = px[:, RIGHT:].copy(), px[:, LEFT : LEFT + 21].copy()
        return px, sure

    arrivals = frames(FOUR, body, seconds=1.5, of="halpe_136", fault=crossed)
    scenes = last_of_each(run(WebcamsTracker(FOUR), arrivals))
    for away in errors_of(scenes[15:], both).values():
        assert np.median(away) < 0.01


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_without_a_body_gets_its_side_by_the_joint_limits(side: Any) -> None:
    at = arm_alone(side)
    arrivals = frames(rig_of(2), lambda _, t: [(at(t), SURE)], seconds=2, of="hand")
    scenes = last_of_each(run(WebcamsTracker(rig_of(2)), arrivals))
    assert not any(scene.people for scene in scenes)
    assert [(hand.id, hand.left) for hand in scenes[-1].hands] == [(ALONE_ID, side == "left")]
    assert np.median(errors_of(scenes[30:], lambda t: {side == "left": at(t)})[side == "left"]) < 0.009


@pytest.mark.slow
def test_two_hands_without_a_body_keep_their_numbers() -> None:
    one, other = arm_alone("left"), arm_alone("right")

    def two(_name: str, at_s: float) -> list[tuple[Float64, Float64]]:
        hands = [(one(at_s), SURE), (other(at_s) + np.array([0.3, 0.1, 0.0]), SURE)]
        return hands if round(at_s * 30) % 2 else hands[::-1]

    scenes = last_of_each(run(WebcamsTracker(rig_of(3)), frames(rig_of(3), two, seconds=1.5, of="hand")))
    assert {len(scene.hands) for scene in scenes[5:]} == {2}
    assert {hand.id for scene in scenes for hand in scene.hands} == {ALONE_ID, ALONE_ID + 1}


def test_one_camera_alone_shows_no_hand_without_a_body() -> None:
    def seen(name: str, at_s: float) -> list[tuple[Float64, Float64]]:
        return [(arm_alone("left")(at_s), SURE)] if name == "cam-0" else []

    scenes = run(WebcamsTracker(rig_of(2)), frames(rig_of(2), seen, seconds=0.7, of="hand"))
    assert not any(scene.hands for scene in scenes)


def test_a_detection_far_from_the_wrist_is_no_hand_of_the_person() -> None:
    def shifted(_name: str, _: float, px: Any, sure: Any) -> Any:
        px[:, LEFT:] += 150.0
        return px, sure

    arrivals = frames(FOUR, body, seconds=0.6, of="halpe_136", fault=shifted)
    assert not any(scene.hands for scene in run(WebcamsTracker(FOUR), arrivals))


def test_a_hand_is_forgotten_after_it_was_not_seen() -> None:
    def gone(_name: str, at_s: float) -> list[tuple[Float64, Float64]]:
        return [(arm_alone("right")(at_s), SURE)] if at_s < 0.5 else []

    scenes = last_of_each(run(WebcamsTracker(rig_of(2)), frames(rig_of(2), gone, seconds=1.4, of="hand")))
    assert len(scenes[14].hands) == 1
    assert (scenes[20].hands[0].states == JointState.INFERRED).all()
    assert not scenes[-1].hands


@pytest.mark.slow
def test_the_size_of_the_hand_is_learnt() -> None:
    def small(_name: str, at_s: float) -> list[tuple[Float64, Float64]]:
        pose = palm_pose(
            np.array([0.0, 1.0, 0.0]), np.array([np.sin(at_s), 0.3, np.cos(at_s)]), np.array([0.3, 1.0, 0])
        )
        return [(posed("right", at_s, pose, length_m=0.15), SURE)]

    tracker = WebcamsTracker(FOUR)
    scenes = last_of_each(run(tracker, frames(FOUR, small, seconds=4, of="hand", noise_px=0.5)))

    def length(k: int) -> float:
        x = scenes[k].hands[0].landmarks[[0, 9, 10, 11, 12]]
        return float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum())

    true = small("", 0.0)[0][0][[0, 9, 10, 11, 12]]
    assert length(-1) == pytest.approx(float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum()), rel=0.06)


def test_once_it_is_ready_nothing_is_compiled_while_hands_are_tracked() -> None:
    warm_up("webcams")
    compiled: list[str] = []
    with on_first_compilation(lambda: compiled.append("something")):
        run(WebcamsTracker(FOUR), frames(FOUR, body, seconds=0.3, of="halpe_136", offsets_s={"cam-1": 0.01}))
    assert compiled == []


def test_a_damaged_memory_of_a_hand_is_refused() -> None:
    tracker = WebcamsTracker(rig_of(2))
    run(tracker, frames(rig_of(2), lambda _, t: [(arm_alone("left")(t), SURE)], seconds=0.3, of="hand"))
    hands = tracker._hands  # the tracker gives its memory as one text of bytes only
    memory = hands.memory()
    memory["hands"][0]["fits"] = {"middle": {}}
    with pytest.raises(WireError, match="has no side 'middle'"):
        hands.recall(memory)
    memory["hands"][0]["fits"] = {}
    with pytest.raises(WireError, match="other values"):
        hands.recall(memory)


def test_a_topology_without_body_and_hands_is_rejected() -> None:
    arrivals = frames(rig_of(2), lambda _, t: [(arm_alone("left")(t), SURE)], seconds=0.1, of="hand")
    frame = msgspec.structs.replace(arrivals[0].frame, topology=topology("nite"))
    tracker = WebcamsTracker(rig_of(2))
    tracker.update(msgspec.structs.replace(arrivals[0], frame=frame))
    assert any("no mapping to halpe_26" in problem for problem in tracker.report.rejected)


@pytest.mark.parametrize(
    ("name", "value"),
    [("hand_sd", 0.0), ("least_sd_px", 0.0), ("least_confidence", 1.0), ("most_cost", 10.0), ("pair_cost", 0.0),
     ("least_landmarks", 22), ("wrist_m", 0.0), ("confirm_instants", 0)],
)  # fmt: skip
def test_invalid_settings_of_hands_are_refused(name: str, value: float) -> None:
    own = type(WebcamsSettings().hands)
    with pytest.raises(SettingsError, match=name):
        own(**{name: value})
