"""Cost of recording 6 bodies × 25 joints, beside the ``mcap`` library's writer; and frames lost in 1,000 kills.

A flush here is what the server does four times a second with six sensors: 48 frames and 48 scenes, on the disk when it
returns. For the kills, a process records and reports over a pipe the frames stored by each flush; it is killed at a
random instant, and the reported frames must be in the take.
"""

from __future__ import annotations

import multiprocessing
import os
import random
import statistics
import tempfile
import time
import tracemalloc
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from mcap.writer import CompressionType, Writer

from benchmarks.harness import Row, at_most, compared, measured
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame

SENSORS: Final = tuple(f"sensor-{i}" for i in range(6))
FLUSHES_IN_TEN_MINUTES: Final = 2400
MIB: Final = 1 << 20
SEED: Final = 11
PEER: Final = "mcap.writer.Writer"


def run(quick: bool = False) -> list[Row]:
    flushes = 20 if quick else 200
    with tempfile.TemporaryDirectory(prefix="mocapella-benchmark-") as folder:
        place = Path(folder)
        ours, peer = Ours(place / "ours.mcap"), Library(place / "library.mcap")
        turns = [(*_turn(ours), *_turn(peer)) for _ in range(flushes)]
        write_us, flush_ms, peer_us, peer_ms = (statistics.median(column) for column in zip(*turns, strict=True))
        grown, peer_grown = (_growth_mib(writer, flushes) for writer in (ours, peer))
        ours.close()
        peer.close()
        return [
            compared("recording: write a frame", write_us, "µs", peer=PEER, peer_value=peer_us),
            compared("recording: flush 48 frames, 48 scenes", flush_ms, "ms", peer=PEER, peer_value=peer_ms),
            compared(
                "recording: memory in ten minutes", grown, "MiB", peer=PEER, peer_value=peer_grown, goal=at_most(1)
            ),
            *reading(place, 500 if quick else 10_000),
            kills(place, 30 if quick else 1000),
        ]


def reading(place: Path, frames: int) -> list[Row]:
    """How fast a take is opened, which checks every byte of it, and its frames are decoded."""
    path = _record(place / "read.mcap", frames, None)
    begin = time.perf_counter()
    take = read_take(path)
    opened = time.perf_counter()
    there = sum(1 for _ in take.frames())
    read = time.perf_counter()
    return [
        measured("recording: open a take and check it", path.stat().st_size / MIB / (opened - begin), "MiB/s"),
        measured("recording: read a frame", (read - opened) / there * 1e6, "µs"),
    ]


def kills(place: Path, times: int) -> Row:
    """How many acknowledged frames were not in the take, over many kills."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    picked, missing, acknowledged_in_all = random.Random(SEED), 0, 0
    for number in range(times):
        path = place / f"killed-{number}.mcap"
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_record, args=(path, 1_000_000, sender))
        process.start()
        sender.close()
        acknowledged = int(receiver.recv())
        time.sleep(picked.uniform(0, 0.02))
        process.kill()
        process.join()
        try:
            while True:
                acknowledged = receiver.recv()
        except EOFError:
            receiver.close()
        found = {stored.frame.sequence for stored in read_take(path).frames()}
        missing += len(set(range(acknowledged)) - found)
        acknowledged_in_all += acknowledged
        path.unlink()
    name = f"recording: of {acknowledged_in_all} acknowledged, lost in {times} kills"
    return measured(name, missing, "frames", goal=at_most(0))


class _Recording(Protocol):
    def frame(self) -> None: ...
    def scene(self) -> None: ...
    def flush(self) -> None: ...


class Ours:
    """A take."""

    def __init__(self, path: Path) -> None:
        self._frames = [_frame(sensor, 0) for sensor in SENSORS]
        self._next = count()
        self._writer = TakeWriter.create(path, info=_info(), reserve_bytes=0)

    def frame(self) -> None:
        sequence, i = divmod(next(self._next), len(SENSORS))
        self._writer.write_frame(self._frames[i], sensor=SENSORS[i], node_id=1, sequence=sequence, log_ns=sequence)

    def scene(self) -> None:
        self._writer.write_scene(self._frames[0], 0)

    def flush(self) -> None:
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()


class Library:
    """The library's writer, without compression as ours is, and made durable at each flush as ours is."""

    def __init__(self, path: Path) -> None:
        self._frames = [_frame(sensor, 0) for sensor in SENSORS]
        self._next = count()
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=256 * MIB, compression=CompressionType.NONE, enable_data_crcs=True)
        self._writer.start()
        schema = self._writer.register_schema("mocapella.BodyFrame", "protobuf", b"")
        self._channels = [self._writer.register_channel(f"/frames/{s}", "protobuf", schema) for s in SENSORS]

    def frame(self) -> None:
        sequence, i = divmod(next(self._next), len(SENSORS))
        self._writer.add_message(self._channels[i], sequence, self._frames[i], sequence, sequence)

    def scene(self) -> None:
        self._writer.add_message(self._channels[0], 0, self._frames[0], 0)

    def flush(self) -> None:
        self._writer.flush()
        os.fdatasync(self._file.fileno())

    def close(self) -> None:
        self._writer.finish()
        self._file.close()


def _turn(writer: _Recording) -> tuple[float, float]:
    """What a quarter of a second costs: microseconds a frame, and milliseconds for the flush."""
    begin = time.perf_counter()
    for _ in range(48):
        writer.frame()
    written = time.perf_counter()
    for _ in range(48):
        writer.scene()
    flushing = time.perf_counter()
    writer.flush()
    return (written - begin) / 48 * 1e6, (time.perf_counter() - flushing) * 1e3


def _growth_mib(writer: _Recording, flushes: int) -> float:
    """Extrapolate the growth of memory over ten minutes of flushes from a few."""
    writer.flush()
    tracemalloc.start()
    begin = tracemalloc.get_traced_memory()[0]
    for _ in range(flushes):
        _turn(writer)
    grown = tracemalloc.get_traced_memory()[0] - begin
    tracemalloc.stop()
    return grown / flushes * FLUSHES_IN_TEN_MINUTES / MIB


def _record(path: Path, frames: int, acknowledge: Connection | None) -> Path:
    """Record, and after every flush of ten frames say how many are stored."""
    writer = TakeWriter.create(path, info=_info(), reserve_bytes=0)
    for sequence in range(frames):
        data = _frame("front", sequence)
        writer.write_frame(data, sensor="front", node_id=1, sequence=sequence, log_ns=sequence)
        if sequence % 10 == 9:
            writer.flush()
            if acknowledge is not None:
                acknowledge.send(sequence + 1)
    return writer.close().path


def _frame(sensor: str, sequence: int) -> bytes:
    kind, generator = topology("kinect_v2"), np.random.default_rng(SEED)
    frame = body_frame(
        sensor,
        kind,
        time_ns=sequence,
        positions=generator.normal(size=(6, len(kind), 3)),
        depth_px=generator.uniform(0, 424, size=(6, len(kind), 2)),
        orientations=generator.normal(size=(6, len(kind), 4)),
        node_id=1,
        sequence=sequence,
    )
    return encode_frame(frame)


def _info() -> TakeInfo:
    return TakeInfo(setup=Setup(), started_unix_ns=0, started_ns=0)
