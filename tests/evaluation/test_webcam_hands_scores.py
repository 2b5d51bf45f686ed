"""Scores of the hands of the method webcams: with trackers that know the truth, and the real one in each scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation.webcam_hands import HandFigures, evaluate, score_frames
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Phase, Scene, TrackedHand, TrackerState
from mocapella.sources.simulate.hand_keypoints import SimulatedHands, hand_frames, hand_keypoint_scene
from mocapella.tracker.protocol import scene_at

HandsOf = Callable[[SimulatedHands], tuple[TrackedHand, ...]]


class Told:
    """A tracker that is told the hands, by the time of the arrival."""

    def __init__(self, items: list[SimulatedHands], hands: HandsOf) -> None:
        self._hands = {item.at_ns: hands(item) for item in items}

    def update(self, arrival: Arrival) -> Scene:
        return scene_at(arrival, 0, TrackerState(Phase.TRACKING), {"hands": self._hands[arrival.at_ns]})


def hand(number: int, left: bool, points: Any, sd: float = 0.01) -> TrackedHand:
    states = np.full(21, JointState.TRACKED, np.uint8)
    return TrackedHand(number, left, points, states, np.full(21, sd, np.float32), np.zeros(21), None)


def figures(name: str, hands: HandsOf) -> HandFigures:
    scene = hand_keypoint_scene(name)
    items = list(hand_frames(scene, 0, seconds=1.0))
    return score_frames(items, scene.rig, tracker=Told(items, hands)).figures()


def truth(item: SimulatedHands) -> tuple[TrackedHand, ...]:
    return tuple(hand(k, side == "left", x) for k, (side, x) in enumerate(item.hands.items()))


def test_the_truth_scores_best() -> None:
    best = figures("passing", truth)
    assert (best.found_percent, best.side_percent, best.measured_percent) == (100.0, 100.0, 100.0)
    assert (best.phantoms_percent, best.ids, best.false_percent) == (0.0, 0, 0.0)
    assert (best.median_mm, best.p95_mm, best.jitter_mm, best.normalised) == (0.0, 0.0, 0.0, 0.0)


def test_nothing_is_found_by_who_finds_nothing_or_looks_elsewhere() -> None:
    assert figures("fist", lambda item: ()).found_percent == 0.0
    elsewhere = figures("fist", lambda item: (hand(0, False, item.hands["right"] + 0.2),))
    assert (elsewhere.found_percent, elsewhere.phantoms_percent) == (0.0, 100.0)


def test_an_error_of_a_length_a_side_and_a_second_id_are_counted() -> None:
    def wrong(item: SimulatedHands) -> tuple[TrackedHand, ...]:
        return (hand(item.at_ns, True, item.hands["right"] + [0.03, 0.0, 0.0]),)

    found = figures("fist", wrong)
    assert found.side_percent == 0.0
    assert found.median_mm == pytest.approx(30.0)
    assert found.tips_mm == pytest.approx(30.0)
    assert found.false_percent == 100.0
    assert found.normalised == pytest.approx(3.0 / np.sqrt(3.0))
    assert found.ids > 5
    assert np.isnan(found.jitter_mm)  # no id is there twice


def test_jitter_is_the_deviation_of_an_error_without_memory() -> None:
    rng = np.random.default_rng(0)

    def noisy(item: SimulatedHands) -> tuple[TrackedHand, ...]:
        return (hand(0, False, item.hands["right"] + rng.normal(size=(21, 3)) * 0.002),)

    assert figures("fist", noisy).jitter_mm == pytest.approx(2.0 * np.sqrt(3.0), rel=0.2)


def test_unknown_scenes_and_missing_seeds_are_named() -> None:
    with pytest.raises(SettingsError, match="unknown scene 'fists'"):
        evaluate(["fists"])
    with pytest.raises(SettingsError, match="seeds"):
        evaluate(["fist"], seeds=())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "most_mm"),
    [("fist", 4.0), ("pinch", 4.0), ("pointing", 4.0), ("spread", 4.0), ("tips-missing", 4.0), ("outliers", 5.0),
     ("passing", 4.0), ("person", 4.0), ("crossed-arms", 4.0), ("camera-exchanged", 4.0), ("sides-confused", 4.0)],
)  # fmt: skip
def test_the_method_finds_all_hands_on_their_sides(name: str, most_mm: float) -> None:
    found = evaluate([name], [3])["scenes"][name]["mean"]
    assert found["found_percent"] > 97.0
    assert found["phantoms_percent"] == 0.0
    assert found["side_percent"] > 97.0
    assert found["median_mm"] < most_mm
    assert found["false_percent"] < 1.0


@pytest.mark.slow
def test_a_hand_that_one_camera_sees_is_near_and_not_measured() -> None:
    found = evaluate(["one-camera"], [3])["scenes"]["one-camera"]["mean"]
    assert found["alone_mm"] < 40.0
    assert found["measured_percent"] < 80.0
