"""Markers that several detectors find in one picture become one frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.markers import MarkerFrame, joined, marker_frame

FIELDS = ("positions_px", "sd_px", "areas_px", "confidences")


def found(names: Sequence[str], seed: int = 0, **other: Any) -> MarkerFrame:
    rng, n = np.random.default_rng(seed), len(names)
    values: dict[str, Any] = {
        "time_ns": 5, "size_px": (640, 480), "positions_px": rng.uniform(0, 400, (n, 2)), "sd_px": rng.random(n),
        "areas_px": rng.uniform(1, 90, n), "confidences": rng.random(n),
    }  # fmt: skip
    return marker_frame("left", names, **(values | other))


@given(st.lists(st.integers(0, 4), min_size=1, max_size=4))
def test_each_marker_is_what_its_detector_found(counts: list[int]) -> None:
    frames = [
        found([f"{k}.{i}" for i in range(count)], k, time_ns=k, node_id=k, sequence=7 - k)
        for k, count in enumerate(counts)
    ]
    whole = joined(*frames)
    first = frames[0]
    assert (whole.sensor, whole.size_px) == ("left", (640, 480))
    assert (whole.time_ns, whole.node_id, whole.sequence) == (first.time_ns, first.node_id, first.sequence)
    assert whole.names == tuple(name for one in frames for name in one.names)
    for one in frames:
        at = [whole.names.index(name) for name in one.names]
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(whole, field)[at], getattr(one, field))
    assert whole.elongations is None
    assert whole.candidates is None


def test_what_one_detector_alone_tells_is_unknown_of_the_others_markers() -> None:
    plain = found(["a", "b"])
    more = msgspec.structs.replace(
        found(["c"]), elongations=np.array([1.5], np.float32), candidates=np.array([3], np.uint8)
    )
    whole = joined(plain, more)
    assert whole.elongations is not None
    assert whole.candidates is not None
    np.testing.assert_array_equal(whole.elongations, [np.nan, np.nan, 1.5])
    np.testing.assert_array_equal(whole.candidates, [0, 0, 3])


@pytest.mark.parametrize("other", [{"sensor": "right"}, {"size_px": (480, 640)}])
def test_markers_of_another_camera_or_size_are_refused(other: dict[str, Any]) -> None:
    one, two = found(["a"]), found(["b"])
    foreign = msgspec.structs.replace(found(["c"]), **other)
    with pytest.raises(SettingsError, match="only those of one picture can"):
        joined(one, two, foreign)


def test_a_name_that_two_detectors_use_is_named() -> None:
    with pytest.raises(SettingsError, match="two detectors call a marker 'b': give it another name"):
        joined(found(["a", "b"]), found(["b", "c"]))
