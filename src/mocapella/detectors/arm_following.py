"""Arms and hands in the images of one depth camera: found, followed, and told. The detector ``kinematic-arm``.

An image goes through three steps: the part of it that may be an arm (`sensing.arm_region`), a kinematic arm and hand
fitted to its points (`kinematics.arm_fit`), and the observation made from it. A known arm is tracked from its
prediction; without one, palms are looked for in the whole image and the fit begins from several poses of either hand.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.arm_finding import SUREST, ArmFinder, Found, cost_of, evidence_of
from mocapella.errors import SettingsError
from mocapella.kinematics.arm_fit import ArmEvidence, ArmFitSettings, ArmModel, ArmPose, Expected, Fitted
from mocapella.kinematics.arm_fit import kernels as fit_kernels
from mocapella.model.arms import PALM, SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import TIPS, Handedness, hand_model
from mocapella.model.observations import JointState
from mocapella.sensing.arm_region import ArmRegionSettings, Region, within
from mocapella.sensing.depth_foreground import DepthForeground
from mocapella.settings import check
from mocapella.steps import Steps, at_once

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class KinematicArmSettings:
    """How arms are found and followed.

    Attributes:
        arms: at most.
        hand_length_m: of the average hand.
        believe: a fit whose cost is above this is no arm.
        keep: likewise of an arm that is followed.
        digits: so many digits are looked at in each image for a better way to hold them, all where it is doubtful.
        gain: a way is tried where it promises to lower the cost by so much.
        doubt: an arm whose cost is above this is doubtful.
        better: another pose is taken when its cost is below this part of that of the arm's own.
        look_again_after: images for which a hand is doubtful before it is looked for anew where it is, and twice as
            long each time that nothing better is found.
        firm: an arm is reported once its cost was below this; after some images below it, no replacement is looked for.
        refuse_for: images for which a place is not looked at again where no arm was; eight times as long while there is
            an arm, and twice as long each time.
        lost_after: frames in a row that an arm may be doubtful.
        look_every: frames between two looks for further arms where something came nearer, while there is one.
        look_anyway_every: likewise where nothing did.
        region, fit: of the steps.
    """

    arms: int = 2
    hand_length_m: float = 0.189
    believe: float = 0.30
    keep: float = 0.38
    digits: int = 2
    gain: float = 0.006
    doubt: float = 0.14
    better: float = 0.93
    look_again_after: int = 12
    firm: float = 0.19
    refuse_for: int = 8
    lost_after: int = 3
    look_every: int = 20
    look_anyway_every: int = 150
    region: ArmRegionSettings = field(default_factory=ArmRegionSettings)
    fit: ArmFitSettings = field(default_factory=ArmFitSettings)

    def __post_init__(self) -> None:
        check(1 <= self.arms <= 8, "arms", self.arms, "1 to 8")
        check(0.1 <= self.hand_length_m <= 0.3, "hand_length_m", self.hand_length_m, "0.1 to 0.3 m")
        check(0 < self.believe <= self.keep < 2, "believe", self.believe, "above 0, at most keep, which is below 2")
        check(1 <= self.digits <= 5, "digits", self.digits, "1 to 5")
        check(0 < self.gain < 2, "gain", self.gain, "above 0, below 2")
        check(0 < self.doubt < 2, "doubt", self.doubt, "above 0, below 2")
        check(0 < self.better <= 1, "better", self.better, "above 0, at most 1")
        check(0 < self.firm < 2, "firm", self.firm, "above 0, below 2")
        check(1 <= self.look_again_after <= 1000, "look_again_after", self.look_again_after, "1 to 1000")
        check(1 <= self.refuse_for <= 100_000, "refuse_for", self.refuse_for, "1 to 100000")
        check(1 <= self.lost_after <= 1000, "lost_after", self.lost_after, "1 to 1000")
        check(1 <= self.look_every <= 1000, "look_every", self.look_every, "1 to 1000")
        check(1 <= self.look_anyway_every <= 100_000, "look_anyway_every", self.look_anyway_every, "1 to 100000")


class _Arm:
    """An arm that is followed."""

    def __init__(self, side: Handedness, model: ArmModel, fitted: Fitted, at_s: float, wait: int) -> None:
        self.side, self.model, self.fitted, self.at_s = side, model, fitted, at_s
        self.id = -1
        self.velocity = np.zeros(6 + len(fitted.pose.z))
        self.doubtful = self.in_doubt = self.firm = self.next_digit = 0
        self.wait, self.sure, self.believed = wait, SUREST, False
        self.region: Region | None = None

    def moved(self, fitted: Fitted, dt: float) -> None:
        """Take in the pose of the next image."""
        self.velocity = 0.6 * _motion(self.fitted.pose, fitted.pose) / dt + 0.4 * self.velocity
        self.fitted = fitted


@dataclass(eq=False)
class _Refused:
    """A place where no arm was."""

    centre: Float64
    wait: int
    until: int = 0


class _Look:
    """A search for further arms. It takes longer than an image may, so it is spread over the images that follow.

    Attributes:
        depth, at_s: the image that is looked at.
        images: (depth, time) of the images since; arms that are found are tracked through them.
        newest: of them.
        steps: the work.
    """

    steps: Steps[None]

    def __init__(self, depth: Float32, at_s: float) -> None:
        # The caller's images may be written over.
        self.depth, self.at_s = depth.copy(), at_s
        self.newest = self.depth
        self.images: list[tuple[Float32, float]] = []

    def add(self, depth: Float32, at_s: float) -> None:
        """Another image has come."""
        self.newest = depth.copy()
        self.images.append((self.newest, at_s))
        if len(self.images) > _MOST_IMAGES:
            del self.images[-2::-2]

    def go_on(self, work: float) -> bool:
        """Do so much of it; whether there is more to do."""
        done = 0
        while done < work:
            try:
                done += next(self.steps)
            except StopIteration:
                return False
        return True


class KinematicArmDetector:
    """Follows arms from image to image."""

    name = "kinematic-arm"

    def __init__(self, camera: Camera, settings: KinematicArmSettings | None = None) -> None:
        self.camera, self.settings = camera, settings or KinematicArmSettings()
        model = hand_model("full").stretched(25.0, 28.0, 4.0)
        s = self.settings
        sides: tuple[Handedness, Handedness] = ("right", "left")
        self.models = {side: ArmModel(model, model.shape(side, hand_length_m=s.hand_length_m), s.fit) for side in sides}
        lens = np.asarray(camera.lens, dtype=np.float64)
        self.finder = ArmFinder(self.models, lens, s.region, s.believe, s.gain)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arms: list[_Arm] = []
        self._refused: list[_Refused] = []
        self._frames = self._next_id = 0
        self._look: _Look | None = None
        self._unfinished = False
        self._nearer = DepthForeground(self.finder.lens, self.settings.region)

    def update(self, depth: Float32, at_s: float) -> SeenArms:
        """Look at the next image, as `mocapella.detectors.ArmDetector` says."""
        width, height = self.camera.size_px
        if depth.shape != (height, width):
            raise SettingsError(
                f"the depth image is {depth.shape[1]} × {depth.shape[0]}; "
                f"camera {self.camera.name} has {width} × {height} px"
            )
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        if self._look is not None:
            self._look.add(depth, at_s)
        for arm in list(self._arms):
            if not self._follow(arm, depth, at_s):
                self._arms.remove(arm)
                self._refused, self._unfinished = [], True  # it may have stood for another
        self._begin_look(depth, at_s)
        if self._look is not None and self._unsure:
            self._look.go_on(np.inf)  # nothing waits
            self._look = None
        elif self._look is not None and not self._look.go_on(_WORK[len(self._arms) > 1][self._looks]):
            self._look = None
        self._frames += 1
        told = tuple(self._told(arm) for arm in sorted(self._believed(), key=lambda arm: arm.id))
        return SeenArms(told, "" if told else self._reason(depth))

    @property
    def _unsure(self) -> bool:
        """Whether no arm is reported, or none is firm and some places have not been searched."""
        return not self._believed() or (self._unfinished and all(arm.firm < _FIRM_AFTER for arm in self._arms))

    @property
    def _looks(self) -> bool:
        """Whether nothing else is looked for in this image than the look that is under way does: in every other."""
        return self._look is not None and self._frames % 2 == 1

    def _believed(self) -> list[_Arm]:
        """Those that once fitted well."""
        for arm in self._arms:
            arm.believed |= arm.fitted.cost < self.settings.firm
        return [arm for arm in self._arms if arm.believed]

    def _reason(self, depth: Float32) -> str:
        s = self.settings.region
        there = depth > 0
        if not there.any():
            return "nothing was measured in the whole image"
        if not ((depth >= s.near_m) & (depth <= s.far_m)).any():
            return f"nothing is between {s.near_m:g} and {s.far_m:g} m"
        return "what may be a hand does not fit one well" if self._arms else "no hand is seen"

    # Following.

    def _follow(self, arm: _Arm, depth: Float32, at_s: float) -> bool:
        model, s = arm.model, self.settings
        dt = max(at_s - arm.at_s, 1e-3)
        predicted = self._predicted(arm, dt)
        part = self.finder.region(depth, model.spheres(predicted))
        if part is None:
            return False
        expected, evidence = self._expected(arm, predicted, dt), evidence_of(part, model, predicted)
        fitted = model.fit(predicted, expected, evidence)
        usual = _JUMP * arm.fitted.cost
        jumped = fitted.cost > usual  # it turned, or stopped: not as was predicted
        if jumped:
            other = self._elsewhere(arm, predicted, expected, evidence, evidence_of(part, model, predicted, _FEW))
            if other.cost < _MARGIN * fitted.cost:
                fitted = other
        arm.moved(fitted, dt)
        arm.at_s, arm.region = at_s, part
        doubt = fitted.cost > min(s.doubt, usual)
        if (doubt or not jumped) and not self._looks:  # no image should take too long
            self._search(arm, depth, doubt, jumped)
        arm.doubtful = arm.doubtful + 1 if arm.fitted.cost > s.keep else 0
        arm.firm = min(arm.firm + 1, _FIRM_AFTER) if arm.fitted.cost < s.firm else max(arm.firm - 1, 0)
        return arm.doubtful < s.lost_after

    @staticmethod
    def _elsewhere(
        arm: _Arm, predicted: ArmPose, expected: Expected, evidence: ArmEvidence, few: ArmEvidence
    ) -> Fitted:
        """The best fit of a hand that is anywhere about: in so short a time its posture hardly changes."""
        model = arm.model

        def rigid(starts: list[ArmPose]) -> list[Fitted]:
            return [
                model.fit(pose, model.rigid(pose, _POSTURE_SD), few, iterations=_COARSELY, loose=4.0) for pose in starts
            ]

        others = rigid([predicted, arm.fitted.pose])
        if min(other.cost for other in others) > _JUMP * arm.fitted.cost:
            others += rigid([predicted._replace(t=predicted.t + shift) for shift in _SHIFTS_M])
        best = min(others, key=lambda other: other.cost)
        certainty = expected.certainty.copy()
        certainty[:6] = 0.0
        return model.fit(best.pose, replace(expected, certainty=certainty), evidence, iterations=4, loose=1.0)

    def _search(self, arm: _Arm, depth: Float32, doubt: bool, jumped: bool) -> None:
        """Look for digits that fit better otherwise; look for the hand anew where it has been doubtful for long.

        Args:
            arm, depth: see there.
            doubt: not only some digits are looked at, but all of them, and postures of the whole hand.
            jumped: the hand was looked for elsewhere in this image, which took its time: single digits wait.
        """
        s = self.settings
        assert arm.region is not None
        model, pose = arm.model, arm.fitted.pose
        evidence = evidence_of(arm.region, model, pose, _FEW, 0.15)
        arm.in_doubt = arm.in_doubt + 1 if doubt else 0
        starts = []
        if not jumped and (arm.in_doubt <= _AT_ONCE or arm.in_doubt % 2):
            digits = range(5) if doubt else [(arm.next_digit + k) % 5 for k in range(s.digits)]
            arm.next_digit = (arm.next_digit + s.digits) % 5
            gain, start = max((model.held_otherwise(pose, evidence, digit) for digit in digits), key=lambda way: way[0])
            starts = [start] if gain > s.gain else []
        if doubt and (arm.in_doubt <= _AT_ONCE or not arm.in_doubt % 2):
            poses = [*model.exchanged(pose), *model.alike(pose)]
            coarse = evidence_of(arm.region, model, pose, _FEWER, 0.15)
            starts += sorted(poses, key=lambda pose: cost_of(model, pose, coarse))[:_TRIED]
        if starts:
            fits = [model.fit(start, model.unexpected(start), evidence, iterations=5, loose=2.0) for start in starts]
            other = min(fits, key=lambda other: other.cost)
            if other.cost < s.better * cost_of(model, pose, evidence):
                self._change(arm, arm.side, other, arm.region)
        if arm.in_doubt >= arm.wait:
            arm.in_doubt, arm.wait = 0, min(2 * arm.wait, _LONGEST_WAIT)
            self._anew(arm, depth)

    def _anew(self, arm: _Arm, depth: Float32) -> None:
        """Search for a hand at its place without its prediction; at once, because it is reported wrongly meanwhile."""
        found: list[Found] = []
        for candidate in at_once(self.finder.candidates(depth, 2, arm.model.points(arm.fitted.pose)[PALM])):
            found += at_once(self.finder.best(depth, candidate))
        for one in sorted(found, key=lambda one: one.cost)[:1]:
            part = self.finder.region(depth, self.models[one.side].spheres(one.fitted.pose))
            if part is not None and self._change(arm, one.side, one.fitted, part):
                arm.sure, arm.wait = self.finder.sure(one, found), self.settings.look_again_after

    def _caught_up(self, arms: list[_Arm], look: _Look) -> Steps[None]:
        """Track arms to the newest image, and remove, in place, arms that are lost on the way."""
        while look.images and arms:
            depth, at_s = look.images[:_STRIDE][-1]
            del look.images[:_STRIDE]
            arms[:] = [arm for arm in arms if self._follow(arm, depth, at_s)]
            yield _FOLLOWED * len(arms)

    def _change(self, arm: _Arm, side: Handedness, other: Fitted, part: Region) -> bool:
        """Take another pose for an arm, where it is still better when all points are looked at; whether it was."""
        model, own = self.models[side], arm.model
        evidence = evidence_of(part, model, other.pose, beyond=0.15)
        fitted = model.fit(other.pose, model.unexpected(other.pose), evidence, iterations=4, loose=1.0)
        before = cost_of(own, arm.fitted.pose, evidence_of(part, own, arm.fitted.pose, beyond=0.15))
        if fitted.cost >= self.settings.better * before:
            return False
        arm.fitted, arm.side, arm.model, arm.region = fitted, side, model, part
        arm.velocity[6:] = 0.0
        return True

    def _predicted(self, arm: _Arm, dt: float) -> ArmPose:
        model, pose = arm.model, arm.fitted.pose.copied()
        step = arm.velocity * min(dt, 0.1)
        step[6:] *= 0.5
        turned = np.empty(9)
        fit_kernels().turned(pose.R, 0, step[3], step[4], step[5], turned)
        t = pose.t + pose.R.reshape(3, 3) @ step[:3]
        z = pose.z + step[6:]
        fit_kernels().within(model.digits, model.columns, model.gains, z, model.c_max)
        return ArmPose(turned, t, z, pose.v)

    def _expected(self, arm: _Arm, predicted: ArmPose, dt: float) -> Expected:
        model, s = arm.model, self.settings.fit
        rates = np.full(6 + len(predicted.z), np.radians(s.angle_rate_deg_s))
        rates[:3], rates[3:6] = s.palm_rate_m_s, np.radians(s.palm_rate_deg_s)
        rates = np.clip(_MAY_CHANGE * np.abs(arm.velocity), _STILL * rates, rates)
        base, before = model.unexpected(predicted), arm.fitted.pose.v.copy()
        # Sizes do not change while an arm is tracked. A forearm's length is inferred from the hand's.
        known = np.full(len(before), 1.0 / _SIZE_SD**2)
        before[2] /= before[0]
        known[2] /= model.forearm_m**2
        known[4:10] = 1.0 / np.radians(_FOREARM_RATE_DEG_S * dt) ** 2
        information = base.information + known
        v = (base.information * base.v + known * before) / information
        return replace(base, certainty=1.0 / (rates * dt) ** 2, v=v, information=information)

    # Finding.

    def _worth_a_look(self, depth: Float32) -> tuple[int, Float64 | None]:
        """How many places are looked at, 0 where it is not worth while, and (k, 3) near to what [m]; None for anywhere.

        All while there is no arm. Else one: in each image while some places have not been searched, then now and
        then where something came nearer, or anywhere while no arm is firm.
        """
        s = self.settings
        if self._unsure:
            return _PLACES, None
        if self._unfinished:
            return 1, None
        if self._frames % s.look_every and self._frames % s.look_anyway_every:
            return 0, None
        if not any(arm.firm >= _FIRM_AFTER for arm in self._arms) or self._frames % s.look_anyway_every == 0:
            return 1, None
        near = self._nearer.places(depth, (arm.model.spheres(arm.fitted.pose) for arm in self._arms))
        return min(len(near), 1), near

    def _begin_look(self, depth: Float32, at_s: float) -> None:
        wanted = self.settings.arms - sum(arm.firm >= _FIRM_AFTER for arm in self._arms)
        if self._look is not None or not wanted:
            return
        most, near = self._worth_a_look(depth)
        if most:
            self._look = _Look(depth, at_s)
            self._look.steps = self._further(self._look, most, near, wanted)

    def _further(self, look: _Look, most: int, near: Float64 | None, wanted: int) -> Steps[None]:
        """Look for so many further arms, at so many places."""
        depth = look.depth
        now = [place for place in self._refused if self._frames < place.until]
        hands = {arm: self._hand(arm) for arm in self._arms}
        known = [*hands.values(), *(np.array([[*place.centre, _REFUSED_M]]) for place in now)]
        candidates = yield from self.finder.candidates(depth, _CANDIDATES, near, np.vstack(known) if known else None)
        found, tried = yield from self.finder.all_of(depth, candidates, most, self.settings.doubt, wanted)
        if near is None:
            self._unfinished = len(tried) == most
        if len(tried) < most or most > 1:
            self._nearer.looked(depth)
        arms = []
        for one in self.finder.judged(depth, self.finder.apart(found)):
            arm = _Arm(one.side, self.models[one.side], one.fitted, look.at_s, self.settings.look_again_after)
            arm.sure, arm.region = (
                self.finder.sure(one, found),
                self.finder.region(depth, arm.model.spheres(one.fitted.pose)),
            )
            arms.append(arm)
        hands |= {arm: self._hand(arm) for arm in arms}
        yield from self._caught_up(arms, look)
        for arm in arms:
            self._admit(arm, look.newest)
        for candidate in tried:
            if not any(within(candidate.centre, balls) for arm, balls in hands.items() if arm in self._arms):
                self._refuse(candidate.centre)

    def _admit(self, arm: _Arm, depth: Float32) -> None:
        """Follow a further arm from now on, unless another explains it better."""
        one = Found(arm.fitted.cost, arm.side, arm.fitted)
        rivals = [other for other in self._arms if self.finder.overlap(Found(0.0, other.side, other.fitted), one)]
        if rivals:  # the same arm, from its other end
            best = self.finder.judged(depth, [one, *(Found(0.0, other.side, other.fitted) for other in rivals)])[0]
            if best.fitted is not one.fitted:
                return
        elif len(self._arms) == self.settings.arms:  # one that was never sure makes room
            rivals = [max(self._arms, key=lambda other: (other.firm < _FIRM_AFTER, other.fitted.cost))]
            most_cost = (_MUCH_BETTER if rivals[0].believed else 1.0) * rivals[0].fitted.cost
            if rivals[0].firm >= _FIRM_AFTER or most_cost < one.cost:
                return
        for other in rivals:
            self._arms.remove(other)
        arm.id, self._next_id = self._next_id, self._next_id + 1
        self._arms.append(arm)

    @staticmethod
    def _hand(arm: _Arm) -> Float64:
        """(k, 4) balls about a hand [m], whose surface is no other hand's."""
        balls = arm.model.spheres(arm.fitted.pose)
        balls = balls[balls[:, 4] > 0, :4]
        balls[:, 3] += _ABOUT_HAND_M
        return balls

    def _refuse(self, centre: Float64) -> None:
        """Look at a place, where no arm was, ever more rarely."""
        for place in self._refused:
            if np.linalg.norm(place.centre - centre) < _REFUSED_M:
                break
        else:
            place = _Refused(centre, self.settings.refuse_for * (_PATIENCE if self._believed() else 1))
            self._refused = [*self._refused[-_MOST_REFUSED:], place]
        if place.until <= self._frames:  # several candidates may be of one place
            place.until = self._frames + place.wait
            place.wait = min(2 * place.wait, _LONGEST_REFUSED)

    # Telling.

    def _told(self, arm: _Arm) -> SeenArm:
        model, pose = arm.model, arm.fitted.pose
        points = model.points(pose)
        shown = np.zeros(len(points))
        if arm.region is not None:
            shown = model.visible(pose, arm.region.front, arm.region.lens)
        states = np.where(shown > _VISIBLE, JointState.TRACKED, JointState.INFERRED).astype(np.uint8)
        sd = _sd_m(shown, arm.fitted.cost).astype(np.float32)
        return SeenArm(
            arm.id, arm.side == "left", arm.sure, points, states, sd, model.angles(pose), pose.T_camera_palm
        )  # fmt: skip


