"""BVH files (Biovision hierarchy): a tree of joints and, for every frame, a number for each of their channels.

The format: M. Meredith, S. Maddock, "Motion Capture File Formats Explained", University of Sheffield, CS-01-11.
A joint's rotation is the product of its channels' rotations, in the file's order. Position channels replace the joint's
offset; this is how tools write a moving root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, decode_text, read_whole
from mocapella.errors import InputError, one_of

Float64 = NDArray[np.float64]

_AXES = {"X": 0, "Y": 1, "Z": 2}
_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")
_MOST_JOINTS = 1000
_MOST_FRAMES = 1_000_000
_LARGEST = 1e9
"""Limit of coordinates and angles in any unit; sums of such numbers stay finite."""


@dataclass(frozen=True)
class BvhJoint:
    """A joint, or an end site (which has no channels and the name ``<parent> end``).

    Attributes:
        name: name in the file.
        parent: index of the parent, −1 for the root.
        offset: (3,) position relative to the parent, in the file's unit.
        channels: names of its channels, in the file's order.
        first_channel: column of its first channel in `Bvh.channels`.
        is_end: whether it is an end site.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    first_channel: int
    is_end: bool = False


@dataclass(frozen=True, eq=False)
class Bvh:
    """The content of a BVH file.

    Attributes:
        joints: joints and end sites, parents before children.
        frame_s: time between two frames [s].
        channels: (frames, columns) values of all channels: positions in the file's unit, angles in degrees.
    """

    joints: tuple[BvhJoint, ...]
    frame_s: float
    channels: Float64

    def positions(self) -> Float64:
        """Compute the positions (frames, joints, 3) of all joints and end sites, in the file's unit and axes."""
        frames = len(self.channels)
        positions = np.empty((frames, len(self.joints), 3))
        rotations = np.empty((frames, len(self.joints), 3, 3))
        for i, joint in enumerate(self.joints):
            offset = np.tile(np.array(joint.offset), (frames, 1))
            turn = np.tile(np.eye(3), (frames, 1, 1))
            for column, channel in enumerate(joint.channels, joint.first_channel):
                values, axis = self.channels[:, column], _AXES[channel[0]]
                if channel.endswith("position"):
                    offset[:, axis] = values
                else:
                    turn = turn @ _rotation(axis, np.radians(values))
            if joint.parent < 0:
                positions[:, i], rotations[:, i] = offset, turn
            else:
                outer = rotations[:, joint.parent]
                positions[:, i] = positions[:, joint.parent] + np.einsum("nij,nj->ni", outer, offset)
                rotations[:, i] = outer @ turn
        return positions


def read_bvh(path: str | Path) -> Bvh:
    """Read a BVH file.

    Raises:
        InputError: it cannot be read, or is not a valid BVH file; names row, field, value and the expected content.
    """
    fix = "give the path of a .bvh file"
    return parse_bvh(decode_text(read_whole(path, fix=fix, most_bytes=MOST_TABLE_BYTES), file=path, fix=fix), path)


def parse_bvh(text: str, file: object = None) -> Bvh:
    """Parse the content of a BVH file; ``file`` is named in errors, if given.

    Raises:
        InputError: it is not a valid BVH file; names row, field, value and the expected content.
    """
    reader = _Reader(text, file)
    reader.expect("HIERARCHY")
    reader.expect("ROOT")
    joints: list[BvhJoint] = []
    _read_joint(reader, joints, -1)
    reader.expect("MOTION")
    reader.expect("Frames:")
    frames = reader.integer("Frames", 1, _MOST_FRAMES)
    reader.expect("Frame")
    reader.expect("Time:")
    frame_s = reader.number("Frame Time")
    if frame_s <= 0:
        reader.fail(
            "is no duration", "Frame Time", frame_s, "give the seconds from one frame to the next, such as 0.0333"
        )
    columns = sum(len(joint.channels) for joint in joints)
    if columns == 0:
        reader.fail("no joint has a channel, so nothing moves", fix="export the file with its motion")
    return Bvh(tuple(joints), frame_s, _read_frames(reader, frames, columns))


class _Reader:
    """Reader of a file's words, with the row of the last one."""

    def __init__(self, text: str, file: object) -> None:
        self.file = file
        self.lines = text.splitlines()
        self.row = 0
        self._words: list[str] = []

    def word(self, wanted: str) -> str:
        while not self._words:
            if self.row >= len(self.lines):
                self.fail(f"ends where {wanted} should stand", fix="the file is empty or cut off; export it again")
            self._words = self.lines[self.row].split()[::-1]
            self.row += 1
        return self._words.pop()

    def name(self) -> str:
        """Read a name up to a brace or the line's end: names may contain blanks."""
        words: list[str] = []
        while self._words and self._words[-1] != "{":
            words.append(self._words.pop())
        return " ".join(words)

    def expect(self, wanted: str) -> None:
        found = self.word(wanted)
        if found.lower() != wanted.lower():
            self.fail(f"{wanted} should stand here", value=found, fix="give a BVH file")

    def number(self, field: str) -> float:
        word = self.word(f"a number ({field})")
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not abs(value) <= _LARGEST:
            self.fail("is no usable number", field, word, "write a decimal number")
        return value

    def integer(self, field: str, least: int, most: int) -> int:
        word = self.word(f"a whole number ({field})")
        if not (word.isascii() and word.isdigit() and len(word) <= 12 and least <= int(word) <= most):
            self.fail("is out of range", field, word, f"write a whole number from {least} to {most}")
        return int(word)

    def fail(self, problem: str, field: str | None = None, value: object = None, fix: str | None = None) -> NoReturn:
        raise InputError(problem, file=self.file, row=max(1, self.row), field=field, value=value, fix=fix)


