"""Guide the user through filming a board: next views to film, and problems.

A calibration is well determined if corners cover each image, the board is tilted in several views, and pairs of cameras
share views. Hints name the condition that is missing most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.homography import homography
from mocapella.model.board import Board, BoardView

GRID: Final = (4, 3)
"""Numbers of columns and rows of fields into which the image is divided for counting corners."""
ENOUGH_VIEWS: Final = 10
SMALL: Final = 0.01
"""Fraction of the image covered by the board below which the lens is poorly sampled and depth is uncertain."""
TILTED: Final = 0.12
"""Least `tilt` that one view must have; about 25° at arm's length."""
BLURRED_PX: Final = 8.0
"""Least width of an edge that counts as blurred; a sharp one is 2 to 3 px wide [px]."""
ENOUGH_SHARED: Final = 5

Cause = Literal[
    "few views", "empty field", "no tilt", "small board", "blurred", "never together", "seldom together", "not seen",
    "moving",
]  # fmt: skip


class Hint(msgspec.Struct, frozen=True):
    """One piece of advice.

    Attributes:
        cause: identifier for programs.
        camera: name of the camera; empty if the advice concerns all.
        text: sentence for the user.
    """

    cause: Cause
    camera: str
    text: str


def field_counts(views: Sequence[BoardView]) -> NDArray[np.int64]:
    """Return the number of detected corners (rows, columns) in each cell of `GRID`, over all views of one camera."""
    counts = np.zeros(GRID[::-1], dtype=np.int64)
    for view in views:
        x, y = (view.corners_px + 0.5).T / np.array(view.size_px)[:, None]
        column = np.clip((x * GRID[0]).astype(int), 0, GRID[0] - 1)
        row = np.clip((y * GRID[1]).astype(int), 0, GRID[1] - 1)
        np.add.at(counts, (row, column), 1)
    return counts


def coverage(
    views: Sequence[BoardView],
    board: Board,
    cameras: Sequence[str],
    instant_of: Mapping[tuple[str, int], int] | None = None,
    *,
    lens_known: Sequence[str] = (),
) -> list[Hint]:
    """Return hints about missing views, the most urgent first. Cheap enough to call after every image.

    Args:
        views: views of all cameras so far.
        board: the calibration board.
        cameras: all names, including cameras without a view.
        instant_of: number of the group of simultaneous frames, by camera and frame number; None for the frame
            number itself.
        lens_known: names of cameras with a given lens, which need no tilt and no corners everywhere.
    """
    hints: list[Hint] = []
    of = {name: [view for view in views if view.camera == name] for name in cameras}
    for name, mine in of.items():
        if not mine:
            hints.append(Hint("not seen", name, f"camera {name} has not seen the board: hold it where it sees it"))
            continue
        hints += _of_pictures(name, mine)
        if name not in lens_known:
            hints += _of_lens(name, mine, board)
    instants = {
        name: {view.frame if instant_of is None else instant_of[name, view.frame] for view in mine}
        for name, mine in of.items()
        if mine
    }
    order: list[Cause] = ["not seen", "never together", "few views"]
    hints += _of_rig(instants)
    return sorted(hints, key=lambda hint: order.index(hint.cause) if hint.cause in order else len(order))


def _of_pictures(name: str, views: Sequence[BoardView]) -> list[Hint]:
    hints = []
    edges = np.array([view.edge_px for view in views])
    blurred = np.nanmedian(edges) > BLURRED_PX if np.isfinite(edges).any() else False
    if blurred:
        text = f"camera {name}: pictures are blurred (edges {np.nanmedian(edges):.0f} px wide): move slower, more light"
        hints.append(Hint("blurred", name, f"{text}, or focus"))
    if max(_share(view) for view in views) < SMALL:
        hints.append(
            Hint("small board", name, f"camera {name}: the board is too small in all pictures: hold it nearer")
        )
    return hints


def _share(view: BoardView) -> float:
    """Return the fraction of the image under the rectangle around the corners."""
    width, height = np.ptp(view.corners_px, axis=0) if len(view.ids) else (0.0, 0.0)
    return float(width * height / (view.size_px[0] * view.size_px[1]))


def _of_lens(name: str, views: Sequence[BoardView], board: Board) -> list[Hint]:
    hints = []
    if len(views) < ENOUGH_VIEWS:
        hints.append(Hint("few views", name, f"camera {name}: {len(views)} pictures of {ENOUGH_VIEWS}: go on filming"))
    if len(views) >= 3 and max(tilt(view, board) for view in views) < TILTED:
        text = f"camera {name}: tilt the board more, forwards, backwards and to both sides"
        hints.append(Hint("no tilt", name, text))
    empty = field_counts(views) == 0
    places = [(0, 0, "top left"), (0, -1, "top right"), (-1, 0, "bottom left"), (-1, -1, "bottom right")]
    missing = [where for row, column, where in places if empty[row, column]]
    if missing:
        which = "corner of the picture" if len(missing) == 1 else "corners of the picture"
        text = f"camera {name}: {which} still empty ({', '.join(missing)}): hold the board there"
        hints.append(Hint("empty field", name, text))
    return hints


def tilt(view: BoardView, board: Board) -> float:
    """Return a board's tilt in an image: the ratio of its farthest to its nearest corner's depth, less 1.

    It is 0 for a board parallel to the image, for fewer than four corners, and for corners on one row or column. Depths
    are known up to a common factor, from the homography of the board to the image.
    """
    rows, columns = np.divmod(view.ids, board.columns - 1)
    if len(view.ids) < 4 or len(set(rows.tolist())) < 2 or len(set(columns.tolist())) < 2:
        return 0.0
    plane = board.corners_m[view.ids, :2]
    H = homography(plane, view.corners_px)
    depth = plane @ H[2, :2] + 1.0  # up to a factor
    return float(depth.max() / depth.min() - 1.0) if depth.min() > 0 else 0.0


def _of_rig(instants: Mapping[str, set[int]]) -> list[Hint]:
    hints: list[Hint] = []
    names = list(instants)
    for name in names:
        shared = {other: len(instants[name] & instants[other]) for other in names if other != name}
        if not shared:
            continue
        other, most = max(shared.items(), key=lambda item: item[1])
        if most == 0:
            text = f"camera {name} never sees the board together with another: hold it where two cameras see it"
            hints.append(Hint("never together", name, text))
        elif most < ENOUGH_SHARED:
            text = f"camera {name} saw the board only {most} times together with another ({other}): more of these"
            hints.append(Hint("seldom together", name, text))
    return hints
