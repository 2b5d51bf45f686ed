"""What a simulated sensor says of the room, against the truth that it publishes beside."""

from __future__ import annotations

import dataclasses
import itertools
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.observations import JointState
from mocapella.model.skeleton import skeleton_mapping
from mocapella.model.topology import topology
from mocapella.sources.simulate import (
    Box,
    Noise,
    PersonSettings,
    Room,
    SceneSettings,
    SensorSettings,
    SimulatedFrame,
    SimulatedSensor,
    build_room,
    load_scene,
    merge,
    scene_names,
    scene_settings,
)

EXACT = Noise(axial_gain=0, lateral_px=0, inferred_gain=0, inferred_bias=0)


def changed(name: str, *, seed: int = 0, **sensor: object) -> Room:
    """A named scene with all its sensors changed."""
    scene = scene_settings(name)
    sensors = tuple(dataclasses.replace(one, **sensor) for one in scene.sensors)
    return build_room(dataclasses.replace(scene, sensors=sensors, seed=seed))


def one_sensor(*people: PersonSettings, boxes: tuple[Box, ...] = (), **sensor: object) -> SimulatedSensor:
    front = SensorSettings("front", **sensor)  # type: ignore[arg-type]
    return SimulatedSensor(build_room(SceneSettings("test", (front,), people, boxes)), 1)


def same(a: SimulatedFrame, b: SimulatedFrame, *, without: tuple[str, ...] = ()) -> bool:
    """Whether two items are the same to the bit."""
    pairs = [(a.due_s, b.due_s)]
    for x, y in ((a.frame, b.frame), (a.truth, b.truth)):
        pairs += [(getattr(x, f), getattr(y, f)) for f in x.__struct_fields__ if f not in without]
    return all(np.array_equal(p, q, equal_nan=True) if isinstance(p, np.ndarray) else p == q for p, q in pairs)


def own_joints(item: SimulatedFrame) -> np.ndarray:
    """(bodies, joints) which joint of the person each reported joint really is."""
    plain, mirror = np.arange(len(item.frame.topology)), np.array(item.frame.topology.mirror)
    return np.where(item.truth.mirrored[:, None], mirror, plain)


def errors(item: SimulatedFrame) -> np.ndarray:
    """(bodies, joints, 3) reported minus true, camera space [m]."""
    truth, T = item.truth, item.truth.T_world_sensor
    rows = np.arange(item.frame.bodies)[:, None]
    true = truth.positions[truth.body_people][rows, own_joints(item)]
    return item.frame.positions - (true - T[:3, 3]) @ T[:3, :3]


@pytest.mark.parametrize("name", scene_names())
def test_without_noise_the_frame_is_the_truth_seen_from_the_sensor(name: str) -> None:
    room = changed(name, noise=EXACT)
    for sensor in room.sensor_names:
        for item in SimulatedSensor(room, sensor).frames(9.0, 9.3):
            there = item.frame.states != JointState.NOT_TRACKED
            assert np.abs(errors(item)[there]).max(initial=0) < 1e-6
            assert np.isnan(item.frame.positions[~there]).all()
            world = item.frame.positions @ item.truth.T_world_sensor[:3, :3].T + item.truth.T_world_sensor[:3, 3]
            rows = np.arange(item.frame.bodies)[:, None]
            true = item.truth.positions[item.truth.body_people][rows, own_joints(item)]
            np.testing.assert_allclose(world[there], true[there], atol=1e-5)


@pytest.mark.parametrize("name", ["obstacle", "crowd"])
def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(name: str) -> None:
    first, again, other = (list(SimulatedSensor(load_scene(name, seed=seed), 2).frames(8.0, 9.0)) for seed in (5, 5, 6))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a, b in zip(first, other, strict=False))


@pytest.mark.parametrize(("scene", "sensor"), [("exchange", "left"), ("self-occlusion", "front")])
def test_a_start_in_the_middle_gives_the_same_frames_but_for_ids_and_sequence(scene: str, sensor: str) -> None:
    """Also where joints have been hidden for so long that they are forgotten."""
    source = SimulatedSensor(load_scene(scene, seed=2), sensor)
    whole = [item for item in source.frames(0.0, 15.0) if item.truth.room_ns >= 13_000_000_000]
    late = list(source.frames(13.0, 15.0))
    assert [item.frame.sequence for item in late] == list(range(len(late)))
    ignored = ("tracking_ids", "sequence")
    assert all(same(a, b, without=ignored) for a, b in zip(whole, late, strict=True))


