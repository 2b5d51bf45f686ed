"""Measures the errors of a Kinect v2's skeletons on the study logs, for `mocapella.sources.simulate.measured`.

The recordings have no ground truth. They have two views of one person, d = view 1 − view 2, and the facing α of the
person relative to each sensor, estimated from past and future (`reference_facings`). So the result describes the errors
that make two sensors disagree; errors that both share remain unknown.

1. Labels are corrected if a view's yaw is more than 90° off the facing; how often this happens, and the reported yaw,
   are counted over α. Shoulders, elbows and hips are rotated back to the facing (`labelled_views`).
2. Bias: d = b(α₁) − b(α₂), by ridge regression in each view's own axes, robustly (weights 1/|d|). Left and right are
   mirror images.
3. Noise: |d − b(α₁) + b(α₂)|² = σ²(view 1) + σ²(view 2), by non-negative least squares over front, side and back,
   separately for joints that the own body hides and for visible ones (capsules about the mean skeleton).
4. Correlation in time: the autocorrelation of that residual in Walk, and in Stationary without its mean, as splines
   over knots; and white noise, by joint, to explain the remaining jitter in Stationary.

Steps 2 to 4 are in `sensor_error_fit`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from mocapella.association.proportions import size_difference, sizes
from mocapella.association.tracks import TrackSettings
from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.evaluation.fused_metrics import bone_length_variation, jitter
from mocapella.evaluation.labelled_views import (
    MIRROR,
    STATIONARY,
    LabelledViews,
    labelled_views,
    mirrored_better,
    shoulder_yaw,
    signed_alpha,
)
from mocapella.evaluation.sensor_error_fit import (
    KNOTS_S,
    fit_bias,
    fit_correlation,
    fit_shares,
    fit_spread,
    fit_still_shares,
    fit_white_noise,
    unexplained,
)
from mocapella.evaluation.study_pairs import StudySession, study_sessions
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply
from mocapella.sources.simulate import SensorSettings, SimulatedSensor, build_room, scene_settings
from mocapella.sources.simulate.body import BODY
from mocapella.sources.simulate.measured import (
    KIND,
    Errors,
    SensorErrors,
    toward_sensor,
)
from mocapella.sources.simulate.scenarios import STILL_S

Float64 = NDArray[np.float64]

MIRROR_KNOTS_S: Final = 1.0
"""Knot spacing of the spline that times label swaps; simulated and real labels then swap about equally often [s]."""
SHARPER: Final = 2.0
"""Factor on the normal deviate of the probability of swapped labels. The facing is itself estimated, which blurs that
probability over α. With this factor, swapping the labels of one of two simulated sensors side by side brings their
views nearer about as often as for the recorded ones."""
LOST_AFTER: Final = 0.12
"""A longer gap of one sensor while the other continues is a loss [s]."""
_BINS_DEG: Final = np.arange(0, 181, 15)
_SHARES_DEG: Final = tuple(range(-150, 151, 30))
"""Limits of the bins of the facing α at the first sensor, positive towards the second [deg]."""
_SECOND_SENSOR: Final[dict[str, dict[str, Any]]] = {
    "parallel": {"position": (-0.5, 1.0, 0.0)},
    "45": {"position": (-1.98, 1.0, 0.82), "yaw_deg": 45.0},
    "90": {"position": (-2.8, 1.0, 2.8), "yaw_deg": 90.0},
}


def measure(folder: Path, on_file: Any = lambda name: None) -> SensorErrors:
    """Measure the errors of the sensors in all study logs of a folder; ``on_file`` is called with each file's name.

    Raises:
        InputError: no log, or none of one person in Stationary, Steps and Walk with a front sensor.
    """
    sessions = list(study_sessions(folder, None, on_file))
    views = [found for session in sessions if (found := labelled_views(session)) is not None]
    if not views:
        fix = "it wants logs of one person with Stationary, Steps and Walk, and a front sensor"
        raise InputError("has nothing to measure a sensor's errors on", file=folder, fix=fix)
    yaw = _yaw_tables(views)
    bias = fit_bias(views)
    rests = [unexplained(view, bias) for view in views]
    sd = fit_spread(views, rests)
    share = fit_shares([rest[view.walk] for view, rest in zip(views, rests, strict=True)])
    share /= share.sum()
    still = fit_still_shares(views, rests, sd)
    losses, minutes = _losses(sessions)
    return SensorErrors(
        measured_on=_statement(views, rests, losses, minutes, sessions),
        **yaw,
        bias_m=_rounded(bias, 4),
        sd_m=_rounded(sd, 4),
        correlation=_rounded(fit_correlation(views, rests, sd), 3),
        white_m=_rounded(fit_white_noise(views, sd, still), 4),
        knots_s=list(KNOTS_S),
        share=_rounded(share, 3),
        still_share=_rounded(still, 4),
        mirror_knots_s=MIRROR_KNOTS_S,
        losses_per_min=round(len(losses) / minutes, 3),
        loss_s=_rounded(np.quantile(losses, np.linspace(0.025, 0.975, 20)), 2) if losses else [],
        joint_lost=_joint_lost(sessions),
    )


def as_simulated(errors: SensorErrors, seeds: Sequence[int] = (0, 1, 2)) -> dict[str, dict[str, Any]]:
    """Compute figures of two simulated sensors with given errors, to compare them with the recorded ones.

    The simulated walk has another route, so its frames are weighted to match the recorded distribution of the facing α
    relative to the first sensor; jitter and bone lengths are not weighted.

    Args:
        errors: the measured errors, with the recorded figures in ``measured_on["by_placement"]``.
        seeds: random seeds of the simulated rooms.

    Returns:
        For each recorded placement, by the keys of its recorded figures: ``walk_dd_cm``, ``mirrored_better_percent``,
        ``bone_length_variation_percent`` and ``stationary_jitter_mm``.
    """
    base = scene_settings("walk")
    out: dict[str, dict[str, Any]] = {}
    for placement, recorded in errors.measured_on["by_placement"].items():
        distances, swapped, alphas, still, bones = [], [], [], [], []
        for seed in seeds:
            sensors = (
                SensorSettings("first", errors=KIND),
                SensorSettings("second", errors=KIND, **_SECOND_SENSOR[placement]),
            )
            room = build_room(dataclasses.replace(base, sensors=sensors, seed=seed))
            views = (SimulatedSensor(room, name, Errors(errors)).frames(0.0, room.duration_s) for name in (1, 2))
            items = [pair for pair in zip(*views, strict=True) if pair[0].frame.bodies and pair[1].frame.bodies]
            seen = np.array([[apply(i.truth.T_world_sensor, i.frame.positions[0]) for i in pair] for pair in items])
            true = np.array([pair[0].truth.positions[0] for pair in items])
            walks = np.array([pair[0].truth.room_ns for pair in items]) > STILL_S * NS_PER_S
            straight, crossed = (
                np.nanmean(np.linalg.norm(seen[:, 0] - other, axis=-1), axis=-1)
                for other in (seen[:, 1], seen[:, 1][:, MIRROR])
            )
            distances.append(straight[walks])
            swapped.append((crossed < straight)[walks])
            eyes = [item.truth.T_world_sensor[:3, 3] for item in items[0]]
            toward = np.stack([toward_sensor(true, eye) for eye in eyes], axis=1)
            alphas.append(signed_alpha(wrap(shoulder_yaw(true) - toward[:, 0]), toward)[walks])
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


def _weights(alpha: Float64, share: Sequence[float]) -> Float64:
    which = np.digitize(np.degrees(alpha), _SHARES_DEG)
    there = np.bincount(which, minlength=len(share)) / len(alpha)
    return np.asarray((np.array(share) / np.maximum(there, 1e-9))[which])


def _yaw_tables(views: Sequence[LabelledViews]) -> dict[str, list[float]]:
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
        # Straight ahead or straight back, the yaw has no sign.
        rows = [[m[0], *m, m[-1]] for m in (mean.tolist(), sd.tolist())]
        rows[0][end] = 0.0
        table[f"{prefix}yaw_deg"], table[f"{prefix}yaw_sd_deg"] = (_rounded(row, 1) for row in rows)
    return table


def _losses(sessions: Sequence[StudySession]) -> tuple[list[float], float]:
    """Return the durations [s] for which one sensor lost a single person whom the other saw, and the sensor minutes."""
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
    views: Sequence[LabelledViews],
    rests: Sequence[Float64],
    losses: Sequence[float],
    minutes: float,
    sessions: Sequence[StudySession],
) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for placement in dict.fromkeys(view.placement for view in views):
        of = [(view, rest) for view, rest in zip(views, rests, strict=True) if view.placement == placement]
        walks = [view.raw.positions[view.walk] for view, _ in of]
        still = [view.raw.positions[view.raw.task == STATIONARY] for view, _ in of]
        figures[placement] = {
            "sessions": len(of),
            "walk_dd_cm": _mean([np.linalg.norm(p[:, 0] - p[:, 1], axis=-1).mean() * 100 for p in walks]),
            "walk_alpha_share": _rounded(
                _alpha_share([signed_alpha(v.alpha[v.walk, 0], v.raw.toward[v.walk]) for v, _ in of]), 3
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


def _lengths(view: LabelledViews) -> Float64:
    moving = view.raw.positions[view.raw.task != STATIONARY]
    return np.stack([sizes(moving[:, k], BODY) for k in range(2)], axis=1)


def _alpha_share(alphas: Sequence[Float64]) -> Float64:
    """Return the share (bins,) of the frames by α, averaged over sessions."""
    which = [np.digitize(np.degrees(alpha), _SHARES_DEG) for alpha in alphas]
    return np.asarray(np.mean([np.bincount(w, minlength=len(_SHARES_DEG) + 1) / len(w) for w in which], axis=0))


def _by_joint(views: Sequence[LabelledViews]) -> dict[str, float]:
    still = [view.raw.positions[view.raw.task == STATIONARY][:, k] for view in views for k in range(2)]
    figures = [_mean([1000 * jitter(p[:, [j]]) for p in still]) for j in range(len(BODY))]
    return dict(zip(BODY.joints, figures, strict=True))


def _by_distance(views: Sequence[LabelledViews]) -> dict[str, float]:
    """Return by distance the median jitter of frames facing the sensor, not in Walk: RMS second difference [mm]."""
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


def told_apart(lengths: Sequence[tuple[int, Float64]], near: float, window: int = 30) -> dict[str, float]:
    """Measure how well body lengths identify a person (`mocapella.association.proportions`).

    Args:
        lengths: for each session the participant, and (frames, views, lengths) [m].
        near: largest `size_difference` that counts as the same person [ratio].
        window: number of frames of a window; its mean lengths are compared with the means of whole sessions.

    Returns:
        Percentages of the comparisons in which a window is nearer to its own session (``same_nearer``), or to another
        session of the same person, than to another person's session; and in which it is within ``near`` of its own,
        another of the same person, or another person's session. Empty for a single person.
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
