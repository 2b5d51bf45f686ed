"""What cameras would say of a simulated hand and a thing, without pictures: true places, projected, and noise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.model.hand import TIPS, HandPose
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival
from mocapella.sources.simulate.hand_motion import landmarks_of
from mocapella.sources.simulate.hand_scene import HandScene, base_places, load_hand_scene
from mocapella.tracker.hands import HandsSettings, HandsTracker, ObjectSettings

Float64 = NDArray[np.float64]
HZ = 60.0
NOISE_PX = 0.1
CUBE = ObjectSettings(
    "cube", ("orange", "purple", "pink"), ((0.04, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.04)), (0.16, 0.16, 0.16)
)
"""Large enough for the fingertips to be in it when it is in the palm."""
IN_PALM = rigid(np.eye(3), [0.0, -0.03, 0.12])
"""``T_palm_cube`` of a cube about the fingers."""


@cache
def scene(name: str = "wide") -> HandScene:
    return load_hand_scene(name, seed=1)


@cache
def places() -> Float64:
    """(1, 3) of the base's marker in the palm's frame."""
    return base_places(scene())


def hands_settings(*things: ObjectSettings, **changed: object) -> HandsSettings:
    return HandsSettings(
        base_places_m=tuple(map(tuple, places().tolist())), middle_sd_px=0.0, objects=things, **changed
    )  # type: ignore[arg-type]


def tracker(*things: ObjectSettings, **changed: object) -> HandsTracker:
    return HandsTracker(scene().rig, hands_settings(*things, **changed), shape=scene().shape)


@cache
def pose_at(at_s: float) -> HandPose:
    return scene().motion.at(at_s)


def landmarks_at(at_s: float) -> Float64:
    return landmarks_of(scene().model, scene().shape, pose_at(at_s))


def palm_at(at_s: float) -> Float64:
    return pose_at(at_s).T_world_palm


def seen_by(
    camera: str, at_s: float, *, hidden: Iterable[str] = (), T_world_cube: Float64 | None = None, node_id: int = 0
) -> Arrival:
    """A frame at a time of the scene; the cube's markers are in it where its place is given."""
    made, k = scene(), round(at_s * HZ)
    points = np.concatenate([landmarks_at(at_s)[list(TIPS)], apply(palm_at(at_s), places())])
    names: Sequence[str] = made.names
    if T_world_cube is not None:
        points = np.concatenate([points, apply(T_world_cube, np.array(CUBE.places_m))])
        names = (*names, *CUBE.markers)
    eye = made.cameras[camera]
    rng = np.random.default_rng([k, len(camera), node_id])
    px = project(apply(eye.T_camera_world, points), eye.lens) + rng.normal(0, NOISE_PX, (len(points), 2))
    px[[name in set(hidden) for name in names]] = np.nan
    at_ns = round(at_s * 1e9) + 1
    frame = marker_frame(
        camera, names, time_ns=at_ns, size_px=eye.size_px, positions_px=px, sd_px=NOISE_PX, sequence=k, node_id=node_id
    )
    return Arrival(frame, at_ns)


def watched(
    start: int, stop: int, *, hidden: Iterable[str] = (), in_palm: Float64 | None = None, cube: Float64 | None = None
) -> Iterator[Arrival]:
    """Frames ``start`` to ``stop`` of both cameras, the right one half a frame later; the cube in the palm or still."""
    for k in range(start, stop):
        for camera, at_s in (("left", k / HZ), ("right", (k + 0.5) / HZ)):
            T = cube if in_palm is None else palm_at(at_s) @ in_palm
            yield seen_by(camera, at_s, hidden=hidden, T_world_cube=T)
