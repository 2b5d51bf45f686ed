"""``mocapella triangulate``: people of keypoint files to files and takes, and other named points."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.keypoint_folders import walkers, write_openpose
from support.programs import run_here

import mocapella
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply

FRAMES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("people")
    write_openpose(path, walkers(FRAMES))
    return path


def test_each_person_gets_a_trc_and_the_result_is_json(folder: Path, tmp_path: Path) -> None:
    rig = str(folder / "rig.toml")
    done = run_here(
        tmp_path, "triangulate", str(folder), "--rig", rig, "--fps", "30", "--out", "walk.trc", "--json", "r.json"
    )
    assert done.returncode == 0, done.stderr
    assert "2 people in 12 frames: walk.person_0.trc, walk.person_1.trc" in " ".join(done.stderr.split())
    row = json.loads((tmp_path / "r.json").read_text())
    assert row["out"] == ["walk.person_0.trc", "walk.person_1.trc"]
    assert row["cameras"]["cam-0"]["used"] == 2 * FRAMES
    assert "measured" in done.stdout
    assert "rejected" in done.stdout
    points = mocapella.load(tmp_path / "walk.person_0.trc").points
    assert points is not None
    assert len(points) == FRAMES


def test_a_take_and_fewer_people(folder: Path, tmp_path: Path) -> None:
    rig = str(folder / "rig.toml")
    done = run_here(tmp_path, "triangulate", str(folder), "--rig", rig, "--fps", "30", "--out", "./walk")
    assert done.returncode == 0, done.stderr
    people = mocapella.load(tmp_path / "walk.mcap").people
    assert people is not None
    assert len(people.individuals) == 2
    lines = run_here(tmp_path, "export", "json", "walk.mcap")
    assert lines.returncode == 0, lines.stderr
    done = run_here(
        tmp_path, "triangulate", str(folder), "--rig", rig, "--fps", "30", "--out", "a.csv", "--max-people", "1"
    )
    assert "1 people, of 2 in 12 frames: a.csv" in " ".join(done.stderr.split())


def test_what_cannot_be_triangulated_is_one_line(folder: Path, tmp_path: Path) -> None:
    rig = str(folder / "rig.toml")
    for arguments, said in (
        (["--out", "a.xyz"], "end its name with one of"),
        (["--out", "a.trc"], "give the frame rate with --fps"),
        *((["--out", "a.trc", "--fps", fps], "--fps is") for fps in ("0", "-30", "nan", "inf")),
        (["--out", "a.trc", "--fps", "30", "--set", "order=COCO_17"], "the order COCO_17 has 17"),
        (["--out", "a.trc", "--fps", "30", "--set", "magic=1"], "magic"),
        (["--out", "a.trc", "--fps", "30", "--up", "x"], "up is 'x'"),
    ):
        done = run_here(tmp_path, "triangulate", str(folder), "--rig", rig, *arguments)
        assert done.returncode == 1, arguments
        assert said in " ".join(done.stderr.split()), (arguments, done.stderr)


def test_points_that_are_no_people_are_triangulated(folder: Path, tmp_path: Path) -> None:
    from mocapella.model.camera_rig_file import load_camera_rig

    truth = np.array([[0.1 * k, 1.0, 0.0] for k in range(3)])
    (tmp_path / "mouse").mkdir()
    for name, one in load_camera_rig(folder / "rig.toml").cameras.items():
        px = project(apply(one.T_camera_world, truth), one.camera.lens)
        cells = ",".join(f"{x},{y},0.9" for x, y in px)
        heads = ["scorer" + ",net" * 9, "bodyparts" + "".join(f",{p},{p},{p}" for p in ("snout", "back", "tail")),
                 "coords" + ",x,y,likelihood" * 3]  # fmt: skip
        (tmp_path / "mouse" / f"{name}DLC_net.csv").write_text("\n".join([*heads, f"0,{cells}", f"1,{cells}"]) + "\n")
    arguments = ["triangulate", "mouse", "--rig", str(folder / "rig.toml"), "--fps", "30"]
    done = run_here(tmp_path, *arguments, "--out", "mouse.trc")
    assert done.returncode == 0, done.stderr
    points = mocapella.load(tmp_path / "mouse.trc").points
    assert points is not None
    assert points.keypoints == ("snout", "back", "tail")
    np.testing.assert_allclose(points.positions[1, 0], truth, atol=1e-4)
    done = run_here(tmp_path, *arguments, "--out", "mouse.bvh")
    assert "these are points and no people" in " ".join(done.stderr.split())
