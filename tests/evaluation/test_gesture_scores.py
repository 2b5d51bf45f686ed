"""The scores of gestures: a detector that knows the truth has all, one that tells nothing has none."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.evaluation.gestures import SETTLED_S, GestureScores, gesture_scores
from mocapella.model.arms import PALM, SeenArm, SeenArms
from mocapella.model.observations import JointState
from mocapella.sources.simulate.depth_scene import ArmTruth, DepthShot

HZ = 30.0


def shot(k: int, gesture: str) -> DepthShot:
    points = np.tile([0.0, 0.0, 0.8], (23, 1))
    truth = ArmTruth(
        False, points, np.zeros(3), np.zeros(21), np.eye(4), np.ones(23, np.bool_), np.zeros(5, np.bool_),
        np.full((5, 2), 9), gesture, "anybody",
    )  # fmt: skip
    blank = np.zeros((48, 64), np.uint16)
    lens = np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0])
    return DepthShot(k / HZ, blank, 0.001, lens, (truth,), np.zeros((48, 64), np.float32), np.zeros((48, 64), np.uint8))


class Says:
    """What it is told to say, image after image."""

    name = "says"

    def __init__(self, words: list[str], at_m: float = 0.8) -> None:
        self._words, self._at_m = iter(words), at_m

    def update(self, depth: Any, at_s: float) -> SeenArms:
        word = next(self._words)
        points = np.full((23, 3), np.nan)
        points[PALM] = 0.0, 0.0, self._at_m
        arm = SeenArm(
            0, False, 1.0, points, np.full(23, JointState.TRACKED, np.uint8), np.zeros(23, np.float32), np.zeros(21),
            gesture=word, gesture_sure=1.0, grabbing=word == "fist",
        )  # fmt: skip
        return SeenArms((arm,))

    def reset(self) -> None: ...


TRUE = ["open"] * 20 + [""] * 5 + ["fist"] * 20
SHOTS = [shot(k, name) for k, name in enumerate(TRUE)]
SCORED = 20 - round(SETTLED_S * HZ)


def test_who_says_what_is_true_has_all() -> None:
    table = gesture_scores(Says(TRUE), SHOTS).table()
    assert table["frames"] == 2 * SCORED
    for name in ("open_right", "fist_right", "right", "grabbing_right", "not_grabbing_right"):
        assert table[name] == 1.0
    assert (table["none"], table["never_told"], table["late_median_ms"]) == (0.0, 0.0, 0.0)


def test_who_says_nothing_has_nothing_but_open_hands() -> None:
    table = gesture_scores(Says([""] * 45), SHOTS).table()
    assert (table["right"], table["none"], table["never_told"]) == (0.0, 1.0, 1.0)
    assert (table["grabbing_right"], table["not_grabbing_right"]) == (0.0, 1.0)
    assert np.isnan(table["late_median_ms"])


def test_a_hand_that_is_elsewhere_is_not_it() -> None:
    assert gesture_scores(Says(TRUE, at_m=1.0), SHOTS).table()["right"] == 0.0


def test_what_is_late_or_another_counts_so() -> None:
    late = [""] * 3 + TRUE[:-3]
    table = gesture_scores(Says(late), SHOTS).table()
    assert table["late_median_ms"] == pytest.approx(100.0, abs=0.1)
    wrong = gesture_scores(Says(["fist"] * 45), SHOTS)
    assert wrong.told == {("open", "fist"): SCORED, ("fist", "fist"): SCORED}
    assert wrong.table()["not_grabbing_right"] == 0.0


def test_scores_add_up() -> None:
    one, both = gesture_scores(Says(TRUE), SHOTS), GestureScores()
    both.add(one)
    both.add(gesture_scores(Says([""] * 45), SHOTS))
    assert both.table()["right"] == 0.5
    assert both.begun == 4


def test_a_detector_is_given_depths_in_metres() -> None:
    given: list[np.ndarray] = []

    class Keeps(Says):
        def update(self, depth: Any, at_s: float) -> SeenArms:
            given.append(depth)
            return super().update(depth, at_s)

    far = msgspec.structs.replace(SHOTS[0], depth=np.full((48, 64), 1600, np.uint16), unit_m=0.0005)
    gesture_scores(Keeps(["open"]), [far])
    np.testing.assert_allclose(given, 0.8, rtol=1e-6)
