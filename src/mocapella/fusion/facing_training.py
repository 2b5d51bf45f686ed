"""Learn the likelihood of views given the facing, from recordings whose facings are mostly unknown.

By expectation–maximisation (Dempster, Laird, Rubin, J. R. Stat. Soc. B 39, 1977), the expectation by forward and
backward passes over the bins (Rabiner, Proc. IEEE 77, 1989, section III). Parts with a known facing (participants asked
to face a sensor) fix the solution. In order:

1. the yaw table, from yaws alone;
2. the classifier of shapes, on frames that are certainly front or back; then the shape table;
3. both again, from yaws and shapes; finally the motion table. Motion is never used to learn shapes, so that walking
   backwards is not learnt as walking forwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.fusion.facing import FacingSettings
from mocapella.fusion.facing_grid import BIN, BINS, STEP_S, YAWS, turned, turned_on, unknown
from mocapella.fusion.facing_model import (
    MOST_SCORE,
    SHAPE_BINS,
    SPEEDS,
    YAW_BINS,
    FacingModel,
    log_rows,
    neighbours,
    shape_place,
    untrained,
)
from mocapella.fusion.facing_shape import FEATURES, View, fit_classifier
from mocapella.geometry.angles import wrap
from mocapella.settings import check

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SCORES = np.linspace(-MOST_SCORE, MOST_SCORE, SHAPE_BINS)


class FacingSequence(msgspec.Struct, frozen=True, eq=False):
    """Observations of one person over time.

    Attributes:
        at_s: (frames,) capture times, increasing, on one clock [s].
        view: observations with the axes (frames, views), see `mocapella.fusion.facing_shape.view_of`.
        toward_sensor: (frames, views) yaw from the person to each sensor, world [rad].
        velocity: (frames, 3) velocity of the person in the world, from past frames only [m/s]; NaN where unknown.
        known_yaw: (frames,) facing that the participant was asked to take, world [rad]; NaN if none.
    """

    at_s: Float64
    view: View
    toward_sensor: Float64
    velocity: Float64
    known_yaw: Float64


@dataclass(frozen=True)
class TrainingSettings:
    """Parameters of the training. Chosen by cross-validation over people.

    Attributes:
        known_within_deg: standard deviation of a known facing [deg].
        yaw_rounds, shape_rounds: number of iterations of the module's steps 1 and 3.
        front_deg, back_deg: a view shows a front (back) if the facing α relative to the sensor is within ±front_deg
            (beyond ±back_deg) with a probability above ``sure`` [deg].
        sure: that probability [0 to 1].
        penalty: ridge penalty of the classifier's weights.
        score_sd: standard deviation of the score's offset of a person or sensor unlike the training data.
        yaw_floor, shape_floor, motion_floor: share of each table row's probability that is distributed evenly.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    known_within_deg: float = 10.0
    yaw_rounds: int = 4
    shape_rounds: int = 2
    front_deg: float = 60.0
    back_deg: float = 120.0
    sure: float = 0.9
    penalty: float = 0.1
    score_sd: float = 1.0
    yaw_floor: float = 0.02
    shape_floor: float = 0.05
    motion_floor: float = 0.02

    def __post_init__(self) -> None:
        check(0 < self.known_within_deg <= 45, "known_within_deg", self.known_within_deg, "above 0° up to 45°")
        check(1 <= self.yaw_rounds <= 100, "yaw_rounds", self.yaw_rounds, "from 1 to 100")
        check(1 <= self.shape_rounds <= 100, "shape_rounds", self.shape_rounds, "from 1 to 100")
        check(0 < self.front_deg <= self.back_deg < 180, "front_deg", self.front_deg, "above 0° up to back_deg")
        check(0.5 <= self.sure < 1, "sure", self.sure, "from 0.5 to below 1")
        check(self.penalty > 0, "penalty", self.penalty, "above 0")
        check(0 < self.score_sd <= MOST_SCORE, "score_sd", self.score_sd, f"above 0, up to {MOST_SCORE}")
        for name in ("yaw_floor", "shape_floor", "motion_floor"):
            check(0 < getattr(self, name) <= 1, name, getattr(self, name), "above 0, up to 1")


def evidence(
    view: View, toward_sensor: Float64, model: FacingModel, settings: FacingSettings, scale: Float64
) -> Float64:
    """Return each view's log-likelihoods (..., BINS) over the person's yaw in the world; 0 for missing observations.

    Args:
        view: observations with leading axes (...,).
        toward_sensor: (...,) yaw from the person to the sensor, world, finite [rad].
        model, settings: likelihood tables, and weights of the evidence.
        scale: (...,) weight of each view, 0 to 1: time since the sensor's last view in units of `STEP_S`, at most 1.
    """
    about = settings.yaw_weight * model.yaw_evidence(view.seen)
    shape = model.shape_evidence(view.features)
    if shape is not None:
        about += settings.shape_weight * shape
    return turned(about * scale[..., None], toward_sensor)


