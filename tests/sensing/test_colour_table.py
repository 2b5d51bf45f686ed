"""The look-up table of colours: densities, noise, limits of brightness, and how well colours can be told apart."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from mocapella.errors import SettingsError
from mocapella.sensing import colour_table
from mocapella.sensing.colour_profile import (
    BINS,
    SPAN,
    BackgroundColours,
    Chromaticities,
    Colour,
    ColourProfile,
    brightness,
    chromaticity,
)  # fmt: skip
from mocapella.sensing.colour_table import CELL, TableSettings, cell_of, classify, gaussian, separability

NOTHING = ((0,) * BINS,) * BINS
LIGHT = TableSettings().light_sd


def colour(
    name: str, mean: tuple[float, float], sd: float = 0.1, luma: tuple[float, float, float] = (50, 80, 100)
) -> Any:
    return Colour(name, Chromaticities(mean, (sd**2, 0.0, sd**2), luma, 100), 100.0)


def profile(*colours: Colour, counts: Any = NOTHING) -> ColourProfile:
    return ColourProfile("left", (320, 240), colours, BackgroundColours(counts, 90.0, (0.0, 0.0)))


def with_counts(**places: tuple[float, float, int]) -> Any:
    """A background that has so many pixels in the cells about these chromaticities."""
    counts = np.zeros((BINS, BINS), np.int64)
    for u, v, many in places.values():
        counts[int((u + SPAN) / (2 * SPAN) * BINS), int((v + SPAN) / (2 * SPAN) * BINS)] += many
    return tuple(map(tuple, counts.tolist()))


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255))
def test_a_cell_has_five_bits_of_blue_green_and_red(blue: int, green: int, red: int) -> None:
    cell = int(cell_of(np.array([blue, green, red], np.uint8)))
    assert cell == blue >> 3 | (green >> 3) << 5 | (red >> 3) << 10


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.9, 0.9), st.floats(0.05, 1), st.floats(0.05, 1))
def test_the_density_is_that_of_a_normal_distribution(
    u: float, v: float, correlation: float, sd_u: float, sd_v: float
) -> None:
    covariance = (sd_u**2, correlation * sd_u * sd_v, sd_v**2)
    noise = np.array([0.01, 0.005, 0.02])
    at = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 2))
    uu, uv, vv = np.array(covariance) + noise
    wanted = multivariate_normal([u, v], [[uu, uv], [uv, vv]]).pdf(at)
    found = gaussian(at, Chromaticities((u, v), covariance, (0, 1, 2), 9), noise)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


@given(st.floats(0, 247), st.floats(0, 247), st.floats(0, 247), st.floats(0, 0.3))
def test_the_noise_of_a_chromaticity_is_that_of_its_three_values(
    blue: float, green: float, red: float, light_sd: float
) -> None:
    """By small changes of each value; the light changes u and v independently of each other."""
    bgr, s = np.array([blue, green, red]), TableSettings(light_sd=light_sd)
    step = 1e-4 * np.eye(3)
    J = (chromaticity(bgr + step) - chromaticity(bgr - step)) / 2e-4  # (3, 2)
    covariance = s.value_sd**2 * J.T @ J + light_sd**2 * np.eye(2)
    told = colour_table._noise(bgr, s)
    np.testing.assert_allclose(told, [covariance[0, 0], covariance[0, 1], covariance[1, 1]], rtol=1e-4)


@pytest.mark.parametrize("channel", range(3))
def test_a_value_of_the_last_cell_may_be_clipped_and_is_ten_times_as_unsure(channel: int) -> None:
    """Green's variance is that of u with v; red's and blue's are the rest of u's and v's."""
    variances = []
    for value in (256 - CELL - 1e-9, 256 - CELL):
        bgr = np.full(3, 100.0)
        bgr[channel] = value
        uu, uv, vv = colour_table._noise(bgr, TableSettings(light_sd=0.0))
        variances.append([vv - uv, uv, uu - uv])
    wanted = np.where(np.arange(3) == channel, 100, 1)
    np.testing.assert_allclose(np.divide(variances[1], variances[0]), wanted, rtol=1e-6)


@pytest.mark.parametrize(("value", "labelled"), [(24, False), (26, True), (80, True), (199, True), (201, False)])
def test_a_colour_may_be_darker_and_brighter_than_learnt_by_a_factor(value: int, labelled: bool) -> None:
    """Its 5th and 95th percentiles are 50 and 100."""
    grey = profile(colour("grey", (0.0, 0.0)))
    pixel = np.array([[value, value, value]])
    assert classify(grey, pixel, TableSettings(brightness_range=2.0)).tolist() == [int(labelled)]


