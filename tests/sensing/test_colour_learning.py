"""Colours learnt from clicks, step by step: the region about a click, its inside, and the pixels' distribution."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mocapella.errors import InputError, SettingsError
from mocapella.sensing import colour_learning as learning
from mocapella.sensing.colour_learning import (
    LEAST_PX,
    LIKE,
    ColourSample,
    check_image,
    grow,
    inside,
    learn,
    learn_background,
    learn_colours,
    light_of,
)  # fmt: skip
from mocapella.sensing.colour_profile import SKIN, CameraControls, brightness, chromaticity

RED, GREY = (30, 30, 180), (90, 90, 90)


def image_of(*boxes: tuple[int, int, int, int, Any], size: tuple[int, int] = (60, 80)) -> np.ndarray:
    """Grey with boxes from (x, y), so wide and high, of a colour."""
    image = np.full((*size, 3), 90, np.uint8)
    for x, y, width, height, bgr in boxes:
        image[y : y + height, x : x + width] = bgr
    return image


def lit(bgr: Any, factor: float) -> np.ndarray:
    """A colour of the same chromaticity, so many times as bright."""
    wanted = factor * brightness(np.array(bgr))
    return (np.array(bgr) + 8) * (wanted + 8) / (brightness(np.array(bgr)) + 8) - 8


@pytest.mark.parametrize("x", [0, 30, 79 - 9])
@pytest.mark.parametrize("y", [0, 25, 59 - 9])
def test_a_region_is_the_box_of_its_colour_wherever_it_is(x: int, y: int) -> None:
    image = image_of((x, y, 10, 10, RED))
    region = grow(image, (x + 4.6, y + 5.4), "red")
    np.testing.assert_array_equal(region, (image == RED).all(axis=-1))


@pytest.mark.parametrize(("right", "down"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
@pytest.mark.parametrize(("distance", "found"), [(4, True), (5, False)])
def test_a_region_begins_at_the_strongest_colour_within_four_pixels_of_the_click(
    right: int, down: int, distance: int, found: bool
) -> None:
    """The box reaches 2 px from its middle; all about it is a plate of the same hue, but weaker."""
    image = image_of((30, 20, 21, 21, (85, 85, 120)), (38, 28, 5, 5, RED))
    region = grow(image, (40 + (2 + distance) * right, 30 + (2 + distance) * down), "red")
    np.testing.assert_array_equal(region, (image == RED).all(axis=-1) if found else (image[..., 2] > 90))


@pytest.mark.parametrize("click", [(-1, 5), (80, 5), (5, -1), (5, 60), (-0.6, 5), (5, 59.6)])
def test_a_click_beyond_the_outermost_pixels_lies_outside(click: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="lies outside the image"):
        grow(image_of(), click, "red")


@pytest.mark.parametrize("click", [(0, 0), (79, 59), (-0.4, 59.4)])
def test_skin_may_be_grey_at_the_border_and_as_large_as_the_image(click: tuple[float, float]) -> None:
    assert grow(image_of(), click, SKIN).all()
    with pytest.raises(InputError, match="hardly any colour"):
        grow(image_of(), click, "red")


@pytest.mark.parametrize(("factor", "joined"), [(0.37, False), (0.43, True), (1.0, True), (2.4, True), (2.6, False)])
def test_a_region_is_of_like_brightness_up_to_a_factor(factor: float, joined: bool) -> None:
    dull = (40, 40, 95)
    image = image_of((20, 20, 10, 10, dull), (30, 20, 4, 10, np.round(lit(dull, factor))))
    assert grow(image, (24, 25), "red")[20:30, 30:34].all() == joined
    assert grow(image, (24, 25), "red").any(axis=0)[30:34].all() == joined


@pytest.mark.parametrize(("height", "refused"), [(10, False), (11, True)])
def test_a_region_of_more_than_a_tenth_of_the_image_is_no_marker(height: int, refused: bool) -> None:
    image = image_of((10, 10, 48, height, RED))
    if refused:
        with pytest.raises(InputError, match="covers 11 % of the image"):
            grow(image, (20, 15), "red")
    else:
        assert grow(image, (20, 15), "red").mean() == 0.1
    assert grow(image, (20, 15), SKIN).mean() == height / 100


@pytest.mark.parametrize(("side", "refused"), [(26, False), (28, True)])
@pytest.mark.parametrize("others", [1, 2])
def test_a_region_of_twenty_times_the_area_of_the_other_markers_has_leaked(
    side: int, refused: bool, others: int
) -> None:
    """Of 6 × 6 px are the others. Of two markers nobody knows which is too large."""
    boxes = {"blue": (5, 100, 6, 6, (180, 30, 30)), "green": (25, 100, 6, 6, (30, 180, 30))}
    image = image_of((5, 5, side, side, RED), *boxes.values(), size=(120, 160))
    clicks = {"red": (8.0, 8.0), **{name: (boxes[name][0] + 3.0, 103.0) for name in list(boxes)[:others]}}
    if refused and others == 2:
        with pytest.raises(InputError, match=r"field red: \(8.0, 8.0\): .* is 22 times as large .*another colour"):
            learn_colours("left", [ColourSample(image, clicks)])
    else:
        assert learn_colours("left", [ColourSample(image, clicks)]).colours[0].area_px == side**2


def test_holes_of_a_region_belong_to_it_and_a_region_apart_does_not() -> None:
    image = image_of((20, 20, 12, 12, RED), (24, 24, 3, 3, GREY), (40, 20, 12, 12, RED))
    region = grow(image, (22, 22), "red")
    assert region.sum() == 144
    assert region[20:32, 20:32].all()


@pytest.mark.parametrize("x", [0, 3, 9, 30, 50, 56, 59])
@pytest.mark.parametrize("y", [0, 5, 20, 35, 39])
def test_near_a_click_colours_are_smooth_and_elsewhere_as_they_were(x: int, y: int) -> None:
    at = np.random.default_rng(0).normal(size=(40, 60, 2))
    out = learning._smooth(at, x, y)
    whole = np.stack([ndimage.median_filter(at[..., k], 5) for k in (0, 1)], axis=-1)
    near = np.zeros((40, 60), np.bool_)
    near[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5] = True
    np.testing.assert_array_equal(out[near], whole[near])
    far = np.hypot(*(np.indices((40, 60)) - np.array([y, x])[:, None, None])) > 12
    np.testing.assert_array_equal(out[far], at[far])


@pytest.mark.parametrize(("degrees", "taken"), [(0, True), (25, True), (-25, True), (26.5, False), (180, False)])
@pytest.mark.parametrize("size", [0.01, 0.3, 2.0])
def test_a_stronger_pixel_is_taken_if_it_is_of_the_clicked_hue(degrees: float, taken: bool, size: float) -> None:
    """Its direction from grey is within 26°, of a cosine of 0.9, whatever the strengths."""
    at, light = np.zeros((21, 21, 2)), np.zeros((21, 21))
    at[10, 10] = size, 0.0
    at[12, 9] = 3 * size * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    light[10, 10], light[12, 9] = 5.0, 7.0
    for strongest in (True, False):
        colour, luma = learning._seed(at, light, 10, 10, strongest=strongest)
        is_taken = taken and strongest
        np.testing.assert_array_equal(colour, at[12, 9] if is_taken else at[10, 10])
        assert luma == (7.0 if is_taken else 5.0)


def test_a_click_on_perfect_grey_takes_no_other_hue() -> None:
    at, light = np.full((21, 21, 2), 0.5), np.full((21, 21), 5.0)
    at[10, 10] = 0.0
    colour, _ = learning._seed(at, light, 10, 10, strongest=True)
    np.testing.assert_array_equal(colour, 0.0)


@given(st.floats(0, 6.28), st.sampled_from([0.4, 1.0, 2.0]))
def test_like_colours_are_beside_the_middle_as_far_as_the_limit_and_some_way_to_white(
    angle: float, size: float
) -> None:
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    middle = size * along
    nearest = {0.4: 0.1, 1.0: 0.5, 2.0: 1.0}[size]  # half of it, or less by the limit where that is more
    farthest = {0.4: 0.7, 1.0: 1.3, 2.0: 2.6}[size]
    for places, like in (((nearest + 1e-6, farthest - 1e-6, size), True), ((nearest - 1e-6, farthest + 1e-6), False)):
        for place in places:
            assert learning._like(place * along, middle) == like
    for aside, like in ((LIKE - 1e-6, True), (LIKE + 1e-6, False), (1e-6 - LIKE, True), (-LIKE - 1e-6, False)):
        assert learning._like(middle + aside * across, middle) == like


def grown(block: np.ndarray, times: int) -> np.ndarray:
    return np.asarray(ndimage.binary_dilation(block, iterations=times))


@pytest.mark.parametrize("enough", [True, False])
def test_an_inside_is_without_two_pixels_of_the_edge_or_one_if_little_is_left(enough: bool) -> None:
    block = np.zeros((16, 18), np.bool_)
    block[6:9, 6:10] = True  # as many as are needed
    assert block.sum() == LEAST_PX
    block[6, 6] = enough
    found = inside(grown(block, 2))
    np.testing.assert_array_equal(found, block if enough else grown(block, 1))


@pytest.mark.parametrize(("side", "some"), [((5, 6), True), ((5, 5), False)])
def test_a_marker_needs_twelve_pixels_inside_its_edge(side: tuple[int, int], some: bool) -> None:
    """Of 5 × 6 pixels, 3 × 4 are left."""
    sample = ColourSample(image_of((30, 20, *side, RED)), {"red": (32, 22)})
    if some:
        assert learn_colours("left", [sample]).colours[0].seen.pixels == LEAST_PX
    else:
        with pytest.raises(InputError, match="only 9 pixels of one colour are there"):
            learn_colours("left", [sample])


def test_a_plain_colour_has_its_own_chromaticity_and_no_spread_but_the_least() -> None:
    seen = learn(np.tile(np.array(RED, np.uint8), (50, 1)))
    np.testing.assert_allclose(seen.mean, chromaticity(np.array(RED)))
    np.testing.assert_allclose(seen.covariance, (1e-4, 0, 1e-4), atol=1e-12)
    np.testing.assert_allclose(seen.luma, brightness(np.array(RED)))
    assert seen.pixels == 50


def test_a_spread_is_that_of_the_pixels_and_a_few_of_another_colour_are_left_out() -> None:
    rng = np.random.default_rng(0)
    bgr = np.clip(rng.normal((60, 70, 180), 4, (4000, 3)), 0, 255).astype(np.uint8)
    seen, at = learn(bgr), chromaticity(bgr)
    uu, uv, vv = seen.covariance
    np.testing.assert_allclose([[uu, uv], [uv, vv]], np.cov(at.T), rtol=0.06, atol=2e-4)
    np.testing.assert_allclose(seen.mean, at.mean(axis=0), atol=0.003)
    assert 0.98 * 4000 < seen.pixels < 4000  # beyond three deviations is one in ninety
    np.testing.assert_allclose(seen.luma, np.percentile(brightness(bgr), (5, 50, 95)), atol=0.5)
    others = np.tile(np.array((60, 90, 120), np.uint8), (2500, 1))
    spoilt = learn(np.concatenate([bgr, others]))
    np.testing.assert_allclose(spoilt.mean, seen.mean, atol=0.02)
    np.testing.assert_allclose(spoilt.covariance, seen.covariance, rtol=0.3, atol=5e-4)
    assert spoilt.pixels == pytest.approx(seen.pixels, rel=0.03)


def test_the_least_spread_is_added_once() -> None:
    """Two values that are equally frequent have half their distance as standard deviation."""
    bgr = np.array([[60, 60, 170], [60, 60, 180]] * 500, np.uint8)
    half = 0.5 * float(np.log(188 / 178))
    assert learn(bgr).covariance[0] == pytest.approx(half**2 * 1000 / 999 + 1e-4, rel=1e-6)


def test_the_background_is_all_but_the_markers_and_their_surroundings() -> None:
    """Skin counts as background; so do images without markers, as a whole."""
    sample = ColourSample(image_of((30, 20, 8, 8, RED), (5, 40, 10, 10, (100, 120, 170))), {"red": (34, 24)})
    with_skin = ColourSample(sample.image, {**sample.clicks, SKIN: (10, 45)})
    marked = np.zeros((60, 80), np.bool_)
    marked[20:28, 30:38] = True
    free = np.count_nonzero(~grown(marked, 8))
    for one in (sample, with_skin):
        assert sum(map(sum, learn_colours("left", [one]).background.counts)) == free
    more = learn_colours("left", [sample], backgrounds=[image_of(), image_of()])
    assert sum(map(sum, more.background.counts)) == free + 2 * 60 * 80


def test_a_colour_in_several_images_has_their_pixels_and_their_median_area() -> None:
    samples = [ColourSample(image_of((30, 20, side, 8, RED)), {"red": (32, 24)}) for side in (8, 9, 12)]
    (colour,) = learn_colours("left", samples).colours
    assert colour.area_px == 72
    assert colour.seen.pixels == 4 * (4 + 5 + 8)


def test_a_profile_has_the_given_values_of_the_cameras_controls() -> None:
    sample, controls = ColourSample(image_of((30, 20, 8, 8, RED)), {"red": (34, 24)}), CameraControls(exposure=7.0)
    assert learn_colours("left", [sample], controls=controls).controls == controls
    assert learn_colours("left", [sample]).controls == CameraControls()


def test_the_histogram_is_of_means_of_nine_pixels() -> None:
    image = image_of()
    image[20, 30] = RED
    mask = np.ones(image.shape[:2], np.bool_)
    counts = np.array(learn_background([(image, mask)]).counts)
    near = chromaticity((8 * np.array(GREY) + np.array(RED)) / 9)
    assert counts.sum() == image.shape[0] * image.shape[1]
    cells = ((near + 3.5) / 7 * 56).astype(int)
    assert counts[tuple(cells)] == 9
    assert counts[28, 28] == counts.sum() - 9


def test_the_light_is_of_the_pixels_medians() -> None:
    pixels = np.array([[10, 20, 30], [40, 80, 60], [200, 100, 50], [40, 80, 61], [40, 80, 59]], np.uint8)
    luma, u, v = light_of(pixels)
    assert luma == np.median(brightness(pixels))
    np.testing.assert_allclose([u, v], np.median(chromaticity(pixels), axis=0))


@pytest.mark.parametrize(
    ("image", "what"),
    [
        ([1, 2], "is list"), (np.zeros((4, 4, 3)), r"is float64 \(4, 4, 3\)"),
        (np.zeros((4, 4), np.uint8), r"\(4, 4\)"),
        (np.zeros((4, 4, 4), np.uint8), r"\(4, 4, 4\)"), (np.zeros((2, 4, 3, 3), np.uint8), r"\(2, 4, 3, 3\)"),
    ],
)  # fmt: skip
def test_what_is_no_image_in_colour_is_refused(image: Any, what: str) -> None:
    with pytest.raises(SettingsError, match=f"the image {what}.*it must be uint8|the image is uint8 {what}"):
        check_image(image)
    check_image(np.zeros((4, 5, 3), np.uint8))