def believed(p: Float64, log_evidence: Float64) -> Float64:
    """Return the posterior (..., BINS) of a prior p (..., BINS) and log-likelihoods (..., BINS), by Bayes' rule.

    The prior may have any sum above 0; that of the posterior is 1.
    """
    after = p * np.exp(log_evidence - log_evidence.max(axis=-1, keepdims=True))
    return np.asarray(after / after.sum(axis=-1, keepdims=True))


def posteriors(
    sequences: Sequence[FacingSequence],
    model: FacingModel,
    settings: FacingSettings,
    *,
    smooth: bool = False,
    known_within_deg: float | None = None,
) -> list[Float64]:
    """Estimate the probabilities of the facing in each frame of recorded sequences, all at once, in numpy.

    Args:
        sequences: observations of any people; at least one sequence.
        model, settings: as in `mocapella.fusion.facing.FacingFilter`; for bodies like the training data, its results
            equal these without ``smooth``.
        smooth: whether to use later frames as well.
        known_within_deg: standard deviation of known facings [deg]; None does not use them.

    Returns:
        For each sequence (frames, BINS) probabilities of the facing, world, see `mocapella.fusion.facing_grid`; the sum
        of each frame is 1.
    """
    frames, people = max(len(s.at_s) for s in sequences), len(sequences)
    steps = np.zeros((frames, people))
    log_evidence = np.zeros((frames, people, BINS))
    for i, sequence in enumerate(sequences):
        n = len(sequence.at_s)
        steps[1:n, i] = np.diff(sequence.at_s) / STEP_S
        log_evidence[:n, i] = _evidence(sequence, steps[:n, i], model, settings)
        if known_within_deg is not None:
            off = np.degrees(wrap(YAWS - sequence.known_yaw[:, None])) / known_within_deg
            log_evidence[:n, i] += np.nan_to_num(-0.5 * off**2)
    p = np.empty_like(log_evidence)
    now = np.broadcast_to(unknown(), (people, BINS))
    for k in range(frames):
        p[k] = now = believed(turned_on(now, steps[k]), log_evidence[k])
    if smooth:
        later = np.ones((people, BINS))
        for k in range(frames - 1, -1, -1):
            p[k] *= later
            later = turned_on(believed(later, log_evidence[k]), steps[k])
        p /= p.sum(axis=-1, keepdims=True)
    return [p[: len(s.at_s), i] for i, s in enumerate(sequences)]


def _evidence(sequence: FacingSequence, steps: Float64, model: FacingModel, settings: FacingSettings) -> Float64:
    scale = np.clip(np.append(1.0, steps[1:]), 0.0, 1.0)
    known = np.isfinite(sequence.view.reported)
    total = evidence(sequence.view, sequence.toward_sensor, model, settings, known * scale[:, None]).sum(axis=-2)
    motion_scale = settings.motion_weight * scale * known.any(axis=-1)
    return np.asarray(total + motion_scale[:, None] * model.motion_evidence(sequence.velocity))


def train(
    sequences: Sequence[FacingSequence],
    topology: str,
    settings: FacingSettings | None = None,
    training: TrainingSettings | None = None,
) -> FacingModel:
    """Learn the likelihood tables of a `FacingModel`, for `mocapella lab train facing`.

    The same sequences give the same model. Its ``trained_on`` is empty.

    Args:
        sequences: observations of some people; in some of them a part of the facings must be known.
        topology: name of the topology of the joints.
        settings: weights in the model's later use; the defaults if None.
        training: parameters of the training; the defaults if None.

    Raises:
        InputError: no facing is known, or too few views are certainly of a front, or of a back.
    """
    settings, training = settings or FacingSettings(), training or TrainingSettings()
    if not any(np.isfinite(s.known_yaw).any() for s in sequences):
        raise InputError("no facing is known in any sequence", fix="add frames in which people face a sensor")
    yaws = FacingSettings(yaw_weight=settings.yaw_weight, shape_weight=0.0, motion_weight=0.0)
    both = FacingSettings(yaw_weight=settings.yaw_weight, shape_weight=settings.shape_weight, motion_weight=0.0)

    def expected(model: FacingModel, used: FacingSettings) -> list[Float64]:
        return posteriors(sequences, model, used, smooth=True, known_within_deg=training.known_within_deg)

    model = untrained()
    for _ in range(training.yaw_rounds):
        model = _with_yaw(model, sequences, expected(model, yaws), training)
    model = msgspec.structs.replace(model, topology=topology)
    model = _with_shape(model, sequences, expected(model, yaws), training)
    for _ in range(training.shape_rounds):
        facings = expected(model, both)
        model = _with_shape(_with_yaw(model, sequences, facings, training), sequences, facings, training)
    return _with_motion(model, sequences, expected(model, both), training)


