"""Hands of the method ``webcams``: 21 keypoints that several cameras see become a hand of 27 degrees of freedom.

    seen  = hands of the detections            of whole bodies, or of hands alone
    hands = predict(hands)
    match = body's wrist, or prediction        in each camera
    new   = group(other detections)            rays of two cameras meet
    hands = fit(triangulated landmarks)        within the joint limits, with the size learnt

A hand of a person is that of the nearest wrist. A hand without a body has no known side: the left and the right hand
are both fitted until one of them fits better. A landmark that one camera sees lies on its ray, at the predicted
distance, and is inferred.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.association.hand_keypoints import (
    LANDMARKS,
    SeenHand,
    arranged,
    chosen_pairs,
    hand_sources,
    kernels,
    mismatch,
    new_hands,
    seen_hand,
)
from mocapella.association.keypoint_rays import Matches, sources_named
from mocapella.conventions import NS_PER_S
from mocapella.errors import WireError
from mocapella.geometry.triangulation import PointState, Views, triangulate, views
from mocapella.kinematics.keypoint_hand import KINDS as HAND_KINDS
from mocapella.kinematics.keypoint_hand import KeypointHand
from mocapella.model.camera import CameraRig
from mocapella.model.hand import WRIST, Hand, Handedness
from mocapella.model.observations import JointState
from mocapella.model.scene import TrackedHand
from mocapella.model.topology import topology
from mocapella.tracker.instants import CameraInstant, most_confident
from mocapella.tracker.webcams_markers import nearest, of_tips
from mocapella.tracker.webcams_memory import PeopleArrays
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]

ALONE_ID: Final = 1_000_000
"""First id of hands without a body; the hands of a person have the ids 2 · person (left) and 2 · person + 1 (right)."""
SIDES: Final[tuple[Handedness, Handedness]] = ("left", "right")
WRISTS: Final = np.array([topology("halpe_26").index("LWrist"), topology("halpe_26").index("RWrist")])
MOST_ALONE: Final = 8
"""Number of hands without a body that are followed at a time."""
_SURE_SIDE: Final = 60.0
"""Difference of the summed squared misfits of a left and a right hand at which the side is decided."""
_MOST_EVIDENCE: Final = 10.0
"""Limit of that difference in one instant."""
_AHEAD_S: Final = 0.1
"""Time for which a measured hand is shown as measured; after it, it is inferred [s]."""
_STEP_S: Final = 0.02
"""Time over which the predicted motion is differentiated [s]."""
_DEPTH_SD_M: Final = 1.0
"""Standard deviation of a landmark along the only ray that sees it [m]."""
_NEW_DEPTH_SD_M: Final = 0.08
"""The same of a new hand, whose distance is that of its person's wrist [m]."""
_WRIST_SD_M: Final = 0.02
"""Standard deviation of a body's wrist about its hand's [m]."""
_PREDICTED_SD_M: Final = 0.015
"""Standard deviation of a predicted landmark, for the comparison with detections [m]."""
_FEWEST: Final = 8
"""Least number of landmarks about which two cameras agree, for the cameras to agree about the hand."""


@dataclass(eq=False)
class OneHand:
    """A hand that is followed.

    Attributes:
        number: id in scenes.
        person: id of its person; −1 without a body.
        fits: fits by side: one where the side is known, else both.
        evidence: for a right hand, against a left one [squared standard deviations].
        hits: number of instants when two cameras agreed.
        agreed_s: last time of such an instant [s]; −inf before the first.
        seen_s: last time that a camera saw it [s].
        hand: what the better fit found last; None before the first.
        velocities: (21, 3) of the landmarks [m/s].
    """

    number: int
    person: int
    fits: dict[Handedness, KeypointHand]
    seen_s: float
    evidence: float = 0.0
    hits: int = 0
    agreed_s: float = -math.inf
    hand: Hand | None = None
    velocities: Float64 = field(default_factory=lambda: np.zeros((LANDMARKS, 3)))

    @property
    def side(self) -> Handedness:
        """The side that fits better."""
        if len(self.fits) == 1:
            return next(iter(self.fits))
        return "right" if self.evidence >= 0.0 else "left"


