"""Law: whatever the decoder accepts, each method's tracker takes; so do the registry, the summary and the encoder."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from itertools import islice
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import WireError
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.live.summary import RunSummary
from mocapella.model.limits import COORDINATE, FRAME_HEIGHT, TILT
from mocapella.model.observations import Arrival
from mocapella.model.session import Setup
from mocapella.schema import decode_frame, decode_scene, encode_frame, encode_scene
from mocapella.schema import mocapella_pb2 as pb
from mocapella.testing.frames import example_frames
from mocapella.tracker import METHODS
from mocapella.tracker.protocol import Tracker
from mocapella.wire.keys import NodeKey

NUMBERS = (*(end for limit in (TILT, FRAME_HEIGHT, COORDINATE) for end in (limit.low, limit.high)),
           0.0, 1e-300, 1.0, 1.7, -1.7, 12.0, np.nan)  # fmt: skip
"""Values at and beside the limits; those out of range are refused by the decoder."""
INTEGERS = (0, 1, 2, 65535, 2**31, 2**53 + 1, 2**63 - 1, -1, -(2**31), -(2**63), 2**64 - 1)
MESSAGES = {"BodyFrame": pb.BodyFrame, "MarkerFrame": pb.MarkerFrame, "PoseFrame": pb.PoseFrame,
            "ArmFrame": pb.ArmFrame, "ImageFrame": pb.ImageFrame, "DepthFrame": pb.DepthFrame,
            "KeypointFrame": pb.KeypointFrame}  # fmt: skip
IDENTITY = ("schema_version", "sensor", "node_id", "sequence")
FRAMES = 12

Message = tuple[str, bytes]
"""A message's class, and its bytes."""


def tracker_of(method: str) -> Tracker:
    practice = METHODS[method].warm_up_run
    return METHODS[method].make({}, 1, {}) if practice is None else practice()[0]


@cache
def messages_of(method: str) -> tuple[Message, ...]:
    """Messages that the method's tracker can use, of several sensors, and some of each other frame type."""
    practice = METHODS[method].warm_up_run or METHODS["default"].warm_up_run
    assert practice is not None
    frames: list[Any] = [arrival.frame for arrival in islice(practice()[1], FRAMES)]
    for k in range(3):
        frames += example_frames(f"x{k % 2}", node_id=1, sequence=k, time_ns=1 + 33_000_000 * k)
    sequences: dict[str, int] = {}
    for i, frame in enumerate(frames):
        sequences[frame.sensor] = sequences.get(frame.sensor, -1) + 1
        frames[i] = msgspec.structs.replace(frame, node_id=1, sequence=sequences[frame.sensor], sent_ns=1)
    return tuple((type(frame).__name__, encode_frame(frame)) for frame in frames)


def changed(before: Message, field: int, value: int, place: int) -> Message:
    """The message with another value in one field, also of its first arm."""
    message = MESSAGES[before[0]].FromString(before[1])
    part, fields = message, [each for each in message.DESCRIPTOR.fields if each.name not in IDENTITY]
    one = fields[field % len(fields)]
    if one.message_type is not None and len(getattr(message, one.name)):
        part, fields = getattr(message, one.name)[0], list(one.message_type.fields)
        one = fields[place % len(fields)]
    try:
        _set(part, one, value, place)
    except (ValueError, TypeError, AttributeError, OverflowError):  # the field cannot have this value
        return before
    return before[0], message.SerializeToString()


def _set(part: Any, one: Any, value: int, place: int) -> None:
    if one.type == one.TYPE_BYTES:
        setattr(part, one.name, _array(getattr(part, one.name), one.name, value, place))
    elif one.type in (one.TYPE_DOUBLE, one.TYPE_FLOAT):
        setattr(part, one.name, NUMBERS[value % len(NUMBERS)])
    elif one.type == one.TYPE_STRING:
        setattr(part, one.name, ("", "x", "kinect_v1", "\x1b[31m\u202e")[value % 4])
    else:
        setattr(part, one.name, INTEGERS[value % len(INTEGERS)])


