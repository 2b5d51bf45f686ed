"""Cost of an articulated body, and its accuracy on real walks beside the filters of `smoothing`.

The real rows are of the study logs: the front sensor's own view, and the mean of both sensors' views (the other brought
over by the rigid motion that fits Stationary and Steps, its left and right exchanged where that is nearer by 2 cm).
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, at_most, measured, median_seconds
from benchmarks.tracker import recordings
from mocapella.evaluation import fused_metrics
from mocapella.evaluation.study_pairs import StudySession, study_sessions
from mocapella.geometry.alignment import align, moments
from mocapella.geometry.rigid import apply
from mocapella.kinematics.articulated_body import ArticulatedBody
from mocapella.kinematics.articulated_memory import Rigidity
from mocapella.model.topology import topology
from mocapella.smoothing.kalman import KalmanSettings, correct, predict, unknown
from mocapella.smoothing.one_euro import OneEuro

Float64 = NDArray[np.float64]
Method = Callable[[Float64, Float64], Float64]

KINECT: Final = topology("kinect_v2")
MIRROR: Final = list(KINECT.mirror)
SD_M: Final = 0.015
STATIONARY, STEPS, WALK = 1, 2, 3
FRAMES: Final = 300


def run(quick: bool = False) -> list[Row]:
    rows = [*cost(quick)]
    folder = recordings() / "kinectmultitrack"
    if not folder.is_dir():
        warnings.warn(f"no walk measured: {folder} is not there (MOCAPELLA_DATA names another place)", stacklevel=2)
        return rows
    found: dict[tuple[str, str, str], list[float]] = {}
    for session in study_sessions(folder, [7] if quick else range(10)):
        for source, task, at_s, joints in sequences(session):
            for name, method in METHODS.items():
                for figure, value in figures(task, at_s, joints, method(at_s, joints)):
                    found.setdefault((source, figure, name), []).append(value)
    goals = {"stationary jitter [mm]": 3.0, "foot slide [cm/s]": 14.0, "shoulder collapse [%]": 6.5, "lag [ms]": 33.0}
    for (source, figure, name), values in sorted(found.items()):
        unit = figure[figure.index("[") + 1 : -1]
        goal = at_most(goals[figure]) if figure in goals and name == "articulated" and source == "both" else None
        what = f"articulated: {source}, {figure[: figure.index(' [')]}, {name}"
        rows.append(measured(what, float(np.nanmean(values)), unit, goal=goal))
    return rows


def cost(quick: bool) -> Iterator[Row]:
    """One person and frame, called from compiled code as a tracker does."""
    from numba import njit

    from mocapella.kinematics import articulated_kernels as kernels

    correct_one, predict_one, rigidity = kernels.correct, kernels.predict, Rigidity(1.0, 0.0)

    @njit
    def corrected(arrays: Any, row: Any, begin: float, frames: Any, variances: Any, x: Any, v: Any) -> None:
        for k in range(len(frames)):
            correct_one(arrays, row, begin + k / 30, frames[k], variances, rigidity, x, v)

    @njit
    def predicted(arrays: Any, row: Any, begin: float, count: int, x: Any, v: Any) -> None:
        for k in range(count):
            predict_one(arrays, row, begin + 0.001 * (k % 30), x, v)

    body = ArticulatedBody(KINECT)
    frames = walker(FRAMES)
    x, v, variances = np.empty((25, 3)), np.empty(25), np.full(25, SD_M**2)
    arrays, row, begin = body.model.arrays, body.memory[0], [0.0]

    def follow() -> None:
        corrected(arrays, row, begin[0], frames, variances, x, v)
        begin[0] += FRAMES / 30

    for name, call, goal in (
        ("correct", follow, at_most(20)),
        ("predict", lambda: predicted(arrays, row, begin[0] - 1 / 30, FRAMES, x, v), None),
    ):
        call()
        value = 1e6 * median_seconds(call, repeat=5, number=2 if quick else 20) / FRAMES
        yield measured(f"articulated: {name}, a person and frame, 25 joints", value, "µs", goal=goal)


def walker(frames: int) -> Float64:
    """Return a simulated walker (frames, 25, 3), with noise [m]."""
    from mocapella.sources.simulate.scenes import load_scene

    room, rng = load_scene("walk"), np.random.default_rng(0)
    truth = np.stack([room.positions_at(k * 33_333_333)[0] for k in range(frames)])
    return np.asarray(truth + rng.normal(0, 0.01, truth.shape))


def sequences(session: StudySession) -> Iterator[tuple[str, int, Float64, Float64]]:
    """Source, task, times and joints (frames, 25, 3) of a session of one person."""
    rows, task = session.pairs.rows, session.pairs.task
    front = session.replay.sensors.index("front")
    sensors = session.sensor[rows]
    apart = sensors[:, 0] != sensors[:, 1]
    rows, task, sensors = rows[apart], task[apart], sensors[apart]
    calibrating = np.isin(task, (STATIONARY, STEPS))
    if session.two_people or calibrating.sum() < 50:
        return
    mine = np.where(sensors[:, 0] == front, rows[:, 0], rows[:, 1])
    other = np.where(sensors[:, 0] == front, rows[:, 1], rows[:, 0])
    own, at_s, theirs = session.raw[mine], session.at_s[mine], session.raw[other]
    p, q = own[calibrating].reshape(-1, 3), theirs[calibrating].reshape(-1, 3)
    weights = np.ones(len(p))
    for _ in range(15):  # least distances, not squares
        T = align(moments(p, q, weights))
        weights = 1 / np.maximum(np.linalg.norm(p - apply(T, q), axis=1), 0.01)
    both = (own + relabelled(own, apply(T, theirs))) / 2
    for number in (STATIONARY, WALK):
        if (task == number).sum() > 30:
            times, one, mean = fused_metrics.rising(*(a[task == number] for a in (at_s, own, both)))
            yield "front", number, times, one
            yield "both", number, times, mean


def relabelled(own: Float64, theirs: Float64) -> Float64:
    """The others' joints, with left and right exchanged while that has been nearer by 2 cm."""
    out, exchanged, advantage = theirs.copy(), False, 0.0
    for k in range(len(own)):
        raw, other = (np.linalg.norm(own[k] - x, axis=1).mean() for x in (theirs[k], theirs[k][MIRROR]))
        advantage += 0.3 * ((other - raw if exchanged else raw - other) - advantage)
        if advantage > 0.02:
            exchanged, advantage = not exchanged, -advantage
        if exchanged:
            out[k] = theirs[k][MIRROR]
    return out


