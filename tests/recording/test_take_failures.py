"""A disk that fills or fails stops a recording once and loudly, and what was stored stays as it was."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.take_making import info, keys, record, unclosed_take, write_frame

from mocapella.errors import DiskFullError, RecordingError
from mocapella.recording import disk
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter


def started(path: Path) -> TakeWriter:
    """A writer with 8 frames stored and 2 pending."""
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    record(writer, 4, 1, step=8, per_flush=9)
    return writer


def fail_with(monkeypatch: pytest.MonkeyPatch, what: str, number: int, first_only: bool = False) -> None:
    """Make the disk's writes (or syncs) fail, from now on or once."""
    real = os.write if what == "write" else disk._data_sync
    calls: list[int] = []

    def fails(*arguments: object) -> object:
        calls.append(1)
        if first_only and len(calls) > 1:
            return real(*arguments)  # type: ignore[arg-type]
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os if what == "write" else disk, "write" if what == "write" else "_data_sync", fails)


@pytest.mark.parametrize("lasting", [True, False])
@pytest.mark.parametrize(
    ("what", "number", "kind", "says"),
    [
        ("write", 28, DiskFullError, "the disk is full"),
        ("write", 122, DiskFullError, "the disk is full"),
        ("write", 5, RecordingError, "the disk failed"),
        ("sync", 5, RecordingError, "the disk failed"),
    ],
)
def test_a_failing_disk_stops_the_recording_loudly_and_once(  # noqa: PLR0917
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    what: str,
    number: int,
    kind: type[RecordingError],
    says: str,
    lasting: bool,
) -> None:
    writer = started(tmp_path / "a.mcap")
    with monkeypatch.context() as patch:
        fail_with(patch, what, number, first_only=not lasting)
        with pytest.raises(kind, match=f"{says}.*holds the 8 frames before it, and 2 are lost") as caught:
            writer.flush()
        assert type(caught.value) is kind
        report = writer.close()  # says it again, and raises nothing
    assert report.frames == {"front": 4, "side": 4}
    assert report.lost == {"front": 1, "side": 1}
    assert report.scenes == 8
    assert report.clean is not lasting
    assert says in report.problem
    for refused in (writer.flush, lambda: write_frame(writer, "front", 5, 5), lambda: writer.start_run(info())):
        with pytest.raises(RecordingError, match=r"a\.mcap is closed .* begin a new take"):
            refused()
    take = read_take(report.path)
    assert take.clean is report.clean
    assert keys(take, "front") == [("front", 1, s) for s in range(4)]


def test_a_disk_that_fills_to_the_reserve_stops_with_everything_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=usage.free // 2)
    record(writer, 0, 4)
    record(writer, 4, 1, step=8, per_flush=9)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=usage.free // 2 - 1))
    with pytest.raises(DiskFullError, match=r"stopped: .* GiB are free and .* holds the 10 frames before it$"):
        writer.flush()
    report = writer.close()
    assert (report.clean, report.frames, report.lost) == (True, {"front": 5, "side": 5}, {})
    assert read_take(report.path).clean


def test_a_frame_counts_as_stored_only_after_the_sync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = started(tmp_path / "a.mcap")
    real, counts = disk._data_sync, list[int]()

    def sync(fd: int) -> None:
        counts.append(writer.accounts.stored)
        real(fd)

    monkeypatch.setattr(disk, "_data_sync", sync)
    writer.flush()
    assert (counts, writer.accounts.stored) == ([8], 10)
    writer.close()


def test_a_disk_that_fails_at_the_end_is_said_and_the_frames_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = started(tmp_path / "a.mcap")
    writer.flush()
    with monkeypatch.context() as patch:
        fail_with(patch, "write", 28)
        with pytest.raises(DiskFullError, match="could not be closed"):
            writer.close()
    assert not writer.close().clean
    take = read_take(writer.path)
    assert (take.clean, take.frame_count) == (False, 10)


def test_a_disk_that_is_full_from_the_start_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        fail_with(patch, "write", 28)
        with pytest.raises(DiskFullError, match="cannot record to"):
            TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    assert list(tmp_path.iterdir()) == []


def test_no_room_to_put_the_parts_together_keeps_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = unclosed_take(tmp_path / "a.mcap")
    writer = TakeWriter.resume_or_create(path, info=info(10**9), reserve_bytes=0)
    record(writer, 0, 16)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    report = writer.close()
    assert not report.clean
    assert "cannot put the parts" in report.problem
    assert len(report.parts) == 2
    assert sorted(keys(read_take(path), "side")) == [("side", 1, s) for s in range(16)]


LIMITED = """
import resource, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from support.take_making import info, record
from mocapella.errors import RecordingError
from mocapella.recording.take_writer import TakeWriter

resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
writer = TakeWriter.create(Path({path!r}), info=info(), reserve_bytes=0)
try:
    record(writer, 0, 1000)
except RecordingError as error:
    print(sum(writer.close().frames.values()), writer.close().clean, error)
"""


def test_a_real_limit_of_the_file_system_cuts_a_write_in_the_middle(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    code = LIMITED.format(tests=str(Path(__file__).parent.parent), path=str(path))
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    count, clean, message = result.stdout.split(" ", 2)
    assert "File too large" in message
    take = read_take(path)
    assert take.frame_count == int(count) > 8
    assert str(take.clean) == clean
    assert bool(take.problems) is not take.clean
    assert path.stat().st_size <= 200_000


def test_a_take_that_was_removed_says_that_nothing_is_left(tmp_path: Path) -> None:
    writer = started(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").unlink()
    with pytest.raises(RecordingError, match=r"was removed while it was recorded.* 0 frames .* 10 are lost"):
        writer.flush()
    assert writer.report is not None
    assert (writer.report.frames, sum(writer.report.lost.values()), writer.report.scenes) == ({}, 10, 0)


def test_a_folder_that_was_removed_stops_a_recording_like_a_disk_that_fails(tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    writer = started(tmp_path / "takes" / "a.mcap")
    shutil.rmtree(tmp_path / "takes")
    with pytest.raises(RecordingError, match="was removed"):
        writer.close()
    assert writer.report is not None
    assert not writer.report.clean


@pytest.mark.parametrize("replaced", [False, True])
def test_a_take_that_was_moved_is_whole_where_it_is_now_and_the_report_says_so(tmp_path: Path, replaced: bool) -> None:
    writer = started(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").rename(tmp_path / "b.mcap")
    if replaced:
        (tmp_path / "a.mcap").write_text("something else")
    report = writer.close()
    assert not report.clean
    assert "was moved" in report.problem
    take = read_take(tmp_path / "b.mcap")
    assert take.clean
    assert take.frame_count == 10


def test_parts_of_a_take_that_was_moved_are_kept_and_the_report_says_why(tmp_path: Path) -> None:
    path = unclosed_take(tmp_path / "a.mcap")
    writer = TakeWriter.resume_or_create(path, info=info(10**9), reserve_bytes=0)
    part = disk.part_path(path, 2)
    path.rename(tmp_path / "b.mcap")
    report = writer.close()
    assert not report.clean
    assert report.problem
    assert part.exists()
