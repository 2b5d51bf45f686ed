"""All files with trajectories, by suffix."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.trajectories import Trajectories
from mocapella.recording.bodies_trajectories import read_bodies
from mocapella.recording.bvh_file import read_bvh_joints
from mocapella.recording.c3d_file import read_c3d
from mocapella.recording.disk import SUFFIX, TAKES
from mocapella.recording.keypoint_csv import read_csv_keypoints
from mocapella.recording.take_reader import Take, read_take
from mocapella.recording.take_trajectories import take_trajectories
from mocapella.recording.trc_file import METRES, read_trc

UNITS: Final = {**METRES, "in": 0.0254}
"""Length of the units that a BVH may be in [m]."""
_BVH: Final = ".bvh"
READERS: Final[Mapping[str, Callable[[Path], Trajectories]]] = {
    ".trc": read_trc,
    ".c3d": read_c3d,
    ".json": read_bodies,
    _BVH: read_bvh_joints,
    ".csv": read_csv_keypoints,
    ".csv.gz": read_csv_keypoints,
}
"""Readers of files with trajectories of one kind."""


def open_trajectories(path: Path, unit: str | None = None) -> tuple[Path, Take | Trajectories]:
    """Open a take, or read a file of `READERS`.

    Args:
        path: the file; the suffix of a take may be left out, and the folder ``takes``.
        unit: unit of a BVH, of `UNITS`; None for centimetres.

    Returns:
        The file's path, and the take, whose damaged entries are skipped, or the file's trajectories.

    Raises:
        InputError: the file is missing, damaged, or of another type; names the types.
        SettingsError: the unit is unknown, or the file is no BVH.
        SchemaVersionError: the take was made with another message schema.
    """
    name = path.name.lower()
    suffix = next((one for one in READERS if name.endswith(one)), path.suffix.lower())
    if unit is not None and unit not in UNITS:
        raise SettingsError(f"unit {unit!r}: known: {one_of(unit, UNITS)}")
    if unit is not None and suffix != _BVH:
        raise SettingsError(f"unit {unit!r}: {path.name} is no BVH, and states its unit itself; leave the unit out")
    if suffix in READERS:
        read = READERS[suffix] if unit is None else partial(read_bvh_joints, unit_m=UNITS[unit])
        return path, read(path)
    if suffix != SUFFIX and path.is_file():
        known = ", ".join((SUFFIX, *READERS))
        raise InputError("is no recording that can be loaded", file=path, fix=f"give a file that ends with {known}")
    path = _take_at(path)
    take = read_take(path)
    take.skips = True
    return path, take


def _take_at(path: Path) -> Path:
    """Return a take's path; its suffix may be left out, and a name without a folder may be in the folder of takes."""
    names = [path] if path.suffix.lower() == SUFFIX else [path.with_name(path.name + SUFFIX)]
    names += [TAKES / name for name in names] if path.parent == Path() else []
    found = next((name for name in names if name.is_file()), None)
    if found is None and path.is_dir():
        raise InputError(
            "is a folder", file=path, fix="name a file in it; `mocapella triangulate` takes folders of keypoint files"
        )
    if found is None:
        fix = f"name a file that is there, such as {names[0].name}"
        raise InputError("there is no such file", file=path, fix=fix)
    return found


class FoundTrajectories(NamedTuple):
    """The trajectories of a file by kind, its faults, a line each, and whether it is damaged or cut off."""

    path: Path
    found: Mapping[str, Trajectories]
    problems: tuple[str, ...]
    damaged: bool


def trajectories_in(path: Path, unit: str | None = None) -> FoundTrajectories:
    """Return all trajectories of a take or file; arguments and errors as in `open_trajectories`."""
    file, found = open_trajectories(path, unit)
    if isinstance(found, Trajectories):
        return FoundTrajectories(file, {found.kind: found}, found.notes, found.cut_off)
    return FoundTrajectories(file, take_trajectories(found), tuple(found.problems), found.damaged)
