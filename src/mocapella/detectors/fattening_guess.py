"""Find out from the arms whether a camera makes near things wider, as stereo cameras do.

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
MOST_VOTES: Final = 5
"""Comparisons with the same result after which the camera's kind is known; it can still be taken back."""
CLEARLY: Final = 0.85
"""Ratio of costs below which narrower things fit clearly better."""
_NO_FIT: Final = 1.0
_OFTEN: Final = 5
_SELDOM: Final = 100
"""Images between two comparisons, before and after the kind is known."""


class FatteningGuess:
    """By how much a camera makes near things wider.

    Each comparison of an arm's fits is a vote for or against it: for it where the arm fits clearly better to narrower
    things. A face may have voted, so that no result is final.

    Args:
        px: the number of pixels on each side, or below 0 if it is to be found out.

    Attributes:
        px: the number of pixels; 0 at first, if it is to be found out.
    """

    def __init__(self, px: int) -> None:
        self.px, self._given = max(px, 0), px >= 0
        self._votes = MOST_VOTES if px > 0 else 0

    @property
    def known(self) -> bool:
        """Whether the number was given, or enough comparisons had the same result."""
        return self._given or abs(self._votes) == MOST_VOTES

    def corrected(self, depth: Float32) -> Float32:
        """Return a depth image (height, width) [m] without the fattening that is known of; itself if there is none."""
        return without_fattening(depth, self.px)

    def otherwise(self, depth: Float32) -> Float32:
        """Return a depth image (height, width) [m] as it would be if the camera were of the other kind."""
        return without_fattening(depth, 0 if self.px else FATTENING_PX)

    def due(self, image: int) -> bool:
        """Return whether the arms in the image of this number are to be compared."""
        return not self._given and image % (_SELDOM if self.known else _OFTEN) == 0

    def learn(self, costs: Sequence[float], otherwise: Sequence[float]) -> bool:
        """Compare fits' costs, 0 to 1, in an image `corrected`, and in the same one `otherwise`.

        Returns:
            Whether the camera is taken for one of the other kind from now on.
        """
        both = [min([*costs, _NO_FIT]), min([*otherwise, _NO_FIT])]
        narrower, measured = both if self.px else both[::-1]
        if self._given or narrower == measured == _NO_FIT:
            return False
        vote = 1 if narrower < CLEARLY * measured else -1
        self._votes = int(np.clip(self._votes + vote, -MOST_VOTES, MOST_VOTES))
        before, self.px = self.px, FATTENING_PX if self._votes > 0 else 0
        return self.px != before
