"""What is written is read, in whatever order it came, and a replay gets what the tracker got."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from support.take_making import KIND, STEP, frame, frame_bytes, info, keys, record, scene, scene_bytes, write_frame

from mocapella.model.arms import ArmFrame
from mocapella.model.depth import depth_frame
from mocapella.model.observations import Arrival
from mocapella.model.session import RecordingHealth, SessionStatus, Setup
from mocapella.model.truth import Truth
from mocapella.recording.take import Command, Run
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene, encode_truth

FRAME = st.tuples(st.just("frame"), st.sampled_from(["a", "b"]), st.integers(0, 1), st.integers(0, 12))
OTHER = st.tuples(st.sampled_from(["scene", "flush", "command", "clock"]), st.just(""), st.just(0), st.integers(0, 12))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(FRAME, OTHER), max_size=40))
def test_any_interleaving_is_read_as_it_was_written(events: list[tuple[str, str, int, int]]) -> None:
    frames: dict[tuple[str, int, int], bytes] = {}
    duplicates, scenes, commands, clocks = 0, [], [], []
    with tempfile.TemporaryDirectory() as folder:
        writer = TakeWriter.create(Path(folder) / "a.mcap", info=info(), reserve_bytes=0)
        for at, (kind, sensor, node, number) in enumerate(events):
            if kind == "frame":
                new = write_frame(writer, sensor, number, at, node_id=node)
                assert new == ((sensor, node, number) not in frames)
                duplicates += not new
                frames.setdefault((sensor, node, number), frame_bytes(sensor, number, node))
            elif kind == "scene":
                scenes.append((at, scene_bytes(len(scenes), "a", number)))
                writer.write_scene(scenes[-1][1], at)
            elif kind == "command":
                commands.append(Command(len(scenes), at, {"name": "recalibrate"}))
                writer.write_command({"name": "recalibrate"}, at, len(scenes))
            elif kind == "clock":
                clocks.append((at, {"node": number}))
                writer.write_clock({"node": number}, at)
            else:
                writer.flush()
        report = writer.close()
        take = read_take(report.path)
        stored = list(take.frames())
        assert take.clean
        assert {s.frame.key: s.raw for s in stored} == frames
        assert len(stored) == len(frames) == sum(report.frames.values())
        assert [(t, encode_scene(s)) for t, s in take.scenes()] == scenes
        assert list(take.commands()) == commands
        assert list(take.clock_probes()) == clocks
        assert (report.duplicates, report.scenes) == (duplicates, len(scenes))
        missing = {(n.sensor, n.node_id, s) for n in take.complete() for a, b in n.missing for s in range(a, b + 1)}
        between = {(n.sensor, n.node_id, s) for n in take.complete() for s in range(n.first, n.last + 1)}
        assert missing == between - set(frames)
        assert sum(report.lost.values()) == sum(n.lost for n in take.complete()) == len(missing)


def test_a_frame_comes_back_to_the_bit(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(5), reserve_bytes=0)
    write_frame(writer, "front", 3, 77)
    (stored,) = read_take(writer.close().path).frames("front")
    expected = frame("front", 3)
    assert stored.log_ns == 77
    assert stored.raw == frame_bytes("front", 3)
    assert stored.frame.key == expected.key
    assert stored.frame.positions.tobytes() == expected.positions.tobytes()


def test_depth_and_arms_are_kept_like_any_other_frame_and_say_what_they_are(tmp_path: Path) -> None:
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4)
    image = depth_frame("depth", depth, unit_m=0.001, lens=[4, 4, 2, 1], time_ns=9, node_id=1, sequence=3)
    arms = ArmFrame("arm", 1, 3, 9, 9, (4, 3), np.ones(9), "default", (), "nobody is there")
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(5), reserve_bytes=0)
    for one in (image, arms):
        writer.write_frame(encode_frame(one), sensor=one.sensor, node_id=1, sequence=3, log_ns=77)
    path = writer.close().path
    kept = {stored.frame.sensor: stored.frame for stored in read_take(path).frames()}
    assert kept["depth"].depth.tolist() == depth.tolist()
    assert kept["arm"].reason == "nobody is there"
    with path.open("rb") as file:
        named = {channel.topic: schema.name for schema, channel, _ in make_reader(file).iter_messages()}
    assert (named["/frames/depth"], named["/frames/arm"]) == ("mocapella.DepthFrame", "mocapella.ArmFrame")


def test_arrivals_are_what_the_tracker_took_in_its_order_with_its_times(tmp_path: Path) -> None:
    """The record path brings frames late, early, and some that the tracker never took."""
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    order = [("front", 0), ("side", 0), ("side", 1), ("front", 2), ("side", 3)]
    write_frame(writer, "side", 3, 0)
    for step, (sensor, sequence) in enumerate(order):
        writer.write_scene(scene_bytes(step, sensor, sequence), step)
    writer.flush()
    for sequence in (2, 1, 0):
        write_frame(writer, "side", sequence, 50)
        write_frame(writer, "front", sequence, 50)
    take = read_take(writer.close().path)
    arrivals = list(take.arrivals())
    assert [(a.frame.sensor, a.frame.sequence) for a in arrivals] == order
    assert [a.at_ns for a in arrivals] == [scene(step, "x", 0).at_ns for step in range(5)]
    assert take.problems == ()


def test_a_scene_without_its_frame_is_reported_and_passed_over(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    write_frame(writer, "front", 0, 0)
    for step in range(9):
        writer.write_scene(scene_bytes(step, "front", step), step)
    take = read_take(writer.close().path)
    assert [a.frame.sequence for a in take.arrivals()] == [0]
    (problem,) = take.problems
    assert problem.startswith("8 scenes were made of frames that are not in the take: run 0 step 1 (front frame 1), ")
    assert problem.endswith("and 3 more")


def test_replay_has_runs_and_commands_where_they_belong(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    writer.write_command({"name": "start"}, 0, 0)
    writer.write_command({"name": "recalibrate"}, 1, 3)  # written early, carried out before step 3
    record(writer, 0, 2)
    writer.write_command({"name": "stop"}, 9, 4)
    writer.start_run(info(10, frames=60))
    record(writer, 2, 1)
    writer.write_command({"name": "setup"}, 11, 1)
    record(writer, 3, 1, step=2)
    take = read_take(writer.close().path)

    def name(item: Run | Command | Arrival) -> Any:
        if isinstance(item, Run):
            return "run", item.number
        return item.values["name"] if isinstance(item, Command) else (item.frame.sensor, item.frame.sequence)

    first = [("run", 0), "start", ("front", 0), ("side", 0), ("front", 1), "recalibrate", ("side", 1), "stop"]
    second = [("run", 1), ("front", 2), "setup", ("side", 2), ("front", 3), ("side", 3)]
    assert [name(item) for item in take.replay()] == first + second
    assert [run.info.method_settings for run in take.runs] == [{"frames": 120}, {"frames": 60}]
    assert take.interruptions == ()
    assert [s.step for _, s in take.scenes(run=1)] == [0, 1, 2, 3]
    assert len(list(take.arrivals(run=0))) == 4


def test_a_new_tracker_without_a_new_run_is_reported(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 2)
    record(writer, 2, 1)
    record(writer, 3, 1, step=1)
    take = read_take(writer.close().path)
    assert take.problems == tuple(
        f"run 0: step {step} follows step {before}; a new tracker is a new run" for step, before in ((0, 3), (1, 1))
    )


def test_status_truth_and_how_it_was_made_come_back(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(5), reserve_bytes=0)
    status = SessionStatus(
        1, True, "tracking", 0, 0, 120, "", 7, 30.0, Setup(), (), RecordingHealth(), ("note",), 1.5, "0.1.0"
    )
    writer.write_status(status, 6)
    points = np.arange(75.0).reshape(1, 25, 3)
    truth = Truth("front", 3, 9, KIND, np.array([4]), points, np.eye(4), np.array([4]), np.array([False]))
    writer.write_truth(encode_truth(truth), sensor="front", log_ns=7)
    take = read_take(writer.close().path)
    assert take.info == info(5)
    assert take.info.method == "stand-still"
    ((log_ns, read),) = take.statuses()
    assert (log_ns, read["phase"], read["notices"]) == (6, "tracking", ["note"])
    ((log_ns, same),) = take.truths("front")
    assert (log_ns, same.sequence) == (7, 3)
    assert np.array_equal(same.positions, points)
    assert list(take.truths("side")) == []


def test_history_that_comes_again_is_counted_and_gaps_are_known(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    for sequence in (10, 11, 14, 10, 11, 13, 20):
        write_frame(writer, "front", sequence, sequence * STEP)
    write_frame(writer, "front", 3, 0, node_id=2)  # the node was started again
    report = writer.close()
    assert report.frames == {"front": 6}
    assert report.lost == {"front": 6}  # 12 and 15 to 19
    assert report.duplicates == 2
    first, second = read_take(report.path).complete()
    assert (first.first, first.last, first.stored, first.missing, first.lost) == (10, 20, 5, ((12, 12), (15, 19)), 6)
    assert (second.node_id, second.missing) == (2, ())
    assert keys(read_take(report.path))[-1] == ("front", 2, 3)


def test_a_takes_time_is_from_its_beginning_to_its_last_entry(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(100 * 10**9), reserve_bytes=0)
    assert writer.seconds == 0.0
    write_frame(writer, "front", 1, 101 * 10**9)
    write_frame(writer, "front", 2, 102 * 10**9 + 10**9 // 2)
    assert writer.seconds == 2.5
    writer.close()
