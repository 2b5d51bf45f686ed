"""Scores methods on the logs of the KinectMultiTrack studies: ``mocapella lab evaluate kinectmultitrack``.

Scores without ground truth: how far two sensors' views of one person are apart after a method's alignment (Δx, Δy, Δz,
Δd), quality metrics of the fused skeleton, and identity switches at labelled crossings. Estimates are causal
(`causal_run`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.evaluation import fused_metrics
from mocapella.evaluation.causal_run import CausalRun
from mocapella.evaluation.interactions import (
    distance_figures,
    identity_figures,
    label_frame,
    labels_of,
    people_as_logged,
    people_of_run,
)
from mocapella.evaluation.methods import AS_LOGGED, check_methods, scored_tracker
from mocapella.evaluation.protocol import ScoredTracker
from mocapella.evaluation.scored_views import ScoredViews, known_before, logged_views, views_of
from mocapella.evaluation.session_runs import run_session
from mocapella.evaluation.study_pairs import TASKS, Pairs, StudySession, study_sessions
from mocapella.evaluation.study_tables import Count, Scored, count, differences, row
from mocapella.geometry import angles, rigid
from mocapella.model.session import SCENARIOS
from mocapella.model.study_log import StudyLog

Float64 = NDArray[np.float64]

FRONT: Final = "front"
"""Name of the sensor that people face in Stationary and Steps."""
WALK, STEPS, STATIONARY = (SCENARIOS[name] for name in ("walk", "steps", "stationary"))
SCORED: Final = {
    AS_LOGGED: "the rows as they were logged: they are the output of the thesis' own method, one motion per person",
    "": "raw joints × one rigid motion per sensor, shared by all people and known before either frame of the pair, "
    "+ the joint bias declared before the first frame, learnt without the scored participant; "
    "begun from the sensor layout of the thesis' calibration; "
    "both views brought to the earlier one's instant where the method declares time offsets; "
    "dx_cm … torso_dd_cm with labels repaired as decided before the pair's frames, raw_labels as the sensors gave them",
}
PROTOCOLS: Final = {
    "walk": "after Stationary and Steps, refined from past frames",
    "walk-frozen": "after Stationary and Steps, the motions and offsets as known before Walk's first frame",
    "walk-cold": "only Walk's frames, begun from the sensor layout of the thesis' calibration",
    "steps-second-half": "motions and offsets as known at the half of Steps",
    "steps-second-half-refined": "refined from past frames",
}


_FIRST: Final = (
    *("stationary", "steps", "steps-second-half", "steps-second-half-refined"),
    *("walk", "walk-frozen", "walk-cold"),
)
"""Order of the tables' rows; the other tasks follow by their number in the log."""


class Output(Protocol):
    """Interface of one method's output for one study log: aligned views, fused skeletons and people's positions."""

    @property
    def wander_m_per_min(self) -> float:
        """Largest `mocapella.evaluation.causal_run.CausalRun.wander_m_per_min` of the method's runs [m/min]."""

    def views(self, scoring: str, pairs: Pairs) -> ScoredViews:
        """Return both views of each pair, in the reference sensor's camera space.

        Args:
            scoring: key of `PROTOCOLS`, or a task's name; it decides which of the method's estimates are applied.
            pairs: the pairs of rows to score.
        """

    def fused(self, pairs: Pairs) -> tuple[Float64, Float64]:
        """Return the fused skeletons at the pairs.

        Returns:
            Times (pairs,) since the file's first frame [s], and skeletons (pairs, joints, 3) in the reference sensor's
            camera space [m]; NaN if there is none.
        """

    def yaw(self) -> float:
        """Return the yaw between front and side sensor, as estimated before the exercise Walk [rad]; NaN if unknown."""

    def people(self, at_s: float) -> Mapping[int, Float64]:
        """Return the position (3,) of SpineBase by person's id, in the reference sensor's camera space [m].

        ``at_s`` is the time since the file's first frame [s]; people without a position are left out.
        """


