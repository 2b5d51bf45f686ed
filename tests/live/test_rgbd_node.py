"""Two depth cameras with colour as nodes in processes of their own, and a server that tracks a person."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.programs import Program, free_port, run_here, wait_until

from mocapella.model.observations import BodyFrame
from mocapella.recording.take_reader import Take, read_take

SCENE = "rendered:room-walk/5/kinect"


@dataclass(frozen=True)
class Ran:
    """What is left of a run."""

    take: Take
    server: dict[str, Any]
    nodes: dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    folder, port = tmp_path_factory.mktemp("rgbd"), free_port()
    begin = ("serve", "--port", str(port), "--no-view", "--sensors", "2", "--json", "server.json")
    into = ("--record", "./walk.mcap", "--set", "reserve_gib=0.001")
    with Program(folder, "server", *begin, *into) as server:
        wait_until("the server listens", server.said("waiting for sensors at"), timeout=120.0)
        epoch = f"{time.time() + 5:.3f}"
        nodes = [
            Program(
                folder, view, "node", "rgbd", f"{SCENE}/{view}", "--name", view, "--fps", "10", "--epoch", epoch,
                "--connect", f"tcp/127.0.0.1:{port}", "--set", "report=1", "--json", f"{view}.json",
            )
            for view in ("front", "right")
        ]  # fmt: skip
        with nodes[0] as front, nodes[1] as right:
            for node in (front, right):
                wait_until("the node sees somebody", node.said("people now: 1"), timeout=120.0)
            wait_until("frames", lambda: front.output.count("people now: 1") > 12, timeout=120.0)
            assert front.end() == 0, front.output
            assert right.end() == 0, right.output
        assert server.end() == 0, server.output
    told = {name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in ("front", "right")}
    summary = json.loads((folder / "server.json").read_text(encoding="utf-8"))
    return Ran(read_take(folder / "walk.mcap"), summary, told)


def test_both_cameras_are_body_sensors_of_the_session(ran: Ran) -> None:
    assert {sensor["name"] for sensor in ran.server["sensors"]} == {"front", "right"}
    for view in ("front", "right"):
        frames = [stored.frame for stored in ran.take.frames(view)]
        bodies = [frame for frame in frames if isinstance(frame, BodyFrame)]
        assert len(bodies) == len(frames) > 20
        assert bodies[0].topology.name == "coco_17"
        assert np.median([frame.bodies for frame in bodies]) == 1
        assert len({int(i) for frame in bodies for i in frame.tracking_ids}) == 1
        times = [frame.time_ns for frame in bodies]
        assert times == sorted(set(times))


def test_the_nodes_tell_what_they_did(ran: Ran) -> None:
    for told in ran.nodes.values():
        assert told["served"]
        assert told["published"] > 20
        assert told["report"]["bodies"] > 20
        assert told["report"]["not_in_space"] == 0
        assert told["report"]["errors"] == {}


def test_the_person_is_tracked(ran: Ran) -> None:
    if ran.server["frames_untracked"] == ran.server["frames_in"]:
        pytest.skip("the method was being compiled during the whole run")
    assert ran.server["most_people"] == 1


def test_sources_without_colour_are_refused_with_the_remedy(tmp_path: Path) -> None:
    for source, said in (
        ("rendered:wave", "room-"),
        (str(tmp_path), "no folder of colour images"),
    ):
        done = run_here(tmp_path, "node", "rgbd", source)
        assert done.returncode != 0
        assert said in done.stderr
