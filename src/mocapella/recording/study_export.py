"""Export scenes as a study log: a row for each view of each person, in the reference sensor's camera space."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import RecordingError, SettingsError, one_of
from mocapella.geometry import rigid
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene
from mocapella.model.session import PLACEMENTS, SCENARIOS, Setup
from mocapella.model.study_log import TICK_NS, StudyRow
from mocapella.model.topology import Topology
from mocapella.recording.study_columns import TOPOLOGY
from mocapella.recording.study_log import write_study_log
from mocapella.settings import check


class ExportReport(msgspec.Struct, frozen=True):
    """Counts of an export.

    Attributes:
        results: number of scenes in the phase *tracking* with people.
        written: number of these scenes that were written, every n-th.
        rows: number of rows in the file.
        without_reference: number of people, summed over the written scenes, without a view of the reference sensor;
            their rows are in the camera space of their first view.
        mirrored: number of rows whose view has left and right swapped, according to the tracking method; they keep
            the sensor's labels.
        not_tracking: number of scenes with people in another phase, such as *calibrating*, which are left out.
    """

    results: int
    written: int
    rows: int
    without_reference: int
    mirrored: int
    not_tracking: int = 0


def rows_of(
    scene: Scene,
    *,
    setup: Setup,
    reference: str | None,
    tracker_time_ms: int,
    kinect_ids: Mapping[str, str] | None = None,
    fixed: bool = False,
) -> list[StudyRow]:
    """Return the study log's rows of one scene: every view of every person, in the camera space of the reference view.

    The reference view has ``skeleton_id`` 0: the view of the sensor ``reference``, or else the person's first. Joints
    without a column are left out; columns without a joint of the topology are missing values.

    Args:
        scene: the tracker's result.
        setup: gives participant, placement and scenario.
        reference: name of the reference sensor, or None for each person's first view.
        tracker_time_ms: wall clock at the result, since the start of the year 1 [ms].
        kinect_ids: the log's ``kinect_id`` by the sensor's name; the name itself for other sensors or if None.
        fixed: whether all rows are in the reference sensor's space where its pose is known, also of people whom it does
            not see; their ``skeleton_id`` begins at 1.

    Source:
        the thesis' equations 7 and 8: T = R(θ)(p − C), and back with the reference sensor's θ and C.
    """
    rows = []
    for person in scene.people:
        views = reference_first(person, reference)
        T_world_reference = _fixed_pose(scene, views, reference) if fixed else None
        first = 0 if T_world_reference is None else 1
        T_reference_world = rigid.inverse(views[0].T_world_sensor if T_world_reference is None else T_world_reference)
        for skeleton_id, view in enumerate(views, first):
            positions = rigid.apply(T_reference_world, view.positions)
            init_angle, init_dist = stand_still_of(view.T_world_sensor)
            rows.append(
                StudyRow(
                    study_id=setup.participant,
                    kinect_config=PLACEMENTS.get(setup.placement, NOT_AVAILABLE),
                    scenario_id=SCENARIOS.get(setup.scenario, NOT_AVAILABLE),
                    tracker_time_ms=tracker_time_ms,
                    person_id=person.id,
                    skeleton_id=skeleton_id,
                    skeleton_time_ticks=view.time_ns // TICK_NS,
                    init_angle=init_angle,
                    init_dist=init_dist,
                    kinect_id=(kinect_ids or {}).get(view.sensor, view.sensor),
                    tilt_deg=round(float(np.degrees(view.tilt)), 6),
                    height_cm=round(100 * view.height, 6) if view.height else np.nan,
                    positions=as_logged(positions, scene.topology),
                )
            )
    return rows


def _fixed_pose(scene: Scene, views: Sequence[PotentialSkeleton], reference: str | None) -> NDArray[np.float64] | None:
    """Return the pose of the reference sensor where it does not see a person; else None, or if it is unknown."""
    if any(view.sensor == reference for view in views):
        return None
    return next((place.T_world_sensor for place in scene.sensors if place.sensor == reference), None)


def stand_still_of(T_world_sensor: NDArray[np.float64]) -> tuple[float, float]:
    """Return a sensor's pose as in the thesis, T = R(θ)(p − C): the angle θ [rad] and the z of C [m].

    Args:
        T_world_sensor: (4, 4). C is the world's origin in camera space. For a tilted sensor, θ is the direction of its
            x axis seen from above.
    """
    C = rigid.inverse(T_world_sensor)[:3, 3]
    return float(np.arctan2(T_world_sensor[0, 2], T_world_sensor[0, 0])), float(C[2])


def export_study_log(
    scenes: Iterable[tuple[Setup, Scene, int]],
    path: Path | str,
    *,
    reference: str | None = None,
    every: int = 1,
    kinect_ids: Mapping[str, str] | None = None,
    write: Callable[[Path | str, Iterable[StudyRow]], int] = write_study_log,
) -> ExportReport:
    """Write a study log of every n-th result, starting with the first; a result is a scene with tracked people.

    The file appears complete or not at all.

    Args:
        scenes: scenes, each with its run's ``setup`` and its ``tracker_time_ms`` as in `rows_of`; scenes that are no
            results are skipped.
        path: path of the new file, ``.csv`` or ``.csv.gz`` as text.
        reference, kinect_ids: as in `rows_of`.
        every: n; the thesis logs every other result.
        write: writes the rows to the path and returns their number; by default as text.

    Raises:
        SettingsError: ``every`` is below 1, a Kinect's id cannot be a cell of the log, or no written result has a view
            of ``reference``; lists the sensors.
        RecordingError: no scene is a result.
        TakeExistsError, DiskFullError, RecordingError: as in `mocapella.recording.study_log.write_study_log`.
    """
    check(every >= 1, "every", every, "1 or more")
    log = _Counting(reference, every, dict(kinect_ids or {}))
    rows = write(path, log.rows(scenes, path))
    return ExportReport(log.results, log.written, rows, log.without_reference, log.mirrored, log.not_tracking)


class _Counting:
    """Converts scenes to rows and counts them, holding one scene at a time."""

    def __init__(self, reference: str | None, every: int, kinect_ids: dict[str, str]) -> None:
        self._options: dict[str, Any] = {"reference": reference, "kinect_ids": kinect_ids}
        self._reference, self._every = reference, every
        self._sensors: set[str] = set()
        self._arms = False
        self.results = self.written = self.without_reference = self.mirrored = self.not_tracking = 0

    def rows(self, scenes: Iterable[tuple[Setup, Scene, int]], path: Path | str) -> Iterator[StudyRow]:
        for setup, scene, tracker_time_ms in scenes:
            self._arms |= bool(scene.arms)
            if scene.state.phase != Phase.TRACKING or not scene.people:
                self.not_tracking += bool(scene.people)
                continue
            self.results += 1
            if (self.results - 1) % self._every:
                continue
            self.written += 1
            self._count_views(scene)
            yield from rows_of(scene, setup=setup, tracker_time_ms=tracker_time_ms, **self._options)
        self._check(path)

    def _count_views(self, scene: Scene) -> None:
        for person in scene.people:
            seen_by = {view.sensor for view in person.views}
            self._sensors |= seen_by
            self.without_reference += self._reference is not None and self._reference not in seen_by
            self.mirrored += sum(view.mirrored for view in person.views)

    def _check(self, path: Path | str) -> None:
        if not self.results:
            fix = (
                "mocapella export arms writes the arms that are in it"
                if self._arms
                else "export scenes that were tracking people"
            )
            raise RecordingError(f"cannot write {path}: no scene is a result; {fix}")
        if self._reference is not None and self._reference not in self._sensors:
            known = one_of(self._reference, sorted(self._sensors))
            raise SettingsError(f"no result has a view of the reference sensor {self._reference!r}; there are {known}")


def reference_first(person: Person, reference: str | None) -> tuple[PotentialSkeleton, ...]:
    """Return a person's views, that of the sensor ``reference`` first, if there is one."""
    first = None if reference is None else person.view_of(reference)
    return person.views if first is None else (first, *(view for view in person.views if view is not first))


def as_logged(positions: NDArray[np.float64], topology: Topology) -> NDArray[np.float32]:
    """Return (joints, 3) of any topology as the log's (25, 3) float32, by the joints' names."""
    if topology.joints == TOPOLOGY.joints:
        return positions.astype(np.float32)
    logged = np.full((len(TOPOLOGY), 3), np.nan, dtype=np.float32)
    for place, joint in enumerate(topology.joints):
        if joint in TOPOLOGY.joints:
            logged[TOPOLOGY.index(joint)] = positions[place]
    return logged
