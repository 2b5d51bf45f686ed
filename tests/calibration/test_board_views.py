"""Where the rig begins: which views are used, a camera by itself, and what several views agree on."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, film

from mocapella.calibration import board_views
from mocapella.calibration.board_views import (
    LEAST_VIEWS,
    _directions,
    _first_lens,
    board_poses,
    motion_between,
    one_camera,
    places,
    usable,
)
from mocapella.errors import CalibrationError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse
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


def test_a_board_is_where_most_views_have_it_though_the_wrong_one_is_the_nearest() -> None:
    far, near = exp_twist([0.2, 0, 2.0, 0.2, 0, 0]), exp_twist([0, 0, 0.3, 0, 0, 0])
    for wrong in "abc":
        poses = {name: {5: near if name == wrong else far} for name in "abc"}
        found = board_poses(poses, dict.fromkeys("abc", np.eye(4)), BOARD.corners_m, [5])
        np.testing.assert_allclose(found, [far])


def test_the_first_lens_is_that_of_views_without_distortion_and_a_usual_one_where_they_leave_it_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    size, plane = np.array(SIZE, np.float64), BOARD.corners_m[:, :2]
    centred = np.array([900.0, 900.0, 639.5, 359.5, 0, 0, 0, 0, 0])
    boards = exp_twist([[-0.1, -0.1, 1, 0.4, 0, 0], [-0.1, -0.1, 1, 0, 0.5, 0], [-0.1, -0.1, 1.2, -0.3, -0.3, 0.2]])
    views = [
        BoardView("a", k, SIZE, np.arange(BOARD.corners), np.asarray(project(apply(T, BOARD.corners_m), centred)))
        for k, T in enumerate(boards)
    ]
    np.testing.assert_allclose(_first_lens(views, plane, size), centred, atol=1e-4)
    for f, part in ((0.19, 0.9), (0.21, 0.21), (9.9, 9.9), (10.1, 0.9), (np.nan, 0.9)):
        monkeypatch.setattr(board_views, "focal_length", lambda *_, f=f: f * SIZE[0])
        found = _first_lens(views, plane, size)
        np.testing.assert_allclose(found[:4], [part * SIZE[0], part * SIZE[0], 639.5, 359.5])


def seen_by(T: dict[str, np.ndarray], **instants: range) -> dict[str, dict[int, np.ndarray]]:
    """Boards as cameras at these ``T_camera_first`` see them at some instants."""
    rng = np.random.default_rng(1)
    boards = [exp_twist(rng.uniform(-0.3, 0.3, 6) + np.array([0, 0, 1.5, 0, 0, 0])) for _ in range(20)]
    return {name: {k: T[name] @ boards[k] for k in of} for name, of in instants.items()}


def test_cameras_are_chained_by_the_pairs_that_share_most() -> None:
    rng = np.random.default_rng(2)
    T = {name: exp_twist(rng.uniform(-0.5, 0.5, 6)) for name in "abcd"} | {"a": np.eye(4)}
    poses = seen_by(T, a=range(8), b=range(2, 12), c=range(7, 15), d=range(13, 18))
    poses["c"][7] = poses["c"][7] @ exp_twist([0, 0, 0, 0.5, 0, 0])  # all that a and c share
    found = places(poses, BOARD.corners_m)
    assert list(found) == ["a", "b", "c", "d"]
    for name, placed in found.items():
        np.testing.assert_allclose(placed, T[name], atol=1e-9)
    backwards = places({name: poses[name] for name in "dcba"}, BOARD.corners_m)
    for name, placed in backwards.items():
        np.testing.assert_allclose(placed, T[name] @ inverse(T["d"]), atol=1e-9)


def test_cameras_that_never_see_the_board_with_the_others_are_named() -> None:
    T = dict.fromkeys("abcd", np.eye(4))
    alone = seen_by(T, a=range(5), b=range(5), c=range(5, 9))
    with pytest.raises(
        CalibrationError, match="camera c never sees the board at the same instant as cameras a, b: none"
    ):
        places(alone, BOARD.corners_m)
    two = seen_by(T, a=range(5), c=range(5, 9), d=range(5, 9))
    with pytest.raises(
        CalibrationError, match="cameras c, d: none never sees the board at the same instant as camera a:"
    ):
        places(two, BOARD.corners_m)
