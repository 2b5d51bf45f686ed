"""Check the table of faults: each row names its tests, and each test exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
COLUMNS = 4
SOURCE = "def test_a() -> None:\n    pass\n\n\nTestLaw = Model.TestCase\n"


def rows(text: str) -> list[list[str]]:
    """Return the cells of all rows of tables of faults, without their heads."""
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    return [row for row in cells if len(row) == COLUMNS and row[0] != "fault" and row[0].strip("-")]


def named(text: str) -> list[tuple[str, str]]:
    """Return (path below tests, name) of each test."""
    return re.findall(r"`((?:\w+/)*test_\w+\.py)::(\w+)`", text)


def defines(source: str, name: str) -> bool:
    """Whether a module has a test, or a class of tests, of this name."""
    return re.search(rf"^(?:def {name}\(|{name} = )", source, re.MULTILINE) is not None


def missing(text: str, tests: Path) -> list[str]:
    """Return the tests that do not exist."""
    return [
        f"{path}::{name}"
        for path, name in named(text)
        if not (tests / path).is_file() or not defines((tests / path).read_text(encoding="utf-8"), name)
    ]


def test_every_test_of_the_table_exists() -> None:
    assert len(named(TEXT)) > 100
    assert missing(TEXT, ROOT / "tests") == []


def test_every_fault_has_an_answer_and_a_test() -> None:
    assert len(rows(TEXT)) > 60
    assert [row[0] for row in rows(TEXT) if not row[0] or not row[1] or not named(row[2])] == []
    assert {line.count("|") for line in TEXT.splitlines() if "::" in line} == {COLUMNS + 1}


@pytest.mark.parametrize(
    ("row", "lacks"),
    [
        ("`live/test_x.py::test_a`, `live/test_x.py::TestLaw`", []),
        ("`live/test_x.py::test_b`", ["live/test_x.py::test_b"]),
        ("`live/test_x.py::test_`", ["live/test_x.py::test_"]),
        ("`test_x.py::test_a`", ["test_x.py::test_a"]),
    ],
)
def test_a_test_that_is_not_there_is_found(tmp_path: Path, row: str, lacks: list[str]) -> None:
    (tmp_path / "live").mkdir()
    (tmp_path / "live" / "test_x.py").write_text(SOURCE)
    assert missing(row, tmp_path) == lacks


def test_a_row_without_a_test_is_found() -> None:
    table = "| fault | does | tests | limits |\n|---|---|---|---|\n| It rains. | It waits. | | no test |\n"
    assert [named(row[2]) for row in rows(table)] == [[]]
