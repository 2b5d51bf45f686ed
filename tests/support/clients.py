"""Programs of others, each in an environment of its own, that read what we write; for tests/interop."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest

WANTED: Final = bool(os.environ.get("MOCAPELLA_INTEROP")) or importlib.util.find_spec("ezc3d") is not None
"""Whether other programs are tried: with the group interop, or by this variable."""
MARKS: Final = (
    []
    if WANTED
    else [pytest.mark.slow, pytest.mark.skip(reason="uv run --group interop pytest tests/interop tries other programs")]
)


def read_by(folder: Path, program: str, packages: list[str], *arguments: str) -> list[dict[str, Any]]:
    """Run a client's program in an environment with its packages; return what it prints."""
    script = folder / "client.py"
    script.write_text(program, encoding="utf-8")
    wanted = [word for package in packages for word in ("--with", package)]
    done = subprocess.run(
        ["uv", "run", "--no-project", "--isolated", "--python", "3.11", *wanted, "python", str(script), *arguments],
        capture_output=True, text=True, timeout=1800, check=False, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout.strip().splitlines()[-1]))
