"""The 87 columns of the study log, and their titles in the three known headers."""

from __future__ import annotations

import re
from typing import Final

from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.names import as_cell
from mocapella.model.study_log import TITLES
from mocapella.model.topology import topology

TOPOLOGY: Final = topology("kinect_v2")
JOINTS: Final = tuple(sorted(TOPOLOGY.joints))
"""Names of the Kinect v2's joints in the order of the columns, which is alphabetical and not the topology's."""
JOINT_PLACES: Final = tuple(TOPOLOGY.index(joint) for joint in JOINTS)
"""Index of each joint of `JOINTS` in the topology, and thus on the joint axis of arrays."""

FLOATS: Final = ("init_angle", "init_dist", "tilt_deg", "height_cm")
"""Fields of `StudyRow` that are floats."""
INTEGERS: Final = {name: TITLES[name] for name in TITLES if name not in (*FLOATS, "kinect_id")}
"""Fields of `StudyRow` that are integers, and their columns' titles."""
KINECT: Final = TITLES["kinect_id"]
POSITIONS: Final = tuple(f"{joint}_{axis}" for joint in JOINTS for axis in "XYZ")
HEADER: Final = (*TITLES.values(), *POSITIONS)
"""Titles of the 87 columns, in the order of written files."""
MAX_KINECT_LENGTH: Final = 64

_OPTIONAL = ("Study_Id", "Kinect_Config")
_OTHER_NAMES = {
    "study": "Study_Id",
    "scenario": "Scenario_Id",
    "person": "Person_Id",
    "skeleton": "Skeleton_Id",
    "kinect": KINECT,
}


def _plain(title: str) -> str:
    return re.sub(r"[\s_#]", "", title).casefold()


_TITLES = {_plain(title): title for title in HEADER} | _OTHER_NAMES


def layout(cells: list[str], file: str) -> dict[str, int]:
    """Map each column's title in `HEADER` to its index in a file's rows.

    Args:
        cells: the file's header.
        file: the file's name, for errors.

    Raises:
        InputError: a column is unknown, repeated, or missing.
    """
    if len(cells) == 1:
        raise InputError(
            "the header has one column; a study log has 87 that are separated by commas",
            file=file,
            row=1,
            value=cells[0],
        )
    places: dict[str, int] = {}
    for place, cell in enumerate(cells):
        title = _TITLES.get(_plain(cell))
        if title is None:
            raise InputError(
                f"column {place + 1} is unknown", file=file, row=1, value=cell, fix=f"columns are {_some(cell)}"
            )
        if title in places:
            raise InputError(
                f"columns {places[title] + 1} and {place + 1} are the same",
                file=file,
                row=1,
                field=title,
                value=cell,
                fix="remove one of them",
            )
        places[title] = place
    missing = [title for title in HEADER if title not in places and title not in _OPTIONAL]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f"this column{more} is missing from the header",
            file=file,
            row=1,
            field=missing[0],
            fix="export the log again with all of its columns",
        )
    return places


def _some(cell: str) -> str:
    """Return the known titles, shortened to one line, and the closest one."""
    listed, _, close = one_of(cell, HEADER).partition(" (did you mean")
    return ", ".join(listed.split(", ")[:13]) + ", …" + (f" (did you mean{close}" if close else "")


def kinect_problem(kinect: str) -> str:
    """Return the reason why a Kinect's id cannot be a cell of the log; empty if it can."""
    if not kinect:
        return "the Kinect's id is empty"
    if len(kinect) > MAX_KINECT_LENGTH:
        return f"the Kinect's id is longer than {MAX_KINECT_LENGTH} characters"
    if not (kinect.isascii() and kinect.isprintable()) or kinect != kinect.strip() or set(kinect) & set(',"'):
        return "a Kinect's id has ASCII characters only, no comma, no quotation mark, and no space at its ends"
    return ""


def kinect_cell(kinect: str) -> str:
    """Return a Kinect's id as a cell of the log, with an apostrophe before ``=+-@``, which begin spreadsheet formulas.

    Raises:
        SettingsError: the id cannot be a cell; names the reason.
    """
    problem = kinect_problem(kinect)
    if problem:
        raise SettingsError(f"{problem}: {kinect!r}; take the sensor's name or address")
    return as_cell(kinect)
