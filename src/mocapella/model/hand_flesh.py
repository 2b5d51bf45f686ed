"""A hand's surface at rest, as tapered limbs for `mocapella.geometry.limb_surface`.

Positions are a right hand's, in the palm's frame, see `mocapella.model.hand`.

**Fingertips.** A fingertip's landmark is that of the hand's model, on the axis of the last bone. With r the radius of
the fingertip, the surface ends 0.6 r beyond it: the centre of the last limb's round end is 0.4 r before the landmark.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.hand import ANGLES, DIGIT_ANGLES, DIGITS, HandModel, HandShape
from mocapella.model.rigged_mesh import smooth

Float64 = NDArray[np.float64]

BEYOND_TIP: Final = 0.6
"""Distance from a fingertip's landmark to the end of its surface, relative to the fingertip's radius."""


def _rest_angles() -> Float64:
    angles = np.zeros(len(ANGLES))
    angles[DIGIT_ANGLES[1:, 1]] = np.radians([7.0, 0.0, -8.0, -14.0])
    return angles


REST_ANGLES: Final = _rest_angles()
"""(21,) angles of a posture whose fingers do not touch, in the order of `mocapella.model.hand.ANGLES` [rad]."""
FINGER_RADII_MM: Final = (
    (12.5, 10.6, 9.3, 8.4),
    (9.7, 8.7, 7.6, 6.8),
    (9.8, 8.9, 7.7, 6.9),
    (9.2, 8.3, 7.2, 6.5),
    (8.2, 7.2, 6.3, 5.7),
)
"""Radii of the digits, thumb to little finger, at the three joints and the tip, for the reference's length [mm].

