from __future__ import annotations

import numpy as np
import pytest

from mocapella.calibration.pair_calibration import WALK, PairCalibration, PairEstimate
from mocapella.calibration.quality import pair_quality, seconds
from mocapella.calibration.time_offset import TimeOffset


def estimate(problem: str = "", motion_s: float = 8.2) -> PairEstimate:
    offset = TimeOffset(0.0, 0.1, False)
    return PairEstimate(np.eye(4), np.eye(6), 0.0123, np.radians(0.42), motion_s, 9.0, 0.05, offset, offset, problem)


def test_it_says_how_much_was_seen_and_how_sure_it_is() -> None:
    assert pair_quality("front", "side", estimate()) == "front–side: 8 s of shared motion, 12 mm, 0.4°"


def test_it_says_what_to_do_first() -> None:
    assert pair_quality("front", "side", estimate(WALK)).startswith("front–side: walk a few steps (")
    nothing = PairCalibration().estimate()
    assert pair_quality("front", "side", nothing) == "front–side: both sensors must see a person"


@pytest.mark.parametrize(
    ("value", "text"),
    [(8.2, "8 s"), (119.0, "119 s"), (120.0, "2 min"), (600.0, "10 min"), (7199.0, "120 min"), (7200.0, "2 h")],
)
def test_long_times_are_told_in_minutes_and_hours(value: float, text: str) -> None:
    assert seconds(value) == text