def _with_yaw(
    model: FacingModel, sequences: Sequence[FacingSequence], facings: list[Float64], training: TrainingSettings
) -> FacingModel:
    counts = np.zeros((BINS, YAW_BINS))
    for sequence, p in zip(sequences, facings, strict=True):
        seen = sequence.view.seen
        _count(counts, _about_sensors(sequence, p), seen / BIN + YAW_BINS / 2, np.isfinite(seen), wraps=True)
    counts = _blurred(counts + _mirrored(_mirrored(counts).T).T)
    return msgspec.structs.replace(model, yaw=log_rows(counts, training.yaw_floor))


def _with_shape(
    model: FacingModel, sequences: Sequence[FacingSequence], facings: list[Float64], training: TrainingSettings
) -> FacingModel:
    about = [_about_sensors(sequence, p) for sequence, p in zip(sequences, facings, strict=True)]
    alpha = np.degrees(np.abs(wrap(YAWS)))
    front = np.concatenate([p[..., alpha < training.front_deg].sum(axis=-1).ravel() for p in about])
    back = np.concatenate([p[..., alpha > training.back_deg].sum(axis=-1).ravel() for p in about])
    features = np.concatenate([s.view.features.reshape(-1, len(FEATURES)) for s in sequences])
    complete = np.isfinite(features).all(axis=-1)
    fronts, backs = complete & (front > training.sure), complete & (back > training.sure)
    if min(fronts.sum(), backs.sum()) <= 2 * len(FEATURES):
        raise InputError(
            f"{fronts.sum()} views are surely of a front and {backs.sum()} of a back",
            fix="add recordings in which people turn all the way round",
        )
    classifier = fit_classifier(features[fronts | backs], fronts[fronts | backs], training.penalty)
    counts = np.zeros((BINS, SHAPE_BINS))
    for sequence, p in zip(sequences, about, strict=True):
        score, _ = classifier.score(sequence.view.features)
        known = np.asarray(np.isfinite(sequence.view.features).all(axis=-1))
        _count(counts, p, shape_place(score), known, wraps=False)
    # Somebody else's body, or another sensor, changes all scores alike.
    apart = np.subtract.outer(_SCORES, _SCORES) / training.score_sd
    other = np.exp(-0.5 * apart**2)
    counts = _blurred(counts + _mirrored(counts)) @ (other / other.sum(axis=1, keepdims=True))
    return msgspec.structs.replace(model, classifier=classifier, shape=log_rows(counts, training.shape_floor))


def _with_motion(
    model: FacingModel, sequences: Sequence[FacingSequence], facings: list[Float64], training: TrainingSettings
) -> FacingModel:
    counts = np.zeros((len(SPEEDS), BINS))
    for sequence, p in zip(sequences, facings, strict=True):
        v = np.nan_to_num(sequence.velocity)
        row = np.searchsorted(SPEEDS, np.hypot(v[:, 0], v[:, 2]), side="right") - 1
        ahead = turned(p, -np.arctan2(v[:, 0], v[:, 2]))
        free = (row >= 0) & np.isnan(sequence.known_yaw)  # a step aside on request is not normal walking
        counts += (row[free] == np.arange(len(SPEEDS))[:, None]) @ ahead[free]
    counts = counts + _mirrored(counts.T).T
    return msgspec.structs.replace(model, motion=log_rows(counts, training.motion_floor))


def _about_sensors(sequence: FacingSequence, p: Float64) -> Float64:
    """Return the facings (frames, views, BINS) relative to the direction towards each sensor."""
    return turned(p[:, None], -sequence.toward_sensor)


def _count(counts: Float64, p: Float64, place: Float64, known: Bools, *, wraps: bool) -> None:
    """Add the probabilities (..., BINS) of an observation between two columns (...,) to (BINS, columns)."""
    p = p[known]
    first, second, part = neighbours(place[known], counts.shape[1], wraps)
    shares = np.zeros((len(p), counts.shape[1]))
    each = np.arange(len(p))
    shares[each, first] = 1 - part
    shares[each, second] += part
    counts += p.T @ shares


def _mirrored(table: Float64) -> Float64:
    """Return the table with the rows of α and −α exchanged; the first row is its own mirror image."""
    return np.asarray(table[-np.arange(len(table)) % len(table)])


def _blurred(table: Float64) -> Float64:
    return np.asarray((np.roll(table, 1, axis=0) + 2 * table + np.roll(table, -1, axis=0)) / 4)
