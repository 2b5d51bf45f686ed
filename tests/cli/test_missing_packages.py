"""Takes that were made with packages that are not installed: they open, and say which."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support.programs import result_here, run_here

from mocapella import __version__
from mocapella.exports.export import EXPORTS, exports_of, left_out
from mocapella.live.recording_service import packages_of
from mocapella.live.recordings import open_recording
from mocapella.model.observations import body_frame
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, TrackerState, UnknownPart
from mocapella.model.sensor_frame import UnknownFrame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.merge import merge_parts
from mocapella.recording.take import TakeInfo, decode_run
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene
from mocapella.tracker import METHODS

KIND = topology("kinect_v2")
PACKAGES = {
    "mocapella": f"mocapella {__version__}",
    "tracking method lamps": "lamp-maker 1.2",
    "frame type lamps": "lamp-maker 1.2",
    "part type glows": "glow-maker 0.3",
}
STEP_NS = 33_000_000


def info(method: str = "lamps", packages: dict[str, str] | None = None) -> TakeInfo:
    return TakeInfo(Setup(method), 0, 0, packages=PACKAGES if packages is None else packages)


def person() -> Person:
    positions = np.ones((len(KIND), 3))
    positions[3] = np.nan
    states = np.full(len(KIND), 2, np.uint8)
    return Person(4, positions, states, (PotentialSkeleton("front", 5, 0, 0.0, 1.0, np.eye(4), positions, states),))


def record(writer: TakeWriter, first: int, count: int) -> None:
    for k in range(first, first + count):
        frame = UnknownFrame("roof", 9, k, k * STEP_NS, 0, "lamps", b"%d" % k)
        writer.write_frame(encode_frame(frame), sensor="roof", node_id=9, sequence=k, log_ns=k * STEP_NS)
        parts: dict[str, Any] = {"people": (person(),), "glows": (UnknownPart("glows", b"x" * k),) * 2}
        scene = Scene(k, k * STEP_NS, "roof", 9, k, KIND, TrackerState(Phase.TRACKING), parts)
        writer.write_scene(encode_scene(scene), k * STEP_NS)
    writer.flush()


def lamp_take(path: Path, made: TakeInfo | None = None) -> Path:
    writer = TakeWriter.create(path, info=made or info(), reserve_bytes=0)
    record(writer, 0, 4)
    writer.close()
    return path


def test_it_opens_with_unknown_frames_and_parts(tmp_path: Path) -> None:
    take = read_take(lamp_take(tmp_path / "a.mcap"))
    assert take.info.packages == PACKAGES
    assert take.clean
    assert take.part_counts == {"people": 4, "glows": 8}
    assert take.unread_frame_types == ("lamps",)
    assert [stored.frame.content for stored in take.frames()] == [b"0", b"1", b"2", b"3"]
    assert [len(scene.of("glows")[0].content) for _, scene in take.scenes()] == [0, 1, 2, 3]


@pytest.mark.parametrize("words", [(), ("--live", "--no-view")], ids=["fast", "live"])
def test_replay_names_what_is_missing(tmp_path: Path, words: tuple[str, ...]) -> None:
    lamp_take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "replay", "a", *words)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "mocapella: a cannot be tracked: " in line
    for what, package in (list(PACKAGES.items()))[1:]:
        assert f"it was made with the {what} of {package}, which is not installed; install it" in line


def test_replay_names_a_frame_type_alone(tmp_path: Path) -> None:
    """The method is there, and a sensor's frames are not: what it said of them then it cannot say now."""
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info("stand-still"), reserve_bytes=0)
    frame = UnknownFrame("roof", 9, 0, 0, 0, "lamps", b"")
    writer.write_frame(encode_frame(frame), sensor="roof", node_id=9, sequence=0, log_ns=0)
    writer.close()
    (missing,) = open_recording(tmp_path / "a.mcap").missing
    assert missing.startswith("it was made with the frame type lamps of lamp-maker 1.2")