def test_two_readings_of_one_sensor_do_not_disturb_each_other() -> None:
    source = SimulatedSensor(load_scene("stand"), 1)
    one, other = source.frames(0.0, 1.0), source.frames(0.0, 1.0)
    assert all(same(a, b) for a, b in zip(one, other, strict=True))


@settings(max_examples=5, deadline=None)
@given(st.floats(0, 1e9))
def test_frames_begin_and_end_where_asked(start_s: float) -> None:
    room = changed("stand", lost=0.0)
    for sensor in (1, 2):
        source = SimulatedSensor(room, sensor)
        times = [item.truth.room_ns for item in source.frames(start_s, start_s + 0.5)]
        assert len(times) in (15, 16)
        assert round(start_s * 1e9) <= times[0] < round(start_s * 1e9) + 34_000_000
        assert times[-1] < (start_s + 0.5) * 1e9
        assert {b - a for a, b in itertools.pairwise(times)} <= {33_333_333, 33_333_334}


@pytest.mark.slow
def test_time_on_the_sensors_own_clock_gives_back_offset_and_drift() -> None:
    room = load_scene("stand")
    for sensor, wanted in zip(room.sensor_names, room.settings.sensors, strict=True):
        items = list(SimulatedSensor(room, sensor).frames(0.0, 20.0))
        at = np.array([item.truth.room_ns for item in items]) * 1e-9
        drift, offset = np.polyfit(at, np.array([item.frame.time_ns for item in items]) * 1e-9 - at, 1)
        assert drift * 1e6 == pytest.approx(wanted.clock_drift_ppm, abs=0.01)
        assert offset == pytest.approx(wanted.clock_offset_s, abs=1e-6)


@pytest.mark.slow
def test_lost_frames_are_about_as_many_as_set_and_sequence_counts_what_comes() -> None:
    items = list(SimulatedSensor(changed("stand", lost=0.2, seed=4), 1).frames(0.0, 60.0))
    # 1800 Bernoulli trials: a standard deviation of 0.0094.
    assert 1 - len(items) / 1800 == pytest.approx(0.2, abs=0.04)
    assert [item.frame.sequence for item in items] == list(range(len(items)))
    assert max(np.diff([item.truth.room_ns for item in items])) > 60_000_000


def test_latency_jitters_about_its_setting_and_frames_never_overtake() -> None:
    items = list(SimulatedSensor(changed("stand", latency_s=0.07, latency_jitter_s=0.0055), 2).frames(0.0, 30.0))
    latency = np.array([item.due_s - item.truth.room_ns * 1e-9 for item in items])
    assert latency.mean() == pytest.approx(0.07, abs=0.001)
    assert latency.std() == pytest.approx(0.0055, rel=0.1)
    assert (np.diff([item.due_s for item in items]) > 0).all()


def test_noise_grows_with_distance_and_where_a_body_is_seen_obliquely() -> None:
    def spread(z: float, position: tuple[float, float, float] = (0, 1, 0), yaw: float = 0) -> float:
        source = one_sensor(PersonSettings((0, z)), position=position, yaw_deg=yaw, lost=0.0)
        items = list(source.frames(0.0, 4.0))
        seen = np.array([item.frame.states[0] == JointState.TRACKED for item in items])
        return float(np.std(np.array([errors(item)[0, :, 2] for item in items])[seen]))

    near, far = spread(2.0), spread(4.0)
    oblique = spread(2.0, (2 * math.sin(1.3), 1, 2 - 2 * math.cos(1.3)), -math.degrees(1.3))
    # 1.5 times the depth camera's noise: 1.7 mm at 2 m, 4.3 mm at 4 m.
    assert near == pytest.approx(2.55e-3, rel=0.1)
    assert far == pytest.approx(6.45e-3, rel=0.1)
    assert oblique > 1.5 * near


def test_hidden_joints_are_inferred_then_forgotten_and_inferred_ones_are_worse() -> None:
    screen = Box((0.0, 1.4), (1.5, 0.8, 0.1))
    source = one_sensor(PersonSettings((0, 2.8)), boxes=(screen,), forget_s=1.0)
    items = list(source.frames(0.0, 2.0))
    knees = [source.topology.index(name) for name in ("KneeLeft", "KneeRight")]
    for item in items:
        wanted = JointState.INFERRED if item.truth.room_ns < 966_000_000 else JointState.NOT_TRACKED
        assert (item.frame.states[0, knees] == wanted).all()
        assert item.frame.states[0, source.topology.parts["head"]] == JointState.TRACKED
    early = np.array([errors(item)[0] for item in items[:20]])
    head = early[:, source.topology.parts["head"]]
    assert np.linalg.norm(early[:, knees], axis=-1).mean() > 3 * np.linalg.norm(head, axis=-1).mean()
    assert np.linalg.norm(early[:, knees].mean(axis=0), axis=-1).min() > 0.03, "the bias does not average out"


