"""An edge at an outline is compared with edges at the same outline elsewhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.edges_elsewhere import EDGE_LEVELS, edges_in_excess

SIDE = 80
AT = np.stack([np.full(20, 40.0), np.linspace(20.0, 60.0, 20)], axis=1)
"""Points of an upright line, x, y [px]."""
NORMALS = np.tile([1.0, 0.0], (len(AT), 1))
ASIDE = np.array([[[-15.0, 0.0]], [[15.0, 0.0]], [[-25.0, 0.0]], [[25.0, 0.0]]]) + np.zeros_like(AT)


def steps(*at, level=100):
    """An image whose columns from each of ``at`` on are brighter or darker in turn."""
    image = np.zeros((SIDE, SIDE, 3), np.uint8)
    for k, column in enumerate(at):
        image[:, column:] = level if k % 2 == 0 else 0
    return image


def test_an_edge_at_the_outline_alone_is_in_excess_by_one():
    np.testing.assert_array_equal(edges_in_excess(steps(40), 1, AT, NORMALS, ASIDE), 1.0)


def test_edges_elsewhere_alone_count_against_the_outline_by_their_share():
    np.testing.assert_allclose(edges_in_excess(steps(25, 55), 1, AT, NORMALS, ASIDE), -0.5)


def test_edges_everywhere_are_no_excess_nor_is_a_plain_image():
    np.testing.assert_allclose(edges_in_excess(steps(15, 25, 40, 55, 65), 1, AT, NORMALS, ASIDE), 0.0)
    np.testing.assert_array_equal(edges_in_excess(steps(), 1, AT, NORMALS, ASIDE), 0.0)


@pytest.mark.parametrize(("level", "counts"), [(EDGE_LEVELS - 1, 0.0), (EDGE_LEVELS, 1.0)])
def test_an_edge_counts_from_its_least_contrast_on(level, counts):
    np.testing.assert_array_equal(edges_in_excess(steps(40, level=int(level)), 1, AT, NORMALS, ASIDE), counts)


def test_a_clear_edge_of_the_room_does_not_count():
    def all_room(pixels):
        return np.ones(len(pixels), np.bool_)

    clear, faint = steps(40), steps(40, level=24)
    np.testing.assert_array_equal(edges_in_excess(clear, 1, AT, NORMALS, ASIDE, is_room=all_room), 0.0)
    np.testing.assert_array_equal(edges_in_excess(faint, 1, AT, NORMALS, ASIDE, is_room=all_room), 1.0)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_the_excess_is_between_its_bounds_and_independent_of_the_normals_length(seed, long):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (SIDE, SIDE, 3), np.uint8)
    elsewhere = rng.uniform(-60.0, 60.0, (5, len(AT), 2))
    found = edges_in_excess(image, 2, AT, NORMALS, elsewhere)
    assert (np.abs(found) <= 1.0).all()
    np.testing.assert_array_equal(edges_in_excess(image, 2, AT, long * NORMALS, elsewhere), found)
