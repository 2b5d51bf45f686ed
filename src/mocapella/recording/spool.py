"""A node's spool: takes of the frames that no server has stored yet, beside the server's own takes.

Each file is a take of its own, with the identity of the take that lacks its frames: `merge_frames` adds them to it.
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
    """Limits of a spool.

    Attributes:
        reserve_bytes: free disk space that is left.
        most_bytes: largest size of the spool of one node.
    """

    reserve_bytes: int = disk.GIB
    most_bytes: int = 8 * disk.GIB


class DiskSpool:
    """The spool of one node; the folder is made when it is needed.

    Args:
        folder: of the files.
        sensor, node_id: the node.
        limits: of the space.
    """

    def __init__(self, folder: Path, sensor: str, node_id: int, limits: SpoolLimits | None = None) -> None:
        self._folder, self._sensor, self._node_id = folder, sensor, node_id
        self._limits = limits or SpoolLimits()
        self._sizes: dict[int, int] = {}

    def write(self, first: int, frames: Sequence[bytes]) -> None:
        """Store consecutive frames.

        Raises:
            RecordingError: there is no space, or the disk failed; nothing is stored.
        """
        size = sum(map(len, frames))
        if sum(self._sizes.values()) + size > self._limits.most_bytes:
            raise DiskFullError(f"the spool of {self._sensor} has its largest size, {self._limits.most_bytes} bytes")
        row = LedgerRow(self._sensor, self._node_id, first, heard=first + len(frames))
        self._write(self._path(first), "", enumerate(frames, first), row, size)
        self._sizes[first] = size

    def read(self, first: int) -> Sequence[bytes]:
        """Return frames as written.

        Raises:
            RecordingError: they cannot be read.
        """
        try:
            return [stored.raw for stored in read_take(self._path(first)).frames()]
        except InputError as error:
            raise RecordingError(f"spooled frames cannot be read: {error}") from error

    def remove(self, first: int) -> None:
        """Remove frames as written."""
        self._sizes.pop(first, None)
        with suppress(OSError):
            self._path(first).unlink()

    def keep(self, take_id: str, frames: Iterable[tuple[int, bytes]], numbers: range) -> Path:
        """Write frames into a file for the take, and return its path.

        Raises:
            RecordingError: the disk is full or failed.
        """
        path = self._folder / f"{self._sensor}-{self._node_id:016x}-{take_id[:8]}{disk.SUFFIX}"
        row = LedgerRow(self._sensor, self._node_id, numbers.start, numbers.stop, numbers.stop)
        self._write(path, take_id, frames, row, sum(self._sizes.values()))
        return path

    def close(self) -> None:
        """Remove the parts, whose frames are stored or kept."""
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
