"""Sliders of a camera's controls without a browser: what is asked, what is shown, and what follows the node."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import viser

from mocapella.errors import BusError, MocapellaError
from mocapella.model.camera_controls import ControlDescription, checked
from mocapella.viewer.camera_feed import CameraFeed
from mocapella.viewer.camera_sliders import CameraSliders
from mocapella.viewer.inputs import set_value
from mocapella.wire.questions import NodeAnswer

LEFT = (
    ControlDescription("exposure", "100 µs", 1, 500, 1, 60, 60, "exposure"),
    ControlDescription("gain", "", 0, 24, 0.5, 0, 0),
    ControlDescription("contrast", "", 5, 5, 1, 5, 5, read_only=True),
)


class Node:
    """Two cameras' nodes that do as they are asked."""

    def __init__(self) -> None:
        self.has = {"left": list(LEFT), "right": [LEFT[1]]}
        self.saved = {"exposure": 60.0, "gain": 0.0, "automatic": []}
        self.asked: list[dict[str, Any]] = []
        self.fails: MocapellaError | None = None
        self.free = threading.Event()
        self.free.set()

    def ask(self, camera: str, question: dict[str, Any], timeout_s: float) -> NodeAnswer:
        self.asked.append(question)
        if self.fails is not None and question["ask"] in ("set", "save_controls"):
            raise self.fails
        now = self.has[camera]
        if question["ask"] == "report":
            return NodeAnswer(True, report={})
        if question["ask"] == "save_controls":
            self.saved = {**{c.name: c.value for c in now}, "automatic": [c.mode for c in now if c.automatic]}
            return NodeAnswer(True, "saved to left.json")
        if question["ask"] == "set":
            self.free.wait(10.0)
            accepted = checked(now, question["values"], question["automatic"])
            now = [replace(c, automatic=question["automatic"].get(c.mode, c.automatic)) for c in now]
            now = self.has[camera] = [replace(c, value=accepted.get(c.name, c.value)) for c in now]
        return NodeAnswer(True, controls={"saved": self.saved}, descriptions=now)


