from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocapella.errors import InputError, SettingsError
from mocapella.smoothing import one_euro_tuning
from mocapella.smoothing.one_euro import OneEuroSettings
from mocapella.smoothing.one_euro_tuning import HIGHEST_HZ, LONGEST_LAG_S, jitter, lag, spread, tune

slow = pytest.mark.slow  # filters by kernels that are compiled for these tests alone

AT_S = np.arange(240) / 60
RNG = np.random.default_rng(3)
NOISE = RNG.normal(0, 0.001, (240, 2, 3))
STILL = (AT_S, NOISE + np.array([0.1, 0.2, 0.5]))
SWING = np.stack([0.3 * np.sin(2 * np.pi * (1.2 * AT_S[:, None] + [0, 0.3]) + phase) for phase in (0, 1, 2)], axis=-1)
FAST = (AT_S, SWING + RNG.normal(0, 0.001, SWING.shape))
START = OneEuroSettings(per_component=True)


@slow
def test_both_goals_are_reached_and_no_more_than_that() -> None:
    tuned = tune(STILL, FAST, 0.0006, 0.02, START)
    assert tuned.jitter_reached
    assert tuned.lag_reached
    assert tuned.jitter_at_rest == pytest.approx(0.0006, rel=0.02)
    assert tuned.lag_s == pytest.approx(0.02, rel=0.02)
    assert tuned.lag_without_beta_s > 0.04
    assert tuned.raw_jitter == pytest.approx(0.001 * np.sqrt(3), rel=0.05)
    assert tuned.settings.per_component
    assert jitter(STILL, replace(tuned.settings, beta_per_m=0.0)) == tuned.jitter_at_rest
    assert lag(FAST, tuned.settings) == tuned.lag_s


@slow
def test_a_goal_that_is_met_without_a_filter_leaves_it_open() -> None:
    tuned = tune(STILL, FAST, 0.01, 0.02, START)
    assert (tuned.settings.min_cutoff_hz, tuned.settings.beta_per_m) == (HIGHEST_HZ, 0.0)


@slow
def test_goals_out_of_reach_are_said() -> None:
    """Of a speed that is smoothed for hours, no beta opens the filter."""
    tuned = tune(STILL, FAST, 1e-7, 0.01, replace(START, speed_cutoff_hz=1e-6))
    assert (tuned.jitter_reached, tuned.lag_reached) == (False, False)


