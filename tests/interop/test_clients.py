"""Other programs read our files: Blender, OpenSim, movement, ezc3d and c3d, each in an environment of its own.

uv run --group interop pytest tests/interop

The first run downloads about a gigabyte. Each client prints the positions that it has read as JSON.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.clients import MARKS, read_by

from mocapella.exports.bvh_file import write_bvh
from mocapella.exports.c3d_file import write_c3d
from mocapella.exports.trajectory_arrays import write_netcdf
from mocapella.exports.trc_file import write_trc
from mocapella.geometry.bone_rotations import posed
from mocapella.model.rest_pose import rigid_motion, skeleton_of
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories

pytestmark = MARKS
KIND = topology("kinect_v2")
FRAMES = 20

BLENDER = """
import bpy, json, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_anim.bvh(filepath=sys.argv[1], global_scale=0.01, axis_forward="-Z", axis_up="Y", rotate_mode="NATIVE")
(rig,) = [one for one in bpy.context.scene.objects if one.type == "ARMATURE"]
frames = []
for frame in range(1, int(sys.argv[2]) + 1):
    bpy.context.scene.frame_set(frame)
    frames.append({bone.name: list(rig.matrix_world @ bone.head) for bone in rig.pose.bones})
print(json.dumps([{name: (x, z, -y) for name, (x, y, z) in frame.items()} for frame in frames]))  # its Z is up
"""
OPENSIM = """
import json, opensim, sys
table = opensim.TimeSeriesTableVec3(sys.argv[1])
names = list(table.getColumnLabels())
rows = [table.getRowAtIndex(k) for k in range(table.getNumRows())]
assert table.getTableMetaDataString("Units") == "m"
assert float(table.getTableMetaDataString("DataRate")) == 30.0
print(json.dumps([{n: [row[i][k] for k in range(3)] for i, n in enumerate(names)} for row in rows]))
"""
EZC3D = """
import ezc3d, json, sys
file = ezc3d.c3d(sys.argv[1])
names, points = file["parameters"]["POINT"]["LABELS"]["value"], file["data"]["points"]
assert file["parameters"]["POINT"]["RATE"]["value"][0] == 30.0
assert file["parameters"]["SUBJECTS"]["NAMES"]["value"] == ["anna"]
assert file["parameters"]["EVENT"]["DESCRIPTIONS"]["value"] == ["participant 7, scenario walk"]
count = points.shape[2]
print(json.dumps([{n: [v / 1000 for v in points[:3, i, k]] for i, n in enumerate(names)} for k in range(count)]))
"""
C3D = """
import c3d, json, sys
reader = c3d.Reader(open(sys.argv[1], "rb"))
names = [label.strip() for label in reader.point_labels]
nan = float("nan")
frames = [points for _, points, _ in reader.read_frames()]
places = [[[v / 1000 if p[3] >= 0 else nan for v in p[:3].tolist()] for p in frame] for frame in frames]
print(json.dumps([dict(zip(names, frame)) for frame in places]))
"""
MOVEMENT = """
import json, sys
import xarray
from movement.filtering import filter_by_confidence
from movement.kinematics import compute_velocity
data = xarray.load_dataset(sys.argv[1], engine="scipy")
assert compute_velocity(data.position).shape == data.position.shape
sure = filter_by_confidence(data.position, data.confidence, threshold=0.1)
one = sure.sel(individuals="anna")
print(json.dumps([
    {n: one.sel(keypoints=n).isel(time=k).values.tolist() for n in data.keypoints.values.tolist()}
    for k in range(data.sizes["time"])
]))
"""


def walk() -> Trajectories:
    """A person who walks and turns, whose hand is unknown in the first frame and the last."""
    rng = np.random.default_rng(2)
    rest = rng.normal(size=(len(KIND), 3)) * 0.3
    angle = np.linspace(0, 2, FRAMES)
    turn = np.zeros((FRAMES, 3, 3))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(angle)
    turn[:, 0, 2], turn[:, 2, 0], turn[:, 1, 1] = np.sin(angle), -np.sin(angle), 1.0
    positions = np.einsum("fij,kj->fki", turn, rest) + np.linspace([0, 1, 2], [1, 1.1, 3], FRAMES)[:, None]
    positions += rng.normal(size=positions.shape) * 0.01
    positions[[0, -1], KIND.index("ThumbRight")] = np.nan
    states = np.where(np.isfinite(positions).all(axis=2), 2, 0).astype(np.uint8)
    return Trajectories(
        "people", np.arange(FRAMES) / 30.0, np.zeros(FRAMES, np.int64), ("anna",), KIND.joints, positions[:, None],
        states[:, None], np.full((FRAMES, 1, len(KIND)), 0.004, np.float32), KIND.bones, rate_hz=30.0,
    )  # fmt: skip


def check_positions(frames: list[dict[str, Any]], wanted: np.ndarray, within_m: float) -> None:
    found = np.array([[frame[name] for name in KIND.joints] for frame in frames], dtype=np.float64)
    np.testing.assert_allclose(found, wanted, atol=within_m)


def test_blender_poses_the_skeleton_of_a_bvh(tmp_path: Path) -> None:
    own = walk()
    write_bvh(own, tmp_path / "a.bvh")
    skeleton = skeleton_of(own)
    motion = rigid_motion(own, skeleton)
    wanted = np.empty((FRAMES, len(KIND), 3))
    wanted[:, list(skeleton.keypoints)] = posed(skeleton.parents, skeleton.offsets, motion.root, motion.R)
    frames = read_by(tmp_path, BLENDER, ["bpy==4.4.*", "numpy<2"], str(tmp_path / "a.bvh"), str(FRAMES))
    check_positions(frames, wanted, 1e-3)


@pytest.mark.parametrize(
    ("program", "packages", "write", "name"),
    [
        (OPENSIM, ["opensim>=4.6"], write_trc, "a.trc"),
        (EZC3D, ["ezc3d>=1.7"], write_c3d, "a.c3d"),
        (C3D, ["c3d>=0.6", "numpy"], write_c3d, "a.c3d"),
        (MOVEMENT, ["movement>=0.15"], write_netcdf, "a.nc"),
    ],
    ids=["opensim", "ezc3d", "c3d", "movement"],
)
def test_a_client_reads_the_positions(tmp_path: Path, program: str, packages: list[str], write: Any, name: str) -> None:
    own = replace(walk(), labels={0: {"participant": 7, "scenario": "walk"}})
    write(own, tmp_path / name)
    check_positions(read_by(tmp_path, program, packages, str(tmp_path / name)), own.positions[:, 0], 1e-4)
