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

from mocapella.cli.evaluate_founding import show_beside, show_causes
from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, TakeExistsError
from mocapella.evaluation.apart_causes import ApartCauses
from mocapella.model.session import PLACEMENTS, SCENARIOS
from mocapella.recording.study_log import read_study_log
from mocapella.sources.simulate.body import ROOT, facing
from mocapella.sources.simulate.measured import KIND
from mocapella.studies.founding import (
    SECOND,
    START_M,
    STATURES_M,
    STEPS_M,
    WALK_M,
    Stop,
    founding_room,
    write_founding_logs,
)

BLOCK_M = (1.925, 1.87)


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


def relative(scenario: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """The pelvis in a task, to the right of the start and towards the front sensor [m], and the yaw [rad]."""
    room, tasks = founding_room("parallel", 0)
    task = next(task for task in tasks if task.scenario == scenario)
    times = np.arange(task.begins_s, task.ends_s, 0.1)
    at = np.array([room.positions_at(round(t * NS_PER_S))[0] for t in times])
    yaw = np.unwrap(np.arctan2(facing(at)[:, 0], facing(at)[:, 2]))
    return (at[:, ROOT][:, [0, 2]] - START_M) * (1, -1), yaw


@pytest.mark.parametrize(("scenario", "stops"), [("steps", STEPS_M), ("walk", WALK_M)])
def test_a_participant_passes_the_stops_in_their_order(scenario: str, stops: tuple[Stop, ...]) -> None:
    at, _ = relative(scenario)
    passed = 0
    for x, y, stop_s in stops:
        near = np.linalg.norm(at - (x, y), axis=1) < 0.1
        after = np.flatnonzero(near[passed:])
        assert len(after), (x, y)
        passed += int(after[0])
        assert near[passed:].sum() >= 10 * stop_s - 2


def test_the_walk_goes_around_the_block() -> None:
    at, yaw = relative("walk")
    assert np.ptp(yaw) > np.radians(300)
    assert (np.ptp(at, axis=0) < BLOCK_M).all()  # people cut the corners
    assert (np.ptp(at, axis=0) > 0.75 * np.array(BLOCK_M)).all()


@pytest.mark.parametrize("placement", sorted(SECOND))
def test_the_second_sensor_is_on_the_right_and_as_far_from_the_start(placement: str) -> None:
    side = founding_room(placement, 0)[0].settings.sensors[1]
    away = np.array([side.position[0], side.position[2]]) - START_M
    if placement != "parallel":
        assert np.linalg.norm(away) == pytest.approx(START_M[1], abs=0.01)
        angle = np.radians(side.yaw_deg)
        assert -away / START_M[1] == pytest.approx([np.sin(angle), np.cos(angle)], abs=0.01)  # it looks at the start
    assert side.position[0] > 0  # the right of a person who faces the front sensor, as in the study


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


def test_the_causes_are_beside_each_other() -> None:
    out = Console(width=120, record=True, file=io.StringIO())
    one, other = ApartCauses(12.34, 20.0, 5.0, 4.0, 3.0, 1.5, 63.0), ApartCauses(30.3, 21.6, 13.9, 9.0, 8.0, 17.5, 63.3)
    show_causes({"simulated": {"walk": {"45": one}}, "recorded": {"walk": {"45": other}}}, out)
    text = out.export_text()
    assert "why the logged views lie apart: simulated / recorded" in text
    row = next(line for line in text.splitlines() if "walk 45" in line)
    assert "12.3 / 30.3" in row
    assert "20.0 / 21.6" in row
    assert "63.0 / 63.3" in row
    assert "– / –" in next(line for line in text.splitlines() if "walk 90" in line)


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
