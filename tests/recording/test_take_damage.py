"""Torn, flipped, foreign and newer files: the good part is kept, the bad part is named, nothing else is raised."""

import contextlib
import random
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from support.take_making import info, keys, record, small_take, unclosed_take

from mocapella.errors import DamagedTakeError, InputError, MocapellaError, SchemaVersionError
from mocapella.recording import merge, take
from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.take_reader import Take, read_take
from mocapella.recording.take_writer import TakeWriter


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_take(tmp_path_factory.mktemp("takes") / "clean.mcap", count=8)


@pytest.fixture(scope="module")
def unclosed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unclosed_take(tmp_path_factory.mktemp("takes") / "unclosed.mcap", count=8)


def boundaries(data: bytes) -> list[int]:
    """Where each record begins."""
    at, found = len(MAGIC), []
    while at + 9 <= len(data) - len(MAGIC):
        found.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return found


def chunks(data: bytes) -> list[int]:
    return [at for at in boundaries(data) if data[at] == 6]


def read_all(path: Path) -> Take:
    """Open it and read everything in it."""
    opened = read_take(path)
    for values in (opened.frames(), opened.scenes(), opened.arrivals(), opened.replay(), opened.commands()):
        for _ in values:
            pass
    return opened


def test_a_take_cut_anywhere_is_a_prefix(clean: Path, tmp_path: Path) -> None:
    data, whole = clean.read_bytes(), keys(read_take(clean))
    cuts = {cut + d for cut in boundaries(data) for d in (-1, 0, 1, 9)} | set(range(0, len(data), 997))
    path, counts = tmp_path / "cut.mcap", []
    for cut in sorted(cuts - {len(data)}):
        path.write_bytes(data[:cut])
        try:
            opened = read_all(path)
        except InputError:
            assert cut < chunks(data)[0]
            continue
        assert not opened.clean
        assert "ends early" in opened.problems[0]
        found = keys(opened)
        assert found == whole[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, len(whole))


def test_a_record_whose_length_would_swallow_chunks_does_not(clean: Path, tmp_path: Path) -> None:
    data, path = bytearray(clean.read_bytes()), tmp_path / "swallowed.mcap"
    first, second = chunks(data)[-2:]
    before = max(at for at in boundaries(data) if at < first)
    struct.pack_into("<Q", data, before + 1, second + 100 - before)
    path.write_bytes(data)
    opened = read_all(path)
    assert opened.frame_count >= 8
    assert any("no record can be read there" in problem for problem in opened.problems)


def test_the_end_says_how_much_there_is(unclosed: Path, tmp_path: Path) -> None:
    (problem,) = read_take(unclosed).problems
    assert problem.startswith("unclosed.mcap: ends early, after 0.23 s, 16 frames and 16 scenes; it was not closed")
    path = tmp_path / "torn.mcap"
    path.write_bytes(unclosed.read_bytes() + b"\x06" + struct.pack("<Q", 5000) + b"torn")
    (problem,) = read_take(path).problems
    assert "and 13 bytes after it are no whole entry" in problem


@pytest.mark.slow
def test_every_flipped_bit_of_a_closed_take_is_noticed(clean: Path, tmp_path: Path) -> None:
    data, path = clean.read_bytes(), tmp_path / "flipped.mcap"
    picked = random.Random(1)
    near = {at + d for at in boundaries(data) for d in (*range(13), 20, 27, 33, 37, 41, 49, 57)} | set(
        range(len(data) - 60, len(data))
    )
    for at in sorted({i for i in near if i < len(data)} | set(range(0, len(data), 211))):
        flipped = bytearray(data)
        flipped[at] ^= 1 << picked.randrange(8)
        path.write_bytes(flipped)
        opened = read_all(path)
        assert not opened.clean, f"byte {at}"
        assert opened.problems, f"byte {at}"
        assert opened.frame_count >= 8, f"byte {at}"  # one chunk of two is lost at most


def test_every_flipped_bit_of_an_unclosed_takes_chunks_is_noticed(unclosed: Path, tmp_path: Path) -> None:
    data, path = unclosed.read_bytes(), tmp_path / "flipped.mcap"
    picked = random.Random(2)
    whole = keys(read_take(unclosed))
    last = chunks(data)[-1]
    for start in chunks(data):
        length = 9 + struct.unpack_from("<Q", data, start + 1)[0]
        # The head's times (bytes 9 to 25) are not read; the message index behind a chunk is not, either.
        for at in [*range(start, start + 9), *range(start + 25, start + 49), *range(start + 49, start + length, 197)]:
            flipped = bytearray(data)
            flipped[at] ^= 1 << picked.randrange(8)
            path.write_bytes(flipped)
            opened = read_all(path)
            found = keys(opened)
            assert set(found) <= set(whole)
            assert len(found) <= len(whole) - 8 or start == chunks(data)[0], f"byte {at}"
            assert len(opened.problems) > 1 or "no whole entry" in opened.problems[0] or start == last, f"byte {at}"


