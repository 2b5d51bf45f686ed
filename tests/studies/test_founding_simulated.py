"""The founding experiment in simulation: logs of the thesis' form, and the pattern of its results."""

from __future__ import annotations

import io
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from support.programs import run_here

from mocapella.cli.evaluate_founding import show_beside
from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, TakeExistsError
from mocapella.model.session import PLACEMENTS, SCENARIOS
from mocapella.recording.study_log import read_study_log
from mocapella.sources.simulate.body import ROOT, facing
from mocapella.sources.simulate.measured import KIND
from mocapella.studies.founding import (
    BLOCK_M,
    CENTRE_M,
    SECOND,
    STATURES_M,
    founding_room,
    write_founding_logs,
)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 1000), st.sampled_from(sorted(SECOND)))
def test_a_room_depends_on_placement_and_participant_alone(seed: int, placement: str) -> None:
    room, tasks = founding_room(placement, seed)
    again, _ = founding_room(placement, seed)
    assert room.settings == again.settings
    assert {sensor.errors for sensor in room.settings.sensors} == {KIND}
    assert STATURES_M[0] <= room.settings.people[0].stature <= STATURES_M[1]
    assert [task.scenario for task in tasks] == ["stationary", "steps", "walk"]
    assert all(task.begins_s < task.ends_s for task in tasks)
    assert all(one.ends_s <= other.begins_s for one, other in pairwise(tasks))


def test_the_walk_goes_around_the_block_and_both_its_diagonals() -> None:
    room, tasks = founding_room("parallel", 0)
    walk = tasks[2]
    times = np.arange(walk.begins_s, walk.ends_s, 0.1)
    at = np.array([room.positions_at(round(t * NS_PER_S))[0] for t in times])
    roots = at[:, ROOT][:, [0, 2]] - CENTRE_M
    assert np.abs(roots).max(axis=0) == pytest.approx(np.array(BLOCK_M) / 2, abs=0.08)
    assert np.linalg.norm(roots, axis=1).min() < 0.1  # where the diagonals cross
    yaw = np.unwrap(np.arctan2(facing(at)[:, 0], facing(at)[:, 2]))
    assert np.ptp(yaw) > np.radians(300)  # a whole turn but for the last corner


def test_in_stationary_and_steps_people_face_the_front_sensor() -> None:
    room, tasks = founding_room("right-90", 1)
    for task in tasks[:2]:
        for t in np.linspace(task.begins_s, task.ends_s, 20):
            assert facing(room.positions_at(round(t * NS_PER_S)))[0, 2] < -0.95


def test_seeds_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    for seeds in ([], [1, 1], list(range(1001))):
        with pytest.raises(SettingsError, match=r"cannot be used; give up to 1000 different ones"):
            write_founding_logs(tmp_path, seeds)
    assert list(tmp_path.iterdir()) == []


def test_means_are_beside_each_other_and_what_is_missing_is_a_dash() -> None:
    def scored(mean: float) -> dict[str, Any]:
        return {"methods": {"stand-still": {"tasks": {"walk": {"45": {"dd_cm": {"mean": mean}}}}}}}

    out = Console(width=80, record=True, file=io.StringIO())
    show_beside(scored(12.34), scored(5.67), out)
    text = out.export_text()
    assert "12.3 / 5.7" in text
    assert "– / –" in text


@pytest.mark.slow
def test_the_logs_have_the_thesis_columns_and_its_pattern_and_are_never_overwritten(tmp_path: Path) -> None:
    words = ("lab", "evaluate", "founding", "--seeds", "7", "--out", "logs", "--json", "-")
    done = run_here(tmp_path, *words)
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    files = sorted((tmp_path / "logs").iterdir())
    assert [path.name for path in files] == [f"Study_7_Kinect_{k}_Time_simulated.csv.gz" for k in range(3)]
    for number, path in enumerate(files):
        log = read_study_log(path)
        assert set(log.study_id.tolist()) == {7}
        assert set(log.kinect_config.tolist()) == {number}
        assert set(log.scenario_id.tolist()) == {SCENARIOS[name] for name in ("stationary", "steps", "walk")}
        assert set(log.kinect_id.tolist()) == {"front", "side"}
        for kinect in ("front", "side"):
            assert len(set(log.init_angle[log.kinect_id == kinect].tolist())) == 1  # one calibration
        assert (log.kinect_id[log.skeleton_id == 0] == "front").mean() > 0.9
    tasks = made["simulated"]["methods"]["stand-still"]["tasks"]
    dd = {task: [tasks[task][name]["dd_cm"]["mean"] for name in ("parallel", "45", "90")] for task in tasks}
    assert dd["walk"] == sorted(dd["walk"])
    for one, other in zip(dd["stationary"], dd["walk"], strict=True):
        assert one < other
    with pytest.raises(TakeExistsError):
        write_founding_logs(tmp_path / "logs", [7])
    assert set(SECOND) <= set(PLACEMENTS)
