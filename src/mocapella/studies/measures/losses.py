"""The measure `lost`: how often, how long and for what share of the time each sensor, and the method, lost a person."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.studies.measures.measure import INTERACTIONS, OBSTACLE, Measure
from mocapella.studies.results import MeasuredFigure
from mocapella.studies.task_views import PAUSE_S, TaskViews

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]

LOSS_S: Final = 0.2
"""Shortest loss [s]; a shorter gap is a few frames that came late."""


class Loss(msgspec.Struct, frozen=True):
    """One loss of a person.

    Attributes:
        first: index of the first frame without the person, or of the frame before a gap without any logged person.
        back: index of the first frame with the person again, or of the last frame before a pause or the end.
        length_s: time without the person [s].
    """

    first: int
    back: int
    length_s: float


def losses(at_s: Float64, there: Bool) -> tuple[Loss, ...]:
    """Find the losses of at least `LOSS_S`.

    A loss lasts from the first frame without the person to the first with it again. If no frame at all was logged in
    between, it lasts from the frame before to the one after. Gaps of more than `PAUSE_S` are pauses of the recording
    and no losses.

    Args:
        at_s: (frames,) rising times [s].
        there: (frames,) whether the person is there.
    """
    steps = np.diff(at_s)
    lost = (~there[:-1] | (steps >= LOSS_S)) & (steps <= PAUSE_S)
    before = np.concatenate([[False], lost[:-1]])
    begins = np.flatnonzero(lost & (there[:-1] | ~before))
    found = []
    for first in begins.tolist():
        goes_on = lost[first + 1 :] & ~there[first + 1 : -1]
        last = first + (len(goes_on) if goes_on.all() else int(np.argmin(goes_on)))
        found.append(Loss(first, last + 1, float(steps[first : last + 1].sum())))
    return tuple(loss for loss in found if loss.length_s >= LOSS_S)


def find(task: TaskViews) -> Iterator[MeasuredFigure]:
    """Return the losses of each person by each sensor and by the method, from the first frame of the task on."""
    sees, tracks = task.sees, task.tracks
    for p, person in enumerate(task.people):
        columns = {sensor: sees[:, p, s] for s, sensor in enumerate(task.sensors)} | {"fused": tracks[:, p]}
        for subject, there in columns.items():
            name = task.of_person(subject, person)
            lost = [loss.length_s for loss in losses(task.at_s, there)]
            total_s = float(task.lasts_s.sum())
            values = {
                "losses": len(lost),
                "longest loss": max(lost, default=0.0),
                "time lost": 100 * sum(lost) / total_s if total_s > 0 else np.nan,
            }
            for quantity, value in values.items():
                yield task.figure(LOST.name, quantity, LOST.quantities[quantity], name, value, samples=len(task.at_s))


LOST: Final = Measure(
    interface=1,
    name="lost",
    summary="how often and how long each sensor, and the method, lost a person",
    quantities={"losses": "", "longest loss": "s", "time lost": "%"},
    find=find,
    tasks=(*OBSTACLE, *INTERACTIONS),
)