def _read_joint(reader: _Reader, joints: list[BvhJoint], parent: int) -> None:
    """Read joints from a root's name to its closing brace, with a stack instead of recursion: files may nest deep."""
    open_joints = [parent]
    keyword = "ROOT"
    while True:
        if keyword == "}":
            open_joints.pop()
            if len(open_joints) == 1:
                return
        elif keyword.upper() in ("ROOT", "JOINT", "END"):
            open_joints.append(_read_one(reader, joints, open_joints[-1], keyword.upper()))
        else:
            reader.fail("JOINT, End Site or } should stand here", value=keyword, fix="give a BVH file")
        keyword = reader.word("JOINT, End Site or }")
        if keyword.upper() == "ROOT":
            reader.fail("a second root", value=keyword, fix="give a file with one skeleton")


def _read_one(reader: _Reader, joints: list[BvhJoint], parent: int, keyword: str) -> int:
    """Read a joint up to its channels; return its index."""
    if len(joints) >= _MOST_JOINTS:
        reader.fail(f"more than {_MOST_JOINTS} joints", fix="give a file of one person")
    end = keyword == "END"
    if end:
        if joints[parent].is_end:
            reader.fail("an end site inside an end site", fix="give a BVH file")
        reader.expect("Site")
        reader.name()
        name = f"{joints[parent].name} end"
    else:
        name = reader.name()
        if not name:
            reader.fail("the joint has no name", fix="write it behind ROOT or JOINT")
    reader.expect("{")
    reader.expect("OFFSET")
    offset = (reader.number("OFFSET x"), reader.number("OFFSET y"), reader.number("OFFSET z"))
    first = sum(len(joint.channels) for joint in joints)
    joints.append(BvhJoint(name, parent, offset, () if end else _read_channels(reader), first, end))
    return len(joints) - 1


def _read_channels(reader: _Reader) -> tuple[str, ...]:
    reader.expect("CHANNELS")
    count = reader.integer("CHANNELS", 0, 6)
    known = {name.lower(): name for name in _CHANNELS}
    channels: list[str] = []
    for _ in range(count):
        word = reader.word("a channel")
        if word.lower() not in known:
            reader.fail("is no channel", "CHANNELS", word, f"known: {one_of(word, _CHANNELS)}")
        if known[word.lower()] in channels:
            reader.fail("stands twice", "CHANNELS", word, "name each channel once")
        channels.append(known[word.lower()])
    return tuple(channels)


def _read_frames(reader: _Reader, frames: int, columns: int) -> Float64:
    """Read the remaining rows (frames, columns); blank rows are skipped."""
    rows = [(i + 1, line.split()) for i, line in enumerate(reader.lines) if i >= reader.row and line.strip()]
    for row, words in rows:
        if len(words) != columns:
            reader.row = row
            reader.fail(
                f"{len(words)} numbers; the joints have {columns} channels", fix="the row is damaged; export again"
            )
    if len(rows) != frames:
        reader.row = len(reader.lines)
        reader.fail(
            f"{len(rows)} rows of motion follow", "Frames", frames, f"write Frames: {len(rows)} if they are all"
        )
    try:
        values = np.array([words for _, words in rows], dtype=np.float64)
    except ValueError:
        values = np.full((frames, columns), np.nan)
    if not (np.abs(values) <= _LARGEST).all():
        _name_bad_number(reader, rows)
    return values


def _name_bad_number(reader: _Reader, rows: list[tuple[int, list[str]]]) -> None:
    for row, words in rows:
        for column, word in enumerate(words):
            try:
                usable = abs(float(word)) <= _LARGEST
            except ValueError:
                usable = False
            if not usable:
                reader.row = row
                reader.fail("is no usable number", f"channel {column + 1}", word, "write a decimal number")


def _rotation(axis: int, angle: Float64) -> Float64:
    """Right-handed rotations (n, 3, 3) about one axis."""
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.zeros((len(angle), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[:, axis, axis] = 1
    matrix[:, i, i] = matrix[:, j, j] = cos
    matrix[:, i, j], matrix[:, j, i] = -sin, sin
    return matrix
