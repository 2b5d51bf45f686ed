"""The gesture's parts and the markers in them: what is kept, what is missing, and a hand found from cameras' scenes."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.gesturing_hand import (
    BASE_NAMES,
    MODEL,
    PALM_SIDE_M,
    PHASES_S,
    TIP_NAMES,
    scenes,
    somebody,
)

from mocapella.errors import InputError, SettingsError
from mocapella.kinematics.hand_bones import PHASES
from mocapella.kinematics.hand_gesture import GesturePoints, phase_at, spans_of_text
from mocapella.kinematics.hand_tracker import base_layout
from mocapella.model.scene import Phase, Scene, TrackedPoints, TrackerState
from mocapella.model.topology import topology

NAMES = (*TIP_NAMES, *BASE_NAMES)
SPANS = spans_of_text(",".join(f"{phase}={begin}:{end}" for phase, (begin, end) in PHASES_S.items()))


def scene(at_s: float = 0.0, *, unseen: tuple[str, ...] = (), predicted: tuple[str, ...] = (), **changed: Any) -> Scene:
    positions = np.arange(3.0 * len(NAMES)).reshape(-1, 3)
    positions[[name in unseen for name in NAMES]] = np.nan
    cameras = np.array([1 if name in predicted else 0 if name in unseen else 2 for name in NAMES], np.uint8)
    points = TrackedPoints(NAMES, positions, np.full(len(NAMES), 0.001, np.float32), cameras)
    whole = Scene(
        0, round(at_s * 1e9), "left", 1, 0, topology("hand"), TrackerState(Phase.TRACKING), {"points": (points,)}
    )
    return msgspec.structs.replace(whole, **changed)


@pytest.mark.slow
def test_a_hand_unlike_the_average_is_found_within_what_is_said() -> None:
    truth, start = somebody(), MODEL.shape("right", person="Ada")
    gesture = GesturePoints(TIP_NAMES, BASE_NAMES)
    for arrival, seen in scenes():
        phase = phase_at(SPANS, (arrival.at_ns - 1) / 1e9)
        assert phase is not None
        gesture.update(seen, phase)
    assert [gesture.missing(phase, 20) for phase in PHASES] == [[], [], []]
    bones = gesture.measure(MODEL, start, base_layout(start, 3, PALM_SIDE_M))
    off, before = bones.shape.lengths - truth.lengths, start.lengths - truth.lengths
    assert bones.shape.lengths_sd is not None
    assert (np.abs(off[1:]) < 2 * bones.shape.lengths_sd[1:]).all()
    assert (np.abs(off.sum(axis=1)) < 2 * bones.finger_sd_m).all()
    rms, rms_before = (np.sqrt((values[1:] ** 2).mean()) for values in (off, before))
    assert rms_before > 0.003  # that it is no average hand
    assert rms < 0.4 * rms_before
    report = gesture.report
    assert report.kept == pytest.approx({"flat": 60, "knuckles": 90, "hook": 90}, abs=2)
    assert report.scenes == sum(report.kept.values()) + report.too_soon + report.without_points == 480


def test_only_what_cameras_see_now_is_kept() -> None:
    gesture = GesturePoints(TIP_NAMES, BASE_NAMES)
    for k in range(30):
        gesture.update(scene(k, predicted=("white",) if k % 2 else ()), "flat")
    (problem,) = gesture.missing("flat", 20)
    assert problem == (
        "the base's markers were seen together in 15 of 30 instants (cyan 30, white 15, orange 30); 20 are wanted: "
        "turn them to the cameras"
    )
    assert gesture.missing("flat", 15) == []


def test_what_is_missing_is_said_by_finger_and_marker() -> None:
    gesture = GesturePoints(TIP_NAMES, BASE_NAMES)
    assert gesture.missing("hook", 3)[0].startswith("no markers were tracked meanwhile")
    gesture.update(scene().with_parts(points=()), "hook")
    assert gesture.missing("hook", 3)[0].startswith("no markers were tracked meanwhile")
    for k in range(5):
        gesture.update(scene(k, unseen=("red", "blue")), "hook")
    assert gesture.missing("hook", 3) == ["the tip of the ring finger (blue) was seen in 0 of 5 instants; 3 are wanted"]
    gesture.forget("hook")
    assert gesture.missing("hook", 3)[0].startswith("no markers were tracked meanwhile")
    assert gesture.report.without_points == 1


def test_scenes_in_quick_succession_are_kept_at_the_rate() -> None:
    gesture = GesturePoints(TIP_NAMES, BASE_NAMES, rate_hz=10.0)
    for k in range(100):
        gesture.update(scene(k / 100), "flat")
    assert (gesture.report.kept["flat"], gesture.report.too_soon) == (10, 90)
    gesture.update(scene(0.0), "flat")  # the server was started anew
    assert gesture.report.kept["flat"] == 11
    gesture.reset()
    assert gesture.report.scenes == 0


def test_a_marker_that_is_not_tracked_is_named_with_those_that_are() -> None:
    gesture = GesturePoints(TIP_NAMES, ("cyan", "whit", "orange"))
    with pytest.raises(InputError, match=r"'whit': is not tracked; choose of .*did you mean white\?"):
        gesture.update(scene(), "flat")


def test_a_gesture_without_markers_is_refused() -> None:
    gesture = GesturePoints(TIP_NAMES, BASE_NAMES)
    start = MODEL.shape("right")
    with pytest.raises(InputError, match="has no markers that cameras see; show the hand to two cameras"):
        gesture.measure(MODEL, start, base_layout(start, 3))
    gesture.update(scene(unseen=NAMES), "flat")
    with pytest.raises(InputError, match="has no markers that cameras see"):
        gesture.measure(MODEL, start, base_layout(start, 3))


@pytest.mark.parametrize(
    ("tips", "base", "what"),
    [
        (TIP_NAMES[:4], BASE_NAMES, "five markers, thumb to little finger"),
        (TIP_NAMES, ("cyan",), "three or more markers, so that they tell how the palm lies"),
        (TIP_NAMES, ("cyan", "white", "red"), "each marker's name once"),
        (TIP_NAMES, ("cyan", "white", ""), "each marker's name once"),
    ],
)
def test_markers_that_cannot_be_are_refused(tips: tuple[str, ...], base: tuple[str, ...], what: str) -> None:
    with pytest.raises(SettingsError, match=what):
        GesturePoints(tips, base)


@given(st.lists(st.tuples(st.sampled_from(PHASES), st.integers(1, 9), st.integers(0, 9)), min_size=1, max_size=6))
def test_parts_are_read_as_they_are_written(parts: list[tuple[str, int, int]]) -> None:
    parts = [*((phase, 1, 0) for phase in PHASES), *parts]
    at, told = 0.0, []
    for phase, lasts, pause in parts:
        told.append((phase, at, at + lasts))
        at += lasts + pause
    spans = spans_of_text(", ".join(f"{phase}={begin}:{end}" for phase, begin, end in reversed(told)))
    assert [tuple(span) for span in spans] == told
    for phase, begin, end in told:
        assert phase_at(spans, begin) == phase_at(spans, end - 1e-6) == phase
        assert phase_at(spans, end) != phase or any(other == phase and b == end for other, b, _ in told)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("flat=0:4,knuckles=4:10", "the part 'hook' is missing; write it as flat=0:4"),
        ("flat=0:4,knuckle=4:10,hook=10:16", r"'knuckle' is no part of the gesture; .*did you mean knuckles\?"),
        ("flat=0:4,knuckles=3:10,hook=10:16", "flat and knuckles are both shown at 3 s"),
        ("flat=0,knuckles=4:10,hook=10:16", "'flat=0' does not say from when to when"),
        ("flat=4:0,knuckles=4:10,hook=10:16", "'flat=4:0' does not end after it begins"),
        ("flat=0:nan,knuckles=4:10,hook=10:16", "does not end after it begins"),
        ("flat=0:4,knuckles=4:10,hook=10:inf", "does not end after it begins"),
        ("", "'' is no part of the gesture"),
    ],
)
def test_what_says_no_parts_is_refused(text: str, why: str) -> None:
    with pytest.raises(SettingsError, match=why):
        spans_of_text(text)
