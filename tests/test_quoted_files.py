"""Check that each source file that README and docs quote exists under that path."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FILES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def existing() -> set[str]:
    """Return the paths of all Python files below the folders with code, and each of their endings."""
    paths: set[str] = set()
    for folder in ("src", "tests", "examples", "benchmarks", "docs", "scripts"):
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT).parts
            paths |= {"/".join(parts[k:]) for k in range(len(parts))}
    return paths


def missing(text: str, paths: set[str]) -> list[str]:
    """Return the quoted Python files that do not exist."""
    return sorted(set(re.findall(r"`((?:\w+/)*\w+\.py)`", text)) - paths)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_quoted_file_exists(path: Path) -> None:
    assert missing(path.read_text(encoding="utf-8"), existing()) == []


def test_a_missing_file_is_reported() -> None:
    assert missing("`tracker/default.py`, `no_such_module.py` and `tracker/no.py`", {"tracker/default.py"}) == [
        "no_such_module.py",
        "tracker/no.py",
    ]
