"""State of a `PairCalibration` as arrays of fixed size, the names of their indices, and buffers of bodies' frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

# Indices in the state of the pair of sensors. Fading values are multiplied by the moments' factor at every frame.
MOTION: Final = 0
"""Index of the duration of shared motion so far [s]; standing still hardly counts."""
BLOCKS: Final = 1
"""Index of Σf, the fading number of independent samples of weight f; at `BLOCKS_SQ` is Σf²."""
BLOCKS_SQ: Final = 2
COST: Final = 3
"""Index of the fading sum of the residuals, weighted by motion.

At `COST_WEIGHT` is the sum of the weights, at `APART_SQ` that of the centres' squared distances.
"""
COST_WEIGHT: Final = 4
APART_SQ: Final = 5
OFFSET: Final = 6
"""Index of an offset [s] that is added to the one at `REFERENCE_OFFSET`: their sum is b's clock minus a's."""
REFERENCE_OFFSET: Final = 7
CENTRE: Final = 8
"""Index of three numbers: the sum of people's positions in a's frame [m], weighted like `COST`."""
STEPS: Final = 11
BLOCKS_CLOSED: Final = 12
"""Index of the number of independent samples so far, not fading."""
OWN_SD: Final = 13
"""Index of the standard deviation of the estimate where people walk [m]; 0 while it is not trusted. While it is above
0, frames whose two centres are farther apart than usual are left out: a sensor moved, or these are two people.
"""
FOLLOWED: Final = 14
"""Index of the value of `BLOCKS_CLOSED` at the last adjustment of b's clock."""
PAIR_SCALARS: Final = 15

# Indices in the clocks' array of fading sums over blocks, with a = Σ u_a·u_b and g = Σ z·r of `time_offset`.
CLOCK_A: Final = 0
CLOCK_G: Final = 1
CLOCK_AA: Final = 2
"""Index of Σ a² over the blocks; at `CLOCK_AG` is Σ a g, at `CLOCK_GG` Σ g²."""
CLOCK_AG: Final = 3
CLOCK_GG: Final = 4
CLOCK_SUMS: Final = 5

# Indices in the state of a pair of bodies, one in each sensor.
LAST: Final = 0
"""Index of the capture time of the newest frame of a that was processed [s]."""
MIRRORED: Final = 1
ANCHOR: Final = 2
"""Index of three numbers: the body's position at the start of the block of frames that becomes one sample."""
ANCHORED: Final = 5
GRADIENT: Final = 6
"""Index of seven numbers: the gradient summed over the block."""
APART: Final = 13
"""Index of the distance between both views' centres [m]; at `RESIDUAL` is the mean distance of the joints [m]."""
RESIDUAL: Final = 14
DISAGREES_SINCE: Final = 15
"""Index of the time since when the centres are farther apart than usual [s]; NaN if they are not."""
AGREED: Final = 16
"""Index of the total time for which the centres were not farther apart than usual [s]."""
STEP_AT: Final = 17
"""Index of the capture time of the last frame that was compared with the estimate, used or left out [s]."""
BLOCK_A: Final = 18
"""Index of the block's part of `CLOCK_A`; at `BLOCK_G` is that of `CLOCK_G`."""
BLOCK_G: Final = 19
STOOD: Final = 20
"""Index of the time of standing since the block began [s]."""
BODY_SCALARS: Final = 21

FRAMES_KEPT: Final = 48
"""Frames kept per body: 0.4 s of a 120 Hz sensor."""


class PairArrays(NamedTuple):
    """State of a pair of sensors and one pair of their bodies, for the kernels; see `pair_calibration.PairCalibration`.

    Attributes:
        moments: (50,) of `geometry.alignment`.
        scatter: (7, 7) scatter of the gradients of closed blocks.
        T_a_b: (4, 4) the present estimate.
        scalars: (PAIR_SCALARS,) numbers of the pair, by the indices `MOTION` to `FOLLOWED`.
        clock: (CLOCK_SUMS,) sums for the clock offset, by the indices `CLOCK_A` to `CLOCK_GG`.
        body: (BODY_SCALARS,) numbers of the pair of bodies, by the indices `LAST` to `STOOD`.
    """

    moments: Float64
    scatter: Float64
    T_a_b: Float64
    scalars: Float64
    clock: Float64
    body: Float64


class BodyFrames(NamedTuple):
    """Arrays ``times``, ``points``, ``weights`` and ``held`` of a `BodyTrack`, not copied, for the kernels."""

    times: Float64
    points: Float64
    weights: Float64
    held: NDArray[np.int64]


