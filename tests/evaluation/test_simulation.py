"""Scoring against exact truth: who knows the truth is perfect, who errs is found out, and truth does not leak."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation import simulation
from mocapella.evaluation.simulation import TARGETS, evaluate, run, scene_room, scene_summaries, summary
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Person, Phase, Scene, SensorPlace, TrackerState
from mocapella.sources.simulate import Room, SimulatedFrame, SimulatedSensor, build_room, merge
from mocapella.tracker import make_tracker
from mocapella.tracker.protocol import SensorViews

SECONDS = {"crossing": 10.0, "walk-45": 21.0}
"""In the second, both sensors see eight seconds of walking."""
MIRROR = list(scene_room("walk-45", 0).topology.mirror)


@cache
def room(name: str = "crossing") -> Room:
    """Without losses, so that everybody is seen; and few frames, for the tests' time."""
    settings = scene_room(name, 0).settings
    sensors = tuple(dataclasses.replace(s, rate_hz=10.0, lost=0.0, errors="model") for s in settings.sensors)
    return build_room(dataclasses.replace(settings, sensors=sensors))


@cache
def frames(name: str = "crossing") -> tuple[SimulatedFrame, ...]:
    return tuple(merge([SimulatedSensor(room(name), n) for n in room(name).sensor_names], 0.0, SECONDS[name]))


class Oracle:
    """A method that is told the truth, and may be made to err.

    Args:
        wrong: from the true scene to the one that it says.
        T_method_world: where it has its world.
    """

    joint_bias = None

    def __init__(
        self,
        wrong: Callable[[Scene, float], Scene] = lambda scene, at_s: scene,
        T_method_world: Any = None,
        offset_error_s: float = 0.0,
        name: str = "crossing",
    ) -> None:
        self.truths = {(f.frame.sensor, f.frame.sequence): f.truth for f in frames(name)}
        self.room, self.wrong, self.offset_error_s = room(name), wrong, offset_error_s
        self.T = np.eye(4) if T_method_world is None else T_method_world

    def start_from(self, T_world_sensor: Mapping[str, Any]) -> None:
        pass

    def sensor_views(self) -> SensorViews:
        late = {s.name: -s.latency_s + self.offset_error_s * (i > 0) for i, s in enumerate(self.room.settings.sensors)}
        return SensorViews({}, late)

    def update(self, arrival: Arrival) -> Scene:
        frame = arrival.frame
        truth = self.truths[frame.sensor, frame.sequence]
        R, t = self.T[:3, :3], self.T[:3, 3]
        tracked = np.full(truth.positions.shape[1], JointState.TRACKED, dtype=np.uint8)
        people = tuple(
            Person(int(p), truth.positions[p] @ R.T + t, tracked, ()) for p in truth.people if self.seen(truth, p)
        )
        places = tuple(SensorPlace(s.name, self.T @ s.T_world_sensor) for s in self.room.settings.sensors)
        state = TrackerState(Phase.TRACKING)
        scene = Scene(
            0, arrival.at_ns, frame.sensor, 0, frame.sequence, frame.topology, state, {"people": people}, places
        )
        return self.wrong(scene, truth.room_ns / 1e9)

    def seen(self, truth: Any, person: int) -> bool:
        return True


def scored(name: str = "crossing", **options: Any) -> dict[str, float | None]:
    return run(Oracle(name=name, **options), room(name), frames(name))


def people(change: Callable[[Person], Person | None]) -> Callable[[Scene, float], Scene]:
    def wrong(scene: Scene, at_s: float) -> Scene:
        changed = tuple(c for p in scene.people if (c := change(p)) is not None)
        return scene.with_parts(people=changed)

    return wrong


@pytest.mark.slow
def test_who_knows_the_truth_is_perfect_wherever_the_world_is_put() -> None:
    T = rigid(rotation_about_y(1.0) @ rotation_about_x(0.3), (3.0, -1.0, 2.0))
    for figures in (scored(), scored("walk-45", T_method_world=T)):
        assert figures["hota"] == figures["idf1"] == 1
        assert figures["identity_switches"] == figures["lost_people"] == figures["wrong_left_right_percent"] == 0
        exact = ("fused_cm", "measured_cm", "fused_of_best_sensor_percent", "hidden_of_sensor_percent")
        layout = ("calibration_end_mm", "calibration_end_deg", "time_offset_ms")
        assert [figures[name] for name in (*exact, *layout)] == pytest.approx([0] * 7, abs=1e-3)
        assert figures["inferred_cm"] is None  # it infers nothing
    assert [figures["calibration_mm"], figures["calibration_deg"]] == pytest.approx([0, 0], abs=1e-3)


def test_two_people_swapped_once_are_two_switches_and_less_hota() -> None:
    def swap(scene: Scene, at_s: float) -> Scene:
        ids = {0: 1, 1: 0} if at_s > 7 else {0: 0, 1: 1}
        swapped = tuple(msgspec.structs.replace(p, id=ids[p.id]) for p in scene.people)
        return scene.with_parts(people=swapped)

    figures = scored(wrong=swap)
    assert figures["identity_switches"] == 2
    assert figures["lost_people"] == 0
    assert figures["hota"] is not None
    assert figures["hota"] < 0.9
    assert figures["fused_cm"] == pytest.approx(0, abs=1e-6)  # who it is does not make the skeleton worse


