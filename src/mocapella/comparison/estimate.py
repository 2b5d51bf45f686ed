"""Estimate time and motion between two recordings from nothing but their joints' paths."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.comparison.lag_search import (
    MOST_LAGS,
    LagSearch,
    RoughTime,
    changing_pairs,
    features_of,
    rates_to_try,
    ratios_to_try,
    regridded,
)
from mocapella.comparison.motion_fit import DRIFT_KNOWN, TimeAndMotion, fit, without_time
from mocapella.comparison.smooth_paths import (
    SensorPaths,
    SmoothPaths,
    paths_of_sensors,
    smooth_paths,
    without_spikes,
)
from mocapella.errors import EvaluationError

Float64 = NDArray[np.float64]

COARSE_STEP_S: Final = 0.04
_MOST_STEPS: Final = 30_000
_LEAST_WIDTH_S: Final = 0.02
SHORTEST_S: Final = 0.5
"""Shortest recording that is compared [s]."""
STILL_M: Final = 0.02
"""Scatter of the joints' positions below which a recording is still [m]."""
EXPLAINED: Final = 0.5
"""Share of the motion that a fit must explain; the motions are different ones otherwise."""
REPEATS_S: Final = 0.3
"""Distance of another time that also fits, at which the motion repeats itself [s]."""
_PERFECT: Final = 1e-3
"""Unexplained share of a fit that cannot be better in practice."""
_NEARLY: Final = 0.1
"""Difference of the unexplained shares' logarithms, in tens, within which another time fits nearly as well."""


@dataclass(frozen=True, eq=False)
class JointPaths:
    """Paths of joints on one clock.

    Attributes:
        times_s: (frames,) rising [s]; numbers of frames if ``clock`` is false.
        positions: (frames, joints, 3) [m]; NaN where unknown.
        groups: (joints,) number of each joint's individual.
        clock: whether the times are seconds.
        sensors: (frames,) number of the sensor whose frame each result follows; empty if unknown.
    """

    times_s: Float64
    positions: Float64
    groups: NDArray[np.int64]
    clock: bool = True
    sensors: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def step_s(self) -> float:
        """Median time between two frames [s]."""
        return float(np.median(np.diff(self.times_s)))

    def of(self, joints: NDArray[np.int64]) -> JointPaths:
        """Return the paths of some joints."""
        return replace(self, positions=self.positions[:, joints], groups=self.groups[joints])


class EstimatedMotion(NamedTuple):
    """Time and motion, and notes about unknown quantities."""

    motion: TimeAndMotion
    notes: tuple[str, ...]


def check_long_enough(paths: JointPaths, what: str) -> None:
    """Check that a recording has enough frames to be compared; ``what`` names it.

    Raises:
        EvaluationError: it is too short, or none of its joints is ever known.
    """
    known = np.flatnonzero(np.any(np.all(np.isfinite(paths.positions), axis=2), axis=1))
    if len(known) < 2:
        raise EvaluationError(f"the {what} never shows the joints in common; name others with --map or --pairs")
    seconds = float(paths.times_s[known[-1]] - paths.times_s[known[0]])
    if len(known) < 16 or (paths.clock and seconds < SHORTEST_S):
        about = f"{len(known)} frames in {seconds:.2f} s" if paths.clock else f"{len(known)} frames"
        raise EvaluationError(f"the {what} is too short to compare: {about}; give {SHORTEST_S:g} s and 16 frames")


def estimate(
    ours: JointPaths, theirs: JointPaths, *, same_clock: bool = False, same_space: bool = False
) -> EstimatedMotion:
    """Estimate the time map and the rigid motion from a reference to a recording.

    Args:
        ours: the recording, whose clock is in seconds.
        theirs: the reference, with the same joints.
        same_clock, same_space: whether the time map, or the rigid motion, is known to be the identity, and is held.

    Raises:
        EvaluationError: one is too short, or the two show no common motion.
    """
    check_long_enough(ours, "recording")
    check_long_enough(theirs, "reference")
    ours, theirs = (replace(one, positions=without_spikes(one.positions)) for one in (ours, theirs))
    if same_clock:
        return _on_same_clock(ours, theirs, same_space)
    space = not same_space
    tried = (_fitted(ours, theirs, one, quick=True, space=space) for one in candidates(ours, theirs))
    likely = sorted((one for one in tried if one), key=_certainty, reverse=True)
    best = _fitted(ours, theirs, _rough(likely[0]), space=space) if likely else None
    if best is not None and best.time_observable and best.explained >= EXPLAINED:
        return EstimatedMotion(best, tuple(_repeats(likely)))
    return _still(ours, theirs, best, space)


