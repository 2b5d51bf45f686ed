"""Parts of pictures with outlines: where lines are drawn, majorities, stretches, rows of pictures, and crosses."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.marker_images import discs

from mocapella.errors import InputError, SettingsError
from mocapella.model.markers import marker_frame
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing import outline_picture
from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.marker_mask import encode_image, mask_image, paint_of
from mocapella.sensing.outline_lines import mask_lines
from mocapella.sensing.outline_picture import Outlines, OverlayWriter, deviations, outlined, side_by_side


def box(x: int, y: int, width: int, height: int, step: int = 1) -> Silhouette:
    """Samples from (x, y) on, in a window that ends with them."""
    return Silhouette((x, y), step, np.full((height, width), 0.5, np.float32))


@pytest.mark.parametrize("scale", [1, 3, 4])
def test_an_outline_is_drawn_at_the_middles_of_its_pixels_at_any_scale(scale: int) -> None:
    """A pixel of the image is so many pixels wide, its middle half of them from its edge."""
    image = np.zeros((24, 30, 3), np.uint8)
    one = box(7, 5, 11, 13)
    shown = outlined(image, [Outlines(one, one, (255, 255, 255))], 30 * scale)
    assert shown.shape == (24 * scale, 30 * scale, 3)
    bright = shown[..., 0].astype(float)
    rows, columns = np.arange(24 * scale), np.arange(30 * scale)
    middle_x, middle_y = (12 + 0.5) * scale - 0.5, (11 + 0.5) * scale - 0.5
    column, row = bright[round(middle_y)], bright[:, round(middle_x)]
    for at, profile_, numbers, centre in ((7, column, columns, middle_x), (17, column, columns, middle_x),
                                          (5, row, rows, middle_y), (17, row, rows, middle_y)):  # fmt: skip
        side = (numbers < centre) == (at < 11)
        assert np.average(numbers[side], weights=profile_[side]) == pytest.approx((at + 0.5) * scale - 0.5, abs=0.35)


@pytest.mark.parametrize(("width", "height"), [(15, 12), (60, 48), (1, 1)])
def test_a_picture_keeps_its_proportions(width: int, height: int) -> None:
    assert outlined(np.zeros((24, 30, 3), np.uint8), width=width).shape == (height, width, 3)


@pytest.mark.parametrize("side", range(4))
def test_what_leaves_the_models_window_is_outside_on_every_side(side: int) -> None:
    x, y, width, height = [(10, 20, 20, 10), (20, 10, 10, 20), (20, 20, 20, 10), (20, 20, 10, 20)][side]
    model = box(20, 20, 10, 10)
    outside, inside = deviations(box(x, y, width, height), model)
    assert inside == []
    points = np.concatenate(outside)
    beyond = (points < 20).any(axis=1) | (points > 29).any(axis=1)
    assert np.count_nonzero(~beyond) <= 4
    assert np.count_nonzero(beyond) >= 26
    assert deviations(model, box(x, y, width, height))[0] == []


def test_a_sample_on_the_models_contour_is_not_covered() -> None:
    phi = np.pad(np.full((10, 10), 0.5, np.float32), 4)
    edge = Silhouette((16, 16), 1, np.where(phi > 0, phi, np.float32(0.0)))
    outside, inside = deviations(box(17, 17, 16, 16), edge)
    assert len(np.concatenate(outside)) == 4 * 15 + 1
    assert inside == []


@given(arrays(np.bool_, st.integers(5, 30)))
def test_a_majority_is_three_of_the_five_around_a_closed_line(flags: Any) -> None:
    wanted = [sum(flags[(k + d) % len(flags)] for d in range(-2, 3)) >= 3 for k in range(len(flags))]
    assert outline_picture._most(flags).tolist() == wanted


@given(arrays(np.bool_, st.integers(3, 25)))
def test_stretches_of_a_closed_line_have_each_chosen_sample_once_and_the_next(chosen: Any) -> None:
    line = np.stack([np.arange(len(chosen)), 100 + np.arange(len(chosen))], axis=-1)
    parts = outline_picture._parts(line, chosen)
    numbers = [part[:, 0].tolist() for part in parts]
    assert sorted(n for part in numbers for n in part[:-1]) == np.flatnonzero(chosen).tolist()
    for part in numbers:
        assert all((a + 1) % len(chosen) == b for a, b in pairwise(part))
        assert chosen.all() or not chosen[part[-1]]
    assert len(parts) == (1 if chosen.all() else np.count_nonzero(chosen & ~np.roll(chosen, 1)))


def test_pictures_in_a_row_keep_their_proportions_and_order() -> None:
    left, right = np.full((60, 80, 3), 50, np.uint8), np.full((100, 51, 3), 200, np.uint8)
    joined = side_by_side([left, right], 30)
    assert joined.shape == (30, 40 + 14, 3)  # 15.3 px wide, and a last odd column is cut off
    assert (joined[:, :40] == 50).all()
    assert (joined[:, 40:] == 200).all()
    assert side_by_side([np.zeros((900, 3, 3), np.uint8), left], 30).shape == (30, 40, 3)


@pytest.mark.parametrize(("size", "every"), [((26, 26), 1), ((27, 26), 2), ((51, 51), 2), ((52, 51), 3)])
def test_borders_are_thinned_out_evenly_to_the_wanted_number(size: tuple[int, int], every: int) -> None:
    """A border of w × h samples has 2w + 2h − 4."""
    points = mask_lines(np.pad(np.ones(size, np.uint8), 1), (0, 0), 1, 100)
    assert len(points) == -(-(2 * size[0] + 2 * size[1] - 4) // every)


@pytest.mark.parametrize(("samples", "lines"), [([(2, 2), (2, 3)], 0), ([(2, 2), (2, 3), (3, 2)], 1)])
def test_a_line_that_encloses_an_area_has_three_samples(samples: list[tuple[int, int]], lines: int) -> None:
    mask = np.zeros((6, 7), np.uint8)
    for at in samples:
        mask[at] = 1
    assert len(mask_lines(mask, (0, 0), 1)) == (3 if lines else 0)


def test_a_folder_is_made_and_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    OverlayWriter(tmp_path / "new", 30.0, {}).close()
    assert (tmp_path / "new").is_dir()
    OverlayWriter(tmp_path / "new", 30.0, {}).close()
    (tmp_path / "folder.d").mkdir()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "folder.d", tmp_path / "file", tmp_path / "file" / "film.mp4"):
        with pytest.raises(InputError, match="--overlay"):
            OverlayWriter(path, 30.0, {})


def test_a_film_that_was_closed_is_closed_and_one_without_frames_is_none(tmp_path: Path) -> None:
    path = tmp_path / "seen.MP4"
    writer = OverlayWriter(path, 10.0, {"c1": (64, 48)})
    writer.close()
    assert not path.exists()
    writer.write(0, {"c1": np.full((48, 64, 3), 255, np.uint8), "c2": np.zeros((4, 4, 3), np.uint8)})
    writer.write(1, {})
    writer.close()
    writer.close()
    film = cv2.VideoCapture(str(path))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 2
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    _, first = film.read()
    assert first.shape == (720, 960, 3)
    assert first.mean() > 250


@pytest.mark.parametrize(("scale", "some"), [(0.25, True), (0.249, False), (1.0, True), (2.0, True)])
def test_a_mask_may_be_resized_down_to_one_pixel(scale: float, some: bool) -> None:
    image = np.zeros((4, 9, 3), np.uint8)
    if some:
        again = cv2.imdecode(np.frombuffer(encode_image(image, "png", scale), np.uint8), cv2.IMREAD_COLOR)
        assert again.shape == (round(4 * scale), round(9 * scale), 3)
    else:
        with pytest.raises(SettingsError, match="nothing of 9 × 4 px would be left"):
            encode_image(image, "png", scale)


@cache
def profile() -> ColourProfile:
    image = discs((40.0, 50.0, 9.0, (20, 15, 190)), (80.0, 50.0, 9.0, (180, 60, 20)), (120.0, 50.0, 9.0, (60, 190, 90)))
    return learn_colours("left", [ColourSample(image, {"red": (40, 50), "blue": (80, 50), "green": (120, 50)})])


def test_paint_is_the_brightest_of_each_hue() -> None:
    paint = paint_of(profile()).astype(float)
    assert (paint[0] == 0).all()
    assert len(paint) == len(profile().colours) + 1
    for (blue, green, red), colour in zip(paint[1:], profile().colours, strict=True):
        assert max(blue, green, red) == 255
        u, v = colour.seen.mean
        assert red / green == pytest.approx(np.exp(u), rel=0.1)
        assert blue / green == pytest.approx(np.exp(v), rel=0.1)


def crossed(*positions: tuple[float, float]) -> Any:
    names = ["x" * (k + 1) for k in range(len(positions))]
    frame = marker_frame("left", names, time_ns=0, size_px=(80, 60), positions_px=list(positions))
    return mask_image(np.zeros((60, 80, 3), np.uint8), profile(), np.zeros(32768, np.uint8), frame)[..., 0]


def test_a_marker_without_a_position_has_no_cross() -> None:
    for position in ((np.nan, np.nan), (np.nan, 30.0), (40.0, np.nan)):
        assert not crossed(position).any()


@pytest.mark.parametrize("x", [40.0, 40.25, 40.5])
@pytest.mark.parametrize("y", [30.0, 30.5])
def test_a_cross_is_at_its_markers_place_between_the_pixels_and_its_name_beside_it(x: float, y: float) -> None:
    shown = crossed((x, y)).astype(float)
    across, down = shown[50:52].sum(), shown[:, 46:48].sum(axis=1)
    assert across == 0
    assert np.average(np.arange(60), weights=down) == pytest.approx(y, abs=0.1)
    right = shown[33:36].sum(axis=0)
    assert np.average(np.arange(80), weights=right) == pytest.approx(x, abs=0.1)
    arms = np.zeros_like(shown, dtype=bool)
    arms[:, 38:43] = arms[28:33, :51] = True
    rows, columns = np.nonzero(np.where(arms, 0, shown) > 60)
    assert len(rows) > 3
    assert columns.min() >= 48
    assert rows.max() <= 30
