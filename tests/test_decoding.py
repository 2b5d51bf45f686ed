"""Content from outside is decoded within limits, and every fault is one line that names the file."""

from __future__ import annotations

import gzip
import os
import tempfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.packings import PACKED

from mocapella import decoding
from mocapella.decoding import (
    DEEPEST,
    MOST_COLUMNS,
    MOST_LINE,
    FileBytes,
    check_filled,
    convert,
    decode_csv,
    decode_json,
    decode_msgpack,
    decode_text,
    decode_toml,
    read_whole,
    text_blocks,
    unpacked_streams,
)
from mocapella.errors import InputError, SettingsError


class Sized(msgspec.Struct):
    """A value that refuses a number with an error of ours, as settings do."""

    size: int

    def __post_init__(self) -> None:
        if self.size < 0:
            raise SettingsError("size is below 0")


def refusal(call: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """Return the one line with which a decoder refuses content of the file ``made.txt``."""
    with pytest.raises(InputError) as caught:
        call(*arguments, file="made.txt", fix="write another", **named)
    text = str(caught.value)
    assert text.startswith("made.txt: ")
    assert text.endswith("; write another")
    assert "\n" not in text
    return text


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(alphabet=st.characters(codec="utf-8")),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(alphabet="a[]{}\"\\"), inner, max_size=4),
    max_leaves=30,
)  # fmt: skip


@given(VALUES)
def test_json_comes_back_whatever_brackets_its_texts_have(value: Any) -> None:
    assert decode_json(msgspec.json.encode(["[" * 99, '\\"[{', value])) == ["[" * 99, '\\"[{', value]


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{", b"nan", b'"\xff"', b'"\\ud800"', b"1" * 5000, b"1" * 30, b"[1, 18446744073709551616]", b"1e999",
        b"[" * 100_000, b'{"a":' * 100_000, b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1),
    ],
)  # fmt: skip
def test_what_is_no_json_within_the_limits_is_refused(text: bytes) -> None:
    refusal(decode_json, text)
    refusal(decode_json, text, kind=dict[str, Any])


def test_json_may_be_as_deep_as_the_limit_says_beside_many_brackets() -> None:
    deep = b"[" * DEEPEST + b"]" * DEEPEST
    assert decode_json(deep) == msgspec.json.decode(deep)
    beside = b"[" + b",".join([b"[[]]"] * 200) + b"]"
    assert len(decode_json(beside)) == 200


def test_json_of_another_type_names_the_field() -> None:
    assert "$.size" in refusal(decode_json, b'{"size": "wide"}', kind=Sized)
    assert "is no box: size is below 0" in refusal(decode_json, b'{"size": -1}', kind=Sized, what="box")
    assert "64 bits" in refusal(decode_json, b'{"size": ' + b"1" * 30 + b"}", kind=Sized)
    assert "is no box: size is below 0" in refusal(convert, {"size": -1}, Sized, what="box")


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x91" * 100_000, b"\xdd\xff\xff\xff\xff", b"\xa1\xff"])
def test_what_is_no_messagepack_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="no MessagePack"):
        decode_msgpack(data)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"x = ", "is no TOML"),
        (b'x = "\xff"', "UTF-8"),
        (b"x = " + b"1" * 5000, "is no TOML"),
        (b"x = 9223372036854775808" + b"0" * 9, "64 bits"),
        (b"x = " + b"[" * 50_000, "is no TOML"),
        (b"x = " + b"[" * 70 + b"]" * 70, "deeper than"),
        (b"a." * 2000 + b"a = 1", "a key has more than"),
        (b"[" + b"a . " * 2000 + b"a]", "a key has more than"),
        (b"x = 1\n" * 200_000, "KiB"),
    ],
)
def test_what_is_no_toml_within_the_limits_is_refused(text: bytes, said: str) -> None:
    assert said in refusal(decode_toml, text)


def test_toml_has_long_rows_of_numbers_and_may_begin_with_a_mark() -> None:
    row = ", ".join(["1.25"] * 500)
    assert decode_toml(f"\ufeffx = [{row}]\n".encode()) == {"x": [1.25] * 500}


def test_a_text_is_utf_8() -> None:
    assert decode_text("\ufeffPrüfling".encode()) == "Prüfling"
    assert "byte 2" in refusal(decode_text, b"ab\xff")


def test_a_table_has_a_cell_for_each_column_that_the_row_has() -> None:
    columns, rows = decode_csv(b'a,b\r\n1,2\r\n\r\n3\r\n"x, y",4,5\r\n')
    assert columns == ("a", "b")
    assert list(rows) == [(2, {"a": "1", "b": "2"}), (3, {"a": "3"}), (4, {"a": "x, y", "b": "4"})]
    assert decode_csv(b"")[0] == ()


def test_a_table_with_too_long_lines_or_too_many_columns_is_refused() -> None:
    assert "line of more than" in refusal(decode_csv, b"a\n" + b"1" * (MOST_LINE + 1))
    assert "row 1" in refusal(decode_csv, b"," * MOST_COLUMNS)
    columns, rows = decode_csv(b"a\n1\n" + b"2" * 200_000, file="made.txt")
    assert columns == ("a",)
    with pytest.raises(InputError, match=r"made\.txt: row 3: cannot be read"):
        list(rows)


