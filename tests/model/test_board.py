from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocapella.errors import InputError, SettingsError
from mocapella.model.board import Board, load_board

GOOD = 'kind = "charuco"\ncolumns = 4\nrows = 5\nsquare_m = 0.054\n'


def test_corners_go_along_the_rows() -> None:
    board = Board("chessboard", 4, 3, 0.1)
    assert board.corners == 6
    np.testing.assert_allclose(board.corners_m[[0, 1, 3]], [[0.1, 0.1, 0], [0.2, 0.1, 0], [0.1, 0.2, 0]])


def test_only_a_symmetric_chessboard_looks_the_same_when_turned() -> None:
    assert Board("chessboard", 8, 6, 0.1).turnable
    assert not Board("chessboard", 9, 6, 0.1).turnable
    assert not Board("charuco", 8, 6, 0.1).turnable


def test_a_board_is_read(tmp_path: Path) -> None:
    path = tmp_path / "board.toml"
    path.write_text(GOOD + "inverted = true\n")
    assert load_board(path) == Board("charuco", 4, 5, 0.054, inverted=True)


def test_caliscopes_board_is_read(camera_recordings: Path) -> None:
    path = camera_recordings / "charuco_4cam" / "charuco.toml"
    assert load_board(path) == Board("charuco", 4, 5, 0.054, 0.75, "DICT_4X4_1000", inverted=True)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('kind = "charuco"\n', "field columns: is missing"),
        (GOOD + "colums = 3\n", "did you mean columns?"),
        (GOOD.replace("charuco", "circles"), "circles"),
        (GOOD.replace("0.054", "54"), "square_m is 54"),
        (GOOD + 'dictionary = "DICT_4X4"\n', "one of DICT_4X4_50"),
        (GOOD + "marker_ratio = 1.0\n", "marker_ratio is 1.0"),
        (GOOD.replace("5", "2"), "rows"),
        ("kind = ", "is no TOML"),
        ("columns = 4\nsquare_size_override_cm = 5.4\n", "is no charuco.toml of Caliscope"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "board.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load_board(path)
    assert says in str(error.value)
    assert str(path) in str(error.value)


def test_a_board_that_is_not_there_is_an_error_of_ours(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_board(tmp_path / "no.toml")
    with pytest.raises(SettingsError, match="columns"):
        Board("charuco", 2, 5, 0.05)
