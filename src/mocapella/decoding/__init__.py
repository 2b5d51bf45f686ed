"""Decode files and messages from outside within limits; every fault is an `InputError` of one line.

No other package calls the decoders of the libraries (`tests/test_decoding_rule.py`): they raise errors of many types,
and take as much memory, stack or time as their input asks for. `hdf5` and `parquet` read formats that need optional
libraries. Images are decoded in `mocapella.sensing.images`.
docs/decisions/0024-files-are-doors.md says why.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import tomllib
import zlib
from collections.abc import Iterator
from importlib.resources import files
from itertools import chain
from pathlib import Path
from types import UnionType
from typing import Any, BinaryIO, Final, TypeVar, overload
from xml.etree.ElementTree import Element, ParseError, fromstring

import msgspec

from mocapella.errors import InputError, MocapellaError

T = TypeVar("T")

MOST_BYTES: Final = 16 << 20
"""Default limit of `read_whole` on the size of a file [bytes]."""
MOST_TABLE_BYTES: Final = 256 << 20
MOST_TOML_BYTES: Final = 1 << 20
DEEPEST: Final = 64
"""Largest number of levels of nested lists and tables in JSON and TOML."""
MOST_LINE: Final = 1 << 20
"""Longest line of a table [characters]."""
MOST_COLUMNS: Final = 10_000
FREE_UNPACKED: Final = 32 << 20
"""Unpacked size up to which a compressed file may have any compression ratio [bytes]."""
MOST_RATIO: Final = 20
"""Largest ratio of unpacked to packed size beyond `FREE_UNPACKED`; tables of measured numbers have 3 to 10."""
FAULTS: Final = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RecursionError)
"""Exceptions that decoding libraries raise for unusable content."""

_PIECE: Final = 1 << 20
_ZSTD: Final = b"\x28\xb5\x2f\xfd"
_ZSTD_PIECE: Final = 1 << 10
"""Packed bytes that are unpacked at once; they have at most about 250 blocks of 128 KiB."""
_ESCAPED: Final = re.compile(rb"(?s)\\.")
_STRING: Final = re.compile(rb'"[^"]*"?')
_ROUND: Final = bytes.maketrans(b"{}", b"[]")
_NO_MARKS: Final = bytes(set(range(256)) - set(b'[]{}"'))
_DOTTED: Final = re.compile(r"[^,=\[\]{}\n]+")
_NOT_64_BITS: Final = "has a whole number of more than 64 bits"


def read_whole(path: Path | str, *, fix: str, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the contents of a file; stop reading as soon as it has more than ``most_bytes``.

    Args:
        path: the file, or a device or pipe.
        fix: advice that errors name.
        most_bytes: largest size [bytes].

    Raises:
        InputError: the file does not exist, cannot be read, or is larger.
    """
    try:
        with Path(path).open("rb") as file:
            return b"".join(_pieces(file, path, fix, most_bytes))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, fix=fix) from error
    except ValueError as error:  # a NUL in the name
        raise InputError(f"cannot be read: {error}", file=path, fix=fix) from None


def _pieces(file: BinaryIO, path: Path | str, fix: str, most_bytes: int) -> Iterator[bytes]:
    """Yield a file's contents; the size of a device is not known before it is read."""
    size = 0
    while piece := file.read(_PIECE):
        size += len(piece)
        if size > most_bytes:
            raise InputError(f"has more than {most_bytes >> 20} MiB", file=path, fix=fix)
        yield piece


def decode_text(data: bytes | str, *, file: object = None, fix: str | None = None) -> str:
    """Decode UTF-8 text and drop a byte order mark; a ``str`` is returned unchanged.

    Args:
        data: the text.
        file, fix: the file and the advice that errors name; None to leave them out.

    Raises:
        InputError: it is not UTF-8.
    """
    if isinstance(data, str):
        return data
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is no text in UTF-8 (byte {error.start})", file=file, fix=fix) from None


