"""How wrong a Kinect v2's skeletons are, measured on the study logs: tables of `mocapella.sources.simulate.measured`.

Nobody knows the truth of a recording. Known are two views of one person, d = view 1 − view 2, and the facing α of the
person against each sensor, from past and future (`reference_facings`). So what is found here is what makes two sensors
disagree; an error that both share stays unknown.

1. Labels are put right where a view's yaw is more than 90° off the facing; how often, and which yaw a view reports, is
   counted over α. Shoulders, elbows and hips are turned back to the facing.
2. Bias: d = b(α₁) − b(α₂), by ridge regression in each view's own axes, robustly (weights 1/|d|). Left and right are
   mirror images.
3. Noise: |d − b(α₁) + b(α₂)|² = σ²(view 1) + σ²(view 2), by non-negative least squares over front, side and back, each
   for joints that the own body hides and for those that it does not (capsules about the mean skeleton).
4. Its course in time: the autocorrelation of that rest in Walk, and in Stationary without its mean, as splines over
   knots; and white noise, by joint, as much as the jitter in Stationary shows beside them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import ndtr, ndtri

from mocapella.association.proportions import size_difference, sizes
from mocapella.association.tracks import TrackSettings
from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.evaluation.facing_sessions import AlignedViews, aligned_views, facing_session, reference_facings
from mocapella.evaluation.fused_metrics import bone_length_variation, jitter
from mocapella.evaluation.study_pairs import StudySession, study_sessions
from mocapella.fusion.facing_model import shipped_model
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply
from mocapella.model.session import SCENARIOS
from mocapella.sources.simulate import SensorSettings, SimulatedSensor, build_room, scene_settings
from mocapella.sources.simulate.body import BODY, JOINT, body_template
from mocapella.sources.simulate.measured import (
    BIAS_BINS,
    KIND,
    SIDES_DEG,
    TURNED,
    Errors,
    SensorErrors,
    bias_place,
    spline_weights,
    toward_sensor,
    turned_about_spine,
    view_axes,
)
from mocapella.sources.simulate.occlusion import hidden, obstacles
from mocapella.sources.simulate.scenarios import STILL_S

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

KNOTS_S: Final = (0.1, 0.4, 2.0)
"""More spacings describe the autocorrelation hardly better."""
MIRROR_KNOTS_S: Final = 1.0
"""With it, simulated sensors swap labels about as often a minute as the recorded ones (docs/simulation.md)."""
SHARPER: Final = 2.0
"""The facing is itself estimated, which blurs over α how often labels are swapped. So much clearer (of the
probability's normal deviate), two simulated sensors side by side are nearer with swapped labels about as often as the
recorded."""
RIDGE: Final = 0.02
"""Of the mean diagonal: what no pair of views can tell is taken as 0."""
LARGEST: Final = 0.3
"""Larger differences count as this, so that a lost limb is not the measure of all [m]."""
MEAN_LENGTH: Final = np.sqrt(8 / np.pi)
"""Of a normal vector in space whose coordinates have variance 1."""
LOST_AFTER: Final = 0.12
"""A longer gap of one sensor while the other goes on is a loss [s]."""
_WALK: Final = SCENARIOS["walk"]
_STATIONARY: Final = SCENARIOS["stationary"]
_BINS_DEG: Final = np.arange(0, 181, 15)
_SHARES_DEG: Final = tuple(range(-150, 151, 30))
"""Between them lie the bins of α at the first sensor, positive towards the second."""
_STOOD: Final[dict[str, dict[str, Any]]] = {
    "parallel": {"position": (-0.5, 1.0, 0.0)},
    "45": {"position": (-1.98, 1.0, 0.82), "yaw_deg": 45.0},
    "90": {"position": (-2.8, 1.0, 2.8), "yaw_deg": 90.0},
}
_MIRROR: Final = np.array(BODY.mirror)
_LAGS: Final = np.array([0, 1, 2, 3, 4, 6, 8, 10, 12, 15, 20, 30, 45])
_LAG_S: Final = 0.035
"""Rows of the log are this far apart [s]."""


class _Views(msgspec.Struct, frozen=True, eq=False):
    """A session: both views with true labels, turned to the facing, and brought to one instant.

    Attributes:
        placement, participant: of the file.
        raw: what was aligned.
        alpha: (frames, 2) [rad]. reported: (frames, 2) yaw of the labels from the direction to the sensor [rad].
        mirrored: (frames, 2).
        positions: (frames, 2, joints, 3) [m].
        hidden: (frames, 2, joints) by the person's own body.
    """

    placement: str
    participant: int
    raw: AlignedViews
    alpha: Float64
    reported: Float64
    mirrored: Bools
    positions: Float64
    hidden: Bools

    @property
    def walk(self) -> Bools:
        """(frames,)."""
        return np.asarray(self.raw.task == _WALK)


def measure(folder: Path, on_file: Any = lambda name: None) -> SensorErrors:
    """Measure all logs of a folder.

    Raises:
        InputError: no log, or none of one person in Stationary, Steps and Walk.
    """
    sessions = list(study_sessions(folder, None, on_file))
    views = [found for session in sessions if (found := _views(session)) is not None]
    if not views:
        fix = "it wants logs of one person with Stationary, Steps and Walk, and a front sensor"
        raise InputError("has nothing to measure a sensor's errors on", file=folder, fix=fix)
    yaw = _yaw_tables(views)
    bias = _bias(views)
    rests = [_rest(view, bias) for view in views]
    sd = _spread(views, rests)
    share = _shares([rest[view.walk] for view, rest in zip(views, rests, strict=True)])
    share /= share.sum()
    still = _still_shares(views, rests, sd)
    losses, minutes = _losses(sessions)
    return SensorErrors(
        measured_on=_statement(views, rests, losses, minutes, sessions),
        **yaw,
        bias_m=_rounded(bias, 4),
        sd_m=_rounded(sd, 4),
        correlation=_rounded(_correlation(views, rests, sd), 3),
        white_m=_rounded(_white(views, sd, still), 4),
        knots_s=list(KNOTS_S),
        share=_rounded(share, 3),
        still_share=_rounded(still, 4),
        mirror_knots_s=MIRROR_KNOTS_S,
        losses_per_min=round(len(losses) / minutes, 3),
        loss_s=_rounded(np.quantile(losses, np.linspace(0.025, 0.975, 20)), 2) if losses else [],
        joint_lost=_joint_lost(sessions),
    )


def as_simulated(errors: SensorErrors, seeds: Sequence[int] = (0, 1, 2)) -> dict[str, dict[str, Any]]:
    """By placement what `SensorErrors.measured_on` has of the recordings, of simulated sensors that have these errors.

    The simulated walk is another route. So frames count by α at the first sensor as the recorded ones do.
    """
    base = scene_settings("walk")
    out: dict[str, dict[str, Any]] = {}
    for placement, recorded in errors.measured_on["by_placement"].items():
        distances, swapped, alphas, still, bones = [], [], [], [], []
        for seed in seeds:
            sensors = (SensorSettings("first", errors=KIND), SensorSettings("second", errors=KIND, **_STOOD[placement]))
            room = build_room(dataclasses.replace(base, sensors=sensors, seed=seed))
            views = (SimulatedSensor(room, name, Errors(errors)).frames(0.0, room.duration_s) for name in (1, 2))
            items = [pair for pair in zip(*views, strict=True) if pair[0].frame.bodies and pair[1].frame.bodies]
            seen = np.array([[apply(i.truth.T_world_sensor, i.frame.positions[0]) for i in pair] for pair in items])
            true = np.array([pair[0].truth.positions[0] for pair in items])
            walks = np.array([pair[0].truth.room_ns for pair in items]) > STILL_S * NS_PER_S
            straight, crossed = (
                np.nanmean(np.linalg.norm(seen[:, 0] - other, axis=-1), axis=-1)
                for other in (seen[:, 1], seen[:, 1][:, _MIRROR])
            )
            distances.append(straight[walks])
            swapped.append((crossed < straight)[walks])
            eyes = [item.truth.T_world_sensor[:3, 3] for item in items[0]]
            toward = np.stack([toward_sensor(true, eye) for eye in eyes], axis=1)
            alphas.append(_signed(wrap(_shoulder_yaw(true) - toward[:, 0]), toward)[walks])
            bones.append(100 * bone_length_variation(seen[walks][:, 0]))
            still.append(1000 * jitter(seen[~walks][:, 0]))
        weight = _weights(np.concatenate(alphas), recorded["walk_alpha_share"])
        out[placement] = {
            "walk_dd_cm": round(float(100 * np.average(np.concatenate(distances), weights=weight)), 2),
            "mirrored_better_percent": round(float(100 * np.average(np.concatenate(swapped), weights=weight)), 2),
            "bone_length_variation_percent": _mean(bones),
            "stationary_jitter_mm": _mean(still),
        }
    return out


def _signed(alpha: Float64, toward: Float64) -> Float64:
    """α at the first sensor, positive where the person is turned to the side where the second one stands."""
    return np.asarray(alpha * np.sign(np.median(wrap(toward[:, 1] - toward[:, 0]))))


def _weights(alpha: Float64, share: Sequence[float]) -> Float64:
    which = np.digitize(np.degrees(alpha), _SHARES_DEG)
    there = np.bincount(which, minlength=len(share)) / len(alpha)
    return np.asarray((np.array(share) / np.maximum(there, 1e-9))[which])


def mirrored_better(one: Float64, other: Float64) -> float:
    """Share of the frames in which two views (frames, joints, 3) are nearer with one of them's labels swapped."""
    straight, crossed = (np.linalg.norm(one - p, axis=-1).mean(axis=-1) for p in (other, other[:, _MIRROR]))
    return float((crossed < straight).mean())


def _views(session: StudySession) -> _Views | None:
    raw, facing = aligned_views(session), facing_session(session)
    if raw is None or facing is None:
        return None
    yaw = reference_facings([facing], shipped_model())[0]
    alpha, reported = wrap(yaw[:, None] - raw.toward), wrap(_shoulder_yaw(raw.positions) - raw.toward)
    mirrored = np.abs(wrap(alpha - reported)) > np.pi / 2
    labelled = np.where(mirrored[..., None, None], raw.positions[:, :, _MIRROR], raw.positions)
    turned = labelled.copy()
    turn = wrap(alpha - np.where(mirrored, reported + np.pi, reported))
    turned[:, :, TURNED] = turned_about_spine(labelled, turn)[:, :, TURNED]
    return _Views(
        session.placement,
        session.participant,
        raw,
        np.asarray(alpha),
        np.asarray(reported),
        mirrored,
        _at_one_time(turned, raw),
        _hidden(turned, raw),
    )


def _shoulder_yaw(positions: Float64) -> Float64:
    across = positions[..., JOINT["ShoulderLeft"], :] - positions[..., JOINT["ShoulderRight"], :]
    return np.asarray(np.arctan2(-across[..., 2], across[..., 0]))


def _at_one_time(positions: Float64, raw: AlignedViews) -> Float64:
    """The second view at the first one's instants, by the constant offset that makes them nearest."""
    moving = raw.task != _STATIONARY
    flat = positions[:, 1].reshape(len(positions), -1)

    def second(offset_s: float) -> Float64:
        at_s = raw.at_s[:, 0] + offset_s
        order = np.argsort(raw.at_s[:, 1])
        columns = [np.interp(at_s, raw.at_s[order, 1], column[order]) for column in flat.T]
        return np.stack(columns, axis=1).reshape(positions[:, 1].shape)

    def apart(offset_s: float) -> float:
        return float(np.linalg.norm(positions[:, 0] - second(offset_s), axis=-1)[moving].mean())

    return np.stack([positions[:, 0], second(min(np.arange(-0.08, 0.081, 0.01), key=apart))], axis=1)


def _hidden(positions: Float64, raw: AlignedViews) -> Bools:
    trunk = positions[..., JOINT["Head"], :] - positions[..., JOINT["SpineBase"], :]
    drawn = body_template().offsets[[JOINT[name] for name in ("SpineMid", "SpineShoulder", "Neck", "Head")]]
    stature = np.median(np.linalg.norm(trunk, axis=-1)) / np.linalg.norm(drawn.sum(axis=0))
    radii, nothing = (body_template().radii * stature)[None], obstacles((), ())
    mean = positions.mean(axis=1)
    return np.array([[hidden(eye, body[None], radii, nothing)[0] for eye in raw.places] for body in mean])


def _yaw_tables(views: Sequence[_Views]) -> dict[str, list[float]]:
    alpha = np.concatenate([view.alpha[view.walk].ravel() for view in views])
    yaw = np.concatenate([view.reported[view.walk].ravel() for view in views])
    mirrored = np.concatenate([view.mirrored[view.walk].ravel() for view in views])
    degrees, yaw = np.degrees(np.abs(alpha)), np.degrees(wrap(np.where(alpha < 0, -1, 1) * yaw))
    which = np.digitize(degrees, _BINS_DEG[1:-1])
    middles = (_BINS_DEG[:-1] + _BINS_DEG[1:]) / 2
    table: dict[str, list[float]] = {"alpha_deg": [0.0, *middles.tolist(), 180.0], "mirrored": []}
    share = [float(mirrored[which == i].mean()) for i in range(len(middles))]
    clear = ndtr(SHARPER * ndtri(np.clip(share, 1e-4, 1 - 1e-4)))
    table["mirrored"] = _rounded([clear[0], *clear, clear[-1]], 3)
    for prefix, chosen, end in (("", ~mirrored, 0), ("mirrored_", mirrored, -1)):
        known = [i for i in range(len(middles)) if (chosen & (which == i)).sum() >= 30]
        of = [yaw[chosen & (which == i)] for i in known]
        mean = np.interp(middles, middles[known], [np.median(values) for values in of])
        sd = np.interp(middles, middles[known], [1.4826 * np.median(np.abs(v - np.median(v))) for v in of])
        # Straight to the front or to the back neither side is meant.
        rows = [[m[0], *m, m[-1]] for m in (mean.tolist(), sd.tolist())]
        rows[0][end] = 0.0
        table[f"{prefix}yaw_deg"], table[f"{prefix}yaw_sd_deg"] = (_rounded(row, 1) for row in rows)
    return table


def _bias(views: Sequence[_Views]) -> Float64:
    """(25, `BIAS_BINS`, 3)."""
    size = 3 * BIAS_BINS
    bias = np.empty((len(BODY), BIAS_BINS, 3))
    for joint in range(len(BODY)):
        N, g = np.zeros((size, size)), np.zeros(size)
        for view in views:
            for mirror in (False, True):
                d = np.subtract(*view.positions[:, :, _MIRROR[joint] if mirror else joint].swapaxes(0, 1))
                X = _design(view.alpha, view.raw.toward, mirror)
                w = 1 / np.maximum(np.linalg.norm(d, axis=1), 0.02)
                N += np.einsum("nij,nik,n->jk", X, X, w, optimize=True)
                g += np.einsum("nij,ni,n->j", X, d, w, optimize=True)
        bias[joint] = np.linalg.solve(N + RIDGE * np.trace(N) / size * np.eye(size), g).reshape(BIAS_BINS, 3)
    return bias


def _design(alpha: Float64, toward: Float64, mirror: bool) -> Float64:
    """(frames, 3, 3 · `BIAS_BINS`): what each coefficient adds to view 1 − view 2."""
    X = np.zeros((len(alpha), 3, BIAS_BINS, 3))
    frames = np.arange(len(alpha))
    for view, sign in ((0, 1.0), (1, -1.0)):
        first, second, part = bias_place(-alpha[:, view] if mirror else alpha[:, view])
        axes = sign * view_axes(toward[:, view])
        if mirror:
            axes[:, :, 0] *= -1
        X[frames, :, first] += (1 - part)[:, None, None] * axes
        X[frames, :, second] += part[:, None, None] * axes
    return X.reshape(len(alpha), 3, -1)


def _rest(view: _Views, bias: Float64) -> Float64:
    """(frames, joints, 3) what the bias leaves of view 1 − view 2."""
    X = _design(view.alpha, view.raw.toward, mirror=False)
    explained = np.einsum("nij,kj->nki", X, bias.reshape(len(bias), -1))
    return np.asarray(view.positions[:, 0] - view.positions[:, 1] - explained)


def _spread(views: Sequence[_Views], rests: Sequence[Float64]) -> Float64:
    """(25, 2, 3) standard deviation of a coordinate of one view."""
    sd = np.empty((len(BODY), 2, 3))
    for joint in range(len(BODY)):
        rows, lengths = [], []
        for view, rest in zip(views, rests, strict=True):
            side = np.digitize(np.degrees(np.abs(view.alpha[view.walk])), SIDES_DEG)
            for one in {joint, int(_MIRROR[joint])}:
                place = side + 3 * view.hidden[view.walk][:, :, one]
                rows.append((place[..., None] == np.arange(6)).sum(axis=1))
                lengths.append(np.minimum(np.linalg.norm(rest[view.walk][:, one], axis=-1), LARGEST))
        X, length = np.concatenate(rows).astype(np.float64), np.concatenate(lengths)
        few = X.sum(axis=0) < 100
        variance = nnls(X, length**2 / 3)[0]
        # The rest has long tails: normal noise of that variance would be too far off on the average.
        variance *= (length.mean() / (MEAN_LENGTH * np.sqrt(X @ variance).mean())) ** 2
        variance = variance.reshape(2, 3)
        # A case that hardly occurs is like the nearest that does.
        for state, side in zip(*np.nonzero(few.reshape(2, 3)), strict=True):
            variance[state, side] = variance[state][~few.reshape(2, 3)[state]].max(initial=variance[0].max())
        sd[joint] = np.sqrt(variance)
    return sd


def _variance(view: _Views, chosen: Bools, sd: Float64) -> Float64:
    """(chosen frames, joints) of the rest, as ``sd`` has it of both views [m²]."""
    side = np.digitize(np.degrees(np.abs(view.alpha[chosen])), SIDES_DEG)[..., None]
    return np.asarray((sd[np.arange(len(BODY)), view.hidden[chosen].astype(int), side] ** 2).sum(axis=1))


def _correlation(views: Sequence[_Views], rests: Sequence[Float64], sd: Float64) -> Float64:
    """(25, 25) of the rest in Walk, its three coordinates alike, left and right alike."""
    total = np.zeros((len(BODY), len(BODY)))
    for view, rest in zip(views, rests, strict=True):
        unit = np.clip(rest[view.walk] / np.sqrt(_variance(view, view.walk, sd))[..., None], -3, 3)
        total += np.einsum("nic,njc->ij", unit, unit, optimize=True)
    total += total[np.ix_(_MIRROR, _MIRROR)]
    spread = np.sqrt(np.diag(total))
    return np.asarray(total / spread / spread[:, None])


def autocovariance(rests: Sequence[Float64]) -> Float64:
    """(lags,) of sequences (frames, joints, 3), at the lags `_LAGS` [m²]."""
    total, count = np.zeros(len(_LAGS)), np.zeros(len(_LAGS))
    for rest in rests:
        clipped = np.clip(rest, -LARGEST, LARGEST)
        for i, lag in enumerate(_LAGS):
            if lag < len(rest):
                total[i] += (clipped[lag:] * clipped[: len(rest) - lag]).sum()
                count[i] += clipped[lag:].size
    return np.asarray(total / np.maximum(count, 1))


def _shares(rests: Sequence[Float64]) -> Float64:
    """(knots,) parts of the variance [m²]; what is white is in it at first, and is then left out."""
    basis = [_knot_autocorrelation(knot, _LAGS * _LAG_S) for knot in KNOTS_S]
    share = nnls(np.stack([_LAGS == 0, *basis], axis=1).astype(np.float64), autocovariance(rests))[0][1:]
    return np.asarray(share)


def _still_shares(views: Sequence[_Views], rests: Sequence[Float64], sd: Float64) -> Float64:
    """(knots,) of the variance that a view of the same joint has in Walk."""
    still, expected = [], []
    for view, rest in zip(views, rests, strict=True):
        chosen = view.raw.task == _STATIONARY
        still.append(rest[chosen] - rest[chosen].mean(axis=0))
        expected.append(_variance(view, chosen, sd).mean())
    return np.asarray(_shares(still) / np.average(expected, weights=[len(rest) for rest in still]))


def _white(views: Sequence[_Views], sd: Float64, share: Float64) -> Float64:
    """(25,) standard deviation of a coordinate of somebody who stands and faces the sensor [m]."""
    still = [
        view.raw.positions[view.raw.task == _STATIONARY][:, k]
        for view in views
        for k in range(2)
        if np.degrees(np.abs(view.alpha[~view.walk, k])).mean() < SIDES_DEG[0]
    ]
    # Of a coordinate: a second difference of white noise has 6 times its variance.
    measured = np.array([np.median([jitter(p[:, [j]]) for p in still]) for j in range(len(BODY))]) ** 2 / 3
    smooth = sum(
        part * float(np.array([6.0, -8.0, 2.0]) @ _knot_autocorrelation(knot, np.arange(3, dtype=np.float64) * _LAG_S))
        for knot, part in zip(KNOTS_S, share, strict=True)
    )
    return np.asarray(np.sqrt(np.maximum(measured - smooth * sd[:, 0, 0] ** 2, 0.0) / 6))


def _knot_autocorrelation(knot_s: float, lag_s: Float64) -> Float64:
    at = np.arange(0.0, 1.0, 1 / 64)

    def weights(time: Float64) -> Float64:
        whole = np.floor(time).astype(int)
        out = np.zeros((len(time), int(lag_s.max() / knot_s) + 6))
        for row, (k, t) in enumerate(zip(whole, time, strict=True)):
            out[row, k : k + 4] = spline_weights(float(t - k))
        return out

    return np.array([(weights(at) * weights(at + lag / knot_s)).sum(axis=1).mean() for lag in lag_s])


def _losses(sessions: Sequence[StudySession]) -> tuple[list[float], float]:
    """How long one sensor lost a person whom the other saw, alone in the room [s]; of how many minutes of a sensor."""
    gaps: list[float] = []
    minutes = 0.0
    for session in sessions:
        if session.two_people:
            continue
        times = [np.unique(session.at_s[session.sensor == k]) for k in range(len(session.replay.sensors))]
        for one, other in zip(times, reversed(times), strict=True):
            steps = np.diff(one)
            minutes += float(np.minimum(steps, 1.0).sum()) / 60
            long = np.flatnonzero(steps > LOST_AFTER)
            gaps += [float(steps[i]) for i in long if ((other > one[i]) & (other < one[i + 1])).sum() > 2]
    return gaps, minutes


def _joint_lost(sessions: Sequence[StudySession]) -> float:
    missing = [~np.isfinite(session.log.positions[..., 0]) for session in sessions if session.two_people]
    return round(float(np.mean(np.concatenate(missing))), 6) if missing else 0.0


def _statement(
    views: Sequence[_Views],
    rests: Sequence[Float64],
    losses: Sequence[float],
    minutes: float,
    sessions: Sequence[StudySession],
) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for placement in dict.fromkeys(view.placement for view in views):
        of = [(view, rest) for view, rest in zip(views, rests, strict=True) if view.placement == placement]
        walks = [view.raw.positions[view.walk] for view, _ in of]
        still = [view.raw.positions[view.raw.task == _STATIONARY] for view, _ in of]
        figures[placement] = {
            "sessions": len(of),
            "walk_dd_cm": _mean([np.linalg.norm(p[:, 0] - p[:, 1], axis=-1).mean() * 100 for p in walks]),
            "walk_alpha_share": _rounded(
                _alpha_share([_signed(v.alpha[v.walk, 0], v.raw.toward[v.walk]) for v, _ in of]), 3
            ),
            "walk_rest_cm": _mean([np.linalg.norm(r[v.walk], axis=-1).mean() * 100 for v, r in of]),
            "bone_length_variation_percent": _mean([100 * bone_length_variation(p[:, 0]) for p in walks]),
            "mirrored_better_percent": _mean([100 * mirrored_better(p[:, 0], p[:, 1]) for p in walks]),
            "stationary_jitter_mm": _mean([1000 * jitter(p[:, k]) for p in still for k in range(2)]),
        }
    walks_min = sum(2 * np.ptp(view.raw.at_s[view.walk, 0]) for view in views) / 60
    swaps = sum(int(np.diff(view.mirrored[view.walk], axis=0).sum()) for view in views)
    return {
        "recordings": "study logs of KinectMultiTrack, 2015 (MIT): two Kinect v2, one room, one route",
        "participants": sorted({view.participant for view in views}),
        "sessions": len(views),
        "walk_frames": int(sum(view.walk.sum() for view in views)),
        "two_person_sessions": sum(session.two_people for session in sessions),
        "sensor_minutes": round(minutes, 1),
        "losses": len(losses),
        "label_swaps_per_min": round(float(swaps / walks_min), 2),
        "jitter_mm_by_joint": _by_joint(views),
        "jitter_mm_by_distance_m": _by_distance(views),
        "by_placement": figures,
        "told_apart_by_lengths": told_apart(
            [(view.participant, _lengths(view)) for view in views], TrackSettings().same_size
        ),
    }


def _lengths(view: _Views) -> Float64:
    moving = view.raw.positions[view.raw.task != _STATIONARY]
    return np.stack([sizes(moving[:, k], BODY) for k in range(2)], axis=1)


def _alpha_share(alphas: Sequence[Float64]) -> Float64:
    """(bins,) share of the frames by α, mean over sessions."""
    which = [np.digitize(np.degrees(alpha), _SHARES_DEG) for alpha in alphas]
    return np.asarray(np.mean([np.bincount(w, minlength=len(_SHARES_DEG) + 1) / len(w) for w in which], axis=0))


def told_apart(lengths: Sequence[tuple[int, Float64]], near: float, window: int = 30) -> dict[str, float]:
    """How well the lengths of a body tell who it is (`mocapella.association.proportions`).

    Args:
        lengths: of each session the participant, and (frames, views, lengths) [m].
        near: a difference up to this is taken for the same person.
        window: frames that are compared with whole sessions.

    Returns:
        For the same session (the window is one of its frames) and for another one of the same person: in how many
        percent the window is nearer to it than to another person's, and is near; and how often it is near another's.
        Nothing of a single person.
    """
    if len({person for person, _ in lengths}) < 2:
        return {}
    whole = [np.nanmean(frames, axis=(0, 1)) for _, frames in lengths]
    hits: dict[str, list[float]] = {name: [] for name in ("same_nearer", "other_session_nearer", "same_near")}
    hits |= {"other_session_near": [], "other_person_near": []}
    for i, (person, frames) in enumerate(lengths):
        for start in range(0, len(frames) - window, 3 * window):
            seen = np.nanmean(frames[start : start + window], axis=(0, 1))
            d = np.array([size_difference(seen, mean) for mean in whole])
            strangers = np.array([who != person for who, _ in lengths])
            own = [k for k, (who, _) in enumerate(lengths) if who == person and k != i]
            hits["same_nearer"].append(float((d[i] < d[strangers]).mean()))
            hits["same_near"].append(float(d[i] <= near))
            hits["other_person_near"].append(float((d[strangers] <= near).mean()))
            hits["other_session_nearer"] += [float((d[k] < d[strangers]).mean()) for k in own]
            hits["other_session_near"] += [float(d[k] <= near) for k in own]
    return {f"{name}_percent": round(100 * float(np.mean(of)), 1) for name, of in hits.items() if of}


def _by_joint(views: Sequence[_Views]) -> dict[str, float]:
    still = [view.raw.positions[view.raw.task == _STATIONARY][:, k] for view in views for k in range(2)]
    figures = [_mean([1000 * jitter(p[:, [j]]) for p in still]) for j in range(len(BODY))]
    return dict(zip(BODY.joints, figures, strict=True))


def _by_distance(views: Sequence[_Views]) -> dict[str, float]:
    """Median over frames of the root mean square second difference of the joints, facing the sensor, not in Walk."""
    distance, jitters = [], []
    for view in views:
        for k in range(2):
            p = view.raw.positions[:, k]
            second = p[2:] - 2 * p[1:-1] + p[:-2]
            used = ~view.walk[1:-1] & (np.abs(view.alpha[1:-1, k]) < np.radians(45))
            away = np.linalg.norm((p.mean(axis=1) - view.raw.places[k])[:, [0, 2]], axis=-1)[1:-1]
            distance.append(away[used])
            jitters.append(1000 * np.sqrt((second**2).sum(axis=-1).mean(axis=-1))[used])
    far, values = np.concatenate(distance), np.concatenate(jitters)
    bins = [(low, (far >= low) & (far < low + 0.4)) for low in np.arange(1.4, 4.2, 0.4)]
    return {f"{low:.1f}-{low + 0.4:.1f}": round(float(np.median(values[m])), 1) for low, m in bins if m.sum() >= 500}


def _mean(values: Sequence[Any]) -> float:
    return round(float(np.mean(values)), 2)


def _rounded(values: Any, decimals: int) -> list[Any]:
    out: list[Any] = np.round(np.asarray(values, dtype=np.float64), decimals).tolist()
    return out
