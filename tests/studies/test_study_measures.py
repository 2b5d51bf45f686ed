"""Losses, hidden joints and identities are found as planted; a broken measure is named, and the rest goes on."""

from __future__ import annotations

import importlib
import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.distributions import distribution
from support.evaluation_sessions import body

from mocapella.evaluation.identity import IdentityFrame
from mocapella.registry import Table
from mocapella.studies import method_results
from mocapella.studies.measures.filling import FILLED
from mocapella.studies.measures.identities import IDENTITY
from mocapella.studies.measures.losses import LOSS_S, LOST, losses
from mocapella.studies.measures.measure import MEASURES, Measure
from mocapella.studies.method_results import measure_task
from mocapella.studies.pose_strips import pose_strip
from mocapella.studies.task_views import PAUSE_S, HiddenViews, TaskViews

DOC = Path(__file__).resolve().parents[2] / "docs" / "studies-methods.md"


def task_views(frames: int = 60, people: int = 1, **changes: Any) -> TaskViews:
    """People who walk along x, 2 m apart, seen alike by two sensors at 10 Hz; the fused person is the mean."""
    at_s = np.arange(frames) / 10
    place = np.stack([0.1 * at_s, np.zeros(frames), np.full(frames, 2.4)], axis=-1)
    one = body() + place[:, None]
    views = np.stack([np.stack([one + np.array([2.0 * p, 0, 0])] * 2, axis=1) for p in range(people)], axis=1)
    task = TaskViews(
        method="default",
        placement="90",
        task="exchange" if people > 1 else "obstacle",
        participant="7",
        sensors=("front", "side"),
        people=tuple(range(people)),
        at_s=at_s,
        views=views,
        fused=views.mean(axis=2),
        fused_ids=np.tile(np.arange(people), (frames, 1)),
    )
    return msgspec.structs.replace(task, **changes)


def figures(measure: Measure, task: TaskViews) -> dict[tuple[str, str], float]:
    found, fault = measure_task(measure, task)
    assert fault == ""
    return {(one.quantity, one.subject): one.value for one in found}


@given(st.lists(st.tuples(st.booleans(), st.sampled_from([0.03, 0.1, 0.25, 1.0, 20.0])), min_size=1, max_size=40))
def test_losses_are_apart_and_cover_the_time_without_the_person(frames: list[tuple[bool, float]]) -> None:
    there = np.array([here for here, _ in frames])
    at_s = np.cumsum([step for _, step in frames])
    found = losses(at_s, there)
    assert all(loss.length_s >= LOSS_S for loss in found)
    assert all(a.back <= b.first for a, b in itertools.pairwise(found))
    for loss in found:
        assert loss.length_s == pytest.approx(at_s[loss.back] - at_s[loss.first])
        assert not there[loss.first + 1 : loss.back].any()
    steps = np.diff(at_s)
    gone = (~there[:-1] | (steps >= LOSS_S)) & (steps <= PAUSE_S)
    inside = np.zeros(len(steps), dtype=bool)
    for loss in found:
        inside[loss.first : loss.back] = True
    assert not (inside & ~gone).any()
    assert (steps[gone & ~inside] < LOSS_S).all()


def test_a_person_who_is_always_there_is_never_lost_and_one_who_never_is_is_lost_once() -> None:
    at_s = np.arange(30) / 10
    assert losses(at_s, np.ones(30, dtype=bool)) == ()
    (loss,) = losses(at_s, np.zeros(30, dtype=bool))
    assert (loss.first, loss.back, loss.length_s) == (0, 29, pytest.approx(2.9))


def test_a_planted_loss_is_counted_for_its_sensor_and_not_for_the_fused_person() -> None:
    task = task_views()
    views = task.views.copy()
    views[10:20, 0, 1] = np.nan
    views[30:35, 0, 1] = np.nan
    found = figures(LOST, msgspec.structs.replace(task, views=views))
    assert found["losses", "side"] == 2
    assert found["longest loss", "side"] == pytest.approx(1.0)
    assert found["time lost", "side"] == pytest.approx(100 * 1.5 / 5.9)
    assert [found["losses", who] for who in ("front", "fused")] == [0, 0]


def test_a_gap_in_the_log_is_lost_by_all_and_a_pause_by_nobody() -> None:
    gap, pause = (np.where(np.arange(60) < 30, 0, step) + np.arange(60) / 10 for step in (2.0, PAUSE_S + 1))
    assert {v for (q, _), v in figures(LOST, task_views(at_s=gap)).items() if q == "losses"} == {1.0}
    assert {v for (q, _), v in figures(LOST, task_views(at_s=pause)).items() if q == "losses"} == {0.0}


@given(st.floats(0.0, 0.3), st.sampled_from([0, 1]))
def test_the_error_of_hidden_joints_is_the_distance_to_what_the_hidden_sensor_measured(off: float, s: int) -> None:
    task = task_views()
    hidden = np.zeros((60, 1, 2, 25), dtype=bool)
    hidden[20:30, 0, s, 3:8] = True
    fused = task.fused.copy()
    fused[:, :, :, 1] += off
    again = HiddenViews(hidden, task.views, fused)
    found = figures(FILLED, msgspec.structs.replace(task, hidden=again))
    sensor = task.sensors[s]
    assert found["hidden joints", sensor] == pytest.approx(100 * off, abs=1e-9)
    assert found["hidden joints not filled", sensor] == 0
    assert found["same joints, not hidden", sensor] == pytest.approx(0, abs=1e-9)
    assert ("hidden joints", task.sensors[1 - s]) not in found


