"""The score of a calibration in place: where sensors and person are, and when which error is measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.evaluation_sessions import KINECT

from mocapella.calibration.people_state import CalibratedSensor
from mocapella.evaluation.calibration_in_place import (
    CENTRE_M,
    _error,
    in_place_room,
    measured_sensor,
    run_in_place,
)
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.geometry.twists import adjoint, exp_twist
from mocapella.model.observations import Arrival

AT_PERSON = np.array([0.1, -0.2, 2.8])


@pytest.mark.parametrize("azimuth_deg", [-120.0, -30.0, 0.0, 45.0, 90.0, 180.0])
def test_a_sensor_looks_at_the_person_from_as_far_away_as_all_others(azimuth_deg: float) -> None:
    sensor = measured_sensor("a", azimuth_deg, height=1.1, tilt_deg=0.0, phase_s=0.0, latency_s=0.05)
    x, z = CENTRE_M
    seen = apply(inverse(sensor.T_world_sensor), np.array([[x, 1.1, z]]))[0]
    np.testing.assert_allclose(seen, [0, 0, z], atol=1e-9)


@pytest.mark.parametrize("angle_deg", [30.0, 90.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_person_faces_the_first_sensor_or_the_middle_of_both(angle_deg: float, seed: int) -> None:
    room = in_place_room("stand", angle_deg, seed, seconds=20.0)
    true = room.positions_at(10**9)[0]
    across = true[KINECT.index("ShoulderLeft")] - true[KINECT.index("ShoulderRight")]
    facing = np.degrees(np.arctan2(-across[2], across[0]))
    sights = [
        np.degrees(np.arctan2(*(sensor.T_world_sensor[:3, 3] - [CENTRE_M[0], 0, CENTRE_M[1]])[[0, 2]]))
        for sensor in room.settings.sensors
    ]
    first, second = ((sight - facing + 180) % 360 - 180 for sight in sights)
    assert abs(first - second) == pytest.approx(angle_deg, abs=1e-6)
    assert abs(first) == pytest.approx(0 if seed == 0 else angle_deg / 2, abs=6)
    assert abs(second) == pytest.approx(angle_deg if seed == 0 else angle_deg / 2, abs=6)
    assert room.duration_s >= 25.0  # the exercise lasts longer than what is scored


def calibrated(name: str, T: Any, root: str = "a", trusted: bool = True) -> CalibratedSensor:
    return CalibratedSensor(name, T, 1e-4 * np.eye(6), root, None, trusted, "", "")


def test_a_turn_about_the_person_moves_nothing_there_and_a_shift_does() -> None:
    centre = rigid(np.eye(3), AT_PERSON)
    turn = centre @ exp_twist(np.radians([0, 0, 0, 0.3, 0.5, -0.2])) @ inverse(centre)
    T_true = rigid(rotation_about_y(0.5), [1.0, 0.2, 0.3])
    a = calibrated("a", np.eye(4))
    about = _error(2.0, a, calibrated("b", turn @ T_true), T_true, AT_PERSON)
    assert (about.at_s, about.position_m) == (2.0, pytest.approx(0.0, abs=1e-4))
    assert about.rotation_deg == pytest.approx(np.sqrt(0.38), rel=1e-6)
    shift = rigid(np.eye(3), [0.0, 0.03, 0.04])
    shifted = _error(2.0, a, calibrated("b", shift @ T_true), T_true, AT_PERSON)
    assert (shifted.position_m, shifted.rotation_deg) == pytest.approx((0.05, 0.0), abs=1e-9)


def test_errors_do_not_depend_on_the_world_of_the_method() -> None:
    T_true, off = rigid(rotation_about_y(0.5), [1.0, 0.2, 0.3]), exp_twist([0.01, 0.02, 0, 0.01, 0, 0.02])
    C = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-4
    errors = []
    for G in (np.eye(4), rigid(rotation_about_y(-1.2), [4.0, 1.0, -3.0])):
        turned = adjoint(G) @ C @ adjoint(G).T
        a = CalibratedSensor("a", G, np.zeros((6, 6)), "a", None, True, "", "")
        b = CalibratedSensor("b", G @ off @ T_true, turned, "a", None, True, "", "")
        errors.append(_error(1.0, a, b, T_true, AT_PERSON))
    for name in errors[0].__struct_fields__:
        assert getattr(errors[0], name) == pytest.approx(getattr(errors[1], name))


class Knows:
    """A tracker that knows the sensors as told from a time on; their frames arrive when they should."""

    def __init__(self, room: Any, from_s: float, off_m: float = 0.0, **wrong: Any) -> None:
        self.room, self.from_s, self.off_m, self.wrong, self.now_s = room, from_s, off_m, wrong, 0.0

    def update(self, arrival: Arrival) -> Any:
        latency_s = {sensor.name: sensor.latency_s for sensor in self.room.settings.sensors}
        self.now_s = arrival.at_ns / 1e9 - latency_s[arrival.frame.sensor]

    @property
    def calibrated_sensors(self) -> dict[str, CalibratedSensor]:
        a, b = (sensor.T_world_sensor for sensor in self.room.settings.sensors)
        off = rigid(np.eye(3), [0.0, self.off_m, 0.0])
        both = {"a": calibrated("a", a), "b": calibrated("b", off @ b, **self.wrong)}
        return both if self.now_s >= self.from_s - 1e-9 else {"a": both["a"]}


ROOM = in_place_room("stand", 60.0, 0)


def test_errors_are_those_at_the_times_asked_for_once_both_sensors_are_known() -> None:
    found = run_in_place(Knows(ROOM, 0.8, 0.02), ROOM, [0.5, 1.0, 1.2])
    assert found.calibrated_s == pytest.approx(0.8, abs=1 / 30)
    assert [error.at_s for error in found.errors] == pytest.approx([1.0, 1.2], abs=1 / 30)
    assert [error.position_m for error in found.errors] == pytest.approx([0.02, 0.02])
    assert found.errors[0].at_s == 1.0  # of the frame that is of just that time
    assert all(error.at_s >= at_s for error, at_s in zip(found.errors, (1.0, 1.2), strict=True))


@pytest.mark.parametrize("wrong", [{"root": "b"}, {"trusted": False}, None])
def test_sensors_of_two_worlds_or_without_trust_are_not_calibrated(wrong: Any) -> None:
    tracker = Knows(ROOM, 9.0) if wrong is None else Knows(ROOM, 0.0, **wrong)
    found = run_in_place(tracker, ROOM, [0.4])
    assert (found.calibrated_s, found.errors) == (np.inf, ())
