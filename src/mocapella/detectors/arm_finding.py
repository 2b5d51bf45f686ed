"""Detect arms in a depth image without a prediction: from palm candidates to fitted poses.

A palm detector proposes candidates (`mocapella.sensing.arm_region`). At each candidate, kinematic models of a left and
a right arm are fitted by articulated ICP (`mocapella.kinematics.arm_fit`), from several initial poses. Fits with a high
cost are rejected, and of fits that overlap only the best is kept (non-maximum suppression).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.arm_starts import arm_starts, fists_behind_fingers
from mocapella.detectors.branch_ends import branch_ends, missed, reached, reaching, shown_ends, unexplained
from mocapella.kinematics.arm_fit import ArmEvidence, ArmModel, ArmPose, Fitted
from mocapella.model.arms import ELBOW, PALM
from mocapella.model.hand import TIPS, Handedness
from mocapella.sensing.arm_region import (
    ArmRegionSettings,
    PalmCandidate,
    Region,
    grid_about,
    others_edges,
    palm_candidates,
    region,
    within,
)
from mocapella.steps import Steps

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Tips = Float64 | None
"""Target positions of fingertips (5, 3) [m]; None for none."""
Bool = NDArray[np.bool_]

FEW_POINTS: Final = 40
"""Least number of points of an arm."""


class Found(NamedTuple):
    """An arm detected by fitting the arm model to a region of the depth image.

    Attributes:
        cost: the fit's cost plus a penalty for occlusion, 0 or more.
        side: side of the hand model that was fitted.
        fitted: the fit's pose, sizes and costs.
        missed: cost of the ends of fingers in the image that no fingertip explains; only fits of one hand are compared
            by it.
        begun: where tracking in further images starts, if its fingertips were moved to ends since; else
            None. Following moves no fingertips to ends, so they would drift back.
    """

    cost: float
    side: Handedness
    fitted: Fitted
    missed: float = 0.0
    begun: Fitted | None = None

    @property
    def rank(self) -> float:
        """Sum of both costs: the rank of fits of one hand."""
        return self.cost + self.missed


Pool = list[tuple[Found, Tips]]
"""Fits, and the targets of their fingertips."""


@dataclass(frozen=True, eq=False)
class ArmFinder:
    """Detects arms in a depth image by fitting models of both sides.

    Attributes:
        models: model of a right and a left arm, by side.
        lens: (4,) fx, fy, cx, cy of the camera [px], or (9,) with the distortion, which is not used.
        settings: settings of the segmentation of arms.
        believe: `Found.rank` above which a fit is rejected.
        gain: least expected reduction of that cost for trying another posture of a digit.
    """

    models: Mapping[Handedness, ArmModel]
    lens: Float64
    settings: ArmRegionSettings
    believe: float
    gain: float

    def candidates(
        self, depth: Float32, most: int = 6, near: Float64 | None = None, but: Float64 | None = None
    ) -> Steps[list[PalmCandidate]]:
        """Search a depth image for palms, in steps.

        Args:
            depth: (height, width) [m].
            most: greatest number of candidates.
            near: (3,) or (k, 3) points in the camera frame [m]; None for all candidates, else only those within 15 cm
                of one are returned.
            but: None, or (k, 4) spheres, centre and radius in the camera frame [m]; candidates centred in one are left
                out.

        Returns:
            Steps (see `mocapella.steps`) whose result is the list of candidates, the likeliest first.
        """
        return palm_candidates(depth, self.lens, self.settings, most, near, but)

    def region(self, depth: Float32, spheres: Float64) -> Region | None:
        """Segment the arm around spheres along it; None outside the image or with fewer than `FEW_POINTS` points.

        Args:
            depth: (height, width) [m].
            spheres: (k, 5) centre and radius in the camera frame [m], and 1 for the hand or 0 for the arm.
        """
        grid = grid_about(depth, self.lens, spheres, self.settings)
        if grid is None:
            return None
        part = region(grid, spheres, self.settings)
        return part if len(part.points) >= FEW_POINTS else None

    def all_of(
        self,
        depth: Float32,
        candidates: Iterable[PalmCandidate],
        most: int,
        good: float,
        enough: int,
        *,
        whole: Float32 | None = None,
    ) -> Steps[tuple[list[Found], list[PalmCandidate]]]:
        """Fit arms at palm candidates, in steps; return the results of `best`, and the candidates that were tried.

        Skipped are candidates within 4 cm of two that were tried already, and those on an arm with a good fit.

        Args:
            depth: (height, width) [m].
            candidates: the likeliest first.
            most: greatest number of candidates that are tried.
            good: cost below which a fit is good, provided that its side is clear, `sure` above 0.75.
            enough: number of candidates with a good fit after which the search ends.
            whole: see `best`.
        """
        found: list[Found] = []
        tried: list[PalmCandidate] = []
        arms: list[Float64] = []
        for candidate in candidates:
            centre = candidate.centre
            if len(tried) == most or enough == 0:
                break
            if sum(np.linalg.norm(other.centre - centre) < _BESIDE_M for other in tried) == _TRIES:
                continue
            if any(within(centre, balls) for balls in arms):
                continue
            tried.append(candidate)
            ones = yield from self.best(depth, candidate, whole)
            found += ones
            # Where the other side fits about as well, another candidate on the same hand may decide it.
            sure = [one for one in ones if one.cost < good and self.sure(one, ones) > _CLEAR]
            arms += [self.models[one.side].spheres(one.fitted.pose) + _ABOUT_ARM for one in sure]
            enough -= bool(sure)
        return found, tried

    def _palm(self, side: Handedness, fitted: Fitted) -> Float64:
        return np.asarray(self.models[side].points(fitted.pose)[PALM])

    def apart(self, found: list[Found]) -> list[Found]:
        """Suppress non-maxima: return the fits, the best first, without those `near` a better one of either side."""
        kept: list[Found] = []
        for one in sorted(found, key=lambda one: one.rank):
            if not any(self.near(other, one) for other in kept):
                kept.append(one)
        return kept

    def near(self, one: Found, other: Found) -> bool:
        """Return whether two fits' palms are less than 10 cm apart, so that they count as the same hand."""
        apart = self._palm(one.side, one.fitted) - self._palm(other.side, other.fitted)
        return float(np.linalg.norm(apart)) < _SAME_M

    def sure(self, one: Found, found: list[Found]) -> float:
        """Return the certainty of a hand's side: 0.5 if the other side fits as well there, up to `SUREST`.

        It rises with the relative excess cost of the best fit of the other side that is `near`; `SUREST` without one.

        Args:
            one: the hand's fit.
            found: fits of both sides; ``one``'s own side is ignored.
        """
        others = [other.rank for other in found if other.side != one.side and self.near(other, one)]
        if not others:
            return SUREST
        return float(np.clip(0.5 + 0.5 * (min(others) - one.rank) / max(one.rank, 1e-6), 0.5, SUREST))

    def alone(self, found: list[Found]) -> list[Found]:
        """Return fits, the best first as `judged` has them, without those that `overlap` a better one."""
        kept: list[Found] = []
        for one in found:
            if not any(self.overlap(other, one) for other in kept):
                kept.append(one)
        return kept

    def unclear(self, one: Found, found: list[Found]) -> Bool:
        """Return (23,) which landmarks another fit of the same hand, which is nearly as good, has elsewhere.

        Args:
            one: the hand's fit.
            found: fits of both sides.
        """
        points = self.models[one.side].points(one.fitted.pose)
        elsewhere = np.zeros(len(points), np.bool_)
        for other in found:
            if other is not one and other.rank < _RIVAL * one.rank and self.near(other, one):
                apart = np.linalg.norm(self.models[other.side].points(other.fitted.pose) - points, axis=1)
                elsewhere |= apart > _ELSEWHERE_M
        return elsewhere

    def overlap(self, one: Found, other: Found) -> bool:
        """Return whether two fits share a forearm or hand, so that only one of them can be an arm.

        The fits overlap if more than a fifth of all spheres along one of them, or half of those beyond its hand, have
        their centres within 5 cm of the other's, or if their elbows are within 10 cm.
        """
        a, b = (self.models[found.side].spheres(found.fitted.pose) for found in (one, other))
        near = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=2) < _OVERLAP_M
        # The hand and forearm of one fit may be the upper arm and elbow of the other.
        elbows = [self.models[found.side].points(found.fitted.pose)[ELBOW] for found in (one, other)]
        return float(np.linalg.norm(elbows[0] - elbows[1])) < _ELBOWS_M or any(
            float(part.mean()) > share
            for part, share in (
                (near.any(axis=1), 0.2), (near.any(axis=0), 0.2),
                (near[a[:, 4] == 0].any(axis=1), 0.5), (near[:, b[:, 4] == 0].any(axis=0), 0.5),
            )
        )  # fmt: skip

    def judged(self, depth: Float32, found: list[Found]) -> list[Found]:
        """Rank fits, the best first, by the sum of two costs, so that a fit must explain its rivals' points as well.

        One is the fit's own cost, which counts twice: the points around may be those of an upper arm, which the model
        describes less exactly than a hand. The other is the cost after refitting it to all points of the `region`
        around it and its rivals: the fits that `overlap` it, those that overlap these, and so on.

        Args:
            depth: (height, width) [m].
            found: the fits. A single one is returned unchanged; of several, fits without a `region` are left out.
        """
        if len(found) < 2:
            return found
        judged: list[tuple[float, int]] = []
        for group in self._overlapping(found):
            around = np.vstack([self.models[found[k].side].spheres(found[k].fitted.pose) for k in group])
            part = self.region(depth, around)
            if part is None:
                continue
            points = np.ascontiguousarray(part.points)
            evidence = ArmEvidence(points, np.ones(len(points)), part.front, part.opposite, part.lens)
            rivals = [found[k] for k in group]
            judged += [(self._around_cost(found[k], rivals, evidence) + _OWN * found[k].rank, k) for k in group]
        return [found[k] for _, k in sorted(judged)]

    def _overlapping(self, found: list[Found]) -> list[list[int]]:
        """Return groups of indices of fits that `overlap`, also by way of others: all fits of a group have one region.

        Costs of regions of different sizes could not be compared: the nearer to an arm's end a false hand is, the less
        of the arm it would have to explain.
        """
        groups: list[list[int]] = []
        for k, one in enumerate(found):
            joined = [group for group in groups if any(self.overlap(found[j], one) for j in group)]
            apart = [group for group in groups if group not in joined]
            groups = [*apart, sorted([k, *(j for group in joined for j in group)])]
        return groups

    def _around_cost(self, one: Found, rivals: list[Found], evidence: ArmEvidence) -> float:
        """Return the cost of a pose, refitted to all points around it and its rivals; a rival may be its upper arm."""
        model, pose = self.models[one.side], one.fitted.pose
        elbow, starts = model.points(pose)[ELBOW], [pose]
        for rival in rivals:
            if rival is not one:
                v = pose.v.copy()
                upper = pose.R.reshape(3, 3).T @ (self._palm(rival.side, rival.fitted) - elbow)
                v[7:10] = upper / max(float(np.linalg.norm(upper)), 1e-3)
                starts.append(pose._replace(v=v))
        return min(model.fit(start, model.unexpected(start), evidence, iterations=_AROUND).cost for start in starts)

    def best(self, depth: Float32, candidate: PalmCandidate, whole: Float32 | None = None) -> Steps[list[Found]]:
        """Fit arms of both sides at a palm candidate, in steps; return the best fit of each side, right before left.

        Fits with a rank above ``believe`` are left out; the result may be empty. All initial poses get few iterations,
        the better ones get more. Where no usual start fits well, fists are tried behind the surface of their fingers.

        Args:
            depth: (height, width) [m].
            candidate: the palm.
            whole: as ``depth``, before things were made narrower, if they were; things near a hand there must belong
                to it.
        """
        part = self.region(depth, candidate.spheres)
        if part is None:
            return []
        points = np.ascontiguousarray(part.points[:: max(-(-len(part.points) // _POINTS), 1)])
        weights = np.where(np.linalg.norm(points - candidate.centre, axis=1) < _ABOUT_M, 1.0, 0.4)
        evidence = ArmEvidence(points, weights, part.front, part.opposite, part.lens)
        started = yield from self._started(
            evidence, [(side, *start) for side, model in self.models.items() for start in arm_starts(model, candidate)]
        )
        pool = yield from self._closer(depth, part, started)
        if not pool or min(one.cost for one, _ in pool) > _WELL:
            fists = [
                (side, start, None)
                for side, model in self.models.items()
                for start in fists_behind_fingers(model, candidate)
            ]
            started += yield from self._started(evidence, fists)
            pool = yield from self._closer(depth, part, started)
        best = []
        for one, _ in _of_each_side(pool, 1):
            if one.cost < _HOPELESS:
                best.append((yield from self._repaired(depth, one, depth if whole is None else whole)))
        return [one for one in best if one.rank <= self.believe]

    def _started(self, evidence: ArmEvidence, starts: Sequence[tuple[Handedness, ArmPose, Tips]]) -> Steps[Pool]:
        """Fit arms from start poses with few iterations, in steps.

        Args:
            evidence: the points.
            starts: sides, poses, and target positions of fingertips.
        """
        pool: Pool = []
        for side, start, tips in starts:
            model = self.models[side]
            fitted = model.fit(
                start, model.unexpected(start, usual=True), evidence, iterations=4, loose=3.0, tips=tips, keep=1.0
            )
            pool.append((Found(fitted.cost, side, fitted), tips))
            yield _work(evidence, 4)
        return pool

    def _closer(self, depth: Float32, part: Region, pool: Pool) -> Steps[Pool]:
        """Fit the better ones of some fits again, in rounds of fewer fits and more points, in steps.

        Args:
            depth: (height, width) [m].
            part: the region of the palm.
            pool: the fits, and target positions of their fingertips.
        """
        for most, count, iterations, loose in _ROUNDS:
            better = []
            for one, tips in _of_each_side(pool, most):
                side, before = one.side, one.fitted
                model = self.models[side]
                closer = self.region(depth, model.spheres(before.pose)) if count > 250 else part
                if closer is None:
                    continue
                evidence = evidence_of(closer, model, before.pose, count, 0.3)
                fitted = model.fit(
                    before.pose, model.unexpected(before.pose, usual=True), evidence, iterations=iterations,
                    loose=loose, tips=tips if count <= 250 else None,
                )  # fmt: skip
                better.append((Found(fitted.cost, side, fitted), tips))
                yield _work(evidence, iterations) + (_REGION if count > 250 else 0)
            pool = better
        return pool

    def _held_otherwise(self, depth: Float32, model: ArmModel, fitted: Fitted) -> Steps[Fitted]:
        """Improve a fit by other postures of single digits, or by exchanging fingers."""
        left, exchanged = set(range(5)), False
        for _ in range(_REPAIRS):
            part = self.region(depth, model.spheres(fitted.pose))
            if part is None or not left:
                break
            evidence = evidence_of(part, model, fitted.pose, 400, 0.3)
            gain, start, digit = max(
                ((*model.held_otherwise(fitted.pose, evidence, digit)[:2], digit) for digit in left),
                key=lambda way: way[0],
            )
            if gain < self.gain:
                if exchanged:
                    break
                starts, exchanged = [*model.exchanged(fitted.pose)], True
            else:
                starts = [start]
                left.discard(digit)
            others = [model.fit(start, model.unexpected(start), evidence, iterations=6, loose=1.5) for start in starts]
            other = min(others, key=lambda other: other.cost, default=fitted)
            yield _work(evidence, 7 * len(starts)) + _HELD_OTHERWISE * len(left) + _REGION
            if other.cost < _BETTER * cost_of(model, fitted.pose, evidence):
                fitted, left, exchanged = other, set(range(5)), False
        return fitted

    def _repaired(self, depth: Float32, found: Found, whole: Float32) -> Steps[Found]:
        """Improve a fit by other postures of digits, and by digits that reach ends of branches; add its penalties.

        Args:
            depth, whole: see `best`.
            found: the fit.
        """
        model = self.models[found.side]
        best = yield from self._refined(depth, model, (yield from self._held_otherwise(depth, model, found.fitted)))
        for _ in range(_REACHES):
            start = None if best is None else (yield from self._reached(depth, model, best))
            if best is None or start is None:
                break
            other = yield from self._refined(depth, model, (yield from self._held_otherwise(depth, model, start)))
            if other is None or other.rank > _BETTER * best.rank:
                break
            best = other
        if best is None:
            return Found(math.inf, found.side, found.fitted)
        begun = best.fitted
        best = yield from self._ended(depth, model, best)
        fitted = best.fitted
        if fitted.cost > _SURELY or whole is not depth:
            around = self.region(whole, model.spheres(fitted.pose))
            if around is None or _stray(model, fitted.pose, around) > _STRAY:
                return Found(math.inf, found.side, fitted)
        moved = None if fitted is begun else begun
        return Found(self.shown_cost(fitted, best.part), found.side, fitted, best.missed, moved)

    def shown_cost(self, fitted: Fitted, part: Region | None) -> float:
        """Return a fit's cost plus the penalty for occlusion, `Found.cost`; without a region, the fit's cost alone."""
        if part is None:
            return fitted.cost
        return fitted.cost + _HIDDEN * max(float(fitted.costs[4]), others_edges(part.front, self.settings))

    def _ended(self, depth: Float32, model: ArmModel, best: _Refined) -> Steps[_Refined]:
        """Move the digits near ends of branches so that their flesh ends there; the palm and sizes hardly move.

        A digit at no such end, whose tip is in front of a surface behind it, ends where that surface begins.

        The fit is taken although its cost may be `_ENDED` times as high: the points on the last millimetres of a
        fingertip are too few to outweigh errors of the model elsewhere.

        Args:
            depth: (height, width) [m].
            model, best: the arm, and its fit.
        """
        pose = best.fitted.pose
        points, ends = model.points(pose)[[*TIPS]], model.tip_ends(pose)
        near = reached(best.ends, ends, _NEAR_END_M)
        shown = shown_ends(depth, self.lens, model.last_bones(pose))
        ended = np.where(np.isfinite(near), near, shown)
        ended[np.linalg.norm(ended - ends, axis=1) < _AT_END_M] = np.nan
        targets = ended - (ends - points)
        if not np.isfinite(targets).any():
            return best
        prior = model.rigid(pose, _ENDED_SD)
        prior.certainty[:3], prior.certainty[3:6] = 1 / _ENDED_M**2, 1 / _ENDED_SD**2
        evidence = evidence_of(best.part, model, pose, beyond=0.3)
        fitted = model.fit(pose, prior, evidence, iterations=_TO_END, loose=1.0, tips=targets, keep=1.0)
        yield _work(evidence, _TO_END)
        if fitted.cost > _ENDED * best.fitted.cost:
            return best
        return best._replace(fitted=fitted)

    def _reached(self, depth: Float32, model: ArmModel, refined: _Refined) -> Steps[Fitted | None]:
        """Return the best fit with a digit at an end of a branch that no tip explained; None without."""
        pose, fits = refined.fitted.pose, []
        evidence = evidence_of(refined.part, model, pose, 400, 0.3)
        for end in unexplained(refined.ends, model.points(pose)[[*TIPS]]):
            for start, tips in reaching(model, pose, end):
                prior = model.unexpected(start)
                fits.append(model.fit(start, prior, evidence, iterations=_TO_END, loose=1.5, tips=tips))
                yield _work(evidence, _TO_END) + _REACHING
        return min(fits, key=lambda fit: fit.cost, default=None)

    def _refined(self, depth: Float32, model: ArmModel, fitted: Fitted) -> Steps[_Refined | None]:
        """Refit a pose to all points, also of its surroundings; None where there is no region, or one unlike a hand."""
        part = self.region(depth, model.spheres(fitted.pose))
        if part is None:
            return None
        evidence = evidence_of(part, model, fitted.pose, beyond=0.3)
        hand = evidence.points[evidence.weights == 1.0]
        if len(hand) < _FEW_OF_HAND or _thickness(hand) < _FLAT_M:
            return None
        points = model.points(fitted.pose)
        ends = branch_ends(depth, self.lens, points[PALM], self.settings)
        yield _REGION + _ENDS
        targets, prior, fits = reached(ends, points[[*TIPS]]), model.unexpected(fitted.pose), []
        for iterations, loose, tips in (
            (0, 1.0, None),
            (_FINELY, 1.0, None),
            (_FINELY, 2.0, None),
            (_FINELY, 1.0, targets),
        ):
            fit = model.fit(fitted.pose, prior, evidence, iterations=iterations, loose=loose, tips=tips)
            fits.append(_Refined(fit, part, ends, _MISSED * missed(ends, model.points(fit.pose)[[*TIPS]])))
            yield _work(evidence, iterations)
        return min(fits, key=lambda fit: fit.rank)


class _Refined(NamedTuple):
    """A fit to all points of its region; ends (k, 3) of fingers in the image [m], and the cost of unexplained ones."""

    fitted: Fitted
    part: Region
    ends: Float64
    missed: float

    @property
    def rank(self) -> float:
        return self.fitted.cost + self.missed


def _stray(model: ArmModel, pose: ArmPose, part: Region) -> float:
    """Return how much of the surface near a hand and its forearm is far from both, 0 to 1."""
    evidence = evidence_of(part, model, pose, beyond=0.3)
    return float(model.fit(pose, model.unexpected(pose), evidence, iterations=0).costs[5])


def _work(evidence: ArmEvidence, iterations: int) -> int:
    """Return the estimated duration of a fit [µs]."""
    return round((iterations + 1) * (60 + 0.12 * len(evidence.points)))


def cost_of(model: ArmModel, pose: ArmPose, evidence: ArmEvidence) -> float:
    """Return the cost of a pose for an image's evidence, without fitting it: `Fitted.cost`, a weighted sum."""
    return model.fit(pose, model.unexpected(pose), evidence, iterations=0).cost


def evidence_of(part: Region, model: ArmModel, pose: ArmPose, most: int = 10_000, beyond: float = 0.05) -> ArmEvidence:
    """Return the evidence of a region for a fit, its points weighted by `ArmModel.relevance` about a pose.

    Args:
        part: the region.
        model, pose: the arm near which points have a large weight.
        most: largest number of points; the region's are evenly subsampled.
        beyond: weight of points away from the arm, 0 to 1; near the hand it is 1, near the forearm 0.5.
    """
    points = np.ascontiguousarray(part.points[:: max(-(-len(part.points) // most), 1)])
    return ArmEvidence(points, model.relevance(points, pose, beyond), part.front, part.opposite, part.lens)


def _thickness(points: Float64) -> float:
    """Return the root mean square distance of points (n, 3) from their plane [m]."""
    around = points - points.mean(axis=0)
    return float(np.sqrt(np.linalg.eigvalsh(around.T @ around / len(points))[0].clip(0.0)))


def _of_each_side(pool: list[tuple[Found, Float64 | None]], most: int) -> list[tuple[Found, Float64 | None]]:
    """Return the best fits of either side, at most ``most`` each."""
    pool = sorted(pool, key=lambda entry: entry[0].cost)
    return [entry for side in ("right", "left") for entry in [one for one in pool if one[0].side == side][:most]]


SUREST: Final = 0.95
"""Largest certainty of a hand's side."""
_CLEAR: Final = 0.75
"""Least certainty of a clear side."""
_BESIDE_M: Final = 0.04
_TRIES: Final = 2
"""Number of candidates within that distance of each other that are tried."""
_ABOUT_ARM: Final = np.array([0.0, 0.0, 0.0, 0.02, 0.0])
"""Margin of an arm's spheres, 2 cm of radius; candidates within them are skipped."""
_SAME_M: Final = 0.10
_OVERLAP_M: Final = 0.05
_ELBOWS_M: Final = 0.10
_REGION: Final = 700
_HELD_OTHERWISE: Final = 250
_ENDS: Final = 2000
_REACHING: Final = 1000
"""Time of each step [µs]."""
_POINTS: Final = 90
_ABOUT_M: Final = 0.16
_REPAIRS: Final = 10
_REACHES: Final = 3
"""Most digits that are brought to the ends of branches, one after the other."""
_BETTER: Final = 0.98
"""A fit is replaced by one whose cost is below this share of its own."""
_MISSED: Final = 0.02
"""Cost of an end of a branch that no fingertip explains."""
_FINELY: Final = 20
"""Iterations of the last fit to all points."""
_NEAR_END_M: Final = 0.02
"""Distance from the end of a fingertip's flesh to the end of a branch below which both are the same [m]."""
_AT_END_M: Final = 0.005
"""Distance below which it ends there already: the ends of branches are as inexact as this [m]."""
_ENDED: Final = 1.3
"""Largest ratio of costs of a fit that is taken because its fingertips end where branches do."""
_ENDED_M: Final = 0.003
_ENDED_SD: Final = np.radians(4)
"""Standard deviations of that fit: of the palm's position [m], of angles [rad] and of relative sizes."""
_TO_END: Final = 8
"""Iterations of a fit that brings a digit to the end of a branch."""
_ROUNDS: Final = ((5, 250, 8, 2.0), (2, 400, 8, 1.5))
"""Of each round: fits kept per side, points, iterations, and factor of the robust scales in the first iteration."""
_AROUND: Final = 12
"""Iterations to place the upper arm."""
_OWN: Final = 2.0
"""Weight of a fit's own cost beside that of all points around it and its rivals."""
_HOPELESS: Final = 0.4
_WELL: Final = 0.1
"""Cost of a fit above which fists behind their fingers are tried."""
_FEW_OF_HAND: Final = 10
"""Least number of a hand's points."""
_FLAT_M: Final = 0.002
"""Least thickness of a hand [m], less than that of any hand in the rendered scenes with seeds below 100."""
_RIVAL: Final = 1.3
"""Ratio of costs below which another fit is nearly as good."""
_ELSEWHERE_M: Final = 0.025
_SURELY: Final = 0.15
"""Cost of a fit below which its surroundings do not matter."""
_STRAY: Final = 0.04
"""Most stray points near a hand: a head or a thing has more surface around the supposed hand."""
_HIDDEN: Final = 0.3
"""Weight of occlusion in the cost, so that an almost hidden arm is not detected."""
