"""Progress of a calibration with a board, for the view."""

from __future__ import annotations

from typing import Literal

import msgspec

BoardPhase = Literal["idle", "filming", "calibrating", "done"]


class CameraProgress(msgspec.Struct, frozen=True):
    """One camera's progress in filming the board.

    Attributes:
        name: name of the camera.
        views: number of images with the board that the calibration will use.
        fields: (rows, columns) number of corners detected so far in each cell of a grid over the image.
        size_px: (width, height) of its image; None before the first.
        corners_px: (n, 2) x, y of the board's corners in its newest image [px].
        problem: why the board is not detected in the newest image; empty if it is, or if the reason is unknown.
    """

    name: str
    views: int
    fields: tuple[tuple[int, ...], ...]
    size_px: tuple[int, int] | None = None
    corners_px: tuple[tuple[float, float], ...] = ()
    problem: str = ""


class RigQuality(msgspec.Struct, frozen=True):
    """The quality of a calibrated rig.

    Attributes:
        headings: title and unit of each column of the table.
        rows: cells of the table, a row for each camera.
        sentences: text beside the table.
        tape: sentence with distances to compare with a tape measure; empty for one camera.
        hints: suggested improvements.
    """

    headings: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, ...], ...]
    sentences: tuple[str, ...]
    tape: str
    hints: tuple[str, ...]


class BoardProgress(msgspec.Struct, frozen=True):
    """The state of the calibration of cameras with a board.

    Attributes:
        phase: ``idle`` before the first run and after a cancelled one, then ``filming`` the board, ``calibrating``
            (computation), and ``done``.
        board: description of the board.
        cameras: progress of the cameras that take part.
        shared: number of instants at which two or more cameras saw the board.
        hints: next actions, the most urgent first.
        problem: why it failed; empty if it did not.
        quality: quality of the calibrated rig; None before it is calibrated.
        file: name of the saved rig's file, or before that a free name proposed for it.
        busy: the long operation in progress; empty if there is none.
        saved, used: whether the rig was saved, and whether the server tracks with it.
        has_rig: whether the session's method is one that needs a rig, so that it has one already.
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
