"""How steady and how right the arms are that a camera gives, as far as that shows without knowing the truth."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.arms import ARM_JOINT_NAMES

Float64 = NDArray[np.float64]

LEAST_SEEN_S: Final = 1.0
"""An arm that was seen for less has no misdetections a minute."""


class Misdetections(msgspec.Struct, frozen=True):
    """Counts of what cannot be true.

    Attributes:
        jumped: joints that were elsewhere in the next frame.
        appeared, vanished: fingertips that became known, and unknown, of an arm that was there before and after.
        swapped: pairs of fingertips that changed places, and arms that changed their side.
        lost: arms that were there no more; also those that went out of the image.
    """

    jumped: int = 0
    appeared: int = 0
    vanished: int = 0
    swapped: int = 0
    lost: int = 0

    @property
    def of_joints(self) -> int:
        """All but whole arms."""
        return self.jumped + self.appeared + self.vanished + self.swapped

    def plus(self, other: Misdetections) -> Misdetections:
        """Both together."""
        pairs = zip(msgspec.structs.astuple(self), msgspec.structs.astuple(other), strict=True)
        return Misdetections(*(one + two for one, two in pairs))


class ArmQuality(msgspec.Struct, frozen=True, eq=False):
    """What was measured up to an instant.

    Attributes:
        noise_m: (8,) root mean square motion of each of `mocapella.model.arms.ARM_JOINTS` about its mean while the arm
            was still, of late [m]; NaN where it has not been still.
        noise_whole_m: (8,) likewise of all the time.
        still: whether an arm is still now.
        per_minute: misdetections of joints a minute, of late; NaN where too little was seen.
        lately: misdetections that this is of.
        whole: of all the time.
        seen_s: how long arms were seen in all, summed over arms [s].
        still_s: how much of it they were still [s].
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
        """For a summary; null where nothing was measured."""

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
