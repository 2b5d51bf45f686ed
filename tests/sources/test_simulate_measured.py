"""Sensors that are as wrong as real ones were measured to be."""

from __future__ import annotations

import dataclasses
import math
from importlib.resources import files

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_simulate_sensor import same

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.model.observations import JointState
from mocapella.sources.simulate import Room, SensorSettings, SimulatedSensor, build_room, scene_settings
from mocapella.sources.simulate.body import BODY, JOINT, facing
from mocapella.sources.simulate.measured import (
    KIND,
    Course,
    Errors,
    errors_from_json,
    errors_to_json,
    measured_errors,
    spline_weights,
    toward_sensor,
    view_axes,
)

EYE = np.array([0.0, 1.0, 0.0])
MIRROR = list(BODY.mirror)


def measured(name: str, *, seed: int = 0) -> Room:
    scene = scene_settings(name)
    sensors = tuple(dataclasses.replace(sensor, errors=KIND) for sensor in scene.sensors)
    return build_room(dataclasses.replace(scene, sensors=sensors, seed=seed))


def somebody(alpha: float) -> np.ndarray:
    """(1, 25, 3) who stands 2.5 m before the lens and is turned by α from the direction to it."""
    body = build_room(scene_settings("stand")).positions_at(0)[0]
    forward = facing(body)
    turn = rotation_about_y(math.pi + alpha - math.atan2(forward[0], forward[2]))
    centred = body - np.array([body[JOINT["SpineMid"], 0], 0.0, body[JOINT["SpineMid"], 2]])
    return apply(rigid(turn, (0.0, 0.0, 2.5)), centred)[None]


def put_on(errors: Errors, alpha: float, noise: float = 0.0, chance: float = 0.5) -> tuple[np.ndarray, bool]:
    body = somebody(alpha)
    all_seen = np.ones(body.shape[:2], dtype=bool)
    given = np.full(body.shape, noise), np.zeros(1), np.array([chance])
    seen, mirrored = errors.put_on(body, EYE, all_seen, given)
    return seen[0], bool(mirrored[0])


def reported(seen: np.ndarray, mirrored: bool) -> float:
    """Yaw that the labels say, from the direction to the sensor [deg]."""
    yaw = math.atan2(*facing(seen[MIRROR] if mirrored else seen)[[0, 2]])
    return math.degrees(wrap(yaw - toward_sensor(seen, EYE)))


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_the_splines_weights_keep_the_variance_and_join_without_a_step(part: float) -> None:
    weights = spline_weights(part)
    assert (weights >= 0).all()
    assert (weights**2).sum() == pytest.approx(1)
    assert spline_weights(1 - 1e-9)[1:] == pytest.approx(spline_weights(0.0)[:3], abs=1e-6)


