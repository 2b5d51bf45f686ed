"""Train a joint bias on the study logs, and measure by how much it reduces the distance between views.

See docs/methods/joint-bias.md.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.evaluation.kinectmultitrack import AsRun, Tally
from mocapella.evaluation.scored_views import TOPOLOGY, asked_about, known_before, seen_views
from mocapella.evaluation.study_pairs import Pairs, StudySession, study_sessions
from mocapella.fusion.joint_bias import JointBiasModel, LeftOut
from mocapella.fusion.joint_bias_training import ViewPairs, train
from mocapella.model.session import SCENARIOS
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.default_settings import DefaultSettings

TASKS: Final = {SCENARIOS["stationary"]: 0.2, SCENARIOS["steps"]: 0.5, SCENARIOS["walk"]: 1.0}
"""Weight of each task of a session, independent of its length."""
NEAR_OTHERS: Final = 2.8
"""Weight of a session of several people, independent of its length and tasks; larger: Δd of two people falls, and that
of people who walk alone rises. Chosen by leaving each session of two people out, with simulated people calibrated as
soon as without these sessions.
"""
EVERY: Final = 4
"""Stride for each person: neighbouring frames are nearly equal, so every fourth is used."""
ROWS: Final = ("walk", "walk-frozen", "walk-cold", "steps-second-half")
"""Rows of the tables that show whether a bias helps."""


class BiasSession(msgspec.Struct, frozen=True, eq=False):
    """Training data of one study log with one placement of the sensors: one participant, or people near each other.

    Attributes:
        study: the study log.
        plain: run of the method `default` without a bias.
        views: pairs of views for the training.
    """

    study: StudySession
    plain: AsRun
    views: ViewPairs

    @property
    def participant(self) -> int:
        """Number of the participant: the log's Study_Id."""
        return self.study.participant


def make_tracker(model: JointBiasModel | None) -> Callable[[int], DefaultTracker]:
    """Return a factory of trackers of the method `default`, with the joint bias ``model`` instead of the shipped one.

    The factory's argument is the number of sensors; with a ``model`` of None, trackers apply no bias.
    """

    def make(sensors: int) -> DefaultTracker:
        tracker = DefaultTracker(DefaultSettings(joint_bias="none"), sensors_expected=sensors)
        tracker.joint_bias = model
        return tracker

    return make


def bias_session(study: StudySession) -> BiasSession | None:
    """Convert a study log to training data; None unless it has two sensors, and several people or the task Walk.

    Of one person, `TASKS` are used; of several people, all tasks. Labels, clock offsets, facings and positions are the
    estimates of the method `default` without a bias at each frame; the sensors' motions are fitted anew in training.
    """
    if len(study.replay.sensors) != 2:
        return None
    if study.two_people:
        pairs = study.pairs
    else:
        pairs = study.pairs.where(np.isin(study.pairs.task, list(TASKS)))
        if SCENARIOS["walk"] not in pairs.task:
            return None
    pairs = pairs.where(study.sensor[pairs.rows].sum(axis=1) == 1)
    if not len(pairs):
        return None
    plain = AsRun(study, make_tracker(None))
    known = known_before(study.frames, pairs)
    seen = seen_views(study, plain.whole, pairs, known, known)
    asked = asked_about(study, pairs, seen)  # of all pairs: velocities need the previous ones
    order = study.sensor[pairs.rows].argsort(axis=1)
    agreed = np.where(seen.swapped[..., None, None], seen.joints[:, :, TOPOLOGY.mirror], seen.joints)
    views = {"positions": agreed, "facing": asked.facing, "position": asked.position, "velocity": asked.velocity}
    each = np.arange(len(pairs))[:, None]
    kept, weight = _kept(pairs), _weight(study, pairs)
    ordered = {name: values[each, order][kept] for name, values in views.items()}
    return BiasSession(study, plain, ViewPairs(weight=weight[kept], **ordered))


