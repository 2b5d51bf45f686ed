"""Laws of the latency histogram."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.live.summary import LatencyHistogram, Tally
from mocapella.model.scene import Phase, TrackerState


@given(st.lists(st.floats(2e-6, 50.0), min_size=1, max_size=300), st.sampled_from([50.0, 90.0, 99.0, 100.0]))
def test_a_percentile_is_never_flattered_and_hardly_too_large(latencies: list[float], percent: float) -> None:
    histogram = LatencyHistogram()
    for latency in latencies:
        histogram.add(latency)
    exact = float(np.percentile(latencies, percent, method="inverted_cdf"))
    found = histogram.percentile(percent)
    assert found is not None
    assert exact <= found * (1 + 1e-12)
    assert found <= exact * 1.012


def test_the_largest_is_exact_and_what_is_out_of_range_counts_too() -> None:
    histogram = LatencyHistogram()
    assert histogram.percentile(50) is None
    for latency in (-1e-5, 0.0123, 1e4):
        histogram.add(latency)
    assert histogram.most == 1e4
    assert histogram.percentile(10) == pytest.approx(1e-6)
    assert histogram.percentile(50) == pytest.approx(0.0123, rel=0.012)


def test_a_run_whose_clocks_are_unknown_has_no_latency() -> None:
    assert Tally().latency_ms() is None


@given(
    st.sampled_from([Phase.WAITING_FOR_SENSORS, Phase.CALIBRATING, Phase.NEEDS_RECALIBRATION]),
    st.integers(1, 9),
    st.text(min_size=1),
)
def test_a_run_that_never_tracked_names_what_was_missing_and_the_reason(phase: Phase, count: int, reason: str) -> None:
    tally = Tally()
    tally.state(0.0, phase.value, "")
    last = TrackerState(phase, sensors_missing=count, frames_remaining=count, frames_wanted=120, reason=reason)
    why = tally.never_tracked(last)
    assert why is not None
    assert f"{count} of " in why
    assert why.endswith(f"; {reason}")
    tally.state(1.0, Phase.TRACKING.value, "")
    assert tally.never_tracked(last) is None


def test_a_run_that_was_not_started_says_so() -> None:
    assert Tally().never_tracked(TrackerState(Phase.STOPPED)) == "tracking was not started"
