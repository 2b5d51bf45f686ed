"""Decide which parts of a body are still: nothing about them changes in any image.

A part about which no camera sees a change has not moved, whatever the segmentation finds there: a dark limb before a
dark thing has no outline, and that of the thing is none of the body. So such parts are held where they came to rest, by
a prior on points of their surface that is a part of the estimate (`SurfacePrior.hold`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.silhouette_fit import Eye, seen_at
from mocapella.model.memory import set_memory
from mocapella.sensing.frame_changes import near_change
from mocapella.tracker.silhouette_body import SilhouetteBody, Standing

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

CHANGED: Final = 0.05
"""Least share of changed samples about a point that may move."""
MOVES: Final = 0.05
"""A part may move if a larger share of its points in one image may."""
WATCHED: Final = 0.5
"""Least share of a part's points within one image at least; of other parts nothing is known."""
FEWEST_IMAGES: Final = 4
"""Least number of images of a frame for `WITNESSES`: of three, a motion along two lines of sight shows in one alone."""
MOVES_WHOLE: Final = 0.25
"""A part that an image shows clearly moves there only if a larger share of its points may: other things reach beside
parts of it."""
WITNESSES: Final = 2
"""A part that so many cameras show without a change about it is still, whatever changes about it in other images: there
other things move beside it, or before it."""
SETTLING: Final = 15
"""Number of frames in a row that a part is fitted freely, and hardly moves, after an uncertain start, or after it was
misplaced [frames]."""
SETTLED_M: Final = 0.002
"""Largest motion of a part in a frame that settles [m]."""
NEAR_START_M: Final = 0.15
"""Largest distance of a point from where a certain start placed it, of a part that has not gone from there [m]."""
EVERY: Final = 5
"""Stride of the vertices that are looked at."""
_MEMORY: Final = ("_still", "_anchors", "_settling", "_last", "_start", "_near_start", "_witnesses")


class ChangedImage(msgspec.Struct, frozen=True, eq=False):
    """Where one camera's image changes.

    Attributes:
        eye: the camera.
        step_px: distance between samples [px].
        density: (rows, columns) share of changed samples about each sample, of `FrameChanges.update`.
    """

    eye: Eye
    step_px: int
    density: Float32


class HeldPoints(msgspec.Struct, frozen=True, eq=False):
    """Points of a body's surface that are held.

    Attributes:
        points: (k,) bool, whether each of the body's points ``skin`` is held.
        at: (k, 3) where they came to rest, world [m]; meaningless where not held.
    """

    points: Bool
    at: Float64


class LimbStillness:
    """Parts of one body that are still, and where they came to rest: call `update` once a frame.

    Args:
        body: the body.
    """

    def __init__(self, body: SilhouetteBody) -> None:
        self._body = body
        self._points = np.arange(0, len(body.figure.part), EVERY)
        self._part = body.figure.part[self._points]
        self._parts = len(body.mesh.tree.parents)
        self._skin_part = body.figure.part[body.skin]
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._still = np.zeros(self._parts, np.bool_)
        self._settling = np.full(self._parts, SETTLING)
        self._last = np.zeros((len(self._skin_part), 3))
        self._anchors = np.zeros((len(self._skin_part), 3))
        self._start = np.full((len(self._skin_part), 3), np.nan)
        self._near_start = np.zeros(self._parts, np.bool_)
        self._witnesses: dict[str, Bool] = {}

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in _MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned for the same body."""
        set_memory(self, memory)

    @property
    def still(self) -> Bool:
        """Whether each part (parts,) was still in the last frame."""
        return self._still

    @property
    def as_started(self) -> Bool:
        """Whether each part (parts,) is still, and near where a start placed it that is `certain`."""
        return self._still & self._near_start

    def certain(self, stands: Standing) -> None:
        """Remember the body of a start that is certain, such as one of triangulated joints; hold it at once."""
        self._settling = np.zeros(self._parts, np.int64)
        self._start = stands.vertices[self._body.skin]

    def release(self, parts: NDArray[np.int64]) -> None:
        """Hold parts of index ``parts`` (k,) no more until they are fitted elsewhere, because they were misplaced."""
        self._settling = np.where(np.isin(np.arange(self._parts), parts), SETTLING, self._settling)

    def witness(self, shown: Mapping[str, Bool]) -> None:
        """Remember which parts (parts,) each camera shows in this frame, by its name; after `update`.

        A camera remains a witness of a part until its image changes about it.
        """
        for name, parts in shown.items():
            self._witnesses[name] = self._witnesses.get(name, False) | parts

    def update(self, stands: Standing, changes: Mapping[str, ChangedImage], images: int) -> HeldPoints:
        """Decide which parts are still; return the points to hold.

        Args:
            stands: the body fitted in the last frame.
            changes: where the images change, by camera.
            images: number of images of this frame; if changes are known of fewer, nothing is still.
        """
        still = np.full(self._parts, len(changes) == images > 0)
        watched, quiet = np.zeros(self._parts, np.bool_), np.zeros(self._parts, np.int64)
        known = still.copy()
        counts = np.maximum(np.bincount(self._part, minlength=self._parts), 1)
        points = stands.vertices[self._points]
        for name, one in changes.items() if known.any() else ():
            near = near_change(one.density, one.step_px, seen_at(points, one.eye))
            seen = np.bincount(self._part[~np.isnan(near)], minlength=self._parts)
            moving = np.bincount(self._part[near >= CHANGED], minlength=self._parts)
            watched |= seen >= WATCHED * counts
            share = moving / np.maximum(seen, 1)
            still &= share <= MOVES
            if name in self._witnesses:
                self._witnesses[name] = self._witnesses[name] & (share <= MOVES_WHOLE) & (seen >= WATCHED * counts)
                quiet += self._witnesses[name]
        still |= known & (quiet >= WITNESSES) & (images >= FEWEST_IMAGES)
        still &= watched & (self._settling == 0)
        skin = stands.vertices[self._body.skin]
        moved = np.linalg.norm(skin - self._last, axis=1) > SETTLED_M
        restless = np.bincount(self._skin_part[moved], minlength=self._parts) > 0
        self._settling = np.where((self._settling > 0) & restless, SETTLING, np.maximum(self._settling - 1, 0))
        self._last = skin
        begins = (still & ~self._still)[self._skin_part]
        self._anchors = np.where(begins[:, None], skin, self._anchors)
        self._still = still
        # NaN, of no certain start, is near nothing.
        away = np.linalg.norm(skin - self._start, axis=1)
        close = np.bincount(self._skin_part[away < NEAR_START_M], minlength=self._parts)
        self._near_start = close == np.bincount(self._skin_part, minlength=self._parts)
        return HeldPoints(still[self._skin_part], self._anchors)
