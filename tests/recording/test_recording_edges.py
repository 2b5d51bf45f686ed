"""What recording and recovery do where their laws do not lead: strange files, failing calls, limits."""

from __future__ import annotations

import errno
import io
import struct
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from support.take_making import SECOND, info, record, scene_bytes, small_take, unclosed_take, write_frame

from mocapella.errors import DamagedTakeError, InputError, RecordingError, SchemaVersionError
from mocapella.recording import bodies_writer, disk, merge, take_reader
from mocapella.recording.accounts import Accounts
from mocapella.recording.bodies_file import ALONE, FollowedBody, FollowedFrame, read_followed_people
from mocapella.recording.bodies_writer import BodiesWriter, left_behind
from mocapella.recording.found_frames import FoundFrames
from mocapella.recording.ledger import NodeLedger
from mocapella.recording.mcap_file import McapFile
from mocapella.recording.mcap_scan import Damage, End, scan
from mocapella.recording.take import FRAMES, NODES, SCENES, new_take_id
from mocapella.recording.take_index import index_take
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import mocapella_pb2 as pb


def test_each_take_has_an_identity_of_its_own() -> None:
    first, second = new_take_id(), new_take_id()
    assert first != second
    assert len(first) == len(second) == 32


def test_a_ledger_counts_what_it_has_received_and_what_is_missing_between() -> None:
    accounts = Accounts({})
    for number in (3, 4, 7):
        accounts.nodes.setdefault(("front", 1), NodeLedger()).put_back(number)
    ledger = accounts.nodes["front", 1]
    ledger.expect(3)
    assert (len(ledger), ledger.gap) == (3, 2)
    assert accounts.gaps == {"front": 2}
    assert NodeLedger().gap == 0


