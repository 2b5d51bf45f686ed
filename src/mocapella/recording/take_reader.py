"""Read a take: complete, truncated, or in the parts of an interrupted recording.

`read_take` scans the files once, checks every chunk and indexes the messages; frames are read from the disk on demand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_json
from mocapella.errors import DamagedTakeError, InputError, SchemaVersionError, WireError
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import UnknownFrame
from mocapella.model.truth import Truth
from mocapella.recording import disk, take
from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.mcap_scan import is_closed
from mocapella.recording.raw_order import raw_order
from mocapella.recording.take import Command, Interruption, NodeFrames, Run, StoredFrame, TakeInfo
from mocapella.recording.take_index import TakeIndex, index_take
from mocapella.recording.take_refs import LENGTH, OFFSET, PART, FrameRef, Ref, SceneRef
from mocapella.schema import decode_frame, decode_scene, decode_truth

T = TypeVar("T")
_FIX = "name a take that is there, such as NAME.mcap"
MOST_SKIPPED: Final = 100
_BYTES_AT_ONCE: Final = 1 << 22
_SCENES_AT_ONCE: Final = 1 << 13
_GAP_BYTES: Final = 1 << 16
"""Largest gap between two scenes that is read with them, rather than skipped."""
_ManyScenes = tuple[NDArray[np.int64], bytes, NDArray[np.int64], NDArray[np.int64]]


class _StoredCommand(msgspec.Struct):
    before_step: int
    command: dict[str, Any]


def _decode_command(data: bytes) -> _StoredCommand:
    return decode_json(data, _StoredCommand, what="command")


def _decode_values(data: bytes) -> dict[str, Any]:
    return decode_json(data, dict[str, Any])


class RawFrame(NamedTuple):
    """A frame to track, as stored, with its capture time ``at_ns`` on the server's clock."""

    stored: StoredFrame
    at_ns: int


def _spans(table: NDArray[np.int64]) -> Iterator[slice]:
    """Yield the rows of scenes that are near each other in a file, and together not too large to be read at once."""
    gaps = table[1:, OFFSET] - table[:-1, OFFSET] - table[:-1, LENGTH]
    apart = (np.diff(table[:, PART]) != 0) | (gaps < 0) | (gaps > _GAP_BYTES)
    for first, last in pairwise([0, *(np.flatnonzero(apart) + 1).tolist(), len(table)]):
        begin = first
        while begin < last:
            offsets = table[begin:last, OFFSET]
            end = begin + int(np.searchsorted(offsets, offsets[0] + _BYTES_AT_ONCE))
            yield slice(begin, end)
            begin = end


