"""The obstacles of a named scene as triangles, for the view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.model.scenery import Scenery, Solid
from mocapella.sources.simulate.occlusion import Box, Cylinder
from mocapella.sources.simulate.scenes import scene_settings

Float64 = NDArray[np.float64]

SIDES = 32
"""Number of sides of the prism that approximates a cylinder."""


def scenery_of(scene: str) -> Scenery:
    """Return the obstacles, as triangle meshes in the world, and the sensors' poses of a scene.

    ``scene`` is as in `mocapella.sources.simulate.scenes.scene_settings`.

    Raises:
        SettingsError: no such scene; lists the known ones.
    """
    settings = scene_settings(scene)
    solids = (*map(_cylinder, settings.cylinders), *map(_box, settings.boxes))
    return Scenery(solids, {sensor.name: sensor.T_world_sensor for sensor in settings.sensors})


def _cylinder(cylinder: Cylinder) -> Solid:
    angle = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)
    outline = cylinder.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1) + np.array(cylinder.centre)
    return _prism(outline, cylinder.height)


def _box(box: Box) -> Solid:
    yaw, (width, height, depth) = np.radians(box.yaw_deg), box.size
    corners = 0.5 * np.array([[width, depth], [-width, depth], [-width, -depth], [width, -depth]])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return _prism(corners @ turn.T + np.array(box.centre), height)


def _prism(outline: Float64, height: float) -> Solid:
    """An upright prism on the floor over an outline (n, 2) of x and z; edges between side and top stay sharp."""
    count = len(outline)
    bottom = np.column_stack([outline[:, 0], np.zeros(count), outline[:, 1]])
    top = bottom + np.array([0.0, height, 0.0])
    k = np.arange(count)
    after = (k + 1) % count
    sides = [np.stack([k, k + count, after + count], axis=-1), np.stack([k, after + count, after], axis=-1)]
    lid = np.stack([np.full(count - 2, 2 * count), 2 * count + after[1:-1], 2 * count + k[1:-1]], axis=-1)
    faces = np.concatenate([*sides, lid]).astype(np.uint32)
    return Solid(np.concatenate([bottom, top, top]).astype(np.float32), faces)
