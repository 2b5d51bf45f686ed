"""Match a camera's arms with tracked arms, by the positions of the palms and the sides.

Solved as a linear assignment (`tracks.assign`).
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
    """Parameters of the matching.

    Attributes:
        within_m: largest distance between the palms of a camera's arm and of its tracked arm, including the penalty
            ``other_side_m``; larger: fast arms keep their ids, but near arms are mixed up more easily [m].
        follow_m: largest distance, as ``within_m``, for an arm that the camera itself reports under the id that the
            tracked arm had before; larger: the camera's own ids are trusted farther [m].
        other_side_m: penalty, added to the distance, of an arm that is certainly of the other side; less for an
            uncertain side; larger: left and right arms are matched more rarely [m].
        new_id_m: penalty, added to the distance, of an arm that has another id in the camera than before; larger: the
            camera's own ids are followed more [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
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
    """Match the arms of a depth camera's frame with the tracked arms, one to one.

    As many arms as possible are matched within the gates, at the smallest total cost.

    Args:
        palms: (n, 3) palms of the camera's arms, world [m]; NaN if unknown: such an arm is not matched.
        sides: (n,) confidence of a left arm, from −1 (right) to 1.
        known_palms, known_sides: (m, 3) palms [m] and (m,) sides of the tracked arms, predicted to the frame's time.
        followed: (n, m) whether the camera's arm has the same camera id as this tracked arm had before.
        slack_m: (m,) widening of the gates for arms that were not seen for a while [m].
        settings: gates and penalties; the defaults if None.

    Returns:
        (n,) index of the tracked arm of each of the camera's arms; −1 for none.
    """
    s = settings or ArmMatchSettings()
    apart = np.linalg.norm(palms[:, None] - known_palms[None], axis=-1)
    opposed = np.maximum(0.0, -sides[:, None] * known_sides[None])
    gate = np.where(followed, s.follow_m, s.within_m) + slack_m
    cost = apart + s.other_side_m * opposed + np.where(followed, 0.0, s.new_id_m)
    return assign(np.nan_to_num(cost, nan=1e3), np.isfinite(apart) & (apart + s.other_side_m * opposed <= gate))
