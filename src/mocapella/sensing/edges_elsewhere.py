"""Compare the edges of an image at an outline with those at the same outline elsewhere.

    edges_in_excess(samples, step_px, at, normals, elsewhere)      for each point, −1 to 1

An outline that lies along an edge by chance has as many edges when it is moved a little; that of a thing which is there
has more where it is. A moved outline is the same one, displaced: how the thing would turn or hide there is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.image_samples import samples_at
from mocapella.sensing.room_edges import BESIDE_STEPS, CLEAR_LEVELS

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

BESIDE_EDGE_STEPS: Final = (-1.0, 0.0, 1.0)
"""Displacements of the edge from the outline at which it counts [samples]."""
EDGE_LEVELS: Final = 20.0
"""Least difference of both sides of an edge, in any channel [grey levels]."""


def edges_in_excess(
    samples: UInt8, step_px: int, at: Float64, normals: Float64, elsewhere: Float64,
    *, is_room: Callable[[Float64], Bool] | None = None,
) -> Float64:  # fmt: skip
    """Return by how much more an image has an edge at each point (n,) of an outline than elsewhere, −1 to 1.

    It is 1 or 0 for the edge at the point, less the share of the point's places elsewhere at which there is one.

    Args:
        samples: (rows, columns, channels) the image, at a distance of ``step_px`` [px].
        step_px: distance between samples, 1 or more [px].
        at: (n, 2) points of the outline, x, y [px].
        normals: (n, 2) outward normals there, of any length.
        elsewhere: (k, n, 2) displacements of the points at k other places of the outline, k at least 1 [px].
        is_room: whether pixels (m, 2) show the learnt background, (m,) bool; an edge inside which it is so does not
            count, if it is so clear (`CLEAR_LEVELS`) that it would differ from the background. None: nowhere.
    """
    long = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = normals / np.maximum(long, 1e-9)
    places = np.concatenate([at[None], at[None] + elsewhere])
    pixels, across = places.reshape(-1, 2), np.broadcast_to(unit, places.shape).reshape(-1, 2)
    contrast = np.zeros(len(pixels))
    for shift in BESIDE_EDGE_STEPS:
        inside, outside = (
            samples_at(samples, step_px, pixels + (shift + side * BESIDE_STEPS) * step_px * across)
            for side in (-1.0, 1.0)
        )
        contrast = np.maximum(contrast, np.abs(inside - outside).max(axis=1))
    edge = contrast >= EDGE_LEVELS
    if is_room is not None:
        edge &= ~(is_room(pixels - BESIDE_STEPS * step_px * across) & (contrast >= CLEAR_LEVELS))
    shown = edge.reshape(places.shape[:2]).astype(np.float64)
    return np.asarray(shown[0] - shown[1:].mean(axis=0))
