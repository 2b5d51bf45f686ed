"""Write tables as CSV, LaTeX and Markdown into a new folder that appears complete or not at all."""

from __future__ import annotations

import csv
import io
import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from mocapella.errors import DiskFullError, RecordingError, SettingsError, visible
from mocapella.model.names import as_cell
from mocapella.recording import disk
from mocapella.studies.tables import StudyTable, TableColumn

DASH: Final = "–"
"""Printed for a value that there is none of."""

_LATEX: Final = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}", '"': "''",
    "Δ": r"$\Delta$", "−": r"$-$", "°": r"$^\circ$", "²": r"$^2$", "√": r"$\surd$", "≤": r"$\leq$", "≥": r"$\geq$",
    "×": r"$\times$", "±": r"$\pm$", "θ": r"$\theta$", "α": r"$\alpha$", "ε": r"$\varepsilon$", "η": r"$\eta$",
    "χ": r"$\chi$", "–": "--", "…": r"\ldots{}", "’": "'",
}  # fmt: skip
_MARKDOWN: Final = re.compile(r"([\\`*_{}\[\]<>|#~])")
_NAME: Final = re.compile(r"[^A-Za-z0-9_.=-]")


def cell_text(value: str | float | int | None, column: TableColumn) -> str:
    """Return a cell's printed text: numbers with the column's digits, and a dash for None and NaN."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return DASH
    if isinstance(value, str):
        return visible(value)
    if isinstance(value, int):
        return str(value)
    text = f"{value:.{column.digits}f}"
    return text.removeprefix("-") if float(text) == 0 else text.replace("-", "−")


def heading(column: TableColumn) -> str:
    """Return a column's heading with its unit, such as ``Avg Δd [cm]``."""
    return f"{column.title} [{column.unit}]" if column.unit else column.title


def as_csv(table: StudyTable) -> str:
    """Return a table as comma-separated text: numbers in full, an empty cell for None and NaN.

    Texts that a spreadsheet would take for a formula get an apostrophe before them.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heading(column) for column in table.columns)
    for row in table.rows:
        writer.writerow(_csv_cell(value) for value in row)
    return text.getvalue()


def _csv_cell(value: str | float | int | None) -> str:
    if isinstance(value, str):
        return as_cell(visible(value))
    if value is None or not math.isfinite(value):
        return ""
    return repr(value)


def as_latex(table: StudyTable) -> str:
    """Return a table as LaTeX: a ``table`` with the rules of the package booktabs, all text escaped."""
    kinds = "".join("l" if _is_text(table, k) else "r" for k in range(len(table.columns)))
    head = " & ".join(_latex(heading(column)) for column in table.columns)
    rows = [" & ".join(_latex(text) for text in _texts(table, row)) for row in table.rows]
    notes = [rf"\par\footnotesize {_latex(note)}" for note in table.notes]
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            r"\begin{table}", r"\centering", rf"\caption{{{_latex(table.title)}}}", rf"\label{{tab:{table.name}}}",
            rf"\begin{{tabular}}{{{kinds}}}", r"\toprule", head + r" \\", r"\midrule",
            *(row + r" \\" for row in rows), r"\bottomrule", r"\end{tabular}", *notes, r"\end{table}", "",
        ]
    )  # fmt: skip


def _latex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)


def as_markdown(table: StudyTable) -> str:
    """Return a table as Markdown, with its title as a heading and its notes below."""
    lines = [f"## {_markdown(table.title)}", ""]
    lines += [_line(_markdown(heading(column)) for column in table.columns)]
    lines += [_line("---" if _is_text(table, k) else "---:" for k in range(len(table.columns)))]
    lines += [_line(map(_markdown, _texts(table, row))) for row in table.rows]
    for note in table.notes:
        lines += ["", _markdown(note)]
    return "\n".join(lines) + "\n"


def _line(cells: Iterator[str] | map[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _markdown(text: str) -> str:
    return _MARKDOWN.sub(r"\\\1", text)


def _texts(table: StudyTable, row: Sequence[str | float | int | None]) -> list[str]:
    return [cell_text(value, column) for value, column in zip(row, table.columns, strict=True)]


def _is_text(table: StudyTable, place: int) -> bool:
    return any(isinstance(row[place], str) for row in table.rows)


FORMATS: Final[dict[str, Callable[[StudyTable], str]]] = {".csv": as_csv, ".tex": as_latex, ".md": as_markdown}
"""Ends of the files' names, and what makes their text."""


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``path`` that gets its name when all has been written; else it is removed.

    Raises:
        SettingsError: ``path`` exists, or its parent folder does not.
        DiskFullError, RecordingError: it cannot be written.
    """
    check_new_folder(path)
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{path.name[:100]}.", suffix=".tmp", dir=path.parent))
        try:
            yield made
            made.chmod(0o777 & ~_umask())
            check_new_folder(path)
            made.rename(path)
        finally:
            shutil.rmtree(made, ignore_errors=True)
        disk.sync_folder(path.parent)
    except OSError as error:
        kind = DiskFullError if disk.is_full(error) else RecordingError
        raise kind(f"cannot write {path}: {error.strerror}; choose another folder") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def check_new_folder(path: Path) -> Path:
    """Check that a folder can be made at ``path``; return it.

    Raises:
        SettingsError: it exists, or its parent folder does not or cannot be written to.
    """
    problem = ""
    if os.path.lexists(path):
        problem = "it exists, and nothing is overwritten; name a new folder"
    elif not path.parent.is_dir():
        problem = f"there is no folder {path.parent}"
    elif not os.access(path.parent, os.W_OK | os.X_OK):
        problem = f"{path.parent} cannot be written to"
    if problem:
        raise SettingsError(f"{path}: {problem}")
    return path


def write_tables(folder: Path, tables: Sequence[StudyTable]) -> None:
    """Write each table as three files, named after it, into an existing folder; a file is never overwritten.

    Raises:
        SettingsError: two tables have the same name.
        OSError: a file exists, or cannot be written.
    """
    names = [_NAME.sub("-", table.name) for table in tables]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise SettingsError(f"two tables would have the name {twice[0]}")
    for name, table in zip(names, tables, strict=True):
        for suffix, text_of in FORMATS.items():
            with (folder / f"{name}{suffix}").open("x", encoding="utf-8", newline="\n") as file:
                file.write(text_of(table))