class AsLogged:
    """Output of the thesis' own method, for one session: the logged rows, with unchanged positions and labels.

    Args:
        session: the study log.

    Attributes:
        wander_m_per_min: always 0, because no motion between sensors is estimated.
    """

    wander_m_per_min = 0.0

    def __init__(self, session: StudySession) -> None:
        self.session = session

    def views(self, scoring: str, pairs: Pairs) -> ScoredViews:
        """Return both views of each pair, the logged rows; they are equal for every scoring. See `Output`."""
        return logged_views(self.session, pairs)

    def fused(self, pairs: Pairs) -> tuple[Float64, Float64]:
        """Return the thesis' average skeletons at the pairs: the means of both logged rows.

        Returns:
            Times (pairs,) of the later row since the file's first frame [s], and skeletons (pairs, joints, 3) in the
            reference sensor's camera space [m]; NaN where a joint is missing in a row.
        """
        rows = self.session.log.positions[pairs.rows].astype(np.float64)
        return self.session.at_s[pairs.rows].max(axis=1), rows.mean(axis=1)

    def yaw(self) -> float:
        """Return the yaw between front and side sensor, by the logged shoulder angles [rad]; NaN if unknown."""
        return _from_front(self.session, _logged_turn(self.session.log))

    def people(self, at_s: float) -> Mapping[int, Float64]:
        """Return the logged position (3,) of SpineBase by Person_Id, in the reference sensor's camera space [m].

        ``at_s`` is the time since the file's first frame [s]. Only recent rows count; see `people_as_logged`.
        """
        return people_as_logged(self.session, at_s)


class OneSensor(AsLogged):
    """The rows of the sensor named `FRONT` alone: a baseline for the fused skeleton."""

    def fused(self, pairs: Pairs) -> tuple[Float64, Float64]:
        """Return the pairs' rows of the sensor named `FRONT`; of the reference sensor in a log without that name.

        Returns:
            Times (rows,) since the file's first frame [s], and skeletons (rows, joints, 3) in the reference sensor's
            camera space [m]; NaN where a joint is missing.
        """
        sensors = self.session.replay.sensors
        front = sensors.index(FRONT) if FRONT in sensors else 0
        rows = pairs.rows[self.session.sensor[pairs.rows] == front]
        return self.session.at_s[rows], self.session.log.positions[rows].astype(np.float64)


class AsRun:
    """Output of a method that is run over all frames of a session, and over the frames of Walk alone, if it has any.

    Args:
        session: the study log.
        make: creates a tracker for a number of sensors; called for each run. A tracker that was trained on the studies
            leaves out the session's participant.
    """

    def __init__(self, session: StudySession, make: Callable[[int], ScoredTracker]) -> None:
        self.session = session
        self._run = run_session(session, make, session.frames)
        self._walk_frames = session.only(WALK) if (session.pairs.task == WALK).any() else None
        self._cold = None if self._walk_frames is None else run_session(session, make, self._walk_frames)
        runs = (self._run,) if self._cold is None else (self._run, self._cold)
        self.wander_m_per_min = max(run.wander_m_per_min for run in runs)

    @property
    def whole(self) -> CausalRun:
        """The causal run (each frame with earlier ones only) over all frames of the session."""
        return self._run

    def views(self, scoring: str, pairs: Pairs) -> ScoredViews:
        """Return both views of each pair under a scoring, a key of `PROTOCOLS` or a task's name.

        Labels are repaired as decided before the pair. ``walk-frozen`` and ``steps-second-half`` use the motions
        as known before the first of these pairs; ``walk-cold`` uses the run over the frames of Walk alone.
        """
        run, frames = self._run, self.session.frames
        if scoring == "walk-cold":
            assert self._cold is not None
            assert self._walk_frames is not None
            run, frames = self._cold, self._walk_frames
        frozen = scoring in ("walk-frozen", "steps-second-half")
        labels = known_before(frames, pairs)
        return views_of(self.session, run, pairs, known_before(frames, pairs, frozen=frozen), labels)

    def fused(self, pairs: Pairs) -> tuple[Float64, Float64]:
        """Return the fused skeletons of the newest scene when both of a pair's frames have arrived.

        Returns:
            Times (pairs,) of the later frame since the file's first [s], and skeletons (pairs, joints, 3) in the
            reference sensor's camera space [m]; NaN if the scene lacks the person.
        """
        session, run = self.session, self._run
        after = session.frames.of_row[pairs.rows].max(axis=1)
        out = np.full((len(pairs), *session.raw.shape[1:]), np.nan)
        for i, (k, person) in enumerate(zip(after.tolist(), pairs.person.tolist(), strict=True)):
            keys = {(sensor, person) for sensor in run.sensors}
            seen = next((there for there in run.people[k] if there.keys & keys), None)
            if seen is not None:
                out[i] = seen.positions
        return session.at_s[pairs.rows].max(axis=1), out

    def yaw(self) -> float:
        """Return the yaw between the front and the side sensor, as estimated before Walk [rad]; NaN if unknown."""
        walk = self.session.pairs.where(self.session.pairs.task == WALK)
        known = int(known_before(self.session.frames, walk, frozen=True)[0])
        T_reference_second = self._run.T_reference_sensor[known, 1]
        beyond = T_reference_second @ rigid.inverse(self.session.replay.T_reference_second)
        return _from_front(self.session, _logged_turn(self.session.log) + _yaw_of(beyond))

    def people(self, at_s: float) -> Mapping[int, Float64]:
        """Return the position (3,) of SpineBase by person's id, in the reference sensor's camera space [m].

        It is that of the newest scene at ``at_s``, the time since the file's first frame [s]; people without a finite
        position are left out.
        """
        return people_of_run(self._run, at_s)


