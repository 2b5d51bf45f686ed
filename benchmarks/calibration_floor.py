"""Best possible accuracy of a calibration from 8 s of walking in the simulated room.

The fits use information that no method has.

Frames of two sensors at one true instant, with true labels and true people, are fitted at once: unchanged; without
their mean error (bias and turned shoulders of the true view angle, taken off exactly); and that by generalised least
squares under the covariance that the noise was made with, whose own bound (Cramér and Rao) is printed too.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from benchmarks.harness import Row, measured
from mocapella.evaluation.simulation import scene_room
from mocapella.evaluation.simulation_score import WALKING
from mocapella.geometry.alignment import cross_matrix, robust_align
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.sources.simulate import Room, SimulatedSensor, merge
from mocapella.sources.simulate.body import ROOT, facing
from mocapella.sources.simulate.measured import (
    SIDES_DEG,
    SPEEDS,
    TURNED,
    measured_errors,
    spline_weights,
    toward_sensor,
)

Float64 = NDArray[np.float64]

SCENES = ("walk-45", "walk-90", "tilted", "clocks")
WALKED_S = 8.0
GAP_S = 0.1
THINNED_S = 0.12
"""Of generalised least squares: frames that are nearer in time say nearly the same [s]."""
NOT_HIDDEN = 2


class Shared(msgspec.Struct, frozen=True):
    """Frames of one person in two sensors, each (frames, ...), with true labels.

    Attributes:
        at_s: of the first sensor's frame.
        truth: (frames, 25, 3) world [m].
        seen: of each sensor (frames, 25, 3) its camera space [m]; states: (frames, 25); mirrored: (frames,).
    """

    at_s: Float64
    truth: Float64
    seen: tuple[Float64, Float64]
    states: tuple[NDArray[np.int64], NDArray[np.int64]]
    mirrored: tuple[NDArray[np.bool_], NDArray[np.bool_]]


def run(*, quick: bool = False) -> list[Row]:
    turned: dict[str, list[float]] = {}
    for name in SCENES[:1] if quick else SCENES:
        room = scene_room(name, 0)
        main, *others = room.sensor_names
        for other in others:
            for what, degrees in _turned_deg(room, main, other).items():
                turned.setdefault(what, []).append(degrees)
    pairs = len(next(iter(turned.values())))
    return [
        measured(f"angle, {what}, {kind} of {pairs} pairs", of(values), "°")
        for what, values in turned.items()
        for kind, of in (("mean", lambda v: float(np.mean(v))), ("worst", max))
    ]


def _turned_deg(room: Room, a: str, b: str) -> dict[str, float]:
    """By how much each fit is turned [°]."""
    T = {sensor.name: sensor.T_world_sensor for sensor in room.settings.sensors}
    true = inverse(T[a]) @ T[b]
    people = [_without_mean_error(shared, (T[a], T[b])) for shared in _shared(room, a, b)]

    def wrong(found: Float64) -> float:
        return float(np.degrees(np.linalg.norm(log_motion(found @ inverse(true))[3:])))

    weights = np.concatenate([_weights(shared) for shared, _ in people]).ravel()
    raw, clean = (
        [np.concatenate([views[k] for views in of]).reshape(-1, 3) for k in (0, 1)]
        for of in ([shared.seen for shared, _ in people], [views for _, views in people])
    )
    H, g = np.zeros((6, 6)), np.zeros(6)
    for shared, views in people:
        _add_information(H, g, shared, views, true, (T[a], T[b]))
    C = np.linalg.inv(H)
    return {
        "all frames at once": wrong(robust_align(*raw, weights)),
        "without the mean error": wrong(robust_align(*clean, weights)),
        "and with the true covariance": wrong(exp_twist(C @ g) @ true),
        "bound of that": float(np.degrees(np.sqrt(np.trace(C[3:, 3:])))),
    }


def _shared(room: Room, a: str, b: str) -> list[Shared]:
    """Return the frames until a person has walked for `WALKED_S` in view of both."""
    mirror = np.array(room.topology.mirror)
    tracks: dict[tuple[str, int], list[Any]] = {}
    walked = 0.0
    for item in merge([SimulatedSensor(room, name) for name in (a, b)], 0.0, room.duration_s):
        frame, truth = item.frame, item.truth
        at_s = truth.room_ns / 1e9
        walks = False
        for body, person in enumerate(truth.body_people.tolist()):
            true = apply(inverse(truth.T_world_sensor), truth.positions[person])
            p, states = frame.positions[body].astype(np.float64), frame.states[body].astype(np.int64)
            wrong = bool(np.nansum(np.abs(p[mirror] - true)) < np.nansum(np.abs(p - true)))
            order = mirror if wrong else np.arange(len(mirror))
            track = tracks.setdefault((frame.sensor, person), [])
            if track and frame.sensor == a and tracks.get((b, person)):
                moved = np.linalg.norm(truth.positions[person][ROOT] - track[-1][1][ROOT])
                walks |= bool(moved > WALKING * (at_s - track[-1][0]))
            track.append((at_s, truth.positions[person], p[order], states[order], wrong))
        walked += walks / room.settings.sensors[room.sensor_index(a)].rate_hz
        if walked >= WALKED_S:
            break
    people = {person for _, person in tracks}
    found = [_together(tracks.get((a, person), []), tracks.get((b, person), [])) for person in sorted(people)]
    return [shared for shared in found if shared is not None]


def _together(of_a: list[Any], of_b: list[Any]) -> Shared | None:
    """b's frames interpolated at a's."""
    times = np.array([view[0] for view in of_b])
    rows = []
    for at_s, true, p, states, wrong in of_a:
        i = int(np.searchsorted(times, at_s))
        if 0 < i < len(times) and times[i] - times[i - 1] <= GAP_S:
            before, after = of_b[i - 1], of_b[i]
            f = (at_s - times[i - 1]) / (times[i] - times[i - 1])
            q = (1 - f) * before[2] + f * after[2]
            if np.isfinite(p).all() and np.isfinite(q).all():
                rows.append((at_s, true, p, q, states, np.minimum(before[3], after[3]), wrong, after[4]))
    if len(rows) < 10:
        return None
    at_s, true, p, q, states_a, states_b, wrong_a, wrong_b = (np.array(column) for column in zip(*rows, strict=True))
    return Shared(at_s, true, (p, q), (states_a, states_b), (wrong_a, wrong_b))


def _weights(shared: Shared) -> Float64:
    return np.prod([np.choose(states, (0.0, 0.2, 1.0)) for states in shared.states], axis=0)


def _without_mean_error(shared: Shared, T: tuple[Float64, Float64]) -> tuple[Shared, tuple[Float64, Float64]]:
    errors, n = measured_errors(), len(shared.at_s)
    everything = np.ones(shared.truth.shape[:2], dtype=np.bool_)
    views = []
    for k in (0, 1):
        chance = np.where(shared.mirrored[k], 0.0, 1.0)
        noise = (np.zeros_like(shared.truth), np.zeros(n), chance)
        seen, _ = errors.put_on(shared.truth, T[k][:3, 3], everything, noise)
        views.append(shared.seen[k] - (seen - shared.truth) @ T[k][:3, :3])
    return shared, (views[0], views[1])


def _add_information(  # noqa: PLR0917 - in the order of the equation
    H: Float64, g: Float64, shared: Shared, views: tuple[Float64, Float64], true: Float64, T: tuple[Float64, Float64]
) -> None:
    """Add Jᵀ C⁻¹ J and Jᵀ C⁻¹ r of one person; joints that are turned about the spine are left out."""
    errors = measured_errors()
    kept = [0]
    for i, at_s in enumerate(shared.at_s):
        if at_s - shared.at_s[kept[-1]] >= THINNED_S:
            kept.append(i)
    truth, at_s = shared.truth[kept], shared.at_s[kept]
    speed = np.linalg.norm(np.gradient(truth[:, ROOT], axis=0), axis=1) / np.gradient(at_s)
    moves = np.interp(speed, SPEEDS, (0.0, 1.0))
    in_time = np.zeros((len(kept), len(kept)))
    for spacing, share, still in zip(errors.data.knots_s, errors.data.share, errors.data.still_share, strict=True):
        sd = np.sqrt(moves * share + (1 - moves) * still)
        in_time += np.outer(sd, sd) * _spline_correlation(at_s, spacing)
    alike = np.kron(in_time, errors.mix @ errors.mix.T)
    covariance = 1e-6 * np.eye(len(alike))
    for k in (0, 1):
        forward = facing(truth)
        alpha = wrap(np.arctan2(forward[:, 0], forward[:, 2]) - toward_sensor(truth, T[k][:3, 3]))
        side = np.digitize(np.degrees(np.abs(alpha)), SIDES_DEG)
        hidden = (shared.states[k][kept] != NOT_HIDDEN).astype(np.intp)
        sd = errors.sd_m[np.arange(truth.shape[1]), hidden, side[:, None]].ravel()
        covariance += alike * np.outer(sd, sd)
    used = _weights(shared)[kept] > 0
    used[:, TURNED] = False
    chosen = used.ravel()
    x = apply(true, views[1][kept]).reshape(-1, 3)[chosen]
    r = views[0][kept].reshape(-1, 3)[chosen] - x
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(x), 3, 3)), -cross_matrix(x)], axis=-1)
    L = np.linalg.cholesky(covariance[np.ix_(chosen, chosen)])
    white = solve_triangular(L, np.concatenate([J.reshape(len(x), 18), r], axis=1), lower=True)
    J, r = white[:, :18].reshape(-1, 3, 6), white[:, 18:]
    H += np.einsum("nki,nkj->ij", J, J)
    g += np.einsum("nki,nk->i", J, r)


def _spline_correlation(at_s: Float64, spacing: float) -> Float64:
    knot = np.floor(at_s / spacing).astype(np.int64)
    weights = np.zeros((len(at_s), int(np.ptp(knot)) + 4))
    for row, (k, part) in enumerate(zip((knot - knot.min()).tolist(), (at_s / spacing - knot).tolist(), strict=True)):
        weights[row, k : k + 4] = spline_weights(part)
    return weights @ weights.T
