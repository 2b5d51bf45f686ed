"""The arm's mesh: closed, moved rigidly by rigid motions, mirrored, with its joints inside; and how it moves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.arms import ELBOW, PALM
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, TIPS, HandPose
from mocapella.model.hand_flesh import BEYOND_TIP, REST_ANGLES
from mocapella.sources.simulate.arm_mesh import (
    ELBOW_FLEXION_RAD,
    FIRST_DIGIT,
    FIRST_TIP,
    SHOULDER,
    WRIST_FLEXION_RAD,
    ArmMesh,
    ArmMeshPose,
    ArmShape,
    arm_mesh,
    arm_shape,
    arm_shapes,
)
from mocapella.sources.simulate.arm_motion import untangled, worst_overlap
from mocapella.sources.simulate.depth_scene import depth_scene_names, load_depth_scene
from mocapella.sources.simulate.hand_motion import landmarks_of

REST = ArmMeshPose(REST_ANGLES, np.zeros(4), np.eye(4))
TWISTS = arrays(np.float64, 6, elements=st.floats(-1.5, 1.5))
UNIT = arrays(np.float64, len(ANGLES) + 4, elements=st.floats(0.0, 1.0))


@pytest.fixture(scope="module")
def mesh() -> ArmMesh:
    return arm_mesh(arm_shape("average"), "right")


def posed(mesh: ArmMesh, unit: np.ndarray, T: np.ndarray) -> ArmMeshPose:
    limits = mesh.model.limits
    angles = mesh.model.limited(limits[:, 0] + unit[:21] * (limits[:, 1] - limits[:, 0]))
    least, most = np.array([0.2, -1.2, -0.9, -0.4]), np.array([2.2, 1.2, 0.9, 0.3])
    return ArmMeshPose(angles, least + unit[21:] * (most - least), T)


def winding(mesh: ArmMesh, vertices: np.ndarray, point: np.ndarray) -> float:
    """How often the surface goes round a point: 1 inside, 0 outside (Van Oosterom and Strackee 1983)."""
    a, b, c = (vertices[mesh.triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    over = np.einsum("ij,ij->i", a, np.cross(b, c))
    under = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(2.0 * np.arctan2(over, under).sum() / (4.0 * np.pi))


@pytest.mark.parametrize("name", ["average", "small-woman", "large-man", "child"])
def test_each_edge_is_of_two_triangles_that_go_along_it_in_opposite_directions(name: str) -> None:
    mesh = arm_mesh(arm_shape(name), "right")
    t = mesh.triangles
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    keys, back = (edges @ np.array([1 << 32, 1]), edges @ np.array([1, 1 << 32]))
    assert len(np.unique(keys)) == len(keys)  # in each direction once
    assert np.array_equal(np.sort(keys), np.sort(back))
    v = mesh.vertices[t]
    litres = 1e3 * np.einsum("ij,ij->i", v[:, 0], np.cross(v[:, 1], v[:, 2])).sum() / 6
    assert 1.0 < litres < 6.0  # positive: outwards
    assert len(mesh.vertices) - len(keys) // 2 + len(t) == 2  # one piece without a hole (Euler)
    assert 4000 <= len(mesh.vertices) <= 10000


def test_weights_add_up_to_one_and_the_rest_is_the_rest(mesh: ArmMesh) -> None:
    assert np.allclose(mesh.weights.sum(axis=1), 1.0, atol=1e-12)
    assert (mesh.weights >= 0).all()
    assert np.allclose(mesh.at(REST), mesh.vertices, atol=1e-12)


@settings(max_examples=15, deadline=None)
@given(UNIT, TWISTS)
def test_a_rigid_motion_moves_the_mesh_rigidly(unit: np.ndarray, twist: np.ndarray) -> None:
    mesh = arm_mesh(arm_shape("average"), "left")
    T, first = exp_twist(twist), posed(mesh, unit, np.eye(4))
    moved = ArmMeshPose(first.angles, first.joints, T)
    assert np.allclose(mesh.at(moved), apply(T, mesh.at(first)), atol=1e-9)
    assert np.allclose(mesh.points(moved), apply(T, mesh.points(first)), atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(UNIT)
def test_a_left_arm_is_the_mirror_image_of_a_right_one(unit: np.ndarray) -> None:
    right, left = (arm_mesh(arm_shape("average"), side) for side in ("right", "left"))
    pose, mirror = posed(right, unit, np.eye(4)), np.array([-1.0, 1.0, 1.0])
    assert np.allclose(left.at(pose), mirror * right.at(pose), atol=1e-12)
    assert np.allclose(left.points(pose), mirror * right.points(pose), atol=1e-12)
    assert np.array_equal(left.triangles, right.triangles[:, ::-1])


@settings(max_examples=25, deadline=None)
@given(UNIT, TWISTS, st.sampled_from(["left", "right"]))
def test_the_joints_are_those_of_the_hands_model(unit: np.ndarray, twist: np.ndarray, side: str) -> None:
    mesh = arm_mesh(arm_shape("slender"), side)  # type: ignore[arg-type]
    pose = posed(mesh, unit, exp_twist(twist))
    points, T = mesh.points(pose), mesh.T_camera_palm(pose)
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    assert np.allclose(points[:21], landmarks_of(mesh.model, mesh.hand, HandPose(pose.angles, T)), atol=1e-9)
    assert np.allclose(points[PALM], 0.5 * (points[0] + points[9]))
    shape = mesh.shape
    assert np.linalg.norm(points[0] - points[ELBOW]) == pytest.approx(shape.forearm_m)
    assert np.linalg.norm(points[SHOULDER] - points[ELBOW]) == pytest.approx(shape.upper_arm_m)
    upper, fore = points[SHOULDER] - points[ELBOW], points[0] - points[ELBOW]
    bend = np.pi - np.arccos(upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore))
    assert bend == pytest.approx(pose.joints[0], abs=1e-6)


@settings(max_examples=6, deadline=None)
@given(UNIT)
def test_joints_lie_inside_the_flesh(unit: np.ndarray) -> None:
    mesh = arm_mesh(arm_shape("average"), "right")
    unit = 0.6 * unit
    pose = posed(mesh, unit, np.eye(4))
    vertices, points = mesh.at(pose), mesh.points(pose)
    inside = np.array([winding(mesh, vertices, p) for p in points[: ELBOW + 1]])
    assert (np.abs(inside) > 0.5).all()
    far = points[TIPS[2]] + 0.05 * (points[12] - points[9]) / np.linalg.norm(points[12] - points[9])
    assert abs(winding(mesh, vertices, far)) < 0.5


def test_flesh_ends_six_tenths_of_the_radius_beyond_the_tip(mesh: ArmMesh) -> None:
    points = mesh.points(REST)
    for digit, tip in enumerate(TIPS):
        along = points[tip] - points[tip - 1]
        along /= np.linalg.norm(along)
        of_bone = np.unique(mesh.triangles[mesh.parts == FIRST_TIP + digit])
        beyond = ((mesh.vertices[of_bone] - points[tip]) @ along).max()
        assert beyond == pytest.approx(BEYOND_TIP * mesh.tip_radii_m[digit], abs=0.0004)
        across = mesh.vertices[of_bone] - points[tip]
        across -= (across @ along)[:, None] * along
        width = np.linalg.norm(across, axis=1).max()
        assert mesh.tip_radii_m[digit] - 0.0005 < width < mesh.tip_radii_m[digit] + 0.001


def test_a_bent_finger_keeps_its_thickness_at_the_knuckle(mesh: ArmMesh) -> None:
    """Blending matrices instead would flatten the knuckle of a finger bent by 90° to 70 % of its radius."""
    angles = REST_ANGLES.copy()
    angles[DIGIT_ANGLES[2, 2]] = np.pi / 2
    pose = ArmMeshPose(angles, np.zeros(4), np.eye(4))
    vertices, points = mesh.at(pose), mesh.points(pose)
    bones = mesh.bones_of[:, 0]
    back = np.array([vertices[i] for i in np.flatnonzero((bones == FIRST_DIGIT + 6) | (bones == FIRST_DIGIT + 7))])
    outwards = 2 * points[10] - points[9] - points[11]
    outwards /= np.linalg.norm(outwards)
    reach = ((back - points[10]) @ outwards).max()
    assert reach > 0.9 * mesh.shape.finger_radii[2, 1]


def test_shapes_span_children_to_large_men_bare_and_sleeved() -> None:
    shapes = arm_shapes().values()
    lengths = [shape.hand_length_m for shape in shapes]
    assert len(lengths) >= 6
    assert min(lengths) <= 0.166
    assert max(lengths) >= 0.21
    assert {shape.sleeve_from_m > 0 for shape in shapes} == {True, False}
    for shape in shapes:
        hand = shape.hand("right")
        assert hand.bases[2, 2] + hand.lengths[2].sum() == pytest.approx(shape.hand_length_m)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("hand_length_m", 0.3), ("hand_breadth_m", 0.2), ("finger_thickness", 2.0), ("finger_length", 0.5),
        ("forearm_m", 1.0), ("upper_arm_m", 1.0), ("forearm_thickness", 2.0), ("sleeve_from_m", 0.9),
    ],
)  # fmt: skip
def test_a_shape_that_nobody_has_is_refused(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match=field):
        ArmShape(**{field: value})


def test_unknown_people_and_sides_are_refused_with_those_there_are() -> None:
    with pytest.raises(SettingsError, match="small-woman"):
        arm_shape("small-women")
    with pytest.raises(SettingsError, match="left or right"):
        arm_mesh(ArmShape(), "upper")  # type: ignore[arg-type]


def axes_apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[float, float, float]:
    """Least distance of two segments by brute force, and where on each."""
    s = np.linspace(0.0, 1.0, 41)
    one, other = a + s[:, None] * (b - a), c + s[:, None] * (d - c)
    distance = np.linalg.norm(one[:, None] - other[None], axis=-1)
    i, j = np.unravel_index(distance.argmin(), distance.shape)
    return float(distance[i, j]), float(s[i]), float(s[j])


def sampled_overlap(points: np.ndarray, radii: np.ndarray) -> float:
    """How far outer limbs of different fingers are inside each other [m]; found by sampling, unlike what avoids it."""
    worst, points = -np.inf, points.copy()
    for d, tip in enumerate(TIPS):  # the round end's middle
        along = points[tip] - points[tip - 1]
        points[tip] -= (1.0 - BEYOND_TIP) * radii[d, 3] * along / np.linalg.norm(along)
    for d in range(5):
        for e in range(d + 1, 5):
            for i in (1, 2):
                for j in (1, 2):
                    p, q = points[1 + 4 * d + i : 3 + 4 * d + i], points[1 + 4 * e + j : 3 + 4 * e + j]
                    far, s, t = axes_apart(p[0], p[1], q[0], q[1])
                    mine = radii[d, i] + s * (radii[d, i + 1] - radii[d, i])
                    theirs = radii[e, j] + t * (radii[e, j + 1] - radii[e, j])
                    worst = max(worst, mine + theirs - far)
    return worst


@settings(max_examples=20, deadline=None)
@given(UNIT)
def test_untangled_fingers_keep_limits_and_are_less_inside_each_other(unit: np.ndarray) -> None:
    mesh = arm_mesh(arm_shape("average"), "right")
    wished = posed(mesh, 0.8 * unit, np.eye(4)).angles
    angles = untangled(mesh, wished)
    assert mesh.model.within(angles, 1e-6)
    radii = mesh.shape.finger_radii
    before, after = (
        sampled_overlap(mesh.frames(ArmMeshPose(a, np.zeros(4), np.eye(4)))[1], radii) for a in (wished, angles)
    )
    assert after <= max(before, 0.0005) + 0.002


@pytest.mark.slow
@pytest.mark.parametrize("name", depth_scene_names())
def test_scenes_keep_limits_and_fingers_are_not_inside_each_other(name: str) -> None:
    scene = load_depth_scene(name, seed=100, sensor="exact")
    mesh = scene.meshes[0]
    radii = mesh.shape.finger_radii
    for at_s in np.linspace(0.0, scene.period_s, 31):
        pose = scene.poses(float(at_s))[0]
        assert mesh.model.within(pose.angles, 1e-6)
        assert ELBOW_FLEXION_RAD[0] <= pose.joints[0] <= ELBOW_FLEXION_RAD[1]
        assert WRIST_FLEXION_RAD[0] <= pose.joints[2] <= WRIST_FLEXION_RAD[1]
        assert sampled_overlap(mesh.frames(pose)[1], radii) < 0.002
        assert sampled_overlap(mesh.frames(pose)[1], radii) - 0.0002 < worst_overlap(mesh, pose.angles) < 0.002


@pytest.mark.parametrize("seed", [0, 100, 101])
def test_fast_is_fast(seed: int) -> None:
    scene = load_depth_scene("fast", seed=seed, sensor="exact")
    at = np.arange(0.0, scene.period_s, 0.004)
    palm = np.array([scene.meshes[0].points(scene.poses(float(t))[0])[PALM] for t in at])
    speed = np.linalg.norm(np.diff(palm, axis=0), axis=1) / 0.004
    assert 2.0 <= speed.max() <= 2.7


def test_digits_touch_where_they_shall() -> None:
    scene = load_depth_scene("touching", seed=100, sensor="exact")
    mesh = scene.meshes[0]
    r = mesh.shape.finger_radii
    apart = np.full((5, 5), np.inf)
    for at_s in np.arange(0.0, scene.period_s, 0.1):
        p = mesh.points(scene.poses(float(at_s))[0])
        for d in range(1, 4):
            for i in (2, 3):
                for j in (2, 3):
                    a, b = p[4 * d + i : 4 * d + i + 2], p[4 * d + 4 + j : 4 * d + 6 + j]
                    far, s, t = axes_apart(a[0], a[1], b[0], b[1])
                    far -= r[d, i - 1] + s * (r[d, i] - r[d, i - 1]) + r[d + 1, j - 1]
                    apart[d, d + 1] = min(apart[d, d + 1], far - t * (r[d + 1, j] - r[d + 1, j - 1]))
        tips = p[list(TIPS)]
        apart[0] = np.minimum(apart[0], np.linalg.norm(tips - tips[0], axis=1) - r[0, 3] - r[:, 3])
    for a, b in ((0, 1), (0, 2), (0, 3), (1, 2), (2, 3), (3, 4)):
        assert apart[a, b] < 0.002
    assert apart[0, 4] < 0.01  # the thumb's limits do not let everybody reach the little finger


def test_angles_and_joints_change_smoothly() -> None:
    scene = load_depth_scene("counting", seed=3, sensor="exact")
    at = np.arange(0.0, scene.period_s, 0.005)
    angles = np.array([scene.poses(float(t))[0].angles for t in at])
    assert np.degrees(np.abs(np.diff(angles, axis=0)).max()) < 8.0  # 1,600° a second


def test_the_mesh_is_posed_by_a_rigid_shoulder(mesh: ArmMesh) -> None:
    T = rigid(np.eye(3), np.array([0.1, -0.2, 0.7]))
    assert np.allclose(mesh.points(ArmMeshPose(REST_ANGLES, np.zeros(4), T))[SHOULDER], [0.1, -0.2, 0.7])
