"""Calibrate a pair of sensors from nothing: without known matches of bodies, and with left and right unreliable.

Every pair of bodies, with left and right as reported and swapped, is a hypothesis with its own `PairCalibration`. Once
a body has walked, only the correct hypothesis still fits one rigid motion.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import islice, product
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import WALK, PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import PairArrays, SensorTracks, new_body
from mocapella.calibration.shared_people import mutually_nearest
from mocapella.model import condition_texts as texts

Float64 = NDArray[np.float64]
Hypothesis = tuple[int, int, bool]
"""Tracking ids in a and in b, and whether left and right start swapped."""

RIVALS_FACTOR = 0.7
"""A hypothesis is accepted if its residual is at most this fraction of every rival's."""
POSTURE_S = 1.5
"""Least duration of shared motion before an estimate from single postures is trusted; if the two bodies are different
people, they usually contradict it earlier [s]."""
SEVERAL_SD_M = 0.04
"""Largest standard deviation of a trusted estimate's position if a sensor sees several people, because it decides which
of their bodies are one person [m]."""
SEVERAL_SD = 0.03
"""Largest standard deviation of a trusted estimate's rotation in that case [rad]."""
OTHER_MOTION = np.radians(60.0)
"""Rotation between two motions from which they count as different ones [rad]."""
SWAPPED_FACTOR = 1.25
"""Factor of the residuals of hypotheses with swapped labels when the best fit is chosen."""
TOGETHER_M = 0.35
"""Largest distance of the centres of two bodies that are one person [m]."""
OTHERS = 2
"""Number of bodies, besides the hypothesis' own, that must coincide in both sensors; see `ColdStart.agreed`."""
MOST = 72
"""Upper bound of the number of hypotheses: all of six people in both sensors. With more, the lowest ids come first."""

_bodies_of = operator.attrgetter("bodies")


