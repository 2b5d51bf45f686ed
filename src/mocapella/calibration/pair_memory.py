"""The places in the arrays that a `PairCalibration` remembers, and the frames of a body that wait for their partners."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState

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
PAIR_SCALARS: Final = 13

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
        begin, end: which of them are held.
        frozen_since: since when no joint has moved at all [s]; NaN where it has.
    """

    times: Float64
    points: Float64
    weights: Float64
    begin: int = 0
    end: int = 0
    frozen_since: float = field(default=float("nan"))

    @classmethod
    def empty(cls, joints: int) -> BodyTrack:
        """Without a frame."""
        return cls(np.zeros(2 * FRAMES_KEPT), np.zeros((2 * FRAMES_KEPT, joints, 3)), np.zeros((2 * FRAMES_KEPT, joints)))

    def add(self, at: float, positions: Float64, states: NDArray[np.uint8], inferred_weight: float) -> bool:
        """Take a frame in; False where it is not newer than the last one.

        A joint that is not finite, or exactly at the lens, or not tracked weighs nothing.
        """
        if self.end > self.begin and at <= self.times[self.end - 1]:
            return False
        if self.end == len(self.times):
            for array in (self.times, self.points, self.weights):
                array[:FRAMES_KEPT] = array[FRAMES_KEPT:]
            self.begin, self.end = 0, FRAMES_KEPT
        e = self.end
        seen = np.isfinite(positions).all(axis=-1) & (positions != 0.0).any(axis=-1)
        self.points[e] = np.where(seen[:, None], positions, 0.0)
        self.weights[e] = np.where(states == JointState.TRACKED, 1.0, inferred_weight) * (
            seen & (states != JointState.NOT_TRACKED)
        )
        self.times[e] = at
        if e > self.begin and seen.any() and np.array_equal(self.points[e], self.points[e - 1]):
            self.frozen_since = at if np.isnan(self.frozen_since) else self.frozen_since
        else:
            self.frozen_since = float("nan")
        self.end = e + 1
        self.begin = max(0, self.end - FRAMES_KEPT)
        return True

    def held(self) -> tuple[Float64, Float64, Float64]:
        """Times, points and weights of the frames that are held: views, not copies."""
        held = slice(self.begin, self.end)
        return self.times[held], self.points[held], self.weights[held]
