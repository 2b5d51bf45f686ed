"""Write a take so that a kill loses at most the entries since the last flush, and nothing acknowledged.

The writer has no thread and no clock. Its owner calls `TakeWriter.flush` several times a second, on a thread that may
wait for the disk. Each node has a ledger of its frames (`mocapella.recording.ledger`), which is stored when it changes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import DiskFullError, InputError, RecordingError, WireError
from mocapella.model.session import SessionStatus
from mocapella.recording import disk, merge, take
from mocapella.recording.accounts import Accounts
from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.take import Run, TakeInfo, TakeReport
from mocapella.recording.take_file import TakeFile
from mocapella.recording.take_index import TakeIndex, index_take
from mocapella.recording.take_so_far import TakeSoFar, read_so_far

MAX_ENTRY_BYTES: Final = 256 * 1024 * 1024
"""Size of the largest entry that is stored."""


class TakeWriter:
    """Writes a take; made by `create` or `resume_or_create`.

    Entries of the ``write_`` methods are on the disk after the next `flush`. An argument ``log_ns`` is the time of the
    entry on the server's monotonic clock. An entry of more than `MAX_ENTRY_BYTES` raises `WireError`; after any error
    of a ``write_`` method, nothing of the entry is stored, and the take goes on. After an error of `flush` or `close`,
    the take is closed as far as possible, ``report`` describes the stored contents, and further writing raises
    `RecordingError`.

    Attributes:
        path: path of the take.
        take_id: identity of the take, which stays the same when the recording is resumed.
        accounts: ledgers of the nodes' frames.
        scenes: number of stored scenes.
        report: result of the recording; None until the take is closed.
    """

    def __init__(
        self,
        path: Path,
        *,
        info: TakeInfo,
        reserve_bytes: int,
        part: int = 1,
        lock_fd: int | None = None,
        earlier: TakeSoFar | None = None,
    ) -> None:
        self.path = path
        self.report: TakeReport | None = None
        self._part, self._reserve = part, reserve_bytes
        so_far = earlier or TakeSoFar()
        self.take_id = so_far.take_id or info.take_id
        account = None if earlier is None else earlier.encode()  # before the ledgers change
        self.accounts = Accounts(so_far.nodes)
        self.scenes, self._pending_scenes = so_far.scenes, 0
        self._first_ns, self._last_ns = so_far.first_ns, so_far.last_ns
        self._next_run = so_far.next_run
        file = disk.part_path(path, part)
        self._fd = disk.create_new(file)
        self._lock_fd = lock_fd
        if lock_fd is None:
            disk.lock(self._fd)
        self._file = TakeFile(self._fd)
        try:
            self._begin_run(info)
            if account is not None:
                self._file.add(take.EARLIER, account, info.started_ns)
            self._file.flush()
            disk.sync_folder(file.parent)
        except OSError as error:
            os.close(self._fd)
            file.unlink()
            raise disk.as_ours(error, f"cannot record to {file}") from error

    @classmethod
    def create(cls, path: Path, *, info: TakeInfo, reserve_bytes: int = disk.GIB) -> TakeWriter:
        """Create a new take.

        Args:
            path: path of the take.
            info: how the take is made.
            reserve_bytes: the recording stops when the disk has less free space.

        Raises:
            RecordingError: the folder is missing, no folder, or cannot be written to.
            DiskFullError: the disk has less free space than the reserve.
            TakeExistsError: the name is in use. In each case, nothing is created.
        """
        disk.check_can_record(path, reserve_bytes)
        return cls(path, info=info, reserve_bytes=reserve_bytes)

    @classmethod
    def resume_or_create(cls, path: Path, *, info: TakeInfo, reserve_bytes: int = disk.GIB) -> TakeWriter:
        """Resume a take whose recording was killed or interrupted, or create a new one; arguments as in `create`.

        Frames that are already stored are not stored again. `close` merges the parts. The take keeps its identity;
        ``info`` begins a new run in it.

        Raises:
            TakeExistsError: the take was closed properly, is being recorded elsewhere, or is no Mocapella take.
            RecordingError, DiskFullError: as in `create`.
            SchemaVersionError: the take was begun with another message schema.
            InputError, DamagedTakeError: a file of the take cannot be read, or a run's description is invalid.
        """
        disk.check_folder(path.parent, reserve_bytes)
        if not os.path.lexists(path):
            return cls.create(path, info=info, reserve_bytes=reserve_bytes)
        try:
            fd = os.open(path, os.O_RDWR)
        except OSError as error:
            raise disk.name_taken(path, f"it exists and cannot be opened ({error.strerror})") from error
        with ExitStack() as stack:
            stack.callback(os.close, fd)
            if not disk.lock(fd):
                raise disk.name_taken(path, "another program is recording it")
            writer = cls(
                path,
                info=info,
                reserve_bytes=reserve_bytes,
                part=disk.next_part(path),
                lock_fd=fd,
                earlier=_earlier_parts(path),
            )
            stack.pop_all()
        return writer

    @property
    def size_bytes(self) -> int:
        """Number of written bytes of the file, without earlier parts."""
        return self._file.size

    @property
    def seconds(self) -> float:
        """Time from the start of the first run, or an earlier entry, to the last entry, on the server's clock [s].

        For a resumed take, this includes the earlier parts and the interruptions.
        """
        return 0.0 if self._first_ns is None else (self._last_ns - self._first_ns) / NS_PER_S

    def start_run(self, info: TakeInfo) -> None:
        """Flush all earlier entries, then begin the run of a new tracker, whose scenes are numbered from 0.

        Raises:
            DiskFullError: the disk is full, or has less free space than the reserve.
            RecordingError: the disk failed, or the file was removed or changed by another program.
        """
        self.flush()
        self._begin_run(info)

    def write_frame(self, data: bytes, *, sensor: str, node_id: int, sequence: int, log_ns: int) -> bool:
        """Add an encoded frame as received; return False if it is a duplicate, or does not belong to the take.

        The caller has checked that ``data`` is the frame with this sensor, node id and sequence number.
        """
        self._check_open()
        node = sensor, node_id
        if not self.accounts.wants(node, sequence):
            return False
        self._add(take.FRAMES + sensor, data, log_ns, sequence)
        self.accounts.receive(node, sequence)
        return True

    def write_scene(self, data: bytes, log_ns: int) -> None:
        """Add a scene, encoded by `mocapella.schema.encode_scene`."""
        self._write(take.SCENES, data, log_ns)
        self._pending_scenes += 1

    def write_truth(self, data: bytes, *, sensor: str, log_ns: int) -> None:
        """Add the ground truth of a simulated sensor's frame, encoded by `mocapella.schema.encode_truth`."""
        self._write(take.TRUTH + sensor, data, log_ns)

    def write_status(self, status: SessionStatus, log_ns: int) -> None:
        """Add the session's status at a time, as JSON."""
        self._write(take.STATUS, msgspec.json.encode(status), log_ns)

    def write_clock(self, probes: Mapping[str, Any], log_ns: int) -> None:
        """Add the raw clock probes of a node, as a JSON object, so that its clock offset can be estimated again."""
        self._write(take.CLOCK, msgspec.json.encode(probes), log_ns)

    def write_command(self, values: Mapping[str, Any], log_ns: int, before_step: int) -> None:
        """Add a command to the tracker.

        Args:
            values: the command's name, arguments and sender, as in `mocapella.recording.take.Command`.
            log_ns: time of the command, on the server's clock.
            before_step: number of the first scene that the tracker makes after the command.
        """
        data = msgspec.json.encode({"before_step": before_step, "command": values})
        self._write(take.COMMANDS, data, log_ns)

    def flush(self) -> None:
        """Write all entries to the disk, and return when they are durable.

        Raises:
            DiskFullError: the disk is full, or has less free space than the reserve.
            RecordingError: the disk failed, or the file was removed or changed by another program. In each case, the
                take is closed, and the report describes the readable contents.
        """
        self._check_open()
        try:
            self._store()
            free = disk.free_bytes(self.path.parent)
        except OSError as error:
            raise self._stopped(disk.as_ours(error, f"recording to {self.path} stopped")) from error
        if free < self._reserve:
            why = f"recording to {self.path} stopped: {disk.too_little(free, self._reserve)}"
            raise self._stopped(DiskFullError(why))

    def close(self, *, interrupted: bool = False) -> TakeReport:
        """Flush and close the take, and merge its parts if its recording was interrupted; return the report.

        With ``interrupted``, the file is marked, so that `resume_or_create` can continue the take, and parts are not
        merged. If parts cannot be merged, they are kept and read as one take, and the report gives the reason. A second
        call returns the same report.

        Raises:
            DiskFullError, RecordingError: the end of the file could not be written; flushed entries stay readable.
        """
        if self.report is not None:
            return self.report
        try:
            self._store(last=True)
            if interrupted:
                self._file.add_metadata(take.INTERRUPTED_METADATA, {})
            self._file.finish()
        except OSError as error:
            raise self._stopped(disk.as_ours(error, f"{self.path} could not be closed")) from error
        problem = f"{self.path} was interrupted; a recording to it goes on with it" if interrupted else ""
        if not disk.leads_to(disk.part_path(self.path, self._part), self._fd):
            problem = f"{self.path} was moved while it was recorded; the frames are in the file that was moved"
        elif self._lock_fd is not None and not interrupted:
            try:
                merge.merge_locked(self.path, self._reserve)
            except (RecordingError, InputError) as error:
                problem = str(error)
        return self._finished(clean=not problem, problem=problem)

    def _begin_run(self, info: TakeInfo) -> None:
        self._file.add_run(Run(self._next_run, self._part, replace(info, take_id=self.take_id)))
        self._next_run += 1
        self._saw(info.started_ns)

    def _write(self, topic: str, data: bytes, log_ns: int) -> None:
        self._check_open()
        self._add(topic, data, log_ns)

    def _add(self, topic: str, data: bytes, log_ns: int, sequence: int = 0) -> None:
        if len(data) > MAX_ENTRY_BYTES:
            raise WireError(f"an entry of {len(data)} bytes; at most {MAX_ENTRY_BYTES} are stored")
        self._file.add(topic, data, log_ns, sequence)
        self._saw(log_ns)

    def _saw(self, log_ns: int) -> None:
        self._first_ns = log_ns if self._first_ns is None else min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)

    def _store(self, *, last: bool = False) -> None:
        for row in self.accounts.take_rows(last=last):
            self._file.add(take.NODES, row, self._last_ns)
        self._check_file()
        self._file.flush()
        self._check_file()
        self.accounts.commit()
        self.scenes += self._pending_scenes
        self._pending_scenes = 0

    def _check_file(self) -> None:
        """Raise an error if another program has removed or truncated the file."""
        if disk.removed(self._fd):
            raise self._stopped(RecordingError(f"{self.path} was removed while it was recorded; begin a new take"))
        if disk.size(self._fd) != self._file.size:
            why = f"{self.path} was changed by another program while it was recorded; begin a new take"
            raise self._stopped(RecordingError(why))

    def _recount(self) -> None:
        """Count what is readable on the disk, after the recording has failed."""
        try:
            parts = [part for part in disk.parts_of(self.path) if part.exists()]
            index = index_take(parts) if parts else TakeIndex()
        except (OSError, InputError, WireError):
            index = TakeIndex()  # nothing can be read there
        self.accounts.recount(index.nodes)
        self.scenes = len(index.scenes)

    def _check_open(self) -> None:
        if self.report is not None:
            why = f" ({self.report.problem})" if self.report.problem else ""
            raise RecordingError(f"{self.path} is closed{why}; begin a new take")

    def _stopped(self, error: RecordingError) -> RecordingError:
        """Close the take as far as the disk allows; return the error with the stored contents."""
        clean = False
        intact = not disk.removed(self._fd) and disk.size(self._fd) == self._file.size
        with suppress(OSError):  # the disk is full or failing: then the take has no end, and is readable
            if intact:
                self._file.finish()
                clean = self._lock_fd is None
        if not intact or disk.leads_to(disk.part_path(self.path, self._part), self._fd):
            self._recount()
        report = self._finished(clean=clean, problem=str(error))
        stored, unsaved = self.accounts.stored, self.accounts.pending
        return type(error)(
            f"{error}; {report.path.name} holds the {stored} frames before it"
            + (f", and {unsaved} are lost" if unsaved else "")
        )

    def _finished(self, *, clean: bool, problem: str) -> TakeReport:
        os.close(self._fd)
        if self._lock_fd is not None:
            os.close(self._lock_fd)
        try:
            parts = (self.path,) if clean else disk.parts_of(self.path)
            size = sum(part.stat().st_size for part in parts)
        except OSError:  # the file or its folder is no longer where it was
            parts, size = (self.path,), self._file.size
        self.report = TakeReport(
            path=self.path,
            parts=parts,
            frames=self.accounts.frames,
            lost=self.accounts.lost,
            duplicates=self.accounts.duplicates,
            scenes=self.scenes,
            size_bytes=size,
            seconds=self.seconds,
            clean=clean and not self.accounts.unknown,
            problem=problem,
            unknown=self.accounts.unknown,
        )
        return self.report


def _earlier_parts(path: Path) -> TakeSoFar:
    """Read an interrupted recording, and reopen it if need be; raise `TakeExistsError` if it is anything else."""
    if merge.closed(path) and not merge.reopen(path):
        raise disk.name_taken(path)
    with path.open("rb") as file:
        start = file.read(len(MAGIC))
    so_far = read_so_far(disk.parts_of(path))
    if not MAGIC.startswith(start):
        raise disk.name_taken(path, "it exists and is no take")
    if so_far.first_ns is not None and not so_far.next_run:
        raise disk.name_taken(path, "it exists and is no take that can be gone on with")
    return so_far
