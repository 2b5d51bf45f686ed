"""Values to begin the adjustment of cameras with: poses along a tree of pairs, and triangulated joints.

Each pair of cameras has the scale at which the people that it sees have bones of typical length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_bundle import BONES, STATURES
from mocapella.calibration.keypoint_pairs import CameraPair
from mocapella.calibration.keypoint_tracks import JOINTS
from mocapella.geometry.essential import triangulate_pair
from mocapella.geometry.rigid import inverse

Float64 = NDArray[np.float64]

LEAST_ANGLE_RAD: Final = np.radians(4.0)
"""Angle of the rays of two cameras below which they count as at one place [rad]."""
_WIDE_RAD: Final = np.radians(25.0)
"""Angle above which all pairs are equally good [rad]."""


def spanning_tree(pairs: Mapping[tuple[int, int], CameraPair], cameras: int) -> list[tuple[int, int]]:
    """Return the pairs of a tree from camera 0: (known, new) cameras, the best pairs first (Prim 1957).

    Cameras that no pair reaches are missing.
    """
    known, tree = {0}, list[tuple[int, int]]()
    while True:
        edges = [
            (-_worth(pair), a, b) if a in known else (-_worth(pair), b, a)
            for (a, b), pair in pairs.items()
            if (a in known) != (b in known)
        ]
        if not edges or len(known) == cameras:
            return tree
        _, one, new = min(edges)
        known.add(new)
        tree.append((one, new))


def _worth(pair: CameraPair) -> float:
    wide = np.clip(np.sin(pair.angle_rad) / np.sin(_WIDE_RAD), 0.05, 1.0)
    return float(pair.score * pair.share * wide)


def tree_poses(
    pairs: Mapping[tuple[int, int], CameraPair], directions: Sequence[Float64], passages: NDArray[np.int64],
    tree: Sequence[tuple[int, int]], stature: float,
) -> dict[int, Float64]:  # fmt: skip
    """Return ``T_camera_first`` of each camera of the tree; the scale is that of people of a stature.

    Args:
        pairs: relative poses and matches.
        directions: (tracks, instants, 26, 2) directions of the keypoints of each camera.
        passages: (instants,) number of the passage of each instant.
        tree: pairs from the first camera outwards, as `spanning_tree` returns them.
        stature: typical stature of the people [m].
    """
    poses = {0: np.eye(4)}
    for known, new in tree:
        a, b = min(known, new), max(known, new)
        pair = pairs[a, b]
        T_b_a = pair.T_b_a.copy()
        T_b_a[:3, 3] *= pair_scale(pair, directions[a], directions[b], passages, stature)
        poses[new] = (T_b_a if known == a else inverse(T_b_a)) @ poses[known]
    return poses


def pair_scale(pair: CameraPair, a: Float64, b: Float64, passages: NDArray[np.int64], stature: float) -> float:
    """Return the length of a pair's translation at which its people have bones of typical length [m].

    Args:
        pair: relative pose with a translation of length 1, and matches.
        a, b: (tracks, instants, 26, 2) directions of both cameras.
        passages: (instants,) number of the passage of each instant.
        stature: typical stature of the people [m].
    """
    ratios = []
    for passage, matches in pair.matches.items():
        at = passages == passage
        for i, j in matches:
            joints, depths = triangulate_pair(pair.T_b_a, a[i, at].reshape(-1, 2), b[j, at].reshape(-1, 2))
            joints[~(depths > 0).all(axis=1)] = np.nan
            joints = joints.reshape(-1, JOINTS, 3)
            for one, other, which in BONES:
                length = np.linalg.norm(joints[:, one] - joints[:, other], axis=-1)
                ratios.append(STATURES[which] * stature / length[np.isfinite(length) & (length > 0)])
    found = np.concatenate(ratios) if ratios else np.zeros(0)
    return float(np.median(found)) if len(found) else 1.0


def triangulate_rays(origins: Float64, rays: Float64, weights: Float64, rounds: int = 4) -> Float64:
    """Return the points nearest to several rays each, with less weight for rays that pass at a distance.

    Args:
        origins: (cameras, 3) [m].
        rays: (points, cameras, 3) unit directions; NaN where a camera does not see the point.
        weights: (points, cameras) weights.
        rounds: number of times the weights are renewed (Cauchy, with a scale of 2 % of the distance).

    Returns:
        (points, 3) [m]; NaN for fewer than two rays.
    """
    seen = np.asarray(np.isfinite(rays).all(axis=-1))
    d = np.where(seen[..., None], rays, 0.0)
    across = np.eye(3) - d[..., :, None] * d[..., None, :]
    w = np.where(seen, weights, 0.0)
    points = np.full((len(rays), 3), np.nan)
    usable = seen.sum(axis=1) >= 2
    for _ in range(rounds):
        A = np.einsum("nc,ncij->nij", w[usable], across[usable]) + 1e-9 * np.eye(3)
        right = np.einsum("nc,ncij,cj->ni", w[usable], across[usable], origins)
        points[usable] = np.linalg.solve(A, right[..., None])[..., 0]
        off = points[:, None] - origins
        miss = np.linalg.norm(np.einsum("ncij,ncj->nci", across, off), axis=-1)
        scale = 0.02 * np.linalg.norm(off, axis=-1)
        w = np.where(seen, weights / (1.0 + (miss / np.maximum(scale, 1e-9)) ** 2), 0.0)
    return points
