"""The description of a room to plan: a TOML file (docs/planner.md), read and checked once.

The floor's coordinates are the simulated room's: x and z [m], seen from above x grows to the left of z; y is up. A yaw
of 0 looks along z and grows towards x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_toml, read_whole
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.limits import Range
from mocapella.settings import check, parse
from mocapella.sources.simulate.occlusion import Box, Cylinder
from mocapella.sources.simulate.postures import POSTURES
from mocapella.studies.planner.polygons import crosses_itself, inside, polygon_area

Float64 = NDArray[np.float64]
Spot2 = tuple[float, float]

FIX: Final = "see docs/planner.md, or begin with `mocapella plan --example > room.toml`"
SIDE: Final = Range(1.0, 100.0, "m")
"""Width and depth of a room."""
HEIGHT: Final = Range(1.0, 20.0, "m")
"""Height of a room."""
STATURE: Final = Range(0.5, 2.5, "m")
MOST_CORNERS: Final = 200
"""Most points of a polygon or line."""
MOST_THINGS: Final = 200
"""Most obstacles, and most groups of places."""
MOST_PLANNED: Final = 16
"""Most sensors that can be planned."""
_SLACK_M: Final = 1e-6


@dataclass(frozen=True)
class SensorModel:
    """Optics of a kind of sensor, from its data sheet.

    Attributes:
        fov_deg: horizontal and vertical field of view [deg].
        range_m: nearest and farthest depth along the optical axis [m].
        size_px: width and height of the depth image [px].
    """

    fov_deg: tuple[float, float]
    range_m: tuple[float, float]
    size_px: tuple[int, int]


SENSOR_MODELS: Final = {
    "kinect-v2": SensorModel((70.6, 60.0), (0.5, 4.5), (512, 424)),
    "kinect-v1": SensorModel((57.0, 43.0), (0.8, 4.0), (640, 480)),
    "azure-kinect": SensorModel((75.0, 65.0), (0.5, 3.86), (640, 576)),
    "azure-kinect-wide": SensorModel((120.0, 120.0), (0.25, 2.88), (512, 512)),
}
"""Kinds of sensors: the narrow mode of the Azure Kinect and Orbbec Femto, and its binned wide mode."""


@dataclass(frozen=True)
class PlannedSensors:
    """The sensors to be placed.

    Attributes:
        kind: key of `SENSOR_MODELS`.
        count: number of sensors.
        fov_deg: horizontal and vertical field of view [deg]; empty for the kind's.
        range_m: nearest and farthest depth along the optical axis [m]; empty for the kind's.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    kind: str = "kinect-v2"
    count: int = 2
    fov_deg: tuple[float, ...] = ()
    range_m: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check(self.kind in SENSOR_MODELS, "sensor.kind", self.kind, one_of(self.kind, SENSOR_MODELS))
        check(1 <= self.count <= MOST_PLANNED, "sensor.count", self.count, f"from 1 to {MOST_PLANNED}")
        fits = len(self.fov_deg) in (0, 2) and all(1 <= angle <= 170 for angle in self.fov_deg)
        check(fits, "sensor.fov_deg", self.fov_deg, "two angles, each from 1 to 170")
        near_far = len(self.range_m) in (0, 2) and all(math.isfinite(one) for one in self.range_m)
        fits = near_far and (not self.range_m or 0 < self.range_m[0] < self.range_m[1])
        check(fits, "sensor.range_m", self.range_m, "a nearest and a greater farthest depth")

    @property
    def model(self) -> SensorModel:
        """The kind's optics, with the field of view and range replaced by the given ones."""
        known = SENSOR_MODELS[self.kind]
        fov, reach = self.fov_deg or known.fov_deg, self.range_m or known.range_m
        return SensorModel((fov[0], fov[1]), (reach[0], reach[1]), known.size_px)


