from __future__ import annotations

import numpy as np
import pytest

from mocapella.calibration.parallel_alignment import PairAlignment, align_pair
from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.camera import Camera, PlacedCamera

LENS = np.array([530.0, 530.0, 319.5, 239.5, 0, 0, 0, 0, 0])


def pair(turned_deg: list[float], at: tuple[float, float, float] = (0.075, 0, 0)) -> tuple[PlacedCamera, PlacedCamera]:
    """The second camera turned about its own axes (x right, y down, z forwards) and at a place in the first's space."""
    T_first_second = exp_twist(np.r_[0, 0, 0, np.radians(turned_deg)])
    T_first_second[:3, 3] = at
    unknown = np.full((6, 6), np.nan)
    T_first_world = rigid(exp_twist(np.array([0, 0, 0, 0.3, -0.2, 0.1]))[:3, :3], [1.0, 2, 3])
    camera = Camera("a", (640, 480), LENS)
    return (
        PlacedCamera(camera, T_first_world, unknown),
        PlacedCamera(camera, inverse(T_first_second) @ T_first_world, unknown),
    )


def test_a_parallel_pair_needs_no_turning() -> None:
    found = align_pair(*pair([0, 0, 0]))
    assert found.baseline_m == pytest.approx(0.075)
    assert found.axes_deg == pytest.approx(0, abs=1e-5)
    assert found.vertical_px == pytest.approx(0, abs=1e-8)
    assert found.advice("left", "right") == []


@pytest.mark.parametrize(
    ("turned_deg", "field", "angle", "says"),
    [
        (
            [0, 2, 0],
            "turn_right_deg",
            -2,
            "turn camera right to the left by 2.0°",
        ),  # about y (down): to the right, so turn it back
        ([0, -2, 0], "turn_right_deg", 2, "turn camera right to the right by 2.0°"),
        ([1, 0, 0], "turn_down_deg", 1, "turn camera right down by 1.0°"),  # about x (right): upwards
        ([-1, 0, 0], "turn_down_deg", -1, "turn camera right up by 1.0°"),
        ([0, 0, 3], "roll_clockwise_deg", -3, "turn camera right counter-clockwise, seen from behind it by 3.0°"),
    ],
)
def test_the_camera_and_the_way_to_turn_it_are_named(
    turned_deg: list[float], field: str, angle: float, says: str
) -> None:
    found = align_pair(*pair(turned_deg))
    assert getattr(found, field) == pytest.approx(angle, abs=1e-6)
    assert found.advice("left", "right") == [says]


def test_a_pitch_of_one_degree_is_nine_pixels_of_vertical_disparity_in_the_middle() -> None:
    found = align_pair(*pair([1, 0, 0]))
    assert found.axes_deg == pytest.approx(1)
    middle = 530 * np.tan(np.radians(1))
    assert middle < found.vertical_px < 1.5 * middle


def test_height_and_depth_are_those_of_the_second() -> None:
    found = align_pair(*pair([0, 0, 0], (0.075, -0.002, 0.003)))
    assert found.higher_mm == pytest.approx(2)
    assert found.ahead_mm == pytest.approx(3)


def test_swapped_cameras_are_told() -> None:
    found = align_pair(*pair([0, 0, 0], (-0.075, 0, 0)))
    assert found.swapped
    assert found.advice("left", "right") == ["camera right stands to the left of camera left: exchange them"]


@pytest.mark.parametrize("roll_deg", [-4.0, 0.5, 30.0])
def test_a_roll_moves_the_corners_of_the_picture_most(roll_deg: float) -> None:
    found = align_pair(*pair([0, 0, roll_deg]))
    roll = np.radians(abs(roll_deg))
    assert found.vertical_px == pytest.approx(319.5 * np.sin(roll) + 239.5 * (1 - np.cos(roll)), rel=1e-9)


def test_a_yaw_moves_corners_and_the_middle_stays() -> None:
    """A corner is as much higher as it is farther from the plane through the second camera."""
    found, yaw = align_pair(*pair([0, 3, 0])), np.radians(3)
    farther = np.cos(yaw) - 319.5 / 530 * np.sin(yaw)
    assert found.vertical_px == pytest.approx(239.5 * (1 / farther - 1), rel=1e-9)


def alignment(**values: float) -> PairAlignment:
    level = dict.fromkeys(("turn_right_deg", "turn_down_deg", "roll_clockwise_deg", "higher_mm", "ahead_mm"), 0.0)
    return PairAlignment(
        **{"baseline_m": 0.1, "axes_deg": 0.0, "vertical_px": 9.0, "swapped": False, **level, **values}
    )


def test_a_pixel_needs_no_turning_and_a_twentieth_of_a_degree_is_told() -> None:
    assert alignment(turn_down_deg=1.0, vertical_px=1.0).advice("a", "b") == []
    assert alignment(turn_down_deg=1.0, vertical_px=1.001).advice("a", "b") == ["turn camera b down by 1.0°"]
    assert alignment(turn_right_deg=-0.05).advice("a", "b") == ["turn camera b to the left by 0.1°"]
    assert alignment(turn_right_deg=-0.049, roll_clockwise_deg=0.049).advice("a", "b") == []


def test_a_camera_straight_above_the_other_is_not_swapped_with_it() -> None:
    camera, unknown, below = Camera("a", (640, 480), LENS), np.full((6, 6), np.nan), np.eye(4)
    below[1, 3] = 0.1
    first, second = (PlacedCamera(camera, T, unknown) for T in (np.eye(4), below))
    found = align_pair(first, second)
    assert found.higher_mm == pytest.approx(100)
    assert not found.swapped