def _array(data: bytes, name: str, value: int, place: int) -> bytes:
    """Packed values with one, every other or all of them replaced."""
    if name in ("image", "depth"):
        return data[: place % (len(data) + 1)]
    whole = name.endswith(("ids", "states", "tracked", "edges", "cameras"))
    dtype = np.uint64 if name == "tracking_ids" else np.uint8 if whole else None
    if dtype is None:
        dtype = np.float64 if name in ("points_m", "angles_rad", "T_camera_palm", "lens") else np.float32
    values = np.frombuffer(data, dtype).copy()
    if not len(values):
        return data
    new: Any = (
        INTEGERS[value % len(INTEGERS)] % 2**64
        if dtype == np.uint64
        else value % 4
        if whole
        else NUMBERS[value % len(NUMBERS)]
    )
    kind, at = place % 3, place // 3 % len(values)
    values[at : at + 1 if kind == 0 else None : 1 if kind == 0 else kind] = new
    return values.tobytes()


def feed(tracker: Tracker, messages: Iterable[bytes]) -> int:
    """Process messages as the server does; return how many the decoder has accepted."""
    registry, summary, now_ns, accepted = SensorRegistry(), RunSummary(), 0, 0
    for message in messages:
        now_ns += 11_000_000
        try:
            frame = decode_frame(message)
            node = NodeKey(frame.sensor, frame.node_id)
            assert registry.admit(node, now_ns) == ""
            at_ns = registry.arrived(frame, node, now_ns)
        except WireError:
            continue
        accepted += 1
        scene = tracker.update(Arrival(frame, at_ns))
        decode_scene(encode_scene(scene))
        summary.scene(scene, registry.finished(node, frame.sent_ns, now_ns), now_ns)
    assert tracker.snapshot()
    registry.health(now_ns, Setup(), {}, {})
    return accepted


@pytest.mark.parametrize(
    "method",
    [pytest.param(name, marks=[pytest.mark.slow] if name == "silhouettes" else []) for name in sorted(METHODS)],
)
@settings(max_examples=12, report_multiple_bugs=False)
@given(data=st.data())
def test_what_the_decoder_accepts_the_tracker_takes(method: str, data: st.DataObject) -> None:
    messages = list(messages_of(method))
    changes = st.lists(st.tuples(*(st.integers(0, 1000) for _ in range(4))), min_size=1, max_size=8)
    for which, field, value, place in data.draw(changes):
        messages[which % len(messages)] = changed(messages[which % len(messages)], field, value, place)
    feed(tracker_of(method), (message for _, message in messages))


@pytest.mark.parametrize("method", sorted(METHODS))
def test_the_tracker_takes_every_field_at_and_beside_its_limits(method: str) -> None:
    """One change a frame, of every field to every value; times are changed last, because they may not go back."""
    by_class = {kind: (kind, data) for kind, data in reversed(messages_of(method))}
    tracker, sweep = tracker_of(method), list[Message]()
    for message in by_class.values():
        values = max(len(NUMBERS), len(INTEGERS))
        sweep += [changed(message, field, k, place) for field in range(16) for k in range(values) for place in (0, 1)]
    sweep.sort(key=lambda message: abs(MESSAGES[message[0]].FromString(message[1]).time_ns) > 10**12)
    accepted = feed(tracker, (_renumbered(message, k + 100) for k, message in enumerate(dict.fromkeys(sweep))))
    assert accepted > 40 * len(by_class)


def _renumbered(message: Message, sequence: int) -> bytes:
    frame = MESSAGES[message[0]].FromString(message[1])
    frame.sequence = sequence
    if abs(frame.time_ns) <= 10**12:
        frame.time_ns = 11_000_000 * sequence
    return bytes(frame.SerializeToString())


def test_the_frames_of_this_test_reach_the_trackers() -> None:
    """Otherwise the law would hold of nothing."""
    for method in METHODS:
        tracker, messages = tracker_of(method), messages_of(method)
        for frame in (decode_frame(message) for _, message in messages):
            tracker.update(Arrival(frame, frame.time_ns))
        assert tracker.report.kept >= 3, method
    assert any(changed(message, 0, 0, 0) != message for message in messages)
