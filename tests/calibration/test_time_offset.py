from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.pair_judgement import offset_of
from support.walking_people import FRONT, SIDE, Sensor, Walker
from test_pair_calibration import calibrated

from mocapella.calibration import pair_memory as at
from mocapella.calibration.time_offset import BLOCKS_WANTED, OFFSET_PRIOR_SD, TimeOffset, moved_clock


def sums(u: np.ndarray, r: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Of blocks (blocks, joints)."""
    a, g = (z * u).sum(axis=1), (z * r).sum(axis=1)
    return np.array([a.sum(), g.sum(), a @ a, a @ g, g @ g])


@given(st.integers(0, 2**32 - 1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_without_noise_the_offset_is_exact_and_follows_the_time_that_frames_are_brought_to(
    seed: int, offset: float, by: float
) -> None:
    u = np.random.default_rng(seed).normal(size=(12, 75))
    clock = sums(u, offset * u, u)
    found, sd = offset_of(clock)
    assert found == pytest.approx(offset, abs=1e-9)
    assert sd < 1e-3
    moved, moved_sd = offset_of(moved_clock(clock, by))
    assert moved == pytest.approx(offset - by, abs=1e-9)
    assert moved_sd == pytest.approx(sd, abs=1e-3)
    assert moved_clock(clock, by)[at.CLOCK_A] <= clock[at.CLOCK_A]


def test_the_other_sensor_as_instrument_leaves_no_bias_and_the_bound_is_true() -> None:
    rng, errors = np.random.default_rng(0), []
    for _ in range(200):
        u = rng.normal(size=(15, 75))
        u_a, u_b = u + 1.5 * rng.normal(size=u.shape), u + 1.5 * rng.normal(size=u.shape)
        r = 0.05 * u + 0.03 * rng.normal(size=u.shape)
        found, sd = offset_of(sums(u_b, r, u_a))
        errors.append((float(found) - 0.05, float(sd)))
    error, sd = np.array(errors).T
    assert abs(error.mean()) < 0.001
    assert 0.8 < np.sqrt(np.mean((error / sd) ** 2)) < 1.3


def test_too_few_blocks_or_none_say_nothing() -> None:
    u = np.random.default_rng(0).normal(size=(3, 75))
    for clock in (np.zeros(at.CLOCK_SUMS), sums(u, 0.05 * u, u), sums(u, 0.05 * u, -u)):
        found, sd = offset_of(clock)
        assert (float(found), float(sd)) == (0.0, pytest.approx(OFFSET_PRIOR_SD))


@pytest.mark.parametrize("blocks", range(1, 6))
def test_as_many_equal_blocks_as_are_wanted_are_enough(blocks: int) -> None:
    u = np.ones((blocks, 4))  # of equal blocks, Kish's count is their number
    found, sd = offset_of(sums(u, 0.05 * u, u))
    if blocks >= BLOCKS_WANTED:
        assert float(found) == pytest.approx(0.05)
        assert float(sd) < 1e-3
    else:
        assert (float(found), float(sd)) == (0.0, pytest.approx(OFFSET_PRIOR_SD))


def test_offsets_are_found_where_most_of_the_motion_seen_is_noise() -> None:
    a, b = Sensor("a", FRONT, noise=0.03), Sensor("b", SIDE, noise=0.03, phase=0.013, clock=0.05)
    estimate = calibrated(a, b, {0: Walker()}, 30).estimate()
    assert estimate.offset_now.seconds == pytest.approx(0.05, abs=2 * estimate.offset_now.sd)
    assert estimate.offset_now.sd < 0.015


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


def test_a_clock_of_which_nothing_is_known_any_more_is_left_where_it_was() -> None:
    pair = calibrated(Sensor("a", FRONT), Sensor("b", SIDE, clock=0.05), {0: Walker()}, 10)
    pair.scalars[at.REFERENCE_OFFSET], pair.scalars[at.OFFSET], pair.scalars[at.FOLLOWED] = 0.05, 0.0, -1.0
    pair.clock[:] = 0.0
    pair.follow_clock(pair.estimate())
    assert pair.scalars[at.REFERENCE_OFFSET] + pair.scalars[at.OFFSET] == 0.05


@pytest.mark.parametrize("blocks", [3, 4, 8])
def test_of_few_blocks_the_bound_is_a_little_too_careful(blocks: int) -> None:
    """The scatter of a few blocks may be small by chance: the variance is what it would be of two more blocks."""
    a, offset = 100.0, 0.02
    g = offset * a + np.random.default_rng(blocks).normal(0, 0.5, (4000, blocks))
    one, total = np.ones(4000), g.sum(axis=1)
    clock = np.stack([a * blocks * one, total, a * a * blocks * one, a * total, (g**2).sum(axis=1)], axis=-1)
    found, sd = offset_of(clock)
    assert (sd**2).mean() / ((found - offset) ** 2).mean() == pytest.approx((blocks + 2) / blocks, rel=0.1)


def test_a_change_of_50_ms_leaves_a_part_in_e_of_the_weight_in_either_direction() -> None:
    clock = np.array([3.0, 0.1, 4.0, 0.2, 0.3])
    for by in (-0.05, 0.05):
        assert moved_clock(clock, by)[0] == pytest.approx(3.0 / np.e)
        assert moved_clock(clock, by)[2] == pytest.approx(4.0 / np.e**2)
    np.testing.assert_array_equal(moved_clock(clock, 0.0), clock)


def test_a_bound_is_told_in_milliseconds() -> None:
    assert str(TimeOffset(0.0, 0.0304, False)) == "clock offset unknown, within ± 61 ms"
