"""A merged take is compared with what it was made of, entry by entry, before it replaces it."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.take_making import STEP, frame_bytes, info, keys, record

from mocapella.errors import RecordingError, TakeExistsError
from mocapella.recording import disk, merge, take
from mocapella.recording.spool import DiskSpool, SpoolLimits
from mocapella.recording.take_file import TakeFile
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter


def written(path: Path, *texts: str, closed: bool = True, log_ns: int = 5) -> Path:
    """A file with these notices, and an end if ``closed``."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        file = TakeFile(fd)
        for number, text in enumerate(texts):
            file.add(take.STATUS, text.encode(), log_ns, number)
        if closed:
            file.finish()
        else:
            file.flush(durable=False)
    finally:
        os.close(fd)
    return path


def found(*texts: str, rows: int = 0) -> Any:
    """Frames of another file, which continue the numbers 0 and 1, and ledgers."""
    frames = [(take.STATUS, text.encode(), number) for number, text in enumerate(texts, 2)]
    return SimpleNamespace(read=lambda: iter(frames), rows=["row"] * rows, log_ns=5)


def test_a_copy_of_all_parts_in_their_order_is_accepted(tmp_path: Path) -> None:
    parts = [written(tmp_path / "a", "1", "2"), written(tmp_path / "b", closed=False)]
    merge._compare(parts, written(tmp_path / "copy", "1", "2"), None)
    merge._compare(parts, written(tmp_path / "more", "1", "2", "3", "4"), found("3", "4"))


@pytest.mark.parametrize(
    ("texts", "added", "closed", "said"),
    [
        (("1",), None, True, "is not equal to the parts .*, at /status"),
        (("2", "1"), None, True, "is not equal"),
        (("1", "2", "3"), None, True, "is not equal"),
        (("1", "2", "3", "4"), found("3"), True, "is not equal"),
        (("1", "2", "4"), found("3"), True, "is not equal"),
        (("1", "2", "3"), found("3", rows=1), True, "is not equal to the parts .*, at /nodes"),
        (("1", "2"), found("3"), True, "is not equal"),
        (("1", "2"), None, False, "has no end"),
    ],
)
def test_a_copy_that_lacks_or_adds_something_is_refused(
    texts: tuple[str, ...], added: Any, closed: bool, said: str, tmp_path: Path
) -> None:
    part = written(tmp_path / "a", "1", "2")
    copy = written(tmp_path / "copy", *texts, closed=closed)
    with pytest.raises(RecordingError, match=said):
        merge._compare([part], copy, added)


def test_an_entry_at_another_time_is_another(tmp_path: Path) -> None:
    part = written(tmp_path / "a", "1")
    with pytest.raises(RecordingError, match="is not equal"):
        merge._compare([part], written(tmp_path / "copy", "1", log_ns=6), None)


def marked_take(path: Path, parts: int) -> Path:
    """A take of 8 frames of two sensors a part, whose program failed and closed it."""
    for number in range(parts):
        writer = TakeWriter.resume_or_create(path, info=info(8 * number * STEP), reserve_bytes=0)
        record(writer, 8 * number, 8)
        writer.close(interrupted=True)
    return path


def kept(folder: Path, *sequences: int) -> list[Path]:
    """Files of frames that a node kept."""
    spool = DiskSpool(folder / "spool", "front", 1, SpoolLimits(reserve_bytes=0))
    for sequence in sequences:
        spool.write(sequence, [frame_bytes("front", sequence)])
    return sorted((folder / "spool").iterdir())


def resumed(path: Path, first: int) -> TakeWriter:
    writer = TakeWriter.resume_or_create(path, info=info(first * STEP), reserve_bytes=0)
    record(writer, first, 4)
    return writer


def check_whole(path: Path, fronts: int) -> None:
    """The take is one clean file with each frame once, and was closed in the end."""
    assert [entry.name for entry in path.parent.iterdir() if entry.suffix == ".mcap"] == [path.name]
    read = read_take(path)
    assert read.clean, read.problems
    assert sorted(keys(read, "front")) == [("front", 1, sequence) for sequence in range(fronts)]
    with pytest.raises(TakeExistsError):
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)


@pytest.mark.parametrize("parts", [1, 2])
def test_a_take_that_its_failing_program_closed_goes_on_after_frames_were_added(parts: int, tmp_path: Path) -> None:
    path, count = marked_take(tmp_path / "walk.mcap", parts), 8 * parts
    first, second, third = kept(tmp_path, count, count + 1, count + 6)
    merge.merge_parts(path, reserve_bytes=0)
    for file in (first, second):
        assert merge.merge_frames(path, [file], reserve_bytes=0) == {"front": 1}
    assert merge.merge_frames(path, [first, second], reserve_bytes=0) == {}
    assert len(disk.parts_of(path)) == 1
    resumed(path, count + 2).close(interrupted=True)
    assert len(disk.parts_of(path)) == 2
    assert merge.merge_frames(path, [third], reserve_bytes=0) == {"front": 1}
    assert resumed(path, count + 7).close().clean
    assert merge.merge_frames(path, [first, second, third], reserve_bytes=0) == {}
    check_whole(path, count + 11)


def test_a_take_whose_server_died_again_before_its_first_flush_still_goes_on(tmp_path: Path) -> None:
    path = marked_take(tmp_path / "walk.mcap", 1)
    assert merge.reopen(path)
    assert merge.merge_frames(path, kept(tmp_path, 8), reserve_bytes=0) == {"front": 1}
    assert resumed(path, 9).close().clean
    check_whole(path, 13)


def test_parts_that_a_kill_left_beside_a_marked_take_are_not_read_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        pass

    def kill(path: Path) -> None:
        raise Killed

    path = marked_take(tmp_path / "walk.mcap", 2)
    with monkeypatch.context() as patch:
        patch.setattr(merge, "remove_leftovers", kill)
        with pytest.raises(Killed):
            merge.merge_parts(path, reserve_bytes=0)
    assert len(disk.parts_of(path)) == 2
    writer = resumed(path, 16)
    assert writer.scenes == 2 * 20
    assert writer.close().clean
    check_whole(path, 20)
