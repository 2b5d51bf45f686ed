"""What the view's loop holds on to, and its pace."""

from __future__ import annotations

import threading
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.passing_time import PassingTime
from support.programs import free_port
from support.walkers import status

from mocapella.errors import InputError, NoServerError
from mocapella.live import view
from mocapella.live.view import LONGEST_ATTEMPT_S, READY_HZ, STALE_AFTER_S, Held, ViewState, beats
from mocapella.model.observations import body_frame
from mocapella.model.topology import topology
from mocapella.viewer import watchdog


def test_a_value_stays_until_a_newer_one_or_until_it_is_stale() -> None:
    held: Held[str] = Held()
    assert held.update(None, 0.0) is None
    assert held.update("a", 1.0) == "a"
    assert held.update(None, 1.0 + STALE_AFTER_S) == "a"
    assert held.update("b", 4.0) == "b"
    assert held.update(None, 4.1 + STALE_AFTER_S) is None


def test_a_sensor_that_falls_silent_is_drawn_no_more() -> None:
    picture = ViewState()
    frame = body_frame("front", topology("kinect_v2"), time_ns=0, positions=np.zeros((1, 25, 3)))
    assert picture.update(None, {"front": frame}, None, 0.0) == (None, {"front": frame}, None)
    assert picture.update(None, {}, None, 1.0)[1] == {"front": frame}
    assert picture.update(None, {}, None, 1.1 + STALE_AFTER_S)[1] == {}


def test_a_sensor_of_a_known_rate_is_drawn_for_less_than_a_second() -> None:
    picture = ViewState()
    frame = body_frame("front", topology("kinect_v2"), time_ns=0, positions=np.zeros((1, 25, 3)))
    for k in range(10):
        picture.update(None, {"front": frame}, None, k / 30)
    assert picture.update(None, {}, None, 9 / 30 + 0.7)[1] == {"front": frame}
    assert picture.update(None, {}, None, 9 / 30 + 0.9)[1] == {}


@given(st.lists(st.floats(0.001, 1.0), min_size=1, max_size=50))
def test_a_view_is_drawn_slowly_while_the_server_gets_ready_and_else_at_every_beat(waits_s: list[float]) -> None:
    """That leaves the processor to the compilation, and the page does not take the view for lost."""
    assert 1 / READY_HZ <= watchdog.PERIOD_S
    ready, getting_ready = status(), status(running=False, phase="stopped", reason="compiling")
    picture, drawn_s = ViewState(), 0.0
    assert picture.due(drawn_s)  # before the first status
    picture.update(None, {}, getting_ready, drawn_s)
    for now_s in np.cumsum(waits_s).tolist():
        assert picture.due(now_s) == (now_s - drawn_s >= 1 / READY_HZ)
        if picture.due(now_s):
            drawn_s = now_s
            picture.update(None, {}, getting_ready, now_s)
    picture.update(None, {}, ready, drawn_s + 10.0)
    assert picture.due(drawn_s + 10.0)


def test_the_beats_end_when_they_are_told() -> None:
    stop = threading.Event()
    instants = []
    for instant in beats(1000.0, stop):
        instants.append(instant)
        if len(instants) == 5:
            stop.set()
    assert len(instants) == 5
    assert instants == sorted(instants)


def instants_of(works_s: list[float], rate_hz: float) -> list[float]:
    """When each beat comes to a loop that works so long after each, and once more after the last."""
    passing: Any = PassingTime()
    found = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "time", passing)
        for work_s, instant in zip([*works_s, 0.0], beats(rate_hz, passing), strict=False):
            found.append(instant)
            passing.now_s += work_s
    return found


@given(st.lists(st.floats(0.0, 0.99), min_size=1, max_size=20), st.sampled_from([1.0, 15.0, 60.0]))
def test_work_of_less_than_a_period_delays_no_later_beat(shares: list[float], rate_hz: float) -> None:
    instants = instants_of([share / rate_hz for share in shares], rate_hz)
    np.testing.assert_allclose(instants, np.arange(len(shares) + 1) / rate_hz, atol=1e-9)


