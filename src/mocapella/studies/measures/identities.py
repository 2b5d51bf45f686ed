"""The measure `identity`: whether people keep their identity in tasks of several people.

Where a file has hand-labelled positions (`mocapella.evaluation.interactions`), the method's people are compared with
them. In all files they are compared with the logged people, and the sensors' views with one another.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.identity import IdentityFrame, identity_switches
from mocapella.evaluation.interactions import identity_figures
from mocapella.studies.measures.measure import INTERACTIONS, Measure
from mocapella.studies.results import MeasuredFigure
from mocapella.studies.task_views import TaskViews

Float64 = NDArray[np.float64]


def find(task: TaskViews) -> Iterator[MeasuredFigure]:
    """Return identity switches, missing labelled people and frames with crossed views; nothing for one person."""
    if len(task.people) < 2:
        return
    if task.labelled:
        figures = identity_figures(task.labelled)
        labels = figures["labels"]
        yield _figure(task, "switches against labels", "all", figures["identity_switches"], labels)
        yield _figure(task, "labelled people missed", "all", figures["missed"], labels)
    frames = [_as_logged(task.people, ids) for ids in task.fused_ids.tolist()]
    yield _figure(task, "switches against the log", "all", identity_switches(frames), len(frames))
    for s, sensor in enumerate(task.sensors[1:], start=1):
        crossed, compared = _crossed(task, s)
        if compared:
            yield _figure(task, "crossed views", sensor, 100 * crossed / compared, compared)


def _as_logged(people: tuple[int, ...], ids: list[int]) -> IdentityFrame:
    """Return the logged people beside the method's: alike where the method fused the logged person's views."""
    found = tuple(dict.fromkeys(one for one in ids if one >= 0))
    alike = np.array([[float(own == one) for one in found] for own in ids]).reshape(len(people), len(found))
    return IdentityFrame(people, found, alike)


def _crossed(task: TaskViews, s: int) -> tuple[int, int]:
    """Count the frames where a sensor's views of two people fit the reference sensor's better when exchanged.

    Returns:
        The number of crossed pairs of people, and of all that both sensors see, over all frames.
    """
    crossed = compared = 0
    first, second = (_centres(task.views[:, :, k]) for k in (0, s))
    for a in range(len(task.people)):
        for b in range(a):
            straight = _apart(first[:, a], second[:, a]) + _apart(first[:, b], second[:, b])
            exchanged = _apart(first[:, a], second[:, b]) + _apart(first[:, b], second[:, a])
            both = np.isfinite(straight) & np.isfinite(exchanged)
            crossed += int((exchanged[both] < straight[both]).sum())
            compared += int(both.sum())
    return crossed, compared


def _centres(views: Float64) -> Float64:
    """Return the mean joint (frames, people, 3) of views (frames, people, joints, 3); NaN without a joint."""
    there = np.isfinite(views)
    count = there.sum(axis=2)
    return np.where(count > 0, np.where(there, views, 0.0).sum(axis=2) / np.maximum(count, 1), np.nan)


def _apart(a: Float64, b: Float64) -> Float64:
    return np.asarray(np.linalg.norm(a - b, axis=-1))


def _figure(task: TaskViews, quantity: str, subject: str, value: float, samples: int) -> MeasuredFigure:
    return task.figure(IDENTITY.name, quantity, IDENTITY.quantities[quantity], subject, value, samples=samples)


IDENTITY: Final = Measure(
    interface=1,
    name="identity",
    summary="whether people keep their identity while one hides another",
    quantities={
        "switches against labels": "",
        "labelled people missed": "",
        "switches against the log": "",
        "crossed views": "%",
    },
    find=find,
    tasks=INTERACTIONS,
)