def test_nothing_is_missing_of_ours(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info("stand-still"), reserve_bytes=0)
    frame = body_frame("front", KIND, time_ns=0, positions=np.zeros((1, len(KIND), 3)))
    writer.write_frame(encode_frame(frame), sensor="front", node_id=frame.node_id, sequence=0, log_ns=0)
    writer.close()
    assert open_recording(tmp_path / "a.mcap").missing == []
    assert packages_of("stand-still") == {"mocapella": f"mocapella {__version__}"}


def test_an_older_take_that_names_no_packages_opens(tmp_path: Path) -> None:
    lamp_take(tmp_path / "a.mcap", info(packages={}))
    assert "of a package that the take does not name" in run_here(tmp_path, "replay", "a").stderr
    written = {"number": 0, "part": 1, "info": msgspec.to_builtins(info())}
    del written["info"]["packages"]
    assert decode_run(msgspec.json.encode(written), "a").info.packages == {}


def test_an_export_writes_what_it_can_and_names_the_rest(tmp_path: Path) -> None:
    lamp_take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "export", "csv", "a")
    assert done.returncode == 0
    assert "a.mcap: left out by export csv: glows (8); `mocapella export json` writes everything" in done.stderr
    assert "the tracking method lamps of lamp-maker 1.2, which is not installed" in done.stderr
    again = run_here(tmp_path, "export", "csv", "a")
    assert again.returncode == 1
    assert "a.csv exists; add --force to replace it, or name another file with --out" in again.stderr
    assert run_here(tmp_path, "export", "csv", "a", "--force").returncode == 0
    assert run_here(tmp_path, "export", "study-log", "a").returncode == 0
    again = run_here(tmp_path, "export", "study-log", "a")
    assert "a.study-log.csv exists, and a study log is never overwritten; name another file with --out" in again.stderr
    done = run_here(tmp_path, "export", "arms", "a")
    assert "left out by export arms: people (4), glows (8)" in done.stderr


def test_lines_of_json_have_every_field_and_the_size_of_what_is_unknown(tmp_path: Path) -> None:
    lamp_take(tmp_path / "a.mcap")
    made = result_here(tmp_path, "export", "json", "a", "--every", "2")
    assert made["parts"] == {"people": 2, "glows": 4}
    assert made["unread"] == {"glows": 4}
    assert (made["scenes"], made["written"]) == (4, 2)
    rows = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text("utf-8").splitlines()]
    assert [row["step"] for row in rows] == [0, 2]
    assert rows[1]["parts"]["glows"] == [{"not_installed": "glows", "bytes": 2}] * 2
    (seen,) = rows[1]["parts"]["people"]
    assert (seen["id"], seen["positions"][2:4]) == (4, [[1.0, 1.0, 1.0], [None, None, None]])
    assert seen["states"] == [2] * len(KIND)
    assert rows[1]["state"]["phase"] == "tracking"
    refused = run_here(tmp_path, "export", "json", "a", "--out", "no/such/folder.jsonl")
    assert refused.returncode == 1


def test_parts_of_an_interrupted_take_are_put_together_and_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 3)
    size = writer.size_bytes
    writer.close()
    path.write_bytes(path.read_bytes()[:size])  # as a kill leaves it
    writer = TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)
    record(writer, 3, 2)
    writer.close()
    take = read_take(path)
    assert take.clean
    assert take.part_counts == {"people": 5, "glows": 10}
    assert [stored.frame.content for stored in take.frames()] == [b"%d" % k for k in range(5)]
    assert [run.info.packages for run in take.runs] == [PACKAGES] * 2


def test_a_take_whose_server_never_came_back_is_put_together(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 3)
    size = writer.size_bytes
    writer.close()
    scenes = [encode_scene(scene) for _, scene in read_take(path).scenes()]
    path.write_bytes(path.read_bytes()[:size])
    merge_parts(path, reserve_bytes=0)
    take = read_take(path)
    assert take.clean
    assert [encode_scene(scene) for _, scene in take.scenes()] == scenes


def test_each_methods_exports_carry_something_of_what_it_makes_and_the_others_nothing() -> None:
    for method in METHODS.values():
        makes = dict.fromkeys(method.parts, 1)
        for name, export in EXPORTS.items():
            assert (name in exports_of(method.parts)) == (len(left_out(export, makes)) < len(makes))
    for export in EXPORTS.values():
        assert set(export.parts or ()) <= set(PART_TYPES)
