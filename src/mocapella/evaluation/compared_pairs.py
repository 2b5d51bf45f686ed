"""Simulated pairs of a recording and a reference of one motion, and the errors of their comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.comparison.comparison import compared
from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.model.observations import JointState
from mocapella.model.resampling import resampled
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
        correlation_s: time in which the recording's noise forgets itself; 0 for white noise; larger: slower noise [s].
        sensors: number of sensors, each of ``rate_hz``, whose frames the recording's results follow in turn.
        view_bias_m: scatter of constant distances of each joint in one sensor's results; larger: sensors that agree
            less [m].
        lag_s: scatter of the sensors' own lags; larger: sensors that agree less about the time [s].
        itself: whether the reference is an export of the recording at ``rate_hz``, on another clock and in another
            space.
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
    correlation_s: float = 0.0
    sensors: int = 1
    view_bias_m: float = 0.0
    lag_s: float = 0.0
    itself: bool = False


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
    at, sensors = _times(own, rng)
    theirs = np.arange(shift + rng.uniform(-2.0, 3.0), shift + own.seconds + rng.uniform(-3.0, 2.0), 1.0 / rate)
    T = rigid(Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix(), rng.normal(scale=1.5, size=3))
    periods, phases = np.array([7.0, 11.3, 23.0]), rng.uniform(0.0, 2 * np.pi, 3)

    def in_room(times: Float64) -> Float64:
        """Return the room's times: a person moves now faster, now slower, so the motion never repeats."""
        waves = np.sin(2 * np.pi * times[:, None] / periods + phases) * periods
        return np.asarray(times + begin + _CHANGE / (2 * np.pi) * waves.sum(axis=1))

    lags = rng.normal(scale=own.lag_s, size=own.sensors) if own.lag_s else np.zeros(own.sensors)
    x = _positions(room, in_room(at - lags[sensors]))
    y = apply(inverse(T), _positions(room, in_room((theirs - shift) / ratio)))
    y = y + rng.normal(scale=own.marker_m, size=y.shape[1:]) + rng.normal(scale=own.reference_noise_m, size=y.shape)
    x = x + _noise(at, x.shape, own, rng)
    if own.view_bias_m:
        x = x + rng.normal(scale=own.view_bias_m, size=(own.sensors, *x.shape[1:]))[sensors]
    _spoil(x, own, rng)
    order = rng.permutation(x.shape[1])
    people = {f"person_{i}": f"subject_{int(np.flatnonzero(order == i)[0])}" for i in range(x.shape[1])}
    joints = room.topology.joints
    recording = replace(_made(at, x, tuple(people), joints, own.rate_hz), sensors=sensors)
    if own.itself:
        same = resampled(recording, own.rate_hz).moved(inverse(T))
        theirs, y, rate = ratio * same.times_s + shift, same.positions.astype(np.float64), own.rate_hz
    reference = _made(theirs, y[:, order], tuple(f"subject_{k}" for k in range(len(order))), joints, rate)
    if not own.clock:
        ratio, shift = ratio * rate, (shift - theirs[0]) * rate
        reference = _made(np.arange(len(theirs), dtype=np.float64), reference.positions, reference.individuals, joints,
                          math.nan)  # fmt: skip
    return SimulatedPair(recording, reference, ratio, shift, T, people)


def _times(own: ComparedPairSettings, rng: np.random.Generator) -> tuple[Float64, NDArray[np.int64]]:
    """Return the times of the recording's results [s], and the number of each one's sensor."""
    regular = np.arange(0.0, own.seconds, 1.0 / own.rate_hz)
    phases = rng.uniform(0.0, 1.0 / own.rate_hz, own.sensors) if own.sensors > 1 else np.zeros(1)
    at = np.concatenate([regular + phase for phase in phases])
    at = at + rng.uniform(-0.002, 0.002, len(at))
    order = np.argsort(at)
    return at[order], np.repeat(np.arange(own.sensors), len(regular))[order]


def _noise(at: Float64, shape: tuple[int, ...], own: ComparedPairSettings, rng: np.random.Generator) -> Float64:
    """Return noise of the recording's coordinates: white, or of a Gauss-Markov process [m]."""
    out = rng.normal(scale=own.noise_m, size=shape)
    if own.correlation_s:
        kept = np.exp(-np.diff(at) / own.correlation_s)
        for k, share in enumerate(kept.tolist(), 1):
            out[k] = share * out[k - 1] + math.sqrt(1.0 - share**2) * out[k]
    return np.asarray(out)


def _spoil(x: Float64, own: ComparedPairSettings, rng: np.random.Generator) -> None:
    """Add outliers and gaps to the recording's positions, in place."""
    wrong = rng.random(x.shape[:3]) < own.outlier_share
    x[wrong] += rng.normal(scale=0.3, size=(int(wrong.sum()), 3))
    x[rng.random(x.shape[:3]) < own.gap_share] = np.nan
    frames = len(x)
    for k in range(0, x.shape[2], 3):
        first = int(rng.integers(0, frames))
        x[first : first + int(0.6 * frames / own.seconds), :, k] = np.nan


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
