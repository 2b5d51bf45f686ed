"""The skeletons of a study log as trajectories: each sensor's views of people, with labels that change in the log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.model.session import PLACEMENTS, SCENARIOS
from mocapella.model.study_log import TICK_NS, YEAR_1_TO_1970_MS, StudyLog
from mocapella.model.topology import topology
from mocapella.model.trajectories import VIEWS, Block, TimeAxis, Trajectories, assembled
from mocapella.recording.study_log import read_study_log
from mocapella.sources.study_replay import check_times_and_people
from mocapella.sources.study_sensors import STUDY_SENSORS, sensor_name

SPACE: Final = "positions are in the camera space of the reference sensor: a study log has no world and no fused people"
_MS: Final = 1_000_000


def read_study_views(path: Path) -> Trajectories:
    """Read a study log as `study_views`.

    Raises:
        InputError: the file cannot be read, is no study log, or states impossible times; names row, field and value.
        SettingsError: a sensor's name cannot be used.
    """
    return study_views(read_study_log(path))


def study_views(log: StudyLog) -> Trajectories:
    """Return the skeletons of a study log as trajectories of the kind ``views``, such as ``person_0@front``.

    Positions are in the camera space of the reference sensor [m], as in the file. The sensors' clocks
    are brought to that of ``Tracker_Time`` by their least difference, as in `StudyReplay`. Each combination of
    participant, placement and scenario is a run, numbered in their order; individuals keep their names in all runs. Of
    rows that repeat a view, the first counts.

    Raises:
        InputError: times or ids are impossible; names row, field and value.
        SettingsError: a sensor's name cannot be used.
    """
    at_ns = _times(log)
    order = np.lexsort((np.arange(len(log)), at_ns))
    _, first = np.unique(_keys(log, at_ns)[order], axis=0, return_index=True)
    rows = order[np.sort(first)]
    sensors = [sensor_name(kinect, STUDY_SENSORS) for kinect in log.kinect_id[rows].tolist()]
    by_sensor = {(0, name): at_ns[rows][np.array(sensors) == name].tolist() for name in dict.fromkeys(sensors)}
    axis = TimeAxis.of([(0, at) for at in at_ns[rows].tolist()], by_sensor)
    found = assembled(VIEWS, _blocks(log, rows, np.array(sensors)), axis)
    assert found is not None  # a log has rows
    triples = np.stack([log.study_id, log.kinect_config, log.scenario_id], axis=1)[rows]
    known, begins, of_row = np.unique(triples, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(begins))
    runs = np.empty(len(found), dtype=np.int64)
    runs[axis.frame_of[::-1]] = rank[of_row.reshape(-1)][::-1]  # of rows of one time, the first counts
    labels = {int(rank[k]): _labels(*triple) for k, triple in enumerate(known.tolist())}
    return replace(found, runs=runs, labels=labels, notes=(SPACE,))


def _keys(log: StudyLog, at_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """(rows, 3) time, person and sensor of each row."""
    _, kinects = np.unique(log.kinect_id, return_inverse=True)
    return np.stack([at_ns, log.person_id, kinects], axis=1)


def _times(log: StudyLog) -> NDArray[np.int64]:
    """Return the capture time of each row since 1970 [ns]."""
    at_ns = np.empty(len(log), dtype=np.int64)
    for kinect in np.unique(log.kinect_id):
        rows = np.flatnonzero(log.kinect_id == kinect)
        check_times_and_people(log, rows)
        time_ns = log.skeleton_time_ticks[rows] * TICK_NS
        tracker_ns = (log.tracker_time_ms[rows] - YEAR_1_TO_1970_MS) * _MS
        at_ns[rows] = time_ns + (tracker_ns - time_ns).min()
    return at_ns


def _blocks(log: StudyLog, rows: NDArray[np.intp], sensors: NDArray[np.str_]) -> Iterator[Block]:
    kind = topology("kinect_v2")
    people = log.person_id[rows]
    for name in dict.fromkeys(zip(people.tolist(), sensors.tolist(), strict=True)):
        own = np.flatnonzero((people == name[0]) & (sensors == name[1]))
        positions = log.positions[rows[own]].astype(np.float64)
        seen = np.isfinite(positions).all(axis=2)
        states = np.where(seen, JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8)
        yield Block(0, f"person_{name[0]}@{name[1]}", own, (kind.joints, kind.bones, ()), positions, states)


def _labels(participant: int, placement: int, scenario: int) -> dict[str, Any]:
    names = ({number: name for name, number in known.items()} for known in (PLACEMENTS, SCENARIOS))
    placements, scenarios = names
    return {
        "participant": participant,
        "placement": placements.get(placement, ""),
        "scenario": scenarios.get(scenario, ""),
    }