def _kept(pairs: Pairs) -> NDArray[np.bool_]:
    """Return which pairs (pairs,) are used: every `EVERY`-th of each person, from the first."""
    kept = np.zeros(len(pairs), dtype=np.bool_)
    for person in np.unique(pairs.person).tolist():
        kept[np.flatnonzero(pairs.person == person)[::EVERY]] = True
    return kept


def _weight(study: StudySession, pairs: Pairs) -> NDArray[np.float64]:
    """Return the weight of each pair (pairs,): of one person by `TASKS`, of several people by `NEAR_OTHERS`."""
    if study.two_people:
        return np.full(len(pairs), NEAR_OTHERS / len(pairs))
    weight = np.zeros(len(pairs))
    for task, share in TASKS.items():
        of_task = pairs.task == task
        weight[of_task] = share / max(of_task.sum(), 1)
    return weight


def bias_sessions(
    folder: Path, participants: Collection[int] | None = None, on_file: Callable[[str], None] = lambda name: None
) -> list[BiasSession]:
    """Return the `bias_session` of each suitable study log of a folder.

    Args:
        folder, participants, on_file: as in `mocapella.evaluation.study_pairs.study_sessions`.

    Raises:
        InputError, SettingsError: as in `study_sessions`; also if no log is suitable.
    """
    found = [bias_session(study) for study in study_sessions(folder, participants, on_file)]
    sessions = [session for session in found if session is not None]
    if not sessions:
        raise InputError(
            "has nothing to learn a joint bias from",
            file=folder,
            fix="it wants logs of two sensors with one person's Walk, or with two people",
        )
    return sessions


def trained_on(sessions: Sequence[BiasSession]) -> dict[str, Any]:
    """Describe the training data, for `JointBiasModel.trained_on`."""
    return {
        "recordings": "study logs of KinectMultiTrack, 2015 (MIT): one room, one route",
        "participants": sorted({session.participant for session in sessions}),
        "sessions": len(sessions),
        "frames": sum(len(session.views.weight) for session in sessions),
        "sessions_of_two_people": sum(session.study.two_people for session in sessions),
        "views": "two Kinect v2, parallel, 45° and 90° apart",
    }


def learn(sessions: Sequence[BiasSession], folds: Sequence[set[int]]) -> JointBiasModel:
    """Train a model on all sessions, with weights learnt without each fold of participants, for cross-validation.

    Args:
        sessions: training data.
        folds: sets of participants' numbers, such as of `mocapella.evaluation.facing_sessions.split`.
    """
    without = [
        LeftOut(tuple(sorted(fold)), train([s.views for s in sessions if s.participant not in fold], TOPOLOGY))
        for fold in folds
    ]
    whole = train([session.views for session in sessions], TOPOLOGY)
    return JointBiasModel(TOPOLOGY.name, whole, trained_on(sessions), tuple(without))


def left_out(
    sessions: Sequence[BiasSession], model: JointBiasModel, on_step: Callable[[str], None] = lambda text: None
) -> dict[str, Any]:
    """Score the method without a bias, and with a bias that was trained without the scored participant.

    Args:
        sessions: sessions to score.
        model: model with the weights of `learn` for each fold.
        on_step: called with the name of each session before it is scored.

    Returns:
        ``without`` and ``with``, each by `ROWS` and placement as in docs/evaluation.md, the figures of two people as
        ``interactions``, and the fused skeleton's as ``fused``; an empty one has no session.
    """
    logged, tallies = Tally(), {"without": Tally(), "with": Tally()}
    for session in sessions:
        study = session.study
        on_step(study.name)
        tallies["without"].add(study, session.plain)
        logged.add(study, session.plain)
        tallies["with"].add(study, AsRun(study, make_tracker(model)))
    counts = logged.counts()
    out: dict[str, Any] = {}
    for name, tally in tallies.items():
        scored = tally.as_json("", counts)
        out[name] = {row: scored["tasks"][row] for row in ROWS if row in scored["tasks"]}
        out[name]["interactions"] = {k: v for k, v in scored["interactions"].items() if k.endswith("_cm")}
        out[name]["fused"] = scored["fused"].get("all", {})
    return out
