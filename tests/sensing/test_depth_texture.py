from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mocapella.sensing.depth_texture import LEAST, SQUARE_PX, texture

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
REAL = sorted([*SHARED.glob("depth_hand_sr305/frames/*.png"), *SHARED.glob("depth_hand_sr305_2/*.png")])
FAR_M = 2.0
seeds = st.integers(0, 2**32 - 1)


def bowl(z: float = 0.5, px: int = 120) -> np.ndarray:
    """Return a quadratic surface (px, px) with its middle at a depth z [m]."""
    y, x = np.indices((px, px)) - px / 2
    return z + 1e-4 * x - 5e-5 * y + 1e-6 * (x * x + x * y + 2 * y * y)


def noisy(seed: int, sd_m: float, z: float = 0.5, blur_px: float = 0.0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((120, 120))
    if blur_px:
        noise = ndimage.gaussian_filter(noise, blur_px)
    return (bowl(z) + sd_m * noise / noise.std()).astype(np.float32)


@given(st.floats(0.3, 1.5))
def test_a_smooth_surface_has_no_texture(z: float) -> None:
    found = texture(bowl(z).astype(np.float32), far_m=FAR_M)
    assert found is not None
    assert found.rough_m < 1e-6


@given(seeds, st.floats(0.0005, 0.002), st.floats(0.3, 1.5))
def test_independent_errors_keep_their_deviation_and_are_not_alike(seed: int, sd_m: float, z: float) -> None:
    found = texture(noisy(seed, sd_m, z), far_m=FAR_M)
    assert found is not None
    assert found.rough_m == pytest.approx(sd_m, rel=0.1)
    assert found.rough_per_m == pytest.approx(sd_m / z**2, rel=0.15)
    assert -0.2 < found.alike < -0.03


@given(seeds)
def test_errors_that_neighbours_share_are_alike(seed: int) -> None:
    found = texture(noisy(seed, 0.002, blur_px=1.5), far_m=FAR_M)
    assert found is not None
    assert found.alike > 0.2


@given(seeds, st.sampled_from([0.0005, 0.001, 0.002]))
def test_the_rounding_to_a_unit_is_no_texture(seed: int, unit_m: float) -> None:
    rounded = (np.rint(noisy(seed, 0.0001) / unit_m) * unit_m).astype(np.float32)
    found = texture(rounded, far_m=FAR_M)
    assert found is not None
    assert found.rough_m < 0.00015 + 0.3 * unit_m / np.sqrt(12)


@pytest.mark.parametrize("px", [SQUARE_PX - 1, SQUARE_PX, 5 * (int(np.sqrt(LEAST)) - 1) + SQUARE_PX])
def test_small_surfaces_have_none(px: int) -> None:
    assert texture(np.full((px, px), 0.5, np.float32), far_m=FAR_M) is None


def test_holes_edges_and_far_surfaces_do_not_count() -> None:
    far = np.full((120, 120), 2.5, np.float32)
    assert texture(far, far_m=FAR_M) is None
    assert texture(np.zeros((120, 120), np.float32), far_m=FAR_M) is None
    stripes = np.tile(np.where(np.arange(120) // 5 % 2, 0.5, 0.6).astype(np.float32), (120, 1))
    assert texture(stripes, far_m=FAR_M) is None


@pytest.mark.skipif(not REAL, reason="needs depth_hand_sr305")
@pytest.mark.parametrize("unit_m", [0.000125, 0.001])
def test_real_images_of_coded_light_are_smooth_also_in_whole_millimetres(unit_m: float) -> None:
    for file in REAL[::4]:
        depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) * 0.000125
        found = texture((np.rint(depth / unit_m) * unit_m).astype(np.float32), far_m=FAR_M)
        assert found is not None
        assert found.rough_per_m < 0.0003
