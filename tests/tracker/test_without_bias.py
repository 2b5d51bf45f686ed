"""The joint bias in the method `default`: what is taken off, from whom, and what that is worth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from support.walking_people import FRONT, KINECT_V2, MIRROR, Sensor, Walker, standing_at

from mocapella.errors import SettingsError
from mocapella.evaluation.fused_metrics import facing_yaw
from mocapella.fusion.joint_bias import TERMS, JointBiasModel, shipped_model, symmetric
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.topology import topology
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.default_settings import DefaultSettings

SIDE = standing_at(-2.0, 0.8, 45.0)
PLACES = {"front": FRONT, "side": SIDE}
RATE = 30.0
ROOT = KINECT_V2.parts["root"]
WEIGHTS = 0.03 * symmetric(np.random.default_rng(5).normal(size=(TERMS, 25, 3)), KINECT_V2.mirror)
WEIGHTS[6:] /= 5  # terms of distance and velocity
MODEL = JointBiasModel("kinect_v2", WEIGHTS)


def as_asked(walker: Walker, t: float, T_world_sensor: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """The true facing, place and velocity in a sensor's space."""
    back = inverse(T_world_sensor)
    body, later = apply(back, walker.at(t)), apply(back, walker.at(t + 0.01))
    place = body[ROOT]
    return (
        float(facing_yaw(body) - np.arctan2(-place[0], -place[2])),
        place,
        (later - body)[ROOT] / 0.01,
    )


def arrivals(
    walker: Walker, seconds: float, model: JointBiasModel | None, mirrored: Mapping[str, bool] | None = None
) -> list[Arrival]:
    """What two sensors see; a model's bias is in it."""
    sensors = [Sensor(name, T, noise=0.003, mirrored=(mirrored or {}).get(name, False)) for name, T in PLACES.items()]
    out = []
    for k in range(round(seconds * RATE)):
        for i, sensor in enumerate(sensors):
            t = k / RATE + i / RATE / 2
            positions = sensor.see({1: walker}, t).positions
            if model is not None:
                bias = -model(sensor.name, *as_asked(walker, t, sensor.T_world_sensor))
                positions = positions + (bias[MIRROR] if sensor.mirrored else bias)
            frame = body_frame(
                sensor.name, KINECT_V2, time_ns=round(1e9 * t), positions=positions, tracking_ids=[1], sequence=k
            )
            out.append(Arrival(frame, round(1e9 * t)))
    return out


def tracker_with(model: JointBiasModel | None) -> DefaultTracker:
    tracker = DefaultTracker(DefaultSettings(joint_bias="none"), sensors_expected=2)
    tracker.joint_bias = model
    return tracker


@pytest.mark.parametrize("mirrored", [False, True])
def test_what_is_taken_off_is_what_is_declared(mirrored: bool) -> None:
    """Of the fused person, in the sensor's own labels, whether the sensors agree on them or one is to be swapped."""
    walker, tracker = Walker(), tracker_with(MODEL)
    tracker.start_from(PLACES)
    for arrival in arrivals(walker, 2.0, None, {"side": mirrored}):
        tracker.update(arrival)
    people = tracker._people
    assert people is not None
    last = arrivals(walker, 2.0 + 1 / RATE, None, {"side": mirrored})[-1]
    assert ("side", 1) in people.swapped() or not mirrored
    heard = tracker._arrivals.update(last)
    taken = tracker._corrections(heard.newest["side"], people)
    assert taken is not None
    declared = MODEL("side", *as_asked(walker, last.at_ns / 1e9, SIDE))
    np.testing.assert_allclose(taken[0], declared[MIRROR] if mirrored else declared, atol=0.01)
    assert np.abs(declared).max() > 0.05


@pytest.mark.slow
def test_a_known_bias_makes_the_layout_and_the_skeleton_worse_no_more() -> None:
    walker = Walker()
    seen = arrivals(walker, 8.0, MODEL)
    layout_m, joints_m = {}, {}
    for name, model in (("without", None), ("with", MODEL)):
        tracker = tracker_with(model)
        tracker.start_from(PLACES)
        for arrival in seen:
            scene = tracker.update(arrival)
        T = tracker.sensor_views().T_world_sensor
        T_front_side = inverse(T["front"]) @ T["side"]
        moved = apply(T_front_side @ inverse(inverse(FRONT) @ SIDE), np.array([[0.0, 0.0, 2.8]]))
        layout_m[name] = float(np.linalg.norm(moved - [0.0, 0.0, 2.8]))
        truth = apply(T["front"] @ inverse(FRONT), walker.at(seen[-1].at_ns / 1e9))
        joints_m[name] = float(np.linalg.norm(scene.people[0].positions - truth, axis=-1).mean())
    assert layout_m["with"] < 0.5 * layout_m["without"]
    assert joints_m["with"] < 0.7 * joints_m["without"]


def test_it_is_on_where_nothing_is_said_can_be_turned_off_and_is_of_the_joints_it_was_learnt_on() -> None:
    assert DefaultTracker().joint_bias is shipped_model()
    assert DefaultTracker(DefaultSettings(joint_bias="none")).joint_bias is None
    with pytest.raises(SettingsError, match=r"joint_bias is 'nine'.*did you mean none"):
        DefaultSettings(joint_bias="nine")
    other = JointBiasModel("kinect_v1", np.zeros((TERMS, len(topology("kinect_v1")), 3)))
    tracker = tracker_with(other)
    tracker.start_from(PLACES)
    *before, last = arrivals(Walker(), 0.5, None)
    for arrival in before:
        scene = tracker.update(arrival)
    assert scene.people
    assert tracker._people is not None
    assert tracker._corrections(tracker._arrivals.update(last).newest["side"], tracker._people) is None
