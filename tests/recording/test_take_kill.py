"""A server that is killed at any time, also while it puts the parts together, costs nothing that was acknowledged."""

import errno
import os
import random
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader
from support.take_making import SECOND, STEP, info, keys, record, unclosed_take, write_frame

from mocapella.errors import DiskFullError, RecordingError, TakeExistsError
from mocapella.recording import disk, merge
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter

TESTS = Path(__file__).resolve().parent.parent
FOREVER = 1_000_000


def record_and_kill(path: Path, after: int, delay: float) -> int:
    """Let a process record, kill it ``delay`` seconds after its ``after``-th acknowledgement; the last one it gave."""
    command = [sys.executable, "-m", "support.take_child", str(path), str(FOREVER)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=TESTS) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        for _ in range(after):
            child.stdout.readline()
        killer = threading.Timer(delay, child.send_signal, [signal.SIGKILL])
        killer.start()
        lines = child.stdout.read().splitlines(keepends=True)  # until it is dead
        killer.join()
    assert child.returncode == -signal.SIGKILL
    whole = [line for line in lines if line.endswith("\n")]
    return int(whole[-1]) if whole else 5 * after - 1


def test_everything_acknowledged_is_readable_after_kill_9(tmp_path: Path) -> None:
    picked = random.Random(5)
    for attempt in range(6):
        path = tmp_path / f"{attempt}.mcap"
        acknowledged = record_and_kill(path, picked.randrange(3), picked.uniform(0, 0.03))
        take = read_take(path)
        assert not take.clean
        for sensor in ("front", "side"):
            found = keys(take, sensor)
            assert found == [(sensor, 1, s) for s in range(len(found))]
            assert len(found) > acknowledged
        assert len(list(take.arrivals())) == take.scene_count
        assert len(take.problems) == 1  # no scene without its frame


