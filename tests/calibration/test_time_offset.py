from __future__ import annotations

import numpy as np
import pytest
from test_pair_calibration import calibrated
from walking_people import FRONT, SIDE, Sensor, Walker

from mocapella.calibration.time_offset import TimeOffset


@pytest.mark.parametrize("clock", [-0.08, -0.02, 0.0, 0.004, 0.05, 0.12])
def test_an_offset_is_found_to_5_ms_from_somebody_who_walks(clock: float) -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, phase=0.013, clock=clock)
    estimate = calibrated(a, b, {0: Walker()}, 20).estimate()
    assert estimate.offset.known
    assert estimate.offset.seconds == pytest.approx(clock, abs=0.005)
    assert abs(estimate.offset.seconds - clock) < 1.5 * estimate.offset.bound


def test_it_is_unknown_while_nobody_walks_and_says_the_bound() -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, clock=0.05)
    offset = calibrated(a, b, {0: Walker(speed=0.0)}, 10).estimate().offset
    assert not offset.known
    assert offset.seconds == 0.0
    assert 0.05 < offset.bound <= 0.2
    assert str(offset).startswith("clock offset unknown, within ± ")


def test_somebody_who_goes_one_way_at_one_speed_says_nothing_of_it() -> None:
    class Conveyor(Walker):
        def at(self, t: float) -> np.ndarray:
            return Walker(speed=0.0).at(0.0) + np.array([0.8 * (t - 2.0), 0.0, 0.0])

    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, clock=0.05)
    assert not calibrated(a, b, {0: Conveyor()}, 4).estimate().offset.known


def test_a_known_offset_is_told_in_milliseconds() -> None:
    assert str(TimeOffset(0.0204, 0.003, True)) == "+20 ± 6 ms"
