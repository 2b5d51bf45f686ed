"""Each person's views brought to one instant, made one skeleton, and kept steady.

    views     = see(frame)              each sensor's newest view of a person
    labels    = facing(views)           which of them have left and right mirrored, and what each is worth
    measured  = fuse(views)             one skeleton of them
    steady    = smooth(measured)        the prediction is part of the estimate

Everything is in arrays with a row for each person and a column for each sensor, so that a frame costs a few compiled
calls, however many bodies it shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import LENGTHS, ends_of_lengths
from mocapella.errors import one_of
from mocapella.fusion.facing import FacingFilter, FacingSettings
from mocapella.fusion.joint_bias import JointBiasModel
from mocapella.fusion.weighted_mean import FusionSettings
from mocapella.geometry.rigid import apply
from mocapella.kinematics.articulated_model import ArticulatedModel, ArticulatedSettings, memory_size
from mocapella.model.bodies import Bodies, BodyKey
from mocapella.model.topology import Topology
from mocapella.settings import check
from mocapella.smoothing.kalman import KalmanSettings
from mocapella.smoothing.one_euro import OneEuroSettings

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Rows = NDArray[np.int64]

SMOOTHING: Final = ("articulated", "kalman", "one-euro")
"""What makes a skeleton steady: a body with joints and bones, a filter for each point, or one for each coordinate."""


@dataclass(frozen=True)
class PeopleSettings:
    """How views become people.

    Attributes:
        fusion: what a view is worth.
        motion: how people move.
        one_euro: the filter of that name.
        body: the articulated body.
        smoothing: which of `SMOOTHING` makes the skeleton steady.
        view_age_s: a view older than this is no longer used.
        speed_memory_s: time constant with which a joint that nobody sees comes to rest [s].
        facing: how it is found which way people face; None does without: labels are those on which the sensors agree.
        noise_gain: how much a joint's own noise in a view, which is learnt, adds to its variance.
        noise_memory_s: time constant with which it is learnt [s].
        turn_s: time constant with which a view's shoulders and hips follow the facing [s].
        still_m_s: the speed of somebody who stands is below this.
        sure_sd: of a facing that may change labels; from here to twice as much, less and less is turned [rad].
        least_worth: of a view that looks along the shoulders, against one from the front.
        swap_m: how much nearer a view must be to the person with left and right swapped, before they are.
        swap_s: time constant over which that is judged.
    """

    fusion: FusionSettings = field(default_factory=FusionSettings)
    motion: KalmanSettings = field(default_factory=KalmanSettings)
    one_euro: OneEuroSettings = field(default_factory=OneEuroSettings)
    body: ArticulatedSettings = field(default_factory=ArticulatedSettings)
    smoothing: str = "articulated"
    view_age_s: float = 0.12
    speed_memory_s: float = 0.2
    facing: FacingSettings | None = field(default_factory=FacingSettings)
    noise_gain: float = 5.0
    noise_memory_s: float = 1.0
    turn_s: float = 0.05
    still_m_s: float = 0.1
    sure_sd: float = 0.6
    least_worth: float = 0.2
    swap_m: float = 0.02
    swap_s: float = 0.1

    def __post_init__(self) -> None:
        known = self.smoothing in SMOOTHING
        check(known, "smoothing", self.smoothing, one_of(self.smoothing, SMOOTHING))
        for name in ("view_age_s", "speed_memory_s", "noise_memory_s", "turn_s", "still_m_s", "sure_sd", "swap_s"):
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "above 0")
        for name in ("noise_gain", "swap_m"):
            check(0 <= getattr(self, name) < 1e6, name, getattr(self, name), "0 or more")
        check(0 < self.least_worth <= 1, "least_worth", self.least_worth, "above 0, up to 1")


@dataclass
class PeopleMemory:
    """All that is remembered, a row for each person; of views a column for each sensor.

    Attributes:
        at_s: (people,) the instant of the points [s].
        positions, velocities, variances, seen_s: (people, joints, ...) of `mocapella.smoothing.kalman.Points`.
        fused_s: (people,) when views were last fused.
        steady: (people, joints, 3) what is told of them [m].
        doubts: (people, joints) variance of a coordinate of it [m²].
        states: (people, joints) `JointState`.
        body: (people, …) of the articulated body.
        euro_positions, euro_velocities, euro_seen_s: (people, joints, ...) of the 1-euro filter.
        view_at: (people, sensors) when the newest view was captured, on the common clock [s]; −inf where there is none.
        view_id: (people, sensors) its tracking id.
        view_positions, view_states, view_variances: (people, sensors, joints, ...) with the sensor's own labels [m].
        view_bias: (people, sensors, joints, 3) what is to be added to them against the sensor's bias [m].
        view_noise: (people, sensors, joints) variance of a coordinate by which its joints jump, slowly learnt [m²].
        view_mirrored: (people, sensors) whether left and right are swapped in it.
        view_swapped: (people, sensors) whether left and right are to be swapped so that it agrees with the others.
        view_advantage: (people, sensors) how much nearer to the person the labels not in use have been lately [m].
        yaw: (people,) which way they face; NaN where not known [rad].
        view_toward: (people, sensors) yaw from the person to the sensor [rad].
        view_reported: (people, sensors) the yaw that its labels say once they are repaired [rad].
        view_turn: (people, sensors, 2) by how much its shoulders, and its hips, are turned [rad].
        view_offsets: (people, sensors, joints, 3) from the person, slowly learnt; in the person's
            labels; NaN where it is to begin where the person is [m].
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
    view_id: NDArray[np.uint64]
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

    @classmethod
    def empty(cls, people: int, sensors: int, joints: int, body: int) -> PeopleMemory:
        """Nothing is known of anybody."""
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
        )

    def taken(self, rows: Sequence[int], people: int, sensors: int) -> PeopleMemory:
        """A memory of its own, of other size, that begins with these rows."""
        new = PeopleMemory.empty(people, sensors, self.states.shape[1], self.body.shape[1])
        for name, values in vars(self).items():
            columns = (slice(values.shape[1]),) if name.startswith("view_") else ()
            getattr(new, name)[(slice(len(rows)), *columns)] = values[list(rows)]
        return new


