"""The fusion of a frame's views joint by joint, beside the functions that document it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.fusion import view_kernels
from mocapella.fusion.view_kernels import ViewLanes
from mocapella.fusion.weighted_mean import FusionSettings, learn_offsets, weighted_mean
from mocapella.tracker import people_kernels

JOINTS, MOST = 4, 5
places = arrays(np.float64, (MOST, JOINTS, 3), elements=st.floats(-1, 1))
spreads = arrays(np.float64, (MOST, JOINTS), elements=st.floats(1e-4, 1.0))
seen_by = arrays(np.bool_, (MOST, JOINTS))
known_joints = arrays(np.bool_, JOINTS)


def lanes_of(views: np.ndarray, variances: np.ndarray, expected: np.ndarray, offsets: np.ndarray) -> ViewLanes:
    """The lanes of views (views, joints, 3), as the tracker writes them."""
    shape = (JOINTS, MOST)
    apart, offsets_of_lanes = np.empty((2, 3, *shape))
    lanes = ViewLanes(apart, offsets_of_lanes, np.full(shape, np.nan), np.empty(shape), np.empty(shape))
    for n, view in enumerate(views):
        lanes.variances[:, n] = variances[n]
        people_kernels.place_view(
            view, expected, offsets[None], 0, n, n, lanes.apart, lanes.offsets, lanes.variances, lanes.there
        )
    return lanes


@pytest.mark.slow
@given(st.tuples(places, spreads, seen_by, places), known_joints, st.sampled_from([5.0, np.inf]), st.integers(1, MOST))
def test_views_side_by_side_are_fused_as_one_after_the_other(
    given_views: tuple[np.ndarray, ...], known: np.ndarray, nu: float, count: int
) -> None:
    positions, variances, seen, offsets = given_views
    views, variances = np.where(seen[..., None], positions, np.nan)[:count], np.where(seen, variances, np.inf)[:count]
    expected, doubts = np.repeat(np.where(known, 0.3, np.nan)[:, None], 3, axis=1), np.where(known, 0.01, np.nan)
    offsets = 0.1 * offsets[:count]
    settings = FusionSettings()
    first = weighted_mean(views, variances, expected, doubts, nu)
    learnt = learn_offsets(offsets, views, first.positions, 0.1, settings)
    second = weighted_mean(views - learnt, variances, expected, doubts, nu)

    lanes, mean, variance = lanes_of(views, variances, expected, offsets), np.empty((JOINTS, 3)), np.empty(JOINTS)
    step = -np.expm1(-0.1 / settings.offset_s)
    view_kernels.fuse_lanes(lanes, count, expected, doubts[:, None].copy(), nu, step, mean, variance)
    np.testing.assert_allclose(mean, second.positions, atol=1e-12)
    np.testing.assert_allclose(variance, second.variances, rtol=1e-9)
    np.testing.assert_allclose(lanes.offsets[..., :count].transpose(2, 1, 0), learnt, atol=1e-12)


@pytest.mark.slow
def test_a_joint_that_no_view_has_is_unknown_and_keeps_its_offsets() -> None:
    views, offsets = np.full((2, JOINTS, 3), np.nan), np.full((2, JOINTS, 3), 0.2)
    expected, mean, variance = np.zeros((JOINTS, 3)), np.zeros((JOINTS, 3)), np.zeros(JOINTS)
    lanes = lanes_of(views, np.full((2, JOINTS), np.inf), expected, offsets)
    view_kernels.fuse_lanes(lanes, 2, expected, np.full((JOINTS, 1), 0.01), 5.0, 0.5, mean, variance)
    assert np.isnan(mean).all()
    assert np.isinf(variance).all()
    np.testing.assert_array_equal(lanes.offsets[..., :2], 0.2)
