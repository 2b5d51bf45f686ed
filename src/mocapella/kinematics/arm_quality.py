"""Quality metrics for arms without ground truth: jitter of a still arm, and misdetections per minute.

- **Noise**: root mean square motion of each joint about its mean, over a window in which palm and joint were still.
- **Misdetections**: joints that move between two frames by more than 5 cm relative to the whole arm (the median of its
  joints' motions), and faster than a finger can; fingertips that appear, disappear, or swap positions.

The 5 cm are those of G. Glynos' thesis (2012), which counts them from image to image. A finger that opens fast moves as
far between two images of 30 Hz. So, without ground truth, the speed decides, and with it (`misdetected`'s ``true``),
the true motion is left out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.model.arm_quality import LEAST_SEEN_S, ArmQuality, Misdetections
from mocapella.model.arms import ARM_JOINTS
from mocapella.settings import check

Float64 = NDArray[np.float64]

_PALM: Final = 2
_TIPS: Final = slice(3, 8)
"""In `ARM_JOINTS`."""
_PARTS: Final = 8
_OVER_S: Final = 60.0
_NOISY: Final = 4.0
"""Tolerance of still joints, in standard deviations of the mean position in an eighth of the window …"""
_MOST_NOISE_M: Final = 0.006
"""… and its limit [m], or a moving arm would pass for a noisy one."""


class Arm(Protocol):
    """Interface of the measured arms: `mocapella.model.arms.SeenArm`, or a tracked arm.

    Attributes:
        id: number of the arm, constant from frame to frame.
        left: whether it is a left arm.
        points: (23, 3) positions of `mocapella.model.arms.ARM_POINTS` [m]; NaN where not known.
    """

    @property
    def id(self) -> int: ...  # noqa: D102
    @property
    def left(self) -> bool: ...  # noqa: D102
    @property
    def points(self) -> Float64: ...  # noqa: D102


@dataclass(frozen=True)
class ArmQualitySettings:
    """Thresholds for a still palm and for a jump.

    Attributes:
        still_window_s: time for which an arm must be still for its noise to be measured [s].
        still_m: largest distance between the mean positions of the palm in any two eighths of the window, beyond
            noise, for an arm that counts as still [m].
        least_frames: fewest frames in the window.
        jump_m: least motion between two frames of a joint that has jumped [m].
        jump_m_s: least speed between two frames of a joint that has jumped; larger: fast fingers count less often, and
            so do short jumps [m/s].
        reach_m: motion above which a joint has jumped however slow it was; larger: hands that turn between distant
            frames count less often [m].
        gap_s: frames farther apart than this are not compared [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    still_window_s: float = 2.0
    still_m: float = 0.002
    least_frames: int = 20
    jump_m: float = 0.05
    jump_m_s: float = 3.0
    reach_m: float = 0.15
    gap_s: float = 0.2

    def __post_init__(self) -> None:
        check(0.1 <= self.still_window_s <= 60, "still_window_s", self.still_window_s, "from 0.1 to 60 s")
        check(0 < self.still_m <= 0.1, "still_m", self.still_m, "above 0, at most 0.1 m")
        check(_PARTS <= self.least_frames <= 10_000, "least_frames", self.least_frames, f"from {_PARTS} to 10000")
        check(0 < self.jump_m <= 1, "jump_m", self.jump_m, "above 0, at most 1 m")
        check(0 <= self.jump_m_s <= 1000, "jump_m_s", self.jump_m_s, "from 0 to 1000 m/s")
        check(self.jump_m <= self.reach_m <= 10, "reach_m", self.reach_m, "from jump_m to 10 m")
        check(0 < self.gap_s <= 10, "gap_s", self.gap_s, "above 0, at most 10 s")

    def least_jump_m(self, step_s: float) -> float:
        """Return the motion between two frames, ``step_s`` [s] apart, above which a joint has jumped [m]."""
        return min(max(self.jump_m, self.jump_m_s * step_s), self.reach_m)


def swapped_pairs(before: Float64, now: Float64, least_m: float = 0.01) -> list[tuple[int, int]]:
    """Return the pairs of points that swapped positions between two frames.

    Each point of a pair is now less than half as far from the other's earlier position as from its own.

    Args:
        before, now: (n, 3) [m]; NaN where not known.
        least_m: pairs of points that were closer together than this are not compared [m].

    Returns:
        Pairs of indices i < j; points with NaN are in none.
    """
    apart = np.linalg.norm(now[:, None] - before[None], axis=-1)
    between = np.linalg.norm(before[:, None] - before[None], axis=-1)
    own = np.diag(apart)
    with np.errstate(invalid="ignore"):
        taken = (apart < 0.5 * own[:, None]) & (between > least_m)
    both = np.triu(taken & taken.T, 1)
    return [(int(i), int(j)) for i, j in np.argwhere(both)]


def misdetected(before: Float64, now: Float64, jump_m: float, true: Float64 | None = None) -> Misdetections:
    """Count the jumps, appearances, losses and swaps of an arm's eight joints between two frames.

    A joint has jumped if its motion differs from the median motion of all joints by more than ``jump_m``. Only
    fingertips appear, vanish and swap; a swap does not count as a jump.

    Args:
        before, now: (8, 3) positions of `ARM_JOINTS` [m]; NaN where not known.
        jump_m: threshold of a jump [m].
        true: (8, 3) true motions of the joints between the frames, which are left out of ``now`` [m]; None if unknown.
    """
    now = now if true is None else now - true
    moved = now - before
    known = np.isfinite(moved).all(axis=-1)
    whole = np.median(moved[known], axis=0) if known.any() else np.zeros(3)
    there, is_there = (np.isfinite(joints[_TIPS]).all(axis=-1) for joints in (before, now))
    pairs = swapped_pairs(before[_TIPS] + whole, now[_TIPS])
    jumped = known & (np.linalg.norm(np.nan_to_num(moved - whole), axis=-1) > jump_m)
    for i, j in pairs:
        jumped[[_TIPS.start + i, _TIPS.start + j]] = False
    return Misdetections(
        jumped=int(jumped.sum()), appeared=int((is_there & ~there).sum()), vanished=int((there & ~is_there).sum()),
        swapped=len(pairs),
    )  # fmt: skip


class _Followed:
    """The recent joint positions of one arm."""

    def __init__(self) -> None:
        self.left = False
        self.frames: deque[tuple[float, Float64]] = deque()
        self.pooled_until_s = -math.inf


class ArmQualityMeter:
    """Measures the quality of arms frame by frame, by capture time.

    Args:
        settings: thresholds; the defaults if None.
    """

    def __init__(self, settings: ArmQualitySettings | None = None) -> None:
        self.settings = settings or ArmQualitySettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arms: dict[int, _Followed] = {}
        self._lately: deque[tuple[float, float, Misdetections]] = deque()
        self._whole = Misdetections()
        self._seen_s = self._still_s = 0.0
        self._squares, self._squared = np.zeros(len(ARM_JOINTS)), np.zeros(len(ARM_JOINTS), dtype=np.int64)
        self._noise = np.full(len(ARM_JOINTS), np.nan)
        self._still = False
        self._at_s: float | None = None

    def update(self, arms: Sequence[Arm], at_s: float) -> ArmQuality:
        """Measure the arms of a frame.

        Args:
            arms: all arms of the frame, or none; an arm of the last frame whose id is missing counts as lost.
            at_s: capture time [s]. The windows of still arms restart unless it is after the last frame, by at most
                ``gap_s``; unless it is after the last frame, the counts per minute restart, too.

        Returns:
            The quality measured so far, as ``quality``.
        """
        s = self.settings
        compare = self._at_s is not None and 0 < at_s - self._at_s <= s.gap_s
        step_s = at_s - self._at_s if compare and self._at_s is not None else 0.0
        if not compare:
            self._arms.clear()
            if self._at_s is not None and at_s <= self._at_s:
                self._lately.clear()
        self._at_s = at_s
        found, seen_s = Misdetections(lost=len(self._arms.keys() - {arm.id for arm in arms})), 0.0
        self._arms = {arm.id: self._arms.get(arm.id, _Followed()) for arm in arms}
        for arm in arms:
            followed, joints = self._arms[arm.id], np.asarray(arm.points, dtype=np.float64)[list(ARM_JOINTS)]
            if followed.frames:
                seen_s += step_s
                found = found.plus(misdetected(followed.frames[-1][1], joints, s.least_jump_m(step_s)))
                found = found.plus(Misdetections(swapped=int(arm.left != followed.left)))
            followed.left = arm.left
            followed.frames.append((at_s, joints))
            while at_s - followed.frames[0][0] > s.still_window_s + 1e-9:
                followed.frames.popleft()
        self._count(found, seen_s, at_s)
        self._measure(at_s, step_s)
        return self.quality

    def _count(self, found: Misdetections, seen_s: float, at_s: float) -> None:
        self._whole = self._whole.plus(found)
        self._seen_s += seen_s
        self._lately.append((at_s, seen_s, found))
        while at_s - self._lately[0][0] > _OVER_S:
            self._lately.popleft()

    def _measure(self, at_s: float, step_s: float) -> None:
        s, rows = self.settings, []
        for followed in self._arms.values():
            if len(followed.frames) < s.least_frames or at_s - followed.frames[0][0] < 0.9 * s.still_window_s:
                continue
            joints = np.stack([joints for _, joints in followed.frames])
            still = _still(joints, s.still_m)
            if not still[_PALM]:
                continue
            self._still_s += step_s
            squares = np.where(still, ((joints - joints.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0), np.nan)
            rows.append(squares)
            if followed.frames[0][0] > followed.pooled_until_s:  # windows that share frames would count them twice
                followed.pooled_until_s = at_s
                self._squares += np.where(still, len(joints) * np.nan_to_num(squares), 0.0)
                self._squared += np.where(still, len(joints), 0)
        self._still = bool(rows)
        if rows:
            stacked = np.stack(rows)
            told = np.isfinite(stacked)
            mean = np.nansum(stacked, axis=0) / np.maximum(told.sum(axis=0), 1)
            self._noise = np.where(told.any(axis=0), np.sqrt(mean), self._noise)

    @property
    def quality(self) -> ArmQuality:
        """The quality measured so far."""
        lately, seen_s = Misdetections(), 0.0
        for _, seconds, found in self._lately:
            seen_s += seconds
            if found.of_joints or found.lost:
                lately = lately.plus(found)
        with np.errstate(invalid="ignore", divide="ignore"):
            whole = np.sqrt(self._squares / self._squared)
        per_minute = lately.of_joints * 60.0 / seen_s if seen_s >= LEAST_SEEN_S else math.nan
        return ArmQuality(
            self._noise, whole, self._still, per_minute, lately, self._whole, self._seen_s, self._still_s
        )  # fmt: skip


def _still(joints: Float64, still_m: float) -> NDArray[np.bool_]:
    """Return which joints (8,) of (n, 8, 3) were known in all frames, and moved at most ``still_m``, beyond noise."""
    parts = np.array_split(joints, _PARTS)
    means = np.stack([part.mean(axis=0) for part in parts])
    apart = np.linalg.norm(means[:, None] - means[None], axis=-1).max(axis=(0, 1))
    # Second differences remove the motion; their variance is six times that of the noise, and the median of a normal
    # point's squared distance 0.789 of its mean.
    bends = (np.diff(joints, n=2, axis=0) ** 2).sum(axis=-1)
    noise = np.sqrt(np.median(bends, axis=0) / (6 * 0.789))
    with np.errstate(invalid="ignore"):
        return np.asarray(apart <= still_m + np.minimum(_NOISY * noise / math.sqrt(len(parts[-1])), _MOST_NOISE_M))
