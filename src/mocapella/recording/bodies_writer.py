"""Write tracked bodies frame by frame to a JSON file that can be read at any time.

During a run, the frames are in a *part file* beside the result: ``out.part.json`` for ``out.json``. After every frame,
it is valid JSON that `bodies_file.py` reads, so a killed run leaves its frames. For one body, it has the layout of the
result without the summary; for several, each row has all bodies. At the end of the run, the part file is completed and
renamed to the result, which therefore appears complete or not at all.
"""

from __future__ import annotations

import codecs
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import count, takewhile
from pathlib import Path
from typing import IO, Any, Final, TypeVar

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import DiskFullError, RecordingError
from mocapella.recording import disk
from mocapella.recording.bodies_file import ALONE, PEOPLE_FORMAT, VERSION, FollowedBody, FollowedFrame

PIECE: Final = 1 << 20

_Row = TypeVar("_Row")


class BodiesWriter:
    """Writes the result file of one tracking run. A context manager; left before `finish`, the part file stays.

    Args:
        path: the result file; None writes a temporary file, which is removed at the end.
        bodies: the tracked bodies by name, without frames; a single unnamed one under the key `ALONE`.
        how: further fields of the file that describe the run, such as its settings.

    Attributes:
        path: the result file, or None.
        part: the part file during the run; None after `finish`, or if ``path`` is None.
        bodies: the tracked bodies, as given.
        frames: number of written frames.

    Raises:
        RecordingError: the file cannot be created.
    """

    def __init__(self, path: Path | None, bodies: Mapping[str, FollowedBody], how: Mapping[str, Any]) -> None:
        self.path, self.part, self.frames = path, None, 0  # type: Path | None, Path | None, int
        self.bodies, self._how = dict(bodies), dict(how)
        self._file: IO[bytes]
        if path is None:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        else:
            self.part = next(part for part in _part_names(path) if not os.path.lexists(part))
            self._file = os.fdopen(disk.create_new(self.part), "r+b", buffering=0)
        self._tail = b"\n]}\n"
        self._begin = self._end = 0
        self._put(self._head(), b"")
        self._begin = self._end

    def add(self, rows: Mapping[str, FollowedFrame]) -> None:
        """Append the next frame to the file; ``rows`` has the frame of each body by name.

        Raises:
            DiskFullError, RecordingError: the frame could not be written; earlier frames are kept.
        """
        data = msgspec.json.encode(rows[ALONE] if ALONE in self.bodies else rows)
        self._put(b",\n" if self.frames else b"\n", data)
        self.frames += 1

    def rows(self, of: type[_Row]) -> Iterator[dict[str, _Row]]:
        """Read the written frames back: yield each as values by body's name, decoded as the msgspec type ``of``.

        Write no frame until all are read: reading and writing share the file's position.

        Raises:
            RecordingError: another program has made the file shorter.
            InputError: a frame cannot be decoded as ``of``.
        """
        for line in self._lines():
            if ALONE in self.bodies:
                yield {ALONE: decode_json(line, of)}
            else:
                yield decode_json(line, dict[str, of])  # type: ignore[valid-type]

    def finish(self, summary: Mapping[str, Any], summaries: Mapping[str, Mapping[str, Any]]) -> None:
        """Complete the file and rename it to the result.

        Args:
            summary: JSON fields that describe the result of the run.
            summaries: JSON fields that describe the result for each body, by name.

        Raises:
            DiskFullError, RecordingError: the result could not be written; the part file is kept.
        """
        try:
            if ALONE in self.bodies:
                self._tail = b'\n],\n"summary": ' + msgspec.json.encode({**summaries[ALONE], **summary}) + b"}\n"
                self._put(b"", b"")
            else:
                self._put_together(summary, summaries)
            if self.part is not None and self.path is not None:
                os.fsync(self._file.fileno())
                self.part.replace(self.path)
                self.part = None
        except OSError as error:
            raise self._as_ours(error) from error

    def copy_to(self, out: IO[str]) -> None:
        """Copy the file's content, as written so far, to a text stream; call it before `close`."""
        self._file.seek(0)
        decoder = codecs.getincrementaldecoder("utf-8")()
        while piece := self._file.read(PIECE):
            out.write(decoder.decode(piece))
        out.flush()

    def close(self) -> None:
        """Close the file; remove the part file if it has no frame."""
        self._file.close()
        if self.part is not None and not self.frames:
            self.part.unlink(missing_ok=True)
            self.part = None

    def __enter__(self) -> BodiesWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _head(self) -> bytes:
        """Return the text before the first frame."""
        if ALONE in self.bodies:
            return _opened({**_without_frames(self.bodies[ALONE]), **self._how}) + b',\n"frames": ['
        people = {name: {**_without_frames(body), "frames": []} for name, body in self.bodies.items()}
        whole = {"format": PEOPLE_FORMAT, "version": VERSION, **self._how, "people": people}
        return _opened(whole) + b',\n"rows": ['

    def _put(self, before: bytes, data: bytes) -> None:
        """Append data and the end of the file in one write, so that the file is valid at any time."""
        try:
            self._write(before + data + self._tail)
        except OSError as error:
            with suppress(OSError):  # back to the earlier length
                self._write(self._tail)
                self._file.truncate(self._end + len(self._tail))
            raise self._as_ours(error) from error
        self._end += len(before) + len(data)

    def _write(self, data: bytes) -> None:
        self._file.seek(self._end)
        piece = memoryview(data)
        while piece:
            piece = piece[self._file.write(piece) :]

    def _lines(self) -> Iterator[bytes]:
        self._file.seek(self._begin)
        rest, left = b"", self._end - self._begin
        while left:
            piece = self._file.read(min(PIECE, left))
            if not piece:
                where = "the temporary file" if self.part is None else self.part
                raise RecordingError(f"{where} became shorter while it was written; track the videos again")
            left -= len(piece)
            *lines, rest = (rest + piece).split(b"\n")
            yield from (line.removesuffix(b",") for line in lines if line)
        if rest:
            yield rest

    def _put_together(self, summary: Mapping[str, Any], summaries: Mapping[str, Mapping[str, Any]]) -> None:
        """Turn rows of all bodies into frames of one body after the other."""
        beside = None if self.part is None else self.part.with_suffix(".whole")
        whole = tempfile.TemporaryFile() if beside is None else beside.open("w+b")  # noqa: SIM115
        try:
            self._write_whole(whole, summary, summaries)
            if self.part is not None and beside is not None:
                beside.replace(self.part)
        except BaseException:
            whole.close()
            if beside is not None:
                beside.unlink(missing_ok=True)
            raise
        self._file.close()
        self._file = whole

    def _write_whole(
        self, whole: IO[bytes], summary: Mapping[str, Any], summaries: Mapping[str, Mapping[str, Any]]
    ) -> None:
        whole.write(_opened({"format": PEOPLE_FORMAT, "version": VERSION, **self._how, "summary": summary}))
        whole.write(b',\n"people": {')
        for k, (name, body) in enumerate(self.bodies.items()):
            whole.write((b",\n" if k else b"\n") + msgspec.json.encode(name) + b": ")
            whole.write(_opened({**_without_frames(body), "summary": summaries[name]}) + b', "frames": [')
            for number, rows in enumerate(self.rows(msgspec.Raw)):
                whole.write((b",\n" if number else b"\n") + bytes(rows[name]))
            whole.write(b"\n]}")
        whole.write(b"}}\n")
        whole.flush()

    def _as_ours(self, error: OSError) -> RecordingError:
        kind = DiskFullError if disk.is_full(error) else RecordingError
        where = "" if self.part is None else f"; {self.part} has the {self.frames} frames before it"
        return kind(f"the frames cannot be written: {error.strerror}{where}")


def left_behind(path: Path) -> list[Path]:
    """Return the part files that exist for the result ``path``: of runs that were killed or still go on."""
    return list(takewhile(Path.exists, _part_names(path)))


def _part_names(path: Path) -> Iterator[Path]:
    """Return ``out.part.json``, ``out.part2.json``, …"""
    return (path.with_name(f"{path.stem}.part{k if k > 1 else ''}{path.suffix or '.json'}") for k in count(1))


def _without_frames(body: FollowedBody) -> dict[str, Any]:
    values = msgspec.to_builtins(body)
    assert isinstance(values, dict)
    first = {key: values.pop(key) for key in ("format", "version")}
    del values["frames"]
    return {**first, **values}


def _opened(values: Mapping[str, Any]) -> bytes:
    """Return a JSON object without its closing brace."""
    return msgspec.json.encode(values).removesuffix(b"}")