def test_between_two_colours_the_likelier_one_is_told_if_it_is_by_the_margin() -> None:
    """Of equal spreads s, at x from the middle between means 2a apart, the ratio is exp(2 a x / s²)."""
    settings, luma = TableSettings(light_sd=0.0, value_sd=0.1, margin_of_others=3.0), (0, 50, 255)
    two = profile(colour("first", (-0.3, 0.0), 0.2, luma), colour("second", (0.3, 0.0), 0.2, luma))
    limit = np.log(3.0) * 0.2**2 / 0.6
    at = np.array([-0.3, -limit - 0.01, -limit + 0.01, 0.0, limit - 0.01, limit + 0.01, 0.3])
    pixels = colour_table._values(np.stack([at, 0 * at], axis=-1), 100.0)
    assert classify(two, pixels, settings).tolist() == [1, 1, 0, 0, 0, 2, 2]


def test_a_colour_is_told_if_it_is_likelier_than_anything_by_the_margin() -> None:
    """Anything is half of a uniform density on a square of side 7."""
    s, uniform = 0.2, 0.5 / 49
    one = profile(colour("first", (0.0, 0.0), s, (0, 50, 255)))
    for margin in (3.0, 30.0):
        settings = TableSettings(light_sd=0.0, value_sd=0.1, margin=margin)
        limit = s * np.sqrt(-2 * np.log(margin * uniform * 2 * np.pi * s**2))
        at = np.array([-limit - 0.01, -limit + 0.01, limit - 0.01, limit + 0.01])
        for pixels in (np.stack([at, 0 * at], axis=-1), np.stack([0 * at, at], axis=-1)):
            assert classify(one, colour_table._values(pixels, 100.0), settings).tolist() == [0, 1, 1, 0]


@given(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(20, 90))
def test_values_have_their_chromaticity_and_luma(u: float, v: float, luma: float) -> None:
    values = colour_table._values(np.array([[u, v]]), luma)
    if values.min() > 0 and values.max() < 255:
        np.testing.assert_allclose(chromaticity(values), [[u, v]], atol=1e-9)
        assert brightness(values)[0] == pytest.approx(luma)
    assert values.min() >= 0
    assert values.max() <= 255


def test_colours_are_as_far_apart_as_their_common_spread_says() -> None:
    """The mean of both variances, and that of the light."""
    sd = np.sqrt((0.1**2 + 0.3**2) / 2 + LIGHT**2)
    found = separability(profile(colour("a", (0.5, 0.2)), colour("b", (0.5, -0.6), 0.3), colour("c", (-0.1, 0.2))))
    assert found.distances[0, 1] == pytest.approx(0.8 / sd)
    assert found.distances[0, 2] == pytest.approx(0.6 / np.sqrt(0.1**2 + LIGHT**2))
    np.testing.assert_allclose(found.distances, found.distances.T)
    np.testing.assert_allclose(np.diag(found.distances), 0)


def test_a_correlation_brings_colours_nearer_along_it() -> None:
    base = colour("a", (0.0, 0.0))
    seen = dataclasses.replace(base.seen, covariance=(0.01, 0.006, 0.01))
    a = dataclasses.replace(base, seen=seen)
    s = TableSettings(light_sd=0.0)
    for v, variance in ((0.3, 0.016), (-0.3, 0.004)):
        b = dataclasses.replace(a, name="b", seen=dataclasses.replace(seen, mean=(0.3, v)))
        assert separability(profile(a, b), s).distances[0, 1] == pytest.approx(np.hypot(0.3, 0.3) / np.sqrt(variance))


def test_all_pairs_that_are_too_alike_are_named_once() -> None:
    near = LIGHT_AND_SPREAD * 3.9
    three = profile(colour("a", (0.0, 0.0)), colour("b", (near, 0.0)), colour("c", (0.0, near)))
    problems = [p for p in separability(three).problems if "too alike" in p]
    assert [p.split(" are ")[0] for p in problems] == ["a and b", "a and c"]
    assert "(3.9 standard deviations apart, 4 are needed)" in problems[0]
    far = LIGHT_AND_SPREAD * 4.1
    apart = profile(colour("a", (0.0, 0.0)), colour("b", (far, 0.0)), colour("c", (0.0, far)))
    assert not [p for p in separability(apart).problems if "too alike" in p]


LIGHT_AND_SPREAD = float(np.hypot(0.1, LIGHT))


@pytest.mark.parametrize("direction", [(1, 0), (0, 1), (-1, 0), (0.6, -0.8)])
def test_the_background_within_two_deviations_of_a_colour_is_its_share(direction: tuple[float, float]) -> None:
    """The cells' sides are an eighth, so that it is the middle of a cell that counts."""
    mean, reach = np.array([0.5625, -0.3125]), 2 * float(np.hypot(0.3, LIGHT))  # a cell's middle
    near, far = (mean + part * reach * np.array(direction) for part in (0.8, 1.2))
    counts = with_counts(near=(*near, 30), far=(*far, 50), away=(-3.0, 3.0, 20))
    found = separability(profile(colour("a", (float(mean[0]), float(mean[1])), 0.3), counts=counts))
    assert found.in_background == {"a": pytest.approx(0.3)}
    (problem,) = [p for p in found.problems if "in the background" in p]
    assert problem.startswith("a is in the background too, 30.0 % of it")


