"""State of all tracked people, as arrays with one row per person and one column per sensor.

`PeopleMemory` owns the arrays. The named tuples hold the same arrays, or parameters, in the groups that
`mocapella.tracker.people_kernels` takes. This module imports no numba.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import ends_of_lengths
from mocapella.kinematics.articulated_model import ArticulatedModel
from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Rows = NDArray[np.int64]
Ids = NDArray[np.uint64]

GUESS_SD_M_S: Final = 0.1
"""Growth of an inferred joint's least standard deviation with the time since it was measured [m/s]: a sensor that
guesses the legs behind a desk repeats one error in all its frames."""
MOST_GUESS_SD_M: Final = 0.3
"""Largest value of it, about half the reach of a limb [m]."""
UNSURE_SD: Final = 1.2
"""Standard deviation of a facing above which it does not decide which of the sensors is right: about that of two
opposite ones, one three times as likely as the other [rad]."""
UNSURE_S: Final = 5.0
"""Time for which sensors must disagree without a decision until the person says so [s]."""
STRAY_S: Final = 5.0
"""Time constant of averaging how far a view's knees and elbows lie from their place along the limb [s]."""
REPORTED_STRAY: Final = 0.16
"""Average share from which the person has a condition."""


_LONG_BONE: Final = 0.12
"""Least length of a limb's bone, which hands and feet do not have, as a fraction of stature."""


class PointArrays(NamedTuple):
    """State of the joints' Kalman filters.

    Attributes:
        at_s: (people,) time of the state, on the common clock [s].
        positions, velocities: (people, joints, 3) in the space of the people [m], [m/s]; NaN where not known.
        variances: (people, joints, 3) for one coordinate: variance of the position [m²], covariance of position and
            velocity [m²/s], variance of the velocity [m²/s²]; see `mocapella.smoothing.kalman.Points`.
        seen_s: (people, joints) time of the newest view that has the joint [s].
    """

    at_s: Float64
    positions: Float64
    velocities: Float64
    variances: Float64
    seen_s: Float64


class ViewArrays(NamedTuple):
    """Each sensor's newest view of each person; (people, sensors, ...).

    Attributes:
        at_s: capture time on the common clock [s]; −inf where there is no view.
        id: tracking id.
        positions, states, variances: (..., joints, 3) in the space of the people [m], (..., joints) `JointState`,
            (..., joints) variance of a coordinate [m²]; with the sensor's labels.
        noise: (..., joints) learnt noise variance of a coordinate [m²].
        rigidity: (..., 2) noise and size of the sensor's skeletons, see `FrameViews` [ratio].
        bias: (..., joints, 3) correction of the sensor's bias, to add to the positions [m].
        mirrored: whether the fusion exchanges left and right, as the facing filter decides; without it, ``swapped``.
        swapped: whether left and right must be exchanged so that the sensors agree.
        advantage: how much nearer a change of ``swapped`` would bring the view to the other sensors' views, as a mean
            over joints, exponentially averaged [m].
        toward: yaw from the person to the sensor [rad].
        reported: yaw that the view's repaired labels imply [rad].
        turn: (..., 2) correction of the yaw of the shoulders and of the hips [rad].
        offsets: (..., joints, 3) learnt offset, view minus person, with the person's labels [m]; NaN restarts it.
        strays: (..., joints) average distance of each middle joint of a limb beyond its place along the limb, as a
            share of the limb's length, with the sensor's labels [ratio]; 0 for other joints.
    """

    at_s: Float64
    id: Ids
    positions: Float64
    states: UInt8
    variances: Float64
    noise: Float64
    rigidity: Float64
    bias: Float64
    mirrored: Bools
    swapped: Bools
    advantage: Float64
    toward: Float64
    reported: Float64
    turn: Float64
    offsets: Float64
    strays: Float64


class SkeletonArrays(NamedTuple):
    """The fused skeletons.

    Attributes:
        yaw: (people,) facing [rad]; NaN where not known.
        states: (people, joints) `JointState`.
        fused_s: (people,) time of the last fusion of views, on the common clock [s].
        steady: (people, joints, 3) smoothed positions, which the tracker reports [m].
        doubts: (people, joints) variance of a coordinate of ``steady`` [m²].
        unsure_s: (people,) time since which sensors have disagreed about left and right without a decision [s];
            infinite if they do not.
        measured_s: (people, joints) time at which a sensor measured the joint last [s]; −inf if none has.
    """

    yaw: Float64
    states: UInt8
    fused_s: Float64
    steady: Float64
    doubts: Float64
    unsure_s: Float64
    measured_s: Float64


