"""A node's spool on the disk: files with the frames that no server has stored yet.

Each file is a take of its own. A file that remains at the end has the identity (`take_id`) of the server's take that
lacks its frames; `mocapella.recording.merge.merge_frames` adds them to that take.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from mocapella.errors import DiskFullError, InputError, RecordingError
from mocapella.model.session import Setup
from mocapella.recording import disk, take
from mocapella.recording.ledger import LedgerRow
from mocapella.recording.take import Run, TakeInfo
from mocapella.recording.take_file import TakeFile
from mocapella.recording.take_reader import read_take

SPOOL_FOLDER: Final = Path("spool")


@dataclass(frozen=True)
class SpoolLimits:
    """Limits of a spool's disk space; beyond one of them, `DiskSpool.write` raises `DiskFullError` and stores nothing.

    Attributes:
        reserve_bytes: free disk space to leave [bytes].
        most_bytes: largest size of the spool of one node [bytes].
    """

    reserve_bytes: int = disk.GIB
    most_bytes: int = 8 * disk.GIB


class DiskSpool:
    """The spool of one node: files with its encoded frames that wait on the disk until a server has stored them.

    Args:
        folder: folder of the spool's files; it is made when the first file is.
        sensor, node_id: identity of the node.
        limits: limits of the disk space; None for the defaults.
    """

    def __init__(self, folder: Path, sensor: str, node_id: int, limits: SpoolLimits | None = None) -> None:
        self._folder, self._sensor, self._node_id = folder, sensor, node_id
        self._limits = limits or SpoolLimits()
        self._sizes: dict[int, int] = {}

    def write(self, first: int, frames: Sequence[bytes]) -> None:
        """Store encoded frames with consecutive sequence numbers from ``first`` on in one file.

        Raises:
            DiskFullError: the spool would exceed its largest size, or the disk its reserve; nothing is stored.
            RecordingError: the disk failed; nothing is stored.
        """
        size = sum(map(len, frames))
        if sum(self._sizes.values()) + size > self._limits.most_bytes:
            raise DiskFullError(f"the spool of {self._sensor} has its largest size, {self._limits.most_bytes} bytes")
        row = LedgerRow(self._sensor, self._node_id, first, heard=first + len(frames))
        self._write(self._path(first), "", enumerate(frames, first), row, size)
        self._sizes[first] = size

    def read(self, first: int) -> Sequence[bytes]:
        """Return the encoded frames that `write` stored from sequence number ``first`` on.

        Raises:
            RecordingError: the file cannot be read.
        """
        try:
            return [stored.raw for stored in read_take(self._path(first)).frames()]
        except InputError as error:
            raise RecordingError(f"spooled frames cannot be read: {error}") from error

    def remove(self, first: int) -> None:
        """Delete the file that `write` stored from sequence number ``first`` on."""
        self._sizes.pop(first, None)
        with suppress(OSError):
            self._path(first).unlink()

    def keep(self, take_id: str, frames: Iterable[tuple[int, bytes]], numbers: range) -> Path:
        """Write the frames that a server's take lacks into a file that can be merged into the take; return its path.

        Args:
            take_id: identity of the take.
            frames: sequence number and encoded frame of each available frame.
            numbers: sequence numbers of the frames that the take lacks, available or not.

        Raises:
            RecordingError: the disk is full or failed.
        """
        name = f"{self._sensor}-{self._node_id:016x}-{take_id[:8]}"
        path = self._folder / f"{name}{disk.SUFFIX}"
        if os.path.lexists(path):  # earlier frames of the take
            path = path.with_stem(f"{name}-{numbers.start}")
        row = LedgerRow(self._sensor, self._node_id, numbers.start, numbers.stop, numbers.stop)
        self._write(path, take_id, frames, row, sum(self._sizes.values()))
        return path

    def close(self) -> None:
        """Delete the files that `write` made, and the folder if it is empty then; files of `keep` stay."""
        for first in list(self._sizes):
            self.remove(first)
        with suppress(OSError):  # it is missing, or other files are in it
            self._folder.rmdir()

    def _path(self, first: int) -> Path:
        return self._folder / f"{self._sensor}-{self._node_id:016x}-from-{first}{disk.SUFFIX}"

    def _write(self, path: Path, take_id: str, frames: Iterable[tuple[int, bytes]], row: LedgerRow, size: int) -> None:
        disk.ensure_folder(self._folder)
        disk.check_folder(self._folder, self._limits.reserve_bytes + size)
        fd = disk.create_new(path)
        try:
            file = TakeFile(fd)
            now_ns = time.monotonic_ns()
            info = TakeInfo(Setup(), started_unix_ns=time.time_ns(), started_ns=now_ns, take_id=take_id)
            file.add_run(Run(0, 1, info))
            for number, data in frames:
                file.add(take.FRAMES + self._sensor, data, now_ns, number)
            file.add(take.NODES, msgspec.json.encode(row), now_ns)
            file.finish()
        except OSError as error:
            path.unlink(missing_ok=True)
            raise disk.as_ours(error, f"cannot write {path}") from error
        finally:
            os.close(fd)
