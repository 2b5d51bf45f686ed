"""Sensors of different kinds see the same people: one person, with the joints of the skeleton, in whatever order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.observations import Arrival, BodyFrame, body_frame
from mocapella.model.scene import Scene
from mocapella.model.skeleton import SKELETON, skeleton_mapping
from mocapella.model.topology import Topology, topology, topology_names
from mocapella.sources.simulate.body import simulated_joints
from mocapella.testing.walking import FRONT, RATE_HZ, SIDE, Walker, WalkerSensor
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.stand_still import StandStillTracker, StandStillTrackerSettings

MAPPED = [topology(name) for name in topology_names() if name not in {"hand", "kinect_v2"}]


def seen_by(kind: Topology, frame: BodyFrame, weights: NDArray[np.float64]) -> BodyFrame:
    """The frame as a sensor of another topology sends it; ``weights`` (joints, 25) give its joints."""
    return body_frame(
        frame.sensor, kind, time_ns=frame.time_ns, positions=weights @ frame.positions.astype(np.float64),
        tracking_ids=frame.tracking_ids, sequence=frame.sequence,
    )  # fmt: skip


def arrivals(seconds: float, azure_first: bool = False, walker: Walker | None = None) -> list[Arrival]:
    """A Kinect v2 in front and an Azure Kinect at the side see one person, 1 cm of noise."""
    azure = simulated_joints("azure_kinect").weights
    front, side = WalkerSensor("front", FRONT, noise=0.01), WalkerSensor("side", SIDE, noise=0.01, phase=0.011)
    found = []
    for k in range(round(seconds * RATE_HZ)):
        t = k / RATE_HZ
        pair = [
            Arrival(front.frame({1: walker or Walker()}, t, k), round(1e9 * (1 + t))),
            Arrival(
                seen_by(topology("azure_kinect"), side.frame({1: walker or Walker()}, t, k), azure),
                round(1e9 * (1 + t)),
            ),
        ]
        found += reversed(pair) if azure_first else pair
    return found


@pytest.mark.parametrize("azure_first", [False, True])
def test_people_have_the_same_joints_whichever_sensor_speaks_first(azure_first: bool) -> None:
    tracker = DefaultTracker(sensors_expected=2)
    scenes = [tracker.update(arrival) for arrival in arrivals(0.5, azure_first)]
    assert all(scene.topology is SKELETON for scene in scenes)
    assert [person.positions.shape for person in scenes[-1].people] == [(25, 3)]


def _seen_from(T_world_camera: NDArray[np.float64], world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions (joints, 3) in the camera's space [m]."""
    return np.asarray(apply(inverse(T_world_camera), world))


def _in_front_camera(scene: Scene) -> NDArray[np.float64]:
    """Return the person's joints (joints, 3) in the space of the sensor ``front`` [m]."""
    (T,) = (place.T_world_sensor for place in scene.sensors if place.sensor == "front")
    assert T is not None
    return _seen_from(T, scene.people[0].positions)


def test_an_azure_kinect_and_a_kinect_v2_are_calibrated_and_fused() -> None:
    tracker = DefaultTracker(sensors_expected=2)
    off = []
    for arrival in arrivals(12.0, azure_first=True):
        scene = tracker.update(arrival)
        at_s = arrival.at_ns / 1e9 - 1.0
        if at_s > 10.0:
            off.append(np.linalg.norm(_in_front_camera(scene) - _seen_from(FRONT, Walker().at(at_s)), axis=-1))
    assert np.mean(off) < 0.04
    assert tracker.report.rejected == {}
    (person,) = scene.people
    assert [view.sensor for view in person.views] == ["front", "side"]
    assert all(view.positions.shape == (25, 3) for view in person.views)
    places = {place.sensor: place.T_world_sensor for place in scene.sensors}
    assert places["front"] is not None
    assert places["side"] is not None
    np.testing.assert_allclose(np.linalg.inv(places["front"]) @ places["side"], np.linalg.inv(FRONT) @ SIDE, atol=0.05)


