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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.kinematics.arm_fit import ArmFitSettings, ArmModel, ArmPose, Evidence, Expected, Fitted
from mocapella.kinematics.arm_fit import kernels as fit_kernels
from mocapella.model.arms import SeenArm, SeenArms
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
        doubt: an arm whose cost is above this is looked for anew …
        better: … and changed for one whose cost is below this part of its own.
        lost_after: frames in a row that an arm may be doubtful.
        look_every: frames between two looks for further arms, while there is one.
        region, fit: of the steps.
    """

    arms: int = 2
    hand_length_m: float = 0.189
    believe: float = 0.35
    keep: float = 0.6
    doubt: float = 0.12
    better: float = 0.8
    lost_after: int = 3
    look_every: int = 5
    region: ArmRegionSettings = field(default_factory=ArmRegionSettings)
    fit: ArmFitSettings = field(default_factory=ArmFitSettings)

    def __post_init__(self) -> None:
        check(1 <= self.arms <= 8, "arms", self.arms, "1 to 8")
        check(0.1 <= self.hand_length_m <= 0.3, "hand_length_m", self.hand_length_m, "0.1 to 0.3 m")
        check(0 < self.believe <= self.keep < 2, "believe", self.believe, "above 0, at most keep, which is below 2")
        check(1 <= self.lost_after <= 1000, "lost_after", self.lost_after, "1 to 1000")
        check(1 <= self.look_every <= 1000, "look_every", self.look_every, "1 to 1000")


class _Arm:
    """An arm that is followed."""

    def __init__(self, number: int, side: Handedness, fitted: Fitted, at_s: float) -> None:
        self.id, self.side, self.fitted, self.at_s = number, side, fitted, at_s
        self.velocity = np.zeros(6 + len(fitted.pose.z))
        self.doubtful = 0
        self.evidence = 0.0
        self.region: Region | None = None


class DepthArms:
    """Follows arms from image to image."""

    name = "default"

    def __init__(self, camera: Camera, settings: DepthArmsSettings | None = None) -> None:
        self.camera, self.settings = camera, settings or DepthArmsSettings()
        model = hand_model("full").stretched(25.0, 20.0)
        s = self.settings
        sides: tuple[Handedness, Handedness] = ("right", "left")
        self.models = {
            side: ArmModel(model, model.shape(side, hand_length_m=s.hand_length_m), s.fit) for side in sides
        }
        self._lens = np.asarray(camera.lens, dtype=np.float64)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arms: list[_Arm] = []
        self._frames = self._next_id = 0

    def update(self, depth: Float32, at_s: float) -> SeenArms:
        """As `ArmMethod.update` says."""
        width, height = self.camera.size_px
        if depth.shape != (height, width):
            raise SettingsError(f"a depth image of {depth.shape[::-1]}; camera {self.camera.name} has {(width, height)}")
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        for arm in list(self._arms):
            if not self._follow(arm, depth, at_s):
                self._arms.remove(arm)
        if len(self._arms) < self.settings.arms and (not self._arms or self._frames % self.settings.look_every == 0):
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
        if part is None:
            return False
        fitted = model.fit(predicted, self._expected(model, arm, predicted, dt), _evidence(part, model, predicted))
        side = arm.side
        if fitted.cost > s.doubt:
            better = self._again(depth, fitted, arm)
            if better is not None and better[1].cost < s.better * fitted.cost:
                side, fitted = better
                part = self._region(depth, self.models[side].spheres(fitted.pose)) or part
        arm.doubtful = arm.doubtful + 1 if fitted.cost > s.keep else 0
        if arm.doubtful >= s.lost_after:
            return False
        if side == arm.side:
            arm.velocity = 0.6 * _motion(arm.fitted.pose, fitted.pose) / dt + 0.4 * arm.velocity
        arm.fitted, arm.at_s, arm.region, arm.side = fitted, at_s, part, side
        return True

    def _again(self, depth: Float32, fitted: Fitted, arm: _Arm) -> tuple[Handedness, Fitted] | None:
        """The hand found anew where it is, or may have gone."""
        centre = self.models[arm.side].points(fitted.pose)[21]
        best: tuple[Handedness, Fitted] | None = None
        for candidate in palm_candidates(depth, self._lens, self.settings.region):
            if np.linalg.norm(candidate.centre - centre) < 0.15:
                found = self._best_start(depth, candidate)
                if found is not None and (best is None or found[1].cost < best[1].cost):
                    best = found
        return None if best is None else self._repaired(depth, *best)

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
        found: list[tuple[float, Handedness, Fitted]] = []
        for candidate in palm_candidates(depth, self._lens, s.region):
            if not any(self._same(arm, candidate) for arm in self._arms):
                best = self._best_start(depth, candidate)
                if best is not None and best[1].cost <= s.believe:
                    found.append((best[1].cost, *best))
        found.sort(key=lambda one: one[0])
        found = [(one[1].cost, *one) for one in (self._repaired(depth, *pair[1:]) for pair in found[: s.arms + 1])]
        found.sort(key=lambda one: one[0])
        for _, side, fitted in found:
            if len(self._arms) == s.arms:
                return
            centre = self.models[side].points(fitted.pose)[21]
            if any(np.linalg.norm(self.models[arm.side].points(arm.fitted.pose)[21] - centre) < 0.08 for arm in self._arms):
                continue
            arm = _Arm(self._next_id, side, fitted, at_s)
            self._next_id += 1
            arm.region = self._region(depth, self.models[side].spheres(fitted.pose))
            self._arms.append(arm)

    def _same(self, arm: _Arm, candidate: PalmCandidate) -> bool:
        spheres = self.models[arm.side].spheres(arm.fitted.pose)
        return bool((np.linalg.norm(spheres[:, :3] - candidate.centre, axis=1) < spheres[:, 3] + 0.04).any())

    def _best_start(self, depth: Float32, candidate: PalmCandidate) -> tuple[Handedness, Fitted] | None:
        part = self._region(depth, candidate.spheres)
        if part is None or len(part.points) < 60:
            return None
        tried: list[tuple[float, Handedness, Fitted]] = []
        for side, model in self.models.items():
            for start, tips in _starts(model, candidate):
                fitted = model.fit(start, model.unexpected(start), _evidence(part, model, start, 200, 0.3), iterations=6, loose=3.0, tips=tips)
                tried.append((fitted.cost, side, fitted))
        tried.sort(key=lambda one: one[0])
        found: list[tuple[float, Handedness, Fitted]] = []
        for _, side, fitted in tried[:12]:
            model = self.models[side]
            finer = self._region(depth, model.spheres(fitted.pose))
            if finer is None:
                continue
            better = model.fit(fitted.pose, model.unexpected(fitted.pose), _evidence(finer, model, fitted.pose, 400, 0.3), iterations=8)
            found.append((better.cost, side, better))
        if not found:
            return None
        found.sort(key=lambda one: one[0])
        DEBUG.append([(round(c, 3), np.round(f.costs,3), a, bool(f.pose.R[5+2-0-0] > 9) , 'back' if f.pose.R[7] < 0 else 'palm') for c, a, f in found])
        return found[0][1], found[0][2]

    def _repaired(self, depth: Float32, side: Handedness, fitted: Fitted) -> tuple[Handedness, Fitted]:
        """With each digit held otherwise where that is better."""
        model = self.models[side]
        for digit in range(5):
            part = self._region(depth, model.spheres(fitted.pose))
            if part is None:
                break
            for flexion, abduction, middle in _OTHERWISE[digit > 0]:
                start = fitted.pose.copied()
                _bend(model, start.z, digit, flexion, abduction, middle)
                fit_kernels().within(model.digits, model.columns, model.gains, start.z, model.c_max)
                other = model.fit(start, model.unexpected(start), _evidence(part, model, start, 400, 0.3), iterations=5, loose=1.5)
                if other.cost < 0.97 * fitted.cost:
                    fitted = other
        return side, fitted

    # Telling.

    def _told(self, arm: _Arm) -> SeenArm:
        model, pose = self.models[arm.side], arm.fitted.pose
        points = model.points(pose)
        states = _states(points, arm.region, model, pose)
        sd = np.where(states == JointState.TRACKED, 0.006, 0.02).astype(np.float32)
        return SeenArm(
            arm.id, arm.side == "left", 0.75, points, states, sd, model.angles(pose), pose.T_camera_palm
        )  # fmt: skip


def _states(points: Float64, part: Region | None, model: ArmModel, pose: ArmPose) -> NDArray[np.uint8]:
    """Measured where the image has the flesh's surface at the joint."""
    states = np.full(len(points), JointState.INFERRED, dtype=np.uint8)
    if part is None:
        return states
    radii = np.full(len(points), 0.015)
    radii[1:21] = (model.radii[:5, :4] * pose.v[0] * pose.v[1]).reshape(20)
    radii[22] = 0.035
    height, width = part.front.shape
    for i, (x, y, z) in enumerate(points):
        if z < 0.1:
            continue
        u, v = part.lens[0] * x / z + part.lens[2], part.lens[1] * y / z + part.lens[3]
        j, k = round(float(u)), round(float(v))
        if not (0 <= j < width and 0 <= k < height):
            continue
        near = part.front[max(k - 1, 0) : k + 2, max(j - 1, 0) : j + 2]
        fits = np.abs(near - (z - radii[i])) < 0.010
        if fits.sum() >= 2:
            states[i] = JointState.TRACKED
    return states


