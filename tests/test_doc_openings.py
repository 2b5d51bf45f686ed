"""Check that each document begins with its purpose: for whom it is, and the shortest command."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = sorted(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name not in ("decisions", "images"))
FIRST = 14
"""Lines that count as the beginning."""


def missing(text: str) -> list[str]:
    """Return what a document's beginning lacks."""
    lines = text.splitlines()
    head = lines[:FIRST]
    lacks = [] if lines and lines[0].startswith("# ") else ["a title"]
    if not any(
        word in " ".join(head) for word in ("For users", "For new users", "For programmers", "For authors", "for users")
    ):
        lacks.append("for whom it is")
    if not any(line.startswith("    ") and ("mocapella " in line or "python -m " in line) for line in head):
        lacks.append("a command")
    return lacks


@pytest.mark.parametrize("path", DOCS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_document_begins_with_its_purpose(path: Path) -> None:
    assert missing(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("text", "lacks"),
    [
        ("# T\n\nFor users.\n\n    mocapella demo\n", []),
        ("For users.\n\n    mocapella demo\n", ["a title"]),
        ("# T\n\n    mocapella demo\n", ["for whom it is"]),
        ("# T\n\nFor users.\n" + FIRST * "\n" + "    mocapella demo\n", ["a command"]),
    ],
)
def test_a_missing_part_is_reported(text: str, lacks: list[str]) -> None:
    assert missing(text) == lacks
