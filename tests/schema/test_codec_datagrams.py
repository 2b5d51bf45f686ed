"""Datagrams of markers: what is written is read, whatever comes is refused or read, and the vectors say so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from vectors.datagrams.generate import DATAGRAMS, MARKERS, SIZE_PX, expected

from mocapella.schema.marker_datagrams import (
    MAX_DATAGRAM_BYTES,
    MAX_MARKERS,
    MAX_SEQUENCE,
    MAX_TIME_US,
    DatagramError,
    DatagramProblem,
    MarkerDatagram,
    decode_marker_datagram,
    encode_marker_datagram,
)

FOLDER = Path(__file__).resolve().parent.parent / "vectors" / "datagrams"
VECTORS = json.loads((FOLDER / "expected.json").read_text(encoding="utf-8"))["datagrams"]


@st.composite
def told(draw: st.DrawFn) -> MarkerDatagram:
    n = draw(st.integers(1, MAX_MARKERS))
    seen = st.tuples(st.integers(-50, 63_950), st.integers(-50, 47_950)).filter(lambda p: p != (-100, -100))
    pairs = draw(st.lists(st.one_of(st.none(), seen), min_size=n, max_size=n))
    positions = np.array([(np.nan, np.nan) if pair is None else pair for pair in pairs]) / 100
    sequence = draw(st.one_of(st.none(), st.integers(0, MAX_SEQUENCE)))
    time_us = None if sequence is None else draw(st.one_of(st.none(), st.integers(0, MAX_TIME_US)))
    return MarkerDatagram(positions, sequence, time_us)


def names(count: int) -> list[str]:
    return [f"m{k}" for k in range(count)]


@given(told(), st.sampled_from([b"", b";", b"\n", b";\r\n", b"\0", b" \t\0\0"]))
def test_what_is_written_is_read_however_it_is_ended(datagram: MarkerDatagram, end: bytes) -> None:
    data = encode_marker_datagram(datagram)
    assert len(data) <= MAX_DATAGRAM_BYTES
    read = decode_marker_datagram(data.rstrip() + end, names(len(datagram.positions_px)), (640, 480))
    np.testing.assert_array_equal(read.positions_px, datagram.positions_px)
    assert (read.sequence, read.time_us) == (datagram.sequence, datagram.time_us)


PIECES = st.sampled_from(
    [
        *(
            ";",
            ",",
            "#",
            "-1",
            "nan",
            "inf",
            "1e308",
            "-0",
            "12",
            "639.5",
            "640",
            " ",
            "\n",
            "\0",
            "é",
            "1_0",
            "٣",
            "+",
            ".",
        )
    ]
)


@given(st.one_of(st.binary(max_size=2000), st.lists(PIECES, max_size=60).map(lambda parts: "".join(parts).encode())))
@example(b"#" + b"9" * 400)
@example(b"1" * 1400)
@example(b"1e99999,1;" * 6)
@example(b"-" * MAX_DATAGRAM_BYTES)
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    problems: list[str] = []
    for count in (1, 2, 6):
        try:
            read = decode_marker_datagram(data, names(count), (640, 480))
        except DatagramError as error:
            problems.append(str(error))
            continue
        assert read.positions_px.shape == (count, 2)
        seen = np.isfinite(read.positions_px)
        np.testing.assert_array_equal(seen[:, 0], seen[:, 1])
        known = read.positions_px[seen[:, 0]]
        assert ((known >= -0.5) & (known <= (639.5, 479.5))).all()
    assert all(len(problem) < 400 and problem.isprintable() for problem in problems)  # a stranger's text is cut


def test_a_program_may_write_zero_for_what_is_lost() -> None:
    data = b"0,0;0,1"
    here = decode_marker_datagram(data, names(2), (640, 480)).positions_px
    lost = decode_marker_datagram(data, names(2), (640, 480), zero_is_lost=True).positions_px
    np.testing.assert_array_equal(here, [(0, 0), (0, 1)])
    np.testing.assert_array_equal(lost, [(np.nan, np.nan), (0, 1)])


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"1,2;3,4;5,6", "3 pairs; the markers are 2: m0, m1"),
        (b"1,2;640,4", r"m1 at \(640, 4\) is not in an image of 640 × 480"),
        (b"1,;3,4", "'1,' has one coordinate; leave both out"),
        (b"x" * 200, r"'x{39}…' has no pairs x,y"),
        (b"#7,-2;1,2;3,4", "'#7,-2' is no #SEQUENCE or #SEQUENCE,TIME_US"),
        (b" \n", "nothing in it; write ;; where no marker is seen"),
        (b"1,2;\x80,4", r"'1,2;\\x80,4' is not a line of ASCII text"),
    ],
)
def test_it_says_what_is_wrong_and_what_would_not_be(data: bytes, why: str) -> None:
    with pytest.raises(DatagramError, match=why):
        decode_marker_datagram(data, names(2), (640, 480))


@pytest.mark.parametrize("name", VECTORS)
def test_the_vectors_say_what_is_read(name: str) -> None:
    data = (FOLDER / f"{name}.datagram").read_bytes()
    assert {"hex": data.hex(), **expected(data)} == VECTORS[name]
    assert ("refused" in VECTORS[name]) == name.startswith("refused_")


def test_the_vectors_are_those_of_the_script_and_have_every_problem() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.datagram")) == sorted(DATAGRAMS) == sorted(VECTORS)
    assert {row["refused"] for row in VECTORS.values() if "refused" in row} == set(DatagramProblem)
    said = json.loads((FOLDER / "expected.json").read_text(encoding="utf-8"))
    assert (tuple(said["order"]), tuple(said["size_px"])) == (MARKERS, SIZE_PX)


@pytest.mark.parametrize("pair", [(np.nan, 3.0), (3.0, np.nan), (np.inf, 3.0), (3.0, -np.inf)])
def test_a_marker_with_one_coordinate_is_written_as_not_seen(pair: tuple[float, float]) -> None:
    assert encode_marker_datagram(MarkerDatagram(np.array([pair, (1.0, 2.0)]))) == b",;1.00,2.00\n"


@pytest.mark.parametrize(
    ("last", "beyond"),
    [
        (b"-0.5,0", b"-0.51,0"),
        (b"0,-0.5", b"0,-0.51"),
        (b"639.5,0", b"639.51,0"),
        (b"0,479.5", b"0,479.51"),
        (b"#%d;1,2" % MAX_SEQUENCE, b"#%d;1,2" % (MAX_SEQUENCE + 1)),
        (b"#9223372036854775807;1,2", b"#9223372036854775808;1,2"),  # what 64 bits hold
        (b"#0,9007199254740992;1,2", b"#0,9007199254740993;1,2"),  # what a 64-bit float holds
        (b"#0,%d;1,2" % MAX_TIME_US, b"#0,%d;1,2" % (MAX_TIME_US + 1)),
        (b"1,2" + b" " * (MAX_DATAGRAM_BYTES - 3), b"1,2" + b" " * (MAX_DATAGRAM_BYTES - 2)),
    ],
)
def test_the_last_value_is_read_and_the_next_is_refused(last: bytes, beyond: bytes) -> None:
    decode_marker_datagram(last, names(1), (640, 480))
    with pytest.raises(DatagramError):
        decode_marker_datagram(beyond, names(1), (640, 480))


@pytest.mark.parametrize(("length", "shown"), [(40, f"'{40 * 'x'}'"), (41, f"'{39 * 'x'}…'")])
def test_a_strangers_text_is_shown_up_to_forty_characters(length: int, shown: str) -> None:
    with pytest.raises(DatagramError, match=f"^{shown} has no pairs"):
        decode_marker_datagram(b"x" * length, names(2), (640, 480))
