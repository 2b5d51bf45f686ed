"""Cloth that hangs by its upper edge, and that hands push, grab, pull and release.

Particles in a square grid, with distance constraints along its lines and diagonals, and over two cells against bending,
are moved by position-based dynamics: M. Müller, B. Heidelberger, M. Hennix, J. Ratcliff, "Position Based Dynamics",
J. Vis. Commun. Image R. 18 (2007) 109, with the compliance of M. Macklin, M. Müller, N. Chentanez, "XPBD:
Position-Based Simulation of Compliant Constrained Dynamics", MIG 2016, and many small steps of one iteration each, of
M. Macklin et al., "Small Steps in Physics Simulation", SCA 2019. The cloth does not collide with itself; hands are
spheres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse
from mocapella.model.arms import PALM
from mocapella.model.hand import TIPS, WRIST
from mocapella.model.scene import TrackedArm
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_NO_SPHERES: Final = np.zeros((0, 4))
_BONES: Final = tuple((1 + 4 * d + k, 2 + 4 * d + k) for d in range(5) for k in range(3))


@dataclass(frozen=True)
class ClothSettings:
    """Material of a cloth, and its contact with hands.

    Attributes:
        width_m, height_m: size of the cloth [m].
        mesh_m: distance between neighbouring particles [m].
        gravity_m_s2: downward acceleration [m/s²].
        damping_per_s: rate at which motion decays [1/s].
        bend_compliance, shear_compliance: compliance against bending and along the diagonals, times a particle's mass
            [s²]; 0 is rigid. Threads are rigid.
        step_s: time step of the simulation [s].
        thickness_m: distance that the cloth keeps from a hand [m].
        friction: Coulomb's friction coefficient on a hand.
        reach_m: a closing hand grabs the particles within this distance of its palm or fingertips [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    width_m: float = 0.42
    height_m: float = 0.36
    mesh_m: float = 0.018
    gravity_m_s2: float = 9.81
    damping_per_s: float = 1.2
    bend_compliance: float = 2e-5
    shear_compliance: float = 1e-6
    step_s: float = 1 / 960
    thickness_m: float = 0.004
    friction: float = 0.4
    reach_m: float = 0.045

    def __post_init__(self) -> None:
        check(0.001 <= self.mesh_m <= 0.1, "mesh_m", self.mesh_m, "from 0.001 to 0.1 m")
        for name in ("width_m", "height_m"):
            value = getattr(self, name)
            check(2 * self.mesh_m <= value <= 200 * self.mesh_m, name, value, "from 2 to 200 times mesh_m")
        check(0 <= self.gravity_m_s2 <= 100, "gravity_m_s2", self.gravity_m_s2, "from 0 to 100 m/s²")
        check(0 <= self.damping_per_s <= 100, "damping_per_s", self.damping_per_s, "from 0 to 100 a second")
        for name in ("bend_compliance", "shear_compliance"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1 s²")
        check(1e-4 <= self.step_s <= 0.02, "step_s", self.step_s, "from 0.0001 to 0.02 s")
        check(0 <= self.thickness_m <= 0.05, "thickness_m", self.thickness_m, "from 0 to 0.05 m")
        check(0 <= self.friction <= 10, "friction", self.friction, "from 0 to 10")
        check(0 < self.reach_m <= 1, "reach_m", self.reach_m, "above 0, at most 1 m")


@dataclass(frozen=True, eq=False)
class HandInCloth:
    """A hand at an instant.

    Attributes:
        id: identifies the hand over time.
        T_world_hand: (4, 4) pose of the hand; grabbed particles are fixed in this frame.
        spheres: (n, 4) centre and radius of each sphere in the world [m]; n is the same every time.
        grips: (k, 3) points in the world from which the hand can grab the cloth [m].
        grabbing: whether it is closed.
    """

    id: int
    T_world_hand: Float64
    spheres: Float64
    grips: Float64
    grabbing: bool


def hand_in_cloth(arm: TrackedArm, radius_m: float = 0.011) -> HandInCloth | None:
    """Model an arm's hand as spheres at palm, wrist, joints and middles of the digits' bones.

    Spheres at unknown landmarks (NaN) have radius 0. If the palm's orientation is unknown, the hand's axes are the
    world's.

    Args:
        arm: a tracked arm.
        radius_m: radius of the spheres at the digits [m]; those at wrist and palm are larger.

    Returns:
        The hand; None if the palm's position is unknown.
    """
    x = arm.points
    if not np.isfinite(x[PALM]).all():
        return None
    if arm.T_world_palm is not None and np.isfinite(arm.T_world_palm).all():
        T = arm.T_world_palm
    else:
        T = np.eye(4)
        T[:3, 3] = x[PALM]
    places = np.concatenate([x[1:21], [0.5 * (x[a] + x[b]) for a, b in _BONES], x[[WRIST, PALM]]])
    radii = np.full(len(places), radius_m)
    radii[-2:] = 2.0 * radius_m, 2.6 * radius_m
    known = np.isfinite(places).all(axis=1)
    spheres = np.where(known[:, None], np.column_stack([places, radii]), [*x[PALM], 0.0])
    grips = x[[PALM, *TIPS]]
    return HandInCloth(arm.id, T, spheres, grips[np.isfinite(grips).all(axis=1)], arm.grabbing)


class Cloth:
    """A cloth at a fixed pose. The same hands at the same times give the same cloth, to the bit.

    Args:
        T_world_cloth: (4, 4) from the cloth's frame, with the origin at the middle of the upper edge, x along the edge
            and y upwards, to the world.
        settings: the material.
        pinned: whether the upper edge is fixed; otherwise the cloth falls unless a hand holds it.

    Attributes:
        settings: as given.
        shape: (rows, columns) numbers of particles, from the upper edge down.
        positions: (rows · columns, 3) of the particles in the world [m].
        velocities: (rows · columns, 3) velocities of the particles in the world [m/s].
        pinned: (rows · columns,) whether a particle never moves.
        pairs, rest: (k, 2) indices of the particles that a constraint connects, and (k,) their distance at rest [m].
    """

    def __init__(self, T_world_cloth: Float64, settings: ClothSettings | None = None, *, pinned: bool = True) -> None:
        self.settings = s = settings or ClothSettings()
        self.shape = (round(s.height_m / s.mesh_m) + 1, round(s.width_m / s.mesh_m) + 1)
        self.pairs, self.rest, self._compliance = _constraints(self.shape, s)
        rows, columns = self.shape
        across = (np.arange(columns) - 0.5 * (columns - 1)) * s.mesh_m
        down = -np.arange(rows) * s.mesh_m
        flat = np.stack(np.broadcast_arrays(across[None], down[:, None], 0.0), axis=-1).reshape(-1, 3)
        self._begin = np.ascontiguousarray(apply(T_world_cloth, flat))
        self.pinned = np.zeros(rows * columns, dtype=np.bool_)
        self.pinned[:columns] = pinned
        self.reset()

    def reset(self) -> None:
        """Reset to a flat cloth at rest, not held by any hand."""
        self.positions = self._begin.copy()
        self.velocities = np.zeros_like(self.positions)
        self._holder = np.full(len(self.positions), -1, dtype=np.int64)
        self._held_at = np.zeros_like(self.positions)
        self._spheres: dict[int, Float64] = {}
        self._grabbing: dict[int, bool] = {}
        self._at_s: float | None = None

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether a hand holds each particle (rows · columns,)."""
        return self._holder >= 0

    def update(self, hands: Sequence[HandInCloth], at_s: float) -> Float64:
        """Simulate up to an instant.

        Nothing moves at the first call, after a gap of more than a quarter of a second, and if time goes back. A hand
        takes hold of the particles in reach when it begins to grab, and releases them when it opens or is missing.

        Args:
            hands: the hands at that instant; they move there in a straight line.
            at_s: the instant, on the clock of the hands [s].

        Returns:
            Positions (rows, columns, 3) of the particles in the world [m]; a view of ``positions``, which the next call
            changes.
        """
        s, before_s = self.settings, self._at_s
        if before_s is None or not 0 < at_s - before_s <= 0.25:
            steps, self._at_s = 0, at_s
        else:
            steps = math.floor((at_s - before_s) / s.step_s + 1e-6)
            self._at_s = before_s + steps * s.step_s
        self._grab_and_release(hands)
        target = self.positions.copy()
        for hand in hands:
            grabbed = self._holder == hand.id
            target[grabbed] = apply(hand.T_world_hand, self._held_at[grabbed])
        spheres_to = np.concatenate([_NO_SPHERES, *(hand.spheres for hand in hands)])
        spheres_from = np.concatenate([_NO_SPHERES, *(self._before(hand) for hand in hands)])
        if steps:
            fixed = (self.pinned | self.held).astype(np.float64)
            k = _kernels()
            k.advance(
                self.positions, self.velocities, fixed, target, k.Threads(self.pairs, self.rest, self._compliance),
                k.CollisionSpheres(spheres_from, spheres_to, float(s.thickness_m), float(s.friction)),
                k.TimeSteps(np.array([0.0, -s.gravity_m_s2, 0.0]), float(s.damping_per_s), float(s.step_s), steps),
            )  # fmt: skip
            self._spheres = {hand.id: hand.spheres.copy() for hand in hands}
        return self.positions.reshape(*self.shape, 3)

    def _before(self, hand: HandInCloth) -> Float64:
        before = self._spheres.get(hand.id)
        return hand.spheres if before is None or before.shape != hand.spheres.shape else before

    def _grab_and_release(self, hands: Sequence[HandInCloth]) -> None:
        here = {hand.id for hand in hands}
        self._holder[~np.isin(self._holder, list(here))] = -1
        for hand in hands:
            if not hand.grabbing:
                self._holder[self._holder == hand.id] = -1
            elif not self._grabbing.get(hand.id, False) and len(hand.grips):
                apart = np.linalg.norm(self.positions[:, None] - hand.grips[None], axis=-1).min(axis=1)
                taken = (apart <= self.settings.reach_m) & ~self.pinned & ~self.held
                self._holder[taken] = hand.id
                self._held_at[taken] = apply(inverse(hand.T_world_hand), self.positions[taken])
        self._grabbing = {hand.id: hand.grabbing for hand in hands}


class ClothBeforeHand:
    """A cloth that appears in reach of the first open hand, for a demonstration of arm tracking.

    Args:
        settings: the material.
        before_m: distance of the cloth in front of the hand's point nearest to the camera [m].
        above_m: height of the upper edge above the palm [m].
        lost_after_s: time without any arm after which the cloth is removed [s].

    Attributes:
        settings: as given.
        cloth: the cloth; None before the first open hand, and after it was removed.
    """

    def __init__(
        self, settings: ClothSettings | None = None, *, before_m: float = 0.03, above_m: float = 0.24,
        lost_after_s: float = 5.0,
    ) -> None:  # fmt: skip
        self.settings = settings or ClothSettings()
        self._before_m, self._above_m, self._lost_after_s = before_m, above_m, lost_after_s
        self.reset()

    def reset(self) -> None:
        """Remove the cloth."""
        self.cloth: Cloth | None = None
        self._seen_s = -math.inf

    def update(self, arms: Sequence[TrackedArm], eye: Float64 | None, at_s: float) -> Cloth | None:
        """Simulate the cloth up to an instant; return it, the same object each time, or None if there is none.

        Args:
            arms: the arms at that instant.
            eye: (3,) position of the camera in the arms' world frame, which a new cloth faces [m]; None for the
                direction z.
            at_s: the instant, on the clock of the arms [s].
        """
        found = [hand for hand in map(hand_in_cloth, arms) if hand is not None]
        if found:
            self._seen_s = at_s
        elif self.cloth is not None and not 0 <= at_s - self._seen_s <= self._lost_after_s:
            self.cloth = None
        loose = [hand for hand in found if not hand.grabbing]
        if self.cloth is None and loose:
            self.cloth = Cloth(self._place(loose[0].grips, eye), self.settings)
        if self.cloth is not None:
            self.cloth.update(found, at_s)
        return self.cloth

    def _place(self, grips: Float64, eye: Float64 | None) -> Float64:
        palm = grips[0]
        towards = np.array([0.0, 0.0, 1.0]) if eye is None else (eye - palm) * [1.0, 0.0, 1.0]
        length = float(np.linalg.norm(towards))
        z = towards / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
        T = np.eye(4)
        T[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], z), [0.0, 1.0, 0.0], z], axis=1)
        nearest = float(((grips - palm) @ z).max())
        T[:3, 3] = palm + (nearest + self._before_m) * z + [0.0, self._above_m, 0.0]
        return T


def _constraints(shape: tuple[int, int], s: ClothSettings) -> tuple[Int64, Float64, Float64]:
    """Pairs of particles, their rest lengths and compliances: threads from the top down, diagonals, and bending."""
    rows, columns = shape
    number = np.arange(rows * columns).reshape(shape)
    parts: list[tuple[Any, Any, float, float]] = [
        (number[:-1], number[1:], 1.0, 0.0),
        (number[:, :-1], number[:, 1:], 1.0, 0.0),
        (number[:-1, :-1], number[1:, 1:], math.sqrt(2), s.shear_compliance),
        (number[:-1, 1:], number[1:, :-1], math.sqrt(2), s.shear_compliance),
        (number[:-2], number[2:], 2.0, s.bend_compliance),
        (number[:, :-2], number[:, 2:], 2.0, s.bend_compliance),
    ]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b, _, _ in parts])
    rest = np.concatenate([np.full(a.size, far * s.mesh_m) for a, _, far, _ in parts])
    compliance = np.concatenate([np.full(a.size, gives) for a, _, _, gives in parts])
    return np.ascontiguousarray(pairs, dtype=np.int64), rest, compliance


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import cloth_kernels

    return cloth_kernels
