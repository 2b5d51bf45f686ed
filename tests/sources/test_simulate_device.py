"""A sensor's pose, image, noise and clock."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.observations import Edge
from mocapella.model.topology import topology
from mocapella.sources.simulate import Noise, SensorSettings
from mocapella.sources.simulate.device import axial_noise
from mocapella.sources.simulate.orientation import bone_ends, bone_orientations

KINECT = SensorSettings("kinect")
coordinate = st.floats(-5, 5)


@given(st.floats(-180, 180), st.floats(-80, 80), st.tuples(coordinate, st.floats(0, 3), coordinate))
def test_the_pose_is_a_rigid_motion_that_looks_where_it_says(
    yaw: float, tilt: float, position: tuple[float, float, float]
) -> None:
    T = SensorSettings("s", position, yaw_deg=yaw, tilt_deg=tilt).T_world_sensor
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    np.testing.assert_array_equal(T[:3, 3], position)
    y, t = math.radians(yaw), math.radians(tilt)
    looks = [math.sin(y) * math.cos(t), math.sin(t), math.cos(y) * math.cos(t)]
    np.testing.assert_allclose(T[:3, 2], looks, atol=1e-12)
    assert T[1, 0] == pytest.approx(0, abs=1e-12), "no roll"


@given(st.floats(-180, 180), st.floats(-80, 80), st.floats(-180, 180))
def test_a_roll_turns_the_image_about_the_optical_axis(yaw: float, tilt: float, roll: float) -> None:
    upright = SensorSettings("s", yaw_deg=yaw, tilt_deg=tilt).T_world_sensor
    rolled = SensorSettings("s", yaw_deg=yaw, tilt_deg=tilt, roll_deg=roll).T_world_sensor
    np.testing.assert_allclose(rolled[:3, 2:], upright[:3, 2:], atol=1e-12)
    r = math.radians(roll)
    np.testing.assert_allclose(rolled[:3, 0], upright[:3, :2] @ [math.cos(r), math.sin(r)], atol=1e-12)
    assert np.linalg.det(rolled[:3, :3]) == pytest.approx(1)


@given(coordinate, coordinate, st.floats(0.3, 6))
def test_a_point_is_in_the_image_exactly_if_it_is_in_the_field_of_view(x: float, y: float, z: float) -> None:
    point = np.array([x, y, z])
    within = abs(math.atan2(x, z)) <= math.radians(35.3) and abs(math.atan2(y, z)) <= math.radians(30)
    u, v = KINECT.project(point)
    assert (0 <= u <= 512 and 0 <= v <= 424) == within
    assert KINECT.in_view(point, KINECT.project(point)) == (within and 0.5 <= z <= 4.5)


@given(st.floats(0, 512), st.floats(0, 424), st.floats(0.5, 4.5))
def test_projection_can_be_undone(u: float, v: float, z: float) -> None:
    fx, fy = KINECT.focal_px
    point = np.array([(u - 256) * z / fx, (212 - v) * z / fy, z])
    np.testing.assert_allclose(KINECT.project(point), [u, v], atol=1e-9)


def test_what_is_behind_the_lens_has_no_pixel() -> None:
    assert np.isnan(KINECT.project(np.array([[0, 0, -1.0], [0.1, 0.1, 0.0]]))).all()


def test_clipped_edges_are_those_the_body_reaches_over() -> None:
    pixels = np.array([[[100.0, 100.0], [513, 200]], [[-1, 100], [200, 430]], [[9, -2], [9, 9]], [[9, 9], [np.nan, 9]]])
    wanted = [Edge.RIGHT, Edge.LEFT | Edge.BOTTOM, Edge.TOP, Edge.NONE]
    np.testing.assert_array_equal(KINECT.clipped_edges(pixels), wanted)


def test_noise_grows_with_distance_and_with_the_angle() -> None:
    distances = axial_noise(np.linspace(1.0, 4.5, 50), np.array(0.0))
    assert (np.diff(distances) > 0).all()
    angles = axial_noise(np.array(2.0), np.radians(np.linspace(0, 75, 50)))
    assert (np.diff(angles) > 0).all()
    # 1.5 − 0.5·2 + 0.3·4 mm at 2 m, head on.
    assert axial_noise(np.array(2.0), np.array(0.0)) == pytest.approx(1.7e-3)


@given(st.integers(0, 10**11), st.floats(-200, 200), st.floats(-1e5, 1e5))
def test_offset_and_drift_can_be_read_off_the_clock(index: int, drift: float, offset: float) -> None:
    sensor = SensorSettings("s", clock_drift_ppm=drift, clock_offset_s=offset)
    room = [sensor.frame_ns(0), sensor.frame_ns(index)]
    clock = [sensor.clock_ns(at) for at in room]
    assert clock[0] == round(offset * 1e9)
    assert (clock[1] - clock[0]) - (room[1] - room[0]) == pytest.approx(drift * 1e-6 * room[1], abs=1e3)


@given(st.integers(0, 10**11), st.sampled_from([30.0, 29.97, 60.0, 14.5]), st.floats(0, 0.016))
def test_frames_are_evenly_apart_also_after_decades(index: int, rate: float, phase: float) -> None:
    sensor = SensorSettings("s", rate_hz=rate, phase_s=phase, latency_jitter_s=0.0)
    assert sensor.frame_ns(index + 1) - sensor.frame_ns(index) == pytest.approx(1e9 / rate, abs=1)
    assert sensor.frame_ns(0) == round(phase * 1e9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "a b"}, "sensor name"),
        ({"position": (0, -1, 0)}, "position"),
        ({"position": (math.nan, 1, 0)}, "position"),
        ({"tilt_deg": 90}, "tilt_deg"),
        ({"fov_deg": (180, 60)}, "fov_deg"),
        ({"range_m": (2, 1)}, "range_m"),
        ({"depth_size_px": (0, 1)}, "depth_size_px"),
        ({"rate_hz": 0}, "rate_hz"),
        ({"phase_s": 0.04}, "phase_s"),
        ({"clock_offset_s": math.inf}, "clock_offset_s"),
        ({"clock_drift_ppm": 1e6}, "clock_drift_ppm"),
        ({"latency_s": -1}, "latency_s"),
        ({"latency_jitter_s": 0.02}, r"latency_jitter_s is 0\.02; it must be from 0 to 0\.0056"),
        ({"lost": 1.0}, "lost"),
        ({"max_bodies": 0}, "max_bodies"),
        ({"forget_s": -1}, "forget_s"),
        ({"mirror_beyond_deg": 181}, "mirror_beyond_deg"),
        ({"roll_deg": 181}, "roll_deg"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(change: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        SensorSettings(**{"name": "s", **change})  # type: ignore[arg-type]


def test_noise_out_of_range_is_refused() -> None:
    with pytest.raises(SettingsError, match="lateral_px"):
        Noise(lateral_px=-0.1)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31))
def test_orientations_carry_y_along_the_bone_and_z_to_the_front(seed: int) -> None:
    rng, kinect = np.random.default_rng(seed), topology("kinect_v2")
    positions, forward = rng.standard_normal((2, 25, 3)), rng.standard_normal((2, 3))
    q = bone_orientations(positions, bone_ends(kinect), forward)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1, atol=1e-12)
    assert (q[..., 0] >= 0).all()
    w, v = q[..., :1], q[..., 1:]

    def turned(axis: list[float]) -> np.ndarray:
        a = np.broadcast_to(np.array(axis), v.shape)
        return a + 2 * np.cross(v, np.cross(v, a) + w * a)

    for parent, child in kinect.bones:
        bone = positions[:, child] - positions[:, parent]
        bone /= np.linalg.norm(bone, axis=1, keepdims=True)
        np.testing.assert_allclose(turned([0, 1, 0])[:, child], bone, atol=1e-9)
        assert (np.einsum("ni,ni->n", turned([0, 0, 1])[:, child], forward) > 0).all()
    root = turned([0, 1, 0])[:, kinect.parts["root"]]
    spine = positions[:, 1] - positions[:, 0]
    np.testing.assert_allclose(root, spine / np.linalg.norm(spine, axis=1, keepdims=True), atol=1e-9)


def test_a_joint_without_a_place_has_no_orientation() -> None:
    positions = np.random.default_rng(0).standard_normal((1, 25, 3))
    positions[0, 5] = np.nan
    missing = np.isnan(bone_orientations(positions, bone_ends(topology("kinect_v2")), np.array([[0, 0, 1.0]]))).all(
        axis=-1
    )
    assert np.flatnonzero(missing[0]).tolist() == [5, 6], "the elbow, and the wrist at the end of its bone"
