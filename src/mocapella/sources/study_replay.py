"""Replay a study log as the sensors that recorded it: frames on each sensor's own clock (docs/study-log.md).

The log has the reference sensor's skeletons in that sensor's camera frame. The second sensor's skeletons are in the
reference's camera frame too, transformed by the thesis' calibration of the day; its own camera frame is not in the log.
The replay therefore places the second sensor at the nominal pose that the file states, and transforms its skeletons
into that camera frame by one fixed rigid motion. A calibration of the replayed sensors differs from that motion by the
error of the thesis' calibration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.geometry import rigid
from mocapella.model.observations import Arrival, BodyFrame, JointState
from mocapella.model.study_log import TICK_NS, YEAR_1_TO_1970_MS, StudyLog
from mocapella.model.topology import topology
from mocapella.sources.recorded_track import MAX_LENGTH, MAX_STEP_BACK, ONE_RUN, RecordedTrack, ReplayReport, order_rows
from mocapella.sources.study_sensors import (
    STUDY_SENSORS,
    motion_by_angle,
    motions_of_people,
    nominal_motion,
    reference_kinect,
    refuse,
    rows_of_placement,
    sensor_names,
)

_MS: Final = 1_000_000
_LIMIT_NS: Final = 2**62
"""146 years; the difference of two times within this limit fits into int64."""
_KINECT_V2: Final = topology("kinect_v2")


class StudyReplay:
    """A study log as sensors, one or two unless they are placed by angle. The constructor sorts the rows into frames.

    Args:
        log: the study log.
        sensors: the end of a ``Kinect_Id`` → the sensor's name; see `mocapella.sources.study_sensors.sensor_names`.
        placement: the placement to replay, or None for the file's only one. A file that states −9999 is assumed to have
            the one given.
        by_angle: whether sensors, any number, are placed by their logged angles about the axis where people stood, and
            not by the placement.

    Attributes:
        log: the file.
        sensors: names of the sensors, the reference sensor first.
        placement: key of `mocapella.model.session.PLACEMENTS`; empty if the file has one sensor and states none.
        T_reference_sensor: (4, 4) by sensor, from its nominal camera frame to the reference's.
        T_reference_second: (4, 4), from the nominal camera frame of the second sensor to the reference's; the identity
            without a second sensor.
        T_reference_second_of: (4, 4) by person id; its inverse transforms the second sensor's logged skeletons of that
            person into the replayed camera frame. It is ``T_reference_second`` for the first person; for others, the
            difference between the thesis' calibrations for the two people is corrected.
        report: counts of rows and frames.

    Raises:
        SettingsError: there is no such placement, or a sensor's name is invalid or shared by two Kinects.
        InputError: the file does not have or state that placement, has more than two Kinects, no constant reference
            sensor, an invalid person or time, or times that go back by more than `MAX_STEP_BACK`.
    """

    def __init__(
        self,
        log: StudyLog,
        *,
        sensors: Mapping[str, str] = STUDY_SENSORS,
        placement: str | None = None,
        by_angle: bool = False,
    ) -> None:
        self.log = log
        rows, self.placement = (np.arange(len(log)), "") if by_angle else rows_of_placement(log, placement)
        names = sensor_names(log, rows, sensors, None if by_angle else 2)
        reference = reference_kinect(log, rows, names)
        kinects = sorted(names, key=lambda kinect: kinect != reference)
        self.sensors = tuple(names[kinect] for kinect in kinects)
        self.T_reference_sensor = {reference_name: np.eye(4) for reference_name in self.sensors[:1]}
        people = np.unique(log.person_id[rows]).tolist()
        motions = {reference: dict.fromkeys(people, np.eye(4))}
        for kinect in kinects[1:]:
            both = rows[np.isin(log.kinect_id[rows], (reference, kinect))]
            T = motion_by_angle(log, both) if by_angle else nominal_motion(log, both, self.placement)
            self.T_reference_sensor[names[kinect]] = T
            motions[kinect] = dict.fromkeys(people, T) | motions_of_people(log, both, T)
        second = kinects[1] if len(kinects) > 1 else reference
        self.T_reference_second = self.T_reference_sensor[names[second]]
        self.T_reference_second_of = motions[second]
        self._tracks = {
            names[kinect]: _track(log, rows[log.kinect_id[rows] == kinect], names[kinect], motions[kinect])
            for kinect in kinects
        }
        tracks = self._tracks.values()
        self.report = ReplayReport(
            rows=len(rows),
            frames=sum(len(track.time_ns) for track in tracks),
            duplicates_dropped=sum(track.duplicates_dropped for track in tracks),
            sorted=sum(track.sorted for track in tracks),
            joints_not_tracked=sum(int((track.bodies["states"] == 0).sum()) for track in tracks),
        )
        self._zero_ns = min(int(track.at_ns[0]) for track in tracks)

    @property
    def duration_s(self) -> float:
        """Time from the first frame of any sensor to the last [s]."""
        return (max(int(track.at_ns[-1]) for track in self._tracks.values()) - self._zero_ns) / NS_PER_S

    def frames(self, sensor: str) -> Iterator[tuple[float, BodyFrame]]:
        """Yield one sensor's frames in the order of capture, each with its due time, for a replay in real time.

        Positions are in the sensor's own camera frame. ``node_id`` and ``sent_ns`` are 0: the publisher sets them.

        Yields:
            (due_s, frame): time since the first frame of the *file* [s], so that nodes started together stay in step.

        Raises:
            SettingsError: the file has no such sensor; lists its sensors.
        """
        if sensor not in self._tracks:
            raise SettingsError(f"{self.log.source} has no sensor {sensor!r}; it has {one_of(sensor, self.sensors)}")
        track = self._tracks[sensor]
        due_s = ((track.at_ns - self._zero_ns) / NS_PER_S).tolist()
        return ((due, track.frame(number)) for number, due in enumerate(due_s))

    def arrivals(self) -> Iterator[Arrival]:
        """Yield all sensors' frames in the order of ``at_ns``, for tracking without a network.

        At the same instant, the reference sensor's comes first.

        ``at_ns`` is Unix time. The offset of a sensor's clock is the least difference between ``Tracker_Time`` and
        ``Skeleton_Time`` in the file: the program wrote a row after drawing it, so every other difference includes a
        delay.
        """
        tracks = list(self._tracks.values())
        which = np.repeat(np.arange(len(tracks)), [len(track.at_ns) for track in tracks])
        number = np.concatenate([np.arange(len(track.at_ns)) for track in tracks])
        at_ns = np.concatenate([track.at_ns for track in tracks])
        for i in np.lexsort((number, which, at_ns)).tolist():
            yield Arrival(tracks[which[i]].frame(int(number[i])), int(at_ns[i]))


def _track(
    log: StudyLog, rows: NDArray[np.intp], sensor: str, T_reference_sensor_of: Mapping[int, NDArray[np.float64]]
) -> RecordedTrack:
    check_times_and_people(log, rows)
    time_ns = log.skeleton_time_ticks[rows] * TICK_NS
    order = order_rows(time_ns, log.person_id[rows])
    kept = order.kept
    first = order.starts[:-1]
    frame_ns = time_ns[kept][first]
    tracker_ns = (log.tracker_time_ms[rows] - YEAR_1_TO_1970_MS) * _MS
    first_rows = rows[kept][first]
    return RecordedTrack(
        sensor=sensor,
        topology=_KINECT_V2,
        bodies=_bodies(log, rows[kept], T_reference_sensor_of),
        starts=order.starts,
        tilt=np.nan_to_num(np.radians(log.tilt_deg[first_rows])).tolist(),
        height=np.nan_to_num(log.height_cm[first_rows] / 100).tolist(),
        time_ns=frame_ns,
        at_ns=frame_ns + (tracker_ns - time_ns).min(),
        duplicates_dropped=len(order.repeated),
        sorted=order.sorted,
    )


def _bodies(
    log: StudyLog, rows: NDArray[np.intp], T_reference_sensor_of: Mapping[int, NDArray[np.float64]]
) -> dict[str, NDArray[Any]]:
    positions = np.empty(log.positions[rows].shape, dtype=np.float32)
    for person, T_reference_sensor in T_reference_sensor_of.items():
        of_person = log.person_id[rows] == person
        positions[of_person] = rigid.apply(rigid.inverse(T_reference_sensor), log.positions[rows[of_person]])
    seen = np.isfinite(positions[..., 0])
    return {
        "tracking_ids": log.person_id[rows].astype(np.uint64),
        "tracked": np.asarray(seen.any(axis=-1)),
        "clipped_edges": np.zeros(len(rows), dtype=np.uint8),
        "states": np.where(seen, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8),
        "positions": positions,
    }


def check_times_and_people(log: StudyLog, rows: NDArray[np.intp]) -> None:
    """Check the times and person ids of one sensor's rows of a study log, given by their indices (k,).

    Raises:
        InputError: a time is impossible or goes back too far, or a person's id is negative; names the row.
    """
    ticks, tracker_ms = log.skeleton_time_ticks[rows], log.tracker_time_ms[rows]
    no_time = _is_beyond(ticks, 0, _LIMIT_NS // TICK_NS)
    refuse(log, rows[no_time], "skeleton_time_ticks", "is no time of a sensor", "it counts 100 ns, from any zero")
    no_date = _is_beyond(tracker_ms, YEAR_1_TO_1970_MS, _LIMIT_NS // _MS)
    refuse(log, rows[no_date], "tracker_time_ms", "is no date of our time", "it counts milliseconds since year 1")
    negative = log.person_id[rows] < 0
    refuse(log, rows[negative], "person_id", "is no person", "number the people of a file from 0")
    ahead = ticks - ticks[0] > MAX_LENGTH * NS_PER_S / TICK_NS
    refuse(log, rows[ahead], "skeleton_time_ticks", "is more than a day after the sensor's first row", ONE_RUN)
    back = np.maximum.accumulate(ticks) - ticks > MAX_STEP_BACK * NS_PER_S / TICK_NS
    refuse(log, rows[back], "skeleton_time_ticks", f"time goes back by more than {MAX_STEP_BACK} s", ONE_RUN)


def _is_beyond(values: NDArray[np.int64], centre: int, by: int) -> NDArray[np.bool_]:
    """Whether each value is farther from the centre than ``by``, computed without a difference, which may overflow."""
    return (values < centre - by) | (values > centre + by)
