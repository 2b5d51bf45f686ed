"""Start poses of fits of a hand to a depth image: an open hand or a fist, at a palm that was detected."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.arm_fit import ArmModel, ArmPose
from mocapella.kinematics.arm_fit import kernels as fit_kernels
from mocapella.sensing.arm_region import PalmCandidate

Float64 = NDArray[np.float64]


def fists_behind_fingers(model: ArmModel, candidate: PalmCandidate) -> Iterator[ArmPose]:
    """Yield fists whose palm faces the camera, behind the candidate: the surface of such a palm is that of its fingers.

    There are none if four or more ends of branches are seen.
    """
    opened = _posed(model, _OPEN)
    for start, tips in arm_starts(model, candidate):
        R = start.R.reshape(3, 3)
        away = float(R[:, 1] @ candidate.centre) / float(np.linalg.norm(candidate.centre))
        if tips is None and away > 0.5 and not np.array_equal(start.z, opened):  # y points to the back of the hand
            yield start._replace(t=start.t + _FINGERS_M * R[:, 1])


def arm_starts(model: ArmModel, candidate: PalmCandidate) -> Iterator[tuple[ArmPose, Float64 | None]]:
    """Yield poses to start fits from, and target positions of fingertips.

    The palm or the back of the hand faces the camera, along the forearm. Detected tips are in the order of the digits;
    if they are fewer than five, every choice of digits is tried, and the others are bent. Without tips the hand is a
    fist, or seen from its side.
    """
    normal, tips = candidate.normal, candidate.tips
    edge_on = candidate.radius_m < _EDGE_ON_M
    for z_axis in _pointing(candidate):
        y_axis = _across(normal, z_axis, candidate.centre)
        for roll in _ROLLS:
            y = np.cos(roll) * y_axis + np.sin(roll) * np.cross(z_axis, y_axis)
            R = np.stack([np.cross(y, z_axis), y, z_axis], axis=1)
            t = candidate.centre - 0.012 * normal - R @ (0.5 * model.shape.bases[2] * model.shape.mirror)
            v = model.state()
            if candidate.forearm is not None:
                v[4:7] = R.T @ candidate.forearm
                # The upper arm points back to the shoulder, away from the camera.
                back = 0.5 * candidate.forearm + candidate.centre / np.linalg.norm(candidate.centre)
                v[7:10] = R.T @ (back / np.linalg.norm(back))
            turned = np.ascontiguousarray(R).reshape(9)
            if roll in _FLAT or len(tips) < 2:
                # Seen from its back, a right hand's digits are in clockwise order from the thumb.
                clockwise = (np.cos(roll) > 0) == (model.mirror > 0)
                ordered = tips[::-1] if clockwise else tips
                for digits in combinations(range(5), len(tips)):
                    z = _posed(model, tuple(_OPEN[d] if d in digits else _BENT[d] for d in range(5)))
                    targets = np.full((5, 3), np.nan)
                    targets[list(digits)] = ordered
                    yield ArmPose(turned, t.copy(), z, v.copy()), targets
            if len(tips) < 2 or (edge_on and roll not in _FLAT):
                for shift in _SHIFTS_M:
                    for postures in (_OPEN, _BENT, _HOLDING):
                        yield ArmPose(turned, t + shift * z_axis, _posed(model, postures), v.copy()), None
            elif roll in _FLAT and len(tips) < 4:
                # The ends of branches may be a fist's knuckles, or noise beside it.
                for shift in _FIST_SHIFTS_M:
                    yield ArmPose(turned, t + shift * z_axis, _posed(model, _BENT), v.copy()), None


def _pointing(candidate: PalmCandidate) -> list[Float64]:
    """Return directions of the hand: away from the forearm, else to the fingertips, else any across the normal."""
    normal, tips = candidate.normal, candidate.tips
    if candidate.forearm is not None:
        return [-candidate.forearm]
    if len(tips) >= 2:
        mean = tips.mean(axis=0) - candidate.centre
        return [mean / np.linalg.norm(mean)]
    across = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(normal, across)
    return [np.cos(a) * across + np.sin(a) * other for a in np.arange(6) * np.pi / 3]


def _across(normal: Float64, z_axis: Float64, centre: Float64) -> Float64:
    """Return the normal's component across the hand's axis; if it is too small, that of the viewing direction."""
    for direction in (normal, -centre / np.linalg.norm(centre), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        across = direction - (direction @ z_axis) * z_axis
        length = float(np.linalg.norm(across))
        if length > 0.3:
            break
    return np.asarray(across / length)


def _posed(model: ArmModel, flexions: tuple[tuple[int, int, int], ...]) -> Float64:
    z = model.natural.copy()
    for digit, held in enumerate(flexions):
        model.hold(z, digit, *held)
    fit_kernels().within(model.digits, model.columns, model.gains, z, model.c_max)
    return z


_FLAT: Final = (0.0, np.pi)
_EDGE_ON_M: Final = 0.026
"""A hand whose largest inscribed circle has a smaller radius may be seen from its side [m]."""
_ROLLS: Final = (*_FLAT, 0.5 * np.pi, -0.5 * np.pi)
_OPEN: Final = ((0, 0, 10), *[(5, 0, 8)] * 4)
_BENT: Final = ((0, 0, 40), *[(70, 0, 85)] * 4)
_HOLDING: Final = ((10, -15, 40), *[(45, 0, 60)] * 4)
"""Flexion, abduction and second flexion of thumb to little finger [degrees]."""
_FINGERS_M: Final = 0.035
"""Distance from a palm to the surface of the fingers that are bent in front of it [m]."""
_SHIFTS_M: Final = (-0.03, 0.0, 0.03)
_FIST_SHIFTS_M: Final = (0.0, 0.04)
"""Offsets of initial poses along the hand [m]: without visible fingers its centre is less certain. The middle of a fist
may be taken for its wrist, which is wider where the palm has holes."""
