"""Check that each command that README and docs quote exists: its verbs and the names of its options."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from mocapella.cli import run

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
)
OF_THE_EXAMPLE = {("node", "heat"), ("export", "spots")}
"""Verbs of examples/plugin_thermal, which is not installed here."""


def quoted(text: str) -> Iterator[tuple[int, str]]:
    """Yield (line number, command) of each quoted command: in code blocks, and in backticks within a paragraph."""
    lines = text.splitlines()
    fenced = False
    for number, line in enumerate(lines, 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        block = fenced or line.startswith("    ")
        if block:
            command = re.match(r"\s*(?:uv run (?:--extra \S+ )?)?mocapella ([a-z].*)", line)
            if command:
                yield number, re.split(r"\s+#\s", command[1])[0]
    prose = re.sub(r"^(?:    .*|```.*?^```)$", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.M | re.S)
    for inline in re.finditer(r"`(?:uv run )?mocapella\s+([a-z][^`]*)`", prose):
        yield text.count("\n", 0, inline.start()) + 1, " ".join(inline[1].split())


@cache
def help_of(*path: str) -> str | None:
    """Return the help text of a command or group; None if there is none."""
    out = io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(out),
        contextlib.suppress(SystemExit),
    ):
        for name, value in {"COLUMNS": "250", "TERMINAL_WIDTH": "250", "NO_COLOR": "1"}.items():
            patch.setenv(name, value)
        run([*path, "--help"])
    usage = f"Usage: mocapella {' '.join(path)}".rstrip() + " ["
    return out.getvalue() if usage in out.getvalue() else None


def options_of(text: str) -> set[str]:
    """Return the names of the options that a help text lists."""
    rows = re.findall(r"^│\s+(?:\*\s+)?(-.*)$", text, flags=re.MULTILINE)
    heads = [re.split(r"\s(?=<|\[|[A-Z]{2})|\s{8,}(?=[A-Z])", row)[0] for row in rows]
    return {name for head in heads for name in re.findall(r"--?[a-z][a-z0-9-]*", head)}


def problem(command: str) -> str:
    """Return what is wrong with a command line that begins after ``mocapella``; empty if it parses."""
    words = re.sub(r"[\[\]'\"]", " ", command).split()
    path: list[str] = []
    text = help_of() or ""
    while words and re.search(r"^\s*Usage: .* COMMAND ", text, flags=re.MULTILINE) and words[0][0].isalpha():
        if words[0].isupper():
            return ""
        path.append(words.pop(0))
        if tuple(path) in OF_THE_EXAMPLE:
            return ""
        if (found := help_of(*path)) is None:
            return f"there is no command: mocapella {' '.join(path)}"
        text = found
    known = options_of(text)
    for word in words:
        name = re.match(r"(--?[a-z][a-z0-9-]*)", word)
        if name and name[1] not in known:
            return f"mocapella {' '.join(path)} has no option {name[1]}"
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_quoted_command_exists(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    found = [f"line {line}: {wrong}" for line, command in quoted(text) if (wrong := problem(command))]
    assert found == []


def test_most_documents_quote_commands() -> None:
    assert sum(len(list(quoted(path.read_text(encoding="utf-8")))) for path in FILES) > 100


@pytest.mark.parametrize(
    ("text", "commands"),
    [
        ("    mocapella serve --view   # a comment", ["serve --view"]),
        ("```sh\nuv run mocapella demo\n```", ["demo"]),
        ("Run `mocapella\nrecord --stop` and `uv run mocapella demo hands`.", ["record --stop", "demo hands"]),
        ("mocapella is a program, `mocapella.registry` a module", []),
    ],
)
def test_commands_are_recognised(text: str, commands: list[str]) -> None:
    assert [command for _, command in quoted(text)] == commands


@pytest.mark.parametrize(
    ("command", "wrong"),
    [
        ("demo hands --seed 3", ""),
        ("node …", ""),
        ("node simulate --scene walk", ""),
        ("dmeo", "there is no command: mocapella dmeo"),
        ("node simulat", "there is no command: mocapella node simulat"),
        ("serve --sensor 2", "mocapella serve has no option --sensor"),
        ("demo [--colour red]", "mocapella demo has no option --colour"),
    ],
)
def test_a_wrong_command_is_reported(command: str, wrong: str) -> None:
    assert problem(command) == wrong