@pytest.mark.parametrize(("of_thousand", "named"), [(3, False), (4, True), (0, False)])
def test_three_thousandths_of_the_background_may_be_of_a_colour(of_thousand: int, named: bool) -> None:
    counts = with_counts(near=(0.5625, -0.3125, of_thousand), away=(-3.0, 3.0, 1000 - of_thousand))
    found = separability(profile(colour("a", (0.5625, -0.3125)), counts=counts))
    assert found.in_background["a"] == pytest.approx(of_thousand / 1000)
    assert any("in the background" in p for p in found.problems) == named


def test_an_empty_background_has_none_of_a_colour() -> None:
    assert separability(profile(colour("a", (0.5, 0.5)))).in_background == {"a": 0.0}


def test_a_colour_that_cannot_be_told_from_another_is_hardly_kept() -> None:
    luma = (60.0, 80.0, 100.0)
    found = separability(profile(colour("a", (0.5, 0.2), 0.05, luma), colour("b", (-0.6, 0.5), 0.05, luma)))
    assert min(found.kept.values()) > 0.95
    assert not found.problems
    alike = separability(profile(colour("a", (0.5, 0.2), 0.05, luma), colour("b", (0.52, 0.2), 0.05, luma)))
    assert max(alike.kept.values()) < 0.5
    share = 100 * alike.kept["b"]
    assert f"only {share:.0f} % of what was pointed at as b can be told from the rest" in "\n".join(alike.problems)


def test_densities_of_the_scene_do_not_depend_on_how_many_images_it_was_learnt_from() -> None:
    at = np.random.default_rng(0).uniform(-2, 2, (50, 2))
    one, many = (
        colour_table.no_marker(
            profile(colour("a", (0.5, 0.5)), counts=with_counts(a=(0.1, 0.1, n), b=(-1.0, 1.0, 3 * n))),
            at, np.zeros(3), np.float64(60.0),
        )
        for n in (100, 700)
    )  # fmt: skip
    np.testing.assert_allclose(one, many)


@pytest.mark.parametrize(
    ("covariance", "definite"),
    [
        ((1.0, 0.0, 1.0), True), ((1.0, 0.9, 1.0), True), ((1.0, -0.9, 1.0), True), ((1.0, 1.0, 1.0), False),
        ((-1.0, 0.0, -1.0), False), ((0.5, 0.6, 0.5), False), ((1.0, -1.5, 1.0), False), ((0.0, 0.0, 1.0), False),
        ((np.inf, 0.0, 1.0), False), ((1.0, 0.0, np.inf), False),
    ],
)  # fmt: skip
def test_a_covariance_is_positive_definite(covariance: Any, definite: bool) -> None:
    def made() -> Chromaticities:
        return Chromaticities((0.0, 0.0), covariance, (0, 1, 2), 1)

    if definite:
        made()
    else:
        with pytest.raises(SettingsError, match="positive definite"):
            made()


def test_what_is_no_profile_of_colours_is_refused() -> None:
    named = colour("a", (0.5, 0.5))
    for rows in (NOTHING[:-1], (*NOTHING[:-1], NOTHING[0][:-1]), ((0,) * BINS,) * (BINS + 1)):
        with pytest.raises(SettingsError, match="counts"):
            BackgroundColours(rows, 90.0, (0.0, 0.0))
    with pytest.raises(SettingsError, match="name"):
        dataclasses.replace(named, name="")
    with pytest.raises(SettingsError, match="counts"):
        BackgroundColours(((-1, *NOTHING[0][1:]), *NOTHING[1:]), 90.0, (0.0, 0.0))
    assert dataclasses.replace(profile(named), size_px=(2, 2)).size_px == (2, 2)
    with pytest.raises(SettingsError, match="size_px"):
        dataclasses.replace(profile(named), size_px=(9, 1))
    assert dataclasses.replace(named.seen, pixels=1).pixels == 1


@given(st.integers(0, 255), st.integers(0, 255))
def test_grey_has_no_colour_and_its_value_as_luma(value: int, other: int) -> None:
    np.testing.assert_allclose(chromaticity(np.full((2, 3), value)), 0, atol=1e-12)
    assert brightness(np.full(3, value)) == pytest.approx(value)
    u, v = chromaticity(np.array([value, 100, other]))
    np.testing.assert_allclose(np.exp([u, v]), [(other + 8) / 108, (value + 8) / 108])
