"""Track a study log with a method, causally, and align both sensors' views of every pair by its estimates.

docs/evaluation.md has the protocol: the estimates applied to a pair were known before the earlier of its two frames
arrived, each sensor has one rigid motion for all people, and models leave the participant out. `stand-still` is not
run: the logged rows are the output of the thesis' own method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.causal_run import CausalRun
from mocapella.evaluation.identity import IdentityFrame
from mocapella.evaluation.interactions import FRESH, label_frame, labels_of, people_as_logged, people_of_run
from mocapella.evaluation.methods import AS_LOGGED, scored_tracker
from mocapella.evaluation.scored_views import known_before, logged_views, views_of
from mocapella.evaluation.session_runs import people_at, run_session
from mocapella.evaluation.study_pairs import Pairs, StudyFrames, StudySession
from mocapella.evaluation.study_tables import MAX_WANDER
from mocapella.model.study_log import StudyLog
from mocapella.studies.hidden_joints import hidden_joints, without_joints
from mocapella.studies.naming import RecordingNames
from mocapella.studies.task_views import HiddenViews, TaskViews

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

UNNAMED: Final = "unnamed"
"""Name of the task of rows without one."""


class MethodViews(msgspec.Struct, frozen=True, eq=False):
    """The pairs of one recording, aligned by one method.

    Attributes:
        method: the method, with its settings.
        placement: name of the sensors' placement, such as `45`.
        participant: code of the participant.
        sensors: names of the sensors, the reference sensor first.
        task: (pairs,) name of each pair's task.
        person: (pairs,) number of the logged person.
        rows: (pairs, 2) indices of the pair's rows in the log.
        sensor: (pairs, 2) index in ``sensors`` of each view's sensor.
        at_s: (pairs,) capture time of the later view since the file's first frame [s].
        views: (pairs, 2, joints, 3) both views with the labels that the method decided, in the reference sensor's
            camera space [m]; NaN where a joint is missing, and in all pairs that the method could not align.
        fused: (pairs, joints, 3) the method's person when both frames had come [m]; NaN where it has none.
        unaligned: (pairs,) whether the method had no motion between the sensors in time.
        problems: by task, why its views cannot be compared with other methods'; tasks without a problem are left out.
    """

    method: str
    placement: str
    participant: str
    sensors: tuple[str, ...]
    task: NDArray[np.str_]
    person: Int64
    rows: Int64
    sensor: Int64
    at_s: Float64
    views: Float64
    fused: Float64
    unaligned: Bool
    problems: dict[str, str]


class TrackedRecording:
    """One study log as tracked by one method. The method runs when its estimates are first used.

    Args:
        session: the study log.
        method: name of the method, with its settings; see `mocapella.evaluation.methods.method_with_settings`.
        names: of the log's numbers; None for the thesis' names.

    Raises:
        SettingsError: no such method or setting, or it cannot be scored.
    """

    def __init__(self, session: StudySession, method: str, names: RecordingNames | None = None) -> None:
        self.session, self.method = session, method
        self._names = names or RecordingNames()
        self.participant = self._names.code(session.participant)
        self.placement = self._names.placement(int(session.log.kinect_config[0]))
        self._make = None if method == AS_LOGGED else scored_tracker(method)

    def _task(self, number: int) -> str:
        return UNNAMED if number < 0 else self._names.task(number)

    @cached_property
    def _run(self) -> CausalRun | None:
        return self._run_over(self.session.frames)

    def _run_over(self, frames: StudyFrames) -> CausalRun | None:
        return None if self._make is None else run_session(self.session, self._make, frames)

    def pairs(self) -> MethodViews:
        """Align both views of all pairs.

        Raises:
            SettingsError, EvaluationError: see `mocapella.evaluation.session_runs.run_session`.
        """
        session, pairs = self.session, self.session.pairs
        views = self._aligned(self._run, pairs)
        logged = np.isfinite(session.raw[pairs.rows])
        unaligned: Bool = np.asarray((logged & ~np.isfinite(views)).any(axis=(1, 2, 3)))
        task = np.array([self._task(number) for number in pairs.task.tolist()], dtype=np.str_)
        arrivals = session.frames.of_row[pairs.rows].max(axis=1)
        return MethodViews(
            method=self.method,
            placement=self.placement,
            participant=self.participant,
            sensors=session.replay.sensors,
            task=task,
            person=pairs.person,
            rows=pairs.rows,
            sensor=session.sensor[pairs.rows].reshape(-1, 2),
            at_s=session.at_s[pairs.rows].max(axis=1),
            views=views,
            fused=self._mean(views) if self._run is None else _fused(self._run, arrivals, pairs.person, views.shape)[0],
            unaligned=unaligned,
            problems=self._problems(task, unaligned),
        )

    def _problems(self, task: NDArray[np.str_], unaligned: Bool) -> dict[str, str]:
        found = {}
        wander = 0.0 if self._run is None else self._run.wander_m_per_min
        for name in np.unique(task).tolist():
            of_task = task == name
            missing = int((unaligned & of_task).sum())
            if missing:
                found[name] = f"{missing} of {int(of_task.sum())} pairs: a motion was not known in time"
            elif wander > MAX_WANDER:
                found[name] = (
                    f"the motion between the sensors wanders {wander:.1f} m a minute; {MAX_WANDER:g} is the most"
                )
        return found

    def _aligned(self, run: CausalRun | None, pairs: Pairs) -> Float64:
        """Align the views (pairs, 2, joints, 3) of pairs by what a run knew before them."""
        if run is None:
            return logged_views(self.session, pairs).repaired
        known = known_before(self.session.frames, pairs)
        return views_of(self.session, run, pairs, known, known).repaired

    @staticmethod
    def _mean(views: Float64) -> Float64:
        """Return the mean over the sensors, axis 1, of the views that have a joint, as the thesis' program has it."""
        there = np.isfinite(views)
        count = there.sum(axis=1)
        return np.where(count > 0, np.where(there, views, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)

    def tasks(self, *, hide: bool = False) -> Iterator[TaskViews]:
        """Yield each task of the recording, in the order of their numbers.

        Args:
            hide: run the method again without `mocapella.studies.hidden_joints`, and add this run.

        Raises:
            SettingsError, EvaluationError: see `mocapella.evaluation.session_runs.run_session`.
        """
        session = self.session
        views = self._of_rows(self._run)
        hidden, again, views_again = None, None, views
        if hide:
            hidden = hidden_joints(session)
            again = self._run_over(without_joints(session, hidden))
            views_again = views if again is None else self._of_rows(again)
        for number in np.unique(session.log.scenario_id).tolist():
            frames = _Frames(session, number)
            of_task = frames.spread(views)
            fused, ids = self._fused_of_frames(self._run, frames, of_task)
            yield TaskViews(
                method=self.method,
                placement=self.placement,
                task=self._task(number),
                participant=self.participant,
                sensors=session.replay.sensors,
                people=frames.people,
                at_s=frames.at_s - frames.at_s[:1],
                views=of_task,
                fused=fused,
                fused_ids=ids,
                labelled=self._labelled(frames.at_s),
                hidden=None if hidden is None else self._hidden(frames, hidden, again, views_again),
            )

    def _of_rows(self, run: CausalRun | None) -> Float64:
        """Align the view (rows, joints, 3) of each row by what a run knew before it."""
        log = self.session.log
        alone = np.repeat(np.arange(len(log))[:, None], 2, axis=1)
        return self._aligned(run, Pairs(alone, log.person_id, log.scenario_id))[:, 0]

    def _hidden(self, frames: _Frames, hidden: Bool, run: CausalRun | None, views: Float64) -> HiddenViews:
        mask = frames.spread(hidden.astype(float)[..., None])[..., 0] == 1.0
        of_task = frames.spread(views)
        seen = np.where(mask[..., None], np.nan, of_task)
        return HiddenViews(mask, of_task, self._fused_of_frames(run, frames, seen)[0])

    def _fused_of_frames(self, run: CausalRun | None, frames: _Frames, views: Float64) -> tuple[Float64, Int64]:
        """Return the fused people (frames, people, joints, 3) and their ids (frames, people)."""
        people, shape = np.array(frames.people), (*views.shape[:2], *views.shape[3:])
        if run is None:
            fused = self._mean(np.moveaxis(views, 2, 1).reshape(len(views), views.shape[2], -1)).reshape(shape)
            return fused, np.where(np.isfinite(fused).any(axis=(-2, -1)), people, -1)
        arrivals = np.repeat(frames.arrivals, len(people))
        fused, ids = _fused(run, arrivals, np.tile(people, len(views)), (len(arrivals), *shape[2:]))
        return fused.reshape(shape), ids.reshape(shape[:2])

    def _labelled(self, at_s: Float64) -> tuple[IdentityFrame, ...]:
        """Return the labels of the file within a task, beside the people found."""
        run = self._run
        within = [label for label in labels_of(self.session) if at_s[0] <= label.at_s <= at_s[-1]]
        people: Callable[[float], dict[int, Float64]] = (
            (lambda t: people_as_logged(self.session, t)) if run is None else (lambda t: people_of_run(run, t))
        )
        return tuple(label_frame(label, people(label.at_s)) for label in within)


def _fused(run: CausalRun, arrivals: Int64, person: Int64, shape: Sequence[int]) -> tuple[Float64, Int64]:
    """Return the fused people (n, joints, 3) of the scenes after arrivals, and their ids (n,), −1 where missing."""
    fused, ids = np.full((shape[0], *shape[-2:]), np.nan), np.full(shape[0], -1)
    for i, there in enumerate(people_at(run, arrivals, person)):
        if there is not None:
            fused[i], ids[i] = there.positions, there.id
    return fused, ids


class _Frames:
    """The results of one task: the rows of one ``Tracker_Time``, in the order of their capture.

    Attributes:
        people: the logged people's numbers.
        at_s: (frames,) capture time of the newest row since the file's first frame, rising [s].
        arrivals: (frames,) index of the newest arrival of the rows.
    """

    def __init__(self, session: StudySession, task: int) -> None:
        log = session.log
        self._sensors = len(session.replay.sensors)
        rows = np.flatnonzero(log.scenario_id == task)
        _, result = np.unique(log.tracker_time_ms[rows], return_inverse=True)
        newest = np.full(int(result.max()) + 1, -np.inf)
        np.maximum.at(newest, result, session.at_s[rows])
        order = np.argsort(newest, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        self.at_s = newest[order]
        numbers, person = np.unique(log.person_id[rows], return_inverse=True)
        self.people = tuple(numbers.tolist())
        self.arrivals = np.zeros(len(order), dtype=np.int64)
        np.maximum.at(self.arrivals, place[result], session.frames.of_row[rows])
        self.arrivals = np.maximum.accumulate(self.arrivals)
        # A view that is older than the result by more than `FRESH` is one that the program went on drawing.
        fresh = session.at_s[rows] >= newest[result] - FRESH
        self._rows = rows[fresh]
        self._places = (place[result][fresh], person[fresh], session.sensor[rows][fresh])

    def spread(self, values: Float64) -> Float64:
        """Return values of rows (rows, …) by frame, person and sensor (frames, people, sensors, …); NaN elsewhere."""
        out = np.full((len(self.at_s), len(self.people), self._sensors, *values.shape[1:]), np.nan)
        out[self._places] = values[self._rows]
        return out


def views_of_methods(log: StudyLog, methods: Sequence[str]) -> tuple[MethodViews, ...]:
    """Align the pairs of a study log by each method, in the order given.

    Args:
        log: the study log, of one participant and at most two sensors.
        methods: names, optionally with settings, such as ``default:people.smoothing=kalman``.

    Raises:
        InputError: the log cannot be replayed.
        SettingsError, EvaluationError: a method is unknown or cannot be scored.
    """
    session = StudySession(log)
    return tuple(TrackedRecording(session, method).pairs() for method in methods)
