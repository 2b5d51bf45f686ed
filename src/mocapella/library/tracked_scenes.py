"""Results of a tracker in memory, as a recording has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mocapella.model.scene import Scene
from mocapella.model.trajectories import Trajectories, trajectories_of


@dataclass(frozen=True)
class TrackedScenes:
    """Results of a tracker.

    Attributes:
        timed: (run, unix_ns, scene): number of the tracker's run, capture time since 1970 [ns], and the scene.
        sensors: names of the sensors.
        seconds: duration [s].
        labels: participant, placement, scenario and method of each run.
        problems: faults of the recording, a line each.
    """

    timed: Sequence[tuple[int, int, Scene]]
    sensors: tuple[str, ...]
    seconds: float
    labels: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    def scenes(self) -> Iterator[Scene]:
        """Yield the scenes."""
        return (scene for _, _, scene in self.timed)

    def trajectories(self, kinds: Sequence[str], *, sensor: str | None = None) -> dict[str, Trajectories]:
        """Return trajectories by kind; arguments and errors as of `trajectories_of`."""
        found = trajectories_of(self.timed, kinds, sensor=sensor)
        return {kind: replace(some, labels=self.labels) for kind, some in found.items()}
