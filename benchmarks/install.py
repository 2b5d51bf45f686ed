"""From a checkout to the first demo, for a new user: nothing installed, downloaded or compiled yet.

``uv sync`` and ``uv run mocapella demo`` run on a copy of the checkout with an environment and a cache of their own;
only the Python is shared. The first demo compiles its kernels. A browser that is already running opens
the view. Its picture moves when one screenshot after the other differs. Debian's chromium draws in software here, and
shares the cores with everything else. ``--quick`` takes the user's cache of packages, so that nothing is downloaded
twice; that figure has no goal.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from benchmarks._browser import open_page
from benchmarks.harness import Row, at_least, at_most, measured
from mocapella.errors import MocapellaError, SettingsError

ROOT = Path(__file__).resolve().parent.parent
DEMO_S = 20
GOAL_S = 120
MOVING_S = 20
DEMO = ["uv", "run", "--no-sync", "mocapella", "demo", "--no-browser", "--seconds", str(DEMO_S), "--json", "-"]
URL, TRACKING = "live view: ", "tracking"
"""What the demo prints of its view's address, and when it tracks."""
CHANGED = 0.0005
"""Share of the pixels that differ between screenshots when people move; they are small."""
PAIRS = 3


def run(quick: bool = False) -> list[Row]:
    if shutil.which("uv") is None:
        raise SettingsError("the group install measures uv, which is not here; docs.astral.sh/uv says how to get it")
    with tempfile.TemporaryDirectory() as folder:
        checkout, environment = _checkout(Path(folder)), _environment(Path(folder), keep_cache=quick)
        installed_s = _timed(["uv", "sync", "--python", sys.executable], checkout, environment)
        demo = _first_demo(checkout, environment)
    cache = "the user's cache" if quick else "an empty cache"
    rows = [measured(f"install: uv sync, {cache}", installed_s, "s")]
    if "moving" in demo:
        rows.append(
            measured("install: first demo, until its picture moves", demo["moving"], "s", goal=at_most(MOVING_S))
        )
    return [
        *rows,
        measured("install: first demo, until people are tracked", demo["tracking"], "s"),
        measured(f"install: first demo, {DEMO_S} s of tracking, from command to result", demo["end"], "s"),
        measured("install: results of it", demo["results"], "results", goal=at_least(1)),
        measured("install: both times", installed_s + demo["end"], "s", goal=None if quick else at_most(GOAL_S)),
    ]


def _first_demo(checkout: Path, environment: dict[str, str]) -> dict[str, float]:
    """When what was there, from the command on [s], and the number of results."""
    lines: list[tuple[float, str]] = []
    with open_page() as page:
        began = time.perf_counter()
        process = subprocess.Popen(
            DEMO, cwd=checkout, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        result: list[str] = []
        readers = [
            threading.Thread(target=lambda: result.append(process.stdout.read())),  # type: ignore[union-attr]
            threading.Thread(target=lambda: lines.extend((time.perf_counter(), line) for line in process.stderr or ())),
        ]
        for reader in readers:
            reader.start()
        seen: dict[str, float] = {}
        while process.poll() is None and not seen:
            url = next((line.split(URL)[1].strip() for _, line in lines if URL in line), None)
            if url is None or page is None:
                time.sleep(0.05)
            else:
                _wait_until_it_moves(page, url)
                seen["moving"] = time.perf_counter() - began
        process.wait()
        for reader in readers:
            reader.join()
    seen["end"] = time.perf_counter() - began
    tracking = [at for at, line in lines if line.startswith(TRACKING)]
    if process.returncode != 0 or not tracking:
        raise MocapellaError(f"the demo ended with {process.returncode}:\n{''.join(line for _, line in lines)}")
    return {**seen, "tracking": tracking[0] - began, "results": json.loads(result[0])["frames_out"]}


def _wait_until_it_moves(page: Any, url: str) -> None:
    page.goto(url)
    before, pairs = _canvas(page), 0
    while pairs < PAIRS:
        now = _canvas(page)
        pairs = pairs + 1 if (now != before).any(axis=2).mean() > CHANGED else 0
        before = now


def _canvas(page: Any) -> Any:
    import cv2
    import numpy as np

    data = page.screenshot(clip={"x": 0, "y": 0, "width": 900, "height": 720})  # without the panel
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def _checkout(folder: Path) -> Path:
    """A copy of what an installation needs, without what an earlier one has left."""
    copy = folder / "checkout"
    shutil.copytree(ROOT / "src", copy / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    return copy


def _environment(folder: Path, *, keep_cache: bool) -> dict[str, str]:
    """Return this process' variables, except references to another project, environment or compiled code.

    Bytecode is written, as for a user, whatever is set here: else each process of the demo compiles all it imports.
    """
    elsewhere = {
        *("VIRTUAL_ENV", "UV_PROJECT", "UV_NO_SYNC", "NUMBA_CACHE_DIR", "PYTHONPATH"),
        *("PYTHONPYCACHEPREFIX", "PYTHONDONTWRITEBYTECODE"),
    }
    kept = {name: value for name, value in os.environ.items() if name not in elsewhere}
    ours = {"UV_PROJECT_ENVIRONMENT": str(folder / "environment")}
    return {**kept, **ours} if keep_cache else {**kept, **ours, "UV_CACHE_DIR": str(folder / "cache")}


def _timed(command: list[str], folder: Path, environment: dict[str, str]) -> float:
    """How long the command takes [s]."""
    began = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    took = time.perf_counter() - began
    if done.returncode != 0:
        raise MocapellaError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    return took