@overload
def decode_json(data: bytes | str, *, what: str = ..., file: object = ..., fix: str | None = ...) -> Any: ...
@overload
def decode_json(
    data: bytes | str, kind: type[T], *, what: str = ..., file: object = ..., fix: str | None = ...
) -> T: ...
@overload
def decode_json(
    data: bytes | str, kind: UnionType, *, what: str = ..., file: object = ..., fix: str | None = ...
) -> Any: ...
def decode_json(
    data: bytes | str, kind: Any = Any, *, what: str = "JSON", file: object = None, fix: str | None = None
) -> Any:
    """Return the value of a JSON text.

    Args:
        data: the text.
        kind: type of the result, such as a `msgspec.Struct`; by default plain dictionaries, lists, texts and numbers.
        what: noun for the text in errors, such as ``sensor layout``.
        file, fix: the file and the advice that errors name; None to leave them out.

    Raises:
        InputError: the text is not JSON, is of another type (names the field), is nested deeper than `DEEPEST` levels,
            or has an integer of more than 64 bits.
    """
    try:
        _check_nesting(data.encode() if isinstance(data, str) else data)
        value = msgspec.json.decode(data, type=kind)
        _check_integers(value)
    except (*FAULTS, MocapellaError) as error:
        raise InputError(f"is no {what}: {error}", file=file, fix=fix) from None
    return value


def _check_nesting(data: bytes) -> None:
    if data.count(b"[") + data.count(b"{") <= DEEPEST:
        return
    marks = _ESCAPED.sub(b"", data) if b"\\" in data else data
    marks = _STRING.sub(b"", marks.translate(_ROUND, _NO_MARKS))
    for _ in range(DEEPEST):
        if not marks:
            return
        marks = marks.replace(b"[]", b"")
    if marks:
        raise ValueError(f"it is nested deeper than {DEEPEST} levels, or its brackets do not match")


def _check_integers(value: Any) -> None:
    try:
        msgspec.msgpack.encode(value)  # refuses larger ones
    except OverflowError:
        raise ValueError(f"it {_NOT_64_BITS}") from None


def decode_msgpack(data: bytes) -> Any:
    """Return the value of MessagePack bytes: plain dictionaries, lists, texts, bytes and numbers.

    Raises:
        InputError: the bytes are not MessagePack, or nested too deeply.
    """
    try:
        return msgspec.msgpack.decode(data)
    except FAULTS as error:
        raise InputError(f"{len(data)} bytes are no MessagePack: {error}") from None


@overload
def convert(value: Any, kind: type[T], *, what: str, file: object = ..., fix: str | None = ...) -> T: ...
@overload
def convert(value: Any, kind: UnionType, *, what: str, file: object = ..., fix: str | None = ...) -> Any: ...
def convert(value: Any, kind: Any, *, what: str, file: object = None, fix: str | None = None) -> Any:
    """Convert decoded JSON or TOML to a value of type ``kind``, strictly: a text does not become a number.

    Args:
        value: the decoded value.
        kind: type of the result, such as a `msgspec.Struct`.
        what: noun for the value in errors, such as ``sensor layout``.
        file, fix: the file and the advice that errors name; None to leave them out.

    Raises:
        InputError: the value does not have that type; names the field.
    """
    try:
        return msgspec.convert(value, kind)
    except (*FAULTS, MocapellaError) as error:
        raise InputError(f"is no {what}: {error}", file=file, fix=fix) from None


def decode_toml(data: bytes | str, *, file: object = None, fix: str | None = None) -> dict[str, Any]:
    """Decode a TOML text into its tables.

    Args:
        data: the text.
        file, fix: the file and the advice that errors name; None to leave them out.

    Raises:
        InputError: it is not TOML in UTF-8, too long, nested too deeply, or has an integer of more than 64 bits.
    """
    if len(data) > MOST_TOML_BYTES:
        raise InputError(f"is no TOML: it has more than {MOST_TOML_BYTES >> 10} KiB", file=file, fix=fix)
    text = decode_text(data, file=file, fix=fix)
    try:
        # The time that tomllib takes for a dotted key grows with the square of its parts.
        if any(part[0].count(".") > DEEPEST for part in _DOTTED.finditer(text)):
            raise ValueError(f"a key has more than {DEEPEST} parts")
        found = tomllib.loads(text)
        _check_depth(found)
        _check_integers(found)
    except FAULTS as error:
        raise InputError(f"is no TOML: {error}", file=file, fix=fix) from None
    return found


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(DEEPEST):
        inner = (item for one in level for item in (one.values() if isinstance(one, dict) else one))
        level = [item for item in inner if isinstance(item, dict | list)]
        if not level:
            return
    raise ValueError(f"it is nested deeper than {DEEPEST} levels")


