"""Trajectories of a take: the tracker's results over all its runs, with the labels of each run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.scene import Scene
from mocapella.model.session import Setup
from mocapella.model.trajectories import PARTS, VIEWS, TimeAxis, Trajectories, assembled, trajectories_of
from mocapella.recording.take import trackers_of
from mocapella.recording.take_reader import Take
from mocapella.recording.take_refs import AT_NS, RUN, SENSOR

COMPILED_FROM_SCENES: Final = 8192
"""Least number of scenes whose people compiled kernels decode; for fewer, loading them takes longer."""


def timed_scenes(take: Take) -> Iterator[tuple[int, int, Scene]]:
    """Yield (run, unix_ns, scene) of all scenes of a take: run number, capture time since 1970 [ns], and the scene.

    Raises:
        InputError, DamagedTakeError: as in `Take.scenes`.
    """
    for run in take.runs:
        wall_ns = run.info.started_unix_ns - run.info.started_ns
        for _, scene in take.scenes(run.number):
            yield run.number, scene.at_ns + wall_ns, scene


def labels_of(take: Take) -> dict[int, dict[str, Any]]:
    """Return participant, placement, scenario and method of each run, by the run's number."""
    return {run.number: labels_of_setup(run.info.setup) for run in take.runs}


def labels_of_setup(setup: Setup) -> dict[str, Any]:
    """Return participant, placement, scenario and method of a setup."""
    return {
        "participant": setup.participant,
        "placement": setup.placement,
        "scenario": setup.scenario,
        "method": setup.method,
    }


def take_trajectories(
    take: Take, kinds: Sequence[str] = tuple(PARTS), *, sensor: str | None = None
) -> dict[str, Trajectories]:
    """Return the trajectories of a take by kind; a kind without any part is left out.

    Args:
        take: the take.
        kinds: as in `trajectories_of`.
        sensor: name of the sensor whose camera space they are in; None for the world.

    Raises:
        SettingsError: as in `trajectories_of`.
        InputError, DamagedTakeError: as in `Take.scenes`.
    """
    labels = labels_of(take)
    found = _people_alone(take, kinds) if sensor is None else None
    if found is None:
        found = trajectories_of(timed_scenes(take), kinds, sensor=sensor, trackers=trackers_of(take.runs))
    return {kind: replace(some, labels=labels) for kind, some in found.items()}


def _people_alone(take: Take, kinds: Sequence[str]) -> dict[str, Trajectories] | None:
    """Return the people of a long take, in the faster way; None for others, and if an entry is unusual or invalid."""
    others = (take.part_counts.keys() & set(kinds)) - {"people"}
    if "people" not in kinds or others or VIEWS in kinds or take.scene_count < COMPILED_FROM_SCENES:
        return None
    from mocapella.schema.people_columns import people_blocks

    table = take.scene_table
    if not np.isin(table[:, RUN], [run.number for run in take.runs]).all():  # a run's description is lost
        return None
    times = np.column_stack([table[:, RUN], table[:, AT_NS]])
    by_sensor: dict[tuple[int, int], NDArray[np.int64]] = {}
    rows = {run.number: np.flatnonzero(table[:, RUN] == run.number) for run in take.runs}
    for run in take.runs:
        own = rows[run.number]
        times[own, 1] += run.info.started_unix_ns - run.info.started_ns
        for sensor in np.unique(table[own, SENSOR]).tolist():
            by_sensor[run.number, sensor] = times[own[table[own, SENSOR] == sensor], 1]
    blocks = (
        block
        for run, own in rows.items()
        for numbers, data, begins, lengths in take.scene_blocks(own)
        for block in people_blocks(run, numbers, data, begins, lengths)
    )
    try:
        people = assembled("people", blocks, TimeAxis.of(times, by_sensor, trackers_of(take.runs)))
    except WireError:  # the other way names the invalid entry, or leaves it out
        return None
    return {} if people is None else {"people": people}
