"""Percentage of correct parts (PCP) of people in space, the score of public recordings of several people.

A limb is correct if the mean of the errors of its two ends is at most half of its true length: V. Ferrari et al.,
*Progressive Search Space Reduction for Human Pose Estimation*, CVPR 2008; in space V. Belagiannis et al., *3D Pictorial
Structures for Multiple Human Pose Estimation*, CVPR 2014, whose 14 joints these are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocapella.errors import SettingsError
from mocapella.model.topology import topology
from mocapella.settings import check

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

JOINTS: Final = (
    "RAnkle", "RKnee", "RHip", "LHip", "LKnee", "LAnkle", "RWrist", "RElbow", "RShoulder", "LShoulder", "LElbow",
    "LWrist", "Neck", "Head",
)  # fmt: skip
"""The 14 joints, in the order of the Leeds Sports Poses; ``Neck`` is its top or bottom as the reference has it."""
PARTS: Final[Mapping[str, tuple[tuple[tuple[int, ...], int], ...]]] = {
    "upper arms": (((8,), 7), ((9,), 10)),
    "lower arms": (((7,), 6), ((10,), 11)),
    "upper legs": (((2,), 1), ((3,), 4)),
    "lower legs": (((1,), 0), ((4,), 5)),
    "torso": (((2, 3), 12),),
    "head": (((12,), 13),),
}
"""Limbs of each part: the joints whose mean is its first end, and its other end."""
LIMBS: Final = tuple(limb for limbs in PARTS.values() for limb in limbs)


class Pcp(msgspec.Struct, frozen=True):
    """Shares of correct limbs, 0 to 1; NaN without a reference.

    Attributes:
        actors: of each actor.
        parts: of each part of `PARTS`, over all actors.
        mean: mean over the actors.
    """

    actors: tuple[float, ...]
    parts: dict[str, float]
    mean: float


def correct_limbs(true: Float64, found: Float64, share: float = 0.5) -> tuple[Bools, Bools]:
    """Compare the limbs of skeletons.

    Args:
        true: (..., 14, 3) in the order of `JOINTS` [m]; NaN where there is no reference.
        found: (..., 14, 3) [m]; NaN where not found.
        share: largest mean error of the two ends, relative to the limb's true length.

    Returns:
        (..., 10) whether each of `LIMBS` is correct, and whether it has a reference. A limb that is not found is not
        correct.

    Raises:
        SettingsError: the arrays have no 14 joints, or the share is not above 0.
    """
    check(share > 0, "share", share, "above 0")
    for name, array in (("true", true), ("found", found)):
        if array.shape[-2:] != (len(JOINTS), 3):
            raise SettingsError(f"{name} has the shape {array.shape}; it wants (..., {len(JOINTS)}, 3)")
    error_a, error_b, length = [], [], []
    for first, last in LIMBS:
        a, a_found = true[..., list(first), :].mean(axis=-2), found[..., list(first), :].mean(axis=-2)
        error_a.append(np.linalg.norm(a - a_found, axis=-1))
        error_b.append(np.linalg.norm(true[..., last, :] - found[..., last, :], axis=-1))
        length.append(np.linalg.norm(a - true[..., last, :], axis=-1))
    lengths = np.stack(length, axis=-1)
    mean = (np.stack(error_a, axis=-1) + np.stack(error_b, axis=-1)) / 2
    known = np.isfinite(lengths)
    with np.errstate(invalid="ignore"):
        return np.asarray(known & (mean <= share * lengths)), known


def pcp(true: Float64, found: list[Float64], share: float = 0.5) -> Pcp:
    """Compute the PCP of actors over frames.

    In each frame actors and found people are matched one to one, so that most limbs are correct.

    Args:
        true: (actors, frames, 14, 3) [m]; NaN where an actor or a joint has no reference.
        found: for each frame the found people (people, 14, 3) [m].
        share: see `correct_limbs`.

    Raises:
        SettingsError: the numbers of frames or joints differ.
    """
    if true.ndim != 4 or len(found) != true.shape[1]:
        raise SettingsError(f"true has the shape {true.shape}; it wants (actors, {len(found)}, {len(JOINTS)}, 3)")
    _, known = correct_limbs(true, np.full(true.shape, np.nan), share)
    hits, cases = np.zeros((len(true), len(LIMBS))), known.sum(axis=1)
    for t, people in enumerate(found):
        if len(people):
            right, _ = correct_limbs(true[:, t][:, None], people[None], share)
            i, j = linear_sum_assignment(right.sum(axis=-1), maximize=True)
            hits[i] += right[i, j]
    with np.errstate(invalid="ignore", divide="ignore"):
        actors = hits.sum(axis=1) / cases.sum(axis=1)
        limbs = hits.sum(axis=0) / cases.sum(axis=0)
    parts, at = {}, 0
    for name, ends in PARTS.items():
        parts[name] = float(np.mean(limbs[at : at + len(ends)]))
        at += len(ends)
    known_actors = actors[np.isfinite(actors)]
    return Pcp(tuple(actors.tolist()), parts, float(known_actors.mean()) if len(known_actors) else float("nan"))


def joints_of_halpe(positions: Float64) -> Float64:
    """Return the 14 joints (..., 14, 3) of skeletons (..., 26, 3) of the topology ``halpe_26``."""
    return positions[..., [topology("halpe_26").index(name) for name in JOINTS], :]