def test_joints_out_of_view_are_not_tracked_and_the_edge_is_said() -> None:
    # 1 m away and 1 m up, a field of view of ±30° ends at 0.4 m and 1.6 m.
    item = next(one_sensor(PersonSettings((0, 1.0)), lost=0.0).frames())
    states, names = item.frame.states[0], item.frame.topology.index
    assert states[names("AnkleLeft")] == JointState.NOT_TRACKED
    assert states[names("Head")] == JointState.NOT_TRACKED
    assert states[names("SpineMid")] == JointState.TRACKED
    assert item.frame.clipped_edges[0] == 4 + 8
    assert next(one_sensor(PersonSettings((0, 5.2)), lost=0.0).frames()).frame.bodies == 0, "beyond the range"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["walk", "self-occlusion"])
def test_labels_are_swapped_where_a_back_is_seen_and_swapping_twice_is_the_truth(name: str) -> None:
    room = changed(name, noise=EXACT, forget_s=60.0)
    items = list(SimulatedSensor(room, "front").frames(6.0, 30.0))
    mirrored = [item for item in items if item.truth.mirrored.any()]
    assert 0.05 < len(mirrored) / len(items) < 0.95
    left, right = room.topology.parts["shoulder_left"], room.topology.parts["shoulder_right"]
    for item in items:
        assert np.array_equal(own_joints(item)[0][own_joints(item)[0]], np.arange(25))
        if (item.frame.states[0, [left, right]] == JointState.TRACKED).all():
            sideways = item.frame.positions[0, right, 0] - item.frame.positions[0, left, 0]
            true = item.truth.positions[0][[left, right]]
            away = true[1, 0] < true[0, 0]
            assert (sideways > 0) == (away == item.truth.mirrored[0])


def test_the_second_sensor_alone_sees_the_right_arm_in_the_self_occlusion_test() -> None:
    room = load_scene("self-occlusion")
    arm = [room.topology.index(f"{joint}Right") for joint in ("Elbow", "Wrist", "Hand")]
    seen = {}
    for sensor in room.sensor_names:
        item = next(SimulatedSensor(room, sensor).frames(13.0))
        own = own_joints(item)[0]
        seen[sensor] = [bool(item.frame.states[0, own == joint][0] == JointState.TRACKED) for joint in arm]
    assert seen == {"front": [False] * 3, "right": [True] * 3}


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in scene_names() if name != "crowd"])
def test_at_first_every_sensor_sees_everybodys_head_and_hands(name: str) -> None:
    """What the stand-still calibration needs, 120 frames long."""
    room = load_scene(name, seed=8)
    parts = [room.topology.parts[part] for part in ("head", "hand_left", "hand_right")]
    for sensor in room.sensor_names:
        items = list(SimulatedSensor(room, sensor).frames(0.0, 6.0))
        assert len(items) > 150
        assert all(item.frame.bodies == len(room.settings.people) for item in items)
        assert all((item.frame.states[:, parts] == JointState.TRACKED).all() for item in items)
        assert not any(item.truth.mirrored.any() for item in items)
        places = np.stack([item.frame.positions[:, parts] for item in items])
        assert np.linalg.norm(places - places[0], axis=-1).max() < 0.1


@pytest.mark.slow
def test_the_obstacle_hides_people_and_their_ids_change_when_they_come_back() -> None:
    room = load_scene("obstacle", seed=1)
    items = list(SimulatedSensor(room, "front").frames(0.0, room.duration_s))
    assert {item.frame.bodies for item in items} == {1, 2}
    ids: dict[int, list[int]] = {0: [], 1: []}
    for item in items:
        now = dict(zip(item.truth.body_people.tolist(), item.frame.tracking_ids.tolist(), strict=True))
        for person, known in ids.items():
            known.append(now.get(person, 0))
    for known in ids.values():
        runs = [key for key, _ in itertools.groupby(known)]
        assert 0 in runs, "was lost"
        present = [key for key in runs if key]
        assert len(present) == len(set(present)) > 1, "and never got an old id back"
    assert set(ids[0]) & set(ids[1]) <= {0}


