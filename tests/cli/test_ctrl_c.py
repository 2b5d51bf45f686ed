"""Ctrl-C at every moment from a command's first import to its last breath: no traceback, and the promised status."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mocapella.cli import RUN_UNTIL_CTRL_C

AT_IMPORT = """
import os, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == wanted:
            print("reached", flush=True)
            os.kill(os.getpid(), signal.SIGINT)

wanted = sys.argv.pop(1)
sys.meta_path.insert(0, Interrupt())
from mocapella.cli import main
main()
"""
AT_EXIT = """
import atexit, os, signal
atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
from mocapella.cli import main
main()
"""
MOMENTS = [
    ("typing", ["serve", "--no-view"]),
    ("typer", ["demo", "--no-view"]),
    ("typer", ["doctor"]),
    ("typer", ["replay", "walk"]),
    ("typer", ["--version"]),
    ("mocapella.cli.view", ["view"]),
    ("mocapella.live.server", ["demo", "--no-view"]),
    ("zenoh", ["serve", "--no-view"]),
    ("zenoh", ["node", "simulate"]),
    ("zenoh", ["node", "bridge"]),
    ("zenoh", ["record", "walk"]),
    ("viser", ["view"]),
    ("mocapella.live.recordings", ["replay", "walk"]),
    ("mocapella.cli.recordings", ["export", "csv", "walk"]),
    ("mocapella.live.launch", ["doctor"]),
]


@pytest.mark.parametrize(("module", "words"), MOMENTS, ids=lambda value: value if isinstance(value, str) else value[0])
def test_it_ends_without_a_word_while_nothing_has_begun(module: str, words: list[str], tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_IMPORT, module, *words],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout == "reached\n"
    assert done.stderr == ""
    assert done.returncode == (0 if words[0] in RUN_UNTIL_CTRL_C else 130)
    assert list(tmp_path.iterdir()) == []


def test_it_changes_nothing_once_all_is_done(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_EXIT, "--version"], cwd=tmp_path, capture_output=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
