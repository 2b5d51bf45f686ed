"""Calibrate a pair of sensors from nothing: without known matches of bodies, and with left and right unreliable.

Every pair of bodies, with left and right as reported and swapped, is a hypothesis with its own `PairCalibration`. Once
a body has walked, only the correct hypothesis still fits one rigid motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import WALK, PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import BodyTrack
from mocapella.calibration.shared_people import mutually_nearest, newest_centres
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


@dataclass
class ColdStart:
    """The hypotheses of one pair of sensors, a and b.

    Attributes:
        settings: settings of each hypothesis.
        hypotheses: their estimates.
    """

    settings: PairSettings = field(default_factory=PairSettings)
    hypotheses: dict[Hypothesis, PairCalibration] = field(default_factory=dict)

    def update(
        self,
        a: Mapping[int, BodyTrack],
        b: Mapping[int, BodyTrack],
        mirror: NDArray[np.int64],
        turned: NDArray[np.bool_] | None = None,
    ) -> None:
        """Update the hypotheses of all pairs of bodies with their newest frames; add new bodies' ones, up to `MOST`.

        Args:
            a, b: each sensor's bodies, by tracking id; hypotheses of other bodies are dropped.
            mirror, turned: (joints,) of the topology, as in `PairCalibration.update`.
        """
        self.hypotheses = {key: known for key, known in self.hypotheses.items() if key[0] in a and key[1] in b}
        for key in ((one, other, swapped) for one in sorted(a) for other in sorted(b) for swapped in (False, True)):
            if len(self.hypotheses) >= MOST:
                break
            if key not in self.hypotheses:
                self.hypotheses[key] = PairCalibration(self.settings, mirrored_at_first=key[2])
        for key, known in self.hypotheses.items():
            known.update(key[:2], a[key[0]], b[key[1]], mirror, turned)

    def likeliest(self) -> Likeliest | None:
        """Return the hypothesis with the best fit, and its best rival; None before there is data.

        Hypotheses of bodies that walked come first, and swapped labels must fit better by `SWAPPED_FACTOR`.
        """
        residuals = {key: known.residual for key, known in self.hypotheses.items() if known.moments[0] > 0}
        if not residuals:
            return None

        def cost(key: Hypothesis) -> tuple[bool, float, Hypothesis]:
            # A flat body at rest fits both ways, so swapped labels must fit better.
            return (
                not self.hypotheses[key].walked,
                (SWAPPED_FACTOR if key[2] else 1.0) * np.nan_to_num(residuals[key], nan=np.inf),
                key,
            )

        key = min(residuals, key=cost)
        rivals = [
            residual
            for other, residual in residuals.items()
            if other[:2] != key[:2] and (other[0] == key[0] or other[1] == key[1])
        ]
        best, labels = self.hypotheses[key], np.inf
        swapped = self.hypotheses.get((*key[:2], not key[2]))
        if swapped is not None and _turned(best.T_a_b, swapped.T_a_b) > OTHER_MOTION:
            labels = swapped.residual
        return Likeliest(best, min(rivals, default=np.inf), labels)

    def agreed(
        self, a: Mapping[int, BodyTrack], b: Mapping[int, BodyTrack], believed: PairCalibration | None
    ) -> PairCalibration | None:
        """Return the estimate under which most bodies of both sensors coincide now, if it is unambiguous.

        With many people who cross each other, one body alone leaves the match ambiguous for long. But all bodies share
        one motion: a wrong one makes single other bodies coincide by accident, rarely two.

        Args:
            a, b: each sensor's bodies, by tracking id.
            believed: the previous result, which stays unless another one is clearly better.

        Returns:
            The estimator of the best hypothesis, not a copy; else ``believed``, as with fewer than three bodies in a
            sensor.
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
        """Return ``estimate``, or a copy with a problem, so that it is not trusted, while rivals fit nearly as well.

        Before a person has walked, the hypothesis with swapped labels (`labels`) is a rival, too, and the shared motion
        must last `POSTURE_S`. If ``wary``, as with several people in view, an estimate from single postures is not
        trusted at all, and one from a walk must be as certain as `SEVERAL_SD_M` and `SEVERAL_SD`.

        Args:
            estimate: result of this hypothesis' estimator, the attribute ``pair``; unchanged if it has a problem.
            wary: whether to apply the stricter conditions.
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
    """Return the estimate marked as not trusted, because it rests on single postures; its remedy is to walk."""
    return msgspec.structs.replace(estimate, problem=WALK) if estimate.trusted else estimate


def _turned(T: Float64, other: Float64) -> float:
    """Return the angle between two motions' rotations [rad]; NaN if one is unknown."""
    cosine = (np.einsum("ij,ij->", T[:3, :3], other[:3, :3]) - 1) / 2
    return float(np.arccos(np.clip(cosine, -1, 1)))


WHICH_SIDE = texts.WHICH_SIDE
WHO_IS_WHO = texts.WHO_IS_WHO
