"""Arms and hands in the images of one depth camera: found, followed, and told. The method ``default``.

An image goes through three steps: the part of it that may be an arm (`sensing.arm_region`), a kinematic arm and hand
fitted to its points (`kinematics.arm_fit`), and what is told of it. An arm that was there before is followed from its
prediction; where there is none, palms are looked for in the whole image and the fit begins from several poses of
either hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.kinematics.arm_fit import ArmFitSettings, ArmModel, ArmPose, Evidence, Expected, Fitted
from mocapella.kinematics.arm_fit import kernels as fit_kernels
from mocapella.model.arms import PALM, SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import Handedness, hand_model
from mocapella.model.observations import JointState
from mocapella.sensing.arm_region import (
    ArmRegionSettings,
    PalmCandidate,
    Region,
    grid_about,
    palm_candidates,
    region,
)
from mocapella.settings import check

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class DepthArmsSettings:
    """How arms are found and followed.

    Attributes:
        arms: at most.
        hand_length_m: of the average hand.
        believe: a fit whose cost is above this is no arm.
        keep: likewise of an arm that is followed.
        digits: so many digits are looked at in each image for a better way to hold them, all where it is doubtful.
        gain: a way is tried where it promises to lower the cost by so much.
        doubt: an arm whose cost is above this is doubtful.
        trials: poses that are tried in each image for a doubtful arm.
        better: another pose is taken when its cost is below this part of that of the arm's own.
        look_again_every: images between two times that a doubtful hand is looked for anew where it is.
        firm: an arm whose cost was below this for some images is sure, and others are not looked for in its stead.
        refuse_for: images for which a place is not looked at again, where no arm was.
        lost_after: frames in a row that an arm may be doubtful.
        look_every: frames between two looks for further arms, while there is one.
        region, fit: of the steps.
    """

    arms: int = 2
    hand_length_m: float = 0.189
    believe: float = 0.30
    keep: float = 0.38
    digits: int = 2
    gain: float = 0.006
    doubt: float = 0.14
    trials: int = 2
    better: float = 0.93
    look_again_every: int = 10
    firm: float = 0.19
    refuse_for: int = 60
    lost_after: int = 3
    look_every: int = 12
    region: ArmRegionSettings = field(default_factory=ArmRegionSettings)
    fit: ArmFitSettings = field(default_factory=ArmFitSettings)

    def __post_init__(self) -> None:
        check(1 <= self.arms <= 8, "arms", self.arms, "1 to 8")
        check(0.1 <= self.hand_length_m <= 0.3, "hand_length_m", self.hand_length_m, "0.1 to 0.3 m")
        check(0 < self.believe <= self.keep < 2, "believe", self.believe, "above 0, at most keep, which is below 2")
        check(1 <= self.digits <= 5, "digits", self.digits, "1 to 5")
        check(0 < self.gain < 2, "gain", self.gain, "above 0, below 2")
        check(0 <= self.trials <= 100, "trials", self.trials, "0 to 100")
        check(0 < self.doubt < 2, "doubt", self.doubt, "above 0, below 2")
        check(0 < self.better <= 1, "better", self.better, "above 0, at most 1")
        check(0 < self.firm < 2, "firm", self.firm, "above 0, below 2")
        check(1 <= self.look_again_every <= 1000, "look_again_every", self.look_again_every, "1 to 1000")
        check(0 <= self.refuse_for <= 100_000, "refuse_for", self.refuse_for, "0 to 100000")
        check(1 <= self.lost_after <= 1000, "lost_after", self.lost_after, "1 to 1000")
        check(1 <= self.look_every <= 1000, "look_every", self.look_every, "1 to 1000")


class _Arm:
    """An arm that is followed."""

    def __init__(self, number: int, side: Handedness, fitted: Fitted, at_s: float) -> None:
        self.id, self.side, self.fitted, self.at_s = number, side, fitted, at_s
        self.velocity = np.zeros(6 + len(fitted.pose.z))
        self.doubtful = self.since_look = self.firm = self.next_digit = 0
        self.sure = _SUREST
        self.region: Region | None = None
        self.trials: list[_Trial] = []

    def moved(self, fitted: Fitted, dt: float) -> None:
        """Take in the pose of the next image."""
        self.velocity = 0.6 * _motion(self.fitted.pose, fitted.pose) / dt + 0.4 * self.velocity
        self.fitted = fitted


class _Found(NamedTuple):
    """A hand that was found."""

    cost: float
    side: Handedness
    fitted: Fitted


class _Trial(NamedTuple):
    """A pose that might be better; as it was when the palm's middle was at a place [m]."""

    side: Handedness
    pose: ArmPose
    centre: Float64


