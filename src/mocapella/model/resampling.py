"""Trajectories at a constant rate, by linear interpolation across short gaps only."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocapella.model.trajectories import Trajectories
from mocapella.settings import check

Float64 = NDArray[np.float64]
T = TypeVar("T", bound=Trajectories)

LONGEST_GAP_S: Final = 0.1
"""Longest time between two known samples that is interpolated by default, or `LONGEST_GAP_FRAMES` if that is longer
[s]."""
LONGEST_GAP_FRAMES: Final = 3.0
_MOST_BYTES: Final = 8 << 30
"""Largest size of the positions at the new rate [byte]."""
_ROUND: Final = 0.02
"""Relative distance within which a measured frame rate is taken for a whole number of Hz."""


def usual_rate_hz(trajectories: Trajectories) -> float:
    """Return the frame rate for files of constant rate: the fastest sensor's, as a whole number if it is near one [Hz].

    Fewer than two frames give 1 Hz.
    """
    rate = trajectories.rate_hz
    if not math.isfinite(rate):
        return 1.0
    whole = max(1.0, float(round(rate)))
    return whole if abs(rate - whole) <= _ROUND * whole else rate


def check_rate(trajectories: Trajectories, rate_hz: float) -> None:
    """Check that a rate gives more than one frame of trajectories that have several.

    Raises:
        SettingsError: it does not; names the lowest rate that does.
    """
    seconds = float(np.ptp(trajectories.times_s)) if len(trajectories) else 0.0
    if seconds > 0 and 0 < rate_hz * seconds < 1:
        least = f"at least {_rounded_up(1.0 / seconds):g} Hz: the recording takes {seconds:.3g} s"
        check(False, "rate", rate_hz, f"{least}, and a lower rate gives a single frame")


def _rounded_up(value: float) -> float:
    """Return a value above 0, rounded up to three digits."""
    step = float(10.0 ** (math.floor(math.log10(value)) - 2))
    return math.ceil(value / step) * step


def resampled(trajectories: T, rate_hz: float | None = None, *, longest_gap_s: float | None = None) -> T:
    """Return the trajectories at a constant rate, from the first frame's time to the last one's, over all runs.

    Positions, standard deviations and angles are interpolated linearly between the neighbouring known samples, and
    poses on the shortest rotation, unless these are more than ``longest_gap_s`` apart. An interpolated keypoint has the
    less certain state of the two. A sample at the very time of a frame is taken unchanged. Sensors are unknown then.

    Args:
        trajectories: the trajectories, at any times.
        rate_hz: the rate; None for `usual_rate_hz` [Hz].
        longest_gap_s: longest time between two samples of a keypoint that is interpolated; None for `LONGEST_GAP_S`, or
            `LONGEST_GAP_FRAMES` at the trajectories' own rate if that is longer [s].

    Raises:
        SettingsError: the rate is not above 0 and at most 10,000 Hz, or gives more frames than fit into memory.
    """
    rate = usual_rate_hz(trajectories) if rate_hz is None else rate_hz
    check(0 < rate <= 10_000, "rate", rate, "above 0 and at most 10000 Hz")
    old = trajectories
    if longest_gap_s is None:
        own = LONGEST_GAP_FRAMES / old.rate_hz if old.rate_hz > 0 else 0.0
        longest_gap_s = max(LONGEST_GAP_S, own)
    first, last = (float(old.times_s.min()), float(old.times_s.max())) if len(old) else (0.0, -1.0)
    count = math.floor((last - first) * rate * (1 + 1e-12) + 1e-6) + 1 if len(old) else 0
    people, points = len(old.individuals), len(old.keypoints)
    fits = count * people * points * 24 <= _MOST_BYTES
    check(fits, "number of frames", count, "fewer: choose a lower rate or fewer individuals, or export the runs apart")
    times = first + np.arange(count) / rate
    positions = np.full((count, people, points, 3), np.nan, old.positions.dtype)
    sd = np.full((count, people, points), np.nan, np.float32)
    states = np.zeros((count, people, points), np.uint8)
    angles = np.full((count, people, len(old.angle_names)), np.nan) if old.angle_names else old.angles
    poses = None if old.poses is None else np.full((count, people, 4, 4), np.nan)
    for i in range(people):
        for k in range(points):
            known = np.all(np.isfinite(old.positions[:, i, k]), axis=1)
            between = Between.of(old.times_s, known, times, longest_gap_s)
            if between is None:
                continue
            to = between.to
            positions[to, i, k] = between.mixed(old.positions[:, i, k])
            sd[to, i, k] = between.mixed(old.sd[:, i, k])
            states[to, i, k] = between.least(old.states[:, i, k])
        for k in range(len(old.angle_names)):
            between = Between.of(old.times_s, np.isfinite(old.angles[:, i, k]), times, longest_gap_s)
            if between is not None:
                angles[between.to, i, k] = between.mixed(old.angles[:, i, k])
        if poses is not None and old.poses is not None:
            between = Between.of(old.times_s, np.isfinite(old.poses[:, i, 0, 0]), times, longest_gap_s)
            if between is not None:
                poses[between.to, i] = between.posed(old.poses[:, i], old.times_s, times)
    runs = old.runs[np.searchsorted(old.times_s, times, side="right") - 1] if count else old.runs[:0]
    return replace(
        old, times_s=times, runs=runs, positions=positions, states=states, sd=sd, angles=angles, poses=poses,
        rate_hz=rate, sensors=old.sensors[:0],
    )  # fmt: skip


class Between:
    """The known samples before and after each time of a grid, where they are near enough.

    Attributes:
        to: indices of the grid's times that have both.
        before, after: indices of the samples.
        share: the later sample's weight, 0 to 1.
    """

    def __init__(self, to: NDArray[np.int64], before: NDArray[np.int64], after: NDArray[np.int64], share: Float64):
        self.to, self.before, self.after, self.share = to, before, after, share

    @staticmethod
    def of(at_s: Float64, known: NDArray[np.bool_], times: Float64, longest_gap_s: float) -> Between | None:
        """Find the known samples around other times; None if there is no such time.

        Args:
            at_s: (samples,) times, rising [s].
            known: (samples,) whether a sample is known.
            times: (times,) the other times [s].
            longest_gap_s: longest time between the two samples [s].
        """
        samples = np.flatnonzero(known)
        if not len(samples):
            return None
        own = at_s[samples]
        after = np.clip(np.searchsorted(own, times - 1e-9), 0, len(own) - 1)
        exact = np.abs(own[after] - times) <= 1e-9
        before = np.where(exact, after, np.maximum(after - 1, 0))
        span = own[after] - own[before]
        inside = exact | ((own[before] <= times) & (times <= own[after]) & (span <= longest_gap_s * (1 + 1e-9)))
        to = np.flatnonzero(inside)
        share = np.where(span > 0, (times - own[before]) / np.where(span > 0, span, 1.0), 0.0)[to]
        return Between(to, samples[before[to]], samples[after[to]], share) if len(to) else None

    def mixed(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Interpolate values (samples, …) linearly."""
        share = self.share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[self.before] * (1 - share) + values[self.after] * share)

    def least(self, states: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the less certain state of the two samples."""
        return np.minimum(states[self.before], states[self.after])

    def posed(self, poses: Float64, at_s: Float64, times: Float64) -> Float64:
        """Interpolate rigid motions (samples, 4, 4) at ``times`` on the shortest rotation."""
        out = np.empty((len(self.to), 4, 4))
        out[:] = np.eye(4)
        out[:, :3, 3] = self.mixed(poses[:, :3, 3])
        from scipy.spatial.transform import Rotation, Slerp  # it takes most of a second to import

        used = np.unique(np.concatenate([self.before, self.after]))
        if len(used) == 1:
            out[:, :3, :3] = poses[used[0], :3, :3]
        else:
            turn = Slerp(at_s[used], Rotation.from_matrix(poses[used, :3, :3]))
            out[:, :3, :3] = turn(np.clip(times[self.to], at_s[used[0]], at_s[used[-1]])).as_matrix()
        return out
