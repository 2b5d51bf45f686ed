"""Read tracked bodies from JSON files: results of silhouette tracking, or named 3D joints to start tracking from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import convert, decode_json, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.twist_tree import TreePose

Float64 = NDArray[np.float64]
Triple = tuple[float, float, float]

FORMAT: Final = "mocapella followed body"
PEOPLE_FORMAT: Final = "mocapella followed people"
VERSION: Final = 1
"""Version of both file formats: of one body, and of several people."""
ALONE: Final = ""
"""Name, in mappings by body, of the single body in a run that tracks one unnamed person."""
LONGEST_NAME: Final = 40
_MOST_BYTES: Final = 1 << 30
FARTHEST_M: Final = 1000.0
"""Largest absolute coordinate of a joint; beyond it, the file's unit is probably not metres [m]."""


class FollowedFrame(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A body in one frame, as in the file.

    Attributes:
        frame: the frame's number in the videos.
        time_s: capture time since the start of the videos [s].
        root_twist: twist of T_world_model, the pose of the body's root: translation part [m], then rotation vector
            [rad].
        angles: joint angles by joint name [rad].
        joints: world positions of the body's landmarks by name [m].
        overlap: intersection over union of the model's and the image's silhouettes, by camera that saw the body.
        left_out: the reason why a camera's image was not used, by camera.
        lost: whether the body is lost; the pose is then the last known one, or at first the initial one.
        unsupported: names of the joints that images do not support; they are predicted, not measured.
        shown: share of the model's outline for which the image has evidence, by camera that saw the body.
    """

    frame: int
    time_s: float
    root_twist: tuple[float, float, float, float, float, float]
    angles: dict[str, float]
    joints: dict[str, Triple]
    overlap: dict[str, float]
    left_out: dict[str, str]
    lost: bool = False
    unsupported: tuple[str, ...] = ()
    shown: dict[str, float] = {}

    def pose(self, joint_names: Sequence[str]) -> TreePose:
        """Return the pose for a body model with the named joints; a joint that the file lacks has angle 0."""
        angles = np.array([self.angles.get(name, 0.0) for name in joint_names], dtype=np.float64)
        return TreePose(exp_twist(self.root_twist), angles)


def frame_of(
    frame: int,
    time_s: float,
    pose: TreePose,
    *,
    joint_names: Sequence[str],
    landmarks: Mapping[str, Float64],
    overlap: Mapping[str, float],
    left_out: Mapping[str, str],
    lost: bool,
    unsupported: Sequence[str] = (),
    shown: Mapping[str, float] = MappingProxyType({}),
) -> FollowedFrame:
    """Return a body's pose in one frame in the form of the file.

    Args:
        frame: the frame's number in the videos.
        time_s: capture time since the start of the videos [s].
        pose: root pose and joint angles of the body model.
        joint_names: names of the joint angles of ``pose``, in their order.
        landmarks: world positions (3,) of landmarks by name [m].
        overlap: intersection over union of the model's and the image's silhouettes, by camera; rounded to 4 decimals.
        left_out: the reason why a camera's image was not used, by camera.
        lost: whether the body is lost.
        unsupported: names of the landmarks that images do not support.
        shown: share of the model's outline for which the image has evidence, by camera; rounded, and NaN left out.
    """
    twist = tuple(float(x) for x in log_motion(pose.T_world_model))
    angles = dict(zip(joint_names, pose.angles.tolist(), strict=True))
    joints = {name: tuple(at.tolist()) for name, at in landmarks.items()}
    return FollowedFrame(
        frame, time_s, twist, angles, joints,  # type: ignore[arg-type]
        {name: round(float(value), 4) for name, value in overlap.items()}, dict(left_out), lost, tuple(unsupported),
        {name: round(float(value), 4) for name, value in shown.items() if not math.isnan(value)},
    )  # fmt: skip


class FollowedBody(msgspec.Struct, frozen=True):
    """Content of a file with one tracked body.

    Attributes:
        format, version: name and version of the file format.
        model: body model: male, female, legs, or the path of a mesh file.
        height_m: subject height, if given; None for mesh files.
        proportions: measured lengths of body segments by name [m].
        frames: the tracked frames.
    """

    model: str
    frames: list[FollowedFrame]
    height_m: float | None = None
    proportions: dict[str, float] = {}
    format: str = FORMAT
    version: int = VERSION


class FollowedPeople(msgspec.Struct, frozen=True):
    """Content of a file with several tracked bodies.

    Attributes:
        format, version: name and version of the file format.
        people: each body by its person's name, as in a file of one body.
        rows: frames of an unfinished run (`bodies_writer.py`), each with all bodies by name.
    """

    people: dict[str, FollowedBody]
    rows: list[dict[str, FollowedFrame]] = []
    format: str = PEOPLE_FORMAT
    version: int = VERSION


_File = TypeVar("_File", FollowedBody, FollowedPeople)


def is_followed_people(data: Any) -> bool:
    """Whether decoded JSON has the format name of a file with several bodies; other fields are not checked."""
    return isinstance(data, dict) and data.get("format") == PEOPLE_FORMAT


def is_followed_body(data: Any) -> bool:
    """Whether decoded JSON has a field ``frames``, as a file of one body has; its content is not checked."""
    return isinstance(data, dict) and "frames" in data


def read_json(path: Path) -> Any:
    """Return the decoded content of a JSON file of at most 1 GiB.

    Raises:
        InputError: the file cannot be read, or is not JSON.
    """
    data = read_whole(path, fix="name a file that exists", most_bytes=_MOST_BYTES)
    return decode_json(data, file=path, fix="see docs/silhouettes.md for what --start reads")


def read_followed_body(path: Path) -> FollowedBody:
    """Read a file of one tracked body.

    Raises:
        InputError: the file cannot be read, has another format or version, or no frames; names the field.
    """
    return _checked(_converted(read_json(path), FollowedBody, FORMAT, path), path, "frames")


def read_followed_people(path: Path) -> dict[str, FollowedBody]:
    """Read a file of one or several tracked bodies; return them by name, an unnamed one under the key `ALONE`.

    Raises:
        InputError: the file cannot be read, has another format or version, or no body, or a body has no frames; names
            the field.
    """
    data = read_json(path)
    if not is_followed_people(data):
        return {ALONE: _checked(_converted(data, FollowedBody, FORMAT, path), path, "frames")}
    found = _converted(data, FollowedPeople, PEOPLE_FORMAT, path)
    people = found.people
    if found.rows:
        people = {
            name: msgspec.structs.replace(body, frames=[row[name] for row in found.rows if name in row])
            for name, body in people.items()
        }
    if not people:
        raise InputError("has no body", file=path, field="people", fix="name a file with tracked frames of a body")
    return {name: _checked(body, path, f"people.{name}.frames") for name, body in people.items()}


def _converted(data: Any, to: type[_File], words: str, path: Path) -> _File:
    if not isinstance(data, dict) or data.get("format") != words:
        value = data.get("format") if isinstance(data, dict) else None
        raise InputError("is no followed body", file=path, field="format", value=value, fix=f"it is {words!r}")
    if data.get("version") != VERSION:
        fix = f"this program reads version {VERSION}: run mocapella track silhouettes again"
        raise InputError("is of another version", file=path, field="version", value=data.get("version"), fix=fix)
    return convert(data, to, what="followed body", file=path, fix="run mocapella track silhouettes again")


def _checked(found: FollowedBody, path: Path, field: str) -> FollowedBody:
    if not found.frames:
        raise InputError("has no frame", file=path, field=field, fix="name a file with tracked frames of a body")
    return found


def check_person_name(name: str) -> str:
    """Return a person's name unchanged if it is valid.

    Raises:
        SettingsError: the name is empty, longer than `LONGEST_NAME`, not printable, or has "=" or an outer space.
    """
    if not (0 < len(name.strip()) == len(name) <= LONGEST_NAME and name.isprintable() and "=" not in name):
        raise SettingsError(
            f"{name!r} cannot be a person's name; use 1 to {LONGEST_NAME} characters without '=', such as anna"
        )
    return name


def joints_of_people(data: Any, path: Path) -> dict[str, dict[str, Float64]]:
    """Return world positions (3,) of joints [m] by person and joint name from decoded JSON.

    Args:
        data: joints by person, or the joints of a single person; the key of the single person is `ALONE`.
        path: the JSON file, named in errors.

    Raises:
        InputError: the content has another form; names the person, the joint and its value.
        SettingsError: a person's name is invalid.
    """
    if isinstance(data, dict) and data and all(isinstance(one, dict) for one in data.values()):
        return {check_person_name(name): named_joints(one, path, f"{name}.") for name, one in data.items()}
    return {ALONE: named_joints(data, path)}


def named_joints(data: Any, path: Path, whose: str = "") -> dict[str, Float64]:
    """Return world positions (3,) of joints [m] by joint name from decoded JSON; underscores become spaces.

    Args:
        data: the JSON object, with three coordinates for each name.
        path: the JSON file, named in errors.
        whose: prefix of the joint's name in errors, such as ``anna.``.

    Raises:
        InputError: the content has another form; names the joint and its value.
    """
    if not isinstance(data, dict) or not data:
        fix = 'write {"left hip": [x, y, z], …} in metres of the rig\'s world'
        raise InputError("has no named joints", file=path, field=whose.rstrip(".") or None, value=data, fix=fix)
    found = {}
    for name, at in data.items():
        numbers = isinstance(at, list) and len(at) == 3 and all(_is_number(value) for value in at)
        if not numbers:
            raise InputError(
                "is no place", file=path, field=whose + name, value=at, fix="write three numbers: [x, y, z] in metres"
            )
        if max(abs(value) for value in at) > FARTHEST_M:
            raise InputError(
                "is farther away than anything", file=path, field=whose + name, value=at, fix="write metres"
            )
        found[name.replace("_", " ")] = np.array(at, dtype=np.float64)
    return found


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
