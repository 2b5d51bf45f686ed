"""The example that loads a recording, as a user runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from support.take_making import info, record

from mocapella.recording.take_writer import TakeWriter

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "05_load_recording.py"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLE), *words], capture_output=True, text=True, timeout=120, check=False
    )


def test_it_prints_speeds_and_draws_them(tmp_path: Path) -> None:
    assert len(EXAMPLE.read_text(encoding="utf-8").splitlines()) < 60
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 30)
    writer.close()
    done = run(str(tmp_path / "a.mcap"), str(tmp_path / "a.png"))
    assert done.returncode == 0, done.stderr
    assert "person_0: right hand" in done.stdout
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    gone = run(str(tmp_path / "gone.mcap"))
    assert gone.returncode == 1
    assert "gone.mcap" in gone.stderr
    assert "Traceback" not in gone.stderr + run().stderr
