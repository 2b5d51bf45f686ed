"""Frames, scenes and takes for the tests of recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, TrackerState
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene

KIND = topology("kinect_v2")
SECOND = 1_000_000_000
STEP = SECOND // 30


def info(started_ns: int = 0, **settings: Any) -> TakeInfo:
    return TakeInfo(
        setup=Setup("stand-still", sensors_expected=2, participant=7, placement="right-90", scenario="walk"),
        started_unix_ns=1_700_000_000 * SECOND + started_ns,
        started_ns=started_ns,
        method_settings=settings or {"frames": 120},
    )


def frame(sensor: str, sequence: int, node_id: int = 1, bodies: int = 1) -> BodyFrame:
    random = np.random.default_rng(sequence)
    return body_frame(
        sensor,
        KIND,
        time_ns=sequence * STEP,
        positions=random.normal(size=(bodies, len(KIND), 3)),
        node_id=node_id,
        sequence=sequence,
        sent_ns=sequence * STEP + 5,
    )


def frame_bytes(sensor: str, sequence: int, node_id: int = 1, bodies: int = 1) -> bytes:
    return encode_frame(frame(sensor, sequence, node_id, bodies))


def scene(step: int, sensor: str, sequence: int, node_id: int = 1, people: int = 1) -> Scene:
    """A scene that could have been made of `frame(sensor, sequence, node_id)` at ``at_ns = step * STEP + 3``."""
    points = np.random.default_rng(step).normal(size=(len(KIND), 3))
    states = np.full(len(KIND), 2, np.uint8)
    view = PotentialSkeleton(sensor, 5, sequence * STEP, 0.0, 1.0, np.eye(4), points, states)
    everyone = tuple(Person(i, points, states, (view,)) for i in range(people))
    return Scene(
        step, step * STEP + 3, sensor, node_id, sequence, KIND, TrackerState(Phase.TRACKING), {"people": everyone}
    )


def scene_bytes(step: int, sensor: str, sequence: int, node_id: int = 1) -> bytes:
    return encode_scene(scene(step, sensor, sequence, node_id))


def write_frame(writer: TakeWriter, sensor: str, sequence: int, log_ns: int, node_id: int = 1) -> bool:
    data = frame_bytes(sensor, sequence, node_id)
    return writer.write_frame(data, sensor=sensor, node_id=node_id, sequence=sequence, log_ns=log_ns)


def record(writer: TakeWriter, first: int, count: int, *, step: int = 0, per_flush: int = 4) -> None:
    """Two sensors' frames ``first``…, each tracked, one flush after every ``per_flush`` of them."""
    for i in range(count):
        log_ns = (first + i) * STEP
        for sensor in ("front", "side"):
            write_frame(writer, sensor, first + i, log_ns)
            writer.write_scene(scene_bytes(step, sensor, first + i), log_ns + 1)
            step += 1
        if (i + 1) % per_flush == 0:
            writer.flush()


def small_take(path: Path, count: int = 12) -> Path:
    """A clean take of two sensors."""
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, count)
    writer.close()
    return path


def unclosed_take(path: Path, count: int = 12) -> Path:
    """What a killed server leaves: everything flushed, no end."""
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, count)
    size = writer.size_bytes
    writer.close()
    data = path.read_bytes()[:size]
    path.write_bytes(data)
    return path


def keys(take: Any, sensor: str | None = None) -> list[tuple[str, int, int]]:
    return [stored.frame.key for stored in take.frames(sensor)]
