"""What the size of the hands that were found says of lens and unit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.model.observations import JointState
from mocapella.sources.depth_options import HandSizeCheck
from mocapella.sources.simulate.depth_scene import load_depth_scene


def hand(length_m: float) -> Any:
    """An arm whose middle finger ends so far from the wrist."""
    points = np.zeros((23, 3))
    points[[9, 10, 11, 12], 1] = length_m * np.array([0.5, 0.7, 0.85, 1.0])
    return SimpleNamespace(points=points, states=np.full(23, JointState.TRACKED, np.uint8))


def said(length_m: float, focal_px: float = 575.8, unit_m: float = 0.001, hands: int = 5) -> str:
    check = HandSizeCheck([focal_px, focal_px, 319.5, 239.5], (640, 480), unit_m)
    for _ in range(hands):
        check.update([hand(length_m)])
    return check.problem


@pytest.mark.parametrize("length_m", [0.145, 0.165, 0.189, 0.21, 0.23])
def test_people_have_hands_of_these_sizes(length_m: float) -> None:
    assert said(length_m) == ""


@pytest.mark.parametrize(
    ("length_m", "focal_px", "unit_m", "focal", "unit"),
    [
        (0.30, 300.0, 0.001, "575.8, which is usual for 640 × 480", "about 0.00062"),
        (0.10, 1100.0, 0.001, "575.8, which is usual for 640 × 480", "about 0.0019"),
        (0.37, 575.8, 0.002, "about 1145", "0.001"),
        (0.10, 575.8, 0.0005, "about 310", "0.001"),
    ],
)
def test_what_would_be_likely_is_named(length_m: float, focal_px: float, unit_m: float, focal: str, unit: str) -> None:
    problem = said(length_m, focal_px, unit_m)
    assert problem.startswith(f"hands are {100 * length_m:.0f} cm long, people's 14 to 23.5 cm")
    assert f"--intrinsics with an F of {focal}, or --unit {unit}, would be likely" in problem


def problem_of(*arms: Any) -> str:
    check = HandSizeCheck([575.8, 575.8, 319.5, 239.5], (640, 480), 0.001)
    for arm in arms:
        check.update([arm])
    return check.problem


def in_posture(name: str, times: float) -> Any:
    """A rendered hand of 16.5 cm, open or a fist, as if it were so many times as large."""
    scene = load_depth_scene("fist", seed=1, sensor="exact")
    arm = next(shot.arms[0] for shot in scene.frames(3.0) if shot.arms[0].gesture == name)
    return SimpleNamespace(points=times * arm.points, states=hand(0.19).states)


def test_a_fist_that_looks_too_short_is_not_doubted_and_the_same_hand_open_is() -> None:
    assert problem_of(*[in_posture("fist", 0.8)] * 5) == ""
    assert problem_of(*[in_posture("open", 0.8)] * 5).startswith("hands are 13 cm long")


def test_no_posture_explains_a_hand_that_is_half_as_long_or_longer_than_any() -> None:
    assert problem_of(*[in_posture("fist", 0.6)] * 5).startswith("hands are 10 cm long")
    assert problem_of(*[in_posture("fist", 1.6)] * 5).startswith("hands are 26 cm long")


def test_straight_fingers_go_before_bent_ones_and_a_tip_that_is_inferred_is_none() -> None:
    assert problem_of(*[in_posture("fist", 0.6)] * 20, *[hand(0.19)] * 5) == ""
    inferred = hand(0.13)
    inferred.states[12] = JointState.INFERRED
    assert problem_of(*[inferred] * 20) == ""
    assert problem_of(*[hand(0.13)] * 5).startswith("hands are 13 cm long")


def test_a_few_hands_and_hands_without_landmarks_say_nothing() -> None:
    assert said(0.3, hands=4) == ""
    unknown = hand(0.3)
    unknown.points[11] = np.nan
    assert problem_of(*[unknown] * 20) == ""
