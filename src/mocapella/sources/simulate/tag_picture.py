"""Render square tags into an image of linear light, as ground truth for tag detectors.

A tag is a textured square in space; it is projected through the lens with sub-pixel sampling.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project, undistort
from mocapella.geometry.rigid import apply, inverse
from mocapella.sensing.tags import draw_tag

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_RAYS: Final = 4
"""Number of rays along a pixel's side."""
_TEXTURE_PX: Final = 320
"""Size of the tag's dark square in its texture, without the margin of two cells."""
_DARK, _LIGHT = 0.04, 0.85
"""Reflectance of ink and paper."""


def draw_tags(
    linear: Float32,
    lens: Float64,
    T_camera_tag: Mapping[int, Float64],
    *,
    dictionary: str,
    side_m: float,
    light: float = 1.0,
) -> None:
    """Draw tags, with a white margin of two cells, into an image; nearer tags occlude farther ones.

    Args:
        linear: (height, width, 3) float32 linear light of the image, changed in place; tags are grey.
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        T_camera_tag: pose (4, 4) of each tag, by its number; the tag's frame is as in `mocapella.model.tags`. Tags seen
            from behind, or with a corner behind the camera, are not drawn.
        dictionary: ArUco dictionary of all tags.
        side_m: side of each tag's dark square [m].
        light: strength of the light on the tags; 1 shows a white surface as white.
    """
    far_first = sorted(T_camera_tag.items(), key=lambda tag: -float(np.linalg.norm(tag[1][:3, 3])))
    for number, T in far_first:
        _draw(linear, lens, T, draw_tag(dictionary, number, _TEXTURE_PX), side_m=side_m, light=light)


def _draw(
    linear: Float32, lens: Float64, T: Float64, texture: NDArray[np.uint8], *, side_m: float, light: float
) -> None:
    if (T[:3, 3] @ T[:3, 2]) >= 0:  # seen from behind
        return
    half = 0.5 * side_m * len(texture) / _TEXTURE_PX
    outline = apply(T, half * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]))
    px = project(outline, lens)
    height, width = linear.shape[:2]
    if not np.isfinite(px).all():
        return
    (x0, y0), (x1, y1) = np.floor(px.min(axis=0)).astype(int) - 1, np.ceil(px.max(axis=0)).astype(int) + 2
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, width), min(y1, height)
    if x0 >= x1 or y0 >= y1:
        return
    part = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
    x = (np.arange(x0, x1)[:, None] + part).ravel()
    y = (np.arange(y0, y1)[:, None] + part).ravel()
    rays = undistort(np.stack(np.meshgrid(x, y), axis=-1), lens)
    T_tag_camera = inverse(T)
    d = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1) @ T_tag_camera[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -T_tag_camera[2, 3] / d[..., 2]
        u = (T_tag_camera[0, 3] + s * d[..., 0]) / half
        v = (T_tag_camera[1, 3] + s * d[..., 1]) / half
        hit = (np.abs(u) < 1) & (np.abs(v) < 1) & (s > 0)
    i = np.where(hit, (u + 1) * 0.5 * len(texture), 0).astype(int)
    j = np.where(hit, (1 - v) * 0.5 * len(texture), 0).astype(int)
    value = np.where(texture[j, i] > 127, _LIGHT, _DARK) * light
    shape = (y1 - y0, _RAYS, x1 - x0, _RAYS)
    covered = hit.reshape(shape).mean(axis=(1, 3))
    shown = np.where(hit, value, 0.0).reshape(shape).mean(axis=(1, 3))
    patch = linear[y0:y1, x0:x1]
    patch *= (1.0 - covered)[..., None]
    patch += shown[..., None]