def test_joints_that_are_not_filled_and_joints_that_no_sensor_sees_are_counted_apart() -> None:
    task = task_views()
    hidden = np.zeros((60, 1, 2, 25), dtype=bool)
    hidden[20:30, 0, 0, 3:7] = True
    views, fused = task.views.copy(), task.fused.copy()
    views[20:30, 0, 1, 3] = np.nan  # the other sensor does not see it either: not compared
    fused[20:30, 0, 4] = np.nan
    (samples,) = {
        one.samples
        for one in measure_task(FILLED, msgspec.structs.replace(task, hidden=HiddenViews(hidden, views, fused)))[0]
        if one.quantity.startswith("hidden")
    }
    found = figures(FILLED, msgspec.structs.replace(task, hidden=HiddenViews(hidden, views, fused)))
    assert samples == 30
    assert found["hidden joints not filled", "front"] == pytest.approx(100 / 3)


def test_the_end_of_a_real_loss_is_compared_with_the_first_view_after_it() -> None:
    task = task_views()
    views, fused = task.views.copy(), task.fused.copy()
    views[10:20, 0, 1] = np.nan
    fused[19, 0] = task.views[20, 0, 0] + [0.0, 0.0, 0.04]
    found = figures(FILLED, msgspec.structs.replace(task, views=views, fused=fused))
    assert found == {("joints at the end of a loss", "side"): pytest.approx(4.0)}


def test_people_who_exchange_ids_or_views_are_found() -> None:
    task = task_views(people=2)
    assert set(figures(IDENTITY, task).values()) == {0.0}
    ids = task.fused_ids.copy()
    ids[30:] = ids[30:, ::-1]
    assert figures(IDENTITY, msgspec.structs.replace(task, fused_ids=ids))["switches against the log", "all"] == 2
    views = task.views.copy()
    views[15:30, :, 1] = views[15:30, ::-1, 1]
    found = figures(IDENTITY, msgspec.structs.replace(task, views=views))
    assert found["crossed views", "side"] == pytest.approx(100 * 15 / 60)
    views[:20, 1, 0] = np.nan  # of a person whom a sensor does not see, no views are crossed
    found = figures(IDENTITY, msgspec.structs.replace(task, views=views))
    assert found["crossed views", "side"] == pytest.approx(100 * 10 / 40)
    assert figures(IDENTITY, task_views(people=1)) == {}


def test_labels_are_used_where_there_are_some() -> None:
    alike = np.eye(2)
    labelled = tuple(IdentityFrame((0, 1), ids, alike) for ids in ((4, 5), (5, 4), (4, 5)))
    found = figures(IDENTITY, task_views(people=2, labelled=labelled))
    assert found["switches against labels", "all"] == 4
    assert found["labelled people missed", "all"] == 0
    missed = (*labelled, IdentityFrame((0, 1), (4,), np.array([[1.0], [0.0]])))
    assert figures(IDENTITY, task_views(people=2, labelled=missed))["labelled people missed", "all"] == 1


def test_a_strip_shows_instants_at_equal_distances_and_where_the_person_is_lost() -> None:
    task = task_views()
    views = task.views.copy()
    views[41:44, 0, 1] = np.nan
    strip = pose_strip(msgspec.structs.replace(task, views=views), 0, instants=4)
    np.testing.assert_allclose(strip.at_s, [0.0, 2.0, 4.0, 4.2, 5.9])
    assert strip.positions.shape == (5, 3, 25, 3)
    assert strip.names == ("front", "side", "fused")
    assert not strip.measured[3, 1].any()
    assert strip.measured[3, 2].all()
    views[41:44, 0, 0] = np.nan
    assert not pose_strip(msgspec.structs.replace(task, views=views), 0, instants=4).measured[3, 2].any()


def broken(task: TaskViews) -> Iterator[Any]:
    yield task.figure("broken", "thing", "cm", "all", 1.0)
    raise ZeroDivisionError("of a\nstranger")


@pytest.mark.parametrize(
    ("find", "words"),
    [
        (broken, "ZeroDivisionError: of a$"),
        (lambda task: [1.0], "returned a float, not a MeasuredFigure"),
        (lambda task: [task.figure("broken", "thing", "m", "all", 1.0)], r"broken, thing \[m\] is not one of its"),
        (lambda task: [task.figure("other", "thing", "cm", "all", 1.0)], r"other, thing \[cm\] is not one of its"),
        (lambda task: [task.figure("broken", "else", "cm", "all", 1.0)], r"broken, else \[cm\] is not one of its"),
    ],
)
def test_a_broken_measure_is_named_and_gives_nothing(find: Any, words: str) -> None:
    figures, fault = measure_task(Measure(1, "broken", "", {"thing": "cm"}, find), task_views())
    assert figures == ()
    assert re.search(f"^measure broken, obstacle: .*{words}", fault)


def test_the_documented_example_is_found_in_somebody_elses_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = DOC.read_text(encoding="utf-8")
    (module,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    (group, name, reference) = re.findall(r'\[project\.entry-points\."(.+)"\]\n(\w+) = "(.+)"', text)[0]
    points = {group: {name: reference, "absent": "no_such_module_of_speeds:SPEED"}}
    distribution(tmp_path, "speeds", points, {f"{reference.partition(':')[0]}.py": module})
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    table = Table("mocapella.measures", Measure, "measure")
    assert list(table) == [*MEASURES, "speed"]
    assert table.plugins() == {"speed": "speeds 1.0"}
    assert ["absent" in str(one) for one in table.skipped] == [True]
    monkeypatch.setattr(method_results, "MEASURES", table)
    found = figures(table.find("speed"), task_views())
    assert found == {("mean speed", "fused"): pytest.approx(10.0)}  # 1 cm in each of 10 frames a second


def test_ours_are_registered() -> None:
    assert list(MEASURES) == ["filled", "identity", "lost"]
    assert all(measure.quantities and measure.summary for measure in MEASURES.values())
