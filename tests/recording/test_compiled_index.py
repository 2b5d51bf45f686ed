"""Compiled kernels index a take as one message after the other is indexed, also a damaged one."""

from __future__ import annotations

import random
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.take_making import info, scene, small_take, unclosed_take, write_frame

from benchmarks._take_mutations import TakeMutations, write_example
from mocapella.errors import MocapellaError
from mocapella.recording import chunk_kernels, chunk_rows, take, take_index
from mocapella.recording.chunk_rows import ChunkRows
from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.mcap_scan import MalformedError, MessageRead, read_messages
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_refs import PART, SCENE, FrameTable, RowsRead, SensorNames
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_scene
from mocapella.schema import mocapella_pb2 as pb


def contents(path: Path, compiled: bool) -> object:
    """All that an index holds, or the error's text."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(take_index, "COMPILED_FROM_BYTES", 0 if compiled else 1 << 60)
        try:
            index = take_index.index_take([path])
        except MocapellaError as error:
            return str(error)
    nodes = {key: (ledger.row(*key), ledger.received(), ledger.stored) for key, ledger in index.nodes.items()}
    found = [index.frame_of(one) for one in index.scenes]
    return (
        list(index.frames), list(index.scenes), found, index.problems, index.parts, index.others, index.commands, nodes,
        index.first_ns, index.last_ns, index.clean, index.damaged_parts, [run.number for run in index.runs],
    )  # fmt: skip


def check(path: Path) -> None:
    assert contents(path, compiled=True) == contents(path, compiled=False)


@pytest.fixture(scope="module")
def mutations(tmp_path_factory: pytest.TempPathFactory) -> TakeMutations:
    return TakeMutations(write_example(tmp_path_factory.mktemp("seed") / "seed.mcap"))


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_contents_are_indexed_alike(
    seed: int, mutations: TakeMutations, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "a.mcap"
    mutations.write(path, random.Random(seed))
    check(path)


@pytest.fixture(scope="module")
def unchecked(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A take that was not closed, whose chunks have no checksum."""
    path = unclosed_take(tmp_path_factory.mktemp("takes") / "unclosed.mcap", count=8)
    data = bytearray(path.read_bytes())
    at = len(MAGIC)
    while at + 9 <= len(data):
        if data[at] == 6:
            data[at + 9 + 24 : at + 9 + 28] = bytes(4)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return bytes(data)


