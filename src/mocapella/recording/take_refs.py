"""Positions of a take's frames and scenes in its files, in tables that take little memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]

PART, OFFSET, LENGTH, LOG_NS, SENSOR, NODE_ID, SEQUENCE, RUN, STEP, AT_NS = range(10)
"""Columns of a table of scenes. Node id, sequence number and step are bits of unsigned numbers."""
TIME_NS: Final = STEP
"""Last column of a table of frames, which has no step."""
FRAME_COLUMNS: Final = TIME_NS + 1
SCENE_COLUMNS: Final = AT_NS + 1
FRAME: Final = 1
SCENE: Final = 2
"""Kinds of rows of `RowsRead`."""
_AT_ONCE: Final = 4096
_UNSIGNED: Final = (1 << 64) - 1


class Ref(msgspec.Struct, frozen=True, gc=False):
    """Position of a message in the files of a take, where it is read on demand.

    Attributes:
        part: index of the file, from 0.
        offset, length: position and size of the message's data in the file, in bytes.
        log_ns: log time of the message, on the server's clock.
    """

    part: int
    offset: int
    length: int
    log_ns: int


class FrameRef(msgspec.Struct, frozen=True, gc=False):
    """Position of a frame in the files of a take, and the frame's identity.

    Attributes:
        ref: position of the frame's message.
        sensor, node_id, sequence: sensor, node and sequence number of the frame.
        time_ns: capture time, on the sensor's own clock.
        run: number of the run during the frame's storage.
    """

    ref: Ref
    sensor: str
    node_id: int
    sequence: int
    time_ns: int
    run: int


class SceneRef(msgspec.Struct, frozen=True, gc=False):
    """Position of a scene in the files of a take, and the scene's identity.

    Attributes:
        ref: position of the scene's message.
        run: number of the run that made the scene.
        step: number of the scene in the run.
        at_ns: capture time of the scene's frame, on the server's clock.
        sensor, node_id, sequence: identity of the scene's frame.
    """

    ref: Ref
    run: int
    step: int
    at_ns: int
    sensor: str
    node_id: int
    sequence: int


class RowsRead(msgspec.Struct, frozen=True):
    """Frames and scenes that follow each other in a chunk.

    Attributes:
        rows: (n, `SCENE_COLUMNS`) in their order, with `FRAME` or `SCENE` as the part and no number of the run; sensors
            are indices of ``sensors``, and the step of a frame is its capture time.
        sensors: names of sensors, of which later rows have more.
        parts: number of parts of the scenes by the name of their type.
    """

    rows: Int64
    sensors: list[str]
    parts: dict[str, int]


class SensorNames:
    """Numbers for names of sensors, in the order of their first use."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._numbers: dict[str, int] = {}

    def number(self, name: str) -> int:
        """Return the number of a name; a new name gets the next one."""
        number = self._numbers.setdefault(name, len(self.names))
        if number == len(self.names):
            self.names.append(name)
        return number


class _Table:
    """Rows of whole numbers, which only grow."""

    def __init__(self, columns: int, sensors: SensorNames) -> None:
        self._sensors = sensors
        self._space = np.empty((_AT_ONCE, columns), np.int64)
        self._used = self._count = 0
        self._rows: list[Sequence[int]] = []

    def __len__(self) -> int:
        return self._count

    def append(self, row: Sequence[int]) -> None:
        """Add a row; unsigned numbers may have all their bits."""
        self._rows.append(row)
        self._count += 1

    def extend(self, block: Int64) -> None:
        """Add rows (n, columns)."""
        self._join()
        self._write(block)
        self._count += len(block)

    @property
    def array(self) -> Int64:
        """All rows (n, columns), read-only."""
        self._join()
        return self._space[: self._used]

    def _join(self) -> None:
        if self._rows:
            unsigned = np.array([[value & _UNSIGNED for value in row] for row in self._rows], np.uint64)
            self._write(unsigned.view(np.int64))
            self._rows = []

    def _write(self, block: Int64) -> None:
        end = self._used + len(block)
        if end > len(self._space):
            space = np.empty((max(end, 2 * len(self._space)), self._space.shape[1]), np.int64)
            space[: self._used] = self._space[: self._used]
            self._space = space
        self._space[self._used : end] = block
        self._used = end

    def _lists(self) -> Iterator[list[int]]:
        rows = self.array
        for begin in range(0, len(rows), _AT_ONCE):
            yield from rows[begin : begin + _AT_ONCE].tolist()


class FrameTable(_Table):
    """Positions and identities of frames, in the order of storage."""

    def __init__(self, sensors: SensorNames) -> None:
        super().__init__(FRAME_COLUMNS, sensors)

    def __getitem__(self, place: int) -> FrameRef:
        return self._ref(self.array[place].tolist())

    def __iter__(self) -> Iterator[FrameRef]:
        return map(self._ref, self._lists())

    def _ref(self, row: list[int]) -> FrameRef:
        part, offset, length, log_ns, sensor, node_id, sequence, run, time_ns = row
        ref, name = Ref(part, offset, length, log_ns & _UNSIGNED), self._sensors.names[sensor]
        return FrameRef(ref, name, node_id & _UNSIGNED, sequence & _UNSIGNED, time_ns, run)


class SceneTable(_Table):
    """Positions and identities of scenes, in the order of storage."""

    def __init__(self, sensors: SensorNames) -> None:
        super().__init__(SCENE_COLUMNS, sensors)

    def __getitem__(self, place: int) -> SceneRef:
        return self._ref(self.array[place].tolist())

    def __iter__(self) -> Iterator[SceneRef]:
        return map(self._ref, self._lists())

    def _ref(self, row: list[int]) -> SceneRef:
        part, offset, length, log_ns, sensor, node_id, sequence, run, step, at_ns = row
        ref, name = Ref(part, offset, length, log_ns & _UNSIGNED), self._sensors.names[sensor]
        return SceneRef(ref, run, step & _UNSIGNED, at_ns, name, node_id & _UNSIGNED, sequence & _UNSIGNED)
