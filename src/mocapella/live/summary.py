"""Statistics of a run, as one value that a script can check."""

from __future__ import annotations

import bisect
import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.model.conditions import conditions
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackerState
from mocapella.model.session import PersonCondition
from mocapella.registry import load


class LatencyHistogram:
    """Percentiles of any number of latencies in a few kilobytes: logarithmic bins, 1.2 % wide.

    A percentile is the upper edge of its bin: from 1 µs to 100 s, never too small and at most 1.2 % too large.
    """

    def __init__(self) -> None:
        self._edges: list[float] = np.logspace(-6, 2, 1601).tolist()  # 1 µs to 100 s
        self._counts = np.zeros(len(self._edges) + 1, dtype=np.int64)
        self.most = 0.0

    def add(self, latency: float) -> None:
        """Add a latency [s]; a negative one, from slightly different clocks, counts as the smallest."""
        self._counts[bisect.bisect_left(self._edges, latency)] += 1
        self.most = max(self.most, latency)

    def percentile(self, percent: float) -> float | None:
        """Return the latency [s] that ``percent`` of the values do not exceed; None without values."""
        total = int(self._counts.sum())
        if total == 0:
            return None
        index = int(np.searchsorted(np.cumsum(self._counts), percent / 100 * total))
        return min(self.most, self._edges[min(index, len(self._edges) - 1)])


MOST_CONDITIONS = 100
"""Largest number of different conditions to keep: the most recently reported ones."""


@dataclass
class Condition:
    """A fault, or a task for the user, that the tracker reports in its state, with the time over which it lasted.

    Attributes:
        first_s, last_s: times of the first and the last report since the start of the run [s].
        results: number of scenes that report it.
    """

    first_s: float
    last_s: float
    results: int = 1


@dataclass
class Labels:
    """Counts of one sensor's views of people, and of left and right labels that the tracker swapped in them.

    Attributes:
        views: number of views.
        swapped: number of views with swapped labels.
        repairs: number of times that the tracker began to swap a person's labels.
        swapped_now: ids of people whose newest view is swapped.
    """

    views: int = 0
    swapped: int = 0
    repairs: int = 0
    swapped_now: frozenset[int] = frozenset()