class People:
    """The bodies of all who are known.

    Attributes:
        numbers: (people,) of the persons, by row.
        sensors: names, by column.
        memory: see there.
    """

    def __init__(self, settings: PeopleSettings, topology: Topology) -> None:
        self.settings = settings
        self.topology = topology
        self.mirror = np.array(topology.mirror, dtype=np.int64)
        self.middle = np.flatnonzero(self.mirror == np.arange(len(topology))).astype(np.int64)
        self._root = topology.parts["root"]
        ends = ends_of_lengths(topology.joints)
        self._ends = np.empty((0, 2), dtype=np.int64) if ends is None else ends
        motion = settings.motion
        self._numbers = (
            *(motion.acceleration_density, motion.forget_after_s, settings.noise_gain, settings.noise_memory_s),
            *(settings.view_age_s, settings.swap_m, settings.swap_s, settings.speed_memory_s),
        )
        self._lines, self._line_of = _shoulders_and_hips(topology)
        self._model = ArticulatedModel.of(topology, settings.body) if settings.smoothing == "articulated" else None
        self._facing = None if settings.facing is None else FacingFilter(topology, settings.facing)
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self.R_level, self.up = np.eye(3), np.array([0.0, 1.0, 0.0])
        self.numbers: list[int] = []
        self.sensors: list[str] = []
        self.memory = PeopleMemory.empty(0, 0, len(self.mirror), 0 if self._model is None else memory_size(self._model))
        if self._facing is not None:
            self._facing.reset()

    def remembered(self) -> tuple[Any, ...]:
        """All that it remembers, for `remember`."""
        facing = None if self._facing is None else self._facing.memory
        return self.numbers, self.sensors, self.memory, facing, self.R_level

    def remember(self, memory: tuple[Any, ...]) -> None:
        """What `remembered` gave, and nothing else."""
        self.numbers, self.sensors, self.memory, facing, self.R_level = memory
        self.up = np.ascontiguousarray(self.R_level[1])
        if self._facing is not None:
            self._facing.memory = facing

    def prepare(self, bodies: Bodies, T: Float64, at_s: float) -> Prepared:
        """What association asks for.

        Args:
            bodies: that a sensor shows.
            T: (4, 4) from its camera space to the space of the people.
            at_s: the instant for which people are expected.
        """
        m, count, joints = self.memory, len(bodies.ids), len(self.mirror)
        prepared = Prepared(
            np.empty((count, joints, 3)),
            np.empty((count, len(self.middle), 3)),
            np.full((count, len(LENGTHS)), np.nan),
            np.empty((len(self.numbers), len(self.middle), 3)),
        )
        _kernels().prepare(
            np.ascontiguousarray(T), np.ascontiguousarray(bodies.positions), self._ends, self.middle, at_s,
            self.settings.motion.forget_after_s, m.at_s, m.positions, m.velocities, m.seen_s,
            prepared.positions, prepared.middles, prepared.lengths, prepared.expected,
        )  # fmt: skip
        return prepared

    def corrections(self, model: JointBiasModel, bodies: Bodies, rows: Rows, T: Float64, at_s: float) -> Float64:
        """What to add to the joints of a frame's bodies against the sensor's bias, as far as people are known.

        Args:
            model: of the same joints.
            bodies: that the sensor shows.
            rows: (bodies,) of whoever they were taken for before; −1 of nobody.
            T: (4, 4) from its camera space to the space of the people.
            at_s: the newest capture there was, on the common clock [s].

        Returns:
            (bodies, joints, 3) in its camera space, with its labels [m]; 0 of who is not known.
        """
        m, out = self.memory, np.zeros(bodies.positions.shape)
        if bodies.sensor not in self.sensors or not bodies.ids:
            return out
        _bias_kernels().corrections(
            rows, self.sensors.index(bodies.sensor), model.flat, np.ascontiguousarray(T), self.R_level, at_s,
            self.settings.view_age_s, self.mirror, self._lines, self._root,
            m.positions, m.velocities, m.view_at, m.view_positions, m.view_swapped, out,
        )  # fmt: skip
        return out

    def update(self, sights: Sights, at_s: float) -> None:
        """Take in one frame: whom it shows, and how.

        Args:
            sights: see there.
            at_s: the newest capture there was so far, on the common clock; everybody is brought there [s].
        """
        s, kernels, rows, column = self.settings, _kernels(), sights.rows, self._column(sights.sensor)
        m, fusion = self.memory, s.fusion.vector
        bodies, toward, velocities, dts = kernels.observe(
            rows, column, at_s, sights.at_s, self._numbers, fusion, self.mirror, self._root, self.R_level,
            sights.positions, sights.states, sights.own_positions, sights.bias, sights.sensor_position, sights.clipped,
            m.at_s, m.positions, m.velocities, m.variances, m.seen_s,
            m.view_at, m.view_positions, m.view_states, m.view_variances, m.view_noise, m.view_bias, m.view_swapped,
            m.view_advantage,
        )  # fmt: skip
        m.view_id[rows, column] = sights.ids
        if self._facing is None:
            m.view_mirrored[rows, column] = m.view_swapped[rows, column]
        elif len(rows):
            people = [self.numbers[row] for row in rows.tolist()]
            f = self._facing.update(sights.sensor, people, bodies, toward, sights.at_s, velocities)
            kernels.turn_views(
                rows, column, dts, s.turn_s, s.sure_sd, bodies, self._lines,
                f.yaw, f.sd, f.mirrored, f.reported, toward, velocities, s.still_m_s,
                m.yaw, m.view_mirrored, m.view_toward, m.view_reported, m.view_turn, m.view_offsets,
            )  # fmt: skip
        measured, doubts = kernels.make(
            rows, len(self.sensors), at_s, s.view_age_s, self.mirror, self._line_of, self.up, self._root, s.least_worth,
            fusion, s.motion.speed_sd**2, m.yaw,
            m.at_s, m.positions, m.velocities, m.variances, m.seen_s, m.states, m.fused_s, m.steady, m.doubts,
            m.view_at, m.view_positions, m.view_states, m.view_variances, m.view_bias, m.view_mirrored,
            m.view_toward, m.view_reported, m.view_turn, m.view_offsets,
        )  # fmt: skip
        if self._model is not None:
            kernels.pose_people(rows, self._model.arrays, m.body, measured, doubts, at_s, m.steady, m.doubts)
        if s.smoothing == "one-euro":
            e = s.one_euro
            kernels.smooth_people(
                rows, m.euro_positions, m.euro_velocities, m.euro_seen_s, measured, at_s,
                e.min_cutoff_hz, e.beta_per_m, e.speed_cutoff_hz, e.forget_after_s, s.view_age_s, m.steady,
            )  # fmt: skip

    def told(self, T: Float64, at_s: float) -> Told:
        """Everybody as told in another space, to which ``T`` (4, 4) moves, with the views that are in use at a time."""
        m = self.memory
        told = _kernels().tell(
            np.ascontiguousarray(T), at_s, self.settings.view_age_s, m.steady, m.doubts, m.view_at, m.view_positions
        )
        return Told(*told)

    def swapped(self) -> frozenset[BodyKey]:
        """The views whose left and right are to be swapped so that the sensors agree."""
        m = self.memory
        rows, columns = np.nonzero(m.view_swapped & np.isfinite(m.view_at))
        return frozenset((self.sensors[c], int(m.view_id[r, c])) for r, c in zip(rows, columns, strict=True))

    def move(self, T_new_old: Float64) -> None:
        """Everything is told in another frame from now on."""
        m, R = self.memory, np.ascontiguousarray(T_new_old[:3, :3])
        self.R_level = self.R_level @ R.T
        self.up = np.ascontiguousarray(self.R_level[1])
        for name in ("positions", "steady", "euro_positions", "view_positions"):
            getattr(m, name)[:] = apply(T_new_old, getattr(m, name))
        if self._model is not None:
            _kernels().move(self._model.layout, m.body, T_new_old)
        for name in ("velocities", "euro_velocities", "view_offsets", "view_bias"):
            getattr(m, name)[:] = getattr(m, name) @ R.T

    def place_anew(self, sensor: str, T_new_old: Float64) -> None:
        """A sensor's place has become better known: its views are there now, and people glide instead of jumping."""
        if sensor not in self.sensors:
            return
        m, column = self.memory, self.sensors.index(sensor)
        _kernels().place_anew(
            column, np.ascontiguousarray(T_new_old), self.mirror, m.view_mirrored, m.view_positions, m.view_offsets
        )

    def level(self, R_level: Float64) -> None:
        """The rotation from the space of the people to one in which y is up has become known, or better known."""
        turned = R_level @ self.R_level.T
        if self._facing is not None:
            self._facing.rotate(float(np.arctan2(turned[0, 2], turned[0, 0])))
        self.R_level = np.ascontiguousarray(R_level)
        self.up = np.ascontiguousarray(R_level[1])

    def arrange(self, numbers: Sequence[int]) -> None:
        """A row for each of these people, in this order: those who are known and after them who is new, nobody else."""
        if self.numbers == numbers:
            return
        known = set(self.numbers)
        kept = [self.numbers.index(number) for number in numbers if number in known]
        self.memory = self.memory.taken(kept, len(numbers), len(self.sensors))
        if len(kept) < len(known) and self._facing is not None:
            self._facing.forget(numbers)
        self.numbers = list(numbers)

    def join(self, stays: int, gone: int) -> None:
        """Two turned out to be one: everything is as with the one seen last, and the views are both's."""
        one, other = self.numbers.index(stays), self.numbers.index(gone)
        seen_s = self.memory.view_at
        newer, last = seen_s[other] > seen_s[one], seen_s[other].max() > seen_s[one].max()
        for name, values in vars(self.memory).items():
            if name.startswith("view_"):
                values[one, newer] = values[other, newer]
            elif last:
                values[one] = values[other]
        if self._facing is not None:
            self._facing.join(stays, gone)
        self.arrange([number for number in self.numbers if number != gone])

    def _column(self, sensor: str) -> int:
        if sensor not in self.sensors:
            self.sensors = [*self.sensors, sensor]
            rows = range(len(self.numbers))
            self.memory = self.memory.taken(rows, len(rows), len(self.sensors))
        return self.sensors.index(sensor)


