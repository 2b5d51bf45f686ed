"""A simulated room: moving people, obstacles and sensors.

A room gives the true joints of all people at any instant; `mocapella.sources.simulate.sensor` makes frames of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.bvh import read_bvh
from mocapella.model.topology import Topology, topology
from mocapella.settings import check
from mocapella.sources.simulate.body import bone_lengths
from mocapella.sources.simulate.device import SensorSettings
from mocapella.sources.simulate.gait import animate
from mocapella.sources.simulate.motion import Ensemble, Motion, together
from mocapella.sources.simulate.occlusion import Box, Cylinder, Obstacles, obstacles
from mocapella.sources.simulate.retarget import bvh_motion
from mocapella.sources.simulate.scenarios import WRITTEN, plan, written_route

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class PersonSettings:
    """A person and the person's motion.

    Attributes:
        start: initial position (world x, z) [m].
        scenario: one of `mocapella.sources.simulate.scenarios.scenario_names`, or ``route``.
        target: position that the scenario refers to (world x, z): an obstacle's centre, or the other person's position;
            None for other scenarios [m].
        first: whether this person moves first, if two take turns.
        route: steps of the scenario ``route``, see `mocapella.sources.simulate.scenarios.written_route`.
        stature: height of the person [m].
        lifeless: whether this is a mannequin, which neither breathes nor sways.
        bvh: path of a BVH file whose motion replaces the scenario; None for none.
        bvh_metres_per_unit: unit of the BVH file [m]; None scales its motion to the stature.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    start: tuple[float, float]
    scenario: str = "stand"
    target: tuple[float, float] | None = None
    first: bool = True
    route: tuple[str, ...] = ()
    stature: float = 1.75
    lifeless: bool = False
    bvh: str | None = None
    bvh_metres_per_unit: float | None = None

    def __post_init__(self) -> None:
        check(all(abs(x) <= 100 for x in self.start), "start", self.start, "within 100 m of the origin")
        check(0.5 <= self.stature <= 2.5, "stature", self.stature, "from 0.5 to 2.5 m")


@dataclass(frozen=True)
class SceneSettings:
    """Description of a room with people, obstacles and body sensors; `build_room` makes it.

    Attributes:
        name: name of the scene.
        sensors: the sensors; the first is the main sensor, which all people face at first.
        people, boxes, cylinders: people and obstacles in the room.
        seed: random seed of noise, losses, jitter and breathing.
        topology: name of the topology of the sensors' frames.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    sensors: tuple[SensorSettings, ...]
    people: tuple[PersonSettings, ...]
    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    seed: int = 0
    topology: str = "kinect_v2"

    def __post_init__(self) -> None:
        check(0 <= self.seed < 2**63, "seed", self.seed, "from 0 to 2**63 − 1")
        check(len(self.sensors) >= 1, "sensors", self.sensors, "one or more")
        check(len(self.people) >= 1, "people", self.people, "one or more")
        names = [sensor.name for sensor in self.sensors]
        check(len(set(names)) == len(names), "sensors", names, "of different names")


@dataclass(frozen=True, eq=False)
class Room:
    """A scene that can be evaluated at any instant of room time, its true time from 0; made by `build_room`.

    The motions repeat after `duration_ns`.

    Attributes:
        settings: description of the scene.
        motion: motion of all people.
        obstacles: obstacles in the room.
        topology: topology of the sensors' frames.
    """

    settings: SceneSettings
    motion: Ensemble = field(repr=False)
    obstacles: Obstacles = field(repr=False)
    topology: Topology = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.settings.name

    @property
    def duration_ns(self) -> int:
        """Period of all motions [ns]."""
        return self.motion.duration_ns

    @property
    def duration_s(self) -> float:
        """`duration_ns` in seconds."""
        return self.duration_ns / 1e9

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names in the scene's order, the main sensor first."""
        return tuple(sensor.name for sensor in self.settings.sensors)

    def positions_at(self, room_ns: int) -> Float64:
        """Return the joints (people, 25, 3) of `simulate.body.BODY` at a room time [ns], in the world [m]."""
        return self.motion.positions_at(room_ns)

    def sensor_index(self, sensor: int | str) -> int:
        """Return the index of a sensor, from 0, by its name or its number from 1 (also as digits).

        Raises:
            SettingsError: unknown sensor; lists the known ones.
        """
        names = self.sensor_names
        if isinstance(sensor, str) and sensor in names:
            return names.index(sensor)
        if isinstance(sensor, int) or (sensor.isascii() and sensor.isdigit()):
            number = int(sensor)
            if 1 <= number <= len(names):
                return number - 1
            raise SettingsError(f"scene {self.name} has no sensor {number}; give 1 to {len(names)}: {', '.join(names)}")
        raise SettingsError(f"scene {self.name} has no sensor {sensor!r}; it has {one_of(sensor, names)}")


def build_room(settings: SceneSettings) -> Room:
    """Build a room: plan and animate all people.

    Raises:
        SettingsError: an unknown scenario or topology, or a scenario without its target.
        InputError: a BVH file that cannot be used.
    """
    motions = [_motion(person, settings.seed, i) for i, person in enumerate(settings.people)]
    blocks = obstacles(settings.boxes, settings.cylinders)
    return Room(settings, together(motions), blocks, topology(settings.topology))


def _motion(person: PersonSettings, seed: int, index: int) -> Motion:
    rng = np.random.default_rng([seed, index])
    if person.bvh is not None:
        unit = person.bvh_metres_per_unit
        bvh = read_bvh(person.bvh)
        return bvh_motion(bvh, person.start, person.stature, rng, metres_per_unit=unit, file=person.bvh)
    if person.scenario == WRITTEN:
        route = written_route(person.start, person.route)
    else:
        route = plan(person.scenario, person.start, person.target, first=person.first)
    return animate(route.legs, bone_lengths(person.stature), person.stature, rng, lifeless=person.lifeless)