class Take:
    """A take on disk; `read_take` opens it.

    A time ``log_ns`` is the log time of an entry, on the server's clock. An argument ``run`` is a run's number, or None
    for all runs. Methods that yield entries read them from the disk one by one; they yield nothing for an unknown run
    or sensor, and raise `InputError` if a file cannot be read any more, `DamagedTakeError` if an entry is invalid.

    Attributes:
        path: path of the take.
        parts: files of the take; more than one if its recording was interrupted and the parts are not merged yet.
        skips: whether invalid entries are left out, and named in ``skipped``, instead of raising `DamagedTakeError`.
        skipped: descriptions of the first `MOST_SKIPPED` entries that were left out, a line each.
    """

    def __init__(self, path: Path, parts: Sequence[Path], index: TakeIndex) -> None:
        self.path, self.parts = path, tuple(parts)
        self.skips = False
        self.skipped: dict[str, None] = {}
        self._index = index

    @property
    def clean(self) -> bool:
        """Whether the take was closed properly, in one file, undamaged, and the last frame of each node is known."""
        return self._index.clean

    @property
    def damaged(self) -> bool:
        """Whether a file was not closed properly, has damaged bytes, or entries were left out (``skips``)."""
        return self._index.damaged or bool(self.skipped)

    @property
    def problems(self) -> tuple[str, ...]:
        """Faults of the take, a line each, with the entries that were left out so far."""
        return (*self._index.problems, *self.skipped)

    @property
    def seconds(self) -> float:
        """Time from the first entry to the last, on the server's clock [s]."""
        return self._index.seconds

    @property
    def runs(self) -> tuple[Run, ...]:
        """Runs of the take, in order; each is the section that one tracker made."""
        return tuple(self._index.runs)

    @property
    def take_id(self) -> str:
        """Random identity of the take, the same in all its files; empty in older takes, and if it cannot be read."""
        return self._index.runs[0].info.take_id if self._index.runs else ""

    @property
    def interruptions(self) -> tuple[Interruption, ...]:
        """Interruptions of the recording, because the server was killed or failed."""
        return tuple(self._index.interruptions)

    @property
    def info(self) -> TakeInfo:
        """How the take was made, according to its first run.

        Raises:
            DamagedTakeError: neither of the two copies of this description can be read.
        """
        if not self._index.runs:
            raise DamagedTakeError("how it was made cannot be read", file=self.path)
        return self._index.runs[0].info

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sorted names of the sensors with frames in the take."""
        return tuple(sorted({sensor for (sensor, _), ledger in self._index.nodes.items() if len(ledger)}))

    @property
    def frame_count(self) -> int:
        """Number of frames in the take."""
        return len(self._index.frames)

    @property
    def scene_count(self) -> int:
        """Number of scenes in the take."""
        return len(self._index.scenes)

    @property
    def part_counts(self) -> dict[str, int]:
        """Number of parts in all scenes by the name of their type, also for types that no installed package reads."""
        return dict(self._index.parts)

    @property
    def unread_frame_types(self) -> tuple[str, ...]:
        """Names of the frame types that no installed package reads, judging by the first frame of each node."""
        firsts = {(frame.sensor, frame.node_id): frame for frame in reversed(self._index.frames)}
        frames = (stored.frame for stored in self._frames(firsts.values()))
        return tuple(sorted({frame.kind for frame in frames if isinstance(frame, UnknownFrame)}))

    def frames(self, sensor: str | None = None) -> Iterator[StoredFrame]:
        """Yield the frames of one sensor, or of all if None, in the order of storage.

        Raises:
            DamagedTakeError: a frame's bytes are not a valid frame.
        """
        yield from self._frames(frame for frame in self._index.frames if sensor in (None, frame.sensor))

    def frames_in_sequence(self, sensor: str) -> Iterator[StoredFrame]:
        """Yield one sensor's frames by their sequence numbers, node after node.

        In the order of storage, frames that were lost and requested again come later.

        Raises:
            DamagedTakeError: a frame's bytes are not a valid frame.
        """
        frames = [frame for frame in self._index.frames if frame.sensor == sensor]
        nodes = {node: place for place, node in enumerate(dict.fromkeys(frame.node_id for frame in frames))}
        yield from self._frames(sorted(frames, key=lambda frame: (nodes[frame.node_id], frame.sequence)))

    def scenes(self, run: int | None = None) -> Iterator[tuple[int, Scene]]:
        """Yield (log_ns, scene) of one run, or of all if None, in the order of storage; log_ns as in `Take`.

        Raises:
            DamagedTakeError: a scene's bytes are not a valid scene.
        """
        refs = (scene.ref for scene in self._index.scenes if run in (None, scene.run))
        yield from self._decoded(refs, decode_scene)

    @property
    def scene_table(self) -> NDArray[np.int64]:
        """Positions and identities of all scenes (scenes, columns) in the order of storage; see `SceneTable`."""
        return self._index.scenes.array

    def scene_blocks(self, numbers: NDArray[np.int64]) -> Iterator[_ManyScenes]:
        """Yield the encoded scenes with some rising numbers (n,), many at a time, not checked.

        Each time, their numbers, bytes that have them, and the first byte and the size of each.
        """
        with ExitStack() as stack:
            files = self._open(stack)
            for first in range(0, len(numbers), _SCENES_AT_ONCE):
                own = numbers[first : first + _SCENES_AT_ONCE]
                places = self._index.scenes.array[own, : LENGTH + 1]
                for some in _spans(places):
                    begins, last = places[some, OFFSET], places[some.stop - 1]
                    length = int(last[OFFSET] + last[LENGTH] - begins[0])
                    data = self._bytes(files, Ref(int(last[PART]), int(begins[0]), length, 0))
                    yield own[some], data, begins - begins[0], places[some, LENGTH]

    def truths(self, sensor: str) -> Iterator[tuple[int, Truth]]:
        """Yield (log_ns, ground truth) for the frames of a simulated sensor."""
        yield from self._decoded(self._index.others.get(take.TRUTH + sensor, []), decode_truth)

    def statuses(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield (log_ns, status of the session) of all recorded statuses, each a JSON object as of `SessionStatus`."""
        yield from self._decoded(self._index.others.get(take.STATUS, []), _decode_values)

    def clock_probes(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield (log_ns, raw measurements of a node's clock offset as a decoded JSON object)."""
        yield from self._decoded(self._index.others.get(take.CLOCK, []), _decode_values)

    def commands(self, run: int | None = None) -> Iterator[Command]:
        """Yield the commands to the tracker, of one run, or of all if None."""
        refs = (ref for number, ref in self._index.commands if run in (None, number))
        for log_ns, stored in self._decoded(refs, _decode_command):
            yield Command(stored.before_step, log_ns, stored.command)

    def arrivals(self, run: int | None = None) -> Iterator[Arrival]:
        """Yield the tracked frames of one run (None: of all) in the tracker's order, with server-clock capture times.

        Scenes whose frame is missing are skipped; `problems` names them.
        """
        with ExitStack() as stack:
            files = self._open(stack)
            for scene in self._index.scenes:
                if run in (None, scene.run):
                    yield from self._arrivals(files, scene)

    def replay(self) -> Iterator[Run | Command | Arrival]:
        """Yield the inputs for trackers that compute the same scenes again.

        At each `Run`, make a new tracker with the run's setup; its frames and commands follow in the tracker's order.
        """
        for run in self._index.runs:
            yield run
            yield from self.replay_run(run.number)

    def complete(self) -> tuple[NodeFrames, ...]:
        """Return the stored and missing frames of each node, sorted by sensor and node."""
        return tuple(
            NodeFrames(
                sensor,
                node,
                ledger.first,
                ledger.after - 1,
                ledger.stored,
                tuple(ledger.missing()),
                ledger.unknown_after is None,
            )
            for (sensor, node), ledger in sorted(self._index.nodes.items())
        )

    def _frames(self, refs: Iterable[FrameRef]) -> Iterator[StoredFrame]:
        with ExitStack() as stack:
            files = self._open(stack)
            for frame in refs:
                yield from self._if_valid(partial(self._stored, files, frame))

    def _stored(self, files: list[BinaryIO], frame: FrameRef) -> StoredFrame:
        raw = self._bytes(files, frame.ref)
        return StoredFrame(frame.ref.log_ns, self._decode(decode_frame, raw, frame.ref), raw)

    def replay_run(self, run: int) -> Iterator[Command | Arrival]:
        """Yield one run's tracked frames and commands in the tracker's order."""
        waiting = list(self.commands(run))[::-1]
        scenes = [scene for scene in self._index.scenes if scene.run == run]
        with ExitStack() as stack:
            files = self._open(stack)
            for scene in scenes:
                while waiting and waiting[-1].before_step <= scene.step:
                    yield waiting.pop()
                yield from self._arrivals(files, scene)
        yield from reversed(waiting)

    def raw_run(self, run: int) -> Iterator[Command | RawFrame]:
        """Yield all frames and commands of one run in the order of `raw_order`, also frames that were not tracked."""
        with ExitStack() as stack:
            files = self._open(stack)
            for event in raw_order(self._index, run, list(self.commands(run))):
                if isinstance(event, Command):
                    yield event
                else:
                    for stored in self._if_valid(partial(self._stored, files, event.frame)):
                        yield RawFrame(stored, event.at_ns)

    def _arrivals(self, files: list[BinaryIO], scene: SceneRef) -> Iterator[Arrival]:
        frame = self._index.frame_of(scene)
        if frame is not None:
            for stored in self._if_valid(partial(self._stored, files, frame)):
                yield Arrival(stored.frame, scene.at_ns)

    def _decoded(self, refs: Any, decode: Callable[[bytes], T]) -> Iterator[tuple[int, T]]:
        with ExitStack() as stack:
            files = self._open(stack)
            for ref in refs:
                yield from self._if_valid(partial(self._timed, files, ref, decode))

    def _timed(self, files: list[BinaryIO], ref: Ref, decode: Callable[[bytes], T]) -> tuple[int, T]:
        return ref.log_ns, self._decode(decode, self._bytes(files, ref), ref)

    def _if_valid(self, read: Callable[[], T]) -> Iterator[T]:
        """Yield what ``read`` returns; nothing if it is invalid and `skips` is set."""
        try:
            value = read()
        except DamagedTakeError as error:
            if not self.skips:
                raise
            if len(self.skipped) < MOST_SKIPPED:
                self.skipped[str(error)] = None
            return
        yield value

    def _open(self, stack: ExitStack) -> list[BinaryIO]:
        try:
            return [stack.enter_context(part.open("rb")) for part in self.parts]
        except OSError as error:
            raise InputError(f"cannot be read any more ({error.strerror})", file=self.path) from error

    def _bytes(self, files: list[BinaryIO], ref: Ref) -> bytes:
        try:
            files[ref.part].seek(ref.offset)
            data = files[ref.part].read(ref.length)
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", file=self.parts[ref.part]) from error
        if len(data) != ref.length:
            raise DamagedTakeError("became shorter while it was read", file=self.parts[ref.part])
        return data

    def _decode(self, decode: Callable[[bytes], T], data: bytes, ref: Ref) -> T:
        try:
            return decode(data)
        except SchemaVersionError:
            raise
        except (WireError, InputError) as error:
            raise DamagedTakeError(f"at byte {ref.offset}: {error}", file=self.parts[ref.part]) from error


def read_take(path: Path | str) -> Take:
    """Open a take. Of a damaged one, the readable sections are read; `Take.problems` lists the faults.

    Unmerged parts of an interrupted recording (`merge_parts`) are read as one take.

    Raises:
        InputError: the file is missing, empty, no MCAP file, or no take.
        DamagedTakeError: nothing in the take is readable.
        SchemaVersionError: the take was made with another message schema.
    """
    path = Path(path)
    parts, is_mcap = _parts(path)
    index = index_take(parts)
    if len(parts) > 1:
        index.clean = False
        index.problems.append(f"the take is in {len(parts)} parts, because the recording was interrupted")
    if index.empty and not is_mcap:
        is_table = path.name.lower().endswith((".csv", ".csv.gz"))
        raise InputError("is a table, and no take" if is_table else "is no MCAP file", file=path, fix=_FIX)
    if index.empty:
        problems = (problem.removeprefix(f"{path.name}: ") for problem in index.problems)
        raise DamagedTakeError("nothing in it can be read", file=path, fix="; ".join(problems) or None)
    if not index.runs and not index.frames and not index.scenes:
        raise InputError("is an MCAP file, and no take of Mocapella", file=path, fix=_FIX)
    return Take(path, parts, index)


def _parts(path: Path) -> tuple[tuple[Path, ...], bool]:
    """Return the files of the take, and whether the first starts like an MCAP file."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            start = file.read(len(MAGIC))
            closed = is_closed(file, size)
    except FileNotFoundError:
        raise InputError("there is no such file", file=path, fix=_FIX) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, fix=_FIX) from error
    parts = (path,) if closed else disk.parts_of(path)
    if size == 0 and len(parts) == 1:
        raise InputError("is empty", file=path, fix=_FIX)
    return parts, bool(start) and MAGIC.startswith(start)
