"""Hide joints of one sensor at a time from a method, to compare its prediction with what that sensor measured.

In each `PERIOD_S` of a task the joints of one part of the body are hidden from one sensor during the last `HIDDEN_S`.
The sensors take turns, and so do the parts. The choice depends on nothing else, so every method misses the same joints.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.scored_views import TOPOLOGY
from mocapella.evaluation.study_pairs import StudyFrames, StudySession
from mocapella.model.observations import Arrival, BodyFrame, JointState

Bool = NDArray[np.bool_]

PERIOD_S: Final = 2.0
"""Interval from one hidden stretch to the next [s]."""
HIDDEN_S: Final = 1.0
"""Length of a hidden stretch [s]."""
_LEG: Final = ("Hip", "Knee", "Ankle", "Foot")
_ARM: Final = ("Elbow", "Wrist", "Hand", "HandTip", "Thumb")
PARTS: Final = tuple(
    tuple(TOPOLOGY.index(name) for name in names)
    for names in (
        tuple(f"{joint}{side}" for side in ("Left", "Right") for joint in _LEG),
        tuple(f"{joint}Left" for joint in _ARM),
        tuple(f"{joint}Right" for joint in _ARM),
    )
)
"""Joints of the parts that are hidden, one part at a time: both legs, the left arm, the right arm."""


def hidden_joints(session: StudySession) -> Bool:
    """Choose the joints (rows, joints) of a session to hide.

    Stretches are counted from the first frame of each task.
    """
    hidden = np.zeros(session.raw.shape[:2], dtype=bool)
    sensors = len(session.replay.sensors)
    for task in np.unique(session.log.scenario_id).tolist():
        rows = np.flatnonzero(session.log.scenario_id == task)
        since_s = session.at_s[rows] - session.at_s[rows].min()
        stretch = (since_s // PERIOD_S).astype(int)
        in_stretch = (since_s % PERIOD_S >= PERIOD_S - HIDDEN_S) & (session.sensor[rows] == stretch % sensors)
        for number, part in enumerate(PARTS):
            chosen = rows[in_stretch & (stretch // sensors % len(PARTS) == number)]
            hidden[np.ix_(chosen, part)] = True
    return hidden


def without_joints(session: StudySession, hidden: Bool) -> StudyFrames:
    """Return a session's frames without joints.

    Args:
        session: the study log.
        hidden: (rows, joints) the joints to remove.
    """
    arrivals = list(session.frames.arrivals)
    for row in np.flatnonzero(hidden.any(axis=1)).tolist():
        k = int(session.frames.of_row[row])
        arrivals[k] = _without(arrivals[k], int(session.log.person_id[row]), hidden[row])
    return StudyFrames(tuple(arrivals), session.frames.of_row)


def _without(arrival: Arrival, person: int, hidden: Bool) -> Arrival:
    frame = arrival.frame
    assert isinstance(frame, BodyFrame)
    body = frame.tracking_ids.tolist().index(person)
    positions, states = frame.positions.copy(), frame.states.copy()
    positions[body, hidden], states[body, hidden] = np.nan, JointState.NOT_TRACKED
    return msgspec.structs.replace(arrival, frame=msgspec.structs.replace(frame, positions=positions, states=states))