def _yaw_of(T: Float64) -> float:
    return float(np.arctan2(T[0, 2], T[0, 0]))


def _logged_turn(log: StudyLog) -> float:
    """Return θ of the second sensor minus θ of the reference [rad]."""
    theta = [log.init_angle[(log.skeleton_id == 0) == own] for own in (False, True)]
    finite = [values[np.isfinite(values)] for values in theta]
    return float(finite[0][0] - finite[1][0]) if all(map(len, finite)) else float("nan")


def _from_front(session: StudySession, turn: float) -> float:
    """Return the yaw of the side sensor seen from the front one, right positive, whichever is the reference [rad]."""
    return float(angles.wrap(turn if session.replay.sensors[1:] == (FRONT,) else -turn))


class Tally:
    """Accumulates the scores of one method over study logs: distances of views, fused skeletons and identities.

    Attributes:
        scored: scored pairs of each session, by scoring (a row of the tables) and placement.
        fused: figures of the fused skeleton of each session of one person with Walk, by placement.
        yaw_deg: yaw between the sensors of these sessions, by placement [deg].
        interactions: figures of sessions with two people, by file name.
        distances: (pairs, joints) Δd of these sessions [m].
    """

    def __init__(self) -> None:
        self.scored: dict[tuple[str, str], list[Scored]] = defaultdict(list)
        self.fused: dict[str, list[dict[str, float]]] = defaultdict(list)
        self.yaw_deg: dict[str, list[float]] = defaultdict(list)
        self.interactions: dict[str, dict[str, Any]] = {}
        self.distances: list[Float64] = []

    def add(self, session: StudySession, output: Output) -> None:
        """Score one session, with the method's output for it, and keep the figures."""
        for scoring, pairs in scorings(session.pairs):
            views = output.views(scoring, pairs)
            scored = Scored(
                session.participant,
                differences(views.raw_labels),
                differences(views.repaired),
                views.swaps_per_min,
                output.wander_m_per_min,
            )
            self.scored[scoring, session.placement].append(scored)
        if session.two_people:
            self._add_interaction(session, output)
        elif (session.pairs.task == WALK).any():
            self.fused[session.placement].append(fused_figures(session, output))
            self.yaw_deg[session.placement].append(float(np.degrees(output.yaw())))

    def _add_interaction(self, session: StudySession, output: Output) -> None:
        frames = [label_frame(label, output.people(label.at_s)) for label in labels_of(session)]
        apart = differences(output.views("", session.pairs).repaired)[..., 3]
        by_person = {
            str(person): distance_figures(apart[session.pairs.person == person])
            for person in np.unique(session.pairs.person).tolist()
        }
        self.distances.append(apart)
        self.interactions[session.name] = {**identity_figures(frames), "people": by_person}

    def counts(self) -> dict[tuple[str, str], Count]:
        """Return the numbers of scored pairs and joints, by scoring and placement."""
        return {key: count(scored) for key, scored in self.scored.items()}

    def as_json(self, scored: str, as_logged: Mapping[tuple[str, str], Count]) -> dict[str, Any]:
        """Return the method's results for the JSON of docs/evaluation.md.

        Args:
            scored: description of the scored rows.
            as_logged: numbers of pairs and joints of the logged rows, by scoring and placement.
        """
        tasks: dict[str, dict[str, Any]] = {}
        for (scoring, placement), values in sorted(self.scored.items(), key=lambda item: _place(item[0][0])):
            tasks.setdefault(scoring, {})[placement] = row(values, as_logged[scoring, placement])
        return {
            "scored": scored,
            "tasks": tasks,
            "yaw_deg": {placement: _mean_and_sd(values) for placement, values in self.yaw_deg.items()},
            "fused": self.fused_json(),
            "interactions": self._interactions(),
        }

    def fused_json(self) -> dict[str, Any]:
        """Return the fused skeleton's figures by placement and over all sessions."""
        everything = {"all": [one for some in self.fused.values() for one in some], **self.fused}
        return {placement: _means(sessions) for placement, sessions in everything.items() if sessions}

    def _interactions(self) -> dict[str, Any]:
        totals = {
            name: sum(one[name] for one in self.interactions.values())
            for name in ("labels", "missed", "identity_switches")
        }
        if not self.interactions:
            return totals
        return {**totals, **distance_figures(np.concatenate(self.distances)), "files": self.interactions}


