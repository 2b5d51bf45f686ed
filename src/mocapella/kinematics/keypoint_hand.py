"""Fit a hand to its 21 landmarks, with 27 degrees of freedom, and learn its size.

The fit is that of `hand_tracker`, with all landmarks as measurements: tips, the palm's corners as its base, and the
joints between. The bones' lengths and the palm's corners are the means over the instants that measure them, with the
model's proportions as a prior.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.kinematics.hand_settings import HandReport, HandSettings
from mocapella.kinematics.hand_tracker import HandTracker, _State
from mocapella.model.hand import BASES, LANDMARKS, TIPS, WRIST, Hand, Handedness, HandShape, hand_model
from mocapella.model.observations import JointState

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

_BASE: Final = (WRIST, *BASES)
_ORDER: Final = np.array([*TIPS, *_BASE, *(b + k for b in BASES for k in (1, 2))], dtype=np.int64)
"""Landmarks in the order of the measurements of `HandTracker`."""
_PALM: Final = np.array(_BASE)
"""Landmarks of the palm's corners."""
_ENDS: Final = np.array([[(b + k, b + k + 1) for k in range(3)] for b in BASES])
"""Landmarks (5, 3, 2) at the ends of each digit's bones."""
_PRIOR: Final = 15.0
"""Number of instants for which the model's proportions count."""
_SIZED_AT: Final = (15, 30, 60, 120, 240, 480)
"""Numbers of measured instants at which the size changes; after the last it stays."""
_RIGID_M: Final = 0.02
"""Root mean square distance of the palm's corners from the present hand, above which an instant teaches nothing [m]."""
_BONE: Final = (0.5, 1.6)
"""Least and greatest bone that is believed, relative to the model's."""
_FAR_M: Final = 0.03
"""Distance of a measured landmark from the fitted one, above which it is inferred [m]."""
SETTINGS: Final = HandSettings(velocity_memory_s=0.06)
"""Settings of the fit: short memory, as cameras that are not synchronous need the present velocity."""
KINDS: Final = (_State, HandReport)
"""Values in `KeypointHand.memory`."""
_ARRAYS: Final = ("lengths", "bases", "lengths_sum", "bases_sum", "counts")


class KeypointHand:
    """A hand of known side that follows its landmarks. Equal inputs give equal outputs, to the bit.

    Args:
        side: left or right.

    Attributes:
        side: left or right.
        shape: the size learnt so far.
        instants: number of instants that taught the size.
    """

    def __init__(self, side: Handedness) -> None:
        self.side: Handedness = side
        self._model = hand_model("full")
        self._start = self._model.shape(side)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self.instants = 0
        self._lengths_sum, self._bases_sum, self._counts = np.zeros((5, 3)), np.zeros((5, 3)), np.zeros((5, 3))
        self._set_shape(self._start)

    def _set_shape(self, shape: HandShape) -> None:
        self.shape = shape
        self._fit = HandTracker(self._model, shape, _layout(shape), SETTINGS, joints=True)

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall`."""
        return {
            "lengths": self.shape.lengths, "bases": self.shape.bases, "lengths_sum": self._lengths_sum,
            "bases_sum": self._bases_sum, "counts": self._counts, "instants": self.instants, "state": self._fit.state,
            "report": self._fit.report,
        }  # fmt: skip

    def recall(self, memory: dict[str, Any]) -> None:
        """Replace all state by that of `memory`.

        Raises:
            WireError: it is no such memory.
        """
        if any(np.shape(memory[name]) != (5, 3) for name in _ARRAYS) or not isinstance(memory["instants"], int):
            raise WireError("the memory of a hand has other values")
        self._set_shape(HandShape(self.side, memory["lengths"], memory["bases"]))
        self._lengths_sum, self._bases_sum = memory["lengths_sum"], memory["bases_sum"]
        self._counts = memory["counts"]
        self.instants = memory["instants"]
        self._fit.recall(memory["state"], memory["report"])

    def predicted(self, at_s: float) -> Float64 | None:
        """Return the landmarks (21, 3) predicted for a time, world [m]; None if the hand is not known."""
        return self._fit.predicted(at_s)

    def update(self, points: Float64, covariances: Float64, measured: Bools, at_s: float) -> Hand:
        """Update the hand with the landmarks of one instant.

        Args:
            points: (21, 3) world [m]; NaN where not seen.
            covariances: (21, 3, 3) [m²].
            measured: (21,) whether two cameras or more agree about the landmark; others only help the fit.
            at_s: capture time [s].

        Returns:
            The hand, with `residuals_m` (21,) in the order of landmarks. A landmark is tracked if it is ``measured``,
            the fit is near it and certain; else inferred.
        """
        self._learn(points, measured)
        hand = self._fit.update(points[_ORDER], at_s, covariances[_ORDER])
        residuals = np.full(len(LANDMARKS), np.nan)
        residuals[_ORDER] = hand.residuals_m
        known = hand.states != JointState.NOT_TRACKED
        sure = measured & (hand.states == JointState.TRACKED) & (np.nan_to_num(residuals, nan=np.inf) <= _FAR_M)
        states = np.where(sure, JointState.TRACKED, np.where(known, JointState.INFERRED, JointState.NOT_TRACKED))
        return Hand(
            hand.at_s, hand.handedness, hand.landmarks, states.astype(np.uint8), hand.sd_m, hand.angles, hand.angles_sd,
            hand.T_world_palm, residuals,
        )  # fmt: skip

    def _learn(self, points: Float64, measured: Bools) -> None:
        """Add an instant that measures the whole palm to the means of the size; resize the hand at some (`_SIZED_AT`).

        A bone counts if both of its ends are measured.
        """
        if self.instants >= _SIZED_AT[-1] or not measured[_PALM].all():
            return
        corners, lengths, own = _layout(self.shape), np.empty((5, 3)), np.empty((len(_BASE), 3))
        mirror = float(self.shape.mirror[0])
        away = _kernels().measure(np.ascontiguousarray(points), corners, mirror, lengths, own)
        if not away <= _RIGID_M:
            return
        usual = lengths / self._start.lengths
        used = measured[_ENDS].all(axis=-1) & (usual > _BONE[0]) & (usual < _BONE[1])
        self.instants += 1
        self._counts += used
        self._lengths_sum += np.where(used, lengths, 0.0)
        self._bases_sum += own[1:] - own[0]
        if self.instants in _SIZED_AT:
            self._resize()

    def _resize(self) -> None:
        """Take the means as the size; the prior is the model's hand, scaled to them."""
        n, counts, model = self.instants, self._counts, self._start
        usual = (counts * model.lengths).sum()
        scale = float(np.clip(self._lengths_sum.sum() / usual, 0.5, 1.5)) if usual > 0 else 1.0
        lengths = (self._lengths_sum + _PRIOR * scale * model.lengths) / (counts + _PRIOR)
        bases = (self._bases_sum + _PRIOR * scale * model.bases) / (n + _PRIOR)
        self.shape = HandShape(self.side, lengths, bases)
        self._fit = self._fit.resized(self.shape, _layout(self.shape))


def _layout(shape: HandShape) -> Float64:
    """Return the palm's corners (6, 3) of a right hand: the wrist, and the digits' first joints [m]."""
    return np.concatenate([np.zeros((1, 3)), shape.bases])


@cache
def _kernels() -> ModuleType:
    """Import the compiled kernel, and with it numba, on first use."""
    from mocapella.kinematics import keypoint_hand_kernels

    return keypoint_hand_kernels
