"""Table files: the values come back from CSV, LaTeX and Markdown are escaped, and nothing is overwritten."""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import RecordingError, SettingsError
from mocapella.model.names import of_cell
from mocapella.studies.table_files import (
    as_csv,
    as_latex,
    as_markdown,
    cell_text,
    check_new_folder,
    new_folder,
    write_tables,
)
from mocapella.studies.tables import StudyTable, TableColumn

TABLE = StudyTable(
    name="walk-by-joint",
    title="Walk: Δd by joint & side_1",
    columns=(TableColumn("Joint"), TableColumn("Δd", "cm"), TableColumn("Pairs", digits=0)),
    rows=(("Head|_50%", -1.005, 12), ("=cmd()", math.nan, None), ("x", -0.001, 0)),
    notes=("Of 100 % of *pairs*.",),
)
cells = st.none() | st.integers(-(10**9), 10**9) | st.floats() | st.text(st.characters(codec="utf-8"), max_size=20)


@settings(deadline=None)
@given(rows=st.lists(st.tuples(cells, cells), max_size=5))
def test_csv_brings_the_values_back(rows: list[tuple[object, object]]) -> None:
    table = StudyTable("a", "a", (TableColumn("x"), TableColumn("y")), tuple(rows))  # type: ignore[arg-type]
    read = list(csv.reader(io.StringIO(as_csv(table), newline="")))[1:]
    assert len(read) == len(rows)
    for found, wanted in zip(read, rows, strict=True):
        for cell, value in zip(found, wanted, strict=True):
            if isinstance(value, str):
                assert of_cell(cell) == value or not value.isprintable()
                assert cell.isprintable()
            elif value is None or not math.isfinite(value):
                assert cell == ""
            else:
                assert type(value)(cell) == value


@settings(deadline=None)
@given(text=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=30))
def test_latex_and_markdown_escape_all_of_their_signs(text: str) -> None:
    table = StudyTable("a", text, (TableColumn(text),), ((text,),), (text,))
    for line in as_latex(table).split("\n")[1:]:
        plain = re.sub(
            r"\\(textbackslash|textasciicircum|textasciitilde|textless|textgreater)\{\}|\\[{}$&#%_]", "", line
        )
        assert not re.search(r"[$&#%_^~]", plain)
        assert plain.count("{") == plain.count("}")
    row = as_markdown(table).split("\n")[4]
    assert re.sub(r"\\.", "", row).count("|") == 2


def test_latex_and_markdown_as_they_are_read() -> None:
    latex = as_latex(TABLE)
    assert r"Walk: $\Delta$d by joint \& side\_1" in latex
    assert r"Head|\_50\% & $-$1.00 & 12 \\" in latex or r"Head|\_50\% & $-$1.01 & 12 \\" in latex
    assert "=cmd() & -- & -- " in latex
    assert r"\begin{tabular}{lrr}" in latex
    markdown = as_markdown(TABLE)
    assert "| --- | ---: | ---: |" in markdown
    assert r"Head\|\_50%" in markdown
    assert "'=cmd()" in as_csv(TABLE)


def test_zero_has_no_sign_and_what_is_missing_is_a_dash() -> None:
    column = TableColumn("x", digits=2)
    assert [cell_text(value, column) for value in (-0.001, 1.0, None, math.nan, 3, "a\x1b")] == [
        "0.00", "1.00", "–", "–", "3", r"a\x1b",
    ]  # fmt: skip


def test_a_folder_appears_complete_or_not_at_all(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def write_half() -> None:
        with new_folder(out) as made:
            write_tables(made, [TABLE])
            assert not out.exists()
            raise RecordingError("stopped")

    with pytest.raises(RecordingError, match="stopped"):
        write_half()
    assert list(tmp_path.iterdir()) == []
    with new_folder(out) as made:
        write_tables(made, [TABLE])
    assert sorted(path.name for path in out.iterdir()) == [f"walk-by-joint.{end}" for end in ("csv", "md", "tex")]
    assert list(tmp_path.iterdir()) == [out]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(SettingsError, match="nothing is overwritten"):
        check_new_folder(out)
    with pytest.raises(SettingsError, match="there is no folder"):
        check_new_folder(tmp_path / "a" / "b")
    write_tables(out, [TABLE])
    with pytest.raises(FileExistsError):
        write_tables(out, [TABLE])
    with pytest.raises(SettingsError, match="two tables would have the name walk-by-joint"):
        write_tables(tmp_path, [TABLE, TABLE])

    def made_meanwhile() -> None:
        with new_folder(tmp_path / "late"):
            (tmp_path / "late").mkdir()

    with pytest.raises(SettingsError, match="nothing is overwritten"):
        made_meanwhile()
