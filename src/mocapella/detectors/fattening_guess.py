"""Find out from the arms whether a camera makes near things wider, as stereo cameras do.

Fits to the image and to one with narrower things are compared: see `mocapella.sensing.fattening`. The texture of the
surfaces is evidence before the first fit, where it rules out the matching of blocks: see
`mocapella.sensing.depth_texture`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.depth_texture import texture
from mocapella.sensing.fattening import without_fattening

Float32 = NDArray[np.float32]

FATTENING_PX: Final = 3
"""How much wider things are in images of cameras that match blocks [px]."""
CLEARLY: Final = 0.85
"""Ratio of costs below which narrower things fit clearly better; 1 where the texture may be a stereo camera's."""
PLAINLY: Final = 0.155
"""Cost below which a fit to the measured things is evidence that they are not wider, however low the other cost."""
_AGAINST: Final = 0.1
_ENOUGH: Final = 0.8
"""Evidence at which the kind is known."""
MOST_EVIDENCE: Final = 1.0
"""Evidence is kept within this, so that it can be taken back."""
_TEXTURE: Final = 0.6
"""Evidence against narrower things where the texture is no stereo camera's."""
SMOOTH_PER_M: Final = 0.00047
"""Roughness of the inverse depth below which surfaces are smoother than a stereo camera's [1/m]: rounding to 1/32 px
alone leaves so much before the smallest usual one, with a focal length of 385 px and a baseline of 0.05 m."""
COARSE_M: Final = 0.0006
"""Roughness above which errors that are independent from pixel to pixel (`Texture.alike` below 0) are no stereo
camera's [m]: neighbouring pixels are of the same block."""
_NO_FIT: Final = 1.0
_LEAST: Final = 1e-3
_LAST: Final = 3
"""Number of last comparisons; their lowest costs are compared."""
_OFTEN: Final = 5
_SELDOM: Final = 100
"""Images between two comparisons, before and after the kind is known."""


class FatteningGuess:
    """By how much a camera makes near things wider.

    Each comparison of an arm's fits adds evidence for or against it, the logarithm of the ratio of their costs: for it
    where the arm fits clearly better to narrower things. A wrong posture costs much in both, so that the lowest costs
    of a few comparisons are compared. The arm may have been a face, so that no result is final.

    Args:
        px: the number of pixels on each side, or below 0 if it is to be found out.

    Attributes:
        px: the number of pixels; 0 at first, if it is to be found out.
    """

    def __init__(self, px: int) -> None:
        self.px, self._given = max(px, 0), px >= 0
        self._evidence, self._clearly = 0.0, CLEARLY
        self._costs: deque[tuple[float, float]] = deque(maxlen=_LAST)
        self._image, self._looked = -1, False

    @property
    def known(self) -> bool:
        """Whether the number was given, or the comparisons are evidence enough."""
        return self._given or abs(self._evidence) >= _ENOUGH

    def corrected(self, depth: Float32) -> Float32:
        """Return a depth image (height, width) [m] without the fattening that is known of; itself if there is none."""
        return without_fattening(depth, self.px)

    def otherwise(self, depth: Float32) -> Float32:
        """Return a depth image (height, width) [m] as it would be if the camera were of the other kind."""
        return without_fattening(depth, 0 if self.px else FATTENING_PX)

    def due(self, image: int, *, urgent: bool = False) -> bool:
        """Return whether the arms in the image of this number are to be compared.

        Args:
            image: the image's number; none is compared twice.
            urgent: no arm can be reported before the kind is known.
        """
        every = _SELDOM if self.known else 1 if urgent else _OFTEN
        return not self._given and image != self._image and image % every == 0

    def look(self, depth: Float32, far_m: float) -> None:
        """Note what the texture of the first image with enough surfaces says.

        Args:
            depth: (height, width) measured image [m].
            far_m: surfaces that are not nearer are left out [m].
        """
        if self._given or self._looked:
            return
        found = texture(depth, far_m=far_m)
        if found is None:
            return
        self._looked = True
        if found.rough_per_m < SMOOTH_PER_M or (found.rough_m > COARSE_M and found.alike < 0):
            self._evidence = max(self._evidence - _TEXTURE, -MOST_EVIDENCE)
        elif found.alike > 0:
            self._clearly = 1.0

    def learn(self, image: int, costs: Sequence[float], otherwise: Sequence[float]) -> bool:
        """Compare fits' costs, 0 to 1, in an image `corrected`, and in the same one `otherwise`.

        Args:
            image: the image's number.
            costs: of the fits to the image `corrected`.
            otherwise: of the fits to the other one.

        Returns:
            Whether the camera is taken for one of the other kind from now on.
        """
        both = [min([*costs, _NO_FIT]), min([*otherwise, _NO_FIT])]
        narrower, measured = both if self.px else both[::-1]
        if self._given or narrower == measured == _NO_FIT:
            return False
        self._image = image
        self._costs.append((narrower, measured))
        narrower, measured = np.min(self._costs, axis=0)
        evidence = math.log(self._clearly * max(measured, _LEAST) / max(narrower, _LEAST))
        if measured < PLAINLY:
            evidence = min(evidence, -_AGAINST)
        self._evidence = float(np.clip(self._evidence + evidence, -MOST_EVIDENCE, MOST_EVIDENCE))
        before, self.px = self.px, FATTENING_PX if self._evidence > 0 else 0
        return self.px != before
