"""The largest object of a mask, without grains and gaps."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.largest_object import largest_object


@given(st.integers(6, 14), st.integers(6, 14), st.integers(1, 4))
def test_the_larger_of_two_is_found_where_it_is(high: int, wide: int, step_px: int) -> None:
    mask = np.zeros((40, 40), np.bool_)
    mask[3 : 3 + high, 4 : 4 + wide] = True
    expected = mask.copy()
    mask[30:34, 30:34] = True  # smaller
    mask[4 + high // 2, 4 + wide // 2] = False  # a gap
    mask[35, 3] = True  # a grain
    found = largest_object(mask, step_px)
    assert found is not None
    assert (found.origin_px, found.step_px) == ((0, 0), step_px)
    np.testing.assert_array_equal(found.phi > 0, expected)


def test_grains_are_no_object() -> None:
    mask = np.zeros((40, 40), np.bool_)
    assert largest_object(mask, 2) is None
    mask[::9, ::9] = True
    assert largest_object(mask, 2) is None
