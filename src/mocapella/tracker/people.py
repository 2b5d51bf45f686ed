"""Each person's views brought to one instant, made one skeleton, and kept steady."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.fusion.weighted_mean import FusionSettings, learn_offsets, view_variances, weighted_mean
from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.smoothing.kalman import KalmanSettings, Points, correct, predict, unknown

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class PeopleSettings:
    """How views become people.

    Attributes:
        fusion: what a view is worth.
        motion: how people move.
        view_age_s: a view older than this is no longer used.
        swap_m: how much nearer a view must be to the person with left and right swapped, before they are.
        swap_s: time constant over which that is judged.
    """

    fusion: FusionSettings = field(default_factory=FusionSettings)
    motion: KalmanSettings = field(default_factory=KalmanSettings)
    view_age_s: float = 0.12
    swap_m: float = 0.02
    swap_s: float = 0.1


class SeenView(msgspec.Struct, frozen=True, eq=False):
    """A sensor's newest view of a person, as it is used.

    Attributes:
        tracking_id: that sensor's.
        at_s: when it was captured, on the common clock.
        positions: (joints, 3), world, with the sensor's own labels [m].
        states: (joints,) with the sensor's own labels.
        variances: (joints,) at its capture [m²].
        swapped: whether left and right are taken for each other.
        advantage_m: how much nearer to the person the labels not in use have been lately.
        offsets: (joints, 3) from the person, slowly learnt; in the person's labels.
    """

    tracking_id: int
    at_s: float
    positions: Float64
    states: UInt8
    variances: Float64
    swapped: bool
    advantage_m: float
    offsets: Float64


class Body(msgspec.Struct, frozen=True, eq=False):
    """One person's skeleton and the views it is made of, by sensor."""

    points: Points
    views: Mapping[str, SeenView]
    states: UInt8
    fused_s: float


class Sight(msgspec.Struct, frozen=True, eq=False):
    """A body as a sensor shows it now: world positions [m], and what they are worth."""

    sensor: str
    tracking_id: int
    at_s: float
    positions: Float64
    states: UInt8
    distance_m: float
    clipped: bool


