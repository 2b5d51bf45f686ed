"""When a sensor is silent: within a second, or three intervals of a slow one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.pace import SILENT_AFTER_S, SILENT_INTERVALS, UNKNOWN_S, Pace

S = 10**9


def at(*seconds: float) -> Pace:
    pace = Pace()
    for second in seconds:
        pace.update(round(second * S))
    return pace


def test_before_two_frames_nothing_is_known() -> None:
    assert at().interval_s is None
    assert not at().silent(10**12)
    assert at(0.0).silent_after_s == UNKNOWN_S
    assert at(0.0).silent(round(UNKNOWN_S * S) + 1)
    assert not at(0.0).silent(round(UNKNOWN_S * S))


@given(interval_ns=st.integers(1, 6 * S), count=st.integers(2, 40))
def test_a_steady_sensor_is_silent_within_a_second_or_three_intervals(interval_ns: int, count: int) -> None:
    pace = Pace()
    for k in range(count):
        assert k < 2 or not pace.silent(k * interval_ns)  # or each of its frames would be a return
        pace.update(k * interval_ns)
    last_ns, limit_ns = (count - 1) * interval_ns, max(SILENT_AFTER_S * S, SILENT_INTERVALS * interval_ns)
    assert pace.silent(last_ns + round(limit_ns) + 1)
    assert not pace.silent(last_ns + round(limit_ns) - 1)


def test_an_outage_does_not_change_the_pace_and_a_slower_rate_does() -> None:
    steady = [k / 30 for k in range(30)]
    assert at(*steady, 60.0).interval_s == pytest.approx(1 / 30)
    assert at(*steady, 3.0, 5.0, 7.0).silent_after_s == pytest.approx(6.0)
    assert at(0.0, 1000.0).silent_after_s == 20.0


def test_a_receiver_that_stood_still_does_not_call_its_sensors_silent() -> None:
    pace = at(*(k / 30 for k in range(30)))
    assert pace.silent(6 * S)
    pace.awake(6 * S)
    assert not pace.silent(6 * S)
    assert pace.silent(7 * S)


def test_a_receiver_that_often_stands_still_reports_a_silence_all_the_same() -> None:
    pace = at(*(k / 30 for k in range(30)))
    for tenths in range(15, 35, 6):
        pace.awake(tenths * S // 10)
    assert pace.silent(3 * S)
    pace.update(4 * S)
    pace.awake(5 * S)
    assert not pace.silent(5 * S)
    Pace().awake(S)  # before any frame
