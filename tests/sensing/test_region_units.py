"""Units and limits of the region model: what a scale changes, what costs mean, and where windows begin and end."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background import FEWEST, SPREAD_UNIT, BackgroundModel, background_contour, learn_background
from mocapella.sensing.background_memory import BackgroundMemory
from mocapella.sensing.region_contour import (
    DEFAULT,
    HALF_LEVELS,
    RegionSettings,
    block_of,
    check_silhouette,
    read_band,
    region_contour,
    starting,
)

LOG_ROOT = 0.5 * math.log(2 * math.pi)
SIZE = (96, 112)


def disc(radius: float = 28.0, centre: tuple[float, float] = (54.0, 46.0), size: tuple[int, int] = SIZE) -> Any:
    """(rows, columns) signed distance of a disc [px], cut off at 16 px."""
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    return np.clip(radius - np.hypot(x - centre[0], y - centre[1]), -16, 16).astype(np.float32)


def noisy(channels: int = 3) -> Any:
    rng = np.random.default_rng(3)
    image = np.where(disc(26.0, (58.0, 49.0))[..., None] > 0, 150, 90) + rng.normal(0, 15, (*SIZE, channels))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


PLAIN = replace(DEFAULT, median=False)


def twice(s: RegionSettings) -> RegionSettings:
    """The same in an image of twice the pixels along each axis."""
    return replace(
        s, prior_weight=s.prior_weight / 4, length_weight=2 * s.length_weight, window_px=2 * s.window_px,
        band_px=2 * s.band_px, unsure_px=2 * s.unsure_px, fewest_px2=4 * s.fewest_px2,
    )  # fmt: skip


def tented(large: Any) -> Any:
    """Every second pixel of an image, as the mean of those nearer than two pixels, weighted like a tent."""
    wide = np.pad(large.astype(int), ((1, 1), (1, 1), (0, 0)), mode="edge")
    down = wide[:-2] + 2 * wide[1:-1] + wide[2:]
    both = down[:, :-2] + 2 * down[:, 1:-1] + down[:, 2:]
    assert (both % 16 == 0).all()
    return (both[::2, ::2] // 16).astype(np.uint8)


@pytest.mark.parametrize("start", [False, True])
def test_an_image_of_twice_the_pixels_has_the_same_contour_and_four_times_the_energy(start: bool) -> None:
    """If every second pixel is a sample, and the settings are in its pixels, too."""
    rng = np.random.default_rng(3)
    inside = np.repeat(np.repeat(disc(26.0, (58.0, 49.0)) > 0, 2, axis=0), 2, axis=1)[..., None]
    large = 16 * np.clip(np.where(inside, 9, 6) + rng.normal(0, 2, (192, 224, 3)), 0, 15).astype(np.uint8)
    phi, begin = disc(), disc(20.0)
    here, there = (
        region_contour(
            image, Silhouette((0, 0), step, step * phi), Silhouette((0, 0), step, step * begin) if start else None,
            settings=s, energies=True,
        )
        for step, image, s in ((1, tented(large), PLAIN), (2, large, twice(PLAIN)))
    )  # fmt: skip
    assert ((here.silhouette.phi > 0) != (phi > 0)).any()
    np.testing.assert_allclose(there.silhouette.phi, 2 * here.silhouette.phi, atol=0.02)
    np.testing.assert_allclose(there.surety, here.surety, atol=0.01)
    np.testing.assert_allclose(there.energies, 4 * here.energies, rtol=1e-3)
    assert there.iterations == here.iterations


@pytest.mark.parametrize("radius", [15.0, 28.0])
def test_a_contour_costs_its_length(radius: float) -> None:
    """Without a prior, of what is clearly foreground."""
    grey = np.full((*SIZE, 3), 120, np.uint8)
    model = BackgroundModel(grey, np.zeros_like(grey), 5.0)
    image = np.where(disc(radius)[..., None] > 0, np.uint8(220), grey)
    energies = [
        background_contour(
            image, model, Silhouette((0, 0), 1, disc()), guided=False, energies=True,
            settings=replace(PLAIN, length_weight=weight),
        ).energies[0]
        for weight in (1.0, 3.0)
    ]  # fmt: skip
    assert (energies[1] - energies[0]) / 2 == pytest.approx(2 * np.pi * radius, rel=0.05)


@given(st.floats(1e-3, 0.999))
def test_an_outlier_is_as_likely_as_its_share_says(outliers: float) -> None:
    """They have any of the half grey levels; densities leave 1/√2π to each other."""
    density = math.exp(-(replace(DEFAULT, outliers=outliers).most_nats + LOG_ROOT))
    assert density == pytest.approx(outliers / HALF_LEVELS)


@pytest.mark.parametrize("least_sd", [1.0, 2.0, 8.0])
@pytest.mark.parametrize("outliers", [0.1, 0.5])
def test_an_edge_between_plain_colours_is_as_sure_as_outliers_are_unlikely(least_sd: float, outliers: float) -> None:
    """Of three channels: a value has the least spread on its side, and is an outlier on the other."""
    s = replace(PLAIN, least_sd=least_sd, outliers=outliers, fewest_px2=1e-6, unsure_px=0.0)
    image = np.repeat(np.where(disc() > 0, 240, 10).astype(np.uint8)[..., None], 3, axis=2)
    found = region_contour(image, Silhouette((0, 0), 1, disc()), settings=s)
    assert found.surety.max() == pytest.approx(3 * (s.most_nats - math.log(2 * least_sd)), rel=0.02)


def test_samples_near_a_first_contour_are_not_learnt_from_unless_it_is_a_start() -> None:
    image, prior = noisy(), Silhouette((0, 0), 1, disc())
    sure, unsure = (replace(PLAIN, unsure_px=px, iterations=1) for px in (0.0, 8.0))
    first = [region_contour(image, prior, settings=s).surety for s in (sure, unsure)]
    assert np.abs(first[0] - first[1]).max() > 0.01
    begun = [region_contour(image, prior, prior, settings=s).surety for s in (sure, unsure)]
    np.testing.assert_array_equal(*begun)
    np.testing.assert_array_equal(begun[0], first[0])


@pytest.mark.parametrize(
    ("window_px", "step_px", "samples"),
    [(32.0, 1, 32), (32.0, 2, 16), (32.0, 3, 8), (2.0, 1, 8), (100.0, 1, 96), (200.0, 1, 200), (40.0, 4, 8)],
)
def test_a_block_is_the_window_in_samples_a_multiple_of_eight(window_px: float, step_px: int, samples: int) -> None:
    assert block_of(replace(DEFAULT, window_px=window_px), step_px) == samples


@pytest.mark.parametrize("columns", [95, 96, 97, 112])
@pytest.mark.parametrize("step", [1, 2])
def test_a_window_is_padded_to_whole_blocks_on_both_sides(columns: int, step: int) -> None:
    phi = disc()[:, :columns]
    band = read_band(noisy(), Silhouette((0, 0), step, phi), None, None, PLAIN)
    size = block_of(PLAIN, step)
    padded = band.phi.shape[1]
    assert padded % size == 0
    assert 0 <= padded - columns < size
    assert band.pad == (padded - columns) // 2
    np.testing.assert_array_equal(band.phi[:, band.pad : band.pad + columns], phi)
    np.testing.assert_array_equal(band.inside[:, band.pad : band.pad + columns], phi > 0)
    assert band.values.shape == (3, len(band.blocks), size)
    assert band.size_px == (SIZE[1], SIZE[0])


@pytest.mark.parametrize(("step", "reach"), [(1, 16), (2, 8), (3, 6), (40, 1)])
def test_distances_are_told_as_far_as_the_priors_in_whole_steps(step: int, reach: int) -> None:
    prior = Silhouette((0, 0), step, disc())
    assert read_band(noisy(), prior, None, None, PLAIN).reach == reach
    free = read_band(noisy(), prior, None, None, replace(PLAIN, band_px=7.0), guided=False)
    assert free.reach == max(-(-7 // step), 1)


def test_a_silhouette_has_at_least_two_rows_and_columns_of_single_precision() -> None:
    check_silhouette(Silhouette((0, 0), 1, np.zeros((2, 2), np.float32)), "start")
    for phi in (np.zeros((1, 2), np.float32), np.zeros((2, 1), np.float32), np.zeros((2, 2)), np.zeros(4, np.float32)):
        with pytest.raises(SettingsError, match=r"start\.phi is"):
            check_silhouette(Silhouette((0, 0), 1, phi), "start")
    with pytest.raises(SettingsError, match="step_px"):
        check_silhouette(Silhouette((0, 0), 0, np.zeros((2, 2), np.float32)), "start")


@pytest.mark.parametrize(
    ("shape", "right"),
    [((96, 112), True), ((96, 112, 1), True), ((96, 112, 3), True), ((96, 112, 2), False), ((96, 112, 4), False),
     ((96,), False), ((1, 96, 112, 3), False), ((0, 112), False)],
)  # fmt: skip
def test_an_image_has_one_channel_or_three(shape: tuple[int, ...], right: bool) -> None:
    prior = Silhouette((0, 0), 1, disc())
    if right:
        assert len(read_band(np.zeros(shape, np.uint8), prior, None, None, PLAIN).values) == (
            3 if shape[-1] == 3 else 1
        )
    else:
        with pytest.raises(SettingsError, match="image is uint8 of shape"):
            read_band(np.zeros(shape, np.uint8), prior, None, None, PLAIN)


def test_energies_need_a_background_that_is_known_everywhere_or_nowhere() -> None:
    image, prior = noisy(), Silhouette((0, 0), 1, disc())
    memory = BackgroundMemory(1)
    memory.update(image, prior)
    assert region_contour(image, prior, background=memory).iterations > 0
    with pytest.raises(SettingsError, match="energies is True"):
        region_contour(image, prior, background=memory, energies=True)


@given(
    st.tuples(st.integers(-9, 9), st.integers(-9, 9)), st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    st.integers(1, 4), st.integers(1, 4),
)  # fmt: skip
def test_a_start_is_read_at_its_nearest_sample(
    origin: tuple[int, int], other: tuple[int, int], step: int, other_step: int
) -> None:
    """Of two that are as near, at the later one. Beyond the start's window the prior is taken."""
    rng = np.random.default_rng(0)
    prior = Silhouette(origin, step, rng.normal(size=(5, 7)).astype(np.float32))
    start = Silhouette(other, other_step, rng.normal(size=(6, 4)).astype(np.float32))
    found = starting(prior, start)

    def nearest(axis: int, sample: int) -> int:
        at = origin[axis] + step * sample - other[axis]
        return min(range(50, -50, -1), key=lambda k: abs(at - other_step * k))

    for i, j in np.ndindex(5, 7):
        row, column = nearest(1, i), nearest(0, j)
        within = 0 <= row < 6 and 0 <= column < 4
        assert found[i, j] == (start.phi[row, column] > 0 if within else prior.phi[i, j] > 0)


