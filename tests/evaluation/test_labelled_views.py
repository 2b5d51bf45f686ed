"""Labels of left and right that a sensor has swapped are put back."""

from __future__ import annotations

import numpy as np
from support.evaluation_sessions import log_of

from mocapella.evaluation.labelled_views import MIRROR, labelled_views
from mocapella.evaluation.study_pairs import StudySession


def test_labels_that_one_sensor_swaps_for_a_moment_are_put_back() -> None:
    log, swapped = log_of(noise=0.0), log_of(noise=0.0)
    rows = np.arange(2 * 200, 2 * 210, 2) + 1  # of the side sensor, in Walk
    swapped.positions[rows] = swapped.positions[rows][:, MIRROR]
    one, other = (labelled_views(StudySession(each)) for each in (log, swapped))
    assert one is not None
    assert other is not None
    changed = (one.raw.positions != other.raw.positions).any(axis=(2, 3))
    assert changed.sum() == len(rows)
    np.testing.assert_array_equal(one.mirrored ^ other.mirrored, changed)
    np.testing.assert_allclose(other.positions, one.positions, atol=1e-6)
