"""Scores of a hand's solvers: their scenes are as said, every solver has a row, and wrong names are refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from rich.console import Console

from mocapella.cli.evaluate_hand_solvers import show_solvers
from mocapella.errors import SettingsError
from mocapella.evaluation.hand_solvers import SCENES, SolverRow, SolverScene, compare_solvers, simulated_markers
from mocapella.kinematics.hand_solvers import SOLVER_NAMES
from mocapella.model.hand import hand_model

MODEL = hand_model("thesis")
SHAPE = MODEL.shape("right")


def test_a_scene_has_the_errors_that_it_names() -> None:
    angles, _, exact = simulated_markers(MODEL, SHAPE, SolverScene(0.0), 3, 240)
    same, _, noisy = simulated_markers(MODEL, SHAPE, SolverScene(0.002, hidden=0.25), 3, 240)
    np.testing.assert_array_equal(same, angles)
    assert MODEL.within(angles).all()
    assert np.isfinite(exact).all()
    hidden = np.isnan(noisy).any(axis=-1)
    assert not hidden[:, 5:].any()
    assert 0.1 < hidden[:, :5].mean() < 0.4
    assert np.nanstd(noisy - exact) == pytest.approx(0.002, rel=0.1)


@pytest.mark.slow
def test_every_solver_has_a_row_and_keeps_the_limits() -> None:
    clock = itertools.count()
    rows = compare_solvers(["exact", "occlusion"], [0, 1], lambda: float(next(clock)), frames=40)
    assert [(row.scene, row.solver) for row in rows] == [(s, n) for s in ("exact", "occlusion") for n in SOLVER_NAMES]
    assert all(row.within_percent == 100 and row.time_ratio == 1.0 for row in rows)
    assert all((row.iterations is None) == (row.solver == "map") for row in rows)
    closed = rows[1]
    assert closed.reached_percent > 90  # the motion of so few frames is fast, and the palm that of the fit
    assert closed.angle_deg < 0.1


def test_what_there_is_not_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"no scene 'noice'.*did you mean noise"):
        compare_solvers(["noice"], [0], float)
    with pytest.raises(SettingsError, match="seeds"):
        compare_solvers(None, [], float)
    with pytest.raises(SettingsError, match="frames"):
        compare_solvers(None, [0], float, frames=21)


def test_the_table_fits_a_terminal() -> None:
    rows = [
        SolverRow(scene, solver, 1.5, 18.25, 2.0, 100.0, 100.0, 4.5, None if solver == "map" else 109.0, 2.0)
        for scene in SCENES
        for solver in SOLVER_NAMES
    ]
    out = Console(width=80)
    with out.capture() as text:
        show_solvers(rows, out)
    assert "…" not in text.get()
    assert all(name in text.get() for name in (*SCENES, *SOLVER_NAMES))
