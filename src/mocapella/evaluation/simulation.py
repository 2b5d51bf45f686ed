"""Scores tracking methods against ground truth in simulated rooms (docs/evaluation.md, *In simulation*).

    for item in merge(sensors):  scene = tracker.update(Arrival(item.frame, …));  score.update(item, scene, …)

The tracker receives frames; only the scoring receives the ground truth. Everything is compared at the frames of the
scene's first sensor, the *main* one. Its pose aligns the worlds of method and room, so a method can choose its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any, Final, Protocol

import msgspec
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.methods import method_with_settings
from mocapella.evaluation.protocol import ScoredTracker
from mocapella.evaluation.simulation_score import Figures, Score
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.sources.simulate import Room, SimulatedFrame, SimulatedSensor, build_room, merge, settings_from
from mocapella.sources.simulate.measured import KIND
from mocapella.tracker import make_tracker, methods_making

TARGETS: Final[Mapping[str, tuple[str, float]]] = {
    "identity_switches": ("sum", 0),
    "lost_people": ("sum", 0),
    "fused_of_best_sensor_percent": ("most", 60),
    "hidden_of_sensor_percent": ("most", 35),
    "hota": ("least", 0.95),
    "calibration_mm": ("most", 10),
    "calibration_deg": ("most", 0.3),
    "time_offset_ms": ("most", 5),
    "wrong_left_right_percent": ("most", 1),
}
"""Kind and limit of each figure's target, by figure.

``sum`` is an upper limit of the sum over all runs, ``most`` of the scenes' means; ``least`` is a lower limit of these.
"""


_ARRAYS: Final = ("tracking_ids", "tracked", "clipped_edges", "states", "positions", "depth_px", "orientations")


class Tracked(Protocol):
    """Interface of a scored tracker: the step of `mocapella.tracker.Tracker`."""

    def update(self, arrival: Arrival) -> Scene:
        """Track one frame, and return the scene."""


def scene_summaries() -> dict[str, str]:
    """Return a description of each scene, by the scene's name."""
    return {name: scene["summary"] for name, scene in _data()["scenes"].items()}


def scene_room(name: str, seed: int) -> Room:
    """Build a scene's room, with measured sensor errors.

    Args:
        name: one of the scenes of `scene_summaries`.
        seed: random seed of the room and of the sensors' errors.

    Raises:
        SettingsError: no such scene; lists those there are.
    """
    settings = settings_from(_data(), name)
    sensors = tuple(dataclasses.replace(sensor, errors=KIND) for sensor in settings.sensors)
    return build_room(dataclasses.replace(settings, sensors=sensors, seed=seed))


@cache
def _data() -> dict[str, Any]:
    return own_toml("mocapella.evaluation", "simulation.toml")


