"""Parts of the search for boards: drawings, windows of the refinement, widths of edges, and what else is named."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from mocapella.model.board import Board
from mocapella.sensing import boards
from mocapella.sensing.boards import FEW_MARKERS, BoardDetector, draw_board, edge_width

CHESS = Board("chessboard", 6, 5, 0.05)
CHARUCO = Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50")


@pytest.mark.parametrize("square_px", [8, 9])
@pytest.mark.parametrize("inverted", [False, True])
def test_a_chessboard_has_its_squares_a_black_one_first_and_half_a_square_of_margin(
    square_px: int, inverted: bool
) -> None:
    drawn = draw_board(replace(CHESS, inverted=inverted), square_px)
    margin = square_px // 2
    assert drawn.shape == (5 * square_px + 2 * margin, 6 * square_px + 2 * margin)
    light, dark = (0, 255) if inverted else (255, 0)
    for row in range(-1, 6):
        for column in range(-1, 7):
            y, x = margin + row * square_px, margin + column * square_px
            square = drawn[max(y, 0) : y + square_px, max(x, 0) : x + square_px]
            inside = 0 <= row < 5 and 0 <= column < 6
            assert (square == (dark if inside and (row + column) % 2 == 0 else light)).all()


def test_a_charuco_board_is_drawn_in_whole_squares() -> None:
    drawn = draw_board(CHARUCO, 30)
    assert drawn.shape == (5 * 30, 6 * 30)
    assert (drawn[:15] == 255).all()
    assert (drawn[15:45, 15:45] == 0).all()


def steps(px: float) -> np.ndarray:
    """A vertical edge, blurred by a Gaussian of that standard deviation."""
    image = np.full((101, 101), 40.0)
    image[:, 51:] = 200
    blurred = cv2.GaussianBlur(image, (0, 0), px) if px else image
    return np.asarray(np.round(blurred), np.uint8)


@pytest.mark.parametrize("sd", [3.0, 4.0, 6.0])
def test_an_edge_is_as_wide_as_its_blur_makes_it(sd: float) -> None:
    width = edge_width(steps(sd), np.array([[50.0, 50.0]]), np.array([90.0]))
    assert width == pytest.approx(np.sqrt(2 * np.pi) * sd, rel=0.06)
    contrast = edge_width(steps(sd) // 2, np.array([[50.0, 50.0]]), np.array([90.0]))
    assert contrast == pytest.approx(width, rel=0.06)


@pytest.mark.parametrize(("spacing", "some"), [(5.0, True), (4.99, False)])
def test_a_corner_has_a_width_from_a_spacing_of_five_pixels_on(spacing: float, some: bool) -> None:
    assert np.isfinite(edge_width(steps(0), np.array([[50.0, 50.0]]), np.array([spacing]))) == some


@pytest.mark.parametrize(("at", "some"), [(40, True), (39, False), (60, True), (61, False)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_corner_has_a_width_if_its_window_is_in_the_image(at: int, some: bool, axis: int) -> None:
    """A spacing of 100 px is a window of 40 to each side."""
    image = np.eye(101, dtype=np.uint8) * 100 + steps(2.0) // 2
    corner = [50.0, 50.0]
    corner[axis] = at
    assert np.isfinite(edge_width(image, np.array([corner]), np.array([100.0]))) == some


def test_the_width_is_that_of_most_corners_and_a_plain_image_has_none() -> None:
    image = np.hstack([steps(2.0), steps(4.0), steps(4.0)])
    corners = np.array([[50.0, 50], [151, 50], [252, 50]])
    assert edge_width(image, corners, np.full(3, 90.0)) == pytest.approx(np.sqrt(2 * np.pi) * 4, rel=0.06)
    assert np.isnan(edge_width(np.full((101, 101), 90, np.uint8), corners[:1], np.full(1, 90.0)))


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Half sides of the windows in which corners are refined, each by ``by`` pixels to the right."""
    told: dict[str, Any] = {"reach": [], "by": 0.0}

    def refined(gray: Any, start: Any, reach: tuple[int, int], *_: Any) -> Any:
        told["reach"].append(reach)
        return start + np.array([told["by"], 0.0], np.float32)

    monkeypatch.setattr(boards.cv2, "cornerSubPix", refined)
    return told


def test_a_corner_is_refined_within_the_gap_between_the_markers_from_two_to_eight_pixels(windows: Any) -> None:
    """The gap between a corner and the markers about it is half of what a marker leaves of its square."""
    gap = 0.5 * (1 - CHARUCO.marker_ratio)
    spacing = np.array([10.0, 30.0, 40.0, 1000.0, np.nan])
    boards._refined(np.zeros((9, 9), np.uint8), np.full((5, 2), 4.5), spacing, CHARUCO)
    reach = [across for across, _ in windows["reach"]]
    assert all(across == down for across, down in windows["reach"])
    assert [reach[0], reach[3], reach[4]] == [2, 8, 2]
    for k in (1, 2):
        assert 0.9 * gap * spacing[k] - 1 < reach[k] <= gap * spacing[k]
    assert reach[2] > reach[1]
    windows["reach"].clear()
    boards._refined(np.zeros((9, 9), np.uint8), np.full((1, 2), 4.5), np.full(1, np.nan), CHARUCO)
    assert windows["reach"] == [(2, 2)]


