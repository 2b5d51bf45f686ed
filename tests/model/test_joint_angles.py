"""Joint angles: those that a person was made of, whatever the person's place, size and side; unknown if not seen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.posed_person import HALPE, KINECT, LENGTHS, MEDIAPIPE, person, points_of

from mocapella.errors import SettingsError
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import rigid
from mocapella.geometry.segment_axes import (
    angles_yxz,
    angles_zxy,
    axes_along_y,
    axes_along_z,
    between,
    swing_yx,
    twist_yxy,
)
from mocapella.model.anatomy import anatomy_of, topology_of, with_body
from mocapella.model.hand import ANGLES, LANDMARKS
from mocapella.model.joint_angles import STRAIGHT_RAD, JointAngles
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories

seeds = st.integers(0, 2**32 - 1)
laws = settings(deadline=None, max_examples=8)
FRAMES = 6
RANGES_DEG = {
    "pelvis_tilt": (-60, 60), "pelvis_list": (-60, 60), "pelvis_rotation": (-179, 179), "hip_flexion": (-40, 120),
    "hip_adduction": (-60, 40), "hip_rotation": (-60, 60), "knee_angle": (25, 150), "ankle_angle": (-60, 40),
    "lumbar_extension": (-60, 40), "lumbar_bending": (-40, 40), "lumbar_rotation": (-50, 50), "arm_flex": (-60, 160),
    "arm_add": (-75, 40), "arm_rot": (-80, 80), "elbow_flex": (25, 150), "forearm_pronation": (-90, 90),
}  # fmt: skip
CENTRAL = ("pelvis", "lumbar")


def angles_of(seed: int) -> dict[str, np.ndarray]:
    """Random angles of both sides within a person's range [rad]."""
    rng = np.random.default_rng(seed)
    found = {}
    for name, (least, most) in RANGES_DEG.items():
        for end in ("",) if name.startswith(CENTRAL) else ("_r", "_l"):
            found[name + end] = np.radians(rng.uniform(least, most, FRAMES))
    return found


def lengths_of(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed + 1)
    return {name: length * rng.uniform(0.6, 1.5) for name, length in LENGTHS.items()}


def check(found: JointAngles, name: str, wanted: np.ndarray) -> None:
    compare(found.angles[:, 0, found.names.index(name)], wanted, name)


