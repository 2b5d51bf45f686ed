"""Whether what was taken for a body looks as the room does when nobody is in it.

A region model always finds an outline where it expects one. So a camera in whose image the body is not keeps what it
shows, and what is later taken for the body there is compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.silhouettes import Silhouette

UInt8 = NDArray[np.uint8]

DIFFERS: Final = 25
"""Grey levels in a channel by which a pixel differs from an empty room, whatever the light does."""


class EmptyRoom:
    """The last image of each camera with nobody in it."""

    def __init__(self) -> None:
        self._images: dict[str, UInt8] = {}

    def learn(self, images: Mapping[str, UInt8]) -> None:
        """Nobody is in these (height, width, 3)."""
        self._images |= {name: image.copy() for name, image in images.items()}

    def differs(self, name: str, image: UInt8, taken: Silhouette) -> float:
        """Share of what was taken for a body that is not as in the empty room; NaN where that was never seen.

        Args:
            name: of the camera.
            image: (height, width, 3).
            taken: for the body.
        """
        empty = self._images.get(name)
        if empty is None:
            return float("nan")
        rows, columns = np.nonzero(taken.phi > 0)
        x, y = (np.array([columns, rows]).T * taken.step_px + np.array(taken.origin_px)).T
        inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
        x, y = x[inside], y[inside]
        if len(x) == 0:
            return float("nan")
        off = np.abs(image[y, x].astype(np.int16) - empty[y, x])
        return float((off.max(axis=-1) > DIFFERS).mean())
