"""GLB and USD: the files' forward kinematics gives the rigid joints, and the skin follows the bones."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.animated_files import Animated, read_glb, read_usd
from support.humanoid_people import joints, observable_pose, people, world_rotations

from mocapella.errors import SettingsError
from mocapella.exports.animated_skeleton import animated_skeleton
from mocapella.exports.bvh_file import CM_PER_M, write_bvh
from mocapella.exports.glb_file import write_glb
from mocapella.exports.usd_file import write_usd
from mocapella.geometry.bone_rotations import posed
from mocapella.model.body_meshes import body_mesh
from mocapella.model.bvh import read_bvh
from mocapella.model.hand import LANDMARKS
from mocapella.model.humanoid_bones import FINGERS, HUMANOIDS
from mocapella.model.humanoid_joints import INDEX, JOINTS
from mocapella.model.humanoid_motion import humanoid_motion
from mocapella.model.rigged_mesh import landmarks_at, rest
from mocapella.model.skeleton import SKELETON
from mocapella.model.trajectories import HAND_BONES, Trajectories

FRAMES = 6
FORMATS = {".glb": (write_glb, read_glb), ".usda": (write_usd, read_usd)}
Format = tuple[Callable[..., list[str]], Callable[[Path], Animated]]
both = pytest.mark.parametrize("suffix", FORMATS)


def dancer(seed: int) -> Trajectories:
    root = np.array([0.3, 0.9, 2.0]) + np.random.default_rng(seed).normal(size=(FRAMES, 3)) * 0.1
    return people(joints(world_rotations(observable_pose(seed, FRAMES), FRAMES), root))


def hand() -> Trajectories:
    rng = np.random.default_rng(4)
    rest = np.cumsum(rng.normal(size=(len(LANDMARKS), 3)) * 0.02, axis=0)
    return replace(people(rest + rng.normal(size=(4, 1, 3)) * 0.1, LANDMARKS, "hands"), bones=HAND_BONES)


def written(own: Trajectories, folder: Path, suffix: str, humanoid: str | None = None) -> tuple[Animated, list[str]]:
    write, read = FORMATS[suffix]
    notes = write(own, folder / f"a{suffix}", humanoid=humanoid)
    return read(folder / f"a{suffix}"), notes


@settings(deadline=None, max_examples=4)
@given(
    seed=st.integers(0, 2**32 - 1), humanoid=st.sampled_from(sorted(HUMANOIDS)), suffix=st.sampled_from(sorted(FORMATS))
)
def test_joints_of_the_file_are_those_of_the_rigid_skeleton(
    seed: int, humanoid: str, suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    own = dancer(seed)
    found, _ = written(own, tmp_path_factory.mktemp("file"), suffix, humanoid)
    motion = humanoid_motion(own, humanoid)
    wanted = posed(motion.skeleton.parents, motion.skeleton.offsets, motion.root, motion.R)
    np.testing.assert_allclose(found.positions, wanted, atol=1e-5)
    assert found.names == [name.replace(":", "_") if suffix == ".usda" else name for name in motion.skeleton.names]
    np.testing.assert_allclose(found.times_s, own.times_s, atol=1e-6)
    assert (np.sum(found.rotations[1:] * found.rotations[:-1], axis=-1) >= -1e-6).all()


@both
def test_the_skin_is_closed_stands_on_the_ground_and_follows_the_bones(tmp_path: Path, suffix: str) -> None:
    own = dancer(5)
    found, _ = written(own, tmp_path, suffix)
    x, faces = found.vertices, found.faces
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    volume = np.einsum("fi,fi->", x[faces[:, 0]], np.cross(x[faces[:, 1]], x[faces[:, 2]])) / 6
    assert 0.05 < volume < 0.12  # m³ of an average man, seen from outside
    assert abs(x[:, 1].min()) < 1e-6
    assert 1.6 < x[:, 1].max() < 1.9
    np.testing.assert_allclose(found.shares.sum(axis=1), 1.0, atol=1e-5)
    for frame in range(FRAMES):
        posed_skin = found.posed(frame)
        for joint in ("leftLowerArm", "rightLowerLeg", "head", "rightHand"):
            k = found.names.index(joint)
            alone = (found.joints == k) & (found.shares > 0.999)
            own_vertices = alone.any(axis=1)
            assert own_vertices.any()
            rest = np.linalg.inv(found.skinning[frame, k])[:3] @ [*found.positions[frame, k], 1.0]
            far = np.linalg.norm(posed_skin[own_vertices] - found.positions[frame, k], axis=1)
            np.testing.assert_allclose(far, np.linalg.norm(x[own_vertices] - rest, axis=1), atol=1e-5)
            assert far.max() < 0.45


@both
def test_fingers_move_the_mesh_of_a_hand(tmp_path: Path, suffix: str) -> None:
    pose = observable_pose(9, FRAMES)
    pose |= {part: np.outer(np.linspace(0, 1, FRAMES), [0, 0, -1]) for part in FINGERS if part.startswith("left index")}
    positions = joints(world_rotations(pose, FRAMES), np.zeros((FRAMES, 3)), hands=True)
    positions[:, INDEX["right hand wrist"] :] = np.nan
    found, _ = written(people(positions, JOINTS), tmp_path, suffix)
    edges = np.sort(np.concatenate([found.faces[:, [0, 1]], found.faces[:, [1, 2]], found.faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    x, faces = found.vertices, found.faces
    assert np.einsum("fi,fi->", x[faces[:, 0]], np.cross(x[faces[:, 1]], x[faces[:, 2]])) > 0
    tip = positions[:, INDEX["left hand index tip"]]
    for frame in range(FRAMES):
        assert np.linalg.norm(found.posed(frame) - tip[frame], axis=1).min() < 0.012
    assert "rightIndexProximal" not in found.names
    assert {"leftThumbMetacarpal", "leftLittleDistal"} <= set(found.names)


@settings(deadline=None, max_examples=4)
@given(scale=st.floats(0.6, 1.3), arm=st.floats(0.7, 1.4))
def test_the_skin_has_the_lengths_of_the_person(scale: float, arm: float) -> None:
    """Around each joint at rest there is skin, and none is far from all bones."""
    own = dancer(1)
    rest = scale * own.positions[:, 0]
    for side in ("Left", "Right"):
        at = [SKELETON.index(f"{name}{side}") for name in ("Elbow", "Wrist", "Hand", "HandTip", "Thumb")]
        rest[:, at] += (arm - 1) * (rest[:, at[:1]] - rest[:, [SKELETON.index(f"Shoulder{side}")]])
    one = animated_skeleton(people(rest), "vrm")
    for joint, place in zip(one.motion.skeleton.names, one.rest, strict=True):
        nearest = np.linalg.norm(one.skin.vertices - place, axis=1).min()
        assert nearest < 0.17 * scale, joint
    assert abs(one.skin.vertices[:, 1].max() / scale - 1.75) < 0.15


@both
@pytest.mark.parametrize("kind", ["hands", "arms"])
def test_hands_have_capsules_around_the_bones_of_their_landmarks(tmp_path: Path, suffix: str, kind: str) -> None:
    own = replace(hand(), kind=kind)
    found, notes = written(own, tmp_path, suffix, "unity")
    assert {name.replace("_", " ") for name in found.names} == set(LANDMARKS)
    at = [found.names.index(name.replace(" ", "_") if suffix == ".usda" else name) for name in LANDMARKS]
    np.testing.assert_allclose(found.positions[:, at], own.positions[:, 0], atol=1e-5)
    assert notes == ["bones are rigid: joints are 0 mm off in the median, 0 mm at 95 %"]
    rest = np.linalg.inv(found.skinning[0])[:, :3, :3] @ found.positions[0][..., None]
    assert np.isfinite(rest).all()


def test_a_glb_of_vrm_is_a_vrm_animation(tmp_path: Path) -> None:
    found, _ = written(dancer(2), tmp_path, ".glb")
    (extension,) = found.extra.extensions.values()
    bones = extension["humanoid"]["humanBones"]
    assert list(found.extra.extensions) == found.extra.extensionsUsed == ["VRMC_vrm_animation"]
    assert {name: found.extra.nodes[bone["node"]].name for name, bone in bones.items()} == {n: n for n in found.names}
    assert not written(dancer(2), tmp_path, ".glb", "unity")[0].extra.extensions


@both
def test_what_is_held_and_observed_is_marked(tmp_path: Path, suffix: str) -> None:
    own = dancer(3)
    own.positions[2:4, :, SKELETON.index("HandLeft")] = np.nan
    found, notes = written(own, tmp_path, suffix)
    if suffix == ".glb":
        marks = found.extra.animations[0].extras["mocapella"]
    else:
        marks = json.loads(json.loads(re.findall(r"string mocapella = (.*)", found.extra)[0]))
    assert marks["held"] == {"leftHand": [[2, 3]]}
    assert marks["twist_observed"]["leftUpperArm"] == [[0, FRAMES - 1]]
    assert "head" not in marks["twist_observed"]
    assert marks["humanoid"] == "vrm"
    assert marks["residual_mm"]["p95"] < 0.01
    assert notes[1] == "2% of the joints are unknown and keep their last rotation"
    assert "left upper arm 100%" in notes[2]
    assert "head 0%" in notes[2]


@pytest.mark.parametrize("humanoid", HUMANOIDS)
def test_a_bvh_has_the_names_and_rest_pose_of_a_humanoid(tmp_path: Path, humanoid: str) -> None:
    own = dancer(6)
    write_bvh(own, tmp_path / "a.bvh", humanoid=humanoid)
    bvh, motion = read_bvh(tmp_path / "a.bvh"), humanoid_motion(own, humanoid)
    places = dict(zip([joint.name for joint in bvh.joints], np.moveaxis(bvh.positions(), 1, 0) / CM_PER_M, strict=True))
    wanted = posed(motion.skeleton.parents, motion.skeleton.offsets, motion.root, motion.R)
    for k, name in enumerate(motion.skeleton.names):
        np.testing.assert_allclose(places[name], wanted[:, k], atol=1e-5)


def test_a_bvh_of_a_body_has_the_usual_humanoid(tmp_path: Path) -> None:
    """The landmarks of a body have no tree of bones."""
    mesh = body_mesh("male", 1.8)
    own = people(np.tile(landmarks_at(mesh, rest(mesh)), (2, 1, 1)), tuple(mesh.landmarks), "bodies")
    write_bvh(own, tmp_path / "a.bvh")
    names = [joint.name for joint in read_bvh(tmp_path / "a.bvh").joints]
    assert set(HUMANOIDS["vrm"].values()) - set(names) == {HUMANOIDS["vrm"][part] for part in FINGERS}


def test_the_glb_is_laid_out_as_the_standard_says(tmp_path: Path) -> None:
    """glTF 2.0, section 4.4 and 3.6.2: chunks and accessors begin at multiples of 4."""
    write_glb(dancer(1), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    content = json.loads(data[20 : 20 + size])
    assert size % 4 == 0
    assert struct.unpack_from("<I4s", data, 20 + size) == (content["buffers"][0]["byteLength"], b"BIN\0")
    for view in content["bufferViews"]:
        assert view["byteOffset"] % 4 == view["byteLength"] % 4 == 0
    position = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    assert len(position["min"]) == len(position["max"]) == 3


@both
def test_names_that_a_format_forbids_are_replaced(tmp_path: Path, suffix: str) -> None:
    own = replace(dancer(1), individuals=('7 "ä"\n/x',))
    found, _ = written(own, tmp_path, suffix)
    if suffix == ".usda":
        assert 'def SkelRoot "_7______x"' in found.extra
    else:
        assert found.extra.nodes[-1].name == '7 "ä"\n/x'


@both
def test_a_file_of_one_frame_is_read(tmp_path: Path, suffix: str) -> None:
    own = dancer(1).at(slice(0, 1))
    found, _ = written(replace(own, rate_hz=30.0), tmp_path, suffix)
    assert found.positions.shape[0] == 1


@both
@pytest.mark.parametrize("kind", ["people", "bodies"])
def test_what_has_no_skeleton_is_refused(tmp_path: Path, suffix: str, kind: str) -> None:
    own = people(np.zeros((3, 2, 3)), ("a", "b"), kind)
    with pytest.raises(SettingsError, match=f"anna is no humanoid: {kind} with the keypoints a, b, … have none"):
        written(own, tmp_path, suffix)


def test_a_file_beyond_the_size_of_a_glb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.exports.glb_file._MOST_BYTES", 1000)
    with pytest.raises(SettingsError, match="anna: a GLB of 0 GB is too large; choose a lower --rate"):
        write_glb(dancer(1), tmp_path / "a.glb")
    assert not (tmp_path / "a.glb").exists()