def own_toml(package: str, *names: str) -> dict[str, Any]:
    """Return the tables of a TOML file that ships with this program.

    Args:
        package: the package that has the file, such as ``mocapella.model``.
        names: path of the file in the package: its folders, if any, then its name.
    """
    return decode_toml(files(package).joinpath(*names).read_bytes(), file=names[-1])


def decode_csv(
    data: bytes, *, file: object = None, fix: str | None = None
) -> tuple[tuple[str, ...], Iterator[tuple[int, dict[str, str]]]]:
    """Read a comma-separated table with a header row.

    Args:
        data: UTF-8 text.
        file, fix: the file and the advice that errors name; None to leave them out.

    Returns:
        The names of the columns, () for an empty text, and an iterator of (row number, cells by column). The header is
        row 1; empty rows are left out and not counted. A row with fewer cells than the header lacks the last columns;
        surplus cells are dropped.

    Raises:
        InputError: the text is not UTF-8, a line is longer than `MOST_LINE`, there are more than `MOST_COLUMNS`
            columns, or the CSV is malformed. The iterator raises it for the rows; names the row.
    """
    rows = decode_csv_rows(data, file=file, fix=fix)
    columns = tuple(next(rows, (1, []))[1])
    return columns, ((number, dict(zip(columns, cells, strict=False))) for number, cells in rows)


def decode_csv_rows(data: bytes, *, file: object = None, fix: str | None = None) -> Iterator[tuple[int, list[str]]]:
    """Read a comma-separated table whose columns have no unique names, such as one with several header rows.

    Args:
        data: UTF-8 text.
        file, fix: the file and the advice that errors name; None to leave them out.

    Returns:
        An iterator of (row number from 1, cells); empty rows are left out and not counted.

    Raises:
        InputError: as of `decode_csv`.
    """
    text = decode_text(data, file=file, fix=fix)
    if max(map(len, io.StringIO(text)), default=0) > MOST_LINE:
        raise InputError(f"has a line of more than {MOST_LINE} characters", file=file, fix=fix)
    rows = _rows(text, file, fix)
    first = next(rows, None)
    if first is not None and len(first[1]) > MOST_COLUMNS:
        raise InputError(f"has {len(first[1])} columns, more than {MOST_COLUMNS}", file=file, row=1, fix=fix)
    return chain(() if first is None else (first,), rows)


def _rows(text: str, file: object, fix: str | None) -> Iterator[tuple[int, list[str]]]:
    number = 0
    try:
        for cells in csv.reader(io.StringIO(text, newline="")):
            if cells:
                number += 1
                yield number, cells
    except csv.Error as error:
        raise InputError(f"cannot be read: {error}", file=file, row=number + 1, fix=fix) from None


def check_filled(places: int, rows: int, *, file: object) -> None:
    """Check that a table's array is not far larger than the table, before the array is allocated.

    The array has an element for each combination of names, such as of each frame with each point, so a table of a few
    rows can require a huge array.

    Args:
        places: number of elements that the array would have.
        rows: number of rows of the table.
        file: named in errors.

    Raises:
        InputError: the array would have more than 2²² elements, and more than 64 for each row.
    """
    if places > max(1 << 22, 64 * rows):
        raise InputError(
            f"{rows} rows name so many frames and points that {places} places would be needed", file=file,
            fix="name the points alike in all frames",
        )  # fmt: skip


