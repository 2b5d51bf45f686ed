"""The example of a comparison prints what docs/compare.md says of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "08_compare.py"


@pytest.mark.slow
def test_it_compares_two_files(single_person: Path) -> None:
    raw, last = (next((single_person / "pose-3d").glob(f"*{end}.trc")) for end in ("0-100", "LSTM"))
    done = subprocess.run([sys.executable, EXAMPLE, raw, last], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "time and rigid motion corrected: RMSE" in done.stdout
    assert "RKnee (angle): mean" in done.stdout
    none = subprocess.run([sys.executable, EXAMPLE, raw], capture_output=True, text=True, check=False)
    assert "08_compare.py walk-1.mcap vicon.c3d" in none.stderr


def test_it_is_short() -> None:
    assert len(EXAMPLE.read_text(encoding="utf-8").splitlines()) < 60
