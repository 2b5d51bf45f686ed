"""What a camera's node says of problems that come and go."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import NoServerError, SettingsError
from mocapella.live.camera_node import (
    STEADY_S,
    WARN_AFTER_S,
    CameraNodeSettings,
    CameraRun,
    FaultReports,
    run_camera_node,
)
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.supervision import Boundary
from mocapella.testing import FakeCamera
from mocapella.wire.keys import NodeKey

BEGIN, OVER = "too few", "rate: well again"


def said(there: list[bool]) -> list[list[str]]:
    """What is said at each look, at some of which there is a problem."""
    warned = FaultReports()
    return [list(warned.update({"rate": BEGIN} if now else {}, WARN_AFTER_S * k)) for k, now in enumerate(there)]


def test_the_first_time_begin_and_end_are_said_at_once() -> None:
    assert said([False, True, True, False, False]) == [[], [BEGIN], [], [OVER], []]


def test_what_comes_and_goes_is_over_when_it_has_been_away_for_long() -> None:
    steady = round(STEADY_S / WARN_AFTER_S)
    told = said([True, False] * 50 + [False] * steady + [True, False])
    assert told[:3] == [[BEGIN], [OVER], [BEGIN]]
    assert told[3:] == [[]] * (95 + steady) + [[OVER], [], [BEGIN], []]


@given(st.lists(st.booleans(), max_size=120))
def test_beginnings_and_ends_alternate_with_a_minute_at_least_between_two_ends(there: list[bool]) -> None:
    told = said(there)
    flat = [text for texts in told for text in texts]
    assert flat == ([BEGIN, OVER] * len(flat))[: len(flat)]
    assert all(texts == [] or (texts == [BEGIN]) == now for texts, now in zip(told, there, strict=True))
    assert any(there) == (BEGIN in flat)
    ends = [k for k, texts in enumerate(told) if texts == [OVER]]
    assert all((b - a) * WARN_AFTER_S >= STEADY_S for a, b in pairwise(ends))


def test_each_kind_is_told_by_itself() -> None:
    warned = FaultReports()
    assert list(warned.update({"a": "A", "b": "B"}, 0.0)) == ["A", "B"]
    assert list(warned.update({"b": "B"}, 3.0)) == ["a: well again"]
    assert list(warned.update({"a": "A"}, 6.0)) == ["A", "b: well again"]
    assert list(warned.update({}, 9.0)) == []
    assert list(warned.update({}, 66.0)) == ["a: well again"]


class Link:
    """A node's link without a bus."""

    node, address, published, put_off = NodeKey("left", 1), "tcp/127.0.0.1:1", 0, ""

    def __init__(self, said: list[str]) -> None:
        self.errors = Boundary(lambda text: said.append(f"left: {text}"))
        self.heard_s = time.monotonic()

    def join(self, timeout: float = 1.0) -> bool:
        return True

    def server_is_there(self) -> bool:
        return True


class Work:
    def words(self) -> str:
        return ""

    def warnings(self, now_s: float) -> Iterator[str]:
        return iter(())


def run(on_picture: Callable[[Picture], None], said: list[str]) -> CameraRun:
    """Run a node until three images were processed."""
    link: Any = Link(said)
    stop, count = threading.Event(), [0]

    def look(picture: Picture) -> None:
        count[0] += 1
        if count[0] == 3:
            stop.set()
        on_picture(picture)

    with Acquisition(FakeCamera(SourceState((2, 2), None))) as acquisition:
        return run_camera_node(
            link, acquisition, Work(), look, CameraNodeSettings(), epoch=None, stop=stop, wait=True, say=said.append
        )


def test_an_image_that_causes_an_unexpected_error_costs_itself_only() -> None:
    seen, said = list[Picture](), list[str]()

    def look(picture: Picture) -> None:
        seen.append(picture)
        if len(seen) == 1:
            raise ZeroDivisionError("planted")

    ran = run(look, said)
    assert len(seen) == 3
    assert "left: unexpected error (image): ZeroDivisionError: planted" in said
    assert list(ran.errors.values()) == [1]


@pytest.mark.parametrize(
    ("refused", "why"),
    [("", "no server was at tcp/127.0.0.1:1; start it first"), ("it has another key; invite it again",) * 2],
)
def test_a_node_whose_source_ends_says_why_no_server_took_its_frames(refused: str, why: str) -> None:
    class Unwanted(Link):
        def join(self, timeout: float = 1.0) -> bool:
            return False

        def why_not_admitted(self) -> str:
            return refused

    class Ended:
        ended = True

        def start(self, zero_s: float) -> None:
            pass

        def take(self, timeout_s: float) -> None:
            return None

    link: Any = Unwanted([])
    source: Any = Ended()
    with pytest.raises(NoServerError, match=f"left: 0 frames went nowhere: {why}"):
        run_camera_node(
            link, source, Work(), lambda picture: None, CameraNodeSettings(), epoch=None, stop=threading.Event(),
            wait=False, say=lambda text: None,
        )  # fmt: skip


def test_an_error_of_ours_ends_the_node() -> None:
    def refuse(picture: Picture) -> None:
        raise SettingsError("no such marker")

    with pytest.raises(SettingsError, match="no such marker"):
        run(refuse, [])
