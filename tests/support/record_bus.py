"""A recording service beside one node, without a bus: for tests of the record path."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryFile

import msgspec
import numpy as np
from support.programs import wait_until

from mocapella.live.recorder import Recorder
from mocapella.live.recording_service import RecordingService
from mocapella.live.session import Session
from mocapella.model.observations import body_frame
from mocapella.model.session import RecordingHealth, Setup
from mocapella.model.topology import topology
from mocapella.schema import encode_frame
from mocapella.wire.delivery import FrameAnswer, FrameRequest
from mocapella.wire.keys import NodeKey
from mocapella.wire.outbox import Outbox
from mocapella.wire.server import OnFrame

NODE = NodeKey("front", 1)
POSITIONS = np.random.default_rng(0).normal(size=(1, 25, 3)).astype(np.float32)


class Bus:
    """In place of the bus and of one node: hands requests to the node's outbox while the node is connected."""

    def __init__(self) -> None:
        self.outbox = Outbox(1000)
        self.connected: list[NodeKey] = [NODE]
        self.served = 0
        self.may_answer = threading.Event()
        self.may_answer.set()

    def request_frames(
        self,
        node: NodeKey,
        request: FrameRequest,
        on_frame: OnFrame,
        on_answer: Callable[[FrameAnswer], None],
        on_end: Callable[[], None],
    ) -> None:
        if self.may_answer.wait(30.0):
            answer, gone = self.outbox.update(request, time.monotonic_ns()), dict[tuple[int, int], str]()
            for data in self.outbox.wanted(request, gone):
                on_frame(node, data, time.monotonic_ns())
                self.served += 1
            on_answer(msgspec.structs.replace(answer, gone=list(gone)))
        on_end()


class Harness:
    """A harness, and what it was heard to say."""

    def __init__(self) -> None:
        self.bus = Bus()
        self.said: list[str] = []
        self.service = RecordingService(
            Session(Setup()), self.bus, lambda: self.bus.connected, self.said.append, reserve_bytes=0
        )

    @property
    def recorder(self) -> Recorder:
        assert self.service.recorder is not None
        return self.service.recorder

    def begin(self, path: Path) -> None:
        """Begin a take, and wait until the node has heard of it: only frames sent from then on are surely in it."""
        self.service.begin(path)
        take = self.recorder.take_id
        wait_until("the node hears of the take", lambda: take in self.bus.outbox.holds)

    def kill(self) -> Callable[[], None]:
        """Forget the recorder, as a kill does; return what ends its threads, and writes nothing."""
        recorder, path = self.recorder, self.service._record_path
        assert path is not None
        path.finish(0.0)
        writer = recorder._writer
        with TemporaryFile() as nowhere:  # who was killed neither writes nor holds a lock any more
            for fd in (writer._fd, writer._lock_fd):
                if fd is not None:
                    os.dup2(nowhere.fileno(), fd)
        self.service.recorder = self.service._record_path = None
        self.service._health = RecordingHealth

        def end() -> None:
            recorder._writer._file.finish = lambda: None  # type: ignore[method-assign]
            recorder.close()

        return end

    def send(self, count: int) -> None:
        """The node sends frames, which the live path loses."""
        for _ in range(count):
            self.bus.outbox.add(frame(self.bus.outbox.next), time.monotonic_ns())

    def record(self, *sequences: int, sensor: str = "front", node_id: int = 1) -> None:
        """Frames of the live path arrive."""
        for k in sequences:
            self.recorder.frame(NODE, frame(k, sensor, node_id), time.monotonic_ns())


def frame(sequence: int, sensor: str = "front", node_id: int = 1) -> bytes:
    kind = topology("kinect_v2")
    made = body_frame(sensor, kind, time_ns=sequence, positions=POSITIONS, node_id=node_id, sequence=sequence)
    return encode_frame(made)
