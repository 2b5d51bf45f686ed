"""Find out from the first arms whether a camera makes near things wider, as stereo cameras do.

Fits to the image and to one with narrower things are compared: see `mocapella.sensing.fattening`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.fattening import without_fattening

Float32 = NDArray[np.float32]

FATTENING_PX: Final = 3
"""How much wider things are in images of cameras that match blocks [px]."""
MOST_TRIES: Final = 5
"""Arms that are compared; without a result, the camera is taken for one without fattening."""
ALIKE: Final = 0.85
"""Ratio of costs above which fits to both images say nothing."""
_NO_FIT: Final = 1.0


class FatteningGuess:
    """By how much a camera makes near things wider.

    Args:
        px: the number of pixels on each side, or below 0 if it is to be found out.

    Attributes:
        px: the number of pixels; 0 at first, if it is to be found out.
        known: whether it does not change any more.
    """

    def __init__(self, px: int) -> None:
        self.px, self.known = max(px, 0), px >= 0
        self._tries = 0

    def corrected(self, depth: Float32) -> Float32:
        """Return a depth image (height, width) [m] without the fattening that is known of; itself if there is none."""
        return without_fattening(depth, self.px)

    def learn(self, costs: Sequence[float], narrower: Sequence[float]) -> bool:
        """Compare fits' costs, 0 to 1, in an image and in the same one with narrower things.

        Returns:
            Whether arms fit better to the narrower one, so that `px` is `FATTENING_PX` from now on.
        """
        before, after = min(costs, default=_NO_FIT), min(narrower, default=_NO_FIT)
        if min(before, after) < _NO_FIT:
            self._tries += 1
            self.known = not ALIKE * before <= after <= before / ALIKE or self._tries == MOST_TRIES
        better = after < ALIKE * before
        if better:
            self.px = FATTENING_PX
        return better
