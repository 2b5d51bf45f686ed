"""How a simulated arm moves: postures and places of a file, one after the other, as one person would do them.

A scene's keys say what the hand does and how the arm moves from where it is held; between them all goes the smoothest
way (T. Flash, N. Hogan, 1985). Then fingers are moved, as little as possible and within the hand's limits, until none
is inside another or the palm by more than flesh gives, and digits that shall touch do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.geometry.rigid import rigid
from mocapella.model.arms import PALM
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, DIGITS
from mocapella.settings import check
from mocapella.sources.simulate.arm_mesh import (
    ELBOW_FLEXION_RAD,
    PRONATION_RAD,
    WRIST_DEVIATION_RAD,
    WRIST_FLEXION_RAD,
    ArmMesh,
    ArmMeshPose,
)

Float64 = NDArray[np.float64]

FLESH_GIVES_M: Final = 0.0005
"""Fingers that overlap by less stay as they are."""
_PALM_HALF_M: Final = 0.0105
_SAMPLES: Final = 400
_NODES: Final = 33
_THUMB_STEPS: Final = 6
_SMOOTHED: Final = 3
_SAME_RAD: Final = 0.05
_THUMB: Final = [int(k) for k in DIGIT_ANGLES[0]]
_FINGERS: Final = [int(k) for k in DIGIT_ANGLES[1:, [0, 2, 3]].ravel()]
_THUMB_BENDS: Final = [int(DIGIT_ANGLES[0, k]) for k in (0, 2, 3)]


class Posture(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the hand does: of each digit flexion and abduction of its base, flexion of its second and third joint [deg];
    what is not given is as in ``open``.

    Attributes:
        touch: two digits that touch: the thumb's tip and another, or two fingers' sides; none by default.
        gesture: its name; empty where it has none.
    """

    thumb: tuple[float, float, float, float] | None = None
    index: tuple[float, float, float, float] | None = None
    middle: tuple[float, float, float, float] | None = None
    ring: tuple[float, float, float, float] | None = None
    little: tuple[float, float, float, float] | None = None
    touch: tuple[str, str] | None = None
    gesture: str = ""


