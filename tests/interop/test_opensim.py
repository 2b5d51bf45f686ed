"""OpenSim scales our skeleton, solves inverse kinematics on our TRC, and finds our angles; it reads our MOT and STO.

uv run --group interop pytest tests/interop/test_opensim.py -m slow
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.clients import MARKS, read_by
from support.posed_person import HALPE, KINECT, LENGTHS, person, points_of

from mocapella.exports.opensim_folder import write_opensim
from mocapella.exports.storage_file import COORDINATES, PELVIS, write_sto
from mocapella.model.trajectories import Trajectories

pytestmark = MARKS
FRAMES = 90
PACKAGES = ["opensim>=4.6"]
SCALE_AND_SOLVE = """
import json, opensim
assert opensim.ScaleTool("scale.xml").run()
assert opensim.InverseKinematicsTool("ik.xml").run()
model = opensim.Model("scaled.osim")
model.initSystem()

def table(path):
    found = opensim.TimeSeriesTable(path)
    names = list(found.getColumnLabels())
    return {name: list(found.getDependentColumn(name).to_numpy()) for name in names}

own = table("angles.mot")
known = {model.getCoordinateSet().get(k).getName() for k in range(model.getNumCoordinates())}
assert set(own) <= known, set(own) - known
storage = opensim.Storage("angles.mot")
assert storage.isInDegrees()
print(json.dumps([{"ik": table("ik.mot"), "own": own, "errors": table("mocapella_ik_marker_errors.sto")}]))
"""
READ_STO = """
import json, opensim, sys
found = opensim.TimeSeriesTable(sys.argv[1])
assert found.getTableMetaDataString("inDegrees") == "yes"
print(json.dumps([{name: list(found.getDependentColumn(name).to_numpy()) for name in found.getColumnLabels()}]))
"""
MIDDLE_DEG = {"knee_angle": 60.0, "elbow_flex": 70.0, "hip_flexion": 20.0, "arm_flex": 20.0, "arm_add": -20.0}
SWING_DEG = {
    "knee_angle": 30.0, "elbow_flex": 35.0, "hip_flexion": 35.0, "arm_flex": 30.0, "arm_add": 15.0,
    "pelvis_rotation": 30.0, "ankle_angle": 20.0,
}  # fmt: skip


def motion(seed: int, kind: str) -> Trajectories:
    """A person of other proportions than the generic skeleton, who walks along and swings every joint."""
    names = {"kinect_v2": KINECT, "halpe_26": HALPE}[kind]
    rng, t = np.random.default_rng(seed), np.arange(FRAMES) / 30.0
    made = {"pelvis_tx": 0.8 * t, "pelvis_ty": np.full(FRAMES, 0.9), "pelvis_tz": 0.1 * np.sin(t)}
    for name in COORDINATES:
        if name not in PELVIS:
            kept = name.removesuffix("_r").removesuffix("_l")
            swing = SWING_DEG.get(kept, 12.0) * np.sin(2 * np.pi * t * rng.uniform(0.3, 1.0) + rng.uniform(0, 6))
            made[name] = np.radians(MIDDLE_DEG.get(kept, 0.0) + swing)
    if "lumbar" not in names:  # only the whole spine is seen
        made["lumbar_extension"] = made["lumbar_bending"] = np.zeros(FRAMES)
    lengths = {name: length * rng.uniform(0.9, 1.1) for name, length in LENGTHS.items()}
    heel = "heel_r" in names
    own = person(points_of(made, FRAMES, lengths, foot_drop=0.07 if heel else 0.0), kind, names)
    positions, states = own.positions.copy(), own.states.copy()
    wrist = own.keypoints.index(names["wrist_r"])
    positions[40:45, 0, wrist], states[40:45, 0, wrist] = math.nan, 0
    return replace(own, positions=positions, states=states)


@pytest.mark.parametrize(("seed", "kind"), [(1, "kinect_v2"), (2, "kinect_v2"), (3, "halpe_26"), (4, "halpe_26")])
def test_inverse_kinematics_of_the_scaled_skeleton_gives_our_angles(tmp_path: Path, seed: int, kind: str) -> None:
    folder = tmp_path / "a.opensim"
    write_opensim(motion(seed, kind), folder)
    (found,) = read_by(folder, SCALE_AND_SOLVE, PACKAGES)
    rms_m = np.array(found["errors"]["marker_error_RMS"])
    print(f"markers: {1000 * rms_m.mean():.1f} mm RMS")
    assert rms_m.max() < 0.012
    assert len(found["own"]) >= 25
    for name, own in found["own"].items():
        values, wanted = np.array(found["ik"][name]), np.array(own)
        known = np.isfinite(wanted)
        assert known.mean() > 0.9
        error = np.abs(values - wanted)[known]
        print(f"{name}: {np.sqrt(np.mean(error**2)):.3f} RMS, {error.max():.3f} most")
        assert error.max() < (0.01 if name in PELVIS else 1.0), name


def test_opensim_reads_every_angle_of_a_sto(tmp_path: Path) -> None:
    own = motion(4, "kinect_v2")
    write_sto(own, tmp_path / "a.sto")
    (found,) = read_by(tmp_path, READ_STO, PACKAGES, str(tmp_path / "a.sto"))
    assert {"shoulder_elevation_r", "knee_angle_l", *PELVIS} <= set(found)
    gaps = np.isnan(np.array(found["elbow_flex_r"], dtype=np.float64))
    np.testing.assert_array_equal(np.flatnonzero(gaps), np.arange(40, 45))
