"""Fits the bias, noise and correlation of Kinect skeletons to pairs of views; the steps are in `sensor_errors`.

Bias: robust ridge regression over the facing. Noise: non-negative least squares. Correlation in time: autocovariance
fitted by random cubic splines and white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mocapella.evaluation.fused_metrics import jitter
from mocapella.evaluation.labelled_views import MIRROR, STATIONARY, LabelledViews
from mocapella.sources.simulate.body import BODY
from mocapella.sources.simulate.measured import (
    BIAS_BINS,
    SIDES_DEG,
    bias_place,
    spline_weights,
    view_axes,
)

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

KNOTS_S: Final = (0.1, 0.4, 2.0)
"""Knot spacings of the splines that describe the autocorrelation [s]; more splines hardly improve it."""
RIDGE: Final = 0.02
"""Ridge, relative to the mean of the normal matrix's diagonal; a coefficient that no pair determines becomes 0."""
LARGEST: Final = 0.3
"""Larger differences of two views are clipped to this, so that a lost limb does not dominate [m]."""
MEAN_LENGTH: Final = np.sqrt(8 / np.pi)
"""Mean length of a normal vector in space whose coordinates have variance 1."""
LAGS: Final = np.array([0, 1, 2, 3, 4, 6, 8, 10, 12, 15, 20, 30, 45])
LAG_S: Final = 0.035
"""Interval between two frames of the log [s]."""


def fit_bias(views: Sequence[LabelledViews]) -> Float64:
    """Fit the bias (25, `BIAS_BINS`, 3) of each joint in the view's axes, by bin of the facing α [m].

    It is a robust ridge regression.
    """
    size = 3 * BIAS_BINS
    bias = np.empty((len(BODY), BIAS_BINS, 3))
    for joint in range(len(BODY)):
        N, g = np.zeros((size, size)), np.zeros(size)
        for view in views:
            for mirror in (False, True):
                d = np.subtract(*view.positions[:, :, MIRROR[joint] if mirror else joint].swapaxes(0, 1))
                X = _design(view.alpha, view.raw.toward, mirror)
                w = 1 / np.maximum(np.linalg.norm(d, axis=1), 0.02)
                N += np.einsum("nij,nik,n->jk", X, X, w, optimize=True)
                g += np.einsum("nij,ni,n->j", X, d, w, optimize=True)
        bias[joint] = np.linalg.solve(N + RIDGE * np.trace(N) / size * np.eye(size), g).reshape(BIAS_BINS, 3)
    return bias


def _design(alpha: Float64, toward: Float64, mirror: bool) -> Float64:
    """Return the design matrix (frames, 3, 3 · `BIAS_BINS`) of view 1 − view 2."""
    X = np.zeros((len(alpha), 3, BIAS_BINS, 3))
    frames = np.arange(len(alpha))
    for view, sign in ((0, 1.0), (1, -1.0)):
        first, second, part = bias_place(-alpha[:, view] if mirror else alpha[:, view])
        axes = sign * view_axes(toward[:, view])
        if mirror:
            axes[:, :, 0] *= -1
        X[frames, :, first] += (1 - part)[:, None, None] * axes
        X[frames, :, second] += part[:, None, None] * axes
    return X.reshape(len(alpha), 3, -1)


def unexplained(view: LabelledViews, bias: Float64) -> Float64:
    """Return the difference (frames, joints, 3) of the two views after subtracting their biases [m].

    It is d − b(α₁) + b(α₂) of `mocapella.evaluation.sensor_errors`, in the reference sensor's camera space. d is the
    reference sensor's view minus the second sensor's. A joint that is NaN in a view is NaN.

    ``bias`` (25, `BIAS_BINS`, 3) is the result of `fit_bias` [m].
    """
    X = _design(view.alpha, view.raw.toward, mirror=False)
    explained = np.einsum("nij,kj->nki", X, bias.reshape(len(bias), -1))
    return np.asarray(view.positions[:, 0] - view.positions[:, 1] - explained)


def fit_spread(views: Sequence[LabelledViews], rests: Sequence[Float64]) -> Float64:
    """Fit the standard deviation (25, 2, 3) of a coordinate of one view in Walk, the study's walking task [m].

    The axes are the joint, visible or hidden by the person's own body, and the person's side (front, side, back) that
    the sensor sees. A left joint and its right one share a fit. A cell with fewer than 100 samples gets the largest
    variance of the visible cells and, if it is hidden, of the frequent hidden ones.

    Args:
        views: the sessions' views.
        rests: (frames, joints, 3) result of `unexplained` for each of ``views``, finite in Walk [m].
    """
    sd = np.empty((len(BODY), 2, 3))
    for joint in range(len(BODY)):
        rows, lengths = [], []
        for view, rest in zip(views, rests, strict=True):
            side = np.digitize(np.degrees(np.abs(view.alpha[view.walk])), SIDES_DEG)
            for one in {joint, int(MIRROR[joint])}:
                place = side + 3 * view.hidden[view.walk][:, :, one]
                rows.append((place[..., None] == np.arange(6)).sum(axis=1))
                lengths.append(np.minimum(np.linalg.norm(rest[view.walk][:, one], axis=-1), LARGEST))
        X, length = np.concatenate(rows).astype(np.float64), np.concatenate(lengths)
        few = X.sum(axis=0) < 100
        variance = nnls(X, length**2 / 3)[0]
        # The residuals have long tails: normal noise of that variance would have too large a mean error.
        variance *= (length.mean() / (MEAN_LENGTH * np.sqrt(X @ variance).mean())) ** 2
        variance = variance.reshape(2, 3)
        # A rare case gets the largest value of the frequent ones.
        for state, side in zip(*np.nonzero(few.reshape(2, 3)), strict=True):
            variance[state, side] = variance[state][~few.reshape(2, 3)[state]].max(initial=variance[0].max())
        sd[joint] = np.sqrt(variance)
    return sd


