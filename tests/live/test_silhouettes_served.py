"""Silhouettes as a method like the others: cameras' nodes, a server, a take, a replay; whole processes over sockets."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.programs import Program, free_port, run_here, wait_until
from support.silhouette_pictures import Room, pose_at, ring, somebody, write_folders

from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.images import ImageFrame
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.recording.take_reader import Take, read_take

HZ = 8
FRAMES = 32
"""Somebody stands for a while, and then goes aside."""
STANDS = 10


def aside_m(frame: int) -> float:
    return 0.012 * max(0, frame - STANDS)


@dataclass(frozen=True)
class Ran:
    """What is left of a run."""

    folder: Path
    take: Take
    summary: dict[str, Any]
    node: dict[str, Any]
    status: dict[str, Any]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """A server that records, and three cameras that show somebody who goes aside."""
    folder, port = tmp_path_factory.mktemp("served"), free_port()
    mesh, rig = somebody(), ring(3)
    room = Room(rig)
    write_folders(folder / "films", (room.images(mesh, pose_at(mesh, aside_m(k))) for k in range(FRAMES)))
    save_camera_rig(folder / "rig.toml", rig)
    places = dict(zip(mesh.landmarks, landmarks_at(mesh, pose_at(mesh)).tolist(), strict=True))
    (folder / "start.json").write_text(json.dumps({"anna": {**places, "model": "male", "height_m": 1.75}}))
    connect = ("--connect", f"tcp/127.0.0.1:{port}", "--set", "report=0", "--fps", str(HZ))
    begin = ("serve", "--port", str(port), "--no-view", "--method", "silhouettes", "--rig", "rig.toml")
    into = ("--start", "start.json", "--record", "./walk", "--set", "reserve_gib=0.001", "--json", "server.json")
    with Program(folder, "server", *begin, *into) as server:
        wait_until("the server listens", server.said("waiting for sensors at"), timeout=300.0)
        epoch = ("--epoch", str(time.time() + 4.0))
        nodes = [
            Program(
                folder,
                name,
                "node",
                "camera",
                f"films/{name}",
                "--name",
                name,
                "--json",
                f"{name}.json",
                *connect,
                *epoch,
            )
            for name in rig.cameras
        ]
        for node in nodes:
            wait_until("the node ends", lambda node=node: node.process.poll() is not None, timeout=120.0)
            assert node.process.returncode == 0, node.output
        assert server.end() == 0, server.output
    summary = json.loads((folder / "server.json").read_text(encoding="utf-8"))
    take = read_take(folder / "walk.mcap")
    *_, (_, status) = take.statuses()
    return Ran(folder, take, summary, json.loads((folder / "c1.json").read_text(encoding="utf-8")), status)


@pytest.mark.slow
def test_images_are_in_the_take_whole(ran: Ran) -> None:
    assert ran.take.clean, ran.take.problems
    assert ran.take.sensors == ("c1", "c2", "c3")
    for sensor in ran.take.sensors:
        frames = [stored.frame for stored in ran.take.frames_in_sequence(sensor)]
        assert len(frames) > FRAMES - 4
        assert all(isinstance(frame, ImageFrame) and frame.format == "jpeg" for frame in frames)
    assert all(node.lost == 0 for node in ran.take.complete())


@pytest.mark.slow
def test_the_body_is_where_somebody_went(ran: Ran) -> None:
    mesh = somebody()
    *_, (_, last) = ran.take.scenes()
    (body,) = last.bodies
    assert (body.name, body.lost, [view.camera for view in body.views]) == ("anna", False, ["c1", "c2", "c3"])
    true = landmarks_at(mesh, pose_at(mesh, aside_m(FRAMES - 1)))
    away = np.linalg.norm(body.landmarks - true, axis=-1)
    assert np.median(away) < 0.06
    assert all(view.overlap > 0.75 for view in body.views if not view.left_out)
    assert all(len(view.outline_px) > 20 for view in body.views if not view.left_out)


@pytest.mark.slow
def test_the_summary_and_the_status_count_bodies(ran: Ran) -> None:
    summary = ran.summary
    assert (summary["bodies"], summary["most_bodies"], summary["most_people"]) == (1, 1, 0)
    assert summary["never_tracked"] is None
    assert [row["name"] for row in summary["sensors"]] == ["c1", "c2", "c3"]
    assert ran.status["counts"] == {"bodies": 1}
    assert {row["sends"] for row in ran.status["sensors"]} == {"images"}


@pytest.mark.slow
def test_the_node_says_what_it_sent(ran: Ran) -> None:
    report = ran.node["report"]
    assert ran.node["published"] == report["sent"] == report["taken"] - report["dropped"]
    assert report["dropped"] < 4
    assert report["bytes"] >= report["sent"] * 1000


@pytest.mark.slow
def test_a_replay_gives_the_same_bodies_to_the_bit(ran: Ran) -> None:
    done = run_here(ran.folder, "replay", "walk", "--json", "replayed.json")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads((ran.folder / "replayed.json").read_text(encoding="utf-8"))
    assert row["recorded_scenes"] > FRAMES
    assert (row["differing_scenes"], row["most_bodies"]) == (0, 1)


def test_what_the_method_needs_is_said_before_anything_begins(tmp_path: Path) -> None:
    save_camera_rig(tmp_path / "rig.toml", ring(2))
    for given, wanted in ((("--rig", "rig.toml"), "--start JOINTS.json is missing"), ((), "--rig RIG.toml is missing")):
        done = run_here(tmp_path, "serve", "--port", str(free_port()), "--method", "silhouettes", "--no-view", *given)
        assert done.returncode == 1
        assert wanted in done.stderr


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"left hip": [0, 0, 0], "model": 3}, "field model: 3: is no model"),
        ({"left hip": [0, 0, 0], "height_m": 17}, "field height_m: 17: is no height"),
        ({"left hip": [0, 0]}, "is no place"),
    ],
)
def test_a_start_that_cannot_be_used_names_the_field(tmp_path: Path, content: dict[str, Any], said: str) -> None:
    save_camera_rig(tmp_path / "rig.toml", ring(2))
    (tmp_path / "start.json").write_text(json.dumps(content))
    options = ("--rig", "rig.toml", "--start", "start.json")
    done = run_here(tmp_path, "serve", "--port", str(free_port()), "--method", "silhouettes", "--no-view", *options)
    assert done.returncode == 1
    assert said in done.stderr
