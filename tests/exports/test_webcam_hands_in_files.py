"""People of the method webcams with their hands in files: names, fingers and states."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.animated_files import read_glb, read_usd

from mocapella.exports.bvh_file import write_bvh
from mocapella.exports.c3d_file import write_c3d
from mocapella.exports.glb_file import write_glb
from mocapella.exports.trajectory_tables import write_csv
from mocapella.exports.trc_file import write_trc
from mocapella.exports.usd_file import write_usd
from mocapella.model.bvh import read_bvh
from mocapella.model.hand import LANDMARKS
from mocapella.model.humanoid_bones import FINGERS, humanoid_names
from mocapella.model.humanoid_hands import with_hands
from mocapella.model.observations import Arrival, JointState
from mocapella.model.resampling import resampled
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories, trajectories_of
from mocapella.sources.simulate.hand_keypoints import hand_frames, hand_keypoint_scene
from mocapella.tracker.webcams import WebcamsTracker

SECONDS = 2.8
"""The left hand is seen by one camera only from 2 s on."""


@cache
def tracked() -> dict[str, Trajectories]:
    scene = hand_keypoint_scene("one-camera")
    tracker = WebcamsTracker(scene.rig, sensors_expected=len(scene.rig.cameras))
    scenes = []
    for item in hand_frames(scene, 1, seconds=SECONDS):
        scenes.append((0, item.at_ns, tracker.update(Arrival(item.frame, item.at_ns))))
    return trajectories_of(scenes)


@cache
def constant(kind: str, individual: str) -> Trajectories:
    return resampled(tracked()[kind].of(individual), 30.0)


@cache
def whole_person() -> Trajectories:
    found = tracked()
    return resampled(with_hands(found["people"], found).of("person_0"), 30.0)


def test_a_table_has_the_names_of_the_joints_and_says_which_landmarks_one_camera_sees(tmp_path: Path) -> None:
    found = tracked()
    assert found["people"].keypoints == topology("halpe_26").joints
    assert found["hands"].keypoints == LANDMARKS
    assert found["hands"].individuals == ("hand_0_left", "hand_1_right")
    write_csv(found["hands"], tmp_path / "hands.csv")
    with (tmp_path / "hands.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["time_s"]) > 2.3]
    states = {name: {row["state"] for row in rows if row["individual"] == name} for name in found["hands"].individuals}
    assert states["hand_0_left"] == {"inferred"}
    assert "measured" in states["hand_1_right"]
    assert all(row["sd_m"] for row in rows)


def test_one_individual_files_have_the_hand_at_a_constant_rate(tmp_path: Path) -> None:
    one = constant("hands", "hand_0_left")
    write_trc(one, tmp_path / "hand.trc")
    names = (tmp_path / "hand.trc").read_text(encoding="utf-8").splitlines()[3].split("\t")
    assert [name.replace("_", " ") for name in names[2::3] if name] == list(LANDMARKS)
    write_c3d(one, tmp_path / "hand.c3d")
    assert (tmp_path / "hand.c3d").stat().st_size > len(one) * len(LANDMARKS) * 16


@pytest.mark.parametrize("humanoid", ["vrm", "unity", "mixamo"])
def test_a_humanoid_bvh_has_the_fingers(tmp_path: Path, humanoid: str) -> None:
    write_bvh(whole_person(), tmp_path / "a.bvh", humanoid=humanoid)
    text = (tmp_path / "a.bvh").read_text(encoding="utf-8")
    names = humanoid_names(humanoid)
    for part in FINGERS:
        if part in names:
            assert f"JOINT {names[part]}\n" in text, part


@pytest.mark.parametrize("suffix", [".glb", ".usda"])
def test_fingers_of_an_animated_person_follow_the_landmarks(tmp_path: Path, suffix: str) -> None:
    own, path = whole_person(), tmp_path / f"a{suffix}"
    (write_glb if suffix == ".glb" else write_usd)(own, path, humanoid="vrm")
    found = (read_glb if suffix == ".glb" else read_usd)(path)
    k = own.keypoints.index("right hand index PIP")
    wrist = own.keypoints.index("right hand wrist")
    wanted = own.positions[:, 0, k] - own.positions[:, 0, wrist]
    at = {name: found.names.index(name) for name in ("rightIndexIntermediate", "rightHand")}
    shown = found.positions[:, at["rightIndexIntermediate"]] - found.positions[:, at["rightHand"]]
    late = slice(30, None)
    away = np.linalg.norm(shown[late] - wanted[late], axis=1)
    assert np.nanmedian(away) < 0.015


def test_the_state_of_a_persons_hand_is_that_of_the_hand() -> None:
    own = whole_person()
    left = [k for k, name in enumerate(own.keypoints) if name.startswith("left hand")]
    late = own.times_s > 2.3
    assert (own.states[late][:, 0, left] == JointState.INFERRED).all()


def test_a_file_of_a_body_of_joints_alone_is_read_back(tmp_path: Path) -> None:
    one = constant("people", "person_0")
    notes = write_bvh(one, tmp_path / "body.bvh")
    assert any("bones are rigid" in note for note in notes)
    found = read_bvh(tmp_path / "body.bvh")
    assert {joint.name for joint in found.joints} >= {"LWrist", "RWrist", "LBigToe"}
