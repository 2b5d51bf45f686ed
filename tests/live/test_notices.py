"""Notices: never blocking, escaped, and limited where other programs cause them."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from support.programs import wait_until

from mocapella.live.notices import Notices
from mocapella.model.limits import LONGEST_NOTICE, NOTICES_A_SECOND, NOTICES_AT_ONCE


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def notices(said: list[str], clock: Clock) -> Iterator[Notices]:
    made = Notices(said.append, clock=clock)
    yield made
    made.close()


def test_a_notice_is_shown_escaped_and_cut(notices: Notices, said: list[str]) -> None:
    notices.add("\x1b[2J" + "x" * 10_000)
    notices.close()
    assert said == list(notices.newest)
    assert said[0].startswith(r"\x1b[2Jxxx")
    assert len(said[0]) <= LONGEST_NOTICE + 3


def test_a_flood_of_foreign_notices_is_counted_and_hides_nothing(
    notices: Notices, said: list[str], clock: Clock
) -> None:
    for k in range(1000):
        notices.add(f"junk {k}", foreign=True)
    notices.add("RECORDING STOPPED")
    assert notices.newest[-1] == "RECORDING STOPPED"
    assert notices.left_out == 1000 - NOTICES_AT_ONCE
    notices.beat()
    assert notices.newest[-1] == "RECORDING STOPPED"
    clock.now_s = 1.0
    notices.beat()
    notices.beat()
    assert notices.newest[-1] == f"{1000 - NOTICES_AT_ONCE} more notices were left out: too many at once"
    for k in range(1000):
        notices.add(f"junk {k}", foreign=True)
    notices.close()
    assert len(said) == NOTICES_AT_ONCE + 2 + NOTICES_A_SECOND - 1


def test_a_terminal_that_is_closed_ends_nothing() -> None:
    tried = list[str]()

    def closed(text: str) -> None:
        tried.append(text)
        raise BrokenPipeError(32, "Broken pipe")

    notices = Notices(closed)
    notices.add("a")
    notices.add("b")
    notices.close()
    assert tried == ["a", "b"]


def test_a_terminal_that_takes_nothing_holds_nobody_up() -> None:
    hold, entered = threading.Event(), threading.Event()

    def never(text: str) -> None:
        entered.set()
        hold.wait(60.0)

    notices = Notices(never)
    for k in range(1000):  # on this thread, which would wait for ever
        notices.add(f"state {k}")
    assert entered.wait(30.0)
    assert notices.newest[-1] == "state 999"
    assert notices.left_out > 0
    hold.set()
    wait_until("the rest is written", notices._unsaid.empty)
    notices.close()
