"""What a camera's node keeps for pointing, and how it goes back to the colours before."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.live.camera_service import CameraService, CameraServiceSettings
from mocapella.live.marker_work import MarkerWork
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import HandShot, load_hand_scene
from mocapella.sources.simulate.rendered_camera import RenderedCamera
from mocapella.wire.questions import (
    AskBoard,
    AskDiscard,
    AskLearn,
    AskPicture,
    AskReport,
    AskSave,
    Clicks,
    NodeAnswer,
    read_answer,
    write_question,
)

SCENE = load_hand_scene("demo", seed=3)


@cache
def shot() -> HandShot:
    """Not while tests are collected: all workers would compile for it at once."""
    return SCENE.at("left", 0.2)


def points() -> dict[str, tuple[float, float]]:
    return {name: (float(x), float(y)) for name, (x, y) in zip(SCENE.names, shot().centres_px, strict=True)}


class Unasked:
    """A node's work that no question reaches."""


class Harness:
    """A service whose node has looked at pictures of one instant, each with a time of its own."""

    def __init__(self, folder: Path, **known: Any) -> None:
        source = RenderedCamera(SCENE, "left", "rendered:demo/left")
        self.acquisition = Acquisition(source)
        self.work = MarkerWork("left", self.acquisition, known.get("profile"))
        self.file = folder / "left.json"
        self.service = CameraService(self.work, self.file, CameraServiceSettings(pictures=2))

    def look(self, time_ns: int) -> None:
        self.work.look(Picture(np.ascontiguousarray(shot().image), time_ns, 0, 0.0, 0.0))

    def ask(self, question: Any) -> Any:
        return self.service.answer(write_question(question))

    def learn(self, **points: tuple[float, float]) -> Any:
        return self.ask(AskLearn([Clicks(1, points)]))

    def unsaved(self) -> bool:
        return bool(self.ask(AskReport()).report["unsaved"])


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Harness]:
    harness = Harness(tmp_path)
    yield harness
    harness.service.close()


def test_a_picture_that_is_not_to_be_kept_pushes_none_out(made: Harness) -> None:
    made.look(1)
    assert made.ask(AskPicture()).ok
    for time_ns in range(2, 9):
        made.look(time_ns)
        assert made.ask(AskPicture(keep=False)).ok
    assert made.learn(**points()).ok
    for time_ns in (10, 11):
        made.look(time_ns)
        assert made.ask(AskPicture()).ok
    refused = made.learn(**points())
    assert (refused.ok, "no image of that time is kept" in refused.message) == (False, True)


def test_what_was_learnt_is_unsaved_until_it_is_saved_or_discarded(made: Harness) -> None:
    made.look(1)
    assert made.ask(AskPicture()).ok
    assert not made.unsaved()
    refused = made.ask(AskDiscard())
    assert (refused.ok, "nothing to discard" in refused.message) == (False, True)
    assert made.learn(**points()).ok
    assert made.unsaved()
    done = made.ask(AskDiscard())
    assert (done.ok, done.names) == (True, [])
    assert made.work.detector is None
    assert not made.unsaved()
    assert made.learn(**points()).ok
    assert made.ask(AskSave()).ok
    assert not made.unsaved()
    assert made.learn(red=points()["red"], blue=points()["blue"]).ok
    assert made.learn(red=points()["red"]).ok
    assert made.work.names == ("red",)
    done = made.ask(AskDiscard())
    assert done.names == list(points())  # those that were saved, not those learnt first
    assert made.file.exists()


def test_colours_that_the_node_began_with_come_back(tmp_path: Path) -> None:
    made = Harness(tmp_path, profile=pointed_at(SCENE, "left"))
    made.look(1)
    assert made.ask(AskPicture()).ok
    assert made.learn(red=points()["red"]).ok
    assert made.ask(AskDiscard()).names == list(SCENE.names)
    made.service.close()


@pytest.mark.parametrize("text", ["columns = " + "1" * 5000, "a = " + "[" * 5000])
def test_no_question_ends_the_thread_that_answers(made: Harness, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answers: queue.Queue[NodeAnswer] = queue.Queue()

    def ask(question: Any) -> NodeAnswer:
        made.service.ask(write_question(question), lambda data: answers.put(read_answer(data)))
        return answers.get(timeout=60.0)

    made.look(1)
    assert not ask(AskBoard(text)).ok
    with monkeypatch.context() as planted:
        planted.setattr(made.service, "_newest", lambda **_: 1 / 0)
        assert ask(AskPicture()).message == "unexpected error (question): ZeroDivisionError: division by zero"
    report = ask(AskReport()).report
    assert report is not None
    assert list(report["errors"].values())[-1] == 1


def test_an_asker_that_has_left_ends_nothing(made: Harness) -> None:
    def gone(data: bytes) -> None:
        raise OSError("the link is closed")

    done = threading.Event()
    made.service.ask(write_question(AskReport()), gone)
    made.service.ask(write_question(AskReport()), lambda data: done.set())
    assert done.wait(60.0)


@given(st.integers(1, 4), st.lists(st.integers(0, 3), max_size=12))
def test_of_any_second_so_many_questions_are_taken_and_none_is_refused_before(a_second: int, steps: list[int]) -> None:
    now_s, taken_s = 1000.0, list[float]()
    settings = CameraServiceSettings(waiting=100, a_second=a_second)
    service = CameraService(Unasked(), settings=settings, clock=lambda: now_s)  # type: ignore[arg-type]
    service.close()  # questions wait now, and are not answered
    for step in steps:
        now_s += step / 4
        refused = list[NodeAnswer]()
        service.ask(b"", lambda data, refused=refused: refused.append(read_answer(data)))  # type: ignore[misc]
        of_this_second = [at for at in taken_s if now_s - at < 1.0]
        assert [said.message for said in refused] == (
            [f"more than {a_second} questions a second; ask again in a second"]
            if len(of_this_second) == a_second
            else []
        )
        taken_s += [] if refused else [now_s]