@pytest.mark.parametrize(("by", "kept"), [(2.0, True), (-2.0, True), (2.5, False), (-2.5, False)])
def test_a_corner_that_leaves_its_window_stays_half_a_pixel_before_where_it_was_found(
    windows: Any, by: float, kept: bool
) -> None:
    windows["by"] = by
    found = boards._refined(np.zeros((9, 9), np.uint8), np.array([[4.5, 6.5]]), np.array([10.0]), CHARUCO)
    assert found.tolist() == [[4.0 + (by if kept else 0.0), 6.0]]


@pytest.mark.parametrize("count", [FEW_MARKERS - 1, FEW_MARKERS])
def test_a_charuco_board_is_there_from_so_many_corners_on(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    class Found:
        def detectBoard(self, gray: Any) -> Any:  # noqa: N802 - as OpenCV calls it
            return None, np.arange(count), None, None

    monkeypatch.setattr(boards, "_charuco_detector", lambda board: Found())
    assert boards._finds(np.zeros((9, 9), np.uint8), CHARUCO) == (count == FEW_MARKERS)


@pytest.mark.parametrize(
    ("shown", "said"),
    [((5, 5), True), ((5, 4), False), ((7, 5), True), ((6, 5), True)],
)
def test_another_chessboard_is_named_unless_its_corners_are_as_many(
    monkeypatch: pytest.MonkeyPatch, shown: tuple[int, int], said: bool
) -> None:
    images = [np.zeros((9, 9), np.uint8)]
    monkeypatch.setattr(boards, "chessboard_size", lambda gray: shown)
    across, down = shown[0] + 1, shown[1] + 1
    inner = " (columns and rows count squares, not inner corners)" if shown == (6, 5) else ""
    told = f"there is one of {across} × {down} squares: set columns and rows so{inner}"
    assert boards._other_chessboard(images, CHESS) == (told if said else "")
    monkeypatch.setattr(boards, "chessboard_size", lambda gray: None)
    assert not boards._other_chessboard(images, CHESS)


def drawn_at(board: Board, square_px: int = 40, border: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """The drawing with a wider border, slightly blurred, and where its corners are."""
    image = np.pad(draw_board(board, square_px), border, constant_values=0 if board.inverted else 255)
    at = board.corners_m[:, :2] / board.square_m * square_px + square_px // 2 + border - 0.5
    return cv2.GaussianBlur(image, (0, 0), 1.0), at


def test_a_drawn_board_has_its_corners_between_its_squares_and_its_edges_their_width() -> None:
    for board in (CHESS, CHARUCO):
        image, at = drawn_at(board)
        view = BoardDetector(board).update(image, "a", 7)
        assert view is not None
        np.testing.assert_allclose(view.corners_px, at, atol=0.2)
        assert view.size_px == (image.shape[1], image.shape[0])
        assert 2 < view.edge_px < 4


def test_a_chessboard_on_its_side_has_its_corners_in_order() -> None:
    image, at = drawn_at(CHESS)
    for turns in (1, 3):
        turned = np.ascontiguousarray(np.rot90(image, turns))
        view = BoardDetector(CHESS).update(turned, "a", 0)
        assert view is not None
        height, width = image.shape
        x, y = at.T
        where = np.stack([y, width - 1 - x] if turns == 1 else [height - 1 - y, x], axis=-1)
        np.testing.assert_allclose(view.corners_px, where, atol=5)  # a square is 40 px wide


@pytest.mark.parametrize("light", [True, False])
def test_the_first_square_is_light_if_the_boards_black_squares_are_the_lighter_ones(light: bool) -> None:
    image, at = drawn_at(CHESS)
    assert boards._first_square_is_light(255 - image if light else image, at, CHESS) == light
    cut = image[: round(float(at[-1, 1])), : round(float(at[-1, 0]))]  # the last squares are beyond the border
    assert boards._first_square_is_light(255 - cut if light else cut, at, CHESS) == light


@pytest.mark.parametrize("light", [True, False])
def test_only_the_inner_squares_tell_which_are_light(light: bool) -> None:
    """The outermost are the first to be covered by hands, or in a shadow."""
    image, at = drawn_at(CHESS)
    shown = 100 + image // 5
    inner = np.zeros(image.shape, np.bool_)
    (left, top), (right, bottom) = at.min(axis=0).astype(int), at.max(axis=0).astype(int)
    inner[top : bottom + 1, left : right + 1] = True
    misleading = np.where(inner, shown, 255 - image)
    assert boards._first_square_is_light(255 - misleading if light else misleading, at, CHESS) == light
