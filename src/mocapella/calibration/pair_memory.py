"""The places in the arrays that a `PairCalibration` remembers, and the newest frames of a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

# Of the pair of sensors. What is said to fade is multiplied by the same factor as the moments, at every frame.
MOTION: Final = 0
"""Shared motion so far [s]; standing still hardly counts."""
BLOCKS: Final = 1
"""Independent samples; they fade. The next: the same, faded twice (Σf and Σf² of the weights f)."""
BLOCKS_SQ: Final = 2
COST: Final = 3
"""Σ of residuals, weighted by motion, fading; the next: their weight; the next: Σ of squares of centres' distances."""
COST_WEIGHT: Final = 4
APART_SQ: Final = 5
OFFSET: Final = 6
"""What is added to `REFERENCE_OFFSET`: both together are b's clock minus a's [s]."""
REFERENCE_OFFSET: Final = 7
CENTRE: Final = 8
"""Three: where people were, weighted like `COST`, in a's frame."""
STEPS: Final = 11
BLOCKS_CLOSED: Final = 12
"""Independent samples so far; they do not fade."""
OWN_SD: Final = 13
"""How wrong the estimate itself may be where people walk [m]; 0 while it is not trusted. Where it is above 0, frames in
which the two views' centres are farther apart than usual are left out: a sensor moved, or these are two people."""
PAIR_SCALARS: Final = 14

# Of a pair of bodies.
LAST: Final = 0
"""The newest frame of a that is done [s]."""
MIRRORED: Final = 1
ANCHOR: Final = 2
"""Three: where the block of frames began that will be one independent sample."""
ANCHORED: Final = 5
GRADIENT: Final = 6
"""Seven: the block's."""
APART: Final = 13
"""Between the two views of the body's centre [m]; the next: the mean over the joints."""
RESIDUAL: Final = 14
DISAGREES_SINCE: Final = 15
"""Since when the centres are farther apart than usual [s]; NaN where they are not."""
AGREED: Final = 16
"""For how long they were not, in all [s]."""
STEP_AT: Final = 17
"""Time of the last frame that was used [s]."""
BODY_SCALARS: Final = 18

FRAMES_KEPT: Final = 48
"""Of every body: as many as a sensor of 120 Hz gives in 0.4 s."""


def new_body(*, mirrored: bool = False) -> Float64:
    """The memory of a pair of bodies that was never seen."""
    body = np.zeros(BODY_SCALARS)
    body[LAST] = body[STEP_AT] = -np.inf
    body[MIRRORED] = mirrored
    body[DISAGREES_SINCE] = np.nan
    return body


@dataclass
class BodyTrack:
    """One sensor's newest frames of one body, in the order of their times.

    Attributes:
        times: (2·kept,) [s]; points: (2·kept, joints, 3) [m]; weights: (2·kept, joints).
        held: (2,) int64: which of them are held, from the first to before the second.
        frozen_since: (1,) since when no joint has moved at all [s]; NaN where one has.
    """

    times: Float64
    points: Float64
    weights: Float64
    held: NDArray[np.int64]
    frozen_since: Float64

    @classmethod
    def empty(cls, joints: int) -> BodyTrack:
        """Without a frame."""
        n = 2 * FRAMES_KEPT
        zeros = np.zeros
        return cls(zeros(n), zeros((n, joints, 3)), zeros((n, joints)), zeros(2, dtype=np.int64), np.full(1, np.nan))

    def add(self, at: float, positions: Float64, states: NDArray[np.uint8], inferred_weight: float) -> bool:
        """Take a frame in; False where it is not newer than the last one.

        Args:
            at: time [s].
            positions: (joints, 3) float64, camera space [m]. A joint that is not finite, or exactly at the lens, weighs
                nothing.
            states: (joints,) `JointState`; not tracked weighs nothing.
            inferred_weight: what an inferred joint weighs; a tracked one weighs 1.
        """
        return bool(
            _add_frame()(self.times, self.points, self.weights, self.held, self.frozen_since, at, positions, states,
                         inferred_weight)
        )  # fmt: skip

    @property
    def newest(self) -> float:
        """Time of the newest frame [s]; −inf where there is none."""
        begin, end = self.held
        return float(self.times[end - 1]) if end > begin else -np.inf


@cache
def _add_frame() -> Callable[..., bool]:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.calibration import pair_kernels

    return cast(Callable[..., bool], pair_kernels.add_frame)