def test_a_sensor_tracks_no_more_bodies_than_it_can() -> None:
    people = tuple(PersonSettings((x, 3.0)) for x in (-1.2, 0.0, 1.2))
    assert [next(one_sensor(*people, max_bodies=n, lost=0.0).frames()).frame.bodies for n in (1, 2, 6)] == [1, 2, 3]


def test_a_frame_of_nobody_is_a_frame() -> None:
    item = next(one_sensor(PersonSettings((0, 2.5)), yaw_deg=180.0, lost=0.0).frames())
    assert item.frame.bodies == 0
    assert item.frame.positions.shape == (0, 25, 3)
    assert item.truth.body_people.shape == (0,)


def test_frames_of_a_kinect_v1_are_the_same_people_with_twenty_joints() -> None:
    v1, v2 = (
        next(SimulatedSensor(load_scene("stand", topology=name), 1).frames()) for name in ("kinect_v1", "kinect_v2")
    )
    assert v1.frame.topology == topology("kinect_v1")
    assert v1.frame.positions.shape == (1, 20, 3)
    for ours, theirs in (("HipCenter", "SpineBase"), ("Spine", "SpineMid"), ("HandLeft", "HandLeft")):
        i, j = v1.frame.topology.index(ours), v2.frame.topology.index(theirs)
        np.testing.assert_array_equal(v1.frame.positions[:, i], v2.frame.positions[:, j])
    assert v1.truth.topology is v2.truth.topology is topology("kinect_v2")
    np.testing.assert_array_equal(v1.truth.positions, v2.truth.positions)


@pytest.mark.parametrize("at_s", [0.0, 9.0])
def test_frames_of_an_azure_kinect_are_the_same_people_whose_joints_its_mapping_gives_back(at_s: float) -> None:
    azure, v2 = (
        next(SimulatedSensor(load_scene("walk", topology=name), 2).frames(at_s)).frame
        for name in ("azure_kinect", "kinect_v2")
    )
    assert (azure.topology, azure.positions.shape) == (topology("azure_kinect"), (1, 32, 3))
    mapping = skeleton_mapping("azure_kinect")
    assert mapping is not None
    back = mapping.positions(azure.positions.astype(np.float64))
    both = np.isfinite(back).all(axis=-1)
    assert both.mean() > 0.5
    np.testing.assert_allclose(back[both], v2.positions[both], atol=0.003)
    assert (mapping.states(azure.states) <= v2.states).all()


def test_depth_pixels_are_the_projected_joints_and_orientations_are_turns() -> None:
    item = next(SimulatedSensor(load_scene("walk"), 2).frames(9.0))
    frame = item.frame
    np.testing.assert_allclose(frame.depth_px, SensorSettings("s").project(frame.positions.astype(float)), atol=1e-3)
    assert frame.depth_size_px == (512, 424)
    assert frame.orientations is not None
    known = np.isfinite(frame.orientations).all(axis=-1)
    np.testing.assert_allclose(np.linalg.norm(frame.orientations[known], axis=-1), 1, atol=1e-6)
    assert known.mean() > 0.5
    assert (frame.tilt, frame.height) == (math.radians(-2), 1.05)


def test_merge_brings_frames_in_the_order_in_which_they_come() -> None:
    room = load_scene("obstacle")
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names]
    merged = list(merge(sensors, 2.0, 4.0))
    assert [item.due_s for item in merged] == sorted(item.due_s for item in merged)
    apart = [item.frame.key for sensor in sensors for item in sensor.frames(2.0, 4.0)]
    assert sorted(item.frame.key for item in merged) == sorted(apart)


def test_values_are_frozen() -> None:
    item = next(SimulatedSensor(load_scene("stand"), 1).frames())
    with pytest.raises(AttributeError):
        item.due_s = 0.0  # type: ignore[misc]
    assert isinstance(item, msgspec.Struct)


@pytest.mark.parametrize(
    ("start_s", "stop_s"), [(-1.0, None), (math.nan, None), (math.inf, None), (2.0, 1.0), (0.0, math.nan)]
)
def test_a_time_that_cannot_be_is_refused_at_once(start_s: float, stop_s: float | None) -> None:
    with pytest.raises(SettingsError, match=r"start_s|stop_s"):
        SimulatedSensor(load_scene("stand"), 1).frames(start_s, stop_s)
