"""Fuse each person's views into one skeleton, and smooth it.

    views     = see(frame)              each sensor's newest view of each person
    labels    = facing(views)           repair mirrored labels, weight views by direction
    measured  = fuse(views)             one skeleton per person
    steady    = smooth(measured)        filter; the prediction is part of the estimate

State is in arrays with one row per person and one column per sensor (`mocapella.tracker.people_memory`), so a frame
takes one compiled call, however many bodies it has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import LENGTHS
from mocapella.association.tracks import UNFINISHED, TrackInputs
from mocapella.errors import one_of
from mocapella.fusion.facing import FacingFilter, FacingSettings
from mocapella.fusion.joint_bias import BiasInputs, JointBiasModel
from mocapella.fusion.weighted_mean import FusionSettings
from mocapella.geometry.rigid import apply
from mocapella.kernel_calls import KernelCall
from mocapella.kinematics.articulated_body import conditions_of, words_of
from mocapella.kinematics.articulated_model import ArticulatedModel, ArticulatedSettings, memory_size
from mocapella.model.bodies import Bodies, BodyKey
from mocapella.model.observations import BodyFrame
from mocapella.model.scene import PotentialSkeleton
from mocapella.model.session import SensorPose
from mocapella.model.topology import Topology
from mocapella.settings import check
from mocapella.smoothing.kalman import KalmanSettings
from mocapella.smoothing.one_euro import OneEuroSettings
from mocapella.tracker.people_memory import (
    REPORTED_STRAY,
    UNSURE_S,
    Bools,
    Float64,
    PeopleMemory,
    PeopleParameters,
    Rows,
    SensorBodies,
    UInt8,
    joint_layout,
)

MISPLACED: Final = "seen at a wrong place along the limb: move the sensor, or what hides the limb from it"
UNSURE: Final = "sensors disagree about left and right: stand upright, or turn the chest to one of them"
SMOOTHING: Final = ("articulated", "kalman", "one-euro")
"""Smoothing methods: an articulated body, a Kalman filter per joint, or a 1-euro filter per coordinate."""


@dataclass(frozen=True)
class PeopleSettings:
    """How views are fused and smoothed.

    Attributes:
        fusion: weights of views.
        motion: Kalman filter of the joints.
        one_euro: 1-euro filter.
        body: articulated body.
        smoothing: ``articulated`` reports a body fitted with the settings ``people.body``; ``kalman`` reports the
            Kalman filter of ``people.motion``, which predicts joints in any case; ``one-euro`` filters joints with the
            settings ``people.one_euro``.
        view_age_s: age of the oldest view that is used; larger: a sensor's gaps are bridged for longer [s].
        speed_memory_s: time constant of the decay of an unseen joint's predicted velocity; larger: it is extrapolated
            farther [s].
        facing: estimation of people's facing, which repairs mirrored labels; None uses the labels on which the sensors
            agree.
        noise_gain: factor of a joint's learnt noise variance, which is added to its variance in a view; larger:
            noisy joints count less [ratio].
        noise_memory_s: time constant of learning a joint's noise [s].
        turn_s: time constant of turning a view's shoulders and hips to the facing; larger: smoother, and later after a
            change [s].
        still_m_s: a person slower than this stands still: if the labels then change, the old ones were wrong, and the
            view's offset is learnt anew, so that it begins at the person's position [m/s].
        sure_sd: largest standard deviation of a facing that changes labels and turns views fully; up to twice as much,
            views are turned in part; larger: uncertain facings are used, too [rad].
        least_worth: weight of a view from the side, along the line of the shoulders, relative to a frontal one; larger:
            views from the side count more [0 to 1].
        swap_m: a view's left and right are exchanged if that brings it nearer to the other views by this; used by the
            joint bias, and by the fusion if ``people.facing`` is None; larger: labels change more rarely [m].
        swap_s: time constant over which that distance is averaged; larger: labels change later and more rarely [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
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


class People:
    """Fuses and smooths the views of all tracked people, whom `mocapella.association.tracks.Tracks` identifies.

    For each frame: `column`, `update`, then `results`. `update` also assigns the bodies; where that needs more than one
    frame's costs: `prepare`, the association, `join` of merged tracks, `arrange`, and `update` with its result.
    The *space of the people*, the frame of reference of all state, is chosen by the caller.

    Args:
        settings: how views are fused and smoothed.
        topology: names and order of the joints.

    Attributes:
        numbers: (people,) ids of the persons, by row.
        sensors: names of the sensors, by column.
        memory: state of all people; changed in place, and replaced if rows or columns change.
        mirror: (joints,) index of each joint's counterpart on the other side.
        middle: (middle,) indices of the joints on the body's middle line.
        R_level: (3, 3) rotation from the space of the people to one with y up, see `level`.
    """

    def __init__(self, settings: PeopleSettings, topology: Topology) -> None:
        self.settings = settings
        self.topology = topology
        self._parameters = _parameters(settings)
        self._model = ArticulatedModel.of(topology, settings.body) if settings.smoothing == "articulated" else None
        self._layout = joint_layout(topology, self._model)
        self.mirror, self.middle = self._layout.mirror, self._layout.middle
        self._body_size, self._slack, self._body_arrays = 0, (0, 0), None
        if self._model is not None:
            layout, self._body_arrays = self._model.layout, self._model.arrays
            self._body_size, self._slack = memory_size(self._model), (int(layout.slack), int(layout.demands))
        self._facing = None if settings.facing is None else FacingFilter(topology, settings.facing)
        self.reset()

    def reset(self) -> None:
        """Forget all people and sensors, and the upward direction, which is y again."""
        self.R_level = np.eye(3)
        self.numbers: list[int] = []
        self.sensors: list[str] = []
        self.memory = PeopleMemory.empty(0, 0, len(self.mirror), self._body_size)
        if self._facing is not None:
            self._facing.reset()

    def state(self) -> tuple[Any, ...]:
        """Return all state, for `restore`; not a copy: it changes with the next update."""
        facing = None if self._facing is None else self._facing.memory
        return self.numbers, self.sensors, self.memory, facing, self.R_level

    def restore(self, state: tuple[Any, ...]) -> None:
        """Replace all state by what `state` returned.

        Bodies of another version's model are fitted anew.

        Raises:
            ValueError: an array has a wrong shape or type.
        """
        self.numbers, self.sensors, self.memory, facing, R_level = state
        if R_level.shape != (3, 3) or R_level.dtype != np.float64:
            raise ValueError(f"R_level is {R_level.dtype} {R_level.shape}, not float64 (3, 3)")
        self.R_level = np.ascontiguousarray(R_level)
        self.memory.check(len(self.numbers), len(self.sensors), len(self.mirror), self._body_size)
        if self._facing is not None:
            self._facing.memory = facing

    def prepare(self, bodies: Bodies, T: Float64, at_s: float) -> Prepared:
        """Compute the inputs of association for a frame, without changing the state.

        Args:
            bodies: the sensor's bodies, in its camera space.
            T: (4, 4) from the sensor's camera space to the space of the people.
            at_s: time for which people are predicted, on the common clock [s].
        """
        m, count = self.memory, len(bodies.ids)
        middle = (len(self.middle), 3)
        prepared = Prepared(
            np.empty((count, *middle)),
            np.full((count, len(LENGTHS)), np.nan),
            np.empty((len(self.numbers), *middle)),
        )
        _kernels().prepare(
            np.ascontiguousarray(T), np.ascontiguousarray(bodies.positions), self._layout, at_s,
            self.settings.motion.forget_after_s, m.points,
            np.empty(bodies.positions.shape), prepared.middles, prepared.lengths, prepared.expected,
        )  # fmt: skip
        return prepared

    def corrections(self, model: JointBiasModel, bodies: Bodies, rows: Rows, T: Float64, at_s: float) -> Float64:
        """Return corrections of the sensor's joint bias for a frame's bodies, from the people's present state.

        Args:
            model: joint bias of the same topology.
            bodies: the sensor's bodies.
            rows: (bodies,) row of each body's person in the previous frames; −1 for none.
            T: (4, 4) from the sensor's camera space to the space of the people.
            at_s: the newest capture time so far, on the common clock [s].

        Returns:
            (bodies, joints, 3) to add in the sensor's camera space, with its labels [m]; 0 for bodies without a person,
            for a person whose position, velocity or direction is unknown, and before the sensor's first `update`.
        """
        m, out = self.memory, np.zeros(bodies.positions.shape)
        if bodies.sensor not in self.sensors or not bodies.ids:
            return out
        inputs = BiasInputs(m.positions, m.velocities, m.view_at, m.view_positions, m.view_swapped)
        _bias_kernels().corrections(
            rows, self.sensors.index(bodies.sensor), model.flat, np.ascontiguousarray(T), self.R_level, at_s,
            self.settings.view_age_s, self.mirror, self._layout.lines, self._layout.root, inputs, out,
        )  # fmt: skip
        return out

    def column(self, sensor: str) -> int:
        """Return the sensor's column; an unknown one gets a new column."""
        if sensor not in self.sensors:
            self.sensors = [*self.sensors, sensor]
            rows = range(len(self.numbers))
            self.memory = self.memory.resized(rows, len(rows), len(self.sensors))
        return self.sensors.index(sensor)

    @cached_property
    def _step(self) -> KernelCall:
        return KernelCall(_step_kernels().assign_and_step)

    def update(self, frame: SensorBodies, tracks: TrackInputs, at_s: float) -> int:
        """Process one frame: assign its bodies, predict all people, and fuse and smooth those in the frame.

        `results` returns the people. Bodies whose rows are not given are assigned to the tracks, which have the same
        rows. Where that is not the whole assignment, nobody is fused: see the events that are returned.

        Args:
            frame: the frame's bodies; may be empty.
            tracks: the tracks, which are updated if the bodies are assigned here.
            at_s: the newest capture time so far, on the common clock; all people are predicted to it [s].

        Returns:
            Events of the frame, see `mocapella.association.tracks.UNFINISHED`: after one of these, nobody was updated.
        """
        s, m, facing = self.settings, self.memory, None
        if self._facing is not None:
            facing = self._facing.inputs(self.sensors[frame.column], self.numbers, frame.at_s)
        fused = np.empty(frame.positions.shape)
        events: int = self._step(
            frame, tracks, at_s, self._parameters, s.fusion.parameters, self._layout, self.R_level, m.points, m.views,
            m.skeletons, facing, self._body_arrays, m.body, fused,
        )  # fmt: skip
        if s.smoothing == "one-euro" and not events & UNFINISHED:
            e = s.one_euro
            _kernels().smooth_people(
                frame.rows, m.euro_positions, m.euro_velocities, m.euro_seen_s, fused, at_s,
                e.min_cutoff_hz, e.beta_per_m, e.speed_cutoff_hz, e.forget_after_s, s.view_age_s, m.steady,
            )  # fmt: skip
        return events

    def results(self, T: Float64, at_s: float, sensor: str = "") -> PeopleResults:
        """Return all people and the views in use, in new arrays; the state does not change.

        Args:
            T: (4, 4) from the space of the people to the space of the results.
            at_s: present time on the common clock, for the age of views [s].
            sensor: the sensor whose views are wanted; empty for all.
        """
        column = self.sensors.index(sensor) if sensor in self.sensors else -1
        m = self.memory
        people, sensors, joints = m.view_positions.shape[:3]
        results = PeopleResults(
            np.empty((people, joints, 3)),
            np.empty((people, joints), dtype=np.float32),
            np.empty((people, joints), dtype=np.uint8),
            np.empty((sensors if column < 0 else 1, people, joints, 3)),
            np.empty((people, sensors), dtype=np.bool_),
            np.empty(people, dtype=np.bool_),
        )
        _step_kernels().report(
            np.ascontiguousarray(T), at_s, self.settings.view_age_s, m.skeletons, m.view_at, m.view_positions,
            m.view_strays, m.body, self._slack, column, results.positions, results.sd, results.states, results.views,
            results.fresh, results.noted,
        )  # fmt: skip
        return results

    def views_of(
        self, results: PeopleResults, sensor: str, time_ns: int, pose: BodyFrame | SensorPose, T: Float64
    ) -> list[PotentialSkeleton]:
        """Return a sensor's view of each row of people, for a scene; arbitrary where ``results.fresh`` is False.

        Args:
            results: of `results`, from this state.
            sensor: name of a known sensor.
            time_ns: capture time of its newest frame, in the sensor's clock [ns].
            pose: tilt and height of the sensor.
            T: (4, 4) from the sensor's space to the space of the results.
        """
        m, column = self.memory, self.sensors.index(sensor)
        own = results.views[column if len(results.views) > 1 else 0]
        views = zip(
            m.view_id[:, column].tolist(), own, m.view_states[:, column].copy(),
            m.view_mirrored[:, column].tolist(), strict=True,
        )  # fmt: skip
        return [
            PotentialSkeleton(sensor, body, time_ns, pose.tilt, pose.height, T, positions, states, mirrored)
            for body, positions, states, mirrored in views
        ]

    def conditions(self, results: PeopleResults) -> list[str]:
        """Return a text for each row: sensors that disagree about sides, joints long measured beyond the body's limits.

        It also names knees and elbows that a sensor in use has long seen at a wrong place along the limb. The text is
        empty without any of these; joints need an articulated body. ``results`` are those of the present state.
        """
        said = [""] * len(self.numbers)
        if True not in results.noted.tolist():
            return said
        m = self.memory
        if self._model is not None:
            said = conditions_of(self._model, m.body)
        for row in np.flatnonzero(m.fused_s - m.unsure_s > UNSURE_S).tolist():
            said[row] = ", ".join(filter(None, (UNSURE, said[row])))
        stray = results.fresh[..., None] & (np.abs(m.view_strays) > REPORTED_STRAY)
        for row, column in zip(*np.nonzero(stray.any(axis=-1)), strict=True):
            own = np.flatnonzero(stray[row, column])
            those = self.mirror[own] if m.view_mirrored[row, column] else own
            joints = " and ".join(words_of(self.topology.joints[j]) for j in those.tolist())
            said[row] = ", ".join(filter(None, (said[row], f"{self.sensors[column]}: {joints} {MISPLACED}")))
        return said

    def swapped(self) -> frozenset[BodyKey]:
        """Return (sensor, tracking id) of the views whose left and right must be swapped so that the sensors agree."""
        m = self.memory
        rows, columns = np.nonzero(m.view_swapped & np.isfinite(m.view_at))
        return frozenset((self.sensors[c], int(m.view_id[r, c])) for r, c in zip(rows, columns, strict=True))

    def move(self, T_new_old: Float64) -> None:
        """Transform all state by ``T_new_old`` (4, 4) into another frame of reference, the new space of the people."""
        m, R = self.memory, np.ascontiguousarray(T_new_old[:3, :3])
        self.R_level = self.R_level @ R.T
        for name in ("positions", "steady", "euro_positions", "view_positions"):
            getattr(m, name)[:] = apply(T_new_old, getattr(m, name))
        if self._model is not None:
            _kernels().move(self._model.layout, m.body, T_new_old)
        for name in ("velocities", "euro_velocities", "view_offsets", "view_bias"):
            getattr(m, name)[:] = getattr(m, name) @ R.T

    def move_sensors(self, sensors: Sequence[str], T_new_old: Float64) -> None:
        """Move sensors' views after their poses were refined; people follow gradually.

        Args:
            sensors: names; unknown ones are ignored.
            T_new_old: (sensors, 4, 4) from the old to the new positions in the space of the people.
        """
        known = [(self.sensors.index(name), i) for i, name in enumerate(sensors) if name in self.sensors]
        if known:
            columns, which = np.array(known, dtype=np.int64).T
            T = np.ascontiguousarray(T_new_old[which])
            _kernels().move_views(np.ascontiguousarray(columns), T, self.mirror, self.memory.views)

    def level(self, R_level: Float64) -> None:
        """Set the rotation ``R_level`` (3, 3) from the space of the people to one with y up."""
        turned = R_level @ self.R_level.T
        if self._facing is not None and turned[1, 1] < 0.0:
            self._facing.reset()  # facings were seen upside down, where right and left are exchanged
        elif self._facing is not None:
            self._facing.rotate(float(np.arctan2(turned[0, 2], turned[0, 0])))
        self.R_level = np.ascontiguousarray(R_level)

    def arrange(self, numbers: Sequence[int]) -> None:
        """Set the rows to the people ``numbers``, in that order: known people first, then new ones; drop all others."""
        if self.numbers == numbers:
            return
        known = set(self.numbers)
        kept = [self.numbers.index(number) for number in numbers if number in known]
        self.memory = self.memory.resized(kept, len(numbers), len(self.sensors))
        if len(kept) < len(known) and self._facing is not None:
            self._facing.forget(numbers)
        self.numbers = list(numbers)

    def join(self, stays: int, gone: int) -> None:
        """Merge two tracks of one person under the number ``stays``.

        The person's state is that of the track seen last; each sensor's view is the newer of the two. The number
        ``gone`` is dropped.

        Raises:
            ValueError: one of the numbers is unknown.
        """
        one, other = self.numbers.index(stays), self.numbers.index(gone)
        seen_s = self.memory.view_at
        newer, last = seen_s[other] > seen_s[one], seen_s[other].max() > seen_s[one].max()
        for name, values in self.memory.arrays():
            if name.startswith("view_"):
                values[one, newer] = values[other, newer]
            elif last:
                values[one] = values[other]
        if self._facing is not None:
            self._facing.join(stays, gone)
        self.arrange([number for number in self.numbers if number != gone])


def _parameters(s: PeopleSettings) -> PeopleParameters:
    """Return the settings as floats for the kernels, which another type would compile again."""
    numbers = (
        s.motion.acceleration_density, s.motion.forget_after_s, s.motion.speed_sd**2, s.noise_gain, s.noise_memory_s,
        s.view_age_s, s.speed_memory_s, s.swap_m, s.swap_s, s.turn_s, s.still_m_s, s.sure_sd, s.least_worth,
    )  # fmt: skip
    return PeopleParameters(*map(float, numbers))


class Prepared(msgspec.Struct, frozen=True, eq=False):
    """Inputs of association for a frame.

    Attributes:
        middles: (bodies, middle joints, 3) the joints on the body's middle line, which have no left and right, in the
            space of the people [m]; NaN where not tracked.
        lengths: (bodies, lengths) body lengths, see `mocapella.association.proportions` [m]; NaN where not known.
        expected: (people, middle joints, 3) predicted for all people [m]; NaN where not known.
    """

    middles: Float64
    lengths: Float64
    expected: Float64


class PeopleResults(msgspec.Struct, frozen=True, eq=False):
    """All people, by row.

    Attributes:
        positions: (people, joints, 3) smoothed positions [m]; NaN where not known.
        sd: (people, joints) float32, standard deviation of a coordinate [m]; NaN where not known.
        states: (people, joints) `JointState`.
        views: (sensors, people, joints, 3) each sensor's view, with its own labels [m], or the wanted sensor's alone;
            arbitrary where ``fresh`` is False.
        fresh: (people, sensors) whether the view is in use.
        noted: (people,) whether the person may have a condition, for `People.conditions`.
    """

    positions: Float64
    sd: NDArray[np.float32]
    states: UInt8
    views: Float64
    fresh: Bools
    noted: Bools


@cache
def _kernels() -> Any:
    """Return the compiled steps; numba is imported at the first use."""
    from mocapella.tracker import people_kernels

    return people_kernels


@cache
def _step_kernels() -> Any:
    """Return the compiled step of a frame."""
    from mocapella.tracker import people_step_kernels

    return people_step_kernels


@cache
def _bias_kernels() -> Any:
    """Return the compiled joint bias, which is used only with a model."""
    from mocapella.fusion import joint_bias_kernels

    return joint_bias_kernels
