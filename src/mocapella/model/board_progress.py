"""How a calibration with a board goes, as a view shows it."""

from __future__ import annotations

from typing import Literal

import msgspec

BoardPhase = Literal["idle", "filming", "calibrating", "done"]


class CameraProgress(msgspec.Struct, frozen=True):
    """What one camera has seen.

    Attributes:
        name: of the camera.
        views: of the board that are kept.
        fields: rows of the picture's fields, and how many corners each had so far.
        size_px: (width, height) of its picture; None before the first.
        corners_px: x, y of the board's corners in its newest picture.
        problem: why it does not see the board, where that is known.
    """

    name: str
    views: int
    fields: tuple[tuple[int, ...], ...]
    size_px: tuple[int, int] | None = None
    corners_px: tuple[tuple[float, float], ...] = ()
    problem: str = ""


class RigQuality(msgspec.Struct, frozen=True):
    """How good a rig is.

    Attributes:
        headings: of the table: words and unit.
        rows: one for each camera.
        sentences: what is said beside it.
        tape: what to compare with a tape measure; empty of one camera.
        hints: what would make it better.
    """

    headings: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, ...], ...]
    sentences: tuple[str, ...]
    tape: str
    hints: tuple[str, ...]


class BoardProgress(msgspec.Struct, frozen=True):
    """All of it.

    Attributes:
        phase: ``idle`` before the first run and after one that was cancelled.
        board: what is looked for, in words.
        cameras: that take part.
        shared: instants at which two or more saw the board.
        hints: what to do next, the most urgent first.
        problem: why it could not be finished; empty where nothing is wrong.
        quality: of the rig that was found.
        file: the name under which the rig was saved, or would be.
        busy: what is being done that takes long; empty where nothing is.
        saved, used: whether it was saved, and whether the server tracks with it.
        has_rig: whether the session's method tracks with a rig already.
    """

    phase: BoardPhase = "idle"
    board: str = ""
    cameras: tuple[CameraProgress, ...] = ()
    shared: int = 0
    hints: tuple[str, ...] = ()
    problem: str = ""
    quality: RigQuality | None = None
    file: str = "rig.toml"
    busy: str = ""
    saved: bool = False
    used: bool = False
    has_rig: bool = False
