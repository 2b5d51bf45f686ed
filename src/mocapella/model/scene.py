"""Scenes, the tracker's results: people and their views, hands, arms, objects, and parts of plug-ins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse
from mocapella.model.arms import ARM_JOINTS
from mocapella.model.topology import Topology

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


class Phase(StrEnum):
    """Phases of the tracker, as in the KinectMultiTrack thesis, and ``STOPPED``; the values are texts for users.

    In the usual order: it waits for the sensors, is calibrated, and then tracks. Only the method ``stand-still`` needs
    a recalibration after all people have left.
    """

    STOPPED = "stopped"
    """Frames are not tracked: before the start, while the method is prepared, or after a stop."""
    WAITING_FOR_SENSORS = "waiting for sensors"
    """Fewer sensors send frames than are expected."""
    CALIBRATING = "calibrating"
    NEEDS_RECALIBRATION = "needs recalibration"
    """All people have left, and the calibration by standing still must be repeated."""
    TRACKING = "tracking"


class TrackerState(msgspec.Struct, frozen=True):
    """The tracker's state, for users to act on.

    Attributes:
        phase: the state.
        sensors_missing: number of sensors that it waits for.
        frames_remaining: number of frames that the calibration still needs from the sensor that lacks most.
        frames_wanted: number of frames that the calibration needs in total.
        reason: why the calibration restarted, or what to do; empty if there is neither.
    """

    phase: Phase
    sensors_missing: int = 0
    frames_remaining: int = 0
    frames_wanted: int = 0
    reason: str = ""


class PotentialSkeleton(msgspec.Struct, frozen=True, eq=False):
    """One sensor's view of a person (the thesis' *potential skeleton*).

    Attributes:
        sensor: name of the sensor.
        tracking_id: the sensor's id of the body.
        time_ns: capture time, on the sensor's own clock.
        tilt: tilt of the sensor, upwards positive [rad].
        height: height of the sensor above the floor [m].
        T_world_sensor: (4, 4), from the sensor's camera space to the world; the method ``stand-still`` has a separate
            world for each person.
        positions: (joints, 3), world [m], with the sensor's own left and right labels; NaN where not tracked.
        states: (joints,), `JointState`.
        mirrored: whether the method judges its left and right labels as swapped, and corrected them in the person.
    """

    sensor: str
    tracking_id: int
    time_ns: int
    tilt: float
    height: float
    T_world_sensor: Float64
    positions: Float64
    states: UInt8
    mirrored: bool = False


class Person(msgspec.Struct, frozen=True, eq=False):
    """A person, the skeleton fused from all views, and the views.

    Attributes:
        id: stays the same for as long as the tracker believes it is the same person.
        positions: (joints, 3), fused, world [m]; NaN where no sensor sees the joint.
        states: (joints,), `JointState`: tracked = measured by at least one sensor; inferred; not tracked.
        views: the potential skeletons, in the order of their sensors' names. A sensor that has lost the person for
            now may keep a view without tracked joints.
        sd: (joints,) float32, standard deviation of a coordinate [m]; NaN where not tracked. None if the method does
            not estimate it.
        name: name given to the person in this session; empty without one.
        condition: lasting disagreement of the person's measurements and the method's model, for users; empty if none.
    """

    id: int
    positions: Float64
    states: UInt8
    views: tuple[PotentialSkeleton, ...]
    sd: Float32 | None = None
    name: str = ""
    condition: str = ""

    def view_of(self, sensor: str) -> PotentialSkeleton | None:
        """Return a sensor's view of this person; None without one."""
        return next((view for view in self.views if view.sensor == sensor), None)

    def seen_from(self, sensor: str) -> Float64 | None:
        """Return the fused skeleton (joints, 3) in a sensor's camera space [m]; None without a view of this sensor.

        A joint that no sensor sees is NaN, as in `positions`. A view without tracked joints suffices, so this also
        works for a person whom the sensor has lost.
        """
        view = self.view_of(sensor)
        return None if view is None else apply(inverse(view.T_world_sensor), self.positions)


