"""Convert study logs to sequences of a person's facing, and score estimates of it (docs/methods/facing.md)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError
from mocapella.evaluation.fused_metrics import HEADING_OVER, MOVING, facing_yaw, reversals
from mocapella.evaluation.study_pairs import StudySession, study_sessions
from mocapella.fusion.facing import FacingSettings
from mocapella.fusion.facing_grid import most_likely, most_likely_angle
from mocapella.fusion.facing_model import FacingModel, untrained
from mocapella.fusion.facing_shape import view_of
from mocapella.fusion.facing_training import FacingSequence, posteriors, train
from mocapella.geometry import rigid
from mocapella.geometry.alignment import robust_align
from mocapella.geometry.angles import wrap
from mocapella.model.session import SCENARIOS
from mocapella.model.study_log import StudyLog
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

TOPOLOGY: Final = topology("kinect_v2")
TASK_NAMES: Final = ("stationary", "steps", "walk")
TASKS: Final = tuple(SCENARIOS[name] for name in TASK_NAMES)
"""Scenario_Id of the tasks that are used; in the first two, people face the front sensor throughout."""
FRONT: Final = "front"
VELOCITY_OVER: Final = 0.25
"""Interval into the past over which a velocity is measured [s]."""
BACKWARD: Final = np.radians(120.0)
"""Smallest angle between motion and facing that counts as walking backward, not sideways [rad]."""

_STATIONARY, _STEPS, _WALK = TASKS
_ROOT = TOPOLOGY.parts["root"]
_TRUNK = [TOPOLOGY.index(name) for name in ("SpineBase", "SpineMid", "SpineShoulder")]


class FacingSession(msgspec.Struct, frozen=True, eq=False):
    """One study log as a sequence of the person's facing; the world is the reference sensor's camera space.

    Attributes:
        participant, name: Study_Id, and the file's name.
        sequence: both views over time; the facings in the tasks Stationary and Steps are known.
        task: (frames,) Scenario_Id.
        toward_front: (frames,) yaw from the person to the front sensor [rad].
        heading: (frames,) yaw of the velocity about each frame [rad]; NaN for speeds up to `MOVING`.
        front_labels, mean_labels: (frames,) yaw of the front sensor's skeleton, and of the thesis' average skeleton,
            from their left and right labels [rad].
    """

    participant: int
    name: str
    sequence: FacingSequence
    task: Int64
    toward_front: Float64
    heading: Float64
    front_labels: Float64
    mean_labels: Float64


class AlignedViews(msgspec.Struct, frozen=True, eq=False):
    """Both sensors' views of one person in Stationary, Steps and Walk; the world is the reference's camera space.

    Attributes:
        at_s: (frames, 2) capture time of each view since the file's first frame, strictly rising in the first column
            [s].
        task: (frames,) Scenario_Id.
        positions: (frames, 2, joints, 3) with the sensors' labels, the reference sensor first [m].
        logged: (frames, 2, joints, 3) positions as logged, with the second sensor's transformed by the thesis [m].
        places: (2, 3) positions of the sensors [m].
        toward: (frames, 2) yaw from the person to each sensor [rad].
    """

    at_s: Float64
    task: Int64
    positions: Float64
    logged: Float64
    places: Float64
    toward: Float64


def aligned_views(session: StudySession) -> AlignedViews | None:
    """Transform a study log's pairs to one space; None unless it has one person in all of `TASKS`, and sensor `FRONT`.

    The second sensor's rows are transformed to the reference's camera space by a robust rigid motion that is fitted to
    Stationary and Steps. The second sensor's position follows from the logged stand-still calibration: from the angle
    between the sensors, and from the person's distance along its axis, on which the person is assumed to stand.
    """
    log = session.log
    pairs = session.pairs.where(np.isin(session.pairs.task, TASKS))
    if session.two_people or FRONT not in session.replay.sensors or set(TASKS) - set(pairs.task.tolist()):
        return None
    is_reference = session.sensor[pairs.rows] == 0
    pairs = pairs.where(is_reference.sum(axis=1) == 1)
    rows = np.take_along_axis(pairs.rows, session.sensor[pairs.rows].argsort(axis=1), axis=1)
    _, first = np.unique(session.at_s[rows[:, 0]], return_index=True)
    rows, task = rows[first], pairs.task[first]
    logged = log.positions[rows].astype(np.float64)
    still = logged[task != _WALK][::3]
    T_fit = robust_align(still[:, 0].reshape(-1, 3), still[:, 1].reshape(-1, 3))
    positions = np.stack([logged[:, 0], rigid.apply(T_fit, logged[:, 1])], axis=1)
    stood = np.nanmean(logged[task == _STATIONARY][:, 0], axis=(0, 1))
    places = np.stack([np.zeros(3), rigid.apply(T_fit, _second_place(log, rows[0], stood)[None])[0]])
    sight = places - np.nanmean(positions[..., _TRUNK, :], axis=-2)
    toward = np.arctan2(sight[..., 0], sight[..., 2])
    return AlignedViews(session.at_s[rows], task, positions, logged, places, toward)


def facing_session(session: StudySession) -> FacingSession | None:
    """Convert a study log's `aligned_views` to a sequence of the person's facing; None if there are none."""
    views = aligned_views(session)
    if views is None:
        return None
    positions, task, toward, at_s = views.positions, views.task, views.toward, views.at_s[:, 0]
    front = session.replay.sensors.index(FRONT)
    known = np.where(task == _WALK, np.nan, toward[:, front])
    root = positions[:, :, _ROOT].mean(axis=1)
    velocity = _velocity(at_s, root, VELOCITY_OVER, 0.0)
    motion = _velocity(at_s, root, HEADING_OVER / 2, HEADING_OVER / 2)
    moving = np.hypot(motion[:, 0], motion[:, 2]) > MOVING
    return FacingSession(
        participant=session.participant,
        name=session.name,
        sequence=FacingSequence(at_s, view_of(positions, toward, TOPOLOGY), toward, velocity, known),
        task=task,
        toward_front=toward[:, front],
        heading=np.where(moving, np.arctan2(motion[:, 0], motion[:, 2]), np.nan),
        front_labels=facing_yaw(positions[:, front]),
        mean_labels=facing_yaw(views.logged.mean(axis=1)),
    )


def facing_sessions(
    folder: Path, participants: Collection[int] | None = None, on_file: Callable[[str], None] = lambda name: None
) -> list[FacingSession]:
    """Return the `facing_session` of each suitable study log of a folder, in the order of participant and file name.

    A log is suitable if it has one person in all of Stationary, Steps and Walk, and a front sensor. Others are skipped.

    Args:
        folder: with ``Study_*.csv`` or ``.csv.gz``.
        participants: numbers of the participants; None for all.
        on_file: called with the name of each file before it is read.

    Raises:
        InputError: no such folder, no log in it, one that cannot be read, or none that is suitable.
        SettingsError: a participant without a file; lists the participants.
    """
    found = [facing_session(session) for session in study_sessions(folder, participants, on_file)]
    sessions = [session for session in found if session is not None]
    if not sessions:
        fix = "it wants logs of one person with Stationary, Steps and Walk, and a front sensor"
        raise InputError("has nothing to learn facing from", file=folder, fix=fix)
    return sessions


def trained_on(sessions: Sequence[FacingSession]) -> dict[str, Any]:
    """Describe the training data, for `mocapella.fusion.facing_model.FacingModel.trained_on`."""
    return {
        "recordings": "study logs of KinectMultiTrack, 2015 (MIT): one room, one route",
        "participants": sorted({session.participant for session in sessions}),
        "sessions": len(sessions),
        "frames_by_task": {
            name: int(sum((session.task == SCENARIOS[name]).sum() for session in sessions)) for name in TASK_NAMES
        },
        "views": "two Kinect v2, parallel, 45° and 90° apart",
    }


def _second_place(log: StudyLog, rows: Int64, stood: Float64) -> Float64:
    """Return the position (3,) of the second sensor by the thesis' calibration, reference camera space [m].

    Args:
        log: the file.
        rows: (2,) of both sensors.
        stood: (3,) position of the person, reference camera space [m].
    """
    distances = log.init_dist[rows]
    turn = rigid.rotation_about_y(log.init_angle[rows[1]] - log.init_angle[rows[0]])
    return np.asarray(np.array([stood[0], 0.0, distances[0]]) - turn @ np.array([0.0, 0.0, distances[1]]))


def _velocity(at_s: Float64, points: Float64, before_s: float, after_s: float) -> Float64:
    """Return the mean velocity (frames, 3) over an interval around each frame; NaN if it is not covered."""

    def at(times: Float64) -> Float64:
        return np.stack([np.interp(times, at_s, column, np.nan, np.nan) for column in points.T], axis=-1)

    return np.asarray((at(at_s + after_s) - at(at_s - before_s)) / (before_s + after_s))


class OfParticipant(Protocol):
    """Interface of a session that has one participant."""

    @property
    def participant(self) -> int:
        """Number of the participant: the log's Study_Id."""