def test_a_table_whose_rows_name_ever_new_things_is_refused() -> None:
    check_filled(100 * 64, 100, file="made.txt")
    check_filled(1 << 22, 1, file="made.txt")
    with pytest.raises(InputError, match=r"made\.txt: 3000 rows"):
        check_filled(3000 * 3000, 3000, file="made.txt")


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "big.bin"
    path.write_bytes(b"x" * 1000)
    os.truncate(path, 3 << 20)
    assert len(read_whole(path, fix="", most_bytes=3 << 20)) == 3 << 20
    for name, said in ((path, "more than 2 MiB"), (tmp_path / "none", "No such file"), (tmp_path, "directory"),
                       ("a\0b", "null")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            read_whole(name, fix="choose another", most_bytes=2 << 20)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a device without an end")
def test_a_device_without_an_end_is_refused() -> None:
    with pytest.raises(InputError, match="more than"):
        read_whole("/dev/zero", fix="name a file")


@given(st.lists(st.text(alphabet="ab ,\n\r", max_size=9), max_size=30), st.integers(1, 9), st.booleans())
def test_blocks_of_lines_are_the_text(pieces: list[str], size: int, packed: bool) -> None:
    text = "".join(pieces)
    wanted = text.replace("\r\n", "\n").replace("\r", "\n").rstrip()
    data = b"\xef\xbb\xbf" + text.encode()
    with (
        tempfile.NamedTemporaryFile(suffix=".csv.gz" if packed else ".csv") as file,
        pytest.MonkeyPatch.context() as patch,
    ):
        file.write(gzip.compress(data, 1) if packed else data)
        file.flush()
        patch.setattr(decoding, "_PIECE", size + 3)
        blocks = list(text_blocks(Path(file.name), fix="none"))
    assert "\n".join(blocks) == wanted


def members(data: bytes, count: int) -> bytes:
    """Return a gzip file that unpacks to the data ``count`` times."""
    return gzip.compress(data) * count


def test_a_packed_file_of_one_long_line_ends_within_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(members(b"0" * (1 << 20), 1500))  # 1.5 GB in 1.6 MB
    tracemalloc.start()
    with pytest.raises(InputError, match="row 1: has a line of more than"):
        list(text_blocks(path, fix=""))
    assert tracemalloc.get_traced_memory()[1] < 32 << 20
    tracemalloc.stop()


def test_a_packed_file_of_many_lines_unpacks_up_to_a_ratio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "FREE_UNPACKED", 3 << 20)
    path = tmp_path / "log.csv.gz"
    path.write_bytes(members(b"0,0,0,0\n" * (1 << 17), 40))
    with pytest.raises(InputError, match="unpacks to more than 20 times"):
        list(text_blocks(path, fix=""))
    path.write_bytes(gzip.compress(b"0,0,0,0\n" * (1 << 17)))
    assert sum(block.count("\n") + 1 for block in text_blocks(path, fix="")) == 1 << 17
    path.write_bytes(gzip.compress(os.urandom(2 << 20).hex().encode().replace(b"a", b"\n"), 1))
    assert sum(map(len, text_blocks(path, fix=""))) > 3 << 20  # beyond the free size, at an honest ratio


@pytest.mark.parametrize("packed", PACKED)
def test_a_large_stream_is_none_and_takes_no_memory(packed: str) -> None:
    data = PACKED[packed](bytes(1 << 22))
    assert list(unpacked_streams(data, 1 << 22)) == [(0, bytes(1 << 22))]
    assert list(unpacked_streams(data, (1 << 22) - 1)) == [(0, None)]


@pytest.mark.parametrize("packed", PACKED)
def test_a_damaged_stream_is_unpacked_at_the_beginning_only(packed: str) -> None:
    text = os.urandom(100).hex().encode()
    data = PACKED[packed](text)
    assert list(unpacked_streams(b"head" + data + b"tail" * 99, 1 << 20)) == [(4, text)]
    for cut in range(len(data)):
        assert all(text.startswith(one or b"-") for _, one in unpacked_streams(data[:cut], 1 << 20))
        changed = data[:cut] + bytes([data[cut] ^ 255]) + data[cut + 1 :]
        assert len(list(unpacked_streams(b"head" + changed, 1 << 20))) <= 1


@given(st.binary(max_size=200))
def test_any_bytes_can_be_searched(data: bytes) -> None:
    for mark in (b"", b"\x1f\x8b\x08", b"\x28\xb5\x2f\xfd", b"PK\x03\x04"):
        for at, contents in unpacked_streams(data + mark + data, 1 << 16):
            assert 0 <= at < len(data) + len(mark) + len(data)
            assert contents


@given(st.binary(max_size=40), st.binary(min_size=1, max_size=4), st.integers(0, 45), st.integers(1, 6))
def test_a_file_is_searched_like_its_bytes(data: bytes, text: bytes, start: int, size: int) -> None:
    with tempfile.TemporaryFile() as file, pytest.MonkeyPatch.context() as patch:
        patch.setattr(decoding, "_PIECE", size)
        file.write(data + text[:2])
        content = FileBytes(file)
        for wanted in (text, data[3:6] or b"x"):
            assert content.find(wanted, start) == (data + text[:2]).find(wanted, start)
        assert content[start : start + size] == (data + text[:2])[start : start + size]
        assert len(content) == len(data + text[:2])
