"""Messages about expected people: they survive their codec, and nothing else is read."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import WireError
from mocapella.wire.expected import MAX_BYTES, MOST_REGIONS, read_expected, write_expected

PIXELS = st.floats(-5000, 5000, width=32)


@given(st.integers(-(2**62), 2**62), st.lists(st.tuples(PIXELS, PIXELS, PIXELS, PIXELS), max_size=MOST_REGIONS + 3))
def test_boxes_survive_to_a_tenth_of_a_pixel(time_ns: int, rows: list[tuple[float, float, float, float]]) -> None:
    corners = np.array(rows, np.float32).reshape(-1, 2, 2)
    boxes = np.sort(corners, axis=1).reshape(-1, 4)
    found = read_expected(write_expected(time_ns, boxes))
    assert found.time_ns == time_ns
    np.testing.assert_allclose(found.boxes, boxes[:MOST_REGIONS], atol=0.06)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no message about expected people"),
        (b"[]", "object"),
        (b'{"time_ns":1}', "regions_px"),
        (b'{"time_ns":1,"regions_px":[[0,0,1]]}', "length"),
        (b'{"time_ns":1,"regions_px":[],"more":1}', "more"),
        (b'{"time_ns":1,"regions_px":[[5,0,1,1]]}', "beyond its right"),
        (b'{"time_ns":1,"regions_px":[[0,0,1e6,1]]}', "within"),
        (b'{"time_ns":1,"regions_px":[[0,0,1e300,1]]}', "within"),  # more than a float32 holds
        (b'{"time_ns":1,"regions_px":[' + b",".join([b"[0,0,1,1]"] * 33) + b"]}", "33 boxes"),
        (b" " * (MAX_BYTES + 1), "8193 bytes"),
    ],
)
def test_what_cannot_be_read_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(WireError, match=words):
        read_expected(data)
