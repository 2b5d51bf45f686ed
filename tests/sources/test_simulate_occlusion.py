"""What hides a joint: the kernel against brute force along the ray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.sources.simulate import Box, Cylinder, load_scene
from mocapella.sources.simulate.body import JOINT, body_template
from mocapella.sources.simulate.occlusion import hidden, obstacles

NOTHING = obstacles((), ())
ALONG = np.linspace(0, 1, 600)
UNSURE_M = 0.004
"""Where a ray passes a surface by less than this, sampling it cannot tell; such joints are not compared."""


def _rays(eye: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(samples, people, 25, 3) points on the way from the eye to every joint."""
    return eye + ALONG[:, None, None, None] * (joints - eye)


def _depth_in_bodies(eye: np.ndarray, joints: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(people, 25) how deep the ray to a joint goes into a limb that may hide it; negative outside."""
    model, rays = body_template(), _rays(eye, joints)
    deepest = np.full(joints.shape[:2], -np.inf)
    for person in range(len(joints)):
        for bone in range(25):
            if radii[person, bone] == 0:
                continue
            a, b = joints[person, model.parents[bone]], joints[person, bone]
            t = np.clip(((rays - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
            depth = radii[person, bone] - np.linalg.norm(rays - (a + t[..., None] * (b - a)), axis=-1).min(axis=0)
            depth[person, model.within[:, bone]] = -np.inf
            deepest = np.maximum(deepest, depth)
    return deepest


@pytest.mark.slow
@example("exchange", 0.0, -1.45)  # one behind the other
@settings(max_examples=8, deadline=None)
@given(st.sampled_from(["exchange", "obstacle", "self-occlusion"]), st.floats(0, 30), st.floats(-3.1, 3.1))
def test_joints_hidden_by_bodies_are_those_whose_ray_is_blocked(scene: str, at_s: float, bearing: float) -> None:
    room = load_scene(scene)
    joints, radii = room.positions_at(round(at_s * 1e9)), room.motion.radii
    eye = np.array([0, 1.1, 2.8]) + 2.9 * np.array([np.sin(bearing), 0, np.cos(bearing)])
    depth = _depth_in_bodies(eye, joints, radii)
    sure = np.abs(depth) > UNSURE_M
    np.testing.assert_array_equal(hidden(eye, joints, radii, NOTHING)[sure], (depth > 0)[sure])
    assert sure.mean() > 0.8


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_joints_hidden_by_boxes_and_pillars_are_those_whose_ray_is_blocked(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = Box((rng.uniform(-1, 1), rng.uniform(1, 2)), tuple(rng.uniform(0.2, 1.5, 3)), rng.uniform(-180, 180))
    pillar = Cylinder((rng.uniform(-1, 1), rng.uniform(1, 2)), rng.uniform(0.1, 0.5), rng.uniform(0.2, 2))
    eye, joints = rng.uniform([-2, 0, -1], [2, 2, 0]), rng.uniform([-2, 0, 2.5], [2, 2, 4], (1, 25, 3))
    rays, yaw = _rays(eye, joints), np.radians(box.yaw_deg)
    x, z = rays[..., 0] - box.centre[0], rays[..., 2] - box.centre[1]
    across, along = x * np.cos(yaw) - z * np.sin(yaw), x * np.sin(yaw) + z * np.cos(yaw)
    size = np.array(box.size)
    out = [np.abs(across) - size[0] / 2, np.abs(along) - size[2] / 2, rays[..., 1] - size[1], -rays[..., 1]]
    in_box = -np.max(out, axis=0).min(axis=0)
    off = np.hypot(rays[..., 0] - pillar.centre[0], rays[..., 2] - pillar.centre[1])
    in_pillar = -np.max([off - pillar.radius, rays[..., 1] - pillar.height, -rays[..., 1]], axis=0).min(axis=0)
    for things, depth in ((obstacles((box,), ()), in_box), (obstacles((), (pillar,)), in_pillar)):
        sure = np.abs(depth) > UNSURE_M
        got = hidden(eye, joints, np.zeros((1, 25)), things)
        np.testing.assert_array_equal(got[sure], (depth > 0)[sure])


def test_a_box_before_the_legs_hides_the_legs_only() -> None:
    room = load_scene("stand")
    joints, radii = room.positions_at(0), room.motion.radii
    eye = np.array([0, 1.0, 0])
    before = hidden(eye, joints, radii, NOTHING)
    behind = hidden(eye, joints, radii, obstacles((Box((0.0, 1.4), (1.5, 0.8, 0.1)),), ()))
    assert not before.any()
    assert behind[0, [JOINT["KneeLeft"], JOINT["AnkleRight"], JOINT["FootLeft"]]].all()
    assert not behind[0, [JOINT["Head"], JOINT["HandLeft"], JOINT["SpineBase"]]].any()


def test_from_the_side_the_far_arm_is_hidden_by_the_own_body() -> None:
    room = load_scene("stand")
    joints, radii = room.positions_at(0), room.motion.radii
    seen_from_left = hidden(np.array([-3.0, 1.2, 2.8]), joints, radii, NOTHING)[0]
    assert seen_from_left[[JOINT["ShoulderRight"], JOINT["HipRight"]]].all()
    assert not seen_from_left[[JOINT["ShoulderLeft"], JOINT["ElbowLeft"], JOINT["HandLeft"], JOINT["Head"]]].any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Box((0, 0), (1, 0, 1)), "size"),
        (lambda: Cylinder((0, 0), 0, 1), "radius"),
        (lambda: Cylinder((0, 0), 1, -1), "height"),
    ],
)
def test_things_without_size_are_refused(make: object, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make()  # type: ignore[operator]
