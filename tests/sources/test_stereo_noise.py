from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.sources.simulate.depth_noise import Stereo, measured

FOCAL_PX, UNIT_M = 385.0, 0.0001
EXACT = Stereo(sd_px=0.0, fatten=0.0, unmatched=0.0, edge_unmatched=0.0, step_px=1e-6)


def seen(exact_m: np.ndarray, noise: Stereo, key: int = 1) -> np.ndarray:
    exact = exact_m.astype(np.float32)
    return measured(exact, np.ones_like(exact), noise, focal_px=FOCAL_PX, unit_m=UNIT_M, key=key) * UNIT_M


def wall(z: float, shape: tuple[int, int] = (120, 160)) -> np.ndarray:
    return np.full(shape, z)


def thing_before_wall() -> np.ndarray:
    exact = wall(2.0)
    exact[40:80, 60:100] = 0.5
    return exact


def nearer(exact_m: np.ndarray, noise: Stereo) -> np.ndarray:
    depth = seen(exact_m, noise)
    return (depth > 0) & (depth < 1.0)


def test_a_camera_without_errors_gives_the_depth() -> None:
    np.testing.assert_allclose(seen(wall(0.7), EXACT), 0.7, atol=UNIT_M)


def test_the_error_of_depth_grows_with_its_square() -> None:
    noise = replace(EXACT, sd_px=0.1)
    for z in (0.4, 0.8):
        expected = z**2 / (FOCAL_PX * noise.baseline_m) * noise.sd_px
        assert np.std(seen(wall(z), noise)) == pytest.approx(expected, rel=0.1)


def test_neighbours_within_a_block_have_nearly_the_same_error() -> None:
    off = seen(wall(0.7), replace(EXACT, sd_px=0.2)) - 0.7
    assert np.corrcoef(off[:, 1:].ravel(), off[:, :-1].ravel())[0, 1] > 0.9
    assert abs(np.corrcoef(off[:, 40:].ravel(), off[:, :-40].ravel())[0, 1]) < 0.3


def test_things_are_wider_by_half_a_block_if_the_nearer_side_always_wins() -> None:
    exact = thing_before_wall()
    near = nearer(exact, replace(EXACT, fatten=1.0, block_px=9))
    rows, columns = near.any(axis=1).nonzero()[0], near[60].nonzero()[0]
    assert (rows.min(), rows.max()) == (40 - 4, 79 + 4)
    assert (columns.min(), columns.max()) == (60 - 4, 99 + 4)
    np.testing.assert_array_equal(nearer(exact, EXACT), exact < 1.0)


def test_what_the_second_camera_does_not_see_has_no_depth() -> None:
    hidden = seen(thing_before_wall(), EXACT)[60] == 0
    shadow = FOCAL_PX * EXACT.baseline_m * (1 / 0.5 - 1 / 2.0)
    assert hidden.sum() == pytest.approx(shadow, abs=3)


def test_the_given_share_of_a_surface_is_not_matched() -> None:
    lost = seen(wall(0.7, (300, 400)), replace(EXACT, unmatched=0.1)) == 0
    assert lost.mean() == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize(
    ("name", "value"),
    [("least_m", 0.0), ("baseline_m", 0.0), ("block_px", 0), ("sd_px", -1.0), ("step_px", 0.0), ("fatten", 1.1)],
)
def test_impossible_values_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=name):
        Stereo(**{name: value})
