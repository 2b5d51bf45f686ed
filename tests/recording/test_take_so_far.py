"""A recording that goes on knows of the earlier parts what reading all of them tells, from the newest one."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.take_making import STEP, info, keys, scene_bytes, write_frame

from mocapella.errors import InputError
from mocapella.recording import disk, take_index
from mocapella.recording.ledger import LedgerRow, NodeLedger
from mocapella.recording.sequences import SequenceRanges
from mocapella.recording.take_index import index_take
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_so_far import TakeSoFar, read_so_far
from mocapella.recording.take_writer import TakeWriter

NODES = [("front", 1), ("side", 1), ("side", 2)]
ENTRIES = st.lists(
    st.one_of(
        st.tuples(st.just("frame"), st.sampled_from(NODES), st.integers(0, 12)),
        st.tuples(st.sampled_from(["expect", "heard", "finish", "left"]), st.sampled_from(NODES), st.integers(0, 12)),
        st.tuples(st.just("scene"), st.sampled_from(NODES), st.integers(0, 12)),
        st.tuples(st.just("flush"), st.none(), st.none()),
    ),
    max_size=12,
)
CHANGES = {
    "expect": NodeLedger.expect,
    "heard": NodeLedger.hear,
    "finish": NodeLedger.finish,
    "left": lambda ledger, end: ledger.finish(end, left=True),
}


def kill(writer: TakeWriter, torn_bytes: int) -> None:
    """End a recording as a kill does: its file has no end, and its last ``torn_bytes`` are missing."""
    file = disk.parts_of(writer.path)[-1]
    os.ftruncate(writer._fd, max(0, file.stat().st_size - torn_bytes))
    for fd in (writer._fd, writer._lock_fd):
        if fd is not None:
            os.close(fd)


def write(writer: TakeWriter, entries: list[Any]) -> None:
    for step, (what, node, number) in enumerate(entries):
        if what == "frame":
            write_frame(writer, *node[:1], number, number * STEP, node[1])
        elif what == "scene":
            writer.write_scene(scene_bytes(step, node[0], number, node[1]), number * STEP)
        elif what == "flush":
            writer.flush()
        else:
            writer.accounts.change(node, lambda ledger, what=what, number=number: CHANGES[what](ledger, number))


def told(nodes: dict[tuple[str, int], NodeLedger]) -> dict[Any, Any]:
    return {
        node: (led.row(*node), led.agreed, led.received(), led.stored, led.acknowledged, led.lost, led.unknown_after)
        for node, led in nodes.items()
    }


@given(st.lists(st.tuples(ENTRIES, st.one_of(st.just(None), st.integers(0, 300))), min_size=1, max_size=5))
def test_the_newest_part_tells_what_all_parts_tell(parts: list[tuple[list[Any], int | None]]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        for number, (entries, torn) in enumerate(parts):
            writer = TakeWriter.resume_or_create(path, info=info(number), reserve_bytes=0)
            write(writer, entries)
            if torn is None:
                writer.close(interrupted=True)
            else:
                writer.flush()
                kill(writer, torn)
            files = disk.parts_of(path)
            known, whole = read_so_far(files), index_take(files)
            assert told(known.nodes) == told(whole.nodes)
            assert known.sizes == [file.stat().st_size for file in files]
            assert known.scenes == len(whole.scenes)
            assert (known.first_ns, known.last_ns) == (whole.first_ns, whole.last_ns)
            assert known.next_run == (whole.runs[-1].number + 1 if whole.runs else 0)
            assert known.take_id == (whole.runs[0].info.take_id if whole.runs else "")
            if not whole.runs:  # torn so early that it is no take to go on with
                return


def interrupted(path: Path, parts: int) -> None:
    """A take of ``parts`` parts; each has the next frame of a node."""
    for number in range(parts):
        writer = TakeWriter.resume_or_create(path, info=info(number), reserve_bytes=0)
        write_frame(writer, "front", number, number * STEP)
        writer.flush()
        kill(writer, 0)


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files of takes that are read whole, in order."""
    names: list[str] = []
    add_file = take_index.TakeIndex.add_file

    def note(index: take_index.TakeIndex, file: Path, part: int) -> None:
        names.append(file.name)
        add_file(index, file, part)

    monkeypatch.setattr(take_index.TakeIndex, "add_file", note)
    return names