def compare(found: np.ndarray, wanted: np.ndarray, what: str = "") -> None:
    """Check that angles are equal or both unknown."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(wanted), err_msg=what)
    np.testing.assert_allclose(np.nan_to_num(wrap(found - wanted)), 0.0, atol=1e-7, err_msg=what)


@laws
@given(seed=seeds)
def test_a_person_has_the_angles_it_was_made_of(seed: int) -> None:
    made = angles_of(seed)
    found = JointAngles.of(person(points_of(made, FRAMES, lengths_of(seed))), with_sd=False)
    for name in made:
        if not name.startswith("forearm"):
            check(found, name, made[name])
    assert not any(name.startswith(("forearm", "wrist")) for name in found.names)  # a Kinect sees no knuckles
    assert (found.states == np.where(np.isfinite(found.angles), 2, 0)).all()


@laws
@given(seed=seeds)
def test_heels_and_knuckles_give_foot_and_forearm(seed: int) -> None:
    """The foot is the line from heel to toe, which the height of the ankle does not change."""
    made = angles_of(seed)
    made["wrist_flexion_r"], made["wrist_deviation_l"] = np.full(FRAMES, 0.4), np.full(FRAMES, -0.2)
    found = JointAngles.of(person(points_of(made, FRAMES, foot_drop=0.07), "mediapipe_pose", MEDIAPIPE), with_sd=False)
    for side in "rl":
        for name in ("ankle_angle", "knee_angle", "elbow_flex", "forearm_pronation"):
            check(found, f"{name}_{side}", made[f"{name}_{side}"])
        for name in ("wrist_flexion", "wrist_deviation"):
            check(found, f"{name}_{side}", made.get(f"{name}_{side}", np.zeros(FRAMES)))


@laws
@given(seed=seeds)
def test_a_straight_spine_gives_the_angles_also_without_its_middle(seed: int) -> None:
    made = angles_of(seed)
    made["lumbar_extension"] = made["lumbar_bending"] = np.zeros(FRAMES)
    found = JointAngles.of(person(points_of(made, FRAMES), "halpe_26", HALPE), with_sd=False)
    assert "lumbar_extension" not in found.names
    for name in made:
        if name in found.names:
            check(found, name, made[name])
    assert {"hip_flexion_r", "arm_flex_l", "lumbar_rotation", "pelvis_tilt"} <= set(found.names)


@laws
@given(seed=seeds)
def test_where_a_person_stands_changes_only_the_pelvis(seed: int) -> None:
    own = person(points_of(angles_of(seed), FRAMES))
    rng = np.random.default_rng(seed)
    moved = own.moved(rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3) * 5))
    before, after = JointAngles.of(own), JointAngles.of(moved)
    kept = [k for k, name in enumerate(before.names) if not name.startswith("pelvis")]
    compare(after.angles[..., kept], before.angles[..., kept])
    np.testing.assert_allclose(after.sd[..., kept], before.sd[..., kept], rtol=2e-3)


@laws
@given(seed=seeds, turn=st.floats(-3.1, 3.1))
def test_obliquity_and_inclination_do_not_depend_on_where_a_person_faces(seed: int, turn: float) -> None:
    own = person(points_of(angles_of(seed), FRAMES))
    moved = own.moved(rigid(Rotation.from_euler("Y", turn).as_matrix(), [1.0, 2.0, 3.0]))
    before, after = (JointAngles.of(one, with_sd=False) for one in (own, moved))
    for name, by in (("pelvis_heading", turn), ("pelvis_obliquity", 0.0), ("pelvis_inclination", 0.0)):
        check(after, name, before.angles[:, 0, before.names.index(name)] + by)
    upright = JointAngles.of(person(points_of({"pelvis_tilt": turn}, 1)), with_sd=False)
    check(upright, "pelvis_inclination", np.full(1, turn))
    check(JointAngles.of(person(points_of({"pelvis_list": turn / 3}, 1)), with_sd=False), "pelvis_obliquity", turn / 3)


@laws
@given(seed=seeds)
def test_the_mirrored_person_has_the_angles_of_the_other_side(seed: int) -> None:
    own = person(points_of(angles_of(seed), FRAMES))
    swapped = own.positions[:, :, list(topology("kinect_v2").mirror)] * (1.0, 1.0, -1.0)
    before, after = (JointAngles.of(one, with_sd=False) for one in (own, replace(own, positions=swapped)))
    sign = dict.fromkeys(("pelvis_list", "pelvis_rotation", "pelvis_heading", "pelvis_obliquity", "lumbar_bending",
                          "lumbar_rotation"), -1.0)  # fmt: skip
    for k, name in enumerate(before.names):
        other = name[:-1] + {"r": "l", "l": "r"}[name[-1]] if name.endswith(("_r", "_l")) else name
        check(after, other, sign.get(name, 1.0) * before.angles[:, 0, k])


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "names"), [("kinect_v2", KINECT), ("mediapipe_pose", MEDIAPIPE)])
@settings(deadline=None, max_examples=5)
@given(seed=seeds)
def test_the_sd_is_the_scatter_of_noisy_joints(kind: str, names: dict[str, str], seed: int) -> None:
    """Of MediaPipe's joints, pelvis and chest are weighted means, whose errors depend on the limbs' ones."""
    made = {name: values[:1] for name, values in angles_of(seed).items()}
    rng, sd, frames = np.random.default_rng(seed), 0.001, 6000
    exact = person(points_of(made, 1), kind, names, sd=sd)
    noisy = replace(
        exact, times_s=np.arange(frames) / 30.0, runs=np.zeros(frames, np.int64),
        positions=exact.positions + rng.normal(scale=sd, size=(frames, *exact.positions.shape[1:])),
        states=np.repeat(exact.states, frames, axis=0), sd=np.repeat(exact.sd, frames, axis=0),
    )  # fmt: skip
    found, one = JointAngles.of(noisy), JointAngles.of(exact)
    for k, name in enumerate(one.names):
        if np.isfinite(found.angles[:, 0, k]).mean() > 0.99:  # not near the limit of what is seen
            scatter = float(np.nanstd(wrap(found.angles[:, 0, k] - one.angles[0, 0, k])))
            assert scatter == pytest.approx(float(one.sd[0, 0, k]), rel=0.1), name


def test_a_standing_person_has_angles_of_zero_and_opensims_signs() -> None:
    """The tilt is backward, the list to the right, the rotation to the left, and the bend of a limb positive."""
    found = JointAngles.of(person(points_of({}, 1)))
    for k, name in enumerate(found.names):
        angle = found.angles[0, 0, k]
        if name[:-2] in {"hip_rotation", "arm_rot", "shoulder_plane", "shoulder_rotation"}:
            assert math.isnan(angle), name
        else:
            assert angle == pytest.approx(0.0, abs=1e-9), name
    p = points_of({}, 1)
    forward, right = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.0, 0.1])

    def moved(**by: np.ndarray) -> dict[str, float]:
        some = JointAngles.of(person({**p, **{name: p[name] + shift for name, shift in by.items()}}), with_sd=False)
        return dict(zip(some.names, some.angles[0, 0], strict=True))

    assert moved(lumbar=-forward)["pelvis_tilt"] > 0.1
    assert moved(hip_r=np.array([0.0, -0.1, 0.0]))["pelvis_list"] > 0.1
    assert moved(hip_r=forward)["pelvis_rotation"] > 0.1
    assert moved(chest=-forward)["lumbar_extension"] > 0.1
    assert moved(chest=right)["lumbar_bending"] > 0.1
    assert moved(knee_r=forward)["hip_flexion_r"] > 0.1
    assert moved(knee_r=-right)["hip_adduction_r"] > 0.1
    assert moved(knee_l=right)["hip_adduction_l"] > 0.1
    assert moved(ankle_l=-forward)["knee_angle_l"] > 0.1
    assert moved(toe_l=np.array([0.0, 0.1, 0.0]))["ankle_angle_l"] > 0.1
    assert moved(elbow_r=right)["arm_add_r"] < -0.1
    assert moved(elbow_r=right)["shoulder_plane_r"] == pytest.approx(0.0)
    assert moved(elbow_l=forward)["shoulder_plane_l"] == pytest.approx(np.pi / 2)
    assert moved(wrist_l=forward)["elbow_flex_l"] > 0.1


def test_rotations_are_unknown_while_a_limb_is_straight_and_where_axes_coincide() -> None:
    for bend, seen in ((STRAIGHT_RAD - 0.01, False), (STRAIGHT_RAD + 0.01, True)):
        made = {"knee_angle_r": bend, "elbow_flex_l": bend, "arm_flex_l": 0.5}
        found = JointAngles.of(person(points_of(made, 1)))
        for name in ("hip_rotation_r", "arm_rot_l", "shoulder_rotation_l"):
            k = found.names.index(name)
            assert math.isfinite(found.angles[0, 0, k]) == seen, name
            assert (found.states[0, 0, k] == 2) == seen
            assert math.isfinite(found.sd[0, 0, k]) == seen
    found = JointAngles.of(person(points_of({"arm_add_r": -math.pi / 2, "elbow_flex_r": 1.0}, 1)))
    wanted = {"arm_flex_r": False, "arm_rot_r": False, "shoulder_elevation_r": True, "shoulder_plane_r": True}
    for name, seen in wanted.items():
        assert math.isfinite(found.angles[0, 0, found.names.index(name)]) == seen, name


def test_a_straight_knee_is_not_more_certain_than_a_bent_one() -> None:
    """The derivative of a flexion, which is never negative, has no sign at 0: central differences would give 0."""
    found = JointAngles.of(person(points_of({"knee_angle_l": 0.5}, 1)))
    straight, bent = (float(found.sd[0, 0, found.names.index(f"knee_angle_{side}")]) for side in "rl")
    assert straight >= bent > 0.0


def test_an_unknown_or_inferred_joint_counts_for_its_angles_only() -> None:
    own = person(points_of(angles_of(3), FRAMES))
    knee, elbow = (own.keypoints.index(name) for name in ("KneeRight", "ElbowLeft"))
    positions, states = own.positions.copy(), own.states.copy()
    positions[1, 0, knee], states[1, 0, knee], states[2, 0, elbow] = np.nan, 0, 1
    found, whole = JointAngles.of(replace(own, positions=positions, states=states)), JointAngles.of(own)
    leg = {f"{one}_r" for one in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle")}
    of_knee = [name in leg for name in found.names]
    np.testing.assert_array_equal(np.isnan(found.angles[1, 0]), of_knee)
    np.testing.assert_array_equal(found.states[1, 0] == 0, of_knee)
    np.testing.assert_array_equal(np.isnan(found.sd[1, 0]), of_knee)
    rest = ~np.array(of_knee)
    np.testing.assert_array_equal(found.angles[1, 0, rest], whole.angles[1, 0, rest])
    inferred = [name for k, name in enumerate(found.names) if found.states[2, 0, k] == 1]
    assert set(inferred) == {f"{one}_l" for one in ("arm_flex", "arm_add", "arm_rot", "shoulder_plane", "elbow_flex",
                                                    "shoulder_elevation", "shoulder_rotation")}  # fmt: skip


def test_without_the_sd_of_joints_angles_have_none() -> None:
    own = person(points_of(angles_of(1), FRAMES), sd=math.nan)
    assert np.isnan(JointAngles.of(own).sd).all()
    assert np.isnan(JointAngles.of(person(points_of(angles_of(1), FRAMES)), with_sd=False).sd).all()


def test_the_pelvis_is_midway_between_the_hips() -> None:
    own = person(points_of({"pelvis_tx": np.full(2, 3.0), "pelvis_ty": np.full(2, 0.9)}, 2))
    np.testing.assert_allclose(JointAngles.of(own).pelvis[:, 0], [[3.0, 0.9, 0.0]] * 2)


@pytest.mark.parametrize("name", with_body())
def test_each_topology_with_a_body_has_angles(name: str) -> None:
    own = anatomy_of(topology(name).joints)
    assert {"pelvis", "chest", "hip_r", "hip_l", "knee_r", "knee_l"} <= own.keys()
    assert ("lumbar" in own) == (name in {"kinect_v2", "azure_kinect"})
    assert topology_of(topology(name).joints) == name
    for terms in own.values():
        assert sum(terms.values()) == pytest.approx(1.0)
    for point in own:
        if point.endswith("_r"):
            mirror = topology(name).mirror
            assert own[f"{point[:-2]}_l"] == {mirror[joint]: weight for joint, weight in own[point].items()}


def test_a_pelvis_that_is_no_keypoint_is_between_the_hips() -> None:
    """Programs such as Pose2Sim write no mid hip."""
    own = person(points_of(angles_of(2), FRAMES), "halpe_26", HALPE)
    kept = [k for k, name in enumerate(own.keypoints) if name not in {"Hip", "Neck"}]
    some = replace(
        own, keypoints=tuple(own.keypoints[k] for k in kept), positions=own.positions[:, :, kept],
        states=own.states[:, :, kept], sd=own.sd[:, :, kept], bones=(),
    )  # fmt: skip
    found = JointAngles.of(some)
    assert np.isfinite(found.angles[..., found.names.index("pelvis_tilt")]).all()
    assert np.isfinite(found.angles[..., found.names.index("lumbar_rotation")]).all()


def test_points_of_no_body_have_no_angles() -> None:
    own = person(points_of({}, 1))
    other = replace(own, keypoints=tuple(f"m{k}" for k in range(len(own.keypoints))), bones=())
    with pytest.raises(SettingsError, match=r"of no body; topologies with one: arkit, .*kinect_v2"):
        JointAngles.of(other)


def test_hands_and_bodies_keep_their_own_angles() -> None:
    rng = np.random.default_rng(0)
    angles = rng.normal(size=(2, 1, len(ANGLES)))
    angles[1, 0, 3] = np.nan
    states = np.full((2, 1, len(LANDMARKS)), 2, np.uint8)
    states[0, 0, 5:9] = 1  # the index finger
    hand = Trajectories(
        "hands", np.arange(2.0), np.zeros(2, np.int64), ("hand_1_left",), LANDMARKS, rng.normal(size=(2, 1, 21, 3)),
        states, np.full((2, 1, 21), 0.01, np.float32), angle_names=ANGLES, angles=angles,
    )  # fmt: skip
    found = JointAngles.of(hand)
    assert found.names == ANGLES
    np.testing.assert_array_equal(found.angles, angles)
    assert np.isnan(found.sd).all()
    assert np.isnan(found.pelvis).all()
    assert {ANGLES[k] for k in np.flatnonzero(found.states[0, 0] == 1)} == {n for n in ANGLES if n.startswith("index ")}
    assert found.states[1, 0, 3] == 0
    body = replace(hand, kind="bodies", angle_names=("left knee flexion",), angles=angles[..., :1])
    lost = replace(body, states=np.ones_like(states))
    assert (JointAngles.of(body).states == 2).all()
    assert (JointAngles.of(lost).states == 1).all()


@laws
@given(seed=seeds)
def test_axes_are_right_handed_and_angles_invert_the_product_of_turns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 50, 3))
    for axes in (axes_along_z(a, b), axes_along_y(a, b)):
        known = np.isfinite(axes).all(axis=(1, 2))
        assert known.sum() > 30
        product = axes[known] @ np.swapaxes(axes[known], 1, 2)
        np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(axes[known]), 1.0)
    z, x, y = rng.uniform(-1.3, 1.3, (3, 50))
    found = angles_zxy(Rotation.from_euler("ZXY", np.stack([z, x, y], axis=1)).as_matrix())
    np.testing.assert_allclose(found, [z, x, y], atol=1e-9)
    found = angles_yxz(Rotation.from_euler("YXZ", np.stack([y, x, z], axis=1)).as_matrix())
    np.testing.assert_allclose(found, [y, x, z], atol=1e-9)
    plane, elevation = rng.uniform(-3, 3, 50), rng.uniform(0.3, 2.8, 50)
    R = Rotation.from_euler("YXY", np.stack([plane, -elevation, y], axis=1)).as_matrix()
    np.testing.assert_allclose(swing_yx(R[..., 1]), [plane, elevation], atol=1e-9)
    np.testing.assert_allclose(twist_yxy(R), y, atol=1e-9)
    np.testing.assert_allclose(between(a, b), between(b, a))


def test_parallel_directions_give_no_axes() -> None:
    up = np.array([0.0, 1.0, 0.0])
    assert np.isnan(axes_along_y(up, 2 * up)).any()
    assert np.isnan(axes_along_z(up, np.array([0.0, 1.0, 0.1]))).any()
    assert np.isnan(angles_zxy(Rotation.from_euler("X", math.pi / 2).as_matrix())[0])
    assert KINECT["lumbar"] == "SpineMid"
