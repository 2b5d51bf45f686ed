"""Write an MCAP file by appending, with one chunk of messages and its checksum per flush.

The record layouts are those of the ``mcap`` library, but not its ``Writer``, for three reasons. After a failed write,
it cannot close the file properly; here a flush happens completely or not at all. It keeps objects for every chunk,
which at four flushes a second is megabytes in ten minutes; here the index is kept as encoded bytes. And it declares a
channel in one chunk only; here every chunk declares its channels, so that a damaged chunk affects no other.

Source: the MCAP file format specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from typing import Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from mocapella.recording import disk

MAGIC: Final = b"\x89MCAP0\r\n"
_MESSAGE: Final = struct.Struct("<BQHIQQ")
_INDEX_ENTRY: Final = struct.Struct("<QQ")
_INDEX_HEAD: Final = struct.Struct("<BQHI")
_FOOTER_HEAD: Final = struct.Struct("<BQQQ")
_MAX_UINT32: Final = 0xFFFFFFFF


class McapFile:
    """Writes an MCAP file to an open descriptor. Errors are `OSError`; earlier flushed data stay intact.

    Args:
        fd: descriptor of an empty file, opened for writing; the caller closes it.
        library: name and version of the writing program, for the file's header.
    """

    def __init__(self, fd: int, library: str) -> None:
        self._fd = fd
        self._size = self._crc = 0
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._chunks = self._metadata = 0
        self._first_ns = self._last_ns = 0
        self._chunk_indices, self._metadata_indices = bytearray(), bytearray()
        self._front = bytearray(MAGIC + _bytes(Header("", library)))
        self._new_metadata: list[tuple[int, int, str]] = []
        self._chunk = bytearray()
        self._index: dict[int, bytearray] = {}
        self._chunk_first, self._chunk_last = -1, 0

    @property
    def size(self) -> int:
        """Number of bytes written to the file by completed flushes."""
        return self._size

    @property
    def pending_bytes(self) -> int:
        """Number of bytes that wait for the next flush."""
        return len(self._front) + len(self._chunk)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add the schema of a message type, in MCAP's terms; return its id for `add_channel`."""
        record = _bytes(Schema(len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._schemas.append(record)
        self._front += record
        return len(self._schemas)

    def add_channel(self, topic: str, encoding: str, schema: int) -> int:
        """Add a channel for messages of one topic, encoding and schema id; return its id for `add_message`."""
        record = _bytes(Channel(len(self._channels) + 1, topic, encoding, {}, schema))
        self._channels.append(record)
        self._front += record
        self._counts[len(self._channels)] = 0
        return len(self._channels)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record with values by key; it is written before the messages of the next flush."""
        record = metadata_record(name, values)
        self._new_metadata.append((len(self._front), len(record), name))
        self._front += record

    def add_message(self, channel: int, data: bytes, *, log_ns: int, publish_ns: int, sequence: int) -> None:
        """Add a message to the next flush; after an error, nothing of it is added.

        Args:
            channel: id of the channel.
            data: the encoded message.
            log_ns: time at which it was recorded, on the caller's clock.
            publish_ns: time at which it was published, on the caller's clock.
            sequence: its sequence number; the file keeps the lower 32 bits.
        """
        chunk = self._chunk
        head = _MESSAGE.pack(Opcode.MESSAGE, 22 + len(data), channel, sequence & _MAX_UINT32, log_ns, publish_ns)
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = bytearray()
            chunk += self._channels[channel - 1]
        index += _INDEX_ENTRY.pack(log_ns, len(chunk))
        chunk += head
        chunk += data
        self._chunk_first = log_ns if self._chunk_first < 0 else min(self._chunk_first, log_ns)
        self._chunk_last = max(self._chunk_last, log_ns)

    def flush(self, *, durable: bool = True) -> None:
        """Append all added records to the file; if ``durable``, return only when they are on the disk.

        Raises:
            OSError: the disk failed; the file is unchanged, and the added records are discarded.
        """
        if not self.pending_bytes:
            return
        chunk, index, record = self._finished_chunk()
        block = bytes(self._front) + chunk
        self._append(block, durable=durable)
        for start, length, name in self._new_metadata:
            at = self._size - len(block) + start
            self._metadata_indices += _bytes(MetadataIndex(offset=at, length=length, name=name))
        self._metadata += len(self._new_metadata)
        if record is not None:
            self._count_chunk(index, record)
        self._clear()

    def finish(self) -> None:
        """Flush, then append the index and the end of the file, and return when all is on the disk.

        Raises:
            OSError: the disk failed; the file has all flushed data, but no index.
        """
        self.flush()
        end = _bytes(DataEnd(self._crc))
        summary, offsets = self._summary(self._size + len(end))
        start, offsets_at = self._size + len(end), self._size + len(end) + len(summary)
        crc = zlib.crc32(_FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offsets_at), zlib.crc32(summary + offsets))
        self._append(end + summary + offsets + _bytes(Footer(start, offsets_at, crc)) + MAGIC, durable=True)

    def _append(self, block: bytes, *, durable: bool) -> None:
        try:
            disk.write_all(self._fd, block)
            if durable:
                disk.sync(self._fd)
        except OSError:
            self._clear()
            with contextlib.suppress(OSError):  # the disk is failing; a reader skips the incomplete record
                os.ftruncate(self._fd, self._size)
                os.lseek(self._fd, self._size, os.SEEK_SET)
            raise
        self._size += len(block)
        self._crc = zlib.crc32(block, self._crc)

    def _finished_chunk(self) -> tuple[bytes, dict[int, bytearray], ChunkIndex | None]:
        """Return the chunk and its message index as bytes, and its record for the file's index."""
        if not self._index:
            return b"", {}, None
        data, start = bytes(self._chunk), self._size + len(self._front)
        chunk = _bytes(Chunk("", data, self._chunk_last, self._chunk_first, zlib.crc32(data), len(data)))
        index_bytes, offsets = bytearray(), {}
        for channel, entries in self._index.items():
            offsets[channel] = start + len(chunk) + len(index_bytes)
            index_bytes += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
        record = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=start,
            compression="",
            compressed_size=len(data),
            message_end_time=self._chunk_last,
            message_index_length=len(index_bytes),
            message_index_offsets=offsets,
            message_start_time=self._chunk_first,
            uncompressed_size=len(data),
        )
        return chunk + bytes(index_bytes), self._index, record

    def _count_chunk(self, index: dict[int, bytearray], record: ChunkIndex) -> None:
        self._first_ns = min(self._first_ns, record.message_start_time) if self._chunks else record.message_start_time
        self._last_ns = max(self._last_ns, record.message_end_time)
        self._chunks += 1
        self._chunk_indices += _bytes(record)
        for channel, entries in index.items():
            self._counts[channel] += len(entries) // _INDEX_ENTRY.size

    def _summary(self, start: int) -> tuple[bytes, bytes]:
        """Return the summary section, placed at byte ``start``, and the offsets of its groups."""
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=self._metadata,
            schema_count=len(self._schemas),
        )
        groups = (
            (Opcode.SCHEMA, b"".join(self._schemas)),
            (Opcode.CHANNEL, b"".join(self._channels)),
            (Opcode.STATISTICS, _bytes(statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indices)),
            (Opcode.METADATA_INDEX, bytes(self._metadata_indices)),
        )
        summary, offsets = bytearray(), bytearray()
        for opcode, group in groups:
            if group:
                offsets += _bytes(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        return bytes(summary), bytes(offsets)

    def _clear(self) -> None:
        self._front.clear()
        self._new_metadata.clear()
        self._clear_chunk()

    def _clear_chunk(self) -> None:
        self._chunk = bytearray()
        self._index = {}
        self._chunk_first, self._chunk_last = -1, 0


def metadata_record(name: str, values: dict[str, str]) -> bytes:
    """Return the bytes of a metadata record with values by key."""
    return _bytes(Metadata(name=name, metadata=values))


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap has no annotation here
    return written
