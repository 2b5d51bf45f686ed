"""A simulated Kinect v2: its frames of the room, with the ground truth of each.

Each frame has its own random numbers, from a counter-based generator (Philox: J. Salmon et al., "Parallel Random
Numbers: As Easy as 1, 2, 3", 2011), keyed by seed and sensor, with the frame as counter. So frame k does not depend on
when the sensor was started; `SimulatedSensor.frames` lists the few exceptions.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.model.observations import BodyFrame, JointState, body_frame
from mocapella.model.truth import Truth
from mocapella.settings import check
from mocapella.sources.simulate.body import BODY, ROOT, facing, simulated_joints
from mocapella.sources.simulate.device import axial_noise
from mocapella.sources.simulate.measured import Course, Errors, measured_errors
from mocapella.sources.simulate.occlusion import hidden
from mocapella.sources.simulate.orientation import bone_ends, bone_orientations
from mocapella.sources.simulate.room import Room

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

SEEN_TO_BEGIN = 0.4
"""A body is detected if at least this fraction of its joints is visible."""
SEEN_TO_GO_ON = 0.12
"""A body is lost if a smaller fraction of its joints is visible; when detected again, it has a new id."""
SPEED_OVER_NS = 100_000_000
"""Interval over which a person's speed is measured, on which errors depend [ns]."""
FIRST_ID = 72_057_594_037_927_936
"""Base of the tracking ids; those of a Kinect v2 are large numbers, too."""


class SimulatedFrame(msgspec.Struct, frozen=True, eq=False):
    """A frame, its arrival at the node, and the ground truth.

    Attributes:
        due_s: room time (the scene's true time, from 0) at which it reaches the node: capture time plus latency [s].
        frame: the sensor's frame, with the capture time on the sensor's own clock; node_id and sent_ns are 0, since
            the node sets them.
        truth: the room at the capture time, which is ``truth.room_ns`` in room time.
    """

    due_s: float
    frame: BodyFrame
    truth: Truth


@dataclass(frozen=True, eq=False)
class _Look:
    """All people at one instant, before noise; joints in the body's order.

    world, camera: (people, 25, 3) [m]; pixels: (people, 25, 2); in_view, visible: (people, 25).
    """

    room_ns: int
    world: Float64
    camera: Float64
    pixels: Float64
    in_view: Bools
    visible: Bools


@dataclass(frozen=True, eq=False)
class _Draws:
    """The random numbers of one frame; equally many for each frame, so that they do not depend on the visibility."""

    lost: float
    jitter: float
    ids: NDArray[np.int64]
    joints: Float64
    lost_joints: Float64


class _Held:
    """The people that the sensor tracks, in the order of their detection, with their ids."""

    def __init__(self) -> None:
        self.people: list[int] = []
        self.ids: list[int] = []

    def update(self, seen: Float64, ids: NDArray[np.int64], most: int) -> None:
        """Drop people who are hardly visible; add visible people, up to the limit."""
        kept = [i for i, person in enumerate(self.people) if seen[person] >= SEEN_TO_GO_ON]
        self.people, self.ids = [self.people[i] for i in kept], [self.ids[i] for i in kept]
        new = [p for p in np.flatnonzero(seen >= SEEN_TO_BEGIN).tolist() if p not in self.people]
        # Sorted by the random ids: a body's index in the frame must not identify the person.
        for person in sorted(new, key=lambda p: int(ids[p]))[: most - len(self.people)]:
            self.people.append(person)
            self.ids.append(FIRST_ID + int(ids[person]))


