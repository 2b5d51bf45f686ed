"""Bones and joints become strokes: what is there is drawn, inferred is thin, missing draws nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.walkers import KINECT, standing

from mocapella.model.observations import JointState
from mocapella.model.topology import topology, topology_names
from mocapella.viewer.bones import (
    INFERRED_THICKNESS,
    LARGEST_HALO_M,
    SURE_SD_M,
    bone_strokes,
    doubt,
    from_up_to,
    halo_strokes,
    join,
    joint_strokes,
    padded,
)
from mocapella.viewer.meshes import ball_mesh, bone_mesh

TRACKED = np.full(25, JointState.TRACKED, np.uint8)
STATES = arrays(np.uint8, 25, elements=st.integers(0, 2))


def rotated_up(wxyz):
    """(n, 3), where a quaternion takes +y: q ⊗ y ⊗ q*."""
    w, x, y, z = np.asarray(wxyz, np.float64).T
    return np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=-1)


@pytest.mark.parametrize("name", topology_names())
def test_a_body_of_which_all_is_tracked_has_every_bone(name):
    kind = topology(name)
    positions = np.random.default_rng(0).normal(size=(3, len(kind), 3))
    strokes = bone_strokes(positions, np.full((3, len(kind)), 2), kind, [(1, 2, 3)] * 3, [0.02] * 3)
    assert len(strokes) == 3 * len(kind.bones)


@given(STATES)
def test_a_bone_is_drawn_exactly_where_both_its_joints_are_and_thin_where_one_is_inferred(states):
    strokes = bone_strokes(standing()[None], states[None], KINECT, [(9, 9, 9)], [0.02])
    weakest = [min(states[a], states[b]) for a, b in KINECT.bones]
    wanted = [0.02 * (1.0 if state == 2 else INFERRED_THICKNESS) for state in weakest if state > 0]
    assert strokes.scales[:, 0] == pytest.approx(wanted)
    assert strokes.scales[:, 2] == pytest.approx(wanted)


@given(STATES)
def test_a_joint_is_drawn_exactly_where_it_is(states):
    strokes = joint_strokes(standing()[None], states[None], [(9, 9, 9)], np.full(25, 0.03))
    wanted = [0.03 * (1.0 if state == 2 else INFERRED_THICKNESS) for state in states if state > 0]
    assert strokes.scales == pytest.approx(np.repeat(np.array(wanted).reshape(-1, 1), 3, axis=1))


def test_joints_of_no_radius_are_left_out():
    assert len(joint_strokes(standing()[None], TRACKED[None], [(9, 9, 9)], np.zeros(25))) == 0


def test_nan_draws_nothing_and_never_reaches_the_browser():
    positions = standing()[None].copy()
    gone = KINECT.index("ElbowLeft")
    positions[0, gone, 1] = np.nan
    bones = bone_strokes(positions, TRACKED[None], KINECT, [(9, 9, 9)], [0.02])
    joints = joint_strokes(positions, TRACKED[None], [(9, 9, 9)], np.full(25, 0.03))
    assert len(bones) == 24 - sum(gone in bone for bone in KINECT.bones)
    assert len(joints) == 24
    for strokes in (bones, joints):
        assert all(np.isfinite(a).all() for a in (strokes.positions, strokes.wxyzs, strokes.scales))


def test_joints_in_one_place_have_no_bone_between_them():
    assert len(bone_strokes(np.zeros((1, 25, 3)), TRACKED[None], KINECT, [(9, 9, 9)], [0.02])) == 0


def test_every_bone_goes_from_its_parent_to_its_child():
    body = standing(0.7)
    strokes = bone_strokes(body[None], TRACKED[None], KINECT, [(9, 9, 9)], [0.02])
    ends = strokes.positions + rotated_up(strokes.wxyzs) * strokes.scales[:, 1:2]
    assert strokes.positions == pytest.approx(np.array([body[a] for a, _ in KINECT.bones]), abs=1e-6)
    assert ends == pytest.approx(np.array([body[b] for _, b in KINECT.bones]), abs=1e-5)


def test_each_skeleton_keeps_its_colour():
    states = np.stack([TRACKED, np.where(np.arange(25) < 12, TRACKED, 0)])
    strokes = bone_strokes(np.stack([standing(), standing()]), states, KINECT, [(1, 2, 3), (4, 5, 6)], [0.02, 0.01])
    first = (strokes.colours == (1, 2, 3)).all(axis=1)
    assert first.sum() == 24
    assert ((strokes.colours == (4, 5, 6)).all(axis=1) == ~first).all()


@given(arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_the_turn_takes_up_to_the_direction(v):
    direction = v / np.linalg.norm(v)
    q = from_up_to(direction[None])
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-6)
    assert rotated_up(q)[0] == pytest.approx(direction, abs=1e-4)


def test_straight_down_is_a_turn_too():
    assert rotated_up(from_up_to(np.array([[0.0, -1.0, 0.0]])))[0] == pytest.approx([0, -1, 0], abs=1e-6)


@given(st.integers(0, 40))
def test_padding_adds_what_has_no_size(extra):
    strokes = bone_strokes(standing()[None], TRACKED[None], KINECT, [(9, 9, 9)], [0.02])
    filled = padded(strokes, len(strokes) + extra)
    assert len(filled) == len(strokes) + extra
    assert (filled.scales[len(strokes) :] == 0).all()
    assert np.array_equal(filled.positions[: len(strokes)], strokes.positions)


def test_nothing_joined_is_nothing():
    assert len(join([])) == 0


@pytest.mark.parametrize("mesh", [bone_mesh(), ball_mesh()])
def test_meshes_face_outwards(mesh):
    """Divergence theorem: a closed surface whose faces look outwards has a positive volume."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume > 0
    if mesh.vertices[:, 1].min() < -0.5:
        assert volume == pytest.approx(4 / 3 * np.pi, rel=0.12)