def _shoulders_and_hips(topology: Topology) -> tuple[Rows, Rows]:
    """The lines that say the yaw, which sensors guess rather than see: no other joints are moved by turning it.

    Returns:
        (2, 2) left and right of the shoulders, and of the hips, or of the shoulders again where there are none; and
        (joints,) the line of each joint, −1 of none.
    """
    parts, joints = topology.parts, topology.joints
    shoulders = (parts["shoulder_left"], parts["shoulder_right"])
    there = {"HipLeft", "HipRight"} <= set(joints)
    hips = (topology.index("HipLeft"), topology.index("HipRight")) if there else shoulders
    line_of = [0 if joint in shoulders else 1 if joint in hips else -1 for joint in range(len(joints))]
    return np.array([shoulders, hips]), np.array(line_of)


class Prepared(msgspec.Struct, frozen=True, eq=False):
    """A frame's bodies as association needs them.

    Attributes:
        positions: (bodies, joints, 3) in the space of the people [m].
        middles: (bodies, middle joints, 3) of them those in the middle, which have no left and right.
        lengths: (bodies, lengths) of `mocapella.association.proportions` [m].
        expected: (people, middle joints, 3) where everybody's are expected [m]; NaN where nobody knows.
    """

    positions: Float64
    middles: Float64
    lengths: Float64
    expected: Float64