def received(path: Path) -> list[tuple[int, int]]:
    return read_so_far(disk.parts_of(path)).nodes["front", 1].received()


def test_only_the_newest_part_is_read(tmp_path: Path, read: list[str]) -> None:
    path = tmp_path / "walk.mcap"
    interrupted(path, 6)
    read.clear()
    assert received(path) == [(0, 5)]
    assert read == ["walk.part6.mcap"]


def test_the_part_before_one_without_a_beginning_is_read_too(tmp_path: Path, read: list[str]) -> None:
    path = tmp_path / "walk.mcap"
    interrupted(path, 5)
    disk.part_path(path, 6).touch()  # killed before its first flush
    read.clear()
    assert received(path) == [(0, 4)]
    assert read == ["walk.part5.mcap", "walk.part6.mcap"]


def test_a_part_that_was_changed_since_it_was_counted_is_read_again(tmp_path: Path, read: list[str]) -> None:
    path = tmp_path / "walk.mcap"
    interrupted(path, 6)
    with disk.part_path(path, 4).open("ab") as changed:
        changed.write(b"\0" * 9)
    read.clear()
    assert received(path) == [(0, 5)]
    assert read == ["walk.part4.mcap", "walk.part5.mcap", "walk.part6.mcap"]


def test_the_merged_take_has_no_account(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    interrupted(path, 3)
    TakeWriter.resume_or_create(path, info=info(3), reserve_bytes=0).close()
    take = read_take(path)
    assert keys(take, "front") == [("front", 1, k) for k in range(3)]
    assert b"/earlier" not in path.read_bytes()


@pytest.mark.parametrize("ranges", [[[3, 2]], [[0, 4], [4, 6]], [[0, 4], [5, 6]], [[5, 6], [0, 1]], [[-1, 2]], "x"])
def test_an_account_that_cannot_be_true_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: list[str], ranges: Any
) -> None:
    path = tmp_path / "walk.mcap"
    interrupted(path, 2)
    encode = TakeSoFar.encode

    def wrong(so_far: TakeSoFar) -> bytes:
        return encode(so_far).replace(b'"received":[[0,1]]', f'"received":{ranges}'.replace("'", '"').encode())

    monkeypatch.setattr(TakeSoFar, "encode", wrong)
    writer = TakeWriter.resume_or_create(path, info=info(2), reserve_bytes=0)
    write_frame(writer, "front", 2, 2 * STEP)
    writer.flush()
    kill(writer, 0)
    read.clear()
    assert received(path) == [(0, 2)]
    assert read == ["walk.part2.mcap", "walk.part3.mcap"]  # part 2's account of part 1 can be used


@given(st.sets(st.integers(0, 60)))
def test_a_set_is_made_again_from_its_ranges(numbers: set[int]) -> None:
    added = SequenceRanges()
    for number in sorted(numbers):
        added.add(number)
    again = SequenceRanges.of(added.ranges)
    assert again.ranges == added.ranges
    assert len(again) == len(numbers)
    assert all((number in again) == (number in numbers) for number in range(-1, 62))


def test_a_restored_ledger_goes_on_like_the_first(tmp_path: Path) -> None:
    first = NodeLedger()
    first.read(LedgerRow("front", 1, 2, None, 9))
    for number in (2, 3, 6):
        first.receive(number)
    first.commit()
    second = NodeLedger.restored(first.row("front", 1), first.agreed, first.received())
    for ledger in (first, second):
        ledger.give_up(4)
        ledger.receive(5)
        ledger.commit()
    assert told({("front", 1): first}) == told({("front", 1): second})
    assert second.acknowledged == 7


def test_a_part_that_is_gone_is_named(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    interrupted(path, 2)
    with pytest.raises(InputError, match=r"walk\.part7\.mcap.*there is no such file"):
        read_so_far([*disk.parts_of(path), disk.part_path(path, 7)])
