from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.errors import SettingsError
from mocapella.fusion.weighted_mean import FusionSettings, learn_offsets, view_variances, weighted_mean
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.sources.simulate.measured import measured_errors

VIEWS, JOINTS = 3, 4
places = arrays(np.float64, (VIEWS, JOINTS, 3), elements=st.floats(-5, 5))
spreads = arrays(np.float64, (VIEWS, JOINTS), elements=st.floats(1e-4, 1.0))
seen_by = arrays(np.bool_, (VIEWS, JOINTS))
NOWHERE, NEVER = np.full((JOINTS, 3), np.nan), np.full(JOINTS, np.nan)


def views_of(positions: np.ndarray, variances: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.where(seen[..., None], positions, np.nan), np.where(seen, variances, np.inf)


@given(places, spreads, seen_by, arrays(np.float64, (JOINTS, 3), elements=st.floats(-5, 5)), st.floats(-3, 3))
def test_moving_everything_moves_the_mean_along(
    positions: np.ndarray, variances: np.ndarray, seen: np.ndarray, expected: np.ndarray, angle: float
) -> None:
    views, variances = views_of(positions, variances, seen)
    T = rigid(rotation_about_x(angle) @ rotation_about_y(2 * angle), [3, -1, 2])
    doubt = np.full(JOINTS, 0.01)
    here = weighted_mean(views, variances, expected, doubt, 5.0)
    there = weighted_mean(apply(T, views), variances, apply(T, expected), doubt, 5.0)
    np.testing.assert_allclose(there.positions, apply(T, here.positions), atol=1e-8)
    np.testing.assert_allclose(there.variances, here.variances, rtol=1e-6, atol=1e-10)


@given(places, spreads, seen_by, st.permutations(range(VIEWS)))
def test_the_order_of_the_views_does_not_matter(
    positions: np.ndarray, variances: np.ndarray, seen: np.ndarray, order: list[int]
) -> None:
    views, variances = views_of(positions, variances, seen)
    one = weighted_mean(views, variances, NOWHERE, NEVER, 5.0)
    other = weighted_mean(views[order], variances[order], NOWHERE, NEVER, 5.0)
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-10)


@given(places, spreads, seen_by)
def test_a_joint_has_a_mean_where_some_view_has_it_and_it_lies_among_them(
    positions: np.ndarray, variances: np.ndarray, seen: np.ndarray
) -> None:
    views, variances = views_of(positions, variances, seen)
    fused = weighted_mean(views, variances, NOWHERE, NEVER, 5.0)
    some = seen.any(axis=0)
    np.testing.assert_array_equal(np.isfinite(fused.positions).all(axis=-1), some)
    np.testing.assert_array_equal(np.isfinite(fused.variances), some)
    least, most = np.nanmin(views[:, some], axis=0), np.nanmax(views[:, some], axis=0)
    assert (fused.positions[some] >= least - 1e-9).all()
    assert (fused.positions[some] <= most + 1e-9).all()


def test_two_views_by_hand() -> None:
    views = np.array([[[0.0, 0, 0]], [[0.3, 0, 0]]])
    fused = weighted_mean(views, np.array([[0.01], [0.02]]), NOWHERE[:1], NEVER[:1], math.inf)
    np.testing.assert_allclose(fused.positions, [[0.1, 0, 0]])
    spread = (2 / 3 * 0.1**2 + 1 / 3 * 0.2**2) / 3
    np.testing.assert_allclose(fused.variances, [1 / 150 + spread])


def test_a_view_that_is_wrong_hardly_pulls() -> None:
    views = np.array([[[0.0, 0, 0]], [[1.0, 0, 0]]])
    variances = np.full((2, 1), 1e-4)
    fused = weighted_mean(views, variances, np.zeros((1, 3)), np.full(1, 1e-4), 5.0)
    assert fused.positions[0, 0] < 0.01
    assert weighted_mean(views, variances, np.zeros((1, 3)), np.full(1, 1e-4), math.inf).positions[0, 0] == 0.5


def test_far_inferred_clipped_and_old_views_are_worth_less() -> None:
    settings = FusionSettings()
    states = np.array([[2, 1, 0], [2, 2, 2], [2, 2, 2], [2, 2, 2]], dtype=np.uint8)
    variances = view_variances(
        states,
        np.array([2.0, 4.0, 2.0, 2.0]),
        np.array([False, False, True, False]),
        np.array([0, 0, 0, 0.1]),
        settings,
    )
    base = settings.sd_m**2
    np.testing.assert_allclose(variances[0], [base, base * settings.inferred_factor**2, np.inf])
    np.testing.assert_allclose(variances[1], base * 16)
    np.testing.assert_allclose(variances[2], base * settings.clipped_factor**2)
    np.testing.assert_allclose(variances[3], base + (0.1 * settings.age_speed_m_s) ** 2)


def test_a_joint_does_not_jump_when_a_view_is_lost_and_drifts_to_what_is_left() -> None:
    settings = FusionSettings(offset_s=1.0)
    both = np.array([[[0.0, 0, 0]], [[0.1, 0, 0]]])
    variances, offsets = np.full((2, 1), 1e-4), np.zeros((2, 1, 3))
    made = []
    for k in range(300):
        views = both if k < 150 else np.stack([both[0], np.full((1, 3), np.nan)])
        seen = np.where(np.isfinite(views[..., 0]), variances, np.inf)
        raw = weighted_mean(views, seen, NOWHERE[:1], NEVER[:1], math.inf)
        offsets = learn_offsets(offsets, views, raw.positions, 1 / 30, settings)
        made.append(weighted_mean(views - offsets, seen, NOWHERE[:1], NEVER[:1], math.inf).positions[0, 0])
    assert made[149] == pytest.approx(0.05, abs=1e-3)
    assert np.abs(np.diff(made)).max() < 0.002
    assert made[-1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("name", ["sd_m", "degrees_of_freedom"])
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        FusionSettings(**{name: 0.0})


def test_an_inferred_joint_counts_about_as_measured() -> None:
    sd_m = measured_errors().sd_m  # (25, visible or hidden, directions)
    ratio = np.exp(np.log(sd_m[:, 1] / sd_m[:, 0]).mean())
    assert ratio <= FusionSettings().inferred_factor <= 1.5 * ratio
