"""Each hint is given where it is due, and not where it is not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, film

from mocapella.calibration.board_guidance import coverage, field_counts, tilt
from mocapella.model.board import BoardView


def causes(views: list[BoardView], cameras: list[str] | None = None, **more: object) -> set[tuple[str, str]]:
    hints = coverage(views, BOARD, cameras or ["c0", "c1"], **more)  # type: ignore[arg-type]
    return {(hint.cause, hint.camera) for hint in hints}


def everywhere(camera: str, count: int = 12) -> list[BoardView]:
    """A tilted board over the whole picture."""
    x, y = (BOARD.corners_m[:, :2] / BOARD.corners_m[:, :2].max(axis=0)).T
    depth = 1 + 0.3 * x
    corners = np.column_stack([20 + 1240 * x * 1.3 / depth, 20 + 680 * y * (1 + 0.0 * depth)])
    first = (x == x.min()) & (y == y.min())
    corners[first] = [20, 20]
    corners[(x == 1) & (y == y.min())] = [1260, 20]
    corners[(x == x.min()) & (y == 1)] = [20, 700]
    return [BoardView(camera, k, SIZE, np.arange(BOARD.corners), corners, 2.5) for k in range(count)]


def test_enough_of_everything_needs_no_hint() -> None:
    assert causes(everywhere("c0") + everywhere("c1")) == set()


def test_a_camera_that_saw_nothing() -> None:
    assert ("not seen", "c1") in causes(everywhere("c0"))


def test_few_views_and_none_where_the_lens_is_known() -> None:
    views = everywhere("c0", 6) + everywhere("c1", 6)
    assert causes(views) == {("few views", "c0"), ("few views", "c1")}
    assert causes(views, lens_known=["c0", "c1"]) == set()


def test_an_empty_corner_is_named() -> None:
    some = [
        msgspec.structs.replace(
            view,
            ids=view.ids[keep := ~((view.corners_px < np.array(SIZE) * [0.3, 0.4]).all(axis=1))],
            corners_px=view.corners_px[keep],
        )
        for view in everywhere("c1")
    ]
    hints = coverage(everywhere("c0") + some, BOARD, ["c0", "c1"])
    assert [hint.text for hint in hints] == [
        "camera c1: corner of the picture still empty (top left): hold the board there"
    ]


def test_no_tilt() -> None:
    filmed = film(cameras=1, flat=True)
    assert max(tilt(view, BOARD) for view in filmed.views) < 0.1
    assert ("no tilt", "c0") in causes(filmed.views, ["c0"])
    tilted = film(cameras=1)
    assert max(tilt(view, BOARD) for view in tilted.views) > 0.2
    assert ("no tilt", "c0") not in causes(tilted.views, ["c0"])


def test_a_small_board() -> None:
    small = [msgspec.structs.replace(view, corners_px=400 + 0.05 * view.corners_px) for view in everywhere("c0")]
    assert ("small board", "c0") in causes(small, ["c0"])


def test_blur() -> None:
    blurred = [msgspec.structs.replace(view, edge_px=12.0) for view in everywhere("c0")]
    assert ("blurred", "c0") in causes(blurred, ["c0"])


def test_never_and_seldom_together() -> None:
    apart = [msgspec.structs.replace(view, frame=view.frame + 100) for view in everywhere("c1")]
    assert ("never together", "c1") in causes(everywhere("c0") + apart)
    seldom = [msgspec.structs.replace(view, frame=view.frame + 10) for view in everywhere("c1")]
    assert causes(everywhere("c0") + seldom) == {("seldom together", "c0"), ("seldom together", "c1")}
    instants = {(view.camera, view.frame): view.frame % 100 for view in everywhere("c0") + apart}
    assert causes(everywhere("c0") + apart, instant_of=instants) == set()


def test_fields_are_counted_where_the_corners_are() -> None:
    view = BoardView("c0", 0, (400, 300), np.arange(3), np.array([[0, 0], [399, 299], [399, 0]], dtype=float))
    counts = field_counts([view])
    assert counts.shape == (3, 4)
    assert (counts[0, 0], counts[2, 3], counts[0, 3], counts.sum()) == (1, 1, 1, 3)


@pytest.mark.parametrize("beyond_px", [0.0, 0.5, 3.0])
def test_corners_on_the_border_of_the_image_or_beyond_count_in_the_outermost_fields(beyond_px: float) -> None:
    """The image ends half a pixel beyond the centres of its outermost pixels; found corners are not exact."""
    low, right, bottom = -0.5 - beyond_px, 399.5 + beyond_px, 299.5 + beyond_px
    corners = np.array([[low, low], [right, low], [low, bottom], [right, bottom]])
    counts = field_counts([BoardView("c0", 0, (400, 300), np.arange(4), corners)])
    assert (counts[[0, 0, -1, -1], [0, -1, 0, -1]] == 1).all()
    assert counts.sum() == 4
