"""From a checkout to the first demo, as somebody new to the project has it: nothing installed, nothing downloaded yet.

``uv sync`` and ``uv run mocapella demo`` run on a copy of the checkout with an environment and a cache of their own;
only the Python is the one that is here. The first demo also compiles what later ones find compiled. ``--quick`` takes
the user's cache of packages, so that nothing is downloaded twice; that figure has no goal.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.harness import Row, at_least, at_most, measured
from mocapella.errors import MocapellaError, SettingsError

ROOT = Path(__file__).resolve().parent.parent
DEMO_S = 5
GOAL_S = 120
DEMO = ["uv", "run", "--no-sync", "mocapella", "demo", "--headless", "--seconds", str(DEMO_S), "--json", "-"]


def run(quick: bool = False) -> list[Row]:
    if shutil.which("uv") is None:
        raise SettingsError("the group install measures uv, which is not here; docs.astral.sh/uv says how to get it")
    with tempfile.TemporaryDirectory() as folder:
        checkout, environment = _checkout(Path(folder)), _environment(Path(folder), keep_cache=quick)
        installed_s, _ = _timed(["uv", "sync", "--python", sys.executable], checkout, environment)
        demo_s, printed = _timed(DEMO, checkout, environment)
    frames = json.loads(printed)["frames_in"]
    cache = "the user's cache" if quick else "an empty cache"
    return [
        measured(f"install: uv sync, {cache}", installed_s, "s"),
        measured(f"install: first demo of {DEMO_S} s, from command to result", demo_s, "s"),
        measured("install: frames tracked by it", frames, "frames", goal=at_least(1)),
        measured("install: both times", installed_s + demo_s, "s", goal=None if quick else at_most(GOAL_S)),
    ]


def _checkout(folder: Path) -> Path:
    """A copy of what an installation needs, without what an earlier one has left."""
    copy = folder / "checkout"
    shutil.copytree(ROOT / "src", copy / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    return copy


def _environment(folder: Path, *, keep_cache: bool) -> dict[str, str]:
    """This process' variables, without those that lead to another project, environment or compiled code."""
    elsewhere = {"VIRTUAL_ENV", "UV_PROJECT", "UV_NO_SYNC", "NUMBA_CACHE_DIR", "PYTHONPATH", "PYTHONPYCACHEPREFIX"}
    kept = {name: value for name, value in os.environ.items() if name not in elsewhere}
    ours = {"UV_PROJECT_ENVIRONMENT": str(folder / "environment")}
    return {**kept, **ours} if keep_cache else {**kept, **ours, "UV_CACHE_DIR": str(folder / "cache")}


def _timed(command: list[str], folder: Path, environment: dict[str, str]) -> tuple[float, str]:
    """How long the command takes [s], and what it prints."""
    began = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    took = time.perf_counter() - began
    if done.returncode != 0:
        raise MocapellaError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    return took, done.stdout
