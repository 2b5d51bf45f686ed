"""The sensors of a study log: their names, and the nominal pose of the second one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.geometry import angles, rigid
from mocapella.model.observations import check_sensor_name
from mocapella.model.session import PLACEMENTS
from mocapella.model.study_log import TITLES, StudyLog

STUDY_SENSORS: Final[Mapping[str, str]] = {".213.82": "front", ".207.136": "side"}
"""Names of the study's sensors of 2015, by the end of their ``Kinect_Id``."""
TURNING_DISTANCE: Final = 2.4
"""Distance from the reference sensor to the vertical axis of the second's rotation, where people stood [m]."""
PARALLEL_DISTANCE: Final = 0.5
"""Distance between two parallel sensors [m]."""

_FIRST_ROWS = 30
"""Rows of a person's first second: the logs begin right after the people stood still."""
_TURNS = {"parallel": 0.0, "right-45": -45.0, "right-90": -90.0, "left-45": 45.0, "left-90": 90.0}


def refuse(log: StudyLog, rows: NDArray[np.intp], name: str, problem: str, fix: str) -> None:
    """Raise an InputError that names the first invalid row; do nothing without invalid rows.

    Args:
        log: the file.
        rows: indices of the invalid rows.
        name: the invalid field of `StudyLog`.
        problem, fix: what is wrong, and the advice, for the error's message.
    """
    if len(rows):
        i = int(rows.min())
        row = i + 2  # an editor counts from 1, and the header is row 1
        value = getattr(log, name)[i].item()
        raise InputError(problem, file=log.source, row=row, field=TITLES[name], value=value, fix=fix)


def rows_of_placement(log: StudyLog, wanted: str | None) -> tuple[NDArray[np.intp], str]:
    """Select the rows of the placement ``wanted``, or of the file's only one.

    A file that states no placement (−9999 in every row) has the wanted one in all rows.

    Returns:
        Indices (k,) of the rows, and the placement's name; empty if the file does not state one and none is wanted.

    Raises:
        SettingsError: there is no such placement; lists the known ones.
        InputError: the file does not have it, has several and none is chosen, or has an invalid number.
    """
    if wanted is not None and wanted not in PLACEMENTS:
        raise SettingsError(f"unknown placement {wanted!r}; known: {one_of(wanted, PLACEMENTS)}")
    placements = {number: name for name, number in PLACEMENTS.items()} | {NOT_AVAILABLE: ""}
    unknown = ~np.isin(log.kinect_config, list(placements))
    listed = ", ".join(f"{number} {name}" for name, number in PLACEMENTS.items())
    refuse(log, np.flatnonzero(unknown), "kinect_config", "is no placement", f"placements are {listed}")
    numbers = np.unique(log.kinect_config).tolist()
    if numbers == [NOT_AVAILABLE]:
        return np.arange(len(log)), wanted or ""
    there = [placements[number] or "not said" for number in numbers]
    if wanted is None and len(numbers) > 1:
        fix = f"choose one with placement: {', '.join(there)}"
        raise InputError("the file has several placements", file=log.source, field="Kinect_Config", fix=fix)
    if wanted is not None and PLACEMENTS[wanted] not in numbers:
        raise InputError(
            "the file does not have this placement",
            file=log.source,
            field="Kinect_Config",
            value=wanted,
            fix=f"it has {', '.join(there)}",
        )
    number = numbers[0] if wanted is None else PLACEMENTS[wanted]
    return np.flatnonzero(log.kinect_config == number), placements[number]


