"""A person's body at rest, as tapered limbs for `mocapella.geometry.limb_surface`.

The surface is an implicit one, a smooth union of tapered limbs; meshes are triangulated from it.

`mocapella.model.body_meshes` defines the rest pose.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.body_proportions import HEEL, TOE, Flesh, Lengths

Float64 = NDArray[np.float64]

TRUNK, ARM, LEG = range(3)
"""Groups of limbs: trunk and head, left arm, left leg. The right arm and leg are mirror images."""
WITHIN: Final = (0.010, 0.003, 0.004)
BETWEEN: Final = 0.030
"""Blending radii between limbs of a group, and between groups, relative to the height."""
APART: Final = 0.014
"""Gap between each leg and the plane x = 0, relative to the height: legs that touch at rest cannot be separated."""
ARM_DOWN: Final = float(np.sqrt(0.5))


def joint_places(lengths: Lengths) -> dict[str, Float64]:
    """Return the joint centres and other named points at rest by name, such as ``left knee``, (3,) each [m].

    x is to the person's left, y up from the ground, z forwards.
    """
    hip = lengths.ankle_height + lengths.shank + lengths.thigh
    neck, top = hip + lengths.trunk, lengths.height
    head, foot = lengths.head, lengths.foot
    places: dict[str, Any] = {
        "pelvis": (0.0, hip, 0.0),
        "waist": (0.0, hip + 0.24 * lengths.trunk, 0.0),
        "neck": (0.0, neck, 0.0),
        "head": (0.0, top, 0.0),
        "nose": (0.0, neck + 0.53 * head, 0.38 * head),
    }
    for side, sign in (("left", 1.0), ("right", -1.0)):
        x = 0.5 * sign * lengths.hip_width
        shoulder = np.array([0.5 * sign * lengths.shoulder_width, neck, 0.0])
        along = np.array([sign * ARM_DOWN, -ARM_DOWN, 0.0])
        elbow = shoulder + lengths.upper_arm * along
        wrist = elbow + lengths.forearm * along
        places |= {
            f"{side} eye": (0.10 * sign * head, neck + 0.65 * head, 0.29 * head),
            f"{side} ear": (0.24 * sign * head, neck + 0.60 * head, 0.0),
            f"{side} shoulder": shoulder,
            f"{side} elbow": elbow,
            f"{side} wrist": wrist,
            f"{side} hand": wrist + 0.5 * lengths.hand * along,
            f"{side} fingertip": wrist + lengths.hand * along,
            f"{side} hip": (x, hip, 0.0),
            f"{side} knee": (x, lengths.ankle_height + lengths.shank, 0.0),
            f"{side} ankle": (x, lengths.ankle_height, 0.0),
            f"{side} heel": (x, HEEL[0] * foot, HEEL[1] * foot),
            f"{side} toe": (x, TOE[0] * foot, TOE[1] * foot),
        }
    return {name: np.array(place, dtype=np.float64) for name, place in places.items()}


def body_limbs(flesh: Flesh, lengths: Lengths, girth: float, *, legs_only: bool = False) -> Float64:
    """Return tapered limbs (n, 9) of trunk, left arm and left leg, sorted by group.

    A row has both ends [m], the radii there [m], and the group; see `mocapella.geometry.limb_surface`.

    Args:
        flesh: breadths and depths of average people, relative to their height.
        lengths: lengths of this person's segments [m].
        girth: this person's girth, relative to average people's.
        legs_only: leave out everything above the waist.
    """
    made = _Limbs(flesh, lengths, girth)
    made.trunk(up_to=0.3 if legs_only else np.inf)
    made.leg()
    if not legs_only:
        made.head()
        made.arm()
    return np.array(sorted(made.rows, key=lambda row: row[8]))


class _Limbs:
    """Collects rows; h is the height, g the factor on radii over the height."""

    def __init__(self, flesh: Flesh, lengths: Lengths, girth: float) -> None:
        self.rows: list[list[float]] = []
        self.flesh, self.lengths, self.places = flesh, lengths, joint_places(lengths)
        self.h, self.g = lengths.height, lengths.height * girth

    def add(self, group: int, a: Any, b: Any, radii: tuple[float, float]) -> None:
        """Add a limb from a to b."""
        self.rows.append([*map(float, a), *map(float, b), *map(float, radii), group])

    def trunk(self, up_to: float) -> None:
        """Add the trunk; four columns side by side form its oval."""
        h, g, flesh, trunk = self.h, self.g, self.flesh, self.lengths.trunk
        hip = self.places["pelvis"][1]
        for (u0, a0, b0, z0), (u1, a1, b1, z1) in pairwise(row for row in flesh.trunk if row[0] <= up_to):
            for x in (-1.0, -0.4, 0.4, 1.0):
                self.add(TRUNK, [x * (a0 - b0) * g, hip + u0 * trunk, z0 * h],
                         [x * (a1 - b1) * g, hip + u1 * trunk, z1 * h], (b0 * g, b1 * g))  # fmt: skip
        for sign in (-1.0, 1.0):
            x, r = 0.045 * g * sign, flesh.buttocks * g
            self.add(TRUNK, [x, hip - 0.02 * trunk, -0.022 * g], [x, hip - 0.01 * h, -0.022 * g], (r, r))
            if flesh.breasts and up_to > 1:
                x, y, r = 0.042 * g * sign, hip + 0.685 * trunk, flesh.breasts * g
                self.add(TRUNK, [x, y, 0.032 * g], [x, y + 0.03 * h, 0.014 * g], (r, 0.9 * r))

    def head(self) -> None:
        """Add the head, and the neck down to the shoulders."""
        h, g, neck = self.h, self.g, self.places["neck"][1]
        k = self.lengths.head / 0.182

        def at(y: float, z: float) -> Float64:
            return np.array([0.0, neck + (y - 0.818) * k, z * k])

        self.add(TRUNK, at(0.956, -0.012), at(0.956, 0.011), (0.0435 * k, 0.0435 * k))
        self.add(TRUNK, at(0.935, 0.000), at(0.935, 0.014), (0.040 * k, 0.040 * k))
        self.add(TRUNK, at(0.940, 0.018), at(0.896, 0.022), (0.034 * k, self.flesh.jaw * k))
        self.add(TRUNK, at(0.930, 0.053), at(0.914, 0.062), (0.005 * k, 0.0075 * k))
        r = self.flesh.neck * g
        self.add(TRUNK, at(0.830, -0.012), at(0.905, -0.002), (1.08 * r, 0.98 * r))
        for side in ("left", "right"):
            shoulder = self.places[f"{side} shoulder"] * [0.85, 1.0, 1.0]
            self.add(TRUNK, at(0.858, -0.012), np.add(shoulder, [0, -0.004 * h, -0.006 * h]), (0.8 * r, 0.025 * g))

    def segment(self, group: int, rows: Any, start: str, end: str) -> None:
        """Add limbs from a joint to the next; legs stay apart."""
        a, b = self.places[start], self.places[end]
        apart = self.h * APART if group == LEG else -np.inf

        def at(u: float, r: float, z: float) -> Float64:
            x = max(0.0, r * self.g + apart - a[0])
            return np.asarray(a + u * (b - a) + [x, 0, z * self.h])

        for one, other in pairwise(rows):
            self.add(group, at(*one), at(*other), (one[1] * self.g, other[1] * self.g))

    def leg(self) -> None:
        """Add a leg, with a shoe."""
        for deep in (-1.0, 1.0):
            rows = [(u, r, z + deep * d) for u, r, z, d in self.flesh.thigh]
            self.segment(LEG, rows, "left hip", "left knee")
        self.segment(LEG, self.flesh.shank, "left knee", "left ankle")
        f, ankle = self.lengths.foot / 0.152, self.places["left ankle"]
        x, sole = ankle[0], -0.003 * f
        self.add(LEG, ankle - [0, 0, 0.003 * f], [x, 0.024 * f + sole, -0.018 * f], (0.020 * f, 0.024 * f))
        self.add(LEG, np.add(ankle, [0, 0, 0.006 * f]), [x, 0.022 * f + sole, 0.055 * f], (0.021 * f, 0.020 * f))
        for aside, end in ((-0.013, 0.093), (0.0, 0.094), (0.013, 0.085)):
            ball = [x + aside * f, 0.019 * f + sole, 0.060 * f]
            self.add(LEG, [x, 0.020 * f + sole, -0.020 * f], ball, (0.021 * f, 0.019 * f))
            self.add(LEG, ball, [x + aside * f, 0.016 * f + sole, end * f], (0.019 * f, 0.0145 * f))

    def arm(self) -> None:
        """Add an arm, with a mitten."""
        self.segment(ARM, self.flesh.upper_arm, "left shoulder", "left elbow")
        self.segment(ARM, self.flesh.forearm, "left elbow", "left wrist")
        wrist, k = self.places["left wrist"], self.lengths.hand / 0.108
        along, thumb = (self.places["left fingertip"] - wrist) / self.lengths.hand, np.array([0.0, 0.0, 1.0])

        def at(down: float, across: float) -> Float64:
            return np.asarray(wrist + (down * along + across * thumb) * k)

        for z in (-0.0145, 0.0, 0.0145):
            self.add(ARM, at(0.006, 0.45 * z), at(0.050, z), (0.0125 * k, 0.0105 * k))
            self.add(ARM, at(0.050, z), at(0.089 if z else 0.099, 0.8 * z), (0.0105 * k, 0.0085 * k))
        self.add(ARM, at(0.012, 0.010), at(0.050, 0.033), (0.011 * k, 0.0085 * k))
