"""The examples that track a recording again and triangulate points, as a user runs them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.take_making import small_take

from mocapella.recording.take_reader import read_take

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
RIG = """
[{name}]
size = [640, 480]
matrix = [[600, 0, 320], [0, 600, 240], [0, 0, 1]]
distortions = [0, 0, 0, 0]
rotation = [0, {angle}, 0]
translation = [0, 0, 2]
"""


def run(name: str, *words: str) -> subprocess.CompletedProcess[str]:
    example = EXAMPLES / name
    assert len(example.read_text(encoding="utf-8").splitlines()) < 60
    return subprocess.run(
        [sys.executable, str(example), *words], capture_output=True, text=True, timeout=240, check=False
    )


@pytest.mark.slow
def test_a_take_is_tracked_again_and_compared(tmp_path: Path) -> None:
    small_take(tmp_path / "a.mcap", 20)
    done = run("06_track_again.py", str(tmp_path / "a.mcap"), "stand-still", str(tmp_path / "b.mcap"))
    assert done.returncode == 0, done.stderr
    assert "recorded: <people: person_0; 25 keypoints, 40 frames" in done.stdout
    assert "tracked again from a.mcap" in done.stdout
    assert read_take(tmp_path / "b.mcap").scene_count == 40
    gone = run("06_track_again.py", str(tmp_path / "gone.mcap"), "default")
    assert gone.returncode == 1
    assert "gone.mcap" in gone.stderr
    assert "Traceback" not in gone.stderr + run("06_track_again.py").stderr


@pytest.mark.slow
def test_points_are_triangulated(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(name="left", angle=0.0) + RIG.format(name="right", angle=0.8))
    rows = ["frame,camera,point,x_px,y_px"]
    rows += [f"{frame},{camera},nose,{320 + np.sign(frame)},240" for frame in range(3) for camera in ("left", "right")]
    (tmp_path / "points.csv").write_text("\n".join(rows) + "\n")
    words = [str(tmp_path / name) for name in ("points.csv", "rig.toml", "out.trc")]
    done = run("07_triangulate_points.py", *words)
    assert done.returncode == 0, done.stderr
    assert "left: 3 detections, 0% rejected" in done.stdout
    assert (tmp_path / "out.trc").is_file()
    gone = run("07_triangulate_points.py", str(tmp_path / "gone.csv"), words[1])
    assert gone.returncode == 1
    assert "Traceback" not in gone.stderr + run("07_triangulate_points.py").stderr
