"""A tag's sides as lines, its corners as their intersections, and what a frame tells of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mocapella.sensing import tags
from mocapella.sensing.tags import TagDetector, TagReport, TagSettings, draw_tag, refined_corners

CORNERS = np.array([[19.5, 19.5], [59.5, 19.5], [59.5, 59.5], [19.5, 59.5]])


def ring(thick: int) -> np.ndarray:
    """A dark square whose sides lie between pixels, as `CORNERS` says, light again so many pixels inside of them."""
    image = np.full((80, 80), 220, np.uint8)
    image[20:60, 20:60] = 40
    image[20 + thick : 60 - thick, 20 + thick : 60 - thick] = 220
    return image


@pytest.mark.parametrize(("thick", "cells"), [(5, 8), (10, 4), (4, 10)])
def test_profiles_end_within_the_outermost_cells(thick: int, cells: int) -> None:
    found, sd = refined_corners(ring(thick), CORNERS, cells, 50.0, 20.0)
    np.testing.assert_allclose(found, CORNERS, atol=0.01)
    assert (sd < 0.01).all()


angles = st.floats(0, 2 * np.pi)


@settings(max_examples=25)
@given(angles, angles, st.floats(0.01, 1), st.floats(0.01, 1), st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
def test_a_corner_is_as_unsure_as_the_lines_make_it_that_meet_there(
    first: float, second: float, sd: float, other_sd: float, at: tuple[float, float]
) -> None:
    """A change of a line's distance moves the corner; variances add up, and each axis has half of their sum."""
    assume(abs(np.sin(first - second)) > 0.21)
    normals = np.array([[np.cos(a), np.sin(a)] for a in (first, second)])
    lines = [(n, float(n @ at), s) for n, s in zip(normals, (sd, other_sd), strict=True)]
    found, told = meet(lines)
    np.testing.assert_allclose(found, at, atol=1e-6)
    moves = []
    for k, (n, d, s) in enumerate(lines):
        moved, _ = meet([(n, d + s, s) if j == k else line for j, line in enumerate(lines)])
        moves.append(moved - found)
    assert told == pytest.approx(np.sqrt(0.5 * np.sum(np.square(moves))), rel=1e-6)


def meet(lines: list[Any]) -> tuple[np.ndarray, float]:
    """Where the first two sides of a square meet, if these are their lines."""
    with pytest.MonkeyPatch.context() as patched:
        given_lines = iter([*lines, None, None])
        patched.setattr(tags, "_side", lambda *_: next(given_lines))
        found, sd = refined_corners(np.zeros((9, 9), np.uint8), CORNERS, 8, 4.0, 20.0)
    assert np.isnan(sd[[0, 2, 3]]).all()
    np.testing.assert_array_equal(found[[0, 2, 3]], CORNERS[[0, 2, 3]])
    return found[1], float(sd[1])


def test_sides_that_are_nearly_parallel_have_no_corner() -> None:
    lines = [(np.array([np.cos(a), np.sin(a)]), 1.0, 0.1) for a in (0.0, np.arcsin(0.19))]
    assert np.isnan(meet(lines)[1])


def points_on(n: np.ndarray, d: float, count: int) -> np.ndarray:
    return d * n + np.linspace(-20, 20, count)[:, None] * np.array([-n[1], n[0]])


@given(angles, st.floats(-100, 100), st.integers(6, 40), st.booleans())
def test_a_line_through_points_is_theirs_and_points_outwards(angle: float, d: float, count: int, turned: bool) -> None:
    n = np.array([np.cos(angle), np.sin(angle)])
    outwards = -n if turned else n
    points = points_on(n, d, count)
    points[count // 2] += 3 * n
    found = tags._line(points, outwards + 0.3 * np.array([-n[1], n[0]]))
    assert found is not None
    np.testing.assert_allclose(found[0], outwards, atol=1e-9)
    assert found[1] == pytest.approx(-d if turned else d, abs=1e-6)
    assert found[2] < 1e-6


@pytest.mark.parametrize(("count", "some"), [(4, False), (5, True)])
def test_a_line_needs_five_points(count: int, some: bool) -> None:
    n = np.array([0.6, 0.8])
    assert (tags._line(points_on(n, 3.0, count), n) is not None) == some


@pytest.mark.parametrize("noise", [0.02, 0.3])
@pytest.mark.parametrize("count", [12, 48])
def test_the_ends_of_a_line_are_as_unsure_as_is_told(noise: float, count: int) -> None:
    """They are 0.1 beyond ends of a line of 0.8; a fitted line's error there, over many draws."""
    rng, n = np.random.default_rng(count), np.array([0.0, 1.0])
    off, told = [], []
    for _ in range(100):
        points = points_on(n, 0.0, count) + rng.normal(0, noise, (count, 1)) * n
        line = tags._line(points, n)
        assert line is not None
        off.append((line[1] - line[0][0] * 25.0) / line[0][1])
        told.append(line[2])
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.sqrt(np.mean(np.square(told))), rel=0.25)


