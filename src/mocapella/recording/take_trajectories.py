"""Trajectories of a take: the tracker's results over all its runs, with the labels of each run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from mocapella.errors import WireError
from mocapella.model.scene import Scene
from mocapella.model.trajectories import PARTS, VIEWS, Trajectories, trajectories_of
from mocapella.recording.take_reader import Take
from mocapella.schema.people_columns import PeopleColumns


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
    return {
        run.number: {
            "participant": run.info.setup.participant,
            "placement": run.info.setup.placement,
            "scenario": run.info.setup.scenario,
            "method": run.info.method,
        }
        for run in take.runs
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
        found = trajectories_of(timed_scenes(take), kinds, sensor=sensor)
    return {kind: replace(some, labels=labels) for kind, some in found.items()}


def _people_alone(take: Take, kinds: Sequence[str]) -> dict[str, Trajectories] | None:
    """Return the people of a take, in the faster way; None if it has other parts, or an entry is invalid."""
    if "people" not in kinds or not (take.part_counts.keys() & set(kinds)) <= {"people"} or VIEWS in kinds:
        return None
    columns = PeopleColumns()
    try:
        for run in take.runs:
            wall_ns = run.info.started_unix_ns - run.info.started_ns
            for data in take.scene_bytes(run.number):
                columns.add(run.number, wall_ns, data)
        people = columns.trajectories()
    except WireError:  # the other way names the invalid entry, or leaves it out
        return None
    return {} if people is None else {"people": people}
