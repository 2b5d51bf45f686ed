"""A stated tilt is turned round for a sensor that is upside down, refused if people refute it, and used otherwise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walking_people import FRONT, RATE_HZ, SIDE, Sensor, Walker, standing_at

from mocapella.calibration.floor import Floor, floor_of_pose
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.stated_pose import (
    ENOUGH_S,
    MOST_OFF,
    MOST_S,
    SURE_SD,
    head_up_s,
    is_upside_down,
    oriented,
    refuted,
    vertical,
)
from mocapella.geometry.rigid import rigid, rotation_about_z
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.session import SensorPose

ROLLED = rigid(rotation_about_z(np.pi), np.zeros(3))
"""From the camera space of a sensor that is upside down to that of the same sensor upright."""
tilts = st.floats(-math.pi, math.pi)


def bodies(T_world_sensor: np.ndarray, tilt_deg: float = 0.0) -> Bodies:
    """One person who stands before a sensor, and leans to the side by an angle."""
    seen = Sensor("a", T_world_sensor, noise=0.01).see({1: Walker(speed=0.0)}, 0.0)
    seen.positions[:] = seen.positions @ rotation_about_z(np.radians(tilt_deg)).T
    return seen


@given(tilts, st.floats(0.1, 3.0))
def test_an_upside_down_sensor_has_the_opposite_vertical_across_its_axis_and_the_same_elevation(
    tilt: float, height: float
) -> None:
    pose = SensorPose(tilt, height)
    turned = oriented(pose, upside_down=True)
    np.testing.assert_allclose(vertical(turned), vertical(pose) * [1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(floor_of_pose(turned.tilt, turned.height).up, vertical(turned), atol=1e-12)
    assert turned.height == height
    again = oriented(turned, upside_down=True)
    np.testing.assert_allclose(vertical(again), vertical(pose), atol=1e-12)
    assert oriented(pose, upside_down=False) is pose


@pytest.mark.parametrize("tilt_deg", [-15.0, 0.0, 15.0])
def test_the_head_of_people_tells_up_from_down_at_any_tilt(tilt_deg: float) -> None:
    pose, upright = SensorPose(math.radians(tilt_deg), 1.4), standing_at(0.0, 0.0, height=1.4, tilt_deg=tilt_deg)
    for T, sign in ((upright, 1.0), (upright @ ROLLED, -1.0)):
        evidence_s, seen = 0.0, bodies(T)
        for _ in range(round(2 * MOST_S * RATE_HZ)):
            evidence_s = head_up_s(evidence_s, seen, pose, 1 / RATE_HZ)
            assert is_upside_down(evidence_s) == (evidence_s <= -ENOUGH_S)
        assert evidence_s == pytest.approx(sign * MOST_S)


@pytest.mark.parametrize("lean_deg", [60.0, 90.0, 120.0])
def test_who_lies_tells_nothing(lean_deg: float) -> None:
    assert head_up_s(1.5, bodies(FRONT, lean_deg), SensorPose(), 0.03) == 1.5


def test_nobody_inferred_joints_and_frames_without_duration_tell_nothing() -> None:
    seen, none = bodies(FRONT), Sensor("a", FRONT).see({}, 0.0)
    assert head_up_s(0.5, none, SensorPose(), 0.03) == 0.5
    for no_duration in (0.0, -0.03, np.nan):
        assert head_up_s(0.5, seen, SensorPose(), no_duration) == 0.5
    assert head_up_s(0.5, seen, SensorPose(), 9.0) == pytest.approx(0.6)
    seen.states[:] = JointState.INFERRED
    assert head_up_s(0.5, seen, SensorPose(), 0.03) == 0.5
    for nowhere in (np.nan, np.inf, 0.0):
        lost = bodies(FRONT)
        lost.positions[:, lost.topology.parts["head"]] = nowhere
        assert head_up_s(0.5, lost, SensorPose(), 0.03) == 0.5


def test_who_stands_on_the_hands_turns_no_sensor_round_that_was_seen_upright() -> None:
    evidence_s, seen = MOST_S, bodies(FRONT @ ROLLED)
    for _ in range(round(0.9 * MOST_S * RATE_HZ)):
        evidence_s = head_up_s(evidence_s, seen, SensorPose(), 1 / RATE_HZ)
    assert not is_upside_down(evidence_s)


@pytest.mark.parametrize(
    ("off_deg", "sd", "wanted"),
    [(0.0, 0.02, False), (25.0, 0.02, False), (35.0, 0.02, True), (90.0, 0.02, True), (90.0, 2 * SURE_SD, False)],
)
def test_only_a_floor_on_which_people_walked_refutes_a_stated_tilt(off_deg: float, sd: float, wanted: bool) -> None:
    stated = floor_of_pose(0.0, 1.0)
    turn = rotation_about_z(np.radians(off_deg))
    assert refuted(stated, Floor(turn @ stated.up, 1.0, sd, 0.01)) is wanted
    assert not refuted(stated, None)
    assert np.degrees(MOST_OFF) == pytest.approx(30.0)


def test_evidence_and_certainty_count_from_their_limits_on() -> None:
    assert is_upside_down(-ENOUGH_S)
    assert not is_upside_down(float(np.nextafter(-ENOUGH_S, 0)))
    stated, lying = floor_of_pose(0.0, 1.0), np.array([1.0, 0.0, 0.0])
    assert not refuted(stated, Floor(lying, 1.0, SURE_SD, 0.01))
    assert refuted(stated, Floor(lying, 1.0, float(np.nextafter(SURE_SD, 0)), 0.01))


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("rolled", [("a",), ("b",), ("a", "b"), ()])
def test_a_rig_stands_upright_whichever_of_its_sensors_are_upside_down(rolled: tuple[str, ...], stated: bool) -> None:
    sensors = [
        Sensor(name, T @ ROLLED if name in rolled else T, noise=0.01, phase=0.011 * (name == "b"))
        for name, T in (("a", FRONT), ("b", SIDE))
    ]
    calibration, pose = PeopleCalibration(), SensorPose(0.0, 1.0) if stated else None
    conditions = set()
    for k in range(round(6 * RATE_HZ)):
        for sensor in sensors:
            t = k / RATE_HZ + sensor.phase
            state = calibration.update(sensor.see({1: Walker(speed=0.7)}, t), round(1e9 * (100 + t)), pose=pose)
            conditions |= {text for text in state.conditions if "upright" in text}
        if k == RATE_HZ / 2:
            up = state.sensors["a"].T_world_sensor[1, :3] @ sensors[0].T_world_sensor[1, :3]
            assert up > 0.8, "half a second is enough to tell up from down"
    assert not conditions
    for sensor in sensors:
        found = state.sensors[sensor.name]
        assert found.trusted
        assert found.T_world_sensor[1, :3] @ sensor.T_world_sensor[1, :3] > np.cos(np.radians(5.0))
