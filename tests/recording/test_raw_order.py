"""Laws of the order in which all frames of a run are tracked again."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from support.take_making import STEP, info, scene_bytes, write_frame

from mocapella.recording.raw_order import TimedFrame, raw_order
from mocapella.recording.take import Command
from mocapella.recording.take_index import TakeIndex
from mocapella.recording.take_reader import RawFrame, read_take
from mocapella.recording.take_refs import FrameRef, Ref, SceneRef
from mocapella.recording.take_writer import TakeWriter

AHEAD = {"front": 5_000_000_000_000, "side": -7_000_000_000}
"""How far each sensor's clock is behind the server's [ns]."""


def frame(sensor: str, number: int, run: int = 0, late_ns: int = 0) -> FrameRef:
    at_ns = number * STEP + late_ns
    return FrameRef(Ref(0, 0, 0, at_ns), sensor, 1, number, number * STEP - AHEAD[sensor], run)


def index_of(frames: list[FrameRef], tracked: list[FrameRef], run: int = 0) -> TakeIndex:
    """An index in which ``tracked`` were tracked in this order, at the times of the true clocks."""
    index = TakeIndex()
    index.frames = frames
    index.scenes = [
        SceneRef(one.ref, run, step, one.time_ns + AHEAD[one.sensor], one.sensor, 1, one.sequence)
        for step, one in enumerate(tracked)
    ]
    return index


@st.composite
def runs(draw: st.DrawFn) -> tuple[list[FrameRef], list[FrameRef], list[Command]]:
    """Frames of two sensors as stored, those that were tracked, in any order, and commands between."""
    numbers = [(sensor, number) for sensor in AHEAD for number in range(draw(st.integers(1, 12)))]
    frames = [frame(*one, late_ns=draw(st.integers(0, 9 * STEP))) for one in draw(st.permutations(numbers))]
    tracked = draw(st.lists(st.sampled_from(frames), unique=True, max_size=len(frames)))
    steps = sorted(draw(st.lists(st.integers(0, len(tracked) + 1), max_size=4)))
    return frames, tracked, [Command(step, k * STEP, {"verb": str(k)}) for k, step in enumerate(steps)]


@given(runs())
def test_all_frames_and_commands_come_once_and_tracked_ones_in_their_order(
    run: tuple[list[FrameRef], list[FrameRef], list[Command]],
) -> None:
    frames, tracked, commands = run
    events = list(raw_order(index_of(frames, tracked), 0, commands))
    timed = [event for event in events if isinstance(event, TimedFrame)]
    assert sorted(one.frame.ref.log_ns for one in timed) == sorted(one.ref.log_ns for one in frames)
    assert [one.frame for one in timed if one.frame in tracked] == tracked
    assert [event for event in events if isinstance(event, Command)] == commands
    for place, event in enumerate(events):
        if isinstance(event, Command):
            before = [one.frame for one in events[:place] if isinstance(one, TimedFrame)]
            assert [one for one in before if one in tracked] == tracked[: event.before_step]


@given(runs())
def test_times_are_of_the_nodes_clock_where_it_is_known_and_never_before_it_else(
    run: tuple[list[FrameRef], list[FrameRef], list[Command]],
) -> None:
    frames, tracked, commands = run
    known = {one.sensor for one in tracked}
    for event in raw_order(index_of(frames, tracked), 0, commands):
        if isinstance(event, TimedFrame):
            true = event.frame.time_ns + AHEAD[event.frame.sensor]
            own = [
                one.ref.log_ns - one.time_ns - AHEAD[one.sensor] for one in frames if one.sensor == event.frame.sensor
            ]
            assert event.at_ns == true + (0 if event.frame.sensor in known else min(own))


def test_between_two_tracked_frames_the_clocks_offset_is_linear() -> None:
    frames = [frame("front", number) for number in range(5)]
    index = index_of(frames, [frames[0], frames[4]])
    drifted = SceneRef(
        *[getattr(index.scenes[1], name) for name in ("ref", "run", "step")], 4 * STEP + 400, "front", 1, 4
    )
    index.scenes[1] = drifted
    times = [event.at_ns for event in raw_order(index, 0, []) if isinstance(event, TimedFrame)]
    assert times == [number * STEP + 100 * number for number in range(5)]


@given(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=2, max_size=4, unique=True), st.integers(0, 2))
def test_no_number_of_a_crafted_take_is_too_large(times: list[int], tracked: int) -> None:
    frames = [FrameRef(Ref(0, 0, 0, -at), "front", 1, k, at, 0) for k, at in enumerate(times)]
    index = index_of(frames, [])
    index.scenes = [
        SceneRef(one.ref, 0, 2**64 - 1 - k, -(2**63), "front", 1, k) for k, one in enumerate(frames[:tracked])
    ]
    events = list(raw_order(index, 0, [Command(2**64 - 1, -(2**63), {})]))
    assert len(events) == len(frames) + 1
    assert all(abs(event.at_ns) <= 2**63 for event in events if isinstance(event, TimedFrame))
    untracked = [event.at_ns for event in events if isinstance(event, TimedFrame) and event.frame in frames[tracked:]]
    assert all(abs(at_ns) <= 2**62 for at_ns in untracked)


def test_a_frame_belongs_to_the_run_of_its_scene_or_else_to_that_in_which_it_was_stored() -> None:
    frames = [frame("front", 0), frame("front", 1), frame("front", 2, run=1)]
    index = index_of(frames, [frames[0]], run=1)
    assert [event.frame for event in raw_order(index, 0, []) if isinstance(event, TimedFrame)] == [frames[1]]
    own = [event.frame for event in raw_order(index, 1, []) if isinstance(event, TimedFrame)]
    assert own == [frames[0], frames[2]]


def test_a_take_yields_frames_that_have_no_scene_too(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    for number in range(6):
        write_frame(writer, "front", number, number * STEP)
        if number % 2:
            writer.write_scene(scene_bytes(number, "front", number), number * STEP)
    writer.write_command({"verb": "recalibrate", "arguments": {}}, 4 * STEP, 4)
    writer.close()
    events = list(read_take(tmp_path / "a.mcap").raw_run(0))
    assert [event.stored.frame.sequence if isinstance(event, RawFrame) else -1 for event in events] == [
        0, 1, 2, 3, 4, -1, 5,
    ]  # fmt: skip
    assert [event.at_ns for event in events if isinstance(event, RawFrame)] == [k * STEP + 3 for k in range(6)]
