"""The least jitter that a linear filter of the fits without penalty can reach: what a penalty on jitter may hope for.

A body is fitted to each image alone, m(t) = x(t) + n(t): the true motion and its error. A filter h gives h ∗ m. Its
jitter is that of the error h ∗ m − x, which has two parts: noise that passes, and motion that does not. The best h for
a known motion is N. Wiener's ("Extrapolation, Interpolation and Smoothing of Stationary Time Series", 1949), here by
least squares over the run itself, so that no other linear filter of this length has less jitter on it. No tracker knows
the truth, so this is a bound and not a method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.evaluation.silhouette_experiments import NOISE, corrupted
from mocapella.evaluation.silhouette_runs import filmed, follow, rough_joints, with_penalty
from mocapella.evaluation.silhouettes import Movement, score
from mocapella.settings import check
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_scene import silhouette_scene
from mocapella.tracker.silhouette_settings import SilhouetteSettings

Float64 = NDArray[np.float64]

TAPS: Final = 16
"""Length of the filters, on each side of the present frame [frames]."""


class JitterLimitRow(msgspec.Struct, frozen=True):
    """Jitter of one noisy run, and what filters of its fits could reach. All are RMS accelerations of errors [m/s²].

    Attributes:
        scene, seed: the rendered scene.
        without, with_it: jitter without the penalty, and with it.
        no_lag: least jitter of a filter of past and present frames that does not lag behind a constant velocity.
        lagging: least jitter of a filter of past and present frames.
        smoothed: least jitter of a filter of past, present and future frames.
    """

    scene: str
    seed: int
    without: float
    with_it: float
    no_lag: float
    lagging: float
    smoothed: float


def run_jitter_limit(
    seeds: Sequence[int],
    scenes: Sequence[str] = ("runner",),
    tell: Callable[[str], None] = lambda _: None,
    *,
    seconds: float | None = None,
    settings: SilhouetteSettings | None = None,
) -> list[JitterLimitRow]:
    """Track noisy scenes with the penalty and without, and compute the least jitter of filters of the latter.

    Args:
        seeds: random seeds of the scenes.
        scenes: names of the scenes.
        tell: called with the current step, in words.
        seconds: duration of each scene [s]; None for the whole scene.
        settings: settings of the tracker; None for the defaults.

    Raises:
        SettingsError: no seed, or an unknown scene.
        EvaluationError: the scenes are too short for the filters.
    """
    check(len(seeds) > 0, "seeds", list(seeds), "one or more")
    rows = []
    for scene in scenes:
        for seed in seeds:
            tell(f"rendering {scene}, seed {seed} …")
            film = filmed(silhouette_scene(scene, seed=seed), seconds)
            worse, found = corrupted(Corruption(NOISE), seed), {}
            for weight in (0.0, 1.0):
                tell(f"following {scene}, seed {seed}: penalty × {weight:g} …")
                fit = with_penalty(weight, settings)
                done = follow(film, film.scene.mesh, rough_joints(film.scene), fit, corruption=worse)
                found[weight] = done.movement
            limits = [
                least_jitter(found[0.0], film.truth, ahead=ahead, no_lag=no_lag)
                for ahead, no_lag in ((0, True), (0, False), (TAPS, False))
            ]
            jitter = [score(found[weight], film.truth).jitter for weight in (0.0, 1.0)]
            rows.append(JitterLimitRow(scene, seed, jitter[0], jitter[1], *limits))
    return rows


def least_jitter(found: Movement, true: Movement, *, ahead: int = 0, no_lag: bool = False, taps: int = TAPS) -> float:
    """Return the least jitter of the landmarks' errors that a linear filter can reach [m/s²].

    Each landmark has a filter of its own, for its three coordinates alike. A constant position passes unchanged.

    Args:
        found: movement whose landmarks are filtered.
        true: the true movement, of as many frames.
        ahead: number of later frames that the filter knows; 0 for a causal filter.
        no_lag: whether a constant velocity must pass unchanged, too.
        taps: number of earlier frames that the filter knows.

    Raises:
        EvaluationError: the movements differ in length, or there are too few frames.
    """
    if len(found) != len(true):
        raise EvaluationError(f"{len(found)} frames cannot be compared with {len(true)}; give the same frames")
    size = 1 + taps + ahead
    if len(true) - 2 - taps - ahead < size:
        raise EvaluationError(
            f"{len(true)} frames are too few for a filter of {size}; {2 * size + 1} or more are wanted"
        )
    sums, count = 0.0, 0
    for name in (name for name in true.landmarks if name in found.landmarks):
        m, x = (np.diff(one.landmarks[name], 2, axis=0) * true.fps**2 for one in (found, true))
        n = len(x)
        # Column k: the frame k - taps after the present one.
        A = np.stack([m[k : n - size + 1 + k].ravel() for k in range(size)], axis=1)
        b = x[taps : n - ahead].ravel()
        left = b - A @ constrained_filter(A, b, np.arange(size) - taps, no_lag=no_lag)
        sums, count = sums + float(left @ left), count + len(b) // 3
    return float(np.sqrt(sums / count))


def constrained_filter(A: Float64, b: Float64, at: NDArray[np.int64], *, no_lag: bool) -> Float64:
    """Return the weights h (k,) that minimise |A h − b|² with Σ h = 1, and with Σ h · at = 0 if ``no_lag``.

    Args:
        A: (n, k) values of the frames at ``at``.
        b: (n,) true values.
        at: (k,) times of the filter's frames, 0 for the present one [frames].
        no_lag: whether a constant velocity passes without lag.
    """
    C = np.stack([np.ones(len(at)), at.astype(np.float64)])[: 1 + no_lag]
    d = np.array([1.0, 0.0])[: 1 + no_lag]
    zeros = np.zeros((len(C), len(C)))
    scale = float(np.trace(A.T @ A)) / A.shape[1] or 1.0  # conditions the equations of the constraints
    K = np.block([[A.T @ A, scale * C.T], [scale * C, zeros]])
    return np.asarray(np.linalg.lstsq(K, np.concatenate([A.T @ b, scale * d]), rcond=1e-12)[0][: A.shape[1]])
