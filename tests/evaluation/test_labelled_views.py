"""Labels of left and right that a sensor has swapped are put back."""

from __future__ import annotations

import numpy as np
import pytest
from support.evaluation_sessions import log_of

from mocapella.evaluation import labelled_views as module
from mocapella.evaluation.facing_sessions import aligned_views
from mocapella.evaluation.labelled_views import MIRROR, labelled_views, shoulder_yaw, signed_alpha
from mocapella.evaluation.study_pairs import StudySession
from mocapella.geometry.angles import wrap


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


@pytest.mark.parametrize("off_deg", [0, -30, 89, -89, 91, -91, 150, 180])
def test_views_are_mirrored_beyond_a_quarter_turn_off_the_facing_and_turned_to_it(
    monkeypatch: pytest.MonkeyPatch, off_deg: float
) -> None:
    """Wherever the person and the sensors are: somebody who walks in a circle, and is known to face another way."""
    session = StudySession(log_of(frames=60, noise=0.0))
    raw = aligned_views(session)
    assert raw is not None
    facing = shoulder_yaw(raw.positions[:, 0]) + np.radians(off_deg)
    monkeypatch.setattr(module, "reference_facings", lambda *_: [facing])
    found = labelled_views(session)
    assert found is not None
    assert (found.mirrored == (abs(off_deg) > 90)).all()
    np.testing.assert_allclose(wrap(shoulder_yaw(found.positions[:, 0]) - facing), 0, atol=1e-6)
    np.testing.assert_allclose(wrap(found.alpha + raw.toward - facing[:, None]), 0, atol=1e-6)
    np.testing.assert_allclose(wrap(found.alpha - found.reported - np.radians(off_deg) + 1.0), 1.0, atol=1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("first", [-3.0, -1.0, 0.1, 1.0, 3.0])
def test_alpha_is_positive_towards_the_second_sensor(first: float, side: float) -> None:
    toward = wrap(np.array([[first, first + 0.8 * side]] * 4))
    alpha = np.array([0.3, -0.3, 2.0, 0.0])
    np.testing.assert_array_equal(signed_alpha(alpha, toward), side * alpha)
