"""Write tracked people to the files of all exports, with the names of the detector's keypoints where it matters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.exports.export import EXPORTS, TRAJECTORIES, Export
from mocapella.exports.new_file import new_file
from mocapella.exports.trc_file import T_OPENSIM_WORLD
from mocapella.library.keypoint_tracking import wrong_up
from mocapella.model.resampling import resampled
from mocapella.model.topology import Topology, topology
from mocapella.model.trajectories import Trajectories
from mocapella.registry import load

T = TypeVar("T", bound=Trajectories)

POINTS: Final = ("trc", "c3d", "csv", "csv-wide", "parquet", "npz", "netcdf")
"""Exports of points, which get the names and the order of the detector's keypoints; others need the skeleton's."""
TABLES: Final = ("csv", "csv-wide", "parquet", "npz", "netcdf")
"""Exports of points that state which are inferred; they also get the skeleton's other joints, such as the head."""


def export_of(path: Path) -> Export:
    """Return the export that writes files with this ending.

    Raises:
        SettingsError: there is none; lists the endings.
    """
    able = {
        one.suffix: one for one in EXPORTS.values() if one.command == TRAJECTORIES and "people" in (one.parts or ())
    }
    fitting = [suffix for suffix in able if path.name.lower().endswith(suffix)]
    if not fitting:
        raise SettingsError(f"--out {path}: end its name with one of {one_of(path.suffix, able)}, or .mcap for a take")
    return able[max(fitting, key=len)]


def save_people(people: Trajectories, path: Path, *, own: Topology | None = None, rate_hz: float | None = None) -> list[
    Path
]:  # fmt: skip
    """Write people to a file, or to a file for each if the format has one individual; existing files are replaced.

    Args:
        people: the people.
        path: the file; its ending tells the format. Several files are called ``NAME.person_0.trc``, ….
        own: topology of the detector's keypoints, whose names and order files of points get; None for the skeleton's.
        rate_hz: frame rate of formats with a constant rate [Hz]; None for that of the fastest camera.

    Returns:
        The files.

    Raises:
        SettingsError: the ending is unknown, or the file cannot be written.
    """
    export = export_of(path)
    if own is not None and export.name in POINTS:
        people = with_names_of(people, own, others=export.name in TABLES)
    write: Callable[..., object] = load(export.write)
    made = []
    for file, some in _planned(people, path, export):
        one = resampled(some, rate_hz) if export.constant_rate else some
        if export.space == "opensim":
            one = one.moved(T_OPENSIM_WORLD)
        with new_file(file, force=True) as part:
            write(one, part)
        made.append(file)
    return made


def with_names_of(people: T, own: Topology, *, others: bool = False) -> T:
    """Return people of `halpe_26` with the keypoints of a detector's topology, in its order, as far as these have some.

    Args:
        people: the people; with other keypoints they are returned unchanged.
        own: the detector's topology.
        others: whether to add the joints that the detector lacks, with Halpe's names, after its keypoints.
    """
    halpe = topology("halpe_26")
    if people.keypoints != halpe.joints or own is halpe:
        return people
    places = {source: joint for joint, source in own.single_joints(halpe.name).items()}
    kept = sorted(places)
    columns = [places[joint] for joint in kept]
    if not kept:
        return people
    index = {joint: i for i, joint in enumerate(kept)}
    names = [own.joints[joint] for joint in kept]
    if others:
        more = [i for i, name in enumerate(halpe.joints) if i not in columns and name not in names]
        columns, names = [*columns, *more], [*names, *(halpe.joints[i] for i in more)]
    bones = tuple((index[a], index[b]) for a, b in own.bones if a in index and b in index)
    return replace(
        people, keypoints=tuple(names), positions=people.positions[:, :, columns],
        states=people.states[:, :, columns], sd=people.sd[:, :, columns], bones=bones,
    )  # fmt: skip


def up_problem(people: Trajectories) -> str:
    """Return a sentence if people do not stand along the world's y axis, with the remedy; empty if they do."""
    names = {name: i for i, name in enumerate(people.keypoints)}
    if not {"Neck", "LAnkle", "RAnkle"} <= names.keys():
        return ""
    neck = people.positions[:, :, names["Neck"]]
    feet = (people.positions[:, :, names["LAnkle"]] + people.positions[:, :, names["RAnkle"]]) / 2
    heights = (neck - feet).reshape(-1, 3)
    heights = heights[np.isfinite(heights).all(axis=-1)]
    if not len(heights):
        return ""
    return wrong_up(heights.mean(axis=0))


def _planned(people: Trajectories, path: Path, export: Export) -> Iterator[tuple[Path, Trajectories]]:
    if not export.alone or len(people.individuals) == 1:
        yield path, people
        return
    base = path.name[: -len(export.suffix)]
    for name in people.individuals:
        yield path.with_name(f"{base}.{name}{export.suffix}"), people.of(name)
