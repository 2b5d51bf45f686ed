"""The rectangle of a camera image that stands upright in its lane of the gallery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.viewer import layout
from mocapella.viewer.bones import Strokes, line_strokes
from mocapella.viewer.palette import Rgb

Float64 = NDArray[np.float64]

_DEEP_M = 0.35 * layout.LANE_DEPTH_M * layout.SENSORS_SCALE
_LOW_M = 0.1


@dataclass(frozen=True, eq=False)
class LanePicture:
    """Position and size of an upright image in a lane.

    Attributes:
        size_px: (width, height) of the image.
        origin: (3,) middle of the lane's front edge, in the view's space [m].
        part: width of the image as a fraction of the lane's width. A lane is the place of one sensor in the gallery.
    """

    size_px: tuple[int, int]
    origin: Float64
    part: float = 0.85

    @property
    def wide_m(self) -> float:
        """Width of the image in the view's space [m]."""
        return self.part * layout.LANE_WIDTH_M * layout.SENSORS_SCALE

    @property
    def px(self) -> float:
        """Size of a pixel in the view's space [m]."""
        return self.wide_m / self.size_px[0]

    def at(self, pixels: Float64) -> Float64:
        """Return the positions (..., 3) in the view's space [m] of pixels (..., 2), x to the right and y down [px].

        The pixel coordinates (0, 0) are drawn at the image's upper left corner; NaN gives NaN in x and y.
        """
        x = 0.5 * self.wide_m - self.px * pixels[..., 0]
        y = _LOW_M + self.px * (self.size_px[1] - pixels[..., 1])
        return np.asarray(self.origin + np.stack([x, y, np.full(x.shape, _DEEP_M)], axis=-1))

    def edge(self, colour: Rgb) -> Strokes:
        """Return the strokes of the image's border, as lines in the view's space."""
        width, height = self.size_px
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]], dtype=np.float64)
        return line_strokes(self.at(corners), colour.paint, 0.008)