def test_two_kills_and_a_proper_end_make_one_clean_take(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    first = record_and_kill(path, 3, 0.01)
    second = record_and_kill(path, 8, 0.01)
    assert [part.name for part in disk.parts_of(path)] == ["walk.mcap", "walk.part2.mcap"]
    torn = read_take(path)
    assert "the take is in 2 parts" in torn.problems[-1]
    end = 5 * (2 + max(first, second, torn.frame_count) // 5)
    result = subprocess.run(
        [sys.executable, "-m", "support.take_child", str(path), str(end)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        cwd=TESTS,
    )
    assert result.stdout.endswith("closed True\n")
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.mcap"]
    take = read_take(path)
    assert take.clean
    assert take.problems == ()
    for sensor in ("front", "side"):
        assert keys(take, sensor) == [(sensor, 1, s) for s in range(end)]
    assert all(node.lost == 0 for node in take.complete())
    assert [run.part for run in take.runs] == [1, 2, 3]
    assert len(take.interruptions) == 2
    steps = [[s.step for _, s in take.scenes(run)] for run in range(3)]
    assert all(part == list(range(len(part))) for part in steps)
    with pytest.raises(TakeExistsError):
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)


def test_what_is_stored_is_not_stored_again(tmp_path: Path) -> None:
    path = unclosed_take(tmp_path / "walk.mcap", 12)
    writer = TakeWriter.resume_or_create(path, info=info(SECOND), reserve_bytes=0)
    assert (writer.accounts.stored, writer.scenes) == (24, 24)
    assert not write_frame(writer, "front", 11, SECOND)
    assert write_frame(writer, "front", 12, SECOND)
    assert write_frame(writer, "front", 11, SECOND, node_id=2)
    report = writer.close()
    assert (report.frames, report.duplicates) == ({"front": 14, "side": 12}, 1)
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 26 + 24 + 2  # frames, scenes, runs


def interrupted(tmp_path: Path) -> Path:
    """A take in two parts, neither closed."""
    path = unclosed_take(tmp_path / "walk.mcap")
    first = path.read_bytes()
    writer = TakeWriter.resume_or_create(path, info=info(SECOND), reserve_bytes=0)
    record(writer, 0, 20)
    size = writer.size_bytes
    part = disk.part_path(path, 2)
    data = part.read_bytes()[:size]
    writer.close()
    path.write_bytes(first)
    part.write_bytes(data)
    return path


def test_a_take_whose_server_never_came_back_is_put_together(tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    before = keys(read_take(path))
    merge.merge_parts(path, reserve_bytes=0)
    take = read_take(path)
    assert take.clean
    assert keys(take) == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.mcap"]
    content = path.read_bytes()
    merge.merge_parts(path, reserve_bytes=0)
    assert path.read_bytes() == content


def test_parts_are_put_together_where_there_is_just_room_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = interrupted(tmp_path)
    size = sum(part.stat().st_size for part in tmp_path.iterdir())
    free = size + 1000 - 1
    monkeypatch.setattr(disk, "free_bytes", lambda folder: free)
    with pytest.raises(DiskFullError, match="cannot put the parts"):
        merge.merge_parts(path, reserve_bytes=1000)
    free += 1
    merge.merge_parts(path, reserve_bytes=1000)
    assert read_take(path).clean


class Killed(BaseException):
    """Stands for a kill: nobody catches it."""


def test_a_kill_at_any_step_of_the_merging_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [(os, "write"), (os, "fsync"), (disk, "_data_sync"), (Path, "replace"), (Path, "unlink"), (os, "open")]
    real = {name: getattr(owner, name) for owner, name in names}
    kill_at = steps = 0

    def counted(name: str) -> object:
        def step(*arguments: object, **options: object) -> object:
            nonlocal steps
            steps += 1
            if steps == kill_at:
                raise Killed
            return real[name](*arguments, **options)

        return step

    expected: list[tuple[str, int, int]] = []
    states = set()
    for kill_at in range(1, 100):
        folder = tmp_path / str(kill_at)
        folder.mkdir()
        path, steps = interrupted(folder), 0
        expected = keys(read_take(path))
        with monkeypatch.context() as patch:
            for owner, name in names:
                patch.setattr(owner, name, counted(name))
            try:
                merge.merge_parts(path, reserve_bytes=0)
                break
            except Killed:
                pass
        states.add(tuple(sorted(entry.name for entry in folder.iterdir())))
        assert keys(read_take(path)) == expected, f"killed at step {kill_at}"
        merge.merge_parts(path, reserve_bytes=0)
        assert read_take(path).clean
        assert keys(read_take(path)) == expected
        assert [entry.name for entry in folder.iterdir()] == ["walk.mcap"]
    assert kill_at > 5
    assert ("walk.mcap", "walk.merging.mcap", "walk.part2.mcap") in states
    assert ("walk.mcap", "walk.part2.mcap") in states


def test_a_copy_that_is_not_equal_replaces_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = interrupted(tmp_path)
    before = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
    real, calls = merge.TakeFile.add, []

    def forgets(*arguments: object) -> None:
        calls.append(1)
        if len(calls) != 7:
            real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(merge.TakeFile, "add", forgets)
    with pytest.raises(RecordingError, match="is not equal to the parts it was made of"):
        merge.merge_parts(path, reserve_bytes=0)
    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == before


def test_a_take_that_its_failing_program_closed_is_gone_on_with(tmp_path: Path) -> None:
    """Twice; and in between it is a whole file for others."""
    path = tmp_path / "walk.mcap"
    for start in (0, 10):
        writer = TakeWriter.resume_or_create(path, info=info(start * STEP), reserve_bytes=0)
        record(writer, start, 10)
        report = writer.close(interrupted=True)
        assert not report.clean
        assert "a recording to it goes on with it" in report.problem
        parts = disk.parts_of(path)
        assert len(parts) == 1 + start // 10
        with parts[-1].open("rb") as file:
            assert make_reader(file, validate_crcs=True).get_summary() is not None
        assert keys(read_take(path), "front") == [("front", 1, s) for s in range(start + 10)]
    writer = TakeWriter.resume_or_create(path, info=info(SECOND), reserve_bytes=0)
    record(writer, 20, 10)
    assert writer.close().clean
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.mcap"]
    take = read_take(path)
    assert (take.clean, take.problems, len(take.interruptions)) == (True, (), 2)
    assert keys(take, "front") == [("front", 1, s) for s in range(30)]
    with pytest.raises(TakeExistsError):  # it was closed in the end
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)


def test_a_disk_that_fails_while_a_take_is_opened_again_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "walk.mcap"
    TakeWriter.create(path, info=info(), reserve_bytes=0).close(interrupted=True)

    def fail(fd: int) -> None:
        raise OSError(errno.EIO, "planted")

    monkeypatch.setattr(disk, "sync", fail)
    with pytest.raises(RecordingError, match=r"cannot go on recording to .*walk.mcap"):
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)
    monkeypatch.undo()
    assert TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0).close().clean


def test_a_take_that_is_being_recorded_is_not_merged(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    with pytest.raises(RecordingError, match="is being recorded; stop the recording first"):
        merge.merge_parts(writer.path, reserve_bytes=0)
    writer.close()


def test_a_server_that_was_killed_before_its_first_flush_is_gone_on_with(tmp_path: Path) -> None:
    for start in (b"", b"\x89MCAP", unclosed_take(tmp_path / "whole.mcap").read_bytes()[:100]):
        path = tmp_path / f"{len(start)}.mcap"
        path.write_bytes(start)
        writer = TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)
        record(writer, 0, 4)
        assert writer.close().clean
        assert read_take(path).frame_count == 8
        assert not disk.part_path(path, 2).exists()


def test_a_file_beside_a_take_that_only_looks_like_a_part_is_left_alone(tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    merge.merge_parts(path, reserve_bytes=0)
    mine = tmp_path / "walk.part7.mcap"
    mine.write_text("mine")
    merge.merge_parts(path, reserve_bytes=0)
    with pytest.raises(TakeExistsError):
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)
    assert mine.read_text() == "mine"
    assert read_take(path).clean
