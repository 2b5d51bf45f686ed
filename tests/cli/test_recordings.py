"""A take as something that nodes replay: in the order and at the times of capture, however it was stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.take_making import small_take

from mocapella.errors import InputError, SettingsError
from mocapella.live.recorded_take import LATE_NS, due_times
from mocapella.live.recordings import find_recording, is_take, open_recording
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame

STEP = 33_000_000
AHEAD = 7_000_000_000
"""How far the sensor's clock is ahead."""


@given(st.lists(st.integers(0, STEP // 3), min_size=1, max_size=50))
def test_frames_that_came_as_they_were_captured_are_due_as_they_came(latencies: list[int]) -> None:
    times = [(1, k * STEP + late, k * STEP + AHEAD) for k, late in enumerate(latencies)]
    assert due_times(times) == [stored for _, stored, _ in times]


@given(st.lists(st.integers(0, LATE_NS), min_size=1, max_size=50))
def test_frames_that_came_in_knots_are_due_between_capture_and_arrival(latencies: list[int]) -> None:
    due = due_times([(1, k * STEP + late, k * STEP + AHEAD) for k, late in enumerate(latencies)])
    assert all(k * STEP <= when <= k * STEP + late for k, (when, late) in enumerate(zip(due, latencies, strict=True)))


@given(st.integers(1, 50), st.integers(1, 50), st.integers(1, 50))
def test_what_was_fetched_later_is_due_when_it_was_captured(before: int, missed: int, after: int) -> None:
    """Either at the end of all, or just before the first frame that came by itself again."""
    count = before + missed + after
    for fetched in (count * STEP + LATE_NS, (before + missed) * STEP - 1):
        stored = [fetched if before <= k < before + missed else k * STEP for k in range(count)]
        due = due_times([(1, stored[k], k * STEP + AHEAD) for k in range(count)])
        assert due == [k * STEP for k in range(count)]


def test_a_clock_that_jumps_or_a_node_that_changes_moves_nobody() -> None:
    times = [(1, 1000 * STEP, 0), (1, STEP, 3_600_000_000_000), (2, 2 * STEP, 5), (2, 3 * STEP, 1)]
    assert due_times(times) == [1000 * STEP, STEP, 2 * STEP, 3 * STEP]
    assert due_times([]) == []


def test_a_take_that_was_mended_is_replayed_in_the_order_of_capture(tmp_path: Path) -> None:
    """Frames 3 and 4 were fetched at the end; then the node was started again, with its clock at 0."""
    path = tmp_path / "a.mcap"
    writer = TakeWriter.create(path, info=TakeInfo(Setup(), 0, 0), reserve_bytes=0)
    stored = [(1, k, k * STEP) for k in (0, 1, 2, 5, 6, 7, 8, 9)]
    stored += [(1, 3, 10 * STEP), (1, 4, 10 * STEP), (2, 0, 11 * STEP), (2, 1, 12 * STEP)]
    for node_id, k, log_ns in stored:
        captured = k * STEP + (AHEAD if node_id == 1 else 0)
        frame = body_frame(
            "front",
            topology("kinect_v2"),
            time_ns=captured,
            positions=np.zeros((1, 25, 3)),
            node_id=node_id,
            sequence=k,
        )
        writer.write_frame(encode_frame(frame), sensor="front", node_id=node_id, sequence=k, log_ns=log_ns)
    writer.close()
    due = list(open_recording(path).due_frames("front"))
    assert [frame.frame.sequence for frame in due] == [*range(10), 0, 1]
    assert [round(frame.due_s * 1e9) for frame in due] == [k * STEP for k in (*range(10), 11, 12)]
    assert [frame.frame.time_ns for frame in due] == [k * STEP + AHEAD for k in (*range(10), 11, 12)]
    with pytest.raises(SettingsError, match="no sensor 'side'; it has front"):
        open_recording(path).due_frames("side")


@pytest.mark.parametrize(("stored", "differing"), [(24, 24), (20, 24), (30, 30)])
def test_a_scene_that_differs_is_missing_or_is_new_counts_once(
    stored: int, differing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The 24 frames of a take whose scenes no tracker has made, with some of these scenes left out or added."""
    recorded = open_recording(small_take(tmp_path / "a.mcap"))
    scenes = list(recorded._take.scenes())
    monkeypatch.setattr(recorded._take, "scenes", lambda: iter((scenes * 2)[:stored]))
    monkeypatch.setattr(type(recorded._take), "scene_count", stored)
    notes = recorded.replay(lambda scene: None).notes
    assert (notes["recorded_scenes"], notes["differing_scenes"]) == (stored, differing)


def test_a_take_is_found_without_its_suffix_and_in_the_folder_of_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("takes").mkdir()
    for name in ("takes/walk.mcap", "takes/day 1.5.mcap", "here.mcap", "takes/here.mcap", "plain", "plain.mcap"):
        Path(name).touch()
    found = {name: str(find_recording(Path(name))) for name in ("walk", "walk.mcap", "day 1.5", "here", "plain")}
    assert found == {
        "walk": "takes/walk.mcap",
        "walk.mcap": "takes/walk.mcap",
        "day 1.5": "takes/day 1.5.mcap",
        "here": "here.mcap",
        "plain": "plain",
    }


def test_a_recording_that_is_not_there_is_told_with_those_that_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^walk: no such file; name a study log or a take$"):
        find_recording(Path("walk"))
    Path("takes").mkdir()
    Path("takes/walk-1.mcap").touch()
    Path("walk-2.mcap").touch()
    for name in ("walk-3", "walk-3.mcap"):
        with pytest.raises(InputError, match=rf"^{name}: no such file; there are takes/walk-1\.mcap, walk-2\.mcap"):
            find_recording(Path(name))
    with pytest.raises(InputError, match=r"^takes: it is a folder; there are takes/walk-1\.mcap$"):
        find_recording(Path("takes"))


def test_the_take_that_was_meant_is_named_however_many_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("takes", "elsewhere"):
        Path(name).mkdir()
    for number in range(12):
        Path(f"takes/a{number:02}.mcap").touch()
    for name in ("takes/take-1.mcap", "elsewhere/run 1.5.mcap"):
        Path(name).touch()
    for name, meant in (("take1", "take-1"), ("take1.mcap", "take-1"), ("elsewhere/run15", r"elsewhere/run 1\.5")):
        with pytest.raises(InputError, match=rf"^{name}: no such file; there are .*mcap \(did you mean {meant}\?\)$"):
            find_recording(Path(name))
    with pytest.raises(InputError, match=r"there are takes/a00.*takes/a09\.mcap$"):
        find_recording(Path("zzzz"))


def test_a_take_is_told_from_a_log_by_its_beginning_too(tmp_path: Path) -> None:
    take = tmp_path / "x.mcap"
    TakeWriter.create(take, info=TakeInfo(Setup(), 0, 0), reserve_bytes=0).close()
    plain = take.rename(tmp_path / "x")
    assert is_take(plain)
    with pytest.raises(InputError, match=r"x: is a take without frames; name one that was recorded while sensors sent"):
        open_recording(plain)
    log = tmp_path / "log.csv"
    log.write_text("Study_Id, Kinect_Config")
    assert not is_take(log)
