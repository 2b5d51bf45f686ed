"""Joint angles of people from the positions of their joints; docs/joint-angles.md has the definitions.

Segments have the axes of the International Society of Biomechanics: x forward, y up, z to the right. Angles are those
of Wu et al. (J. Biomech. 35, 2002, 543; 38, 2005, 981) and of Grood and Suntay (J. Biomech. Eng. 105, 1983, 136), named
and signed as OpenSim's coordinates where they mean the same. An angle is unknown where joints do not determine it: the
rotation of a thigh while the knee is straight, the forearm's without knuckles, the plane of an arm that hangs down.

The left side is computed as the right side of the mirrored person, so that a sign means the same on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.angles import wrap
from mocapella.geometry.segment_axes import (
    angles_yxz,
    angles_zxy,
    axes_along_y,
    axes_along_z,
    between,
    cross,
    swing_yx,
    swing_zx,
    twist_yxy,
    unit,
)
from mocapella.model.anatomy import Anatomy, anatomy_of, with_body
from mocapella.model.hand import DIGITS
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]
Points = Mapping[str, Float64]

STRAIGHT_RAD: Final = math.radians(20.0)
"""Flexion of a knee or elbow below which the rotation of thigh or upper arm is unknown [rad]."""
_FOLDED_RAD: Final = math.radians(170.0)
_STEP_M: Final = 1e-6
"""Displacement of a keypoint for the derivative of angles [m]."""
_FRAMES_AT_ONCE: Final = 8192


@dataclass(frozen=True, eq=False)
class JointAngles:
    """Joint angles of several individuals over time.

    Attributes:
        kind, times_s, runs, individuals, rate_hz, began_unix_ns, labels: as in `Trajectories`.
        names: names of the angles, such as ``knee_angle_r``.
        angles: (frames, individuals, angles) [rad]; NaN where unknown.
        states: (frames, individuals, angles) `JointState`: the least certain one of the joints that an angle is made
            of; not tracked where it is unknown.
        sd: (frames, individuals, angles) float32, standard deviation [rad]; NaN where unknown.
        pelvis: (frames, individuals, 3) midpoint of the hips [m]; NaN where unknown.
    """

    kind: str
    times_s: Float64
    runs: NDArray[np.int64]
    individuals: tuple[str, ...]
    names: tuple[str, ...]
    angles: Float64
    states: NDArray[np.uint8]
    sd: NDArray[np.float32]
    pelvis: Float64
    rate_hz: float = math.nan
    began_unix_ns: int = 0
    labels: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times_s)

    @classmethod
    def of(cls, trajectories: Trajectories, *, with_sd: bool = True) -> Self:
        """Return the joint angles of trajectories.

        Those with angles of their own (hands, arms and bodies) keep them: measured while any keypoint of the digit, or
        of the body, is measured, with an unknown standard deviation. Others have the angles that their keypoints
        determine, as docs/joint-angles.md defines them. Angles that begin with ``pelvis`` are in the frame of the
        trajectories, y up. The standard deviation is propagated to first order from the
        keypoints' ones; their errors count as independent and equal along all axes.

        Args:
            trajectories: the trajectories, at any times.
            with_sd: whether standard deviations are computed, which takes most of the time; otherwise they are NaN.

        Raises:
            SettingsError: the keypoints determine no angle; lists the topologies.
        """
        own = trajectories
        if own.angle_names:
            names, values = own.angle_names, (own.angles, _fitted_states(own), np.full(own.angles.shape, np.nan))
        else:
            names, values = _of_keypoints(own, with_sd)
        angles, states, sd = values
        return cls(
            own.kind, own.times_s, own.runs, own.individuals, names, angles, states, sd.astype(np.float32),
            _pelvis(own), own.rate_hz, own.began_unix_ns, own.labels,
        )  # fmt: skip


@dataclass(frozen=True)
class _Group:
    """Angles of one joint that need the same points.

    Attributes:
        names: names of the angles, without the side.
        points: names of anatomical points, without the side; ``other_hip`` is the other side's, ``up`` the lumbar
            point, or the chest of a topology without it, ``low`` the lumbar point or the pelvis.
        compute: their angles (..., angles), of points (..., 3).
        sided: whether there is one for each side.
    """

    names: tuple[str, ...]
    points: tuple[str, ...]
    compute: Callable[[Points], tuple[Float64, ...]]
    sided: bool = True


def _pelvis_axes(p: Points) -> Float64:
    return axes_along_z(p["hip"] - p["other_hip"], p["up"] - p["pelvis"])


def _chest_axes(p: Points) -> Float64:
    return axes_along_y(p["chest"] - p["low"], p["shoulder"] - p["other_shoulder"])


def _in(axes: Float64, direction: Float64) -> Float64:
    """Return directions (..., 3) in axes (..., 3, 3)."""
    return np.asarray(np.einsum("...ji,...j->...i", axes, direction))


def _relative(proximal: Float64, distal: Float64) -> Float64:
    return np.asarray(np.swapaxes(proximal, -1, -2) @ distal)


def _limb_axes(upper: Float64, lower: Float64, *, forward: bool) -> Float64:
    """Return axes of a thigh or upper arm, with z across the plane of upper and lower segment.

    Args:
        upper, lower: (..., 3) vectors of the upper and the lower segment, downwards.
        forward: whether the lower segment bends forward, as a forearm does, or backward.
    """
    normal = cross(upper, lower) if forward else cross(lower, upper)
    bend = between(upper, lower)
    seen = (bend >= STRAIGHT_RAD) & (bend <= _FOLDED_RAD)
    return axes_along_y(-upper, np.where(seen[..., None], normal, np.nan))


def _pelvis_angles(p: Points) -> tuple[Float64, ...]:
    axes = _pelvis_axes(p)
    return *angles_zxy(axes), *angles_yxz(axes)


def _lumbar_all(p: Points) -> tuple[Float64, ...]:
    return angles_zxy(_relative(_pelvis_axes(p), _chest_axes(p)))


def _lumbar_without_extension(p: Points) -> tuple[Float64, ...]:
    return _lumbar_all(p)[1:]


def _hip_swing(p: Points) -> tuple[Float64, ...]:
    return swing_zx(_in(_pelvis_axes(p), unit(p["hip"] - p["knee"])))


def _hip_rotation(p: Points) -> tuple[Float64, ...]:
    thigh = _limb_axes(p["knee"] - p["hip"], p["ankle"] - p["knee"], forward=False)
    return angles_zxy(_relative(_pelvis_axes(p), thigh))[2:]


def _knee(p: Points) -> tuple[Float64, ...]:
    return (between(unit(p["knee"] - p["hip"]), unit(p["ankle"] - p["knee"])),)


def _ankle(p: Points) -> tuple[Float64, ...]:
    rise = np.sum(unit(p["toe"] - p["back"]) * unit(p["knee"] - p["ankle"]), axis=-1)
    return (np.arcsin(np.clip(rise, -1.0, 1.0)),)


def _shoulder_swing(p: Points) -> tuple[Float64, ...]:
    y = _in(_chest_axes(p), unit(p["shoulder"] - p["elbow"]))
    return (*swing_zx(y), *swing_yx(y))


def _shoulder_rotation(p: Points) -> tuple[Float64, ...]:
    arm = _limb_axes(p["elbow"] - p["shoulder"], p["wrist"] - p["elbow"], forward=True)
    R = _relative(_chest_axes(p), arm)
    return angles_zxy(R)[2], twist_yxy(R)


def _elbow(p: Points) -> tuple[Float64, ...]:
    return (between(unit(p["elbow"] - p["shoulder"]), unit(p["wrist"] - p["elbow"])),)


def _forearm_axes(p: Points) -> Float64:
    return axes_along_y(p["elbow"] - p["wrist"], p["index"] - p["little"])


def _forearm(p: Points) -> tuple[Float64, ...]:
    arm = _limb_axes(p["elbow"] - p["shoulder"], p["wrist"] - p["elbow"], forward=True)
    return angles_zxy(_relative(arm, _forearm_axes(p)))[2:]


def _wrist(p: Points) -> tuple[Float64, ...]:
    flexion, deviation = swing_zx(_in(_forearm_axes(p), unit(p["wrist"] - 0.5 * (p["index"] + p["little"]))))
    return flexion, -deviation


_PELVIS: Final = ("hip", "other_hip", "pelvis", "up")
_CHEST: Final = ("shoulder", "other_shoulder", "chest", "low")
_ALL: Final = (
    _Group(("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_heading", "pelvis_obliquity",
            "pelvis_inclination"), _PELVIS, _pelvis_angles, sided=False),
    _Group(("hip_flexion", "hip_adduction"), (*_PELVIS, "knee"), _hip_swing),
    _Group(("hip_rotation",), (*_PELVIS, "knee", "ankle"), _hip_rotation),
    _Group(("knee_angle",), ("hip", "knee", "ankle"), _knee),
    _Group(("ankle_angle",), ("knee", "ankle", "back", "toe"), _ankle),
    _Group(("lumbar_extension", "lumbar_bending", "lumbar_rotation"), (*_PELVIS, *_CHEST, "lumbar"), _lumbar_all,
           sided=False),
    _Group(("lumbar_bending", "lumbar_rotation"), (*_PELVIS, *_CHEST), _lumbar_without_extension, sided=False),
    _Group(("arm_flex", "arm_add", "shoulder_plane", "shoulder_elevation"), (*_CHEST, "elbow"), _shoulder_swing),
    _Group(("arm_rot", "shoulder_rotation"), (*_CHEST, "elbow", "wrist"), _shoulder_rotation),
    _Group(("elbow_flex",), ("shoulder", "elbow", "wrist"), _elbow),
    _Group(("forearm_pronation",), ("shoulder", "elbow", "wrist", "index", "little"), _forearm),
    _Group(("wrist_flexion", "wrist_deviation"), ("elbow", "wrist", "index", "little"), _wrist),
)  # fmt: skip
_NO_SIDE: Final = frozenset({"pelvis", "lumbar", "chest"})


@dataclass(frozen=True)
class _Measured:
    """A group of one side, and the anatomical point of each of its points."""

    group: _Group
    names: tuple[str, ...]
    points: Mapping[str, str]
    mirrored: bool


def _measured(anatomy: Anatomy) -> Iterator[_Measured]:
    """Yield the groups whose points are known, the right side first, each angle once."""
    done: set[str] = set()
    for side, other in (("r", "l"), ("l", "r")):
        for group in _ALL:
            ending = f"_{side}" if group.sided else ""
            names = tuple(name + ending for name in group.names)
            points = {point: _anatomical(point, side, other, anatomy) for point in group.points}
            if done.isdisjoint(names) and all(point in anatomy for point in points.values()):
                done.update(names)
                yield _Measured(group, names, points, side == "l")


def _anatomical(point: str, side: str, other: str, anatomy: Anatomy) -> str:
    middle = "lumbar" in anatomy
    instead = {
        "up": "lumbar" if middle else "chest",
        "low": "lumbar" if middle else "pelvis",
        "back": "heel" if f"heel_{side}" in anatomy else "ankle",
    }
    name = instead.get(point, point)
    if name in _NO_SIDE:
        return name
    return f"{name.removeprefix('other_')}_{other}" if name.startswith("other_") else f"{name}_{side}"


def _of_keypoints(
    own: Trajectories, with_sd: bool
) -> tuple[tuple[str, ...], tuple[Float64, NDArray[np.uint8], Float64]]:
    anatomy = anatomy_of(own.keypoints)
    groups = list(_measured(anatomy))
    if not groups:
        raise SettingsError(
            f"no joint angles: the keypoints of {own.kind} are of no body; topologies with one: "
            f"{', '.join(with_body())}"
        )
    names = tuple(name for group in groups for name in group.names)
    shape = (len(own), len(own.individuals), len(names))
    angles, sd, states = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, np.uint8)
    for begin in range(0, len(own), _FRAMES_AT_ONCE):
        some, at = slice(begin, begin + _FRAMES_AT_ONCE), 0
        for group in groups:
            to = slice(at, at + len(group.names))
            at = to.stop
            points = {point: _mean(anatomy[name], own.positions[some]) for point, name in group.points.items()}
            weights: dict[int, dict[str, float]] = {}
            for point, name in group.points.items():
                for k, weight in anatomy[name].items():
                    weights.setdefault(k, {})[point] = weight
            values = angles[some, :, to] = _angles(group, points)
            least = own.states[some][..., list(weights)].min(axis=2)[..., None]
            states[some, :, to] = np.where(np.isfinite(values), least, JointState.NOT_TRACKED)
            if with_sd:
                sd[some, :, to] = _sd(group, points, values, own.sd[some], weights)
    return names, (angles, states, sd)


def _angles(group: _Measured, points: Points) -> Float64:
    """Return the angles (..., angles) of the group's points (..., 3)."""
    if group.mirrored:
        points = {point: value * (-1.0, 1.0, 1.0) for point, value in points.items()}
    return np.stack(group.group.compute(points), axis=-1)