class JointLayout(NamedTuple):
    """Joints of a topology that the kernels treat specially.

    Attributes:
        mirror: (joints,) index of each joint's counterpart on the other side of the body; of a central joint, its own.
        middle: (middle,) indices of the central joints, on the body's middle line.
        ends: (2 · lengths, 2) joints at both ends of each body length, see
            `mocapella.association.proportions.ends_of_lengths`; (0, 2) if the topology lacks one.
        root, head: indices of the skeleton's root joint and of its head.
        lines: (2, 2) left and right shoulder, left and right hip; the shoulders again in a topology without hips.
        line_of: (joints,) 0 for the two shoulders, 1 for the two hips, −1 for all other joints.
        limbs: (limbs, 3) joints of each limb of two long bones, from the trunk: such as hip, knee and ankle.
        shares: (limbs,) length of each limb's first bone as a share of both, of an average person [ratio].
    """

    mirror: Rows
    middle: Rows
    ends: Rows
    root: int
    head: int
    lines: Rows
    line_of: Rows
    limbs: Rows
    shares: Float64


def joint_layout(topology: Topology, model: ArticulatedModel | None = None) -> JointLayout:
    """Return the layout of a topology; its limbs are those of the articulated body, and there are none without it."""
    parts, mirror = topology.parts, np.array(topology.mirror, dtype=np.int64)
    middle = np.flatnonzero(mirror == np.arange(len(mirror))).astype(np.int64)
    ends = ends_of_lengths(topology.joints)
    ends = np.empty((0, 2), dtype=np.int64) if ends is None else ends
    return JointLayout(
        mirror, middle, ends, parts["root"], parts["head"], *_shoulders_and_hips(topology), *_limbs(model)
    )


def _limbs(model: ArticulatedModel | None) -> tuple[Rows, Float64]:
    """Return `JointLayout.limbs` and `JointLayout.shares`: pairs of long bones that meet outside the torso."""
    if model is None:
        return np.empty((0, 3), dtype=np.int64), np.empty(0)
    parent, length, torso = model.joint_table[:, 0], model.joint_values[:, 3], model.joint_values[:, 10] > 0
    ends = [j for j in range(len(parent)) if parent[j] >= 0 and not torso[parent[j]]]
    long = [j for j in ends if min(length[j], length[parent[j]]) > _LONG_BONE]
    limbs = np.array([(parent[parent[j]], parent[j], j) for j in long], dtype=np.int64).reshape(-1, 3)
    first, second = length[limbs[:, 1]], length[limbs[:, 2]]
    return limbs, np.ascontiguousarray(first / (first + second))


def _shoulders_and_hips(topology: Topology) -> tuple[Rows, Rows]:
    """Return the shoulder and hip lines, whose yaw sensors guess; only their joints are turned to the facing.

    Returns:
        (2, 2) left and right joint of the shoulders, and of the hips (or the shoulders again if there are none); and
        (joints,) the line of each joint, −1 for none.
    """
    parts, joints = topology.parts, topology.joints
    shoulders = (parts["shoulder_left"], parts["shoulder_right"])
    there = {"HipLeft", "HipRight"} <= set(joints)
    hips = (topology.index("HipLeft"), topology.index("HipRight")) if there else shoulders
    line_of = [0 if joint in shoulders else 1 if joint in hips else -1 for joint in range(len(joints))]
    return np.array([shoulders, hips]), np.array(line_of)


class SensorBodies(NamedTuple):
    """A frame's bodies, before their assignment to people.

    Attributes:
        ids: (bodies,) tracking ids.
        rows: (bodies,) row of each body's person, each once.
        assigned: whether ``rows`` is given; it is written otherwise.
        column, track_column: column of the sensor in the arrays of the people, and in those of the tracks.
        at_s: capture time on the common clock [s].
        positions: (bodies, joints, 3) in the sensor's own camera space [m]; NaN where not tracked.
        states: (bodies, joints) `JointState`.
        corrections: (bodies, joints, 3) correction of the sensor's bias in that space, to add to ``positions`` [m];
            (0, joints, 3) for none.
        T: (4, 4) from that space to the space of the people.
        clipped: (bodies,) whether the body is cut off at an edge of the image.
        noise, scale_sd: how rigid the sensor's skeletons are, see `mocapella.model.topology.Topology` [ratio].
    """

    ids: Ids
    rows: Rows
    assigned: bool
    column: int
    track_column: int
    at_s: float
    positions: Float64
    states: UInt8
    corrections: Float64
    T: Float64
    clipped: Bools
    noise: float
    scale_sd: float