def _on_same_clock(ours: JointPaths, theirs: JointPaths, same_space: bool) -> EstimatedMotion:
    found = _at_stated_time(ours, theirs, 0.0, space=not same_space)
    if found.explained < EXPLAINED and not same_space and not _rests(ours, theirs):
        raise _unlike(found)
    return EstimatedMotion(replace(found, clock_held=True, offset_sd_s=0.0, ratio_sd=0.0), ())


def _certainty(found: TimeAndMotion) -> float:
    """Return the share of the motion that is explained as a number that falls with the length in common, too."""
    return math.atanh(min(max(found.explained, 0.0), 1 - 1e-9) ** 0.5) - 1.64 / math.sqrt(max(2 * found.common_s, 1.0))


def candidates(ours: JointPaths, theirs: JointPaths) -> list[RoughTime]:
    """Return the likeliest time maps, best first; ``ratio`` and ``shift_s`` in frames of a reference without clock."""
    found = _rough_rates(ours, theirs) if not theirs.clock else _rough_lags(ours, theirs)
    ordered = sorted(found, key=lambda one: -one.sure)
    kept: list[RoughTime] = []
    middle = float(ours.times_s[[0, -1]].mean())
    for one in ordered:
        at = one.ratio * middle + one.shift_s
        if all(abs(other.ratio * middle + other.shift_s - at) > 0.25 * one.ratio for other in kept):
            kept.append(one)
    return kept[:MOST_LAGS]


def _grid(ours: JointPaths) -> tuple[SmoothPaths, Float64, float]:
    """Return the recording's smooth paths, and the times and the step of the coarse search [s]."""
    paths = smooth_paths(ours.times_s, ours.positions, max(ours.step_s, _LEAST_WIDTH_S))
    seconds = float(ours.times_s[-1] - ours.times_s[0])
    step = max(COARSE_STEP_S, seconds / _MOST_STEPS)
    return paths, ours.times_s[0] + step * np.arange(int(seconds / step) + 1), step


def _rough_lags(ours: JointPaths, theirs: JointPaths) -> Iterator[RoughTime]:
    own, at, step = _grid(ours)
    other = smooth_paths(theirs.times_s, theirs.positions, max(theirs.step_s, _LEAST_WIDTH_S))
    pairs = changing_pairs(ours.positions, theirs.positions, ours.groups)
    search = LagSearch(features_of(own.at(at)[0], pairs, step), step)
    seconds = [float(one.times_s[-1] - one.times_s[0]) for one in (ours, theirs)]
    for ratio in ratios_to_try(min(seconds)):
        times = theirs.times_s[0] + ratio * step * np.arange(int(seconds[1] / ratio / step) + 1)
        features = features_of(other.at(times)[0], pairs, step)
        yield from search.lags(features, float(theirs.times_s[0]) / ratio - float(ours.times_s[0]), float(ratio))


def _rough_rates(ours: JointPaths, theirs: JointPaths) -> Iterator[RoughTime]:
    own, at, step = _grid(ours)
    pairs = changing_pairs(ours.positions, theirs.positions, ours.groups)
    if not pairs:
        raise EvaluationError(
            "the reference has no times, and with one joint its rate cannot be found; name more joints"
        )
    search = LagSearch(features_of(own.at(at)[0], pairs, None), step)
    features = features_of(theirs.positions, pairs, None)
    for rate in rates_to_try():
        if len(features) / rate >= SHORTEST_S:
            yield from search.lags(regridded(features, rate * step), -float(ours.times_s[0]), float(rate))


def _in_seconds(theirs: JointPaths, rough: RoughTime) -> tuple[JointPaths, RoughTime, float]:
    """Return a reference in seconds of the rough rate, the rough time in them, and the frames in a second."""
    if theirs.clock:
        return theirs, rough, 1.0
    return (
        replace(theirs, times_s=theirs.times_s / rough.ratio, clock=True),
        replace(rough, ratio=1.0, shift_s=rough.shift_s / rough.ratio),
        rough.ratio,
    )


def _smoothed(ours: JointPaths, theirs: JointPaths) -> tuple[SmoothPaths, SmoothPaths]:
    width = _width_s(ours, theirs)
    own, other = (smooth_paths(one.times_s, one.positions, width) for one in (ours, theirs))
    return own, other


def _width_s(ours: JointPaths, theirs: JointPaths) -> float:
    return max(ours.step_s, theirs.step_s, _LEAST_WIDTH_S)