class PairParameters(NamedTuple):
    """Fields of `pair_calibration.PairSettings` as a named tuple of floats, for the kernels."""

    memory_s: float
    first_memory_s: float
    memory_growth: float
    residual_floor_m: float
    mirrored_weight: float
    label_hysteresis_m: float
    full_speed_m_s: float
    still_fraction: float
    velocity_window_s: float
    independent_after_m: float
    moved_factor: float
    moved_least_m: float
    every_s: float
    turned_weight: float


class PairLimits(NamedTuple):
    """Fields of `pair_calibration.PairSettings` that judge an estimate, as a named tuple of floats, for the kernels."""

    residual_floor_m: float
    samples_wanted: float
    position_sd_wanted_m: float
    rotation_sd_wanted: float
    residual_allowed_m: float


def turned_joints(topology: Topology) -> NDArray[np.bool_]:
    """Return which joints (joints,) depth sensors turn towards themselves: shoulders, elbows and hips.

    Those are the paired joints next to the spine, and the next ones of the arms.
    """
    paired = [mirror != joint for joint, mirror in enumerate(topology.mirror)]
    turned = np.zeros(len(topology), dtype=np.bool_)
    shoulders = {topology.parts.get("shoulder_left"), topology.parts.get("shoulder_right")}
    for parent, child in topology.bones:
        turned[child] = paired[child] and (not paired[parent] or child in shoulders or parent in shoulders)
    return turned


NO_LEGS: Final = np.empty((0, 3), dtype=np.int64)
"""Value of `legs_of` for a topology without the joints of legs."""


def legs_of(topology: Topology) -> NDArray[np.int64]:
    """Return the indices (2, 3) of hip, knee and ankle of both legs; (0, 3) if the topology lacks one."""
    names = [[f"{joint}{side}" for joint in ("Hip", "Knee", "Ankle")] for side in ("Left", "Right")]
    if not {*names[0], *names[1]} <= set(topology.joints):
        return NO_LEGS
    return np.array([[topology.index(name) for name in leg] for leg in names], dtype=np.int64)


def new_body(*, mirrored: bool = False) -> Float64:
    """Return the initial state (BODY_SCALARS,) of a pair of bodies; ``mirrored`` if left and right start swapped."""
    body = np.zeros(BODY_SCALARS)
    body[LAST] = body[STEP_AT] = -np.inf
    body[MIRRORED] = mirrored
    body[DISAGREES_SINCE] = np.nan
    return body


@dataclass
class BodyTrack:
    """One sensor's newest frames of one body, in the order of their times.

    Attributes:
        times: (2·kept,) capture times, on the common clock [s]; kept is `FRAMES_KEPT`.
        points: (2·kept, joints, 3) in camera space [m].
        weights: (2·kept, joints), 0 where not seen.
        held: (2,) int64 index of the first stored frame, and index after the last one.
        frozen_since: (1,) time since when no joint has moved at all [s]; NaN if one has.
    """

    times: Float64
    points: Float64
    weights: Float64
    held: NDArray[np.int64]
    frozen_since: Float64

    @classmethod
    def empty(cls, joints: int) -> BodyTrack:
        """Return a track without frames, for a topology with this number of joints."""
        n = 2 * FRAMES_KEPT
        zeros = np.zeros
        return cls(zeros(n), zeros((n, joints, 3)), zeros((n, joints)), zeros(2, dtype=np.int64), np.full(1, np.nan))

    def add(
        self, at: float, positions: Float64, states: NDArray[np.uint8], inferred_weight: float,
        *, legs: NDArray[np.int64] = NO_LEGS,
    ) -> bool:  # fmt: skip
        """Append a frame by copying its values, and drop frames beyond `FRAMES_KEPT`.

        Return False, without a change, if its time is not newer, or not finite.

        Args:
            at: capture time, on the common clock [s].
            positions: (joints, 3) float64, camera space [m]. A joint that is not finite, or exactly at the lens, weighs
                nothing.
            states: (joints,) `JointState`; not tracked weighs nothing.
            inferred_weight: weight of an inferred joint; a tracked one weighs 1.
            legs: of `legs_of`; the joints of a body whose knees are both misplaced weigh no more than inferred ones.
        """
        return bool(
            _kernels().add_frame(
                self.times, self.points, self.weights, self.held, self.frozen_since, at, positions, states,
                inferred_weight, legs,
            )
        )  # fmt: skip

    @cached_property
    def arrays(self) -> BodyFrames:
        """The same arrays as a named tuple, for the kernels."""
        return BodyFrames(self.times, self.points, self.weights, self.held)

    @property
    def newest(self) -> float:
        """Capture time of the newest frame [s]; −inf without any."""
        begin, end = self.held
        return float(self.times[end - 1]) if end > begin else -np.inf


