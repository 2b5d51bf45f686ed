"""Gestures of arms: each arm's own, for as long as it is there; and every arm detector by name has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from mocapella.detectors import DETECTORS, ArmDetector, Detector, make_detector
from mocapella.detectors.arm_gestures import ArmGestures
from mocapella.errors import SettingsError
from mocapella.kinematics.gestures import GestureSettings
from mocapella.model.arms import SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import DIGIT_ANGLES, HandPose, hand_model
from mocapella.model.observations import JointState
from mocapella.sources.simulate.hand_motion import landmarks_of

MODEL = hand_model("full")
HZ = 30.0
CAMERA = Camera("depth", (64, 48), np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0]))


def arm(number: int, closed: bool) -> SeenArm:
    angles = np.zeros(21)
    if closed:
        for row in DIGIT_ANGLES:
            angles[row[:4]] = np.radians([82, 0, 98, 62])
    x = landmarks_of(MODEL, MODEL.shape("right"), HandPose(MODEL.limited(angles), np.eye(4)))
    points = np.concatenate([x, [0.5 * (x[0] + x[9])], [x[0] - [0, 0, 0.25]]])
    states = np.full(23, JointState.TRACKED, dtype=np.uint8)
    return SeenArm(number, False, 0.9, points, states, np.full(23, 0.004, np.float32), angles)


def last(gestures: ArmGestures, arms: tuple[SeenArm, ...], start: int, count: int = 10) -> tuple[SeenArm, ...]:
    for k in range(count):
        arms_now = gestures.update(arms, (start + k) / HZ)
    return arms_now


def test_each_arm_has_its_own_and_nothing_else_changes() -> None:
    gestures, arms = ArmGestures(), (arm(3, True), arm(7, False))
    told = last(gestures, arms, 0)
    assert [(one.gesture, one.grabbing) for one in told] == [("fist", True), ("open", False)]
    assert all(one.gesture_sure > 0.8 for one in told)
    for one, given in zip(told, arms, strict=True):
        assert one.id == given.id
        assert one.points is given.points
    assert [report.begun for report in gestures.reports.values()] == [{"fist": 1}, {"open": 1}]


def test_an_arm_that_comes_back_soon_goes_on_and_one_that_was_long_away_begins_anew() -> None:
    hold = round(GestureSettings().hold_s * HZ)
    for away, goes_on in ((hold - 3, True), (hold + 3, False)):
        gestures = ArmGestures()
        last(gestures, (arm(1, True),), 0)
        assert last(gestures, (), 10, away) == ()
        (back,) = gestures.update((arm(1, True),), (10 + away) / HZ)
        assert (back.gesture == "fist") == back.grabbing == goes_on
        assert {number: one.instants for number, one in gestures.reports.items()} == {1: 11 + away if goes_on else 1}


def test_a_gesture_that_the_detector_told_itself_stays() -> None:
    own = replace(arm(1, True), gesture="victory", gesture_sure=0.4, grabbing=False)
    assert last(ArmGestures(), (own,), 0) == (own,)


def test_reset_forgets() -> None:
    gestures = ArmGestures()
    last(gestures, (arm(1, True),), 0)
    gestures.reset()
    assert gestures.reports == {}
    (told,) = gestures.update((arm(1, True),), 0.0)
    assert told.gesture == ""


@dataclass(frozen=True)
class FakeSettings:
    """None."""


class Fake:
    """A detector that finds a fist in every image."""

    name = "fake"

    def __init__(self) -> None:
        self.resets = 0

    def update(self, depth: Any, at_s: float) -> SeenArms:
        return SeenArms((arm(0, True),), "so it is")

    def reset(self) -> None:
        self.resets += 1


@pytest.mark.parametrize("has_stages", [False, True])
def test_every_detector_by_name_tells_gestures(has_stages: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Fake] = []

    def make(camera: Camera, settings: Any) -> ArmDetector:
        assert settings == FakeSettings()
        made.append(Fake())
        return made[-1]

    def stages(of: Fake, depth: Any) -> dict[str, Any]:
        assert of is made[-1]
        return {"image": depth}

    fake = Detector(1, "fake", "For tests.", "arms", lambda: FakeSettings, make, stages if has_stages else None)
    monkeypatch.setitem(DETECTORS, "fake", fake)
    detector = make_detector("fake", CAMERA, {"gestures": {"after_s": 0.5}})
    assert detector.name == "fake"
    depth = np.zeros((48, 64), np.float32)
    seen = [detector.update(depth, k / HZ) for k in range(30)]
    assert [one.arms[0].gesture == "fist" for one in seen] == [k >= 15 for k in range(30)]
    assert seen[0].reason == "so it is"
    detector.reset()
    assert made[0].resets == 1
    assert detector.update(depth, 0.0).arms[0].gesture == ""
    assert (detector.stages is not None) == has_stages
    if detector.stages is not None:
        assert list(detector.stages(depth)) == ["image"]
    with pytest.raises(SettingsError, match=r"settings of fake, gestures: unknown key 'aftr_s'.*did you mean after_s"):
        make_detector("fake", CAMERA, {"gestures": {"aftr_s": 0.5}})


def test_an_arm_without_a_hand_has_no_gesture() -> None:
    bare = replace(arm(0, True), points=np.full((23, 3), np.nan), states=np.zeros(23, np.uint8))
    (told,) = last(ArmGestures(), (bare,), 0)
    assert (told.gesture, told.gesture_sure, told.grabbing) == ("", 0.0, False)
