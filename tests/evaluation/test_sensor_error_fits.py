"""What the fits of the sensor errors find again in views that were made of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocapella.evaluation.facing_sessions import AlignedViews
from mocapella.evaluation.labelled_views import LabelledViews
from mocapella.evaluation.sensor_error_fit import (
    KNOTS_S,
    LAG_S,
    fit_bias,
    fit_correlation,
    fit_shares,
    fit_spread,
    fit_still_shares,
    unexplained,
)
from mocapella.model.session import SCENARIOS
from mocapella.sources.simulate.body import BODY, JOINT
from mocapella.sources.simulate.measured import BIAS_BINS, spline_weights

WALK, STATIONARY = SCENARIOS["walk"], SCENARIOS["stationary"]
SPINE = JOINT["SpineBase"]
NOTHING = np.zeros((len(BODY), BIAS_BINS, 3))


def views(seen: np.ndarray, task: Any = WALK, hidden: Any = False) -> LabelledViews:
    """Views (frames, 2, joints, 3) of somebody who faces both sensors, which are side by side."""
    frames = len(seen)
    zeros, nothing = np.zeros((frames, 2)), np.zeros((frames, 2), dtype=bool)
    raw = AlignedViews(zeros, np.broadcast_to(task, frames), seen, seen, np.zeros((2, 3)), zeros)
    hides = np.broadcast_to(hidden, (frames, 2, len(BODY)))
    return LabelledViews("x", 0, raw, zeros + 0.1, zeros + 0.1, nothing, seen, hides)


def noise(frames: int, sd: Any, seed: int = 0) -> np.ndarray:
    return np.asarray(sd * np.random.default_rng(seed).normal(size=(frames, 2, len(BODY), 3)))


def turning(frames: int) -> LabelledViews:
    """Views 70° apart of somebody who turns around, of which the first is off by 5 cm to its left for all joints."""
    alpha = np.linspace(-np.pi, np.pi, frames)
    both = np.stack([alpha, (alpha - np.radians(70) + np.pi) % (2 * np.pi) - np.pi], axis=1)
    seen = np.zeros((frames, 2, len(BODY), 3))
    seen[:, 0, :, 1] = 0.05 * np.cos(alpha)[:, None]
    seen[:, 1, :, 1] = 0.05 * np.cos(both[:, 1])[:, None]
    of = views(seen)
    return LabelledViews("x", 0, of.raw, both, both, of.mirrored, seen, of.hidden)


def away(rest: np.ndarray) -> float:
    return float(np.linalg.norm(rest, axis=-1).mean())


def test_a_bias_is_the_same_of_twice_as_many_views() -> None:
    of = turning(200)
    np.testing.assert_allclose(fit_bias([of, of]), fit_bias([of]), atol=1e-9)


def test_a_bias_is_not_overdone() -> None:
    """What no pair determines stays 0, and what remains of a difference has the sign of the difference."""
    seen = np.zeros((50, 2, len(BODY), 3))
    seen[:, 0] = [0.04, 0.02, -0.03]
    of, alpha = views(seen), np.tile([0.1, 2.0], (50, 1))
    of = LabelledViews("x", 0, of.raw, alpha, alpha, of.mirrored, seen, of.hidden)
    bias = fit_bias([of])
    rest, difference = unexplained(of, bias), seen[:, 0] - seen[:, 1]
    assert away(rest) < 0.3 * away(difference)
    assert (rest * difference > 0).all()
    assert (bias == 0).all(axis=(0, 2)).any()


def test_a_limb_that_is_lost_now_and_then_does_not_bend_the_bias() -> None:
    of = turning(600)
    lost = of.positions.copy()
    lost[::7, 0] += [0.0, 1.5, 0.0]
    rest = unexplained(of, fit_bias([LabelledViews("x", 0, of.raw, of.alpha, of.alpha, of.mirrored, lost, of.hidden)]))
    assert away(rest) < 0.5 * away(of.positions[:, 0] - of.positions[:, 1])


def test_hidden_joints_have_noise_of_their_own() -> None:
    frames = 3000
    hidden = np.random.default_rng(1).random((frames, 2, len(BODY))) < 0.4
    seen = noise(frames, np.where(hidden, 0.06, 0.02)[..., None])
    of = views(seen, hidden=hidden)
    sd = fit_spread([of], [seen[:, 0] - seen[:, 1]])
    assert sd[:, 0, 0] == pytest.approx(0.02, rel=0.25)
    assert sd[:, 1, 0] == pytest.approx(0.06, rel=0.25)


@pytest.mark.parametrize(("count", "own"), [(99, False), (100, True)])
def test_a_hundred_frames_are_enough_for_noise_of_their_own(count: int, own: bool) -> None:
    """A rarer case has the largest noise of visible joints."""
    hidden = np.zeros((1000, 2, len(BODY)), dtype=bool)
    hidden[:count, 0] = True
    seen = noise(1000, np.where(hidden, 0.09, 0.02)[..., None])
    sd = fit_spread([views(seen, hidden=hidden)], [seen[:, 0] - seen[:, 1]])
    assert (sd[SPINE, 1, 0] > 2 * sd[SPINE, 0, 0]) is np.bool_(own)
    if not own:
        assert sd[SPINE, 1, 0] == sd[SPINE, 0].max()


def test_few_frames_in_which_all_is_lost_hardly_correlate_joints() -> None:
    seen = noise(2000, 0.02)
    seen[::33, 0] += 1.0
    sd = np.full((len(BODY), 2, 3), 0.02)
    found = fit_correlation([views(seen)], [seen[:, 0] - seen[:, 1]], sd)
    assert np.diag(found) == pytest.approx(1)
    assert 0.0 < found[~np.eye(len(BODY), dtype=bool)].max() < 0.4


def splines(knot_s: float, frames: int, seed: int = 0) -> np.ndarray:
    """(frames, joints, 3) random cubic splines of variance 1, with knots in such intervals [s]."""
    places = LAG_S / knot_s * np.arange(frames)
    first = np.floor(places).astype(int)
    knots = np.random.default_rng(seed).normal(size=(first[-1] + 4, len(BODY), 3))
    weights = np.stack([spline_weights(float(place - k)) for place, k in zip(places, first, strict=True)])
    return np.einsum("fw,fwjc->fjc", weights, knots[first[:, None] + np.arange(4)])


@pytest.mark.parametrize("which", range(len(KNOTS_S)))
def test_splines_are_told_from_each_other_and_from_white_noise(which: int) -> None:
    made = 0.02 * splines(KNOTS_S[which], 4000) + noise(4000, 0.03)[:, 0]
    wanted = np.zeros(len(KNOTS_S))
    wanted[which] = 0.02**2
    assert fit_shares([made]) == pytest.approx(wanted, abs=0.15 * 0.02**2)


def test_who_stands_sways_by_a_share_of_the_noise_in_walk_about_any_mean() -> None:
    """The variance of both views together is twice that of one."""
    frames, sd = 3000, np.full((len(BODY), 2, 3), 0.02)
    task = np.where(np.arange(2 * frames) < frames, STATIONARY, WALK)
    rest = np.concatenate([0.05 + 0.01 * splines(KNOTS_S[1], frames), 0.1 * noise(frames, 1.0)[:, 0]])
    of = views(np.zeros((2 * frames, 2, len(BODY), 3)), task)
    share = fit_still_shares([of], [rest], sd)
    assert share == pytest.approx([0.0, 0.01**2 / (2 * 0.02**2), 0.0], abs=0.02)