class DepthArms:
    """Follows arms from image to image."""

    name = "default"

    def __init__(self, camera: Camera, settings: DepthArmsSettings | None = None) -> None:
        self.camera, self.settings = camera, settings or DepthArmsSettings()
        model = hand_model("full").stretched(25.0, 28.0, 4.0)
        s = self.settings
        sides: tuple[Handedness, Handedness] = ("right", "left")
        self.models = {side: ArmModel(model, model.shape(side, hand_length_m=s.hand_length_m), s.fit) for side in sides}
        self._lens = np.asarray(camera.lens, dtype=np.float64)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arms: list[_Arm] = []
        self._refused: list[tuple[Float64, int]] = []
        self._frames = self._next_id = 0

    def update(self, depth: Float32, at_s: float) -> SeenArms:
        """As `ArmMethod.update` says."""
        width, height = self.camera.size_px
        if depth.shape != (height, width):
            raise SettingsError(
                f"a depth image of {depth.shape[::-1]}; camera {self.camera.name} has {(width, height)}"
            )
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        for arm in list(self._arms):
            if not self._follow(arm, depth, at_s):
                self._arms.remove(arm)
        firm = sum(arm.firm >= _FIRM_AFTER for arm in self._arms)
        if firm < self.settings.arms and (not self._arms or self._frames % self.settings.look_every == 0):
            self._look(depth, at_s)
        self._frames += 1
        told = tuple(self._told(arm) for arm in sorted(self._arms, key=lambda arm: arm.id))
        return SeenArms(told, "" if told else self._reason(depth))

    def _reason(self, depth: Float32) -> str:
        s = self.settings.region
        there = depth > 0
        if not there.any():
            return "nothing was measured in the whole image"
        if not ((depth >= s.near_m) & (depth <= s.far_m)).any():
            return f"nothing is between {s.near_m:g} and {s.far_m:g} m"
        return "no hand is seen"

    # Following.

    def _follow(self, arm: _Arm, depth: Float32, at_s: float) -> bool:
        model, s = self.models[arm.side], self.settings
        dt = max(at_s - arm.at_s, 1e-3)
        predicted = self._predicted(arm, model, dt)
        part = self._region(depth, model.spheres(predicted))
        if part is None or len(part.points) < _FEW:
            return False
        fitted = model.fit(predicted, self._expected(model, arm, predicted, dt), _evidence(part, model, predicted))
        arm.moved(fitted, dt)
        arm.at_s, arm.region = at_s, part
        self._search(arm, depth)
        arm.doubtful = arm.doubtful + 1 if arm.fitted.cost > s.keep else 0
        arm.firm = min(arm.firm + 1, _FIRM_AFTER) if arm.fitted.cost < s.firm else max(arm.firm - 1, 0)
        return arm.doubtful < s.lost_after

    def _search(self, arm: _Arm, depth: Float32) -> None:
        """Look for digits that fit better otherwise, and try other poses of an arm that fits badly."""
        s = self.settings
        assert arm.region is not None
        model, doubt = self.models[arm.side], arm.fitted.cost > s.doubt
        evidence = _evidence(arm.region, model, arm.fitted.pose, 250, 0.15)
        digits = range(5) if doubt else [(arm.next_digit + k) % 5 for k in range(s.digits)]
        arm.next_digit = (arm.next_digit + s.digits) % 5
        gain, start = max(
            (model.held_otherwise(arm.fitted.pose, evidence, digit) for digit in digits), key=lambda way: way[0]
        )
        if gain > s.gain:
            other = model.fit(start, model.unexpected(start), evidence, iterations=5, loose=2.0)
            if other.cost < s.better * self._cost(model, arm.fitted.pose, evidence):
                self._change(arm, arm.side, other, depth)
        arm.since_look += 1
        if not doubt:
            return
        if not arm.trials and arm.since_look >= s.look_again_every:
            arm.since_look = 0
            centre = model.points(arm.fitted.pose)[PALM]
            for candidate in palm_candidates(depth, self._lens, s.region, 1, centre):
                arm.trials = [
                    _Trial(side, start, centre)
                    for side, model in self.models.items()
                    for start, _ in _starts(model, candidate)
                ]
        for _ in range(min(s.trials, len(arm.trials))):
            if not arm.trials:
                break  # another side was taken
            trial = arm.trials.pop(0)
            model = self.models[trial.side]
            start = trial.pose.copied()
            start.t[:] += self.models[arm.side].points(arm.fitted.pose)[PALM] - trial.centre
            evidence = _evidence(arm.region, model, start, 250, 0.15)
            other = model.fit(start, model.unexpected(start), evidence, iterations=5, loose=2.0)
            own = self.models[arm.side]
            before = self._cost(own, arm.fitted.pose, _evidence(arm.region, own, arm.fitted.pose, 250, 0.15))
            if other.cost < s.better * before:
                self._change(arm, trial.side, other, depth)

    @staticmethod
    def _cost(model: ArmModel, pose: ArmPose, evidence: Evidence) -> float:
        return model.fit(pose, model.unexpected(pose), evidence, iterations=0).cost

    def _change(self, arm: _Arm, side: Handedness, other: Fitted, depth: Float32) -> None:
        """Take another pose for an arm, where it is still better when all points are looked at."""
        model = self.models[side]
        part = self._region(depth, model.spheres(other.pose))
        if part is None or len(part.points) < _FEW:
            return
        fitted = model.fit(
            other.pose, model.unexpected(other.pose), _evidence(part, model, other.pose, beyond=0.15), iterations=4,
            loose=1.0,
        )  # fmt: skip
        own = self.models[arm.side]
        before = own.fit(
            arm.fitted.pose, own.unexpected(arm.fitted.pose), _evidence(part, own, arm.fitted.pose, beyond=0.15),
            iterations=0,
        )  # fmt: skip
        if fitted.cost < self.settings.better * before.cost:
            if side != arm.side:
                arm.trials = []
            arm.fitted, arm.side, arm.region = fitted, side, part
            arm.velocity[6:] = 0.0

    def _predicted(self, arm: _Arm, model: ArmModel, dt: float) -> ArmPose:
        pose = arm.fitted.pose.copied()
        step = arm.velocity * min(dt, 0.1)
        step[6:] *= 0.5
        turned = np.empty(9)
        fit_kernels().turned(pose.R, 0, step[3], step[4], step[5], turned)
        t = pose.t + pose.R.reshape(3, 3) @ step[:3]
        z = pose.z + step[6:]
        fit_kernels().within(model.digits, model.columns, model.gains, z, model.c_max)
        return ArmPose(turned, t, z, pose.v)

    def _expected(self, model: ArmModel, arm: _Arm, predicted: ArmPose, dt: float) -> Expected:
        s = self.settings.fit
        rates = np.full(6 + len(predicted.z), np.radians(s.angle_rate_deg_s))
        rates[:3], rates[3:6] = s.palm_rate_m_s, np.radians(s.palm_rate_deg_s)
        base = model.unexpected(predicted)
        return replace(base, certainty=1.0 / (rates * dt) ** 2)

    def _region(self, depth: Float32, spheres: Float64) -> Region | None:
        grid = grid_about(depth, self._lens, spheres, self.settings.region)
        return None if grid is None else region(grid, spheres, self.settings.region)

    # Finding.

    def _look(self, depth: Float32, at_s: float) -> None:
        s = self.settings
        self._refused = [(at, frame) for at, frame in self._refused if self._frames - frame < s.refuse_for]
        candidates = [
            candidate
            for candidate in palm_candidates(depth, self._lens, s.region)
            if not any(self._same(arm, candidate) for arm in self._arms)
            and not any(np.linalg.norm(candidate.centre - at) < _REFUSED_M for at, _ in self._refused)
        ]
        found = [one for candidate in candidates for one in self._best(depth, candidate)]
        for one in self._judged(depth, self._apart(found)):
            rivals = [arm for arm in self._arms if self._overlap(_Found(0.0, arm.side, arm.fitted), one)]
            if rivals:  # the same arm, from its other end
                best = self._judged(depth, [one, *(_Found(0.0, arm.side, arm.fitted) for arm in rivals)])[0]
                if best.fitted is not one.fitted:
                    continue
            elif len(self._arms) == s.arms:  # one that was never sure makes room
                rivals = [max(self._arms, key=lambda arm: (arm.firm < _FIRM_AFTER, arm.fitted.cost))]
                if rivals[0].firm >= _FIRM_AFTER or _MUCH_BETTER * rivals[0].fitted.cost < one.cost:
                    continue
            for arm in rivals:
                self._arms.remove(arm)
            arm = _Arm(self._next_id, one.side, one.fitted, at_s)
            self._next_id += 1
            arm.region = self._region(depth, self.models[one.side].spheres(one.fitted.pose))
            arm.sure = self._sure(one, found)
            self._arms.append(arm)
        for candidate in candidates:
            if self._arms and not any(self._same(arm, candidate) for arm in self._arms):
                self._refused.append((candidate.centre, self._frames))

    def _palm(self, side: Handedness, fitted: Fitted) -> Float64:
        return np.asarray(self.models[side].points(fitted.pose)[PALM])

    def _apart(self, found: list[_Found]) -> list[_Found]:
        """The best at each place, of whichever side."""
        kept: list[_Found] = []
        for one in sorted(found, key=lambda one: one.cost):
            if not any(self._near(other, one) for other in kept):
                kept.append(one)
        return kept

    def _near(self, one: _Found, other: _Found) -> bool:
        apart = self._palm(one.side, one.fitted) - self._palm(other.side, other.fitted)
        return float(np.linalg.norm(apart)) < 0.5 * _REFUSED_M

    def _sure(self, one: _Found, found: list[_Found]) -> float:
        """How sure the side of a hand is, by how much better it is than the best of the other side there."""
        others = [other.cost for other in found if other.side != one.side and self._near(other, one)]
        if not others:
            return _SUREST
        return float(np.clip(0.5 + 0.5 * (min(others) - one.cost) / max(one.cost, 1e-6), 0.5, _SUREST))

    def _overlap(self, one: _Found, other: _Found) -> bool:
        """Whether two are of one forearm or hand."""
        a = self.models[one.side].spheres(one.fitted.pose)[:, :3]
        b = self.models[other.side].spheres(other.fitted.pose)[:, :3]
        near = np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1) < 0.04
        return bool(near.mean() > 0.2)

    def _judged(self, depth: Float32, found: list[_Found]) -> list[_Found]:
        """The best first, by how well each explains what is around any of them."""
        if len(found) < 2:
            return found
        judged: list[tuple[float, int]] = []
        for k, one in enumerate(found):
            rivals = [other for other in found if other is one or self._overlap(one, other)]
            around = np.vstack([self.models[other.side].spheres(other.fitted.pose) for other in rivals])
            part = self._region(depth, around)
            if part is None:
                continue
            model = self.models[one.side]
            points = np.ascontiguousarray(part.points)
            evidence = Evidence(points, np.ones(len(points)), part.front, part.opposite, part.lens)
            around_cost = model.fit(one.fitted.pose, model.unexpected(one.fitted.pose), evidence, iterations=0).cost
            judged.append((around_cost + one.fitted.cost, k))
        return [found[k] for _, k in sorted(judged)]

    def _same(self, arm: _Arm, candidate: PalmCandidate) -> bool:
        spheres = self.models[arm.side].spheres(arm.fitted.pose)
        spheres = spheres[spheres[:, 4] > 0]
        return bool((np.linalg.norm(spheres[:, :3] - candidate.centre, axis=1) < spheres[:, 3] + 0.04).any())

    def _best(self, depth: Float32, candidate: PalmCandidate) -> list[_Found]:
        """The hand of either side that fits best there: all starts a little, the better ones more."""
        part = self._region(depth, candidate.spheres)
        if part is None or len(part.points) < _FEW:
            return []
        pool: list[tuple[_Found, Float64 | None]] = []
        for side, model in self.models.items():
            for start, tips in _starts(model, candidate):
                evidence = _evidence(part, model, start, 120, 0.3)
                fitted = model.fit(
                    start, model.unexpected(start), evidence, iterations=4, loose=3.0, tips=tips, keep=1.0
                )
                pool.append((_Found(fitted.cost, side, fitted), tips))
        for most, points, iterations, loose in _ROUNDS:
            better = []
            for (_, side, before), tips in _of_each_side(pool, most):
                model = self.models[side]
                closer = self._region(depth, model.spheres(before.pose)) if points > 250 else part
                if closer is None:
                    continue
                evidence = _evidence(closer, model, before.pose, points, 0.3)
                fitted = model.fit(
                    before.pose, model.unexpected(before.pose), evidence, iterations=iterations, loose=loose,
                    tips=tips if points <= 250 else None,
                )  # fmt: skip
                better.append((_Found(fitted.cost, side, fitted), tips))
            pool = better
        best = (self._repaired(depth, one) for one, _ in _of_each_side(pool, 1) if one.cost < _HOPELESS)
        return [one for one in best if one.cost <= self.settings.believe]

    def _repaired(self, depth: Float32, found: _Found) -> _Found:
        """With each digit held otherwise where that is better."""
        model, fitted = self.models[found.side], found.fitted
        left = set(range(5))
        for _ in range(_REPAIRS):
            part = self._region(depth, model.spheres(fitted.pose))
            if part is None or not left:
                break
            evidence = _evidence(part, model, fitted.pose, 400, 0.3)
            gain, start, digit = max(
                ((*model.held_otherwise(fitted.pose, evidence, digit), digit) for digit in left),
                key=lambda way: way[0],
            )
            if gain < self.settings.gain:
                break
            other = model.fit(start, model.unexpected(start), evidence, iterations=6, loose=1.5)
            if other.cost < 0.98 * self._cost(model, fitted.pose, evidence):
                fitted, left = other, set(range(5))
            else:
                left.discard(digit)
        part = self._region(depth, model.spheres(fitted.pose))
        if part is None:
            return _Found(fitted.cost, found.side, fitted)
        evidence = _evidence(part, model, fitted.pose, beyond=0.3)
        ends = [
            model.fit(fitted.pose, model.unexpected(fitted.pose), evidence, iterations=iterations, loose=loose)
            for iterations, loose in ((0, 1.0), (12, 1.0), (12, 2.0))
        ]
        best = min(ends, key=lambda end: end.cost)
        return _Found(best.cost + _HIDDEN * float(best.costs[4]), found.side, best)

    # Telling.

    def _told(self, arm: _Arm) -> SeenArm:
        model, pose = self.models[arm.side], arm.fitted.pose
        points = model.points(pose)
        seen = np.zeros(len(points), np.bool_)
        if arm.region is not None:
            seen = model.visible(pose, _evidence(arm.region, model, pose)) > _VISIBLE
        states = np.where(seen, JointState.TRACKED, JointState.INFERRED).astype(np.uint8)
        sd = np.where(states == JointState.TRACKED, 0.006, 0.02).astype(np.float32)
        return SeenArm(
            arm.id, arm.side == "left", arm.sure, points, states, sd, model.angles(pose), pose.T_camera_palm
        )  # fmt: skip


