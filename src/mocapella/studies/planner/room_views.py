"""What sensors at all possible places of a room would see of people on its floor.

A *cell* is a piece of the floor that must be covered, a *lens* a place and height for a sensor, and a *pose* a lens
with a yaw and a tilt. Sight past obstacles depends on the lens alone, the field of view on the pose.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.sources.simulate import SensorSettings
from mocapella.sources.simulate.device import axial_noise
from mocapella.sources.simulate.measured import view_axes
from mocapella.sources.simulate.occlusion import obstacles
from mocapella.studies.planner.person_views import (
    ON_AXIS,
    RISES_DEG,
    SCORED,
    TURNS,
    PersonTables,
    body_points,
)
from mocapella.studies.planner.planned_room import PlannedRoom, SensorSites, solid_at
from mocapella.studies.planner.polygons import inside
from mocapella.studies.planner.sight import blocked
from mocapella.studies.planner.symmetric import six_of

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

MOST_TRIED: Final = 10_000_000
"""Most joints that all poses together look at; a larger room gets larger cells."""
COARSER: Final = 1.2
"""Growth factor of cells and of the spacings of sites, repeated until the work is within its bounds."""
ASIDE_DEG: Final = (0.0, -20.0, 20.0, -40.0, 40.0)
"""Yaws of a pose, relative to the direction of the area's middle [deg]."""
AROUND_DEG: Final = tuple(np.arange(0.0, 360.0, 30.0).tolist())
"""Yaws of a lens that is within the area [deg]."""
MEASURED_AT_M: Final = 2.6
"""Distance at which the errors of the sensors were measured; beyond, the depth camera's noise grows [m]."""
AXIAL_GAIN: Final = 1.5
"""Ratio of a joint's noise along the line of sight to the depth camera's, as in the simulated room."""
LATERAL_PX: Final = 0.35
"""Noise of a joint across the image, as in the simulated room [px]."""
TRACKED: Final = 0.62
"""Error of the tracked skeleton relative to the best mean of single frames: the method ``default`` also averages over
time, and subtracts the known bias. Median over eight placements in the simulation, seed 100 (docs/planner.md)."""
_MIDDLE: Final = 0.674
"""Height of the body's middle, in fractions of stature."""


class PlannedPose(msgspec.Struct, frozen=True, order=True):
    """A sensor's pose in the room.

    Attributes:
        x, height, z: position of the lens [m].
        yaw_deg: rotation about the vertical; 0 looks along z, growing towards x [deg].
        tilt_deg: tilt, upwards positive [deg].
    """

    x: float
    height: float
    z: float
    yaw_deg: float
    tilt_deg: float

    @property
    def lens(self) -> tuple[float, float, float]:
        """Position of the lens: x, height, z [m]."""
        return self.x, self.height, self.z


@dataclasses.dataclass(frozen=True, eq=False)
class LensView:
    """What a lens sees of all people, whatever its pose.

    Attributes:
        information: (6, cells, facings, postures, joints) inverse of the covariance of each joint, in the room's axes,
            elements as in `symmetric.six_of` [1/m²]; 0 behind obstacles.
        points: (3, cells, 18, 3) test points of the smallest, the tallest and the middle person [m].
        clear: (3, cells, 18) whether no obstacle is before the point.
        point: (cells, facings, postures, joints) index of the test point next to each joint.
    """

    information: Float32
    points: Float64
    clear: Bools
    point: NDArray[np.int64]