def test_the_spread_of_a_pixel_is_its_noise_in_quarters_of_a_level() -> None:
    rng = np.random.default_rng(0)
    images = [np.clip(rng.normal(120, 8, (60, 60, 3)).round(), 0, 255).astype(np.uint8) for _ in range(41)]
    model = learn_background(images)
    assert model.spread.mean() / SPREAD_UNIT == pytest.approx(8, rel=0.06)
    assert model.usual.mean() == pytest.approx(120, abs=0.5)
    wild = [np.full((4, 4), 255 * (k % 2), np.uint8) for k in range(8)]
    assert (learn_background(wild).spread == 255).all()


def test_a_background_is_learnt_from_three_images_in_gray_or_colour() -> None:
    for shape in ((4, 5), (4, 5, 3)):
        images = [np.full(shape, 7, np.uint8)] * FEWEST
        assert learn_background(images).usual.shape == shape
        with pytest.raises(SettingsError, match="at least 3"):
            learn_background(images[1:])
    for images in ([np.zeros((4, 5))] * 3, [np.zeros((4, 5, 1), np.uint8)] * 3, [np.zeros(4, np.uint8)] * 3,
                   [*[np.zeros((4, 5), np.uint8)] * 3, np.zeros((5, 4), np.uint8)]):  # fmt: skip
        with pytest.raises(SettingsError, match="all must be uint8 of one shape"):
            learn_background(images)


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("origin", [(0, 0), (8, 4), (13, 9)])
def test_an_image_that_is_its_background_costs_the_same_everywhere(step: int, origin: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*SIZE, 3)).astype(np.uint8)
    model = BackgroundModel(image, np.zeros_like(image), 6.0)
    window = Silhouette(origin, step, np.ones((30, 37), np.float32))
    for median in (False, True):
        settings = replace(DEFAULT, median=median)
        band = read_band(image, window, None, None, settings, guided=False)
        assert band.pad > 0
        np.testing.assert_allclose(model.costs(band, settings)[band.known > 0], 3 * math.log(2 * 6.0), rtol=1e-5)


