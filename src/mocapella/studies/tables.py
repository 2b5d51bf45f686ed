"""A table as a value: the report, the terminal and the files (CSV, LaTeX, Markdown) are all made from it."""

from __future__ import annotations

import msgspec


class TableColumn(msgspec.Struct, frozen=True):
    """A column of a table.

    Attributes:
        title: its heading, such as `Δd`.
        unit: such as `cm`; empty if there is none.
        digits: digits after the point of its numbers; text is unchanged.
    """

    title: str
    unit: str = ""
    digits: int = 2


class StudyTable(msgspec.Struct, frozen=True):
    """A table of the analysis.

    Attributes:
        name: stem of its files, such as `walk-by-placement`.
        title: one line above it.
        columns: its columns.
        rows: rows of cells, one for each column; None or NaN is printed as a dash.
        notes: lines below it: its computation, and faults in it.
    """

    name: str
    title: str
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[str | float | int | None, ...], ...]
    notes: tuple[str, ...] = ()
