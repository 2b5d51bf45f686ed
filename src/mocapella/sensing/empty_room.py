"""What says, without any model of a body, whether somebody is where a body was found: the empty room, and what moves.

A region model always finds an outline where it expects one. So a camera in whose image the body is not keeps what it
shows, and what is later taken for the body there is compared; and what has changed since the first image has to be
where the body was or is.
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
"""Grey levels in a channel by which a pixel differs from an empty room, whatever the light does."""
FEWEST: Final = 0.2
"""Of what a body covers: where less has changed, nobody has moved."""
GROWN: Final = 0.1
"""Of a body's height: so much beside it may change with it, as its shadow does."""
_STEP_PX: Final = 2
_GRAIN: Final = 7
"""Samples: what changes in less than half of a square of so many is noise."""


class EmptyRoom:
    """Each camera's last image with nobody in it, put together of images with somebody elsewhere in them."""

    def __init__(self) -> None:
        self._images: dict[str, UInt8] = {}
        self._known: dict[str, Bool] = {}

    def memory(self) -> list[Any]:
        """All that `recall` wants."""
        return [self._images, self._known]

    def recall(self, memory: Sequence[Any]) -> None:
        """Be as when `memory` was made."""
        self._images, self._known = memory

    def learn(self, images: Mapping[str, UInt8], people: Mapping[str, Silhouette] | None = None) -> None:
        """Nobody is in these images (height, width, 3), by camera, but for ``people``, about whom nothing is learnt."""
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
        """Whether an image of that camera has been seen with nobody in it."""
        return name in self._images

    def differs(self, name: str, image: UInt8, taken: Silhouette, others: Bool | None = None) -> float:
        """Share of what was taken for a body that is not as in the empty room; NaN where most of that was never seen.

        Args:
            name: of the camera.
            image: (height, width, 3).
            taken: for the body.
            others: (height, width) where other people are: what differs there is not of this body.
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
        """The largest things in an image (height, width, 3) that are not in the empty room; None where none was seen.

        Args:
            name: of the camera.
            image: (height, width, 3).
            things: how many at most.
            others: (height, width) where people are who are not meant.
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
    """What has changed in each camera since its first image."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[UInt8, Bool]] = {}

    def memory(self) -> dict[str, tuple[UInt8, Bool]]:
        """All that `recall` wants."""
        return self._first

    def recall(self, memory: dict[str, tuple[UInt8, Bool]]) -> None:
        """Be as when `memory` was made."""
        self._first = memory

    def at_body(self, name: str, image: UInt8, covered: Silhouette) -> float:
        """Share of what has changed that is where the body was or is; NaN where next to nothing has.

        Args:
            name: of the camera.
            image: (height, width, 3).
            covered: by the body as it was found.
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
    """What is in a mask or near it, for a body that is so many rows high; without ``high``, as many as it has."""
    high = int(np.count_nonzero(mask.any(axis=1))) if high is None else high
    side = 2 * round(GROWN * high) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


def _differ(a: UInt8, b: UInt8) -> Bool:
    return np.asarray(cv2.absdiff(a, b).reshape(*a.shape[:-1], -1).max(axis=-1) > DIFFERS)
