"""Check docs/glossary.md: each term is used, sorted within its group, and defined once."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def groups(text: str) -> dict[str, list[str]]:
    """Return the terms of each section, in their order."""
    return {
        section.splitlines()[0]: re.findall(r"^- \*\*(.+?)\*\*: \S", section, flags=re.MULTILINE)
        for section in text.split("\n## ")[1:]
    }


def problems(text: str, corpus: str) -> list[str]:
    """Return what is wrong with a glossary, one line for each fault."""
    wrong = []
    terms = [term for group in groups(text).values() for term in group]
    for name, group in groups(text).items():
        if not group or group != sorted(group):
            wrong.append(f"not sorted: {name}")
    wrong += [f"defined twice: {term}" for term in sorted(set(terms)) if terms.count(term) > 1]
    wrong += [f"not used: {term}" for term in terms if not re.search(pattern(term), corpus)]
    bullets = text.count("\n- ")
    if bullets != len(terms):
        wrong.append(f"{bullets - len(terms)} entries have no definition")
    return wrong


def pattern(term: str) -> str:
    """Return a pattern for the term with any letter case, white space and a plural s."""
    return r"(?i)\b" + r"[\s_-]+".join(map(re.escape, re.split(r"[ -]", term))) + r"(?:e?s)?\b"


@pytest.fixture(scope="module")
def corpus() -> str:
    """Return the documentation and the source code, without the glossary."""
    files = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "src").rglob("*.py")]
    return "\n".join(file.read_text(encoding="utf-8") for file in files if file.name != "glossary.md")


def test_each_term_is_used_sorted_and_defined_once(corpus: str) -> None:
    assert problems(TEXT, corpus) == []


def test_it_has_about_as_many_terms_as_one_can_read() -> None:
    assert 55 <= sum(map(len, groups(TEXT).values())) <= 100


@pytest.mark.parametrize("file", ["README.md", "CONTRIBUTING.md"])
def test_it_is_linked(file: str) -> None:
    assert "](docs/glossary.md)" in (ROOT / file).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("entries", "fault"),
    [
        ("- **b**: B.\n- **a**: A.", "not sorted: G"),
        ("- **a**: A.\n- **a**: A.", "defined twice: a"),
        ("- **zebra**: Z.", "not used: zebra"),
        ("- **a** A.\n- **b**: B.", "1 entries have no definition"),
    ],
)
def test_a_fault_is_reported(entries: str, fault: str) -> None:
    assert problems(f"# T\n\n## G\n\n{entries}\n", "a b") == [fault]
