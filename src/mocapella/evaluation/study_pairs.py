"""Pairs of rows of the study logs: the two sensors' views of one person in one result of the thesis' tracker.

A pair is two views of one person at nearly one time, whose distance scores an alignment of the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.observations import Arrival
from mocapella.model.session import SCENARIOS
from mocapella.model.study_log import TICK_NS, StudyLog
from mocapella.recording.study_log import read_study_log
from mocapella.sources.study_replay import StudyReplay
from mocapella.sources.study_sensors import STUDY_SENSORS, sensor_names

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

PLACEMENT_NAMES: Final = {"parallel": "parallel", "right-45": "45", "left-45": "45", "right-90": "90", "left-90": "90"}
"""Name of a placement in the thesis' tables, by its name in the log."""
TASKS: Final = {number: name for name, number in SCENARIOS.items()}


class Pairs(msgspec.Struct, frozen=True, eq=False):
    """Pairs of rows with the same person, task and Tracker_Time, in the order of Tracker_Time.

    Attributes:
        rows: (pairs, 2) indices of the rows in the file.
        person: (pairs,) Person_Id.
        task: (pairs,) Scenario_Id.
    """

    rows: Int64
    person: Int64
    task: Int64

    def __len__(self) -> int:
        return len(self.rows)

    def where(self, mask: Bool) -> Pairs:
        """Return the pairs that ``mask`` (pairs,) selects."""
        return Pairs(self.rows[mask], self.person[mask], self.task[mask])


class StudyFrames(msgspec.Struct, frozen=True, eq=False):
    """Frames of a file in the order of their arrival, with the frame of each row.

    Attributes:
        arrivals: (arrivals,) the frames.
        of_row: (rows,) index of the arrival that contains the row's view; −1 if none does.
    """

    arrivals: tuple[Arrival, ...]
    of_row: Int64


class StudySession:
    """One study log: one participant with one placement of the sensors.

    Args:
        log: the file as read; unchanged.
        by_angle: whether sensors, any number, are placed by their logged angles, as in `StudyReplay`.

    Attributes:
        log: the file's rows, with `corrected_tasks`.
        replay: the sensors' frames, reconstructed from the log.
        participant: Study_Id.
        placement: name of the sensors' placement, as in the thesis' tables.
        pairs: all pairs of rows; of more than two sensors, the pairs of each two.
        frames: all frames of the replay.
        raw: (rows, joints, 3) each row's view in its own sensor's camera space [m].
        sensor: (rows,) index in ``replay.sensors``.
        at_s: (rows,) capture time of the row's frame, from the file's first frame [s].

    Raises:
        InputError: the file has several participants, or its frames cannot be reconstructed.
    """

    def __init__(self, log: StudyLog, *, by_angle: bool = False) -> None:
        self.log = msgspec.structs.replace(log, scenario_id=corrected_tasks(log))
        self.replay = StudyReplay(self.log, by_angle=by_angle)
        self.participant = int(log.study_id[0])
        if (log.study_id != self.participant).any():
            raise InputError("the file has several participants", file=log.source, field="Study_Id", fix="split it")
        self.placement = PLACEMENT_NAMES.get(self.replay.placement, self.replay.placement)
        self.pairs = pairs_of(self.log) if len(self.replay.sensors) < 3 else pairs_of_each_two(self.log)
        self._sensor_names = sensor_names(self.log, np.arange(len(log)), STUDY_SENSORS, None)
        self.frames = self._frames(tuple(self.replay.arrivals()))
        arrivals = self.frames.arrivals
        names = [arrivals[k].frame.sensor for k in self.frames.of_row]
        self.sensor = np.array([self.replay.sensors.index(name) for name in names])
        at_ns = np.array([arrival.at_ns for arrival in arrivals])
        self.at_s = ((at_ns - at_ns[0]) / 1e9)[self.frames.of_row]
        self.raw = np.stack([self._raw(row) for row in range(len(log))])

    @property
    def name(self) -> str:
        """The file's name without its folder."""
        return Path(self.log.source).name

    @cached_property
    def two_people(self) -> bool:
        """Whether the file has two people."""
        return len(np.unique(self.pairs.person)) > 1

    def only(self, task: int) -> StudyFrames:
        """Return the frames of one task, as if it were the whole file."""
        wanted = sorted(set(self.frames.of_row[self.log.scenario_id == task].tolist()))
        return self._frames(tuple(self.frames.arrivals[k] for k in wanted))

    def _frames(self, arrivals: tuple[Arrival, ...]) -> StudyFrames:
        place = {(arrival.frame.sensor, arrival.frame.time_ns): k for k, arrival in enumerate(arrivals)}
        times = (self.log.skeleton_time_ticks * TICK_NS).tolist()
        names = [self._sensor_names[kinect] for kinect in self.log.kinect_id.tolist()]
        return StudyFrames(arrivals, np.array([place.get(key, -1) for key in zip(names, times, strict=True)]))

    def _raw(self, row: int) -> Float64:
        frame = self.frames.arrivals[self.frames.of_row[row]].frame
        body = frame.tracking_ids.tolist().index(int(self.log.person_id[row]))
        return np.asarray(frame.positions[body], dtype=np.float64)


