"""Merge the parts of an interrupted take, or add frames from other files to a take: copy, compare, then replace.

A recording whose server was killed continues in ``NAME.part2.mcap``, and so on. The parts are copied to
``NAME.merging.mcap``; after a check that it holds everything, it replaces ``NAME.mcap`` in one step, and the other
parts are removed. A kill at any point leaves either all parts, or the complete take.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Final

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import DamagedTakeError, DiskFullError, InputError, RecordingError
from mocapella.recording import disk, take
from mocapella.recording.found_frames import FoundFrames, found_frames
from mocapella.recording.mcap_file import metadata_record
from mocapella.recording.mcap_scan import Damage, MessageRead, MetadataRead, data_end, is_closed, scan
from mocapella.recording.take_file import TakeFile
from mocapella.recording.take_index import index_take

_FLUSH_BYTES: Final = 1 << 20


class _Entry(msgspec.Struct, frozen=True):
    """Content of a message or metadata record that a copy must have, at any position in the file."""

    topic: str
    data: bytes
    log_ns: int = 0
    publish_ns: int = 0
    sequence: int = 0
    values: dict[str, str] | None = None


_MARK: Final = _Entry(take.INTERRUPTED_METADATA, b"", values={})


def merge_parts(path: Path | str, *, reserve_bytes: int = disk.GIB) -> None:
    """Merge the parts of an interrupted take into one file, properly closed; a take that was closed stays unchanged.

    A take that ends with `INTERRUPTED_METADATA` keeps this mark at its end, so that its recording can go on.

    Args:
        path: the take, ``NAME.mcap``.
        reserve_bytes: free disk space to leave beside the copy.

    Raises:
        InputError: the take does not exist.
        RecordingError: the take is being recorded, or the copy differs from the parts.
        DiskFullError: there is no space for the copy.
        DamagedTakeError: a part is damaged; all parts are kept.
    """
    path = Path(path)
    with _locked(path):
        if not closed(path):
            merge_locked(path, reserve_bytes)
        remove_leftovers(path)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    try:
        fd = os.open(path, os.O_RDWR)
    except OSError as error:
        raise InputError(f"cannot be opened ({error.strerror})", file=path, fix="name a take that is there") from error
    try:
        if not disk.lock(fd):
            raise RecordingError(f"{path} is being recorded; stop the recording first")
        yield
    finally:
        os.close(fd)


def merge_frames(path: Path | str, others: Sequence[Path], *, reserve_bytes: int = disk.GIB) -> dict[str, int]:
    """Add the frames that a take lacks from other files, such as nodes' spools; return their number by sensor.

    Only frames that belong to the take are added. The parts of an interrupted take are merged, too; a mark at the end
    stays there, as with `merge_parts`.

    Args:
        path: the take, ``NAME.mcap``.
        others: files with frames, which are takes themselves; they stay unchanged.
        reserve_bytes: free disk space to leave beside the copy.

    Raises:
        InputError: the take or a file cannot be read.
        RecordingError: the take is being recorded, or the copy differs from the parts.
        DiskFullError: there is no space for the copy.
        DamagedTakeError: the take is damaged; everything is kept. Of a damaged other file, readable frames are added.
        SchemaVersionError: the take or a file was made with another message schema.
    """
    path = Path(path)
    merge_parts(path, reserve_bytes=reserve_bytes)
    found = found_frames(index_take([path]), [(other, index_take([other])) for other in others])
    if found.frames or found.rows:
        with _locked(path):
            merge_locked(path, reserve_bytes, found)
    return dict(found.counts)


def merge_locked(path: Path, reserve_bytes: int, found: FoundFrames | None = None) -> None:
    """Merge a take's parts and further frames into one file that replaces the take; the caller holds the take's lock.

    Args:
        path: the take, ``NAME.mcap``.
        reserve_bytes: free disk space to leave beside the copy.
        found: frames of other files to add; None for none.

    Raises:
        DiskFullError: there is no space for the copy.
        RecordingError: the copy differs from the parts.
        DamagedTakeError: a part is damaged. In each case all parts are kept.
    """
    scratch = disk.merging_path(path)
    added = [] if found is None else found.sources
    try:
        parts = (path,) if closed(path) else disk.parts_of(path)  # beside a closed take, no file is a part of it
        needed = sum(part.stat().st_size for part in (*parts, *added)) + reserve_bytes
        free = disk.free_bytes(path.parent)
        if free < needed:
            raise DiskFullError(f"cannot put the parts of {path} together: {disk.too_little(free, needed)}")
        scratch.unlink(missing_ok=True)  # what a kill during an earlier merging left
        fd = disk.create_new(scratch)
        try:
            _copy(parts, fd, found)
        finally:
            os.close(fd)
        _compare(parts, scratch, found)
        scratch.replace(path)
        disk.sync_folder(path.parent)
    except OSError as error:
        scratch.unlink(missing_ok=True)
        kind = DiskFullError if disk.is_full(error) else RecordingError
        raise kind(f"cannot put the parts of {path} together: {error.strerror}; they are kept") from error
    except (RecordingError, InputError):
        scratch.unlink(missing_ok=True)
        raise
    remove_leftovers(path)


def remove_leftovers(path: Path) -> None:
    """Delete the part files that were merged into a closed take, according to its metadata.

    Raises:
        OSError: the take cannot be read, or a part cannot be deleted.
        InputError: the metadata are invalid.
    """
    beside = {part.name: part for part in disk.parts_of(path)[1:]}
    if not beside or not closed(path):
        return
    merged = [entry for entry in _metadata(path) if entry.name == take.MERGED_METADATA]
    names = decode_json(merged[-1].values.get("parts", ""), list[str], file=path) if merged else []
    for name in names:
        if name in beside:
            beside[name].unlink()
    disk.sync_folder(path.parent)


def closed(path: Path) -> bool:
    """Whether the MCAP file was closed properly, so that it has an end and an index."""
    with path.open("rb") as file:
        return is_closed(file, path.stat().st_size)


def reopen(path: Path) -> bool:
    """Remove the end of a closed take marked with `INTERRUPTED_METADATA`; return False if it has no such mark.

    Part files that were merged into the take are deleted before, because they would be parts of it again. A kill at any
    point leaves an interrupted take. The caller holds the take's lock.

    Raises:
        DiskFullError, RecordingError: the disk failed.
    """
    mark = metadata_record(take.INTERRUPTED_METADATA, {})
    try:
        remove_leftovers(path)
        with path.open("r+b") as file:
            end = data_end(file, path.stat().st_size) or 0
            file.seek(max(0, end - len(mark)))
            if file.read(len(mark)) != mark:
                return False
            file.truncate(end)
            disk.sync(file.fileno())
    except OSError as error:
        raise disk.as_ours(error, f"cannot go on recording to {path}") from error
    return True


def _metadata(path: Path) -> Iterator[MetadataRead]:
    with path.open("rb") as file:
        yield from (e for e in scan(file, path.stat().st_size, str(path)) if isinstance(e, MetadataRead))


def _copy(parts: Sequence[Path], fd: int, found: FoundFrames | None) -> None:
    file = TakeFile(fd)
    names = msgspec.json.encode([part.name for part in parts]).decode()
    file.add_metadata(take.MERGED_METADATA, {"parts": names})  # at the beginning: a mark at the end must be the last
    for entry in _wanted(parts, found):
        if entry.values is not None:
            file.flush(durable=False)  # a run's record stands between the messages before it and after it
            file.add_metadata(entry.topic, entry.values)
            continue
        file.add(entry.topic, entry.data, entry.log_ns, entry.sequence, entry.publish_ns)
        if file.pending_bytes > _FLUSH_BYTES:
            file.flush(durable=False)
    file.finish()


def _compare(parts: Sequence[Path], copy: Path, found: FoundFrames | None) -> None:
    for wanted, copied in zip_longest(_wanted(parts, found), _entries([copy])):
        if wanted != copied:
            what = wanted or copied
            raise RecordingError(f"{copy} is not equal to the parts it was made of, at {what.topic}; they are kept")
    if not closed(copy):
        raise RecordingError(f"{copy} has no end; the parts it was made of are kept")


def _wanted(parts: Sequence[Path], found: FoundFrames | None) -> Iterator[_Entry]:
    """Yield the entries of a merged take: first of the parts, then the found frames and their ledgers.

    The mark of `reopen` for opening the take again stays the last entry.
    """
    marked = False
    for entry in _entries(parts):
        if marked:
            yield _MARK
        marked = entry == _MARK
        if not marked:
            yield entry
    if found is not None:
        at_ns = found.log_ns
        for topic, data, sequence in found.read():
            yield _Entry(topic, data, at_ns, at_ns, sequence % 2**32)  # MCAP keeps the lower 32 bits
        for row in found.rows:
            yield _Entry(take.NODES, msgspec.json.encode(row), at_ns, at_ns)
    if marked:
        yield _MARK


def _entries(parts: Sequence[Path]) -> Iterator[_Entry]:
    for part in parts:
        with part.open("rb") as file:
            for event in scan(file, part.stat().st_size, str(part)):
                if isinstance(event, Damage):
                    raise DamagedTakeError(
                        f"bytes {event.start} to {event.end}: {event.problem}",
                        file=part,
                        fix="the parts are kept as they are, and are read as one take",
                    )
                if isinstance(event, MessageRead) and event.topic != take.EARLIER:
                    yield _Entry(event.topic, event.data, event.log_ns, event.publish_ns, event.sequence)
                elif isinstance(event, MetadataRead) and event.name != take.MERGED_METADATA:
                    yield _Entry(event.name, b"", values=event.values)
