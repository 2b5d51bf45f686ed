"""What docs/extending.md shows is the example's own code, and it names every file of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocapella.cli.plugins import tables

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
FILES = {
    path.name: path.read_text(encoding="utf-8")
    for example in ("plugin_people", "plugin_thermal")  # of files with one name, the page shows the second's
    for path in sorted((ROOT / "examples" / example).rglob("*"))
    if path.suffix in (".py", ".toml") and path.name != "__init__.py"
}


def blocks(text: str) -> list[tuple[str, str]]:
    """The name of the file that was named last before each block of code, and the code."""
    found, file = [], ""
    for part in re.split(r"(```\w+\n.*?```)", text, flags=re.DOTALL):
        code = re.fullmatch(r"```\w+\n(.*?)```", part, flags=re.DOTALL)
        if code is not None:
            found.append((file, code[1]))
        else:
            file = ([file, *(name for name in re.findall(r"`([\w.]+)`", part) if name in FILES)])[-1]
    return found


@pytest.mark.parametrize(("file", "code"), blocks(TEXT))
def test_a_block_is_in_the_file_that_is_named_before_it(file: str, code: str) -> None:
    assert f"\n{code}" in FILES[file]


def test_every_file_is_shown() -> None:
    assert {file for file, _ in blocks(TEXT)} == FILES.keys()


def test_a_block_that_is_not_in_its_file_is_found() -> None:
    ((file, code),) = blocks("In `spots.py`, and `SPOTS`:\n\n```python\nclass Spot(object):\n```\n")
    assert file == "spots.py"
    assert f"\n{code}" not in FILES[file]


def test_every_group_of_entry_points_is_in_the_table() -> None:
    assert sorted(re.findall(r"^\| `(mocapella\.\w+)`", TEXT, flags=re.MULTILINE)) == sorted(
        table.group for table in tables()
    )


def test_readme_links_the_page() -> None:
    assert "[docs/extending.md](docs/extending.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
