"""The measure `filled`: how well a method predicts joints that are hidden from one sensor, compared where it sees them.

Joints are hidden from one sensor at a time (`mocapella.studies.hidden_joints`), the method runs without them, and its
person is compared with what the hidden sensor measured. Joints that the other sensor lacks too are not compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.studies.measures.losses import losses
from mocapella.studies.measures.measure import INTERACTIONS, OBSTACLE, Measure
from mocapella.studies.results import MeasuredFigure
from mocapella.studies.task_views import HiddenViews, TaskViews

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
_CM: Final = 100.0


def find(task: TaskViews) -> Iterator[MeasuredFigure]:
    """Return the errors of hidden joints, by sensor, and of joints at the end of the real losses."""
    for s, sensor in enumerate(task.sensors):
        for p, person in enumerate(task.people):
            subject = task.of_person(sensor, person)
            if task.hidden is not None:
                yield from _of_hidden(task, task.hidden, subject, (p, s))
            yield from _of_returns(task, subject, (p, s))


def _of_hidden(task: TaskViews, hidden: HiddenViews, subject: str, place: tuple[int, int]) -> Iterator[MeasuredFigure]:
    p, s = place
    own = hidden.views[:, p, s]
    others = np.delete(hidden.views[:, p], s, axis=1)
    there: Bool = np.asarray(np.isfinite(others).all(axis=-1))
    other = np.where(there[..., None], others, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)[..., None]
    compared = hidden.hidden[:, p, s] & np.isfinite(own).all(axis=-1) & there.any(axis=1)
    count = int(compared.sum())
    if not count:
        return
    filled = _apart(hidden.fused[:, p], own)[compared]
    yield _figure(task, "hidden joints", subject, _mean(filled), count)
    yield _figure(task, "hidden joints, 95th percentile", subject, _percentile(filled), count)
    yield _figure(task, "hidden joints not filled", subject, 100 * float((~np.isfinite(filled)).mean()), count)
    yield _figure(
        task, "same joints, not hidden", subject, _mean(_apart(task.fused[:, p], task.views[:, p, s])[compared]), count
    )
    yield _figure(task, "same joints, other sensor", subject, _mean(_apart(other, own)[compared]), count)


def _of_returns(task: TaskViews, subject: str, place: tuple[int, int]) -> Iterator[MeasuredFigure]:
    """Return the error of the method's person in the last frame of each loss, against the first view after it."""
    p, s = place
    sees = task.sees[:, p, s]
    back = [loss.back for loss in losses(task.at_s, sees) if not sees[loss.back - 1] and sees[loss.back]]
    if back:
        after = np.array(back)
        apart = _apart(task.fused[after - 1, p], task.views[after, p, s])
        finite = np.isfinite(apart)
        yield _figure(task, "joints at the end of a loss", subject, _mean(apart), int(finite.sum()))


def _apart(a: Float64, b: Float64) -> Float64:
    return np.asarray(np.linalg.norm(a - b, axis=-1) * _CM)


def _mean(values: Float64) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def _percentile(values: Float64) -> float:
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, 95)) if len(finite) else float("nan")


def _figure(task: TaskViews, quantity: str, subject: str, value: float, samples: int) -> MeasuredFigure:
    return task.figure(FILLED.name, quantity, FILLED.quantities[quantity], subject, value, samples=samples)


FILLED: Final = Measure(
    interface=1,
    name="filled",
    summary="how well joints that are hidden from one sensor are predicted, compared where it sees them",
    quantities={
        "hidden joints": "cm",
        "hidden joints, 95th percentile": "cm",
        "hidden joints not filled": "%",
        "same joints, not hidden": "cm",
        "same joints, other sensor": "cm",
        "joints at the end of a loss": "cm",
    },
    find=find,
    tasks=("walk", *OBSTACLE, *INTERACTIONS),
    hides=True,
)
