"""The command line starts quickly: help and version import no numerical library, codec or network library."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {
    "cv2", "google", "llvmlite", "matplotlib", "mcap", "numba", "numpy", "scipy", "viser", "websockets", "zenoh",
}  # fmt: skip
"""Packages that take long to import."""
RUN = "from mocapella.cli import run\ntry:\n    run({})\nexcept SystemExit as ended:\n    assert not ended.code"


def heavy_of(code: str) -> set[str]:
    """Return the heavy packages that a fresh interpreter has imported after this code."""
    printed = f"{code}\nimport sys\nprint()\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", printed], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()} & HEAVY


@pytest.mark.parametrize(
    "words",
    [["--help"], ["--version"], ["serve", "--help"], ["track", "silhouettes", "--help"], ["node", "--help"]],
    ids=" ".join,
)
def test_help_and_version_import_nothing_heavy(words: list[str]) -> None:
    assert heavy_of(RUN.format(words)) == set()


def test_the_package_alone_imports_nothing_heavy_and_no_command_line_library() -> None:
    code = "import mocapella, sys\nassert not {'typer', 'rich', 'msgspec'} & set(sys.modules)"
    assert heavy_of(code) == set()


@pytest.mark.parametrize("code", ["import numpy", "import mocapella.schema"])
def test_a_heavy_import_would_be_noticed(code: str) -> None:
    assert "numpy" in heavy_of(f"{code}\n{RUN.format(['--version'])}")


def test_a_view_imports_no_compiler() -> None:
    assert not heavy_of("import mocapella.live.view") & {"cv2", "llvmlite", "matplotlib", "numba", "scipy"}