@dataclass(frozen=True)
class SensorSites:
    """Places where sensors may stand: exactly one of ``points``, ``along`` and ``within``.

    Attributes:
        heights_m: heights of the lens above the floor [m].
        points: single places (x, z) [m].
        along: corners of a line, such as a wall, along which a sensor may stand anywhere [m].
        within: corners of a polygon, within which a tripod may stand anywhere [m].
        every_m: spacing of the places along the line or within the polygon [m].
        tilts_deg: tilts, upwards positive [deg].
        yaws_deg: yaws [deg]; empty for yaws towards the area.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    heights_m: tuple[float, ...]
    points: tuple[Spot2, ...] = ()
    along: tuple[Spot2, ...] = ()
    within: tuple[Spot2, ...] = ()
    every_m: float = 0.5
    tilts_deg: tuple[float, ...] = (0.0, -15.0)
    yaws_deg: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        given = [name for name in ("points", "along", "within") if getattr(self, name)]
        check(len(given) == 1, "sites", " and ".join(given), "exactly one of points, along and within")
        check(0.05 <= self.every_m <= 10, "every_m", self.every_m, "from 0.05 to 10 m")
        check(1 <= len(self.heights_m) <= 20, "heights_m", self.heights_m, "from 1 to 20 heights")
        check(all(0 < height <= 20 for height in self.heights_m), "heights_m", self.heights_m, "above 0 up to 20 m")
        check(1 <= len(self.tilts_deg) <= 20, "tilts_deg", self.tilts_deg, "from 1 to 20 tilts")
        check(all(-85 <= tilt <= 85 for tilt in self.tilts_deg), "tilts_deg", self.tilts_deg, "within ±85")
        check(len(self.yaws_deg) <= 36, "yaws_deg", self.yaws_deg, "at most 36 yaws")
        check(all(-360 <= yaw <= 360 for yaw in self.yaws_deg), "yaws_deg", self.yaws_deg, "within ±360")
        _check_line(self.along, "along", 2)
        _check_line(self.points, "points", 1)
        _check_polygon(self.within, "within")


@dataclass(frozen=True)
class PlannedPeople:
    """The people who are to be measured.

    Attributes:
        heights_m: smallest and greatest height of a person [m].
        postures: postures whose error is expected, ``stand`` or keys of
            `mocapella.sources.simulate.postures.POSTURES`.
        facings: number of directions, evenly around, that people face.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    heights_m: tuple[float, float] = (1.55, 1.9)
    postures: tuple[str, ...] = ("stand",)
    facings: int = 8

    def __post_init__(self) -> None:
        low, high = self.heights_m
        fits = low in STATURE and high in STATURE and low <= high
        check(fits, "people.heights_m", self.heights_m, f"the smallest and the greatest height, {STATURE}")
        known = ("stand", *POSTURES)
        check(1 <= len(self.postures) <= 4, "people.postures", self.postures, "from 1 to 4 postures")
        for name in self.postures:
            check(name in known, "people.postures", name, one_of(name, known))
        check(4 <= self.facings <= 36, "people.facings", self.facings, "from 4 to 36")


@dataclass(frozen=True)
class PlanWeights:
    """Weights of the cost, see docs/planner.md.

    Attributes:
        unseen_cm: error of a joint that no sensor sees; larger: hidden joints cost more [cm].
        uncovered_cm: cost of a floor that no sensor covers; larger: more floor, less accuracy [cm].
        single_cm: cost of a floor that fewer than two sensors cover; larger: more floor that two cover [cm].
        apart_cm: cost of each group of sensors that cannot be calibrated with the others [cm].
        overlap_m2: least floor that two sensors must both cover to be calibrated with each other [m²].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    unseen_cm: float = 30.0
    uncovered_cm: float = 50.0
    single_cm: float = 10.0
    apart_cm: float = 100.0
    overlap_m2: float = 1.0

    def __post_init__(self) -> None:
        check(1 <= self.unseen_cm <= 1000, "weights.unseen_cm", self.unseen_cm, "from 1 to 1000 cm")
        for name in ("uncovered_cm", "single_cm", "apart_cm"):
            check(0 <= getattr(self, name) <= 1e6, f"weights.{name}", getattr(self, name), "from 0 to 1000000 cm")
        check(0 <= self.overlap_m2 <= 100, "weights.overlap_m2", self.overlap_m2, "from 0 to 100 m²")


@dataclass(frozen=True)
class PlannedRoom:
    """A room to place sensors in.

    Attributes:
        width, depth, height: extent along x, z and up [m].
        corner: the room's corner of least x and z [m].
        area: corners of the polygon that must be covered (x, z) [m]; empty for the whole floor.
        boxes, cylinders: obstacles.
        sites: where sensors may stand.
        sensor: the sensors.
        people: the people.
        cell_m: spacing of the cells of the floor [m].
        weights: weights of the cost.

    Raises:
        SettingsError: a value is invalid, something is outside the room, or a polygon crosses itself; names it and the
            remedy.
    """

    width: float
    depth: float
    height: float
    sites: tuple[SensorSites, ...]
    corner: Spot2 = (0.0, 0.0)
    area: tuple[Spot2, ...] = ()
    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    sensor: PlannedSensors = field(default_factory=PlannedSensors)
    people: PlannedPeople = field(default_factory=PlannedPeople)
    cell_m: float = 0.3
    weights: PlanWeights = field(default_factory=PlanWeights)

    def __post_init__(self) -> None:
        check(self.width in SIDE, "width", self.width, str(SIDE))
        check(self.depth in SIDE, "depth", self.depth, str(SIDE))
        check(self.height in HEIGHT, "height", self.height, str(HEIGHT))
        check(all(abs(x) <= 1000 for x in self.corner), "corner", self.corner, "within 1000 m")
        check(0.05 <= self.cell_m <= 2, "cell_m", self.cell_m, "from 0.05 to 2 m")
        check(
            1 <= len(self.sites) <= MOST_THINGS, "sites", len(self.sites), f"from 1 to {MOST_THINGS} groups of places"
        )
        count = len(self.boxes) + len(self.cylinders)
        check(count <= MOST_THINGS, "number of obstacles", count, f"at most {MOST_THINGS}")
        _check_polygon(self.area, "area")
        self._check_inside(self.area, "area", "is outside the room")
        for i, box in enumerate(self.boxes):
            self._check_inside(box_corners(box), f"boxes[{i}]", "reaches outside the room")
            check(box.size[1] <= self.height, f"boxes[{i}].size", box.size, f"no higher than the room, {self.height} m")
        for i, pillar in enumerate(self.cylinders):
            r = pillar.radius
            around = [(pillar.centre[0] + dx, pillar.centre[1] + dz) for dx, dz in ((r, 0), (-r, 0), (0, r), (0, -r))]
            self._check_inside(around, f"cylinders[{i}]", "reaches outside the room")
            name = f"cylinders[{i}].height"
            check(pillar.height <= self.height, name, pillar.height, f"no higher than the room, {self.height} m")
        for i, site in enumerate(self.sites):
            for name in ("points", "along", "within"):
                self._check_inside(getattr(site, name), f"sites[{i}].{name}", "is outside the room")
            high = max(site.heights_m)
            check(high <= self.height, f"sites[{i}].heights_m", high, f"no higher than the room, {self.height} m")

    def _check_inside(self, points: Sequence[Spot2], name: str, problem: str) -> None:
        x0, z0 = self.corner
        for x, z in points:
            off = max(x0 - x, x - x0 - self.width, z0 - z, z - z0 - self.depth)
            if not off <= _SLACK_M:
                limits = f"x from {x0:g} to {x0 + self.width:g} and z from {z0:g} to {z0 + self.depth:g}"
                raise SettingsError(f"{name}: ({x:g}, {z:g}) {problem}; the room has {limits} m")

    @property
    def floor(self) -> tuple[Spot2, ...]:
        """Corners of the area to be covered: ``area``, or the whole floor."""
        (x, z), w, d = self.corner, self.width, self.depth
        return self.area or ((x, z), (x + w, z), (x + w, z + d), (x, z + d))


def box_corners(box: Box) -> list[Spot2]:
    """Return the four corners (x, z) of a box's base [m]."""
    yaw = math.radians(box.yaw_deg)
    cos, sin = math.cos(yaw), math.sin(yaw)
    w, d = box.size[0] / 2, box.size[2] / 2
    x, z = box.centre
    return [(x + a * cos + b * sin, z - a * sin + b * cos) for a, b in ((w, d), (-w, d), (-w, -d), (w, -d))]