@dataclass
class RunSummary:
    """Running counts of a run, live or replayed, for its status and its ``--json``.

    Attributes:
        frames_in: number of accepted frames.
        untracked: number of these frames without a scene, because tracking was stopped or had not begun.
        rejected: number of messages and frames that were refused.
        scenes_out: number of scenes.
        counts: present number of parts, such as people, by part type.
        most: largest number of parts in one scene, by part type.
        meters: object that accumulates quality statistics of a part type, by type, where there is one.
        state_changes: changes of the tracker's phase.
        latencies: from a frame's sending to its scene, where the clocks are known.
        began_ns: start of the run on the clock of its scenes [ns]; set to the first scene's time if None.
        conditions: reports of faults and tasks by their text; the newest `MOST_CONDITIONS`. A person's begins with
            ``person ID: ``.
        conditions_left_out: number of older conditions, which are not kept.
        people_conditions: conditions of people in the newest scene.
        places: the sensors' poses in the newest scene.
        labels: counts of swapped labels by sensor.
        times: completion of the newest 1024 scenes, on the monotonic clock [ns].
        errors: number of unexpected errors, by reason.
    """

    frames_in: int = 0
    untracked: int = 0
    rejected: int = 0
    scenes_out: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    most: Counter[str] = field(default_factory=Counter)
    meters: dict[str, Any] = field(default_factory=dict)
    state_changes: list[dict[str, Any]] = field(default_factory=list)
    latencies: LatencyHistogram = field(default_factory=LatencyHistogram)
    began_ns: int | None = None
    conditions: dict[str, Condition] = field(default_factory=dict)
    conditions_left_out: int = 0
    people_conditions: tuple[PersonCondition, ...] = ()
    places: tuple[SensorPlace, ...] = ()
    labels: dict[str, Labels] = field(default_factory=dict)
    times: deque[int] = field(default_factory=lambda: deque(maxlen=1024))
    errors: dict[str, int] = field(default_factory=dict)

    def scene(self, scene: Scene, latency: float | None, done_ns: int) -> None:
        """Add a scene.

        Args:
            scene: the tracker's result.
            latency: since its frame was sent [s]; None if unknown.
            done_ns: when the scene was complete, on the clock of ``began_ns`` [ns].
        """
        self.scenes_out += 1
        self._count(scene)
        self.times.append(done_ns)
        self.places = scene.sensors
        self._note_labels(scene)
        if self.began_ns is None:
            self.began_ns = done_ns
        self.people_conditions = tuple(PersonCondition(one.id, one.condition) for one in scene.people if one.condition)
        texts = scene.state.reason.split("; ") if scene.state.reason else []
        texts += [one.text for one in self.people_conditions]
        for text in texts:
            self._note_condition(text, (done_ns - self.began_ns) / NS_PER_S)
        if latency is not None:
            self.latencies.add(latency)

    def _count(self, scene: Scene) -> None:
        """Count the parts of each type, and update their quality meters."""
        self.counts = {}
        for name, parts in scene.parts.items():
            kind = PART_TYPES.get(name)
            if kind is None or kind.counted is None:
                continue
            self.counts[name] = sum(1 for part in parts if kind.there(part))
            self.most[name] = max(self.most[name], self.counts[name])
            if kind.meter and self.most[name]:
                meter = self.meters.get(name)
                if meter is None:
                    meter = self.meters[name] = load(kind.meter)()
                meter.update(parts, scene.at_ns / NS_PER_S)

    def _note_labels(self, scene: Scene) -> None:
        """Count the views of this scene's own frame; other views were counted with their frames."""
        found = ((person.id, person.view_of(scene.sensor)) for person in scene.people)
        views = {person: view.mirrored for person, view in found if view is not None}
        if views:
            labels = self.labels.setdefault(scene.sensor, Labels())
            now = frozenset(person for person, mirrored in views.items() if mirrored)
            labels.views += len(views)
            labels.swapped += len(now)
            labels.repairs += len(now - labels.swapped_now)
            labels.swapped_now = now

    def _note_condition(self, text: str, at_s: float) -> None:
        known = self.conditions.get(text)
        if known is not None:
            known.last_s, known.results = at_s, known.results + 1
            return
        if len(self.conditions) == MOST_CONDITIONS:
            del self.conditions[min(self.conditions, key=lambda old: self.conditions[old].last_s)]
            self.conditions_left_out += 1
        self.conditions[text] = Condition(at_s, at_s)

    def state(self, at_s: float, phase: str, reason: str) -> None:
        """Add a change of the tracker's state: time since the start of the run [s], phase and reason."""
        self.state_changes.append({"at_s": round(at_s, 3), "phase": phase, "reason": reason})

    def rate_hz(self, now_ns: int, over_s: float = 2.0) -> float:
        """Return the rate of scenes over the last ``over_s`` seconds [Hz]; ``now_ns`` is on the monotonic clock."""
        return sum(1 for t in tuple(self.times) if now_ns - t < over_s * 1e9) / over_s

    def latency_ms(self) -> dict[str, float] | None:
        """Return percentiles of the latency from sent frame to scene [ms]; None if no clock was known."""
        named = {"p50": 50.0, "p90": 90.0, "p99": 99.0, "max": 100.0}
        values = {name: self.latencies.percentile(percent) for name, percent in named.items()}
        known = {name: round(value * 1e3, 3) for name, value in values.items() if value is not None}
        return known or None

    def _counted(self) -> dict[str, Any]:
        """Return the present and largest number of parts of each type, and their quality."""
        row: dict[str, Any] = {}
        for name, kind in PART_TYPES.items():
            if kind.counted is not None:
                row |= {name: self.counts.get(name, 0), f"most_{name}": self.most[name]}
            if kind.meter_name:
                row[kind.meter_name] = self.meters[name].quality.as_json() if name in self.meters else None
        return row

    def never_tracked(self, last: TrackerState) -> str | None:
        """Return why the run never reached tracking, given its last state; None if it did."""
        if any(change["phase"] == Phase.TRACKING for change in self.state_changes):
            return None
        if last.phase is Phase.STOPPED:
            return "tracking was not started"
        if last.phase is Phase.WAITING_FOR_SENSORS:
            why = f"{last.sensors_missing} of the expected sensors never came"
        else:
            remained = (
                f": {last.frames_remaining} of {last.frames_wanted} frames remained" if last.frames_wanted else ""
            )
            why = f"calibration never succeeded{remained}"
        return f"{why}; {self.in_words(last.reason)}" if last.reason else why

    def in_words(self, reason: str) -> str:
        """Return a state's reason for users, with sensors that share a problem named together."""
        return "; ".join(conditions(reason, [place.sensor for place in self.places])) if self.places else reason

    def as_json(self, last: TrackerState) -> dict[str, Any]:
        """Return the fields of a summary that live and replayed runs share; ``last`` is the tracker's final state."""
        return {
            "phase": last.phase.value,
            "reason": last.reason,
            "frames_in": self.frames_in,
            "frames_untracked": self.untracked,
            "frames_out": self.scenes_out,
            "rejected": self.rejected,
            **self._counted(),
            "latency_ms": self.latency_ms(),
            "state_changes": self.state_changes,
            "conditions": [
                {
                    "condition": text,
                    "first_s": round(condition.first_s, 3),
                    "last_s": round(condition.last_s, 3),
                    "results": condition.results,
                }
                for text, condition in self.conditions.items()
            ],
            "conditions_left_out": self.conditions_left_out,
            "sensor_places": [_place_row(place) for place in self.places],
            "labels_repaired": [
                {"sensor": sensor, "views": of.views, "swapped": of.swapped, "repairs": of.repairs}
                for sensor, of in sorted(self.labels.items())
            ],
            "never_tracked": self.never_tracked(last),
            "errors": self.errors,
        }


def _place_row(place: SensorPlace) -> dict[str, Any]:
    """Return a sensor's last pose; null if unknown."""
    T, sd_mm, sd_deg = place.T_world_sensor, 1e3 * place.position_sd, math.degrees(place.rotation_sd)
    return {
        "sensor": place.sensor,
        "T_world_sensor": None if T is None else T[:3].tolist(),
        "position_sd_mm": round(sd_mm, 2) if math.isfinite(sd_mm) else None,
        "rotation_sd_deg": round(sd_deg, 3) if math.isfinite(sd_deg) else None,
        "quality": place.quality,
        "problem": place.problem,
    }