@dataclass
class ColdStart:
    """Hypotheses about which bodies of two sensors, a and b, are one person, each with its own estimator.

    Attributes:
        settings: settings of each estimator.
        hypotheses: the estimators, by tracking id in a, tracking id in b, and whether left and right start swapped.
    """

    settings: PairSettings = field(default_factory=PairSettings)
    hypotheses: dict[Hypothesis, PairCalibration] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._stack: PairArrays | None = None
        self._rows: list[Float64] = []
        self._of: tuple[Mapping[int, int], Mapping[int, int]] = ({}, {})
        self._who: list[tuple[int, int]] = []
        self._slots = np.empty((0, 2), dtype=np.int64)

    def update(
        self, a: SensorTracks, b: SensorTracks, mirror: NDArray[np.int64], turned: NDArray[np.bool_] | None = None
    ) -> None:
        """Update the hypotheses of all pairs of bodies with their newest frames; add new bodies' ones, up to `MOST`.

        Args:
            a, b: each sensor's bodies; hypotheses of other bodies are dropped.
            mirror, turned: (joints,) of the topology, as in `PairCalibration.update`.
        """
        if self._of[0] is not a.slots or self._of[1] is not b.slots or not self.hypotheses:
            self._choose(a, b)
        if not self.hypotheses:
            return
        # An estimator that `agreed` returned is updated elsewhere, too, which may drop or replace its state of a body.
        rows = map(dict.get, map(_bodies_of, self.hypotheses.values()), self._who)
        if self._stack is not None and not all(map(operator.is_, rows, self._rows)):
            self._stack = None
        if turned is None:
            turned = np.zeros(len(mirror), dtype=np.bool_)
        _kernels().take_newest_of_each(
            self._stacked(), a.arrays, b.arrays, self._slots, mirror, turned, self.settings.parameters
        )

    def _choose(self, a: SensorTracks, b: SensorTracks) -> None:
        """Drop the hypotheses of missing bodies, and add hypotheses of new ones."""
        kept = {key: one for key, one in self.hypotheses.items() if key[0] in a.bodies and key[1] in b.bodies}
        ids = product(sorted(a.bodies), sorted(b.bodies), (False, True))
        for key in islice((key for key in ids if key not in kept), MOST - len(kept)):
            kept[key] = PairCalibration(self.settings, mirrored_at_first=key[2])
        if kept.keys() != self.hypotheses.keys():
            self.hypotheses, self._stack = kept, None
        self._of, self._who = (a.slots, b.slots), [key[:2] for key in kept]
        self._slots = np.array([(a.slots[one], b.slots[other]) for one, other, _ in kept], dtype=np.int64)

    def clear(self) -> None:
        """Drop all hypotheses."""
        self.hypotheses, self._stack = {}, None

    def _stacked(self) -> PairArrays:
        """Return the arrays of all hypotheses, in order, with a leading axis; the estimators' own are views of them."""
        if self._stack is not None:
            return self._stack
        bodies = [
            one.bodies[key[:2]] if key[:2] in one.bodies else new_body(mirrored=one.mirrored_at_first)
            for key, one in self.hypotheses.items()
        ]
        rows = zip(self.hypotheses.values(), bodies, strict=True)
        arrays = zip(
            *((one.moments, one.scatter, one.T_a_b, one.scalars, one.clock, own) for one, own in rows), strict=True
        )
        stack = self._stack = PairArrays._make(map(np.stack, arrays))
        for i, (key, one) in enumerate(self.hypotheses.items()):
            one.moments, one.scatter, one.T_a_b, one.scalars, one.clock, one.bodies[key[:2]] = (
                part[i] for part in stack
            )
        self._rows = [one.bodies[key[:2]] for key, one in self.hypotheses.items()]
        return stack

    def likeliest(self) -> Likeliest | None:
        """Return the hypothesis with the least residual, and its rivals' residuals; None before there is data.

        Hypotheses of bodies that walked come first. Residuals of swapped labels are multiplied by `SWAPPED_FACTOR`.
        """
        if not self.hypotheses:
            return None
        stack = self._stacked()
        residuals, begun = _residuals(stack), stack.moments[:, 0] > 0
        # A flat body at rest fits both ways, so swapped labels must fit better.
        factors = np.where([swapped for _, _, swapped in self.hypotheses], SWAPPED_FACTOR, 1.0)
        costs = np.where(np.isnan(residuals), np.inf, factors * residuals)
        stands = stack.scalars[:, at.BLOCKS_CLOSED] < self.settings.samples_wanted
        rows = zip(stands.tolist(), costs.tolist(), self.hypotheses, residuals.tolist(), strict=True)
        known = [row for row, has_data in zip(rows, begun.tolist(), strict=True) if has_data]
        if not known:
            return None
        key = min(known)[2]
        rivals = [
            residual
            for _, _, other, residual in known
            if other[:2] != key[:2] and (other[0] == key[0] or other[1] == key[1])
        ]
        best, labels = self.hypotheses[key], np.inf
        swapped = self.hypotheses.get((*key[:2], not key[2]))
        if swapped is not None and _turned(best.T_a_b, swapped.T_a_b) > OTHER_MOTION:
            labels = swapped.residual
        return Likeliest(best, min(rivals, default=np.inf), labels)

    def agreed(self, a: SensorTracks, b: SensorTracks, believed: PairCalibration | None) -> PairCalibration | None:
        """Return the estimator under whose pose most bodies of both sensors coincide now, if it is unambiguous.

        Bodies coincide if their newest centres are mutually nearest, within `TOGETHER_M`. Under the returned pose, more
        than `OTHERS` pairs coincide, and more than under the pose of ``believed``, of any hypothesis that shares one of
        the two bodies, and of the same one with swapped labels. With a wrong pose, two other pairs rarely coincide.

        Args:
            a, b: each sensor's bodies.
            believed: the previous result; None before the first.

        Returns:
            The estimator of the best hypothesis, not a copy; else ``believed``, as with fewer than three bodies in a
            sensor.
        """
        if not self.hypotheses or min(len(a.bodies), len(b.bodies)) < OTHERS + 1:
            return believed
        stack, keys = self._stacked(), list(self.hypotheses)
        residuals = _residuals(stack)
        fits = (stack.scalars[:, at.STEPS] > 0) & (residuals <= self.settings.residual_allowed_m)
        known = np.flatnonzero(fits).tolist()
        if not known:
            return believed
        T = stack.T_a_b[known] if believed is None else np.concatenate([stack.T_a_b[known], believed.T_a_b[None]])
        near = mutually_nearest(T, a.newest_centres(), b.newest_centres(), TOGETHER_M)
        together = near.sum(axis=(1, 2)).tolist()
        counts = {keys[i]: count for i, count in zip(known, together, strict=False)}
        scores = list(zip(counts.values(), (-residuals[known]).tolist(), strict=True))
        key = keys[known[scores.index(max(scores))]]
        rivals = [n for other, n in counts.items() if other != key and (other[0] == key[0]) != (other[1] == key[1])]
        swapped = counts.get((*key[:2], not key[2]), 0)
        known_count = together[-1] if believed is not None else 0
        return self.hypotheses[key] if counts[key] > max([OTHERS, swapped, known_count, *rivals]) else believed


