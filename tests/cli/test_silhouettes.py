"""`mocapella track silhouettes` as a user runs it, with everything that users get wrong."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.programs import Program, result_here, run_here, wait_until
from support.silhouette_pictures import Room, pose_at, ring, somebody, write_folders, write_video

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.body_meshes import legs_mesh
from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.rigged_mesh_file import save_rigged_mesh
from mocapella.recording.take_reader import read_take

MESH, RIG, FRAMES, HZ = somebody(), ring(3), 6, 30
POSES = [pose_at(MESH, 0.01 * k, 0.4 + 0.04 * k) for k in range(FRAMES)]
JOINTS = {
    name: at.tolist()
    for name, at in zip(MESH.landmarks, landmarks_at(MESH, POSES[0]), strict=True)
    if name.split()[-1] in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "head")
}
GIVEN = ("--rig", "rig.toml", "--start", "joints.json", "--fps", str(HZ))
FOLDERS = ("c3", "c1", "c2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A rig, a folder of images of each camera, and of the empty room, and joints to start from."""
    where = tmp_path_factory.mktemp("silhouettes")
    room = Room(RIG)
    write_folders(where, [room.images(MESH, pose) for pose in POSES])
    write_folders(where / "empty", [room.images() for _ in range(2)])
    save_camera_rig(where / "rig.toml", RIG)
    (where / "joints.json").write_text(json.dumps(JOINTS))
    return where


@pytest.fixture(scope="module")
def found(folder):
    return result_here(folder, "track", "silhouettes", *FOLDERS, *GIVEN, "--set", "height=1.75")


def failed(folder, *arguments):
    """The one line that it ends with."""
    done = run_here(folder, "track", "silhouettes", *arguments)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return " ".join(done.stderr.split())


def test_a_body_is_followed_and_written(found):
    assert (found["format"], found["model"], found["rate_hz"]) == ("mocapella followed body", "male", HZ)
    assert [row["frame"] for row in found["frames"]] == list(range(FRAMES))
    assert [row["time_s"] for row in found["frames"]] == pytest.approx([k / HZ for k in range(FRAMES)])
    last = found["frames"][-1]
    truth = dict(zip(MESH.landmarks, landmarks_at(MESH, POSES[-1]), strict=True))
    assert np.median([np.linalg.norm(np.subtract(at, truth[name])) for name, at in last["joints"].items()]) < 0.04
    assert set(last["angles"]) >= set(MESH.joint_names)  # which of real people are more
    assert min(last["overlap"].values()) > 0.85
    assert len(last["root_twist"]) == 6
    assert found["summary"]["frames"] == FRAMES
    assert list(found["cameras"]) == ["c1", "c2", "c3"]


def test_it_starts_from_what_it_wrote(folder, found):
    (folder / "out.json").write_text(json.dumps(found))
    again = result_here(
        folder,
        "track",
        "silhouettes",
        *FOLDERS,
        "--rig",
        "rig.toml",
        "--fps",
        str(HZ),
        "--start",
        "out.json:2",
        "--frames",
        "2:4",
    )
    assert [row["frame"] for row in again["frames"]] == [2, 3]
    assert again["height_m"] == 1.75
    for key, at in again["frames"][0]["joints"].items():
        assert np.linalg.norm(np.subtract(at, found["frames"][2]["joints"][key])) < 0.05
    said = failed(folder, *FOLDERS, "--rig", "rig.toml", "--fps", "30", "--start", "out.json:77")
    assert "out.json: field frame: 77: has no such frame; it has frames from 0 to 5" in said
    said = failed(folder, *FOLDERS, "--rig", "rig.toml", "--fps", "30", "--start", "out.json", "--set", "model=female")
    assert "model female: " in said