Breadths of index finger and thumb are from T. Greiner,
*Hand anthropometry of U.S. Army personnel* (1991), the others in proportion."""
THENAR, CORE, GROUPS = 5, 6, 7
"""Groups of limbs after the five digits: thenar (moves with the thumb), and the rest; number of all groups."""
WITHIN_M: Final = (0.003, 0.002, 0.002, 0.002, 0.002, 0.008, 0.010)
BETWEEN_M: Final = 0.006
"""Blending radii between limbs of a group, and between groups [m]; `mocapella.model.hand_mesh` scales them up for hands
of more than average length."""


def finger_radii(hand_length_m: float, thickness: float = 1.0) -> Float64:
    """Return the radii (5, 4) of the digits at their three joints and tips [m].

    Args:
        hand_length_m: from the wrist to the tip of the middle finger [m].
        thickness: thickness of the fingers, relative to the average for that length.
    """
    return 1e-3 * hand_length_m / 0.189 * thickness * np.array(FINGER_RADII_MM)


def digits_at_rest(model: HandModel, hand: HandShape) -> tuple[Float64, Float64]:
    """Return the digits' bones and joints in the palm's frame, at `REST_ANGLES`.

    Returns:
        The upper rows of ``T_palm_bone`` (15, 3, 4) of each bone, thumb first; positions (20, 3) of joints and tips,
        the landmarks after the wrist [m].
    """
    bones, places = np.empty((15, 3, 4)), np.empty((20, 3))
    for d in range(len(DIGITS)):
        c, s = np.cos(REST_ANGLES[DIGIT_ANGLES[d, 1]]), np.sin(REST_ANGLES[DIGIT_ANGLES[d, 1]])
        R = model.frames[d] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        ends = hand.bases[d] + np.r_[0.0, np.cumsum(hand.lengths[d])][:, None] * R[:, 2]
        places[4 * d : 4 * d + 4] = ends
        bones[3 * d : 3 * d + 3, :, :3], bones[3 * d : 3 * d + 3, :, 3] = R, ends[:3]
    return bones, places


def hand_limbs(places: Float64, radii: Float64, *, hand_length_m: float, hand_breadth_m: float) -> list[list[float]]:
    """Return the hand's tapered limbs, not sorted by group.

    A row has nine numbers: both ends [m], the radii there [m], and the group; see `mocapella.geometry.limb_surface`.

    Args:
        places: (21 or more, 3) landmarks of the hand at rest, in the palm's frame [m].
        radii: (5, 4) of `finger_radii` [m].
        hand_length_m, hand_breadth_m: from the wrist to the tip of the middle finger; across the knuckles [m].
    """
    big, wide = hand_length_m / 0.189, hand_breadth_m / 0.085
    mm = 1e-3 * big
    rows: list[list[float]] = []

    def add(group: int, a: Any, b: Any, ra: float, rb: float) -> None:
        rows.append([*map(float, a), *map(float, b), ra, rb, group])

    for digit in range(5):
        joints = places[1 + 4 * digit : 5 + 4 * digit]
        r = radii[digit]
        for bone in range(2):
            middle, waist = 0.5 * (joints[bone] + joints[bone + 1]), 0.49 * (r[bone] + r[bone + 1])
            add(digit, joints[bone], middle, r[bone], waist)
            add(digit, middle, joints[bone + 1], waist, r[bone + 1])
        along = (joints[3] - joints[2]) / np.linalg.norm(joints[3] - joints[2])
        add(digit, joints[2], joints[3] - (1.0 - BEYOND_TIP) * r[3] * along, r[2], r[3])
    bases = places[[1, 5, 9, 13, 17]]
    # The palm: metacarpals, thicker towards the wrist and lower than the knuckles.
    carpus = np.array([[13.0 * wide / big, -3, 10], [4, -3, 10], [-5, -3, 10], [-13 * wide / big, -3, 12]]) * mm
    for base, carpal, r in zip(bases[1:], carpus, (12.0, 12.2, 11.5, 10.3), strict=True):
        middle = 0.45 * carpal + 0.55 * base + [0.0, -1.5 * mm, 0.0]
        add(CORE, carpal, middle, 14.0 * mm, 11.8 * mm)
        add(CORE, middle, base + mm * np.array([0.0, -1.0, -2.0]), 11.8 * mm, r * mm)
    thumb, index, little = bases[0], bases[1], bases[4]
    thumb_mcp = places[2]
    add(THENAR, thumb + np.array([-5, -4, 0]) * mm, 0.2 * thumb + 0.8 * thumb_mcp + [0, -1 * mm, 0], 15 * mm, 11.5 * mm)
    add(THENAR, thumb + np.array([-8, -5, 6]) * mm, 0.6 * thumb + 0.4 * thumb_mcp + np.array([-8, -3, 4]) * mm,
        14 * mm, 12 * mm)  # fmt: skip
    add(CORE, [-20 * mm * wide / big, -9 * mm, 18 * mm], 0.25 * carpus[3] + 0.75 * little + [0, -6 * mm, 0],
        12.5 * mm, 10 * mm)  # fmt: skip
    # Skin between thumb and index finger, and between the fingers.
    add(THENAR, 0.45 * thumb + 0.55 * thumb_mcp, 0.45 * carpus[0] + 0.55 * index, 8.5 * mm, 8.5 * mm)
    add(THENAR, 0.25 * thumb + 0.75 * thumb_mcp, 0.22 * carpus[0] + 0.78 * index, 6.5 * mm, 7.5 * mm)
    for digit in range(1, 4):
        one, other = places[1 + 4 * digit : 3 + 4 * digit], places[5 + 4 * digit : 7 + 4 * digit]
        a, b = one[0] + 0.30 * (one[1] - one[0]), other[0] + 0.32 * (other[1] - other[0])
        add(CORE, a, b, 5.5 * mm, 5.0 * mm)
    return rows


def hand_weights(vertices: Float64, distance: Float64, bones: Float64, *, hand_length_m: float) -> Float64:
    """Return the skinning weights (n, 16) of the palm and the 15 bones of the digits for each vertex; their sum is 1.

    Along a chain the weight changes from bone to bone within about a radius of the joint; between digits the nearer one
    moves the vertex, with a narrow transition.

    Args:
        vertices: (n, 3) in the palm's frame [m].
        distance: (n, `GROUPS`) distance of each vertex from each group of limbs [m].
        bones: (15, 3, 4) of `digits_at_rest`.
        hand_length_m: from the wrist to the tip of the middle finger [m].
    """
    big = hand_length_m / 0.189
    of_finger = np.exp(-np.clip((distance[:, 1:5] - distance[:, 1:5].min(axis=1)[:, None]) / (1.2e-3 * big), 0, 60))
    of_finger /= of_finger.sum(axis=1)[:, None]
    others = distance[:, [1, 2, 3, 4, CORE]].min(axis=1)
    nearer = distance[:, [0, THENAR]].min(axis=1) - others
    thumb = 1.0 / (1.0 + np.exp(np.clip(nearer / (3e-3 * big), -40, 40)))
    share = np.column_stack([thumb, (1.0 - thumb)[:, None] * of_finger])
    weights = np.zeros((len(vertices), 1 + 3 * len(DIGITS)))
    for digit in range(5):
        handed = [np.ones(len(vertices))]
        for bone in range(3):
            T = bones[3 * digit + bone]
            along = (vertices - T[:, 3]) @ T[:, 2]
            r = big * 1e-3 * FINGER_RADII_MM[digit][bone]
            before, after = (0.9, 1.0) if bone == 0 else (0.55, 0.55)
            s = smooth(along, -before * r, after * r)
            handed.append(np.minimum(s, handed[-1]))
        handed.append(np.zeros(len(vertices)))
        weights[:, 0] += share[:, digit] * (handed[0] - handed[1])
        for bone in range(3):
            weights[:, 1 + 3 * digit + bone] = share[:, digit] * (handed[bone + 1] - handed[bone + 2])
    return weights
