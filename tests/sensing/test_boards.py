"""Boards in drawn pictures: corners where they were drawn, and why there are none."""

from __future__ import annotations

import re
import struct
import zlib

import cv2
import numpy as np
import pytest

from mocapella.geometry.homography import homography
from mocapella.model.board import Board
from mocapella.sensing import boards, chessboards
from mocapella.sensing.boards import FEW_MARKERS, BoardDetector, board_png, draw_board, edge_width, why_not_found

CHARUCO = Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50")
SQUARE = 80
SIZE = (960, 720)
TO = np.array([[180, 120], [760, 90], [800, 600], [150, 560]], dtype=np.float64)


def picture(board: Board, *, blur: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The board in perspective, and where its corners are."""
    drawn = draw_board(board, SQUARE)
    height, width = drawn.shape
    # A pixel of the drawing covers the square around its number.
    H = homography(np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5, TO)
    background = 255 if board.inverted else 90
    image = cv2.warpPerspective(drawn, H, SIZE, borderValue=background, flags=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), blur)
    at = board.corners_m[:, :2] / board.square_m * SQUARE + SQUARE // 2 - 0.5
    h = np.column_stack([at, np.ones(len(at))]) @ H.T
    return image, h[:, :2] / h[:, 2:]


@pytest.mark.parametrize(
    "board",
    [
        CHARUCO,
        Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50", inverted=True),
        Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50", legacy=True),
        Board("chessboard", 6, 5, 0.05),
        Board("chessboard", 6, 5, 0.05, inverted=True),
    ],
)
def test_corners_are_found_where_they_were_drawn(board: Board) -> None:
    image, at = picture(board)
    detector = BoardDetector(board)
    view = detector.update(image, "a", 3)
    assert view is not None
    assert (view.camera, view.frame, view.size_px) == ("a", 3, SIZE)
    assert view.ids.tolist() == list(range(board.corners))
    assert np.abs(view.corners_px - at).max() < 0.3
    assert abs((view.corners_px - at).mean(axis=0)).max() < 0.1
    assert (detector.report.pictures, detector.report.found, detector.report.corners) == (1, 1, board.corners)


@pytest.mark.parametrize("dots_per_inch", [72, 300])
def test_a_boards_png_is_whole_and_is_printed_to_scale(dots_per_inch: int) -> None:
    data = board_png(CHARUCO, dots_per_inch)
    chunks, at = dict[bytes, bytes](), 8
    while at < len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        chunks[name] = data[at + 8 : at + 8 + size]
        assert data[at + 8 + size : at + 12 + size] == struct.pack(">I", zlib.crc32(name + chunks[name]))
        at += 12 + size
    names = list(chunks)
    assert (names[0], names[-1]) == (b"IHDR", b"IEND")
    assert names.index(b"pHYs") < names.index(b"IDAT")
    across, down, unit = struct.unpack(">IIB", chunks[b"pHYs"])
    assert unit == 1  # dots a metre
    assert across == down == pytest.approx(dots_per_inch / 0.0254, abs=0.5)
    drawn = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    squares = np.array([CHARUCO.rows + 1, CHARUCO.columns + 1])  # with its margin
    np.testing.assert_allclose(np.array(drawn.shape) / across, squares * CHARUCO.square_m, atol=4 / across)


def test_the_first_square_of_a_chessboard_is_black_also_when_it_is_turned() -> None:
    board = Board("chessboard", 6, 5, 0.05)
    image, at = picture(board)
    turned = np.ascontiguousarray(image[::-1, ::-1])
    view = BoardDetector(board).update(turned, "a", 0)
    assert view is not None
    assert np.abs(view.corners_px - (np.array(SIZE) - 1 - at)).max() < 0.3


def test_the_end_at_which_opencv_begins_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    board = Board("chessboard", 6, 5, 0.05)
    image, at = picture(board)
    search = chessboards._largest

    def from_the_other_end(gray: np.ndarray, least: tuple[int, int]) -> tuple[bool, np.ndarray, tuple[int, int]]:
        found, corners, counts = search(gray, least)
        return found, corners[::-1], counts

    for told in (search, from_the_other_end):
        monkeypatch.setattr(chessboards, "_largest", told)
        view = BoardDetector(board).update(image, "a", 0)
        assert view is not None
        assert np.abs(view.corners_px - at).max() < 0.3


def test_a_picture_without_a_board_is_counted() -> None:
    detector = BoardDetector(CHARUCO)
    assert detector.update(np.full((480, 640, 3), 90, dtype=np.uint8), "a", 0) is None
    assert (detector.report.pictures, detector.report.found) == (1, 0)


def test_the_width_of_edges_grows_with_blur() -> None:
    widths = []
    for blur in (1.0, 3.0, 6.0):
        image, at = picture(CHARUCO, blur=blur)
        widths.append(edge_width(image, at, np.full(len(at), 90.0)))
    assert widths[0] < 4 < widths[1] < 9 < widths[2]
    assert np.isnan(edge_width(image, at, np.full(len(at), np.nan)))


@pytest.mark.parametrize("turns", range(4))
def test_an_edge_is_measured_in_a_window_with_the_corner_in_its_middle(turns: int) -> None:
    """An edge at the last pixel of the window, on each side, gives a width; one pixel farther it is not seen."""
    spacing, reach, middle = 20.0, 8, 30
    for column, seen in ((middle + reach, True), (middle + reach + 1, False)):
        image = np.zeros((61, 61), np.uint8)
        image[:, column:] = 255
        width = edge_width(np.rot90(image, turns).copy(), np.array([[middle, middle]]), np.array([spacing]))
        assert np.isfinite(width) == seen


@pytest.mark.parametrize(
    ("sought", "shown", "says"),
    [
        (Board("charuco", 5, 4, 0.05, dictionary="DICT_6X6_50"), CHARUCO, 'Then set dictionary = "DICT_4X4_50"'),
        (Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50", inverted=True), CHARUCO, "set inverted = false"),
        (Board("charuco", 9, 8, 0.05, dictionary="DICT_4X4_50"), None, "nor any other board"),
        (Board("chessboard", 6, 5, 0.05), Board("chessboard", 7, 5, 0.05), "there is one of 7 × 5 squares"),
        (
            Board("chessboard", 5, 4, 0.05),
            Board("chessboard", 6, 5, 0.05),
            "one of 6 × 5 squares: set columns and rows so (columns and rows count squares, not inner corners)",
        ),
    ],
)
def test_what_is_there_instead_is_named(sought: Board, shown: Board | None, says: str) -> None:
    image = np.full((480, 640), 90, dtype=np.uint8) if shown is None else picture(shown)[0]
    assert BoardDetector(sought).update(image, "a", 0) is None
    assert says in why_not_found([image], sought)


def test_markers_in_another_order_are_named_with_the_numbers_that_the_board_has() -> None:
    """The whole board is seen, so that its highest number is the highest of the wanted board, too."""
    sought, shown = CHARUCO, Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50", legacy=True)
    image = cv2.resize(picture(shown)[0], None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA)
    assert BoardDetector(sought).update(image, "a", 0) is None
    said = re.search(r"\((\d+), the highest number (\d+); this board has 0 to (\d+)\)", why_not_found([image], sought))
    assert said is not None
    seen, highest, last = map(int, said.groups())
    assert seen == highest + 1 == last + 1


@pytest.mark.parametrize("count", [FEW_MARKERS - 1, FEW_MARKERS])
def test_another_board_is_named_from_so_many_markers_on(count: int) -> None:
    image = np.full((240, 100 * count + 60), 255, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_50)
    for k in range(count):
        image[80:160, 40 + 100 * k : 120 + 100 * k] = cv2.aruco.generateImageMarker(dictionary, k, 80)
    said = why_not_found([image], CHARUCO)
    assert (f"of DICT_6X6_50 there are {count} markers" in said) == (count == FEW_MARKERS)
    assert ("nor any other board" in said) == (count < FEW_MARKERS)


def test_a_mirrored_picture_is_told() -> None:
    image = np.ascontiguousarray(picture(CHARUCO)[0][:, ::-1])
    assert BoardDetector(CHARUCO).update(image, "a", 0) is None
    assert "in the mirrored picture" in why_not_found([image], CHARUCO)


def test_the_spacing_of_a_corner_is_the_distance_to_the_next_one_in_its_row_or_column() -> None:
    """Corners that are two apart on the board, or one apart in both directions, may be nearer in a slanted view."""
    board = Board("chessboard", 6, 5, 0.05)
    row, column = np.divmod(np.arange(board.corners), 5)
    corners = np.column_stack([10.0 * column + 8.0 * row, 12.0 * row])
    np.testing.assert_allclose(boards._spacing(np.arange(board.corners), corners, board), 10.0)
    for kept, spacing in ((column == 2, np.hypot(8, 12)), (row == 1, 10.0), ((row + column) % 2 == 0, np.nan),
                          (column % 2 == 1, np.hypot(8, 12)), (row % 2 == 0, 10.0)):  # fmt: skip
        np.testing.assert_allclose(boards._spacing(np.flatnonzero(kept), corners[kept], board), spacing)
    stretched = corners * [3.0, 1.0]
    np.testing.assert_allclose(boards._spacing(np.arange(board.corners), stretched, board), np.hypot(24, 12))