class RoomViews:
    """Cells, lenses and poses of a room, and the joints and cells that they see.

    Args:
        room: the room.
        on_step: called with the next step, in words.

    Attributes:
        room: as given; with larger cells and spacings if the work would exceed `MOST_TRIED`.
        notes: what the user should know: larger cells, floor that no site covers.
        cells: (cells, 2) centres of the cells, x and z [m].
        poses: all poses that cover a cell.
        shape: (cells, facings, postures, joints) of all that is looked at.
        joints: of each pose, the flat indices (n,) of the joints that it has in view without an obstacle before them.
        information: of each pose, the inverse covariances (6, n) of these joints, as in `LensView` [1/m²].
        covers: (poses, cells) whether a pose sees a person, of any planned height, from head to ankle.

    Raises:
        SettingsError: no cell, no place for a sensor, or no pose that covers any cell; says what to change.
    """

    def __init__(self, room: PlannedRoom, on_step: Callable[[str], None] = lambda text: None) -> None:
        self.notes: list[str] = []
        self.room = self._within_bounds(room)
        self.cells = cells_of(self.room)
        low, high = self.room.people.heights_m
        self._statures = (low, high, (low + high) / 2)
        on_step("people: hidden joints and errors by direction")
        self.person = PersonTables(self.room.people.postures, self._statures[2])
        self._things = obstacles(self.room.boxes, self.room.cylinders)
        wanted = poses_of(self.room, self.cells)
        lenses = list(dict.fromkeys(pose.lens for pose in wanted))
        poses: list[PlannedPose] = []
        self.joints: list[NDArray[np.int64]] = []
        self.information: list[Float32] = []
        covers = []
        for i, lens in enumerate(lenses):
            if i % 10 == 0:
                on_step(f"lines of sight from {len(lenses)} places: {i}")
            view = self.lens_view(lens)
            for pose in (pose for pose in wanted if pose.lens == lens):
                seen, cells = self.see(view, pose)
                if cells.any():
                    poses.append(pose)
                    covers.append(cells)
                    self.joints.append(np.flatnonzero(seen))
                    self.information.append(view.information.reshape(6, -1)[:, self.joints[-1]])
        if not poses:
            raise SettingsError(
                "no sensor at any of the sites sees a person in the area from head to ankle: put sites farther from "
                "the area (the field of view ends there), nearer than the sensor's range, or before the obstacles"
            )
        self.poses = tuple(poses)
        self.covers = np.stack(covers)
        people = self.room.people
        self.shape = (len(self.cells), people.facings, len(people.postures), len(SCORED))
        missing = 100 * float((~self.covers.any(axis=0)).mean())
        if missing:
            self.notes.append(
                f"{missing:.0f} % of the area is covered by no sensor at any site, however many there are; add "
                "sites, or remove obstacles"
            )

    @property
    def prior(self) -> float:
        """Information of each coordinate of a joint that no sensor sees [1/m²]."""
        return 3.0 / (self.room.weights.unseen_cm / 100) ** 2

    @property
    def cell_m2(self) -> float:
        """Floor area of a cell [m²]."""
        return self.room.cell_m**2

    def lens_view(self, lens: tuple[float, float, float]) -> LensView:
        """Return what a lens at (x, height, z) [m] sees of the people in all cells."""
        eye = np.array(lens)
        toward = np.arctan2(eye[0] - self.cells[:, 0], eye[2] - self.cells[:, 1])
        points = np.stack([self._points(stature, toward) for stature in self._statures])
        clear = ~blocked(eye, points, self._things)
        people = self.room.people
        facing = np.arange(people.facings) * (2 * np.pi / people.facings)
        alpha = facing - toward[:, None]
        turn = np.round(alpha / (2 * np.pi) * TURNS).astype(np.int64) % TURNS
        far = np.hypot(eye[0] - self.cells[:, 0], eye[2] - self.cells[:, 1])
        up = eye[1] - _MIDDLE * self._statures[2]
        rise = np.abs(np.degrees(np.arctan2(up, far))[:, None] - RISES_DEG).argmin(axis=-1)
        posture = np.arange(len(people.postures))[:, None]
        joint = np.arange(len(SCORED))
        turns = turn[:, :, None, None]
        is_hidden = self.person.hides[posture, rise[:, None, None, None], turns, joint]
        moments = self.person.moments[posture, turns, joint, is_hidden.astype(np.int64)]
        moments = moments + np.eye(3) * self._farther(np.hypot(far, up), alpha)[:, :, None, None, None, :]
        axes = view_axes(toward)[:, None, None, None]
        information = axes @ np.linalg.inv(TRACKED**2 * moments) @ np.swapaxes(axes, -1, -2)
        point = self.person.point[posture, turns, joint]
        open_to = clear[2][np.arange(len(self.cells))[:, None, None, None], point]
        return LensView((six_of(information) * open_to).astype(np.float32), points, clear, point)

    def see(self, view: LensView, pose: PlannedPose) -> tuple[Bools, Bools]:
        """Return what a pose at a lens sees, each joint (cells, facings, postures, joints), and a row of `covers`."""
        sensor = self.sensor(pose)
        T = sensor.T_world_sensor
        camera = (view.points - T[:3, 3]) @ T[:3, :3]
        in_view = sensor.in_view(camera, sensor.project(camera)) & view.clear
        cells = np.arange(len(self.cells))[:, None, None, None]
        return in_view[2][cells, view.point], np.asarray(in_view[:2, :, ON_AXIS].all(axis=(0, 2)))

    def sensor(self, pose: PlannedPose, name: str = "planned") -> SensorSettings:
        """Return a pose as a sensor of the simulated room, of the planned kind and with a Kinect v2's errors."""
        model = self.room.sensor.model
        return SensorSettings(
            name, position=pose.lens, yaw_deg=pose.yaw_deg, tilt_deg=pose.tilt_deg, fov_deg=model.fov_deg,
            range_m=model.range_m, depth_size_px=model.size_px,
        )  # fmt: skip

    def _points(self, stature: float, toward: Float64) -> Float64:
        """Test points (cells, 18, 3) of a person in each cell, across the line of sight of yaw (cells,) [m]."""
        across, up = body_points(stature).T
        x = self.cells[:, :1] + across * np.cos(toward)[:, None]
        z = self.cells[:, 1:] - across * np.sin(toward)[:, None]
        return np.stack([x, np.broadcast_to(up, x.shape), z], axis=-1)

    def _farther(self, far: Float64, alpha: Float64) -> Float64:
        """Mean squares (cells, facings, 3) that the depth camera's noise adds beyond `MEASURED_AT_M` [m²]."""
        near = np.full(len(far), MEASURED_AT_M)[:, None]
        farther = np.maximum(far, MEASURED_AT_M)[:, None]
        focal_px = self.sensor(PlannedPose(0, 1, 0, 0, 0)).focal_px[0]
        across = (LATERAL_PX / focal_px) ** 2 * (farther**2 - near**2) * np.ones(alpha.shape)
        away = np.abs(np.angle(np.exp(1j * alpha)))
        oblique = np.minimum(away, np.pi - away)
        along = AXIAL_GAIN**2 * (axial_noise(farther, oblique) ** 2 - axial_noise(near, oblique) ** 2)
        return np.stack([across, across, along], axis=-1)

    def _within_bounds(self, room: PlannedRoom) -> PlannedRoom:
        people, chosen = room.people, room
        each = people.facings * len(people.postures) * len(SCORED)
        while True:
            cells, poses = len(cells_of(chosen)), poses_of(chosen, cells_of(chosen))
            if cells * each * len(poses) <= MOST_TRIED:
                break
            sites = tuple(dataclasses.replace(s, every_m=min(10.0, s.every_m * COARSER)) for s in chosen.sites)
            if chosen.cell_m * COARSER > 2.0:
                raise SettingsError(
                    f"the room is too large to plan at once ({len(poses)} poses of a sensor, {cells} cells): plan "
                    "parts of its area, or give fewer sites, heights, tilts or yaws"
                )
            chosen = dataclasses.replace(chosen, cell_m=chosen.cell_m * COARSER, sites=sites)
        if chosen is not room:
            self.notes.append(
                f"cells of {chosen.cell_m:.2f} m instead of {room.cell_m:g} m, and sites as much farther apart, to "
                "bound time and memory; plan a smaller area for finer cells"
            )
        return chosen


