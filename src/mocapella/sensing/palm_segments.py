"""The detector `angular-segments`: fingers as the farthest grid points in angular segments around the palm.

One of the two ways to find fingers that the source document of `line-skeleton` gave up;
`docs/detectors/angular-segments.md` says what of it is our reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera import Camera
from mocapella.sensing.line_skeleton import LineSkeleton
from mocapella.sensing.line_skeleton_joints import FINGERS, HandJoints, Place, PointGrid, angles, place_of
from mocapella.sensing.line_skeleton_outline import ArmOutline, Lines
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings
from mocapella.settings import check

Float64 = NDArray[np.float64]
_NONE: Final = np.zeros((0, 2))


@dataclass(frozen=True)
class PalmSegmentsSettings(LineSkeletonSettings):
    """Settings of `PalmSegments`; the settings of `LineSkeletonSettings` up to the grid apply, too.

    Attributes:
        segment_degrees: width of a segment; larger: neighbouring fingers share one, smaller: segments are empty [°].
        palm_part: least distance of a fingertip from the palm, as a multiple of the largest circle about the palm that
            lies within the outline; larger: fewer knuckles are fingertips [ratio].
        gap_m: how much nearer to the palm the hand must reach between two fingertips; larger: fewer fingers [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    segment_degrees: float = 4.0
    palm_part: float = 1.6
    gap_m: float = 0.015

    def __post_init__(self) -> None:
        super().__post_init__()
        check(0.5 <= self.segment_degrees <= 45, "segment_degrees", self.segment_degrees, "from 0.5 to 45")
        check(1 <= self.palm_part <= 10, "palm_part", self.palm_part, "from 1 to 10")
        check(0 <= self.gap_m <= 0.2, "gap_m", self.gap_m, "from 0 to 0.2 m")


class PalmSegments(LineSkeleton):
    """`LineSkeleton` with another last stage: a fingertip is where the hand reaches farther than beside it.

    Args:
        camera: as of `LineSkeleton`.
        settings: thresholds; the defaults if None.
    """

    name = "angular-segments"
    settings: PalmSegmentsSettings

    def __init__(self, camera: Camera, settings: PalmSegmentsSettings | None = None) -> None:
        super().__init__(camera, settings or PalmSegmentsSettings())

    def _hand(self, of: ArmOutline, found: Lines, points: PointGrid) -> HandJoints:
        place = place_of(of, found, points, self.focal_px)
        outer = segment_tips(points, place, self.settings)
        tips = np.zeros((FINGERS, 2))
        tips[: len(outer)] = outer
        return HandJoints(place.elbow, place.palm, place.wrist, place.inside_px, _NONE, (), outer, _NONE, tips)


def segment_tips(points: PointGrid, place: Place, s: PalmSegmentsSettings) -> Float64:
    """Return the fingertips, (n, 2) pixels in the mirrored image, n up to 5, in the order of their angles.

    Each grid point belongs to the segment of its angle around the palm, from the forearm's direction. A segment reaches
    as far as its farthest point. Segments that reach farther than those beside them are fingertips.

    Args:
        points: the grid points of the arm.
        place: where elbow and palm are.
        s: width of the segments, and least distance of far points.
    """
    off = points.pixels - place.palm
    far, turn = np.hypot(*off.T), angles(points.pixels.astype(np.float64), place.palm, place.palm - place.elbow)
    widest, width = math.radians(s.finger_degrees), math.radians(s.segment_degrees)
    within = np.flatnonzero(np.abs(turn) <= widest)
    count = max(1, math.ceil(2 * widest / width))
    segment = np.minimum(((turn[within] + widest) / width).astype(int), count - 1)
    reach, which = np.zeros(count), np.full(count, -1)
    order = np.argsort(far[within], kind="stable")  # the farthest is written last
    reach[segment[order]], which[segment[order]] = far[within][order], within[order]
    tops = peaks(reach, s.gap_m * place.px_per_m)
    tops = tops[reach[tops] >= max(s.palm_part * place.inside_px, 1.0)]
    tops = np.sort(tops[np.argsort(-reach[tops], kind="stable")][:FINGERS])
    return np.asarray(points.pixels[which[tops]], dtype=np.float64).reshape(-1, 2)


def peaks(values: Float64, deep: float) -> NDArray[np.intp]:
    """Return the indices of peaks in (n,) values, in order: between any two, values fall by ``deep`` below both.

    Of equal values, the first is the peak. Before and after the values, there is a valley.
    """
    kept, top, low, rising = [], 0, math.inf, True
    for k, value in enumerate([*values.tolist(), -math.inf]):
        if rising:
            if value > values[top]:
                top = k
            elif value < values[top] - deep or value == -math.inf:
                kept.append(top)
                low, rising = value, False
        elif value > low + deep:
            top, rising = k, True
        else:
            low = min(low, value)
    return np.array(kept, dtype=np.intp)