def _evidence(part: Region, model: ArmModel, pose: ArmPose, most: int = 10_000, beyond: float = 0.05) -> Evidence:
    points = np.ascontiguousarray(part.points[:: -(-len(part.points) // most)])
    return Evidence(points, model.relevance(points, pose, beyond), part.front, part.nearest_x, part.nearest_y, part.lens)


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
    if candidate.forearm is not None:
        pointing = [-candidate.forearm]
    elif len(tips) >= 2:
        mean = tips.mean(axis=0) - candidate.centre
        pointing = [mean / np.linalg.norm(mean)]
    else:
        across = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        other = np.cross(normal, across)
        pointing = [np.cos(a) * across + np.sin(a) * other for a in np.arange(6) * np.pi / 3]
    for z_axis in pointing:
        y_axis = _across(normal, z_axis, candidate.centre)
        for roll in _ROLLS:
            if len(tips) >= 3 and roll not in _FLAT:
                continue
            y = np.cos(roll) * y_axis + np.sin(roll) * np.cross(z_axis, y_axis)
            R = np.stack([np.cross(y, z_axis), y, z_axis], axis=1)
            t = candidate.centre - 0.012 * normal - R @ (0.5 * model.shape.bases[2] * model.shape.mirror)
            v = model.state()
            if candidate.forearm is not None:
                v[4:7] = R.T @ candidate.forearm
                v[7:10] = v[4:7]
            # Seen from its back, a right hand's digits go clockwise from the thumb on.
            clockwise = (np.cos(roll) > 0) == (model.mirror > 0)
            ordered = tips[::-1] if clockwise else tips
            for digits in combinations(range(5), len(tips)):
                z = _posed(model, tuple(_OPEN[d] if d in digits else _BENT[d] for d in range(5)))
                targets = np.full((5, 3), np.nan)
                targets[list(digits)] = ordered
                yield ArmPose(np.ascontiguousarray(R).reshape(9), t.copy(), z, v.copy()), targets
            if len(tips) < 2:
                yield ArmPose(np.ascontiguousarray(R).reshape(9), t.copy(), _posed(model, _OPEN), v.copy()), None


def _across(normal: Float64, z_axis: Float64, centre: Float64) -> Float64:
    """The normal's part across the hand's axis; where there is none, that of the view."""
    for direction in (normal, -centre / np.linalg.norm(centre), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        across = direction - (direction @ z_axis) * z_axis
        length = float(np.linalg.norm(across))
        if length > 0.3:
            break
    return np.asarray(across / length)


DEBUG: list = []
_FLAT: Final = (0.0, np.pi)
_ROLLS: Final = (*_FLAT, 0.5 * np.pi, -0.5 * np.pi)
_OPEN: Final = ((0, 0, 10), *[(5, 0, 8)] * 4)
_BENT: Final = ((0, 0, 40), *[(70, 0, 85)] * 4)
"""Flexion, abduction and second flexion of thumb to little finger [degrees]."""


_OTHERWISE: Final = (
    ((0, 0, 10), (20, 15, 50), (-20, -15, 10), (20, -15, 50)),
    ((0, 0, 5), (45, 0, 45), (80, 0, 95), (5, 0, 95), (80, 0, 15)),
)
"""Of a thumb, and of a finger: straight, half bent, fist, hook, at right angles to the palm."""


def _posed(model: ArmModel, flexions: tuple[tuple[int, int, int], ...]) -> Float64:
    z = model.natural.copy()
    for digit, held in enumerate(flexions):
        _bend(model, z, digit, *held)
    fit_kernels().within(model.digits, model.columns, model.gains, z, model.c_max)
    return z


def _bend(model: ArmModel, z: Float64, digit: int, flexion: float, abduction: float, middle: float) -> None:
    """Hold a digit so [degrees]."""
    columns = model.columns[digit]
    for k, value in ((0, flexion), (1, abduction), (2, middle), (3, middle * model.model.coupling[digit])):
        if columns[k] >= 0:
            z[columns[k]] = np.radians(value)