def _place(scoring: str) -> tuple[int, int]:
    first = _FIRST.index(scoring) if scoring in _FIRST else len(_FIRST)
    return first, SCENARIOS.get(scoring, 0)


def scorings(pairs: Pairs) -> list[tuple[str, Pairs]]:
    """Return the scorings (rows of the tables) that include these pairs, each with its pairs."""
    found = []
    for task in np.unique(pairs.task).tolist():
        of_task = pairs.where(pairs.task == task)
        name = TASKS.get(task, f"scenario {task}")
        found.append((name, of_task))
        if task == WALK:
            found += [("walk-frozen", of_task), ("walk-cold", of_task)]
        if task == STEPS:
            second = of_task.where(np.arange(len(of_task)) >= len(of_task) // 2)
            found += [("steps-second-half", second), ("steps-second-half-refined", second)]
    return found


def fused_figures(session: StudySession, output: Output) -> dict[str, float]:
    """Compute the metrics of `mocapella.evaluation.fused_metrics` for one session.

    Args:
        session: the study log.
        output: a method's output for it.

    Returns:
        Metrics by name, which ends with the unit. Metrics of a task with too few fused skeletons are left out; the lag
        is NaN if the output has another number of skeletons than pairs.
    """
    figures: dict[str, float] = {}
    walk = session.pairs.where(session.pairs.task == WALK)
    at_s, skeleton = _known_frames(*output.fused(walk))
    if len(at_s) > 2:
        minutes = (at_s[-1] - at_s[0]) / 60
        figures = {
            "bone_length_variation_percent": 100 * fused_metrics.bone_length_variation(skeleton),
            "foot_slide_cm_s": 100 * fused_metrics.foot_slide(skeleton, at_s),
            "shoulder_collapse_percent": 100 * fused_metrics.shoulder_collapse(skeleton),
            "facing_against_motion_percent": 100 * fused_metrics.facing_against_motion(skeleton, at_s),
            "yaw_reversals_per_min": fused_metrics.yaw_reversals(skeleton, at_s) / minutes,
            "label_flips_per_min": fused_metrics.label_flips(skeleton) / minutes,
            "lag_ms": 1000 * _lag(session, output, walk),
        }
    at_s, skeleton = _known_frames(*output.fused(session.pairs.where(session.pairs.task == STATIONARY)))
    if len(at_s) > 2:
        figures["stationary_jitter_mm"] = 1000 * fused_metrics.jitter(skeleton)
    at_s, skeleton = _known_frames(*output.fused(session.pairs.where(session.pairs.task == STEPS)))
    if len(at_s):
        figures["steps_facing_wrong_percent"] = 100 * fused_metrics.facing_away(skeleton, _front_place(session))
    return figures


def _lag(session: StudySession, output: Output, pairs: Pairs) -> float:
    """Return the lag of the fused skeleton behind the mean of the two views, from the pair's own frames [s]."""
    fused_at, fused = output.fused(pairs)
    _, raw = AsLogged(session).fused(pairs)
    if len(fused) != len(raw):
        return float("nan")
    there = np.isfinite(fused).any(axis=(1, 2))  # a new person appears a moment later
    at_s, fused, raw = fused_metrics.rising(fused_at[there], fused[there], raw[there])
    return fused_metrics.lag(fused, raw, at_s)


def _known_frames(at_s: Float64, skeleton: Float64) -> tuple[Float64, Float64]:
    """Return times, strictly rising, and skeletons, without missing ones."""
    there = np.isfinite(skeleton).any(axis=(1, 2))
    at_s, skeleton = fused_metrics.rising(at_s[there], skeleton[there])
    return at_s, skeleton


def _front_place(session: StudySession) -> Float64:
    """Return the nominal position (3,) of the front sensor, reference camera space [m]; enough for `facing_away`."""
    is_second = session.replay.sensors[1:] == (FRONT,)
    return session.replay.T_reference_second[:3, 3] if is_second else np.zeros(3)


def _means(sessions: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    names = dict.fromkeys(name for one in sessions for name in one)
    values = {name: np.array([one[name] for one in sessions if name in one]) for name in names}
    finite = {name: found[np.isfinite(found)] for name, found in values.items()}
    return {"sessions": len(sessions), **{n: float(v.mean()) if len(v) else None for n, v in finite.items()}}


def _mean_and_sd(values: Sequence[float]) -> dict[str, Any]:
    """Return mean and standard deviation (N − 1) of angles so close together that no circular mean is needed."""
    sd = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
    return {"mean": float(np.mean(values)), "sd": sd, "sessions": len(values)}


def evaluate(
    folder: Path,
    methods: Sequence[str],
    participants: Collection[int] | None = None,
    on_step: Callable[[str], None] = lambda text: None,
    makers: Mapping[str, Callable[[int], ScoredTracker]] | None = None,
) -> dict[str, Any]:
    """Score methods on the study logs of a folder.

    Args:
        folder: folder of the study logs.
        methods: names, optionally with settings, see `mocapella.evaluation.methods.method_with_settings`.
        participants: numbers of the participants whose logs are scored; None for all.
        on_step: called with the current step, in words.
        makers: further methods by name: functions that create a tracker for a number of sensors; None for none.

    Returns:
        The JSON of docs/evaluation.md.

    Raises:
        InputError, SettingsError: the folder, a participant or a method cannot be used.
        EvaluationError: a method's output cannot be scored.
    """
    own = dict(makers or {})
    check_methods(methods, some=bool(own))
    make = {method: scored_tracker(method) for method in methods if method != AS_LOGGED} | own
    tallies = {method: Tally() for method in (*methods, *own, AS_LOGGED)}
    front = Tally()
    seen: list[int] = []
    for session in study_sessions(folder, participants, on_step):
        seen.append(session.participant)
        front.add(session, OneSensor(session))
        for method, tally in tallies.items():
            on_step(f"{session.name}: {method}")
            tally.add(session, AsLogged(session) if method == AS_LOGGED else AsRun(session, make[method]))
    as_logged = tallies[AS_LOGGED].counts()
    if not as_logged:
        fix = "a log of two sensors has two rows for each person and result"
        raise InputError("no log has a person whom two sensors saw", file=folder, fix=fix)
    return {
        "data": str(folder),
        "participants": sorted(set(seen)),
        "files": len(seen),
        "protocols": PROTOCOLS,
        "methods": {m: tallies[m].as_json(SCORED.get(m, SCORED[""]), as_logged) for m in (*methods, *own)},
        "front_sensor_alone": {"fused": front.fused_json()},
    }
