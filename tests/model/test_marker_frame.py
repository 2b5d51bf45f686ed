from __future__ import annotations

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.model.markers import marker_frame


def test_nothing_is_said_of_a_marker_that_is_not_seen() -> None:
    frame = marker_frame("left", ("a", "b"), [[1.0, 2.0], [np.nan, 3.0]], time_ns=5, size_px=(640, 480))
    np.testing.assert_array_equal(frame.found, [True, False])
    assert np.isnan(frame.positions_px[1]).all()
    assert np.isnan([frame.sd_px[1], frame.elongations[1]]).all()
    assert frame.areas_px[1] == frame.confidences[1] == 0
    assert frame.positions_px.dtype == np.float32
    assert frame.key == ("left", 0, 0)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(SettingsError, match="positions_px"):
        marker_frame("left", ("a",), np.zeros((2, 2)), time_ns=0, size_px=(2, 2))
    with pytest.raises(SettingsError, match="sd_px"):
        marker_frame("left", ("a",), [[0, 0]], sd_px=[1, 2], time_ns=0, size_px=(2, 2))
    with pytest.raises(SettingsError, match="marker name 'a'"):
        marker_frame("left", ("a", "a"), np.zeros((2, 2)), time_ns=0, size_px=(2, 2))
    with pytest.raises(SettingsError, match="sensor name"):
        marker_frame("a b", ("a",), [[0, 0]], time_ns=0, size_px=(2, 2))
