"""Choose skeletons of a task for a timeline of stick figures: at equal distances, and where a person is lost."""

from __future__ import annotations

from typing import Final

import numpy as np

from mocapella.studies.measures.losses import losses
from mocapella.studies.results import PoseStrip
from mocapella.studies.task_views import TaskViews

INSTANTS: Final = 8
"""Number of instants at equal distances in time."""
MOST_LOSSES: Final = 4
"""Number of losses that are shown beside them, the longest ones."""
FUSED: Final = "fused"
"""Name of the method's person among the views."""


def pose_strip(task: TaskViews, person: int, instants: int = INSTANTS) -> PoseStrip:
    """Return the views of a person at ``instants`` frames, and in the middle of the longest losses.

    Args:
        task: the task.
        person: number of the person, one of ``task.people``.
        instants: number of frames at equal distances in time, at least 1; fewer if the task has not so many.
    """
    p = task.people.index(person)
    shown = set(np.searchsorted(task.at_s, np.linspace(0, task.at_s[-1], instants)).tolist())
    lost = {loss for s in range(len(task.sensors)) for loss in losses(task.at_s, task.sees[:, p, s])}
    longest = sorted(lost, key=lambda loss: (-loss.length_s, loss.first))[:MOST_LOSSES]
    chosen = np.array(sorted(shown | {(loss.first + loss.back) // 2 for loss in longest}))
    views = np.concatenate([task.views[chosen, p], task.fused[chosen, p, None]], axis=1)
    measured = np.isfinite(views).all(axis=-1)
    measured[:, -1] &= measured[:, :-1].any(axis=1)  # a fused joint that no sensor sees is inferred
    return PoseStrip(
        method=task.method,
        placement=task.placement,
        task=task.task,
        participant=task.participant,
        person=person,
        names=(*task.sensors, FUSED),
        at_s=task.at_s[chosen],
        positions=views.astype(np.float32),
        measured=measured,
    )
