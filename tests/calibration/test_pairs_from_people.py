"""Pairs of sensors that people calibrate: which sensor was moved, as far as the other pairs tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import PairCalibration
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.sensor_pair import PairOfSensors

LASTS_S = PeopleCalibration().settings.moved_after_s


def confirmed(agreed_at: float) -> PairOfSensors:
    """A pair that somebody calibrated who walked, and last agreed with at that time."""
    calibration = PairCalibration()
    calibration.scalars[at.BLOCKS_CLOSED] = 1000.0
    return PairOfSensors(calibration, ColdStart(calibration.settings), shown=True, agreed_at=agreed_at)


@given(now=st.floats(0, 1e6))
@pytest.mark.parametrize(("ago_s", "moved"), [(0.0, "a"), (LASTS_S - 0.1, "a"), (LASTS_S + 0.1, "b"), (np.inf, "b")])
def test_of_two_sensors_that_contradict_the_one_was_moved_with_which_no_third_agrees(
    ago_s: float, moved: str, now: float
) -> None:
    """If no third agrees with either, it is the last."""
    people = PeopleCalibration()
    people._tracks = {name: SensorTracks.empty(25) for name in "abc"}
    people._pairs = {("a", "b"): confirmed(-np.inf), ("b", "c"): confirmed(now - ago_s)}
    people._believe(("a", "b"), PairCalibration(), now)
    assert people._moved == {moved: now}
