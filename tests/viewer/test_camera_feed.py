"""Cameras are asked only while somebody looks, so often at most, and each once for all."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from mocapella.errors import BusError, SettingsError
from mocapella.viewer.camera_feed import CameraFeed, FeedMode, FeedSettings
from mocapella.wire.questions import NodeAnswer

PICTURE = NodeAnswer(True, image=b"jpeg", format="jpeg", size_px=(640, 480), time_ns=5)
BEAT_S = 1 / 30


class Node:
    """Answers at once, and remembers what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.answer: NodeAnswer | Exception = PICTURE
        self.gate = threading.Event()
        self.gate.set()

    def ask(self, camera: str, question: dict[str, Any], timeout_s: float) -> NodeAnswer:
        self.asked.append((camera, question))
        assert self.gate.wait(10.0)
        if question["ask"] == "report":
            return NodeAnswer(True, report={"fps": 20.0})
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def pictures(self) -> list[dict[str, Any]]:
        return [question for _, question in self.asked if question["ask"] != "report"]


class Loop:
    """The loop that draws, on a clock of its own."""

    def __init__(self, node: Node, *cameras: str, **settings: Any) -> None:
        self.node, self.cameras, self.now_s = node, cameras, 0.0
        self.feed = CameraFeed(node.ask, FeedSettings(**settings))

    def run(self, seconds: float, *wanted: tuple[str, FeedMode, float], wait: bool = True) -> None:
        for _ in range(round(seconds / BEAT_S)):
            self.now_s += BEAT_S
            for camera, shown, width_px in wanted:
                self.feed.want(camera, shown, width_px, self.now_s)
            self.feed.beat(self.cameras, self.now_s)
            deadline = time.monotonic() + 10.0
            while wait and self.feed._under_way:
                assert time.monotonic() < deadline
                time.sleep(1e-4)


@pytest.fixture
def node() -> Node:
    return Node()


def test_nothing_is_asked_but_once_who_answers_while_nobody_looks(node: Node) -> None:
    loop = Loop(node, "left")
    loop.run(20.0)
    assert node.asked == [("left", {"ask": "report"})]
    assert loop.feed.cameras == ("left",)


def test_a_camera_is_asked_so_often_at_most_for_all_browsers(node: Node) -> None:
    loop = Loop(node, "left", "right", rate_hz=5.0)
    browsers = [("left", FeedMode.PICTURE, 320.0)] * 3 + [("right", FeedMode.MASK, 320.0)]
    loop.run(10.0, *browsers)
    assert 40 <= len(node.asked) <= 51
    each = [sum(1 for c, q in node.asked if (c, q["ask"]) == kind) for kind in (("left", "picture"), ("right", "mask"))]
    assert abs(each[0] - each[1]) <= 1  # taken in turn
    asked = len(node.asked)
    loop.run(5.0)
    assert len(node.asked) <= asked + 3  # what was wanted last; then nothing


def test_what_is_under_way_is_not_asked_again_and_nothing_waits_for_it(node: Node) -> None:
    loop = Loop(node, "left")
    loop.run(1.0, ("left", FeedMode.PICTURE, 320.0))
    node.gate.clear()
    asked, began_s = len(node.asked), time.monotonic()
    loop.run(5.0, ("left", FeedMode.PICTURE, 320.0), wait=False)
    assert time.monotonic() - began_s < 5.0
    node.gate.set()
    assert len(node.asked) <= asked + 2  # one picture, one report
    loop.feed.close()


def test_pictures_are_asked_for_as_wide_as_the_widest_browser_wants_and_are_not_kept(node: Node) -> None:
    loop = Loop(node, "left")
    loop.run(2.0, ("left", FeedMode.PICTURE, 160.0), ("left", FeedMode.PICTURE, 320.0))
    assert node.pictures()[-1] == {"ask": "picture", "scale": 0.5, "format": "jpeg", "keep": False}
    loop.run(2.0, ("left", FeedMode.PICTURE, 160.0))
    assert node.pictures()[-1]["scale"] == 0.25
    loop.run(2.0, ("left", FeedMode.MASK, 5000.0))
    assert node.pictures()[-1] == {"ask": "mask", "scale": 1.0, "format": "jpeg"}


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (BusError("left: nobody answered"), "nobody answered"),
        (NodeAnswer(False, "no colours are learnt yet"), "no colours"),
        (NodeAnswer(False), "not said why"),
        (NodeAnswer(True), "no picture"),
        (NodeAnswer(True, image=b"x", format="svg+xml", size_px=(2, 2)), "no picture"),
        (NodeAnswer(True, image=b"x", format="png", size_px=(0, 2)), "no picture"),
    ],
)
def test_what_goes_wrong_is_said_and_the_last_picture_stays(node: Node, answer: Any, says: str) -> None:
    loop = Loop(node, "left", patience_s=2.0)
    loop.run(1.0, ("left", FeedMode.PICTURE, 320.0))
    node.answer = answer
    loop.run(1.0, ("left", FeedMode.PICTURE, 320.0))
    shot = loop.feed.want("left", FeedMode.PICTURE, 320.0, loop.now_s)
    assert says in shot.problem
    assert shot.answer is PICTURE
    asked = len(node.pictures())
    loop.run(10.0, ("left", FeedMode.PICTURE, 320.0))
    assert len(node.pictures()) <= asked + 6  # patiently
    node.answer = PICTURE
    loop.run(3.0, ("left", FeedMode.PICTURE, 320.0))
    assert loop.feed.want("left", FeedMode.PICTURE, 320.0, loop.now_s).problem == ""


def test_a_node_that_never_answers_is_no_camera_and_one_that_leaves_is_none_any_more(node: Node) -> None:
    def deaf(camera: str, question: dict[str, Any], timeout_s: float) -> NodeAnswer:
        raise BusError("nobody answered")

    loop = Loop(node, "left")
    feed = CameraFeed(deaf)
    for k in range(200):
        feed.beat(["left"], k * BEAT_S)
    assert feed.cameras == ()
    loop.run(1.0)
    assert loop.feed.cameras == ("left",)
    loop.feed.beat([], loop.now_s)
    assert loop.feed.cameras == ()


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0}, {"rate_hz": 31}, {"timeout_s": 0}, {"report_s": 61}, {"workers": 0}, {"wanted_s": -1}]
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        FeedSettings(**wrong)
