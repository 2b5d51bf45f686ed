"""What a node writes to its own disk: a spool of frames that no server has stored, and, if wanted, a take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mocapella.errors import RecordingError
from mocapella.live.recorder import Recorder
from mocapella.model.frame_types import HISTORY_FRAMES
from mocapella.model.session import Setup
from mocapella.recording.disk import GIB
from mocapella.recording.ledger import NodeLedger
from mocapella.recording.spool import SPOOL_FOLDER, DiskSpool, SpoolLimits
from mocapella.recording.take import TakeInfo, new_take_id
from mocapella.recording.take_writer import TakeWriter
from mocapella.wire.keys import NodeKey
from mocapella.wire.node import FAREWELL_S, NodeLink, NodeStart


@dataclass(frozen=True)
class NodeDisk:
    """What a node writes to its own disk.

    Attributes:
        spool: folder for frames of a server's open take that it has not stored; made when it is needed.
        record: path of a take for all frames of the node; None records none.
        reserve_bytes: free disk space that spool and take leave [bytes].
        farewell_s: longest wait at the end for the server to store further frames of its open take [s]; the spool keeps
            the others.
    """

    spool: Path = SPOOL_FOLDER
    record: Path | None = None
    reserve_bytes: int = GIB
    farewell_s: float = FAREWELL_S


@contextmanager
def open_link(
    connect: str,
    sensor: str,
    disk: NodeDisk | None = None,
    *,
    history_frames: int = HISTORY_FRAMES,
    say: Callable[[str], None] = lambda text: None,
    start: NodeStart | None = None,
) -> Iterator[NodeLink]:
    """Open a node's link to the bus, with its spool, and record its frames if wanted, within this context.

    Args:
        connect: address of the server.
        sensor: name of the sensor.
        disk: what to write; None for the spool only.
        history_frames: number of frames to keep in memory.
        say: receives messages about frames that are not stored.
        start: identity of the node, if another program numbers its frames; None takes a random id.

    Raises:
        BusError, KeyFileError: as `NodeLink`.
        RecordingError: the take cannot be begun, or it stopped.
        UnstoredFramesError: as `NodeLink.close`.
    """
    disk = disk or NodeDisk()
    limits = SpoolLimits(disk.reserve_bytes)
    with ExitStack() as stack:
        link = NodeLink(
            connect,
            sensor,
            history_frames=history_frames,
            spool=lambda node: DiskSpool(disk.spool, node.sensor, node.node_id, limits),
            say=say,
            start=start,
        )
        link.farewell_s = disk.farewell_s
        stack.enter_context(link)
        if disk.record is not None:
            stack.enter_context(_recording(link, disk.record, disk.reserve_bytes, say))
        yield link


@contextmanager
def _recording(link: NodeLink, path: Path, reserve_bytes: int, say: Callable[[str], None]) -> Iterator[None]:
    """Record the frames of a link; a take whose node was killed or failed goes on."""
    info = TakeInfo(Setup(), time.time_ns(), time.monotonic_ns(), take_id=new_take_id())
    recorder = Recorder(TakeWriter.resume_or_create(path, info=info, reserve_bytes=reserve_bytes), say)
    link.on_published = partial(_record, recorder, link.node)
    try:
        yield
    finally:
        recorder.account(link.node, lambda ledger: ledger.finish(link.published, left=True))
        interrupted = link.hurry.is_set()
        health = recorder.close(interrupted=interrupted)
    if health.problem and not interrupted:
        raise RecordingError(health.problem)
    say(f"recorded {health.frames} frames in {health.path}")


def _record(recorder: Recorder, node: NodeKey, sequence: int, data: bytes, sent_ns: int) -> None:
    if sequence == 0:
        recorder.account(node, _begin)
    recorder.frame(node, data, sent_ns, sequence)


def _begin(ledger: NodeLedger) -> bool:
    return ledger.expect(0)