SDS = arrays(np.float32, 25, elements=st.sampled_from([np.nan, 0.0, 1 / 64, 1 / 16, 1 / 8, 0.5]))


@given(SDS, SDS)
def test_who_is_less_sure_never_looks_surer(one, other):
    low, high = np.fmin(one, other), np.fmax(one, other)
    low = np.where(np.isnan(one) | np.isnan(other), np.nan, low)
    assert (doubt(low) <= doubt(high)).all()
    for strokes in (
        lambda sd: bone_strokes(standing()[None], TRACKED[None], KINECT, [(9, 9, 9)], [0.02], doubts=doubt(sd[None])),
        lambda sd: joint_strokes(
            standing()[None], TRACKED[None], [(9, 9, 9)], np.full(25, 0.03), doubts=doubt(sd[None])
        ),
    ):
        assert (strokes(high).scales[:, 0] <= strokes(low).scales[:, 0]).all()


def test_a_method_that_says_nothing_of_doubt_is_drawn_as_before():
    unsaid = doubt(np.full((1, 25), np.nan))
    assert (unsaid == 0).all()
    states = np.where(np.arange(25) % 3 == 0, JointState.INFERRED, JointState.TRACKED)[None]
    plain = joint_strokes(standing()[None], states, [(9, 9, 9)], np.full(25, 0.03))
    assert np.array_equal(
        joint_strokes(standing()[None], states, [(9, 9, 9)], np.full(25, 0.03), doubts=unsaid).scales, plain.scales
    )
    assert len(halo_strokes(standing()[None], states, np.full((1, 25), np.nan), [(9, 9, 9)])) == 0


@given(SDS, STATES)
def test_exactly_the_unsure_joints_have_a_halo_as_wide_as_they_are_unsure(sd, states):
    halos = halo_strokes(standing()[None], states[None], sd[None], [(9, 9, 9)])
    unsure = (np.nan_to_num(sd) > SURE_SD_M) & (states > 0)
    assert halos.positions == pytest.approx(standing()[unsure].astype(np.float32))
    assert halos.scales == pytest.approx(np.repeat(np.minimum(sd[unsure], LARGEST_HALO_M)[:, None], 3, axis=1))
    assert ((halos.opacities > 0) & (halos.opacities <= 1)).all()
    assert (np.diff(halos.opacities[np.argsort(halos.scales[:, 0])]) >= 0).all()
