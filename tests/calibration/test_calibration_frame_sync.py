from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.calibration.frame_sync import synchronise_frames
from mocapella.errors import CalibrationError


@given(st.lists(st.tuples(*[st.floats(0, 0.009)] * 3), min_size=3, max_size=30))
def test_frames_a_little_apart_are_of_one_instant(late: list[tuple[float, float, float]]) -> None:
    times = {f"c{c}": [0.1 * k + of[c] for k, of in enumerate(late)] for c in range(3)}
    found = synchronise_frames(times, 0.02)
    assert all(found[f"c{c}", k] == k for c in range(3) for k in range(len(late)))


def test_a_frame_that_was_dropped_shifts_no_other() -> None:
    times = {"a": [0.0, 0.1, 0.2, 0.3], "b": [0.005, 0.205, 0.305]}
    found = synchronise_frames(times)
    assert found["a", 2] == found["b", 1]
    assert found["a", 1] not in {found["b", k] for k in range(3)}


def test_a_frame_of_unknown_time_is_of_no_instant() -> None:
    found = synchronise_frames({"a": [0.0, np.nan, 0.2], "b": [0.0, 0.1, 0.2]})
    assert ("a", 1) not in found
    assert found["a", 2] == found["b", 2]


def test_times_that_do_not_rise_and_a_tolerance_that_is_too_wide_are_refused() -> None:
    with pytest.raises(CalibrationError, match="camera b: the times of its frames do not rise"):
        synchronise_frames({"a": [0.0, 0.1], "b": [0.1, 0.1]})
    with pytest.raises(CalibrationError, match=r"50\.0 ms apart cannot be taken"):
        synchronise_frames({"a": [0.0, 0.1], "b": [0.0, 0.1]}, 0.05)