def _sd_m(shown: Float64, cost: float) -> Float64:
    """(23,) standard deviation of a landmark's coordinate [m], from its visible share and the fit's cost.

    Set to the errors in rendered scenes of seeds below 100: 2.6 mm where much is seen and all fits, more than twice as
    much where the fit is doubtful, and up to 2.6 times as much again where little is seen.
    """
    fits = 0.0026 + 0.046 * min(max(cost - 0.06, 0.0), 0.08)
    sd = fits * np.interp(shown, (_VISIBLE, 0.35, 0.6), (2.6, 2.0, 1.0))
    return np.where(shown > _VISIBLE, sd, np.maximum(_HIDDEN_SD_M, sd))


def _motion(before: ArmPose, after: ArmPose) -> Float64:
    turn = fit_kernels().turn_between(before.R, 0, after.R)
    moved = before.R.reshape(3, 3).T @ (after.t - before.t)
    return np.concatenate([moved, turn, after.z - before.z])


_WORK: Final = ((3000, 5000), (0, 3000))
"""Search time in an image with one arm or none, and with several; the second values where nothing else is done [µs]."""
_MOST_IMAGES: Final = 40
"""Are kept meanwhile; of more, every other."""
_STRIDE: Final = 3
"""What was found is followed through every third image until it has caught up."""
_FOLLOWED: Final = 2500
"""Following an arm takes so long [µs]."""
_FIRM_AFTER: Final = 5
"""Images with a good fit of an arm before no replacement is looked for."""
_PLACES: Final = 8
"""Are looked at in an image while there is no arm …"""
_CANDIDATES: Final = 24
"""… of so many, for some are of one arm."""
_ABOUT_HAND_M: Final = 0.04
_REFUSED_M: Final = 0.08
"""So near to a place where no arm was, there is none."""
_PATIENCE: Final = 8
"""A place is refused so many times as long while there is an arm."""
_LONGEST_REFUSED: Final = 480
_MOST_REFUSED: Final = 63
_MUCH_BETTER: Final = 0.7
"""What makes room for another arm costs so much more, where it has been told."""
_LONGEST_WAIT: Final = 240
"""Images between two looks for a doubtful hand where it is."""

