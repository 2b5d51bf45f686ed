"""Find roughly when two recordings show the same motion, by distances between joints and by speeds.

Neither depends on the coordinates, so the time is found before the rigid motion is. Correlations over all lags are
computed by the fast Fourier transform, with unknown samples left out (D. Padfield, IEEE Trans. Image Process. 21, 2012,
2706).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.signal import find_peaks

Float64 = NDArray[np.float64]

MOST_FEATURES: Final = 24
"""Number of compared distances, by their change."""
LEAST_OVERLAP_S: Final = 1.0
"""Least common time of a lag [s]."""
LEAST_SHARE: Final = 0.3
"""Least share of the shorter recording that a lag must have in common."""
MOST_SHARE: Final = 0.7
"""Share of the shorter recording that suffices, if it is less than `LEAST_OVERLAP_S`."""
MOST_LAGS: Final = 6
"""Number of lags that are tried."""
APART_S: Final = 0.2
"""Least time between two lags that are tried [s]."""
LARGEST_DRIFT: Final = 2e-3
"""Largest relative difference of two clocks that is searched."""
SLIPPED_S: Final = 0.1
"""Shift at the ends between two trial rates [s]."""
RATES_HZ: Final = (8.0, 1100.0)
"""Rates that are tried for a file without times [Hz]."""
_NEVER: Final = -1e6
RATE_STEP: Final = 0.008
"""Relative step of these rates."""


@dataclass(frozen=True)
class RoughTime:
    """A time map that may be right: reference time = ratio · recording time + shift.

    Attributes:
        ratio: seconds of the reference in a second of the recording.
        shift_s: time of the reference at the recording's time 0 [s].
        correlation: of the features, −1 to 1.
        sure: lower bound of the correlation's Fisher transform, by the length in common; larger: more likely.
    """

    ratio: float
    shift_s: float
    correlation: float
    sure: float


def features_of(positions: Float64, pairs: list[tuple[int, int]], step_s: float | None) -> Float64:
    """Return features (frames, features) of a motion that do not depend on coordinates; NaN where unknown.

    Args:
        positions: (frames, joints, 3) on a regular grid [m].
        pairs: joints whose distance is a feature.
        step_s: step of the grid, for the joints' speeds as features; None to leave them out [s].
    """
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    distances = np.linalg.norm(positions[:, first] - positions[:, second], axis=2)
    if step_s is None:
        return np.asarray(distances)
    speeds = np.full(positions.shape[:2], np.nan)
    speeds[1:-1] = np.linalg.norm(positions[2:] - positions[:-2], axis=2) / (2 * step_s)
    return np.concatenate([distances, speeds], axis=1)


def changing_pairs(ours: Float64, theirs: Float64, groups: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the pairs of joints of one individual whose distances change most, in both recordings.

    Args:
        ours, theirs: (frames, joints, 3); the frames of the two need not be alike.
        groups: (joints,) number of each joint's individual.
    """
    pairs = [(a, b) for a, b in combinations(range(len(groups)), 2) if groups[a] == groups[b]]
    if len(pairs) <= MOST_FEATURES:
        return pairs
    change = [
        np.nan_to_num(_spread(features_of(own[:: max(1, len(own) // 2000)], pairs, None))) for own in (ours, theirs)
    ]
    order = np.argsort(-np.minimum(*change), kind="stable")[:MOST_FEATURES]
    return [pairs[k] for k in sorted(order.tolist())]


def _spread(features: Float64) -> Float64:
    """Return the standard deviation of each feature without NaN; 0 with fewer than two samples."""
    known = np.isfinite(features)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, features, 0.0).sum(axis=0) / count
    return np.asarray(np.sqrt(np.where(known, (features - mean) ** 2, 0.0).sum(axis=0) / count))


def ratios_to_try(seconds: float) -> Float64:
    """Return the clocks' ratios to try for a recording of this length [s]: one if the drift cannot be seen in it."""
    count = int(np.ceil(LARGEST_DRIFT * seconds / 2 / SLIPPED_S)) if LARGEST_DRIFT * seconds / 2 > SLIPPED_S else 0
    return 1.0 + (LARGEST_DRIFT * np.arange(-count, count + 1) / count if count else np.zeros(1))


def rates_to_try() -> Float64:
    """Return the rates to try for a file without times [Hz]."""
    count = int(np.log(RATES_HZ[1] / RATES_HZ[0]) / RATE_STEP)
    return np.asarray(RATES_HZ[0] * np.exp(RATE_STEP * np.arange(count + 1)))


class LagSearch:
    """Correlates the features of a recording and a reference at all lags.

    Args:
        ours: (frames, features) of the recording, on a regular grid; NaN where unknown.
        step_s: step of the grid [s].
    """

    def __init__(self, ours: Float64, step_s: float) -> None:
        self._step = step_s
        spread = _spread(ours)
        self._ours, self._known = _filled(ours, np.where(spread > 0, spread, 1.0))
        self._transformed: dict[int, tuple[Float64, ...]] = {}

    def lags(self, theirs: Float64, begin_s: float, ratio: float) -> list[RoughTime]:
        """Return the likeliest lags.

        Args:
            theirs: (frames, features) of the reference, on a grid of the same step in the recording's seconds.
            begin_s: time of its first frame, divided by the ratio, minus that of the recording's first frame [s].
            ratio: seconds of the reference in a second of the recording.
        """
        correlation, overlap = self._correlated(theirs)
        shorter = self._step * min(len(theirs), len(self._ours))
        enough = overlap * self._step >= max(min(LEAST_OVERLAP_S, MOST_SHARE * shorter), LEAST_SHARE * shorter)
        z = np.arctanh(np.clip(correlation, -0.9999, 0.9999))
        sure = np.where(enough, z - 1.64 / np.sqrt(np.maximum(2 * overlap * self._step - 3, 0.3)), _NEVER)
        peaks, _ = find_peaks(
            np.concatenate([[2 * _NEVER], sure, [2 * _NEVER]]), distance=max(1, round(APART_S / self._step))
        )
        peaks = peaks[sure[peaks - 1] > _NEVER] - 1
        best = peaks[np.argsort(-sure[peaks], kind="stable")][:MOST_LAGS]
        at = begin_s + self._step * (best - (len(self._ours) - 1))  # time of the reference at the recording's begin
        return [
            RoughTime(ratio, float(shift * ratio), float(correlation[k]), float(sure[k]))
            for shift, k in zip(at, best, strict=True)
        ]

    def _correlated(self, theirs: Float64) -> tuple[Float64, Float64]:
        """Return the pooled correlation at all lags, and the mean number of samples in common."""
        spread = _spread(theirs)
        values, known = _filled(theirs, np.where(spread > 0, spread, 1.0))
        count = len(self._ours) + len(theirs) - 1
        size = fft.next_fast_len(count, real=True)
        if size not in self._transformed:
            self._transformed[size] = tuple(
                fft.rfft(one[::-1], size, axis=0) for one in (self._ours, self._ours**2, self._known)
            )
        a, aa, m = self._transformed[size]
        b, bb, n = (fft.rfft(one, size, axis=0) for one in (values, values**2, known))

        def at_lags(product: Float64) -> Float64:
            return np.asarray(fft.irfft(product, size, axis=0)[:count])

        common = np.maximum(at_lags(m * n), 0.0)
        safe = np.maximum(common, 1.0)
        sum_a, sum_b = at_lags(a * n), at_lags(m * b)
        both = at_lags(a * b) - sum_a * sum_b / safe
        own = np.maximum(at_lags(aa * n) - sum_a**2 / safe, 0).sum(axis=1)
        other = np.maximum(at_lags(m * bb) - sum_b**2 / safe, 0).sum(axis=1)
        scale = np.sqrt(own * other)
        tiny = 1e-6 * max(float(scale.max(initial=0.0)), 1e-12)
        return both.sum(axis=1) / np.maximum(scale, tiny), common.mean(axis=1)


def _filled(features: Float64, spread: Float64) -> tuple[Float64, Float64]:
    """Return features of variance 1 about their mean, 0 where unknown, and 1 where known."""
    known = np.isfinite(features)
    mean = np.where(known, features, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.where(known, (features - mean) / spread, 0.0), known.astype(np.float64)


def regridded(features: Float64, step: float) -> Float64:
    """Return the features at every ``step``-th frame, interpolated linearly; NaN beside a NaN."""
    place = np.arange(0.0, len(features) - 1 + 1e-9, step)
    k = np.minimum(place.astype(np.int64), max(0, len(features) - 2))
    u = (place - k)[:, None]
    return np.asarray(features[k] * (1 - u) + features[np.minimum(k + 1, len(features) - 1)] * u)