def _expected_variance(view: LabelledViews, chosen: Bools, sd: Float64) -> Float64:
    """Return the variance (chosen frames, joints) of the residual that ``sd`` predicts for both views together [m²]."""
    side = np.digitize(np.degrees(np.abs(view.alpha[chosen])), SIDES_DEG)[..., None]
    return np.asarray((sd[np.arange(len(BODY)), view.hidden[chosen].astype(int), side] ** 2).sum(axis=1))


def fit_correlation(views: Sequence[LabelledViews], rests: Sequence[Float64], sd: Float64) -> Float64:
    """Return the correlation (25, 25) of the joints' residuals in Walk, averaged over coordinates, left and right.

    Args:
        views: the sessions' views.
        rests: (frames, joints, 3) result of `unexplained` for each of ``views``, finite in Walk [m].
        sd: (25, 2, 3) of `fit_spread` [m].
    """
    total = np.zeros((len(BODY), len(BODY)))
    for view, rest in zip(views, rests, strict=True):
        unit = np.clip(rest[view.walk] / np.sqrt(_expected_variance(view, view.walk, sd))[..., None], -3, 3)
        total += np.einsum("nic,njc->ij", unit, unit, optimize=True)
    total += total[np.ix_(MIRROR, MIRROR)]
    spread = np.sqrt(np.diag(total))
    return np.asarray(total / spread / spread[:, None])


def autocovariance(rests: Sequence[Float64]) -> Float64:
    """Return the autocovariance (lags,) of a coordinate at the lags `LAGS` [m²].

    ``rests`` are finite sequences (frames, joints, 3) [m]. Their mean is not subtracted, and larger values are clipped
    to `LARGEST`. The autocovariance of a lag that no sequence covers is 0.
    """
    total, count = np.zeros(len(LAGS)), np.zeros(len(LAGS))
    for rest in rests:
        clipped = np.clip(rest, -LARGEST, LARGEST)
        for i, lag in enumerate(LAGS):
            if lag < len(rest):
                total[i] += (clipped[lag:] * clipped[: len(rest) - lag]).sum()
                count[i] += clipped[lag:].size
    return np.asarray(total / np.maximum(count, 1))


def fit_shares(rests: Sequence[Float64]) -> Float64:
    """Fit the residuals as a sum of random cubic splines and white noise; return the splines' variances (knots,) [m²].

    There is one spline for each of the knot spacings `KNOTS_S`. ``rests`` (frames, joints, 3) are finite results of
    `unexplained` [m].
    """
    basis = [knot_autocorrelation(knot, LAGS * LAG_S) for knot in KNOTS_S]
    share = nnls(np.stack([LAGS == 0, *basis], axis=1).astype(np.float64), autocovariance(rests))[0][1:]
    return np.asarray(share)


def fit_still_shares(views: Sequence[LabelledViews], rests: Sequence[Float64], sd: Float64) -> Float64:
    """Return the variance (knots,) of each spline of `fit_shares` in Stationary, relative to the total one in Walk.

    Stationary is the study's standing task. ``views``, ``rests`` and ``sd`` are as in `fit_correlation`; ``rests`` are
    finite in Stationary.
    """
    still, expected = [], []
    for view, rest in zip(views, rests, strict=True):
        chosen = view.raw.task == STATIONARY
        still.append(rest[chosen] - rest[chosen].mean(axis=0))
        expected.append(_expected_variance(view, chosen, sd).mean())
    return np.asarray(fit_shares(still) / np.average(expected, weights=[len(rest) for rest in still]))


def fit_white_noise(views: Sequence[LabelledViews], sd: Float64, share: Float64) -> Float64:
    """Return the standard deviation (25,) of the white noise of each joint's coordinate [m].

    It is fitted to the jitter of views of a person who stands and faces the sensor.

    Args:
        views: the sessions' views.
        sd: (25, 2, 3) of `fit_spread` [m].
        share: (knots,) of `fit_still_shares`.
    """
    still = [
        view.raw.positions[view.raw.task == STATIONARY][:, k]
        for view in views
        for k in range(2)
        if np.degrees(np.abs(view.alpha[~view.walk, k])).mean() < SIDES_DEG[0]
    ]
    # A second difference of white noise has 6 times its variance.
    measured = np.array([np.median([jitter(p[:, [j]]) for p in still]) for j in range(len(BODY))]) ** 2 / 3
    smooth = sum(
        part * float(np.array([6.0, -8.0, 2.0]) @ knot_autocorrelation(knot, np.arange(3, dtype=np.float64) * LAG_S))
        for knot, part in zip(KNOTS_S, share, strict=True)
    )
    return np.asarray(np.sqrt(np.maximum(measured - smooth * sd[:, 0, 0] ** 2, 0.0) / 6))


def knot_autocorrelation(knot_s: float, lag_s: Float64) -> Float64:
    """Return the autocorrelation of a random cubic spline with knots every ``knot_s`` seconds, at lags (lags,) [s]."""
    at = np.arange(0.0, 1.0, 1 / 64)

    def weights(time: Float64) -> Float64:
        whole = np.floor(time).astype(int)
        out = np.zeros((len(time), int(lag_s.max() / knot_s) + 6))
        for row, (k, t) in enumerate(zip(whole, time, strict=True)):
            out[row, k : k + 4] = spline_weights(float(t - k))
        return out

    return np.array([(weights(at) * weights(at + lag / knot_s)).sum(axis=1).mean() for lag in lag_s])
