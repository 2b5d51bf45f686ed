"""List the messages of a take's chunks by compiled kernels, faster than one by one. Importing imports numba."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.recording import take
from mocapella.recording.chunk_kernels import (
    CHANNEL_NEXT,
    DONE,
    FULL,
    KIND,
    LONGEST_NAME,
    MALFORMED,
    NEW_SENSOR,
    PLAIN,
    UNKNOWN,
    list_messages,
)
from mocapella.recording.mcap_scan import MalformedError, MessageRead, read_channel
from mocapella.recording.take_refs import FRAME, LENGTH, OFFSET, SCENE, SCENE_COLUMNS, RowsRead
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.scenes import part_fields
from mocapella.schema.wire_kernels import FIELDS
from mocapella.schema.wire_shapes import shapes_of

Int64 = NDArray[np.int64]

_MOST_NAMES: Final = 64
_ROWS_AT_FIRST: Final = 1024
_MOST_DESCRIBED: Final = 1 << 16
"""Size of the remembered descriptions of channels above which they are forgotten [bytes]."""
_KINDS: Final = (pb.BodyFrame, pb.Scene)
_FIELDS: Final = (
    ("sensor", "node_id", "sequence", "time_ns", "", "", ""),
    ("sensor", "node_id", "sequence", "step", "at_ns", "parts", "points"),
)


class ChunkRows:
    """Lists the messages of the chunks of one file; `mocapella.recording.mcap_scan.scan` calls it for each chunk."""

    def __init__(self) -> None:
        self._shapes = shapes_of(*_KINDS)
        self._wanted = np.array(
            [[_number(kind, name) for name in names] for kind, names in zip(_KINDS, _FIELDS, strict=True)]
        )
        self._names = np.zeros((_MOST_NAMES, LONGEST_NAME), np.uint8)
        self._sizes = np.zeros(_MOST_NAMES, np.int64)
        self._sensors: list[str] = []
        self._topics: dict[int, str] = {}
        self._channels = np.full(1 << 16, UNKNOWN, np.int8)
        self._places = np.zeros((1 << 16, 2), np.int64)
        self._described = np.empty(0, np.uint8)
        self._rows = np.empty((_ROWS_AT_FIRST, SCENE_COLUMNS), np.int64)

    def __call__(self, data: memoryview, base: int, topics: dict[int, str]) -> Iterator[MessageRead | RowsRead]:
        """Yield a chunk's messages, frames and scenes that follow each other together; add its channels to ``topics``.

        Raises:
            MalformedError: a record does not fit, or a message's channel is unknown.
        """
        if topics != self._topics:  # channels were described between the chunks
            self._places[:] = 0
            for channel, topic in topics.items():
                self._channels[channel] = _kind(topic)
        bytes_ = np.frombuffer(data, np.uint8)
        parts = np.zeros(FIELDS, np.int64)
        at, count, why = 0, 0, CHANNEL_NEXT
        while why != DONE:
            at, count, why = list_messages(
                bytes_, at, self._channels, self._places, self._described, self._shapes, self._wanted, self._names,
                self._sizes, len(self._sensors), count, self._rows, parts,
            )  # fmt: skip
            if why == MALFORMED:
                raise MalformedError
            if why == FULL:
                self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
            elif why == CHANNEL_NEXT:
                found, end = read_channel(data, at)
                topics[found.id] = found.topic
                self._channels[found.id] = _kind(found.topic)
                self._remember(found.id, bytes_[at:end])
                at = end
            elif why == NEW_SENSOR:
                begin, length = self._rows[count, OFFSET], self._rows[count, LENGTH]
                self._learn(bytes_[begin : begin + length])
        self._topics = dict(topics)
        yield from self._events(data, base, topics, self._rows[:count].copy(), parts)

    def _events(
        self, data: memoryview, base: int, topics: dict[int, str], rows: Int64, parts: Int64
    ) -> Iterator[MessageRead | RowsRead]:
        numbers = {name: int(parts[field]) for name, field in part_fields().items() if parts[field]}
        begin = 0
        for at in [*np.flatnonzero((rows[:, KIND] != FRAME) & (rows[:, KIND] != SCENE)).tolist(), len(rows)]:
            if at > begin:
                rows[begin:at, OFFSET] += base
                yield RowsRead(rows[begin:at], self._sensors, numbers)
                numbers = {}
            if at < len(rows):
                _, offset, length, log_ns, _, _, _, channel, _, _ = rows[at].view(np.uint64).tolist()
                content = bytes(data[offset : offset + length])
                yield MessageRead(topics[channel], 0, log_ns, log_ns, base + offset, content)
            begin = at + 1

    def _remember(self, channel: int, description: NDArray[np.uint8]) -> None:
        """Remember a channel's description, so that its repetitions are skipped; forget all if there are many."""
        if len(self._described) > _MOST_DESCRIBED:
            self._places[:], self._described = 0, self._described[:0]
        self._places[channel] = len(self._described), len(description)
        self._described = np.concatenate([self._described, description])

    def _learn(self, name: NDArray[np.uint8]) -> None:
        place = len(self._sensors)
        self._names[place, : len(name)], self._sizes[place] = name, len(name)
        self._sensors.append(name.tobytes().decode())


def _kind(topic: str) -> int:
    if topic.startswith(take.FRAMES):
        return FRAME
    return SCENE if topic == take.SCENES else PLAIN


def _number(kind: type[pb.BodyFrame] | type[pb.Scene], name: str) -> int:
    field = kind.DESCRIPTOR.fields_by_name.get(name)
    return 0 if field is None else field.number
