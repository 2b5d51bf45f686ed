"""Who follows gets every message in its order; what cannot be read or kept is counted."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from support.moved_wand import moved

from mocapella.model.scene import Scene
from mocapella.schema import encode_frame, encode_scene
from mocapella.wire import keys
from mocapella.wire.reader import Following, Newest


class Bus:
    """A session that hands on what it is given."""

    def __init__(self) -> None:
        self._callbacks: dict[str, Callable[[Any], None]] = {}

    def declare_subscriber(self, key: str, callback: Callable[[Any], None]) -> None:
        self._callbacks[key] = callback

    def put(self, key: str, data: bytes) -> None:
        self._callbacks[key](SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data)))


def test_every_message_comes_once_and_in_order() -> None:
    bus = Bus()
    following = Following(bus)  # type: ignore[arg-type]
    sent = []
    for scene, frame in moved(0.1):
        if frame is not None:
            bus.put(keys.ALL_LIVE, encode_frame(frame))
            sent.append(frame.key)
        bus.put(keys.SCENE, encode_scene(scene))
        sent.append(("scene", scene.step, scene.at_ns))
    came = [("scene", m.step, m.at_ns) if isinstance(m, Scene) else m.key for m in following.take()]
    assert came == sent
    assert following.take() == []
    assert following.refused == following.lost == 0


def test_what_cannot_be_read_or_kept_is_counted() -> None:
    bus = Bus()
    following = Following(bus, most=3)  # type: ignore[arg-type]
    scenes = [encode_scene(scene) for scene, _ in moved(0.05)]
    for data in (*scenes[:3], b"nonsense", scenes[3]):
        bus.put(keys.SCENE, data)
    steps = [message.step for message in following.take() if isinstance(message, Scene)]
    assert steps == [2, 3]
    assert (following.refused, following.lost) == (1, 2)


def test_a_slow_reader_has_the_newest_scene_and_the_number_of_those_that_it_skipped() -> None:
    bus = Bus()
    newest = Newest(bus)  # type: ignore[arg-type]
    scenes = [encode_scene(scene) for scene, _ in moved(0.05)]
    for data in scenes[:4]:
        bus.put(keys.SCENE, data)
    scene = newest.scene()
    assert scene is not None
    assert scene.step == 3
    assert newest.skipped == 3
    bus.put(keys.SCENE, scenes[0])
    assert newest.scene() is not None
    assert newest.skipped == 3


def test_a_reader_knows_since_when_it_has_heard_nothing_of_the_server() -> None:
    bus = Bus()
    newest = Newest(bus)  # type: ignore[arg-type]
    bus.put(keys.SCENE, b"")
    assert newest.heard_s == float("-inf")
    bus.put(keys.STATUS, b"{}")
    first_s = newest.heard_s
    assert first_s > 0
    bus.put(keys.STATUS, b"{}")
    assert newest.heard_s >= first_s