def test_a_system_without_locks_takes_every_lock(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:

        class Without:
            LOCK_EX = LOCK_NB = 0

            @staticmethod
            def flock(fd: int, how: int) -> None:
                raise OSError(errno.ENOLCK, "no locks available")

        monkeypatch.setattr(disk, "fcntl", Without)
        assert disk.lock(file.fileno())
        monkeypatch.setattr(disk, "fcntl", None)
        assert disk.lock(file.fileno())


def chunk_of(messages: bytes) -> bytes:
    """Return an MCAP file with one chunk, whose content is only bytes."""
    body = struct.pack("<QQQIIQ", 0, 0, len(messages), 0, 0, len(messages)) + messages
    return b"\x89MCAP0\r\n" + bytes([Opcode.CHUNK]) + struct.pack("<Q", len(body)) + body


@pytest.mark.parametrize(
    "content",
    [
        bytes([Opcode.MESSAGE]) + struct.pack("<Q", 99),
        bytes([Opcode.MESSAGE]) + struct.pack("<QHIQQ", 22, 7, 0, 0, 0),
        bytes([Opcode.MESSAGE]) + struct.pack("<QH", 2, 7),
        b"\x05",
    ],
    ids=["longer than the chunk", "unknown channel", "too short", "half a head"],
)
def test_a_chunk_with_a_right_checksum_and_strange_content_is_damage(content: bytes) -> None:
    data = chunk_of(content)
    events = list(scan(io.BytesIO(data), len(data), "made.mcap"))
    assert [type(event) for event in events[:-1]] == [Damage]
    assert "unknown content" in events[0].problem  # type: ignore[union-attr]


def with_message(path: Path, topic: str, data: bytes) -> Path:
    """Write a take's file that has only this message."""
    with path.open("w+b") as out:
        file = McapFile(out.fileno(), "mocapella")
        file.add_message(file.add_channel(topic, "", 0), data, log_ns=1, publish_ns=1, sequence=0)
        file.finish()
    return path


@pytest.mark.parametrize("topic", [FRAMES + "front", SCENES, NODES])
def test_a_message_that_is_none_of_ours_is_a_problem(topic: str, tmp_path: Path) -> None:
    index = index_take([with_message(tmp_path / "a.mcap", topic, b"\xff\xff\xff")])
    assert not index.clean
    assert [problem.partition(" at byte")[0] for problem in index.problems] == [f"a.mcap: the message of {topic}"]


def test_a_frame_that_is_stored_twice_counts_once(tmp_path: Path) -> None:
    path = unclosed_take(tmp_path / "a.mcap", count=4)
    again = tmp_path / "a.part2.mcap"
    again.write_bytes(path.read_bytes())
    assert len(index_take([path, again]).frames) == len(index_take([path]).frames) == 8


def test_a_take_that_is_missing_or_a_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.mcap: there is no such file"):
        index_take([tmp_path / "none.mcap"])
    with pytest.raises(InputError, match="cannot be read"):
        index_take([tmp_path])


def test_a_take_tells_what_it_has(tmp_path: Path) -> None:
    take = read_take(small_take(tmp_path / "a.mcap", count=4))
    assert (take.frame_count, take.scene_count, take.part_counts) == (8, 8, {"people": 8})
    assert take.interruptions == ()
    assert take.unread_frame_types == ()
    assert take.take_id == take.info.take_id
    assert [stored.frame.sequence for stored in take.frames_in_sequence("front")] == [0, 1, 2, 3]
    assert take.seconds > 0
    assert take.sensors == ("front", "side")


def test_a_take_without_a_description_says_so(tmp_path: Path) -> None:
    take = read_take(with_message(tmp_path / "a.mcap", SCENES, scene_bytes(0, "front", 0)))
    assert take.take_id == ""
    with pytest.raises(DamagedTakeError, match="how it was made"):
        _ = take.info


def test_a_take_that_shrinks_or_goes_while_it_is_read_is_named(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap", count=4)
    take = read_take(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(DamagedTakeError, match="became shorter"):
        list(take.frames())
    path.unlink()
    with pytest.raises(InputError, match="cannot be read any more"):
        list(take.frames())


def test_a_take_on_a_failing_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(io.BytesIO):
        def read(self, size: int | None = -1, /) -> bytes:
            raise OSError(errno.EIO, "Input/output error")

    take = read_take(small_take(tmp_path / "a.mcap", count=2))
    monkeypatch.setattr(type(take), "_open", lambda self, stack: [Failing()])
    with pytest.raises(InputError, match=r"cannot be read \(Input/output error\)"):
        list(take.frames())


def test_frames_that_are_none_are_damage_with_their_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = read_take(small_take(tmp_path / "a.mcap", count=2))
    monkeypatch.setattr(type(take), "_bytes", lambda self, files, ref: b"\xff\xff")
    with pytest.raises(DamagedTakeError, match="at byte"):
        list(take.frames())


def test_a_frame_of_another_version_is_named_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = read_take(small_take(tmp_path / "a.mcap", count=2))
    newer = pb.BodyFrame(schema_version=99, sensor="front").SerializeToString()
    monkeypatch.setattr(type(take), "_bytes", lambda self, files, ref: newer)
    with pytest.raises(SchemaVersionError, match="99"):
        list(take.frames())


def test_a_spool_that_shrinks_while_it_is_read_is_named(tmp_path: Path) -> None:
    path = small_take(tmp_path / "spool.mcap", count=2)
    ref = index_take([path]).frames[-1]
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(DamagedTakeError, match=r"spool\.mcap: became shorter"):
        list(FoundFrames(((path, ref),), (), 0).read())


def test_a_merge_flushes_as_it_goes_and_is_equal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(merge, "_FLUSH_BYTES", 0)
    path = unclosed_take(tmp_path / "a.mcap", count=4)
    before = [stored.raw for stored in read_take(path).frames()]
    merge.merge_parts(path, reserve_bytes=0)
    assert [stored.raw for stored in read_take(path).frames()] == before
    assert read_take(path).seconds > 0


def test_a_copy_without_an_end_replaces_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = unclosed_take(tmp_path / "a.mcap", count=4)
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(merge, "closed", lambda _: False)
        with pytest.raises(RecordingError, match="has no end; the parts it was made of are kept"):
            merge.merge_parts(path, reserve_bytes=0)
    assert path.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_take_that_another_program_changes_stops(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    with path.open("ab") as other:
        other.write(b"more")
    write_frame(writer, "front", 9, 9 * SECOND)
    with pytest.raises(RecordingError, match="was changed by another program"):
        writer.flush()


def test_a_take_that_was_moved_away_stops_with_what_it_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    path.rename(tmp_path / "b.mcap")
    write_frame(writer, "front", 9, 9 * SECOND)

    def fails(fd: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(disk, "_data_sync", fails)
    with pytest.raises(RecordingError, match="the 8 frames before it, and 1 are lost"):
        writer.flush()


def test_a_file_of_another_kind_is_not_gone_on_with(tmp_path: Path) -> None:
    path = with_message(tmp_path / "a.mcap", "/tf", b"a message")
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4))])
    with pytest.raises(RecordingError, match="no take that can be gone on with"):
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)


def test_a_result_of_nobody_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    path.write_text('{"format":"mocapella followed people","version":1,"people":{}}')
    with pytest.raises(InputError, match="has no body"):
        read_followed_people(path)


def row(k: int) -> FollowedFrame:
    return FollowedFrame(k, k / 30, (0.0,) * 6, {}, {}, {}, {}, False)


