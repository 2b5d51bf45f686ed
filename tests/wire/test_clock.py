"""Laws of bringing two clocks together."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mocapella.errors import WireError
from mocapella.wire.clock import (
    DRIFT_FROM_S,
    DRIFT_OVER_S,
    MOST_DRIFT_PPM,
    ClockProbe,
    OffsetFilter,
    SensorClock,
    read_clock,
)

SECOND = 10**9
DELAY = st.integers(0, 3 * 10**8)
STEPS = st.lists(
    st.tuples(st.integers(0, 40 * SECOND), st.integers(-MOST_DRIFT_PPM, MOST_DRIFT_PPM), DELAY, DELAY),
    min_size=1,
    max_size=30,
)
"""Of successive probes: time before it [ns], drift from there on [ppm], time to the far clock and back [ns]."""


NS = 10**9
"""Units of exact times in a nanosecond."""
PS = 10**6
"""Units of exact times in a picosecond."""


class Clocks:
    """Two clocks that drift apart, at another rate from each probe on; a clock that is read shows whole nanoseconds.

    Args:
        offset_ps: of the far clock at first.
        phase_ps: how far the near clock is beyond a whole nanosecond.
    """

    def __init__(self, offset_ps: int, phase_ps: int = 0) -> None:
        self._now = self._since = 10**12 * NS + phase_ps * PS
        self._then, self._ppm = offset_ps * PS, 0

    @property
    def near(self) -> int:
        return self._now // NS

    def wait(self, ns: int) -> None:
        self._now += ns * NS

    def step(self, ns: int) -> None:
        self._then += ns * NS

    def drift(self, ppm: int) -> None:
        self._then, self._since, self._ppm = self._offset(self._now), self._now, ppm

    def probe(self, out: int, back: int) -> ClockProbe:
        sent = self.near
        self.wait(out)
        far = (self._now + self._offset(self._now)) // NS
        self.wait(back)
        return ClockProbe(sent, far, self.near)

    def beyond(self, found: OffsetFilter, later: int = 0) -> int:
        """How far the truth is beyond the bound that is shown so much later; at most 0 if the bound holds."""
        estimate = found.estimate(self.near + later)
        assert estimate is not None
        return abs(estimate.offset_ns * NS - self._offset(self._now + later * NS)) - estimate.bound_ns * NS

    def _offset(self, at: int) -> int:
        return self._then + self._ppm * (at - self._since) // 10**6  # exact, of whole picoseconds


@given(
    offset=st.integers(-(10**18), 10**18),
    phase=st.integers(0, 999),
    steps=STEPS,
    later=st.integers(0, 100 * SECOND),
)
@example(offset=500, phase=900, steps=[(0, 0, 0, 0)], later=0)
@example(offset=0, phase=0, steps=[(0, 1000, 1, 2), (7, 1000, 3, 0)] * 15, later=1)
@example(offset=0, phase=999, steps=[(0, -1000, 2, 1), (7, -1000, 0, 3)] * 15, later=999)
def test_the_truth_is_always_within_the_bound(
    offset: int, phase: int, steps: list[tuple[int, int, int, int]], later: int
) -> None:
    """Whatever the delays are, while the clocks drift by up to the largest rate, and however long no probe comes."""
    clocks, found = Clocks(offset, phase), OffsetFilter()
    for pause, ppm, out, back in steps:
        clocks.wait(pause)
        clocks.drift(ppm)
        found.update([clocks.probe(out, back)])
        assert clocks.beyond(found) <= 0
        assert clocks.beyond(found, later) <= 0
        at_once = found.estimate(clocks.near)
        assert at_once is not None
        assert at_once.bound_ns <= (out + back + 1) // 2 + MOST_DRIFT_PPM * (out + back) // 10**6 + 3
        assert at_once.offset_ns == found.offset_ns
    assert found.restarts == 0


@given(st.lists(st.tuples(DELAY, DELAY), min_size=1, max_size=20))
def test_the_fastest_question_and_the_fastest_answer_count_even_of_different_probes(
    delays: list[tuple[int, int]],
) -> None:
    clocks, found = Clocks(5), OffsetFilter()
    found.update([clocks.probe(out, back) for out, back in delays])
    estimate = found.estimate(clocks.near)
    assert estimate is not None
    fastest = min(out for out, _ in delays) + min(back for _, back in delays)
    widened = MOST_DRIFT_PPM * sum(out + back for out, back in delays) // 10**6
    assert fastest // 2 <= estimate.bound_ns <= fastest // 2 + widened + len(delays) + 3


@given(
    ppm=st.integers(-900, 900),
    delays=st.lists(st.tuples(st.integers(0, 10**7), st.integers(0, 10**7)), min_size=90, max_size=90),
)
def test_the_drift_is_within_its_bound_and_the_bound_is_that_of_a_minute(
    ppm: int, delays: list[tuple[int, int]]
) -> None:
    clocks, found = Clocks(-(10**15)), OffsetFilter()
    clocks.drift(ppm)
    for second, (out, back) in enumerate(delays):
        clocks.wait(10**12 + second * SECOND - clocks.near)
        found.update([clocks.probe(out, back)])
        estimate = found.estimate(clocks.near)
        assert estimate is not None
        assert (estimate.drift_ppm is None) == (second < DRIFT_FROM_S + 1) or second == DRIFT_FROM_S
        if estimate.drift_ppm is not None and estimate.drift_bound_ppm is not None:
            assert abs(estimate.drift_ppm - ppm) <= estimate.drift_bound_ppm + 1e-6
    assert estimate.drift_bound_ppm is not None
    assert estimate.drift_bound_ppm <= (10_000 + 10_000) * 1.01 / DRIFT_OVER_S + 1


def test_the_drift_is_known_from_its_shortest_time_on_and_is_that_of_the_longest() -> None:
    clocks, found = Clocks(0), OffsetFilter()
    clocks.drift(100)
    clocks.wait(10**12 - clocks.near)
    for second in range(2 * DRIFT_OVER_S + 1):
        found.update([clocks.probe(0, 0)])
        estimate = found.estimate(clocks.near)
        assert estimate is not None
        assert (estimate.drift_ppm is not None) == (second >= DRIFT_FROM_S)
        assert found._past[0].at_ns == 10**12 + max(0, second - DRIFT_OVER_S) * SECOND
        clocks.wait(SECOND)
    assert estimate.drift_ppm == pytest.approx(100)
    assert estimate.drift_bound_ppm == pytest.approx(0, abs=1e-4)  # readings are of whole nanoseconds


@given(step=st.integers(10**9, 10**15), sign=st.sampled_from([-1, 1]))
def test_after_a_step_of_a_clock_only_later_probes_count(step: int, sign: int) -> None:
    clocks, found = Clocks(0), OffsetFilter()
    for _ in range(20):
        clocks.wait(SECOND)
        found.update([clocks.probe(10**5, 10**5)])
    clocks.step(sign * step)
    clocks.wait(SECOND)
    found.update([clocks.probe(10**6, 10**6)])
    estimate = found.estimate(clocks.near)
    assert estimate is not None
    assert found.restarts == 1
    assert clocks.beyond(found) <= 0
    assert estimate.bound_ns < 2 * 10**6
    assert estimate.drift_ppm is None


def test_no_answer_is_no_estimate() -> None:
    found = OffsetFilter()
    found.update([])
    found.update([ClockProbe(10, 5, 9)])
    assert found.estimate(10) is found.offset_ns is None


@given(offset=st.integers(-(10**12), 10**12), latencies=st.lists(st.integers(0, 10**8), min_size=1, max_size=60))
def test_capture_time_is_never_after_arrival_and_off_by_the_smallest_latency(offset: int, latencies: list[int]) -> None:
    clock = SensorClock(window_s=1000.0)
    for k, latency in enumerate(latencies):
        true_ns = 10**13 + k * 33_000_000
        at_ns = clock.update(true_ns - offset, true_ns + latency)
        assert true_ns <= at_ns <= true_ns + latency
        assert at_ns == true_ns + min(latencies[: k + 1])


def test_a_drift_is_followed() -> None:
    clock = SensorClock(window_s=2.0)
    for k in range(3000):
        true_ns = k * 33_000_000
        at_ns = clock.update(int(true_ns * 1.001), true_ns + 1_000_000)
    assert abs(at_ns - true_ns) < 4_000_000


def test_a_jump_of_the_sensors_clock_begins_anew() -> None:
    clock = SensorClock()
    for k in range(10):
        clock.update(k * 33_000_000, k * 33_000_000 + 500)
    far = 3600 * 10**9
    assert clock.update(far, 400_000_000) == 400_000_000
    assert clock.update(far + 33_000_000, 433_000_100) == 433_000_000


@pytest.mark.parametrize(("later", "jumped"), [(20 * SECOND - 1, False), (20 * SECOND, True)])
def test_frames_that_are_later_by_a_jump_begin_anew_and_by_less_do_not(later: int, jumped: bool) -> None:
    clock = SensorClock(window_s=1000.0)
    clock.update(0, 100)
    clock.update(10, 110 + later)
    assert clock.offset_ns == (100 + later if jumped else 100)


@pytest.mark.parametrize(("earlier", "jumped"), [(2 * SECOND - 1, False), (2 * SECOND, True)])
def test_frames_that_are_earlier_by_a_jump_begin_a_new_window(earlier: int, jumped: bool) -> None:
    clock = SensorClock(window_s=10.0)
    clock.update(0, SECOND)
    clock.update(2 * SECOND + earlier, 3 * SECOND)
    assert clock.offset_ns == SECOND - earlier
    for arrival in (6 * SECOND + 1, 11 * SECOND + 3):  # more than half a window after the first frame, and again
        clock.update(arrival - SECOND, arrival)
    assert clock.offset_ns == (SECOND - earlier if jumped else SECOND)


def test_the_smallest_latency_counts_for_half_a_window_and_then_half_a_window_more() -> None:
    clock, begin = SensorClock(window_s=2.0), SECOND
    assert clock.update(begin - 100, begin) == begin
    for arrival, latency in ((2 * SECOND, 300), (2 * SECOND + 1, 400), (3 * SECOND + 1, 500)):
        assert clock.update(arrival - latency, arrival) == arrival - latency + 100
    clock.update(3 * SECOND + 2 - 600, 3 * SECOND + 2)
    assert clock.offset_ns == 400


@given(st.integers(0, 2**63 - 1))
def test_a_clock_is_read_as_it_was_written(time_ns: int) -> None:
    assert read_clock(str(time_ns).encode()) == time_ns


@pytest.mark.parametrize(
    "answer", [b"", b"12.5", b"-1", b"1_0", b" 1", b"\xff", "\u0661".encode(), b"9" * 20, b"9" * 5000]
)
def test_an_answer_that_is_no_time_is_refused(answer: bytes) -> None:
    with pytest.raises(WireError, match="decimal text"):
        read_clock(answer)
