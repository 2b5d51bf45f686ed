"""Find faults of films by their images: black, frozen, or the same film twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.live.keypoint_work import dead
from mocapella.sources.frame_set import FrameSet

UInt8 = NDArray[np.uint8]

_EVERY_PX: Final = 4
SHARE: Final = 0.5
"""Share of a film's images above which a fault is reported."""
FEWEST: Final = 5
"""Least number of images of a film that can be frozen."""
ALIKE: Final = 12
"""Largest difference of a pixel of alike images; a film's compression changes equal images a little [0 to 255]."""


class FilmFaults:
    """Counts dead, unchanged and equal images of synchronised films.

    Args:
        cameras: names of the cameras.
    """

    def __init__(self, cameras: Iterable[str]) -> None:
        names = list(cameras)
        self._instants = 0
        self._dead: dict[str, dict[str, int]] = {name: {} for name in names}
        self._same = dict.fromkeys(names, 0)
        self._last: dict[str, NDArray[np.int16]] = {}
        self._pairs: dict[tuple[str, str], int] = {}

    def watch(self, films: Iterable[FrameSet]) -> Iterator[FrameSet]:
        """Yield the instants of films unchanged, and count their images."""
        for shown in films:
            self.update(shown.images)
            yield shown

    def update(self, images: Mapping[str, UInt8]) -> None:
        """Count the images (height, width, 3) uint8 BGR of an instant, by camera."""
        self._instants += 1
        shown: dict[str, NDArray[np.int16]] = {}
        for name, image in images.items():
            if why := dead(image):
                self._dead[name][why] = self._dead[name].get(why, 0) + 1
                continue
            shown[name] = image[::_EVERY_PX, ::_EVERY_PX].astype(np.int16)
            self._same[name] += name in self._last and _alike(shown[name], self._last[name])
        self._last = shown
        for pair in combinations(shown, 2):
            if _alike(shown[pair[0]], shown[pair[1]]):
                self._pairs[pair] = self._pairs.get(pair, 0) + 1

    def sentences(self) -> list[str]:
        """Return a sentence about each fault of more than `SHARE` of a film's images, with the remedy."""
        most = SHARE * self._instants
        found = []
        for name, kinds in self._dead.items():
            for why, count in kinds.items():
                if count > most:
                    found.append(
                        f"{name}: {count} of its {self._instants} images are {why}: uncover the lens, film again"
                    )
        for name, count in self._same.items():
            if self._instants >= FEWEST and count > most:
                found.append(
                    f"{name}: {count} of its {self._instants} images do not differ from the one before (frozen): film "
                    "again, or leave this film out"
                )
        for (one, other), count in self._pairs.items():
            if count > most:
                found.append(f"{one} and {other} are the same film: name the film of each camera")
        return found


def _alike(one: NDArray[np.int16], other: NDArray[np.int16]) -> bool:
    """Whether two images show the same, apart from a film's compression."""
    return one.shape == other.shape and int(np.abs(one - other).max(initial=0)) <= ALIKE
