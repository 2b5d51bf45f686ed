"""Values that describe a take: the names of its channels, how it was made, and its stored and missing frames.

A take is one MCAP file. `mocapella.recording.take_writer` writes it, `mocapella.recording.take_reader` reads it.
"""

from __future__ import annotations

import secrets
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella import __version__
from mocapella.decoding import convert, decode_json
from mocapella.errors import DamagedTakeError, InputError, SchemaVersionError
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import Setup, UnknownEnd
from mocapella.recording.take_origin import TakeOrigin
from mocapella.schema import SCHEMA_VERSION

RUNS: Final = "/runs"
SCENES: Final = "/scenes"
COMMANDS: Final = "/commands"
STATUS: Final = "/status"
CLOCK: Final = "/clock"
NODES: Final = "/nodes"
EARLIER: Final = "/earlier"
"""Channel of the account that each later part begins with (`mocapella.recording.take_so_far`)."""
FRAMES: Final = "/frames/"
TRUTH: Final = "/truth/"
RUN_METADATA: Final = "mocapella.run"
MERGED_METADATA: Final = "mocapella.merged"
INTERRUPTED_METADATA: Final = "mocapella.interrupted"
"""Name of the metadata record at the end of a file whose recording was interrupted, and can be continued."""


@dataclass(frozen=True)
class TakeInfo:
    """How a take, or a run in it, was made.

    Attributes:
        setup: the session's configuration at the start.
        method_settings: settings of the tracking method, by name.
        started_unix_ns: wall clock at the start, since 1970 [ns].
        started_ns: the server's monotonic clock at the start [ns]; every ``log_ns`` in the take is on this clock.
        version: version of Mocapella.
        schema_version: version of the message schema.
        packages: package with its version, by each plug-in that the run may have used, such as ``tracking method
            heat``; empty in older takes.
        take_id: random identity of the take, the same in all its runs and parts; empty in older takes.
        origin: recording whose raw frames were tracked again; None if the take was recorded live.
        continues: whether the tracker of the run before goes on, with other labels: ids of people mean the same.
    """

    setup: Setup
    started_unix_ns: int
    started_ns: int
    method_settings: dict[str, Any] = field(default_factory=dict)
    version: str = __version__
    schema_version: int = SCHEMA_VERSION
    packages: dict[str, str] = field(default_factory=dict)
    take_id: str = ""
    origin: TakeOrigin | None = None
    continues: bool = False

    @property
    def method(self) -> str:
        """Name of the tracking method."""
        return self.setup.method


@dataclass(frozen=True)
class Run:
    """The section of a take that one tracker made with the same labels; its scenes have rising step numbers.

    A new tracker is a new run, and so are other labels.

    Attributes:
        number: number of the run in the take, from 0.
        part: number of the file that recorded the run: 1, plus 1 for each resumption after an interruption.
        info: how the run was made.
    """

    number: int
    part: int
    info: TakeInfo


def trackers_of(runs: Iterable[Run]) -> dict[int, int]:
    """Return for each run, by its number, the number of the first run of its tracker (`TakeInfo.continues`)."""
    found: dict[int, int] = {}
    tracker = 0
    for run in runs:
        tracker = tracker if run.info.continues and found else run.number
        found[run.number] = tracker
    return found


