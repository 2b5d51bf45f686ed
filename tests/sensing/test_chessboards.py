"""Chessboards are found by either of OpenCV's detectors, and their size is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocapella.model.board import Board

cv2 = pytest.importorskip("cv2")

from mocapella.sensing.boards import BoardDetector, draw_board, why_not_found  # noqa: E402
from mocapella.sensing.chessboards import chessboard_corners, chessboard_size, grown  # noqa: E402

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
CHARUCO = DATA / "charuco_4cam" / "chessboard_intrinsic"
POSE2SIM = DATA / "pose2sim_single_person" / "calibration" / "intrinsics"


def filmed(columns: int, rows: int, *, tilt: float = 0.0) -> np.ndarray:
    """An image of a board on a grey wall, seen a little from the side."""
    drawn = draw_board(Board("chessboard", columns, rows, 0.03), 30)
    height, width = drawn.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = np.add(corners, [80, 60]) + np.array([[0, 0], [-tilt, tilt], [-tilt, -tilt], [0, 0]])
    H = cv2.getPerspectiveTransform(corners, seen.astype(np.float32))
    size = (width + 160, height + 120)
    image = cv2.warpPerspective(drawn, H, size, borderValue=120, flags=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0))


@pytest.mark.parametrize(("columns", "rows"), [(8, 6), (8, 5), (10, 7), (5, 4)])
def test_a_board_is_found_with_its_own_size_and_no_smaller_one(columns: int, rows: int) -> None:
    image = filmed(columns, rows, tilt=20)
    corners = chessboard_corners(image, (columns - 1, rows - 1))
    assert corners is not None
    assert corners.shape == ((columns - 1) * (rows - 1), 2)
    assert chessboard_size(image) == (columns - 1, rows - 1)
    for smaller in ((columns - 2, rows - 1), (columns - 1, rows - 2)):
        assert chessboard_corners(image, smaller) is None


def test_a_part_of_a_grid_grows_to_the_whole() -> None:
    image = filmed(8, 6)
    whole = chessboard_corners(image, (7, 5))
    assert whole is not None
    part = whole.reshape(5, 7, 2)[1:4, 2:5].reshape(-1, 2)
    assert grown(image, part, (3, 3)) == (7, 5)
    assert grown(image, whole, (7, 5)) == (7, 5)


def test_the_advice_names_the_boards_size() -> None:
    image = filmed(8, 6, tilt=15)
    said = why_not_found([image], Board("chessboard", 9, 6, 0.03))
    assert "there is one of 8 × 6 squares" in said
    assert "not inner corners" in why_not_found([image], Board("chessboard", 7, 5, 0.03))
    assert "nor any other board" in why_not_found([np.full((120, 160), 90, np.uint8)], Board("chessboard", 7, 5, 0.03))


@pytest.mark.slow
@pytest.mark.skipif(not POSE2SIM.is_dir(), reason="the recordings are not here")
@pytest.mark.parametrize(
    ("name", "board"),
    [
        ("int_cam01_img/cam01_01_int.jpg", Board("chessboard", 8, 5, 0.06)),
        ("int_cam01_img/cam01_02_int.jpg", Board("chessboard", 8, 5, 0.06)),
        ("int_cam01_img/cam01_06_int.jpg", Board("chessboard", 8, 5, 0.06)),
        ("int_cam04_img/cam04_05_int.jpg", Board("chessboard", 8, 5, 0.06)),
    ],
)
def test_photographs_that_one_detector_misses_are_found(name: str, board: Board) -> None:
    image = cv2.imread(str(POSE2SIM / name), cv2.IMREAD_GRAYSCALE)
    view = BoardDetector(board).update(image, "a", 0)
    assert view is not None
    assert len(view.ids) == 28


@pytest.mark.slow
@pytest.mark.skipif(not CHARUCO.is_dir(), reason="the recordings are not here")
def test_the_advice_is_right_on_photographs() -> None:
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(CHARUCO.glob("cam_0*.jpg"))[1:4]]
    assert "there is one of 10 × 7 squares" in why_not_found(images, Board("chessboard", 8, 5, 0.06))
