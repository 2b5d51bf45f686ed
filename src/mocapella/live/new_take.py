"""Write the take of a recording that is tracked again: the same raw entries, and new results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from os import stat_result
from os.path import samestat
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from mocapella.errors import RecordingError
from mocapella.live.recording_service import packages_of
from mocapella.model.scene import Scene
from mocapella.model.truth import Truth
from mocapella.recording import disk
from mocapella.recording.ledger import NodeLedger
from mocapella.recording.take import NodeFrames, TakeInfo, TakeReport, new_take_id
from mocapella.recording.take_origin import TakeOrigin
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_scene, encode_truth

FLUSH_BYTES: Final = 16 << 20
"""Size of the entries after which they are flushed to the disk [bytes]."""


class NewTake:
    """Writes a take on the caller's thread. A context manager: after an error, or Ctrl-C, the file is removed.

    Args:
        path: path of the take, which must not exist.
        origin: recording that is tracked again; None for frames of none.
        size_bytes: size of that recording; the disk must have room for a take of the same size.
        reserve_bytes: free disk space to leave [bytes].

    Attributes:
        path: path of the take.
        report: result; None until the take is closed.

    Raises:
        TakeExistsError, DiskFullError, RecordingError: before anything is created.
    """

    def __init__(
        self, path: Path, origin: TakeOrigin | None, *, size_bytes: int = 0, reserve_bytes: int = disk.GIB
    ) -> None:
        disk.check_can_record(path, reserve_bytes + size_bytes)
        self.path = path
        self._origin, self._reserve_bytes, self._take_id = origin, reserve_bytes, new_take_id()
        self._writer: TakeWriter | None = None
        self._file: stat_result | None = None
        self._unflushed = 0
        self.report: TakeReport | None = None

    def run(self, info: TakeInfo) -> None:
        """Begin a run; its setup, settings and start are as in ``info``, the rest is of this program.

        Raises:
            TakeExistsError, DiskFullError, RecordingError: the take cannot be written.
        """
        own = TakeInfo(
            info.setup, info.started_unix_ns, info.started_ns, info.method_settings,
            packages=packages_of(info.method), take_id=self._take_id, origin=self._origin,
        )  # fmt: skip
        if self._writer is None:
            self._writer = TakeWriter.create(self.path, info=own, reserve_bytes=self._reserve_bytes)
            self._file = self.path.stat()
        else:
            self._writer.start_run(own)

    def expect(self, nodes: Iterable[NodeFrames]) -> None:
        """Note which frames of each node belong to the take, so that frames missing in the recording count as lost."""
        for one in nodes:
            self._open.accounts.change((one.sensor, one.node_id), partial(_count_as, one))

    def frame(self, data: bytes, sensor: str, node_id: int, sequence: int, log_ns: int) -> None:
        """Write an encoded frame, unchanged; arguments as in `TakeWriter.write_frame`."""
        self._open.write_frame(data, sensor=sensor, node_id=node_id, sequence=sequence, log_ns=log_ns)
        self._wrote(len(data))

    def scene(self, scene: Scene, log_ns: int) -> None:
        """Write a result, at ``log_ns`` on the recording's server clock."""
        data = encode_scene(scene)
        self._open.write_scene(data, log_ns)
        self._wrote(len(data))

    def command(self, verb: str, arguments: Mapping[str, Any], log_ns: int, before_step: int) -> None:
        """Write a command that is carried out before the scene numbered ``before_step``."""
        self._open.write_command({"verb": verb, "arguments": dict(arguments)}, log_ns, before_step)

    def truth(self, sensor: str, truth: Truth, log_ns: int) -> None:
        """Write the ground truth of a simulated sensor."""
        self._open.write_truth(encode_truth(truth), sensor=sensor, log_ns=log_ns)

    def clock(self, probes: Mapping[str, Any], log_ns: int) -> None:
        """Write the raw clock probes of a node."""
        self._open.write_clock(probes, log_ns)

    @property
    def _open(self) -> TakeWriter:
        if self._writer is None:
            raise RecordingError(f"{self.path}: there is nothing to track, so no take is written")
        return self._writer

    def _wrote(self, size: int) -> None:
        self._unflushed += size
        if self._unflushed >= FLUSH_BYTES:
            self._unflushed = 0
            self._open.flush()

    def __enter__(self) -> NewTake:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None and self._writer is not None:
                self.report = self._writer.close()
        except BaseException as failed:
            self._remove(failed)
            raise
        if error is not None:
            self._remove(error)

    def _remove(self, error: BaseException) -> None:
        """Close and remove the unfinished file; raise an error of the disk anew, saying so."""
        if self._writer is None:
            return
        with suppress(RecordingError, OSError):  # it is removed anyway
            self._writer.close()
        with suppress(OSError):
            if self._file is not None and samestat(self.path.stat(), self._file):  # else it is another program's
                self.path.unlink()
        if isinstance(error, RecordingError) and self._writer.report is not None and self._writer.report.problem:
            raise type(error)(f"{self._writer.report.problem}; the unfinished take was removed") from error


def _count_as(node: NodeFrames, ledger: NodeLedger) -> bool:
    """Let a node's ledger expect the same frames as another take's; return that it has changed."""
    ledger.expect(node.first)
    ledger.hear(node.last + 1)
    if node.end_known:
        ledger.finish(node.last + 1)
    return True
