"""A node's spool is a take of its own, from which the frames that another take lacks are added to it."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from support.take_making import frame_bytes, info, keys, unclosed_take, write_frame

from mocapella.errors import DamagedTakeError, DiskFullError, RecordingError
from mocapella.recording import disk
from mocapella.recording.ledger import NodeLedger
from mocapella.recording.merge import merge_frames
from mocapella.recording.spool import DiskSpool, SpoolLimits
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter

NODE = ("front", 7)
LIMITS = SpoolLimits(reserve_bytes=0)


def frames(numbers: range) -> list[bytes]:
    return [frame_bytes(*NODE[:1], number, NODE[1]) for number in numbers]


def spool(folder: Path, limits: SpoolLimits = LIMITS) -> DiskSpool:
    return DiskSpool(folder / "spool", *NODE, limits)


def take_without(path: Path, lacking: range, *, ends: bool) -> str:
    """Record the frames 5 to 19 of the node but for some, and return the take's identity."""
    writer = TakeWriter.create(path, info=replace(info(), take_id="0123456789abcdef"), reserve_bytes=0)
    writer.accounts.change(NODE, lambda ledger: ledger.expect(5))
    for number in (number for number in range(5, 20) if number not in lacking):
        write_frame(writer, NODE[0], number, number, NODE[1])
    if ends:
        writer.accounts.change(NODE, lambda ledger: ledger.finish(20))
    writer.close()
    return writer.take_id


def test_frames_come_back_from_the_spool_as_they_were(tmp_path: Path) -> None:
    place = spool(tmp_path)
    place.write(3, frames(range(3, 8)))
    place.write(8, frames(range(8, 10)))
    assert place.read(3) == frames(range(3, 8))
    assert place.read(8) == frames(range(8, 10))
    place.remove(3)
    with pytest.raises(RecordingError, match="cannot be read"):
        place.read(3)
    place.close()
    assert not (tmp_path / "spool").exists()


def test_a_spool_may_be_as_large_as_its_largest_size(tmp_path: Path) -> None:
    size = sum(map(len, frames(range(3))))
    place = spool(tmp_path, SpoolLimits(0, most_bytes=2 * size))
    place.write(0, frames(range(3)))
    place.write(3, frames(range(3)))
    with pytest.raises(DiskFullError, match=f"largest size, {2 * size} bytes"):
        place.write(6, [b"x"])


def test_a_spools_limits_are_those_that_the_documentation_tells() -> None:
    text = (Path(__file__).parents[2] / "docs/takes.md").read_text(encoding="utf-8")
    told = re.search(r"spool of a node grows up to (\d+) GiB, and leaves (\d+) GiB of the disk free", text)
    assert told is not None
    most, reserve = (int(gib) * 1024**3 for gib in told.groups())
    assert SpoolLimits() == SpoolLimits(reserve_bytes=reserve, most_bytes=most)


def test_a_spool_leaves_the_reserve_and_has_a_largest_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DiskFullError, match="largest size"):
        spool(tmp_path, SpoolLimits(0, most_bytes=10)).write(0, frames(range(3)))
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=999))
    with pytest.raises(DiskFullError, match="cannot record into"):
        spool(tmp_path, SpoolLimits(reserve_bytes=1000)).write(0, frames(range(3)))
    assert list((tmp_path / "spool").iterdir()) == []


def test_a_disk_that_fails_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_fd: int, _data: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(disk, "write_all", fails)
        with pytest.raises(DiskFullError, match="the disk is full"):
            spool(tmp_path).write(0, frames(range(3)))
    assert list((tmp_path / "spool").iterdir()) == []


