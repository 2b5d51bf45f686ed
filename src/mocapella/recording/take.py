"""The contents of a take: how it was made, its channels, and the frames left out.

A take is one MCAP file. `mocapella.recording.take_writer` writes it, `mocapella.recording.take_reader` reads it.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella import __version__
from mocapella.errors import DamagedTakeError, SchemaVersionError, SettingsError
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import Setup
from mocapella.schema import SCHEMA_VERSION

RUNS: Final = "/runs"
SCENES: Final = "/scenes"
COMMANDS: Final = "/commands"
STATUS: Final = "/status"
CLOCK: Final = "/clock"
FRAMES: Final = "/frames/"
TRUTH: Final = "/truth/"
RUN_METADATA: Final = "mocapella.run"
MERGED_METADATA: Final = "mocapella.merged"


@dataclass(frozen=True)
class TakeInfo:
    """How a take, or a run of it, was made.

    Attributes:
        setup: chosen before the start.
        method_settings: of the tracker's method, by name.
        started_unix_ns: wall clock at the start.
        started_ns: the server's clock at the same instant; every ``log_ns`` in the take is of this clock.
        version: of Mocapella.
        schema_version: of the messages.
        packages: what of other packages the run was made with, such as ``tracking method heat``, and the package
            with its version; empty of older takes.
    """

    setup: Setup
    started_unix_ns: int
    started_ns: int
    method_settings: dict[str, Any] = field(default_factory=dict)
    version: str = __version__
    schema_version: int = SCHEMA_VERSION
    packages: dict[str, str] = field(default_factory=dict)

    @property
    def method(self) -> str:
        """Name of the tracker's method."""
        return self.setup.method


@dataclass(frozen=True)
class Run:
    """The life of one tracker: within it the scenes' steps go up.

    Attributes:
        number: 0, 1, … in the take.
        part: 1, and one more each time that the server was killed and the recording was taken up again.
        info: how it was made.
    """

    number: int
    part: int
    info: TakeInfo


@dataclass(frozen=True)
class Command:
    """Something that was done to the tracker, such as recalibrate, before it took step ``before_step``."""

    before_step: int
    log_ns: int
    values: dict[str, Any]


class StoredFrame(msgspec.Struct, frozen=True, eq=False):
    """A frame, when the server stored it (its clock), and the very bytes that came."""

    log_ns: int
    frame: SensorFrame
    raw: bytes


@dataclass(frozen=True)
class NodeFrames:
    """Which frames of one node are in the take; ``missing`` are (first, last) of each gap."""

    sensor: str
    node_id: int
    first: int
    last: int
    stored: int
    missing: tuple[tuple[int, int], ...]

    @property
    def lost(self) -> int:
        """How many frames are missing between the first and the last."""
        return self.last - self.first + 1 - self.stored


@dataclass(frozen=True)
class Interruption:
    """The server was killed: the last entry before it (server's clock), and the wall clock when it went on."""

    last_log_ns: int
    resumed_unix_ns: int


@dataclass(frozen=True)
class TakeReport:
    """What came of a recording.

    Attributes:
        path: the take.
        parts: the files it is in: the take itself, unless merging the parts of an interrupted one was not possible.
        frames: on the disk, by sensor.
        lost: frames known to be missing, by sensor.
        duplicates: frames that came again and were not stored twice.
        scenes: on the disk.
        size_bytes, seconds: of the whole take.
        clean: closed properly, in one file.
        problem: why not, or why the recording stopped; empty where all is well.
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


def encode_run(run: Run) -> bytes:
    """The run as JSON."""
    return msgspec.json.encode(run)


def run_metadata(run: Run) -> dict[str, str]:
    """The run as MCAP metadata, which has no checksum of its own."""
    text = encode_run(run).decode()
    return {"run": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}


def run_from_metadata(values: dict[str, str], file: str) -> Run | None:
    """The run; None where the checksum says that the record was changed.

    Raises:
        SchemaVersionError, DamagedTakeError: as `decode_run`.
    """
    text = values.get("run", "").encode()
    return decode_run(text, file) if values.get("crc32") == f"{zlib.crc32(text):08x}" else None


def decode_run(data: bytes, file: str) -> Run:
    """Read a run.

    Raises:
        SchemaVersionError: the take was made with another schema; names both versions.
        DamagedTakeError: it is no run.
    """
    try:
        raw = msgspec.json.decode(data)
        version = raw["info"]["schema_version"]
        if version != SCHEMA_VERSION:
            raise SchemaVersionError(
                f"{file}: the take is of schema version {version!r} (Mocapella {raw['info'].get('version')}) and this "
                f"program reads version {SCHEMA_VERSION}; open it with a Mocapella of the same schema"
            )
        return msgspec.convert(raw, Run)
    except (msgspec.DecodeError, KeyError, TypeError, AttributeError, SettingsError) as error:
        raise DamagedTakeError(f"the description of a run cannot be read ({error})", file=file) from error