def text_blocks(path: Path, *, fix: str, piece: int = 1 << 20) -> Iterator[str]:
    """Yield an ASCII file in blocks of whole lines of about a piece, for tables too large to read whole.

    A block has ``\\n`` between its lines, whatever the file has, and none at its end. A byte order mark and the file's
    trailing white space are dropped; an empty file yields nothing. A file whose name ends with ``.gz`` is unpacked; the
    whole lines before a damaged place come before its error.

    Args:
        path: the file.
        fix: advice that errors name, except those with more specific advice.
        piece: number of bytes to read at once; less for the first lines alone.

    Raises:
        InputError: the file cannot be read, is damaged, not ASCII, has a line longer than `MOST_LINE`, or unpacks to
            more than `FREE_UNPACKED` and `MOST_RATIO` times its size; names the row of a faulty line.
    """
    rest, row = "", 1
    for data in _unpacked(path, piece):
        try:
            text = rest + data.decode("ascii")
        except UnicodeDecodeError as error:
            at = row + rest.count("\n") + data.count(b"\n", 0, error.start)
            value = data[error.start : error.start + 8]
            raise InputError("is not plain text", file=path, row=at, value=value, fix=fix) from None
        # What may be the file's empty end, or half of a \r\n, waits for the next piece.
        end = len(text.rstrip())
        lines = text[:end]
        if "\r" in lines:
            lines = lines.replace("\r\n", "\n").replace("\r", "\n")
        block, newline, last = lines.rpartition("\n")
        rest = last + text[end:]
        if len(rest) > MOST_LINE:
            long = row + block.count("\n") + len(newline)
            raise InputError(f"has a line of more than {MOST_LINE} characters", file=path, row=long, fix=fix)
        if newline:
            row += len(block.split("\n"))  # `count` takes ten times as long
            yield block
    if rest.strip():
        yield rest.rstrip()


class FileBytes:
    """The bytes of an open file, of any size, as far as a search needs them; not mapped to memory.

    A mapped file that another program cuts meanwhile ends the process; here, the bytes are only missing.

    Args:
        file: the file, open for reading.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, io.SEEK_END)

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, place: slice) -> bytes:
        """Return the bytes of a slice without a step.

        Raises:
            OSError: the file cannot be read.
        """
        first, last, _ = place.indices(self._size)
        self._file.seek(first)
        return self._file.read(max(0, last - first))

    def find(self, text: bytes, start: int = 0) -> int:
        """Return the first place of a text from ``start`` on; −1 if there is none.

        Raises:
            OSError: the file cannot be read.
        """
        while start < self._size:
            found = self[start : start + _PIECE + len(text) - 1].find(text)
            if found >= 0:
                return start + found
            start += _PIECE
        return -1


def unpacked_streams(data: bytes | FileBytes, most_bytes: int) -> Iterator[tuple[int, bytes | None]]:
    """Yield (offset, contents) of each compressed stream in bytes of any format: gzip, zstd, deflated files of a zip.

    So the contents of ``.gz`` and ``.zst`` files, of zips, and of chunks and pages of MCAP and Parquet are found alike.

    Args:
        data: the bytes, or a file of any size.
        most_bytes: largest unpacked size [bytes]; the contents of a larger stream are None. Of a stream that is
            damaged, the readable part is yielded if it is at the beginning of the data, and nothing elsewhere, because
            a stream's first bytes also occur by chance.
    """
    for mark, unpack in ((b"\x1f\x8b\x08", _inflated), (_ZSTD, _unpacked_zstd), (b"PK\x03\x04", _unzipped)):
        at = data.find(mark)
        while at >= 0:
            contents, whole = unpack(data, at, most_bytes + 1)
            if contents and (whole or at == 0):
                yield at, contents if len(contents) <= most_bytes else None
            at = data.find(mark, at + 1)


def _inflated(data: bytes | FileBytes, at: int, most_bytes: int, window: int = 31) -> tuple[bytes, bool]:
    """Return the first ``most_bytes`` of a deflated stream, and whether it goes on to its end or to more than these."""
    reader, found, size = zlib.decompressobj(window), [], 0
    try:
        while not reader.eof and size < most_bytes and at < len(data):
            piece = data[at : at + _PIECE]
            found.append(reader.decompress(piece, most_bytes - size))
            size += len(found[-1])
            at += len(piece) - len(reader.unconsumed_tail)
    except zlib.error:
        return b"".join(found), False
    return b"".join(found), reader.eof or size >= most_bytes


def _unpacked_zstd(data: bytes | FileBytes, at: int, most_bytes: int) -> tuple[bytes, bool]:
    import zstandard

    reader, found, size = zstandard.ZstdDecompressor().decompressobj(), [], 0
    try:
        while not reader.eof and size < most_bytes and at < len(data):
            found.append(reader.decompress(data[at : at + _ZSTD_PIECE]))
            size += len(found[-1])
            at += _ZSTD_PIECE
    except zstandard.ZstdError:
        return b"".join(found), False
    return b"".join(found)[:most_bytes], reader.eof or size >= most_bytes


def _unzipped(data: bytes | FileBytes, at: int, most_bytes: int) -> tuple[bytes, bool]:
    head = data[at : at + 30]
    if len(head) < 30 or head[8] != 8:  # stored files are found in the bytes themselves
        return b"", False
    name, extra = (int.from_bytes(head[place : place + 2], "little") for place in (26, 28))
    return _inflated(data, at + 30 + name + extra, most_bytes, -15)


def _before_damage(source: Any, piece: int) -> Iterator[bytes]:
    """Yield a file's bytes in pieces; those before a damaged place come before its error."""
    parts: list[bytes] = []
    size = 0
    try:
        while part := source.read1(piece):
            parts.append(part)
            size += len(part)
            if size >= piece:
                yield b"".join(parts)
                parts, size = [], 0
    except (EOFError, zlib.error, OSError):
        if parts:
            yield b"".join(parts)
        raise
    if parts:
        yield b"".join(parts)