class Key(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the arm shall do next.

    Attributes:
        posture: of the hand, by name.
        move_s: how long it takes to get there; hold_s: and how long it stays.
        elbow_deg, pronation_deg, wrist_deg, deviation_deg: more than at the beginning.
        roll_deg: of the whole arm about the view's axis through its middle, clockwise in the picture.
        turn_deg: of the whole arm about its shoulder: a vector along the axis, camera's axes.
        shift_m: of the whole arm, camera's axes.
    """

    posture: str = "open"
    move_s: float = 0.6
    hold_s: float = 0.3
    elbow_deg: float = 0.0
    pronation_deg: float = 0.0
    wrist_deg: float = 0.0
    deviation_deg: float = 0.0
    roll_deg: float = 0.0
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check(0.05 <= self.move_s <= 60, "move_s", self.move_s, "from 0.05 to 60 s")
        check(0 <= self.hold_s <= 60, "hold_s", self.hold_s, "from 0 to 60 s")


@dataclass(frozen=True, eq=False)
class HeldArm:
    """How an arm is held at an instant.

    Attributes:
        pose: see there; of a right arm, in the space of a camera that sees the mirror image of a left one.
        gesture: its name; empty between gestures.
    """

    pose: ArmMeshPose
    gesture: str


class ArmMotion:
    """A right arm's pose at any time; a left one's is the mirror image of what it says. Keys repeat for ever.

    Args:
        mesh: whose arm.
        keys: what it does.
        postures: all there are.
        start: how it is held, to which keys add.
        middle: (3,) about what it rolls [m].
        rate: how much faster than the keys say.
        peak_m_s: the palm's greatest speed, 0 for that of the keys; the rate follows from it.
        phase: where in the keys it begins, from 0 to 1.
        amount_deg: how far each key's posture departs from the file's (standard deviation).
        seed: of that.
    """

    def __init__(
        self, mesh: ArmMesh, keys: tuple[Key, ...], postures: dict[str, Posture], start: ArmMeshPose, middle: Float64,
        *, rate: float = 1.0, peak_m_s: float = 0.0, phase: float = 0.0, amount_deg: float = 0.0, seed: int = 0,
    ) -> None:  # fmt: skip
        self.mesh, self.keys, self.start, self.middle = mesh, keys, start, middle
        rng = np.random.default_rng([seed, 21])
        same = {name: rng.normal(0.0, math.radians(amount_deg), len(ANGLES)) for name in postures}
        self._postures: list[Float64] = []
        self._touches: list[tuple[int, int] | None] = []
        for key in keys:
            if key.posture not in postures:
                raise SettingsError(f"unknown posture {key.posture!r}; known: {one_of(key.posture, postures)}")
            posture = postures[key.posture]
            wished = posture_angles(posture, postures["open"])
            self._postures.append(mesh.model.limited(wished + same[key.posture]))
            self._touches.append(posture.touch and (DIGITS.index(posture.touch[0]), DIGITS.index(posture.touch[1])))
        self._gestures = [postures[key.posture].gesture for key in keys]
        degrees = [[k.elbow_deg, k.pronation_deg, k.wrist_deg, k.deviation_deg, k.roll_deg, *k.turn_deg] for k in keys]
        self._values = np.hstack([np.radians(degrees), [k.shift_m for k in keys]])
        self._ends = np.cumsum([key.move_s + key.hold_s for key in keys])
        self.period_s, self._rate, self._phase = float(self._ends[-1]), rate, phase
        self._flesh = _flesh(mesh)
        self._open = posture_angles(postures["open"], postures["open"])
        self._postures = [self._settled(k) for k in range(len(keys))]
        self._corrections = [self._correction(k) for k in range(len(keys))]
        if peak_m_s:
            self._rate = 1.0
            at = np.linspace(0.0, self.period_s, _SAMPLES * len(keys) + 1)
            palm = np.array([self._palm(t) for t in at])
            self._rate = peak_m_s / float(np.linalg.norm(np.diff(palm, axis=0), axis=1).max() / (at[1] - at[0]))
        self.period_s /= self._rate

    def at(self, at_s: float) -> HeldArm:
        """How it is held at a time."""
        before, after, x = self._where(at_s)
        part = _eased(x)
        wished = self._wished(before, after, x)
        nodes = self._corrections[after]
        k = min(int(x * (len(nodes) - 1)), len(nodes) - 2)
        u = x * (len(nodes) - 1) - k
        angles = self.mesh.model.limited(wished + (1.0 - u) * nodes[k] + u * nodes[k + 1])
        same = self._gestures[before] == self._gestures[after]
        sure = part == 1.0 or same
        return HeldArm(self._arm(angles, self._mixed(before, after, part)), self._gestures[after] if sure else "")

    def _touch(self, before: int, after: int, part: float) -> Float64:
        """(2, 3) which tips are drawn to each other; on the way nothing pulls."""
        touch = np.zeros((2, 3))
        for row, k, amount in ((0, before, 1.0 - part), (1, after, part)):
            pair = self._touches[k]
            if pair:
                touch[row] = *pair, amount**4
        return touch

    def _correction(self, after: int) -> Float64:
        """(nodes, 21) what keeps fingers out of each other on the way to a key [rad], smooth in time.

        Followed from both ends, because a finger that is in the way can be passed on either side of it.
        """
        before = (after - 1) % len(self.keys)
        xs = np.linspace(0.0, 1.0, _NODES)
        wished = np.array([self._wished(before, after, float(x)) for x in xs])
        ways = np.empty((2, *wished.shape))
        for way, nodes in zip(ways, (range(_NODES), range(_NODES - 1, -1, -1)), strict=True):
            last = wished[nodes[0]]
            for n in nodes:
                touch = self._touch(before, after, _eased(float(xs[n])))
                last = way[n] = untangled(self.mesh, wished[n], start=last, touch=touch, flesh=self._flesh)
        there, back = ways
        missed = np.abs(there[-1] - back[-1]).max(), np.abs(back[0] - there[0]).max()
        if min(missed) < _SAME_RAD:
            way = there if missed[0] <= missed[1] else back
        else:
            part = np.array([[_eased(float(x))] for x in xs])
            way = (1.0 - part) * there + part * back
        correction = way - wished
        correction[0] = correction[-1] = 0.0
        for _ in range(_SMOOTHED):
            correction[1:-1] = 0.25 * correction[:-2] + 0.5 * correction[1:-1] + 0.25 * correction[2:]
        return np.asarray(correction)

    def _where(self, at_s: float) -> tuple[int, int, float]:
        """The keys before and after, and how much of the time from one to the other is over."""
        u = (at_s * self._rate + self._phase * float(self._ends[-1])) % float(self._ends[-1])
        k = min(int(np.searchsorted(self._ends, u, side="right")), len(self.keys) - 1)
        since = u - (float(self._ends[k - 1]) if k else 0.0)
        return (k - 1) % len(self.keys), k, min(since / self.keys[k].move_s, 1.0)

    def _settled(self, k: int) -> Float64:
        """(21,) a key's angles such that no finger is in another; the thumb comes last, from outside."""
        wished, touch = self._postures[k], self._touch(k, k, 1.0)
        last = wished.copy()
        last[_THUMB] = self._open[_THUMB]
        for part in np.linspace(0.0, 1.0, _THUMB_STEPS):
            now = wished.copy()
            now[_THUMB] = (1.0 - part) * self._open[_THUMB] + part * wished[_THUMB]
            drawn = touch * [1.0, 1.0, float(part == 1.0)]
            last = untangled(self.mesh, now, start=last, touch=drawn, flesh=self._flesh)
        return last

    def _wished(self, before: int, after: int, x: float) -> Float64:
        """(21,) the angles before any finger is in another's way.

        The thumb closes last, opens first, and makes way where it is bent before and after while a finger moves.
        """
        a, b = self._postures[before], self._postures[after]
        bends = [float((angles - self._open)[_THUMB_BENDS].sum()) for angles in (a, b)]
        away = np.zeros(len(ANGLES))
        if min(bends) > math.radians(40) and np.abs((b - a)[_FINGERS]).max() > math.radians(30):
            part = np.full(len(ANGLES), _eased((x - 0.3) / 0.4))
            away[_THUMB] = _eased(x / 0.3) * _eased((1.0 - x) / 0.3)
        elif bends[1] > bends[0]:
            part = np.full(len(ANGLES), _eased(x / 0.7))
            part[_THUMB] = _eased((x - 0.55) / 0.45)
        else:
            part = np.full(len(ANGLES), _eased((x - 0.3) / 0.7))
            part[_THUMB] = _eased(x / 0.45)
        return np.asarray((1.0 - away) * ((1.0 - part) * a + part * b) + away * self._open)

    def _mixed(self, before: int, after: int, part: float) -> Float64:
        change = self._values[after] - self._values[before]
        if abs(change[4]) > math.radians(200):  # a whole turn is where it began
            change[4] -= math.copysign(2 * math.pi, change[4])
        return np.asarray(self._values[before] + part * change)

    def _palm(self, at_s: float) -> Float64:
        before, after, x = self._where(at_s)
        pose = self._arm(self._postures[before], self._mixed(before, after, _eased(x)))
        return np.asarray(
            pose.T_camera_shoulder[:3, :3] @ self.mesh.frames(pose)[1][PALM] + pose.T_camera_shoulder[:3, 3]
        )

    def _arm(self, angles: Float64, values: Float64) -> ArmMeshPose:
        joints = self.start.joints + values[[0, 1, 2, 3]]
        for i, limits in enumerate((ELBOW_FLEXION_RAD, PRONATION_RAD, WRIST_FLEXION_RAD, WRIST_DEVIATION_RAD)):
            joints[i] = min(max(joints[i], limits[0]), limits[1])
        T = self.start.T_camera_shoulder.copy()
        T[:3, :3] = _about(values[5:8]) @ T[:3, :3]
        T[:3, 3] += values[8:11]
        roll = _about(np.array([0.0, 0.0, values[4]]))
        T[:3, :3], T[:3, 3] = roll @ T[:3, :3], self.middle + roll @ (T[:3, 3] - self.middle)
        return ArmMeshPose(angles, joints, T)


def _eased(x: float) -> float:
    """From 0 to 1 by the way of least jerk."""
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def posture_angles(posture: Posture, otherwise: Posture) -> Float64:
    """(21,) [rad]."""
    angles = np.zeros(len(ANGLES))
    for digit, row in zip(DIGITS, DIGIT_ANGLES, strict=True):
        values = getattr(posture, digit)
        angles[row[:4]] = np.radians(getattr(otherwise, digit) if values is None else values)
    return angles


def untangled(
    mesh: ArmMesh,
    wished: Float64,
    *,
    start: Float64 | None = None,
    touch: Float64 | None = None,
    flesh: tuple[Float64, float] | None = None,
) -> Float64:
    """(21,) the angles nearest to those wished at which no finger is in another [rad].

    Args:
        mesh: whose hand it is.
        wished: (21,) [rad].
        start: (21,) where to begin; at those wished, where not given.
        touch: (n, 3) two digits that shall touch, the thumb first and with its tip, and how much, 0 to 1.
        flesh: radii of the digits (5, 4) and half the palm's thickness [m]; the mesh's own where not given.
    """
    radii, palm_m = flesh or _flesh(mesh)
    angles, model, k = np.empty(len(ANGLES)), mesh.model, _kernels()
    hand = k.HandGeometry(
        model.frames, DIGIT_ANGLES, mesh.hand.bases, mesh.hand.lengths, model.cones, model.limits, radii, palm_m
    )
    start, touch = wished if start is None else start, np.zeros((0, 3)) if touch is None else touch
    k.untangle(hand, wished, start, touch, FLESH_GIVES_M, angles)
    return angles


def worst_overlap(mesh: ArmMesh, angles: Float64) -> float:
    """How far one finger is inside another, or in the palm, at most [m]; 0 where none is.

    Flesh is taken as tapered limbs about the bones; neighbouring fingers' first bones count from 45 % of their length.

    Args:
        mesh: whose hand it is.
        angles: (21,) [rad].
    """
    pose, k = ArmMeshPose(angles, np.zeros(4), np.eye(4)), _kernels()
    limbs, out = np.empty((19, 8)), np.empty(k.PAIRS)
    k.limbs_of(mesh.frames(pose)[1], *_flesh(mesh), limbs)
    k.overlaps(limbs, out)
    return max(float(out.max()), 0.0)


def _flesh(mesh: ArmMesh) -> tuple[Float64, float]:
    """Radii of the digits (5, 4) and half the palm's thickness [m]."""
    return mesh.shape.finger_radii, _PALM_HALF_M * (mesh.shape.hand_length_m / 0.189)


def held_at(mesh: ArmMesh, joints: Float64, R_camera_palm: Float64, at: Float64, which: int = PALM) -> ArmMeshPose:
    """The pose of a right arm, all of whose hand's angles are 0, one of whose points is at a place.

    Args:
        mesh: whose arm it is.
        joints: (4,) of `ArmMeshPose` [rad].
        R_camera_palm: (3, 3).
        at: (3,) in the camera's space [m].
        which: of `mocapella.model.arms.ARM_POINTS`, is there.
    """
    pose = ArmMeshPose(np.zeros(len(ANGLES)), np.asarray(joints, dtype=np.float64), np.eye(4))
    bones, points = mesh.frames(pose)
    R = R_camera_palm @ bones[3, :, :3].T
    return ArmMeshPose(pose.angles, pose.joints, rigid(R, at - R @ points[which]))


def _about(vector: Float64) -> Float64:
    """(3, 3) rotation by a vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K)


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sources.simulate import arm_motion_kernels

    return arm_motion_kernels