class Rig:
    """Sliders, their feed, and the loop that shows them; its clock runs ten times as fast."""

    def __init__(self, gui: viser.GuiApi, *, sets: bool = True) -> None:
        self.node, self.now_s, self.camera = Node(), 0.0, "left"
        self.said: list[tuple[str, str, bool]] = []
        self.feed = CameraFeed(self.node.ask)
        self.sliders = CameraSliders(gui, self.feed, lambda *words: self.said.append(words), sets=sets)

    def step(self) -> None:
        self.now_s += 0.1
        self.feed.beat(("left", "right"), self.now_s)
        self.sliders.show(self.camera, self.now_s)
        time.sleep(0.01)

    def until(self, holds: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 10.0
        while not holds():
            assert time.monotonic() < deadline, what
            self.step()

    def opened(self) -> Rig:
        set_value(self.sliders.open, True)
        self.until(lambda: "gain" in self.sliders._sliders, "there are sliders")
        return self

    def move(self, name: str, value: float) -> None:
        """As a browser does."""
        set_value(self.sliders._sliders[name], value)
        self.sliders._wish(lambda: self.sliders._values.update({name: value}))

    def of(self, verb: str) -> list[dict[str, Any]]:
        return [question for question in self.node.asked if question["ask"] == verb]


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


def test_nothing_is_asked_until_they_are_opened(rig: Rig) -> None:
    for _ in range(20):
        rig.step()
    assert not rig.of("controls")
    assert not rig.sliders._folder.visible


def test_each_control_has_a_slider_in_its_own_range(rig: Rig) -> None:
    sliders = rig.opened().sliders._sliders
    assert list(sliders) == ["exposure", "gain", "contrast"]
    exposure = sliders["exposure"]
    assert (exposure.label, exposure.min, exposure.max, exposure.step, exposure.value) == (
        "Exposure, 100 µs", 1, 500, 1, 60,
    )  # fmt: skip
    assert exposure.hint == "from 1 to 500 (100 µs); default 60"
    assert (sliders["contrast"].disabled, exposure.disabled) == (True, False)
    assert list(rig.sliders._modes) == ["exposure"]


def test_a_slider_that_is_moved_sets_the_control_and_it_can_be_saved(rig: Rig) -> None:
    rig.opened()
    assert rig.sliders._save.disabled
    rig.move("gain", 3.0)
    rig.until(lambda: not rig.sliders._save.disabled, "it is set, and not saved")
    assert rig.node.has["left"][1].value == 3.0
    assert "not saved yet" in rig.sliders._note.content
    rig.sliders._wish(rig.sliders._keep)
    rig.until(lambda: bool(rig.said) and rig.sliders._save.disabled, "it is saved")
    assert rig.said == [("Save settings", "saved to left.json", True)]
    assert rig.node.saved["gain"] == 3.0


def test_a_slider_that_is_dragged_asks_seldom_and_for_the_newest_value(rig: Rig) -> None:
    rig.opened()
    for value in range(1, 13):
        rig.move("gain", value)
    rig.until(lambda: rig.node.has["left"][1].value == 12, "the last value is set")
    assert len(rig.of("set")) <= 2


def test_an_automatic_mode_takes_its_sliders_and_gives_them_back(rig: Rig) -> None:
    rig.opened()
    exposure = rig.sliders._sliders["exposure"]
    for on in (True, False):
        rig.sliders._wish(lambda on=on: rig.sliders._automatic.update({"exposure": on}))  # type: ignore[misc]
        rig.until(lambda on=on: exposure.disabled is on, "the slider follows")  # type: ignore[misc]
        assert rig.sliders._modes["exposure"].value is on


def test_what_another_browser_or_the_camera_changes_is_shown(rig: Rig) -> None:
    rig.opened()
    rig.node.has["left"][0] = replace(LEFT[0], value=222)
    rig.until(lambda: rig.sliders._sliders["exposure"].value == 222, "the slider follows")
    rig.sliders._wish(rig.sliders._go_back)
    rig.until(lambda: rig.node.has["left"][0].value == 60, "it is as saved")
    rig.move("gain", 6.0)
    rig.until(lambda: rig.node.has["left"][1].value == 6.0, "it is set")
    rig.sliders._wish(rig.sliders._reset)
    rig.until(lambda: rig.node.has["left"][1].value == 0.0, "it is the default")


def test_undo_leaves_out_controls_that_are_read_only(rig: Rig) -> None:
    rig.node.has["left"][1] = replace(rig.node.has["left"][1], read_only=True)
    rig.opened()
    rig.until(lambda: any(control.read_only for control in rig.sliders._known), "it is known")
    rig.sliders._go_back()
    assert "gain" not in rig.sliders._values
    assert "exposure" in rig.sliders._values


def test_a_refusal_is_shown_and_the_slider_goes_back(rig: Rig) -> None:
    rig.opened()
    rig.node.fails = BusError("left: no answer within 30 s")
    rig.move("gain", 3.0)
    rig.until(lambda: "no answer within 30 s" in rig.sliders._note.content, "it is shown")
    rig.until(lambda: rig.sliders._sliders["gain"].value == 0.0, "the slider goes back")
    rig.sliders._wish(rig.sliders._keep)
    rig.until(lambda: bool(rig.said), "it is said")
    assert rig.said == [("Save settings: not done", "left: no answer within 30 s", False)]


def test_another_camera_has_other_sliders(rig: Rig) -> None:
    rig.opened()
    rig.camera = "right"
    rig.until(lambda: list(rig.sliders._sliders) == ["gain"], "they are the other camera's")
    rig.node.has["right"] = []
    rig.until(lambda: "no settings that can be changed" in rig.sliders._note.content, "that is said")
    rig.camera = ""
    rig.step()
    assert not rig.sliders._folder.visible


def test_a_slider_keeps_the_users_value_until_the_node_has_answered(rig: Rig) -> None:
    rig.opened()
    rig.node.free.clear()
    rig.move("gain", 3.0)
    rig.until(lambda: bool(rig.of("set")), "it is under way")
    before = len(rig.of("controls"))
    rig.until(lambda: len(rig.of("controls")) > before + 1, "the old value has come again")
    for _ in range(5):
        rig.step()
    assert rig.sliders._sliders["gain"].value == 3.0
    rig.node.free.set()
    rig.until(lambda: not rig.sliders._busy, "it is answered")
    assert rig.sliders._sliders["gain"].value == 3.0


def test_an_answer_of_the_camera_before_is_not_shown(rig: Rig) -> None:
    rig.opened()
    rig.node.free.clear()
    rig.move("gain", 3.0)
    rig.until(lambda: bool(rig.of("set")), "it is under way")
    rig.camera = "right"
    rig.until(lambda: list(rig.sliders._sliders) == ["gain"], "they are the other camera's")
    rig.node.free.set()
    rig.until(lambda: rig.node.has["left"][1].value == 3.0, "it is set")
    for _ in range(10):
        rig.step()
        assert list(rig.sliders._sliders) == ["gain"]
    assert rig.sliders._sliders["gain"].value == 0.0


def test_who_watches_sees_the_values_and_sets_none(server: viser.ViserServer) -> None:
    server.gui.reset()
    rig = Rig(server.gui, sets=False).opened()
    assert all(slider.disabled for slider in rig.sliders._sliders.values())
    assert not rig.sliders._save.visible
    rig.move("gain", 3.0)
    for _ in range(10):
        rig.step()
    rig.feed.close()
    assert not rig.of("set")
