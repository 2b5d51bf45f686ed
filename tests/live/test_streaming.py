"""The loop of a stream: each result once, an end, and a server that is gone."""

from __future__ import annotations

import threading
from collections import deque

import pytest
from support.walkers import Room

from mocapella.errors import NoServerError
from mocapella.live.streaming import run_stream
from mocapella.model.scene import Scene
from mocapella.streams.stream import STREAMS

ROOM = Room(people=2, sensors=2)


class TwoEach:
    """An encoder of two datagrams for each scene."""

    def datagrams(self, scene: Scene) -> list[bytes]:
        return [b"abc", b"de"]


def test_each_scene_is_sent_once_until_it_is_stopped() -> None:
    scenes = deque([None, ROOM.scene(1.0, ROOM.frames(1.0)), None, ROOM.scene(1.1, ROOM.frames(1.1))])
    stop, sent = threading.Event(), list[bytes]()

    def newest() -> Scene | None:
        if not scenes:
            stop.set()
            return None
        return scenes.popleft()

    summary = run_stream(newest, TwoEach(), sent.append, stop)
    assert sent == [b"abc", b"de"] * 2
    assert (summary.scenes, summary.datagrams, summary.sent_bytes, summary.most_people) == (2, 4, 10, 2)


def test_a_silent_server_ends_it_with_an_error() -> None:
    with pytest.raises(NoServerError, match="nothing comes from the server any more"):
        run_stream(lambda: None, TwoEach(), lambda _: None, threading.Event(), silent_s=lambda: 11.0)


def test_ours_are_registered() -> None:
    assert {"osc", "vmc"} <= set(STREAMS)
