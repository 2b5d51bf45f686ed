"""Boxes in a camera's image where the tracked people are expected, for detectors that search there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import PlacedCamera
from mocapella.model.observations import JointState
from mocapella.model.scene import Person

Float32 = NDArray[np.float32]

FEWEST: Final = 6
"""Least number of known joints in the image of an expected person."""
MARGIN: Final = 0.15
"""Margin of the box of an expected person, as a share of its longer side."""


def expected_regions(people: Sequence[Person], placed: PlacedCamera) -> Float32:
    """Return the boxes (people, 4) left, top, right, bottom of people in a camera's image [px].

    A person with too few known joints in the image (`FEWEST`) is left out.

    Args:
        people: the people of the last scene, world [m].
        placed: the camera.
    """
    boxes: list[list[float]] = []
    size = np.array(placed.camera.size_px, np.float64)
    for person in people:
        known = np.asarray(person.states) != JointState.NOT_TRACKED
        pixels = project(apply(placed.T_camera_world, person.positions[known]), placed.camera.lens)
        inside = pixels[((pixels >= 0) & (pixels <= size - 1)).all(axis=-1)]  # NaN behind the camera compares false
        if len(inside) < FEWEST:
            continue
        low, high = inside.min(axis=0), inside.max(axis=0)
        wider = MARGIN * float((high - low).max())
        boxes.append([*np.maximum(low - wider, 0), *np.minimum(high + wider, size - 1)])
    return np.array(boxes, np.float32).reshape(-1, 4)
