from __future__ import annotations

import numpy as np
import pytest
from support.walking_people import RATE_HZ, Sensor, Walker, standing_at

from mocapella.calibration.floor import (
    BACK_SD,
    FOOT_HEIGHT_M,
    FOOT_SD_M,
    FloorFromFeet,
    floor_of_pose,
    mean_floor,
)
from mocapella.calibration.floor_kernels import HEAD_SHARE
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_z
from mocapella.model.observations import JointState
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")

POSES = [
    standing_at(0.3, -0.2, 30.0, height=1.4, tilt_deg=-12.0),
    standing_at(0.0, 0.0, 0.0, height=0.6, tilt_deg=15.0),
]
MOUNTED = [*POSES, standing_at(0.0, 0.0, 0.0, height=1.1) @ rigid(rotation_about_z(np.pi), np.zeros(3))]
"""The last is upside down."""


class Stepper(Walker):
    """Walks for 0.6 s and stands for 0.6 s, so that feet stand."""

    def at(self, t: float) -> np.ndarray:
        return super().at(0.6 * (t // 1.2) + min(t % 1.2, 0.6))


@pytest.mark.parametrize("T_world_sensor", MOUNTED)
def test_the_floor_is_found_from_feet_under_a_tilted_sensor(T_world_sensor: np.ndarray) -> None:
    sensor, feet = Sensor("a", T_world_sensor, noise=0.01), FloorFromFeet()
    assert feet.floor() is None
    for i in range(round(20 * RATE_HZ)):
        feet.update(sensor.see({0: Stepper(speed=0.8)}, i / RATE_HZ), i / RATE_HZ)
    floor = feet.floor()
    assert floor is not None
    up = T_world_sensor[:3, :3].T @ [0.0, 1.0, 0.0]
    assert np.arccos(np.clip(floor.up @ up, -1, 1)) < np.radians(1.5)
    assert floor.height == pytest.approx(T_world_sensor[1, 3], abs=0.04)
    assert np.arccos(np.clip(floor.up @ up, -1, 1)) < 3 * floor.up_sd


def test_standing_still_is_enough_for_a_floor_and_it_is_less_sure() -> None:
    sensor = Sensor("a", POSES[0], noise=0.003)
    found = []
    for walker in (Walker(speed=0.0), Stepper(speed=0.8)):
        feet = FloorFromFeet()
        for i in range(round(20 * RATE_HZ)):
            feet.update(sensor.see({0: walker}, i / RATE_HZ), i / RATE_HZ)
        found.append(feet.floor())
    stands, walks = found
    assert stands is not None
    assert walks is not None
    assert stands.up_sd > 1.5 * walks.up_sd
    assert stands.height == pytest.approx(1.4, abs=0.08)


class Bent(Walker):
    """Stands with a trunk that leans forward by an angle, and with hips as far back that the body is in balance."""

    def __init__(self, lean_deg: float) -> None:
        super().__init__(speed=0.0)
        self.lean = np.radians(lean_deg)

    def at(self, t: float) -> np.ndarray:
        joints = super().at(t)
        root, head = joints[KINECT.parts["root"]], joints[KINECT.parts["head"]]
        trunk = joints[:, 1] > root[1]
        forward = np.cross(joints[KINECT.parts["shoulder_left"]] - joints[KINECT.parts["shoulder_right"]], [0, 1, 0])
        forward /= np.linalg.norm(forward)
        up = joints[trunk, 1:2] - root[1]
        joints[trunk] += np.sin(self.lean) * up * forward + (np.cos(self.lean) - 1) * up * [0, 1, 0]
        feet = np.mean([joints[KINECT.parts[side]] for side in ("foot_left", "foot_right")], axis=0)
        head, root = joints[KINECT.parts["head"]], joints[KINECT.parts["root"]]
        balance = (1 - HEAD_SHARE) * root + HEAD_SHARE * head
        raised = joints[:, 1] > feet[1] + 0.2
        joints[raised] += (feet - balance) * [1, 0, 1]
        return joints


@pytest.mark.parametrize("T_world_sensor", MOUNTED)
@pytest.mark.parametrize("lean_deg", [0.0, 30.0, 60.0, 85.0])
def test_whoever_stands_in_balance_tells_the_vertical_however_the_back_leans(
    T_world_sensor: np.ndarray, lean_deg: float
) -> None:
    sensor, feet = Sensor("a", T_world_sensor, noise=0.003), FloorFromFeet()
    for i in range(round(5 * RATE_HZ)):
        feet.update(sensor.see({0: Bent(lean_deg)}, i / RATE_HZ), i / RATE_HZ)
    floor = feet.floor()
    assert floor is not None
    assert np.degrees(np.arccos(np.clip(floor.up @ T_world_sensor[1, :3], -1, 1))) < 6


def test_what_is_inferred_or_not_there_says_nothing_of_the_floor() -> None:
    sensor, feet = Sensor("a", POSES[0]), FloorFromFeet()
    for i in range(200):
        seen = sensor.see({0: Walker(speed=0.0)}, i / RATE_HZ)
        seen.states[:] = JointState.INFERRED
        feet.update(seen, i / RATE_HZ)
        seen.states[:] = JointState.TRACKED
        seen.positions[:] = np.nan if i % 2 else 0.0
        feet.update(seen, i / RATE_HZ + 0.1)
    assert feet.floor() is None


@pytest.mark.parametrize("T_world_sensor", POSES)
def test_a_given_pose_makes_the_same_world_as_the_truth_but_for_place_and_heading(T_world_sensor: np.ndarray) -> None:
    tilt = np.arcsin(T_world_sensor[1, 2])
    T = floor_of_pose(float(tilt), float(T_world_sensor[1, 3])).T_level_sensor
    points = np.random.default_rng(0).normal(size=(20, 3))
    np.testing.assert_allclose(apply(T, points)[:, 1], apply(T_world_sensor, points)[:, 1], atol=1e-9)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0)
    np.testing.assert_allclose(T[[0, 2], 3], 0.0, atol=1e-12)


def test_a_sensor_that_looks_straight_down_still_has_a_world() -> None:
    T = floor_of_pose(-np.pi / 2, 2.5).T_level_sensor
    np.testing.assert_allclose(T @ [0, 0, 1.0, 1], [0, 1.5, 0, 1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0)


def test_several_sensors_floors_are_one() -> None:
    floors = [(inverse(POSES[0]) @ T, floor_of_pose(float(np.arcsin(T[1, 2])), float(T[1, 3]))) for T in POSES]
    floor = mean_floor(floors)
    np.testing.assert_allclose(floor.up, POSES[0][:3, :3].T @ [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(floor.height, 1.4, atol=1e-9)


def standing(points: np.ndarray, back: np.ndarray, weight: float = 1.0, back_s: float = 10.0) -> FloorFromFeet:
    """What is known from feet at points (n, 3), each of the same weight, and from backs of one direction."""
    xx = weight * points.T @ points
    sums = np.r_[weight * len(points), weight * points.sum(axis=0), xx[np.triu_indices(3)]]
    return FloorFromFeet(sums=sums, back=np.r_[back_s * back / np.linalg.norm(back), back_s])


def test_feet_all_over_the_floor_outweigh_backs_and_their_plane_is_exact() -> None:
    rng, up = np.random.default_rng(0), np.array([0.1, 0.95, 0.2])
    up /= np.linalg.norm(up)
    level = rng.uniform(-2, 2, (500, 3)) + np.array([0, 0, 3])
    points = level - np.outer(level @ up + 1.3 - FOOT_HEIGHT_M, up)
    floors = [standing(points, up + np.array([0.05, 0, -0.08]), 4.0, back_s).floor() for back_s in (1.0, 500.0)]
    for floor in floors:
        assert floor is not None
        np.testing.assert_allclose(floor.up, up, atol=1e-3)
        assert floor.height == pytest.approx(1.3, abs=0.003)
    np.testing.assert_allclose(floors[0].up, floors[1].up, atol=1e-12)  # backs have one weight, however long


def test_feet_in_one_spot_leave_the_vertical_to_the_backs_and_the_height_to_how_far_they_are() -> None:
    up = np.array([0.0, 0.8, 0.6])
    for spot, across in ((np.array([0.0, -2.0, -1.5]), 0.0), (np.array([3.0, -0.8, -0.6]), 3.0)):
        floor = standing(np.tile(spot, (5, 1)), 7.0 * up).floor()
        assert floor is not None
        np.testing.assert_allclose(floor.up, up, atol=1e-9)
        assert floor.height == pytest.approx(FOOT_HEIGHT_M - up @ spot)
        assert floor.up_sd == pytest.approx(np.sqrt(2) * BACK_SD, rel=1e-3)
        assert floor.height_sd == pytest.approx(np.hypot(FOOT_SD_M / np.sqrt(5), across * BACK_SD), rel=1e-3)


def test_a_floor_needs_feet_that_stood_for_a_second_and_a_back() -> None:
    feet, up = np.array([[0.3, -1.0, 2.0], [0.4, -1.0, 2.5]]), np.array([0.0, 1.0, 0.0])
    assert standing(feet, up).floor() is not None
    assert standing(feet, up, weight=0.999).floor() is None
    assert standing(feet[:1], up).floor() is None
    assert standing(feet, up, back_s=0.0).floor() is None


def test_the_known_floor_is_renewed_whenever_feet_have_stood_for_a_twentieth_longer() -> None:
    sensor, feet, renewed = Sensor("a", POSES[0], noise=0.003), FloorFromFeet(), [0.0]
    for i in range(60):
        feet.update(sensor.see({0: Walker(speed=0.0)}, i / 10), i / 10)
        assert feet.sums[0] <= 1.05 * feet.grown
        if feet.grown != renewed[-1]:
            assert feet.grown > 1.05 * renewed[-1]
            renewed.append(feet.grown)
    assert len(renewed) > 15
