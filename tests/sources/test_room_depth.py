"""Rendered people, from head to foot: the image shows them where the truth says they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.simulate.body import BODY, JOINT
from mocapella.sources.simulate.depth_scene import depth_sensor
from mocapella.sources.simulate.device import SensorSettings
from mocapella.sources.simulate.rendered_depth import RenderedRecording, rendered_scene
from mocapella.sources.simulate.room import build_room
from mocapella.sources.simulate.room_depth import (
    FIRST_PERSON,
    FLOOR,
    WALL,
    WALL_M,
    RoomDepthScene,
    capsule,
    room_depth_scene,
)
from mocapella.sources.simulate.scenes import load_scene


def test_joints_lie_in_the_flesh_that_is_seen() -> None:
    scene = room_depth_scene("exchange", seed=1, sensor="exact")
    for at_s in (1.0, 9.0):
        shot = scene.at(at_s)
        depth_m = shot.depth * shot.unit_m
        for number, joints in enumerate(shot.people):
            px = np.rint(project(joints, shot.lens)).astype(int)
            x, y = px.T
            mine = shot.parts[y, x] == FIRST_PERSON + number
            assert mine[[JOINT[name] for name in ("Head", "SpineMid", "KneeLeft", "KneeRight")]].all()
            before = joints[mine, 2] - depth_m[y, x][mine]
            assert (before > -0.02).all()  # fingertips, between two pixels
            assert (before < 0.35).all()
    assert len(shot.people) == 2
    assert shot.people.shape[1] == len(BODY)


def test_floor_and_wall_are_planes() -> None:
    scene = room_depth_scene("stand", sensor="exact")
    shot = scene.at(0.0)
    y, x = np.nonzero(shot.parts == FLOOR)
    z = shot.depth[y, x] * shot.unit_m
    np.testing.assert_allclose((y - shot.lens[3]) / shot.lens[1] * z, 1.0, atol=0.002)
    np.testing.assert_allclose(shot.depth[shot.parts == WALL] * shot.unit_m, 5.0, atol=1e-4)


@pytest.mark.parametrize("noise", ["exact", "kinect"])
def test_the_camera_has_the_pose_of_the_first_sensor(noise: str) -> None:
    settings = load_scene("stand", seed=1).settings
    seen = set()
    for yaw_deg, tilt_deg, position in ((30.0, 25.0, (-1.0, 0.5, 0.5)), (-20.0, -50.0, (0.6, 2.2, 1.2))):
        sensor = SensorSettings("front", position, yaw_deg=yaw_deg, tilt_deg=tilt_deg)
        room = build_room(replace(settings, sensors=(sensor,)))
        scene = RoomDepthScene(room, depth_sensor(noise), 1)
        shot = scene.at(1.0)
        T_world_camera = inverse(scene.T_camera_world)
        np.testing.assert_allclose(T_world_camera[:3, 1:], sensor.T_world_sensor[:3, 1:] * (-1, 1, 1), atol=1e-12)
        np.testing.assert_allclose(apply(T_world_camera, shot.people), room.positions_at(10**9), atol=1e-9)
        assert (shot.parts == FIRST_PERSON).sum() > 3000
        seen |= set(np.unique(shot.parts).tolist())
        if noise != "exact":
            continue
        y, x = np.nonzero(shot.depth)
        rays = np.stack(
            [(x - shot.lens[2]) / shot.lens[0], (y - shot.lens[3]) / shot.lens[1], np.ones(len(x))], axis=-1
        )
        points = apply(T_world_camera, rays * (shot.depth[y, x] * shot.unit_m)[:, None])
        parts = shot.parts[y, x]
        assert np.abs(points[parts == FLOOR, 1]).max(initial=0.0) < 0.001
        yaw = np.radians(yaw_deg)
        ahead_m = (points - position) @ (np.sin(yaw), 0.0, np.cos(yaw))
        np.testing.assert_allclose(ahead_m[parts == WALL], WALL_M, atol=0.002)
    assert seen == {FLOOR, WALL, FIRST_PERSON}
    upwards = replace(settings, sensors=(SensorSettings("front", tilt_deg=80.0),))
    shot = RoomDepthScene(build_room(upwards), depth_sensor(noise), 1).at(1.0)
    assert (shot.parts == 0).any()
    assert not shot.depth[shot.parts == 0].any()


def test_a_capsule_is_closed_and_as_thick_as_it_is_said() -> None:
    a, b = np.array([0.1, -0.2, 1.0]), np.array([0.4, 0.3, 1.2])
    vertices, triangles = capsule(a, b, 0.05, 0.08)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)  # each edge once in each direction
    assert {tuple(edge) for edge in edges.tolist()} == {(v, u) for u, v in edges.tolist()}
    along = np.clip((vertices - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    off = np.linalg.norm(vertices - a - along[:, None] * (b - a), axis=1)
    assert (off > 0.049).all()
    assert (off < 0.0801).all()
    p, q, r = (vertices[triangles[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", p, np.cross(q, r)).sum() / 6 > 0  # seen from outside
    point = capsule(a, a, 0.05, 0.05)[0]
    np.testing.assert_allclose(np.linalg.norm(point - a, axis=1), 0.05)


@pytest.mark.slow
def test_a_scene_is_a_recording() -> None:
    recording = RenderedRecording(rendered_scene("room-stand/3/tof", "rendered:x"), "rendered:x", DepthOptions(fps=0.5))
    images = list(recording.images())
    assert len(images) == recording.count == 10
    assert recording.state.size_px == (512, 424)
    assert [image.time_ns for image in images[:3]] == [1, 2_000_000_001, 4_000_000_001]
    assert images[0].file == "rendered:x/0"
    first = images[0].depth
    assert first is not None
    np.testing.assert_array_equal(first, room_depth_scene("stand", seed=3, sensor="tof").at(0.0).depth)
    arm = RenderedRecording(rendered_scene("fist/2", "rendered:fist/2"), "rendered:fist/2")
    assert arm.state.unit_m == 0.001
    assert arm.state.lens is not None
    assert next(arm.images()).depth is not None


@pytest.mark.parametrize(
    ("which", "named"),
    [("room-wlk", "unknown scene 'wlk'.*did you mean walk"), ("room-walk/0/kinct", "unknown sensor 'kinct'"),
     ("fist/x", "rendered:NAME/SEED/SENSOR")],
)  # fmt: skip
def test_a_scene_that_there_is_not_is_refused(which: str, named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        rendered_scene(which, "rendered:fist/x")
