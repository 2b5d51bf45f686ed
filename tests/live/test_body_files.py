"""A file of an Azure Kinect goes through every process: its bodies are tracked, and the take has them as they came."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from support.azure_squats import knee_flexion
from support.programs import Program, free_port, result_here, run_here, wait_until

from mocapella.model.body_rows import BodyRows
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.skeleton import SKELETON, skeleton_mapping
from mocapella.recording.body_csv import read_body_csv
from mocapella.recording.take_reader import Take, read_take
from mocapella.tracker.default import DefaultTracker

ROWS, SECOND = 240, 30


class Run(NamedTuple):
    """A server's take of a replayed file."""

    folder: Path
    rows: BodyRows
    take: Take


@pytest.fixture(scope="module")
def served(azure_and_vicon: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Somebody squats twice, in 8 s."""
    folder, port = tmp_path_factory.mktemp("azure"), free_port()
    lines = gzip.decompress((azure_and_vicon / "azure_positions.csv.gz").read_bytes()).splitlines(keepends=True)
    (folder / "squats.csv").write_bytes(b"".join(lines[: ROWS + 1]))
    words = ["serve", "--port", str(port), "--no-view", "--record", "./take.mcap", "--set", "reserve_gib=0.001"]
    with Program(folder, "server", *words) as server:
        wait_until("the server listens", server.said("waiting for sensors at"), timeout=120.0)
        address = f"tcp/127.0.0.1:{port}"
        words = ["node", "replay", "squats.csv", "--sensor", "left", "--connect", address, "--json", "node.json"]
        with Program(folder, "node", *words) as node:
            assert node.process.wait(150.0) == 0, node.output
        assert server.end() == 0, server.output
    return Run(folder, read_body_csv(folder / "squats.csv"), read_take(folder / "take.mcap"))


@pytest.mark.slow
def test_the_take_has_the_sensors_own_joints_to_the_bit(served: Run) -> None:
    assert served.take.sensors == ("left",)
    assert json.loads((served.folder / "node.json").read_text())["published"] == ROWS
    frames = [stored.frame for stored in served.take.frames_in_sequence("left")]
    assert len(frames) == ROWS
    for frame, time_ns, positions, states in zip(
        frames, served.rows.time_ns, served.rows.positions, served.rows.states, strict=True
    ):
        assert isinstance(frame, BodyFrame)
        assert (frame.topology.name, frame.time_ns, frame.tracking_ids.tolist()) == ("azure_kinect", time_ns, [1])
        np.testing.assert_array_equal(frame.positions[0], positions)
        np.testing.assert_array_equal(frame.states[0], states)


@pytest.mark.slow
def test_its_replay_gives_the_same_results_to_the_bit(served: Run) -> None:
    (row,) = result_here(served.folder, "replay", "take.mcap")
    assert (row["differing_scenes"], row["unusable"], row["most_people"]) == (0, {}, 1)


@pytest.mark.slow
def test_the_knees_of_the_person_follow_the_sensors(served: Run) -> None:
    """Of all frames in the take: on a busy machine, the live path passes some over."""
    mapping, tracker = skeleton_mapping("azure_kinect"), DefaultTracker()
    assert mapping is not None
    own = mapping.positions(served.rows.positions.astype(np.float64))
    frames = [stored.frame for stored in served.take.frames_in_sequence("left")]
    scenes = [tracker.update(Arrival(frame, frame.time_ns)) for frame in frames]
    known = [k for k, scene in enumerate(scenes) if scene.people and k >= SECOND]
    assert len(known) == ROWS - SECOND
    assert {scene.topology.name for scene in scenes} == {SKELETON.name}
    fused = np.array([scenes[k].people[0].positions for k in known])
    for side in ("Left", "Right"):
        seen, found = knee_flexion(own[known], side), knee_flexion(fused, side)
        assert np.ptp(seen) > 50
        assert np.corrcoef(found, seen)[0, 1] > 0.95
        assert np.sqrt(np.mean((found - seen) ** 2)) < 15


@pytest.mark.slow
def test_the_file_is_tracked_without_a_server_too(served: Run) -> None:
    (row,) = result_here(served.folder, "replay", "squats.csv")
    assert (row["sensors"], row["frames_in"], row["most_people"]) == (["azure_kinect"], ROWS, 1)
    assert row["log"]["rows"] == ROWS
    assert row["recorded_s"] == pytest.approx(ROWS / 30, rel=0.01)


@pytest.mark.slow
def test_what_cannot_be_replayed_is_said_in_one_line(served: Run) -> None:
    lines = (served.folder / "squats.csv").read_text().split("\n")
    lines[5] = lines[5].replace(";", ";x", 1)
    (served.folder / "bad.csv").write_text("\n".join(lines))
    done = run_here(served.folder, "node", "replay", "bad.csv", "--sensor", "left")
    assert done.returncode == 1
    assert "bad.csv: row 6: field body_idx: 'x1': is no number; write a number with a point" in done.stderr
    done = run_here(served.folder, "node", "replay", "squats.csv", "--sensor", "left", "--placement", "parallel")
    assert done.returncode == 1
    assert "squats.csv has one sensor; leave --placement out" in done.stderr
