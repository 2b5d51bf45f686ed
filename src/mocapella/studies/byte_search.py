"""Search all bytes of a folder for a participant's code and for checksums, in compressed content, too."""

from __future__ import annotations

import os
import string
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from mocapella.decoding import FileBytes, unpacked_streams
from mocapella.errors import InputError

MOST_UNPACKED: Final = 1 << 28
"""Largest unpacked size of a compressed stream that is searched [bytes]; larger ones are named."""
DEEPEST: Final = 3
"""How often content that is compressed within compressed content is unpacked."""
_PICTURES: Final = (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"%PDF", b"II*\0", b"MM\0*")
"""First bytes of pictures and documents, whose text is drawn or compressed."""
_HEAD: Final = 1024
"""Number of first bytes that tell a picture."""
_OF_CODES: Final = frozenset((string.ascii_letters + string.digits + "-").encode())
_OF_WORDS: Final = _OF_CODES - {ord("-")}


class Trace(msgspec.Struct, frozen=True):
    """A place where a code or a checksum was found.

    Attributes:
        file: path in the folder.
        place: ``name`` for the path itself, else such as ``byte 40`` or ``byte 0, unpacked byte 7``.
        what: ``code`` or ``checksum``.
    """

    file: str
    place: str
    what: str


class SearchReport(msgspec.Struct, frozen=True):
    """Result of a search.

    Attributes:
        files: number of files that were searched.
        size_bytes: their size.
        traces: the traces found.
        unsearched: files that could not be searched, or not wholly, each with the reason; also pictures and PDF files,
            whose drawn texts no search finds.
    """

    files: int
    size_bytes: int
    traces: tuple[Trace, ...]
    unsearched: tuple[str, ...]


def search(
    folder: Path, code: str, checksums: Sequence[str] = (), *, others: Collection[str] = (), leave_out: str = ""
) -> SearchReport:
    """Search the names and all bytes of a folder's files.

    A code counts where it is a word of its own between characters of a text, also before or after a hyphen; and where
    a byte or four bytes before it give its length, as in protobuf, MCAP and Parquet. Streams of gzip, zstd and zip are
    unpacked.

    Args:
        folder: the folder.
        code: the code.
        checksums: hexadecimal digits.
        others: other codes; ``P07-2`` is no trace of ``P07`` if it is one of them.
        leave_out: path in the folder that is not searched.

    Raises:
        InputError: a file cannot be read.
    """
    traces, unsearched, files, size = [], [], 0, 0
    for path in files_of(folder):
        name = path.relative_to(folder).as_posix()
        if name == leave_out:
            continue
        traces += [Trace(name, "name", what) for _, what in _found(name.encode(), code.encode(), checksums, others)]
        if path.is_symlink() or not path.is_file():
            unsearched.append(f"{name} is a link or no file")
            continue
        files, size = files + 1, size + path.stat().st_size
        for place, what in _in_file(path, code.encode(), checksums, others):
            if what:
                traces.append(Trace(name, place, what))
            else:
                unsearched.append(f"{name}, {place}: unpacks to more than {MOST_UNPACKED >> 20} MiB")
        if _is_picture(path):
            unsearched.append(
                f"{name} is a picture or a PDF file: look at it, and remove it if it shows the participant"
            )
    return SearchReport(files, size, tuple(traces), tuple(unsearched))


def files_of(folder: Path) -> list[Path]:
    """Return all files and links in a folder and its folders, sorted; links are not followed."""
    found = []
    for base, folders, names in os.walk(folder):
        found += [Path(base) / name for name in names]
        found += [Path(base) / name for name in folders if (Path(base) / name).is_symlink()]
    return sorted(found)


def _in_file(path: Path, code: bytes, checksums: Sequence[str], others: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield (place, what) of each trace; an empty ``what`` for content too large to unpack."""
    with _opened(path) as file:
        yield from _in_bytes(FileBytes(file), code, checksums, others)


def _is_picture(path: Path) -> bool:
    with _opened(path) as file:
        head = file.read(_HEAD)
    return head.startswith(_PICTURES) or (head[:4] == b"RIFF" and head[8:12] == b"WEBP") or b"<svg" in head


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading.

    Raises:
        InputError: it cannot be read, also later, while it is open.
    """
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise InputError(f"cannot be searched: {error.strerror}", file=path, fix="check its permissions") from error


def _in_bytes(
    data: bytes | FileBytes, code: bytes, checksums: Sequence[str], others: Collection[str], depth: int = 0
) -> Iterator[tuple[str, str]]:
    byte = "byte" if depth == 0 else "unpacked byte"
    yield from ((f"{byte} {at}", what) for at, what in _found(data, code, checksums, others))
    if depth == DEEPEST:
        return
    for at, contents in unpacked_streams(data, MOST_UNPACKED):
        if contents is None:
            yield f"{byte} {at}", ""
        else:
            for place, what in _in_bytes(contents, code, checksums, others, depth + 1):
                yield f"{byte} {at}, {place}", what


def _found(
    data: bytes | FileBytes, code: bytes, checksums: Sequence[str], others: Collection[str]
) -> Iterator[tuple[int, str]]:
    at = data.find(code)
    while at >= 0:
        if _is_word(data, at, len(code), others):
            yield at, "code"
        at = data.find(code, at + 1)
    for checksum in checksums:
        at = data.find(checksum.encode())
        if at >= 0:
            yield at, "checksum"


def _is_letter(data: bytes) -> bool:
    """Whether bytes are one character of a text in UTF-8, also white space or the NUL that ends a text."""
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return False
    return len(text) == 1 and (text.isprintable() or text in "\0\t\n\r")


def _is_word(data: bytes | FileBytes, at: int, length: int, others: Collection[str]) -> bool:
    """Whether the text of a length at a place stands for itself and is no part of a longer word or of another code."""
    before, after = data[max(0, at - 13) : at], data[at + length : at + length + 13]
    if before[-1:] == bytes([length]) or before[-4:] == length.to_bytes(4, "little"):
        return True
    if (before and before[-1] in _OF_WORDS) or (after and after[0] in _OF_WORDS):
        return False
    ends, begins = (before[-size:] for size in range(1, 5)), (after[:size] for size in range(1, 5))
    if not ((not before or any(map(_is_letter, ends))) and (not after or any(map(_is_letter, begins)))):
        return False  # three letters among numbers or in an image
    first, last = len(before), 0
    while first and before[first - 1] in _OF_CODES:
        first -= 1
    while last < len(after) and after[last] in _OF_CODES:
        last += 1
    return (before[first:] + data[at : at + length] + after[:last]).decode() not in others
