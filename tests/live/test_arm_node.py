"""A depth camera's node in a process of its own, over real sockets, into a take, and out of it again."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.nearest_arm import NEAREST
from support.programs import Program, free_port, wait_until
from typer.testing import CliRunner

from mocapella.cli import arm as _arm  # noqa: F401 - registers the verb
from mocapella.cli import replay as _replay  # noqa: F401
from mocapella.cli.app import app
from mocapella.detectors import DETECTORS
from mocapella.model.arms import ArmFrame
from mocapella.model.depth import DepthFrame
from mocapella.recording.take_reader import Take, read_take

IMAGES = 5
SAID = ("--intrinsics", "12,7.5,5.5", "--unit", "0.001")


@dataclass(frozen=True)
class Ran:
    """What is left of a run."""

    folder: Path
    take: Take
    node: dict[str, Any]
    output: str


def depth(number: int) -> np.ndarray:
    image = np.full((12, 16), 1000, np.uint16)
    image[2, 3 + number] = 700
    return image


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """A server that records, and a node that shows it five images again and again."""
    folder, port = tmp_path_factory.mktemp("arm"), free_port()
    (folder / "frames").mkdir()
    for number in range(IMAGES):
        cv2.imwrite(str(folder / "frames" / f"{number}.png"), depth(number))
    with pytest.MonkeyPatch.context() as patch:
        path = os.pathsep.join([str(Path(__file__).parent.parent), os.environ.get("PYTHONPATH", "")])
        patch.setenv("PYTHONPATH", path.rstrip(os.pathsep))
        begin = ("serve", "--port", str(port), "--no-view", "--method", "arms", "--json", "server.json")
        into = ("--record", "./walk.mcap", "--set", "reserve_gib=0.001")
        source = ("frames", *SAID, "--fps", "25", "--set", "loop=true", "--name", "left", "--set", "publish_depth=true")
        connect = (
            "--detector",
            "nearest",
            "--connect",
            f"tcp/127.0.0.1:{port}",
            "--set",
            "report=0.3",
            "--json",
            "node.json",
        )
        chosen = ("--detector", "nearest")
        with (
            Program(folder, "server", *begin, *into) as server,
            Program(folder, "node", "node", "arm", *source, *chosen, *connect, module="support.nearest_arm") as node,
        ):
            wait_until("the server listens", server.said("waiting for sensors at"), timeout=120.0)
            wait_until("the node reports", node.said("arms in 100.0 %"), timeout=120.0)
            wait_until("and again", lambda: node.output.count("arms in 100.0 %") > 2)
            assert node.end() == 0, node.output
            assert server.end() == 0, server.output
            output = node.output
    told = json.loads((folder / "node.json").read_text(encoding="utf-8"))
    return Ran(folder, read_take(folder / "walk.mcap"), told, output)


def test_arms_and_images_are_in_the_take_whole(ran: Ran) -> None:
    assert ran.take.clean
    assert ran.take.sensors == ("left", "left.depth")
    arms = [stored.frame for stored in ran.take.frames_in_sequence("left")]
    images = [stored.frame for stored in ran.take.frames_in_sequence("left.depth")]
    assert len(arms) > IMAGES
    assert len(images) > IMAGES
    assert all(node.lost == 0 for node in ran.take.complete())
    at = {}
    for frame in images:
        assert isinstance(frame, DepthFrame)
        number = int(np.argwhere(frame.depth == 700)[0, 1]) - 3
        np.testing.assert_array_equal(frame.depth, depth(number))
        assert (frame.unit_m, frame.lens[:4].tolist()) == (0.001, [12, 12, 7.5, 5.5])
        at[frame.time_ns] = number
    for frame in arms:
        assert isinstance(frame, ArmFrame)
        assert (frame.method, frame.size_px, len(frame.arms)) == ("nearest", (16, 12), 1)
        if frame.time_ns in at:
            z = 0.7
            x = (3 + at[frame.time_ns] - 7.5) / 12 * z
            np.testing.assert_allclose(frame.arms[0].points[21], [x, -3.5 / 12 * z, z], atol=1e-6)
    assert len(at.keys() & {frame.time_ns for frame in arms}) > IMAGES


def test_the_node_says_what_it_did(ran: Ran) -> None:
    node, report = ran.node, ran.node["report"]
    assert (node["sensor"], node["served"]) == ("left", True)
    assert node["published"] == report["looked_at"] - report["too_late"]
    assert node["images_published"] == report["looked_at"] == report["with_arms"]
    assert report["taken"] == report["looked_at"] + report["dropped"]
    assert (report["detector"], report["empty"], report["damaged"], report["lost"]) == ("nearest", 0, 0, 0)
    assert "depth images of frames, 16 × 12 px, 25 a second, 0.001 m a unit, f 12.0 px" in ran.output
    assert f"left: {node['published']} frames published" in ran.output


def test_the_server_makes_arms_in_the_world_of_them(ran: Ran) -> None:
    scenes = [scene for _, scene in ran.take.scenes()]
    with_arms = [scene for scene in scenes if scene.sensor == "left"]
    assert len(with_arms) > IMAGES
    arms = {
        (stored.frame.node_id, stored.frame.sequence): stored.frame for stored in ran.take.frames_in_sequence("left")
    }
    for scene in with_arms:
        (arm,), frame = scene.arms, arms[scene.node_id, scene.sequence]
        assert isinstance(frame, ArmFrame)
        np.testing.assert_allclose(arm.points, frame.arms[0].points * [-1.0, -1.0, 1.0], atol=1e-12)
        assert (arm.id, arm.person, arm.cameras) == (0, -1, ("left",))
    summary = json.loads((ran.folder / "server.json").read_text(encoding="utf-8"))
    assert (summary["most_arms"], summary["most_people"], summary["never_tracked"]) == (1, 0, None)


def test_a_replay_gives_the_same_arms_to_the_bit(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ran.folder)
    done = CliRunner().invoke(app, ["replay", "walk.mcap", "--json", "replayed.json"])
    assert done.exit_code == 0, (done.output, done.exception)
    (row,) = json.loads((ran.folder / "replayed.json").read_text(encoding="utf-8"))
    assert (row["differing_scenes"], row["most_arms"]) == (0, 1)
    assert row["recorded_scenes"] > 2 * IMAGES
    assert not row["unusable"]  # images beside arms are passed over


def test_the_arms_are_exported_as_a_table(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ran.folder)
    done = CliRunner().invoke(app, ["export", "arms", "walk.mcap", "--json", "export.json"])
    assert done.exit_code == 0, (done.output, done.exception)
    told = json.loads((ran.folder / "export.json").read_text(encoding="utf-8"))
    rows = (ran.folder / "walk.arms.csv").read_text(encoding="utf-8").splitlines()
    assert told["path"] == "walk.arms.csv"
    assert len(rows) - 1 == told["rows"] == 8 * told["with_arms"]
    assert told["arms"] == 1


def test_the_takes_images_give_the_same_arms_again(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DETECTORS, "nearest", NEAREST)
    monkeypatch.chdir(ran.folder)
    done = CliRunner().invoke(app, ["track", "arm", "walk.mcap", "--detector", "nearest", "--json", "again.json"])
    assert done.exit_code == 0, (done.output, done.exception)
    (recording,) = json.loads((ran.folder / "again.json").read_text(encoding="utf-8"))["recordings"]
    images = list(ran.take.frames_in_sequence("left.depth"))
    arms = {stored.frame.time_ns: stored.frame for stored in ran.take.frames_in_sequence("left")}
    assert recording["recording"] == "walk.mcap:left.depth"
    assert recording["counts"]["with_arms"] == len(images)
    both = 0
    for stored, frame in zip(images, recording["frames"], strict=True):
        live = arms.get(stored.frame.time_ns)
        if live is not None:
            both += 1
            palm = frame["arms"][0]["joints"]["palm"]["m"]
            np.testing.assert_allclose(palm, live.arms[0].points[21], atol=1e-5)
    assert both > IMAGES
