"""Statistics of a silhouette run in constant memory, however long it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Final

from mocapella.recording.bodies_file import FollowedFrame

STEP: Final = 1e-4
"""Resolution of overlaps in a file."""
STEP_MS: Final = 0.01
"""Resolution of frame durations [ms]."""


class BinnedValues:
    """Minimum and median of the values that `add` takes, rounded to a step and counted; ``+=`` adds another's counts.

    Args:
        step: resolution, in the unit of the values. ``+=`` needs equal steps and does not check them.
    """

    def __init__(self, step: float) -> None:
        self._step, self._counts = step, Counter[int]()

    def add(self, value: float) -> None:
        """Add a value to its bin."""
        self._counts[round(value / self._step)] += 1

    def __len__(self) -> int:
        return self._counts.total()

    def __iadd__(self, other: BinnedValues) -> BinnedValues:
        self._counts.update(other._counts)
        return self

    @property
    def least(self) -> float:
        """The smallest value; there must be one."""
        return min(self._counts) * self._step

    @property
    def median(self) -> float | None:
        """The median, of an even number of values the mean of the middle two; None without values."""
        count, seen, low = len(self), 0, None
        for value in sorted(self._counts):
            seen += self._counts[value]
            if low is None and 2 * seen >= count:
                low = value
            if 2 * seen > count:
                assert low is not None
                return 0.5 * (low + value) * self._step
        return None


class BodyStatistics:
    """Statistics of one body over a run, in constant memory.

    Attributes:
        frames: number of frames.
        lost: number of frames in which the body was lost.
        unsupported: number of frames without an image that shows a joint, by its name.
        left_out: number of frames with an unused or missing image, by camera.
        overlaps: intersection over union of the model's and the image's silhouettes, by camera.
        shown: share of the model's outline for which the image has evidence, by camera.
        keypoints_left_out: number of landmarks, over all frames, whose keypoints every image contradicted; None
            without keypoints.
    """

    def __init__(self) -> None:
        self.frames = self.lost = 0
        self.left_out, self.unsupported = Counter[str](), Counter[str]()
        self.overlaps: dict[str, BinnedValues] = {}
        self.shown: dict[str, BinnedValues] = {}
        self.keypoints_left_out: int | None = None

    def add(self, row: FollowedFrame) -> None:
        """Add one frame's result: whether the body is lost, the unused images, and the overlaps by camera."""
        self.frames += 1
        self.lost += row.lost
        self.left_out.update(row.left_out.keys())
        self.unsupported.update(row.unsupported)
        for camera, overlap in row.overlap.items():
            self.overlaps.setdefault(camera, BinnedValues(STEP)).add(overlap)
        for camera, share in row.shown.items():
            self.shown.setdefault(camera, BinnedValues(STEP)).add(share)

    def summary(self) -> dict[str, object]:
        """Return the statistics in the form of ``--json``; medians are over all cameras, None without any."""
        left = self.keypoints_left_out
        return {
            "frames": self.frames,
            "lost": self.lost,
            "left_out": dict(self.left_out),
            "unsupported": dict(self.unsupported),
            "median_overlap": _median(self.overlaps),
            "median_shown": _median(self.shown),
            **({} if left is None else {"keypoints_left_out": left}),
        }


def _median(of: Mapping[str, BinnedValues]) -> float | None:
    """Return the median over all cameras; None without values."""
    whole = BinnedValues(STEP)
    for one in of.values():
        whole += one
    median = whole.median
    return None if median is None else round(median, 4)
