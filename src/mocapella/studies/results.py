"""What the analysis of a study finds in its recordings, before tables, tests and pictures are made of it.

One recording gives one `FileResults`. They are merged in the order of the files, so that the result is the same to the
bit however many processes analysed them.
"""

from __future__ import annotations

from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]

AXES: Final = ("dx", "dy", "dz", "dd")
"""Order of the last axis of `DifferenceSums.sums`: |Δx|, |Δy|, |Δz| and the distance Δd."""
BIN_M: Final = 0.001
"""Width of a histogram's bin [m]."""
BINS: Final = 2001
"""Number of a histogram's bins; the last one has all distances from `BIN_M` × 2000 on."""
TIMELINE_S: Final = 0.1
"""Width of a timeline's bin [s]."""


class ComparedViews(msgspec.Struct, frozen=True, order=True):
    """What is compared, in whose recording, doing what.

    Attributes:
        method: tracking method whose alignment is scored; `stand-still` for views as the thesis' program logged them.
        placement: name of the sensors' placement, such as `parallel`, `45`, `90`.
        task: name of the task, such as `walk`.
        participant: code of the participant, such as `7`; never a name.
        first, second: names of the compared views: two sensors, or a sensor and `fused`.
    """

    method: str
    placement: str
    task: str
    participant: str
    first: str
    second: str


class DifferenceSums(msgspec.Struct, frozen=True, eq=False):
    """The differences of all pairs of one `ComparedViews`, as sums that can be added.

    Attributes:
        key: the pairs' method, placement, task, participant and views.
        pairs: number of pairs of views.
        sums: (joints, 4) sums over the pairs, by `AXES` [m]; joints that a view lacks are left out.
        squares: (joints, 4) sums of the squares [m²].
        counts: (joints,) number of pairs in each sum.
        histogram: (joints, `BINS`) number of distances Δd in each bin of `BIN_M`.
        worst: (joints,) largest Δd [m]; NaN where there is none.
        timeline_sums, timeline_counts: (bins, joints) sums of Δd [m] and their numbers, in bins of `TIMELINE_S` from
            the first frame of the task on.
    """

    key: ComparedViews
    pairs: int
    sums: Float64
    squares: Float64
    counts: Int64
    histogram: Int64
    worst: Float64
    timeline_sums: Float64
    timeline_counts: Int64

    @property
    def means(self) -> Float64:
        """(joints, 4) means over the pairs [m]; NaN for a joint that is never in both views."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.sums / self.counts[:, None]


class PoseStrip(msgspec.Struct, frozen=True, eq=False):
    """Skeletons of a task at a few instants, for a timeline of stick figures.

    Attributes:
        method, placement, task, participant: as in `ComparedViews`.
        person: the person's number in the recording.
        names: names of the views, sensors first, then perhaps `fused`.
        at_s: (instants,) time since the task's first frame [s].
        positions: (instants, views, joints, 3) in the reference sensor's camera space, x to its left, y up, z forward
            [m]; NaN where a view lacks the person or a joint.
        measured: (instants, views, joints) whether the joint was measured; False for one that is inferred.
    """

    method: str
    placement: str
    task: str
    participant: str
    person: int
    names: tuple[str, ...]
    at_s: Float64
    positions: Float32
    measured: NDArray[np.bool_]


class MeasuredFigure(msgspec.Struct, frozen=True):
    """One figure that a measure found in one task of one recording.

    Attributes:
        measure: name of the measure, such as `lost`.
        quantity: the measured quantity, such as `longest loss`.
        unit: `s`, `cm`, `%`, or empty for a count.
        method, placement, task, participant: as in `ComparedViews`.
        subject: the figure's subject, such as a sensor's name or `person 2`.
        value: the figure in ``unit``; NaN if unknown.
        samples: number of frames or joints that it is a figure of.
    """

    measure: str
    quantity: str
    unit: str
    method: str
    placement: str
    task: str
    participant: str
    subject: str
    value: float
    samples: int


class StudyOrder(msgspec.Struct, frozen=True):
    """The order of a study's tasks and placements in tables, pictures and report.

    Attributes:
        tasks, placements: names in their order; names that are not there follow, in the order of
            `mocapella.studies.pooled_tasks`.
    """

    tasks: tuple[str, ...] = ()
    placements: tuple[str, ...] = ()


class CleaningStep(msgspec.Struct, frozen=True):
    """What one step of the cleaning did to one recording.

    Attributes:
        step: name of the step, such as `scenario 4 after 8 read as 8`.
        rows: number of rows that it changed or removed.
        removed: whether these rows were removed.
    """

    step: str
    rows: int
    removed: bool


class StudyFinding(msgspec.Struct, frozen=True):
    """A fault of the recordings that a reader of the report must know: a cut file, a missing condition.

    Attributes:
        file: name of the file, without its folder; empty if it is about the whole study.
        what: the fault, in one line.
        effect: what the analysis did about it.
        rows: number of rows it is about; 0 if it is not about rows.
    """

    file: str
    what: str
    effect: str
    rows: int = 0


class FileResults(msgspec.Struct, frozen=True, eq=False):
    """All that one recording gives.

    Attributes:
        file: its name, without its folder.
        rows: number of rows read.
        used: number of rows that are in at least one pair.
        joints: names of the joints, in the order of all arrays.
        cleaning: the steps, in their order; all files have the same steps.
        findings: the file's faults.
        summaries: differences, one for each `ComparedViews`, sorted.
        strips: skeletons for pictures.
        measured: figures of the measures.
        origin: what wrote it, with version and settings, for the report's methods; empty for logs of 2015.
        whole: whether all of it could be read.
    """

    file: str
    rows: int
    used: int
    joints: tuple[str, ...]
    cleaning: tuple[CleaningStep, ...]
    findings: tuple[StudyFinding, ...] = ()
    summaries: tuple[DifferenceSums, ...] = ()
    strips: tuple[PoseStrip, ...] = ()
    measured: tuple[MeasuredFigure, ...] = ()
    origin: dict[str, Any] = {}
    whole: bool = True


class StudyResults(msgspec.Struct, frozen=True, eq=False):
    """The results of a study: `merged` from the results of the files.

    Attributes:
        files: the recordings, in the order of their names.
        joints: names of the joints, in the order of all arrays.
        summaries: differences, one for each `ComparedViews`, sorted by it; files of one key are added.
        strips, measured: of all files.
        findings: of the whole study, then of the files.
        order: of tasks and placements.
    """

    files: tuple[FileResults, ...]
    joints: tuple[str, ...]
    summaries: tuple[DifferenceSums, ...]
    strips: tuple[PoseStrip, ...]
    measured: tuple[MeasuredFigure, ...]
    findings: tuple[StudyFinding, ...]
    order: StudyOrder = StudyOrder()
