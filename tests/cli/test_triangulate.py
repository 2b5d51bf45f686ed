"""The verbs of depth: points of several cameras, a parallel pair, and the tuning of the filter."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.programs import result_here, run_here

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_y

CAMERA = """
[{name}]
size = [640, 480]
matrix = [[600, 0, 320], [0, 600, 240], [0, 0, 1]]
distortions = [0, 0, 0, 0]
rotation = [0, {angle}, 0]
translation = [0, 0, 2]
"""


def scene(folder: Path) -> np.ndarray:
    """A rig of two cameras and the CSV of three points in two frames; where they are."""
    angles = {"left": 0.0, "right": 0.8}
    rig = "".join(CAMERA.format(name=name, angle=angle) for name, angle in angles.items())
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    truth = np.random.default_rng(0).uniform(-0.3, 0.3, (2, 3, 3))
    lens = np.array([600.0, 600, 320, 240, 0, 0, 0, 0, 0])
    rows = ["frame,camera,point,x_px,y_px"]
    for name, angle in angles.items():
        seen = project(apply(rigid(rotation_about_y(angle), [0, 0, 2.0]), truth), lens)
        rows += [f"{i},{name},p{p},{seen[i, p, 0]},{seen[i, p, 1]}" for i in range(2) for p in range(3)]
    (folder / "points.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return truth


def test_points_become_points_in_space(tmp_path: Path) -> None:
    truth = scene(tmp_path)
    found = result_here(
        tmp_path, "track", "points", "points.csv", "--rig", "rig.toml", "--fps", "50", "--out", "out.csv"
    )
    assert found["counted"]["seen"] == 6
    rows = [line.split(",") for line in (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()[1:]]
    np.testing.assert_allclose([[float(x) for x in row[3:6]] for row in rows], truth.reshape(-1, 3), atol=1e-6)
    done = run_here(
        tmp_path, "track", "points", "points.csv", "--rig", "rig.toml", "--fps", "50", "--up", "z", "--out", "o.trc"
    )
    assert done.returncode == 0
    assert "6 of 6 points" in done.stdout
    last = (tmp_path / "o.trc").read_text(encoding="utf-8").splitlines()[-1].split("\t")
    np.testing.assert_allclose([float(x) for x in last[2:5]], truth[1, 0, [1, 2, 0]], atol=1e-6)


def test_what_cannot_be_triangulated_is_one_line(tmp_path: Path) -> None:
    scene(tmp_path)
    (tmp_path / "one.toml").write_text(CAMERA.format(name="left", angle=0.0), encoding="utf-8")
    alone = run_here(tmp_path, "track", "points", "points.csv", "--rig", "one.toml", "--out", "o.csv")
    assert alone.returncode == 1
    assert "a rig of two cameras or more" in " ".join(alone.stderr.split())
    for arguments, said in (
        (["points.csv", "--out", "o.c3d"], "end its name with .csv or .trc"),
        (["points.csv", "--out", "o.csv", "--solver", "magic"], "--solver is 'magic'"),
        (["points.csv", "--out", "o.csv", "--set", "order=COCO"], "setting order is 'COCO'"),
        (["rig.toml", "--out", "o.csv"], "no file of detections"),
    ):
        done = run_here(tmp_path, "track", "points", *arguments, "--rig", "rig.toml")
        assert done.returncode == 1
        assert said in " ".join(done.stderr.split())
        assert "Traceback" not in done.stderr


def test_a_power_law_is_fitted_and_shown(tmp_path: Path) -> None:
    rows = ["distance_cm,disparity_px", *(f"{cm},{4543.3 / cm:.3f}" for cm in (100, 50, 25, 20))]
    (tmp_path / "m.csv").write_text("\n".join(rows), encoding="utf-8")
    found = result_here(tmp_path, "lab", "depth", "fit", "m.csv", "--baseline-cm", "7.5")
    assert abs(found["z"] + 1) < 1e-3
    assert abs(found["k_cm"] - 4543.3) < 5
    assert found["mean_error_corrected_percent"] < 0.01
    assert len(found["rows"]) == 4
    swapped = (tmp_path / "m.csv").read_text(encoding="utf-8").replace(",", ",-").replace(",-disparity", ",disparity")
    (tmp_path / "s.csv").write_text(swapped, encoding="utf-8")
    done = run_here(tmp_path, "lab", "depth", "fit", "s.csv", "--baseline-cm", "7.5")
    assert done.returncode == 1
    assert "the cameras are swapped" in " ".join(done.stderr.split())


@pytest.mark.parametrize("lag_ms", ["0", "400", "500"])
def test_a_goal_of_lag_that_cannot_be_measured_is_refused(tmp_path: Path, lag_ms: str) -> None:
    for name in ("still", "fast"):
        (tmp_path / f"{name}.csv").touch()
    goals = ("--jitter", "0.3", "--lag-ms", lag_ms)
    done = run_here(tmp_path, "lab", "tune", "one-euro", "still.csv", "fast.csv", *goals)
    assert done.returncode == 1
    assert f"--lag-ms is {float(lag_ms)}; it must be above 0 and below 400 ms" in done.stderr


@pytest.mark.slow
def test_the_filter_is_tuned_in_two_steps(tmp_path: Path) -> None:
    rng, at_s = np.random.default_rng(0), np.arange(150) / 60
    noise = rng.normal(0, 0.3, (150, 2))
    swing = 150 * np.sin(2 * np.pi * 1.3 * at_s)[:, None] * [1, 0.5]
    for name, motion in (("still", 0 * swing), ("fast", swing)):
        rows = [f"{t:.5f},tip,{x:.4f},{y:.4f}" for t, (x, y) in zip(at_s, noise + motion + 300, strict=True)]
        (tmp_path / f"{name}.csv").write_text("time_s,point,x_px,y_px\n" + "\n".join(rows), encoding="utf-8")
    done = run_here(
        tmp_path,
        "lab",
        "tune",
        "one-euro",
        "still.csv",
        "fast.csv",
        "--jitter",
        "0.15",
        "--lag-ms",
        "15",
        "--json",
        "-",
    )
    assert done.returncode == 0, done.stderr
    tuned = json.loads(done.stdout)
    assert tuned["jitter_reached"]
    assert tuned["lag_s"] <= 0.015 < tuned["lag_without_beta_s"]
    assert "step 2, in motion" in done.stderr
    failed = run_here(
        tmp_path, "lab", "tune", "one-euro", "still.csv", "fast.csv", "--jitter", "0.00001", "--lag-ms", "15"
    )
    assert failed.returncode == 1
    assert "NOT as wished" in failed.stderr