def test_a_bad_chunk_is_named_and_the_rest_is_kept(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap", count=12)
    data = bytearray(path.read_bytes())
    second = chunks(data)[2]  # the first holds the run alone
    data[second + 400] ^= 1
    path.write_bytes(data)
    opened = read_all(path)
    (problem, orphans) = (*opened.problems, "")[:2]
    assert problem.startswith(f"a.mcap: bytes {second} to ")
    assert "0.10 s after the beginning: a chunk does not have the checksum" in problem
    assert orphans == ""  # a flush holds frames with their scenes
    assert [s for _, _, s in keys(opened, "front")] == [0, 1, 2, 3, 8, 9, 10, 11]
    assert [node.missing for node in opened.complete()] == [((4, 7),), ((4, 7),)]


@pytest.mark.parametrize("closed", [True, False])
def test_a_damaged_length_costs_one_chunk(tmp_path: Path, closed: bool) -> None:
    path = (small_take if closed else unclosed_take)(tmp_path / "a.mcap", 12)
    data = bytearray(path.read_bytes())
    data[chunks(data)[1] + 4] ^= 0x40
    path.write_bytes(data)
    opened = read_all(path)
    assert "no record can be read there" in opened.problems[0]
    assert [s for _, _, s in keys(opened, "front")] == list(range(4, 12))


def test_how_it_was_made_is_there_twice(clean: Path, tmp_path: Path) -> None:
    data = clean.read_bytes()
    at, path = data.index(b"right-90"), tmp_path / "a.mcap"
    path.write_bytes(data[:at] + b"right-45" + data[at + 8 :])
    opened = read_take(path)
    assert opened.info == info()
    assert "the description of a run was changed; its second copy is used" in opened.problems[0]


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_nothing_but_our_errors(clean: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    content = bytearray(clean.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        piece = data.draw(st.binary(max_size=30))
        content[at : at + data.draw(st.integers(0, 300))] = piece
    path = tmp_path_factory.getbasetemp() / "mutated.mcap"
    path.write_bytes(content)
    with contextlib.suppress(MocapellaError):
        read_all(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty; name a take"),
        (b"Kinect,Time\n1,2\n" * 900, "is no MCAP file; name a take"),
        (b"\0" * 9000, "is no MCAP file"),
        (MAGIC, "nothing in it can be read"),
        (MAGIC[:5], "nothing in it can be read"),
    ],
)
def test_files_that_are_no_takes(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        read_take(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["walk.csv", "walk.csv.gz"])
def test_a_table_is_told_from_a_take(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"Kinect,Time\n1,2\n" * 900)
    with pytest.raises(InputError, match=f"{name}: is a table, and no take; name a take that is there, such as NAME"):
        read_take(path)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file; name a take"):
        read_take(tmp_path / "x.mcap")
    with pytest.raises(InputError, match="cannot be read"):
        read_take(tmp_path)
    with pytest.raises(InputError, match="cannot be opened"):
        merge.merge_parts(tmp_path / "x.mcap")


def foreign(path: Path, compression: str) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[compression])
        writer.start()
        channel = writer.register_channel("/imu", "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    return path


def test_other_programs_mcap_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is an MCAP file, and no take of Mocapella"):
        read_take(foreign(tmp_path / "a.mcap", "NONE"))
    with pytest.raises(InputError, match=r"is compressed \(zstd\).*undo it with mcap decompress"):
        read_take(foreign(tmp_path / "b.mcap", "ZSTD"))


def test_a_newer_schema_is_refused_with_both_versions(tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    TakeWriter.create(path, info=replace(info(), schema_version=2, version="9.0"), reserve_bytes=0).close()
    with pytest.raises(SchemaVersionError, match=r"version 2 \(Mocapella 9\.0\) and this program reads version 1"):
        read_take(path)


DEEP_AND_LONG = (
    b"[" * 9999,
    b"1" * 5000,
    b'{"info": {"schema_version": 1, "setup": {"participant": ' + b"1" * 30 + b"}}}",
)


def test_a_run_that_cannot_be_understood_is_damage() -> None:
    for text in (b"[]", b"{}", b'{"info": {"schema_version": 1}}', b'{"info": 3}', b"\xff", *DEEP_AND_LONG):
        with pytest.raises(DamagedTakeError, match="the description of a run cannot be read"):
            take.decode_run(text, "a.mcap")


def test_a_part_that_is_damaged_is_not_merged_and_all_is_kept(tmp_path: Path) -> None:
    path = unclosed_take(tmp_path / "a.mcap", 12)
    data = bytearray(path.read_bytes())
    data[chunks(data)[2] + 400] ^= 1
    path.write_bytes(data)
    writer = TakeWriter.resume_or_create(path, info=info(10**9), reserve_bytes=0)
    record(writer, 0, 16)
    report = writer.close()
    assert not report.clean
    assert "the parts are kept as they are" in report.problem
    assert [part.name for part in report.parts] == ["a.mcap", "a.part2.mcap"]
    assert path.read_bytes() == data
    opened = read_all(path)
    assert not opened.clean
    assert "the take is in 2 parts" in opened.problems[-1]
    assert sorted(keys(opened, "front")) == [("front", 1, s) for s in range(16)]  # the nodes sent the lost ones again
