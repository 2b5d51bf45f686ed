"""Pictures with outlines."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError
from mocapella.model.outline_colours import BODIES, INSIDE, OUTSIDE, body_colour
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.outline_picture import Outlines, OverlayWriter, deviations, outlined, side_by_side

GREY = np.full((60, 80, 3), 128, np.uint8)


def square(x, y, side, step=1):
    return Silhouette((x - 2 * step, y - 2 * step), step, np.pad(np.ones((side, side), np.float32), 2) - 0.5)


def near(picture, colour):
    return np.abs(picture.astype(int) - colour[::-1]).max(axis=-1) < 60


def extent(picture, colour):
    """Least column, least row, largest column, largest row."""
    rows, columns = np.nonzero(near(picture, colour))
    return np.array([columns.min(), rows.min(), columns.max(), rows.max()])


@pytest.mark.parametrize("step", [1, 2])
def test_a_models_outline_lies_on_the_border_of_what_it_covers(step):
    one = square(10, 12, 10, step)
    picture = outlined(GREY, [Outlines(one, one, body_colour(0))])
    assert (GREY == 128).all()
    far = step * 9
    assert np.abs(extent(picture, BODIES[0]) - [10, 12, 10 + far, 12 + far]).max() <= step
    assert not near(picture, BODIES[0])[12 + step * 5, 10 + step * 5]
    assert not near(picture, OUTSIDE).any()  # both outlines are one
    assert not near(picture, INSIDE).any()


def test_a_smaller_picture_has_its_outlines_where_they_belong():
    one = square(40, 20, 12)
    picture = outlined(GREY, [Outlines(one, one, body_colour(0))], 40)
    assert picture.shape == (30, 40, 3)
    left, top, right, bottom = extent(picture, BODIES[0])
    assert abs((left + right) / 2 - 22.5) < 2
    assert abs((top + bottom) / 2 - 12.5) < 2


def test_bodies_have_their_own_colours():
    shapes = [square(5, 12, 10), square(40, 12, 10)]
    picture = outlined(GREY, [Outlines(one, one, body_colour(k)) for k, one in enumerate(shapes)])
    assert extent(picture, BODIES[0])[2] < 20
    assert extent(picture, BODIES[1])[0] > 35
    assert body_colour(len(BODIES)) == BODIES[0]


@pytest.mark.parametrize("by", [1, 3])
def test_an_outline_that_is_elsewhere_is_outside_or_inside(by):
    model = square(20, 20, 20)
    picture = outlined(GREY, [Outlines(square(20 - by, 20 - by, 20 + 2 * by), model, BODIES[0])])
    assert np.abs(extent(picture, OUTSIDE) - [20 - by, 20 - by, 39 + by, 39 + by]).max() <= 1
    assert not near(picture, INSIDE).any()
    picture = outlined(GREY, [Outlines(square(20 + by, 20 + by, 20 - 2 * by), model, BODIES[0])])
    assert np.abs(extent(picture, INSIDE) - [20 + by, 20 + by, 39 - by, 39 - by]).max() <= 1
    assert not near(picture, OUTSIDE).any()


@pytest.mark.parametrize("side", range(4))
def test_a_body_that_the_edge_of_the_image_cuts_off_deviates_nowhere(side):
    phi = np.full((12, 12), -0.5, np.float32)
    phi[:6, 3:9] = 0.5
    one = Silhouette((0, 0), 1, np.ascontiguousarray(np.rot90(phi, side)))
    assert deviations(one, one) == ([], [])


@given(st.integers(1, 6), st.integers(-6, 6), st.integers(4, 16), st.sampled_from([1, 2]))
def test_two_shapes_are_as_much_outside_of_each_other_as_the_other_way_round(right, down, side, step):
    a = square(20, 20, side, step)
    b = Silhouette((a.origin_px[0] + right * step, a.origin_px[1] + down * step), step, a.phi)
    lengths = [[sum(len(line) for line in lines) for lines in deviations(*pair)] for pair in ((a, b), (b, a))]
    assert lengths[0] == lengths[1]  # a square moved one way, and the other way
    assert lengths[0][0] > 0
    assert all(length == 0 for lines in (deviations(a, a), deviations(b, b)) for length in map(len, lines))


def test_a_single_sample_has_no_side_of_its_own_and_a_shape_apart_is_all_outside():
    bump = square(20, 20, 20)
    phi = bump.phi.copy()
    phi[1, 12] = 0.5  # one sample over the upper border
    assert deviations(Silhouette(bump.origin_px, 1, phi), bump) == ([], [])
    (line,), inside = deviations(square(60, 5, 10), bump)
    assert len(line) == 4 * 9 + 1
    assert (line[0] == line[-1]).all()
    assert inside == []


def test_pictures_of_any_size_stand_in_a_row():
    joined = side_by_side([np.zeros((60, 80, 3), np.uint8), np.zeros((100, 51, 3), np.uint8)], 50)
    assert joined.shape[0] == 50
    assert joined.shape[1] % 2 == 0


def test_where_nothing_can_be_written_is_said(tmp_path):
    for path in (tmp_path / "no" / "folder", tmp_path / "no" / "film.mp4", tmp_path / "film.avi"):
        with pytest.raises(InputError, match="--overlay"):
            OverlayWriter(path, 30.0, {"c1": (20, 20)})
    writer = OverlayWriter(tmp_path / "seen", 30.0, {"c1": (20, 20)})
    writer.write(7, {"c1": np.zeros((20, 20, 3), np.uint8)})
    writer.close()
    assert cv2.imread(str(tmp_path / "seen" / "c1_000007.jpg")).shape == (20, 20, 3)


def test_a_picture_that_cannot_be_written_is_named(tmp_path):
    writer = OverlayWriter(tmp_path / "seen", 30.0, {"c1": (20, 20)})
    (tmp_path / "seen" / "c1_000007.jpg").mkdir()
    with pytest.raises(InputError, match=r"c1_000007.jpg: cannot be written: Is a directory"):
        writer.write(7, {"c1": np.zeros((20, 20, 3), np.uint8)})


def test_a_camera_that_gives_no_picture_is_black_in_a_film(tmp_path):
    writer = OverlayWriter(tmp_path / "seen.mp4", 30.0, {"c1": (64, 48), "c2": (64, 48)})
    white = np.full((48, 64, 3), 255, np.uint8)
    writer.write(0, {"c2": white})
    writer.write(1, {"c1": white, "c2": white})
    writer.close()
    film = cv2.VideoCapture(str(tmp_path / "seen.mp4"))
    (_, first), (_, second) = film.read(), film.read()
    half = first.shape[1] // 2
    assert [part.mean() > 128 for part in (first[:, :half], first[:, half:])] == [False, True]
    assert [part.mean() > 128 for part in (second[:, :half], second[:, half:])] == [True, True]