@given(st.floats(-math.pi, math.pi))
def test_the_axes_of_a_view_are_right_handed_and_point_to_the_sensor(toward: float) -> None:
    axes = view_axes(np.array(toward))
    assert axes.T @ axes == pytest.approx(np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[:, 2] == pytest.approx([math.sin(toward), 0, math.cos(toward)])


def test_no_sensor_reports_a_back_and_what_it_reports_is_compressed() -> None:
    errors = measured_errors()
    turned = {degrees: reported(*put_on(errors, math.radians(degrees))) for degrees in range(-180, 181, 15)}
    assert max(abs(yaw) for yaw in turned.values()) < 100
    assert all(0 < turned[degrees] < degrees for degrees in (30, 45, 60, 75, 90))
    assert not put_on(errors, math.radians(60))[1]
    assert put_on(errors, math.radians(178))[1]


@settings(max_examples=25)
@given(st.floats(0.05, 3.0), st.floats(0.0, 1.0))
def test_left_and_right_are_alike(alpha: float, chance: float) -> None:
    """Somebody who is turned the other way is seen in a mirror."""
    errors = measured_errors()
    one, is_mirrored = put_on(errors, alpha, chance=chance)
    other, is_too = put_on(errors, -alpha, chance=chance)
    flipped = (other * [-1, 1, 1])[MIRROR]
    assert is_mirrored == is_too
    # The body itself breathes a little askew.
    assert np.linalg.norm(one - flipped, axis=-1).max() < 0.08


def test_noise_is_as_wide_as_measured_and_hidden_joints_are_worse() -> None:
    errors = measured_errors()
    widths = np.linalg.norm(put_on(errors, 0.1, noise=1.0)[0] - put_on(errors, 0.1)[0], axis=-1)
    assert widths == pytest.approx(errors.sd_m[:, 0, 0] * math.sqrt(3))
    limbs = [JOINT[name] for name in ("ElbowLeft", "HandLeft", "KneeRight", "AnkleRight")]
    assert (errors.sd_m[limbs, 1] > errors.sd_m[limbs, 0]).all()
    assert np.diff(errors.sd_m[limbs, 0]).min() > 0  # front, side, back


def test_noise_in_time_has_variance_one_and_who_stands_has_less() -> None:
    errors = measured_errors()
    course = Course(errors, np.array([3, 1], dtype=np.uint64), 4)
    rng = np.random.default_rng(0)
    instants = np.arange(0, 400_000_000_000, 900_000_000)
    values = {
        speed: np.array(
            [errors.noise(course.splines(int(t)), rng.normal(size=(4, 25, 3)), np.full(4, speed))[0] for t in instants]
        )
        for speed in (0.0, 1.0)
    }
    smooth = errors.white < 0.01
    assert values[1.0][:, :, smooth].std() == pytest.approx(1, abs=0.06)
    assert values[0.0].std() < 0.7 * values[1.0].std()
    soon = course.splines(10_000_000_000), course.splines(10_005_000_000)
    assert np.abs(soon[1] - soon[0]).max() < 0.4


@pytest.mark.parametrize("sensor", ["front", "right"])
def test_a_start_in_the_middle_gives_the_same_frames(sensor: str) -> None:
    room = measured("walk")
    whole = list(SimulatedSensor(room, sensor).frames(7.0, 11.0))
    part = list(SimulatedSensor(room, sensor).frames(9.5, 11.0))
    tail = whole[-len(part) :]
    free = ("sequence", "tracking_ids")
    assert len(part) > 40
    assert all(same(a, b, without=free) for a, b in zip(tail, part, strict=True))


def test_another_seed_is_wrong_in_another_way_and_every_sensor_in_its_own() -> None:
    one, other = (next(SimulatedSensor(measured("stand", seed=seed), 1).frames(2.0)).frame for seed in (0, 1))
    assert not np.array_equal(one.positions, other.positions)
    room = measured("stand")
    tilts = [next(SimulatedSensor(room, n).frames(1.0)).frame.tilt for n in (1, 2)]
    errors = [tilt - math.radians(s.tilt_deg) for tilt, s in zip(tilts, room.settings.sensors, strict=False)]
    assert errors[0] != errors[1]
    assert max(map(abs, errors)) < math.radians(4)


@pytest.mark.slow
def test_people_are_lost_as_often_as_measured_and_come_back_with_another_id() -> None:
    data = measured_errors().data
    course = Course(measured_errors(), np.array([1, 1], dtype=np.uint64), 300)
    instants = np.arange(0, 60_000_000_000, 100_000_000)
    lost = np.array([course.lost(int(t)) for t in instants])
    expected = data.losses_per_min / 60 * np.mean(data.loss_s)
    assert lost.mean() == pytest.approx(expected, rel=0.3)
    often = Errors(msgspec.structs.replace(data, losses_per_min=6.0, loss_s=[1.0]))
    frames = [item.frame for item in SimulatedSensor(measured("stand"), "front", often).frames(0.0, 21.0)]
    assert {frame.bodies for frame in frames} == {0, 1}
    assert len({int(i) for frame in frames for i in frame.tracking_ids}) > 1


def test_joints_are_lost_as_often_as_measured() -> None:
    data = measured_errors().data
    often = Errors(msgspec.structs.replace(data, joint_lost=0.25, losses_per_min=0.0))
    items = [item.frame.states for item in SimulatedSensor(measured("stand"), "front", often).frames(0.0, 2.0)]
    assert (np.array(items) == JointState.NOT_TRACKED).mean() == pytest.approx(0.25, abs=0.04)


def test_the_file_says_what_it_was_measured_on_and_by_which_command() -> None:
    text = files("mocapella.sources.simulate").joinpath("data", "kinect_v2_measured.json").read_text(encoding="utf-8")
    errors = errors_from_json(text, "file")
    assert errors_to_json(errors.data) == text
    assert {"recordings", "participants", "command", "by_placement"} <= set(errors.data.measured_on)


@pytest.mark.parametrize(
    "change", [{"bias_m": [[[0.0]]]}, {"share": [1.0]}, {"mirrored": [0.0]}, {"white_m": [0.0]}, {"loss": 1}]
)
def test_a_file_that_is_none_is_refused_and_says_how_to_make_one(change: dict[str, object]) -> None:
    data = msgspec.json.decode(errors_to_json(measured_errors().data)) | change
    with pytest.raises(InputError, match="mocapella lab train sensor-errors"):
        errors_from_json(msgspec.json.encode(data), "here.json")


def test_another_kind_of_errors_is_refused() -> None:
    with pytest.raises(SettingsError, match=KIND):
        SensorSettings("front", errors="perfect")