@pytest.mark.slow
def test_pictures_plots_and_tables_are_for_people(folder, found):
    (folder / "before.json").write_text(json.dumps(found))
    done = run_here(
        folder, "track", "silhouettes", *FOLDERS, *GIVEN, "--frames", "0:2", "--set", "steadiness=false",
        "--background", "empty/c1",
        "--set", "plot=plot.png", "--set", "beside=before.json", "--overlay", "overlay",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "2 frames; " in done.stdout
    assert "no empty room is known of c2, c3" in done.stderr
    assert cv2.imread(str(folder / "plot.png")) is not None
    assert sorted(path.name for path in (folder / "overlay").iterdir()) == [
        f"{name}_00000{k}.jpg" for name in ("c1", "c2", "c3") for k in (0, 1)
    ]
    picture = cv2.imread(str(folder / "overlay" / "c1_000001.jpg")).astype(int)
    assert (
        picture[..., 1] - picture.max(axis=-1, initial=0, where=[True, False, True]) > 60
    ).any()  # the model's green
    done = run_here(folder, "track", "silhouettes", *FOLDERS, *GIVEN, "--frames", "0:2", "--overlay", "overlay.mp4")
    assert done.returncode == 0, done.stderr
    assert cv2.VideoCapture(str(folder / "overlay.mp4")).get(cv2.CAP_PROP_FRAME_COUNT) == 2


def test_videos_and_models_that_cannot_be_used_are_one_line(folder):
    write_video(folder / "fast.avi", [np.zeros((200, 240, 3), np.uint8)] * 3, 60.0)
    write_video(folder / "slow.avi", [np.zeros((200, 240, 3), np.uint8)] * 3, 50.0)
    write_video(folder / "wide.avi", [np.zeros((200, 248, 3), np.uint8)] * 3, 30.0)
    (folder / "text.avi").write_text("no video")
    for arguments, said in (
        ((), "no videos are named"),
        (("c1", "wide.avi", *GIVEN), "the rig has no such camera; the rig's are c1, c2, c3"),
        (("c1", "c2=no.avi", *GIVEN), "no.avi: is not there"),
        (("c1", "c2=text.avi", *GIVEN), "text.avi: is no video that can be read"),
        (
            ("c1=fast.avi", "c2=slow.avi", *GIVEN[:4]),
            "slow.avi: field frame rate: 50.0: has 50 frames a second, and fast.avi",
        ),
        (("c1", "c2=wide.avi", *GIVEN), "--set other_size=crop where pixels are as calibrated"),
        (("c1", "c2", *GIVEN[:4]), "give it with --fps"),
        (("c1", "c2", *GIVEN, "--set", "model=mail"), "did you mean male"),
        (("c1", "c2", *GIVEN, "--set", "model=no.glb"), "no.glb"),
        (("c1", "c2", *GIVEN, "--set", "height=175"), "height is 175.0; it must be 0.5 to 2.5 m"),
        (("c1", "c2", *GIVEN, "--background", "c2=wide.avi"), "is calibrated for 240 × 200 px"),
        (("c1", "c2", *GIVEN, "--background", "empty/c3"), "is of a camera that has no video"),
        (("c1", "c2", *GIVEN, "--overlay", "no/pictures"), "--overlay"),
    ):
        assert said in failed(folder, *arguments), arguments


def test_starts_that_cannot_be_are_one_line(folder):
    def start(name, value):
        (folder / name).write_text(json.dumps(value))
        return "c1", "c2", "c3", "--rig", "rig.toml", "--fps", "30", "--start", name

    assert "nothing says where the body is at first" in failed(folder, "c1", "c2", "--rig", "rig.toml", "--fps", "30")
    said = failed(folder, "c1", "c2", *GIVEN, "--set", "points=p.csv")
    assert "--start and points are both given" in said
    few = {name: at for name, at in JOINTS.items() if "shoulder" not in name}
    assert "few.json: field left shoulder: is missing" in failed(folder, *start("few.json", few))
    feet = {name: (np.array(at) / 0.3048).tolist() for name, at in JOINTS.items()}
    assert "are they in metres" in failed(folder, *start("feet.json", feet))
    far = {name: (np.array(at) + np.array([50.0, 0, 0])).tolist() for name, at in JOINTS.items()}
    said = failed(folder, *start("far.json", far))
    assert "the body would start at (50.00" in said
    assert "outside of all images" in said
    assert "field left hip: [1, 2]: is no place" in failed(folder, *start("odd.json", {**JOINTS, "left hip": [1, 2]}))


@pytest.mark.slow
def test_later_keypoints_are_kept_in_a_take_and_change_nothing_of_a_body_that_is_not_lost(folder):
    rows, rate_hz = ["frame,camera,point,x_px,y_px"], 10
    for k, pose in enumerate(POSES):
        joints = dict(zip(MESH.landmarks, landmarks_at(MESH, pose), strict=True))
        for camera, placed in RIG.cameras.items():
            at = project(apply(placed.T_camera_world, np.array([joints[name] for name in JOINTS])), placed.camera.lens)
            rows += [f"{k},{camera},{name},{x},{y}" for name, (x, y) in zip(JOINTS, at, strict=True)]
    given = ("--rig", "rig.toml", "--fps", str(rate_hz), "--set", "height=1.75")
    for name, some in (("all", rows), ("first", rows[: 1 + len(rows) // FRAMES])):
        (folder / f"{name}.csv").write_text("\n".join(some))
        done = run_here(
            folder, "track", "silhouettes", *FOLDERS, *given, "--set", f"points={name}.csv", "--json", f"{name}.json",
            "--record", f"./{name}",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    whole, first = (json.loads((folder / f"{name}.json").read_text())["frames"] for name in ("all", "first"))
    assert whole == first
    later = {
        name: read_take(folder / f"{name}.mcap").info.method_settings["bodies"][0].get("later", ())
        for name in ("all", "first")
    }
    assert [one["at_s"] for one in later["all"]] == pytest.approx([k / rate_hz for k in range(1, FRAMES)])
    assert not later["first"]


def test_a_mesh_whose_weights_do_not_match_its_joints_is_named(folder):
    import pygltflib

    save_rigged_mesh(folder / "legs.glb", legs_mesh("male", 1.75))
    content = pygltflib.GLTF2().load(str(folder / "legs.glb"))
    weights = content.accessors[content.meshes[0].primitives[0].attributes.WEIGHTS_0]
    view = content.bufferViews[weights.bufferView]
    data = bytearray(content.binary_blob())
    at = view.byteOffset + (weights.byteOffset or 0)
    data[at : at + 16] = np.array([3.0, 0, 0, 0], np.float32).tobytes()
    content.set_binary_blob(bytes(data))
    content.save(str(folder / "bad.glb"))
    said = failed(folder, *FOLDERS, *GIVEN, "--set", "model=bad.glb")
    assert "bad.glb" in said
    assert "weights" in said
    legs = result_here(folder, "track", "silhouettes", *FOLDERS, *GIVEN, "--set", "model=legs.glb", "--frames", "0:1")
    assert legs["model"] == "legs.glb"


def test_videos_of_two_lengths_and_a_black_one_are_said(folder, tmp_path):
    room = Room(RIG)
    for name, count in (("c1", 6), ("c2", 8), ("c3", 8)):
        images = [room.images(MESH, POSES[0])[name] for _ in range(count)]
        write_video(tmp_path / f"{name}.avi", images if name != "c2" else [np.zeros_like(one) for one in images], HZ)
    for name in ("rig.toml", "joints.json"):
        (tmp_path / name).write_text((folder / name).read_text())
    done = run_here(tmp_path, "track", "silhouettes", "c1.avi", "c2.avi", "c3.avi", *GIVEN[:4], "--json", "out.json")
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stderr.split())
    assert "the videos differ in length (c1 6, c2 8, c3 8 frames): the shortest, 6 frames, counts" in said
    assert "c2 does not count from frame 0 on: its image is black" in said
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["summary"]["left_out"] == {"c2": 6}
    assert found["summary"]["notes"][0].startswith("the videos differ in length")


@pytest.mark.slow
def test_ctrl_c_writes_what_is_there(folder, tmp_path):
    room = Room(RIG)
    images = room.images(MESH, POSES[0])
    write_folders(tmp_path, [images])
    for name in ("c1", "c2", "c3"):
        first = tmp_path / name / "0000.png"
        for k in range(1, 1500):
            (tmp_path / name / f"{k:04d}.png").hardlink_to(first)
    for name in ("rig.toml", "joints.json"):
        (tmp_path / name).write_text((folder / name).read_text())
    with Program(
        tmp_path, "run", "track", "silhouettes", *FOLDERS, *GIVEN, "--json", "out.json", "--overlay", "seen"
    ) as program:
        wait_until("some frames", lambda: len(list((tmp_path / "seen").glob("c1_*"))) > 3)
        assert program.end(signal.SIGINT) == 130
    assert "what there is by now was written" in program.output
    found = json.loads((tmp_path / "out.json").read_text())
    assert 3 < found["summary"]["frames"] == len(found["frames"]) < 1500


@pytest.mark.slow
def test_the_real_clip_begins_at_its_keypoints(single_person: Path, tmp_path):
    videos = sorted((single_person / "videos").glob("*.mp4"))
    common = (
        "--rig", str(single_person / "calibration" / "Calib_qualisys.toml"), "--set",
        f"points={single_person / 'pose-associated'}", "--frames", "0:3",
    )  # fmt: skip
    said = failed(tmp_path, *map(str, videos), *common)
    assert "cam01.mp4: field size" in said
    assert "1080 × 1920" in said
    assert "1088 × 1920" in said
    found = result_here(
        tmp_path, "track", "silhouettes", *map(str, reversed(videos)), *common, "--set", "other_size=crop"
    )
    assert list(found["cameras"]) == ["cam_01", "cam_02", "cam_03", "cam_04"]
    assert found["summary"]["median_overlap"] > 0.7
    assert len([note for note in found["summary"]["notes"] if "--set other_size=crop" in note]) == 2


@pytest.mark.slow
def test_the_real_clip_begins_at_the_keypoints_of_all_people(single_person: Path, tmp_path):
    videos = sorted((single_person / "videos").glob("*.mp4"))
    found = result_here(
        tmp_path, "track", "silhouettes", *map(str, videos), "--rig",
        str(single_person / "calibration" / "Calib_qualisys.toml"), "--set", f"keypoints={single_person / 'pose'}",
        "--set", "up=z", "--set", "other_size=crop", "--frames", "0:3",
    )  # fmt: skip
    assert found["summary"]["median_overlap"] > 0.7
    assert found["summary"]["lost"] == 0


@pytest.mark.slow
def test_the_demo_follows_and_says_how_good_that_is(tmp_path):
    found = result_here(tmp_path, "demo", "silhouettes", "--scene", "t-pose", "--no-view", "--seed", "2")
    assert found["score"]["frames"] == found["scene_frames"] == found["summary"]["frames"] > 10
    assert found["score"]["joints_mm"] < 30
    assert found["score"]["overlap"] > 0.85
    for arguments, said in (
        (["silhouettes", "--set", "corrupt=noize"], "corrupt is 'noize'; it must be one of noise, rectangles, wrong"),
        (["silhouettes", "--record", "take"], "--record: demo silhouettes has no bus"),
        (["silhouettes", "--scene", "run"], "run"),
        (["arm", "--set", "steadiness=false"], "are settings of demo silhouettes"),
    ):
        done = run_here(tmp_path, "demo", *arguments, "--no-view")
        assert done.returncode == 1
        assert said in " ".join(done.stderr.split())
