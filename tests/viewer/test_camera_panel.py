"""The folder "Cameras" without a browser: what it asks for, and what it says of all that goes wrong."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import viser

from mocapella.errors import BusError
from mocapella.viewer.camera_feed import CameraFeed, FeedMode
from mocapella.viewer.camera_panel import CameraPanel, Lesson
from mocapella.wire.questions import NodeAnswer

SHOT = {"image": b"jpeg", "format": "jpeg", "size_px": (320, 240), "names": ["red", "blue"]}


class Node:
    """A camera's node that does what it is asked, unless it is told to fail."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.unsaved = False
        self.fails: dict[str, Exception | NodeAnswer] = {}

    def ask(self, camera: str, question: dict[str, Any], timeout_s: float) -> NodeAnswer:
        self.asked.append(question)
        verb = question["ask"]
        if (failure := self.fails.get(verb)) is not None:
            if isinstance(failure, Exception):
                raise failure
            return failure
        self.unsaved = {"learn": True, "save": False, "discard": False}.get(verb, self.unsaved)
        if verb == "report":
            return NodeAnswer(True, report={"unsaved": self.unsaved, "problems": []})
        if verb == "learn":
            return NodeAnswer(True, "learnt", separability={"kept": {"red": 1.0}, "problems": ["blue is weak"]})
        if verb in ("save", "discard"):
            return NodeAnswer(True, f"done: {verb}")
        return NodeAnswer(True, time_ns=len(self.asked), **SHOT)  # type: ignore[arg-type]

    def of(self, verb: str) -> list[dict[str, Any]]:
        return [question for question in self.asked if question["ask"] == verb]


