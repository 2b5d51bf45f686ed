"""Contents of a take: its origin, its channels, and its missing frames.

A take is one MCAP file. `mocapella.recording.take_writer` writes it, `mocapella.recording.take_reader` reads it.
"""

from __future__ import annotations

import secrets
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella import __version__
from mocapella.decoding import convert, decode_json
from mocapella.errors import DamagedTakeError, InputError, SchemaVersionError
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import Setup, UnknownEnd
from mocapella.schema import SCHEMA_VERSION

RUNS: Final = "/runs"
SCENES: Final = "/scenes"
COMMANDS: Final = "/commands"
STATUS: Final = "/status"
CLOCK: Final = "/clock"
NODES: Final = "/nodes"
FRAMES: Final = "/frames/"
TRUTH: Final = "/truth/"
RUN_METADATA: Final = "mocapella.run"
MERGED_METADATA: Final = "mocapella.merged"


@dataclass(frozen=True)
class TakeInfo:
    """Origin of a take, or of a run in it.

    Attributes:
        setup: at the start.
        method_settings: of the tracker's method, by name.
        started_unix_ns: wall clock at the start.
        started_ns: the server's clock at the same time; every ``log_ns`` in the take is on this clock.
        version: of Mocapella.
        schema_version: of the messages.
        packages: descriptors of other packages that the run used, such as ``tracking method heat``, and each package
            with its version; empty in older takes.
        take_id: random identity of the take, the same in all its runs and parts; empty in older takes.
    """

    setup: Setup
    started_unix_ns: int
    started_ns: int
    method_settings: dict[str, Any] = field(default_factory=dict)
    version: str = __version__
    schema_version: int = SCHEMA_VERSION
    packages: dict[str, str] = field(default_factory=dict)
    take_id: str = ""

    @property
    def method(self) -> str:
        """Name of the tracker's method."""
        return self.setup.method


@dataclass(frozen=True)
class Run:
    """The part of a take made by one tracker, within which the scenes' steps rise.

    Attributes:
        number: 0, 1, … in the take.
        part: 1, plus 1 for each time that the server was killed and the recording was resumed.
        info: its origin.
    """

    number: int
    part: int
    info: TakeInfo


@dataclass(frozen=True)
class Command:
    """A command to the tracker, such as recalibrate, carried out before step ``before_step``."""

    before_step: int
    log_ns: int
    values: dict[str, Any]


class StoredFrame(msgspec.Struct, frozen=True, eq=False):
    """A frame, when the server stored it (on its clock), and the received bytes."""

    log_ns: int
    frame: SensorFrame
    raw: bytes


@dataclass(frozen=True)
class NodeFrames:
    """Frames of one node in the take.

    Attributes:
        sensor, node_id: the node.
        first, last: numbers of the first and the last frame that belong to the take, as far as known.
        stored: number of its frames in the take.
        missing: (first, last) of each gap.
        end_known: whether the node said which frame was its last; true for older takes, which do not ask.
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
        """Number of frames that belong to the take and are missing."""
        return self.last - self.first + 1 - self.stored


@dataclass(frozen=True)
class Interruption:
    """An interruption by a killed server: last entry before it (server's clock), and wall clock at the restart."""

    last_log_ns: int
    resumed_unix_ns: int


@dataclass(frozen=True)
class TakeReport:
    """Result of a recording.

    Attributes:
        path: the take.
        parts: its files: only the take itself, unless the parts of an interrupted one could not be merged.
        frames: number of stored frames by sensor.
        lost: number of missing frames by sensor.
        unknown: ends that no node has said.
        duplicates: number of repeated frames, which are stored once.
        scenes: number of stored scenes.
        size_bytes, seconds: of the whole take.
        clean: whether it was closed properly, in one file, and the last frame of every node is known.
        problem: why not, or why the recording stopped; empty if there was none.
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
    """Return a random identity for a take."""
    return secrets.token_hex(16)


def encode_run(run: Run) -> bytes:
    """Return the run as JSON."""
    return msgspec.json.encode(run)


def run_metadata(run: Run) -> dict[str, str]:
    """Return the run as MCAP metadata, with a checksum, which MCAP metadata lack."""
    text = encode_run(run).decode()
    return {"run": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}


def run_from_metadata(values: dict[str, str], file: str) -> Run | None:
    """Return the run; None if the checksum is wrong.

    Raises:
        SchemaVersionError, DamagedTakeError: as in `decode_run`.
    """
    text = values.get("run", "").encode()
    return decode_run(text, file) if values.get("crc32") == f"{zlib.crc32(text):08x}" else None


def decode_run(data: bytes, file: str) -> Run:
    """Read a run.

    Raises:
        SchemaVersionError: the take was made with another schema; names both versions.
        DamagedTakeError: the bytes are no run.
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