def kalman(at_s: Float64, joints: Float64) -> Float64:
    settings, points, out = KalmanSettings(), unknown(25, float(at_s[0])), []
    for t, x in zip(at_s, joints, strict=True):
        points = correct(predict(points, float(t), settings), x, np.full(25, SD_M**2), settings)
        out.append(points.positions.copy())
    return np.array(out)


def articulated(at_s: Float64, joints: Float64) -> Float64:
    body, variances = ArticulatedBody(KINECT), np.full(25, SD_M**2)
    return np.array([body.update(x, variances, float(t)).positions for t, x in zip(at_s, joints, strict=True)])


def one_euro(at_s: Float64, joints: Float64) -> Float64:
    smooth = OneEuro()
    return np.array([smooth.update(x, float(t)) for t, x in zip(at_s, joints, strict=True)])


METHODS: Final[dict[str, Method]] = {
    "raw": lambda at_s, joints: joints,
    "1-euro": one_euro,
    "kalman": kalman,
    "articulated": articulated,
}


def figures(task: int, at_s: Float64, raw: Float64, joints: Float64) -> Iterator[tuple[str, float]]:
    """Return the figures of one sequence by name, without the first ten frames, the filters' warm-up."""
    if task == STATIONARY:
        yield "stationary jitter [mm]", 1000 * fused_metrics.jitter(joints[10:])
        return
    yield "bone length variation [%]", 100 * fused_metrics.bone_length_variation(joints[10:])
    yield "foot slide [cm/s]", 100 * fused_metrics.foot_slide(joints[10:], at_s[10:])
    yield "shoulder collapse [%]", 100 * fused_metrics.shoulder_collapse(joints[10:])
    if joints is not raw:
        yield "lag [ms]", 1000 * fused_metrics.lag(joints, raw, at_s)
        yield "distance from raw [cm]", 100 * float(np.nanmean(np.linalg.norm(joints - raw, axis=-1)))