def _unpacked(path: Path, size_of_piece: int) -> Iterator[bytes]:
    """Yield a file's bytes without a byte order mark."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, io.SEEK_END)
            file.seek(0)
            packed = path.suffix == ".gz" and size > 0
            source: Any = gzip.GzipFile(fileobj=file, mode="rb") if packed else file
            done = 0
            for piece in _before_damage(source, size_of_piece):
                yield piece if done else piece.removeprefix(b"\xef\xbb\xbf")
                done += len(piece)
                if packed and done > max(FREE_UNPACKED, MOST_RATIO * size):
                    raise InputError(
                        f"unpacks to more than {MOST_RATIO} times its size", file=path, fix="give it unpacked"
                    )
    except FileNotFoundError:
        raise InputError("there is no such file", file=path, fix="check the name and the folder") from None
    except IsADirectoryError:
        raise InputError("is a folder", file=path, fix="name one .csv or .csv.gz file in it") from None
    except gzip.BadGzipFile:
        fix = "drop .gz from its name if it is plain text"
        raise InputError("is not gzip-compressed", file=path, fix=fix) from None
    except (EOFError, zlib.error):
        raise InputError("the compressed data end early or are damaged", file=path, fix="copy the file again") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, fix="check its permissions") from error


def decode_xml(data: bytes | str, *, file: object = None, fix: str | None = None) -> Element:
    """Decode an XML text without document type, such as entities need; return its first element.

    Args:
        data: the text.
        file, fix: the file and the advice that errors name; None to leave them out.

    Raises:
        InputError: it is not XML in UTF-8 or ASCII, too long, nested too deeply, or has a document type.
    """
    if len(data) > MOST_TOML_BYTES:
        raise InputError(f"is no XML: it has more than {MOST_TOML_BYTES >> 10} KiB", file=file, fix=fix)
    text = decode_text(data, file=file, fix=fix)
    try:
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise ValueError("it has a document type")
        root = fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
        level = [root]
        for _ in range(DEEPEST):
            level = [one for parent in level for one in parent]
            if not level:
                return root
        raise ValueError(f"it is nested deeper than {DEEPEST} levels")
    except (*FAULTS, ParseError) as error:
        raise InputError(f"is no XML: {error}", file=file, fix=fix) from None
