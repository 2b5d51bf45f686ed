"""A camera image as an upright rectangle in the view's space, and the mapping between pixels and positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.viewer.palette import Rgb

Float64 = NDArray[np.float64]

_CORNERS: Final = 40
"""Number of line segments of a circle."""
_SQUARE: Final = float(np.pi / 2)
"""Field of view of a frustum whose far end is twice as high as the frustum is deep [rad]."""
_FLAT_M: Final = 1e-4
"""Depth of the frustum that shows an image [m]."""
_UPRIGHT: Final = (0.0, 0.0, 0.0, 1.0)
"""Rotation from an image's axes (x right, y down) to the view's (x left, y up), as a quaternion (w, x, y, z)."""


class Encoded(Protocol):
    """Interface of an encoded image, such as a `mocapella.viewer.camera_feed.CameraAnswer`."""

    @property
    def image(self) -> bytes:
        """The encoded image."""

    @property
    def format(self) -> str:
        """Format of ``image``: jpeg or png."""


class SizedPicture(Encoded, Protocol):
    """Interface of an encoded camera image with the size of the original."""

    @property
    def size_px(self) -> tuple[int, int] | None:
        """(width, height) of the camera's image, before it was scaled; None if unknown."""


@dataclass(frozen=True)
class CameraPicture:
    """A `SizedPicture` that holds its image in memory.

    Attributes:
        image: the encoded image.
        size_px: (width, height) of the camera's image, before it was scaled; None if unknown.
        format: jpeg or png.
    """

    image: bytes
    size_px: tuple[int, int] | None
    format: str = "jpeg"


@dataclass(frozen=True, eq=False)
class Plane:
    """Rectangle of an image in the view's space, parallel to the x and y axes and facing −z.

    Attributes:
        middle: (3,) centre of the image [m].
        wide_m: width of the image in the view's space [m].
        size_px: (width, height) of the camera's image.
    """

    middle: Float64
    wide_m: float
    size_px: tuple[int, int]

    @property
    def px_m(self) -> float:
        """Size of a pixel in the view's space [m]."""
        return self.wide_m / self.size_px[0]

    @property
    def high_m(self) -> float:
        """Height of the image in the view's space [m]."""
        return self.px_m * self.size_px[1]

    @property
    def at_origin(self) -> Plane:
        """The same plane with its centre at the origin, for drawing relative to a scene node."""
        return Plane(np.zeros(3), self.wide_m, self.size_px)

    def moved(self, by_m: Float64) -> Plane:
        """Return the plane translated by a vector (3,) [m]."""
        return Plane(self.middle + by_m, self.wide_m, self.size_px)

    @property
    def corners(self) -> Float64:
        """Corners (4, 3) of the image [m], clockwise from the upper left one."""
        width, height = self.size_px
        return self.place(np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64) - 0.5)

    def place(self, points_px: Float64, lift_m: float = 0.0) -> Float64:
        """Return the positions (..., 3) of pixels in the view's space [m].

        Args:
            points_px: (..., 2) x to the right, y down; the middle of the first pixel is (0, 0). NaN gives NaN.
            lift_m: distance of the positions in front of the image [m].
        """
        width, height = self.size_px
        x, y = (width - 1) / 2 - points_px[..., 0], (height - 1) / 2 - points_px[..., 1]
        placed: Float64 = self.middle + np.stack([self.px_m * x, self.px_m * y, np.full(x.shape, -lift_m)], axis=-1)
        return placed

    def pixel(self, origin: Float64, direction: Float64) -> tuple[float, float] | None:
        """Return x, y where a ray meets the image, from either side, for clicks; None if the ray misses the image.

        They are fractional pixels of the camera's image (`size_px`); the middle of the upper left pixel is (0, 0).

        Args:
            origin: (3,) start of the ray in the view's space, the coordinates of the browser's 3D scene [m].
            direction: (3,) direction of the ray, of any length above 0.
        """
        along = float(direction[2])
        if abs(along) < 1e-9 or (reach := float(self.middle[2] - origin[2]) / along) <= 0:
            return None
        off = origin + reach * direction - self.middle
        width, height = self.size_px
        x, y = (width - 1) / 2 - float(off[0]) / self.px_m, (height - 1) / 2 - float(off[1]) / self.px_m
        inside = -0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5
        return (x, y) if inside else None


def rings(
    plane: Plane, points_px: Mapping[str, tuple[float, float]], colours: Mapping[str, Rgb], radius_px: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return circles around points of an image as line segments just in front of it.

    Args:
        plane: rectangle of the image.
        points_px: x, y of each circle's centre in the image [px], by name; none gives n = 0.
        colours: colour of each circle, by name, at least for the names of ``points_px``.
        radius_px: radius of the circles [px].

    Returns:
        End points (n, 2, 3) in the view's space [m], and their colours (n, 2, 3), red, green and blue, 0 to 255.
    """
    turns = np.linspace(0.0, 2 * np.pi, _CORNERS + 1)
    circle = radius_px * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    lines, painted = [np.zeros((0, 2, 3))], [np.zeros((0, 2, 3))]
    for name, at in points_px.items():
        ends = plane.place(np.asarray(at) + circle, 0.002 * plane.wide_m)
        lines.append(np.stack([ends[:-1], ends[1:]], axis=1))
        painted.append(np.broadcast_to(np.array(colours[name].paint, np.float64), (_CORNERS, 2, 3)))
    return np.concatenate(lines).astype(np.float32), np.concatenate(painted).astype(np.uint8)


class PictureNode:
    """Scene node of an image that can be replaced without creating a new node; hidden until `draw`.

    An image node of viser is white until the browser has decoded the image, which can take long. The image of a frustum
    is invisible until then, so this node is a nearly flat frustum without lines.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node.
    """

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        self._scene, self._name = scene, name
        self._handle: viser.CameraFrustumHandle | None = None
        self._where: tuple[object, ...] | None = None
        self._answer: Encoded | None = None

    def draw(self, plane: Plane, answer: Encoded) -> None:
        """Show an encoded image on a plane; nothing is sent if the same object is already shown there."""
        where = (*plane.middle.tolist(), plane.wide_m, plane.size_px)
        if self._answer is answer and self._where == where:
            return
        if self._handle is None:
            self._handle = self._scene.add_camera_frustum(
                self._name, fov=_SQUARE, aspect=1.0, thickness=0.0, thickness_units="screen", cast_shadow=False,
                receive_shadow=False, wxyz=_UPRIGHT, visible=False,
            )  # fmt: skip
        handle = self._handle
        # The library takes pixels and encodes them for every browser; encoded images are passed on unchanged.
        handle._format, handle._image_data = ("png" if answer.format == "png" else "jpeg"), answer.image
        if self._where != where:
            handle.aspect, handle.scale = plane.wide_m / plane.high_m, _frustum_scale(plane)
            handle.position = plane.middle
        handle.visible = True
        self._where, self._answer = where, answer

    def hide(self) -> None:
        """Hide the node."""
        if self._answer is not None and self._handle is not None:
            self._handle.visible, self._answer = False, None


def _frustum_scale(plane: Plane) -> tuple[float, float, float]:
    """Return the scale for a 90° frustum with a far end like the plane; viser divides by its volume's cube root."""
    of_one = float(np.cbrt(plane.wide_m / plane.high_m / 3))
    return 0.5 * plane.high_m * of_one, 0.5 * plane.high_m * of_one, _FLAT_M * of_one
