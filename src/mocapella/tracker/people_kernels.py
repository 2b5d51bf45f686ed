"""Compiled steps of `mocapella.tracker.people`, in place; importing this module imports numba.

They fuse the sensors' newest views of each person's joints (inverse variance weighting), and filter each joint: a
constant-velocity Kalman filter, then the 1-euro filter, or the articulated body's filter.

See `mocapella.tracker.people_memory` for the arrays; body ``b`` of a frame belongs to the person in row
``rows[b]``.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.association.track_kernels import measure
from mocapella.compiled import njit
from mocapella.fusion.facing_kernels import view_worth
from mocapella.fusion.view_kernels import follow_offsets, fuse
from mocapella.fusion.weighted_mean import FusionParameters
from mocapella.kinematics import articulated_kernels
from mocapella.kinematics.articulated_kernels import move
from mocapella.kinematics.articulated_memory import Rigidity
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.model.observations import JointState
from mocapella.smoothing.kalman_kernels import correct, predict
from mocapella.smoothing.one_euro_kernels import smooth
from mocapella.tracker.people_memory import (
    FrameViews,
    JointLayout,
    PeopleParameters,
    PointArrays,
    SkeletonArrays,
    ViewArrays,
)
from mocapella.tracker.people_view_kernels import follow_labels, move_views, see, to_level, turn

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Int64 = NDArray[np.int64]

_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)


__all__ = [
    "begin_offsets", "bring", "make", "move", "move_points", "move_views", "observe", "pose_people", "prepare",
    "rigidity_of", "smooth_people", "turn",
]  # fmt: skip


@njit(cache=True)
def move_points(T: Float64, points: Float64, out: Float64) -> None:
    """Transform points (n, 3) by T (4, 4), and write them to ``out`` (n, 3) [m]."""
    for j in range(len(points)):
        x, y, z = points[j, 0], points[j, 1], points[j, 2]
        for k in range(3):
            out[j, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]


@njit(cache=True)
def prepare(
    T: Float64, bodies: Float64, ends: Int64, middle: Int64, now_s: float, forget_after_s: float, points: PointArrays,
    world: Float64, middles: Float64, lengths: Float64, expected: Float64,
) -> None:  # fmt: skip
    """Compute the inputs of association for a frame's bodies; see `mocapella.tracker.people.Prepared`.

    Args:
        T: (4, 4) from the sensor's camera space to the space of the people.
        bodies: (bodies, joints, 3) in camera space [m]; NaN where not tracked.
        ends: (2 · lengths, 2) indices of the joints at both ends of each body length, left and right in turn.
        middle: (middle,) indices of the joints on the body's middle line.
        now_s: time for which people are predicted, on the common clock [s].
        forget_after_s: a joint that was unseen for longer is not predicted [s].
        points: Kalman filters of the people's joints.
        world, middles, lengths, expected: (bodies, joints, 3), (bodies, middle, 3), (bodies, lengths),
            (people, middle, 3), written [m]; NaN where not known.
    """
    for b in range(len(bodies)):
        move_points(T, bodies[b], world[b])
        for m in range(len(middle)):
            for k in range(3):
                middles[b, m, k] = world[b, middle[m], k]
    if len(ends):
        measure(bodies, ends, lengths)
    expect(middle, now_s, points, forget_after_s, expected)


@njit(cache=True)
def observe(
    frame: FrameViews,
    now_s: float,
    parameters: PeopleParameters,
    fusion: FusionParameters,
    layout: JointLayout,
    R_level: Float64,
    points: PointArrays,
    views: ViewArrays,
) -> tuple[Float64, Float64, Float64, Float64]:
    """Predict all people to ``now_s`` and store a frame's bodies as the newest views.

    Args:
        frame: the bodies.
        now_s: newest capture time so far, on the common clock [s].
        parameters, fusion: the settings.
        layout: joints with a special role.
        R_level: (3, 3) from the space of the people to one with y up.
        points, views: updated.

    Returns:
        The bodies' joints, the yaws to the sensor and the velocities that `to_level` returns, and the time since each
        person's previous view by this sensor (bodies,), at most a second [s].
    """
    bring(now_s, points, parameters)
    rows = frame.rows
    dts = np.empty(len(rows))
    for b in range(len(rows)):
        dts[b] = min(frame.at_s - views.at_s[rows[b], frame.column], 1.0)
    see(frame, fusion, parameters, points.velocities, views)
    follow_labels(rows, frame.column, dts, parameters, layout.mirror, views)
    level, toward, speeds = to_level(
        R_level, frame.positions, frame.sensor_position, layout.root, layout.head, rows, points.velocities
    )
    return level, toward, speeds, dts


@njit(cache=True)
def expect(middle: Int64, now_s: float, points: PointArrays, forget_after_s: float, out: Float64) -> None:
    """Predict the joints on the middle line of all people.

    Args:
        middle: (middle,) indices of these joints.
        now_s: the time, on the common clock [s].
        points: Kalman filters of the people's joints.
        forget_after_s: a joint that was unseen for longer is not predicted [s].
        out: (people, middle, 3) written, in the space of the people [m]; NaN where not known.
    """
    at_s, positions, velocities, seen_s = points.at_s, points.positions, points.velocities, points.seen_s
    for r in range(len(at_s)):
        dt = max(0.0, now_s - at_s[r])
        for m in range(len(middle)):
            j = middle[m]
            if now_s - seen_s[r, j] > forget_after_s:
                out[r, m, 0] = out[r, m, 1] = out[r, m, 2] = np.nan
            else:
                for k in range(3):
                    out[r, m, k] = positions[r, j, k] + dt * velocities[r, j, k]


@njit(cache=True)
def bring(now_s: float, points: PointArrays, parameters: PeopleParameters) -> None:
    """Predict the people's Kalman filters to a time, in place; filters that are later already do not change.

    The velocity of a joint that no view has decays: the last frames before an occlusion often move the
    joints too fast.

    Args:
        now_s: the time, on the common clock [s].
        points: the filters' states, updated.
        parameters: parameters of the filters, of the views' age, and of the decay.
    """
    at_s, positions, velocities = points.at_s, points.positions, points.velocities
    variances, seen_s = points.variances, points.seen_s
    for r in range(len(at_s)):
        dt = now_s - at_s[r]
        if dt > 0.0:
            predict(
                positions[r], velocities[r], variances[r], seen_s[r], dt, now_s, parameters.acceleration_density,
                parameters.forget_after_s,
            )  # fmt: skip
            at_s[r] = now_s
            fading = np.exp(-dt / parameters.speed_memory_s)
            for j in range(len(seen_s[r])):
                if now_s - seen_s[r, j] > parameters.view_age_s:
                    for k in range(3):
                        velocities[r, j, k] *= fading


@njit(cache=True)
def begin_offsets(offsets: Float64, view: Float64, expected: Float64) -> None:
    """Initialise the offsets (joints, 3) that are NaN, in place, so that the corrected view begins at the prediction.

    ``view`` and ``expected`` are the view's and the predicted joints (joints, 3) [m]; where one is unknown, the offset
    becomes 0.
    """
    for j in range(len(offsets)):
        if np.isnan(offsets[j, 0]):
            x, y, z = view[j, 0] - expected[j, 0], view[j, 1] - expected[j, 1], view[j, 2] - expected[j, 2]
            if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
                x, y, z = 0.0, 0.0, 0.0
            offsets[j, 0], offsets[j, 1], offsets[j, 2] = x, y, z


@njit(cache=True)
def subtract_offsets(offsets: Float64, view: Float64, kept: Float64) -> None:
    """Subtract offsets (joints, 3) from ``view`` (joints, 3), in place, and copy them to ``kept`` (joints, 3) [m]."""
    for j in range(len(offsets)):
        for k in range(3):
            kept[j, k] = offsets[j, k]
            view[j, k] -= offsets[j, k]


@njit(cache=True)
def make(
    rows: Int64,
    columns: int,
    now_s: float,
    parameters: PeopleParameters,
    fusion: FusionParameters,
    layout: JointLayout,
    up: Float64,
    points: PointArrays,
    views: ViewArrays,
    skeletons: SkeletonArrays,
) -> tuple[Float64, Float64]:
    """Fuse each person's views by a robust weighted mean, correct the Kalman filter by it, and write the skeletons.

    Args:
        rows: (bodies,) rows of the persons in the frame.
        columns: number of sensors.
        now_s: newest capture time so far, on the common clock [s].
        parameters, fusion: the settings.
        layout: joints with a special role.
        up: (3,) unit vector upwards, in the space of the people.
        points, views, skeletons: updated.

    Returns:
        The fused positions of the persons in the frame (bodies, joints, 3) [m], and their variances (bodies, joints)
        [m²]; NaN and infinity for a joint that no view in use has, such as those of a frame that came too late.
    """
    positions, variances = points.positions, points.variances
    joints = len(layout.mirror)
    measured, measured_variances = np.full((len(rows), joints, 3), np.nan), np.full((len(rows), joints), np.inf)
    corrected = np.empty((columns, joints, 3))
    worth = np.empty((columns, joints))
    offsets = np.empty((columns, joints, 3))
    used = np.empty(columns, dtype=np.int64)
    nu, offset_s = fusion.degrees_of_freedom, fusion.offset_s
    for i in range(len(rows)):
        r = rows[i]
        count = views_in_use(
            r, now_s, parameters, fusion.age_speed_m_s, layout, up, skeletons.yaw[r], points.velocities[r], views,
            used, corrected, worth, offsets,
        )  # fmt: skip
        if count == 0:
            continue
        for n in range(count):
            begin_offsets(offsets[n], corrected[n], positions[r])
        doubts = variances[r, :, 0]
        fuse(corrected[:count], worth[:count], positions[r], doubts, nu, measured[i], measured_variances[i])
        step = 1.0 if offset_s == 0.0 else -np.expm1(-max(0.0, now_s - skeletons.fused_s[r]) / offset_s)
        follow_offsets(offsets[:count], corrected[:count], measured[i], step)
        for n in range(count):
            subtract_offsets(offsets[n], corrected[n], views.offsets[r, used[n]])
        fuse(corrected[:count], worth[:count], positions[r], doubts, nu, measured[i], measured_variances[i])
        # The other views were fused in earlier frames: scaling the variance by their number avoids counting them twice.
        correct(
            positions[r], points.velocities[r], variances[r], points.seen_s[r], points.at_s[r], measured[i],
            measured_variances[i], float(count), nu, parameters.speed_variance,
        )  # fmt: skip
        skeletons.fused_s[r] = now_s
        for j in range(joints):
            best = _NOT_TRACKED
            for n in range(count):
                m = layout.mirror[j] if views.mirrored[r, used[n]] else j
                best = max(best, views.states[r, used[n], m])
            skeletons.states[r, j] = best
    infer(now_s, parameters.view_age_s, positions, skeletons.states, views.at_s)
    steady, steady_variances = skeletons.steady, skeletons.doubts
    for r in range(len(positions)):
        for j in range(joints):
            steady[r, j, 0], steady[r, j, 1], steady[r, j, 2] = (
                positions[r, j, 0],
                positions[r, j, 1],
                positions[r, j, 2],
            )
            steady_variances[r, j] = variances[r, j, 0]
    return measured, measured_variances


@njit(cache=True)
def views_in_use(
    row: int, now_s: float, parameters: PeopleParameters, age_speed: float, layout: JointLayout, up: Float64,
    yaw: float, velocities: Float64, views: ViewArrays,
    used: Int64, corrected: Float64, variances: Float64, offsets: Float64,
) -> int:  # fmt: skip
    """Collect a person's views that are recent enough, with repaired labels and brought to ``now_s``.

    Args:
        row: row of the person.
        now_s: newest capture time so far, on the common clock [s].
        parameters: the settings.
        age_speed: growth of a view's standard deviation with its age [m/s].
        layout: joints with a special role.
        up: (3,) unit vector upwards, in the space of the people.
        yaw: facing of the person [rad]; NaN where not known.
        velocities: (joints, 3) velocities of the person [m/s].
        views: the newest views.
        used, corrected, variances, offsets: the first rows are written, one for each view in use: (sensors,) columns,
            (sensors, joints, 3) positions [m], (sensors, joints) variances [m²], and (sensors, joints, 3) offsets [m].

    Returns:
        The number of views in use.
    """
    count = 0
    for c in range(len(used)):
        age = now_s - views.at_s[row, c]
        if age > parameters.view_age_s:
            continue
        age = max(0.0, age)
        used[count] = c
        value = 1.0
        if np.isfinite(yaw):
            worth = view_worth(yaw, views.toward[row, c], views.reported[row, c], views.unlike[row, c])
            value = max(parameters.least_worth, worth)
        for j in range(len(layout.mirror)):
            m = layout.mirror[j] if views.mirrored[row, c] else j
            for k in range(3):
                moved = age * velocities[j, k]
                seen = views.positions[row, c, m, k] + (views.bias[row, c, m, k] if layout.line_of[j] < 0 else 0.0)
                corrected[count, j, k] = seen + (moved if np.isfinite(moved) else 0.0)
                offsets[count, j, k] = views.offsets[row, c, j, k]
            variances[count, j] = (views.variances[row, c, m] + (age_speed * age) ** 2) / value
        turn(corrected[count], layout.line_of, layout.root, up, views.turn[row, c])
        count += 1
    return count


@njit(cache=True)
def infer(now_s: float, view_age_s: float, positions: Float64, states: UInt8, view_at: Float64) -> None:
    """Mark predicted joints that no view has as inferred, and joints without a prediction as not tracked.

    Args:
        now_s: newest capture time so far, on the common clock [s].
        view_age_s: age of the oldest view in use [s].
        positions: (people, joints, 3) predicted positions [m]; NaN where not known.
        states: (people, joints) `JointState`, updated.
        view_at: (people, sensors) capture times of the newest views [s].
    """
    for r in range(len(positions)):
        seen = False
        for c in range(view_at.shape[1]):
            seen = seen or now_s - view_at[r, c] <= view_age_s
        for j in range(states.shape[1]):
            if not np.isfinite(positions[r, j, 0]):
                states[r, j] = _NOT_TRACKED
            elif not seen or states[r, j] == _NOT_TRACKED:
                states[r, j] = _INFERRED


@njit(cache=True)
def rigidity_of(rows: Int64, now_s: float, view_age_s: float, views: ViewArrays) -> Float64:
    """Return the largest noise and size, ``rigidity``, of the views of each person that are recent enough.

    Args:
        rows: (bodies,) rows of the persons in the frame.
        now_s: newest capture time so far, on the common clock [s].
        view_age_s: age of the oldest view in use [s].
        views: the newest views.

    Returns:
        (bodies, 2); 0 without a view.
    """
    largest = np.zeros((len(rows), 2))
    for i in range(len(rows)):
        for c in range(views.at_s.shape[1]):
            if now_s - views.at_s[rows[i], c] <= view_age_s:
                for k in range(2):
                    largest[i, k] = max(largest[i, k], views.rigidity[rows[i], c, k])
    return largest


@njit(cache=True)
def pose_people(
    rows: Int64,
    model: BodyArrays,
    body: Float64,
    measured: Float64,
    measured_variances: Float64,
    at_s: float,
    rigidity: Float64,
    steady: Float64,
    doubts: Float64,
) -> None:
    """Update the articulated-body filters of the persons in the frame by their fused joints, and predict the others.

    Args:
        rows: (bodies,) rows of the persons in the frame.
        model: the articulated body.
        body: (people, …) state of the body in a row for each person, updated.
        measured, measured_variances: (bodies, joints, 3), (bodies, joints) fused views [m], [m²].
        at_s: newest capture time so far, on the common clock [s].
        rigidity: (bodies, 2) noise of the skeletons, a factor of the joints' standard deviation, and standard deviation
            of their size, of which at least the model's counts [ratio].
        steady, doubts: (people, joints, 3), (people, joints) smoothed positions [m] and their variances [m²]; written
            for people with a known pose.
    """
    positions, variances = np.empty(steady.shape[1:]), np.empty(steady.shape[1])
    for r in range(len(steady)):
        b = -1
        for i in range(len(rows)):
            if rows[i] == r:
                b = i
        if b >= 0:
            rigid = Rigidity(rigidity[b, 0], max(model.parameters.scale_sd, rigidity[b, 1]))
            known = articulated_kernels.correct(
                model, body[r], at_s, measured[b], measured_variances[b], rigid, positions, variances
            )
        else:
            known = articulated_kernels.predict(model, body[r], at_s, positions, variances)
        if known:
            for j in range(len(variances)):
                doubts[r, j] = variances[j]
                for k in range(3):
                    steady[r, j, k] = positions[j, k]


@njit(cache=True)
def smooth_people(
    rows: Int64, euro_positions: Float64, euro_velocities: Float64, euro_seen_s: Float64, measured: Float64,
    at_s: float, min_cutoff_hz: float, beta_per_m: float, speed_cutoff_hz: float, forget_after_s: float,
    view_age_s: float, steady: Float64,
) -> None:  # fmt: skip
    """Run the 1-euro filter of the persons in the frame, and copy the recently measured joints to the skeletons.

    Args:
        rows: (bodies,) rows of the persons in the frame.
        euro_positions, euro_velocities, euro_seen_s: (people, joints, 3) [m], (people, joints, 3) [m/s],
            (people, joints) [s]: state of the filters, updated.
        measured: (bodies, joints, 3) fused views [m]; NaN where no view has the joint.
        at_s: newest capture time so far, on the common clock [s].
        min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s: cutoff at rest [Hz], its increase per speed
            [Hz/(m/s)], cutoff of the velocity's low pass [Hz], and gap that restarts the filter [s].
        view_age_s: joints that were measured within this time are copied [s].
        steady: (people, joints, 3) written where copied [m].
    """
    for i in range(len(rows)):
        r = rows[i]
        smooth(
            euro_positions[r], euro_velocities[r], euro_seen_s[r], measured[i], at_s,
            min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s,
        )  # fmt: skip
    for r in range(len(steady)):
        for j in range(steady.shape[1]):
            if at_s - euro_seen_s[r, j] <= view_age_s:
                for k in range(3):
                    steady[r, j, k] = euro_positions[r, j, k]
