"""Motion of a simulated arm through a sequence of key poses.

A scene's keys give the hand's posture and the arm's motion relative to its start. Between keys, motion has minimum jerk
(T. Flash, N. Hogan, 1985). Then fingers are moved as little as possible, within the joint limits, until no finger
penetrates another or the palm by more than soft tissue yields, and digits that are meant to touch do.
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
"""Smaller overlaps of fingers are accepted, because flesh yields [m]."""
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
    """A hand posture: for each digit, flexion and abduction of its base, flexion of its second and third joint [deg].

    A digit without values is as in ``open``.

    Attributes:
        touch: names of two digits that touch: the thumb, named first, and a finger with their tips, or two fingers with
            their sides; None for no contact.
        gesture: name of the gesture; empty for none.
    """

    thumb: tuple[float, float, float, float] | None = None
    index: tuple[float, float, float, float] | None = None
    middle: tuple[float, float, float, float] | None = None
    ring: tuple[float, float, float, float] | None = None
    little: tuple[float, float, float, float] | None = None
    touch: tuple[str, str] | None = None
    gesture: str = ""


class Key(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A key pose of the arm. Angles and shifts are relative to the start.

    Attributes:
        posture: name of the hand's posture, in the postures of `ArmMotion`.
        move_s: duration of the motion to this key [s].
        hold_s: duration of the pause at this key [s].
        elbow_deg, pronation_deg, wrist_deg, deviation_deg: joint angles, see `ArmMeshPose.joints` [deg].
        roll_deg: rotation of the whole arm about the viewing direction through `ArmMotion.middle`, clockwise [deg].
        turn_deg: rotation of the whole arm about its shoulder, as a rotation vector in the camera frame [deg].
        shift_m: translation of the whole arm, in the camera frame [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
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
    """The state of an arm at an instant.

    Attributes:
        pose: pose of a right arm; a left arm is its mirror image.
        gesture: name of the posture's gesture; empty if it has none, and during a motion between two gestures.
    """

    pose: ArmMeshPose
    gesture: str


class ArmMotion:
    """A right arm's pose at any time; a left arm's is its mirror image. The keys repeat forever.

    The constructor removes overlaps of fingers on the way to every key, which takes a while.

    Args:
        mesh: the arm.
        keys: key poses, at least one.
        postures: known postures by name; ``open`` must be among them and have values for all digits.
        start: the pose that the keys are relative to.
        middle: (3,) centre of the roll of `Key.roll_deg`, in the camera frame [m].
        rate: speed of the motion, relative to the keys' durations.
        peak_m_s: the palm's greatest speed, which replaces ``rate`` by a suitable one [m/s]; 0 keeps ``rate``.
        phase: start within the keys' period, from 0 to 1.
        amount_deg: standard deviation of the random change of each posture's angles [deg].
        seed: random seed of that change.

    Attributes:
        mesh, keys, start, middle: as given.
        period_s: period of the motion [s].

    Raises:
        SettingsError: a key has an unknown posture.
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
        """Return the state of the arm at a time of the scene [s]."""
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
        """Touching digits (2, 3) of the keys before and after, as for `untangled`; weights vanish between the keys."""
        touch = np.zeros((2, 3))
        for row, k, amount in ((0, before, 1.0 - part), (1, after, part)):
            pair = self._touches[k]
            if pair:
                touch[row] = *pair, amount**4
        return touch

    def _correction(self, after: int) -> Float64:
        """Corrections (nodes, 21) that keep fingers apart on the way to a key [rad], smooth in time.

        They are computed from both ends, because a finger can pass another on either side.
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
        """Indices of the keys before and after a time, and the elapsed share of the motion between them."""
        u = (at_s * self._rate + self._phase * float(self._ends[-1])) % float(self._ends[-1])
        k = min(int(np.searchsorted(self._ends, u, side="right")), len(self.keys) - 1)
        since = u - (float(self._ends[k - 1]) if k else 0.0)
        return (k - 1) % len(self.keys), k, min(since / self.keys[k].move_s, 1.0)

    def _settled(self, k: int) -> Float64:
        """A key's angles (21,) without overlaps; the thumb closes last, from outside."""
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
        """Angles (21,) between two keys before overlaps are removed.

        The thumb closes last and opens first. It moves aside while fingers move, if it is bent at both keys.
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
        if abs(change[4]) > math.radians(200):  # remove a whole turn
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
    """Minimum-jerk interpolation from 0 to 1."""
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def posture_angles(posture: Posture, otherwise: Posture) -> Float64:
    """Return the angles (21,) of a posture, in the order of `mocapella.model.hand.ANGLES` [rad].

    Digits without values are as in ``otherwise``, which must have them. The result is not limited to the joint limits.
    """
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
    """Find the angles (21,) nearest to the wished ones at which no finger penetrates another or the palm [rad].

    They are within the joint limits. Wished angles without overlap and without ``touch`` are only copied. The search is
    local: an overlap may remain, see `worst_overlap`.

    Args:
        mesh: mesh of the hand.
        wished: (21,) wished angles, in the order of `mocapella.model.hand.ANGLES` [rad].
        start: (21,) start of the search [rad]; None for the wished angles.
        touch: (n, 3) indices of two digits that must touch, and a weight from 0 to 1. The thumb (0) is first and
            touches with its tip; two fingers touch with their sides. None for no touch.
        flesh: radii of the capsules: of the digits (5, 4), and half the palm's thickness [m]; None for the mesh's own.
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
    """Return the largest overlap of a finger with another or with the palm [m]; 0 without any.

    The hand is modelled as tapered capsules around the bones; of each digit's first bone, the 45 % of its length next
    to the palm are ignored, since neighbouring digits merge there.

    Args:
        mesh: mesh of the hand.
        angles: (21,) in the order of `mocapella.model.hand.ANGLES` [rad].
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
    """Return the pose of a right arm with a flat hand (all angles 0), with one of its points at a known position.

    Args:
        mesh: the arm.
        joints: (4,) angles of `ArmMeshPose` [rad].
        R_camera_palm: (3, 3) orientation of the palm in the camera frame.
        at: (3,) position of the point in the camera frame [m].
        which: index of the point in `mocapella.model.arms.ARM_POINTS`.
    """
    pose = ArmMeshPose(np.zeros(len(ANGLES)), np.asarray(joints, dtype=np.float64), np.eye(4))
    bones, points = mesh.frames(pose)
    R = R_camera_palm @ bones[3, :, :3].T
    return ArmMeshPose(pose.angles, pose.joints, rigid(R, at - R @ points[which]))


def _about(vector: Float64) -> Float64:
    """Rotation (3, 3) by a rotation vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K)


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import arm_motion_kernels

    return arm_motion_kernels
