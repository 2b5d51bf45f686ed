"""Laws of what the method webcams states: slow detector errors, predictions, and cameras that see nobody."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import Matches, Rays
from mocapella.model.keypoints import KeypointFrame
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_cameras_kernels import MISSED_WEIGHT, WELL_KNOWN, count_refuting
from mocapella.tracker.webcams_errors_kernels import (
    LEAST_GAIN,
    follow_unpredicted,
    stated_variance,
    widen,
)
from mocapella.tracker.webcams_memory import no_counts, no_people
from mocapella.tracker.webcams_people_kernels import forget, refuting
from mocapella.tracker.webcams_warmup import circle_of_cameras, seen_people, standing_person

Float64 = NDArray[np.float64]

SD_M = 0.02
DISTANCE_M = 4.0


def widened(gain: float, correlation: float, support: int = 2) -> float:
    """The factor by which `widen` raises the variance of a joint before three cameras at right angles."""
    origins = -DISTANCE_M * np.eye(3)
    # Each ray informs about two of three directions: 2 / sd² of each coordinate, so P = gain · sd² / 2.
    covariances = np.full((26, 3, 3), np.nan)
    covariances[4] = gain * SD_M**2 / 2.0 * np.eye(3)
    before = covariances[4].copy()
    joints, sds = np.full(3, 4), np.full(3, SD_M / DISTANCE_M)
    widen(
        joints, origins, np.eye(3), sds, np.ones(3), correlation, np.zeros((26, 3)), np.full(26, support, np.uint8),
        covariances,
    )  # fmt: skip
    factor = covariances[4] / before[0, 0]
    np.testing.assert_allclose(factor, factor[0, 0] * np.eye(3), atol=1e-12)
    return float(factor[0, 0])


@pytest.mark.parametrize(("gain", "correlation"), [(0.3, 0.0), (0.3, 0.65), (0.5, 0.65), (0.8, 0.9), (1.0, 0.9)])
def test_the_variance_is_that_of_a_filter_of_correlated_errors(gain: float, correlation: float) -> None:
    """The added variance is the difference of two simulated filters: of correlated errors, and of white ones."""
    random = np.random.default_rng(3)
    R, n = 1.0, 20_000
    state, noise, values = 0.0, 0.0, []
    for fresh in random.normal(size=n):
        noise = correlation * noise + np.sqrt(1.0 - correlation**2) * fresh
        state += gain * (noise - state)
        values.append(state)
    white = gain * R / (2.0 - gain)
    own = gain * R
    expected = (own + float(np.var(values)) - white) / own
    assert widened(gain, correlation) == pytest.approx(expected, rel=0.12)


def test_white_errors_and_single_cameras_change_nothing_and_small_gains_are_limited() -> None:
    assert widened(0.4, 0.0) == pytest.approx(1.0)
    assert widened(0.4, 0.9, support=1) == 1.0
    assert widened(0.01, 0.6) == pytest.approx(widened(LEAST_GAIN, 0.6))


def test_a_predicted_variance_follows_the_errors_of_earlier_predictions() -> None:
    people = no_people(10, 2)
    people.positions[0] = 0.0
    people.support[0] = 2
    people.covariances[0] = 0.01**2 * np.eye(3)
    wide = 0.2**2 * np.eye(3)
    assert stated_variance(people, 0, 4, 1.0, 0.05, wide, True) == pytest.approx(
        0.2**2
    )  # no prediction was compared yet
    random = np.random.default_rng(1)
    for _ in range(400):
        follow_unpredicted(people, 0, 0.1, random.normal(scale=0.03, size=(26, 3)))
    ahead = np.array([stated_variance(people, 0, j, 1.0, 0.05, wide, True) for j in range(26)])
    assert np.sqrt(ahead.mean()) == pytest.approx(np.hypot(0.01, 0.015), rel=0.1)
    assert stated_variance(people, 0, 4, 1.0, 0.05, 0.005**2 * np.eye(3), True) == pytest.approx(0.005**2)
    assert stated_variance(people, 0, 4, 1.0, 0.05, wide, False) == pytest.approx(0.2**2)
    people.support[0], people.measured_s[0], people.measured_variances[0] = 1, 0.95, 0.02**2
    one = np.array([stated_variance(people, 0, j, 1.0, 0.05, wide, True) for j in range(26)])
    assert np.sqrt(one.mean()) == pytest.approx(np.hypot(0.02, 0.03), rel=0.1)  # 0.1 s after two cameras agreed
    people.support[0] = 0
    assert stated_variance(people, 0, 4, 1.0, 0.05, wide, True) == pytest.approx(0.2**2)
    before = people.unpredicted.copy()
    follow_unpredicted(people, 0, 0.0, np.zeros((26, 3)))
    follow_unpredicted(people, 0, 0.1, np.full((26, 3), np.nan))
    np.testing.assert_array_equal(people.unpredicted, before)


@given(st.lists(st.floats(1e-5, 2e-3), max_size=30))
def test_the_keypoints_own_errors_are_no_large_speed_in_frames_that_follow_each_other_closely(dts: list[float]) -> None:
    people = no_people(10, 2)
    people.positions[0], people.support[0] = 0.0, 2
    for dt in (1 / 30, *dts):
        follow_unpredicted(people, 0, dt, np.full((26, 3), 0.03))
    assert (people.unpredicted[0] < 1.2 * (0.03 * 30) ** 2).all()


def test_a_camera_before_which_a_person_is_hidden_neither_refutes_nor_confirms() -> None:
    rig = circle_of_cameras(2)
    cameras, joints = WebcamsTracker(rig)._cameras, standing_person()
    people = no_people(10, 2)
    people.positions[0] = joints
    seen = [one.frame for one in seen_people(rig, [joints], at_ns=0)]
    pixels = np.array([one.positions_px[0] for one in seen if isinstance(one, KeypointFrame)], dtype=np.float64)
    both, counts = np.ones(2, dtype=np.bool_), no_counts(2)

    def after(first: int, count: int, person: int) -> list[float]:
        """What the cameras tell after an instant of ``count`` detections from camera ``first`` on."""
        at, empty = slice(first, first + count), np.zeros((count, 26, 3))
        rays = Rays(np.arange(first, first + count), np.zeros(count), empty, np.ones((count, 26)), np.ones((count, 26)))
        owner = np.full(count, person)
        matches = Matches(owner, np.zeros(count, dtype=np.bool_), np.full(count, -1), np.full(count, np.nan))
        assert count_refuting(people, 0, pixels[at].copy(), rays, cameras, matches, both, counts) == 2  # both look
        return [float(value) for value in people.refuted[0]]

    assert after(1, 1, -1)[0] == 1.0  # camera 0 sees nobody; before camera 1 somebody else stands
    assert np.isnan(people.refuted[0, 1])
    assert refuting(people, 0, counts.missed) == 1.0
    assert after(0, 2, -1)[0] == 1.0  # now before both
    assert after(0, 2, 0) == [pytest.approx(0.8), 0.0]
    assert not counts.missed.any()  # the person is not well known
    people.cameras[0], people.sure[0] = 2, WELL_KNOWN
    after(1, 1, 0)
    assert counts.missed.tolist() == [MISSED_WEIGHT, 0.0]
    after(0, 2, 0)
    assert 0.0 < counts.missed[0] < MISSED_WEIGHT
    forget(people, 0)
    assert np.isnan(people.refuted[0]).all()
    assert refuting(people, 0, counts.missed) == 0.0
