"""A study log as the sensors that it was made by: frames on each sensor's own clock (docs/study-log.md).

The log has the reference sensor's skeletons in that sensor's own camera space. The second sensor's it has in the
reference's too, as the thesis' calibration of the day brought them there; its true camera space is not in the log.
The replay therefore places the second sensor where the file says that it stood, nominally, and maps its skeletons into
that camera space by one fixed rigid motion. What a calibration finds instead of that motion differs from it by what
the thesis' calibration was wrong by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.geometry import rigid
from mocapella.model.observations import Arrival, BodyFrame, JointState
from mocapella.model.study_log import TICK_NS, YEAR_1_TO_1970_MS, StudyLog
from mocapella.model.topology import topology
from mocapella.sources.study_sensors import (
    STUDY_SENSORS,
    motions_of_people,
    nominal_motion,
    reference_kinect,
    refuse,
    rows_of_placement,
    sensor_names,
)

MAX_STEP_BACK: Final = 0.5
"""Frames that come later than newer ones of their sensor are sorted, up to this far back [s]."""
MAX_LENGTH: Final = 86_400.0
"""No sensor's times in one file are farther apart [s]."""

_MS: Final = 1_000_000
_LIMIT_NS: Final = 2**62
"""146 years; the difference of two times that are nearer to their zeros fits into int64."""
_KINECT_V2: Final = topology("kinect_v2")


class ReplayReport(msgspec.Struct, frozen=True):
    """What became of the rows.

    Attributes:
        rows: of the file, and of the chosen placement.
        frames: made of them; the bodies that a sensor sees at one instant are one frame.
        duplicates_dropped: rows that repeat a person's skeleton of the same sensor and instant.
        sorted: rows that came later in the file than a newer one of their sensor.
        joints_not_tracked: in the frames.
    """

    rows: int
    frames: int
    duplicates_dropped: int
    sorted: int
    joints_not_tracked: int


class _Track(msgspec.Struct, frozen=True, eq=False):
    """One sensor's rows as frames.

    Attributes:
        sensor: its name.
        bodies: over (bodies of all frames), in the order of capture: a `BodyFrame`'s fields of that shape.
        starts: (frames + 1,), frame i has the bodies ``starts[i]`` to ``starts[i + 1] - 1``.
        tilt, height: (frames,), 0 where the file has none.
        time_ns: (frames,), on the sensor's own clock; strictly rising.
        at_ns: (frames,), Unix time.
        duplicates_dropped, sorted: rows.
    """

    sensor: str
    bodies: dict[str, NDArray[Any]]
    starts: list[int]
    tilt: list[float]
    height: list[float]
    time_ns: NDArray[np.int64]
    at_ns: NDArray[np.int64]
    duplicates_dropped: int
    sorted: int

    def frame(self, number: int) -> BodyFrame:
        """The sensor's frame of that number."""
        first, end = self.starts[number], self.starts[number + 1]
        return BodyFrame(
            sensor=self.sensor,
            node_id=0,
            sequence=number,
            time_ns=int(self.time_ns[number]),
            sent_ns=0,
            topology=_KINECT_V2,
            depth_size_px=(0, 0),
            tilt=self.tilt[number],
            height=self.height[number],
            **{name: values[first:end] for name, values in self.bodies.items()},
        )


