from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.marker_images import discs, profile, sample

from mocapella.errors import InputError, SettingsError
from mocapella.sensing.colour_learning import _SEED_PX, ColourSample, _seed, grow, learn_colours
from mocapella.sensing.colour_profile import (
    BINS,
    OFFSET,
    SPAN,
    Chromaticities,
    ColourProfile,
    chromaticity,
    decode_profile,
    encode_profile,
    load_profile,
    save_profile,
)
from mocapella.sensing.colour_table import TableSettings, cell_of, classify, lookup_table, no_marker, separability

RED, BLUE = (20, 15, 190), (180, 60, 20)


@pytest.mark.parametrize("along", [-1, 0, 1])
@pytest.mark.parametrize("down", [-1, 0, 1])
def test_the_strongest_colour_about_a_click_is_sought_as_far_on_every_side(along: int, down: int) -> None:
    x = y = 20
    for distance, found in ((_SEED_PX, True), (_SEED_PX + 1, False)):
        at, light = np.zeros((41, 41, 2)), np.zeros((41, 41))
        at[y, x] = 0.1, 0.0
        at[y + distance * down, x + distance * along] = 0.4, 0.0
        light[y + distance * down, x + distance * along] = 9.0
        if not (along or down):
            continue
        colour, luma = _seed(at, light, x, y, strongest=True)
        assert (float(colour[0]), luma) == ((0.4, 9.0) if found else (0.1, 0.0))


@pytest.mark.parametrize("click", [(60, 50), (1, 50), (158, 50), (60, 1), (60, 118), (1, 1), (158, 118)])
@pytest.mark.parametrize("beside", [(0, 0), (2, 0), (-2, 1), (0, -3), (-1, 2), (3, 3)])
def test_one_pixel_of_a_stronger_colour_near_a_click_changes_no_other(
    click: tuple[int, int], beside: tuple[int, int]
) -> None:
    plain = discs((*click, 10.0, (90, 80, 170)))
    spoilt, others = plain.copy(), np.ones(plain.shape[:2], np.bool_)
    x, y = np.clip(np.add(click, beside), 0, (159, 119))
    spoilt[y, x], others[y, x] = (20, 10, 190), False
    np.testing.assert_array_equal(grow(spoilt, click, "red")[others], grow(plain, click, "red")[others])


def test_the_table_says_what_direct_classification_says() -> None:
    image = sample().image
    middles = image // 8 * 8 + 3.5
    np.testing.assert_array_equal(lookup_table(profile())[cell_of(image)], classify(profile(), middles))


@settings(max_examples=10)
@given(st.floats(1.0, 1e3), st.floats(1.0, 1e3))
def test_larger_margins_label_less_and_never_otherwise(margin: float, more: float) -> None:
    few = lookup_table(profile(), TableSettings(margin=margin * more))
    many = lookup_table(profile(), TableSettings(margin=margin))
    assert np.isin(few, [0, *range(1, 7)]).all()
    np.testing.assert_array_equal(few[few > 0], many[few > 0])


@pytest.mark.parametrize("factor", [0.7, 0.85, 1.15])
def test_more_or_less_light_keeps_the_label(factor: float) -> None:
    names = profile().names
    for colour in profile().colours:
        at = np.array(sample().clicks[colour.name])
        x, y = np.round(at).astype(int)
        patch = sample().image[y - 3 : y + 4, x - 3 : x + 4].reshape(-1, 3)
        before = classify(profile(), patch) == names.index(colour.name) + 1
        after = classify(profile(), np.clip(patch * factor, 0, 255)) == names.index(colour.name) + 1
        assert after.mean() >= before.mean() - 0.25


@pytest.mark.parametrize("bgr", [(60, 60, 230), (40, 200, 60), (180, 60, 20)])
def test_a_colour_that_is_clipped_in_twice_the_light_keeps_its_label(bgr: tuple[int, int, int]) -> None:
    """Clipping changes the hue. The same change in a pixel that is not clipped is another colour."""
    learnt = learn_colours("left", [ColourSample(discs((60.0, 50.0, 9.0, bgr)), {"marker": (60, 50)})])
    clipped = np.clip(2.1 * np.array([bgr]), 0, 255)
    assert classify(learnt, clipped).tolist() == [1]
    dimmed = (clipped + OFFSET) * 0.8 - OFFSET
    np.testing.assert_allclose(chromaticity(dimmed), chromaticity(clipped))
    assert classify(learnt, dimmed).tolist() == [0]