class FacingFigures(msgspec.Struct, frozen=True):
    """The accuracy of facings over all frames of all sessions.

    Attributes:
        sessions: number of sessions.
        against_motion_percent: share of Walk's frames faster than `MOVING` that are more than 90° off the heading.
        reversals_per_min: number of reversals per minute of Walk, see `mocapella.evaluation.fused_metrics.reversals`.
        backward_kept_percent: share of Walk's frames with backward motion (reference facing farther than `BACKWARD`
            from the heading) where the estimate is also more than 90° off the heading.
        steps_wrong_percent, stationary_wrong_percent: share of frames more than 90° off the direction of the front
            sensor.
        walk_differs_percent: share of Walk's frames that are more than 90° off the reference.
    """

    sessions: int
    against_motion_percent: float
    reversals_per_min: float
    backward_kept_percent: float
    steps_wrong_percent: float
    stationary_wrong_percent: float
    walk_differs_percent: float


def figures(
    sessions: Sequence[FacingSession], estimates: Sequence[Float64], references: Sequence[Float64]
) -> FacingFigures:
    """Score estimated facings over all frames of all sessions.

    Args:
        sessions: sessions of any participants.
        estimates: facings (frames,) of each session [rad]; a frame with NaN does not count as wrong.
        references: facings (frames,) of each session by `reference_facings` [rad].

    Returns:
        The figures; NaN where no frame is of the kind.
    """
    total = np.zeros((2, 6))  # rows: count and total; columns: in the order of `FacingFigures`
    for session, yaw, reference in zip(sessions, estimates, references, strict=True):
        walk, at_s = session.task == _WALK, session.sequence.at_s
        moving = walk & np.isfinite(session.heading)
        backward = moving & _is_off(reference, session.heading, BACKWARD)
        against = _is_off(yaw, session.heading)
        wrong, differs = _is_off(yaw, session.toward_front), _is_off(yaw, reference)
        for column, (what, of) in enumerate(
            (
                (against, moving),
                (None, walk),
                (against, backward),
                (wrong, session.task == _STEPS),
                (wrong, session.task == _STATIONARY),
                (differs, walk),
            )
        ):
            if what is None:
                total[:, column] += reversals(yaw[of], at_s[of]), np.ptp(at_s[of]) / 60
            else:
                total[:, column] += what[of].sum(), of.sum() / 100
    ratios = np.divide(total[0], total[1], out=np.full(6, np.nan), where=total[1] > 0)
    return FacingFigures(len(sessions), *(float(ratio) for ratio in ratios))


