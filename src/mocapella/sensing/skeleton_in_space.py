"""The detector `line-skeleton-3d`: fingers as the ends of thin lines that depth lifts into space.

One of the two ways to find fingers that the source document of `line-skeleton` gave up;
`docs/detectors/line-skeleton-3d.md` says what of it is our reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera import Camera
from mocapella.sensing.line_skeleton import LineSkeleton
from mocapella.sensing.line_skeleton_joints import FINGERS, HandJoints, PointGrid, angles, place_of
from mocapella.sensing.line_skeleton_outline import ArmOutline, Lines
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings
from mocapella.settings import check

Float64 = NDArray[np.float64]
_NONE: Final = np.zeros((0, 2))
_RING: Final = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
"""The eight neighbours, row and column, around a pixel."""
_STRAIGHT_FIRST: Final = (*_RING[::2], *_RING[1::2])
_MOST_AT_END: Final = 2
_FORK: Final = 3


@dataclass(frozen=True)
class SkeletonInSpaceSettings(LineSkeletonSettings):
    """Settings of `SkeletonInSpace`; the settings of `LineSkeletonSettings` up to the thinning apply, too.

    Attributes:
        back_px: number of pixels that a line is followed back from its end, to see where it points; larger: a bent
            finger's tip is placed on its straight continuation [px].
        length_m: least length in space of the line from its end towards the palm: a shorter one is a side branch [m].
        tip_from_palm_m: least distance in space of a fingertip from the palm [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    back_px: int = 12
    length_m: float = 0.02
    tip_from_palm_m: float = 0.06

    def __post_init__(self) -> None:
        super().__post_init__()
        check(2 <= self.back_px <= 200, "back_px", self.back_px, "from 2 to 200 px")
        check(0 <= self.length_m <= 0.5, "length_m", self.length_m, "from 0 to 0.5 m")
        check(0 <= self.tip_from_palm_m <= 0.5, "tip_from_palm_m", self.tip_from_palm_m, "from 0 to 0.5 m")


class SkeletonInSpace(LineSkeleton):
    """`LineSkeleton` with another last stage: a fingertip is the end of a thin line whose length is measured in space.

    Args:
        camera: as of `LineSkeleton`.
        settings: thresholds; the defaults if None.
    """

    name = "line-skeleton-3d"
    settings: SkeletonInSpaceSettings

    def __init__(self, camera: Camera, settings: SkeletonInSpaceSettings | None = None) -> None:
        super().__init__(camera, settings or SkeletonInSpaceSettings())

    def _hand(self, of: ArmOutline, found: Lines, points: PointGrid) -> HandJoints:
        s, place = self.settings, place_of(of, found, points, self.focal_px)
        palm = self._lifted(of, place.palm[None])[0]
        tips = []
        for way in ends_of(found.skeleton.thinned > 0):
            end = way[0].astype(np.float64)
            line = self._lifted(of, way.astype(np.float64))
            if not np.isfinite(line).all() or np.linalg.norm(np.diff(line, axis=0), axis=-1).sum() < s.length_m:
                continue
            if (
                not np.linalg.norm(line[0] - palm) >= s.tip_from_palm_m
                or np.hypot(*(end - place.palm)) <= place.inside_px
            ):
                continue
            back = end - way[min(s.back_px, len(way) - 1)]
            ahead = float(found.skeleton.distance[way[0][1], way[0][0]]) * back / max(float(np.hypot(*back)), 1e-9)
            tips.append((float(np.linalg.norm(line[0] - palm)), end + ahead))  # thinning stops a radius before the tip
        ends = np.array([at for _, at in sorted(tips, key=lambda tip: -tip[0])]).reshape(-1, 2)
        turn = angles(ends, place.palm, place.palm - place.elbow)
        ends, turn = (one[np.abs(turn) <= math.radians(s.finger_degrees)][:FINGERS] for one in (ends, turn))
        outer = ends[np.argsort(turn, kind="stable")]
        placed = np.zeros((FINGERS, 2))
        placed[: len(outer)] = outer
        return HandJoints(place.elbow, place.palm, place.wrist, place.inside_px, _NONE, (), outer, _NONE, placed)

    def _lifted(self, of: ArmOutline, pixels: Float64) -> Float64:
        """Return (n, 3) points in space [m] of pixels (n, 2) of the mirrored image; NaN of those outside the arm."""
        height, width = of.arm.shape
        x, y = np.clip(np.rint(pixels).astype(int), 0, (width - 1, height - 1)).T
        z = np.where(of.arm[y, x] > 0, of.metres[y, x], np.nan)
        return np.asarray(np.concatenate([self._rays[y, x], np.ones((len(z), 1))], axis=-1) * z[:, None])


def ends_of(thin: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the ways (n, 2), x and y, from each end of thin lines to the next fork, or to the other end.

    Args:
        thin: (height, width) lines of one pixel's width. At an end one run of the eight neighbours is set, at a fork
            three or more (the crossing number of Zhang and Suen 1984).
    """
    wide = np.pad(thin, 1).astype(np.int8)
    ring = np.stack([np.roll(wide, (-i, -j), axis=(0, 1)) for i, j in _RING])
    runs = ((ring == 0) & (np.roll(ring, -1, axis=0) > 0)).sum(axis=0)
    ways = []
    for row, column in np.argwhere((wide > 0) & (runs == 1) & (ring.sum(axis=0) <= _MOST_AT_END)):
        at, way, seen = (int(row), int(column)), [], set()
        while True:
            way.append((at[1] - 1, at[0] - 1))
            seen.add(at)
            straight = [(at[0] + i, at[1] + j) for i, j in _STRAIGHT_FIRST]
            ahead = [one for one in straight if wide[one] and one not in seen]
            if not ahead or (len(way) > 1 and runs[at] >= _FORK):
                break
            at = ahead[0]
        ways.append(np.array(way, dtype=np.intp))
    return ways