def test_skin_and_grey_are_no_marker() -> None:
    table, skin = lookup_table(profile()), profile().skin
    assert skin is not None
    greys = np.repeat(np.arange(0, 256, 5)[:, None], 3, axis=1)
    assert not table[cell_of(greys)].any()
    x, y = (round(v) for v in sample().clicks["skin"])
    patch = sample().image[y - 3 : y + 4, x - 3 : x + 4].astype(float)
    for glance in (0.0, 0.2, 0.5):
        assert not table[cell_of((patch + glance * (255 - patch)).astype(np.uint8))].any()


def test_good_colours_have_no_problem() -> None:
    report = separability(profile())
    assert report.problems == ()
    assert min(report.kept.values()) > 0.8
    np.testing.assert_allclose(report.distances, report.distances.T)


def test_colours_too_alike_are_named() -> None:
    image = discs((60.0, 50.0, 9.0, RED), (110.0, 80.0, 9.0, (26, 20, 185)))
    learnt = learn_colours("left", [ColourSample(image, {"red": (60, 50), "crimson": (110, 80)})])
    assert any("red and crimson are too alike" in problem for problem in separability(learnt).problems)


def test_a_colour_that_is_in_the_background_is_named() -> None:
    image = discs((60.0, 50.0, 9.0, RED), (110.0, 80.0, 9.0, BLUE))
    wall = discs()
    wall[:, :20] = RED
    learnt = learn_colours("left", [ColourSample(image, {"red": (60, 50), "blue": (110, 80)})], backgrounds=[wall])
    problems = separability(learnt).problems
    assert any("red is in the background too" in problem for problem in problems)
    assert not any("blue is in the background" in problem for problem in problems)


@pytest.mark.parametrize(
    ("click", "what"),
    [((500, 50), "outside"), ((5, 5), "hardly any colour"), ((60, 20), "pixels of one colour")],
)
def test_a_click_that_cannot_be_learnt_from_says_where_to_click(click: tuple[int, int], what: str) -> None:
    image = discs((60.0, 50.0, 9.0, RED), (60.0, 20.0, 2.6, RED))
    with pytest.raises(InputError, match=f"red.*{what}.*click (on|into)"):
        learn_colours("left", [ColourSample(image, {"red": click})])


def test_a_region_without_end_is_refused() -> None:
    image = np.full((120, 160, 3), RED, np.uint8)
    with pytest.raises(InputError, match=r"100 % of the image"):
        learn_colours("left", [ColourSample(image, {"red": (60, 50)})])


def test_samples_that_do_not_go_together_are_refused() -> None:
    image = discs((60.0, 50.0, 9.0, RED))
    with pytest.raises(SettingsError, match="no marker was pointed at"):
        learn_colours("left", [ColourSample(image, {"skin": (60, 50)})])
    with pytest.raises(SettingsError, match="differ in size"):
        learn_colours("left", [ColourSample(image, {"red": (60, 50)})], backgrounds=[image[:50]])
    with pytest.raises(SettingsError, match="must be uint8"):
        learn_colours("left", [ColourSample(image[..., 0], {"red": (60, 50)})])


def test_a_click_on_a_reflection_learns_the_colour_beside_it() -> None:
    plain = discs((60.0, 50.0, 10.0, RED))
    shiny = discs((60.0, 50.0, 10.0, RED), (60.0, 50.0, 1.5, (120, 120, 220)))
    a, b = (learn_colours("left", [ColourSample(i, {"red": (60, 50)})]).colours[0] for i in (plain, shiny))
    np.testing.assert_allclose(b.seen.mean, a.seen.mean, atol=0.1)
    assert b.area_px == pytest.approx(a.area_px, rel=0.05)


def test_a_profile_is_the_same_after_a_file(tmp_path: Path) -> None:
    save_profile(tmp_path / "left.json", profile())
    assert load_profile(tmp_path / "left.json") == profile()
    np.testing.assert_array_equal(lookup_table(load_profile(tmp_path / "left.json")), lookup_table(profile()))
    assert [path.name for path in tmp_path.iterdir()] == ["left.json"]


def spoilt(path: tuple[Any, ...], value: Any) -> bytes:
    data = json.loads(encode_profile(profile()))
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return json.dumps(data).encode()