def cells_of(room: PlannedRoom) -> Float64:
    """Return the centres (cells, 2) of the cells of a room's area that are not within an obstacle [m].

    Raises:
        SettingsError: there is none.
    """
    corners = np.array(room.floor)
    grid = _grid(corners, room.cell_m)
    cells = grid[inside(corners, grid) & ~solid_at(room, grid)]
    if not len(cells):
        raise SettingsError(
            "the area has no cell outside obstacles: enlarge it, make cell_m smaller, or move obstacles"
        )
    return np.asarray(cells)


def poses_of(room: PlannedRoom, cells: Float64) -> list[PlannedPose]:
    """Return all poses at the sites of a room, without those within an obstacle.

    Args:
        room: the room.
        cells: (cells, 2) centres of the cells, towards whose middle sensors look [m].

    Raises:
        SettingsError: all places of a group of sites are within obstacles.
    """
    middle = cells.mean(axis=0)
    found: dict[PlannedPose, None] = {}
    corners = np.array(room.floor)
    for i, site in enumerate(room.sites):
        places, free = site_places(site), 0
        within = inside(corners, places)
        for (x, z), is_within in zip(places.tolist(), within, strict=True):
            for height in site.heights_m:
                if is_solid(room, (x, height, z)):
                    continue
                free += 1
                if site.yaws_deg:
                    yaws: Sequence[float] = site.yaws_deg
                elif is_within:
                    yaws = AROUND_DEG
                else:
                    ahead = math.degrees(math.atan2(middle[0] - x, middle[1] - z))
                    yaws = [wrapped(round(ahead + aside)) for aside in ASIDE_DEG]
                found.update({PlannedPose(x, height, z, yaw, tilt): None for yaw in yaws for tilt in site.tilts_deg})
        if not free:
            raise SettingsError(f"sites[{i}]: no sensor fits, all its places are inside obstacles; move one of them")
    return list(found)


