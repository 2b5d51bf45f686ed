"""Tune a 1-euro filter by its authors' procedure: from two recordings, for a jitter goal and a lag goal.

Source: Casiez, Roussel, Vogel: 1€ Filter (CHI 2012), section 3, *Tuning the filter*: with beta 0 and a hand held still,
the minimum cutoff is lowered until the jitter is acceptable; then, while the hand moves fast, beta is raised until the
lag is. Here the highest cutoff is chosen that reaches a jitter goal, and the lowest beta that reaches a lag goal.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.settings import check
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings

Float64 = NDArray[np.float64]

LOWEST_HZ, HIGHEST_HZ = 0.02, 50.0
BISECTIONS = 12
LONGEST_LAG_S = 0.4
SETTLING_S = 0.5
"""Beginning of a filtered recording that is left out of jitter and lag, because the filter settles [s]."""


class Tuned(msgspec.Struct, frozen=True):
    """Result of a tuning.

    Attributes:
        settings: the chosen settings.
        raw_jitter: jitter of the still recording without a filter, in the unit of the points.
        jitter_at_rest: its jitter with the chosen minimum cutoff and beta 0.
        jitter: its jitter with all chosen settings.
        lag_without_beta_s: lag of the fast recording with beta 0 [s].
        lag_s: its lag with all chosen settings [s].
        jitter_reached: whether ``jitter_at_rest`` is within the goal.
        lag_reached: whether ``lag_s`` is within the goal.
    """

    settings: OneEuroSettings
    raw_jitter: float
    jitter_at_rest: float
    jitter: float
    lag_without_beta_s: float
    lag_s: float
    jitter_reached: bool
    lag_reached: bool


def tune(
    still: tuple[Float64, Float64],
    fast: tuple[Float64, Float64],
    jitter_goal: float,
    lag_goal_s: float,
    settings: OneEuroSettings | None = None,
) -> Tuned:
    """Choose the minimum cutoff by the still recording, then beta by the fast one.

    A goal that cannot be reached is no error: the nearest settings are chosen, and the result reports it.

    Args:
        still: times (frames,) [s] and points (frames, points, dimensions) of markers that do not move; NaN: not seen.
        fast: times and points, as in ``still``, of markers in fast motion.
        jitter_goal: largest jitter, see `jitter`, in the unit of the points.
        lag_goal_s: largest lag, see `lag`; less than `LONGEST_LAG_S` [s].
        settings: the other settings, the defaults if None; their min_cutoff_hz and beta_per_m are replaced.

    Raises:
        SettingsError: a goal that is not above 0, or a lag that is too long to be measured.
        InputError: a recording is too short, its times do not rise, no point is seen in more than half of its frames,
            or nothing moves in the fast one.
    """
    check(jitter_goal > 0, "jitter_goal", jitter_goal, "above 0")
    # A lag of `LONGEST_LAG_S` may be a longer one, which would pass for a goal reached.
    check(0 < lag_goal_s < LONGEST_LAG_S, "lag_goal_s", lag_goal_s, f"above 0 and below {LONGEST_LAG_S:g} s")
    for name, (at_s, points) in (("still", still), ("fast", fast)):
        _check_recording(name, at_s, points)
    start = replace(settings or OneEuroSettings(), beta_per_m=0.0)
    at_rest = lowered(still, jitter_goal, start)
    chosen = raised(fast, lag_goal_s, at_rest)
    jitter_at_rest, lag_s = jitter(still, at_rest), lag(fast, chosen)
    return Tuned(
        settings=chosen,
        raw_jitter=spread(still[1][still[0] - still[0][0] >= SETTLING_S]),
        jitter_at_rest=jitter_at_rest,
        jitter=jitter(still, chosen),
        lag_without_beta_s=lag(fast, at_rest),
        lag_s=lag_s,
        jitter_reached=jitter_at_rest <= jitter_goal,
        lag_reached=lag_s <= lag_goal_s,
    )


def lowered(still: tuple[Float64, Float64], goal: float, settings: OneEuroSettings) -> OneEuroSettings:
    """Step 1: choose the highest minimum cutoff with no more jitter than a goal, on a still recording.

    If none reaches the goal, `LOWEST_HZ` is chosen.

    Args:
        still: times (frames,) [s] and points (frames, points, dimensions) of markers that do not move.
        goal: largest jitter, see `jitter`, in the unit of the points.
        settings: the settings; in the result only ``min_cutoff_hz`` is replaced.
    """
    low, high = np.log(LOWEST_HZ), np.log(HIGHEST_HZ)
    if jitter(still, replace(settings, min_cutoff_hz=HIGHEST_HZ)) <= goal:
        return replace(settings, min_cutoff_hz=HIGHEST_HZ)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        enough = jitter(still, replace(settings, min_cutoff_hz=float(np.exp(middle)))) <= goal
        low, high = (middle, high) if enough else (low, middle)
    return replace(settings, min_cutoff_hz=float(np.exp(low)))


def raised(fast: tuple[Float64, Float64], goal_s: float, settings: OneEuroSettings) -> OneEuroSettings:
    """Step 2: choose the lowest beta with no more lag than a goal, on a fast recording.

    The settings are returned unchanged if they already reach the goal. If no beta does, the highest one tried is taken.

    Args:
        fast: times (frames,) [s] and points (frames, points, dimensions) of markers in fast motion.
        goal_s: largest lag, see `lag` [s].
        settings: the settings; in the result only ``beta_per_m`` is replaced.
    """
    if lag(fast, settings) <= goal_s:
        return settings
    # Of the fast recording, this beta raises the cutoff by 1 Hz, and 2¹⁶ times it by enough to filter nothing.
    unit = 1.0 / max(_typical_speed(*fast), 1e-12)
    low, high = np.log(unit / 256.0), np.log(unit * 65536.0)
    if lag(fast, replace(settings, beta_per_m=float(np.exp(high)))) > goal_s:
        return replace(settings, beta_per_m=float(np.exp(high)))
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        enough = lag(fast, replace(settings, beta_per_m=float(np.exp(middle)))) <= goal_s
        low, high = (low, middle) if enough else (middle, high)
    return replace(settings, beta_per_m=float(np.exp(high)))


def jitter(still: tuple[Float64, Float64], settings: OneEuroSettings) -> float:
    """Return the `spread` of a still recording after filtering, in the unit of the points; ``still`` as in `tune`.

    The first `SETTLING_S` seconds are not counted.
    """
    at_s, points = still
    return spread(filtered(at_s, points, settings)[at_s - at_s[0] >= SETTLING_S])


def spread(points: Float64) -> float:
    """Return the root mean square distance of points (frames, points, dimensions) from each one's mean over the frames.

    Points that are NaN are left out.
    """
    off = points - np.nanmean(points, axis=0)
    return float(np.sqrt(np.nanmean((off**2).sum(axis=-1))))


def lag(fast: tuple[Float64, Float64], settings: OneEuroSettings) -> float:
    """Return the lag of the filter [s]: the delay of the raw recording that fits the filtered one best.

    Delays from 0 to `LONGEST_LAG_S` are tried, so a longer lag is reported as `LONGEST_LAG_S`. The first `SETTLING_S`
    seconds are not counted, nor are points that are seen in fewer than three frames.

    Args:
        fast: times (frames,) [s] and points (frames, points, dimensions) of markers in fast motion; NaN: not seen.
        settings: settings of the filter.
    """
    at_s, points = fast
    result = filtered(at_s, points, settings)
    later = at_s - at_s[0] >= max(SETTLING_S, LONGEST_LAG_S)
    shifts = np.linspace(0.0, LONGEST_LAG_S, 81)
    tracks = [
        (points[seen, p, d], at_s[seen], result[later, p, d])
        for p in range(points.shape[1])
        for d in range(points.shape[2])
        if (seen := np.isfinite(points[:, p, d])).sum() > 2
    ]

    def error(shift: float) -> float:
        off = [np.interp(at_s[later] - shift, t, x) - y for x, t, y in tracks]
        return float(np.nanmean(np.square(off)))

    errors = [error(shift) for shift in shifts]
    k = int(np.argmin(errors))
    if k in (0, len(shifts) - 1):
        return float(shifts[k])
    before, at, after = errors[k - 1 : k + 2]
    return float(shifts[k] + 0.5 * (before - after) / (before - 2 * at + after) * (shifts[1] - shifts[0]))


def filtered(at_s: Float64, points: Float64, settings: OneEuroSettings) -> Float64:
    """Filter a recording (frames, points, dimensions) with times (frames,) [s] by a new filter with ``settings``.

    Returns:
        (frames, points, dimensions), a new array; NaN where the recording is NaN.
    """
    one_euro = OneEuro(settings)
    return np.stack([one_euro.update(frame, float(t)) for t, frame in zip(at_s, points, strict=True)])


def _typical_speed(at_s: Float64, points: Float64) -> float:
    speeds = np.linalg.norm(np.diff(points, axis=0), axis=-1) / np.diff(at_s)[:, None]
    return float(np.nanmedian(speeds))


def _check_recording(name: str, at_s: Float64, points: Float64) -> None:
    long_enough = SETTLING_S + 2 * LONGEST_LAG_S
    if len(at_s) < 20 or not at_s[-1] - at_s[0] >= long_enough:
        seconds = float(at_s[-1] - at_s[0]) if len(at_s) else 0.0
        raise InputError(
            f"the {name} recording is too short",
            value=f"{len(at_s)} frames, {seconds:.2f} s",
            fix=f"record {long_enough + 0.7:.0f} s or more",
        )
    if not (np.diff(at_s) > 0).all():
        raise InputError(f"the times of the {name} recording do not rise", fix="put its frames in order")
    if not (np.isfinite(points).all(axis=-1).mean(axis=0) > 0.5).any():
        raise InputError(f"the {name} recording hardly sees a point", fix="keep the markers in view")
    if name == "fast" and not _typical_speed(at_s, points) > 0:
        raise InputError("nothing moves in the fast recording", fix="move the markers quickly while it records")
