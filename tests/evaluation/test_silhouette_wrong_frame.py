"""One wrong frame in a knee bend: only it changes, only where it should, and the experiment runs on little."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.cli.evaluate_silhouettes import method_settings
from mocapella.cli.evaluate_wrong_frame import show_wrong_frame
from mocapella.errors import SettingsError
from mocapella.evaluation import silhouette_wrong_frame as experiment
from mocapella.evaluation.silhouette_runs import Film, filmed
from mocapella.evaluation.silhouette_wrong_frame import (
    CASES,
    FRAME,
    MORE_DEG,
    WEIGHTS,
    errors_deg,
    legs_box,
    with_wrong_frame,
)
from mocapella.evaluation.silhouettes import Movement
from mocapella.model.twist_tree import TreePose
from mocapella.sources.simulate.corruption import WRONG
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

SMALL: Any = {"seed": 3, "cameras": 3, "size_px": (160, 120), "fps": 60.0}


@pytest.fixture(scope="module")
def film() -> Film:
    return filmed(silhouette_scene("knee-bend", **SMALL), 0.05)


@pytest.mark.parametrize("kind", WRONG)
def test_one_frame_is_wrong_and_the_others_are_the_same(film: Film, kind: str) -> None:
    worse = with_wrong_frame(film, 1, kind)
    assert worse.images[0] is film.images[0]
    assert worse.images[2] is film.images[2]
    for name, right in film.images[1].items():
        assert (worse.images[1][name] != right).any(axis=-1).mean() > 0.5
        assert right is film.images[1][name]


def test_it_is_wrong_only_where_it_should_be(film: Film) -> None:
    masks = legs_box(film.scene, 1)
    worse, whole = with_wrong_frame(film, 1, "black", masks), with_wrong_frame(film, 1, "black")
    for (name, right), mask in zip(film.images[1].items(), masks, strict=True):
        np.testing.assert_array_equal(worse.images[1][name][~mask], right[~mask])
        np.testing.assert_array_equal(worse.images[1][name][mask], whole.images[1][name][mask])


def test_the_legs_part_is_a_rectangle_with_all_of_the_legs_and_not_the_head(film: Film) -> None:
    names = film.scene.mesh.part_names
    legs = [k for k, name in enumerate(names) if name.split(" ")[-1] in {"thigh", "shank", "foot"}]
    for mask, seen in zip(legs_box(film.scene, 1), film.scene.covered(1), strict=True):
        assert len(legs) == 6
        assert mask[np.isin(seen.parts, legs)].all()
        rows, columns = np.nonzero(mask)
        assert mask.sum() == np.ptp(rows) * np.ptp(columns) + np.ptp(rows) + np.ptp(columns) + 1
        assert not mask[np.nonzero((seen.people == 0).any(axis=1))[0][0]].any()


def test_the_truth_has_no_error(film: Film) -> None:
    np.testing.assert_allclose(errors_deg(film.truth, film.truth), 0.0, atol=1e-5)


def test_frames_are_disturbed_that_are_worse_than_without_the_wrong_frame() -> None:
    usual = np.full(FRAME + 8, 2.0)
    off = usual.copy()
    off[FRAME : FRAME + 3] += 1.01 * MORE_DEG, 9.0, 0.99 * MORE_DEG
    off[FRAME - 1] += 50.0  # before it
    row = experiment._row(7, CASES[0], "black", 1.0, (off, usual), left_out=False)
    assert (row.disturbed, row.most_deg, row.late_deg) == (2, 11.0, 2.0)
    assert row.at_deg == pytest.approx(2.0 + 1.01 * MORE_DEG)
    assert row.before_deg == pytest.approx(7.0)
    assert experiment._row(7, CASES[0], "black", 1.0, (usual, usual), left_out=False).disturbed == 0


def test_the_plotted_angle_is_the_one_that_the_wrong_frame_changes_most(
    film: Film, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiment, "FRAME", 1)
    angles = film.truth.poses.angles.copy()
    angles[1, 7] += 0.3
    angles[1, 5] += 0.2
    angles[2, 3] += 1.0  # in another frame
    found = Movement(film.truth.mesh, TreePose(film.truth.poses.T_world_model, angles), film.truth.fps)
    joint = experiment.most_disturbed(found, film.truth)
    assert joint == film.truth.mesh.joint_names[7]
    off = experiment.angle_deg(found, joint) - experiment.angle_deg(film.truth, joint)
    np.testing.assert_allclose(off, [0, np.degrees(0.3), 0], atol=1e-9)


def test_what_cannot_be_wrong_is_refused(film: Film) -> None:
    with pytest.raises(SettingsError, match="did you mean black"):
        with_wrong_frame(film, 1, "blak")
    with pytest.raises(SettingsError, match="frame is 3; it must be from 0 to 2"):
        with_wrong_frame(film, 3, "black")
    with pytest.raises(SettingsError, match="seeds"):
        experiment.run_wrong_frame([])


def test_the_penalty_is_the_experiments_and_the_rejection_is_the_users() -> None:
    assert method_settings(None, ["rejection=none"]).rejection == "none"
    with pytest.raises(SettingsError, match=r"steadiness is null, but the experiment compares .* leave it out"):
        method_settings(None, ["steadiness=null"])
    with pytest.raises(SettingsError, match=r"rejection is 'nome'; it must be adaptive, none \(did you mean none"):
        method_settings(None, ["rejection=nome"])


def test_the_table_has_room_at_80_columns() -> None:
    errors = np.full(FRAME + 40, 123.4), np.zeros(FRAME + 40)
    rows = [experiment._row(12345, case, "garbage", 1.0, errors, left_out=True) for case in CASES]
    out = StringIO()
    show_wrong_frame(rows, "none", Console(file=out, width=80))
    assert "…" not in out.getvalue()
    assert "image rejection: none" in out.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("rejection", ["adaptive", "none"])
def test_the_experiment_is_a_command(rejection: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A black frame throws the body off without the penalty, less with it, and is left out by default."""
    pytest.importorskip("matplotlib")

    def scene(name: str, *, seed: int) -> Any:
        return silhouette_scene(name, **(SMALL | {"seed": seed}))

    monkeypatch.setattr(experiment, "silhouette_scene", scene)
    monkeypatch.setattr(experiment, "FRAME", 12)
    monkeypatch.setattr(experiment, "FRAMES", 18)
    monkeypatch.setattr(experiment.run_wrong_frame, "__kwdefaults__", {"settings": None, "kinds": ("black",)})
    line = ["lab", "evaluate", "silhouettes-wrong-frame", "--seeds", "5", "--set", f"rejection={rejection}"]
    files = ["--plot", str(tmp_path / "plot.svg"), "--json", str(tmp_path / "rows.json")]
    done = CliRunner().invoke(app, [*line, *files], env={"COLUMNS": "80"})
    assert done.exit_code == 0, (done.output, done.exception)
    result = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    rows = {(row["body"], row["where"], row["weight"]): row for row in result["rows"]}
    assert list(rows) == [(case.body, case.where, weight) for case in CASES for weight in WEIGHTS]
    assert result["rejection"] == rejection
    whole = [row for row in rows.values() if row["where"] == "everywhere"]
    assert all(row["left_out"] == (rejection == "adaptive") for row in whole)
    if rejection == "none":
        for body in ("legs", "whole body"):
            without, with_it = (rows[body, "everywhere", weight]["at_deg"] for weight in WEIGHTS)
            assert without > with_it
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert "…" not in done.output
