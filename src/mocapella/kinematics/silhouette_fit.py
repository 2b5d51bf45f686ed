"""Render a body's outline in a camera, and constrain the body by an image's outline.

    seen  = see(figure, vertices, eye)                               the projected mesh: its mask and outline
    given = touching(seen, motions, phi, surety, eye, reach_px=12)   constraints of `mocapella.kinematics.twist_fit`

Points are matched in both directions: the mesh's outline with the nearest point of the image's, and the image's with
the nearest of the mesh's; only the second notices a limb in the image far from the mesh's (B. Rosenhahn, T. Brox, D.
Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007, section 2.3). Weights fall with the
residual (S. Geman, D. McClure, "Statistical methods for tomographic image reconstruction", Bull. ISI 52, 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry import lens as lenses
from mocapella.kinematics.twist_fit import InPlanes
from mocapella.model.camera import PlacedCamera
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.silhouettes import Silhouette
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]


@dataclass(frozen=True)
class CorrespondenceSettings:
    """Settings for matching outlines; lengths are in samples, `Outline.step_px` pixels each.

    Attributes:
        spacing_steps: distance between points on the mesh's outline; larger: less work, less accurate [samples].
        every: stride between samples of the image's outline; larger: less work, less accurate [samples].
        soft_steps: scale of the robust loss: at this residual the weight is a quarter; larger: faster motion is
            followed, and false outlines count more [samples].
        sd_steps: standard deviation of the image outline's position, for one pixel of its length; larger than a single
            edge's, as neighbours' errors are correlated; larger: prediction and resting pose count more [samples].
        sure_nats: least evidence of an edge with full weight; larger: weak edges count less [nats].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    spacing_steps: float = 2.0
    every: int = 3
    soft_steps: float = 5.0
    sd_steps: float = 5.0
    sure_nats: float = 1.0

    def __post_init__(self) -> None:
        check(self.spacing_steps > 0, "spacing_steps", self.spacing_steps, "above 0")
        check(self.every >= 1, "every", self.every, "1 or more")
        check(self.soft_steps > 0, "soft_steps", self.soft_steps, "above 0")
        check(self.sd_steps > 0, "sd_steps", self.sd_steps, "above 0")
        check(self.sure_nats > 0, "sure_nats", self.sure_nats, "above 0 nats")


DEFAULT = CorrespondenceSettings()


class Figure(msgspec.Struct, frozen=True, eq=False):
    """A triangle mesh with the edges and parts that rendering its outline needs, computed once.

    Attributes:
        mesh: the mesh.
        edges: (e, 4) its edges: both vertices and both adjacent faces.
        part: (n,) index of the part with the largest skinning weight at each vertex.
        one_way: whether the faces are oriented consistently, so that the mask can be drawn from the outline alone.
    """

    mesh: RiggedMesh
    edges: Int32
    part: Int32
    one_way: bool


def figure(mesh: RiggedMesh) -> Figure:
    """Prepare a mesh for `see`, once for all images: find its edges and the part of each vertex."""
    k = _seeing()
    part = np.ascontiguousarray(mesh.bones[:, 0])
    return Figure(mesh, k.outline_edges(mesh.faces), part, k.one_way(mesh.faces))


class Eye(msgspec.Struct, frozen=True, eq=False):
    """A calibrated camera: intrinsics and extrinsics as arrays for the rendering kernels.

    Attributes:
        size_px: (width, height) of the image.
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        farthest_r2: largest squared normalised radius of the lens model's range, of `geometry.lens.farthest_r2`.
        T_camera_world: (4, 4) extrinsics.
    """

    size_px: tuple[int, int]
    lens: Float64
    farthest_r2: float
    T_camera_world: Float64


def eye(placed: PlacedCamera) -> Eye:
    """Prepare a calibrated camera for `see`, once for all images."""
    lens = np.ascontiguousarray(placed.camera.lens, np.float64)
    T = np.ascontiguousarray(placed.T_camera_world, np.float64)
    return Eye(placed.camera.size_px, lens, lenses.farthest_r2(lens), T)


