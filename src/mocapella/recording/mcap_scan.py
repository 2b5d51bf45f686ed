"""Read an MCAP file from start to end, also a damaged or unfinished one, and report its faults.

The ``mcap`` library's readers stop at the first fault, and refuse a file that was not closed. Here a damaged part is
reported and skipped, and reading continues at the next detectable chunk. Checksums cover every byte of a closed file,
and every chunk of an unclosed one.

Source: the MCAP file format specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from typing import Any, BinaryIO, Final, TypeVar

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata

from mocapella.errors import InputError
from mocapella.recording.checksums import joined_crc
from mocapella.recording.mcap_file import MAGIC

_HEAD: Final = struct.Struct("<BQ")
_CHUNK: Final = struct.Struct("<QQQII")
_MESSAGE: Final = struct.Struct("<HIQQ")
_INDEX: Final = struct.Struct("<HI")
_FOOTER: Final = struct.Struct("<BQQQI")
_DATA_END: Final = struct.Struct("<BQI")
_PLAIN_CHUNK: Final = re.compile(rb"(?s)(?=\x06.{4}\0{4}.{28}\0{4}.{4}\0{4})")
"""Pattern of the start of an uncompressed chunk below 4 GiB."""
_WINDOW: Final = 1 << 20
_FIRST_WINDOW: Final = 1 << 12
_OVERLAP: Final = 64
_SKIPPED: Final = (Opcode.HEADER, Opcode.SCHEMA, Opcode.ATTACHMENT)
_KNOWN: Final = (*_SKIPPED, Opcode.METADATA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX)
M = TypeVar("M")
_Record = TypeVar("_Record", Channel, Metadata)


class MessageRead(msgspec.Struct, frozen=True, gc=False):
    """A message of the file.

    Attributes:
        topic: topic of its channel.
        sequence: its sequence number, modulo 2^32.
        log_ns, publish_ns: times of recording and of publication, on the recording process's clock.
        offset: byte offset of ``data`` in the file.
        data: the encoded message.
    """

    topic: str
    sequence: int
    log_ns: int
    publish_ns: int
    offset: int
    data: bytes


class MetadataRead(msgspec.Struct, frozen=True):
    """A metadata record of the file: its name, and its values by key."""

    name: str
    values: dict[str, str]


class Damage(msgspec.Struct, frozen=True):
    """A damaged section of the file: byte ``start`` to before ``end``; ``problem`` describes the fault."""

    start: int
    end: int
    problem: str


class End(msgspec.Struct, frozen=True):
    """Last event of a scan.

    Attributes:
        closed: whether the file was closed properly.
        torn_bytes: size of an incomplete record at the file's end; 0 without one.
    """

    closed: bool
    torn_bytes: int


Event = MessageRead | MetadataRead | Damage | End
ReadChunk = Callable[[memoryview, int, dict[int, str]], Iterable[M]]
"""A function of a chunk's records, their byte offset in the file, and the topic of each channel."""


class MalformedError(Exception):
    """A record's content does not fit its length, or a message's channel is unknown."""


class _Tail(msgspec.Struct, frozen=True):
    """End of a closed file: end of its data, their checksum, and whether the summary's checksum is correct."""

    data_end: int
    data_crc: int
    summary_good: bool


def is_closed(file: BinaryIO, size: int) -> bool:
    """Whether an MCAP file of ``size`` bytes has a complete end, which means that its writer has closed it."""
    return data_end(file, size) is not None


def data_end(file: BinaryIO, size: int) -> int | None:
    """Return where the data of an MCAP file of ``size`` bytes end [byte]; None if the file was not closed."""
    tail = _read_tail(file, size)
    return None if tail is None else tail.data_end