@dataclass
class SensorTracks:
    """One sensor's newest frames of all bodies; a slot of the arrays holds one body, and `bodies` are views of them.

    Attributes:
        ids: (slots,) tracking ids.
        used: (slots,) whether a slot is in use.
        times, points, weights, held, frozen_since: the arrays of `BodyTrack` with a leading axis (slots,).
        frozen: time since when no body of the newest frame has changed at all [s]; NaN if one has, or none is seen.
    """

    ids: NDArray[np.uint64]
    used: NDArray[np.bool_]
    times: Float64
    points: Float64
    weights: Float64
    held: NDArray[np.int64]
    frozen_since: Float64
    frozen: float = np.nan

    def __post_init__(self) -> None:
        parts = (self.times, self.points, self.weights, self.held, self.frozen_since)
        self.bodies = {int(self.ids[i]): BodyTrack(*(part[i] for part in parts)) for i in self._taken()}
        self._slots = {int(self.ids[i]): int(i) for i in self._taken()}
        self._slots_of: dict[tuple[int, ...], NDArray[np.int64]] = {}

    @classmethod
    def empty(cls, joints: int, slots: int = 0) -> SensorTracks:
        """Return tracks without bodies, for a topology with this number of joints; slots are added as needed."""
        n = 2 * FRAMES_KEPT
        zeros = np.zeros
        return cls(
            zeros(slots, dtype=np.uint64),
            zeros(slots, dtype=np.bool_),
            zeros((slots, n)),
            zeros((slots, n, joints, 3)),
            zeros((slots, n, joints)),
            zeros((slots, 2), dtype=np.int64),
            np.full((slots, 1), np.nan),
        )

    def add(
        self, at: float, ids: Sequence[int], positions: Float64, states: UInt8, inferred_weight: float,
        *, legs: NDArray[np.int64] = NO_LEGS,
    ) -> None:  # fmt: skip
        """Append a frame to its bodies' tracks, and make tracks of new bodies.

        New bodies may enlarge the arrays; take tracks from `bodies` anew after each call.

        Args:
            at: capture time, on the common clock [s].
            ids: (bodies,) tracking ids, each once.
            positions, states: (bodies, joints, 3) float64 and (bodies, joints), as in `BodyTrack.add`.
            inferred_weight, legs: as in `BodyTrack.add`.
        """
        key = tuple(ids)
        slots = self._slots_of.get(key)
        if slots is None:
            if new := [body for body in ids if body not in self._slots]:
                self._make_room(new)
            slots = np.array([self._slots[body] for body in ids], dtype=np.int64)
            self._slots_of = {key: slots}
        self.frozen = _kernels().add_bodies(
            self.times, self.points, self.weights, self.held, self.frozen_since, slots, at,
            np.ascontiguousarray(positions), np.ascontiguousarray(states), inferred_weight, legs,
        )  # fmt: skip

    @property
    def arrays(self) -> BodyFrames:
        """The arrays of all slots as a named tuple, for the kernels."""
        return BodyFrames(self.times, self.points, self.weights, self.held)

    @property
    def slots(self) -> Mapping[int, int]:
        """Slots of the bodies, by tracking id; a new object whenever they change."""
        return self._slots

    def newest_centres(self) -> Float64:
        """Return the centre of each body's newest visible joints (bodies, 3), in order of ids [m]; NaN without any."""
        slots = np.array([self._slots[body] for body in sorted(self.bodies)], dtype=np.int64)
        return np.asarray(_kernels().newest_centres(self.points, self.weights, self.held, slots))

    def forget_before(self, at: float) -> None:
        """Drop every body without a frame since a capture time [s]."""
        begin, end = self.held.T
        newest = np.where(end > begin, self.times[np.arange(len(end)), end - 1], -np.inf)
        gone = np.flatnonzero(self.used & (newest < at)).tolist()
        for slot in gone:
            self._free(slot)
        if gone:
            self.__post_init__()

    def clear(self) -> None:
        """Drop every body."""
        self.forget_before(np.inf)

    def _taken(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.used)

    def _free(self, slot: int) -> None:
        self.used[slot] = False
        self.held[slot] = 0
        self.frozen_since[slot] = np.nan

    def _make_room(self, new: Sequence[int]) -> None:
        free = np.flatnonzero(~self.used)
        if len(free) < len(new):
            more = SensorTracks.empty(self.points.shape[2], max(len(new) - len(free), len(self.ids), 2))
            for part in ("ids", "used", "times", "points", "weights", "held", "frozen_since"):
                setattr(self, part, np.concatenate([getattr(self, part), getattr(more, part)]))
            free = np.flatnonzero(~self.used)
        self.ids[free[: len(new)]] = np.array(new, dtype=np.uint64)
        self.used[free[: len(new)]] = True
        self.__post_init__()


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import body_track_kernels

    return body_track_kernels