def test_a_background_of_another_size_or_channels_is_refused() -> None:
    window = Silhouette((0, 0), 1, np.ones((30, 37), np.float32))
    band = read_band(noisy(), window, None, None, PLAIN)
    for shape in ((96, 111, 3), (95, 112, 3), (96, 112), (112, 96, 3)):
        with pytest.raises(SettingsError, match="the background is of shape"):
            BackgroundModel(np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)).costs(band)


@pytest.mark.parametrize("sd", [6.0, 10.0])
@pytest.mark.parametrize("side", [-1, 1])
def test_without_a_prior_a_pixel_is_foreground_if_any_value_is_likelier_than_the_background(
    sd: float, side: int
) -> None:
    """A uniform density over the half levels, 1/510, against a normal one, whose values beside the mean are rarer."""
    limit = sd * math.sqrt(2 * math.log(HALF_LEVELS / (2 * sd * math.sqrt(2 * math.pi))))
    grey = np.full((*SIZE, 3), 120, np.uint8)
    model = BackgroundModel(grey, np.zeros_like(grey), sd, darkest=1.0)
    window = Silhouette((0, 0), 1, disc())
    settings = replace(PLAIN, length_weight=0.0, outliers=0.999)
    for off, seen in ((math.floor(limit), False), (math.ceil(limit), True)):
        image = grey.copy()
        image[30:60, 40:80] = 120 + side * off
        found = background_contour(image, model, window, guided=False, settings=settings).silhouette.phi > 0
        assert found[30:60, 40:80].all() == seen
        assert found.any() == seen


def test_ignored_pixels_are_no_foreground() -> None:
    grey = np.full((*SIZE, 3), 120, np.uint8)
    model = BackgroundModel(grey, np.zeros_like(grey), 5.0)
    image, ignore = grey.copy(), np.zeros(SIZE, np.bool_)
    image[30:60, 40:80] = 220
    ignore[30:60, 40:80] = True
    window = Silhouette((0, 0), 1, disc())
    assert not (background_contour(image, model, window, guided=False, ignore=ignore).silhouette.phi > 0).any()
    assert (background_contour(image, model, window, guided=False).silhouette.phi > 0).any()