def scan(file: BinaryIO, size: int, name: str, read_chunk: ReadChunk[M] | None = None) -> Iterator[Event | M]:
    """Read an MCAP file from start to end: yield its messages, metadata and damaged sections in order, then an `End`.

    Args:
        file: the open file.
        size: number of bytes to read.
        name: the file's name, for errors.
        read_chunk: yields something else for a chunk than its messages.

    Raises:
        InputError: a chunk is compressed, unlike Mocapella's.
        OSError: the file cannot be read.
    """
    tail = _read_tail(file, size)
    end = size if tail is None else tail.data_end
    file.seek(0)
    head = file.read(len(MAGIC))
    if len(head) < len(MAGIC) and MAGIC.startswith(head):
        yield End(False, len(head))
        return
    at, crc, whole = len(MAGIC), zlib.crc32(head), True
    if head != MAGIC:
        whole = False
        yield Damage(0, min(size, len(MAGIC)), "the first bytes are not those of an MCAP file")
    topics: dict[int, str] = {}
    read: ReadChunk[Any] = read_chunk or read_messages
    torn = 0
    while at < end:
        record = _record_at(file, at, end)
        try:
            events = None if record is None else list(_events(memoryview(record), at, topics, name, read))
        except MalformedError:
            events = None
        if record is None or events is None:
            found = _next_chunk(file, at + 1, end)
            whole = False
            if tail is None and found is None:
                torn = end - at
            else:
                yield Damage(at, found or end, "no record can be read there")
            at = found or end
            continue
        whole = whole and not any(isinstance(event, Damage) for event in events)
        yield from events
        if whole and tail is not None:
            crc = _crc_after(crc, record)
        at += len(record)
    if tail is None:
        yield End(False, torn)
        return
    if whole and tail.data_crc not in (0, crc):
        yield Damage(0, end, "the checksum over all data is wrong, though every chunk's is right")
    if not tail.summary_good:
        yield Damage(end, size, "the checksum of the index is wrong; the data are not touched by that")
    yield End(True, 0)


def _crc_after(crc: int, record: bytes) -> int:
    """Return a checksum continued by a record; an undamaged chunk has the checksum of its content."""
    if record[0] != Opcode.CHUNK:
        return zlib.crc32(record, crc)
    _, _, _, own, name_length = _CHUNK.unpack_from(record, _HEAD.size)
    start = _HEAD.size + _CHUNK.size + name_length + 8
    if own == 0:  # its writer computed none
        return zlib.crc32(record, crc)
    return joined_crc(zlib.crc32(record[:start], crc), own, len(record) - start)


def _read_tail(file: BinaryIO, size: int) -> _Tail | None:
    length = _FOOTER.size + len(MAGIC)
    if size < length + _DATA_END.size + len(MAGIC):
        return None
    file.seek(size - length)
    footer = file.read(length)
    opcode, body, summary_start, offsets_start, summary_crc = _FOOTER.unpack_from(footer)
    if (opcode, body) != (Opcode.FOOTER, 20) or not footer.endswith(MAGIC):
        return None
    summary_end = size - length
    data_end = (summary_start or summary_end) - _DATA_END.size
    if not len(MAGIC) <= data_end <= summary_end or offsets_start > summary_end:
        return None
    file.seek(data_end)
    opcode, body, data_crc = _DATA_END.unpack(file.read(_DATA_END.size))
    if (opcode, body) != (Opcode.DATA_END, 4):
        return None
    crc = zlib.crc32(footer[: _FOOTER.size - 4], zlib.crc32(file.read(summary_end - data_end - _DATA_END.size)))
    return _Tail(data_end, data_crc, summary_crc in (0, crc))


