"""Detect and track arms and hands in the images of one depth camera: the detector ``kinematic-arm``.

A known arm is tracked: its pose is predicted at constant velocity, the image segmented around the prediction
(`sensing.arm_region`), and a kinematic model of arm and hand fitted to the points (`kinematics.arm_fit`) by maximum a
posteriori estimation. Arms whose cost stays high are lost.

New arms are detected from palm candidates, at first in the whole image, by fits from several poses of either hand
(`detectors.arm_finding`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.arm_finding import ArmFinder, Found, cost_of, evidence_of
from mocapella.detectors.arm_search import RefusedPlace, Search
from mocapella.detectors.arm_settings import KinematicArmSettings
from mocapella.detectors.arm_track import CameraArmTrack
from mocapella.detectors.branch_ends import branch_ends, reaching, unexplained
from mocapella.detectors.fattening_guess import PLAINLY, FatteningGuess
from mocapella.errors import SettingsError
from mocapella.kinematics.arm_fit import ArmEvidence, ArmModel, ArmPose, Expected, Fitted
from mocapella.model.arms import PALM, SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import TIPS, Handedness, hand_model
from mocapella.model.observations import JointState
from mocapella.sensing.arm_region import PalmCandidate, Region, within
from mocapella.sensing.depth_foreground import DepthForeground
from mocapella.sensing.mixed_pixels import without_mixed_pixels
from mocapella.steps import Steps, at_once

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


class KinematicArmDetector:
    """Detects arms, and tracks them from image to image; a `mocapella.detectors.ArmDetector`.

    Args:
        camera: name, size and lens of the depth camera; its lens distortion is not used.
        settings: thresholds and rates; the defaults if None.

    Attributes:
        camera, settings: as given.
        models: model of a right and a left arm, by side.
        finder: detects arms without a prediction.
    """

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
        """Forget all images and arms; ids begin at 0 again."""
        self._arms: list[CameraArmTrack] = []
        self._refused: list[RefusedPlace] = []
        self._before: list[CameraArmTrack] = []  # arms of the last image, if this one does not continue it
        self._at_s: float | None = None
        self._frames = self._next_id = 0
        self._search: Search | None = None
        self._unfinished = self._mixes = False
        self._foreground = DepthForeground(self.finder.lens, self.settings.region)
        self._fattening = FatteningGuess(self.settings.fattening_px)

    def update(self, depth: Float32, at_s: float) -> SeenArms:
        """Detect the arms in the next image, and track known ones; see `mocapella.detectors.ArmDetector`.

        Only arms with a cost that was once below the setting ``firm`` are reported; `SeenArms.reason` says why if there
        is none. Once an arm has fitted well for some images, a search for further ones is spread over several.

        Args:
            depth: (height, width) [m]; 0 where nothing was measured. It may be changed afterwards.
            at_s: the image's capture time [s], which rises from image to image.

        Raises:
            SettingsError: the image has another size than the camera's.
        """
        width, height = self.camera.size_px
        if depth.shape != (height, width):
            raise SettingsError(
                f"the depth image is {depth.shape[1]} × {depth.shape[0]}; "
                f"camera {self.camera.name} has {width} × {height} px"
            )
        whole = self._without_mixed_pixels(np.ascontiguousarray(depth, dtype=np.float32))
        self._fattening.look(whole, self.settings.region.far_m)
        depth = self._fattening.corrected(whole)
        self._before = []
        if self._at_s is not None and at_s - self._at_s > self.settings.independent_s:
            self._before, self._arms, self._refused, self._search = self._arms, [], [], None
        self._at_s = at_s
        if self._search is not None:
            self._search.add(whole, at_s)
        for arm in list(self._arms):
            if not self._follow(arm, depth, at_s):
                self._arms.remove(arm)
                self._refused, self._unfinished = [], True  # its place may be another arm's
        self._begin_search(depth, at_s, whole)
        if self._search is not None and self._unsure:
            self._search.go_on(np.inf)  # no tracked arm is delayed
            self._search = None
        elif self._search is not None and not self._search.go_on(_WORK[len(self._arms) > 1][self._reserved]):
            self._search = None
        self._compare(whole)
        self._frames += 1
        arms = tuple(self._observed(arm) for arm in sorted(self._believed(), key=lambda arm: arm.id))
        return SeenArms(arms, "" if arms else self._reason(depth))

    def _without_mixed_pixels(self, depth: Float32) -> Float32:
        """Leave out mixed pixels; before a camera that has none, they are looked for in some images only."""
        if not self._mixes and self._frames % _LOOK_FOR_MIXED:
            return depth
        s = self.settings.region
        without = without_mixed_pixels(depth, jump=s.jump, far_m=s.far_m)
        self._mixes = without is not depth
        return without

    @property
    def _unsure(self) -> bool:
        """Whether no arm is reported, or the last search left places out and no arm has had enough good fits."""
        return not self._believed() or (self._unfinished and all(arm.firm < _FIRM_AFTER for arm in self._arms))

    @property
    def _reserved(self) -> bool:
        """Whether this image's time is reserved for the search under way: in every second image."""
        return self._search is not None and self._frames % 2 == 1

    def _believed(self) -> list[CameraArmTrack]:
        """Return the arms that have fitted well at least once."""
        for arm in self._arms:
            arm.believed = arm.believed or self._fits(arm)
        return [arm for arm in self._arms if arm.believed]

    def _fits(self, arm: CameraArmTrack) -> bool:
        """Return whether an arm's fit is good enough to be reported for the first time."""
        most = self.settings.firm_in_blocks if self._fattening.px else self.settings.firm
        return self.finder.shown_cost(arm.fitted, arm.region) < most

    def _compare(self, whole: Float32) -> None:
        """Compare arms' fits with those to the image of a camera of the other kind, from time to time.

        The arm that fits best in either image counts, so that a true hand is not judged by the fit to another surface.
        """
        ones = [Found(self.finder.shown_cost(arm.fitted, arm.region), arm.side, arm.fitted) for arm in self._arms]
        ones = [one for one in ones if one.cost <= self.settings.firm_in_blocks]
        if not ones or not self._fattening.due(self._frames, urgent=not self._believed()):
            return
        otherwise = self._fattening.otherwise(whole)
        costs = [(one.cost, self._refitted(one, otherwise).cost) for one in ones]
        measured, other = min(costs, key=min)
        if self._fattening.learn(self._frames, [measured], [other]):
            for arm in self._arms:
                arm.believed = self.finder.shown_cost(arm.fitted, arm.region) < self.settings.firm

    def _refitted(self, one: Found, depth: Float32) -> Found:
        """Return an arm's fit to another image of the same instant, from its pose; of cost ∞ if it is not there."""
        model, pose = self.models[one.side], one.fitted.pose
        part = self.finder.region(depth, model.spheres(pose))
        if part is None:
            return Found(math.inf, one.side, one.fitted)
        fitted = model.fit(pose, model.unexpected(pose), evidence_of(part, model, pose), iterations=4, loose=1.0)
        return Found(self.finder.shown_cost(fitted, part), one.side, fitted, one.missed)

    def _reason(self, depth: Float32) -> str:
        s = self.settings.region
        there = depth > 0
        if not there.any():
            return "nothing was measured in the whole image"
        if not ((depth >= s.near_m) & (depth <= s.far_m)).any():
            return f"nothing is between {s.near_m:g} and {s.far_m:g} m"
        return "a possible hand does not fit the hand model well" if self._arms else "no hand is seen"

    # Tracking.

    def _follow(self, arm: CameraArmTrack, depth: Float32, at_s: float) -> bool:
        model, s = arm.model, self.settings
        dt = max(at_s - arm.at_s, 1e-3)
        if arm.begun is not None:
            arm.fitted, arm.begun = arm.begun, None
        predicted = arm.predicted(dt)
        part = self.finder.region(depth, model.spheres(predicted))
        if part is None:
            return False
        expected, evidence = arm.expected(predicted, dt, s.fit), evidence_of(part, model, predicted)
        fitted = model.fit(predicted, expected, evidence)
        if fitted.cost > _ROSE * arm.calm:
            fitted = self._moved_fast(arm, fitted, expected, evidence)
        usual = _JUMP * arm.fitted.cost
        jumped = fitted.cost > usual  # the hand turned or stopped, unlike its prediction
        if jumped:
            other = self._elsewhere(arm, predicted, expected, evidence, evidence_of(part, model, predicted, _FEW))
            if other.cost < _MARGIN * fitted.cost:
                fitted = other
        arm.move(fitted, dt)
        arm.at_s, arm.region = at_s, part
        doubt = fitted.cost > min(s.doubt, usual, _DOUBTED * arm.calm)
        if (doubt or not jumped) and not self._reserved:  # limits the time of an image
            self._improve(arm, depth, doubt)
        arm.doubtful = arm.doubtful + 1 if arm.fitted.cost > s.keep else 0
        arm.firm = min(arm.firm + 1, _FIRM_AFTER) if arm.fitted.cost < s.firm else max(arm.firm - 1, 0)
        return arm.doubtful < s.lost_after

    @staticmethod
    def _moved_fast(arm: CameraArmTrack, fitted: Fitted, expected: Expected, evidence: ArmEvidence) -> Fitted:
        """Return a fit whose fingers may be far from their prediction, if it is clearly better; else the one given.

        Fingers start and stop within an image or two. With as wide a prior in each image, a still hand would tremble.
        """
        certainty, steady = expected.certainty.copy(), expected.steady.copy()
        certainty[6:] *= _FREER
        steady[6:] = 0.0
        prior = replace(expected, certainty=certainty, steady=steady)
        free = arm.model.fit(fitted.pose, prior, evidence, iterations=6, loose=1.0)
        return free if free.cost < _CLEARLY * fitted.cost else fitted

    @staticmethod
    def _elsewhere(
        arm: CameraArmTrack, predicted: ArmPose, expected: Expected, evidence: ArmEvidence, few: ArmEvidence
    ) -> Fitted:
        """Return the best fit of a hand away from its prediction, from rigid fits: postures change slowly."""
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
        certainty[:6] = 0.0  # and with it ``steady`` of the palm
        return model.fit(best.pose, replace(expected, certainty=certainty), evidence, iterations=4, loose=1.0)

    def _improve(self, arm: CameraArmTrack, depth: Float32, doubt: bool) -> None:
        """Try other postures of single digits or the whole hand; search the hand anew after a long doubt.

        Args:
            arm: the arm.
            depth: (height, width) [m].
            doubt: all digits are tested, not only some, and postures of the whole hand.
        """
        s = self.settings
        assert arm.region is not None
        model, pose = arm.model, arm.fitted.pose
        evidence = evidence_of(arm.region, model, pose, _FEW, 0.15)
        arm.count_doubt(doubt, s)
        starts = []
        if arm.in_doubt <= _AT_ONCE or arm.in_doubt % 2:
            digits = range(5) if doubt else [(arm.next_digit + k) % 5 for k in range(s.digits)]
            arm.next_digit = (arm.next_digit + s.digits) % 5
            held = {digit: model.held_otherwise(pose, evidence, digit) for digit in digits}
            for digit, way in held.items():
                arm.check(digit, way.clearness)
            best = max(held.values(), key=lambda way: way.gain)
            starts = [best.pose] if best.gain > s.gain else []
        if doubt:
            points = model.points(pose)
            ends = unexplained(branch_ends(depth, self.finder.lens, points[PALM], s.region), points[[*TIPS]])
            starts += [start for end in ends[:1] for start, _ in reaching(model, pose, end)]
        if doubt and (arm.in_doubt <= _AT_ONCE or not arm.in_doubt % 2):
            poses = [*model.exchanged(pose), *model.alike(pose)]
            coarse = evidence_of(arm.region, model, pose, _FEWER, 0.15)
            starts += sorted(poses, key=lambda pose: cost_of(model, pose, coarse))[:_TRIED]
        if starts:
            fits = [model.fit(start, model.unexpected(start), evidence, iterations=5, loose=2.0) for start in starts]
            other = min(fits, key=lambda other: other.cost)
            if other.cost < s.better * cost_of(model, pose, evidence):
                self._change(arm, arm.side, other, arm.region)
        if arm.is_due(s):
            arm.in_doubt, arm.wait = 0, min(2 * arm.wait, _LONGEST_WAIT)
            self._anew(arm, depth)

    def _anew(self, arm: CameraArmTrack, depth: Float32) -> None:
        """Detect the hand again near its palm, without its prediction; in this image, because its pose may be wrong."""
        found: list[Found] = []
        for candidate in at_once(self.finder.candidates(depth, 2, arm.model.points(arm.fitted.pose)[PALM])):
            found += at_once(self.finder.best(depth, candidate, depth))
        for one in sorted(found, key=lambda one: one.rank)[:1]:
            part = self.finder.region(depth, self.models[one.side].spheres(one.fitted.pose))
            if part is not None and self._change(arm, one.side, one.fitted, part):
                arm.sure = self.finder.sure(one, found)
                if arm.proven:
                    arm.wait = self.settings.look_again_after
                arm.prove(self.settings)

    def _caught_up(self, arms: list[CameraArmTrack], search: Search) -> Steps[None]:
        """Track arms to the newest image; remove lost ones from the list."""
        while search.images and arms:
            whole, at_s = search.images[:_STRIDE][-1]
            del search.images[:_STRIDE]
            depth = self._fattening.corrected(whole)
            arms[:] = [arm for arm in arms if self._follow(arm, depth, at_s)]
            yield _FOLLOWED * len(arms)

    def _change(self, arm: CameraArmTrack, side: Handedness, other: Fitted, part: Region) -> bool:
        """Replace an arm's pose if the other one is also better with all points; return whether it was."""
        model, own = self.models[side], arm.model
        evidence = evidence_of(part, model, other.pose, beyond=0.15)
        fitted = model.fit(other.pose, model.unexpected(other.pose), evidence, iterations=4, loose=1.0)
        before = cost_of(own, arm.fitted.pose, evidence_of(part, own, arm.fitted.pose, beyond=0.15))
        if fitted.cost >= self.settings.better * before:
            return False
        moved_m = np.linalg.norm((model.points(fitted.pose) - own.points(arm.fitted.pose))[[*TIPS]], axis=1)
        arm.clear &= moved_m < _MOVED_M
        arm.fitted, arm.side, arm.model, arm.region, arm.begun = fitted, side, model, part, None
        arm.velocity[6:] = 0.0
        self._check(arm)
        return True

    @staticmethod
    def _check(arm: CameraArmTrack) -> None:
        """Note of a new posture which fingertips are clear."""
        if arm.region is None:
            return
        pose = arm.fitted.pose
        evidence = evidence_of(arm.region, arm.model, pose, _FEW, 0.15)
        for digit in range(5):
            arm.check(digit, arm.model.held_otherwise(pose, evidence, digit).clearness)

    # Detection.

    def _places_to_search(self, depth: Float32) -> tuple[int, Float64 | None]:
        """Return how many places to search now, and near which points (k, 3) [m]; None for anywhere.

        All places while there is no arm. Else one: in each image while some places have not been searched, then from
        time to time where the foreground changed, or anywhere while no arm is firm.
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
        near = self._foreground.places(depth, (arm.model.spheres(arm.fitted.pose) for arm in self._arms))
        return min(len(near), 1), near

    def _begin_search(self, depth: Float32, at_s: float, whole: Float32) -> None:
        wanted = self.settings.arms - sum(arm.firm >= _FIRM_AFTER for arm in self._arms)
        if self._search is not None or not wanted:
            return
        most, near = self._places_to_search(depth)
        if most:
            self._search = Search(whole, at_s)
            self._search.steps = self._further(self._search, most, near, wanted)

    def _further(self, search: Search, most: int, near: Float64 | None, wanted: int) -> Steps[None]:
        """Search for up to ``wanted`` further arms at up to ``most`` places."""
        guess, depth = self._fattening, self._fattening.corrected(search.depth)
        now = [place for place in self._refused if self._frames < place.until]
        hands = {arm: self._hand(arm) for arm in self._arms}
        known = [*hands.values(), *(np.array([[*place.centre, _REFUSED_M]]) for place in now)]
        taken = np.vstack(known) if known else None

        def searched(image: Float32) -> Steps[tuple[list[Found], list[PalmCandidate]]]:
            candidates = yield from self.finder.candidates(image, _CANDIDATES, near, taken)
            return (
                yield from self.finder.all_of(image, candidates, most, self.settings.doubt, wanted, whole=search.depth)
            )

        found, tried = yield from searched(depth)
        least = min((one.cost for one in found), default=np.inf)
        if tried and not self._arms and not guess.known and least >= _WELL:
            otherwise = guess.otherwise(search.depth)
            instead = yield from searched(otherwise)
            again = [self._refitted(one, depth) for one in instead[0]]
            likeliest = self.finder.judged(otherwise, self.finder.apart(instead[0]))[:1]
            costs = self._of_same_hands(found, instead[0], again, likeliest)
            # Narrower images of thin fingers have none: a good fit to the measured image is not given up for another.
            if least >= PLAINLY and guess.learn(self._frames, *costs):
                (found, tried), depth = instead, otherwise
            else:
                found = [*found, *(one for one in again if one.cost < self.settings.believe)]
        if near is None:
            self._unfinished = len(tried) == most
        if len(tried) < most or most > 1:
            self._foreground.learn(depth)
        arms = []
        for one in self.finder.alone(self.finder.judged(depth, self.finder.apart(found))):
            arm = CameraArmTrack(
                one.side, self.models[one.side], one.fitted, search.at_s, self.settings.look_again_after
            )
            arm.sure, arm.region = (
                self.finder.sure(one, found),
                self.finder.region(depth, arm.model.spheres(one.fitted.pose)),
            )
            arm.unclear, arm.begun = self.finder.unclear(one, found), one.begun
            self._check(arm)
            arms.append(arm)
        hands |= {arm: self._hand(arm) for arm in arms}
        yield from self._caught_up(arms, search)
        newest = guess.corrected(search.newest)
        for arm in arms:
            self._admit(arm, newest)
        for candidate in tried:
            if not any(within(candidate.centre, balls) for arm, balls in hands.items() if arm in self._arms):
                self._refuse(candidate.centre)

    def _of_same_hands(
        self, found: list[Found], instead: list[Found], again: list[Found], likeliest: list[Found]
    ) -> tuple[list[float], list[float]]:
        """Return costs of the hand that fits best in an image of either kind, as measured and of the other kind.

        Costs of different surfaces say nothing about the camera: a forearm's end may fit the measured image as well as
        a true fist does.

        Args:
            found: fits to the measured image.
            instead: fits to the image of the other kind.
            again: the fits of ``instead``, in this order, refitted to the measured image.
            likeliest: the one of ``instead`` that is the likeliest hand, or none.
        """
        if not likeliest:
            return [one.cost for one in found], []
        best = likeliest[0]
        same = [other for other in instead if self.finder.near(best, other)]
        measured = [other.cost for other in found if self.finder.near(best, other)]
        measured += [other.cost for one, other in zip(instead, again, strict=True) if self.finder.near(best, one)]
        return measured, [one.cost for one in same]

    def _admit(self, arm: CameraArmTrack, depth: Float32) -> None:
        """Track a further arm from now on, unless a tracked one explains its points better.

        A reported arm that still fits is not replaced by one that could not be reported.
        """
        one = Found(arm.fitted.cost, arm.side, arm.fitted)
        rivals = [other for other in self._arms if self.finder.overlap(Found(0.0, other.side, other.fitted), one)]
        if not self._fits(arm) and any(other.believed and self._fits(other) for other in rivals):
            return
        if rivals:  # the same arm, fitted from its other end
            kept = [
                Found(0.0 if other.firm >= _FIRM_AFTER else other.fitted.cost, other.side, other.fitted)
                for other in rivals
            ]
            best = self.finder.judged(depth, [one, *kept])[0]
            if best.fitted is not one.fitted:
                return
        elif len(self._arms) == self.settings.arms:  # an arm that was never firm is replaced
            rivals = [max(self._arms, key=lambda other: (other.firm < _FIRM_AFTER, other.fitted.cost))]
            most_cost = (_MUCH_BETTER if rivals[0].believed else 1.0) * rivals[0].fitted.cost
            if rivals[0].firm >= _FIRM_AFTER or most_cost < one.cost:
                return
        for other in rivals:
            self._arms.remove(other)
        arm.id = self._id_before(arm)
        self._arms.append(arm)

    def _id_before(self, arm: CameraArmTrack) -> int:
        """Return the id that an arm had before a gap in time, if one was near; else a new one."""

        def distance(other: CameraArmTrack) -> float:
            return float(np.linalg.norm(other.fitted.pose.t - arm.fitted.pose.t))

        near = [other for other in self._before if other.side == arm.side and distance(other) < _SAME_ARM_M]
        if near:
            same = min(near, key=distance)
            self._before.remove(same)
            return same.id
        self._next_id += 1
        return self._next_id - 1

    @staticmethod
    def _hand(arm: CameraArmTrack) -> Float64:
        """Return balls (k, 4) around a hand [m]; no other hand is searched in them."""
        balls = arm.model.spheres(arm.fitted.pose)
        balls = balls[balls[:, 4] > 0, :4]
        balls[:, 3] += _ABOUT_HAND_M
        return balls

    def _refuse(self, centre: Float64) -> None:
        """Skip a place without an arm for some images, twice as many each time."""
        for place in self._refused:
            if np.linalg.norm(place.centre - centre) < _REFUSED_M:
                break
        else:
            place = RefusedPlace(centre, self.settings.refuse_for * (_PATIENCE if self._believed() else 1))
            self._refused = [*self._refused[-_MOST_REFUSED:], place]
        if place.until <= self._frames:  # several candidates may lie at one place
            place.until = self._frames + place.wait
            place.wait = min(2 * place.wait, _LONGEST_REFUSED)

    # Reporting.

    def _observed(self, arm: CameraArmTrack) -> SeenArm:
        model, pose = arm.model, arm.fitted.pose
        points = model.points(pose)
        shown = np.zeros(len(points))
        if arm.region is not None:
            shown = arm.confirmed(model.visible(pose, arm.region.front, arm.region.lens))
        # Before a camera that matches blocks, right fits cost more than what proves an arm.
        settled = arm.firm >= _FIRM_AFTER and (arm.proven or self._fattening.px > 0)
        clear = ~arm.unclear | settled
        clear[[*TIPS]] &= arm.clear
        least = _VISIBLE_IN_BLOCKS if self._fattening.px else _VISIBLE
        states = np.where((shown > least) & clear, JointState.TRACKED, JointState.INFERRED).astype(np.uint8)
        sd = _sd_m(np.where(clear, shown, 0.0), arm.fitted.cost).astype(np.float32)
        return SeenArm(
            arm.id, arm.side == "left", arm.sure, points, states, sd, model.angles(pose), pose.T_camera_palm
        )  # fmt: skip


def _sd_m(shown: Float64, cost: float) -> Float64:
    """Return (23,) standard deviations of a landmark's coordinate [m], from its visible share and the fit's cost.

    Calibrated on errors in rendered scenes with seeds below 100: 2.6 mm for visible landmarks and a good fit, more than
    twice as much for a doubtful fit, and up to 2.6 times as much again where little is visible.
    """
    fits = 0.0026 + 0.046 * min(max(cost - 0.06, 0.0), 0.08)
    sd = fits * np.interp(shown, (_VISIBLE, 0.35, 0.6), (2.6, 2.0, 1.0))
    return np.where(shown > _VISIBLE, sd, np.maximum(_HIDDEN_SD_M, sd))


_WORK: Final = ((3000, 5000), (0, 3000))
"""Time to search in an image [µs]: (in usual images, in reserved ones), with one arm or none, and with several."""
_STRIDE: Final = 3
"""New arms are tracked through every third image kept during the search, up to the newest."""
_FOLLOWED: Final = 2500
"""Time to track an arm through an image [µs]."""
_FIRM_AFTER: Final = 5
"""Images with a good fit after which no replacement for an arm is searched."""
_LOOK_FOR_MIXED: Final = 30
"""Images between two searches for mixed pixels, before a camera that had none in the last."""
_PLACES: Final = 8
"""Places searched in an image while there is no arm."""
_WELL: Final = 0.10
"""Cost of a fit below which the image of a camera of the other kind is not searched for a better one."""
_CANDIDATES: Final = 24
"""Most palm candidates of a search; several may belong to one arm."""
_ABOUT_HAND_M: Final = 0.04
_REFUSED_M: Final = 0.08
"""Radius around a refused place [m]."""
_PATIENCE: Final = 8
"""Factor of the number of images for which a place is refused, while an arm is reported."""
_LONGEST_REFUSED: Final = 480
_MOST_REFUSED: Final = 63
_SAME_ARM_M: Final = 0.3
"""Greatest way of an arm from the last image before a gap in time [m]."""
_MUCH_BETTER: Final = 0.7
"""A reported arm is replaced only by one whose cost is below this share of its own."""
_LONGEST_WAIT: Final = 240
"""Most images between two new searches for a hand in doubt."""

_ROSE: Final = 1.05
"""Ratio of a cost to the lowest of late above which fingers may have moved unlike their prediction."""
_FREER: Final = 1 / 36
"""Factor of the certainty of the fingers' predicted angles then."""
_CLEARLY: Final = 0.9
"""Such a fit is taken if its cost is below this share of the other's."""
_JUMP: Final = 1.25
"""Ratio of the costs of successive images above which the prediction counts as wrong."""
_DOUBTED: Final = 1.4
"""Ratio of a cost to the lowest of late above which the posture is in doubt."""
_SHIFTS_M: Final = 0.042 * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
"""Offsets from the prediction that are tried for a hand that turned, camera [m]."""
_POSTURE_SD: Final = np.radians(1)
"""Standard deviation of each angle in a rigid fit [rad]."""
_COARSELY: Final = 4
"""Iterations of a fit that only locates the hand."""
_MOVED_M: Final = 0.025
"""Distance that a fingertip moves with a new posture above which it must become clear again [m]."""
_MARGIN: Final = 0.93
"""A pose away from the prediction is taken if its cost is below this share of the other's."""

_FEW: Final = 250
_FEWER: Final = 100
"""Points used to fit another posture, and to rank postures by cost."""
_AT_ONCE: Final = 5
"""Number of images in doubt that try postures of digits and of the whole hand; later images try them by turns."""
_TRIED: Final = 2
"""Postures of the whole hand that are fitted."""

_VISIBLE: Final = 0.1
"""Least visible share of a tracked landmark's surface; below, it is inferred."""
_VISIBLE_IN_BLOCKS: Final = 0.3
"""The same before a camera that matches blocks, where a finger's neighbour may stand in for it."""
_HIDDEN_SD_M: Final = np.full(23, 0.011)
_HIDDEN_SD_M[[*TIPS]] = 0.024
"""Standard deviation of a coordinate of an occluded landmark [m]."""
