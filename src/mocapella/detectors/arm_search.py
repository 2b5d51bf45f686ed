"""State of a search for arms that takes longer than one image, and of places that were searched in vain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.steps import Steps

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_MOST_IMAGES: Final = 40
"""Images kept during a search; beyond that, every second one is dropped."""


@dataclass(eq=False)
class RefusedPlace:
    """A place that was searched without finding an arm.

    Attributes:
        centre: (3,) camera [m].
        wait: number of images for which the place is skipped after the next search in vain.
        until: number of the first image that may search it again.
    """

    centre: Float64
    wait: int
    until: int = 0


class Search:
    """A search for further arms, spread over several images because it takes longer than one.

    Attributes:
        depth, at_s: the measured image that is searched.
        images: (depth, time) of the images since; arms that are found are tracked through them.
        newest: the newest of them.
        steps: the remaining work.
    """

    steps: Steps[None]

    def __init__(self, depth: Float32, at_s: float) -> None:
        # The caller may reuse its images' memory.
        self.depth, self.at_s = depth.copy(), at_s
        self.newest = self.depth
        self.images: list[tuple[Float32, float]] = []

    def add(self, depth: Float32, at_s: float) -> None:
        """Keep another image for catching up."""
        self.newest = depth.copy()
        self.images.append((self.newest, at_s))
        if len(self.images) > _MOST_IMAGES:
            del self.images[-2::-2]

    def go_on(self, work: float) -> bool:
        """Do so much work [µs]; return whether any is left."""
        done = 0
        while done < work:
            try:
                done += next(self.steps)
            except StopIteration:
                return False
        return True