@pytest.mark.parametrize(
    ("path", "value", "what"),
    [
        (("version",), 2, "version is 2.*learn the colours anew"),
        (("camra",), 1, "unknown key 'camra'.*did you mean camera"),
        (("controls", "exposur"), 1, "unknown key 'exposur'.*did you mean exposure"),
        (("camera",), "a b", "camera|sensor name 'a b'"),
        (("colours",), [], "colours is 0"),
        (("colours", 1, "name"), "red", "of different names"),
        (("colours", 0, "name"), "skin", "name is 'skin'"),
        (("colours", 0, "area_px"), -1.0, "area_px is -1"),
        (("colours", 0, "seen", "covariance"), [1.0, 2.0, 1.0], "positive definite"),
        (("colours", 0, "seen", "luma"), [9.0, 5.0, 300.0], "luma"),
        (("colours", 0, "seen", "pixels"), 0, "pixels is 0"),
        (("background", "counts"), [[1]], "counts"),
        (("background", "luma"), 300.0, "luma is 300"),
        (("size_px",), [320], "size_px"),
        (("skin",), "pale", "skin"),
    ],
)
def test_a_spoilt_profile_is_refused_by_name(path: tuple[Any, ...], value: Any, what: str) -> None:
    with pytest.raises(InputError, match=what) as error:
        decode_profile(spoilt(path, value), file="left.json")
    assert str(error.value).startswith("left.json: ")


def test_what_is_no_profile_is_refused(tmp_path: Path) -> None:
    for data in (b"", b"[]", b"{", b"\xff"):
        with pytest.raises(InputError, match="is no colour profile"):
            decode_profile(data)
    with pytest.raises(InputError, match="learn the colours first"):
        load_profile(tmp_path / "none.json")
    with pytest.raises(InputError, match="choose another folder"):
        save_profile(tmp_path / "none" / "left.json", profile())


def test_another_camera_or_size_is_refused() -> None:
    profile().check_camera("left", (320, 240))
    with pytest.raises(SettingsError, match="'left', not of 'right'"):
        profile().check_camera("right", (320, 240))
    with pytest.raises(SettingsError, match=r"320 × 240.*640 × 480"):
        profile().check_camera("left", (640, 480))


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(TableSettings)])
def test_table_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        TableSettings(**{name: -1.0})


def over_chromaticities(density: np.ndarray) -> float:
    """Integral of a density over the plane of `plane`."""
    return float(density.sum() * (2 * SPAN / len(density)) ** 2)


def plane(count: int = 700) -> np.ndarray:
    """(count, count, 2) chromaticities."""
    middles = (np.arange(count) + 0.5) * 2 * SPAN / count - SPAN
    return np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1)


def with_background(counts: np.ndarray, skin: Chromaticities | None) -> ColourProfile:
    background = dataclasses.replace(profile().background, counts=tuple(map(tuple, counts.tolist())))
    return dataclasses.replace(profile(), background=background, skin=skin)


def test_what_is_no_marker_is_in_half_anything_or_in_a_quarter_each_anything_and_skin() -> None:
    """Noise is given as 0, and the background is empty, so that only these are left."""
    at, nothing = plane(), np.zeros((BINS, BINS), np.int64)
    skin = Chromaticities((0.6, -0.4), (0.01, 0.002, 0.008), (60, 100, 140), 500)
    anything = no_marker(with_background(nothing, None), at, np.zeros(3), np.float64(50.0))
    assert over_chromaticities(anything) == pytest.approx(0.5)
    assert np.ptp(anything) == 0
    found = no_marker(with_background(nothing, skin), at, np.zeros(3), np.float64(50.0))
    assert over_chromaticities(found) == pytest.approx(0.5, abs=1e-6)
    np.testing.assert_allclose(found[0, 0], 0.5 * anything[0, 0])
    rest = found - found[0, 0]
    assert over_chromaticities(rest) == pytest.approx(0.25, abs=1e-6)
    u, v = (float((rest * at[..., k]).sum() / rest.sum()) for k in (0, 1))
    assert u / v == pytest.approx(0.6 / -0.4, rel=1e-3), "glances of skin are on the line to grey"
    noisy = no_marker(with_background(nothing, skin), at, np.array([0.02, 0.0, 0.02]), np.float64(50.0))
    assert noisy.max() < found.max()


@pytest.mark.parametrize("area_px", [50.0, 400.0])
def test_a_colour_of_the_background_counts_by_its_area_in_markers(area_px: float) -> None:
    counts = np.zeros((BINS, BINS), np.int64)
    counts[20, 33], counts[40, 30] = 3000, 1000
    at, skin = plane(), None
    empty = no_marker(with_background(np.zeros_like(counts), skin), at, np.zeros(3), np.float64(area_px))
    wall = no_marker(with_background(counts, skin), at, np.zeros(3), np.float64(area_px)) - empty
    width, height = profile().size_px
    assert over_chromaticities(wall) == pytest.approx(width * height / area_px, rel=1e-3)
    peak = at[np.unravel_index(wall.argmax(), wall.shape)]
    np.testing.assert_allclose(peak, (np.array([20, 33]) + 0.5) * 2 * SPAN / BINS - SPAN, atol=0.02)