@settings(deadline=None, max_examples=150)
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8))
def test_damaged_records_are_indexed_alike(
    changes: list[tuple[float, int]], unchecked: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data = bytearray(unchecked)
    for place, value in changes:
        data[min(len(data) - 1, int(place * len(data)))] = value
    path = tmp_path_factory.mktemp("damaged") / "a.mcap"
    path.write_bytes(data)
    check(path)


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def channel(number: int, topic: str) -> bytes:
    text = topic.encode()
    return record(4, struct.pack("<HHI", number, 0, len(text)) + text + struct.pack("<II", 0, 0))


def message(number: int, data: bytes = b"", log_ns: int = 7) -> bytes:
    return record(5, struct.pack("<HIQQ", number, 0, log_ns, log_ns) + data)


@pytest.mark.parametrize(
    "data",
    [
        message(1),  # of no channel
        channel(1, "/a") + message(1)[:-1],
        channel(1, "/a") + record(5, bytes(21)),
        channel(1, "/a") + b"\x05",
        channel(1, "/a")[:-1],
        record(4, b"\x01"),
        struct.pack("<BQ", 5, 2**64 - 1),
    ],
)
def test_records_that_do_not_fit_are_malformed(data: bytes) -> None:
    for read in (ChunkRows(), read_messages):
        with pytest.raises((MalformedError, struct.error)):
            list(read(memoryview(data), 0, {}))  # type: ignore[operator]


@pytest.mark.parametrize("most", [chunk_rows._MOST_DESCRIBED, 0])
def test_a_channel_that_is_described_anew_has_the_new_topic(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunk_rows, "_MOST_DESCRIBED", most)
    topics = {1: "/a"}
    reader = ChunkRows()
    for text in ("/b", "/c", "/b"):
        (found,) = reader(memoryview(channel(1, text) + message(1)), 0, topics)
        assert isinstance(found, MessageRead)
        assert found.topic == text
    topics[1] = "/d"  # between two chunks
    for data, text in ((message(1), "/d"), (channel(1, "/b") + message(1), "/b")):
        (found,) = reader(memoryview(data), 0, topics)
        assert isinstance(found, MessageRead)
        assert found.topic == text


def test_many_messages_of_many_sensors_in_one_chunk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """More messages than a table's first rows, and more sensors than kernels tell apart."""
    monkeypatch.setattr(chunk_rows, "_ROWS_AT_FIRST", 4)
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    for k in range(chunk_rows._MOST_NAMES + 9):
        name = "s" * k or "0"
        write_frame(writer, name[:64], 1000 * (k > 64) + k, k)
        writer.write_scene(encode_scene(scene(k, name[:64], 1000 * (k > 64) + k)), k)
    writer.close()
    check(tmp_path / "a.mcap")
    assert read_take(tmp_path / "a.mcap").scene_count == chunk_rows._MOST_NAMES + 9


def test_a_frame_that_is_there_twice_and_a_step_back_are_told(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    for k in (0, 1, 1, 3):
        write_frame(writer, "front", k, k)
        writer.write_scene(encode_scene(scene(min(k, 2), "front", 2 * k)), k)
    writer.close()
    check(tmp_path / "a.mcap")


def test_a_sensor_of_another_alphabet_is_read(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    data = pb.BodyFrame(schema_version=1, sensor="küche", sequence=0).SerializeToString()
    writer.write_frame(data, sensor="front", node_id=1, sequence=0, log_ns=1)
    writer.close()
    check(tmp_path / "a.mcap")
    assert [one.sensor for one in take_index.index_take([tmp_path / "a.mcap"]).frames] == ["küche"]


def test_a_single_part_that_is_there_twice_counts_once(tmp_path: Path) -> None:
    """As in protobuf, which merges the two."""
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    twice = pb.Scene(points=pb.Points(names=["a"])).SerializeToString() * 2
    write_frame(writer, "front", 0, 0)
    writer.write_scene(encode_scene(scene(0, "front", 0)) + twice, 1)
    writer.close()
    check(tmp_path / "a.mcap")


def test_a_usual_take_is_indexed_by_the_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by protobuf, message by message: else they would be of no use."""
    path = small_take(tmp_path / "a.mcap", count=8)
    events: list[Any] = []
    with path.open("rb") as file:
        from mocapella.recording.mcap_scan import scan

        events = list(scan(file, path.stat().st_size, "a", ChunkRows()))
    topics = {event.topic for event in events if isinstance(event, MessageRead)}
    assert not {topic for topic in topics if topic == take.SCENES or topic.startswith(take.FRAMES)}
    rows = np.concatenate([event.rows for event in events if isinstance(event, RowsRead)])
    assert (rows[:, PART] == SCENE).sum() == read_take(path).scene_count


def test_rows_that_wait_are_added_before_there_are_too_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take_index, "_CHUNKS_AT_ONCE", 1)
    check(small_take(tmp_path / "a.mcap", count=8))


def test_a_table_grows() -> None:
    table = FrameTable(SensorNames())
    blocks = np.arange(9 * 10_000, dtype=np.int64).reshape(4, 2500, 9)
    for block in blocks:
        table.extend(block)
    np.testing.assert_array_equal(table.array, blocks.reshape(-1, 9))


def test_descriptions_that_alternate_take_no_growing_memory() -> None:
    reader = ChunkRows()
    for k in range(40):
        list(reader(memoryview(channel(1, f"/{k}" + "x" * 9000) + message(1)), 0, {}))
        assert len(reader._described) <= chunk_rows._MOST_DESCRIBED + 10_000


@given(st.lists(st.tuples(st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1)), max_size=9), st.integers(0, 9))
def test_a_table_gives_the_frames_back(rows: list[tuple[int, int]], cut: int) -> None:
    sensors = SensorNames()
    table, whole = (
        FrameTable(sensors),
        [(0, k, 5, 6, sensors.number("ab"[k % 2]), *row, 1, 9) for k, row in enumerate(rows)],
    )
    for row in whole[:cut]:
        table.append(row)
    block = np.array([[value % 2**64 for value in row] for row in whole[cut:]], np.uint64).reshape(-1, 9)
    table.extend(block.view(np.int64))
    assert len(table) == len(rows)
    found = [(one.ref.part, one.ref.offset, one.sensor, one.node_id, one.sequence) for one in table]
    assert found == [(0, k, "ab"[k % 2], *row) for k, row in enumerate(rows)]
    assert [table[k] for k in range(len(rows))] == list(table)


def test_the_columns_of_kernels_and_tables_are_the_same() -> None:
    assert (chunk_kernels.KIND, chunk_kernels.CHANNEL) == (take_index.PART, take_index.RUN)