def _is_off(yaw: Float64, other: Float64, by: float = np.pi / 2) -> NDArray[np.bool_]:
    return np.asarray(np.abs(wrap(yaw - other)) > by)


def reference_facings(sessions: Sequence[FacingSession], model: FacingModel) -> list[Float64]:
    """Estimate reference facings of each session, because there is no ground truth.

    All frames of the views are used, also later ones, by their yaws and shapes. Motion is not used, so these facings
    show whether a person really walked backward.

    Args:
        sessions: the sessions.
        model: likelihood tables of yaw and shape.

    Returns:
        The yaw (frames,) of each session [rad].
    """
    sequences = [session.sequence for session in sessions]
    return [*map(most_likely, posteriors(sequences, model, FacingSettings(motion_weight=0.0), smooth=True))]


def _yaws(sessions: Sequence[FacingSession], model: FacingModel, settings: FacingSettings) -> list[Float64]:
    """Return the facings (frames,) of each session as the filter estimates them [rad]."""
    sequences = [session.sequence for session in sessions]
    ps, p_angles = (posteriors(sequences, model, s) for s in (settings, replace(settings, shape_weight=0.0)))
    return [*map(most_likely_angle, ps, p_angles)]


def left_out(
    sessions: Sequence[FacingSession], folds: int, reference: FacingModel, settings: FacingSettings | None = None
) -> Mapping[str, FacingFigures]:
    """Cross-validate the facing model: score each fold with a model trained on the other participants.

    Args:
        sessions: sessions of at least as many participants as folds.
        folds: number of folds, 2 or more.
        reference: model trained on all participants, for `reference_facings`.
        settings: settings in the model's later use; None for the defaults.

    Returns:
        Figures by method. ``front sensor`` and ``mean of sensors`` have raw labels; ``default`` has ``settings``, and
        other names say which weights differ from these; ``untrained`` is the model without training.
    """
    settings = settings or FacingSettings()
    variants = {
        "yaw": replace(settings, shape_weight=0.0, motion_weight=0.0),
        "yaw, motion": replace(settings, shape_weight=0.0),
        "yaw, shape": replace(settings, motion_weight=0.0),
        "default": settings,
        "five times the motion": replace(settings, motion_weight=5 * settings.motion_weight),
    }
    estimates: dict[str, list[Float64]] = {name: [] for name in variants}
    tested: list[FacingSession] = []
    for test in split(sessions, folds):
        learnt = train([s.sequence for s in sessions if s.participant not in test], TOPOLOGY.name, settings)
        held = [s for s in sessions if s.participant in test]
        tested += held
        for name, variant in variants.items():
            estimates[name] += _yaws(held, learnt, variant)
    plain = {
        "front sensor": [s.front_labels for s in tested],
        "mean of sensors": [s.mean_labels for s in tested],
        "untrained": _yaws(tested, untrained(), settings),
    }
    references = reference_facings(tested, reference)
    return {name: figures(tested, yaws, references) for name, yaws in (plain | estimates).items()}


def split(sessions: Iterable[OfParticipant], folds: int) -> list[set[int]]:
    """Divide the participants into ``folds`` sets of their numbers, in turn in ascending order.

    Raises:
        SettingsError: there are fewer participants than folds, or fewer than two folds.
    """
    participants = sorted({session.participant for session in sessions})
    if not 2 <= folds <= len(participants):
        raise SettingsError(f"{folds} folds of {len(participants)} participants; take from 2 to as many as there are")
    return [set(participants[k::folds]) for k in range(folds)]
