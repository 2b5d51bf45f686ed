"""Where the rig begins: which views are used, a camera by itself, and what several views agree on."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, film

from mocapella.calibration.board_views import LEAST_VIEWS, _directions, board_poses, motion_between, one_camera, usable
from mocapella.errors import CalibrationError
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import exp_twist
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera

WIDE = Board("charuco", 9, 9, 0.03)
ACROSS = WIDE.columns - 1
PINHOLE = np.array([900.0, 905.0, 630.0, 350.0, 0, 0, 0, 0, 0])


def seen(ids: list[int]) -> BoardView:
    return BoardView("a", 0, SIZE, np.array(ids), np.zeros((len(ids), 2)))


def test_a_view_is_of_six_corners_at_least_on_two_rows_and_two_columns() -> None:
    two_rows = [0, 1, 2, ACROSS, ACROSS + 1, ACROSS + 2]
    assert usable(seen(two_rows), WIDE)
    assert not usable(seen(two_rows[:-1]), WIDE)
    assert usable(seen([k + j * ACROSS for k in range(2) for j in range(3)]), WIDE)
    assert not usable(seen(list(range(ACROSS, 2 * ACROSS))), WIDE)  # one row
    assert not usable(seen([3 + j * ACROSS for j in range(ACROSS)]), WIDE)  # one column


def test_a_lens_needs_three_views_and_one_that_is_given_stays() -> None:
    views = [view for view in film(cameras=1, instants=8).views if usable(view, BOARD)]
    assert len(views) > LEAST_VIEWS
    one_camera(views[:LEAST_VIEWS], BOARD)
    with pytest.raises(CalibrationError, match=f"in {LEAST_VIEWS - 1} pictures, and a lens needs {LEAST_VIEWS}"):
        one_camera(views[: LEAST_VIEWS - 1], BOARD)
    known = one_camera(views[:1], BOARD, Camera("c0", SIZE, PINHOLE))
    np.testing.assert_array_equal(known.lens, PINHOLE)
    assert not known.covariance.any()
    free = one_camera(views, BOARD)
    assert free.lens[0] == pytest.approx(900, rel=0.01)
    assert (np.diag(free.covariance) > 0).all()


def test_a_corner_beyond_the_lens_model_has_the_direction_without_distortion() -> None:
    barrel = PINHOLE + np.array([0, 0, 0, 0, -0.6, 0, 0, 0, 0])
    view = BoardView("a", 0, SIZE, np.arange(3), np.array([[630.0, 350.0], [730.0, 350.0], [1270.0, 710.0]]))
    found = _directions(view, barrel)
    np.testing.assert_allclose(found[0], 0.0, atol=1e-12)
    assert found[1, 0] > 100 / 900
    np.testing.assert_allclose(found[2], [640 / 900, 360 / 905])


def test_a_minority_of_wrong_views_does_not_matter_to_the_motion_between_cameras_nor_to_a_board() -> None:
    rng = np.random.default_rng(0)
    T_a_b = exp_twist([0.5, 0.1, -0.3, 0.1, 0.7, 0.0])
    of_a = {k: exp_twist(rng.uniform(-0.3, 0.3, 6) + np.array([0, 0, 1.5, 0, 0, 0])) for k in range(7)}
    of_b = {k: inverse(T_a_b) @ T for k, T in of_a.items() if k != 6} | {9: np.eye(4)}
    for k in (0, 3):
        of_b[k] = of_b[k] @ exp_twist([0, 0, 0, 0.5, 0.4, 0])
    found, off_m = motion_between(of_a, of_b, BOARD.corners_m)
    np.testing.assert_allclose(found, T_a_b, atol=1e-9)
    assert off_m < 1e-9
    of_c = dict(of_a)
    placed = {"a": np.eye(4), "b": inverse(T_a_b), "c": np.eye(4)}
    boards = board_poses({"b": of_b, "a": of_a, "c": of_c}, placed, BOARD.corners_m, [0, 1, 6])
    np.testing.assert_allclose(boards, [of_a[0], of_a[1], of_a[6]], atol=1e-9)