class People:
    """The bodies of all who are known, by number."""

    def __init__(self, settings: PeopleSettings, mirror: NDArray[np.int64]) -> None:
        self.settings = settings
        self.mirror = mirror
        self._sided = self.mirror != np.arange(len(self.mirror))
        self.bodies: dict[int, Body] = {}

    def expected(self, at_s: float) -> dict[int, Points]:
        """Everybody, predicted."""
        motion = self.settings.motion
        return {
            person: body.points if at_s <= body.points.at_s else predict(body.points, at_s, motion)
            for person, body in self.bodies.items()
        }

    def update(self, expected: Mapping[int, Points], sights: Mapping[int, Sight], at_s: float) -> None:
        """Take in one frame: whom it shows, and how.

        Args:
            expected: of `expected` for this instant.
            sights: by person.
            at_s: the frame's capture.
        """
        joints = len(self.mirror)
        for person in sights:
            if person not in self.bodies:
                states = np.full(joints, JointState.NOT_TRACKED, dtype=np.uint8)
                self.bodies[person] = Body(unknown((joints,), at_s), {}, states, at_s)
        for person, body in list(self.bodies.items()):
            points = expected.get(person, body.points)
            views = {
                sensor: view for sensor, view in body.views.items() if at_s - view.at_s <= self.settings.view_age_s
            }
            if (sight := sights.get(person)) is not None:
                views[sight.sensor] = self._seen(sight, body.views.get(sight.sensor), points)
            self.bodies[person] = self._fuse(body, points, dict(sorted(views.items())))

    def move(self, T_new_old: Float64) -> None:
        """Everything is told in another frame from now on."""
        R = T_new_old[:3, :3]
        for person, body in self.bodies.items():
            points = msgspec.structs.replace(
                body.points,
                positions=apply(T_new_old, body.points.positions),
                velocities=body.points.velocities @ R.T,
            )
            views = {
                sensor: msgspec.structs.replace(
                    view, positions=apply(T_new_old, view.positions), offsets=view.offsets @ R.T
                )
                for sensor, view in body.views.items()
            }
            self.bodies[person] = msgspec.structs.replace(body, points=points, views=views)

    def keep(self, people: Sequence[int]) -> None:
        """Forget everybody else."""
        self.bodies = {person: self.bodies[person] for person in people if person in self.bodies}

    def join(self, stays: int, gone: int) -> None:
        """Two turned out to be one."""
        one, other = self.bodies.get(stays), self.bodies.pop(gone, None)
        if one is not None and other is not None:
            views = {**other.views, **one.views}
            self.bodies[stays] = msgspec.structs.replace(one, views=dict(sorted(views.items())))

    def _seen(self, sight: Sight, before: SeenView | None, points: Points) -> SeenView:
        s = self.settings
        variances = view_variances(
            sight.states, np.array(sight.distance_m), np.array(sight.clipped), np.zeros(()), s.fusion
        )
        swapped, advantage, offsets = False, 0.0, np.zeros_like(sight.positions)
        dt = 1.0
        if before is not None:
            swapped, advantage, offsets = before.swapped, before.advantage_m, before.offsets
            dt = sight.at_s - before.at_s
        now = self._advantage(sight, points, swapped)
        if now is not None:
            advantage += -np.expm1(-dt / s.swap_s) * (now - advantage)
            if advantage > s.swap_m:
                swapped, advantage = not swapped, -advantage
        return SeenView(
            sight.tracking_id, sight.at_s, sight.positions, sight.states, variances, swapped, advantage, offsets
        )

    def _advantage(self, sight: Sight, points: Points, swapped: bool) -> float | None:
        """How much nearer to the person the other labels are [m]; None where nothing tells."""
        mirror = self.mirror
        raw = np.linalg.norm(sight.positions - points.positions, axis=-1)
        other = np.linalg.norm(sight.positions[mirror] - points.positions, axis=-1)
        both = self._sided & np.isfinite(raw) & np.isfinite(other)
        if both.sum() < 2:
            return None
        difference = float((raw[both] - other[both]).mean())
        return -difference if swapped else difference

    def _fuse(self, body: Body, points: Points, views: dict[str, SeenView]) -> Body:
        s, now_s = self.settings, points.at_s
        if not views:
            states = np.where(np.isfinite(points.positions[:, 0]), JointState.INFERRED, JointState.NOT_TRACKED)
            return Body(points, {}, states.astype(np.uint8), body.fused_s)
        velocity = np.nan_to_num(points.velocities)
        order = [self.mirror if view.swapped else slice(None) for view in views.values()]
        ages = np.array([max(0.0, now_s - view.at_s) for view in views.values()])
        positions = np.stack([view.positions[o] for view, o in zip(views.values(), order, strict=True)])
        positions += ages[:, None, None] * velocity
        variances = np.stack([view.variances[o] for view, o in zip(views.values(), order, strict=True)])
        variances = variances + ((s.fusion.age_speed_m_s * ages) ** 2)[:, None]
        states = np.stack([view.states[o] for view, o in zip(views.values(), order, strict=True)])
        offsets = np.stack([view.offsets for view in views.values()])
        nu, expected_variances = s.fusion.degrees_of_freedom, points.variances[:, 0]
        raw = weighted_mean(positions, variances, points.positions, expected_variances, nu)
        offsets = learn_offsets(offsets, positions, raw.positions, max(0.0, now_s - body.fused_s), s.fusion)
        fused = weighted_mean(positions - offsets, variances, points.positions, expected_variances, nu)
        # The views that are not of this frame were taken in before: their news is not counted twice.
        points = correct(points, fused.positions, fused.variances * len(views), s.motion)
        best = states.max(axis=0)
        predicted = (best == JointState.NOT_TRACKED) & np.isfinite(points.positions[:, 0])
        best = np.where(predicted, JointState.INFERRED, best).astype(np.uint8)
        kept = {
            sensor: msgspec.structs.replace(view, offsets=offsets[i]) for i, (sensor, view) in enumerate(views.items())
        }
        return Body(points, kept, best, now_s)
