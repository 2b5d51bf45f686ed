"""The region model: laws of its energy and of images seen otherwise, then pictures whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks._outlined_people import KINDS, SIZE_PX, Shot, at_every_pixel, shot
from mocapella.errors import SettingsError
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background import BackgroundModel, background_contour, learn_background
from mocapella.sensing.region_contour import DEFAULT, GRAY, RegionContour, RegionSettings, region_contour, starting

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]


def disc(centre: tuple[float, float], radius: float, size: tuple[int, int], step: int = 1) -> NDArray[np.float32]:
    """(rows, columns) signed distance [px] of a disc (x, y), cut off at 16 px; size in samples."""
    y, x = step * np.mgrid[: size[0], : size[1]].astype(float)
    return np.clip(radius - np.hypot(x - centre[0], y - centre[1]), -16, 16).astype(np.float32)


def noisy(seed: int, channels: int = 3, size: tuple[int, int] = (96, 112)) -> UInt8:
    """A disc of other values than what is around it, in noise: (h, w, channels)."""
    rng = np.random.default_rng(seed)
    inside = disc((58.0, 49.0), 27.0, size) > 0
    two = rng.uniform(30, 220, (2, channels))
    image = np.where(inside[..., None], two[0], two[1]) + rng.normal(0, rng.uniform(2, 30), (*size, channels))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def prior_of(step: int, size: tuple[int, int] = (96, 112)) -> Silhouette:
    return Silhouette((0, 0), step, disc((54.0, 46.0), 28.0, (size[0] // step, size[1] // step), step))


def iou(a: Bool, b: Bool) -> float:
    return float((a & b).sum() / (a | b).sum())


@cache
def picture(kind: str, seed: int) -> Shot:
    return shot(kind, seed)


def same(a: RegionContour, b: RegionContour) -> None:
    np.testing.assert_array_equal(a.silhouette.phi, b.silhouette.phi)
    np.testing.assert_array_equal(a.surety, b.surety)


# Laws


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.sampled_from([1, 3]), st.sampled_from([1, 2, 3]), st.floats(0, 1), st.floats(0, 20))
def test_the_energy_falls_with_every_iteration(
    seed: int, channels: int, step: int, prior_weight: float, length_weight: float
) -> None:
    how = replace(DEFAULT, prior_weight=prior_weight, length_weight=length_weight, iterations=12)
    found = region_contour(noisy(seed, channels), prior_of(step), settings=how, energies=True)
    falls = np.diff(found.energies)
    assert (falls <= 1e-5 * abs(found.energies[:-1]) + 1e-2).all()
    assert found.energies[-1] < found.energies[0]
    assert np.isfinite(found.silhouette.phi).all()
    assert np.isfinite(found.surety).all()


def test_energies_cost_time_and_change_nothing() -> None:
    image, prior = noisy(5), prior_of(2)
    told, silent = (region_contour(image, prior, energies=e) for e in (True, False))
    same(told, silent)
    assert len(told.energies) == DEFAULT.iterations + 1
    assert len(silent.energies) == 0


@pytest.mark.parametrize("level", [0, 77, 255])
@pytest.mark.parametrize("step", [1, 2])
def test_a_constant_image_leaves_the_priors_outline(level: int, step: int) -> None:
    prior = prior_of(step)
    found = region_contour(np.full((96, 112, 3), level, dtype=np.uint8), prior)
    np.testing.assert_array_equal(found.silhouette.phi > 0, prior.phi > 0)
    near = abs(prior.phi) < 8
    assert abs(found.silhouette.phi - prior.phi)[near].max() < 0.12 * step
    assert found.surety.max() < 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_an_inverted_image_gives_the_same(seed: int) -> None:
    image, prior = noisy(seed), prior_of(2)
    one, other = region_contour(image, prior), region_contour(255 - image, prior)
    np.testing.assert_allclose(one.silhouette.phi, other.silhouette.phi, atol=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_an_image_with_half_the_contrast_gives_nearly_the_same(seed: int) -> None:
    image, prior = noisy(seed), prior_of(2)
    one, other = region_contour(image, prior), region_contour(image // 2 + 40, prior)
    assert iou(one.silhouette.phi > 0, other.silhouette.phi > 0) > 0.98


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_image_gives_the_mirrored_outline(seed: int, step: int, axis: int) -> None:
    image, phi = noisy(seed), prior_of(step).phi[:46, :54]
    # The window's last sample is mirrored to its first.
    height, width = image.shape[:2]
    last = (width - 1 - step * (phi.shape[1] - 1), 0) if axis else (0, height - 1 - step * (phi.shape[0] - 1))
    here = region_contour(image, Silhouette((0, 0), step, phi))
    there = region_contour(np.flip(image, 1 if axis else 0), Silhouette(last, step, np.flip(phi, axis)))
    np.testing.assert_allclose(np.flip(there.silhouette.phi, axis), here.silhouette.phi, atol=2e-3)
    np.testing.assert_allclose(np.flip(there.surety, axis), here.surety, atol=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_three_equal_channels_are_gray(seed: int) -> None:
    gray, prior = noisy(seed, channels=1), prior_of(2)
    colour = region_contour(np.repeat(gray, 3, axis=2), prior)
    np.testing.assert_allclose(region_contour(gray, prior).silhouette.phi, colour.silhouette.phi, atol=2e-3)
    same(region_contour(gray, prior), region_contour(gray[..., 0], prior))


def test_a_heavy_prior_is_the_result() -> None:
    prior = prior_of(2)
    found = region_contour(noisy(1), prior, settings=replace(DEFAULT, prior_weight=1e6))
    clear = abs(prior.phi) > 0.01
    np.testing.assert_array_equal((found.silhouette.phi > 0)[clear], (prior.phi > 0)[clear])


def test_without_a_priors_weight_the_image_alone_decides() -> None:
    image, near = noisy(2), prior_of(2)
    far = Silhouette((0, 0), 2, disc((63.0, 53.0), 24.0, near.phi.shape, 2))
    how = replace(DEFAULT, prior_weight=0.0, iterations=40, band_px=15.9)
    truth = disc((58.0, 49.0), 27.0, near.phi.shape, 2) > 0
    for prior in (near, far):
        assert iou(region_contour(image, prior, settings=how).silhouette.phi > 0, truth) > 0.97
    assert iou(far.phi > 0, truth) < 0.75


def test_nothing_moves_beyond_the_band() -> None:
    prior = prior_of(1)
    found = region_contour(noisy(3), prior, settings=replace(DEFAULT, band_px=5.0, prior_weight=0.0))
    moved = (found.silhouette.phi > 0) != (prior.phi > 0)
    assert moved.any()
    assert abs(prior.phi[moved]).max() <= 5.0


@pytest.mark.parametrize("step", [1, 2, 3])
def test_pixels_that_are_ignored_say_nothing(step: int) -> None:
    image, prior = noisy(7), prior_of(step)
    ignore = np.zeros(image.shape[:2], dtype=np.bool_)
    ignore[20:70, 60:90] = True
    other = image.copy()
    other[ignore] = 255 - other[ignore]
    same(region_contour(image, prior, ignore=ignore), region_contour(other, prior, ignore=ignore))
    everything = region_contour(image, prior, ignore=np.ones_like(ignore))
    np.testing.assert_array_equal(everything.silhouette.phi > 0, prior.phi > 0)
    assert everything.surety.max() == 0
    assert (
        (region_contour(other, prior).silhouette.phi > 0) != (region_contour(image, prior).silhouette.phi > 0)
    ).any()


@pytest.mark.parametrize("origin", [(-20, -14), (30, 26), (-400, 0), (0, 400), (400, -400)])
@pytest.mark.parametrize("step", [1, 2])
def test_beyond_the_image_the_prior_alone_rules(origin: tuple[int, int], step: int) -> None:
    image, prior = noisy(8), Silhouette(origin, step, prior_of(step).phi)
    found = region_contour(image, prior)
    rows, columns = prior.phi.shape
    x, y = origin[0] + step * np.arange(columns), origin[1] + step * np.arange(rows)
    off = ((y < -8) | (y > 103))[:, None] | ((x < -8) | (x > 119))
    np.testing.assert_array_equal((found.silhouette.phi > 0)[off], (prior.phi > 0)[off])
    assert found.surety[off].max(initial=0) == 0
    wider = np.pad(image, ((400, 500), (400, 500), (0, 0)))
    there = np.ones(wider.shape[:2], dtype=np.bool_)
    there[400:496, 400:512] = False
    same_place = Silhouette((origin[0] + 400, origin[1] + 400), step, prior.phi)
    inside = region_contour(wider, same_place, ignore=there).silhouette.phi
    assert iou(inside > 0, found.silhouette.phi > 0) > 0.96  # at the border, pixels are repeated


def test_the_outline_at_rest_stays_where_it_is() -> None:
    image, prior = noisy(9), prior_of(2)
    how = replace(DEFAULT, iterations=200)
    found = region_contour(image, prior, settings=how)
    assert found.iterations < 200
    again = region_contour(image, prior, found.silhouette, settings=how)
    # Which pixels are like neither side is not handed on.
    assert again.iterations <= 4
    assert iou(again.silhouette.phi > 0, found.silhouette.phi > 0) > 0.99


def test_a_start_in_another_window_is_taken_over() -> None:
    prior = prior_of(2)
    moved = Silhouette((10, 6), 1, disc((50.0, 40.0), 28.0, (80, 90)))  # the same disc as in the image
    begun = starting(prior, moved)
    true = disc((60.0, 46.0), 28.0, prior.phi.shape, 2) > 0
    assert iou(begun > 0, true) > 0.93
    assert iou(prior.phi > 0, true) < 0.88
    for x in (-8, 4, 30):
        beside = Silhouette((x, -6), 2, prior.phi)
        dense = Silhouette((x, -6), 1, np.repeat(np.repeat(prior.phi, 2, axis=0), 2, axis=1))
        np.testing.assert_array_equal(starting(prior, beside), starting(prior, dense))
        assert (starting(prior, beside) != (prior.phi > 0)).any()
    away = Silhouette((1000, 1000), 1, moved.phi)
    np.testing.assert_array_equal(starting(prior, away), prior.phi > 0)


def test_the_same_images_give_the_same_bits() -> None:
    a, b = (region_contour(noisy(11), prior_of(2)) for _ in range(2))
    same(a, b)


def test_arrays_need_not_be_contiguous() -> None:
    image, prior = noisy(12), prior_of(2)
    wide = np.zeros((96, 112, 6), dtype=np.uint8)
    wide[..., ::2] = image
    same(region_contour(wide[..., ::2], prior), region_contour(image, prior))
    spread = np.zeros((2 * prior.phi.shape[0], prior.phi.shape[1]), dtype=np.float32)
    spread[::2] = prior.phi
    same(region_contour(image, Silhouette((0, 0), 2, spread[::2])), region_contour(image, prior))


# Pictures


@pytest.mark.parametrize(
    "kind", [kind if kind == "easy" else pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS]
)
@pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_an_outline_is_found(kind: str, step: int) -> None:
    shots = [picture(kind, seed) for seed in range(3)]
    before = [iou(at_every_pixel(s.prior(step)), s.mask) for s in shots]
    after = [iou(at_every_pixel(region_contour(s.image, s.prior(step)).silhouette), s.mask) for s in shots]
    assert np.mean(before) < 0.9
    assert np.mean(after) > 0.92
    assert all(a > b + 0.03 for a, b in zip(after, before, strict=True))


@pytest.mark.slow
def test_in_gray_images_a_heavier_prior_is_better() -> None:
    gain = []
    for kind in KINDS:
        s = picture(kind, 0)
        gray = np.rint(s.image @ [0.114, 0.587, 0.299]).astype(np.uint8)
        usual, heavy = (
            iou(at_every_pixel(region_contour(gray, s.prior(2), settings=how).silhouette), s.mask)
            for how in (DEFAULT, GRAY)
        )
        gain.append(heavy - usual)
    assert np.mean(gain) > 0


def test_an_edge_is_surer_than_none() -> None:
    s = picture("easy", 0)
    prior = s.prior(2)
    found = region_contour(s.image, prior)
    edge = abs(found.silhouette.phi) < 2
    noise = np.random.default_rng(0).normal(120, 12, s.image.shape).astype(np.uint8)
    for image in (noise, np.zeros_like(s.image), np.full_like(s.image, 255)):
        none = region_contour(image, prior)
        at = abs(none.silhouette.phi) < 2
        assert np.median(none.surety[at]) < 0.2 * np.median(found.surety[edge])


@pytest.mark.slow
def test_a_shadow_is_told_from_a_body() -> None:
    s = picture("easy", 1)
    empty = np.random.default_rng(1).normal(170, 4, (9, *s.image.shape))
    back = np.clip(empty, 0, 255).astype(np.uint8)
    body = np.where(s.mask[..., None], s.image, back[-1])
    shaded = body.astype(float)
    dark = np.roll(s.mask, 30, axis=1) & ~s.mask
    shaded[dark] *= 0.6
    image, prior = shaded.astype(np.uint8), s.prior(2)
    model = learn_background(list(back[:-1]))
    blind = BackgroundModel(model.usual, model.spread, darkest=1.0)
    told, not_told = (
        iou(at_every_pixel(background_contour(image, m, prior, guided=False).silhouette), s.mask)
        for m in (model, blind)
    )
    guided = iou(at_every_pixel(background_contour(image, model, prior).silhouette), s.mask)
    both = iou(at_every_pixel(region_contour(image, prior, background=model).silhouette), s.mask)
    assert told > 0.95
    assert not_told < 0.8
    assert min(guided, both) > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("guided", [True, False])
def test_the_energy_falls_with_a_background_too(guided: bool) -> None:
    s = picture("shadow", 0)
    model = learn_background(
        [np.random.default_rng(k).normal(150, 9, s.image.shape).astype(np.uint8) for k in range(4)]
    )
    prior = s.prior(2)
    for found in (
        background_contour(s.image, model, prior, guided=guided, energies=True),
        region_contour(s.image, prior, background=model, energies=True),
    ):
        assert (np.diff(found.energies) <= 1e-5 * abs(found.energies[:-1]) + 1e-2).all()


@pytest.mark.parametrize("colour", [(20, 20, 20), (230, 230, 230), (110, 110, 240)])
def test_whatever_differs_from_the_known_background_is_found_without_a_prior_and_else_there_is_nothing(
    colour: tuple[int, int, int],
) -> None:
    rng = np.random.default_rng(0)
    empty = [rng.normal(110, 3, (96, 112, 3)).round().astype(np.uint8) for _ in range(7)]
    model, window = learn_background(empty[:-1]), prior_of(1)
    there = disc((70.0, 40.0), 20.0, (96, 112)) > 0
    image = np.where(there[..., None], np.array(colour, np.uint8), empty[-1])
    assert iou(background_contour(image, model, window, guided=False).silhouette.phi > 0, there) > 0.95
    assert not (background_contour(empty[-1], model, window, guided=False).silhouette.phi > 0).any()


def test_a_person_who_walks_by_is_not_learnt() -> None:
    images = [np.full((40, 60, 3), 90, dtype=np.uint8) for _ in range(9)]
    for k, image in enumerate(images):
        image[:, 6 * k : 6 * k + 6] = 200
    model = learn_background(images)
    np.testing.assert_array_equal(model.usual, 90)
    np.testing.assert_array_equal(model.spread, 0)


# Guards


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("prior_weight", -0.1),
        ("prior_weight", float("nan")),
        ("length_weight", -1.0),
        ("window_px", 1.0),
        ("band_px", 0.0),
        ("band_px", 201.0),
        ("unsure_px", 12.0),
        ("unsure_px", -1.0),
        ("iterations", 0),
        ("least_sd", 0.1),
        ("outliers", 0.0),
        ("outliers", 1.0),
        ("fewest_px2", 0.0),
    ],
)
def test_a_setting_out_of_range_is_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=name):
        RegionSettings(**{name: value})


def test_what_is_no_image_is_refused() -> None:
    prior = prior_of(2)
    for image in (
        np.zeros((9, 9)),
        np.zeros((9, 9, 2), dtype=np.uint8),
        np.zeros((0, 9), dtype=np.uint8),
        noisy(0)[0, 0],
    ):
        with pytest.raises(SettingsError, match="image is"):
            region_contour(image, prior)
    for ignore in (np.zeros((96, 112), dtype=np.uint8), np.zeros((96, 111), dtype=np.bool_)):
        with pytest.raises(SettingsError, match="ignore is"):
            region_contour(noisy(0), prior, ignore=ignore)


def test_what_is_no_silhouette_is_refused() -> None:
    image, phi = noisy(0), prior_of(2).phi
    broken = phi.copy()
    broken[3, 4] = np.nan
    for bad in (Silhouette((0, 0), 0, phi), Silhouette((0, 0), 2, phi[:1]), Silhouette((0, 0), 2, broken)):
        with pytest.raises(SettingsError, match="prior"):
            region_contour(image, bad)
    double: Any = phi.astype(float)
    with pytest.raises(SettingsError, match=r"start\.phi is float64"):
        region_contour(image, prior_of(2), Silhouette((0, 0), 2, double))


def test_what_is_no_background_is_refused() -> None:
    images = [noisy(k) for k in range(3)]
    with pytest.raises(SettingsError, match="at least 3"):
        learn_background(images[:2])
    with pytest.raises(SettingsError, match="one shape"):
        learn_background([*images, images[0][:-1]])
    with pytest.raises(SettingsError, match="one shape"):
        learn_background([image[..., :2] for image in images])
    model = learn_background(images)
    for name, value in (("least_sd", 0.0), ("darkest", 0.0), ("shadow_nats", -1.0)):
        with pytest.raises(SettingsError, match=name):
            learn_background(images, **{name: value})
    with pytest.raises(SettingsError, match="spread is"):
        BackgroundModel(model.usual, model.spread[:-1])
    for other in (images[0][:-2], images[0][..., 0]):
        with pytest.raises(SettingsError, match="the background is of shape"):
            region_contour(other, prior_of(2), background=model)


def test_pictures_are_of_a_tenth_person() -> None:
    shares = [picture(kind, 0).mask.mean() for kind in KINDS]
    assert 0.07 < np.mean(shares) < 0.13
    assert picture("easy", 0).image.shape == (SIZE_PX[1], SIZE_PX[0], 3)
