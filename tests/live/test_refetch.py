"""When missing frames are asked for again."""

from __future__ import annotations

from mocapella.live.refetch import ASK_AFTER_S, MOST_ASKS, Refetch


def asked(refetch: Refetch, missing: int, begin_s: float, end_s: float) -> list[float]:
    """How far back was asked, each time, while so many frames are missing; looked at five times a second."""
    times = [begin_s + 0.2 * k for k in range(round((end_s - begin_s) / 0.2))]
    return [back for now_s in times if (back := refetch.update(missing, now_s)) is not None]


def test_nothing_is_asked_while_nothing_is_missing() -> None:
    assert asked(Refetch(), 0, 100.0, 200.0) == []


def test_a_gap_is_left_to_the_bus_for_a_moment() -> None:
    refetch = Refetch()
    refetch.opened(149.0)
    assert asked(refetch, 7, 150.0, 150.0 + 0.9 * ASK_AFTER_S) == []
    assert asked(refetch, 0, 152.0, 160.0) == []


def test_at_the_end_of_a_take_it_is_not() -> None:
    refetch = Refetch()
    refetch.opened(149.0)
    back = refetch.update(7, 150.0, at_once=True)
    assert back is not None
    assert back > 1.0


def test_it_is_asked_back_to_the_frame_before_the_oldest_gap() -> None:
    refetch = Refetch()
    refetch.opened(60.0)
    refetch.opened(30.0)
    refetch.opened(90.0)
    backs = asked(refetch, 7, 100.0, 100.0 + 2.5 * ASK_AFTER_S)
    assert len(backs) == 2
    assert all(70.0 < back < 90.0 for back in backs)


def test_a_gap_that_was_mended_is_not_asked_for_with_the_next() -> None:
    refetch = Refetch()
    refetch.opened(30.0)
    assert asked(refetch, 0, 100.0, 1000.0) == []
    refetch.opened(999.0)
    (back,) = asked(refetch, 7, 1000.0, 1000.0 + 1.5 * ASK_AFTER_S)
    assert 1.0 < back < 20.0


def test_what_does_not_come_is_given_up_and_what_is_lost_after_it_is_asked_for_anew() -> None:
    refetch = Refetch()
    refetch.opened(0.0)
    assert len(asked(refetch, 7, 0.0, 100.0)) == MOST_ASKS
    assert refetch.given_up == 7
    refetch.opened(100.0)
    assert len(asked(refetch, 9, 100.0, 200.0)) == MOST_ASKS


def test_what_an_earlier_part_misses_is_not_asked_for_since_nobody_knows_how_old_it_is() -> None:
    refetch = Refetch()
    assert asked(refetch, 7, 0.0, 100.0) == []
    assert refetch.given_up == 7


def test_what_comes_after_all_is_no_longer_given_up() -> None:
    refetch = Refetch()
    refetch.opened(0.0)
    asked(refetch, 7, 0.0, 100.0)
    assert asked(refetch, 0, 100.0, 110.0) == []
    assert refetch.given_up == 0


def test_what_newcomers_sent_before_is_asked_for_once_though_no_gap_is_known() -> None:
    """As of a sensor that began while the server was away: nobody can know what is missing of it."""
    refetch = Refetch()
    refetch.newcomer(60.0, 100.0)
    refetch.newcomer(90.0, 101.0)
    (back,) = asked(refetch, 0, 100.0, 200.0)
    assert 40.0 + ASK_AFTER_S < back < 60.0