def corrected_tasks(log: StudyLog) -> Int64:
    """Return the Scenario_Id (rows,) without a logging error: after the first 8 (``around-second``), a 4 means 8."""
    after = np.maximum.accumulate(log.scenario_id == SCENARIOS["around-second"])
    return np.where(after & (log.scenario_id == SCENARIOS["around-first"]), SCENARIOS["around-second"], log.scenario_id)


def pairs_of(log: StudyLog) -> Pairs:
    """Pair the first two rows of each (task, Tracker_Time, person); rows without a partner are left out."""
    keys = np.stack([log.tracker_time_ms, log.scenario_id, log.person_id], axis=1)
    _, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse.reshape(-1), kind="stable")
    starts = (np.cumsum(counts) - counts)[counts >= 2]
    rows = np.stack([order[starts], order[starts + 1]], axis=1)
    return Pairs(rows, log.person_id[rows[:, 0]], log.scenario_id[rows[:, 0]])


def pairs_of_each_two(log: StudyLog) -> Pairs:
    """Pair the rows of each two sensors, as `pairs_of` does; one pair of sensors after the other."""
    found = []
    for two in combinations(dict.fromkeys(log.kinect_id.tolist()), 2):
        rows = np.flatnonzero(np.isin(log.kinect_id, two))
        names = [name for name in StudyLog.__struct_fields__ if name != "source"]
        pairs = pairs_of(StudyLog(log.source, **{name: getattr(log, name)[rows] for name in names}))
        distinct = log.kinect_id[rows[pairs.rows[:, 0]]] != log.kinect_id[rows[pairs.rows[:, 1]]]
        found.append(Pairs(rows[pairs.rows], pairs.person, pairs.task).where(distinct))
    return Pairs(*(np.concatenate([getattr(one, name) for one in found]) for name in Pairs.__struct_fields__))


def study_sessions(
    folder: Path, participants: Collection[int] | None = None, on_file: Callable[[str], None] = lambda name: None
) -> Iterator[StudySession]:
    """Read the sessions of a folder's study logs; arguments, order and errors are those of `study_logs`."""
    return map(StudySession, study_logs(folder, participants, on_file))


def study_logs(
    folder: Path, participants: Collection[int] | None = None, on_file: Callable[[str], None] = lambda name: None
) -> Iterator[StudyLog]:
    """Read the study logs of a folder, by participant and name; files with only a header are skipped.

    Args:
        folder: with ``Study_*.csv`` or ``.csv.gz``.
        participants: numbers of the participants; None for all.
        on_file: called with the name of each file before it is read.

    Raises:
        InputError: no such folder, no log in it, or one that cannot be read.
        SettingsError: a participant without a file; lists the participants.
    """
    files = study_files(folder)
    wanted = set(files) if participants is None else set(participants)
    for unknown in sorted(wanted - set(files)):
        known = one_of(str(unknown), map(str, sorted(files)))
        raise SettingsError(f"{folder} has no participant {unknown}; it has {known}")
    for path in (path for participant in sorted(wanted) for path in files[participant]):
        on_file(path.name)
        try:
            log = read_study_log(path)
        except InputError as error:
            if "header and no rows" in error.problem:
                continue
            raise
        yield log


def study_files(folder: Path) -> dict[int, list[Path]]:
    """Return the study logs of a folder by participant, from their names.

    Raises:
        InputError: no such folder, or no log in it.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder, fix="name the folder of the study's .csv.gz files")
    found: dict[int, list[Path]] = {}
    for path in sorted((*folder.glob("Study_*.csv"), *folder.glob("Study_*.csv.gz"))):
        number = path.name.split("_")[1]
        if number.isdigit():
            found.setdefault(int(number), []).append(path)
    if not found:
        fix = "they are called Study_P_Kinect_C_….csv or .csv.gz, P the participant and C the placement"
        raise InputError("has no study logs", file=folder, fix=fix)
    return found