def test_somebody_left_out_for_longer_than_a_second_is_lost_and_for_less_is_not() -> None:
    def without(until_s: float) -> Callable[[Scene, float], Scene]:
        def wrong(scene: Scene, at_s: float) -> Scene:
            return people(lambda p: None if p.id == 1 and 6 < at_s < until_s else p)(scene, at_s)

        return wrong

    assert scored(wrong=without(6.8))["lost_people"] == 0
    long = scored(wrong=without(8.0))
    assert long["lost_people"] == 1
    assert long["hota"] is not None
    assert long["hota"] < 1


def test_a_phantom_costs_hota() -> None:
    def two(scene: Scene, at_s: float) -> Scene:
        phantom = msgspec.structs.replace(
            scene.people[0], id=99, positions=scene.people[0].positions + np.array([5.0, 0, 0])
        )
        return scene.with_parts(people=(*scene.people, phantom))

    figures = scored(wrong=two)
    assert figures["hota"] is not None
    assert figures["hota"] < 0.9


def test_swapped_labels_are_wrong_and_count_against_the_joints() -> None:
    figures = scored(wrong=people(lambda p: msgspec.structs.replace(p, positions=p.positions[MIRROR])))
    assert figures["wrong_left_right_percent"] == 100
    assert figures["fused_cm"] is not None
    assert figures["fused_cm"] > 5


def test_an_error_of_every_joint_is_the_error_and_inferred_joints_are_told_apart() -> None:
    def aside(p: Person) -> Person:
        states = p.states.copy()
        states[:5] = JointState.INFERRED
        off = np.where((states == JointState.INFERRED)[:, None], [0.0, 0.1, 0.0], [0.02, 0.0, 0.0])
        return msgspec.structs.replace(p, positions=p.positions + off, states=states)

    figures = scored(wrong=people(aside))
    assert figures["measured_cm"] == pytest.approx(2)
    assert figures["inferred_cm"] == pytest.approx(10)
    assert figures["fused_cm"] == pytest.approx((5 * 10 + 20 * 2) / 25)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_who_repeats_the_only_sensor_has_its_errors_and_who_doubles_them_twice_these(factor: float) -> None:
    settings = room().settings
    alone = build_room(dataclasses.replace(settings, sensors=settings.sensors[:1]))
    items = list(merge([SimulatedSensor(alone, alone.sensor_names[0])], 6.0, 9.0))  # some joints are hidden

    class Echo(Oracle):
        def __init__(self) -> None:
            super().__init__()
            self.room, self.items = alone, {item.frame.sequence: item for item in items}

        def update(self, arrival: Arrival) -> Scene:
            item = self.items[arrival.frame.sequence]
            self.truths[arrival.frame.sensor, arrival.frame.sequence] = item.truth
            scene = super().update(arrival)
            seen = apply(item.truth.T_world_sensor, item.frame.positions.astype(np.float64))
            true = item.truth.positions[item.truth.body_people]
            said = dict(zip(item.truth.body_people.tolist(), true + factor * (seen - true), strict=True))
            echoed = [msgspec.structs.replace(p, positions=said[p.id]) for p in scene.people if p.id in said]
            return scene.with_parts(people=tuple(echoed))

    figures = run(Echo(), alone, items)
    assert figures["best_sensor_cm"] is not None
    assert figures["best_sensor_cm"] > 0.1
    assert figures["fused_of_best_sensor_percent"] == pytest.approx(100 * factor)
    assert figures["hidden_of_sensor_percent"] == pytest.approx(100 * factor)


@pytest.mark.slow
def test_a_wrong_layout_and_a_wrong_clock_are_measured() -> None:
    def moved(scene: Scene, at_s: float) -> Scene:
        T = rigid(np.eye(3), (0.03, 0.0, 0.04))
        places = [
            p if i == 0 else msgspec.structs.replace(p, T_world_sensor=T @ p.T_world_sensor)
            for i, p in enumerate(scene.sensors)
        ]
        return msgspec.structs.replace(scene, sensors=tuple(places))

    figures = scored("walk-45", wrong=moved, offset_error_s=0.012)
    assert figures["calibration_mm"] == pytest.approx(50)
    assert figures["calibration_deg"] == pytest.approx(0, abs=1e-6)
    assert figures["time_offset_ms"] == pytest.approx(12)

    def turned(scene: Scene, at_s: float) -> Scene:
        last = scene.sensors[-1]
        T = last.T_world_sensor @ rigid(rotation_about_y(np.radians(2)), np.zeros(3))
        return msgspec.structs.replace(
            scene, sensors=(*scene.sensors[:-1], msgspec.structs.replace(last, T_world_sensor=T))
        )

    assert scored(wrong=turned)["calibration_end_deg"] == pytest.approx(2)


