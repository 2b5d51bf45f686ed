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
from mocapella.fusion.view_kernels import ViewLanes, fuse_lanes
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
    "bring", "make", "move", "move_points", "move_views", "observe", "pose_people", "prepare",
    "rigidity_of", "smooth_people", "turn",
]  # fmt: skip


@njit(cache=True, error_model="numpy")
def move_points(T: Float64, points: Float64, out: Float64) -> None:
    """Transform points (n, 3) by T (4, 4), and write them to ``out`` (n, 3) [m]."""
    for j in range(len(points)):
        x, y, z = points[j, 0], points[j, 1], points[j, 2]
        for k in range(3):
            out[j, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]


@njit(cache=True, error_model="numpy")
def prepare(
    T: Float64, bodies: Float64, layout: JointLayout, now_s: float, forget_after_s: float, points: PointArrays,
    world: Float64, middles: Float64, lengths: Float64, expected: Float64,
) -> None:  # fmt: skip
    """Compute the inputs of association for a frame's bodies; see `mocapella.tracker.people.Prepared`.

    Args:
        T: (4, 4) from the sensor's camera space to the space of the people.
        bodies: (bodies, joints, 3) in camera space [m]; NaN where not tracked.
        layout: joints with a special role.
        now_s: time for which people are predicted, on the common clock [s].
        forget_after_s: a joint that was unseen for longer is not predicted [s].
        points: Kalman filters of the people's joints.
        world, middles, lengths, expected: (bodies, joints, 3), (bodies, middle, 3), (bodies, lengths),
            (people, middle, 3), written [m]; NaN where not known, but ``lengths`` stays if the topology has none.
    """
    middle, ends = layout.middle, layout.ends
    for b in range(len(bodies)):
        move_points(T, bodies[b], world[b])
        for m in range(len(middle)):
            for k in range(3):
                middles[b, m, k] = world[b, middle[m], k]
    if len(ends):
        measure(bodies, ends, lengths)
    expect(middle, now_s, points, forget_after_s, expected)


@njit(cache=True, error_model="numpy")
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
    see(frame, fusion, parameters, layout, points.velocities, views)
    follow_labels(rows, frame.column, dts, parameters, layout.mirror, views)
    level, toward, speeds = to_level(
        R_level, frame.positions, frame.sensor_position, layout.root, layout.head, rows, points.velocities
    )
    return level, toward, speeds, dts


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
    positions, velocities, variances = points.positions, points.velocities, points.variances
    seen_s, at_s, fused_s, states = points.seen_s, points.at_s, skeletons.fused_s, skeletons.states
    yaw, kept = skeletons.yaw, views.offsets
    joints, nu, offset_s = len(layout.mirror), fusion.degrees_of_freedom, fusion.offset_s
    speed_variance = parameters.speed_variance
    measured, measured_variances = np.full((len(rows), joints, 3), np.nan), np.full((len(rows), joints), np.inf)
    used = np.empty(columns, dtype=np.int64)
    lanes = ViewLanes(
        np.empty((3, joints, columns)), np.empty((3, joints, columns)), np.empty((joints, columns)),
        np.empty((joints, columns)), np.empty((joints, columns)),
    )  # fmt: skip
    for i in range(len(rows)):
        r = rows[i]
        count = views_in_use(
            r, now_s, parameters, fusion.age_speed_m_s, layout, up, yaw[r], positions[r], velocities[r], views, used,
            lanes, states[r],
        )  # fmt: skip
        if count == 0:
            continue
        step = 1.0 if offset_s == 0.0 else -np.expm1(-max(0.0, now_s - fused_s[r]) / offset_s)
        fuse_lanes(lanes, count, positions[r], variances[r], nu, step, measured[i], measured_variances[i])
        offsets = lanes.offsets
        for n in range(count):
            c = used[n]
            for j in range(joints):
                for k in range(3):
                    kept[r, c, j, k] = offsets[k, j, n]
        # The other views were fused in earlier frames: scaling the variance by their number avoids counting them twice.
        correct(
            positions[r], velocities[r], variances[r], seen_s[r], at_s[r], measured[i], measured_variances[i],
            float(count), nu, speed_variance,
        )  # fmt: skip
        fused_s[r] = now_s
    infer(now_s, parameters.view_age_s, positions, states, views.at_s)
    steady, steady_variances = skeletons.steady, skeletons.doubts
    for r in range(len(positions)):
        for j in range(joints):
            for k in range(3):
                steady[r, j, k] = positions[r, j, k]
            steady_variances[r, j] = variances[r, j, 0]
    return measured, measured_variances