def test_the_bias_of_a_kinect_v2_is_not_subtracted_from_another_sensor() -> None:
    tracker = DefaultTracker(sensors_expected=2)
    tracker.start_from({"front": FRONT, "side": SIDE})
    *before, kinect, azure = arrivals(1.0)
    for arrival in before:
        tracker.update(arrival)
    assert tracker._people is not None
    for arrival, corrected in ((kinect, True), (azure, False)):
        sighting = tracker._arrivals.update(arrival).newest[arrival.frame.sensor]
        assert (tracker._corrections(sighting, tracker._people) is not None) is corrected


@pytest.mark.parametrize("kind", MAPPED, ids=lambda kind: kind.name)
def test_people_are_tracked_by_a_sensor_of_any_kind_alone(kind: Topology) -> None:
    mapping = skeleton_mapping(kind.name)
    assert mapping is not None
    weights = np.linalg.pinv(mapping.weights[mapping.known])  # joints that are mapped to the walker's
    full = np.zeros((len(kind), 25))
    full[:, mapping.known] = weights
    tracker, sensor = DefaultTracker(), WalkerSensor("front", FRONT, noise=0.005)
    for k in range(60):
        t = k / RATE_HZ
        frame = seen_by(kind, sensor.frame({1: Walker()}, t, k), full)
        scene = tracker.update(Arrival(frame, round(1e9 * (1 + t))))
    (person,) = scene.people
    assert scene.topology is SKELETON
    (place,) = scene.sensors
    assert place.T_world_sensor is not None
    true = Walker().at(59 / RATE_HZ) @ FRONT[:3, :3] - FRONT[:3, 3] @ FRONT[:3, :3]
    R, t0 = place.T_world_sensor[:3, :3], place.T_world_sensor[:3, 3]
    found = (person.positions - t0) @ R
    off = np.linalg.norm(found - true, axis=-1)[mapping.known]
    assert np.nanmedian(off) < 0.05
    assert np.isfinite(off).all()


def test_a_tracker_that_restarts_from_a_snapshot_continues_with_both_kinds() -> None:
    one, other, frames = DefaultTracker(sensors_expected=2), DefaultTracker(sensors_expected=2), arrivals(2.0)
    for arrival in frames[:60]:
        one.update(arrival)
    other.restore(one.snapshot())
    for arrival in frames[60:]:
        assert one.update(arrival).step == other.update(arrival).step
    assert one.snapshot() == other.snapshot()


def test_a_memory_of_people_with_other_joints_is_refused_and_leaves_a_new_tracker() -> None:
    tracker, frames = DefaultTracker(), arrivals(1.0)
    for arrival in frames:
        tracker.update(arrival)
    assert tracker._people is not None
    tracker._people.topology = topology("kinect_v1")  # as a take of an earlier version has it
    with pytest.raises(WireError, match="people of topology kinect_v1"):
        tracker.restore(tracker.snapshot())
    assert tracker.report.frames == 0


def test_standing_people_are_calibrated_and_fused_by_the_baseline_too() -> None:
    settings = StandStillTrackerSettings(frames=20, still_within_m=0.2)
    tracker: Any = StandStillTracker(settings, sensors_expected=2)
    *before, last = arrivals(2.0, walker=Walker(speed=0.0))
    for arrival in before:
        scene = tracker.update(arrival)
    assert tracker.report.rejected == {}
    assert scene.topology is SKELETON
    (person,) = scene.people
    assert [view.sensor for view in person.views] == ["front", "side"]
    nobody = body_frame("side", topology("azure_kinect"), time_ns=last.frame.time_ns, positions=[])
    (person,) = tracker.update(Arrival(nobody, last.at_ns)).people
    assert person.views[1].positions.shape == (25, 3)
    assert np.isnan(person.views[1].positions).all()
