"""Probabilities of a person's facing on a circle of bins: process model, rotation, and statistics.

The process model: a person makes random turns, on average one per `STEP_S`, by at most two bins with few exceptions.

A direction is a yaw: 0 along +z, π/2 along +x, y up [rad]. Bin i of `BINS` is the yaw i · `BIN`.

Source: a histogram filter on a circle; S. Thrun, W. Burgard, D. Fox, *Probabilistic Robotics* (2005), section 4.1.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.angles import wrap

Float64 = NDArray[np.float64]

BINS: Final = 48
BIN: Final = 2 * np.pi / BINS
"""Width of a bin: 7.5° [rad]."""
YAWS: Final[Float64] = np.arange(BINS, dtype=np.float64) * BIN
"""(BINS,) yaw of each bin [rad]."""
STEP_S: Final = 1 / 29
"""Mean time between a person's random turns in the process model [s]."""

ANGLE_WITHIN: Final = np.pi / 6
"""Largest difference of an uncertain angle from the most likely yaw by all evidence, see `most_likely_angle` [rad].
With 45° and more, people of the study who were left out of the training are turned round more than once a minute."""
CLIMB_BINS: Final = 4
"""Largest number of bins from the most likely yaw by all evidence to the peak of the angle's evidence: 30°."""
PEAK_WITHIN: Final = np.pi / 3
"""Angle about a peak within which its probability is summed [rad]."""
CERTAIN: Final = 0.93
"""Share of the probability about a certain peak. With less, people who were left out are turned round more often."""
_NEAR: Final = np.arange(-3, 4)
_PREVIOUS: Final = np.arange(-1, BINS - 1)
LEAST: Final = 1e-12
"""Lower bound of a bin's probability."""


def _turn_rates() -> Float64:
    """Return the decay rate of each frequency on the circle (BINS // 2 + 1,), per `STEP_S`: 1 − λ of one turn.

    λ is the turn's eigenvalue. A turn goes by 0, ±1 or ±2 bins with weight 0.2 each, to any other bin with 1e-4. The
    latter bounds the certainty: weak evidence that stays, as of a body with an odd shape, never becomes certainty.
    """
    kernel = np.full(BINS, 1e-4)
    kernel[[0, 1, 2, -1, -2]] = 0.2
    return np.asarray(1.0 - np.fft.rfft(kernel / kernel.sum()).real)


TURN_RATES: Final = _turn_rates()
"""(BINS // 2 + 1,) decay rate of each frequency on the circle under random turns, per `STEP_S`."""


def unknown() -> Float64:
    """Return the uniform distribution (BINS,)."""
    return np.full(BINS, 1 / BINS)


def turned_on(p: Float64, steps: Any) -> Float64:
    """Predict the probabilities of the facing after some time of random turns.

    Two successive predictions equal one over the total time, so the frame rate does not matter.

    Args:
        p: (..., BINS) probability of each bin.
        steps: (...,) elapsed time in units of `STEP_S`, 0 or more.

    Returns:
        (..., BINS), with unchanged sum.

    Source:
        exp(steps · (K − 1)), K a turn: a Markov process in continuous time; J. R. Norris, *Markov Chains* (1997),
        section 2.1. It is diagonal in the frequencies on the circle, because K is the same for all directions.
    """
    fading = np.exp(-np.asarray(steps, dtype=np.float64)[..., None] * TURN_RATES)
    return np.maximum(np.fft.irfft(np.fft.rfft(p, axis=-1) * fading, n=BINS, axis=-1), LEAST)


def turned(values: Float64, by: Any) -> Float64:
    """Rotate values on the circle: the value at a yaw moves to that yaw + ``by``.

    Args:
        values: (..., BINS), one for each bin.
        by: (...,) angle, finite [rad]; between two bins, values are interpolated linearly.

    Returns:
        (..., BINS), a new array of the broadcast shape.
    """
    places = np.asarray(by, dtype=np.float64) / BIN
    whole = np.floor(places)
    part = (places - whole)[..., None]
    sources = (np.arange(BINS) - whole.astype(np.intp)[..., None]) % BINS
    here = np.take_along_axis(np.broadcast_to(values, (*sources.shape[:-1], BINS)), sources, axis=-1)
    return np.asarray((1 - part) * here + part * here[..., _PREVIOUS])