@pytest.fixture
def delay_s(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> float:
    """Delay of a filter that delays the first two points, and returns others as measured [s]."""
    delay_s: float = request.param

    def delayed(at_s: np.ndarray, points: np.ndarray, _settings: OneEuroSettings) -> np.ndarray:
        result = points.copy()
        for p, d in np.ndindex(2, points.shape[2]):
            result[:, p, d] = np.interp(at_s - delay_s, at_s, points[:, p, d])
        return result

    monkeypatch.setattr(one_euro_tuning, "filtered", delayed)
    return delay_s


@pytest.mark.parametrize("delay_s", [0.0, 0.037, 0.2, 0.39], indirect=True)
def test_the_lag_of_a_delayed_recording_is_its_delay(delay_s: float) -> None:
    assert lag((AT_S, SWING), START) == pytest.approx(delay_s, abs=0.001)


@pytest.mark.parametrize("seed", range(4))
def test_a_lag_between_two_tried_ones_is_where_the_parabola_through_their_errors_is_least(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Delays of a line, and of lines only, have errors of an exact parabola."""
    at_s, speed = np.arange(128) / 64, np.array([[1.0, -0.5, 0.3]])
    line = at_s[:, None, None] * speed
    delay_s = float(np.random.default_rng(seed).uniform(0.01, LONGEST_LAG_S - 0.01))
    monkeypatch.setattr(one_euro_tuning, "filtered", lambda _, points, __: points - delay_s * speed)
    assert lag((at_s, line), START) == pytest.approx(delay_s, abs=1e-9)


@pytest.mark.parametrize("origin_s", [-64.0, 1024.0])
def test_it_does_not_matter_when_a_recording_was_made(monkeypatch: pytest.MonkeyPatch, origin_s: float) -> None:
    """The first half a second is left out in any case: here the filter is wrong in it."""

    def settling(at_s: np.ndarray, points: np.ndarray, _: OneEuroSettings) -> np.ndarray:
        early = (at_s - at_s[0] < one_euro_tuning.SETTLING_S)[:, None, None]
        return points - np.where(early, 1.0, 0.0625)

    monkeypatch.setattr(one_euro_tuning, "filtered", settling)
    at_s = np.arange(128) / 64
    line = (at_s, at_s[:, None, None] * np.ones((1, 3)))
    later = (at_s + origin_s, line[1])
    assert lag(later, START) == pytest.approx(lag(line, START), abs=1e-9) == pytest.approx(0.0625, abs=1e-9)
    assert jitter(later, START) == jitter(line, START) == spread(line[1][32:])


@pytest.mark.parametrize("delay_s", [LONGEST_LAG_S, 0.45, 0.5], indirect=True)
def test_a_longer_lag_than_the_longest_is_reported_as_that(delay_s: float) -> None:
    assert delay_s >= LONGEST_LAG_S == lag((AT_S, SWING), START)


@pytest.mark.parametrize("delay_s", [0.037], indirect=True)
@pytest.mark.parametrize("seen", [0, 1, 2])
def test_a_point_that_is_hardly_ever_seen_says_nothing_of_the_lag(delay_s: float, seen: int) -> None:
    """A filter begins anew with it each time, and so has no lag."""
    rare = np.full((len(AT_S), 1, 3), np.nan)
    rare[[100, 200][:seen]] = 10.0 * np.arange(seen)[:, None, None]
    assert lag((AT_S, np.concatenate([SWING, rare], axis=1)), START) == lag((AT_S, SWING), START)


@pytest.mark.parametrize("delay_s", [0.037], indirect=True)
def test_a_goal_is_reached_by_what_equals_it(delay_s: float) -> None:
    """This filter delays alike with any settings, so that jitter and lag are known before the tuning."""
    least_jitter, least_lag_s = jitter(STILL, START), lag((AT_S, SWING), START)
    assert least_lag_s == pytest.approx(delay_s, abs=0.001)
    met = tune(STILL, (AT_S, SWING), least_jitter, least_lag_s)
    assert (met.jitter_reached, met.lag_reached) == (True, True)
    missed = tune(STILL, (AT_S, SWING), float(np.nextafter(least_jitter, 0)), float(np.nextafter(least_lag_s, 0)))
    assert (missed.jitter_reached, missed.lag_reached) == (False, False)
    assert (missed.jitter_at_rest, missed.lag_s) == (met.jitter_at_rest, met.lag_s) == (least_jitter, least_lag_s)


@slow
def test_frames_without_a_point_are_left_out() -> None:
    gone = RNG.random((240, 2)) < 0.1
    tuned = tune(
        (AT_S, np.where(gone[..., None], np.nan, STILL[1])),
        (AT_S, np.where(gone[..., None], np.nan, FAST[1])),
        0.0006,
        0.02,
        START,
    )
    assert tuned.jitter_reached
    assert tuned.lag_reached


def test_the_spread_of_what_stands_is_zero() -> None:
    assert spread(np.ones((5, 2, 3))) == 0.0


@pytest.mark.parametrize(
    ("still", "fast", "said"),
    [
        ((AT_S[:30], STILL[1][:30]), FAST, "still recording is too short"),
        (STILL, (AT_S[:0], FAST[1][:0]), "fast recording is too short"),
        (STILL, (AT_S[::-1] + 9, FAST[1]), "too short|do not rise"),
        ((np.r_[AT_S[:-1], AT_S[-2] + 1e-9 * 0], STILL[1]), FAST, "do not rise"),
        ((AT_S, STILL[1] * np.nan), FAST, "hardly sees"),
        (STILL, (AT_S, np.zeros((240, 2, 3))), "nothing moves"),
    ],
)
def test_recordings_of_no_use_are_refused(
    still: tuple[np.ndarray, np.ndarray], fast: tuple[np.ndarray, np.ndarray], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        tune(still, fast, 0.0006, 0.02)


@pytest.mark.parametrize(("jitter_goal", "lag_goal_s"), [(0.0, 0.1), (0.1, 0.0), (0.1, LONGEST_LAG_S)])
def test_goals_out_of_range_are_refused(jitter_goal: float, lag_goal_s: float) -> None:
    with pytest.raises(SettingsError, match="goal"):
        tune(STILL, FAST, jitter_goal, lag_goal_s)
