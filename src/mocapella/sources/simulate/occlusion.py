"""Occlusion of joints: rays from a sensor to joints, intersected with limbs, boxes and pillars.

It decides which joints a simulated body sensor infers or loses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check
from mocapella.sources.simulate.body import body_template

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """A box on the floor, such as a table or a screen.

    Attributes:
        centre: centre of its base (world x, z) [m].
        size: edges along its own x, up, and its own z [m].
        yaw_deg: rotation about the vertical axis, from z towards x [deg].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    centre: tuple[float, float]
    size: tuple[float, float, float]
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        check(all(0 < side <= 20 for side in self.size), "size", self.size, "three sides of more than 0 up to 20 m")


@dataclass(frozen=True)
class Cylinder:
    """A pillar on the floor.

    Attributes:
        centre: centre of its base (world x, z) [m].
        radius, height: size of the cylinder [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    centre: tuple[float, float]
    radius: float
    height: float

    def __post_init__(self) -> None:
        check(0 < self.radius <= 10, "radius", self.radius, "more than 0 and up to 10 m")
        check(0 < self.height <= 20, "height", self.height, "more than 0 and up to 20 m")


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Boxes and cylinders as arrays for the kernels.

    Attributes:
        boxes: (n, 7) x, z, half width, height, half depth [m], cosine and sine of the yaw.
        pillars: (n, 4) x, z, radius, height [m].
    """

    boxes: Float64
    pillars: Float64


def obstacles(boxes: tuple[Box, ...], cylinders: tuple[Cylinder, ...]) -> Obstacles:
    """Return boxes and pillars as arrays, for `hidden`; without any, the arrays have no rows."""
    rows = [
        (*box.centre, box.size[0] / 2, box.size[1], box.size[2] / 2, np.cos(yaw), np.sin(yaw))
        for box, yaw in ((box, np.radians(box.yaw_deg)) for box in boxes)
    ]
    pillars = [(*pillar.centre, pillar.radius, pillar.height) for pillar in cylinders]
    return Obstacles(
        np.array(rows, dtype=np.float64).reshape(-1, 7), np.array(pillars, dtype=np.float64).reshape(-1, 4)
    )


def hidden(eye: Float64, joints: Float64, radii: Float64, blocks: Obstacles) -> NDArray[np.bool_]:
    """Return whether each joint is occluded (people, 25).

    Args:
        eye: (3,) position of the sensor's lens, world [m].
        joints: (people, 25, 3), world [m].
        radii: (people, 25) radii of the bones' capsules [m].
        blocks: obstacles in the room.

    A joint is occluded if the straight line from the lens to it comes closer to a bone's axis than the bone's radius,
    or passes through an obstacle. Bones of its own body that contain the joint do not occlude it. Whether the joint is
    in the field of view does not matter.
    """
    from mocapella.sources.simulate import occlusion_kernels  # with numba, which a view of the scenery need not import

    model = body_template()
    return np.asarray(
        occlusion_kernels.hidden(eye, joints, radii, model.parents, model.within, blocks.boxes, blocks.pillars)
    )