def test_a_result_that_cannot_be_put_together_keeps_its_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = {name: FollowedBody("male", [], None, {}) for name in ("anna", "ben")}
    writer = BodiesWriter(tmp_path / "out.json", bodies, {})
    writer.add(dict.fromkeys(bodies, row(0)))

    def fails(self: Path, target: Path) -> Path:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fails)
        with pytest.raises(RecordingError, match="Input/output error"):
            writer.finish({}, {name: {} for name in bodies})
    writer.close()
    assert left_behind(tmp_path / "out.json") == [tmp_path / "out.part.json"]
    assert not (tmp_path / "out.part.whole").exists()


def test_a_result_whose_disk_fails_at_the_end_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = BodiesWriter(tmp_path / "out.json", {ALONE: FollowedBody("male", [], None, {})}, {})
    writer.add({ALONE: row(0)})

    def fails(fd: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(bodies_writer.os, "fsync", fails)
    with pytest.raises(RecordingError, match="No space left"):
        writer.finish({}, {ALONE: {}})
    writer.close()


def test_frames_from_a_spool_are_flushed_as_they_are_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(merge, "_FLUSH_BYTES", 0)
    path, spool = tmp_path / "a.mcap", tmp_path / "spool.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    write_frame(writer, "front", 9, 9 * SECOND)
    writer.close()
    small_take(spool, count=9)
    assert merge.merge_frames(path, [spool], reserve_bytes=0)["front"] == 5
    assert [stored.frame.sequence for stored in read_take(path).frames_in_sequence("front")] == [*range(9), 9]


def test_a_result_without_a_file_that_cannot_be_put_together_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = {name: FollowedBody("male", [], None, {}) for name in ("anna", "ben")}
    writer = BodiesWriter(None, bodies, {})
    writer.add(dict.fromkeys(bodies, row(0)))

    def fails(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(writer, "_write_whole", fails)
    with pytest.raises(RecordingError, match="No space left"):
        writer.finish({}, {name: {} for name in bodies})
    writer.close()


@pytest.mark.parametrize(("beyond", "said"), [(9, "checksum over all data"), (40, "checksum of the index")])
def test_a_file_with_a_wrong_checksum_at_its_end_is_damaged(beyond: int, said: str, tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap", count=2)
    data = bytearray(path.read_bytes())
    place = data.rindex(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4)) + beyond
    data[place] ^= 1
    path.write_bytes(data)
    assert [problem for problem in read_take(path).problems if said in problem] != []


@pytest.mark.parametrize("body", [b"", struct.pack("<HI", 0, 99) + bytes(16)])
def test_an_index_of_messages_with_a_wrong_length_is_damage(body: bytes) -> None:
    record = bytes([Opcode.MESSAGE_INDEX]) + struct.pack("<Q", len(body)) + body
    data = chunk_of(b"") + record + chunk_of(b"")[8:]
    assert [type(event) for event in scan(io.BytesIO(data), len(data), "made.mcap")] == [Damage, End]


def test_scenes_without_their_frame_are_passed_over_in_a_replay(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    writer.write_scene(scene_bytes(0, "front", 0), SECOND)
    write_frame(writer, "front", 1, 2 * SECOND)
    writer.write_scene(scene_bytes(1, "front", 1), 3 * SECOND)
    writer.close()
    assert len(list(read_take(path).replay_run(0))) == 1


def test_frames_that_are_none_can_be_left_out_and_damage_the_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = read_take(small_take(tmp_path / "a.mcap", count=2))
    assert not take.damaged
    whole, real = len(list(take.frames())), type(take)._bytes
    first = next(iter(take.frames())).log_ns
    monkeypatch.setattr(
        type(take), "_bytes", lambda self, files, ref: b"\xff" if ref.log_ns == first else real(self, files, ref)
    )
    take.skips = True
    assert 0 < len(list(take.frames())) < whole
    assert take.damaged
    assert all("at byte" in problem for problem in take.skipped)


def test_a_take_remembers_only_so_much_of_what_it_leaves_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take_reader, "MOST_SKIPPED", 1)
    take = read_take(small_take(tmp_path / "a.mcap", count=2))
    monkeypatch.setattr(type(take), "_bytes", lambda self, files, ref: b"\xff")
    take.skips = True
    assert list(take.frames()) == []
    assert len(take.skipped) == 1


def test_a_frame_that_can_never_be_stored_counts_as_lost_also_before_the_first_number_is_agreed() -> None:
    ledger = NodeLedger()
    assert ledger.give_up(7)
    assert (ledger.first, ledger.heard, ledger.lost) == (7, 8, 1)
    ledger.receive(8)
    assert not ledger.give_up(8)
    ledger.commit()
    assert (ledger.first, ledger.heard, ledger.lost) == (7, 9, 1)
