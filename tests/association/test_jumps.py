"""Bodies that a sensor throws about just before it loses somebody."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.jumps import Jumps, JumpSettings
from mocapella.errors import SettingsError

DT = 1 / 30
SPINE = np.array([[0.0, 0.9, 0.0], [0.0, 1.2, 0.0], [0.0, 1.6, 0.0]])


def at(*x: float) -> np.ndarray:
    """Bodies (n, 3, 3) at these places to the side."""
    return SPINE + np.array([[[place, 0.0, 2.5]] for place in x])


speeds = st.floats(-3.0, 3.0)


@given(st.booleans(), st.lists(st.tuples(speeds, speeds, st.booleans()), max_size=20))
def test_who_walks_never_jumps_where_a_sensor_swaps_ids_or_loses_joints(
    swaps: bool, steps: list[tuple[float, float, bool]]
) -> None:
    jumps, places = Jumps(), np.array([0.0, 1.0])
    jumps.update("side", (0, 1), at(*places), 0.0)
    for k, (one, other, now) in enumerate(steps):
        places = places + DT * np.array([one, other])
        ids, bodies = ((1, 0) if swaps and now else (0, 1)), at(*places)
        if now and not swaps:
            bodies[0] = np.nan
        assert jumps.update("side", ids, bodies, (k + 1) * DT).all()


def test_a_body_that_is_thrown_about_is_nobody_until_it_is_back() -> None:
    jumps = Jumps()
    for k, place in enumerate([0.0, 0.02, 0.9, 0.8, -0.4, 0.05]):
        there = jumps.update("front", (7, 8), at(place, 2.0), k * DT)
        assert there.tolist() == [abs(place) < 0.1, True]


def test_what_stays_where_it_jumped_to_is_somebody_after_a_while() -> None:
    jumps = Jumps(JumpSettings(doubt_s=0.5))
    jumps.update("front", (7,), at(0.0), 0.0)
    there = [bool(jumps.update("front", (7,), at(1.0), k * DT)[0]) for k in range(1, 20)]
    assert there == [k * DT > 0.5 for k in range(1, 20)]


@pytest.mark.parametrize("clock_s", [-3600.0, -0.2, 3600.0])
def test_a_clock_that_jumps_leaves_nobody_in_doubt_for_long(clock_s: float) -> None:
    jumps = Jumps()
    jumps.update("front", (7,), at(0.0), 0.0)
    there = [bool(jumps.update("front", (7,), at(1.0), clock_s + k * DT)[0]) for k in range(30)]
    assert there[-1]


def test_sensors_and_new_bodies_are_apart() -> None:
    jumps = Jumps()
    jumps.update("front", (7,), at(0.0), 0.0)
    assert jumps.update("side", (7,), at(2.0), DT).all()
    assert jumps.update("front", (7, 9), at(0.0, 3.0), DT).all()
    assert not jumps.update("front", (7, 9), at(5.0, 3.0), 2 * DT).all()
    jumps.reset()
    assert jumps.update("front", (7,), at(5.0), 3 * DT).all()


def test_settings_are_checked() -> None:
    with pytest.raises(SettingsError, match="fastest_m_s"):
        JumpSettings(fastest_m_s=-1.0)
