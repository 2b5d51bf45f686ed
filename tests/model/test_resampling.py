"""A constant rate: exact on lines, unknown in gaps, never surer than its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.twists import exp_twist
from mocapella.model.resampling import LONGEST_GAP_S, check_rate, resampled, usual_rate_hz
from mocapella.model.trajectories import Trajectories


def line(times: np.ndarray, rate_hz: float = 30.0, gap: slice = slice(0, 0)) -> Trajectories:
    """A point that moves along a line, and turns; unknown in the gap."""
    positions = np.array([1.0, -2.0, 3.0]) * times[:, None, None, None] + np.array([0.5, 0.0, 1.0])
    positions[gap] = np.nan
    states = np.full(positions.shape[:3], 2, np.uint8)
    states[gap] = 0
    sd = np.broadcast_to(0.01 + 0.1 * times[:, None, None], states.shape).astype(np.float32)
    poses = exp_twist(np.concatenate([positions[:, 0, 0], np.outer(times, [0.0, 0.3, 0.0])], axis=1))[:, None]
    return Trajectories(
        "objects", times, np.zeros(len(times), np.int64), ("cup",), ("origin",), positions, states, sd, (),
        ("bend",), times[:, None, None] * 2.0, poses, rate_hz,
    )  # fmt: skip


@settings(deadline=None)
@given(st.lists(st.floats(0.001, 0.09), min_size=1, max_size=40), st.floats(5.0, 200.0))
def test_motion_along_a_line_is_kept_exactly(steps: list[float], rate: float) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    found = resampled(line(times), rate)
    np.testing.assert_allclose(np.diff(found.times_s), 1 / rate, rtol=1e-9)
    assert found.times_s[-1] <= times[-1] + 1e-6 < found.times_s[-1] + 1 / rate + 2e-6
    wanted = line(np.minimum(found.times_s, times[-1]))
    inside = found.present[:, 0]
    assert inside[: int((times[-1] - 1e-6) * rate)].all()
    np.testing.assert_allclose(found.positions[inside], wanted.positions[inside], atol=1e-9)
    np.testing.assert_allclose(found.angles[inside], wanted.angles[inside], atol=1e-9)
    np.testing.assert_allclose(found.sd[inside], wanted.sd[inside], rtol=1e-5)
    assert found.poses is not None
    assert wanted.poses is not None
    np.testing.assert_allclose(found.poses[inside, :, :3, :3], wanted.poses[inside, :, :3, :3], atol=1e-7)
    assert found.rate_hz == rate


@settings(deadline=None)
@given(st.integers(1, 20), st.integers(1, 8))
def test_short_gaps_are_bridged_and_long_ones_stay_unknown(begin: int, length: int) -> None:
    times = np.arange(40) / 30.0
    gap = slice(begin, begin + length)
    found = resampled(line(times, gap=gap), 30.0)
    bridged = (length + 1) / 30.0 <= LONGEST_GAP_S + 1e-9
    assert found.present[gap].all() if bridged else not found.present[gap].any()
    outside = np.ones(40, bool)
    outside[gap] = False
    np.testing.assert_allclose(found.positions[outside], line(times).positions[outside], atol=1e-9)


def test_a_sample_between_two_is_as_uncertain_as_the_worse_one() -> None:
    own = line(np.array([0.0, 0.05, 0.1]))
    own.states[1] = 1
    found = resampled(own, 40.0)
    assert found.states[:, 0, 0].tolist() == [2, 1, 1, 1, 2]


def test_the_usual_rate_is_whole_if_it_is_near_a_whole_number() -> None:
    assert usual_rate_hz(line(np.arange(3.0), 29.97)) == 30.0
    assert usual_rate_hz(line(np.arange(3.0), 12.5)) == 12.5
    assert usual_rate_hz(line(np.arange(1.0), np.nan)) == 1.0


@pytest.mark.parametrize("rate", [0.0, -1.0, 10_001.0, float("nan")])
def test_an_impossible_rate_is_refused(rate: float) -> None:
    with pytest.raises(SettingsError, match="rate"):
        resampled(line(np.arange(3.0)), rate)


@given(st.floats(0.01, 1e6))
def test_a_rate_that_gives_one_frame_of_many_is_refused_with_one_that_works(seconds: float) -> None:
    with pytest.raises(SettingsError, match="a lower rate gives a single frame") as refused:
        check_rate(line(np.linspace(0.0, seconds, 5)), 0.5 / seconds)
    least = float(str(refused.value).split("at least ")[1].split(" Hz")[0])
    check_rate(line(np.linspace(0.0, seconds, 5)), least)
    if least <= 10_000:
        assert len(resampled(line(np.linspace(0.0, seconds, 5)), least)) == 2
    check_rate(line(np.zeros(1)), 1e-9)  # of one frame there is no other


@pytest.mark.parametrize("rate", [5.0, 9.0, 30.0])
def test_a_slow_sensor_with_jitter_has_no_gaps(rate: float) -> None:
    times = np.arange(50) / rate + np.random.default_rng(0).normal(size=50) * 0.002
    assert resampled(line(times, rate)).present.all()


def test_runs_far_apart_do_not_fill_the_memory() -> None:
    times = np.concatenate([np.arange(5.0), 1.7e9 + np.arange(5.0)])
    with pytest.raises(SettingsError, match="number of frames"):
        resampled(line(times), 30.0)


def test_nothing_stays_nothing() -> None:
    assert len(resampled(line(np.arange(3.0)).at(slice(0, 0)), 30.0)) == 0