class WebcamsHands:
    """The hands of all people, and hands without a body.

    Args:
        settings: settings of the method.
    """

    def __init__(self, settings: WebcamsSettings) -> None:
        self._all, self.settings = settings, settings.hands
        self.reset()

    def set_rig(self, rig: CameraRig) -> None:
        """Use the cameras of a rig, before the first update; the hands stay."""
        names = sorted(rig.cameras)
        self._column = {name: i for i, name in enumerate(names)}
        placed = [rig.cameras[name] for name in names]
        self._views: Views = views([one.camera.lens for one in placed], [one.T_camera_world for one in placed])

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._hands: list[OneHand] = []
        self._numbers = 0
        self._at_s = math.nan
        self._wrists: dict[int, Float64] = {}
        self._wrist_covariances: dict[int, Float64] = {}

    def forget_hands(self) -> None:
        """Forget all hands; the numbers given so far stay."""
        self._hands, self._at_s = [], math.nan

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall` and a tracker's snapshot."""
        hands = [
            {
                **{name: getattr(one, name) for name in _MEMORY},
                "fits": {side: fit.memory() for side, fit in one.fits.items()},
            }
            for one in self._hands
        ]
        return {"hands": hands, "numbers": self._numbers, "at_s": self._at_s}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Replace all state by that of `memory`.

        Raises:
            WireError: it is no such memory.
        """
        hands = []
        for values in memory["hands"]:
            fits = {}
            for side, state in values["fits"].items():
                if side not in SIDES:
                    raise WireError(f"a hand has no side {side!r}")
                fits[side] = KeypointHand(side)
                fits[side].recall(state)
            if not fits or set(values) != {*_MEMORY, "fits"}:
                raise WireError("the memory of a hand has other values")
            hands.append(OneHand(fits=fits, **{name: values[name] for name in _MEMORY}))
        self._hands, self._numbers, self._at_s = hands, int(memory["numbers"]), float(memory["at_s"])

    def update(
        self, instant: CameraInstant, matches: Matches, people: PeopleArrays, markers: Sequence[SeenHand] = ()
    ) -> None:
        """Process the hands in the detections of an instant.

        Args:
            instant: the frames.
            matches: the people of the instant's bodies; detections in the order of the frames, at most
                `mocapella.tracker.instants.MOST_DETECTIONS` of each.
            people: the people at the instant.
            markers: the colour markers on fingertips near the instant.
        """
        seen = self._seen(instant, matches)
        self._at_s = instant.at_ns / NS_PER_S
        if not seen and not self._hands:
            return
        self._wrists, self._wrist_covariances = {}, {}
        for row, number in enumerate(people.ids.tolist()):
            if number >= 0:
                self._wrists[number] = people.positions[row, WRISTS]
                self._wrist_covariances[number] = people.covariances[row, WRISTS]
        self._hands = [one for one in self._hands if one.person < 0 or one.person in self._wrists]
        self._join()
        owned, rest = self._owned(seen, people)
        predicted = {i: self._predicted(one) for i, one in enumerate(self._hands)}
        found = self._matched(rest, predicted)
        for i, one in enumerate(self._hands):
            key = (one.person, one.side)
            if one.person >= 0 and key in owned:
                found.setdefault(i, []).extend(owned.pop(key))
        used = {id(one) for group in found.values() for one in group}
        self._add_markers(markers, predicted, found)
        for i, group in found.items():
            self._fit(self._hands[i], group)
        for i, one in enumerate(self._hands):
            if i not in found:
                self._fit(one, [])
        for (person, side), group in sorted(owned.items(), key=lambda item: item[0]):
            self._begin(person, side, group)
        self._begin_alone([one for one in rest if id(one) not in used])
        self._drop()

    def _seen(self, instant: CameraInstant, matches: Matches) -> list[SeenHand]:
        """Return the hands in the detections of an instant."""
        seen, first = [], 0
        for name, one in instant.frames.items():
            frame, column = one.frame, self._column[name]
            hands, chosen = hand_sources(frame.topology.name), most_confident(frame)
            after_s = (one.at_ns - instant.at_ns) / NS_PER_S
            for left, source in hands:
                for k, detection in enumerate(chosen.tolist()):
                    person = -1 if left is None else int(matches.person[first + k])
                    turned = left is not None and bool(matches.swapped[first + k])
                    hand = seen_hand(
                        column, after_s, frame.positions_px[detection, source], frame.confidences[detection, source],
                        self.settings, person=person, left=(not left) if turned else left,
                    )  # fmt: skip
                    if hand is not None:
                        seen.append(hand)
            if sources_named(frame.topology.name) is not None:
                first += len(chosen)
        return seen

    def _owned(
        self, seen: Sequence[SeenHand], people: PeopleArrays
    ) -> tuple[dict[tuple[int, Handedness], list[SeenHand]], list[SeenHand]]:
        """Return the hands of bodies that are people, by person and side of the nearer wrist; and the other hands."""
        owned: dict[tuple[int, Handedness], list[SeenHand]] = {}
        rest = []
        for one in seen:
            number = int(people.ids[one.person]) if one.person >= 0 else -1
            if number not in self._wrists:
                rest.append(one)
                continue
            away = self._wrist_distances(one, self._wrists[number])
            side = 0 if one.left else 1
            # Detectors confuse the sides; where a wrist is clearly nearer, it decides.
            if away[1 - side] < 0.5 * away[side]:
                side = 1 - side
            if away[side] > 1.0:
                continue
            group = owned.setdefault((number, SIDES[side]), [])
            if all(other.camera != one.camera for other in group):
                group.append(one)
        return owned, rest

    def _wrist_distances(self, one: SeenHand, wrists: Float64) -> Float64:
        """Return the distances (wrists,) of a seen hand's wrist from a person's, over the allowed; inf if unknown."""
        own = one.pixels[WRIST] if np.isfinite(one.pixels[WRIST]).all() else np.nanmean(one.pixels, axis=0)
        away = np.empty(len(wrists))
        kernels().point_distances(
            self._views.numbers, one.camera, np.ascontiguousarray(wrists), float(own[0]), float(own[1]),
            float(self.settings.wrist_m), away,
        )  # fmt: skip
        return away

    def _predicted(self, one: OneHand) -> Float64 | None:
        return one.fits[one.side].predicted(self._at_s)

    def _matched(self, rest: Sequence[SeenHand], predicted: Mapping[int, Float64 | None]) -> dict[int, list[SeenHand]]:
        """Assign seen hands that belong to no known body to predicted hands, in each camera."""
        found: dict[int, list[SeenHand]] = {}
        for camera in sorted({one.camera for one in rest}):
            costs = {
                (i, k): mismatch(one, landmarks, self._hands[i].velocities, _PREDICTED_SD_M, self._views)
                for i, landmarks in predicted.items()
                if landmarks is not None
                for k, one in enumerate(rest)
                if one.camera == camera
            }
            for i, k in chosen_pairs(costs, self.settings.most_cost):
                found.setdefault(i, []).append(rest[k])
        return found

    def _add_markers(
        self, markers: Sequence[SeenHand], predicted: Mapping[int, Float64 | None], found: dict[int, list[SeenHand]]
    ) -> None:
        """Add the markers of each camera to the nearest hand of their side, in ``found``."""
        for one in markers:
            side: Handedness = "left" if one.left else "right"
            hands = [(i, x) for i, x in predicted.items() if x is not None and side in self._hands[i].fits]
            near = [of_tips(one, x, self._views, self.settings.marker_sd_m) for _, x in hands]
            costs = [
                mismatch(tips, x, self._hands[i].velocities, _PREDICTED_SD_M, self._views)
                for tips, (i, x) in zip(near, hands, strict=True)
            ]
            best = nearest(costs, self.settings.most_cost)
            if best >= 0:
                found.setdefault(hands[best][0], []).append(near[best])

    def _join(self) -> None:
        """Give hands without a body to the person whose free wrist is nearest."""
        taken = {(one.person, one.side) for one in self._hands if one.person >= 0}
        for one in self._hands:
            if one.person >= 0 or one.hand is None:
                continue
            owner = self._nearest_wrist(one.hand.landmarks[WRIST], taken)
            if owner is None:
                continue
            taken.add(owner)
            fit = one.fits.get(owner[1])
            one.person, side = owner
            one.number = _number(owner)
            one.fits = {side: fit if fit is not None else KeypointHand(side)}

    def _nearest_wrist(self, wrist: Float64, taken: set[tuple[int, Handedness]]) -> tuple[int, Handedness] | None:
        best, least = None, self.settings.wrist_m
        for number in sorted(self._wrists):
            for k, side in enumerate(SIDES):
                away = float(np.linalg.norm(self._wrists[number][k] - wrist))
                if away < least and (number, side) not in taken:
                    best, least = (number, side), away
        return best

    def _begin(self, person: int, side: Handedness, group: Sequence[SeenHand]) -> None:
        """Begin a hand of a person."""
        one = OneHand(_number((person, side)), person, {side: KeypointHand(side)}, self._at_s)
        self._fit(one, group)
        self._hands.append(one)

    def _begin_alone(self, seen: Sequence[SeenHand]) -> None:
        """Begin hands of detections without a body: at a free wrist, or alone if two cameras agree."""
        s = self.settings
        taken = {(one.person, one.side) for one in self._hands if one.person >= 0}
        groups = new_hands(seen, self._views, s.pair_cost, s.least_landmarks)
        for group in groups:
            own = [seen[i] for i in group]
            found = self._triangulated(own, np.zeros((LANDMARKS, 3)))
            wrist = found[0][WRIST] if np.isfinite(found[0][WRIST]).all() else np.nanmean(found[0], axis=0)
            owner = self._nearest_wrist(wrist, taken)
            if owner is not None:
                taken.add(owner)
                self._begin(*owner, own)
            elif sum(one.person < 0 for one in self._hands) < MOST_ALONE:
                one = OneHand(ALONE_ID + self._numbers, -1, {k: KeypointHand(k) for k in SIDES}, self._at_s)
                self._numbers += 1
                self._fit(one, own)
                self._hands.append(one)
        grouped = {i for group in groups for i in group}
        for i, single in enumerate(seen):
            if i in grouped:
                continue
            near = [
                (float(away), number, SIDES[k])
                for number in sorted(self._wrists)
                for k, away in enumerate(self._wrist_distances(single, self._wrists[number]))
                if (number, SIDES[k]) not in taken and away < 1.0
            ]
            if near:
                _, number, side = min(near)
                taken.add((number, side))
                self._begin(number, side, [single])

    def _triangulated(
        self, seen: Sequence[SeenHand], velocities: Float64, landmarks: Float64 | None = None
    ) -> tuple[Float64, Float64, NDArray[np.int64]]:
        """Return triangulated landmarks (21, 3), their covariances, and the number of cameras that agree.

        Pixels are moved by the predicted motion to the time of the instant, where ``landmarks`` are predicted.
        """
        pixels, sds = arranged(seen, len(self._views))
        if landmarks is not None:
            for one in seen:
                if one.after_s != 0.0:
                    kernels().move_pixels(self._views.numbers, one.camera, landmarks, velocities, one.after_s, pixels)
        found = triangulate(pixels, self._views, sds)
        return found.points, found.covariances, np.where(found.states == PointState.SEEN, found.used.sum(axis=1), 0)

    def _fit(self, one: OneHand, seen: Sequence[SeenHand]) -> None:
        """Fit a hand to its detections."""
        predicted = self._predicted(one)
        points, covariances, support = self._triangulated(seen, one.velocities, predicted)
        if seen and support[WRIST] < 2:
            self._add_wrist(one, points, covariances)
        if predicted is not None:
            self._add_rays(seen, points, covariances, predicted, _DEPTH_SD_M)
        elif np.isfinite(points[WRIST]).all():
            near = np.repeat(points[WRIST][None], LANDMARKS, axis=0)
            self._add_rays(seen, points, covariances, near, _NEW_DEPTH_SD_M)
        measured = support >= 2
        hands = {side: fit.update(points, covariances, measured, self._at_s) for side, fit in one.fits.items()}
        if len(hands) == 2 and measured.sum() >= _FEWEST:
            self._weigh(one, hands, covariances, measured)
        one.hand = hands[one.side]
        if seen:
            one.seen_s = self._at_s
        if measured.sum() >= _FEWEST:
            one.hits += 1
            one.agreed_s = self._at_s
        fit = one.fits[one.side]
        now, later = fit.predicted(self._at_s), fit.predicted(self._at_s + _STEP_S)
        one.velocities = np.zeros((LANDMARKS, 3)) if now is None or later is None else (later - now) / _STEP_S

    def _add_wrist(self, one: OneHand, points: Float64, covariances: Float64) -> None:
        """Take the wrist of the person's body for the hand's, in place: it tells the distance if one camera sees it."""
        if one.person not in self._wrists:
            return
        k = SIDES.index(one.side)
        wrist, covariance = self._wrists[one.person][k], self._wrist_covariances[one.person][k]
        if np.isfinite(wrist).all() and np.isfinite(covariance).all():
            points[WRIST], covariances[WRIST] = wrist, covariance + _WRIST_SD_M**2 * np.eye(3)

    def _add_rays(
        self, seen: Sequence[SeenHand], points: Float64, covariances: Float64, near: Float64, depth_sd_m: float
    ) -> None:
        """Add landmarks that are not triangulated: on a camera's ray, nearest to ``near`` (21, 3); in place."""
        for one in seen:
            kernels().add_rays(
                self._views.numbers, one.camera, one.pixels, one.sds_px, near, depth_sd_m, points, covariances
            )

    def _weigh(self, one: OneHand, hands: Mapping[Handedness, Hand], covariances: Float64, measured: Any) -> None:
        """Add an instant's evidence for the side of a hand; keep the better fit alone when it is sure."""
        variances = np.trace(covariances, axis1=1, axis2=2)
        costs = {
            side: float(np.nansum(np.minimum(hand.residuals_m**2 / variances, 9.0)[measured]))
            for side, hand in hands.items()
        }
        one.evidence += float(np.clip(costs["left"] - costs["right"], -_MOST_EVIDENCE, _MOST_EVIDENCE))
        if abs(one.evidence) >= _SURE_SIDE:
            one.fits = {one.side: one.fits[one.side]}

    def _drop(self) -> None:
        """Forget hands that are lost, or that no two cameras have seen for long."""
        s = self._all
        self._hands = [
            one
            for one in self._hands
            if self._predicted(one) is not None
            and (one.person >= 0 or self._at_s - max(one.agreed_s, one.seen_s - s.one_camera_s) <= s.one_camera_s)
        ]

    def shown(self, at_s: float) -> tuple[TrackedHand, ...]:
        """Return the hands at a time, in the order of their ids.

        Args:
            at_s: time, not long after the last instant [s].
        """
        ahead_s = at_s - self._at_s
        ahead_s = ahead_s if 0.0 < ahead_s <= self._all.unseen_s else 0.0
        shown = [
            _shown(one, ahead_s)
            for one in self._hands
            if one.hand is not None and (one.person >= 0 or one.hits >= self.settings.confirm_instants)
        ]
        return tuple(sorted(shown, key=lambda hand: hand.id))


def _shown(one: OneHand, ahead_s: float) -> TrackedHand:
    hand: Any = one.hand
    moved = ahead_s * one.velocities
    T = hand.T_world_palm.copy()
    T[:3, 3] += moved[WRIST]
    states = hand.states
    if ahead_s > _AHEAD_S:
        states = np.where(states == JointState.TRACKED, JointState.INFERRED, states).astype(np.uint8)
    known = bool(np.isfinite(T).all())
    return TrackedHand(
        one.number, one.side == "left", hand.landmarks + moved, states, hand.sd_m.astype(np.float32), hand.angles,
        T if known else None,
    )  # fmt: skip


def _number(owner: tuple[int, Handedness]) -> int:
    return 2 * owner[0] + SIDES.index(owner[1])


_MEMORY: Final = ("number", "person", "seen_s", "evidence", "hits", "agreed_s", "hand", "velocities")
KINDS: Final = (*HAND_KINDS, Hand)
"""Values in `WebcamsHands.memory`."""