def most_likely(p: Float64) -> Float64:
    """Return the mean yaw of the seven bins (52.5°) around the five most likely neighbouring ones.

    A person may face one way or the opposite, but hardly between, so the mean over the circle is not used.

    Args:
        p: (..., BINS) probability of each bin.

    Returns:
        (...,) yaw [rad], within [−π, π).
    """
    return _mean_near(p, _of_five(p).argmax(axis=-1)[..., None])


def most_likely_angle(p: Float64, p_angle: Float64) -> Float64:
    """Return the yaw of the peak of ``p_angle`` uphill from the most likely yaw by ``p``, `CLIMB_BINS` away at most.

    ``p`` chooses among the peaks, such as front and back; ``p_angle`` alone says where its peak is. A peak with at most
    `CERTAIN` of the probability within `PEAK_WITHIN` is uncertain, and not returned. Instead, the result is the most
    likely yaw by ``p_angle`` within `ANGLE_WITHIN` of that by ``p``; this limit draws it towards ``p``.

    Args:
        p: (..., BINS) probability of each bin by all evidence, which tells front from back.
        p_angle: (..., BINS) that by the evidence of the angle only.

    Returns:
        (...,) yaw [rad], within [−π, π).

    Source:
        Hill climbing to a mode of a density; compare D. Comaniciu and P. Meer, Mean Shift, PAMI 24 (2002), section 2.2.
    """
    five, best = _of_five(p_angle), _of_five(p).argmax(axis=-1)[..., None]
    for _ in range(CLIMB_BINS):
        down, here, up = (np.take_along_axis(five, (best + k) % BINS, axis=-1) for k in (-1, 0, 1))
        uphill = np.where(up > down, 1, -1)
        best = (best + np.where(np.maximum(up, down) > here, uphill, 0)) % BINS
    peak = _mean_near(p_angle, best)
    near = np.where(_beyond(peak, PEAK_WITHIN), 0.0, p_angle).sum(axis=-1)
    limited = most_likely(np.where(_beyond(most_likely(p), ANGLE_WITHIN), 0.0, p_angle))
    return np.where(near > CERTAIN * p_angle.sum(axis=-1), peak, limited)


def _beyond(yaw: Float64, angle: float) -> NDArray[np.bool_]:
    """Return which bins (..., BINS) are more than ``angle`` from ``yaw`` (...,) [rad]."""
    return np.asarray(np.cos(YAWS - yaw[..., None]) < np.cos(angle))


def _of_five(p: Float64) -> Float64:
    """Return the probability (..., BINS) of each bin and its four nearest neighbours."""
    return np.asarray(p + sum(np.roll(p, k, axis=-1) for k in (-2, -1, 1, 2)))


def _mean_near(p: Float64, best: NDArray[np.intp]) -> Float64:
    """Return the mean yaw (...,) of the seven bins around the bins ``best`` (..., 1), within [−π, π) [rad]."""
    near = np.take_along_axis(p, (best + _NEAR) % BINS, axis=-1)
    return wrap((best[..., 0] + (near * _NEAR).sum(axis=-1) / near.sum(axis=-1)) * BIN)


def circular_sd(p: Float64) -> Float64:
    """Return the circular standard deviation (...,) of probabilities p (..., BINS) [rad].

    It is √(−2 ln R), R the length of the mean unit vector; at most 7.4, for the uniform distribution. ``p`` need not be
    normalised.

    Source:
        Mardia and Jupp, *Directional Statistics* (2000), section 2.3.1.
    """
    R = np.hypot((p * np.cos(YAWS)).sum(axis=-1), (p * np.sin(YAWS)).sum(axis=-1)) / p.sum(axis=-1)
    return np.asarray(np.sqrt(-2 * np.log(np.clip(R, LEAST, 1.0))))