def test_kept_frames_make_a_take_whole_and_say_its_end(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    take_id = take_without(path, range(12, 20), ends=False)
    before = read_take(path)
    assert not before.clean
    assert before.complete()[0].last == 11
    kept = spool(tmp_path).keep(take_id, zip(range(12, 20), frames(range(12, 20)), strict=True), range(12, 20))
    assert merge_frames(path, [kept], reserve_bytes=0) == {"front": 8}
    take = read_take(path)
    assert take.clean
    assert keys(take) == [(*NODE, number) for number in range(5, 20)]
    assert (take.complete()[0].lost, take.seconds) == (0, before.seconds)
    content = path.read_bytes()
    assert merge_frames(path, [kept], reserve_bytes=0) == {}
    assert path.read_bytes() == content


def test_only_frames_that_belong_to_the_take_are_added_and_the_rest_counts_as_lost(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    take_without(path, range(10, 16), ends=True)
    place = spool(tmp_path)
    place.write(0, frames(range(13)))  # from before the take, too
    place.write(19, frames(range(19, 30)))
    stranger = DiskSpool(tmp_path / "spool", "side", 8, LIMITS)
    stranger.write(0, [frame_bytes("side", 0, 8)])
    files = sorted((tmp_path / "spool").iterdir())
    assert merge_frames(path, files, reserve_bytes=0) == {"front": 3}
    (node,) = read_take(path).complete()
    assert (node.first, node.last, node.lost, node.missing) == (5, 19, 3, ((13, 15),))


def test_a_node_that_the_take_has_not_met_is_added_if_its_frames_were_kept_for_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    take_id = take_without(path, range(0), ends=True)
    other = DiskSpool(tmp_path / "spool", "side", 8, LIMITS)
    kept = other.keep(take_id, [(n, frame_bytes("side", n, 8)) for n in (2, 3)], range(1, 4))
    assert merge_frames(path, [kept], reserve_bytes=0) == {"side": 2}
    side = read_take(path).complete()[1]
    assert (side.sensor, side.first, side.last, side.stored, side.lost) == ("side", 1, 3, 2, 1)


def test_an_interrupted_take_is_put_together_on_the_way(tmp_path: Path) -> None:
    path = unclosed_take(tmp_path / "a.mcap", 4)
    place = DiskSpool(tmp_path / "spool", "front", 1, LIMITS)
    place.write(4, [frame_bytes("front", 4, 1)])
    assert merge_frames(path, sorted((tmp_path / "spool").iterdir()), reserve_bytes=0) == {"front": 1}
    assert read_take(path).clean


def test_a_damaged_file_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mcap"
    take_without(path, range(12, 20), ends=False)
    place = spool(tmp_path)
    place.write(12, frames(range(12, 20)))
    (file,) = (tmp_path / "spool").iterdir()
    before = path.read_bytes()
    real = merge_frames.__globals__["found_frames"]

    def shortened(*arguments: object) -> object:
        found = real(*arguments)
        file.write_bytes(file.read_bytes()[:200])
        return found

    monkeypatch.setitem(merge_frames.__globals__, "found_frames", shortened)
    with pytest.raises(DamagedTakeError, match="became shorter"):
        merge_frames(path, [file], reserve_bytes=0)
    assert path.read_bytes() == before
    assert not disk.merging_path(path).exists()


def test_an_account_is_never_raised_and_its_end_is_said_once() -> None:
    ledger = NodeLedger()
    assert ledger.expect(5)
    assert not ledger.expect(6)
    assert not ledger.receive(4)
    assert ledger.receive(7)
    assert ledger.unknown_after == 7
    assert ledger.finish(9)
    assert not ledger.finish(20)
    assert not ledger.receive(9)
    ledger.commit()
    assert (ledger.expected, ledger.stored, ledger.lost, list(ledger.missing())) == (4, 1, 3, [(5, 6), (8, 8)])
    assert (ledger.acknowledged, ledger.unknown_after) == (5, None)
    ledger.hear(9, oldest=7)
    ledger.commit()
    assert (ledger.acknowledged, list(ledger.obtainable(9))) == (8, [(8, 8)])


def test_frames_that_are_kept_twice_for_a_take_are_in_two_files(tmp_path: Path) -> None:
    place = spool(tmp_path)
    kept = [place.keep("0" * 32, [(n, data) for n, data in zip(part, frames(part), strict=True)], part)
            for part in (range(3), range(7, 9))]  # fmt: skip
    assert len({path.name for path in kept}) == 2
    assert [path.stat().st_size > 0 for path in kept] == [True, True]
