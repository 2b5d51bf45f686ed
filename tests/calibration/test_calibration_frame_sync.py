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


def test_frames_are_of_one_instant_up_to_the_tolerance_after_its_first_and_one_of_each_camera() -> None:
    found = synchronise_frames({"a": [0.0, 1.0], "b": [0.25, 1.2501], "c": [0.25, 1.5]}, 0.25)
    assert found == {("a", 0): 0, ("b", 0): 0, ("c", 0): 0, ("a", 1): 1, ("b", 1): 2, ("c", 1): 2}


def test_a_camera_with_a_single_frame_has_no_interval_and_is_matched_as_others() -> None:
    assert synchronise_frames({"a": [0.0, 0.3, 0.6], "b": [0.35]}) == {
        ("a", 0): 0,
        ("a", 1): 1,
        ("b", 0): 1,
        ("a", 2): 2,
    }
    assert synchronise_frames({"a": [0.5], "b": [0.5]}) == {("a", 0): 0, ("b", 0): 0}
    assert synchronise_frames({"a": [0.5], "b": [0.6]}) == {("a", 0): 0, ("b", 0): 1}


def test_a_tolerance_below_half_of_the_shortest_interval_is_taken_and_the_interval_is_told() -> None:
    times = {"a": [0.0, 0.25, 0.5], "b": [0.0, 1.0]}
    assert len(set(synchronise_frames(times, 0.1249).values())) == 4
    for wrong in (0.125, -0.001):
        with pytest.raises(CalibrationError, match=r"as of one instant with one every 250\.0 ms"):
            synchronise_frames(times, wrong)