def _evidence(part: Region, model: ArmModel, pose: ArmPose, most: int = 10_000, beyond: float = 0.05) -> Evidence:
    points = np.ascontiguousarray(part.points[:: max(-(-len(part.points) // most), 1)])
    return Evidence(points, model.relevance(points, pose, beyond), part.front, part.opposite, part.lens)


def _of_each_side(pool: list[tuple[_Found, Float64 | None]], most: int) -> list[tuple[_Found, Float64 | None]]:
    """The best of either side, so many at most."""
    pool = sorted(pool, key=lambda entry: entry[0].cost)
    return [entry for side in ("right", "left") for entry in [one for one in pool if one[0].side == side][:most]]


def _motion(before: ArmPose, after: ArmPose) -> Float64:
    turn = fit_kernels().turn_between(before.R, 0, after.R)
    moved = before.R.reshape(3, 3).T @ (after.t - before.t)
    return np.concatenate([moved, turn, after.z - before.z])


def _starts(model: ArmModel, candidate: PalmCandidate) -> Iterator[tuple[ArmPose, Float64 | None]]:
    """Poses to begin from, and where fingertips should be.

    The palm or the back of the hand is to the camera, along the forearm. The tips that were found go round the hand as
    the digits do; where they are fewer than five, every choice of digits is tried, and the others are bent. Where there
    is none, the hand is a fist, or seen from its side.
    """
    normal, tips = candidate.normal, candidate.tips
    edge_on = candidate.radius_m < _EDGE_ON_M
    for z_axis in _pointing(candidate):
        y_axis = _across(normal, z_axis, candidate.centre)
        for roll in _ROLLS:
            y = np.cos(roll) * y_axis + np.sin(roll) * np.cross(z_axis, y_axis)
            R = np.stack([np.cross(y, z_axis), y, z_axis], axis=1)
            t = candidate.centre - 0.012 * normal - R @ (0.5 * model.shape.bases[2] * model.shape.mirror)
            v = model.state()
            if candidate.forearm is not None:
                v[4:7] = R.T @ candidate.forearm
                # The upper arm goes back to the shoulder, away from the camera.
                back = 0.5 * candidate.forearm + candidate.centre / np.linalg.norm(candidate.centre)
                v[7:10] = R.T @ (back / np.linalg.norm(back))
            turned = np.ascontiguousarray(R).reshape(9)
            if roll in _FLAT or len(tips) < 2:
                # Seen from its back, a right hand's digits go clockwise from the thumb on.
                clockwise = (np.cos(roll) > 0) == (model.mirror > 0)
                ordered = tips[::-1] if clockwise else tips
                for digits in combinations(range(5), len(tips)):
                    z = _posed(model, tuple(_OPEN[d] if d in digits else _BENT[d] for d in range(5)))
                    targets = np.full((5, 3), np.nan)
                    targets[list(digits)] = ordered
                    yield ArmPose(turned, t.copy(), z, v.copy()), targets
            if len(tips) < 2 or (edge_on and roll not in _FLAT):
                for shift in _SHIFTS_M:
                    for postures in (_OPEN, _BENT, _HOLDING):
                        yield ArmPose(turned, t + shift * z_axis, _posed(model, postures), v.copy()), None


def _pointing(candidate: PalmCandidate) -> list[Float64]:
    """Where the hand may point: away from the forearm, else to the fingertips, else anywhere across the normal."""
    normal, tips = candidate.normal, candidate.tips
    if candidate.forearm is not None:
        return [-candidate.forearm]
    if len(tips) >= 2:
        mean = tips.mean(axis=0) - candidate.centre
        return [mean / np.linalg.norm(mean)]
    across = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(normal, across)
    return [np.cos(a) * across + np.sin(a) * other for a in np.arange(6) * np.pi / 3]


def _across(normal: Float64, z_axis: Float64, centre: Float64) -> Float64:
    """The normal's part across the hand's axis; where there is none, that of the view."""
    for direction in (normal, -centre / np.linalg.norm(centre), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        across = direction - (direction @ z_axis) * z_axis
        length = float(np.linalg.norm(across))
        if length > 0.3:
            break
    return np.asarray(across / length)


_FLAT: Final = (0.0, np.pi)
_EDGE_ON_M: Final = 0.026
"""A hand in which no larger circle fits may be seen from its side."""
_ROLLS: Final = (*_FLAT, 0.5 * np.pi, -0.5 * np.pi)
_OPEN: Final = ((0, 0, 10), *[(5, 0, 8)] * 4)
_BENT: Final = ((0, 0, 40), *[(70, 0, 85)] * 4)
_HOLDING: Final = ((10, -15, 40), *[(45, 0, 60)] * 4)
"""Flexion, abduction and second flexion of thumb to little finger [degrees]."""
_SHIFTS_M: Final = (-0.03, 0.0, 0.03)
"""Along the hand: where there are no fingers to be seen, its middle is not known so well."""


_ROUNDS: Final = ((5, 250, 8, 2.0), (2, 400, 8, 1.5))
"""How many starts of either side are kept, with how many points, iterations, and how loose at the beginning."""
_HOPELESS: Final = 0.4
_HIDDEN: Final = 0.3
"""An arm that is all but hidden is none, when it is first seen."""
_MUCH_BETTER: Final = 0.7
_SUREST: Final = 0.95
_FIRM_AFTER: Final = 5
_REFUSED_M: Final = 0.08
_FEW: Final = 40
_VISIBLE: Final = 0.05

_REPAIRS: Final = 10


def _posed(model: ArmModel, flexions: tuple[tuple[int, int, int], ...]) -> Float64:
    z = model.natural.copy()
    for digit, held in enumerate(flexions):
        _bend(model, z, digit, *held)
    fit_kernels().within(model.digits, model.columns, model.gains, z, model.c_max)
    return z


def _bend(model: ArmModel, z: Float64, digit: int, flexion: float, abduction: float, middle: float) -> None:  # noqa: PLR0917
    """Hold a digit so [degrees]."""
    columns = model.columns[digit]
    for k, value in ((0, flexion), (1, abduction), (2, middle), (3, middle * model.model.coupling[digit])):
        if columns[k] >= 0:
            z[columns[k]] = np.radians(value)
