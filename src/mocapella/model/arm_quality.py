"""Quality metrics of a camera's arms without ground truth: noise and misdetections."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.arms import ARM_JOINT_NAMES

Float64 = NDArray[np.float64]

LEAST_SEEN_S: Final = 1.0
"""Least observed time for a rate of misdetections [s]."""


class Misdetections(msgspec.Struct, frozen=True):
    """Counts of implausible changes of arms between successive frames.

    Attributes:
        jumped: number of joints that moved farther than an arm can.
        appeared, vanished: numbers of fingertips that became known, and unknown, while their arm was tracked.
        swapped: number of pairs of fingertips that exchanged positions, and of arms that changed their side.
        lost: number of lost arms, including arms that left the image.
    """

    jumped: int = 0
    appeared: int = 0
    vanished: int = 0
    swapped: int = 0
    lost: int = 0

    @property
    def of_joints(self) -> int:
        """Number of all misdetections except lost arms."""
        return self.jumped + self.appeared + self.vanished + self.swapped

    def plus(self, other: Misdetections) -> Misdetections:
        """Return the sum of both."""
        pairs = zip(msgspec.structs.astuple(self), msgspec.structs.astuple(other), strict=True)
        return Misdetections(*(one + two for one, two in pairs))


class ArmQuality(msgspec.Struct, frozen=True, eq=False):
    """The quality measured so far.

    Attributes:
        noise_m: (8,) root mean square distance of each of `mocapella.model.arms.ARM_JOINTS` from its mean position,
            over the last seconds when an arm was still [m]; NaN before the first.
        noise_whole_m: (8,) the same over all still seconds of the session [m].
        still: whether an arm is still now.
        per_minute: misdetections of joints per minute of a seen arm, over the last minute; NaN if seen for under 1 s.
        lately: misdetections of the last minute.
        whole: misdetections over the whole session.
        seen_s: time for which arms were seen, summed over arms [s].
        still_s: part of that time for which they were still [s].
    """

    noise_m: Float64
    noise_whole_m: Float64
    still: bool
    per_minute: float
    lately: Misdetections
    whole: Misdetections
    seen_s: float
    still_s: float

    def as_json(self) -> dict[str, object]:
        """Return the values over the whole session for a summary, in mm, s and 1/min; None if not measured."""

        def number(value: float, digits: int) -> float | None:
            return round(float(value), digits) if np.isfinite(value) else None

        per_minute = self.whole.of_joints * 60 / self.seen_s if self.seen_s >= LEAST_SEEN_S else np.nan
        return {
            "seen_s": round(self.seen_s, 3),
            "still_s": round(self.still_s, 3),
            "noise_mm": {
                name: number(1e3 * value, 3) for name, value in zip(ARM_JOINT_NAMES, self.noise_whole_m, strict=True)
            },
            "misdetections": msgspec.structs.asdict(self.whole),
            "misdetections_per_minute": number(per_minute, 2),
        }
