"""The first example, as a user runs it: with a server, and without."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.programs import Program, free_port, wait_until

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "01_read_results.py"


def read(port: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLE), f"tcp/127.0.0.1:{port}", "3"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.slow
def test_it_prints_heads_of_a_running_server(tmp_path: Path) -> None:
    assert len(EXAMPLE.read_text().splitlines()) < 40
    port = free_port()
    with Program(tmp_path, "demo", "demo", "--no-view", "--port", str(port), "--scene", "stand") as demo:
        wait_until("the sensors deliver", demo.said("calibrating"), timeout=120.0)
        done = read(port)
        assert demo.end() == 0
    assert done.returncode == 0, done.stderr
    assert "head at" in done.stdout


def test_without_a_server_it_says_in_a_line_what_to_do() -> None:
    done = read(free_port())
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "start a server there (mocapella serve)" in done.stderr