def solid_at(room: PlannedRoom, points: Float64) -> NDArray[np.bool_]:
    """Return whether floor points (..., 2) are inside the base of an obstacle."""
    found = np.zeros(points.shape[:-1], dtype=np.bool_)
    for box in room.boxes:
        found |= inside(np.array(box_corners(box)), points)
    for pillar in room.cylinders:
        found |= np.hypot(points[..., 0] - pillar.centre[0], points[..., 1] - pillar.centre[1]) < pillar.radius
    return found


def read_room(path: Path | str) -> PlannedRoom:
    """Read the TOML file of a room.

    Raises:
        InputError: the file cannot be read, is no TOML, or does not describe a room; names the field and the remedy.
    """
    return room_from_toml(read_whole(path, fix=FIX), path)


def room_from_toml(data: bytes, file: object) -> PlannedRoom:
    """Decode a room from the content of a TOML file; ``file`` is named in errors.

    Raises:
        InputError: it is no TOML, or does not describe a room; names the field and the remedy.
    """
    table = decode_toml(data, file=file, fix=FIX)
    try:
        return parse(PlannedRoom, table, where="room")
    except SettingsError as error:
        raise InputError(str(error), file=file, fix=FIX) from None


def example_room() -> str:
    """Return the text of the example that ships with this version."""
    return files("mocapella.studies.planner").joinpath("example.toml").read_text(encoding="utf-8")


def _check_line(points: tuple[Spot2, ...], name: str, least: int) -> None:
    if not points:
        return
    check(least <= len(points) <= MOST_CORNERS, name, len(points), f"from {least} to {MOST_CORNERS} points")
    check(all(abs(x) < 1e4 for point in points for x in point), name, points[:3], "finite coordinates in metres")


def _check_polygon(points: tuple[Spot2, ...], name: str) -> None:
    if not points:
        return
    _check_line(points, name, 3)
    corners = np.array(points, dtype=np.float64)
    if crosses_itself(corners):
        raise SettingsError(f"{name} crosses itself; give its corners in their order around it, each once")
    area = polygon_area(corners)
    check(area >= 0.01, f"{name}, area in m²", round(area, 4), "0.01 m² or more")
