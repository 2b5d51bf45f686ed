"""What a run of silhouettes comes to, counted as it goes on: however long it is, this does not grow with it."""

from __future__ import annotations

from collections import Counter
from typing import Final

from mocapella.recording.bodies_file import FollowedFrame

STEP: Final = 1e-4
"""To so much overlaps are told in a file."""
STEP_MS: Final = 0.01
"""To so much the time a frame took is known."""


class Counted:
    """Values of which the median is asked for, each counted to the next step."""

    def __init__(self, step: float) -> None:
        self._step, self._counts = step, Counter[int]()

    def add(self, value: float) -> None:
        """One more."""
        self._counts[round(value / self._step)] += 1

    def __len__(self) -> int:
        return self._counts.total()

    def __iadd__(self, other: Counted) -> Counted:
        self._counts.update(other._counts)
        return self

    @property
    def least(self) -> float:
        """The smallest; of none there is none."""
        return min(self._counts) * self._step

    @property
    def median(self) -> float | None:
        """Half of them are below; None where there are none."""
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
    """What came of one body.

    Attributes:
        frames: how many.
        lost: of these, in how many nobody was there.
        left_out: frames in which a camera did not count, by camera.
        overlaps: by camera.
    """

    def __init__(self) -> None:
        self.frames = self.lost = 0
        self.left_out = Counter[str]()
        self.overlaps: dict[str, Counted] = {}

    def add(self, row: FollowedFrame) -> None:
        """The next frame."""
        self.frames += 1
        self.lost += row.lost
        self.left_out.update(row.left_out.keys())
        for camera, overlap in row.overlap.items():
            self.overlaps.setdefault(camera, Counted(STEP)).add(overlap)

    def summary(self) -> dict[str, object]:
        """As ``--json`` has it."""
        whole = Counted(STEP)
        for one in self.overlaps.values():
            whole += one
        median = whole.median
        return {
            "frames": self.frames,
            "lost": self.lost,
            "left_out": dict(self.left_out),
            "median_overlap": None if median is None else round(median, 4),
        }