class SensorPlace(msgspec.Struct, frozen=True, eq=False):
    """A sensor's pose and its uncertainty.

    Attributes:
        sensor: name of the sensor.
        T_world_sensor: (4, 4), from the sensor's camera space to the world; None where not known yet.
        position_sd: standard deviation, by the pose's error, of a point where the people are [m]; NaN if unknown.
        rotation_sd: standard deviation of the pose's rotation [rad]; NaN if unknown.
        quality: quality of the pose, in words.
        problem: why its views are not used, or what to do; empty if there is no problem.
    """

    sensor: str
    T_world_sensor: Float64 | None
    position_sd: float = math.nan
    rotation_sd: float = math.nan
    quality: str = ""
    problem: str = ""


class TrackedHand(msgspec.Struct, frozen=True, eq=False):
    """A hand; landmarks and angles are in the order of `mocapella.model.hand`.

    Attributes:
        id: constant for one hand.
        left: whether it is a left hand.
        landmarks: (21, 3), world [m]; NaN where not known.
        states: (21,) `JointState`: tracked = the markers of this instant determine it; inferred; not tracked.
        sd: (21,) float32, standard deviation of a coordinate [m]; NaN where not known.
        angles: (21,) [rad]; NaN where not known.
        T_world_palm: (4, 4) pose of the palm; None where not known.
        holds: name of the object that the hand holds; empty for none.
    """

    id: int
    left: bool
    landmarks: Float64
    states: UInt8
    sd: Float32
    angles: Float64
    T_world_palm: Float64 | None
    holds: str = ""


class TrackedArm(msgspec.Struct, frozen=True, eq=False):
    """An arm and its hand that depth cameras see; points are in the order of `mocapella.model.arms.ARM_POINTS`.

    Attributes:
        id: constant for one arm.
        left: whether it is a left arm.
        points: (23, 3), world [m]; NaN where not known.
        states: (23,) `JointState`: tracked = at least one camera measures it; inferred; not tracked.
        sd: (23,) float32, standard deviation of a coordinate [m]; NaN where not known.
        angles: (21,) angles in the order of `mocapella.model.hand.ANGLES` [rad]; NaN where not known.
        T_world_palm: (4, 4) pose of the palm; None where not known.
        gesture: name, such as open or fist; empty if none is recognised.
        gesture_sure: confidence of the gesture, from 0 to 1.
        grabbing: whether the hand holds on to something.
        person: id of the arm's `Person`; -1 if unassigned.
        cameras: names of the cameras that see it now; empty while it is only predicted.
    """

    id: int
    left: bool
    points: Float64
    states: UInt8
    sd: Float32
    angles: Float64
    T_world_palm: Float64 | None
    gesture: str
    gesture_sure: float
    grabbing: bool
    person: int = -1
    cameras: tuple[str, ...] = ()

    @property
    def joints(self) -> Float64:
        """(8, 3) positions of `mocapella.model.arms.ARM_JOINTS`, world [m]."""
        return self.points[list(ARM_JOINTS)]

    @property
    def joint_states(self) -> UInt8:
        """(8,) `JointState` of `mocapella.model.arms.ARM_JOINTS`."""
        return self.states[list(ARM_JOINTS)]


class TrackedPoints(msgspec.Struct, frozen=True, eq=False):
    """Named 3D points triangulated from several cameras, with their uncertainties.

    Attributes:
        names: (points,) names of the markers or keypoints.
        positions: (points, 3), world [m]; NaN where not known.
        sd: (points,) float32, standard deviation of a coordinate [m]; NaN where not known.
        cameras: (points,) uint8, number of cameras that agree.
    """

    names: tuple[str, ...]
    positions: Float64
    sd: Float32
    cameras: UInt8


class TrackedObject(msgspec.Struct, frozen=True, eq=False):
    """A rigid object.

    Attributes:
        name: name of the object.
        T_world_object: (4, 4) pose of the object; None before it is seen.
        outline: (k, 3) a closed line in the object's frame, for drawing [m].
        state: `JointState`: tracked; inferred = at its last seen pose, or carried by the hand; not tracked.
    """

    name: str
    T_world_object: Float64 | None
    outline: Float64
    state: int


class UnknownPart(msgspec.Struct, frozen=True):
    """A part of a type that no installed package decodes; it is re-encoded unchanged.

    Attributes:
        kind: name of its type.
        content: bytes encoded by the plug-in.
    """

    kind: str
    content: bytes


