"""A hand mesh to fit to images: its palm moves freely, and its fingers have 21 angles.

    hand = hand_mesh(hand_model("full").shape("left", hand_length_m=0.18))

**Rest**: the palm's frame of `mocapella.model.hand`, mirrored for a left hand; the fingers apart, at `REST_ANGLES`. The
tree's angles are relative to that posture, and ordered differently from `mocapella.model.hand.ANGLES`. Limits apply to
each angle alone.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.limb_surface import group_distances, polygonise
from mocapella.geometry.twists import revolute
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, DIGITS, LANDMARKS, HandShape, hand_model
from mocapella.model.hand_flesh import (
    BETWEEN_M,
    CORE,
    REST_ANGLES,
    WITHIN_M,
    digits_at_rest,
    finger_radii,
    hand_limbs,
    hand_weights,
)
from mocapella.model.rigged_mesh import Landmark, RiggedMesh, strongest
from mocapella.model.twist_tree import twist_tree
from mocapella.settings import check

Float64 = NDArray[np.float64]

HAND_PARTS: Final = ("palm", *(f"{digit} {bone}" for digit in DIGITS for bone in ("first", "second", "last")))
DETAIL: Final = (0.9, 3.0)
_REFERENCE_M: Final = 0.189, 0.085
_STUB: Final = ((0.010, 0.0095, 0.0160), (-0.015, 0.0100, 0.0166))
"""The reference hand's forearm: length, half distance of its two bones, radius [m]."""


def hand_mesh(shape: HandShape, thickness: float = 1.0, detail: float = 1.0) -> RiggedMesh:
    """Return the mesh of a hand and the end of its forearm, made anew at each call; it is deterministic.

    Its tree has 16 parts, `HAND_PARTS`, and 21 joint angles, relative to `REST_ANGLES` (see `hand_mesh_angles`). Its
    landmarks have the names `mocapella.model.hand.LANDMARKS`.

    Args:
        shape: the person's bones.
        thickness: thickness of the fingers, relative to the average for that length of hand; 0.7 to 1.3.
        detail: factor of the number of vertices along a line; 0.9 to 3.

    Raises:
        SettingsError: thickness or detail out of range.
    """
    check(0.7 <= thickness <= 1.3, "thickness", thickness, "0.7 to 1.3")
    check(DETAIL[0] <= detail <= DETAIL[1], "detail", detail, f"{DETAIL[0]} to {DETAIL[1]}")
    model = hand_model("full")
    bones, digits = digits_at_rest(model, shape)
    length = float(shape.bases[2, 2] + shape.lengths[2].sum())
    reference = model.shape("right")
    spread = float(np.ptp(shape.bases[1:, 0]) / np.ptp(reference.bases[1:, 0]))
    places = np.vstack([np.zeros(3), digits])
    rows = hand_limbs(
        places, finger_radii(length, thickness), hand_length_m=length, hand_breadth_m=spread * _REFERENCE_M[1]
    )
    big = length / _REFERENCE_M[0]
    for (z0, x0, r0), (z1, x1, r1) in pairwise(_STUB):
        rows += [[*np.multiply(big, [side * x0, 0, z0, side * x1, 0, z1, r0, r1]), CORE] for side in (-1.0, 1.0)]
    limbs = np.array(sorted(rows, key=lambda row: row[8]))
    blend = max(1.0, big)  # limbs of a large hand are farther apart: there would be holes between its knuckles
    within = blend * np.array(WITHIN_M)
    vertices, faces = polygonise(limbs, within, blend * BETWEEN_M, _grid(limbs, 0.0034 * big / detail))
    distance = group_distances(limbs, within, vertices)
    moved_by, shares = strongest(hand_weights(vertices, distance, bones, hand_length_m=length))
    twists, joint_parts, limits, names = _joints(bones)
    M = shape.mirror
    left = shape.handedness == "left"
    if left:  # a mirrored rotation's axis is a pseudovector, so it is reversed
        axes, points = twists[:, 3:] * -M, np.cross(twists[:, 3:], twists[:, :3]) * M
        twists = revolute(axes, points)
    part_of = [0, *(1 + 3 * (k // 4) + max(k % 4 - 1, 0) if k % 4 else 0 for k in range(20))]
    named = zip(LANDMARKS, part_of, places, strict=True)
    return RiggedMesh(
        name=f"{shape.handedness} hand",
        tree=twist_tree([-1, *(0 if k % 3 == 0 else k for k in range(15))], joint_parts, twists, limits),
        part_names=HAND_PARTS,
        joint_names=tuple(names),
        vertices=vertices * M,
        faces=np.ascontiguousarray(faces[:, ::-1] if left else faces).astype(np.int32),
        bones=moved_by,
        shares=shares,
        landmarks={name: Landmark(part, place * M) for name, part, place in named},
    )  # fmt: skip


def hand_mesh_angles(mesh: RiggedMesh, angles: Float64) -> Float64:
    """Convert a hand's angles (..., 21), in the order of `mocapella.model.hand.ANGLES`, to a mesh's angles [rad].

    A mesh of `hand_mesh` has another order, and angles relative to `REST_ANGLES`. Limits are not applied.
    """
    order = [ANGLES.index(name) for name in mesh.joint_names]
    return np.asarray((np.asarray(angles) - REST_ANGLES)[..., order])


def _joints(bones: Float64) -> tuple[Float64, list[int], Float64, list[str]]:
    """Return twists, parts, limits [rad] and names; a bone's abduction precedes its flexion."""
    model = hand_model("full")
    twists, parts, chosen = [], [], []
    for digit, (flexion, abduction, middle, last, thumb) in enumerate(DIGIT_ANGLES.tolist()):
        turns = [(0, 1, abduction), (0, 0, flexion), (1, 1, thumb), (1, 0, middle), (2, 0, last)]
        for bone, axis, angle in turns:
            if angle >= 0:
                T = bones[3 * digit + bone]
                twists.append(revolute(T[:, axis], T[:, 3]))
                parts.append(1 + 3 * digit + bone)
                chosen.append(angle)
    limits = model.limits[chosen] - REST_ANGLES[chosen][:, None]
    return np.array(twists), parts, limits, [ANGLES[angle] for angle in chosen]


def _grid(limbs: Float64, step: float) -> Float64:
    """Return (a, b, c, 3) grid nodes: fine across the fingers, so that they stay apart."""
    r = limbs[:, 6:8].max(axis=1)[:, None]
    low = (np.minimum(limbs[:, :3], limbs[:, 3:6]) - r).min(axis=0)
    high = (np.maximum(limbs[:, :3], limbs[:, 3:6]) + r).max(axis=0)
    steps = step * np.array([1.0, 1.4, 2.0])
    axes = [np.arange(a - 3 * s, b + 3 * s, s) for a, b, s in zip(low, high, steps, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
