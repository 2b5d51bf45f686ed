"""Labels of left and right that a sensor has swapped are put back."""

from __future__ import annotations

import numpy as np
import pytest
from support.evaluation_sessions import body, log_of, walker

from mocapella.evaluation import labelled_views as module
from mocapella.evaluation.facing_sessions import AlignedViews, aligned_views
from mocapella.evaluation.labelled_views import MIRROR, labelled_views, shoulder_yaw, signed_alpha
from mocapella.evaluation.study_pairs import StudySession
from mocapella.geometry.angles import wrap
from mocapella.sources.simulate.body import JOINT


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


def raw_views(at_s: np.ndarray, task: np.ndarray, places: list[list[float]]) -> AlignedViews:
    shape = (len(at_s), 2)
    seen = np.zeros((*shape, 25, 3))
    return AlignedViews(np.stack([at_s] * 2, axis=1), task, seen, seen, np.array(places), np.zeros(shape))


@pytest.mark.parametrize("late_s", [-0.06, 0.0, 0.04])
def test_the_second_view_is_taken_from_when_somebody_who_moves_is_nearest_in_it(late_s: float) -> None:
    """Those who stand still do not tell; in their frames, the second view is later still."""
    at_s, path = walker(120)
    flat = path.reshape(120, -1)
    stands = np.arange(120) < 60
    shown_s = at_s - np.where(stands, 0.08, late_s)
    late = np.stack([np.interp(shown_s, at_s, column) for column in flat.T], axis=1).reshape(path.shape)
    task = np.where(stands, module.STATIONARY, module.WALK)
    found = module._at_one_time(np.stack([path, late], axis=1), raw_views(at_s, task, [[0, 0, 0]] * 2))
    np.testing.assert_array_equal(found[:, 0], path)
    np.testing.assert_allclose(found[66:-3, 1], path[66:-3], atol=0.003)


@pytest.mark.parametrize("size", [0.7, 1.0, 1.2])
def test_the_own_trunk_hides_what_is_just_behind_it_from_the_front_at_any_size(size: float) -> None:
    """A hand beside the trunk, or before it, is not hidden; from the back it is the other way round."""
    joints = body()
    joints[JOINT["HandLeft"]] = [0.04, 0.25, -0.3]
    joints[JOINT["HandRight"]] = [-0.04, 0.25, 0.3]
    joints[JOINT["ThumbLeft"]] = [0.4, 0.25, -0.3]
    for name in ("Elbow", "Wrist", "HandTip"):
        for side, sign in (("Left", 1), ("Right", -1)):
            joints[JOINT[name + side]] = [sign * 0.9, 1.2, 0.0]
    seen = size * np.stack([np.stack([joints + np.array([0.0, 0.0, 2.4])] * 2)] * 3)
    raw = raw_views(np.arange(3.0), np.full(3, module.WALK), [[0.0, 0.25 * size, 4.8 * size], [0.0, 0.25 * size, 0.0]])
    found = module._hidden(seen, raw)
    for joint, hidden in (("HandLeft", [True, False]), ("HandRight", [False, True]), ("ThumbLeft", [False, False])):
        assert found[:, :, JOINT[joint]].tolist() == [hidden] * 3