class FrameViews(NamedTuple):
    """A frame's bodies that are assigned to people.

    Attributes:
        rows: (bodies,) row of each body's person, each once.
        ids: (bodies,) tracking ids.
        column: column of the sensor.
        at_s: capture time on the common clock [s].
        positions: (bodies, joints, 3) in the space of the people, the root sensor's camera space [m]; NaN where not
            tracked.
        states: (bodies, joints) `JointState`.
        own_positions: (bodies, joints, 3) the joints in the sensor's own camera space, which give their distance [m].
        bias: (bodies, joints, 3) correction of the sensor's bias, to add to ``positions`` [m].
        sensor_position: (3,) position of the sensor in the space of the people [m].
        clipped: (bodies,) whether the body is cut off at an edge of the image.
        noise, scale_sd: how rigid the sensor's skeletons are, see `mocapella.model.topology.Topology` [ratio].
    """

    rows: Rows
    ids: Ids
    column: int
    at_s: float
    positions: Float64
    states: UInt8
    own_positions: Float64
    bias: Float64
    sensor_position: Float64
    clipped: Bools
    noise: float
    scale_sd: float


class FacingResults(NamedTuple):
    """The facing filter's results for a frame's bodies, and the inputs they depend on.

    Attributes:
        bodies: (bodies, joints, 3) in a space with y up [m].
        yaw, sd: (bodies,) facing and its standard deviation [rad].
        mirrored: (bodies,) whether the view's left and right must be swapped.
        reported: (bodies,) yaw that the labels imply [rad].
        unlike: (bodies,) how unlike the training data the sensor's views have been lately, 0 to 1.
        toward: (bodies,) yaw from the person to the sensor [rad].
        velocities: (bodies, 3) velocities of the persons, in a space with y up [m/s].
    """

    bodies: Float64
    yaw: Float64
    sd: Float64
    mirrored: Bools
    reported: Float64
    unlike: Float64
    toward: Float64
    velocities: Float64


class PeopleParameters(NamedTuple):
    """The values of `mocapella.tracker.people.PeopleSettings` for the kernels.

    Attributes:
        acceleration_density, forget_after_s, speed_variance: parameters of the Kalman filter, see
            `mocapella.smoothing.kalman.KalmanSettings` [m²/s³], [s], [m²/s²].
        noise_gain, noise_memory_s, view_age_s, speed_memory_s, swap_m, swap_s, turn_s, still_m_s, sure_sd, least_worth:
            the settings of these names.
    """

    acceleration_density: float
    forget_after_s: float
    speed_variance: float
    noise_gain: float
    noise_memory_s: float
    view_age_s: float
    speed_memory_s: float
    swap_m: float
    swap_s: float
    turn_s: float
    still_m_s: float
    sure_sd: float
    least_worth: float


