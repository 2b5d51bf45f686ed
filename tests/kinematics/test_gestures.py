"""Gestures: the same wherever a hand is, whatever its size and side, and steady."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.kinematic_hands import random_motion

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.kinematics.gestures import (
    GESTURES,
    Closed,
    FingerGesture,
    GestureSettings,
    GestureState,
    HandFeatures,
    HandGestures,
    Pinch,
    closure,
    hand_features,
    ramp,
)
from mocapella.model.hand import DIGIT_ANGLES, HandPose, hand_model
from mocapella.model.observations import JointState
from mocapella.sources.simulate.hand_motion import landmarks_of

MODEL = hand_model("full").stretched(25.0, 20.0)
SHAPE = MODEL.shape("right")
HZ = 30.0
OPEN, BENT, AWAY = (4, 0, 8, 5), (82, 0, 98, 62), (64, 0, 74, 42)
THUMB, THUMB_IN = (-8, 4, 6, 6), (15, -8, 40, 45)
HELD: dict[str, tuple[tuple[float, ...], ...]] = {
    "open": (THUMB, OPEN, OPEN, OPEN, OPEN),
    "fist": (THUMB_IN, BENT, BENT, BENT, BENT),
    "point": (THUMB_IN, OPEN, BENT, BENT, BENT),
    "two": (THUMB_IN, OPEN, OPEN, BENT, BENT),
    "pinch": ((8, 2, 22, 32), (46, 4, 48, 30), OPEN, OPEN, OPEN),
    "grab": ((16, -6, 32, 36), AWAY, AWAY, AWAY, AWAY),
}
seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(list(HELD))
MEASURED = np.full(21, JointState.TRACKED, dtype=np.uint8)


@cache
def angles(name: str) -> np.ndarray:
    out = np.zeros(21)
    for row, held in zip(DIGIT_ANGLES, HELD[name], strict=True):
        out[row[:4]] = np.radians(held)
    return MODEL.limited(out)


def landmarks(name: str, other: str = "", part: float = 0.0) -> np.ndarray:
    """Of a hand that does that, or so far on the way to another."""
    a = (1 - part) * angles(name) + part * angles(other or name)
    return landmarks_of(MODEL, SHAPE, HandPose(a, np.eye(4)))


def features(x: np.ndarray, states: Any = MEASURED, **more: Any) -> HandFeatures:
    return hand_features(x, states, **more)


def run(hand: HandGestures, path: list[HandFeatures | None], start: int = 0) -> list[GestureState]:
    return [hand.update(one, (start + k) / HZ) for k, one in enumerate(path)]


@pytest.mark.parametrize("name", HELD)
def test_each_gesture_is_told_and_no_other(name: str) -> None:
    hand = HandGestures()
    shown = run(hand, [features(landmarks(name))] * 10)
    assert shown[-1].gesture == name
    assert shown[-1].sure > 0.8
    assert shown[-1].known
    assert {one.gesture for one in shown} == {"", name}
    assert hand.report.begun == {name: 1}
    assert shown[-1].grabbing == (name in ("fist", "grab", "pinch"))


@settings(max_examples=40)
@given(names, seeds, st.floats(0.3, 3.0), st.booleans())
def test_neither_place_nor_turn_nor_size_nor_side_matter(name: str, seed: int, size: float, mirrored: bool) -> None:
    x = landmarks(name)
    moved = apply(random_motion(np.random.default_rng(seed)), size * x * ([-1, 1, 1] if mirrored else 1))
    one, other = features(x), features(moved)
    np.testing.assert_allclose(other.reach, one.reach, atol=1e-9)
    np.testing.assert_allclose(other.gaps, one.gaps, atol=1e-9)
    assert closure(other) == pytest.approx(closure(one), abs=1e-9)
    for gesture in GESTURES.values():
        assert gesture.score(other) == pytest.approx(gesture.score(one), abs=1e-8)


@given(st.lists(st.floats(0.41, 0.59), min_size=1, max_size=60), st.booleans())
def test_noise_within_the_band_changes_nothing(scores: list[float], on: bool) -> None:
    class Given:
        name, digits, value = "given", (0,), 0.0

        def score(self, hand: HandFeatures) -> float:
            return self.value

    gesture = Given()
    hand, any_hand = HandGestures(gestures=[gesture]), features(landmarks("open"))
    gesture.value = 1.0 if on else 0.0
    run(hand, [any_hand] * 10)
    for k, gesture.value in enumerate(scores):
        assert hand.update(any_hand, (10 + k) / HZ).gesture == ("given" if on else "")


class Told:
    """A gesture whose score is told."""

    digits = (0,)

    def __init__(self, name: str) -> None:
        self.name, self.value = name, 0.0

    def score(self, hand: HandFeatures) -> float:
        return self.value


@pytest.mark.parametrize("enter", [0.6, 1.0])
def test_a_gesture_that_only_stays_gives_way_to_one_that_just_reaches_enter(enter: float) -> None:
    for score, shown in ((enter, "new"), (math.nextafter(enter, 0.0), "old")):
        old, new = Told("old"), Told("new")
        hand, any_hand = HandGestures(GestureSettings(enter=enter), [old, new]), features(landmarks("open"))
        old.value = enter
        assert run(hand, [any_hand] * 10)[-1].gesture == "old"
        old.value, new.value = 0.5 * (GestureSettings().leave + enter), score
        assert run(hand, [any_hand] * 10, 10)[-1].gesture == shown


@settings(max_examples=10)
@given(st.floats(0.5, 2.5), st.floats(0, 0.004), seeds)
def test_a_hand_that_opens_slowly_lets_go_once_and_one_that_closes_takes_hold_once(
    lasts_s: float, noise: float, seed: int
) -> None:
    rng, hand = np.random.default_rng(seed), HandGestures()
    there = np.linspace(0, 1, int(lasts_s * HZ))
    parts = np.concatenate([np.zeros(10), there, np.ones(10), there[::-1], np.zeros(10)])
    path = [features(landmarks("open", "fist", part) + rng.normal(0, noise, (21, 3))) for part in parts]
    shown = run(hand, path)
    assert [one.event for one in shown if one.event] == ["grab", "release"]
    assert (hand.report.grabs, hand.report.releases) == (1, 1)
    grabbing = [one.grabbing for one in shown]
    changes = [k for k, one in enumerate(shown) if one.event]
    assert all(grabbing[k] != grabbing[k - 1] for k in changes)
    told = [one.gesture for one in shown if one.gesture]
    order = [name for k, name in enumerate(told) if k == 0 or told[k - 1] != name]
    # On the way it may look as if it grabbed something, but nothing comes twice on one way.
    assert [name for name in order if name != "grab"] == ["open", "fist", "open"]
    assert order.count("grab") <= 2


def test_a_gesture_begins_after_it_lasted_and_a_short_one_never() -> None:
    s, opened, fist = GestureSettings(), features(landmarks("open")), features(landmarks("fist"))
    shown = run(HandGestures(), [opened] * 8)
    assert [one.gesture == "open" for one in shown] == [k / HZ >= s.after_s - 1e-9 for k in range(8)]
    hand = HandGestures()
    shown = run(hand, [opened] * 8 + ([fist] + [opened] * 3) * 5)
    assert {one.gesture for one in shown[7:]} == {"open"}
    assert hand.report.grabs == 0


@pytest.mark.parametrize("missing", ["nobody", "nan", "inferred", "unsure"])
def test_what_cannot_be_told_stays_for_a_while_and_then_ends(missing: str) -> None:
    x, sd, states = landmarks("fist"), np.full(21, 0.005), MEASURED.copy()
    if missing == "nan":
        x[8] = np.nan
    if missing == "inferred":
        states[1:] = JointState.INFERRED
    if missing == "unsure":
        sd[[4, 8, 12, 16, 20]] = 0.08
    untold = None if missing == "nobody" else features(x, states, sd=sd)
    s, hand = GestureSettings(), HandGestures()
    before = run(hand, [features(landmarks("fist"))] * 10)
    assert before[-1].grabbing
    shown = run(hand, [untold] * 30, 10)
    for k, one in enumerate(shown):
        holds = (k + 1) / HZ <= s.hold_s + 1e-9
        assert (one.gesture, one.grabbing, one.known) == ("fist" if holds else "", holds, False)
    sure = [one.sure for one in shown]
    assert sure == sorted(sure, reverse=True)
    assert sure[-1] == 0.0
    assert [one.event for one in shown if one.event] == ["release"]
    assert hand.report.unknown == 30
    # It is not enough to begin, either.
    assert not any(one.gesture or one.grabbing for one in run(HandGestures(), [untold] * 30))


def test_a_finger_that_is_inferred_makes_it_less_sure() -> None:
    states = MEASURED.copy()
    states[9:13] = JointState.INFERRED
    sure = run(HandGestures(), [features(landmarks("fist"))] * 10)[-1].sure
    less = run(HandGestures(), [features(landmarks("fist"), states)] * 10)[-1]
    assert less.gesture == "fist"
    assert 0 < less.sure < sure
    states[10] = JointState.TRACKED  # a joint of it is seen
    assert less.sure < run(HandGestures(), [features(landmarks("fist"), states)] * 10)[-1].sure < sure


@pytest.mark.parametrize(("name", "reach"), [("open", 0.9), ("fist", 0.3)])
def test_with_eight_joints_only_it_is_told_of_palm_and_elbow(name: str, reach: float) -> None:
    x = landmarks(name)
    palm, elbow, rough = 0.5 * (x[0] + x[9]), x[0] - [0, 0, 0.25], np.full((21, 3), np.nan)
    joints = [0, 4, 8, 12, 16, 20]
    rough[joints] = x[joints]
    states = np.where(np.isfinite(rough[:, 0]), JointState.TRACKED, JointState.NOT_TRACKED)
    made = features(rough, states, palm=palm, elbow=elbow)
    np.testing.assert_allclose(made.reach[1:], reach, atol=0.12)
    assert (made.certainty == 1).all()
    assert run(HandGestures(), [made] * 10)[-1].gesture == name
    assert np.isnan(features(rough, states).reach).all()


def test_a_gesture_of_ones_own_is_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    three = FingerGesture("three", extended=("index", "middle", "ring"), folded=("little",))
    assert three.digits == (1, 2, 3, 4)
    monkeypatch.setitem(HELD, "three", (THUMB_IN, OPEN, OPEN, OPEN, BENT))
    shown = [features(landmarks("three"))] * 10
    assert run(HandGestures(), shown)[-1].gesture == ""
    monkeypatch.setitem(GESTURES, "three", three)
    assert run(HandGestures(), shown)[-1].gesture == "three"
    assert run(HandGestures(gestures=[Pinch()]), shown)[-1].gesture == ""


def test_a_score_that_is_no_number_is_not_told() -> None:
    x = landmarks("open")
    x[20] = np.nan
    made = features(x)
    assert np.isnan(made.reach[4])
    assert made.certainty[4] == 0
    for gesture in (FingerGesture("open", extended=("little",)), Closed("fist", True), Pinch()):
        assert math.isnan(gesture.score(made))
    assert not math.isnan(FingerGesture("index", extended=("index",)).score(made))
    assert math.isnan(ramp(math.nan, 0, 1))


@pytest.mark.slow
@given(st.lists(names, min_size=1, max_size=8))
def test_reset_and_a_time_that_goes_back_are_as_newly_made(path: list[str]) -> None:
    held = [features(landmarks(name)) for name in path for _ in range(5)]
    hand = HandGestures()
    first = run(hand, held)
    assert run(hand, held) == first
    hand.reset()
    assert run(hand, held) == first
    assert hand.report.instants == len(held)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("enter", 0.0), ("enter", 1.1), ("leave", 0.6), ("leave", -0.1), ("after_s", -1.0), ("grab", 0.0)),
        *(("release", 0.7), ("grab_after_s", 11.0), ("least_certain", 1.1), ("hold_s", math.nan), ("unsure", 0.0)),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} is {value}"):
        GestureSettings(**{name: value})


def test_gestures_that_cannot_be_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"unknown digit 'indx'; .*did you mean index"):
        FingerGesture("odd", extended=("indx",))
    with pytest.raises(SettingsError, match="one digit or more"):
        FingerGesture("odd")
    with pytest.raises(SettingsError, match="each digit once"):
        FingerGesture("odd", extended=("index",), folded=("index",))
    with pytest.raises(SettingsError, match="each name once"):
        HandGestures(gestures=[Pinch(), Pinch()])
