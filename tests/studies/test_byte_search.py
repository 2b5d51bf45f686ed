"""The search for a participant's code finds it in any content, and takes no other word for it."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import packings

import mocapella.studies.byte_search
from mocapella.studies.byte_search import search

CODE = "P07"
SUM = "ab" * 32


PACKED = {"plain": bytes, **packings.PACKED}


def found(folder: Path, data: bytes, **options: object) -> list[str]:
    (folder / "some.bin").write_bytes(data)
    return sorted({trace.what for trace in search(folder, CODE, [SUM], **options).traces})  # type: ignore[arg-type]


@given(st.binary(max_size=40), st.binary(max_size=40), st.sampled_from([b'"', b"/", b" ", b"\n", b"_", b".", b"-"]))
def test_a_word_is_found_wherever_it_is(
    tmp_path_factory: pytest.TempPathFactory, before: bytes, after: bytes, mark: bytes
) -> None:
    folder = tmp_path_factory.mktemp("found")
    assert "code" in found(folder, before + b" " + CODE.encode() + mark + b" " + after)


@pytest.mark.parametrize("outer", PACKED)
@pytest.mark.parametrize("inner", PACKED)
def test_content_is_unpacked_wherever_it_is_in_a_file(tmp_path: Path, inner: str, outer: str) -> None:
    assert found(tmp_path, b"head" + PACKED[outer](b"\x01" + PACKED[inner](b'{"code":"P07"}'))) == ["code"]
    assert found(tmp_path, b"head" + PACKED[outer](b"\x01" + PACKED[inner](SUM.encode()))) == ["checksum"]
    assert found(tmp_path, b"head" + PACKED[outer](b"\x01" + PACKED[inner](b'{"code":"P08"}'))) == []


@pytest.mark.parametrize(
    "data", [b"\x03P07x", b"\x03\0\0\0P07x", b"P07", b"a/P07/b", b"P07-walk.csv", b"study-P07", "«P07»".encode()]
)
def test_words_names_and_texts_of_binary_formats_are_found(tmp_path: Path, data: bytes) -> None:
    assert found(tmp_path, data) == ["code"]


@pytest.mark.parametrize("data", [b"P070", b"XP07", b"xP07y", b"p07", b"P0 7", b"\xff P07\x91", b"\x91P07 ", b""])
def test_another_word_is_none(tmp_path: Path, data: bytes) -> None:
    assert found(tmp_path, data) == []


def test_another_participants_code_is_none(tmp_path: Path) -> None:
    assert found(tmp_path, b"a P07-2 b") == ["code"]
    assert found(tmp_path, b"a P07-2 b", others={"P07-2"}) == []


@pytest.mark.parametrize("compression", ["zstd", "gzip", "uncompressed"])
@pytest.mark.parametrize("typed", ["String", "Enum"])
def test_cells_of_a_parquet_table_are_found(tmp_path: Path, compression: str, typed: str) -> None:
    polars = pytest.importorskip("polars")
    for code, wanted in ((CODE, ["code"]), ("P08", [])):
        words = [f"some text {number}" for number in range(200)] + [code]
        kind = polars.Enum(words) if typed == "Enum" else polars.String
        table = polars.DataFrame({"who": polars.Series(words * 3, dtype=kind)})
        table.write_parquet(tmp_path / "t.parquet", compression=compression, statistics=False)
        assert sorted({trace.what for trace in search(tmp_path, CODE).traces}) == wanted


def test_names_of_files_and_folders_are_searched(tmp_path: Path) -> None:
    (tmp_path / "x" / "P07").mkdir(parents=True)
    (tmp_path / "x" / "P07" / "a").touch()
    assert [(trace.file, trace.place) for trace in search(tmp_path, CODE).traces] == [("x/P07/a", "name")]


def test_what_is_not_searched_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mocapella.studies.byte_search, "MOST_UNPACKED", 1 << 20)
    (tmp_path / "far").symlink_to(tmp_path.parent)
    (tmp_path / "large.gz").write_bytes(gzip.compress(bytes((1 << 20) + 1)))
    report = search(tmp_path, CODE)
    assert report.unsearched == ("far is a link or no file", "large.gz, byte 0: unpacks to more than 1 MiB")


@pytest.mark.parametrize("packed", ["gzip", "zstd"])
def test_of_a_stream_that_ends_early_what_is_left_is_searched(tmp_path: Path, packed: str) -> None:
    text = b"P07 " + bytes(range(256)) * 4000
    data = PACKED[packed](text)[:-8]
    assert found(tmp_path, data) == ["code"]


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg", "jpg"])
def test_pictures_are_named_because_their_texts_are_drawn(tmp_path: Path, suffix: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2, 1))
    figure.text(0.1, 0.5, "participant P07")
    figure.savefig(tmp_path / f"bars.{suffix}")
    report = search(tmp_path, "P07")
    assert [one.split(" is ")[0] for one in report.unsearched] == [f"bars.{suffix}"]
    (tmp_path / f"bars.{suffix}").write_text("no picture")
    assert search(tmp_path, "P07").unsearched == ()