def _record_at(file: BinaryIO, at: int, end: int) -> bytes | None:
    """Return the complete record, or None if there is none before the end, or its length is implausible.

    It is read only if the length is plausible: a scan thus reads every byte a few times at most, also if each of many
    records claims the rest of the file.
    """
    file.seek(at)
    head = file.read(_HEAD.size + _CHUNK.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack_from(head)
    if length > end - at - _HEAD.size:
        return None
    if opcode == Opcode.CHUNK:
        plausible = _chunk_fits(file, at + _HEAD.size, head[_HEAD.size :], length)
    else:
        plausible = opcode in _KNOWN and _next_chunk(file, at + 1, at + _HEAD.size + length) is None
    if not plausible:
        return None
    file.seek(at)
    record = file.read(_HEAD.size + length)
    return record if len(record) == _HEAD.size + length else None


def _chunk_fits(file: BinaryIO, at: int, head: bytes, length: int) -> bool:
    """Whether the lengths within a chunk agree with the chunk's."""
    if length < _CHUNK.size + 8:
        return False
    _, _, size, _, name_length = _CHUNK.unpack(head)
    start = _CHUNK.size + name_length + 8
    file.seek(at + start - 8)
    stored = int.from_bytes(file.read(8), "little")
    return bool(start <= length and stored == length - start and (name_length > 0 or size == stored))


def _next_chunk(file: BinaryIO, start: int, end: int) -> int | None:
    """Return the offset of the first consistent chunk head from ``start`` on; read less if it is near."""
    window_start, length = start, _FIRST_WINDOW
    while window_start < end:
        file.seek(window_start)
        window = file.read(min(length + _OVERLAP, end - window_start))
        for match in _PLAIN_CHUNK.finditer(window):
            i = match.start()
            claimed = _HEAD.unpack_from(window, i)[1]
            size = _CHUNK.unpack_from(window, i + _HEAD.size)[2]
            stored = int.from_bytes(window[i + 41 : i + 49], "little")
            if size == stored == claimed - 40 and window_start + i + _HEAD.size + claimed <= end:
                return window_start + i
        window_start += length
        length = min(2 * length, _WINDOW)
    return None


def _events(
    record: memoryview, at: int, topics: dict[int, str], name: str, read_chunk: ReadChunk[Any]
) -> Iterator[Any]:
    """Yield the contents of a record; raise `MalformedError` if it is inconsistent."""
    opcode, body = record[0], record[_HEAD.size :]
    if opcode == Opcode.CHUNK:
        yield from _chunk(body, at, topics, name, read_chunk)
    elif opcode == Opcode.METADATA:
        found = _parse(Metadata, body)
        yield MetadataRead(found.name, found.metadata)
    elif opcode == Opcode.CHANNEL:
        channel = _parse(Channel, body)
        topics[channel.id] = channel.topic
    elif opcode == Opcode.MESSAGE_INDEX and (
        len(body) < _INDEX.size or _INDEX.unpack_from(body)[1] != len(body) - _INDEX.size
    ):
        raise MalformedError


def _chunk(body: memoryview, at: int, topics: dict[int, str], name: str, read_chunk: ReadChunk[Any]) -> Iterator[Any]:
    """Yield the messages of a chunk whose lengths agree (`_chunk_fits`)."""
    _, _, _, crc, name_length = _CHUNK.unpack_from(body)
    start = _CHUNK.size + name_length + 8
    if name_length:
        compression = bytes(body[_CHUNK.size : start - 8]).decode("ascii", "replace")
        raise InputError(
            f"the chunk at byte {at} is compressed ({compression}), as Mocapella's are not",
            file=name,
            fix="undo it with mcap decompress",
        )
    data = body[start:]
    end = at + _HEAD.size + len(body)
    if crc not in (0, zlib.crc32(data)):
        yield Damage(at, end, "a chunk does not have the checksum that it was written with")
        return
    try:
        yield from list(read_chunk(data, at + _HEAD.size + start, topics))
    except (MalformedError, struct.error):
        yield Damage(at, end, "a chunk has a correct checksum and unknown content")


def read_messages(data: memoryview, base: int, topics: dict[int, str]) -> Iterator[MessageRead]:
    """Yield the messages of a chunk, and add its channels to ``topics``.

    Args:
        data: the chunk's records.
        base: byte offset of ``data`` in the file.
        topics: topic of each channel.

    Raises:
        MalformedError, struct.error: a record does not fit, or a message's channel is unknown.
    """
    at, length = 0, len(data)
    while at < length:
        opcode, size = _HEAD.unpack_from(data, at)
        body = at + _HEAD.size
        if opcode == Opcode.CHANNEL:
            found, at = read_channel(data, at)
            topics[found.id] = found.topic
            continue
        at = body + size
        if at > length:
            raise MalformedError
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, body)
            if channel not in topics or size < _MESSAGE.size:
                raise MalformedError
            start = body + _MESSAGE.size
            yield MessageRead(topics[channel], sequence, log_ns, publish_ns, base + start, bytes(data[start:at]))


def read_channel(data: memoryview, at: int) -> tuple[Channel, int]:
    """Return the channel that is described at a place, and the place after it.

    Raises:
        MalformedError, struct.error: the record does not fit.
    """
    _, size = _HEAD.unpack_from(data, at)
    body = at + _HEAD.size
    if size > len(data) - body:
        raise MalformedError
    return _parse(Channel, data[body : body + size]), body + size


def _parse(kind: type[_Record], body: memoryview) -> _Record:
    try:
        record = kind.read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise MalformedError from error
    assert isinstance(record, kind)  # mcap does not annotate what `read` returns
    return record