def test_beats_that_a_delay_missed_are_skipped() -> None:
    instants = instants_of([10.0, *[0.0] * 6], 1.0)
    assert instants == sorted(instants)
    assert instants[0] == 0.0
    assert instants[1] == 10.0
    assert instants[-1] >= 10.0 + 5  # of the six beats after that one, at most one comes early


def test_a_drawing_that_fails_ends_neither_the_view_nor_its_other_drawings(monkeypatch: pytest.MonkeyPatch) -> None:
    shown, stop = list[int](), threading.Event()

    class Viewer:
        url, watch_url, pages = "http://127.0.0.1:1", "http://127.0.0.1:1", 0

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def show(self, *_: Any, **__: Any) -> None:
            shown.append(len(shown))
            if len(shown) == 3:
                stop.set()
            if len(shown) == 1:
                raise ZeroDivisionError("planted")

        def close(self) -> None:
            pass

    monkeypatch.setattr(view, "Viewer", Viewer)
    view.run_view(f"tcp/127.0.0.1:{free_port()}", "127.0.0.1", 1, stop)
    assert shown == [0, 1, 2]


def test_the_first_browser_that_draws_the_view_is_told_of_once(monkeypatch: pytest.MonkeyPatch) -> None:
    pages, told, stop = iter([0, 0, 1, 0, 2, 2]), list[int](), threading.Event()

    class Viewer:
        url = watch_url = "http://127.0.0.1:1"
        pages = drawings = 0

        def __init__(self, *_: Any, **__: Any) -> None:
            made.append(self)

        def show(self, *_: Any, **__: Any) -> None:
            self.pages = next(pages)
            self.drawings += 1
            if self.drawings == 6:
                stop.set()

        def close(self) -> None:
            pass

    class Link:
        def __init__(self, *_: Any) -> None:
            self.ask = self.command = None

        def newest(self) -> tuple[None, dict[str, Any], None]:
            return None, {}, None

        def close(self) -> None:
            pass

    made = list[Viewer]()
    monkeypatch.setattr(view, "Viewer", Viewer)
    monkeypatch.setattr(view, "Link", Link)
    view.run_view("tcp/127.0.0.1:1", "127.0.0.1", 1, stop, on_page=lambda: told.append(made[0].drawings))
    assert told == [3]


@given(st.floats(0.01, LONGEST_ATTEMPT_S))
def test_a_server_that_takes_seconds_to_answer_is_reached(takes_s: float) -> None:
    """On a busy machine, no attempt of a fixed, short duration would ever succeed."""
    attempts_s, link = list[float](), object.__new__(view.Link)  # without its thread

    def opened(connect: str, timeout: float) -> Any:
        attempts_s.append(timeout)
        if timeout < takes_s:
            raise NoServerError("no server answers")
        return "session"

    link._session, link._newest, link._closed = None, None, cast(Any, PassingTime())
    link._connect = link._address = "tcp/127.0.0.1:1"
    link._on_waiting = lambda reason: None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "open_reader", opened)
        patch.setattr(view, "Newest", lambda session: session)
        link._reach()
    assert link._newest == "session"
    assert attempts_s[-1] >= takes_s > max([0.0, *attempts_s[:-1]])
    assert attempts_s[0] <= 0.5
    assert max(attempts_s) <= LONGEST_ATTEMPT_S  # Ctrl-C waits as long


def test_a_reply_that_cannot_be_read_is_a_refusal_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's buttons get an answer, whatever a server sends."""

    def unreadable(*args: Any, **options: Any) -> None:
        raise InputError("start: reply of a server: 7 bytes are no JSON")

    monkeypatch.setattr(view, "send_command", unreadable)
    link = object.__new__(view.Link)  # without its thread, which reaches no server
    link._session = object()  # type: ignore[assignment]
    reply = link.command("start", {})
    assert not reply.ok
    assert "no JSON" in reply.message
