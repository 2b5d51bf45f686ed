"""Find edges of the room among the edges of one static camera's image at a body's outline.

    edges = RoomEdges(step_px=2)
    edges.of_room(image, at, normals, background)     which points of the outline have such an edge
    edges.keep(image, body)                           remember the first image, and where the body was

An edge of a chair or a desk that lies along a limb of the model is as clear as the limb's own. It is an edge of the
room if the image inside the model's outline is the learnt background, or if both sides of the edge look as they did in
the first image, where the body was elsewhere then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background_memory import BackgroundMemory
from mocapella.sensing.image_samples import image_samples, samples_at
from mocapella.settings import check

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

BESIDE_STEPS: Final = 1.5
"""Distance from the outline of the samples that are compared, inwards and outwards [samples]."""
CLEAR_LEVELS: Final = 28.0
"""Least difference of both sides, of an edge that would differ from the background if it were the body's: twice what
the foreground score accepts as background, in the default settings [grey levels]."""
UNCHANGED: Final = 0.5
"""Largest change of a side since the first image, as a share of the difference of both sides, of an edge that was there
before [ratio]."""
APART_STEPS: Final = 4
"""Least distance of a place from the body in the first image, where the body was elsewhere [samples]."""


class RoomEdges:
    """Edges of the room in one camera's images; its memory has the first image, at the distance of samples.

    Args:
        step_px: distance between samples, each the mean of a square of pixels as wide [px].

    Raises:
        SettingsError: ``step_px`` is below 1.
    """

    def __init__(self, step_px: int) -> None:
        check(step_px >= 1, "step_px", step_px, "1 or more")
        self.step_px = step_px
        self.reset()

    def reset(self) -> None:
        """Forget the first image; the next one that is kept takes its place."""
        self._first: UInt8 = np.empty((0, 0, 0), np.uint8)
        self._body: Bool = np.empty((0, 0), np.bool_)

    def memory(self) -> list[Any]:
        """Return all state, for `recall`; its arrays are shared, and never changed."""
        return [self._first, self._body]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned, of the same step."""
        self._first, self._body = memory

    def keep(self, image: UInt8, body: Silhouette) -> None:
        """Keep an image if there is none since `reset`.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            body: where the body is in it.
        """
        import cv2

        if self._first.size:
            return
        self._first = image_samples(image, self.step_px)
        mask = body.mask((image.shape[1], image.shape[0]))
        wide = 2 * APART_STEPS * self.step_px + 1
        grown = np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((wide, wide), np.uint8)))
        rows, columns = self._first.shape[:2]
        self._body = grown[:: self.step_px, :: self.step_px][:rows, :columns] > 0

    def of_room(self, image: UInt8, at: Float64, normals: Float64, background: BackgroundMemory) -> Bool:
        """Return whether the image has an edge of the room, or no edge at all, at each point (n,) of an outline.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            at: (n, 2) points of the body's outline in it, x, y [px].
            normals: (n, 2) outward normals there, of any length.
            background: the background learnt so far.
        """
        long = np.linalg.norm(normals, axis=1, keepdims=True)
        beside = BESIDE_STEPS * self.step_px * normals / np.maximum(long, 1e-9)
        inside, outside = at - beside, at + beside
        now = image_samples(image, self.step_px)
        within, without = samples_at(now, self.step_px, inside), samples_at(now, self.step_px, outside)
        contrast = np.abs(within - without).max(axis=1)
        found = (background.strange_at(image, inside) < 0) & (contrast >= CLEAR_LEVELS)
        if self._first.shape == now.shape:
            change = np.maximum(
                np.abs(within - samples_at(self._first, self.step_px, inside)).max(axis=1),
                np.abs(without - samples_at(self._first, self.step_px, outside)).max(axis=1),
            )
            elsewhere = samples_at(~self._body[..., None], self.step_px, at)[:, 0] > 0
            found |= elsewhere & (change < UNCHANGED * contrast)
        return np.asarray(found)