_SIZE_SD: Final = 0.002
"""Of sizes from image to image."""
_FOREARM_RATE_DEG_S: Final = 300.0
_MAY_CHANGE: Final = 4.0
"""In an image a motion may become so many times as fast …"""
_STILL: Final = 0.1
"""… or reach this part of its limit, where the hand is still; this steadies a still hand."""

_JUMP: Final = 1.25
"""A fit that costs so many times as much as that of the image before was predicted wrongly."""
_SHIFTS_M: Final = 0.042 * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
"""Where a hand that turned may be beside its prediction, camera [m]."""
_POSTURE_SD: Final = np.radians(1)
"""Of each angle of a hand that is looked for elsewhere."""
_COARSELY: Final = 4
"""Steps of a fit that only tells where a hand is."""
_MARGIN: Final = 0.93
"""What is elsewhere costs so much less."""

_FEW: Final = 250
_FEWER: Final = 100
"""Points that suffice to find a better posture, and to sort postures by their expected gain."""
_AT_ONCE: Final = 5
"""For so many images of doubt all kinds of postures are tried in each; then they take turns."""
_TRIED: Final = 2
"""So many of the postures of the whole hand are fitted."""

_VISIBLE: Final = 0.1
"""So much of a landmark's flesh must be seen where it should be."""
_HIDDEN_SD_M: Final = np.full(23, 0.011)
_HIDDEN_SD_M[[*TIPS]] = 0.024
"""Of a coordinate of a landmark that is not seen."""
