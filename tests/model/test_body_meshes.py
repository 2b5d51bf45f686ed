"""Women, men and legs: closed, symmetric, as high as they should be, and moved by 26 degrees of freedom."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rigged_meshes import any_pose, is_closed, is_own_mirror_image, volume

from mocapella.errors import SettingsError
from mocapella.geometry.limb_surface import group_distances
from mocapella.model.body_flesh import WITHIN, body_limbs, joint_places
from mocapella.model.body_meshes import DETAIL, PARTS, _grid, _steps, body_mesh, legs_mesh
from mocapella.model.body_proportions import AVERAGE, BodyProportions, body_shape, lengths_of, proportions_of
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, posed, rest
from mocapella.model.twist_tree import TreePose, joint_twists, part_motions

SEXES = ("female", "male")
sexes = st.sampled_from(SEXES)
few = settings(max_examples=12, deadline=None)


def places(mesh: RiggedMesh) -> dict[str, np.ndarray]:
    return dict(zip(mesh.landmarks, landmarks_at(mesh, rest(mesh)), strict=True))


def turned(mesh: RiggedMesh, **degrees: float) -> TreePose:
    """left_knee_flexion=90, all else 0."""
    angles = np.zeros(len(mesh.joint_names))
    for name, value in degrees.items():
        angles[mesh.joint_names.index(name.replace("_", " "))] = np.radians(value)
    return TreePose(np.eye(4), angles)


def at(mesh: RiggedMesh, landmark: str, **degrees: float) -> np.ndarray:
    return dict(zip(mesh.landmarks, landmarks_at(mesh, turned(mesh, **degrees)), strict=True))[landmark]


@pytest.mark.slow
@settings(few, max_examples=6)
@given(sexes, st.floats(1.0, 2.1), st.floats(0.75, 1.4), st.sampled_from([0.8, 1.0, 1.5]))
def test_a_body_is_a_closed_surface_that_is_its_own_mirror_image(
    sex: str, height: float, girth: float, detail: float
) -> None:
    mesh = body_mesh(sex, height, BodyProportions(girth=girth), detail)  # type: ignore[arg-type]
    assert is_closed(mesh)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2, "without a hole or a handle: legs and arms are apart"
    assert volume(mesh) > 0
    assert is_own_mirror_image(mesh)
    assert mesh.bones.shape[1] <= 4


@pytest.mark.parametrize("sex", SEXES)
def test_a_body_has_26_degrees_of_freedom_and_so_many_vertices(sex: str) -> None:
    mesh = body_mesh(sex)  # type: ignore[arg-type]
    assert mesh.tree.dofs == 26
    assert mesh.part_names == PARTS
    assert 1000 <= len(mesh.vertices) <= 2500
    assert len(body_mesh(sex, detail=3.0).vertices) > 8 * len(mesh.vertices)  # type: ignore[arg-type]
    np.testing.assert_allclose(mesh.tree.root, 0.5 * (places(mesh)["left hip"] + places(mesh)["right hip"]))
    assert body_mesh(sex) is mesh, "made once"  # type: ignore[arg-type]


@few
@given(sexes, st.floats(0.6, 2.4))
def test_a_body_is_as_high_as_it_should_be_and_stands_on_the_ground(sex: str, height: float) -> None:
    mesh = body_mesh(sex, height)  # type: ignore[arg-type]
    assert mesh.vertices[:, 1].min() == 0.0
    assert mesh.vertices[:, 1].max() == pytest.approx(height, rel=1e-12)
    assert places(mesh)["head"][1] == pytest.approx(height, rel=1e-12)


@few
@given(sexes, st.floats(0.8, 1.3))
def test_scaling_by_height_scales_everything(sex: str, scale: float) -> None:
    one, other = body_mesh(sex, 1.6), body_mesh(sex, 1.6 * scale)  # type: ignore[arg-type]
    assert {name: point.tolist() for name, point in places(other).items()} == {
        name: pytest.approx((scale * point).tolist(), abs=1e-9) for name, point in places(one).items()
    }
    assert volume(other) == pytest.approx(scale**3 * volume(one), rel=5e-3)


@pytest.mark.parametrize("sex", SEXES)
def test_a_body_twice_as_high_has_the_same_mesh_twice_as_large(sex: str) -> None:
    one, other = body_mesh(sex, 0.9, supple=True), body_mesh(sex, 1.8, supple=True)  # type: ignore[arg-type]
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(one.bones, other.bones)
    np.testing.assert_allclose(2 * one.vertices, other.vertices, atol=0.5e-3)
    np.testing.assert_allclose(one.shares, other.shares, atol=2e-3)


@pytest.mark.parametrize(("sex", "height", "kilograms"), [("male", 1.756, 78.5), ("female", 1.629, 62.0)])
def test_a_body_has_the_volume_of_a_person(sex: str, height: float, kilograms: float) -> None:
    """Means of the 1988 survey of U.S. Army personnel; people are about as dense as water."""
    assert volume(body_mesh(sex, height)) == pytest.approx(kilograms / 1000, rel=0.2)  # type: ignore[arg-type]
    broad = body_mesh(sex, height, BodyProportions(girth=1.2))  # type: ignore[arg-type]
    assert volume(broad) > 1.2 * volume(body_mesh(sex, height))  # type: ignore[arg-type]


LENGTHS = {
    "shank": 0.40, "thigh": 0.43, "trunk": 0.52, "head": 0.30, "shoulder_width": 0.34, "hip_width": 0.18,
    "upper_arm": 0.31, "forearm": 0.24, "hand": 0.18, "foot": 0.25,
}  # fmt: skip


@few
@given(sexes, st.dictionaries(st.sampled_from(sorted(LENGTHS)), st.floats(0.9, 1.1), min_size=1))
def test_landmarks_are_as_far_apart_as_the_segments_that_are_given(sex: str, scales: dict[str, float]) -> None:
    known = {name: LENGTHS[name] * scale for name, scale in scales.items()}
    mesh = body_mesh(sex, proportions=BodyProportions(**known))  # type: ignore[arg-type]
    measured = proportions_of(places(mesh))
    assert {name: getattr(measured, name) for name in known} == pytest.approx(known, rel=1e-9)
    assert mesh.vertices[:, 1].max() == pytest.approx(places(mesh)["head"][1], rel=1e-12)


@few
@given(sexes, st.integers(0, 2**32 - 1))
def test_at_rest_a_body_is_as_it_was_built_and_the_root_moves_all_of_it(sex: str, seed: int) -> None:
    mesh = body_mesh(sex)  # type: ignore[arg-type]
    np.testing.assert_allclose(posed(mesh, rest(mesh)), mesh.vertices, atol=1e-15)
    pose = any_pose(np.random.default_rng(seed), mesh)
    T = part_motions(mesh.tree, pose)
    whole = np.flatnonzero(mesh.shares[:, 0] == 1.0)
    alone = (T[mesh.bones[whole, 0], :3, :3] @ mesh.vertices[whole, :, None])[..., 0] + T[mesh.bones[whole, 0], :3, 3]
    np.testing.assert_allclose(posed(mesh, pose)[whole], alone, atol=1e-12)
    assert set(mesh.bones[:, 0].tolist()) == set(range(len(PARTS))), "every part moves some of it most"


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_leg_moves_nothing_beyond_the_other_hip(sex: str, side: str) -> None:
    mesh = body_mesh(sex)  # type: ignore[arg-type]
    other = places(mesh)["right hip" if side == "left" else "left hip"][0]
    beyond = mesh.vertices[:, 0] * np.sign(other) > abs(other)
    leg = turned(mesh, **{f"{side}_hip_flexion": 40, f"{side}_hip_abduction": 20, f"{side}_knee_flexion": 30})
    np.testing.assert_allclose(posed(mesh, leg)[beyond], mesh.vertices[beyond], atol=1e-12)


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("side", ["left", "right"])
def test_joints_turn_the_way_their_names_say(sex: str, side: str) -> None:
    mesh = body_mesh(sex)  # type: ignore[arg-type]
    out = 1 if side == "left" else -1
    wrist, toe, ankle = f"{side} wrist", f"{side} toe", f"{side} ankle"

    def moved(landmark: str, **degrees: float) -> np.ndarray:
        """To the outside, upwards, forwards."""
        named = {name.replace("SIDE", side): value for name, value in degrees.items()}
        return (at(mesh, landmark, **named) - places(mesh)[landmark]) * [out, 1, 1]

    assert moved("nose", waist_bend_forwards=10)[2] > 0.05
    assert moved("nose", waist_bend_to_the_left=10)[0] * out > 0.05
    assert moved(wrist, SIDE_shoulder_swing_forwards=10)[2] > 0.05
    assert moved(wrist, SIDE_shoulder_raise_sidewards=10)[1] > 0.05
    assert moved(wrist, SIDE_elbow_flexion=10)[2] > 0.03
    bent = moved(wrist, SIDE_elbow_flexion=90)
    assert (moved(wrist, SIDE_elbow_flexion=90, SIDE_shoulder_turn_outwards=20) - bent)[0] > 0.03
    assert moved(ankle, SIDE_hip_flexion=10)[2] > 0.05
    assert moved(ankle, SIDE_hip_abduction=10)[0] > 0.05
    assert moved(toe, SIDE_hip_turn_outwards=10)[0] > 0.02
    assert moved(ankle, SIDE_knee_flexion=10)[2] < -0.05
    assert moved(toe, SIDE_ankle_flexion=10)[1] > 0.02
    straight = at(mesh, wrist, **{f"{side}_shoulder_swing_forwards": 90}) - places(mesh)[f"{side} shoulder"]
    np.testing.assert_allclose(straight / np.linalg.norm(straight), [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("sex", SEXES)
def test_mirrored_angles_make_a_mirrored_pose(sex: str) -> None:
    mesh = body_mesh(sex)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    angles = any_pose(rng, mesh).angles
    names = mesh.joint_names
    swap = {"left": "right", "right": "left"}
    other = np.empty_like(angles)
    for k, name in enumerate(names):
        first, _, more = name.partition(" ")
        other[names.index(f"{swap[first]} {more}" if first in swap else name)] = angles[k]
    other[names.index("waist bend to the left")] *= -1
    one, image = (
        dict(zip(mesh.landmarks, landmarks_at(mesh, TreePose(np.eye(4), a)), strict=True)) for a in (angles, other)
    )
    for name, point in one.items():
        first, _, more = name.partition(" ")
        np.testing.assert_allclose(
            image[f"{swap[first]} {more}" if first in swap else name], point * [-1, 1, 1], atol=1e-12
        )


@pytest.mark.parametrize("sex", SEXES)
def test_a_supple_body_nods_tilts_its_head_and_turns_its_waist_and_is_else_the_same(sex: str) -> None:
    stiff, supple = body_mesh(sex), body_mesh(sex, supple=True)  # type: ignore[arg-type]
    assert supple.tree.dofs == 29
    np.testing.assert_array_equal(supple.vertices, stiff.vertices)
    assert [name for name in supple.joint_names if name in stiff.joint_names] == list(stiff.joint_names)
    nose, neck = places(supple)["nose"], places(supple)["neck"]
    forwards = at(supple, "nose", neck_nod=30) - neck
    assert forwards[1] < (nose - neck)[1]
    assert forwards[0] == pytest.approx(0)
    assert at(supple, "nose", neck_tilt_to_the_left=30)[0] > 0.05
    turned_left = at(supple, "nose", waist_turn_to_the_left=30)
    assert turned_left[0] > 0.02
    assert turned_left[1] == pytest.approx(nose[1])
    for name in ("left shoulder", "left wrist"):  # the head alone
        np.testing.assert_allclose(at(supple, name, neck_nod=30), places(supple)[name])
    moved = np.abs(posed(supple, turned(supple, neck_nod=30)) - supple.vertices).max(axis=1) > 1e-9
    assert moved.any()
    assert supple.vertices[moved, 1].min() > neck[1] - 0.02
    assert supple.vertices[~moved, 1].max() < neck[1] + 0.08


@pytest.mark.parametrize("sex", SEXES)
def test_a_nodding_head_keeps_its_shape(sex: str) -> None:
    """Only the neck bends: the skull is rigid."""
    mesh = body_mesh(sex, supple=True)  # type: ignore[arg-type]
    skull = mesh.vertices[:, 1] > places(mesh)["nose"][1]
    pose = turned(mesh, neck_nod=40, neck_tilt_to_the_left=20)
    T = part_motions(mesh.tree, pose)[mesh.part_names.index("head")]
    np.testing.assert_allclose(posed(mesh, pose)[skull], mesh.vertices[skull] @ T[:3, :3].T + T[:3, 3], atol=1e-12)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_shoulder_loses_a_degree_of_freedom_where_arms_seldom_are(side: str) -> None:
    mesh = body_mesh()
    turns = [k for k, name in enumerate(mesh.joint_names) if name.startswith(f"{side} shoulder")]

    def freedom(**degrees: float) -> float:
        """1 where the three axes are perpendicular, 0 where they lie in a plane."""
        named = {f"{side}_shoulder_{name}": value for name, value in degrees.items()}
        return abs(float(np.linalg.det(joint_twists(mesh.tree, turned(mesh, **named))[turns, 3:])))

    assert freedom(raise_sidewards=90) < 1e-12
    assert freedom(swing_forwards=90) == pytest.approx(1.0), "straight forwards"
    assert freedom(raise_sidewards=-45) == pytest.approx(np.sqrt(0.5)), "hanging"
    assert freedom(raise_sidewards=45) == pytest.approx(np.sqrt(0.5)), "straight to the side"


def test_limits_hold_the_rest() -> None:
    limits = body_mesh("male").tree.limits
    assert ((limits[:, 0] <= 0) & (limits[:, 1] > 0)).all()
    assert np.isfinite(limits).all()


@pytest.mark.parametrize("sex", SEXES)
def test_legs_are_those_of_the_body(sex: str) -> None:
    legs, body = legs_mesh(sex, 1.7), body_mesh(sex, 1.7)  # type: ignore[arg-type]
    assert legs.tree.dofs == 6 + 2 * 5
    assert is_closed(legs)
    assert is_own_mirror_image(legs)
    assert legs.part_names == tuple(part for part in PARTS if part.endswith(("pelvis", "thigh", "shank", "foot")))
    assert {name: point.tolist() for name, point in places(legs).items()} == {
        name: places(body)[name].tolist() for name in places(legs)
    }
    assert legs.vertices[:, 1].max() < places(body)["neck"][1]
    moved = turned(legs, left_hip_flexion=40, right_knee_flexion=30)
    same = turned(body, left_hip_flexion=40, right_knee_flexion=30)
    np.testing.assert_allclose(
        landmarks_at(legs, moved)[list(legs.landmarks).index("right toe")],
        landmarks_at(body, same)[list(body.landmarks).index("right toe")],
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"sex": "mail"}, r"unknown sex 'mail'; known: female, male \(did you mean male\?\)"),
        ({"detail": 0.1}, "detail is 0.1; it must be 0.8 to 4.0"),
        ({"detail": float("nan")}, "detail is nan"),
        ({"height_m": 3.0}, "height_m is 3.0; it must be 0.5 to 2.5 m"),
        ({"height_m": float("nan")}, "height_m is nan"),
    ],
)
def test_what_cannot_be_built_is_said(arguments: dict[str, object], said: str) -> None:
    for build in (body_mesh, legs_mesh):
        with pytest.raises(SettingsError, match=said):
            build(**arguments)  # type: ignore[operator]


@pytest.mark.parametrize("detail", [*DETAIL, 1.5])
@pytest.mark.parametrize("girth", [0.75, 1.4])
@pytest.mark.parametrize("sex", SEXES)
def test_the_grid_of_a_body_goes_beyond_its_flesh_on_all_sides_but_not_far(
    sex: str, girth: float, detail: float
) -> None:
    """Else the surface would not be closed; a grid that is much too large is slow. The middle cuts the body in two."""
    shape, lengths = body_shape(sex), lengths_of(sex, 1.75, AVERAGE)  # type: ignore[arg-type]
    limbs = body_limbs(shape.flesh, lengths, girth, legs_only=False)
    nodes = _grid(limbs, lengths, joint_places(lengths), detail)
    sides = nodes[-1], nodes[:, 0], nodes[:, -1], nodes[:, :, 0], nodes[:, :, -1]
    distances = [
        group_distances(limbs, 1.75 * np.array(WITHIN), np.ascontiguousarray(side.reshape(-1, 3))).min()
        for side in sides
    ]
    assert min(distances) > 0
    assert max(distances) < 0.12
    assert (nodes[..., 0] > 0).all()
    for axis in range(3):
        assert (np.diff(nodes[..., axis], axis=axis) > 0).all()


@given(st.lists(st.tuples(st.floats(0.1, 3), st.floats(0.05, 0.5)), min_size=1, max_size=4), st.floats(-2, 2))
def test_coordinates_go_through_all_bands_in_about_the_step_of_each(
    bands: list[tuple[float, float]], start: float
) -> None:
    ends = start + np.cumsum([width for width, _ in bands])
    x = _steps([(start, end, step) for end, (_, step) in zip(ends, bands, strict=True)])
    assert x[0] == start
    for begin, end, (width, step) in zip([start, *ends[:-1]], ends, bands, strict=True):
        inside = x[(x > begin - 1e-9) & (x < end + 1e-9)]
        np.testing.assert_allclose(inside[[0, -1]], [begin, end], atol=1e-9)
        steps = np.diff(inside)
        np.testing.assert_allclose(steps, steps.mean())
        assert abs(len(steps) - width / step) <= 0.5 + 1e-6 or len(steps) == 1


def test_a_band_that_has_been_passed_adds_no_coordinate() -> None:
    assert _steps([(0.0, 1.0, 0.5), (0.0, 1.0, 0.1), (0.0, 0.5, 0.1)]).tolist() == [0.0, 0.5, 1.0]