class TrackedBodyView(msgspec.Struct, frozen=True, eq=False):
    """A body in one camera's image.

    Lines are closed, one after the other, with a row of NaN between two; empty where there is nothing to draw.

    Attributes:
        camera: name of the camera.
        overlap: intersection over union of the model's and the image's silhouettes; NaN if the camera does not see it.
        left_out: why the image is not used; empty if it is.
        outline_px: (k, 2) float32, outline of the posed model [px].
        contour_px: (k, 2) float32, contour of the region segmented in the image [px].
    """

    camera: str
    overlap: float
    left_out: str
    outline_px: Float32
    contour_px: Float32


class TrackedBody(msgspec.Struct, frozen=True, eq=False):
    """A body model in a pose.

    Attributes:
        id: constant for one body.
        name: name of the person; empty if unknown.
        build: JSON from which a reader rebuilds the mesh: ``model``, ``height_m`` and ``proportions``, or
            ``model`` and ``sha256`` of a mesh's file. Empty if not given.
        T_world_model: (4, 4) from the model's rest frame to the world, of the root part.
        angles: (dof,) joint angles [rad].
        joint_names: (dof,) names of the angles.
        landmark_names: (landmarks,) names of the landmarks.
        landmarks: (landmarks, 3), world [m].
        states: (landmarks,) uint8 `JointState`: tracked = in the image of a camera that sees the body now; inferred =
            predicted, or of a lost body; not tracked = the tracker does not search for the body yet.
        lost: whether the person is absent, because not yet arrived or gone; the pose is then the initial one, or the
            last one seen.
        views: the body in each camera's image, in the order of the rig's cameras.
        person: id of the body's `Person`; -1 if unassigned.
    """

    id: int
    name: str
    build: str
    T_world_model: Float64
    angles: Float64
    joint_names: tuple[str, ...]
    landmark_names: tuple[str, ...]
    landmarks: Float64
    states: UInt8
    lost: bool
    views: tuple[TrackedBodyView, ...] = ()
    person: int = -1


class Scene(msgspec.Struct, frozen=True, eq=False):
    """The tracker's result for one frame, with that frame's identity, so that it can be reproduced.

    Attributes:
        step: number of the scene, from 0 with each new tracker.
        at_ns: capture time of the frame on the common clock.
        sensor, node_id, sequence: identity of the frame (`SensorFrame`).
        topology: topology of all skeletons in the scene.
        state: state of the tracker.
        parts: the parts, by the name of their type (`mocapella.model.part_types`), each in the order of ids or names.
        sensors: poses of the sensors, in the order of names; empty if the method does not estimate them.
    """

    step: int
    at_ns: int
    sensor: str
    node_id: int
    sequence: int
    topology: Topology
    state: TrackerState
    parts: Mapping[str, tuple[Any, ...]] = {}
    sensors: tuple[SensorPlace, ...] = ()

    def of(self, name: str) -> tuple[Any, ...]:
        """Return the parts of one type; none if the method makes none."""
        return self.parts.get(name, ())

    @property
    def people(self) -> tuple[Person, ...]:
        """The people, in the order of their ids."""
        return self.of("people")

    @property
    def hands(self) -> tuple[TrackedHand, ...]:
        """The hands, in the order of their ids."""
        return self.of("hands")

    @property
    def arms(self) -> tuple[TrackedArm, ...]:
        """The arms, in the order of their ids."""
        return self.of("arms")

    @property
    def bodies(self) -> tuple[TrackedBody, ...]:
        """The fitted bodies, in the order of their ids."""
        return self.of("bodies")

    @property
    def objects(self) -> tuple[TrackedObject, ...]:
        """The objects, in the order of their names."""
        return self.of("objects")

    @property
    def points(self) -> TrackedPoints | None:
        """The triangulated points that hands and objects are computed from; None if the method reports none."""
        return next(iter(self.of("points")), None)

    def with_parts(self, **parts: tuple[Any, ...]) -> Scene:
        """Return a copy of the scene with the parts of some types replaced, by name of the type: ``people=()``."""
        return msgspec.structs.replace(self, parts={**self.parts, **parts})