class Rig:
    """A panel, its feed, and the loop that shows it; its clock runs ten times as fast."""

    def __init__(self, gui: viser.GuiApi, *, learns: bool = True) -> None:
        self.node, self.now_s, self.cameras = Node(), 0.0, ["left"]
        self.plain: list[str] = []
        self.said: list[tuple[str, str, bool]] = []
        self.feed = CameraFeed(self.node.ask)
        self.panel = CameraPanel(gui, self.feed, lambda *words: self.said.append(words), learns=learns)

    def until(self, holds: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 10.0
        while not holds():
            assert time.monotonic() < deadline, what
            self.now_s += 0.1
            self.feed.beat(self.cameras, self.now_s, self.plain)
            self.panel.show(self.now_s)
            time.sleep(0.01)

    def do(self, act: Callable[[], None], lesson: Lesson) -> None:
        self.panel._wish(act)
        self.until(lambda: self.panel._lesson is lesson, f"it is {lesson}")

    def point(self) -> None:
        """As far as the markers are pointed at."""
        self.until(lambda: bool(self.panel._folder.visible), "there is a camera")
        self.do(self.panel._freeze, Lesson.POINTING)
        self.until(lambda: self.panel.wants_clicks, "the picture is large")
        for at in ((10.0, 20.0), (30.0, 40.0)):
            self.panel.click(at)
        self.until(lambda: self.panel._pointing.next == "skin", "both clicks have come")


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield made
    made.stop()


@pytest.fixture
def rig(server: viser.ViserServer) -> Iterator[Rig]:
    server.gui.reset()
    made = Rig(server.gui)
    yield made
    made.feed.close()


def test_there_is_no_folder_without_cameras_and_nothing_is_asked_while_off(rig: Rig) -> None:
    rig.cameras = []
    rig.panel.show(0.0)
    assert not rig.panel._folder.visible
    rig.cameras = ["left"]
    rig.until(lambda: bool(rig.panel._folder.visible), "there is a camera")
    rig.until(lambda: rig.now_s > 5.0, "time passes")
    assert {question["ask"] for question in rig.node.asked} == {"report"}
    assert rig.panel.large is None


def test_who_watches_sees_the_picture_and_orders_nothing(server: viser.ViserServer) -> None:
    server.gui.reset()
    rig = Rig(server.gui, learns=False)
    rig.node.unsaved = True
    rig.panel._shown.value = FeedMode.PICTURE
    rig.until(lambda: "<img" in rig.panel._view.content, "the picture is there")
    panel = rig.panel
    for button in (panel._begin, panel._learn, panel._save, panel._discard, panel._repeat, panel._cancel):
        assert not button.visible
    for act in (panel._freeze, panel._send_clicks, lambda: panel._finish("save", "Save"), panel._add_background):
        panel._wish(act)
    panel.click((1.0, 2.0))
    begun_s = rig.now_s
    rig.until(lambda: rig.now_s > begun_s + 3.0, "time passes")
    rig.feed.close()
    assert {question["ask"] for question in rig.node.asked} == {"report", "picture"}
    assert not any(question.get("keep") for question in rig.node.asked)


def test_a_picture_is_shown_and_is_large_where_that_is_wanted(rig: Rig) -> None:
    rig.panel._shown.value = FeedMode.PICTURE
    rig.until(lambda: "<img" in rig.panel._view.content, "the picture is there")
    assert rig.panel.large is None
    rig.panel._enlarge.value = True
    rig.until(lambda: rig.panel.large is not None, "it is large")
    assert not rig.panel.wants_clicks
    rig.panel._shown.value = FeedMode.MASK
    rig.until(lambda: rig.panel.large is not None and rig.panel.large.words == "left · mask", "it is the mask")
    rig.cameras = []
    rig.until(lambda: "its node is gone" in rig.panel._view.content, "that is said")
    assert rig.panel._folder.visible


def test_the_first_camera_by_name_is_shown_until_another_is_looked_at(rig: Rig) -> None:
    rig.until(lambda: rig.panel._camera == "left", "it is the only one")
    rig.cameras = ["back", "left"]
    rig.until(lambda: rig.panel._camera == "back", "it is the first")
    rig.panel._shown.value = FeedMode.MASK
    rig.cameras = ["aside", "back", "left"]
    rig.until(lambda: "aside" in rig.panel._cameras.options, "there is a third")
    assert rig.panel._camera == "back"


def test_colours_are_learnt_from_the_frozen_picture_and_saved(rig: Rig) -> None:
    rig.point()
    frozen = rig.node.of("picture")[-1]
    assert frozen["keep"]
    assert "picture" not in [question["ask"] for question in rig.node.asked[rig.node.asked.index(frozen) + 1 :]]
    rig.panel._wish(rig.panel._add_background)
    rig.until(lambda: len(rig.panel._backgrounds) == 1, "there is a picture without the hand")
    rig.do(rig.panel._send_clicks, Lesson.LEARNT)
    (learn,) = rig.node.of("learn")
    points = {"red": (10.0, 20.0), "blue": (30.0, 40.0)}
    assert learn["clicks"] == [{"time_ns": rig.panel._frozen.time_ns, "points": points}]  # type: ignore[union-attr]
    assert learn["backgrounds"] == rig.panel._backgrounds
    assert "blue is weak" in rig.panel._steps.content
    rig.until(lambda: rig.panel.large is not None and rig.panel.large.words == "left · mask", "the mask is beside it")
    rig.do(lambda: rig.panel._finish("save", "Save colours"), Lesson.NONE)
    assert rig.said == [("Save colours", "done: save", True)]
    rig.until(lambda: not rig.panel._save.visible, "there is nothing to save")
    assert not rig.panel.large


def test_unsaved_colours_can_be_discarded_in_any_browser(rig: Rig) -> None:
    rig.node.unsaved = True
    rig.until(lambda: "not saved" in rig.panel._steps.content, "it is said")
    assert rig.panel._discard.visible
    rig.panel._wish(lambda: rig.panel._finish("discard", "Discard colours"))
    rig.until(lambda: not rig.panel._discard.visible, "it is discarded")
    assert rig.node.of("discard")


@pytest.mark.parametrize("failure", [BusError("left: nobody answered"), NodeAnswer(False, "left: nobody answered")])
def test_a_node_that_is_gone_or_refuses_is_said_at_every_step(rig: Rig, failure: Any) -> None:
    rig.until(lambda: bool(rig.panel._folder.visible), "there is a camera")
    rig.node.fails["picture"] = failure
    rig.panel._wish(rig.panel._freeze)
    rig.until(lambda: bool(rig.said), "it is said")
    assert rig.said.pop() == ("Learn colours: not begun", "left: nobody answered", False)
    assert rig.panel._lesson is Lesson.NONE
    del rig.node.fails["picture"]
    rig.point()
    rig.node.fails |= {"learn": failure, "save": failure, "picture": failure}
    rig.panel._wish(rig.panel._add_background)
    rig.until(lambda: "nobody answered" in rig.panel._steps.content, "it is said")
    rig.do(rig.panel._send_clicks, Lesson.LEARNING)
    rig.until(lambda: rig.panel._lesson is Lesson.POINTING, "one can go on")
    assert "nobody answered" in rig.panel._steps.content
    assert len(rig.panel._pointing.points) == 2  # nothing is lost
    del rig.node.fails["learn"]
    rig.do(rig.panel._send_clicks, Lesson.LEARNT)
    rig.panel._wish(lambda: rig.panel._finish("save", "Save colours"))
    rig.until(lambda: bool(rig.said), "it is said")
    assert rig.said == [("Save colours: not done", "left: nobody answered", False)]
    assert rig.panel._lesson is Lesson.LEARNT
    rig.do(rig.panel._again, Lesson.POINTING)
    assert len(rig.panel._pointing.points) == 2


def test_names_can_be_typed_and_wrong_ones_are_refused_in_words(rig: Rig) -> None:
    rig.point()
    rig.panel._markers.value = "red, big blue, red"
    rig.until(lambda: "red is named twice" in rig.panel._steps.content, "it is said")
    rig.panel._markers.value = "red, big blue"
    rig.until(lambda: rig.panel._pointing.names == ("red", "big blue", "skin"), "the names are taken")
    assert rig.panel._pointing.next == "big blue"
    assert list(rig.panel._pointing.points) == ["red"]


def test_a_lesson_that_is_cancelled_takes_nothing_that_comes_late(rig: Rig) -> None:
    rig.until(lambda: bool(rig.panel._folder.visible), "there is a camera")
    rig.panel._wish(rig.panel._freeze)
    rig.panel._wish(rig.panel._stop)
    rig.until(lambda: bool(rig.node.of("picture")) and rig.now_s > 5.0, "the picture came")
    assert rig.panel._lesson is Lesson.NONE
    rig.panel.click((1.0, 2.0))
    rig.until(lambda: not rig.panel._wishes, "the click came")
    assert not rig.panel._pointing.points


def test_of_a_camera_that_looks_for_nothing_no_colours_are_spoken_of_and_none_can_be_learnt(rig: Rig) -> None:
    rig.plain = ["left"]
    rig.panel._shown.value = FeedMode.PICTURE
    rig.until(lambda: "<img" in rig.panel._view.content, "the picture is there")
    assert "320 × 240 px" in rig.panel._view.content
    assert "markers" not in rig.panel._view.content
    assert "colours" not in rig.panel._view.content
    assert not rig.panel._begin.visible
    rig.plain = []
    rig.until(lambda: bool(rig.panel._begin.visible), "colours can be learnt")