def test_a_sensor_without_a_place_has_no_calibration_and_the_target_is_not_met() -> None:
    def untied(scene: Scene, at_s: float) -> Scene:
        return msgspec.structs.replace(scene, sensors=scene.sensors[:1])

    figures = scored(wrong=untied)
    assert figures["calibration_mm"] is None
    assert figures["calibration_end_mm"] is None
    worst = summary({"crossing": [figures]})["worst"]
    assert worst["calibration_mm"] == {"value": None, "scene": "crossing", "met": False}
    assert worst["identity_switches"]["met"]


def test_a_method_with_a_motion_for_each_person_is_compared_by_its_views() -> None:
    tracker = make_tracker("stand-still", sensors_expected=3, settings={"frames": 30})
    figures = run(tracker, room(), frames())
    assert figures["fused_cm"] is not None
    assert figures["fused_cm"] < 10
    assert figures["time_offset_ms"] is None


def test_the_truth_cannot_reach_a_method_nor_a_method_the_truth() -> None:
    class Vandal(Oracle):
        """It is given nothing but arrivals, and spoils all that it is given."""

        def update(self, arrival: Arrival) -> Scene:
            assert set(arrival.__struct_fields__) == {"frame", "at_ns"}
            frame = arrival.frame
            truth = self.truths[frame.sensor, frame.sequence]
            held = [getattr(frame, name) for name in frame.__struct_fields__]
            assert not any(isinstance(v, np.ndarray) and np.shares_memory(v, truth.positions) for v in held)
            scene = super().update(arrival)
            for values in held:
                if isinstance(values, np.ndarray):
                    values[:] = 0
            return scene

    spoilt, whole = run(Vandal(), room(), frames()[:90]), run(Oracle(), room(), frames()[:90])
    assert spoilt == whole
    assert whole["best_sensor_cm"] is not None


def test_the_scenes_are_what_they_promise() -> None:
    rooms = {name: scene_room(name, 1) for name in scene_summaries()}
    assert len(rooms) == 10
    for name, made in rooms.items():
        assert 20 <= made.duration_s <= 62, name
        assert all(sensor.errors == "kinect-v2-measured" for sensor in made.settings.sensors)
        roots = np.stack([made.positions_at(int(t * 1e9))[:, 0, [0, 2]] for t in np.arange(0, made.duration_s, 0.2)])
        apart = np.linalg.norm(roots[:, :, None] - roots[:, None], axis=-1) + 9 * np.eye(roots.shape[1])
        assert apart.min() > 0.45, name  # nobody walks through anybody
    people_in = {name: len(made.settings.people) for name, made in rooms.items()}
    assert people_in["six"] == 6
    assert max(sensor.tilt_deg for sensor in rooms["tilted"].settings.sensors) > 5
    latencies = [sensor.latency_s for sensor in rooms["clocks"].settings.sensors]
    assert max(latencies) - min(latencies) > 0.1


def test_who_leaves_the_room_is_out_of_all_views_and_who_enters_was() -> None:
    made = scene_room("leaving", 0)
    times = np.arange(0, made.duration_s, 0.5)
    seen = np.zeros((len(times), 2), dtype=bool)
    for sensor in made.settings.sensors:
        for i, t in enumerate(times):
            camera = (made.positions_at(int(t * 1e9)) - sensor.T_world_sensor[:3, 3]) @ sensor.T_world_sensor[:3, :3]
            seen[i] |= sensor.in_view(camera, sensor.project(camera)).mean(axis=1) > 0.4
    for person in range(2):
        away = np.flatnonzero(~seen[:, person])
        assert seen[0, person]
        assert seen[-1, person]
        assert len(away) > 8


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": ["defaut"]}, "default"),
        ({"methods": ["default"], "scenes": ["crosing"]}, "crossing"),
        ({"methods": []}, "no method"),
        ({"methods": ["default"], "seeds": []}, "seeds"),
        ({"methods": ["default"], "seeds": [-1]}, "seeds"),
    ],
)
def test_what_cannot_be_scored_is_refused_before_anything_is_done(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        evaluate(on_run=lambda text: pytest.fail("it began"), **options)


def test_means_and_the_worst_scene() -> None:
    base = dict.fromkeys(TARGETS, 0.0) | {"sensors": 2.0, "hota": 1.0}
    runs = {
        "a": [base | {"identity_switches": 1.0}, base | {"calibration_mm": 4.0}],
        "b": [base | {"calibration_mm": 30.0, "hota": 0.9}, base | {"time_offset_ms": None}],
    }
    out = summary(runs)
    assert out["scenes"]["a"]["mean"]["calibration_mm"] == 2
    assert out["scenes"]["b"]["mean"]["time_offset_ms"] is None
    assert out["worst"]["identity_switches"] == {"value": 1.0, "scene": "a", "met": False}
    assert out["worst"]["calibration_mm"] == {"value": 15.0, "scene": "b", "met": False}
    assert out["worst"]["hota"] == {"value": 0.95, "scene": "b", "met": True}


def test_targets_are_figures_of_a_run() -> None:
    assert set(TARGETS) <= set(scored())
    assert simulation.scene_summaries().keys() == simulation._data()["scenes"].keys()
