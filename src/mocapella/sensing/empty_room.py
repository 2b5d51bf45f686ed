"""Verify a segmented body without a body model: by the empty room, and by motion.

A region model finds a contour wherever it expects one. So each camera keeps an image without the person, and later
segmentations are compared with it; and changes since the first image must lie where the body was or is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.model.silhouettes import Silhouette

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

DIFFERS: Final = 25
"""A pixel is foreground if a channel differs from the empty room by more than this [grey levels]."""
FEWEST: Final = 0.2
"""Least changed area, as a share of the body's area, from which motion is judged."""
GROWN: Final = 0.1
"""Margin around a body that may change with it, such as its shadow, as a share of its height."""
_STEP_PX: Final = 2
_GRAIN: Final = 7
"""Side of a square [samples]; changes in less than half of it are noise."""


class EmptyRoom:
    """Background image of the empty room by camera, learnt wherever no person is, for background subtraction."""

    def __init__(self) -> None:
        self._images: dict[str, UInt8] = {}
        self._known: dict[str, Bool] = {}

    def memory(self) -> list[Any]:
        """Return the state for `recall`: the object's own arrays, which `learn` changes, not copies."""
        return [self._images, self._known]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore a state that `memory` returned: images of the empty room by camera, which are kept, not copied."""
        self._images, self._known = memory

    def learn(self, images: Mapping[str, UInt8], people: Mapping[str, Silhouette] | None = None) -> None:
        """Learn the empty room from images, except near people; newer pixels replace older ones.

        Args:
            images: (height, width, 3) uint8 BGR by camera, of the same size each time; they are copied.
            people: silhouettes of the people in the images, by camera; None for none.
        """
        for name, image in images.items():
            free = np.ones(image.shape[:2], np.bool_)
            if people is not None and name in people:
                free = ~_grown(people[name].mask((image.shape[1], image.shape[0])))
            if name not in self._images:
                self._images[name], self._known[name] = image.copy(), free
            else:
                self._images[name][free] = image[free]
                self._known[name] |= free

    def knows(self, name: str) -> bool:
        """Return whether the empty room of the camera ``name`` was learnt."""
        return name in self._images

    def differs(self, name: str, image: UInt8, taken: Silhouette, others: Bool | None = None) -> float:
        """Return the share of a segmented body, 0 to 1, that differs from the empty room; NaN if it is unknown.

        Args:
            name: name of the camera.
            image: (height, width, 3) uint8 BGR, of the size that was learnt.
            taken: the segmented body.
            others: (height, width) bool, True on other people, whose pixels are left out first; None for none.

        Returns:
            The share of differing pixels among the body's remaining pixels where the room was learnt. NaN if the room
            was learnt at no more than half of the remaining pixels, if none remains, or for an unknown camera.
        """
        empty = self._images.get(name)
        if empty is None:
            return float("nan")
        inside = taken.mask((image.shape[1], image.shape[0]))
        inside = inside if others is None else inside & ~others
        known = inside & self._known[name]
        if 2 * np.count_nonzero(known) <= np.count_nonzero(inside):
            return float("nan")
        return float(_differ(image[known], empty[known]).mean())

    def silhouette(self, name: str, image: UInt8, things: int = 1, others: Bool | None = None) -> Silhouette | None:
        """Segment the largest foreground objects of an image; None where the empty room is unknown or nothing differs.

        Args:
            name: name of the camera.
            image: (height, width, 3) uint8 BGR.
            things: largest number of objects.
            others: (height, width) bool, True on other people, who are left out; None for none.

        Returns:
            A silhouette in the whole image, sampled at every second pixel, with phi of 0.5 on the objects and −0.5
            elsewhere instead of signed distances.
        """
        empty = self._images.get(name)
        if empty is None:
            return None
        thinned = np.s_[::_STEP_PX, ::_STEP_PX]
        changed = _differ(image[thinned], empty[thinned]) & self._known[name][thinned]
        changed = changed if others is None else changed & ~others[thinned]
        cleaned = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        _, labels, stats, _ = cv2.connectedComponentsWithStats(cleaned)
        if len(stats) < 2:
            return None
        largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:things]
        return Silhouette((0, 0), _STEP_PX, np.isin(labels, largest).astype(np.float32) - np.float32(0.5))


class MovedSince:
    """Detects changes in each camera's images since its first one, and compares them with the body's position."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[UInt8, Bool]] = {}

    def memory(self) -> dict[str, tuple[UInt8, Bool]]:
        """Return the state for `recall`: first images and body positions, the object's own arrays, not copies."""
        return self._first

    def recall(self, memory: dict[str, tuple[UInt8, Bool]]) -> None:
        """Restore a state that `memory` returned: first images and body positions, which are kept, not copied."""
        self._first = memory

    def at_body(self, name: str, image: UInt8, covered: Silhouette) -> float:
        """Return the share of changed pixels, 0 to 1, that lie at the body's first or present position.

        A changed pixel differs from the camera's first image. The first call for a camera keeps a copy of the image and
        the body's position, and returns NaN, as later calls do if too few pixels have changed.

        Args:
            name: name of the camera.
            image: (height, width, 3) uint8 BGR.
            covered: silhouette of the estimated body.
        """
        mask = covered.mask((image.shape[1], image.shape[0]))[::_STEP_PX, ::_STEP_PX]
        image = image[::_STEP_PX, ::_STEP_PX]
        if name not in self._first:
            self._first[name] = image.copy(), mask
            return float("nan")
        before, was = self._first[name]
        changed = cv2.medianBlur(_differ(image, before).astype(np.uint8), _GRAIN) > 0
        if np.count_nonzero(changed) < FEWEST * max(int(np.count_nonzero(mask)), 1):
            return float("nan")
        return float(_grown(mask | was, int(np.count_nonzero(mask.any(axis=1))))[changed].mean())


def _grown(mask: Bool, high: int | None = None) -> Bool:
    """Dilate the mask of a body that is ``high`` rows high; None: as high as the mask."""
    high = int(np.count_nonzero(mask.any(axis=1))) if high is None else high
    side = 2 * round(GROWN * high) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


def _differ(a: UInt8, b: UInt8) -> Bool:
    return np.asarray(cv2.absdiff(a, b).reshape(*a.shape[:-1], -1).max(axis=-1) > DIFFERS)