def evaluate(
    methods: Sequence[str],
    scenes: Sequence[str] | None = None,
    seeds: Sequence[int] = (0, 1, 2),
    on_run: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Score methods on scenes.

    Args:
        methods: names, optionally with settings, see `method_with_settings`.
        scenes: names of the scenes; None for all.
        seeds: random seeds of the scenes' noise.
        on_run: called with the next step, in words.

    Returns:
        The JSON of docs/evaluation.md.

    Raises:
        SettingsError: no method, scene or seed, or an unknown or invalid one.
    """
    names = list(scene_summaries()) if scenes is None else list(scenes)
    for name in names:
        if name not in scene_summaries():
            raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, scene_summaries())}")
    for what, chosen, known in (("method", methods, methods_making("people")), ("scene", names, scene_summaries())):
        if not chosen:
            raise SettingsError(f"no {what} to score; known: {', '.join(known)}")
    chosen_methods = {text: method_with_settings(text) for text in methods}
    for method, settings in chosen_methods.values():  # reject unusable methods and settings before any room is built
        make_tracker(method, settings=settings)
    if not seeds or min(seeds) < 0:
        raise SettingsError(f"seeds {list(seeds)} cannot be used; give one or more of 0, 1, 2, …")
    result: dict[str, Any] = {"seeds": list(seeds), "scenes": {name: scene_summaries()[name] for name in names}}
    result["targets"] = {name: {"over_scenes": kind, "limit": limit} for name, (kind, limit) in TARGETS.items()}
    result["methods"] = {}
    total, done = len(chosen_methods) * len(names) * len(seeds), 0
    for text, (method, settings) in chosen_methods.items():
        runs: dict[str, list[Figures]] = {}
        for name in names:
            for seed in seeds:
                done += 1
                on_run(f"{text}, {name}, seed {seed} ({done} of {total})")
                room = scene_room(name, seed)
                tracker = make_tracker(method, sensors_expected=len(room.sensor_names), settings=settings)
                runs.setdefault(name, []).append(run(tracker, room))
        result["methods"][text] = summary(runs)
    return result


def summary(runs: Mapping[str, Sequence[Figures]]) -> dict[str, Any]:
    """Return the runs and their mean by scene (``scenes``), and each of `TARGETS` over all scenes (``worst``).

    ``runs`` has the figures of each run, by scene.
    """
    scenes = {name: {"mean": _mean(of), "runs": list(of)} for name, of in runs.items()}
    worst = {
        figure: _worst(figure, {name: [run[figure] for run in of] for name, of in runs.items()}) for figure in TARGETS
    }
    return {"scenes": scenes, "worst": worst}


def _worst(figure: str, values: Mapping[str, Sequence[float | None]]) -> dict[str, Any]:
    """Judge the targets over scenes; a figure missing in a scene fails, unless it is optional and missing in all."""
    kind, limit = TARGETS[figure]
    known = {name: [v for v in of if v is not None] for name, of in values.items()}
    missing = [name for name, of in values.items() if len(known[name]) < len(of)]
    if missing:
        may_be_silent = figure == "time_offset_ms" and not any(known.values())
        return {"value": None, "scene": missing[0], "met": None if may_be_silent else False}
    means = {name: float(np.mean(of)) for name, of in known.items()}
    scene = (min if kind == "least" else max)(means, key=lambda name: means[name])
    value = float(sum(map(sum, known.values()))) if kind == "sum" else means[scene]
    return {"value": value, "scene": scene, "met": value >= limit if kind == "least" else value <= limit}


def _mean(runs: Sequence[Figures]) -> Figures:
    """Average a scene's runs; a figure that is None in one run is None."""
    out: Figures = {}
    for name in runs[0]:
        values = [run[name] for run in runs]
        out[name] = None if None in values else float(np.mean(np.array(values, dtype=np.float64)))
    return out


def run(tracker: Tracked, room: Room, items: Iterable[SimulatedFrame] | None = None) -> Figures:
    """Score one method in one room, from its first frame on.

    Args:
        tracker: a new tracker.
        room: the simulated room.
        items: the frames of the room's sensors in the order of their arrival; None for all frames until the simulation
            repeats.
    """
    score = Score(room)
    latency_ns = {sensor.name: round(sensor.latency_s * NS_PER_S) for sensor in room.settings.sensors}
    if items is None:
        items = merge([SimulatedSensor(room, name) for name in room.sensor_names], 0.0, room.duration_s)
    for item in items:
        # A copy: a method must not change the frames of the scoring.
        arrays = {name: value.copy() for name in _ARRAYS if (value := getattr(item.frame, name)) is not None}
        frame = msgspec.structs.replace(item.frame, **arrays)
        scene = tracker.update(Arrival(frame, item.truth.room_ns + latency_ns[frame.sensor]))
        score.update(item, scene, _offsets(tracker))
    return score.figures()


def _offsets(tracker: Tracked) -> Mapping[str, float]:
    return tracker.sensor_views().time_offset_s if isinstance(tracker, ScoredTracker) else {}