def test_of_few_points_the_scatter_is_not_underestimated() -> None:
    """Of a line through n points with noise, n − 2 of the squares of the noise are left."""
    rng, n = np.random.default_rng(1), np.array([0.0, 1.0])
    lines = [tags._line(points_on(n, 0.0, 6) + rng.normal(0, 0.01, (6, 1)) * n, n) for _ in range(400)]
    scatter = [line[2] for line in lines if line is not None]  # one for six points: √(6/6)
    assert np.sqrt(np.mean(np.square(scatter))) == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize(("off", "kept"), [(0.049, True), (0.051, False)])
def test_a_point_beside_an_exact_line_is_an_outlier_from_a_twentieth_of_a_pixel_on(off: float, kept: bool) -> None:
    n = np.array([0.0, 1.0])
    points = points_on(n, 0.0, 401)
    points[200, 1] = off
    found = tags._line(points, n)
    assert found is not None
    assert (found[1] > 1e-6) == kept


@given(angles, st.floats(1, 40), st.floats(1, 40), st.floats(-9, 9), st.booleans())
def test_the_area_of_a_turned_rectangle_is_the_product_of_its_sides(
    angle: float, width: float, height: float, x: float, mirrored: bool
) -> None:
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) + x
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = (corners[::-1] if mirrored else corners) @ turn.T
    assert tags._area(corners) == pytest.approx(width * height, rel=1e-9)


@pytest.mark.parametrize(("dictionary", "cells"), [("APRILTAG_36H11", 8), ("DICT_4X4_50", 6)])
@pytest.mark.parametrize("cell_px", [1, 10])
def test_a_drawn_tag_has_a_margin_of_two_cells(dictionary: str, cells: int, cell_px: int) -> None:
    side = cells * cell_px
    image = draw_tag(dictionary, 3, side)
    margin = 2 * cell_px
    assert image.shape == (side + 2 * margin, side + 2 * margin)
    rows, columns = np.nonzero(image < 128)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (margin, margin + side - 1) * 2


def seen(number: int, at: tuple[int, int] = (60, 40)) -> np.ndarray:
    """An image of 240 × 200 px with a tag of 64 px whose first pixel is there."""
    image = np.full((200, 240), 255, np.uint8)
    image[at[1] - 16 : at[1] + 80, at[0] - 16 : at[0] + 80] = draw_tag("APRILTAG_36H11", number, 64)
    return image


def test_a_tag_in_the_image_has_its_corners_between_pixels_and_its_area() -> None:
    frame = TagDetector("left").update(seen(5), 0.0)
    corners = np.array([[0, 0], [64, 0], [64, 64], [0, 64]]) + np.array([60, 40]) - 0.5
    np.testing.assert_allclose(frame.positions_px, corners, atol=0.02)
    np.testing.assert_allclose(frame.areas_px, 64**2, rtol=1e-3)
    np.testing.assert_allclose(frame.sd_px, TagSettings().sd_floor_px)


def test_a_report_counts_all_images_so_far() -> None:
    detector = TagDetector("left", TagSettings(ids=(5, 6), least_contrast=200.0))
    twice = np.hstack([seen(6), seen(6)])
    images = (seen(5), twice, seen(7), seen(5), twice, seen(7))
    frames = [detector.update(image // 2, 0.0) for image in images]
    assert [frame.sequence for frame in frames] == list(range(6))
    assert detector.report == TagReport(images=6, found=2, unwanted=2, twice=2, unrefined=8)
    every = TagDetector("left")
    every.update(seen(7), 0.0)
    assert every.report == TagReport(images=1, found=1)


@pytest.mark.parametrize(
    ("corner", "there"),
    [
        ((-0.5, 9), True), ((-0.51, 9), False), ((9, -0.5), True), ((9, -0.51), False), ((239.5, 9), True),
        ((239.51, 9), False), ((9, 199.5), True), ((9, 199.51), False),
    ],
)  # fmt: skip
def test_a_corner_beyond_the_outermost_pixels_is_not_told(
    corner: tuple[float, float], there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = np.array([corner, (9, 9), (30, 9), (30, 30)], np.float64)
    monkeypatch.setattr(TagDetector, "_corners", lambda *_: (corners, np.full(4, 0.1)))
    frame = TagDetector("left").update(seen(5), 0.0)
    assert np.isfinite(frame.positions_px).all(axis=1).tolist() == [there, True, True, True]
