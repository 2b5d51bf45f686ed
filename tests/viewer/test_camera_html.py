"""What is shown of cameras, as HTML: whatever a node sends, nothing breaks and nothing is run."""

from __future__ import annotations

import base64
from typing import Any

import pytest

from mocapella.viewer import camera_html
from mocapella.viewer.camera_feed import FeedImage, FeedMode
from mocapella.viewer.palette import AMBER, GREEN, RED
from mocapella.viewer.pointing import Pointing
from mocapella.wire.questions import NodeAnswer

NASTY = "<img src=x onerror='window.hurt=1'>"
ANSWER = NodeAnswer(
    True, image=b"\xff\xd8bytes", format="jpeg", size_px=(320, 240), names=["red", NASTY, "gone"],
    positions_px=[(10.0, 20.5), (30.0, 40.0), None],
)  # fmt: skip


def test_a_picture_has_a_circle_around_each_marker_that_was_found() -> None:
    html = camera_html.picture_html(FeedImage(ANSWER), FeedMode.PICTURE, {"fps": 19.6})
    assert base64.b64encode(ANSWER.image).decode() in html
    assert html.count("<circle") == 2
    assert 'cx="10.0" cy="20.5"' in html
    assert "2 of 3 markers found · 20 pictures a second" in html
    assert NASTY not in html


def test_a_mask_has_none_because_it_is_painted_by_the_node_and_what_is_off_is_empty() -> None:
    assert "<circle" not in camera_html.picture_html(FeedImage(ANSWER), FeedMode.MASK, {})
    assert camera_html.picture_html(FeedImage(ANSWER), FeedMode.OFF, {}) == ""
    assert camera_html.picture_html(None, FeedMode.PICTURE, {}) == ""
    words = camera_html.picture_html(FeedImage(ANSWER), FeedMode.MASK, {}, large=True)
    assert "2 of 3 markers found" in words
    assert "<img" not in words


def test_what_is_wrong_stands_below_the_dimmed_picture_or_in_its_place() -> None:
    html = camera_html.picture_html(
        FeedImage(ANSWER, f"gone {NASTY}"), FeedMode.PICTURE, {"problems": ["light", 7, NASTY]}
    )
    assert "opacity:0.35" in html
    assert "gone &lt;img" in html
    assert "light" in html
    assert NASTY not in html
    assert "Waiting" in camera_html.picture_html(FeedImage(), FeedMode.MASK, {})
    assert "no colours" in camera_html.picture_html(FeedImage(None, "no colours"), FeedMode.MASK, {})


def test_who_is_next_is_said_and_where_the_others_were() -> None:
    pointing = Pointing(("red", NASTY, "blue", "skin")).click((3.2, 4.0)).skip()
    html = camera_html.pointing_html(pointing, "too <dark>", "note")
    assert "Click on blue, on the ring finger" in html
    assert "3, 4" in html
    assert "left out" in html
    assert "too &lt;dark&gt;" in html
    assert NASTY not in html


def test_colours_that_can_be_told_apart_are_green_and_problems_are_in_words() -> None:
    html = camera_html.separability_html({"kept": {"red": 0.99, "blue": 0.85, NASTY: 0.2}, "problems": []})
    for colour in (GREEN, AMBER, RED):
        assert f"background:{colour.css}" in html
    assert "99 %" in html
    assert "can be told apart" in html
    assert NASTY not in html
    html = camera_html.separability_html({"kept": {"red": 0.99}, "problems": ["red and crimson are too alike"]})
    assert "too alike" in html
    assert "can be told apart" not in html


@pytest.mark.parametrize("sent", [{}, {"kept": [1], "problems": 3}, {"kept": {"a": "x"}, "problems": [None, {}]}])
def test_nonsense_of_a_node_is_survived(sent: dict[str, Any]) -> None:
    assert "not saved yet" in camera_html.separability_html(sent)
    assert "<img" in camera_html.picture_html(FeedImage(ANSWER), FeedMode.PICTURE, {**sent, "fps": "many"})