@njit(cache=True, error_model="numpy")
def views_in_use(
    row: int, now_s: float, parameters: PeopleParameters, age_speed: float, layout: JointLayout, up: Float64,
    yaw: float, expected: Float64, velocities: Float64, views: ViewArrays,
    used: Int64, lanes: ViewLanes, best: UInt8,
) -> int:  # fmt: skip
    """Collect a person's views that are recent enough, with repaired labels and brought to ``now_s``.

    Arrays are taken out of their tuples once: numba counts references each time.

    Args:
        row: row of the person.
        now_s: newest capture time so far, on the common clock [s].
        parameters: the settings.
        age_speed: growth of a view's standard deviation with its age [m/s].
        layout: joints with a special role.
        up: (3,) unit vector upwards, in the space of the people.
        yaw: facing of the person [rad]; NaN where not known.
        expected, velocities: (joints, 3) predicted joints of the person [m], and their velocities [m/s].
        views: the newest views.
        used: (sensors,) the first are written: columns of the views in use.
        lanes: written for these views. Offsets that are NaN begin anew: the view then begins at the prediction.
        best: (joints,) written if there are such views: the best `JointState` of these.

    Returns:
        The number of views in use.
    """
    at_s, toward, reported, turns = views.at_s, views.toward, views.reported, views.turn
    seen, bias, kept, doubts = views.positions, views.bias, views.offsets, views.variances
    mirrored, states, mirror, line_of = views.mirrored, views.states, layout.mirror, layout.line_of
    apart, offsets, own_variances, there = lanes.apart, lanes.offsets, lanes.variances, lanes.there
    joints, root, view_age_s, count = len(mirror), layout.root, parameters.view_age_s, 0
    body = np.empty((joints, 3))
    for c in range(len(used)):
        age = now_s - at_s[row, c]
        if age > view_age_s:
            continue
        age = max(0.0, age)
        used[count] = c
        value = 1.0
        if np.isfinite(yaw):
            worth = view_worth(yaw, toward[row, c], reported[row, c])
            value = max(parameters.least_worth, worth)
        middle = np.sqrt(value)  # the errors of the body's middle depend less on where the person faces
        grown, is_mirrored = (age_speed * age) ** 2, mirrored[row, c]
        for j in range(joints):
            m = mirror[j] if is_mirrored else j
            for k in range(3):
                moved = age * velocities[j, k]
                own = seen[row, c, m, k] + (bias[row, c, m, k] if line_of[j] < 0 else 0.0)
                body[j, k] = own + (moved if np.isfinite(moved) else 0.0)
            state = states[row, c, m]
            best[j] = state if count == 0 else max(best[j], state)
            own_variances[j, count] = (doubts[row, c, m] + grown) / (middle if mirror[j] == j else value)
        turn(body, line_of, root, up, turns[row, c])
        place_view(body, expected, kept, row, c, count, apart, offsets, own_variances, there)
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def place_view(
    body: Float64, expected: Float64, kept: Float64, row: int, c: int, n: int, apart: Float64, offsets: Float64,
    variances: Float64, there: Float64,
) -> None:  # fmt: skip
    """Write a view into the arrays of `ViewLanes`.

    Args:
        body, expected: (joints, 3) joints of the view, and predicted ones [m]; NaN where unknown.
        kept: (people, sensors, joints, 3) offsets of the views [m]; where NaN, the view begins at the prediction.
        row, c: the view's row and column in ``kept``.
        n: index of the view in the other arrays.
        apart, offsets, variances, there: of `ViewLanes`; ``variances`` has the view's already.
    """
    for j in range(len(body)):
        x, y, z = body[j, 0], body[j, 1], body[j, 2]
        known = np.isfinite(expected[j, 0])
        if known:
            x, y, z = x - expected[j, 0], y - expected[j, 1], z - expected[j, 2]
        is_seen = np.isfinite(x) and np.isfinite(y) and np.isfinite(z)
        u, v, w = kept[row, c, j, 0], kept[row, c, j, 1], kept[row, c, j, 2]
        if np.isnan(u):
            begins = known and is_seen
            u, v, w = (x if begins else 0.0), (y if begins else 0.0), (z if begins else 0.0)
        offsets[0, j, n], offsets[1, j, n], offsets[2, j, n] = u, v, w
        is_seen = is_seen and np.isfinite(variances[j, n])
        apart[0, j, n], apart[1, j, n] = (x if is_seen else 0.0), (y if is_seen else 0.0)
        apart[2, j, n], there[j, n] = (z if is_seen else 0.0), (1.0 if is_seen else 0.0)
        variances[j, n] = variances[j, n] if is_seen else 1.0


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