class Likeliest(msgspec.Struct, frozen=True, eq=False):
    """The hypothesis with the best fit.

    Attributes:
        pair: its estimator.
        rival: least residual of a hypothesis that matches one of the two bodies with another one [m]; infinite if none.
        labels: residual of the same bodies with left and right swapped [m]; infinite if it has found the same motion.
    """

    pair: PairCalibration
    rival: float
    labels: float

    def judged(self, estimate: PairEstimate, *, wary: bool = False) -> PairEstimate:
        """Return a copy of an estimate with a ``problem`` if a rival fits nearly as well; else the estimate itself.

        The residual must be at most `RIVALS_FACTOR` of `rival`. Before a person has walked, it must also be at most
        this fraction of `labels`, and the shared motion must last `POSTURE_S`.

        Args:
            estimate: the result of `pair`; returned unchanged if it has a problem already.
            wary: whether to demand more, as with several people in view: a walk, and standard deviations of at most
                `SEVERAL_SD_M` and `SEVERAL_SD`.
        """
        if not estimate.trusted:
            return estimate
        walked = self.pair.walked
        if not estimate.residual <= RIVALS_FACTOR * self.rival:
            return msgspec.structs.replace(estimate, problem=WHO_IS_WHO)
        unsure = estimate.position_sd > SEVERAL_SD_M or estimate.rotation_sd > SEVERAL_SD
        if (wary and unsure) or (not walked and (wary or estimate.motion_s < POSTURE_S)):
            return msgspec.structs.replace(estimate, problem=WALK)
        if not walked and not estimate.residual <= RIVALS_FACTOR * self.labels:
            return msgspec.structs.replace(estimate, problem=WHICH_SIDE)
        return estimate


def unwalked(estimate: PairEstimate) -> PairEstimate:
    """Return a copy of a trusted estimate with the ``problem`` that people must walk; another one unchanged."""
    return msgspec.structs.replace(estimate, problem=WALK) if estimate.trusted else estimate


def _residuals(stack: PairArrays) -> Float64:
    """Return `PairCalibration.residual` of each hypothesis (hypotheses,) [m]."""
    weights = stack.scalars[:, at.COST_WEIGHT]
    some = weights > 0
    return np.where(some, stack.scalars[:, at.COST] / np.where(some, weights, 1.0), np.nan)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import pair_kernels

    return pair_kernels


def _turned(T: Float64, other: Float64) -> float:
    """Return the angle between two motions' rotations [rad]; NaN if one is unknown."""
    cosine = (float((T[:3, :3] * other[:3, :3]).sum()) - 1) / 2
    return math.acos(min(max(cosine, -1.0), 1.0)) if math.isfinite(cosine) else math.nan


WHICH_SIDE = texts.WHICH_SIDE
WHO_IS_WHO = texts.WHO_IS_WHO
