"""Which runs a scoring in simulation makes, when its frames arrive, and what meets a target."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation import simulation
from mocapella.evaluation.methods import check_methods, method_with_settings
from mocapella.evaluation.simulation import TARGETS, evaluate, run, summary
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.skeleton import SKELETON

PERFECT: dict[str, float | None] = dict.fromkeys(TARGETS, 0.0) | {"hota": 1.0}


def met(*scenes: list[dict[str, float | None]]) -> dict[str, Any]:
    """Whether each target is met, by scenes of several runs each; each run is perfect but for what is given."""
    runs = {f"scene{k}": [PERFECT | of for of in scene] for k, scene in enumerate(scenes)}
    return {name: worst["met"] for name, worst in summary(runs)["worst"].items()}


def test_a_perfect_method_meets_all_targets() -> None:
    assert met([{}, {}], [{}]) == dict.fromkeys(TARGETS, True)


@pytest.mark.parametrize("name", [name for name, (kind, _) in TARGETS.items() if kind != "sum"])
def test_a_target_is_met_up_to_its_limit_by_the_mean_of_the_worst_scene(name: str) -> None:
    kind, limit = TARGETS[name]
    beyond = np.nextafter(limit, 0.0 if kind == "least" else np.inf)
    best = 1.0 if kind == "least" else 0.0
    assert met([{name: limit}], [{}])[name]
    assert not met([{name: beyond}], [{}])[name]
    assert met([{name: 2 * limit - best}, {name: best}], [{}])[name]


@pytest.mark.parametrize("name", [name for name, (kind, _) in TARGETS.items() if kind == "sum"])
def test_not_one_of_what_is_summed_may_be(name: str) -> None:
    assert not met([{}, {name: 1.0}], [{}])[name]


@pytest.mark.parametrize("name", TARGETS)
def test_a_missing_figure_fails_and_clocks_may_be_silent_if_they_always_are(name: str) -> None:
    assert met([{name: None}, {}], [{}])[name] is False
    assert met([{name: None}], [{}])[name] is False
    assert met([{name: None}, {name: None}], [{name: None}])[name] is (None if name == "time_offset_ms" else False)


def test_each_method_is_run_on_each_scene_and_seed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    said: list[str] = []

    def tracker(method: str, **options: Any) -> Any:
        made.append((method, options))
        return SimpleNamespace(number=len(made))

    def scored(tracker: Any, room: Any) -> dict[str, float | None]:
        return PERFECT | {"sensors": float(tracker.number), "calibration_mm": float(room.seed)}

    monkeypatch.setattr(simulation, "make_tracker", tracker)
    monkeypatch.setattr(
        simulation,
        "scene_room",
        lambda name, seed: SimpleNamespace(sensor_names=["a", "b", "c"][: 2 + seed], seed=seed),
    )
    monkeypatch.setattr(simulation, "run", scored)
    methods = ["default", "default:keep_root_s=2"]
    found = evaluate(methods, ["walk-45", "crossing"], [0, 1], said.append)
    assert (found["seeds"], list(found["scenes"]), list(found["methods"])) == ([0, 1], ["walk-45", "crossing"], methods)
    assert found["targets"]["hota"] == {"over_scenes": "least", "limit": 0.95}
    assert said[0] == "default, walk-45, seed 0 (1 of 8)"
    assert said[-1] == "default:keep_root_s=2, crossing, seed 1 (8 of 8)"
    tried, runs = made[:2], made[2:]  # that they can be made is tried first
    assert [options["settings"] for _, options in tried] == [{}, {"keep_root_s": 2}]
    assert [options["sensors_expected"] for _, options in runs] == [2, 3] * 4
    assert (
        len({run["sensors"] for of in found["methods"].values() for s in of["scenes"].values() for run in s["runs"]})
        == 8
    )
    assert found["methods"]["default"]["scenes"]["crossing"]["mean"]["calibration_mm"] == 0.5


def test_frames_arrive_after_their_sensors_latency() -> None:
    arrivals: list[Arrival] = []

    class Hears:
        def update(self, arrival: Arrival) -> Any:
            arrivals.append(arrival)
            return SimpleNamespace(people=(), sensors=())

    late_s = {"a": 0.06, "b": 0.13}
    sensors = [
        SimpleNamespace(name=name, latency_s=late, T_world_sensor=np.eye(4), range_m=(0.5, 9.0))
        for name, late in late_s.items()
    ]
    true = np.zeros((1, len(SKELETON), 3))
    room: Any = SimpleNamespace(
        sensor_names=("a", "b"),
        settings=SimpleNamespace(sensors=sensors),
        duration_ns=10**9,
        positions_at=lambda _: true,
    )
    items: Any = [
        SimpleNamespace(
            frame=body_frame(name, SKELETON, time_ns=k, positions=[]),
            truth=SimpleNamespace(
                room_ns=k * 10**8, body_people=np.zeros(0, np.int64), people=np.arange(1), positions=true,
                T_world_sensor=np.eye(4),
            ),
        )
        for k in range(3) for name in "ba"
    ]  # fmt: skip
    run(Hears(), room, items)
    assert [one.at_ns for one in arrivals] == [
        item.truth.room_ns + round(1e9 * late_s[item.frame.sensor]) for item in items
    ]


def test_methods_that_are_unknown_or_none_are_refused() -> None:
    assert method_with_settings("default:keep_root_s=2") == ("default", {"keep_root_s": 2})
    with pytest.raises(SettingsError, match="unknown tracking method 'defaut'"):
        method_with_settings("defaut")
    check_methods(["stand-still", "default"])
    check_methods([], some=True)
    with pytest.raises(SettingsError, match="no method to score"):
        check_methods([])
