"""Run a method over a study log, causally, and read its fused people at the log's rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.causal_run import CausalRun, PersonThen, run_causally
from mocapella.evaluation.protocol import LearntFromStudies, ScoredTracker
from mocapella.evaluation.study_pairs import StudyFrames, StudySession

Int64 = NDArray[np.int64]


def run_session(session: StudySession, make: Callable[[int], ScoredTracker], frames: StudyFrames) -> CausalRun:
    """Run a new tracker over frames of a session, from the sensor layout of the thesis' calibration.

    Args:
        session: the study log.
        make: creates a tracker for a number of sensors. A tracker that was trained on the studies leaves out the
            session's participant.
        frames: the frames, such as ``session.frames``.

    Raises:
        SettingsError: no model was trained without the participant.
        EvaluationError: the method's estimates cannot be scored.
    """

    def left_out(sensors: int) -> ScoredTracker:
        tracker = make(sensors)
        if isinstance(tracker, LearntFromStudies):
            tracker.leave_out(session.participant)
        return tracker

    replay = session.replay
    return run_causally(left_out, replay.sensors, frames.arrivals, dict(replay.T_reference_sensor))


def people_at(run: CausalRun, arrivals: Int64, logged: Int64) -> tuple[PersonThen | None, ...]:
    """Return the tracked person for each logged person and instant.

    The tracked person is the one fused from a sensor's view of the logged person. Where no view was fused, because no
    sensor sees the person, it is the one with the id that the logged person had last.

    Args:
        run: the method's run.
        arrivals: (n,) indices of arrivals; the scene after each is used. Rising for each person.
        logged: (n,) Person_Id.

    Returns:
        (n,) the people; None where the scene lacks the person.
    """
    last: dict[int, int] = {}
    found: list[PersonThen | None] = []
    for k, person in zip(arrivals.tolist(), logged.tolist(), strict=True):
        keys = {(sensor, person) for sensor in run.sensors}
        there = next((one for one in run.people[k] if one.keys & keys), None)
        if there is None:
            others = (one for one in run.people[k] if not one.keys and one.id == last.get(person))
            there = next(others, None)
        else:
            last[person] = there.id
        found.append(there)
    return tuple(found)
