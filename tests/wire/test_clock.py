"""Laws of bringing two clocks together."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import WireError
from mocapella.wire.clock import ClockProbe, SensorClock, estimate_offset, read_clock

DELAYS = st.lists(st.tuples(st.integers(0, 10**8), st.integers(0, 10**8)), min_size=1, max_size=12)


@given(offset=st.integers(-(10**15), 10**15), delays=DELAYS)
def test_the_truth_is_always_within_the_bound(offset: int, delays: list[tuple[int, int]]) -> None:
    probes = []
    now = 10**12
    for out, back in delays:
        probes.append(ClockProbe(now, now + out + offset, now + out + back))
        now += out + back + 1
    estimate = estimate_offset(probes)
    assert estimate is not None
    assert abs(estimate.offset_ns - offset) <= estimate.bound_ns
    assert estimate.bound_ns <= (min(out + back for out, back in delays) + 1) // 2


def test_no_answer_is_no_estimate() -> None:
    assert estimate_offset([]) is None
    assert estimate_offset([ClockProbe(10, 5, 9)]) is None


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


@given(st.integers(0, 2**63 - 1))
def test_a_clock_is_read_as_it_was_written(time_ns: int) -> None:
    assert read_clock(str(time_ns).encode()) == time_ns


@pytest.mark.parametrize(
    "answer", [b"", b"12.5", b"-1", b"1_0", b" 1", b"\xff", "\u0661".encode(), b"9" * 20, b"9" * 5000]
)
def test_an_answer_that_is_no_time_is_refused(answer: bytes) -> None:
    with pytest.raises(WireError, match="decimal text"):
        read_clock(answer)
