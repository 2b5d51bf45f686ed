"""The folder for OpenSim: its files name each other's markers, bodies and times. tests/interop runs OpenSim on it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from support.posed_person import HALPE, KINECT, MEDIAPIPE, person, points_of

from mocapella.errors import SettingsError
from mocapella.exports.opensim_folder import write_opensim
from mocapella.exports.opensim_model import MIDDLES, SOLES, skeleton_for
from mocapella.exports.storage_file import COORDINATES
from mocapella.model.anatomy import anatomy_of
from mocapella.model.topology import topology
from mocapella.recording.trc_file import read_trc

FRAMES = 30
FILES = {"markers.trc", "angles.mot", "model.osim", "scale.xml", "ik.xml", "README.txt"}
KINDS = {"kinect_v2": KINECT, "halpe_26": HALPE, "mediapipe_pose": MEDIAPIPE}


def texts(path: Path, name: str) -> list[str]:
    return [(one.text or "").strip() for one in ElementTree.parse(path).iter(name)]


def names(path: Path, kind: str) -> list[str]:
    return [one.attrib["name"] for one in ElementTree.parse(path).iter(kind)]


@pytest.mark.parametrize("kind", KINDS)
def test_the_files_fit_each_other(kind: str, tmp_path: Path) -> None:
    own = person(points_of({"knee_angle_r": np.full(FRAMES, 0.5)}, FRAMES), kind, KINDS[kind])
    folder = tmp_path / "a.opensim"
    write_opensim(own, folder)
    assert {one.name for one in folder.iterdir()} == FILES
    trc = read_trc(folder / "markers.trc")
    markers, bodies = names(folder / "model.osim", "Marker"), names(folder / "model.osim", "Body")
    assert set(markers) <= set(trc.keypoints)
    made = {*MIDDLES, *(SOLES if kind != "kinect_v2" else ())}
    assert made <= set(markers)
    assert set(names(folder / "ik.xml", "IKMarkerTask")) == set(markers) - made
    for pair in texts(folder / "scale.xml", "markers"):
        assert set(pair.split()) <= set(markers)
    assert set(names(folder / "scale.xml", "BodyScale")) == set(bodies)
    assert set(names(folder / "model.osim", "Coordinate")) == set(COORDINATES)
    for name in ("scale.xml", "ik.xml"):
        (found,) = texts(folder / name, "time_range")
        np.testing.assert_allclose([float(word) for word in found.split()], [0.0, 29 / 30], atol=1e-6)
    locked = dict(zip(names(folder / "model.osim", "Coordinate"), texts(folder / "model.osim", "locked"), strict=True))
    assert [name for name, text in locked.items() if text == "true"] == (
        [] if kind == "kinect_v2" else ["lumbar_extension"]
    )
    hips = [KINDS[kind][f"hip_{side}"] for side in "rl"]
    middle = trc.positions[:, 0, [trc.keypoints.index(name) for name in hips]].mean(axis=1)
    np.testing.assert_allclose(trc.positions[:, 0, trc.keypoints.index("hips_middle")], middle, atol=1e-6)


def test_the_scaling_uses_the_longest_time_at_which_all_joints_are_known(tmp_path: Path) -> None:
    own = person(points_of({}, FRAMES))
    positions = own.positions.copy()
    positions[[4, 20], 0, own.keypoints.index("KneeLeft")] = math.nan
    positions[10:15, 0, own.keypoints.index("SpineShoulder")] = math.nan  # not needed for the scaling
    write_opensim(replace(own, positions=positions), tmp_path / "a.opensim")
    (found,) = texts(tmp_path / "a.opensim" / "scale.xml", "time_range")
    np.testing.assert_allclose([float(word) for word in found.split()], [5 / 30, 19 / 30], atol=1e-6)
    positions[::2, 0, own.keypoints.index("KneeLeft")] = math.nan
    for gaps in (positions, np.full_like(positions, math.nan)):
        with pytest.raises(SettingsError, match="no two frames in a row with all joints"):
            write_opensim(replace(own, positions=gaps), tmp_path / "b.opensim")
    assert not (tmp_path / "b.opensim").exists()


def test_points_of_no_body_have_no_skeleton(tmp_path: Path) -> None:
    own = person(points_of({}, FRAMES))
    other = replace(own, keypoints=tuple(f"m{k}" for k in range(len(own.keypoints))), bones=())
    with pytest.raises(SettingsError, match=r"no skeleton for OpenSim: .*topologies with one: arkit"):
        write_opensim(other, tmp_path / "a.opensim")


@pytest.mark.parametrize("name", ["arkit", "azure_kinect", "body_25", "coco_17", "halpe_26", "kinect_v1", "kinect_v2"])
def test_each_topology_has_markers_at_the_joints_of_its_limbs(name: str) -> None:
    joints = topology(name).joints
    own = skeleton_for(joints, anatomy_of(joints))
    for point in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"):
        assert {f"{point}_r", f"{point}_l"} <= own.points.keys()
    assert set(own.points.values()) <= own.markers.keys()


def test_the_sole_is_the_point_of_the_foot_below_the_ankle(tmp_path: Path) -> None:
    own = person(points_of({"ankle_angle_r": np.full(FRAMES, 0.3)}, FRAMES, foot_drop=0.07), "halpe_26", HALPE)
    write_opensim(own, tmp_path / "a.opensim")
    trc = read_trc(tmp_path / "a.opensim" / "markers.trc")
    sole, ankle, heel, toe = (
        trc.positions[:, 0, trc.keypoints.index(name)] for name in ("sole_r", "RAnkle", "RHeel", "RBigToe")
    )
    np.testing.assert_allclose(np.linalg.norm(sole - ankle, axis=1), 0.07, atol=1e-5)
    np.testing.assert_allclose(np.sum((sole - ankle) * (toe - heel), axis=1), 0.0, atol=1e-6)