def site_places(site: SensorSites) -> Float64:
    """Return the places (n, 2) of a group of sites, x and z [m]."""
    if site.points:
        return np.array(site.points, dtype=np.float64)
    if site.within:
        corners = np.array(site.within, dtype=np.float64)
        grid = _grid(corners, site.every_m)
        kept = grid[inside(corners, grid)]
        return kept if len(kept) else corners.mean(axis=0, keepdims=True)
    corners, parts = np.array(site.along, dtype=np.float64), []
    for start, end in itertools.pairwise(corners):
        steps = max(1, round(float(np.linalg.norm(end - start)) / site.every_m))
        parts.append(start + np.linspace(0, 1, steps + 1)[:, None] * (end - start))
    return np.unique(np.concatenate(parts).round(9), axis=0)


def is_solid(room: PlannedRoom, lens: tuple[float, float, float]) -> bool:
    """Return whether a place for a lens (x, height, z) [m] is within an obstacle."""
    low = dataclasses.replace(
        room,
        boxes=tuple(box for box in room.boxes if box.size[1] > lens[1]),
        cylinders=tuple(pillar for pillar in room.cylinders if pillar.height > lens[1]),
    )
    return bool(solid_at(low, np.array([lens[0], lens[2]])))


def wrapped(degrees: float) -> float:
    """Return an angle between −180° (exclusive) and 180° [deg]."""
    return 180.0 - (180.0 - degrees) % 360.0


def _grid(corners: Float64, spacing: float) -> Float64:
    """Centres (n, 2) of squares over the bounding box of a polygon, as many on both sides of its middle."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    counts = np.maximum(1, np.round((high - low) / spacing).astype(int))
    axes = [(a + b) / 2 + spacing * (np.arange(n) - (n - 1) / 2) for a, b, n in zip(low, high, counts, strict=True)]
    x, z = np.meshgrid(*axes, indexing="ij")
    return np.stack([x, z], axis=-1).reshape(-1, 2)
