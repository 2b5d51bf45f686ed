"""Index a take in one pass over its files, which checks them and finds each message, without decoding arrays."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.decoding import decode_json
from mocapella.errors import InputError
from mocapella.model.session import UnknownEnd
from mocapella.recording import take
from mocapella.recording.ledger import LedgerRow, NodeLedger
from mocapella.recording.mcap_scan import Damage, End, Event, MessageRead, MetadataRead, scan
from mocapella.recording.take import Interruption, Run
from mocapella.recording.take_refs import (
    FRAME,
    FRAME_COLUMNS,
    LOG_NS,
    NODE_ID,
    PART,
    RUN,
    SENSOR,
    SEQUENCE,
    STEP,
    FrameRef,
    FrameTable,
    Ref,
    RowsRead,
    SceneRef,
    SceneTable,
    SensorNames,
)
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.scenes import count_parts

COMPILED_FROM_BYTES: Final = 256 << 20
"""Least size of a file whose messages compiled kernels list; for less, loading them takes longer [bytes]."""
_CHUNKS_AT_ONCE: Final = 64
NAMED_AT_MOST: Final = 5
"""Largest number of scenes that the report of scenes without frames names; the others are only counted."""


class TakeIndex:
    """Index of a take's messages, in the order of storage.

    Attributes:
        clean: whether all files were closed properly and nothing is damaged.
        damaged: whether a file was not closed properly, or has damaged bytes; an undamaged take is unclean if the last
            frame of a node is unknown.
        problems: faults of the take, a line each.
        runs: descriptions of the runs.
        interruptions: interruptions of the recording.
        frames, scenes: positions and identities of the frames and scenes.
        commands: number of the run and position of each command.
        others: positions of other messages by topic.
        nodes: ledger of each node's frames, by sensor and node id.
        parts: number of parts in all scenes, such as people, by the name of their type.
        first_ns, last_ns: smallest and largest log time, on the server's clock; None and 0 without messages.
        damaged_parts: indices of files that are damaged, from 0.
    """

    def __init__(self) -> None:
        self.clean, self.damaged = True, False
        self.problems: list[str] = []
        self.runs: list[Run] = []
        self.interruptions: list[Interruption] = []
        self._sensors = SensorNames()
        self.frames, self.scenes = FrameTable(self._sensors), SceneTable(self._sensors)
        self.commands: list[tuple[int, Ref]] = []
        self.others: dict[str, list[Ref]] = {}
        self.nodes: dict[tuple[str, int], NodeLedger] = {}
        self.parts: Counter[str] = Counter()
        self.first_ns: int | None = None
        self.last_ns = 0
        self.damaged_parts: set[int] = set()
        self._last_step = -1, 0
        self._by_key: dict[tuple[str, int, int], FrameRef] = {}
        self._waiting: list[RowsRead] = []

    @property
    def seconds(self) -> float:
        """Time from the first message to the last, on the server's clock [s]."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) / NS_PER_S

    @property
    def empty(self) -> bool:
        """Whether no message and no run was readable."""
        return self.first_ns is None and not self.runs

    def frame_of(self, scene: SceneRef) -> FrameRef | None:
        """Return the frame that the tracker turned into a scene, or None if the take lacks it."""
        if len(self._by_key) != len(self.frames):
            self._by_key = {(frame.sensor, frame.node_id, frame.sequence): frame for frame in self.frames}
        return self._by_key.get((scene.sensor, scene.node_id, scene.sequence))

    def add_file(self, path: Path, part: int) -> None:
        """Read one file of the take, and add its messages to the index; ``part`` is the file's index, from 0.

        Raises:
            OSError: the file cannot be read.
            InputError: a chunk is compressed.
            SchemaVersionError: the take was made with another message schema; names both versions.
            DamagedTakeError: its description of a run is invalid, though its checksum is right.
        """
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            read_chunk = None
            if size >= COMPILED_FROM_BYTES:
                from mocapella.recording.chunk_rows import ChunkRows

                read_chunk = ChunkRows()
            for event in scan(file, size, str(path), read_chunk):
                self._add(event, part, path)
            self._add_waiting(part)

    def find_orphans(self) -> None:
        """Add a problem if the take lacks the frames of some scenes; call it after the last file."""
        orphans = self._without_frames()
        if orphans:
            some = [self.scenes[place] for place in orphans[:NAMED_AT_MOST]]
            named = [f"run {s.run} step {s.step} ({s.sensor} frame {s.sequence})" for s in some]
            more = f" and {len(orphans) - len(named)} more" if len(orphans) > len(named) else ""
            self.problems.append(
                f"{len(orphans)} scenes were made of frames that are not in the take: {', '.join(named)}{more}"
            )

    def _without_frames(self) -> list[int]:
        """Return the places of the scenes without a frame."""
        table = self.scenes.array
        found = np.zeros(len(table), np.bool_)
        for (sensor, node), ledger in self.nodes.items():
            number = np.array([node], np.uint64).view(np.int64)
            own = np.flatnonzero((table[:, SENSOR] == self._sensors.number(sensor)) & (table[:, NODE_ID] == number))
            if len(own) and len(ledger):
                first, last = np.array(ledger.received(), np.uint64).T
                sequences = table[own, SEQUENCE].view(np.uint64)
                place = np.searchsorted(first, sequences, side="right") - 1
                found[own] = (place >= 0) & (sequences <= last[place])
        return np.flatnonzero(~found).tolist()

    def _add(self, event: Event | RowsRead, part: int, path: Path) -> None:
        if isinstance(event, RowsRead):
            self._waiting.append(event)
            if len(self._waiting) == _CHUNKS_AT_ONCE:
                self._add_waiting(part)
            return
        self._add_waiting(part)
        if isinstance(event, MessageRead):
            self._add_message(event, part, path)
        elif isinstance(event, MetadataRead):
            self._add_metadata(event, part, path)
        elif isinstance(event, Damage):
            self._damage(part)
            self.problems.append(
                f"{path.name}: bytes {event.start} to {event.end}, {self.seconds:.2f} s after the beginning: "
                f"{event.problem}"
            )
        else:
            self._end(event, path)

    def _damage(self, part: int | None = None) -> None:
        self.clean, self.damaged = False, True
        if part is not None:
            self.damaged_parts.add(part)

    def _end(self, end: End, path: Path) -> None:
        if not end.closed:
            self._damage()
            torn = f", and {end.torn_bytes} bytes after it are no whole entry" if end.torn_bytes else ""
            self.problems.append(
                f"{path.name}: ends early, after {self.seconds:.2f} s, {len(self.frames)} frames and "
                f"{len(self.scenes)} scenes{torn}; it was not closed, so the last half second may be missing"
            )

    def _add_metadata(self, event: MetadataRead, part: int, path: Path) -> None:
        if event.name == take.RUN_METADATA:
            run = take.run_from_metadata(event.values, str(path))
            if run is not None:
                self._begin_run(run)
                return
            self._damage(part)
            self.problems.append(f"{path.name}: the description of a run was changed; its second copy is used")

    def _begin_run(self, run: Run) -> None:
        if self.runs and run.number <= self.runs[-1].number:  # each run is described twice
            return
        if self.runs and run.part > self.runs[-1].part:
            self.interruptions.append(Interruption(self.last_ns, run.info.started_unix_ns))
        self.runs.append(run)

    def _add_message(self, m: MessageRead, part: int, path: Path) -> None:
        ref = Ref(part, m.offset, len(m.data), m.log_ns)
        try:
            if m.topic.startswith(take.FRAMES):
                self._add_frame(pb.BodyFrame.FromString(m.data), ref)
            elif m.topic == take.SCENES:
                self._add_scene(pb.Scene.FromString(m.data), ref)
            elif m.topic == take.RUNS:
                self._begin_run(take.decode_run(m.data, str(path)))
            elif m.topic == take.NODES:
                row = decode_json(m.data, LedgerRow, what="account of a node")
                self._ledger(row.sensor, row.node_id).read(row)
            elif m.topic == take.COMMANDS:
                self.commands.append((self._run_number(), ref))
            else:
                self.others.setdefault(m.topic, []).append(ref)
        except (DecodeError, InputError):
            self._damage()
            self.problems.append(f"{path.name}: the message of {m.topic} at byte {m.offset} is none of ours")
            return
        self._note_times(m.log_ns, m.log_ns)

    def _note_times(self, first_ns: int, last_ns: int) -> None:
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)

    def _add_waiting(self, part: int) -> None:
        """Add the frames and scenes of the last chunks, which follow each other."""
        if not self._waiting:
            return
        rows, run = np.concatenate([one.rows for one in self._waiting]), self._run_number()
        numbers = np.array([self._sensors.number(name) for name in self._waiting[-1].sensors])
        frames = rows[:, PART] == FRAME
        rows[:, PART], rows[:, RUN], rows[:, SENSOR] = part, run, numbers[rows[:, SENSOR]]
        found = rows[frames, :FRAME_COLUMNS]
        self.frames.extend(found[self._put_back(found[:, SENSOR : SEQUENCE + 1].view(np.uint64))])
        scenes = rows[~frames]
        for step in scenes[:, STEP].view(np.uint64).tolist():
            self._note_step(run, step)
        self.scenes.extend(scenes)
        for one in self._waiting:
            self.parts.update(one.parts)
        times = rows[:, LOG_NS].view(np.uint64)
        self._note_times(int(times.min()), int(times.max()))
        self._waiting = []

    def _put_back(self, identities: NDArray[np.uint64]) -> NDArray[np.bool_]:
        """Note frames by sensor, node and number (n, 3); return which (n,) were not noted before."""
        new = np.ones(len(identities), np.bool_)
        for sensor, node in set(map(tuple, identities[:, :2].tolist())):
            own = np.flatnonzero((identities[:, 0] == sensor) & (identities[:, 1] == node))
            ledger, numbers = self._ledger(self._sensors.names[sensor], node), identities[own, 2]
            follow = bool((np.diff(numbers) == 1).all())
            if not (follow and ledger.put_back_run(int(numbers[0]), len(numbers))):
                new[own] = [ledger.put_back(number) for number in numbers.tolist()]
        return new

    def _add_frame(self, frame: pb.BodyFrame, ref: Ref) -> None:
        sensor = sys.intern(frame.sensor)
        if self._ledger(sensor, frame.node_id).put_back(frame.sequence):
            identity = self._sensors.number(sensor), frame.node_id, frame.sequence
            self.frames.append((*_columns(ref), *identity, self._run_number(), frame.time_ns))

    def _ledger(self, sensor: str, node_id: int) -> NodeLedger:
        key = (sensor, node_id)
        if key not in self.nodes:
            self.nodes[key] = NodeLedger()
        return self.nodes[key]

    def close_accounts(self) -> None:
        """Count all read frames as stored, after the last file; add a problem for each node with an unknown end."""
        for (sensor, node_id), ledger in self.nodes.items():
            ledger.commit()
            if ledger.unknown_after is not None:
                self.clean = False
                self.problems.append(str(UnknownEnd(sensor, node_id, ledger.unknown_after)))

    def _add_scene(self, scene: pb.Scene, ref: Ref) -> None:
        run = self._run_number()
        self._note_step(run, scene.step)
        count_parts(scene, self.parts)
        identity = self._sensors.number(sys.intern(scene.sensor)), scene.node_id, scene.sequence
        self.scenes.append((*_columns(ref), *identity, run, scene.step, scene.at_ns))

    def _note_step(self, run: int, step: int) -> None:
        if self._last_step[0] == run and step <= self._last_step[1]:
            self.problems.append(
                f"run {run}: step {step} follows step {self._last_step[1]}; a new tracker is a new run"
            )
        self._last_step = run, step

    def _run_number(self) -> int:
        return self.runs[-1].number if self.runs else 0


def _columns(ref: Ref) -> tuple[int, int, int, int]:
    return ref.part, ref.offset, ref.length, ref.log_ns


def index_take(parts: Sequence[Path]) -> TakeIndex:
    """Index a take from its files, in the order of its parts.

    Raises:
        InputError: a file is missing, cannot be read, or has a compressed chunk.
        DamagedTakeError: the description of a run is invalid, though its checksum is right.
        SchemaVersionError: the take was made with another message schema.
    """
    index = TakeIndex()
    add_files(index, parts)
    index.find_orphans()
    index.close_accounts()
    return index


def add_files(index: TakeIndex, parts: Sequence[Path], first: int = 0) -> None:
    """Add files of a take to an index, in the order of its parts; ``first`` is the index of ``parts[0]``, from 0.

    Raises:
        InputError, DamagedTakeError, SchemaVersionError: as in `index_take`.
    """
    for number, path in enumerate(parts, first):
        try:
            index.add_file(path, number)
        except FileNotFoundError:
            raise InputError("there is no such file", file=path, fix="name a take that is there (NAME.mcap)") from None
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", file=path) from error