def _mean(terms: Mapping[int, float], positions: NDArray[np.floating]) -> Float64:
    return np.asarray(sum(np.float64(weight) * positions[..., k, :] for k, weight in terms.items()))


def _sd(
    group: _Measured,
    points: Points,
    values: Float64,
    sd: NDArray[np.float32],
    weights: Mapping[int, Mapping[str, float]],
) -> Float64:
    """Return the standard deviations (..., angles), by forward differences.

    They are not central: at the end of its range, a straight knee's flexion would have the derivative 0.

    Args:
        group, points, values: the group, its points (..., 3) and their angles (..., angles).
        sd: (..., keypoints) of the keypoints.
        weights: for each keypoint that contributes, its weight in each point.
    """
    variance = np.zeros(values.shape)
    if not np.isfinite(sd[..., list(weights)]).all(axis=-1).any():
        return variance + np.nan
    for k, of_points in weights.items():
        for axis in range(3):
            step = _STEP_M * np.eye(3)[axis]
            shifted = {**points, **{point: points[point] + weight * step for point, weight in of_points.items()}}
            slope = wrap(_angles(group, shifted) - values) / _STEP_M
            variance += (slope * sd[..., k, None]) ** 2
    return np.asarray(np.sqrt(variance))


def _pelvis(own: Trajectories) -> Float64:
    anatomy = anatomy_of(own.keypoints)
    if not {"hip_r", "hip_l"} <= anatomy.keys():
        return np.full((len(own), len(own.individuals), 3), np.nan)
    return 0.5 * (_mean(anatomy["hip_r"], own.positions) + _mean(anatomy["hip_l"], own.positions))


def _fitted_states(own: Trajectories) -> NDArray[np.uint8]:
    """Return the states of angles that a model was fitted with."""
    states = np.zeros(own.angles.shape, np.uint8)
    for k, name in enumerate(own.angle_names):
        digit = name.split(" ")[0]
        of_digit = [i for i, point in enumerate(own.keypoints) if digit in DIGITS and point.startswith(f"{digit} ")]
        used = of_digit or list(range(len(own.keypoints)))
        measured = (own.states[..., used] == JointState.TRACKED).any(axis=2)
        states[..., k] = np.where(measured, JointState.TRACKED, JointState.INFERRED)
    return np.where(np.isfinite(own.angles), states, np.uint8(JointState.NOT_TRACKED))
