"""Check that no text of the repository contains the marks of an unresolved merge."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SUFFIXES = {".md", ".toml", ".py", ".pyi", ".proto", ".json", ".c", ".h", ""}
MARKS = re.compile(r"^(<{7}|>{7}|\|{7}) .*$", re.MULTILINE)


def merge_marks(text: str) -> list[str]:
    """Return the lines that a merge left to be resolved."""
    return [found.group(0) for found in MARKS.finditer(text)]


def test_no_file_has_marks_of_a_merge() -> None:
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = [ROOT / name for name in names.split("\0") if name and Path(name).suffix in SUFFIXES]
    assert len(paths) > 500
    found = {str(path): merge_marks(path.read_text(encoding="utf-8")) for path in paths if path.is_file()}
    assert {path: marks for path, marks in found.items() if marks} == {}


@pytest.mark.parametrize("mark", ["<" * 7 + " HEAD", ">" * 7 + " 86736a4 (cli: show commands)", "|" * 7 + " base"])
def test_a_mark_is_found(mark: str) -> None:
    assert merge_marks(f"one\n{mark}\ntwo\n") == [mark]
    assert merge_marks(f"one {mark}\n=======\n") == []
