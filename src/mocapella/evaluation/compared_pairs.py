"""Simulated pairs of a recording and a reference of one motion, and the errors of their comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.comparison.comparison import compared
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories
from mocapella.sources.simulate import load_scene

Float64 = NDArray[np.float64]

SCENES: Final = ("walk", "squats", "sit", "wave", "bend", "steps", "obstacle")
"""Scenes whose motion is compared; the last one has two people, who are matched by their motion."""
_CHANGE: Final = 0.12
"""Relative change of the speed of motion by each of three waves."""
RATES_HZ: Final = (50.0, 60.0, 100.0, 120.0, 200.0)


@dataclass(frozen=True)
class ComparedPairSettings:
    """How a pair is simulated.

    Attributes:
        seconds: length of the recording; larger: more to estimate from [s].
        rate_hz: rate of the recording [Hz].
        noise_m: noise of a coordinate of the recording; larger: less certain [m].
        reference_noise_m: noise of a coordinate of the reference; larger: less certain [m].
        drift: largest relative difference of the clocks; larger: clocks that differ more.
        outlier_share: share of the recording's samples that are about 0.3 m off; larger: more outliers.
        gap_share: share of the recording's samples that are missing, beside a gap of 0.6 s of each third joint;
            larger: more gaps.
        marker_m: scatter of constant distances between the two's joints; larger: farther from joint centres [m].
        clock: whether the reference has times.
    """

    seconds: float = 20.0
    rate_hz: float = 30.0
    noise_m: float = 0.015
    reference_noise_m: float = 0.002
    drift: float = 1e-3
    outlier_share: float = 0.02
    gap_share: float = 0.03
    marker_m: float = 0.0
    clock: bool = True


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """A recording and a reference with their ground truth.

    Attributes:
        recording, reference: the two.
        ratio, shift_s: reference time = ratio · recording time + shift; in frames without a clock.
        T: (4, 4) rigid motion from the reference to the recording.
        people: individual of the reference by individual of the recording.
    """

    recording: Trajectories
    reference: Trajectories
    ratio: float
    shift_s: float
    T: Float64
    people: dict[str, str]


def simulated_pair(scene: str, seed: int, settings: ComparedPairSettings | None = None) -> SimulatedPair:
    """Simulate a pair; a seed gives another part of the scene's motion, and other clocks, spaces and noise."""
    own = settings or ComparedPairSettings()
    rng = np.random.default_rng([seed, SCENES.index(scene)])
    room = load_scene(scene)
    begin = rng.uniform(0, room.duration_s)
    ratio, shift = 1.0 + rng.uniform(-own.drift, own.drift), rng.uniform(-3.0, 3.0)
    rate = float(rng.choice(RATES_HZ))
    at = np.arange(0.0, own.seconds, 1.0 / own.rate_hz)
    at = np.sort(at + rng.uniform(-0.002, 0.002, len(at)))
    theirs = np.arange(shift + rng.uniform(-2.0, 3.0), shift + own.seconds + rng.uniform(-3.0, 2.0), 1.0 / rate)
    T = rigid(Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix(), rng.normal(scale=1.5, size=3))
    periods, phases = np.array([7.0, 11.3, 23.0]), rng.uniform(0.0, 2 * np.pi, 3)

    def in_room(times: Float64) -> Float64:
        """Return the room's times: a person moves now faster, now slower, so the motion never repeats."""
        waves = np.sin(2 * np.pi * times[:, None] / periods + phases) * periods
        return np.asarray(times + begin + _CHANGE / (2 * np.pi) * waves.sum(axis=1))

    x = _positions(room, in_room(at))
    y = apply(inverse(T), _positions(room, in_room((theirs - shift) / ratio)))
    y = y + rng.normal(scale=own.marker_m, size=y.shape[1:]) + rng.normal(scale=own.reference_noise_m, size=y.shape)
    x = x + rng.normal(scale=own.noise_m, size=x.shape)
    wrong = rng.random(x.shape[:3]) < own.outlier_share
    x[wrong] += rng.normal(scale=0.3, size=(int(wrong.sum()), 3))
    x[rng.random(x.shape[:3]) < own.gap_share] = np.nan
    for k in range(0, x.shape[2], 3):
        first = int(rng.integers(0, len(at)))
        x[first : first + int(0.6 * own.rate_hz), :, k] = np.nan
    order = rng.permutation(x.shape[1])
    people = {f"person_{i}": f"subject_{int(np.flatnonzero(order == i)[0])}" for i in range(x.shape[1])}
    joints = room.topology.joints
    reference = _made(theirs, y[:, order], tuple(f"subject_{k}" for k in range(len(order))), joints, rate)
    if not own.clock:
        ratio, shift = ratio * rate, (shift - theirs[0]) * rate
        reference = _made(np.arange(len(theirs), dtype=np.float64), reference.positions, reference.individuals, joints,
                          math.nan)  # fmt: skip
    return SimulatedPair(_made(at, x, tuple(people), joints, own.rate_hz), reference, ratio, shift, T, people)


def _positions(room: object, at_s: Float64) -> Float64:
    """Return the joints (times, people, joints, 3) in a room [m]."""
    return np.stack([room.positions_at(round(t * NS_PER_S)) for t in at_s.tolist()])  # type: ignore[attr-defined]


def _made(
    at: Float64, x: NDArray[np.floating], names: tuple[str, ...], joints: tuple[str, ...], rate_hz: float
) -> Trajectories:
    known = np.isfinite(x).all(axis=3)
    states = np.where(known, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8)
    sd = np.full(known.shape, np.nan, np.float32)
    return Trajectories("people", at, np.zeros(len(at), np.int64), names, joints, x, states, sd, rate_hz=rate_hz)


@dataclass(frozen=True)
class PairErrors:
    """Errors of a comparison.

    Attributes:
        offset_s: error of the time in the middle [s].
        ratio: relative error of the clocks' ratio.
        angle_deg, shift_m: error of the rotation [°], and of the position of the joints' centre [m].
        normalised: errors in standard deviations that the comparison states: of the offset, the ratio, and the mean
            square ones of the rotation and the position.
        people_right: whether the individuals are matched rightly.
    """

    offset_s: float
    ratio: float
    angle_deg: float
    shift_m: float
    normalised: tuple[float, float, float, float] = field(default=(math.nan,) * 4)
    people_right: bool = True


def errors_of(pair: SimulatedPair) -> PairErrors:
    """Compare a simulated pair, and return the errors of the time map and the rigid motion.

    Raises:
        SettingsError, EvaluationError: as in `mocapella.comparison.comparison.compared`.
    """
    found = compared({"people": pair.recording}, {"people": pair.reference})
    motion = found.motion
    offset = (motion.reference_middle_s - pair.ratio * motion.middle_s - pair.shift_s) / pair.ratio
    ratio = motion.ratio / pair.ratio - 1.0
    turn = Rotation.from_matrix(motion.T[:3, :3] @ pair.T[:3, :3].T).as_rotvec()
    centre = apply(inverse(pair.T), motion.centre_m[None])
    shift = apply(motion.T, centre)[0] - motion.centre_m
    normalised = (
        offset / motion.offset_sd_s, ratio / motion.ratio_sd,
        float(np.sqrt(np.mean((turn / motion.rotation_sd) ** 2))),
        float(np.sqrt(np.mean((shift / motion.translation_sd_m) ** 2))),
    )  # fmt: skip
    return PairErrors(
        offset, ratio, math.degrees(float(np.linalg.norm(turn))), float(np.linalg.norm(shift)), normalised,
        found.people == pair.people,
    )  # fmt: skip
