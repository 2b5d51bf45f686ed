"""``mocapella compare``: files, numbers and refusals."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from support.programs import result_here, run_here

import mocapella
from mocapella.cli.compare import show_comparison
from mocapella.comparison.comparison import compared
from mocapella.exports.c3d_file import write_c3d
from mocapella.exports.comparison_report import figure_of
from mocapella.exports.trajectory_tables import write_csv
from mocapella.exports.trc_file import write_trc
from mocapella.geometry.rigid import rigid
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories

T = rigid(np.eye(3)[[2, 0, 1]], [1.0, 2.0, 3.0])


def motion(rate_hz: float, begin_s: float = 0.0) -> Trajectories:
    at = np.arange(begin_s, begin_s + 6.0, 1.0 / rate_hz)
    rng = np.random.default_rng(0)
    names = topology("kinect_v2").joints
    size, rate, phase = (rng.uniform(low, high, (1, 1, len(names), 3)) for low, high in ((0.03, 0.1), (1, 7), (0, 6)))
    positions = rng.normal(size=(len(names), 3)) + size * np.sin(rate * at[:, None, None, None] + phase)
    shape = positions.shape[:3]
    return Trajectories(
        "people", at, np.zeros(len(at), np.int64), ("anna",), names, positions, np.full(shape, 2, np.uint8),
        np.full(shape, np.nan, np.float32), topology("kinect_v2").bones, rate_hz=rate_hz,
    )  # fmt: skip


@pytest.fixture
def files(tmp_path: Path) -> Path:
    write_csv(motion(30.0), tmp_path / "ours.csv")
    write_trc(motion(100.0, 0.5).moved(T), tmp_path / "marks.trc")
    return tmp_path


def test_its_numbers_are_json(files: Path) -> None:
    found = result_here(files, "compare", "ours.csv", "marks.trc", "--curves", "c.csv", "--json", "-")
    np.testing.assert_allclose(found["rigid_motion"]["T_recording_reference"], np.linalg.inv(T), atol=1e-3)
    assert found["time"]["observable"]
    assert found["positions_m"]["rigid"]["joints"]["all"]["Head"]["rmse"] < 0.002
    assert found["positions_m"]["time_only"]["all joints"]["all"]["rmse"] > 1.0
    assert "KneeLeft (angle)" in found["angles_rad"]["angles"]["measured"]
    json.dumps(found, allow_nan=False)
    rows = (files / "c.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("time_s,reference_s,individual,joint,state,dx_m")
    assert len(rows) > 5 * 30 * 25


@pytest.mark.slow
def test_it_writes_what_is_asked_for(files: Path) -> None:
    pytest.importorskip("matplotlib")
    words = ("compare", "ours.csv", "marks.trc", "--report", "r.html", "--plot", "p.png")
    assert run_here(files, *words).returncode == 0
    page = (files / "r.html").read_text(encoding="utf-8")
    assert "time corrected only, files&#x27; own coordinates" in page
    assert "data:image/png;base64," in page
    assert (files / "p.png").stat().st_size > 1000
    again = run_here(files, *words)
    assert again.returncode == 1
    assert "r.html exists; add --force" in again.stderr
    assert run_here(files, *words, "--force").returncode == 0


def test_the_terminal_names_the_corrections(files: Path) -> None:
    done = run_here(files, "compare", "ours.csv", "marks.trc", "--remove-bias")
    assert done.returncode == 0
    assert "corrections that saw the reference: the time offset was estimated" in done.stdout
    assert "the mean difference of each joint was removed (--remove-bias)" in done.stdout


def test_clock_and_space_can_be_held(files: Path) -> None:
    write_trc(motion(100.0), files / "same.trc")
    done = run_here(files, "compare", "ours.csv", "same.trc", "--same-clock", "--same-space", "--json", "a.json")
    assert done.returncode == 0, done.stderr
    assert "time: held, both have one clock (--same-clock)" in done.stdout
    assert "rigid motion: held, both are in the same coordinates (--same-space)" in done.stdout
    assert "corrections that saw the reference: none" in done.stdout
    found = json.loads((files / "a.json").read_text(encoding="utf-8"))
    assert [found[name]["held"] for name in ("time", "rate", "rigid_motion")] == [True] * 3
    assert found["positions_m"]["rigid"]["all joints"]["all"]["rmse"] < 0.005
    held = mocapella.compare(files / "ours.csv", files / "same.trc", same_clock=True, same_space=True)
    assert held.result.corrections == ()


def test_tables_fit_into_the_terminal(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = mocapella.compare(files / "ours.csv", files / "marks.trc").result
    lines = {}
    for width in (60, 80, 200):
        monkeypatch.setenv("COLUMNS", str(width))
        show_comparison(found)
        lines[width] = capsys.readouterr().out.splitlines()
        (row,) = [line for line in lines[width] if line.strip().startswith("Head ")]
        assert len(row) <= width
    text = {width: "\n".join(some) for width, some in lines.items()}
    assert "bias x, y, z mm" in " ".join(text[60].partition("for want of width")[2].split())
    assert "for want of width" not in text[200]


@pytest.mark.slow
def test_a_file_that_is_cut_off_is_compared_with_a_status_of_its_own(files: Path) -> None:
    write_c3d(motion(100.0, 0.5), files / "whole.c3d")
    data = (files / "whole.c3d").read_bytes()
    (files / "cut.c3d").write_bytes(data[: -len(data) // 4])
    text = (files / "marks.trc").read_text(encoding="utf-8").splitlines(keepends=True)
    (files / "cut.trc").write_text("".join(text[:-100]), encoding="utf-8")
    for name, status in (("whole.c3d", 0), ("cut.c3d", 3), ("cut.trc", 3)):
        done = run_here(files, "compare", "ours.csv", name)
        assert done.returncode == status, name
        assert ("its header says" in done.stderr) == (status == 3)


@pytest.mark.slow
def test_the_plot_has_each_joint_once_for_all_people(files: Path) -> None:
    pytest.importorskip("matplotlib")
    one = motion(30.0)
    two = Trajectories(**{**vars(one), "individuals": ("anna", "ben")} | {
        name: np.repeat(getattr(one, name), 2, axis=1) for name in ("positions", "states", "sd")
    })  # fmt: skip
    found = compared({"people": two}, {"people": two}, people={"anna": "anna", "ben": "ben"})
    axes = figure_of(found).axes
    names = [label.get_text() for label in axes[1].get_yticklabels()]
    assert names == list(one.keypoints)
    assert {text.get_text() for text in axes[1].get_legend().get_texts()} == {"anna", "ben"}
    assert axes[1].get_xlabel() == "RMSE [mm]"
    assert {axis.get_title().partition(":")[0] for axis in axes[2::2]} == {"anna", "ben"}


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("ours.csv", "none.c3d"), "cannot be read"),
        (("ours.csv", "marks.trc", "--pairs", "ben=marks"), "no 'ben' among people; known: anna"),
        (("ours.csv", "marks.trc", "--report", "r.pdf"), "end its name with .html"),
        (("ours.csv", "marks.trc", "--plot", "old.png"), "old.png exists; add --force"),
        (("ours.csv", "marks.trc", "--report", "r.html", "--curves", "./r.html"), "name the same file"),
        (("log.csv", "marks.trc"), "log.csv: is a study log, which has no results; make a take of it with"),
        (("ours.csv", "marks.trc", "--bvh-unit", "mm"), "marks.trc is no BVH"),
        (("ours.csv", "marks.trc", "--map", "none.toml"), "cannot be read"),
        (("ours.csv", "short.trc", "--report", "r.html", "--curves", "c.csv"), "the reference is too short"),
    ],
)
def test_a_refusal_is_one_line_and_leaves_nothing(files: Path, words: tuple[str, ...], why: str) -> None:
    write_trc(motion(100.0).at(slice(0, 10)), files / "short.trc")
    (files / "old.png").write_bytes(b"old")
    (files / "log.csv").write_text("Tracker_Time,Person_Id\n1,2\n")
    before = sorted(files.iterdir())
    done = run_here(files, "compare", *words)
    assert done.returncode == 1
    assert why in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert sorted(files.iterdir()) == before


def test_without_matplotlib_it_says_so_before_its_work(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    done = run_here(files, "compare", "ours.csv", "marks.trc", "--report", "r.html")
    assert done.returncode == 1
    assert "uv sync --extra plots" in done.stderr


def test_python_has_the_same_figures(files: Path) -> None:
    ours = mocapella.load(files / "ours.csv")
    found = mocapella.compare(ours, files / "marks.trc", joints={"Head": {"Head": 1.0}, "KneeLeft": {"KneeLeft": 1.0}})
    assert [joint.name for joint in found.result.joints] == ["Head", "KneeLeft"]
    assert "<Comparison of ours.csv and marks.trc" in repr(found)
    assert found.to_dict()["people"] == {"anna": "marks"}
    (files / "map.toml").write_text('Head = "Head"\nKneeLeft = "KneeLeft"\n', encoding="utf-8")
    assert len(mocapella.compare(ours, files / "marks.trc", joints=files / "map.toml").result.joints) == 2
    pytest.importorskip("matplotlib")
    found.report(files / "r.html")
    assert (files / "r.html").stat().st_size > 1000
