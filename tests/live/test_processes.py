"""The main job in whole processes over real sockets, on a real recording: an undisturbed run, and one whose server is
killed in the middle. Both go on at the same time, because they take as long as the recording does."""

from __future__ import annotations

import gzip
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.programs import Program, free_port, result_here, wait_until

from mocapella.model.observations import BodyFrame
from mocapella.recording.study_log import read_study_log
from mocapella.recording.take_reader import Take, read_take
from mocapella.sources.study_replay import StudyReplay
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

LOG = "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
ROWS = 901
SENSORS = ("front", "side")


@dataclass(frozen=True)
class Runs:
    """What is left on the disk of both runs."""

    log: Path
    undisturbed: Path
    killed: Path


def start_server(folder: Path, port: int, name: str, method: str) -> Program:
    server = Program(
        folder,
        name,
        "serve",
        "--port",
        str(port),
        "--no-view",
        "--sensors",
        "2",
        "--method",
        method,
        "--record",
        "./take.mcap",
        "--json",
        f"{name}.json",
        "--set",
        "reserve_gib=0.001",
    )
    wait_until("the server listens", server.said("waiting for sensors at"), timeout=120.0)
    return server


def start_nodes(folder: Path, log: Path, port: int) -> list[Program]:
    epoch = str(time.time() + 3.0)
    return [
        Program(
            folder,
            sensor,
            "node",
            "replay",
            str(log),
            "--sensor",
            sensor,
            "--epoch",
            epoch,
            "--connect",
            f"tcp/127.0.0.1:{port}",
            "--json",
            f"{sensor}.json",
        )
        for sensor in SENSORS
    ]


@pytest.fixture(scope="module")
def runs(study_logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Runs:
    # Its first 27 s: somebody stands still, goes out of both sensors' sight, and comes back.
    log = tmp_path_factory.mktemp("log") / LOG.removesuffix(".gz")
    log.write_text("\n".join(gzip.decompress((study_logs / LOG).read_bytes()).decode().splitlines()[:ROWS]))
    undisturbed, killed = tmp_path_factory.mktemp("undisturbed"), tmp_path_factory.mktemp("killed")
    programs: list[Program] = []
    try:
        ports = [free_port(), free_port()]
        servers = [
            start_server(undisturbed, ports[0], "server", "stand-still"),
            start_server(killed, ports[1], "before", "default"),
        ]
        nodes = start_nodes(undisturbed, log, ports[0]) + start_nodes(killed, log, ports[1])
        programs = [*servers, *nodes]
        time.sleep(12.0)  # the recording goes on; the kill falls where the first person has been tracked for a while
        servers[1].process.kill()
        servers[1].process.wait()
        time.sleep(4.0)  # nobody listens; the nodes keep what they send
        servers[1] = start_server(killed, ports[1], "after", "default")
        programs.append(servers[1])
        for node in nodes:
            assert node.process.wait(150.0) == 0, node.output
        wait_until("the take is whole", lambda: stored(ports[0]) >= sum(published(undisturbed).values()))
        for server in servers:
            assert server.end() == 0, server.output
    finally:
        for program in programs:
            program.__exit__(None, None, None)
    return Runs(log, undisturbed, killed)


def stored(port: int) -> int:
    """Frames that are safe on the server's disk: also of those that a busy machine passed over live."""
    session = open_reader(f"tcp/127.0.0.1:{port}")
    try:
        status = send_command(session, "status").status
    finally:
        session.close()
    assert status is not None
    return sum(sensor.stored for sensor in status.sensors)


def published(folder: Path) -> dict[str, Any]:
    return {sensor: json.loads((folder / f"{sensor}.json").read_text())["published"] for sensor in SENSORS}


def same_content(stored: BodyFrame, source: BodyFrame) -> bool:
    return (
        stored.time_ns == source.time_ns
        and np.array_equal(stored.positions, source.positions, equal_nan=True)
        and np.array_equal(stored.states, source.states)
        and np.array_equal(stored.tracking_ids, source.tracking_ids)
    )


def assert_every_frame_of_the_log_is_in(take: Take, log: Path) -> None:
    source = StudyReplay(read_study_log(log))
    for sensor in SENSORS:
        stored = sorted((item.frame for item in take.frames(sensor)), key=lambda frame: frame.sequence)
        expected = [frame for _, frame in source.frames(sensor)]
        assert len(stored) == len(expected)
        assert all(same_content(one, other) for one, other in zip(stored, expected, strict=True))


def test_a_real_recording_goes_through_every_process_and_comes_out_whole(runs: Runs) -> None:
    take = read_take(runs.undisturbed / "take.mcap")
    assert take.clean
    assert take.problems == ()
    assert_every_frame_of_the_log_is_in(take, runs.log)
    summary = json.loads((runs.undisturbed / "server.json").read_text())
    # The live path may pass frames over on a busy machine; those before a sensor's first and after its last that came
    # live are known by the take alone.
    assert summary["frames_in"] == summary["frames_out"]
    assert 0 < summary["frames_in"] + summary["drops"] <= sum(published(runs.undisturbed).values())
    assert [change["phase"] for change in summary["state_changes"]][-1] == "tracking"
    assert summary["most_people"] == 1


def test_its_offline_replay_gives_the_same_results_to_the_bit(runs: Runs) -> None:
    (row,) = result_here(runs.undisturbed, "replay", "take.mcap")
    assert row["differing_scenes"] == 0
    summary = json.loads((runs.undisturbed / "server.json").read_text())
    assert row["frames_out"] == summary["frames_out"] > 0


def test_no_frame_is_missing_from_a_take_whose_server_was_killed(runs: Runs) -> None:
    take = read_take(runs.killed / "take.mcap")
    assert take.clean
    assert len(take.interruptions) == 1
    assert all(frames.missing == () for frames in take.complete())
    assert_every_frame_of_the_log_is_in(take, runs.log)
    assert sorted(path.name for path in runs.killed.glob("*.mcap")) == ["take.mcap"]
    summary = json.loads((runs.killed / "after.json").read_text())
    assert summary["recording"]["lost"] == 0
    assert summary["recording"]["frames"] == sum(published(runs.killed).values())
    assert "frames are kept for it" in (runs.killed / "front.log").read_text(encoding="utf-8")


def test_both_of_its_runs_replay_to_the_same_results(runs: Runs) -> None:
    (row,) = result_here(runs.killed, "replay", "take.mcap")
    assert row["differing_scenes"] == 0
    assert [scene.step for _, scene in read_take(runs.killed / "take.mcap").scenes()].count(0) == 2


def test_a_finished_take_is_never_recorded_over(runs: Runs) -> None:
    before = (runs.undisturbed / "take.mcap").read_bytes()
    with Program(
        runs.undisturbed,
        "again",
        "serve",
        "--port",
        str(free_port()),
        "--no-view",
        "--record",
        "./take.mcap",
        "--set",
        "reserve_gib=0.001",
    ) as again:
        assert again.process.wait(30.0) == 1
    assert "take.mcap" in again.output
    assert (runs.undisturbed / "take.mcap").read_bytes() == before


def test_the_study_log_comes_out_of_it(runs: Runs) -> None:
    made = result_here(
        runs.undisturbed,
        "export",
        "study-log",
        "take.mcap",
        "--out",
        "log.csv",
        "--participant",
        "7",
        "--placement",
        "right-90",
    )
    log = read_study_log(runs.undisturbed / "log.csv")
    assert len(log.positions) == made["rows"] > 0
    assert set(log.study_id.tolist()) == {7}
    replayed = StudyReplay(log)
    assert len(replayed.sensors) == 2
