"""A frame of `mocapella.tracker.people` in one compiled call, and the results in another; importing it imports numba.

See `mocapella.tracker.people_memory` for the arrays.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import SD_M
from mocapella.association.track_kernels import assign_and_take
from mocapella.association.tracks import UNFINISHED, Assignment, FrameBodies, TrackInputs
from mocapella.compiled import njit
from mocapella.fusion.facing import FacingInputs
from mocapella.fusion.facing_kernels import update as update_facings
from mocapella.fusion.weighted_mean import FusionParameters
from mocapella.kinematics.articulated_body import LEAST_REPORTED
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.model.observations import JointState
from mocapella.tracker.people_kernels import make, move_points, observe, pose_people, prepare, rigidity_of
from mocapella.tracker.people_memory import (
    GUESS_SD_M_S,
    MOST_GUESS_SD_M,
    REPORTED_STRAY,
    UNSURE_S,
    UNSURE_SD,
    Bools,
    FacingResults,
    Float64,
    FrameViews,
    JointLayout,
    PeopleParameters,
    PointArrays,
    Rows,
    SensorBodies,
    SkeletonArrays,
    UInt8,
    ViewArrays,
)
from mocapella.tracker.people_view_kernels import turn_views

_NOT_TRACKED, _INFERRED, _TRACKED = map(int, (JointState.NOT_TRACKED, JointState.INFERRED, JointState.TRACKED))


@njit(cache=True, error_model="numpy")
def assign_and_step(
    bodies: SensorBodies,
    tracks: TrackInputs,
    now_s: float,
    parameters: PeopleParameters,
    fusion: FusionParameters,
    layout: JointLayout,
    R_level: Float64,
    points: PointArrays,
    views: ViewArrays,
    skeletons: SkeletonArrays,
    facing: FacingInputs | None,
    model: BodyArrays | None,
    body: Float64,
    fused: Float64,
) -> int:
    """Assign a frame's bodies to tracks, and update the people by them with `step`, which describes the arguments.

    Args:
        bodies: the frame; its ``rows`` are written unless they are given.
        tracks: the tracks, one for each of the people, in the same order; updated, unless the rows are given.
        facing: with the facing filter's row of each of the people.

    Returns:
        Events of the frame; after one of `mocapella.association.tracks.UNFINISHED`, the people are not updated.
    """
    own, rows, T, count = bodies.positions, bodies.rows, bodies.T, len(bodies.ids)
    middle, people = len(layout.middle), len(points.at_s)
    events: int = 0
    world, middles = np.empty(own.shape), np.empty((count, middle, 3))
    lengths, expected = np.full((count, len(SD_M)), np.nan), np.empty((people, middle, 3))
    prepare(T, own, layout, now_s, parameters.forget_after_s, points, world, middles, lengths, expected)
    if not bodies.assigned:
        frame = FrameBodies(bodies.at_s, bodies.track_column, bodies.ids.view(np.int64), middles, lengths)
        result = Assignment(
            np.empty((count, people)), np.empty((count, people), dtype=np.bool_), np.empty(count, dtype=np.bool_), rows
        )
        events = assign_and_take(frame, expected, tracks, result)
        if events & UNFINISHED:
            return events
    bias = np.zeros(own.shape)
    for b in range(len(bodies.corrections)):
        for j in range(own.shape[1]):
            x, y, z = bodies.corrections[b, j, 0], bodies.corrections[b, j, 1], bodies.corrections[b, j, 2]
            for k in range(3):
                bias[b, j, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z
    new = FrameViews(
        rows, bodies.ids, bodies.column, bodies.at_s, world, bodies.states, own, bias, T[:3, 3].copy(), bodies.clipped,
        bodies.noise, bodies.scale_sd,
    )  # fmt: skip
    step(new, now_s, parameters, fusion, layout, R_level, points, views, skeletons, facing, model, body, fused)
    return events


@njit(cache=True, error_model="numpy")
def step(
    frame: FrameViews,
    now_s: float,
    parameters: PeopleParameters,
    fusion: FusionParameters,
    layout: JointLayout,
    R_level: Float64,
    points: PointArrays,
    views: ViewArrays,
    skeletons: SkeletonArrays,
    facing: FacingInputs | None,
    model: BodyArrays | None,
    body: Float64,
    fused: Float64,
) -> None:
    """Predict all people, then store a frame's views, decide their labels, and fuse and smooth the persons in it.

    Args:
        frame: the bodies.
        now_s: newest capture time so far, on the common clock [s].
        parameters, fusion: the settings.
        layout: joints with a special role.
        R_level: (3, 3) from the space of the people to one with y up.
        points, views, skeletons: updated.
        facing: the facing filter, updated, with its row of each of the people; None uses the labels on which the
            sensors agree.
        model: the articulated body; None leaves the skeletons as the Kalman filter has them.
        body: (people, …) state of the body in a row for each person, updated.
        fused: (bodies, joints, 3) written: fused positions of the persons in the frame [m]; NaN where no view has the
            joint. It is no result, because numba takes more than a microsecond to return an array.
    """
    rows, column = frame.rows, frame.column
    level, toward, velocities, dts = observe(frame, now_s, parameters, fusion, layout, R_level, points, views)
    numbers, ids = views.id, frame.ids
    for b in range(len(rows)):
        numbers[rows[b], column] = ids[b]
    if facing is None:
        for b in range(len(rows)):
            views.mirrored[rows[b], column] = views.swapped[rows[b], column]
    else:
        out, mirrored, slots = np.empty((5, len(rows))), np.empty(len(rows), dtype=np.bool_), facing.slots[rows]
        update_facings(
            slots, facing.column, level, toward, frame.at_s, velocities, facing.zero, facing.memory,
            facing.model, facing.factors, out,
        )  # fmt: skip
        exchanged = facing.memory.mirrored
        for b in range(len(rows)):
            mirrored[b] = exchanged[slots[b], facing.column]
        results = FacingResults(level, out[0], out[1], mirrored, out[2], out[4], toward, velocities)
        turn_views(rows, column, dts, parameters, layout.lines, results, skeletons.yaw, views)
        note_unsure(rows, out[1], now_s, parameters.view_age_s, views, skeletons.unsure_s)
    measured: Float64
    measured, variances = make(
        rows, views.at_s.shape[1], now_s, parameters, fusion, layout, R_level[1], points, views, skeletons
    )
    states, measured_s = skeletons.states, skeletons.measured_s
    for r in range(len(states)):
        for j in range(states.shape[1]):
            if states[r, j] == _TRACKED:
                measured_s[r, j] = now_s
    if model is not None:
        rigidity = rigidity_of(rows, now_s, parameters.view_age_s, views)
        pose_people(rows, model, body, measured, variances, now_s, rigidity, skeletons.steady, skeletons.doubts)
    for b in range(len(rows)):
        for j in range(fused.shape[1]):
            for k in range(3):
                fused[b, j, k] = measured[b, j, k]


@njit(cache=True, error_model="numpy")
def note_unsure(rows: Rows, sd: Float64, now_s: float, view_age_s: float, views: ViewArrays, unsure_s: Float64) -> None:
    """Note since when the sensors have disagreed about left and right while the facing does not decide it.

    Args:
        rows: (bodies,) row of each body's person.
        sd: (bodies,) standard deviation of their facings [rad].
        now_s: newest capture time so far, on the common clock [s].
        view_age_s: age of the oldest view in use [s].
        views: the newest views.
        unsure_s: (people,) the time, updated [s]; infinite if they do not disagree.
    """
    at_s, mirrored = views.at_s, views.mirrored
    for b in range(len(rows)):
        r, exchanged, straight = rows[b], False, False
        for c in range(at_s.shape[1]):
            if now_s - at_s[r, c] <= view_age_s:
                exchanged = exchanged or mirrored[r, c]
                straight = straight or not mirrored[r, c]
        unsure = exchanged and straight and sd[b] > UNSURE_SD
        unsure_s[r] = min(unsure_s[r], now_s) if unsure else np.inf


@njit(cache=True, error_model="numpy")
def report(
    T: Float64, now_s: float, view_age_s: float, skeletons: SkeletonArrays, view_at: Float64, view_positions: Float64,
    strays: Float64, body: Float64, slack: tuple[int, int], column: int, positions: Float64, sd: NDArray[np.float32],
    states: UInt8, views: Float64, fresh: Bools, noted: Bools,
) -> None:  # fmt: skip
    """Transform all people and views by ``T`` (4, 4) for output.

    An inferred joint's standard deviation is at least what a sensor's guess may be off after that time.

    Args:
        T: (4, 4) from the space of the people to the space of the results.
        now_s: newest capture time so far, on the common clock [s].
        view_age_s: age of the oldest view in use [s].
        skeletons: the fused skeletons.
        view_at, view_positions: (people, sensors) capture time [s] and (people, sensors, joints, 3) of the newest views
            [m].
        strays: (people, sensors, joints) those of `ViewArrays` [ratio].
        body: (people, …) state of the articulated body.
        slack: first column of the limits' slack in ``body``, and the one after its last [rad].
        column: column of the sensor whose views are wanted; −1 for all.
        positions, sd, states: (people, joints, 3) smoothed positions [m], (people, joints) their standard deviation
            [m], both NaN for a joint that is not tracked, and (people, joints) `JointState`; written.
        views, fresh: (wanted sensors, people, joints, 3) each wanted view [m], where it is in use, and
            (people, sensors) whether it is in use; written.
        noted: (people,) whether the person may have a condition; written.
    """
    people, sensors, joints = view_positions.shape[:3]
    first, last = (column, column + 1) if column >= 0 else (0, sensors)
    steady, doubts, measured_s = skeletons.steady, skeletons.doubts, skeletons.measured_s
    now_states = skeletons.states
    for r in range(people):
        noted[r] = skeletons.fused_s[r] - skeletons.unsure_s[r] > UNSURE_S
        for i in range(slack[0], slack[1]):
            noted[r] = noted[r] or body[r, i] > LEAST_REPORTED  # False for NaN
        move_points(T, steady[r], positions[r])
        for j in range(joints):
            states[r, j] = now_states[r, j]
            sd[r, j] = np.sqrt(doubts[r, j])
            if states[r, j] == _NOT_TRACKED:  # the body model extrapolates them without an end
                positions[r, j], sd[r, j] = np.nan, np.nan
            elif states[r, j] == _INFERRED:
                drift_m = min(GUESS_SD_M_S * (now_s - measured_s[r, j]), MOST_GUESS_SD_M)
                sd[r, j] = max(sd[r, j], np.float32(drift_m))
        for c in range(sensors):
            fresh[r, c] = now_s - view_at[r, c] <= view_age_s
            for j in range(joints):
                noted[r] = noted[r] or (fresh[r, c] and abs(strays[r, c, j]) > REPORTED_STRAY)
            if fresh[r, c] and first <= c < last:
                move_points(T, view_positions[r, c], views[c - first, r])