def sensor_names(
    log: StudyLog, rows: NDArray[np.intp], sensors: Mapping[str, str], most: int | None = 2
) -> dict[str, str]:
    """Return the names of the sensors by their ``Kinect_Id``, in the order of appearance in the ``rows`` (k,).

    An id that ends in none of ``sensors`` is itself the name, with ``-`` in place of invalid characters, and
    ``kinect-`` before a bare number.

    Args:
        log: the file.
        rows: (k,) indices of the rows to use.
        sensors: the end of a ``Kinect_Id`` → the sensor's name, such as `STUDY_SENSORS`.
        most: largest number of sensors; None for any.

    Raises:
        InputError: there are more sensors.
        SettingsError: a name is invalid, or shared by two Kinects.
    """
    kinects, first = np.unique(log.kinect_id[rows], return_index=True)
    first = np.sort(first)
    if most is not None and len(kinects) > most:
        fix = "a log does not say where a third sensor stood: replay the take that it was exported from"
        refuse(log, rows[first[2:]], "kinect_id", "is a third sensor, and a replay places two", fix)
    names: dict[str, str] = {}
    for kinect in log.kinect_id[rows[first]].tolist():
        name = sensor_name(kinect, sensors)
        if name in names.values():
            raise SettingsError(f"{log.source}: two Kinects would be the sensor {name!r}; name them apart")
        names[kinect] = name
    return names


def sensor_name(kinect: str, sensors: Mapping[str, str]) -> str:
    """Return the name of a sensor by its ``Kinect_Id``, as in `sensor_names`.

    Raises:
        SettingsError: the name is invalid.
    """
    return check_sensor_name(
        next((name for end, name in sensors.items() if kinect.endswith(end)), None) or _safe_name(kinect)
    )


def _safe_name(kinect: str) -> str:
    safe = re.sub(r"[^A-Za-z0-9_.-]", "-", kinect)
    return safe if safe[0].isalnum() and not safe.isdigit() else f"kinect-{safe.lstrip('-_.')}"[:64]


def reference_kinect(log: StudyLog, rows: NDArray[np.intp], names: dict[str, str]) -> str:
    """Return the Kinect_Id of the reference sensor: all its rows, and no others, have Skeleton_Id 0.

    Args:
        log: the file.
        rows: (k,) indices of the rows to use.
        names: name of each sensor by its Kinect_Id, for errors.

    Raises:
        InputError: there is none, or it changes within the file.
    """
    is_reference = log.skeleton_id[rows] == 0
    if not is_reference.any():
        raise InputError(
            "no row is the reference sensor's own",
            file=log.source,
            field="Skeleton_Id",
            fix="the reference sensor's rows have Skeleton_Id 0",
        )
    reference: str = log.kinect_id[rows[is_reference]][0].item()
    mixed = rows[is_reference != (log.kinect_id[rows] == reference)]
    fix = "the reference must not change within a file: replay the take that it was exported from"
    problem = f"sensor {names[reference]} is the reference (Skeleton_Id 0) in other rows"
    refuse(log, mixed, "skeleton_id", problem, fix)
    return reference


def motions_of_people(
    log: StudyLog, rows: NDArray[np.intp], T_reference_second: NDArray[np.float64]
) -> dict[int, NDArray[np.float64]]:
    """Return ``T_reference_second`` (4, 4) of each person, by Person_Id; the first person's is the argument.

    The thesis calibrated the second sensor separately for each person. The calibrations differ by some degrees, so two
    people's logged rows are not in one frame. The logged angles, and the people's first positions seen by the reference
    sensor, give the motion from another person's frame to the first person's: a rotation about that person's position
    by the difference of the two calibrations, and a translation of that position to where a second sensor with the
    given motion saw it. A person without angles, or never seen by the reference sensor, keeps the given motion.

    Args:
        log: the file.
        rows: (k,) indices of the rows to use.
        T_reference_second: (4, 4) from the second sensor's camera space to the reference's, for the first person.
    """
    turns, places = {}, {}
    for person in np.unique(log.person_id[rows]).tolist():
        of_person = rows[log.person_id[rows] == person]
        of_reference = of_person[log.skeleton_id[of_person] == 0][:_FIRST_ROWS]
        joints = log.positions[of_reference].reshape(-1, 3).astype(np.float64)
        joints = joints[np.isfinite(joints[:, 0])]
        turn = _turn_of_person(log, of_person)
        if turn is not None and len(joints):
            turns[person], places[person] = turn, joints.mean(axis=0)
    motions = dict.fromkeys(np.unique(log.person_id[rows]).tolist(), T_reference_second)
    first, *others = turns or [-1]
    nominal = np.arctan2(T_reference_second[0, 2], T_reference_second[0, 0])
    for person in others:
        turned = rigid.rotation_about_y(turns[first] - turns[person])
        place = places[first] + rigid.rotation_about_y(turns[first] - nominal) @ (places[person] - places[first])
        T_first_person = rigid.rigid(turned, place - turned @ places[person])
        motions[person] = rigid.inverse(T_first_person) @ T_reference_second
    return motions