@dataclass
class PeopleMemory:
    """All state that is kept from frame to frame; the names are those in recorded takes.

    The kernels change the arrays in place; an array is not replaced after `points`, `views` or `skeletons` was read.

    Attributes:
        at_s, positions, velocities, variances, seen_s: each person's Kalman state of the joints and its times, see
            `PointArrays` for shapes and units.
        fused_s, steady, doubts, states, yaw, unsure_s, measured_s: the fused and smoothed skeletons that scenes report,
            see `SkeletonArrays`.
        body: (people, …) state of the articulated body.
        euro_positions, euro_velocities, euro_seen_s: (people, joints, 3) [m], (people, joints, 3) [m/s],
            (people, joints) [s]: state of the 1-euro filter.
        view_id: (people, sensors) tracking id of the newest view.
        view_at, view_positions, …: the fields of `ViewArrays`.
    """

    at_s: Float64
    positions: Float64
    velocities: Float64
    variances: Float64
    seen_s: Float64
    fused_s: Float64
    steady: Float64
    doubts: Float64
    states: UInt8
    body: Float64
    euro_positions: Float64
    euro_velocities: Float64
    euro_seen_s: Float64
    view_at: Float64
    view_id: Ids
    view_positions: Float64
    view_states: UInt8
    view_variances: Float64
    view_noise: Float64
    view_bias: Float64
    view_mirrored: Bools
    view_swapped: Bools
    view_advantage: Float64
    yaw: Float64
    view_toward: Float64
    view_reported: Float64
    view_turn: Float64
    view_offsets: Float64
    view_rigidity: Float64 = field(default_factory=lambda: np.empty(0))
    view_strays: Float64 = field(default_factory=lambda: np.empty(0))
    unsure_s: Float64 = field(default_factory=lambda: np.empty(0))
    measured_s: Float64 = field(default_factory=lambda: np.empty(0))

    @classmethod
    def empty(cls, people: int, sensors: int, joints: int, body: int) -> PeopleMemory:
        """Return the memory of ``people`` rows and ``sensors`` columns without data.

        ``joints`` is the number of joints, ``body`` the number of values in an articulated body's state.
        """
        P, V = (people,), (people, sensors)
        return cls(
            at_s=np.full(P, -np.inf),
            positions=np.full((*P, joints, 3), np.nan),
            velocities=np.full((*P, joints, 3), np.nan),
            variances=np.full((*P, joints, 3), np.nan),
            seen_s=np.full((*P, joints), -np.inf),
            fused_s=np.full(P, -np.inf),
            steady=np.full((*P, joints, 3), np.nan),
            doubts=np.full((*P, joints), np.nan),
            states=np.zeros((*P, joints), dtype=np.uint8),
            body=np.full((*P, body), np.nan),
            euro_positions=np.full((*P, joints, 3), np.nan),
            euro_velocities=np.full((*P, joints, 3), np.nan),
            euro_seen_s=np.full((*P, joints), -np.inf),
            view_at=np.full(V, -np.inf),
            view_id=np.zeros(V, dtype=np.uint64),
            view_positions=np.full((*V, joints, 3), np.nan),
            view_states=np.zeros((*V, joints), dtype=np.uint8),
            view_variances=np.full((*V, joints), np.inf),
            view_noise=np.zeros((*V, joints)),
            view_bias=np.zeros((*V, joints, 3)),
            view_mirrored=np.zeros(V, dtype=np.bool_),
            view_swapped=np.zeros(V, dtype=np.bool_),
            view_advantage=np.zeros(V),
            yaw=np.full(P, np.nan),
            view_toward=np.full(V, np.nan),
            view_reported=np.full(V, np.nan),
            view_turn=np.zeros((*V, 2)),
            view_offsets=np.zeros((*V, joints, 3)),
            view_rigidity=np.tile((1.0, 0.0), (*V, 1)),
            view_strays=np.zeros((*V, joints)),
            unsure_s=np.full(P, np.inf),
            measured_s=np.full((*P, joints), -np.inf),
        )

    def check(self, people: int, sensors: int, joints: int, body: int) -> None:
        """Check the arrays of a snapshot; replace those of another version by ones without data.

        These are the attribute ``body``, if it has another size, and ``view_rigidity``, ``view_strays``,
        ``unsure_s`` and ``measured_s``, which older ones do not have.

        The arguments are as in `empty`.

        Raises:
            ValueError: an array has a wrong shape or type; names it.
        """
        empty = PeopleMemory.empty(people, sensors, joints, body)
        if self.body.shape != empty.body.shape and self.body.shape[:1] == (people,):
            self.body = empty.body
        for name in ("view_rigidity", "view_strays", "unsure_s", "measured_s"):
            if getattr(self, name).shape == (0,):
                setattr(self, name, getattr(empty, name))
        for name, wanted in empty.arrays():
            found = getattr(self, name)
            if found.shape != wanted.shape or found.dtype != wanted.dtype:
                raise ValueError(f"{name} is {found.dtype} {found.shape}, not {wanted.dtype} {wanted.shape}")

    def resized(self, rows: Sequence[int], people: int, sensors: int) -> PeopleMemory:
        """Return a copy of another size.

        Args:
            rows: (n,) indices of the rows to keep, which become the first rows.
            people, sensors: numbers of rows and columns; new ones are empty.
        """
        new = PeopleMemory.empty(people, sensors, self.states.shape[1], self.body.shape[1])
        for name, values in self.arrays():
            columns = (slice(values.shape[1]),) if name.startswith("view_") else ()
            getattr(new, name)[(slice(len(rows)), *columns)] = values[list(rows)]
        return new

    def arrays(self) -> list[tuple[str, NDArray[Any]]]:
        """Return the name and the array of each attribute, not copies."""
        return [(one.name, getattr(self, one.name)) for one in fields(self)]

    @cached_property
    def points(self) -> PointArrays:
        """Fields of the Kalman filter, not copies, for the kernels."""
        return PointArrays(self.at_s, self.positions, self.velocities, self.variances, self.seen_s)

    @cached_property
    def views(self) -> ViewArrays:
        """Fields of the views, not copies, for the kernels."""
        return ViewArrays(
            self.view_at, self.view_id, self.view_positions, self.view_states, self.view_variances, self.view_noise,
            self.view_rigidity, self.view_bias, self.view_mirrored, self.view_swapped, self.view_advantage,
            self.view_toward, self.view_reported, self.view_turn, self.view_offsets, self.view_strays,
        )  # fmt: skip

    @cached_property
    def skeletons(self) -> SkeletonArrays:
        """Fields of the fused skeletons, not copies, for the kernels."""
        return SkeletonArrays(
            self.yaw, self.states, self.fused_s, self.steady, self.doubts, self.unsure_s, self.measured_s
        )
