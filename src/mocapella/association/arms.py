"""Which arm of a camera is which of those that are known, by where the palms are, and which side they are of.

The assignment that costs least, each arm at most once (`tracks.assign`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import assign
from mocapella.settings import check

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class ArmMatchSettings:
    """When two arms are one.

    Attributes:
        within_m: two palms that are farther apart are of two arms …
        follow_m: … unless the camera itself says that it is the arm it showed before; then, farther than that.
        other_side_m: a hand that is surely of the other side counts as so much farther; one that is a guess, as no
            farther.
        new_id_m: likewise one that the camera has another number for.
    """

    within_m: float = 0.15
    follow_m: float = 0.4
    other_side_m: float = 0.15
    new_id_m: float = 0.05

    def __post_init__(self) -> None:
        for name in ("within_m", "follow_m", "other_side_m", "new_id_m"):
            check(0 <= getattr(self, name) <= 10, name, getattr(self, name), "from 0 to 10 m")


def match_arms(  # noqa: PLR0917 - two sets of arms
    palms: Float64,
    sides: Float64,
    known_palms: Float64,
    known_sides: Float64,
    followed: Bools,
    slack_m: Float64,
    settings: ArmMatchSettings | None = None,
) -> Int64:
    """(n,) which of the known arms each of a camera's arms is; −1 for none.

    Args:
        palms: (n, 3) [m]; NaN is none.
        sides: (n,) how sure it is that it is a left one, from −1, surely right, to 1.
        known_palms, known_sides: (m, 3) and (m,) likewise, expected at the camera's instant.
        followed: (n, m) the camera says that it is the same as before.
        slack_m: (m,) how much farther it may be, for it has not been seen for a while [m].
        settings: see there.
    """
    s = settings or ArmMatchSettings()
    apart = np.linalg.norm(palms[:, None] - known_palms[None], axis=-1)
    opposed = np.maximum(0.0, -sides[:, None] * known_sides[None])
    gate = np.where(followed, s.follow_m, s.within_m) + slack_m
    cost = apart + s.other_side_m * opposed + np.where(followed, 0.0, s.new_id_m)
    return assign(np.nan_to_num(cost, nan=1e3), np.isfinite(apart) & (apart + s.other_side_m * opposed <= gate))
