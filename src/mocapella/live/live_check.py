"""Check the data of the last second while a study runs, for the researcher."""

from __future__ import annotations

from collections import deque
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.model.scene import Person, Scene
from mocapella.model.session import SessionStatus
from mocapella.model.study_status import FloorMap, LiveCheck, StudyStatus

Float64 = NDArray[np.float64]

OVER_S: Final = 1.0
"""Interval whose data are checked [s]."""
LEAST_PLACES: Final = 30
"""Least number of results with a person who stands still on a known point, to find the marked block."""
_MARGIN_M: Final = 0.3
"""How far the pelvis may be outside of the block: people turn on its edge [m]."""


class LiveChecker:
    """Checks the results as they come.

    The marked block is found from the first step with one person standing on a named point: the person's pelvis is
    over that point, and the first sensor looks along the block.
    """

    def __init__(self) -> None:
        self._apart: deque[tuple[float, float]] = deque()
        self._whole: deque[tuple[float, float]] = deque()
        self._standing: list[Float64] = []
        self._stood_at = ""
        self._middle: Float64 | None = None
        self._last: Scene | None = None

    def update(self, scene: Scene | None, status: SessionStatus | None, now_s: float) -> LiveCheck | None:
        """Return the check after a new result; None while the session runs no study.

        Args:
            scene: the newest result; None without one.
            status: the session's newest status.
            now_s: the present time on a monotonic clock [s].
        """
        if status is None or status.study is None:
            return None
        if scene is not None and scene is not self._last:
            self._add(scene, status.study, now_s)
        self._last = scene
        for values in (self._apart, self._whole):
            while values and now_s - values[0][0] > OVER_S:
                values.popleft()
        people = () if scene is None else scene.people
        return LiveCheck(
            sensors=sum(row.connected and not row.silent for row in status.sensors),
            wanted=status.setup.sensors_expected,
            people=len(people),
            inside=self._inside(scene, status.study.block),
            apart_cm=None if not self._apart else 100 * float(np.mean([value for _, value in self._apart])),
            whole_percent=None if not self._whole else 100 * float(np.mean([value for _, value in self._whole])),
        )

    def _add(self, scene: Scene, study: StudyStatus, now_s: float) -> None:
        for person in scene.people:
            self._apart += [(now_s, apart) for apart in views_apart(person)]
            self._whole += [(now_s, float((view.states == JointState.TRACKED).all())) for view in person.views]
        here = study.block.here if study.block is not None and study.phase == "running" else ()
        still = len(here) == 1 and here[0] and not any(study.block.next if study.block is not None else ())
        if self._middle is not None or not still or len(scene.people) != 1:
            return
        if here[0] != self._stood_at:
            self._stood_at, self._standing = here[0], []
        self._standing.append(_pelvis(scene, scene.people[0]))
        if len(self._standing) >= LEAST_PLACES and study.block is not None:
            axes = _block_axes(scene)
            point = next((one for one in study.block.points if one.name == here[0]), None)
            place = np.median(np.stack(self._standing), axis=0)
            if axes is not None and point is not None and np.isfinite(place).all():
                self._middle = place - axes.T @ np.array([point.x, point.y])

    def _inside(self, scene: Scene | None, block: FloorMap | None) -> int | None:
        if scene is None or block is None or self._middle is None or (axes := _block_axes(scene)) is None:
            return None
        half = np.array([block.width, block.depth]) / 2 + _MARGIN_M
        places = [axes @ (_pelvis(scene, person) - self._middle) for person in scene.people]
        return sum(bool((np.abs(place) <= half).all()) for place in places)


def views_apart(person: Person) -> list[float]:
    """Return the mean distance over the joints, Δd, of each two views of a person that share a joint [m]."""
    views = [
        np.where((view.states == JointState.NOT_TRACKED)[:, None], np.nan, view.positions) for view in person.views
    ]
    distances = [np.linalg.norm(one - other, axis=-1) for one, other in combinations(views, 2)]
    return [float(np.nanmean(each)) for each in distances if np.isfinite(each).any()]


def _pelvis(scene: Scene, person: Person) -> Float64:
    """Return where a person is on the floor: (2,) x and z of the root joint, world [m]."""
    return np.asarray(person.positions[scene.topology.parts["root"]], dtype=np.float64)[[0, 2]]


def _block_axes(scene: Scene) -> Float64 | None:
    """Return the block's axes as rows (2, 2) in the world's x and z; None without a sensor's pose.

    The second points to the first sensor along its line of sight, the first to the right of a person who faces it.
    """
    first = min(scene.sensors, key=lambda one: one.sensor, default=None)
    if first is None or first.T_world_sensor is None:
        return None
    ahead = first.T_world_sensor[[0, 2], 2]
    length = float(np.linalg.norm(ahead))
    if length < 1e-6:
        return None
    towards = -ahead / length
    return np.array([[-towards[1], towards[0]], towards])