def nominal_motion(log: StudyLog, rows: NDArray[np.intp], placement: str) -> NDArray[np.float64]:
    """Return the nominal ``T_reference_second`` (4, 4), from the second sensor's camera space to the reference's.

    It is a rotation about the vertical axis where people stood, or a translation for parallel sensors.

    The placement gives the angle, but not its sign, because either sensor can be the reference. The sign is that of θ,
    a standing person's logged angle, in the second sensor minus θ in the reference; if none is logged, right is minus.

    Args:
        log: the file.
        rows: (k,) indices of the rows to use.
        placement: key of `mocapella.model.session.PLACEMENTS`.

    Raises:
        InputError: ``placement`` is empty: the file does not state it.
    """
    if not placement:
        raise InputError(
            "the file does not say how its two sensors stood",
            file=log.source,
            field="Kinect_Config",
            value=NOT_AVAILABLE,
            fix=f"give the placement: {', '.join(PLACEMENTS)}",
        )
    turn = np.radians(_TURNS[placement])
    if turn == 0.0:
        return rigid.rigid(np.eye(3), (PARALLEL_DISTANCE, 0.0, 0.0))
    logged = _logged_turn(log, rows)
    return _about_person(np.copysign(turn, logged) if logged else turn)


def motion_by_angle(log: StudyLog, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return ``T_reference_sensor`` (4, 4) of a sensor by its logged angle alone, as `nominal_motion` by a placement.

    Args:
        log: the file.
        rows: (k,) indices of the rows of the reference sensor and of that sensor.

    Raises:
        InputError: no person has the angles of both.
    """
    turn = _logged_turn(log, rows)
    if turn is None:
        raise InputError(
            "the file does not say how its sensors stood",
            file=log.source,
            field=TITLES["init_angle"],
            value=NOT_AVAILABLE,
            fix="log the stand-still angles of all sensors",
        )
    return _about_person(turn)


def _about_person(turn: float) -> NDArray[np.float64]:
    """Return ``T_reference_sensor`` (4, 4) of a sensor turned [rad] about a person in front of the reference."""
    R, axis = rigid.rotation_about_y(turn), np.array([0.0, 0.0, TURNING_DISTANCE])
    return rigid.rigid(R, axis - R @ axis)


def _logged_turn(log: StudyLog, rows: NDArray[np.intp]) -> float | None:
    """θ of the second sensor minus θ of the reference, of the first person with both angles [rad]; None without any."""
    for person in np.unique(log.person_id[rows]).tolist():
        turn = _turn_of_person(log, rows[log.person_id[rows] == person])
        if turn is not None:
            return turn
    return None


def _turn_of_person(log: StudyLog, rows: NDArray[np.intp]) -> float | None:
    """θ of the second sensor minus θ of the reference in one person's rows [rad]; None if one is not logged."""
    known = rows[np.isfinite(log.init_angle[rows])]
    is_reference = log.skeleton_id[known] == 0
    if is_reference.all() or not is_reference.any():
        return None
    theta = log.init_angle[known]
    return float(angles.wrap(theta[~is_reference][0] - theta[is_reference][0]))