class Told(msgspec.Struct, frozen=True, eq=False):
    """Everybody, by row.

    Attributes:
        positions: (people, joints, 3) [m].
        sd: (people, joints) float32, of a coordinate [m].
        views: (people, sensors, joints, 3) as each sensor saw them [m]; only of those in use.
        fresh: (people, sensors) whether that view is in use.
    """

    positions: Float64
    sd: NDArray[np.float32]
    views: Float64
    fresh: Bools


class Sights(msgspec.Struct, frozen=True, eq=False):
    """What a frame shows of people.

    Attributes:
        sensor: whose frame it is.
        rows: (bodies,) of the persons in the memory, each once.
        ids: (bodies,) tracking ids.
        at_s: when it was captured, on the common clock.
        positions: (bodies, joints, 3) [m]; NaN where not tracked.
        states: (bodies, joints) `JointState`.
        own_positions: (bodies, joints, 3) the same in the sensor's own camera space, which say how far away it is [m].
        bias: (bodies, joints, 3) what is to be added to the positions against the sensor's bias [m].
        sensor_position: (3,) [m].
        clipped: (bodies,) whether the body is cut off at an edge of the picture.
    """

    sensor: str
    rows: Rows
    ids: Sequence[int]
    at_s: float
    positions: Float64
    states: UInt8
    own_positions: Float64
    bias: Float64
    sensor_position: Float64
    clipped: Bools


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.tracker import people_kernels

    return people_kernels


@cache
def _bias_kernels() -> Any:
    """Likewise; needed only where a joint bias is known."""
    from mocapella.fusion import joint_bias_kernels

    return joint_bias_kernels
