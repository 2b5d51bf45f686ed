"""Each hint is given where it is due, and not where it is not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, film

from mocapella.calibration.board_guidance import BLURRED_PX, coverage, field_counts, tilt
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


def test_a_corner_counts_in_the_field_of_the_pixel_that_it_is_in() -> None:
    """The image begins half a pixel before the centre of its first pixel: fields of 100 pixels begin at 99.5."""
    for x, y, field in ((99.4, 99.4, (0, 0)), (99.5, 99.4, (0, 1)), (99.4, 99.5, (1, 0)), (299.5, 199.5, (2, 3))):
        counts = field_counts([BoardView("c0", 0, (400, 300), np.arange(1), np.array([[x, y]]))])
        assert counts[field] == counts.sum() == 1


def test_pictures_are_blurred_beyond_the_width_and_a_board_small_below_its_share() -> None:
    def named(cause: str, **changed: object) -> bool:
        return (cause, "c0") in causes([msgspec.structs.replace(v, **changed) for v in everywhere("c0")], ["c0"])

    assert not named("blurred", edge_px=BLURRED_PX)
    assert named("blurred", edge_px=float(np.nextafter(BLURRED_PX, 9)))
    square = np.tile([[100.0, 100.0], [200.0, 200.0]], (BOARD.corners // 2, 1))
    assert not named("small board", corners_px=square, size_px=(1000, 1000))
    assert named("small board", corners_px=square, size_px=(1000, 1001))


def test_ten_pictures_are_enough_and_three_show_whether_the_board_is_tilted() -> None:
    assert ("few views", "c0") in causes(everywhere("c0", 9), ["c0"])
    assert ("few views", "c0") not in causes(everywhere("c0", 10), ["c0"])
    flat = film(cameras=1, flat=True).views
    assert ("no tilt", "c0") in causes(flat[:3], ["c0"])
    assert ("no tilt", "c0") not in causes(flat[:2], ["c0"])


def test_five_instants_together_are_enough() -> None:
    later = {k: [msgspec.structs.replace(v, frame=v.frame + 12 - k) for v in everywhere("c1")] for k in (4, 5)}
    assert causes(everywhere("c0") + later[5]) == set()
    assert causes(everywhere("c0") + later[4]) == {("seldom together", "c0"), ("seldom together", "c1")}


def test_a_tilt_needs_two_corners_on_two_rows_and_columns() -> None:
    x, y = BOARD.corners_m[:, :2].T
    depth = 1 + x + 0.5 * y
    view = BoardView("c0", 0, SIZE, np.arange(BOARD.corners), 900 * np.column_stack([x / depth, y / depth]))
    across = BOARD.columns - 1

    def of(ids: list[int]) -> float:
        return tilt(msgspec.structs.replace(view, ids=np.array(ids), corners_px=view.corners_px[ids]), BOARD)

    assert of([0, 3, across, across + 3]) > 0.05
    assert of([across - 2, across - 1, across, across + 1]) > 0.05
    assert of([6, 7, 8, 6 + across, 7 + across, 8 + across]) > 0.01
    assert of(list(range(across, 2 * across))) == 0.0  # one row
    assert of(list(range(2, BOARD.corners, across))) == 0.0  # one column
    assert of([0, 3, across]) == 0.0
