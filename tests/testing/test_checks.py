"""The published checks pass for what Mocapella ships, and fail for each fault that they are for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import msgspec
import numpy as np
import pytest
from support.messages import hands_scene

from mocapella.errors import WireError
from mocapella.model import frame_types
from mocapella.model.frame_types import FRAME_TYPES, FrameType
from mocapella.model.observations import Arrival
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import topology
from mocapella.schema.envelope import ENVELOPE, seal, unseal
from mocapella.testing import Walker, check_frame_type, check_part_type, check_tracker, example_frames, walking_arrivals
from mocapella.tracker import make_tracker
from mocapella.tracker.protocol import TrackerReport, scene_at


@pytest.mark.parametrize("frame", example_frames(), ids=lambda frame: type(frame).__name__)
def test_an_example_of_each_shipped_frame_type_passes(frame: SensorFrame) -> None:
    check_frame_type(frame)


def test_there_is_an_example_of_each_shipped_frame_type() -> None:
    assert {type(frame) for frame in example_frames()} == {kind.type for kind in FRAME_TYPES.values()}


@pytest.mark.parametrize(("name", "part"), [(n, p) for n, parts in hands_scene().parts.items() for p in parts])
def test_shipped_parts_pass(name: str, part: Any) -> None:
    check_part_type(name, part, topology("hand"))


class Sample(SensorFrame, frozen=True, eq=False):
    """A frame of a plug-in."""

    value: float


def decode_sample(data: bytes) -> Sample:
    identity, content = unseal(data)
    try:
        return Sample(*identity, msgspec.msgpack.decode(content, type=float))
    except msgspec.DecodeError as error:
        raise WireError(str(error)) from error


SAMPLE = FrameType(
    interface=1,
    name="sample",
    type=Sample,
    encode=lambda frame: seal(frame, "sample", msgspec.msgpack.encode(frame.value)),
    decode=decode_sample,
    format=ENVELOPE,
)
FRAME = Sample("front", 1, 2, 3, 4, 36.5)


def damaging(data: bytes) -> Sample:
    identity, content = unseal(data)
    return Sample(*identity, msgspec.msgpack.decode(content, type=float))  # lets msgspec's error through


def forgetful(data: bytes) -> Sample:
    return Sample(*unseal(data)[0], 0.0)


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> Callable[[FrameType], None]:
    """Registers a frame type for one test."""

    def register(kind: FrameType) -> None:
        monkeypatch.setitem(FRAME_TYPES, kind.name, kind)
        monkeypatch.setattr(frame_types, "_BY_CLASS", {kind.type: kind})

    return register


def test_a_frame_type_of_a_plug_in_passes(registered: Callable[[FrameType], None]) -> None:
    registered(SAMPLE)
    check_frame_type(FRAME)


def test_a_frame_type_that_loses_a_value_fails(registered: Callable[[FrameType], None]) -> None:
    registered(replace(SAMPLE, decode=forgetful))
    with pytest.raises(AssertionError, match=r"Sample.value is 0.0 after decoding; it was 36.5"):
        check_frame_type(FRAME)


def test_a_frame_type_that_lets_another_error_through_fails(registered: Callable[[FrameType], None]) -> None:
    registered(replace(SAMPLE, decode=damaging))
    with pytest.raises(AssertionError, match=r"damaged bytes raise \w+ .*; WireError is wanted"):
        check_frame_type(FRAME)


def test_a_frame_whose_class_nobody_registers_fails() -> None:
    with pytest.raises(AssertionError, match="no frame type has the class Sample; registered: arms, "):
        check_frame_type(FRAME)


class Counting:
    """A tracker that counts frames; the fault is by the test."""

    def __init__(self) -> None:
        self.steps = 0

    def update(self, arrival: Arrival) -> Scene:
        self.steps += 1
        return scene_at(arrival, self.steps - 1, TrackerState(Phase.TRACKING, self.steps), {})

    def recalibrate(self, reason: str) -> None:
        pass

    def reset(self) -> None:
        self.steps = 0

    def snapshot(self) -> bytes:
        return msgspec.msgpack.encode(self.steps)

    def restore(self, data: bytes) -> None:
        try:
            self.steps = msgspec.msgpack.decode(data, type=int)
        except msgspec.DecodeError as error:
            self.reset()
            raise WireError(str(error)) from error

    @property
    def report(self) -> TrackerReport:
        return TrackerReport(self.steps, self.steps, {}, 0, 0)


class Moody(Counting):
    """Another result at each run: a state that the instances share."""

    runs: Iterator[int] = count()

    def update(self, arrival: Arrival) -> Scene:
        scene = super().update(arrival)
        return msgspec.structs.replace(scene, state=TrackerState(Phase.TRACKING, next(self.runs)))


class Stuck(Counting):
    def reset(self) -> None:
        pass


class Forgetful(Counting):
    def restore(self, data: bytes) -> None:
        super().restore(data)
        self.steps = min(self.steps, 1)


class Trusting(Counting):
    def restore(self, data: bytes) -> None:
        self.steps = msgspec.msgpack.decode(data, type=int)


class Careless(Counting):
    def restore(self, data: bytes) -> None:
        before = self.steps
        try:
            super().restore(data)
        except WireError:
            self.steps = before
            raise


class Boastful(Counting):
    @property
    def report(self) -> TrackerReport:
        return TrackerReport(self.steps, self.steps + 1, {}, 0, 0)


class Nameless(Counting):
    def update(self, arrival: Arrival) -> Scene:
        return msgspec.structs.replace(super().update(arrival), sequence=0)


ARRIVALS = walking_arrivals({1: Walker()}, 0.2)


def test_a_tracker_that_keeps_its_promises_passes() -> None:
    assert [scene.step for scene in check_tracker(Counting, ARRIVALS)] == list(range(len(ARRIVALS)))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (Moody, "a second tracker makes another scene at step 0"),
        (Stuck, r"the tracker after reset\(\) makes another scene at step 0"),
        (Forgetful, "a tracker restored from the snapshot at step 4 makes another scene at step 4"),
        (Trusting, "WireError is wanted"),
        (Careless, "does not reset the tracker that refuses it"),
        (Boastful, "the report has 12 frames, 13 kept and 0 rejected of 12 arrivals"),
        (Nameless, "scene 2 names another time or frame than its arrival's"),
    ],
)
def test_each_broken_promise_is_found(make: Callable[[], Any], says: str) -> None:
    with pytest.raises(AssertionError, match=says):
        check_tracker(make, ARRIVALS)


@pytest.mark.slow
def test_the_default_tracker_keeps_its_promises_and_tracks_a_walker() -> None:
    scenes = check_tracker(lambda: make_tracker("default", sensors_expected=2), walking_arrivals({1: Walker()}, 8.0))
    (person,) = scenes[-1].people
    assert [view.sensor for view in person.views] == ["front", "side"]


def test_the_parts_that_are_checked_are_of_registered_types() -> None:
    assert set(hands_scene().parts) <= set(PART_TYPES)
    assert np.isfinite(ARRIVALS[0].frame.positions).all()
