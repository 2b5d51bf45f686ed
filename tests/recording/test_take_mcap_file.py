"""Other MCAP programs read what we write: here the library of the format's authors, every checksum and index."""

import os
import struct
import zlib
from io import BytesIO
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import MessageIndex, SummaryOffset
from mcap.stream_reader import StreamReader
from support.take_making import frame_bytes, info, record, small_take

from mocapella.model.session import Setup
from mocapella.recording.mcap_file import McapFile
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter


def test_the_library_reads_a_take_with_every_checksum(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap", count=10)
    with path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    assert {type(r).__name__ for r in records} >= {"Header", "Metadata", "MessageIndex", "Statistics", "Footer"}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 41  # 20 frames, 20 scenes, 1 run
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count == 4
        for topic in ("/frames/front", "/scenes"):  # through the message index
            times = [message.log_time for _, _, message in reader.iter_messages(topics=[topic])]
            assert times == sorted(times)
            assert len(times) == (10 if topic == "/frames/front" else 20)
        (metadata,) = reader.iter_metadata()
        assert metadata.name == "mocapella.run"


def test_each_message_index_points_at_its_messages(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap")
    with path.open("rb") as file:
        reader = make_reader(file)
        late = [m.log_time for _, _, m in reader.iter_messages(topics=["/scenes"], starting_at=200_000_000)]
        reverse = [m.log_time for _, _, m in reader.iter_messages(topics=["/scenes"], reverse=True)]
    every = [log_ns for log_ns, _ in read_take(path).scenes()]
    assert late == [t for t in every if t >= 200_000_000]
    assert reverse == every[::-1]


def test_every_offset_of_the_index_is_that_of_what_it_names(tmp_path: Path) -> None:
    """Of chunks, the messages in them, their message index, the metadata, and the groups of the summary."""
    path = small_take(tmp_path / "a.mcap", count=10)
    data = path.read_bytes()

    def record_at(at: int, opcode: Opcode) -> tuple[bytes, int]:
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        assert data[at] == opcode
        return data[at + 9 : at + 9 + length], 9 + length

    with path.open("rb") as file:
        records = list(StreamReader(file).records)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 4
    assert summary.metadata_indexes
    for chunk in summary.chunk_indexes:
        body, length = record_at(chunk.chunk_start_offset, Opcode.CHUNK)
        assert length == chunk.chunk_length
        content = body[40:]  # of an uncompressed chunk
        assert len(content) == chunk.compressed_size == chunk.uncompressed_size
        times, at = [], chunk.chunk_start_offset + chunk.chunk_length
        assert chunk.message_index_length == sum(
            record_at(offset, Opcode.MESSAGE_INDEX)[1] for offset in chunk.message_index_offsets.values()
        )
        assert min(chunk.message_index_offsets.values()) == at
        for channel, offset in chunk.message_index_offsets.items():
            body, _ = record_at(offset, Opcode.MESSAGE_INDEX)
            index = MessageIndex.read(ReadDataStream(BytesIO(body)))
            assert index.channel_id == channel
            for log_ns, place in index.records:
                assert content[place] == Opcode.MESSAGE
                assert int.from_bytes(content[place + 9 : place + 11], "little") == channel
                assert int.from_bytes(content[place + 15 : place + 23], "little") == log_ns
                times.append(log_ns)
        assert (min(times), max(times)) == (chunk.message_start_time, chunk.message_end_time)
    for metadata in summary.metadata_indexes:
        body, length = record_at(metadata.offset, Opcode.METADATA)
        assert length == metadata.length
        assert metadata.name.encode() in body
    groups = [record for record in records if isinstance(record, SummaryOffset)]
    assert len(groups) == 5
    for group in groups:
        at = group.group_start
        while at < group.group_start + group.group_length:
            at += record_at(at, Opcode(group.group_opcode))[1]
        assert at == group.group_start + group.group_length


def test_the_footer_points_at_the_summary_and_at_the_offsets_of_its_groups(tmp_path: Path) -> None:
    """Who wants one group reads its offset. The footer's checksum is that of all from the summary to the checksum."""
    data = small_take(tmp_path / "a.mcap", count=10).read_bytes()
    magic = b"\x89MCAP0\r\n"
    places: dict[int, list[int]] = {}
    at = len(magic)
    while at < len(data) - len(magic):
        places.setdefault(data[at], []).append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    assert data[at:] == magic
    ((end,), (footer,), offsets) = (places[code] for code in (Opcode.DATA_END, Opcode.FOOTER, Opcode.SUMMARY_OFFSET))
    start, offsets_at, crc = struct.unpack("<QQI", data[footer + 9 : at])
    assert start == end + 9 + 4
    assert offsets_at == offsets[0]
    assert footer - offsets_at == len(offsets) * (9 + 1 + 8 + 8)
    assert crc == zlib.crc32(data[start : at - 4])
    assert int.from_bytes(data[end + 9 : end + 13], "little") == zlib.crc32(data[:end])


def test_the_schema_in_the_take_is_enough_to_read_a_frame(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap")
    with path.open("rb") as file:
        schema, channel, message = next(make_reader(file).iter_messages(topics=["/frames/side"]))
    assert channel.message_encoding == schema.encoding == "protobuf"
    pool = descriptor_pool.DescriptorPool()
    for proto in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(proto)
    frame = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(message.data)
    assert (frame.sensor, frame.sequence, len(frame.positions_m)) == ("side", 0, 25 * 12)
    assert message.data == frame_bytes("side", 0)


@pytest.mark.parametrize("failing", ["write", "fdatasync"])
def test_a_flush_happens_wholly_or_not_at_all(tmp_path: Path, failing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mcap"
    fd = os.open(path, os.O_RDWR | os.O_CREAT)
    file = McapFile(fd, "test")
    channel = file.add_channel("/scenes", "json", file.add_schema("x", "jsonschema", b"{}"))
    file.add_message(channel, b"{}", log_ns=1, publish_ns=1, sequence=0)
    file.flush()
    good = path.read_bytes()
    real, calls = os.write, []

    def half(fd: int, data: memoryview) -> int:
        calls.append(fd)
        if len(calls) > 1:
            raise OSError(28, "No space left on device")
        return real(fd, data[: len(data) // 2])

    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        if failing == "write":
            patch.setattr(os, "write", half)
        else:
            patch.setattr("mocapella.recording.disk._data_sync", fail)
        file.add_message(channel, b"{}" * 100, log_ns=2, publish_ns=2, sequence=1)
        with pytest.raises(OSError, match=r"No space|Input/output"):
            file.flush()
    assert path.read_bytes() == good
    file.finish()
    os.close(fd)
    with path.open("rb") as opened:
        assert [m.log_time for _, _, m in make_reader(opened, validate_crcs=True).iter_messages()] == [1]


def test_an_empty_take_is_a_whole_mcap_file(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    report = writer.close()
    assert report.clean
    assert (report.frames, report.scenes) == ({}, 0)
    take = read_take(report.path)
    assert take.clean
    assert isinstance(take.info.setup, Setup)
    with report.path.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 1


def test_what_is_flushed_is_in_the_file_before_it_is_closed(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 4, per_flush=4)
    assert (writer.accounts.stored, writer.accounts.pending) == (8, 0)
    record(writer, 4, 3, step=8, per_flush=99)
    assert (writer.accounts.stored, writer.accounts.pending) == (8, 6)
    assert read_take(writer.path).frame_count == 8
    writer.flush()
    assert (writer.accounts.stored, writer.accounts.pending) == (14, 0)
    assert read_take(writer.path).frame_count == 14
    writer.close()
