"""Nodes of other trackers: datagrams and devices become frames on the bus, and whatever comes, they go on."""

from __future__ import annotations

import socket
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.errors import AddressInUseError, BusError
from mocapella.live.poses import run_openvr, run_osc
from mocapella.model.poses import PoseFrame, pose_frame
from mocapella.sources.osc import encode
from mocapella.supervision import Boundary


class Link:
    """A `NodeLink` whose server is always there."""

    def __init__(self) -> None:
        self.node, self.address = SimpleNamespace(sensor="vive"), "tcp/127.0.0.1:1"
        self.published, self.put_off = 0, ""
        self.errors, self.heard_s = Boundary(), time.monotonic()
        self.frames: list[PoseFrame] = []
        self.came = threading.Event()

    def publish(self, frame: PoseFrame) -> PoseFrame:
        self.frames.append(frame)
        self.published += 1
        self.came.set()
        return frame

    def join(self, timeout: float = 1.0) -> bool:
        return True

    def server_is_there(self) -> bool:
        return True


class Served:
    """`run_osc` in a thread; ``port`` is where it listens."""

    def __init__(self) -> None:
        self.link, self.stop, self.listens = Link(), threading.Event(), threading.Event()
        self.summary: dict[str, Any] = {}
        self.port = 0
        self.thread = threading.Thread(target=self._run)
        self.thread.start()
        assert self.listens.wait(30)

    def _say(self, text: str) -> None:
        if "listening" in text:
            self.port = int(text.split("127.0.0.1:")[1].split(maxsplit=1)[0])
            self.listens.set()

    def _run(self) -> None:
        self.summary = run_osc(self.link, ("127.0.0.1", 0), "vr", self.stop, self._say)  # type: ignore[arg-type]

    def end(self) -> dict[str, Any]:
        self.stop.set()
        self.thread.join(30)
        assert not self.thread.is_alive()
        return self.summary


def test_datagrams_become_frames_and_garbage_ends_nothing() -> None:
    served = Served()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in (
                b"",
                b"garbage",
                b"/x\0\0",
                encode("/mocapella/pose", "cup", 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0),
            ):
                sender.sendto(data, ("127.0.0.1", served.port))
        assert served.link.came.wait(30)
    finally:
        summary = served.end()
    (frame,) = served.link.frames
    assert (frame.space, frame.names) == ("vr", ("cup",))
    np.testing.assert_allclose(frame.positions, [[1, 2, 3]])
    counted = {name: summary[name] for name in ("published", "datagrams", "poses", "bad", "unknown")}
    assert counted == {"published": 1, "datagrams": 4, "poses": 1, "bad": 2, "unknown": 1}


def test_a_port_that_is_taken_and_a_place_that_is_none_are_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(AddressInUseError, match="take another port"):
            run_osc(Link(), taken.getsockname(), "vr", threading.Event(), print)  # type: ignore[arg-type]
    with pytest.raises(BusError, match=r"try 127\.0\.0\.1:9000"):
        run_osc(Link(), ("no such host.", 9000), "vr", threading.Event(), print)  # type: ignore[arg-type]


def test_devices_are_polled_until_it_ends() -> None:
    link, stop = Link(), threading.Event()

    class Source:
        invalid = 3

        def poll(self, at_ns: int) -> PoseFrame:
            if link.published == 4:
                stop.set()
            return pose_frame("vive", "vr", ["a"], time_ns=at_ns, positions=[[0, 0, 0]], orientations=[[1, 0, 0, 0]])

    summary = run_openvr(link, Source(), 500.0, stop, lambda _: None)  # type: ignore[arg-type]
    assert summary == {"sensor": "vive", "published": 5, "invalid": 3}
    times = [frame.time_ns for frame in link.frames]
    assert times == sorted(set(times))
