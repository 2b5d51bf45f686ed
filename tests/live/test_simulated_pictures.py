"""Images of a simulated camera: people are where its keypoints are, and other queries are refused with the reason."""

from __future__ import annotations

import importlib.util
import json
import queue
from collections.abc import Iterator

import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.live.simulated_pictures import NO_CONTROLS, NO_OPENCV, SimulatedPictures
from mocapella.sources.simulate.crowd import crowd_scene
from mocapella.wire.questions import read_answer

cv2 = pytest.importorskip("cv2")

PICTURE = json.dumps({"ask": "picture", "format": "png"}).encode()
SECONDS = 10


@pytest.fixture(scope="module")
def pictures() -> Iterator[SimulatedPictures]:
    with SimulatedPictures(crowd_scene("turning").cameras[0], SECONDS * NS_PER_S) as made:
        yield made


def test_people_are_drawn_where_the_keypoints_are(pictures: SimulatedPictures) -> None:
    from mocapella.sources.simulate.keypoint_picture import WALL

    item = next(crowd_scene("turning").cameras[0].frames(NS_PER_S))
    pictures.time_ns = item.frame.time_ns + 3 * SECONDS * NS_PER_S  # the scene is repeated
    answered = queue.Queue[bytes]()
    pictures.ask(PICTURE, answered.put)
    answer = read_answer(answered.get(timeout=30))
    assert (answer.ok, answer.time_ns, answer.size_px) == (True, pictures.time_ns, item.frame.size_px)
    image = cv2.imdecode(np.frombuffer(answer.image, np.uint8), cv2.IMREAD_COLOR)
    bright = np.abs(image.astype(int) - WALL).max(axis=-1) > 40
    (person,) = np.flatnonzero(item.detected >= 0)[:1]
    seen = item.frame.positions_px[person][item.frame.confidences[person] > 0.6]
    assert len(seen) > 3
    assert np.mean([bright[int(y) - 6 : int(y) + 7, int(x) - 6 : int(x) + 7].any() for x, y in seen]) > 0.9
    assert bright.mean() < 0.2


@pytest.mark.parametrize(
    ("question", "reason"),
    [
        ('{"ask": "controls"}', NO_CONTROLS),
        ('{"ask": "dance"}', "no question"),
        ('{"ask": "picture", "scale": 0}', "scale"),
    ],
)
def test_other_queries_are_refused(pictures: SimulatedPictures, question: str, reason: str) -> None:
    pictures.time_ns = 0
    answer = pictures.answer(question.encode())
    assert (answer.ok, reason in answer.message) == (False, True), answer.message


def test_what_is_missing_is_named(pictures: SimulatedPictures, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures.time_ns = None
    assert "no image yet" in pictures.answer(PICTURE).message
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert pictures.answer(PICTURE).message == NO_OPENCV


def test_too_many_queries_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("threading.Thread.start", lambda _: None)
    monkeypatch.setattr("threading.Thread.join", lambda *_: None)
    with SimulatedPictures(crowd_scene("turning").cameras[0], NS_PER_S) as idle:
        refused: list[bytes] = []
        for _ in range(9):
            idle.ask(PICTURE, refused.append)
    (answer,) = refused
    assert "ask again later" in read_answer(answer).message


def test_an_unexpected_error_costs_its_query_only(pictures: SimulatedPictures, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ValueError("no such joint")

    pictures.time_ns = 0
    answered = queue.Queue[bytes]()
    with monkeypatch.context() as patch:
        patch.setattr("mocapella.sources.simulate.keypoint_picture.draw_bodies", broken)
        pictures.ask(PICTURE, answered.put)
        failed = read_answer(answered.get(timeout=30))
    assert (failed.ok, "no such joint" in failed.message) == (False, True), failed.message
    pictures.ask(PICTURE, answered.put)
    assert read_answer(answered.get(timeout=30)).ok
