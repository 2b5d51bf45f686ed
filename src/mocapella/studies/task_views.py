"""What a measure of a study receives: one task of a recording, each sensor's views aligned by a method, and its people.

The frames are the recording's results: the rows of one ``Tracker_Time``. All positions are in the reference sensor's
camera space, x to its left, y up, z forward [m].
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.identity import IdentityFrame
from mocapella.studies.results import MeasuredFigure

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

PAUSE_S: Final = 10.0
"""A longer gap between two frames is a pause of the recording, and no loss [s]."""


class HiddenViews(msgspec.Struct, frozen=True, eq=False):
    """A second run of the method, with joints of one sensor at a time hidden from it.

    Attributes:
        hidden: (frames, people, sensors, joints) whether the joint was hidden.
        views: (frames, people, sensors, joints, 3) all joints that the sensors measured, also the hidden ones, aligned
            by this run's estimates.
        fused: (frames, people, joints, 3) the fused people of this run; NaN where missing.
    """

    hidden: Bool
    views: Float64
    fused: Float64


class TaskViews(msgspec.Struct, frozen=True, eq=False):
    """One task of one recording, as aligned and tracked by one method.

    Attributes:
        method, placement, task, participant: as in `mocapella.studies.results.ComparedViews`.
        sensors: names of the sensors, the reference sensor first.
        people: the logged people's numbers.
        at_s: (frames,) time since the task's first frame, rising [s].
        views: (frames, people, sensors, joints, 3) each sensor's view with the labels that the method decided; NaN
            where a sensor has no recent view of the person, or lacks a joint.
        fused: (frames, people, joints, 3) the method's fused person; NaN where missing.
        fused_ids: (frames, people) the method's id of the fused person; −1 where missing.
        labelled: frames of hand-labelled true people, beside the people that the method found; empty without labels.
        hidden: the run with hidden joints, for measures with ``hides``; None for others.
    """

    method: str
    placement: str
    task: str
    participant: str
    sensors: tuple[str, ...]
    people: tuple[int, ...]
    at_s: Float64
    views: Float64
    fused: Float64
    fused_ids: Int64
    labelled: tuple[IdentityFrame, ...] = ()
    hidden: HiddenViews | None = None

    @property
    def sees(self) -> Bool:
        """(frames, people, sensors) whether a sensor has a recent view of a person."""
        return np.asarray(np.isfinite(self.views).any(axis=(-2, -1)))

    @property
    def tracks(self) -> Bool:
        """(frames, people) whether the method has the fused person."""
        return np.asarray(np.isfinite(self.fused).any(axis=(-2, -1)))

    @property
    def lasts_s(self) -> Float64:
        """(frames,) time from each frame to the next; 0 for the last one, and before a pause of `PAUSE_S` [s]."""
        steps = np.diff(self.at_s, append=self.at_s[-1:])
        return np.where(steps > PAUSE_S, 0.0, steps)

    def figure(
        self, measure: str, quantity: str, unit: str, subject: str, value: float, *, samples: int = 0
    ) -> MeasuredFigure:
        """Return a figure of this task, see `mocapella.studies.results.MeasuredFigure`."""
        return MeasuredFigure(
            measure=measure,
            quantity=quantity,
            unit=unit,
            method=self.method,
            placement=self.placement,
            task=self.task,
            participant=self.participant,
            subject=subject,
            value=float(value),
            samples=int(samples),
        )

    def of_person(self, subject: str, person: int) -> str:
        """Return a subject such as ``front``, with the person's number if the task has several people."""
        return subject if len(self.people) == 1 else f"{subject}, person {person}"
