"""A pair of sensors from nothing: which body is which is not known, nor whether a sensor takes a back for a front.

Every pair of bodies, with left and right as they are and swapped, is a hypothesis with an estimate of its own
(`PairCalibration`). When a body has walked, only the true one still fits with one rigid motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import BodyTrack
from mocapella.calibration.shared_people import mutually_nearest, newest_centres

Hypothesis = tuple[int, int, bool]
"""a's tracking id, b's, and whether left and right are swapped at first."""

RIVALS_FACTOR = 0.7
"""A hypothesis wins when its residual is no more than this part of every rival's."""
SWAPPED_FACTOR = 1.25
"""Swapped labels must fit better by this."""
TOGETHER_M = 0.35
"""Bodies whose middles are nearer in both sensors are one person …"""
OTHERS = 2
"""… and so many others must be, for one of them to be believed."""
MOST = 72
"""Hypotheses; six people seen by both sensors have as many. Of more people, those with the lowest ids begin."""


@dataclass
class ColdStart:
    """The hypotheses of one pair of sensors.

    Attributes:
        settings: of every hypothesis.
        hypotheses: their estimates.
    """

    settings: PairSettings = field(default_factory=PairSettings)
    hypotheses: dict[Hypothesis, PairCalibration] = field(default_factory=dict)

    def update(self, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack], mirror: NDArray[np.int64]) -> None:
        """Take in what is new of every pair of bodies.

        Args:
            a, b: the bodies that each sensor sees, by tracking id. Of one that is gone, nothing is remembered.
            mirror: (joints,) of the topology.
        """
        self.hypotheses = {key: known for key, known in self.hypotheses.items() if key[0] in a and key[1] in b}
        for key in ((one, other, swapped) for one in sorted(a) for other in sorted(b) for swapped in (False, True)):
            if len(self.hypotheses) >= MOST:
                break
            if key not in self.hypotheses:
                self.hypotheses[key] = PairCalibration(self.settings, mirrored_at_first=key[2])
        for key, known in self.hypotheses.items():
            known.update(key[:2], a[key[0]], b[key[1]], mirror)

    def likeliest(self) -> Likeliest | None:
        """The hypothesis that fits best; None before there is one that fits anything."""
        residuals = {key: known.residual for key, known in self.hypotheses.items() if known.moments[0] > 0}
        if not residuals:
            return None

        def cost(key: Hypothesis) -> tuple[bool, float, Hypothesis]:
            enough = self.hypotheses[key].samples_closed >= self.settings.samples_wanted
            # Swapped labels need a reason: a flat body at rest fits either way.
            return not enough, (SWAPPED_FACTOR if key[2] else 1.0) * np.nan_to_num(residuals[key], nan=np.inf), key

        key = min(residuals, key=cost)
        rivals = [
            residual
            for other, residual in residuals.items()
            if other[:2] != key[:2] and (other[0] == key[0] or other[1] == key[1])
        ]
        return Likeliest(self.hypotheses[key], min(rivals, default=np.inf))

    def agreed(
        self, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack], believed: PairCalibration | None
    ) -> PairCalibration | None:
        """The estimate that puts most people where both sensors see them now, if it is clear which that is.

        Where there are many, whoever crosses their ways makes it long unclear from one body alone who is who. But one
        motion is that of all: a wrong one puts others together by accident, and hardly two.

        Args:
            a, b: the bodies that each sensor sees, by tracking id.
            believed: what was said before; it stays where nothing else is clearly better.
        """
        s = self.settings
        known = {
            key: pair
            for key, pair in self.hypotheses.items()
            if pair.scalars[at.STEPS] > 0 and pair.residual <= s.residual_allowed_m
        }
        if not known or min(len(a), len(b)) < OTHERS + 1:
            return believed
        tried = [*known.values()] if believed is None else [*known.values(), believed]
        T, ours, theirs = np.stack([pair.T_a_b for pair in tried]), newest_centres(a), newest_centres(b)
        together = mutually_nearest(T, ours, theirs, TOGETHER_M).sum(axis=(1, 2)).tolist()
        counts = dict(zip(known, together, strict=False))
        key = max(counts, key=lambda key: (counts[key], -known[key].residual))
        rivals = [n for other, n in counts.items() if other != key and (other[0] == key[0]) != (other[1] == key[1])]
        swapped = counts.get((*key[:2], not key[2]), 0)
        known_count = together[-1] if believed is not None else 0
        return known[key] if counts[key] > max([OTHERS, swapped, known_count, *rivals]) else believed


class Likeliest(msgspec.Struct, frozen=True, eq=False):
    """A hypothesis, and the residual of the best that contradicts it [m]."""

    pair: PairCalibration
    rival: float

    def judged(self, estimate: PairEstimate) -> PairEstimate:
        """The estimate of `pair`; not trusted while rivals remain."""
        if estimate.trusted and not estimate.residual <= RIVALS_FACTOR * self.rival:
            return msgspec.structs.replace(estimate, problem=WHO_IS_WHO)
        return estimate


WHO_IS_WHO = "it is not clear yet who is who: one of you, walk a few steps alone"