class SimulatedSensor:
    """One sensor of a room, as the source of frames of a simulated node; it has no state between calls of `frames`.

    Args:
        room: the room that it is in.
        sensor: its name, or its number from 1.
        errors: errors of a sensor whose settings state ``kinect-v2-measured``; None for the shipped errors. Sensors
            with the error model ``model`` ignore them.

    Attributes:
        room: as given.
        settings: settings of the sensor.
        topology: topology of the frames.
        T_world_sensor: (4, 4) from the sensor's camera frame to the world.

    Raises:
        SettingsError: unknown sensor, or the body lacks joints of the room's topology.
    """

    def __init__(self, room: Room, sensor: int | str, errors: Errors | None = None) -> None:
        index = room.sensor_index(sensor)
        self.room = room
        self.settings = room.settings.sensors[index]
        self.topology = room.topology
        self.T_world_sensor = self.settings.T_world_sensor
        self._joints = None if self.topology is BODY else simulated_joints(self.topology.name)
        self._bones = bone_ends(self.topology)
        self._key = np.array([room.settings.seed, index], dtype=np.uint64)
        self._bias = self._biases()
        self._course: Course | None = None
        if self.settings.errors != "model":
            self._course = Course(errors or measured_errors(), self._key, len(self._bias))

    @property
    def name(self) -> str:
        """The sensor's name."""
        return self.settings.name

    def frames(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[SimulatedFrame]:
        """Yield the frames captured from ``start_s`` until before ``stop_s``, both room times [s]; None for no end.

        Frame k (captured at ``settings.frame_ns(k)``) depends only on the scene, its seed and k, not on the start. The
        exceptions are ``sequence``, which counts from 0; tracking ids; the order of the bodies; and the choice of the
        tracked bodies if there are more than ``max_bodies``, or if a person's visibility is between the thresholds for
        detecting and for losing a body.

        Raises:
            SettingsError: a time before 0, or a stop before the start.
        """
        check(math.isfinite(start_s) and start_s >= 0, "start_s", start_s, "0 or later")
        check(stop_s is None or stop_s >= start_s, "stop_s", stop_s, "start_s or later")
        return self._frames(start_s, math.inf if stop_s is None else stop_s)

    def _frames(self, start_s: float, stop_s: float) -> Iterator[SimulatedFrame]:
        first = max(0, math.floor((start_s - self.settings.phase_s) * self.settings.rate_hz))
        while self.settings.frame_ns(first) < round(start_s * NS_PER_S):
            first += 1
        forget = round(self.settings.forget_s * self.settings.rate_hz)
        unseen = np.zeros(self._bias.shape[:2], dtype=np.int64)
        for index in range(max(0, first - forget), first):
            unseen = _count(unseen, self._look(self.settings.frame_ns(index)), forget)
        held, sequence, index = _Held(), 0, first
        while (room_ns := self.settings.frame_ns(index)) < stop_s * NS_PER_S:
            look, draws = self._look(room_ns), self._draws(index)
            unseen = _count(unseen, look, forget)
            held.update(look.visible.mean(axis=1), draws.ids, self.settings.max_bodies)
            if draws.lost >= self.settings.lost:
                states = _states(look, unseen < max(forget, 1))
                yield self._frame(sequence, look, draws, states, held)
                sequence += 1
            index += 1

    def _look(self, room_ns: int) -> _Look:
        """Positions and visibility of all joints at one instant."""
        world = self.room.positions_at(room_ns)
        camera = (world - self.T_world_sensor[:3, 3]) @ self.T_world_sensor[:3, :3]
        pixels = self.settings.project(camera)
        in_view = self.settings.in_view(camera, pixels)
        blocked = hidden(self.T_world_sensor[:3, 3], world, self.room.motion.radii, self.room.obstacles)
        if self._course is not None:
            in_view = in_view & ~self._course.lost(room_ns)[:, None]
        return _Look(room_ns, world, camera, pixels, in_view, in_view & ~blocked)

    def _draws(self, index: int) -> _Draws:
        counter = np.array([0, 0, 0, index], dtype=np.uint64)
        rng = np.random.Generator(np.random.Philox(key=self._key, counter=counter))
        people = len(self._bias)
        return _Draws(
            rng.random(),
            float(np.clip(rng.standard_normal(), -3, 3)),
            rng.integers(1, 2**40, people),
            rng.standard_normal((people, self._bias.shape[1], 3)),
            rng.random((people, self._bias.shape[1])),
        )

    def _biases(self) -> Float64:
        """Constant errors (people, 25, 3) of inferred joints, camera frame [m]."""
        rng = np.random.default_rng([self._key[0], self._key[1], 1])
        direction = rng.standard_normal(self.room.motion.directions.shape[1:])
        length = np.linalg.norm(direction, axis=2, keepdims=True)
        return np.asarray(self.settings.noise.inferred_bias * direction / length)

    def _frame(
        self, sequence: int, look: _Look, draws: _Draws, states: NDArray[np.uint8], held: _Held
    ) -> SimulatedFrame:
        people = np.array(held.people, dtype=np.int64)
        forward, away = self._turned(look.world[people])
        rows, settings = people[:, None], self.settings
        tilt, height = math.radians(settings.tilt_deg), settings.position[1]
        if self._course is None:
            mirrored = away > math.radians(settings.mirror_beyond_deg)
            noisy = self._noisy(look.camera[people], states[people], away, draws.joints[people], self._bias[people])
        else:
            noisy, mirrored = self._as_measured(look, people, draws, self._course)
            states = np.where((draws.lost_joints < self._course.errors.data.joint_lost), JointState.NOT_TRACKED, states)
            tilt, height = tilt + self._course.tilt_error, max(0.01, height + self._course.height_error)
        order = np.where(mirrored[:, None], BODY.mirror, range(len(BODY)))
        positions, states = noisy[np.arange(len(people))[:, None], order], states[rows, order]
        if self._joints is not None:
            positions, states = self._joints.positions(positions), self._joints.states(states)
        frame = body_frame(
            self.name,
            self.topology,
            time_ns=settings.clock_ns(look.room_ns),
            positions=positions,
            states=states,
            tracking_ids=held.ids,
            clipped_edges=settings.clipped_edges(look.pixels[people]),
            depth_px=settings.project(positions),
            orientations=bone_orientations(positions, self._bones, np.where(mirrored[:, None], -forward, forward)),
            sequence=sequence,
            depth_size_px=settings.depth_size_px,
            tilt=tilt,
            height=height,
        )
        due_s = look.room_ns / NS_PER_S + max(0.0, settings.latency_s + settings.latency_jitter_s * draws.jitter)
        return SimulatedFrame(due_s, frame, self._truth(sequence, look, people, mirrored))

    def _turned(self, world: Float64) -> tuple[Float64, Float64]:
        """Facing directions (n, 3) of bodies (n, 25, 3) in the camera frame, and angles away from the sensor (n,)."""
        forward, line = facing(world), self.T_world_sensor[:3, 3] - world.mean(axis=1)
        cross = forward[:, 2] * line[:, 0] - forward[:, 0] * line[:, 2]
        away = np.abs(np.arctan2(cross, forward[:, 0] * line[:, 0] + forward[:, 2] * line[:, 2]))
        return forward @ self.T_world_sensor[:3, :3], away

    def _noisy(
        self, camera: Float64, states: NDArray[np.uint8], away: Float64, draws: Float64, bias: Float64
    ) -> Float64:
        """Joints (bodies, 25, 3) with noise that depends on their distance and the angle of view."""
        noise, depth = self.settings.noise, np.maximum(camera[..., 2], 0.0)
        oblique = np.minimum(away, math.pi - away)[:, None]
        across = [noise.lateral_px * depth / focal for focal in self.settings.focal_px]
        spread = np.stack([*across, noise.axial_gain * axial_noise(depth, oblique)], axis=-1)
        inferred = (states == JointState.INFERRED)[..., None]
        scatter = np.where(inferred, noise.inferred_gain, 1.0) * spread * draws
        return np.asarray(camera + scatter + np.where(inferred, bias, 0.0))

    def _as_measured(
        self, look: _Look, people: NDArray[np.int64], draws: _Draws, course: Course
    ) -> tuple[Float64, Bools]:
        """Joints (bodies, 25, 3) in the camera frame with correct labels, and whether labels are swapped (bodies,)."""
        eye, R = self.T_world_sensor[:3, 3], self.T_world_sensor[:3, :3]
        before = self.room.positions_at(max(0, look.room_ns - SPEED_OVER_NS))[people, ROOT]
        speed = np.linalg.norm(look.world[people, ROOT] - before, axis=-1) * (NS_PER_S / SPEED_OVER_NS)
        noise = course.errors.noise(course.splines(look.room_ns)[:, people], draws.joints[people], speed)
        world, mirrored = course.errors.put_on(look.world[people], eye, look.visible[people], noise)
        return (world - eye) @ R, mirrored

    def _truth(self, sequence: int, look: _Look, people: NDArray[np.int64], mirrored: Bools) -> Truth:
        return Truth(
            sensor=self.name,
            sequence=sequence,
            room_ns=look.room_ns,
            topology=BODY,
            people=np.arange(len(look.world)),
            positions=look.world,
            T_world_sensor=self.T_world_sensor,
            body_people=people,
            mirrored=mirrored,
        )


def merge(
    sensors: Iterable[SimulatedSensor], start_s: float = 0.0, stop_s: float | None = None
) -> Iterator[SimulatedFrame]:
    """Merge the frames of several sensors in the order of arrival at their nodes; ties are in the order of names.

    The frames are captured from ``start_s`` until before ``stop_s``, both room times [s]; without ``stop_s``, the
    iteration does not end.
    """
    streams = [sensor.frames(start_s, stop_s) for sensor in sensors]
    return heapq.merge(*streams, key=lambda item: (item.due_s, item.frame.sensor))


def _count(unseen: NDArray[np.int64], look: _Look, most: int) -> NDArray[np.int64]:
    """Number of frames (people, 25) since each joint was visible, at most ``most``."""
    return np.where(look.visible, 0, np.minimum(unseen + 1, max(most, 1)))


def _states(look: _Look, remembered: Bools) -> NDArray[np.uint8]:
    """`JointState` (people, 25): tracked if visible; inferred if hidden in view for a short time; else not tracked."""
    inferred = np.where(look.in_view & remembered, np.uint8(JointState.INFERRED), np.uint8(JointState.NOT_TRACKED))
    return np.asarray(np.where(look.visible, np.uint8(JointState.TRACKED), inferred))
