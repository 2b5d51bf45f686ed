"""Markers by the colours of a window: where the background has a marker's colour, but hardly at the predicted place."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.marker_images import discs, profile

from mocapella.sensing import marker_kernels
from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_table import cell_of, classify
from mocapella.sensing.markers import MarkerDetector, MarkerSettings

RED, BLUE = (20, 15, 190), (180, 60, 20)
AT = np.array([60.0, 50.0])


@cache
def detector(**settings: float) -> MarkerDetector:
    learnt = learn_colours("left", [ColourSample(discs((*AT, 8.0, RED)), {"red": tuple(AT)})])
    return MarkerDetector(learnt, MarkerSettings(**settings))


def seen_then(second: np.ndarray, after_s: float = 1 / 30, **settings: float) -> tuple[MarkerDetector, float, float]:
    """A red disc, then an image in which the whole image's table has no red; the detector and its confidences."""
    made = detector(**settings)
    made.reset()
    usual = made._colours
    first = made.update(discs((*AT, 8.0, RED)), 0.0).confidences[0]
    none = np.zeros_like(usual.table)
    made._colours = marker_kernels.MarkerColours(none, usual.near, usual.light)
    try:
        then = made.update(second, after_s)
    finally:
        made._colours = usual
    assert then.found[0] == (made.report.near[0] == 1)
    return made, float(first), float(then.confidences[0])


def test_what_the_whole_image_tells_a_window_tells_too() -> None:
    """The background counts less in a window, so a cell only loses `none`, and the less the smaller the window."""
    values = np.random.default_rng(1).integers(0, 256, (4000, 3))
    before = first = classify(profile(), values)
    for near_px in (320.0, 80.0, 40.0, 10.0):
        now = classify(profile(), values, near_px=near_px)
        np.testing.assert_array_equal(now[before > 0], before[before > 0])
        before = now
    assert (before > 0).sum() > (first > 0).sum()


def test_a_window_as_large_as_the_image_is_the_image() -> None:
    values = np.random.default_rng(0).integers(0, 256, (500, 3))
    np.testing.assert_array_equal(classify(profile(), values, near_px=1e6), classify(profile(), values))


def test_a_marker_is_followed_by_the_colours_of_a_window_and_is_less_sure() -> None:
    made, before, now = seen_then(discs((63.0, 50.0, 8.0, RED)))
    assert made.report.near[0] == 1
    assert made.report.found[0] == 2
    assert now == pytest.approx(0.5 * before, rel=0.05)


@pytest.mark.parametrize(("radius", "found"), [(11.0, True), (14.0, False), (6.0, True), (4.5, False)])
def test_a_piece_of_quite_another_area_than_before_is_not_it(radius: float, found: bool) -> None:
    """Of radius 8 it was; 2.5 times the area is a radius of 12.6, and of 5.1."""
    made, _, _ = seen_then(discs((*AT, radius, RED)))
    assert made.report.near[0] == found


@pytest.mark.parametrize(("x", "found"), [(75.0, True), (87.0, False), (110.0, False)])
def test_it_is_sought_in_the_window_only_and_must_be_in_it_as_a_whole(x: float, found: bool) -> None:
    made, _, _ = seen_then(discs((x, 50.0, 8.0, RED)), window_px=30.0)
    assert made.report.near[0] == found


@pytest.mark.parametrize(("after_s", "found"), [(0.4, True), (0.6, False)])
def test_who_is_forgotten_is_not_predicted(after_s: float, found: bool) -> None:
    made, _, _ = seen_then(discs((*AT, 8.0, RED)), after_s)
    assert made.report.near[0] == found


@pytest.mark.parametrize(("side", "found"), [(2, True), (1, False), (0, False)])
def test_a_lost_marker_is_found_around_a_few_pixels_that_are_sure(side: int, found: bool) -> None:
    """Only the core has a colour that the background has not: four pixels are enough, one is not."""
    made = detector()
    made.reset()
    usual, image = made._colours, discs((*AT, 8.0, RED))
    image[50 : 50 + side, 60 : 60 + side] = (20, 15, 170)
    core = np.zeros_like(usual.table)
    core[cell_of(np.array((20, 15, 170)))] = 1
    assert usual.near[cell_of(np.array((20, 15, 170)))] == 1
    assert core[cell_of(np.array(RED))] == 0
    made._colours = marker_kernels.MarkerColours(core, usual.near, usual.light)
    try:
        frame = made.update(image, 0.0)
    finally:
        made._colours = usual
    assert frame.found[0] == found == made.report.near[0]
    if found:
        np.testing.assert_allclose(frame.positions_px[0], AT, atol=0.2)


def test_sure_pixels_on_the_wall_are_no_marker() -> None:
    """The piece around them is too large."""
    made = detector()
    made.reset()
    image = discs((*AT, 8.0, BLUE))
    image[70:110, 100:150] = RED
    usual = made._colours
    core = np.zeros_like(usual.table)
    core[cell_of(np.array((20, 15, 170)))] = 1
    image[90:93, 120:123] = (20, 15, 170)
    made._colours = marker_kernels.MarkerColours(core, usual.near, usual.light)
    try:
        assert not made.update(image, 0.0).found[0]
    finally:
        made._colours = usual
