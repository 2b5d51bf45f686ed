"""The study log of the thesis: one row for each sensor's view of a person."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

TICK_NS = 100
"""Unit of ``Skeleton_Time`` [ns]."""

YEAR_1_TO_1970_MS = 62_135_596_800_000
"""Time from the zero of ``Tracker_Time`` (1 January of year 1) to the zero of Unix time [ms]."""


TITLES: dict[str, str] = {
    "study_id": "Study_Id",
    "kinect_config": "Kinect_Config",
    "scenario_id": "Scenario_Id",
    "tracker_time_ms": "Tracker_Time",
    "person_id": "Person_Id",
    "skeleton_id": "Skeleton_Id",
    "skeleton_time_ticks": "Skeleton_Time",
    "init_angle": "Skeleton_Init_Angle",
    "init_dist": "Skeleton_Init_Dist",
    "kinect_id": "Kinect_Id",
    "tilt_deg": "Kinect_Tilt_Angle",
    "height_cm": "Kinect_Height",
}
"""Title of each column in the file, by field of `StudyRow`, in the file's order; the joints' coordinates follow."""


class StudyRow(msgspec.Struct, frozen=True, eq=False):
    """One row: one sensor's view of a person. −9999 in an integer and NaN elsewhere = not available.

    Attributes:
        study_id: the participant.
        kinect_config: placement of the sensors, a value of `mocapella.model.session.PLACEMENTS`.
        scenario_id: scenario, a value of `mocapella.model.session.SCENARIOS`.
        tracker_time_ms: time at which the program wrote the row, since the beginning of year 1 [ms].
        person_id: number of the person.
        skeleton_id: number of the view of this person; 0 is the reference sensor's.
        skeleton_time_ticks: capture time of the view, on the sensor's own clock [100 ns].
        init_angle: yaw θ of the view's pose p_world = R(θ)(p − C), calibrated by a person standing still [rad].
        init_dist: the z of C, the world's origin (that person's centre) in camera space [m].
        kinect_id: the sensor, by its address or name.
        tilt_deg: tilt of the sensor, upwards positive [°].
        height_cm: height of the sensor above the floor [cm].
        positions: (25, 3) float32 in kinect_v2's order, camera space *of the reference view* [m]; NaN = missing.
    """

    study_id: int
    kinect_config: int
    scenario_id: int
    tracker_time_ms: int
    person_id: int
    skeleton_id: int
    skeleton_time_ticks: int
    init_angle: float
    init_dist: float
    kinect_id: str
    tilt_deg: float
    height_cm: float
    positions: Float32


class StudyLog(msgspec.Struct, frozen=True, eq=False):
    """A whole study log: each field of `StudyRow` as an array over the rows, in the file's order.

    Attributes:
        source: the file that the log was read from.
        positions: (rows, 25, 3) float32; all other fields are (rows,), with the units of `StudyRow`.
    """

    source: str
    study_id: Int64
    kinect_config: Int64
    scenario_id: Int64
    tracker_time_ms: Int64
    person_id: Int64
    skeleton_id: Int64
    skeleton_time_ticks: Int64
    init_angle: Float64
    init_dist: Float64
    kinect_id: NDArray[np.str_]
    tilt_deg: Float64
    height_cm: Float64
    positions: Float32

    def __len__(self) -> int:
        return len(self.positions)

    def rows(self) -> Iterator[StudyRow]:
        """Yield the rows in the file's order; their positions are views of the log's array."""
        columns = [getattr(self, name).tolist() for name in TITLES]
        for values, positions in zip(zip(*columns, strict=True), self.positions, strict=True):
            fields: dict[str, Any] = dict(zip(TITLES, values, strict=True))
            yield StudyRow(**fields, positions=positions)