class StudyReplay:
    """One study log as one or two sensors.

    Attributes:
        log: the file.
        sensors: names, the reference sensor first.
        placement: key of `mocapella.model.session.PLACEMENTS`; empty where the file has one sensor and does not say.
        T_reference_second: (4, 4), from the nominal camera space of the second sensor to the reference's; the identity
            where there is no second.
        T_reference_second_of: the same by person: the first person's is that one; the others' differ from it by how far
            the thesis' calibrations of the two were apart, so that the replayed sensor has one camera space.
        report: what became of the rows.
    """

    def __init__(
        self, log: StudyLog, *, sensors: Mapping[str, str] = STUDY_SENSORS, placement: str | None = None
    ) -> None:
        """Sort the rows into frames.

        Args:
            log: as it was read.
            sensors: the end of a ``Kinect_Id`` → the sensor's name; see `mocapella.sources.study_sensors.sensor_names`.
            placement: which the file must have, or None for the one that it has. A file that says −9999 is believed
                to have the one given.

        Raises:
            SettingsError: no such placement, or a name that no sensor can have or two Kinects would share.
            InputError: the file does not have that placement or does not say, has more than two Kinects, no constant
                reference sensor, a person or time that is none, or times that go back by more than `MAX_STEP_BACK`.
        """
        self.log = log
        rows, self.placement = rows_of_placement(log, placement)
        names = sensor_names(log, rows, sensors)
        reference = reference_kinect(log, rows, names)
        kinects = sorted(names, key=lambda kinect: kinect != reference)
        self.sensors = tuple(names[kinect] for kinect in kinects)
        self.T_reference_second = nominal_motion(log, rows, self.placement) if len(kinects) == 2 else np.eye(4)
        self.T_reference_second_of = motions_of_people(log, rows, self.T_reference_second)
        motions = (dict.fromkeys(self.T_reference_second_of, np.eye(4)), self.T_reference_second_of)
        self._tracks = {
            names[kinect]: _track(log, rows[log.kinect_id[rows] == kinect], names[kinect], T_reference_sensor_of)
            for kinect, T_reference_sensor_of in zip(kinects, motions, strict=False)
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
        """From the first frame to the last."""
        return (max(int(track.at_ns[-1]) for track in self._tracks.values()) - self._zero_ns) / NS_PER_S

    def frames(self, sensor: str) -> Iterator[tuple[float, BodyFrame]]:
        """One sensor's frames, in the order of their capture, each with when it is due.

        Returns:
            (due_s, frame): seconds since the first frame of the *file*, so that nodes that start together stay in step.

        Raises:
            SettingsError: the file has no such sensor; lists those it has.
        """
        if sensor not in self._tracks:
            raise SettingsError(f"{self.log.source} has no sensor {sensor!r}; it has {one_of(sensor, self.sensors)}")
        track = self._tracks[sensor]
        due_s = ((track.at_ns - self._zero_ns) / NS_PER_S).tolist()
        return ((due, track.frame(number)) for number, due in enumerate(due_s))

    def arrivals(self) -> Iterator[Arrival]:
        """All sensors' frames in the order of ``at_ns``; of the same instant, the reference sensor's is first.

        ``at_ns`` is Unix time. A sensor's clock is brought to it by the least difference in the file between
        ``Tracker_Time`` and ``Skeleton_Time``: the program wrote a row when the view had drawn it, so every other
        difference is the least one plus a delay.
        """
        tracks = list(self._tracks.values())
        which = np.repeat(np.arange(len(tracks)), [len(track.at_ns) for track in tracks])
        number = np.concatenate([np.arange(len(track.at_ns)) for track in tracks])
        at_ns = np.concatenate([track.at_ns for track in tracks])
        for i in np.lexsort((number, which, at_ns)).tolist():
            yield Arrival(tracks[which[i]].frame(int(number[i])), int(at_ns[i]))


def _track(
    log: StudyLog, rows: NDArray[np.intp], sensor: str, T_reference_sensor_of: Mapping[int, NDArray[np.float64]]
) -> _Track:
    _check_times_and_people(log, rows)
    time_ns = log.skeleton_time_ticks[rows] * TICK_NS
    back_ns = np.maximum.accumulate(time_ns) - time_ns
    order = np.lexsort((log.person_id[rows], time_ns))  # stable: of duplicates, the first in the file is first
    repeated = (np.diff(time_ns[order]) == 0) & (np.diff(log.person_id[rows][order]) == 0)
    kept = order[np.append(True, ~repeated)]
    starts = np.flatnonzero(np.append(True, np.diff(time_ns[kept]) > 0))
    frame_ns = time_ns[kept][starts]
    tracker_ns = (log.tracker_time_ms[rows] - YEAR_1_TO_1970_MS) * _MS
    first_rows = rows[kept][starts]
    return _Track(
        sensor=sensor,
        bodies=_bodies(log, rows[kept], T_reference_sensor_of),
        starts=[*starts.tolist(), len(kept)],
        tilt=np.nan_to_num(np.radians(log.tilt_deg[first_rows])).tolist(),
        height=np.nan_to_num(log.height_cm[first_rows] / 100).tolist(),
        time_ns=frame_ns,
        at_ns=frame_ns + (tracker_ns - time_ns).min(),
        duplicates_dropped=len(rows) - len(kept),
        sorted=int((back_ns[kept] > 0).sum()),
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


def _check_times_and_people(log: StudyLog, rows: NDArray[np.intp]) -> None:
    ticks, tracker_ms = log.skeleton_time_ticks[rows], log.tracker_time_ms[rows]
    no_time = _is_beyond(ticks, 0, _LIMIT_NS // TICK_NS)
    refuse(log, rows[no_time], "skeleton_time_ticks", "is no time of a sensor", "it counts 100 ns, from any zero")
    no_date = _is_beyond(tracker_ms, YEAR_1_TO_1970_MS, _LIMIT_NS // _MS)
    refuse(log, rows[no_date], "tracker_time_ms", "is no date of our time", "it counts milliseconds since year 1")
    nobody = log.person_id[rows] < 0
    refuse(log, rows[nobody], "person_id", "is no person", "number the people of a file from 0")
    split = "a file is one run of the sensors: split it where the time begins anew"
    ahead = ticks - ticks[0] > MAX_LENGTH * NS_PER_S / TICK_NS
    refuse(log, rows[ahead], "skeleton_time_ticks", "is more than a day after the sensor's first row", split)
    back = np.maximum.accumulate(ticks) - ticks > MAX_STEP_BACK * NS_PER_S / TICK_NS
    refuse(log, rows[back], "skeleton_time_ticks", f"time goes back by more than {MAX_STEP_BACK} s", split)


def _is_beyond(values: NDArray[np.int64], centre: int, by: int) -> NDArray[np.bool_]:
    """Whether a value is farther from the centre than that; no difference, which could overflow."""
    return (values < centre - by) | (values > centre + by)
