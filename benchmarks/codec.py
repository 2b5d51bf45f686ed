"""Cost of a message with 6 bodies × 25 joints, and the effect of a million damaged ones.

The peers do the same work with the same arrays: JSON with lists, and protobuf with a message a joint. Neither validates
its input; ours does.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
import psutil
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from benchmarks._mutations import mutated
from benchmarks.harness import Row, against_peer, at_most, measured
from mocapella.errors import WireError
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, TrackerState
from mocapella.model.topology import topology
from mocapella.model.truth import Truth
from mocapella.schema import decode_frame, decode_scene, decode_truth, encode_frame, encode_scene, encode_truth

BODIES: Final = 6
MAX_MICROSECONDS: Final = 5
MAX_GROWTH_MIB: Final = 64
SEED: Final = 7


def run(quick: bool = False) -> list[Row]:
    repeat, number = (3, 200) if quick else (15, 2000)
    rows = []
    for what, frame in frames().items():
        data = encode_frame(frame)
        text = json_of(frame)
        timed = partial(
            against_peer, goal=at_most(MAX_MICROSECONDS), repeat=repeat, number=number, peer_number=number // 20
        )
        rows += [
            timed(f"codec: encode, {what}", partial(encode_frame, frame), partial(json_of, frame), "json"),
            timed(f"codec: decode, {what}", partial(decode_frame, data), partial(of_json, text), "json"),
        ]
    skeleton = frames()["skeleton"]
    nested = Nested()
    data, peer_data = encode_frame(skeleton), nested.encode(skeleton)
    timed = partial(against_peer, repeat=repeat, number=number, peer_number=number // 10)
    peer = "nested protobuf"
    rows += [
        timed(
            f"codec: encode, against {peer}", partial(encode_frame, skeleton), partial(nested.encode, skeleton), peer
        ),
        timed(f"codec: decode, against {peer}", partial(decode_frame, data), partial(nested.decode, peer_data), peer),
    ]
    return rows + damaged_messages(30_000 if quick else 1_000_000)


def frames() -> dict[str, BodyFrame]:
    """Six bodies: only the skeletons; with some joints not tracked; with depth points and orientations; all of it."""
    rng = np.random.default_rng(SEED)
    kind = topology("kinect_v2")
    shape = (BODIES, len(kind))
    positions = rng.uniform((-2, -1, 1), (2, 1, 4), (*shape, 3))
    depth_px = rng.uniform(0, (512, 424), (*shape, 2))
    orientations = rng.normal(size=(*shape, 4))
    orientations /= np.linalg.norm(orientations, axis=-1, keepdims=True)
    all_tracked = np.full(shape, 2, np.uint8)
    some_missing = np.where(rng.random(shape) < 0.15, 0, all_tracked)
    skeleton = partial(body_frame, "front", kind, time_ns=1_234_567_890, positions=positions, depth_size_px=(512, 424))
    full = partial(skeleton, depth_px=depth_px, orientations=orientations)
    return {
        "skeleton": skeleton(states=all_tracked),
        "skeleton, 15 % of joints missing": skeleton(states=some_missing),
        "skeleton, depth, orientations": full(states=all_tracked),
        "all of it, 15 % of joints missing": full(states=some_missing),
    }


ARRAYS: Final = {
    "tracking_ids": np.uint64,
    "tracked": np.bool_,
    "clipped_edges": np.uint8,
    "states": np.uint8,
    "positions": np.float32,
    "depth_px": np.float32,
    "orientations": np.float32,
}


def json_of(frame: BodyFrame) -> str:
    """The same frame as JSON, which has numbers in lists."""
    values: dict[str, Any] = {
        "schema_version": 1,
        "sensor": frame.sensor,
        "node_id": frame.node_id,
        "sequence": frame.sequence,
        "time_ns": frame.time_ns,
        "topology": frame.topology.name,
        "depth_size_px": frame.depth_size_px,
        "tilt": frame.tilt,
        "height": frame.height,
    }
    for name in ARRAYS:
        array = getattr(frame, name)
        values[name] = None if array is None else array.tolist()
    return json.dumps(values)


def of_json(text: str) -> dict[str, Any]:
    """The arrays of a frame that `json_of` wrote."""
    values: dict[str, Any] = json.loads(text)
    for name, dtype in ARRAYS.items():
        if values[name] is not None:
            values[name] = np.array(values[name], dtype)
    return values


class Nested:
    """The usual use of protobuf: a message for every joint."""

    def __init__(self) -> None:
        file = descriptor_pb2.FileDescriptorProto(name="nested_peer.proto", package="nested_peer", syntax="proto3")
        field = descriptor_pb2.FieldDescriptorProto
        scalars = {
            "Joint": [("state", field.TYPE_UINT32), *((axis, field.TYPE_FLOAT) for axis in "xyz")],
            "Body": [("tracking_id", field.TYPE_UINT64)],
            "Frame": [("sensor", field.TYPE_STRING), ("sequence", field.TYPE_UINT64), ("time_ns", field.TYPE_INT64)],
        }
        for name, fields in scalars.items():
            message = file.message_type.add(name=name)
            for i, (label, kind) in enumerate(fields, 1):
                message.field.add(name=label, number=i, type=kind, label=field.LABEL_OPTIONAL)
        for parent, (label, child) in {1: ("joints", "Joint"), 2: ("bodies", "Body")}.items():
            file.message_type[parent].field.add(
                name=label,
                number=15,
                type=field.TYPE_MESSAGE,
                label=field.LABEL_REPEATED,
                type_name=f"nested_peer.{child}",
            )
        pool = descriptor_pool.DescriptorPool()
        pool.AddSerializedFile(file.SerializeToString())
        self.frame = message_factory.GetMessageClass(pool.FindMessageTypeByName("nested_peer.Frame"))

    def encode(self, frame: BodyFrame) -> bytes:
        message = self.frame(sensor=frame.sensor, sequence=frame.sequence, time_ns=frame.time_ns)
        positions, states = frame.positions.tolist(), frame.states.tolist()
        for body, tracking_id in enumerate(frame.tracking_ids.tolist()):
            joints = message.bodies.add(tracking_id=tracking_id).joints
            for (x, y, z), state in zip(positions[body], states[body], strict=True):
                joints.add(x=x, y=y, z=z, state=state)
        data: bytes = message.SerializeToString()
        return data

    def decode(self, data: bytes) -> tuple[np.ndarray, np.ndarray]:
        bodies = self.frame.FromString(data).bodies
        positions = [[(j.x, j.y, j.z) for j in body.joints] for body in bodies]
        states = [[j.state for j in body.joints] for body in bodies]
        return np.array(positions, np.float32), np.array(states, np.uint8)


def damaged_messages(count: int) -> list[Row]:
    """Feed damaged messages to the three decoders; anything but a valid value or a `WireError` is a crash."""
    decoders: list[tuple[list[bytes], Callable[[bytes], Any], int]] = [
        ([encode_frame(frame) for frame in frames().values()], decode_frame, count * 8 // 10),
        ([encode_scene(scene())], decode_scene, count // 10),
        ([encode_truth(truth())], decode_truth, count // 10),
    ]
    crashes = accepted = fed = 0
    process = psutil.Process()
    before = most = process.memory_info().rss
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for messages, decode, share in decoders:
            for data in mutated(messages, share, SEED):
                fed += 1
                try:
                    value = decode(data)
                except WireError:
                    continue
                except Exception as error:  # noqa: BLE001  counted here
                    crashes += 1
                    print(f"{decode.__name__}: {type(error).__name__}: {error}: {data[:80]!r}")
                    continue
                accepted += 1
                crashes += isinstance(value, BodyFrame) and not is_sound(value)
                if fed % 1000 == 0:
                    most = max(most, process.memory_info().rss)
    most = max(most, process.memory_info().rss)
    return [
        measured(f"codec: crashes in {fed:,} damaged messages", crashes, "crashes", goal=at_most(0)),
        measured("codec: of these still valid", 100 * accepted / fed, "%"),
        measured("codec: memory grown meanwhile", (most - before) / 2**20, "MiB", goal=at_most(MAX_GROWTH_MIB)),
    ]


def is_sound(frame: BodyFrame) -> bool:
    """What a decoded frame promises: NaN where not tracked, finite and in the room elsewhere."""
    seen = frame.states != 0
    return bool(np.isnan(frame.positions[~seen]).all() and (np.abs(frame.positions[seen]) <= 1000).all())


def scene() -> Scene:
    kind = topology("kinect_v2")
    rng = np.random.default_rng(SEED)
    states = np.full(len(kind), 2, np.uint8)
    positions = rng.normal(size=(len(kind), 3))
    view = PotentialSkeleton("front", 7, 1, 0.1, 1.2, np.eye(4), positions, states)
    state = TrackerState(Phase.TRACKING)
    return Scene(
        3,
        10,
        "front",
        1,
        2,
        kind,
        state,
        {"people": tuple(Person(i, positions, states, (view, view)) for i in range(2))},
    )


def truth() -> Truth:
    kind = topology("kinect_v2")
    positions = np.random.default_rng(SEED).normal(size=(2, len(kind), 3))
    people = np.arange(2)
    return Truth("front", 2, 5, kind, people, positions, np.eye(4), people[::-1].copy(), np.array([True, False]))
