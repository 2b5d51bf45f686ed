"""Find foreground that is none of a tracked person: things and people that come, in the images of one static camera.

    things = PassingThings()
    ignored = things.update(foreground, unknown, body)     # its pixels are no evidence for or against the body

Foreground that is apart from the body, with background between, begins a thing. From then on it is one, also when it
comes beside the body, where it could be taken for a limb. A limb that a tracker has lost is no thing, as it hangs on
the body, also through unknown pixels, as where the body stood from the first image on.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]

APART: Final = 2
"""Least distance of a thing from the body, where it begins [samples]."""
LEAST: Final = 10
"""Least size of a thing, outside of the body's neighbourhood [samples]."""
MOVES: Final = 2
"""Largest motion of a thing between two images [samples]."""


class PassingThings:
    """The things in one camera's images; its memory is where they were."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all things."""
        self._things = np.zeros((0, 0), np.bool_)

    def memory(self) -> list[Bool]:
        """Return all state, for `recall`; its array is shared, and never changed."""
        return [self._things]

    def recall(self, memory: list[Bool]) -> None:
        """Restore the state that `memory` returned."""
        (self._things,) = memory

    def update(self, foreground: Bool, unknown: Bool, body: Bool) -> Bool:
        """Follow the things to the next image; return where they are, outside of the body.

        Args:
            foreground: (rows, columns) whether each sample is foreground, at the same samples in every image.
            unknown: (rows, columns) whether a sample may be foreground or background.
            body: (rows, columns) where the body is expected.
        """
        import cv2

        if self._things.shape != foreground.shape:
            self._things = np.zeros(foreground.shape, np.bool_)
        if not foreground.any():
            self._things = np.zeros(foreground.shape, np.bool_)
            return self._things
        near = _grown(body, APART)
        _, labels = cv2.connectedComponents((foreground | unknown).astype(np.uint8))
        apart = np.ones(labels.max() + 1, np.bool_)
        apart[np.unique(labels[near])] = False
        apart[0] = False
        begun = apart[labels] & foreground
        things = (begun | (foreground & _grown(self._things, MOVES))) & ~body
        _, labels = cv2.connectedComponents(things.astype(np.uint8))
        large = np.bincount(labels[~near], minlength=labels.max() + 1) >= LEAST
        large[0] = False
        self._things = large[labels]
        return self._things


def _grown(mask: Bool, by: int) -> Bool:
    """Return a mask (rows, columns), dilated by samples."""
    import cv2

    side = np.ones((2 * by + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), side) > 0)