class Outline(msgspec.Struct, frozen=True, eq=False):
    """A mesh rendered in a camera: mask, and points on its occluding contour with their 3D positions.

    Attributes:
        origin_px, step_px: first sample and sample spacing of the window, as in `Silhouette`.
        mask: (rows, columns) uint8, 1 where the body covers a sample.
        at: (n, 2) points of the outline [px].
        normals: (n, 2) outward normals; the length of each is that of the outline that its point represents [px].
        points: (n, 3) positions of these points on the mesh, world [m].
        part: (n,) index of the mesh's part at each point.
        depth: (n,) depths of the points in the camera frame [m].
    """

    origin_px: tuple[int, int]
    step_px: int
    mask: NDArray[np.uint8]
    at: Float64
    normals: Float64
    points: Float64
    part: Int32
    depth: Float64

    @property
    def silhouette(self) -> Silhouette:
        """The mask as a `Silhouette`, whose phi is only +0.5 px inside and −0.5 px outside, no distance."""
        return Silhouette(self.origin_px, self.step_px, self.mask.astype(np.float32) - np.float32(0.5))


def see(
    body: Figure,
    vertices: Float64,
    by: Eye,
    *,
    step_px: int = 2,
    margin_px: int = 24,
    spacing_px: float = 4.0,
    window: Outline | None = None,
) -> Outline | None:
    """Render a body's mask and outline; return None if the body is outside the image and no window is given.

    Args:
        body: the body.
        vertices: (n, 3) posed vertices from `rigged_mesh.posed`, world [m].
        by: the camera.
        step_px: distance between the window's samples [px].
        margin_px: margin of the window about the body [px].
        spacing_px: distance between the outline's points [px].
        window: an outline with the same ``step_px`` whose window is reused; None to fit the window to the body.
    """
    given = (0, 0, 0, 0) if window is None else (*window.origin_px, *window.mask.shape[::-1])
    x0, y0, mask, *points = _seeing().outlined(
        vertices, by.T_camera_world, by.lens, by.farthest_r2, by.size_px, body.mesh.faces, body.edges, body.one_way,
        body.part, step_px, margin_px, spacing_px, given,
    )  # fmt: skip
    return Outline((x0, y0), step_px, mask, *points) if mask.size else None


def seen_at(points: Float64, by: Eye) -> Float64:
    """Project world points (n, 3) [m] into the image, (n, 2) x, y [px], with distortion.

    The centre of the first pixel is (0, 0); coordinates are not clipped to the image. Points that are NaN, less than
    5 cm in front of the camera, or outside the range of the distortion model get -1e6 in both coordinates.
    """
    pixels, depth = np.empty((len(points), 2)), np.empty(len(points))
    _seeing().see(np.ascontiguousarray(points), by.T_camera_world, by.lens, by.farthest_r2, pixels, depth)
    pixels[depth <= 0.0] = -1e6
    return pixels


def within(points: Float64, by: Eye) -> bool:
    """Return whether all world points (n, 3) [m] are in front of the camera and within its image; True for n = 0."""
    at = np.ascontiguousarray(points)
    return bool(_seeing().within(at, by.T_camera_world, by.lens, by.farthest_r2, *by.size_px))


def alike(seen: Outline, phi: NDArray[np.float32]) -> float:
    """Return the intersection over union of a body's mask and an image's silhouette (rows, columns) in its window.

    ``phi`` [px] is a signed distance, positive inside the silhouette. The result is 0 where both are empty.
    """
    return float(_seeing().alike(seen.mask, phi))


def touching(
    seen: Outline,
    motions: tuple[Float64, Float64],
    phi: NDArray[np.float32],
    surety: NDArray[np.float32],
    by: Eye,
    *,
    reach_px: float,
    settings: CorrespondenceSettings = DEFAULT,
) -> InPlanes:
    """Match a rendered outline with an image's contour; return point-to-plane constraints on the body's pose.

    Args:
        seen: the body's outline.
        motions: the parts' motions from rest in the rendered pose: R (parts, 9), row by row, and t (parts, 3) [m].
        phi: (rows, columns) signed distance to the image's contour, positive inside, in the window of ``seen`` [px].
        surety: (rows, columns) evidence of the contour: log-likelihood ratio of the side of ``phi`` on which a sample
            lies against the other side [nats].
        by: the camera.
        reach_px: largest distance between matched points; at most the value at which ``phi`` is truncated [px].
        settings: the settings.
    """
    R, t = motions
    s, (x0, y0), step = settings, seen.origin_px, seen.step_px
    found = _fitting().touching(
        phi, surety, x0, y0, step, s.every, reach_px, seen.at, seen.normals, seen.points, seen.part, seen.depth,
        s.soft_steps * step, s.sd_steps * step, s.sure_nats, R, t, by.lens, by.farthest_r2, by.T_camera_world,
    )  # fmt: skip
    return InPlanes(*found)


@cache
def _seeing() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import outline_kernels

    return outline_kernels


@cache
def _fitting() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import outline_fit_kernels

    return outline_fit_kernels
