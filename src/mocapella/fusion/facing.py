"""Estimate which way people face, which views are mirrored, and how reliable a view is.

    p        ← turned on(p, Δt)                                         process model: random turns, see `facing_grid`
    log p   += w_yaw·yaw(α, β) + w_shape·shape(α, score)                α = facing − direction to the sensor
    log p   += w_motion·motion(speed, facing − heading)
    facing   = most likely by yaw and motion, on the side that is most likely by all three

Each update processes one sensor's frame. The weights are far below 1 because successive frames repeat the same
evidence; evidence of a source is weighted by the time since its last use, so that fast sensors do not count more. The
facing of a person is estimated, not that of a view. The shape tells front from back, and not the angle: a score between
those of fronts and backs rather means another body than one that is seen from the side. A view is *mirrored*, its left
and right labels exchanged, if it is likely enough that the yaw which they imply is more than 90° off. Bodies unlike the
training data give evidence by their labels only, and little between front and back, so that their labels stay. See
docs/methods/facing.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.fusion.facing_grid import BINS, STEP_S, TURN_RATES, YAWS, turned_on, unknown
from mocapella.fusion.facing_model import FacingModel, shipped_model
from mocapella.fusion.facing_shape import feature_sums, pairs_across
from mocapella.geometry.angles import wrap
from mocapella.model.topology import Topology
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class FacingSettings:
    """Weights of the evidence, and thresholds of mirroring. Chosen by cross-validation over people.

    Attributes:
        yaw_weight: weight of the log-likelihood of a view's yaw; larger: the facing follows the views faster, with more
            false turns [0 to 1].
        shape_weight: weight of the log-likelihood of the body's shape, which tells front from back; larger: a wrong
            facing is corrected sooner, with more false turns [0 to 1].
        motion_weight: weight of the log-likelihood of the motion; if it is larger, people who walk backwards are
            misjudged [0 to 1].
        swap: probability of wrong labels above which a view's left and right are swapped, if another sensor sees the
            person too; they are restored below 0.5; larger: labels are swapped later and more rarely [0.5 to 1].
        swap_alone: as ``swap``, for a person whom no other sensor sees; larger: the sensor's own labels stay for longer
            [0.5 to 1].
        mirrors_from_deg: threshold for a view without a yaw: the angle between facing and the direction to the sensor
            beyond which its labels are mirrored; larger: labels of such views are mirrored more rarely [°].
        hysteresis_deg: half the width of the hysteresis of ``mirrors_from_deg``; larger: labels of views without a yaw
            change more rarely [°].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    yaw_weight: float = 0.1
    shape_weight: float = 0.2
    motion_weight: float = 0.1
    swap: float = 0.8
    swap_alone: float = 0.95
    mirrors_from_deg: float = 130.0
    hysteresis_deg: float = 10.0

    def __post_init__(self) -> None:
        for name in ("yaw_weight", "shape_weight", "motion_weight"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1")
        for name in ("swap", "swap_alone"):
            check(0.5 <= getattr(self, name) < 1, name, getattr(self, name), "from 0.5 to below 1")
        check(0 <= self.hysteresis_deg < 90, "hysteresis_deg", self.hysteresis_deg, "from 0° to below 90°")
        check(90 <= self.mirrors_from_deg <= 180, "mirrors_from_deg", self.mirrors_from_deg, "from 90° to 180°")


class FacingArrays(NamedTuple):
    """The arrays of a `FacingMemory`, not copies, for the kernels, which change them in place.

    Attributes:
        p, p_angle: (people, BINS) probability of each facing, with and without the evidence of shapes.
        at_s: (people,) time of the probabilities [s].
        told_s: (people, 1 + sensors) time of the last evidence from the motion, and from each sensor [s].
        mirrored: (people, sensors) whether the labels were mirrored in the sensor's last frame.
        unlike: (people, sensors) how unlike the training data the sensor's views have been lately, 0 to 1.
    """

    p: Float64
    p_angle: Float64
    at_s: Float64
    told_s: Float64
    mirrored: Bools
    unlike: Float64


class FacingTables(NamedTuple):
    """A `FacingModel` for one topology, for the kernels.

    Attributes:
        tables: (rows, BINS) log-likelihoods of yaw, shape and motion, and the Fourier series of the process model; see
            `mocapella.fusion.facing_kernels.TABLE_ROWS`.
        across: (pairs, 2) indices of left and right joints that give the yaw, in the order of preference.
        joints: (1 + terms, 2) indices of head and SpineBase; then of the feature and the joint of each term, one for
            each joint with a weight in a shape feature (`FEATURES`).
        weights: (terms,) weights of these joints in the features; empty if the model has no shapes for the topology.
        classifier: (4 · features + 1,) means, spreads, linear weights and weights of squares of the features; constant.
    """

    tables: Float64
    across: Int64
    joints: Int64
    weights: Float64
    classifier: Float64


class FacingWeights(NamedTuple):
    """`FacingSettings` for the kernels.

    Attributes:
        yaw, shape, motion: weights of the log-likelihoods.
        hysteresis, mirrors_from: thresholds of mirroring of views without a yaw [rad].
        swap, swap_alone: least probabilities of wrong labels for them to be swapped.
    """

    yaw: float
    shape: float
    motion: float
    hysteresis: float
    mirrors_from: float
    swap: float
    swap_alone: float


class FacingInputs(NamedTuple):
    """What `mocapella.fusion.facing_kernels.update` takes of a `FacingFilter` for a frame.

    Attributes:
        slots: (bodies,) row of each body's person in the memory.
        column: the sensor's column in ``memory.mirrored``.
        zero: yaw of the first bin [rad].
        memory: updated in place.
        model, factors: the facing model's tables, and the weights of the evidence.
    """

    slots: Int64
    column: int
    zero: float
    memory: FacingArrays
    model: FacingTables
    factors: FacingWeights


class FacingMemory(msgspec.Struct, eq=False):
    """State of a `FacingFilter`.

    Attributes:
        people: row of the arrays by person.
        sensors: column of ``mirrored`` by sensor; its column in ``told_s`` is one more.
        zero: yaw of the first bin, in the present world frame [rad].
        p: (people, BINS) probability of each facing.
        at_s: (people,) time of the probabilities, on the common clock [s].
        told_s: (people, 1 + sensors) time of the last evidence from the motion, and from each sensor, on the same
            clock [s].
        mirrored: (people, sensors) whether the labels were mirrored in the sensor's last frame.
        unlike: (people, sensors) how unlike the training data the sensor's views have been lately, 0 to 1.
        p_angle: (people, BINS) as ``p``, without the evidence of shapes; a copy of ``p`` in snapshots without it.
    """

    people: dict[int, int]
    sensors: dict[str, int]
    zero: float
    p: Float64
    at_s: Float64
    told_s: Float64
    mirrored: Bools
    unlike: Float64
    p_angle: Float64 = msgspec.field(default_factory=lambda: np.empty((0, BINS)))

    def __post_init__(self) -> None:
        """Complete a snapshot of a version without ``p_angle``."""
        if self.p_angle.shape != self.p.shape:
            self.p_angle = self.p.copy()


class Repair(msgspec.Struct, frozen=True):
    """A change in whether one sensor's labels of a person are swapped (``person`` is an id, ``sensor`` a name).

    From the capture time ``at_s`` on [s], the left and right labels are swapped if ``mirrored``, else used unchanged.
    """

    person: int
    sensor: str
    at_s: float
    mirrored: bool


class Facings(msgspec.Struct, frozen=True, eq=False):
    """Facings of the people in a frame, in the order of the call's ``people``.

    Attributes:
        yaw: (people,) world, 0 along +z, π/2 along +x [rad].
        sd: (people,) circular standard deviation [rad].
        mirrored: (people,) whether this view's left and right labels must be swapped.
        reported: (people,) yaw that this view's labels imply, swapped if necessary, world [rad]; NaN if too few joints
            of shoulders and hips are seen.
        repairs: changes of ``mirrored`` in this frame.
        unlike: (people,) how unlike the training data this sensor's views have been lately, 0 to 1.
    """

    yaw: Float64
    sd: Float64
    mirrored: Bools
    reported: Float64
    repairs: tuple[Repair, ...]
    unlike: Float64


class PredictedFacings(msgspec.Struct, frozen=True, eq=False):
    """Predicted facings ``yaw`` (people,) and circular standard deviations ``sd`` (people,) [rad].

    An unknown person has yaw NaN and an infinite deviation.
    """

    yaw: Float64
    sd: Float64


class FacingFilter:
    """Histogram filter of the facings of all people; call `update` with each sensor's frame.

    Args:
        topology: names and order of the joints.
        settings: weights and thresholds; the defaults if None.
        model: learnt model; `shipped_model` if None. Shapes learnt on other joints are ignored.

    Attributes:
        memory: its whole state, updated in place. As a snapshot keep a deep copy; assign one to restore it.
    """

    def __init__(
        self, topology: Topology, settings: FacingSettings | None = None, model: FacingModel | None = None
    ) -> None:
        """Create a filter without people; the class describes the arguments."""
        self.settings = settings or FacingSettings()
        self.topology = topology
        self.model = model or shipped_model()
        s = self.settings
        self._tables = _tables(self.model, topology)
        angles = math.radians(s.hysteresis_deg), math.radians(s.mirrors_from_deg)
        factors = float(s.yaw_weight), float(s.shape_weight), float(s.motion_weight)
        self._weights = FacingWeights(*factors, *angles, float(s.swap), float(s.swap_alone))
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.memory = FacingMemory(
            {}, {}, 0.0, np.empty((0, BINS)), np.empty(0), np.empty((0, 1)), np.empty((0, 0), dtype=np.bool_),
            np.empty((0, 0)),
        )  # fmt: skip

    def update(  # noqa: PLR0917 - a frame has as many parts as it has
        self,
        sensor: str,
        people: Sequence[int],
        positions: Float64,
        toward_sensor: Float64,
        at_s: float,
        velocities: Float64,
    ) -> Facings:
        """Update the facings of the people in a sensor's frame; unknown people begin with all facings equally likely.

        A body whose yaw or direction to the sensor is unknown is no evidence: its person's facing is only predicted.

        Args:
            sensor: name of the sensor.
            people: (bodies,) id of each body's person; each person at most once.
            positions: (bodies, joints, 3) with the sensor's own labels, world, y up [m]; NaN where not seen.
            toward_sensor: (bodies,) yaw from the person to the sensor, world [rad]; NaN where unknown.
            at_s: capture time on the common clock [s]; for a person it never decreases: an earlier one counts as the
                person's last one.
            velocities: (bodies, 3) world [m/s]; NaN where unknown.

        Raises:
            ValueError: an array has another shape, or the time is not finite.
        """
        bodies = len(people)
        positions = np.ascontiguousarray(positions, dtype=np.float64)
        toward = np.ascontiguousarray(toward_sensor, dtype=np.float64)
        velocities = np.ascontiguousarray(velocities, dtype=np.float64)
        shapes = (positions.shape, toward.shape, velocities.shape)
        if shapes != ((bodies, len(self.topology), 3), (bodies,), (bodies, 3)):
            raise ValueError(f"arrays of {bodies} people and {len(self.topology)} joints were expected, not {shapes}")
        if not math.isfinite(at_s):
            raise ValueError(f"a frame at {at_s} s; the time must be finite")
        inputs, out = self.inputs(sensor, people, at_s), np.empty((5, bodies))
        changed = _kernels().update(
            inputs.slots, inputs.column, positions, toward, float(at_s), velocities, inputs.zero, inputs.memory,
            inputs.model, inputs.factors, out,
        )  # fmt: skip
        mirrored = inputs.memory.mirrored[inputs.slots, inputs.column]
        repairs: tuple[Repair, ...] = ()
        if changed:
            which = np.flatnonzero(out[3]).tolist()
            repairs = tuple(Repair(people[n], sensor, float(at_s), bool(mirrored[n])) for n in which)
        return Facings(out[0], out[1], mirrored, out[2], repairs, out[4])

    def inputs(self, sensor: str, people: Sequence[int], at_s: float) -> FacingInputs:
        """Return what the kernel takes for a frame of these people, each at most once; unknown ones are new.

        The arguments are as in `update`.
        """
        slots, column = self._slots(people, at_s), self._column(sensor)
        m = self.memory
        memory = FacingArrays(m.p, m.p_angle, m.at_s, m.told_s, m.mirrored, m.unlike)
        return FacingInputs(slots, column, m.zero, memory, self._tables, self._weights)

    def predicted(self, people: Sequence[int], at_s: float) -> PredictedFacings:
        """Predict the facings of people at the time ``at_s`` on the common clock [s], without changing the state.

        For a time before a person's last frame, the prediction is the last estimate.
        """
        m, out = self.memory, np.empty((2, len(people)))
        slots = np.array([m.people.get(person, -1) for person in people], dtype=np.int64)
        memory = FacingArrays(m.p, m.p_angle, m.at_s, m.told_s, m.mirrored, m.unlike)
        _kernels().predict(slots, float(at_s), m.zero, memory, self._tables.tables, out)
        return PredictedFacings(out[0], out[1])

    def forget(self, kept: Collection[int]) -> None:
        """Forget all people except those in ``kept``; unknown ids in it are ignored."""
        memory = self.memory
        if memory.people.keys() <= set(kept):
            return
        rows = {person: row for person, row in memory.people.items() if person in kept}
        self._keep_rows(rows)

    def join(self, stays: int, gone: int) -> None:
        """Merge two tracks of one person under the id ``stays``; the id ``gone`` is forgotten.

        The probabilities of both are multiplied, as independent evidence. If only ``gone`` is known, it is renamed; if
        ``gone`` is unknown, nothing changes.
        """
        memory = self.memory
        other = memory.people.get(gone)
        if other is None or stays == gone:
            return
        one = memory.people.get(stays)
        if one is None:
            memory.people = {stays if person == gone else person: row for person, row in memory.people.items()}
            return
        pair = [one, other]
        at_s = memory.at_s[pair].max()
        steps = (at_s - memory.at_s[pair]) / STEP_S
        for of_all in (memory.p, memory.p_angle):
            p = np.prod(turned_on(of_all[pair], steps), axis=0)
            of_all[one] = p / p.sum()
        memory.at_s[one] = at_s
        later = memory.told_s[other, 1:] > memory.told_s[one, 1:]
        memory.mirrored[one] = np.where(later, memory.mirrored[other], memory.mirrored[one])
        memory.unlike[one] = np.where(later, memory.unlike[other], memory.unlike[one])
        memory.told_s[one] = np.maximum(memory.told_s[one], memory.told_s[other])
        self._keep_rows({person: row for person, row in memory.people.items() if person != gone})

    def rotate(self, angle: float) -> None:
        """Change to a world frame where all yaws are larger by ``angle`` [rad]; later arguments must be in it."""
        self.memory.zero = float(wrap(self.memory.zero + angle))

    def _keep_rows(self, rows: dict[int, int]) -> None:
        memory, kept = self.memory, np.array(list(rows.values()), dtype=np.int64)
        memory.people = {person: row for row, person in enumerate(rows)}
        memory.p, memory.p_angle, memory.at_s = memory.p[kept], memory.p_angle[kept], memory.at_s[kept]
        memory.told_s, memory.mirrored = memory.told_s[kept], memory.mirrored[kept]
        memory.unlike = memory.unlike[kept]

    def _slots(self, people: Sequence[int], at_s: float) -> Int64:
        """Return the rows of people (people,); unknown ones get a new row."""
        memory = self.memory
        new = [person for person in people if person not in memory.people]
        if new:
            memory.people |= {person: len(memory.people) + n for n, person in enumerate(new)}
            n, sensors = len(new), len(memory.sensors)
            memory.p = np.concatenate([memory.p, np.broadcast_to(unknown(), (n, BINS))])
            memory.p_angle = np.concatenate([memory.p_angle, np.broadcast_to(unknown(), (n, BINS))])
            memory.at_s = np.concatenate([memory.at_s, np.full(n, at_s)])
            memory.told_s = np.concatenate([memory.told_s, np.full((n, 1 + sensors), -np.inf)])
            memory.mirrored = np.concatenate([memory.mirrored, np.zeros((n, sensors), dtype=np.bool_)])
            memory.unlike = np.concatenate([memory.unlike, np.zeros((n, sensors))])
        return np.array([memory.people[person] for person in people], dtype=np.int64)

    def _column(self, sensor: str) -> int:
        """Return the sensor's column; an unknown one gets a new column."""
        memory = self.memory
        if sensor not in memory.sensors:
            rows = len(memory.people)
            memory.sensors[sensor] = len(memory.sensors)
            memory.told_s = np.concatenate([memory.told_s, np.full((rows, 1), -np.inf)], axis=1)
            memory.mirrored = np.concatenate([memory.mirrored, np.zeros((rows, 1), dtype=np.bool_)], axis=1)
            memory.unlike = np.concatenate([memory.unlike, np.zeros((rows, 1))], axis=1)
        return memory.sensors[sensor]


def _tables(model: FacingModel, topology: Topology) -> FacingTables:
    """Return a model's tables for a topology."""
    k = _kernels()
    m = np.arange(BINS // 2 + 1)
    tables = np.zeros((k.TABLE_ROWS, BINS))
    tables[k.YAW_AT : k.SHAPE_AT] = model.yaw.T
    tables[k.MOTION_AT : k.WAVES_AT] = model.motion
    share = np.where((m == 0) | (m == BINS // 2), 1.0, 2.0) / BINS
    tables[k.WAVES_AT : k.RATES_AT] = share[:, None] * np.cos(m[:, None] * YAWS)
    tables[k.RATES_AT, : len(m)] = TURN_RATES
    tables[k.COS_AT :] = np.cos(YAWS), np.sin(YAWS)
    across = np.array(pairs_across(topology))
    sums, classifier = feature_sums(topology), model.classifier
    if sums is None or classifier is None or model.shape is None or model.topology != topology.name:
        return FacingTables(tables, across, np.zeros((1, 2), dtype=np.int64), np.empty(0), np.empty(0))
    tables[k.SHAPE_AT : k.MOTION_AT] = model.shape.T
    terms = np.argwhere(sums != 0)
    joints = np.concatenate([[(topology.index("Head"), topology.index("SpineBase"))], terms])
    joints = np.ascontiguousarray(joints)  # as the kernels are compiled for
    numbers = np.concatenate([classifier.mean, classifier.spread, classifier.weights])
    return FacingTables(tables, across, joints, sums[sums != 0], numbers)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.fusion import facing_kernels

    return facing_kernels