@dataclass(frozen=True)
class Command:
    """A command to the tracker, such as recalibrate.

    Attributes:
        before_step: number of the first scene that the tracker made after the command.
        log_ns: time of the command, on the server's clock.
        values: the command's name ``verb``, its ``arguments`` by name, and its sender ``by``, if known.
    """

    before_step: int
    log_ns: int
    values: dict[str, Any]

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments by name; none if they are no JSON object."""
        found = self.values.get("arguments")
        return found if isinstance(found, dict) else {}


class StoredFrame(msgspec.Struct, frozen=True, eq=False):
    """A frame of a take: decoded, and as the bytes that the server received, with its arrival time.

    Attributes:
        log_ns: time at which the server received the frame, on the server's clock.
        frame: the decoded frame.
        raw: the frame's bytes as received.
    """

    log_ns: int
    frame: SensorFrame
    raw: bytes


@dataclass(frozen=True)
class NodeFrames:
    """Stored and missing frames of one node in a take.

    Attributes:
        sensor, node_id: identity of the node.
        first, last: sequence numbers of the first and the last frame that belong to the take, as far as known.
        stored: number of the node's frames in the take.
        missing: first and last sequence number of each gap.
        end_known: whether the number of the node's last frame in the take is known; True for older takes, where
            ``last`` is that of the last stored frame.
    """

    sensor: str
    node_id: int
    first: int
    last: int
    stored: int
    missing: tuple[tuple[int, int], ...]
    end_known: bool = True

    @property
    def lost(self) -> int:
        """Number of frames that belong to the take and are missing in it."""
        return self.last - self.first + 1 - self.stored


@dataclass(frozen=True)
class Interruption:
    """An interruption of a recording, because the server was killed or failed.

    Attributes:
        last_log_ns: log time of the last entry before the interruption, on the server's clock.
        resumed_unix_ns: wall clock when the recording was resumed, since 1970 [ns].
    """

    last_log_ns: int
    resumed_unix_ns: int


@dataclass(frozen=True)
class TakeReport:
    """Result of a recording.

    Attributes:
        path: path of the take.
        parts: files of the take: only ``path``, unless the parts of an interrupted take are not merged.
        frames: number of stored frames by sensor.
        lost: number of missing frames by sensor.
        unknown: nodes whose last frame in the take is not known, so that more frames may be missing.
        duplicates: number of frames that were received again, and stored only once.
        scenes: number of stored scenes.
        size_bytes: size of all files.
        seconds: time from the take's first entry to its last [s].
        clean: whether the take was closed properly, in one file, and the last frame of every node is known.
        problem: why the take is in several files, or why the recording stopped; empty if there was no problem.
    """

    path: Path
    parts: tuple[Path, ...]
    frames: dict[str, int]
    lost: dict[str, int]
    duplicates: int
    scenes: int
    size_bytes: int
    seconds: float
    clean: bool
    problem: str = ""
    unknown: tuple[UnknownEnd, ...] = ()


def new_take_id() -> str:
    """Return a new take's random identity, 32 hexadecimal digits."""
    return secrets.token_hex(16)


def encode_run(run: Run) -> bytes:
    """Encode a run's description as JSON, for a message of a take."""
    return msgspec.json.encode(run)


def run_metadata(run: Run) -> dict[str, str]:
    """Return a run's description as the values of an MCAP metadata record, with a checksum, which such records lack."""
    text = encode_run(run).decode()
    return {"run": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}


def run_from_metadata(values: dict[str, str], file: str) -> Run | None:
    """Decode the values that `run_metadata` made; return None if the checksum is wrong.

    Raises:
        SchemaVersionError: the take was made with another message schema; names both versions.
        DamagedTakeError: the record is no description of a run.
    """
    text = values.get("run", "").encode()
    return decode_run(text, file) if values.get("crc32") == f"{zlib.crc32(text):08x}" else None


def decode_run(data: bytes, file: str) -> Run:
    """Decode a run's description from JSON; ``file`` is the take, named in errors.

    Raises:
        SchemaVersionError: the take was made with another message schema; names both versions.
        DamagedTakeError: the bytes are no description of a run.
    """
    try:
        raw = decode_json(data)
        info = raw.get("info") if isinstance(raw, dict) else None
        version = info.get("schema_version") if isinstance(info, dict) else None
        if isinstance(info, dict) and isinstance(version, int) and version != SCHEMA_VERSION:
            raise SchemaVersionError(
                f"{file}: the take is of schema version {version!r} (Mocapella {info.get('version')}) and this "
                f"program reads version {SCHEMA_VERSION}; open it with a Mocapella of the same schema"
            )
        return convert(raw, Run, what="run")
    except InputError as error:
        raise DamagedTakeError(f"the description of a run cannot be read ({error})", file=file) from error