def _by_sensor(ours: JointPaths, theirs: JointPaths) -> tuple[tuple[SensorPaths, ...], ...]:
    width = _width_s(ours, theirs)
    return tuple(paths_of_sensors(one.times_s, one.positions, one.sensors, width) for one in (ours, theirs))


def _fitted(
    ours: JointPaths, theirs: JointPaths, rough: RoughTime, *, quick: bool = False, space: bool
) -> TimeAndMotion | None:
    """Return the fit from a rough time, in the reference's own unit of time; ``quick`` and ``space`` as in `fit`."""
    seconds, start, per_second = _in_seconds(theirs, rough)
    own, other = _smoothed(ours, seconds)
    stated = replace(
        start, ratio=1.0, shift_s=start.shift_s + (start.ratio - 1.0) * float(ours.times_s[[0, -1]].mean())
    )
    if quick:
        found = fit(own, other, start, drift=not theirs.clock, quick=True, space=space)
    else:
        sensors = _by_sensor(ours, seconds)
        found = fit(own, other, start, drift=True, sensors=sensors, space=space)
        if theirs.clock and (found is None or not found.ratio_sd <= DRIFT_KNOWN):
            found = fit(own, other, stated, drift=False, sensors=sensors, space=space)
    return None if found is None else replace(
        found, reference_middle_s=found.reference_middle_s * per_second, ratio=found.ratio * per_second
    )  # fmt: skip


def _rough(found: TimeAndMotion) -> RoughTime:
    return RoughTime(found.ratio, found.shift_s, found.explained, found.explained)


def _repeats(found: list[TimeAndMotion]) -> Iterator[str]:
    best = found[0]
    for other in found:
        apart = float(other.reference_s(np.array(best.middle_s))) - best.reference_middle_s
        nearly = (
            math.log10(max(1 - other.explained, _PERFECT)) - math.log10(max(1 - best.explained, _PERFECT)) < _NEARLY
        )
        if abs(apart) > REPEATS_S * best.ratio and nearly:
            yield f"the motion repeats itself: it fits nearly as well {apart / best.ratio:+.2f} s away"
            return


def _still(ours: JointPaths, theirs: JointPaths, best: TimeAndMotion | None, space: bool) -> EstimatedMotion:
    """Return the rigid motion alone, at the times as stated, if the motion does not tell the time.

    Raises:
        EvaluationError: both move, and not alike.
    """
    if not _rests(ours, theirs):
        raise _unlike(best)
    if not theirs.clock:
        raise EvaluationError("the reference has no times, and without motion its rate is not observable")
    overlap = min(ours.times_s[-1], theirs.times_s[-1]) - max(ours.times_s[0], theirs.times_s[0])
    shift = 0.0 if overlap > SHORTEST_S else float(theirs.times_s[0] - ours.times_s[0])
    found = _at_stated_time(ours, theirs, shift, space=space)
    stated = "the clocks are taken as stated" if shift == 0 else "the beginnings are taken as one time"
    return EstimatedMotion(
        without_time(found), (f"no motion: the time offset is not observable (infinite uncertainty); {stated}",)
    )


def _at_stated_time(ours: JointPaths, theirs: JointPaths, shift_s: float, *, space: bool) -> TimeAndMotion:
    """Return the rigid motion alone, at a known time."""
    found = fit(
        *_smoothed(ours, theirs), RoughTime(1.0, shift_s, 0.0, 0.0), drift=False, time=False, space=space,
        sensors=_by_sensor(ours, theirs),
    )  # fmt: skip
    if found is None:
        raise EvaluationError("the recording and the reference have no known joints at a common time")
    return found


def _rests(ours: JointPaths, theirs: JointPaths) -> bool:
    """Return whether one side is still, and the other nearly."""
    scatter = [_scatter_m(one.positions) for one in (ours, theirs)]
    return min(scatter) <= STILL_M and max(scatter) <= 5 * STILL_M


def _unlike(best: TimeAndMotion | None) -> EvaluationError:
    explained = 0.0 if best is None else max(0.0, best.explained)
    return EvaluationError(
        f"the recording and the reference show no common motion: at best {explained:.0%} of the joints' motion "
        "agrees; give files of the same movement, or pair people with --pairs and joints with --map"
    )


def _scatter_m(positions: Float64) -> float:
    """Return the median over joints of the scatter of the positions about their mean [m]; 0 if none is known."""
    known = [one[np.isfinite(one).all(axis=1)] for one in np.swapaxes(positions, 0, 1)]
    return float(np.median([float(np.linalg.norm(one.std(axis=0))) for one in known if len(one)] or [0.0]))
