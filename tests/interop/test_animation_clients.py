"""Blender imports our GLB, and usd-core our USD: the joints and the skin are where we put them.

uv run --group interop pytest tests/interop
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.animated_files import read_glb, read_usd
from support.clients import MARKS, read_by
from support.humanoid_people import joints, observable_pose, people, world_rotations

from mocapella.exports.glb_file import write_glb
from mocapella.exports.usd_file import write_usd
from mocapella.geometry.bone_rotations import posed
from mocapella.model.humanoid_bones import HUMANOIDS
from mocapella.model.humanoid_joints import JOINTS
from mocapella.model.humanoid_motion import humanoid_motion
from mocapella.model.trajectories import Trajectories

pytestmark = MARKS
FRAMES = 8
EVERY_VERTEX = 50

BLENDER = f"""
import bpy, json, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 30
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
(rig,) = [one for one in scene.objects if one.type == "ARMATURE"]
(skin,) = [one for one in scene.objects if one.type == "MESH" and one.parent is not None]
def ours(place):  # its Z is up
    x, y, z = place
    return x, z, -y
frames = []
for frame in range(int(sys.argv[2])):
    scene.frame_set(frame)
    mesh = skin.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    frames.append({{
        "joints": {{bone.name: ours(rig.matrix_world @ bone.head) for bone in rig.pose.bones}},
        "skin": [ours(skin.matrix_world @ vertex.co) for vertex in mesh.vertices][::{EVERY_VERTEX}],
    }})
print(json.dumps(frames))
"""
USD = f"""
import json, sys
from pxr import Usd, UsdGeom, UsdSkel, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0 and UsdGeom.GetStageUpAxis(stage) == "Y"
assert stage.GetTimeCodesPerSecond() == 30.0 and stage.GetEndTimeCode() == int(sys.argv[2]) - 1
validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
problems = [one.GetErrorAsString() for one in UsdValidation.ValidationContext(validators).Validate(stage)]
assert not problems, problems
root = UsdSkel.Root(stage.GetDefaultPrim())
cache = UsdSkel.Cache()
cache.Populate(root, Usd.PrimDefaultPredicate)
(binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
skeleton = cache.GetSkelQuery(binding.GetSkeleton())
assert skeleton and skeleton.HasBindPose() and skeleton.HasRestPose()
(target,) = binding.GetSkinningTargets()
points = UsdGeom.PointBased(target.GetPrim()).GetPointsAttr().Get()
names = [path.rpartition("/")[2] for path in skeleton.GetJointOrder()]
frames = []
for frame in range(int(sys.argv[2])):
    places = [list(T.ExtractTranslation()) for T in skeleton.ComputeJointSkelTransforms(frame)]
    moved = type(points)(points)
    assert target.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(frame), moved, frame)
    frames.append({{"joints": dict(zip(names, places)), "skin": [list(p) for p in moved][::{EVERY_VERTEX}]}})
print(json.dumps(frames))
"""


def dancer() -> Trajectories:
    """A person with fingers who moves."""
    root = np.linspace([0.3, 0.9, 2.0], [1.0, 1.0, 2.5], FRAMES)
    pose = observable_pose(8, 2)
    pose = {part: np.linspace(turn[0], turn[1], FRAMES) for part, turn in pose.items()}
    return people(joints(world_rotations(pose, FRAMES), root, hands=True), JOINTS)


@pytest.mark.parametrize("humanoid", HUMANOIDS)
@pytest.mark.parametrize(
    ("suffix", "program", "packages"),
    [(".glb", BLENDER, ["bpy==4.4.*", "numpy<2"]), (".usda", USD, ["usd-core"])],
    ids=["blender", "usd-core"],
)
def test_a_program_poses_the_joints_and_the_skin(
    tmp_path: Path, humanoid: str, suffix: str, program: str, packages: list[str]
) -> None:
    own, file = dancer(), tmp_path / f"a{suffix}"
    (write_glb if suffix == ".glb" else write_usd)(own, file, humanoid=humanoid)
    ours = (read_glb if suffix == ".glb" else read_usd)(file)
    motion = humanoid_motion(own, humanoid)
    wanted = posed(motion.skeleton.parents, motion.skeleton.offsets, motion.root, motion.R)
    frames = read_by(tmp_path, program, packages, str(file), str(FRAMES))
    found = np.array([[frame["joints"][name] for name in ours.names] for frame in frames])
    np.testing.assert_allclose(found, wanted, atol=1e-3)
    skins = np.array([frame["skin"] for frame in frames])
    np.testing.assert_allclose(skins, [ours.posed(k)[::EVERY_VERTEX] for k in range(FRAMES)], atol=1e-3)
