"""Recognise hand gestures: open, fist, point, two, pinch, grab; and detect when a hand grasps and releases.

All features are ratios of lengths between a hand's landmarks, so they do not depend on its position, orientation, size
and side. A gesture begins once its score has been high for some time, and ends once it has been low for some time:
hysteresis in value and in time (a Schmitt trigger). A gesture whose digits are not known keeps its state, and ends
after a while.

A custom gesture is a value with a name, the digits that it needs, and a score::

    GESTURES["three"] = FingerGesture("three", extended=("index", "middle", "ring"), folded=("little",))
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.hand import BASES, DIGITS, TIPS, WRIST
from mocapella.model.observations import JointState
from mocapella.settings import check

Float64 = NDArray[np.float64]

_KNUCKLE: Final = BASES[2]
"""Landmark of the middle finger's knuckle, whose distance from the wrist is a hand's unit of length."""
_OPEN_OVER_FOREARM: Final = np.array([0.42, 0.49, 0.50, 0.48, 0.40])
"""Distance of an open hand's tips from the palm's centre, over the elbow's distance from it; of an average arm."""
_PARTLY: Final = 0.5
_INFERRED: Final = 0.25


@dataclass(frozen=True, eq=False)
class HandFeatures:
    """A hand's posture as ratios of lengths.

    Attributes:
        reach: (5,) distance from wrist to fingertip, divided by the length along the bones: 1 is straight, 0.3 to 0.4
            is folded into the palm; NaN where not known.
        gaps: (5, 5) distances between fingertips, divided by that from the wrist to the middle finger's knuckle; NaN
            where not known.
        certainty: (5,) certainty of each digit: 1 if its tip is measured, 0.5 if another joint beyond its base is, 0.25
            if they are inferred, 0 if the digit is not known.
    """

    reach: Float64
    gaps: Float64
    certainty: Float64

    def extended(self, digit: int) -> float:
        """Return how far a digit (0: thumb) is extended, from 0 to 1 (straight, in line with palm); NaN if unknown."""
        low, high = (0.80, 0.93) if digit == 0 else (0.68, 0.86)
        return ramp(float(self.reach[digit]), low, high)

    def folded(self, digit: int) -> float:
        """Return how far a digit (0: thumb) is folded, from 0 to 1 (tip at the palm); NaN if unknown."""
        low, high = (0.78, 0.90) if digit == 0 else (0.45, 0.65)
        return 1.0 - ramp(float(self.reach[digit]), low, high)


def ramp(value: float, low: float, high: float) -> float:
    """Return a linear ramp: 0 up to ``low``, 1 from ``high`` on; NaN for NaN."""
    part = (value - low) / (high - low)
    return part if math.isnan(part) else min(max(part, 0.0), 1.0)


def hand_features(
    landmarks: Any, states: Any, sd: Any = None, *, palm: Any = None, elbow: Any = None, unsure: float = 0.5
) -> HandFeatures:
    """Compute the features of a hand.

    If a digit's inner landmarks are not known, but palm and elbow are, its reach is estimated as the tip's distance
    from the palm, divided by that of an open average hand with the same distance from palm to elbow.

    Args:
        landmarks: (21, 3) in the order of `mocapella.model.hand.LANDMARKS`, in any frame [m]; NaN where not known.
        states: (21,) `JointState`.
        sd: (21,) standard deviation of a coordinate [m], or None.
        palm, elbow: (3,) centre of the palm and elbow, in the same frame [m].
        unsure: a tip with a standard deviation above this fraction of the distance from the wrist to the middle
            finger's knuckle counts as unknown.

    Returns:
        The features; for an unknown digit, reach is NaN and certainty 0.
    """
    x, s = np.asarray(landmarks, dtype=np.float64), np.asarray(states)
    chains = x[1:].reshape(5, 4, 3)
    bones = np.linalg.norm(np.diff(chains, axis=1), axis=-1).sum(axis=1)
    wrist, tips = x[WRIST], chains[:, 3]
    unit = float(np.linalg.norm(x[_KNUCKLE] - wrist))
    way = np.linalg.norm(chains[:, 0] - wrist, axis=-1) + bones
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.linalg.norm(tips - wrist, axis=-1) / way
        if palm is not None and elbow is not None:
            forearm = np.linalg.norm(np.asarray(elbow) - palm)
            unit = unit if math.isfinite(unit) else 0.29 * float(forearm)
            rough = np.linalg.norm(tips - palm, axis=-1) / (forearm * _OPEN_OVER_FOREARM)
            reach = np.where(np.isfinite(reach), reach, np.minimum(rough, 1.0))
        gaps = np.linalg.norm(tips[:, None] - tips[None], axis=-1) / unit
        reach = np.where(np.isfinite(reach), reach, np.nan)
        gaps = np.where(np.isfinite(gaps), gaps, np.nan)
    seen = s[1:].reshape(5, 4) == JointState.TRACKED
    certainty = np.where(seen[:, 3], 1.0, np.where(seen[:, 1:3].any(axis=1), _PARTLY, _INFERRED))
    there = np.isfinite(reach) & (s[list(TIPS)] != JointState.NOT_TRACKED)
    if sd is not None:
        there &= ~(np.asarray(sd, dtype=np.float64)[list(TIPS)] > unsure * unit)
    return HandFeatures(np.where(there, reach, np.nan), gaps, np.where(there, certainty, 0.0))


class Gesture(Protocol):
    """Interface of a gesture.

    Attributes:
        name: its name, one word.
        digits: indices of the digits that must be known; the thumb is 0.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def digits(self) -> tuple[int, ...]: ...  # noqa: D102

    def score(self, hand: HandFeatures) -> float:
        """Return the gesture's score, from 0 (certainly not) to 1 (certainly); NaN if not known."""
        ...


@dataclass(frozen=True)
class FingerGesture:
    """Gesture with some digits extended and some folded; the others do not matter.

    Attributes:
        name: its name, one word.
        extended, folded: names of digits.
    """

    name: str
    extended: tuple[str, ...] = ()
    folded: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        named = (*self.extended, *self.folded)
        for digit in named:
            if digit not in DIGITS:
                raise SettingsError(f"gesture {self.name!r}: unknown digit {digit!r}; known: {one_of(digit, DIGITS)}")
        check(bool(named), "extended and folded", named, "one digit or more")
        check(len(set(named)) == len(named), "extended and folded", named, "each digit once")

    @property
    def digits(self) -> tuple[int, ...]:
        """Indices of the digits that are extended or folded."""
        return tuple(sorted(DIGITS.index(digit) for digit in (*self.extended, *self.folded)))

    def score(self, hand: HandFeatures) -> float:
        """Return the score of the digit that fits worst, 0 to 1; NaN if unknown."""
        fits = [hand.extended(DIGITS.index(digit)) for digit in self.extended]
        return _least([*fits, *(hand.folded(DIGITS.index(digit)) for digit in self.folded)])


@dataclass(frozen=True)
class Closed:
    """Gesture with all four fingers bent: a fist, or a hand around an object.

    Attributes:
        name: its name, one word.
        tight: whether the fingers lie in the palm (fist); otherwise they are bent as around an object.
        digits: indices of the digits that it uses, thumb 0: the four fingers.
    """

    name: str
    tight: bool
    digits: tuple[int, ...] = (1, 2, 3, 4)

    def score(self, hand: HandFeatures) -> float:
        """Return the score by the fingers' mean reach, 0 to 1; it is low if any finger is extended. NaN if unknown."""
        mean = float(hand.reach[1:].mean())
        loose = ramp(mean, 0.36, 0.52)
        bent = min(loose, 1.0 - ramp(mean, 0.58, 0.72)) if not self.tight else 1.0 - loose
        return _least([bent, *(1.0 - hand.extended(digit) for digit in self.digits)])


@dataclass(frozen=True)
class Pinch:
    """Gesture with the tips of thumb and index finger together, the other fingers not folded.

    Attributes:
        name, digits: its name, one word, and the indices of the digits that it uses, thumb 0.
    """

    name: str = "pinch"
    digits: tuple[int, ...] = (0, 1, 2, 3, 4)

    def score(self, hand: HandFeatures) -> float:
        """Return the score by the gap between the tips and the other fingers' mean reach, 0 to 1; NaN if unknown."""
        others = ramp(float(hand.reach[2:].mean()), 0.68, 0.82)
        return _least([1.0 - ramp(float(hand.gaps[0, 1]), 0.28, 0.50), others])


def _least(fits: list[float]) -> float:
    return math.nan if any(math.isnan(fit) for fit in fits) else min(fits)


GESTURES: Final[dict[str, Gesture]] = {
    gesture.name: gesture
    for gesture in (
        FingerGesture("open", extended=DIGITS),
        Closed("fist", tight=True),
        FingerGesture("point", extended=("index",), folded=("middle", "ring", "little")),
        FingerGesture("two", extended=("index", "middle"), folded=("ring", "little")),
        Pinch(),
        Closed("grab", tight=False),
    )
}
"""The gestures by name; an added one is recognised by every `HandGestures` made afterwards."""


def closure(hand: HandFeatures) -> float:
    """Return how closed a hand is, from 0 (open) to 1 (closed); NaN if not known.

    It is the larger of the score of a pinch and the flexion, from 0 to 1, of the least bent finger.
    """
    closed = _least([1.0 - ramp(float(hand.reach[finger]), 0.45, 0.85) for finger in range(1, 5)])
    pinched = Pinch().score(hand)
    return pinched if math.isnan(closed) else closed if math.isnan(pinched) else max(closed, pinched)


@dataclass(frozen=True)
class GestureSettings:
    """Thresholds in score and time at which gestures and grasps begin and end.

    Attributes:
        enter: score at or above which a gesture begins; larger: fewer false gestures, more missed ones [0 to 1].
        leave: score below which a gesture ends; smaller: it lasts longer [0 to 1].
        after_s: time for which the score must stay beyond ``enter`` or ``leave``; larger: fewer false gestures, later
            ones [s].
        grab: closure (`closure`) at or above which a hand grasps; larger: the hand must be closed more [0 to 1].
        release: closure below which a hand releases; smaller: the hand must be opened more [0 to 1].
        grab_after_s: time for which the closure must stay beyond ``grab`` or ``release``; larger: fewer false grasps,
            later ones [s].
        least_certain: mean certainty of a gesture's digits below which its score is unknown; larger: gestures of partly
            hidden hands are ignored [0 to 1].
        hold_s: time for which a gesture with an unknown score keeps its state [s].
        unsure: a tip counts as unknown if its standard deviation is above this fraction of the length from wrist to the
            middle finger's knuckle, see `hand_features`; larger: less certain tips are used [ratio].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    enter: float = 0.6
    leave: float = 0.4
    after_s: float = 0.09
    grab: float = 0.55
    release: float = 0.35
    grab_after_s: float = 0.06
    least_certain: float = 0.5
    hold_s: float = 0.4
    unsure: float = 0.5

    def __post_init__(self) -> None:
        check(0 < self.enter <= 1, "enter", self.enter, "above 0, at most 1")
        check(0 <= self.leave < self.enter, "leave", self.leave, f"from 0 to below enter, {self.enter:g}")
        check(0 <= self.after_s <= 10, "after_s", self.after_s, "from 0 to 10 s")
        check(0 < self.grab <= 1, "grab", self.grab, "above 0, at most 1")
        check(0 <= self.release < self.grab, "release", self.release, f"from 0 to below grab, {self.grab:g}")
        check(0 <= self.grab_after_s <= 10, "grab_after_s", self.grab_after_s, "from 0 to 10 s")
        check(0 <= self.least_certain <= 1, "least_certain", self.least_certain, "from 0 to 1")
        check(0 <= self.hold_s <= 60, "hold_s", self.hold_s, "from 0 to 60 s")
        check(0 < self.unsure <= 10, "unsure", self.unsure, "above 0, at most 10")


@dataclass(frozen=True)
class GestureState:
    """A hand's gesture and grasp at an instant.

    Attributes:
        gesture: name of the active gesture, by default one of `GESTURES`; empty if none is.
        sure: last known score of that gesture times the mean certainty of the digits that it needs, 0 to 1. It falls
            linearly to 0 over ``hold_s`` of `GestureSettings` while the score is not known.
        grabbing: whether the hand grasps. While ``known`` is False it does not change, until it ends after ``hold_s``.
        event: ``grab`` or ``release`` at the instant at which ``grabbing`` changes; empty otherwise.
        known: whether the hand's `closure`, which decides ``grabbing``, is known at this instant; a gesture's score may
            be known when it is not, and the reverse.
    """

    gesture: str
    sure: float
    grabbing: bool
    event: str
    known: bool


@dataclass(frozen=True)
class GesturesReport:
    """Counts of a hand's gestures and grasps.

    Attributes:
        instants: number of instants processed.
        unknown: number of instants at which the hand's closure is not known.
        begun: number of times each gesture began, by name.
        grabs, releases: number of grasps and releases.
    """

    instants: int
    unknown: int
    begun: dict[str, int]
    grabs: int
    releases: int


class _Trigger:
    """Schmitt trigger: on after ``after_s`` at ``high`` or above, off after ``after_s`` below ``low``.

    A NaN changes nothing and does not interrupt the wait; after more than ``hold_s`` of NaN it is off.
    """

    def __init__(self, low: float, high: float, after_s: float, hold_s: float) -> None:
        self._low, self._high, self._after_s, self._hold_s = low, high, after_s, hold_s
        self.on = False
        self.told_s = -math.inf
        self._since_s: float | None = None

    def update(self, value: float, at_s: float) -> None:
        if math.isnan(value):
            if at_s - self.told_s > self._hold_s:
                self.on, self._since_s = False, None
            return
        if at_s - self.told_s > self._hold_s:
            self._since_s = None
        self.told_s = at_s
        changes = value < self._low if self.on else value >= self._high
        if not changes:
            self._since_s = None
            return
        if self._since_s is None:
            self._since_s = at_s
        if at_s - self._since_s >= self._after_s - 1e-9:
            self.on, self._since_s = not self.on, None


class HandGestures:
    """Recognises the gestures and grasps of one hand, instant by instant.

    Args:
        settings: thresholds; the defaults if None.
        gestures: the gestures to recognise; None for those in `GESTURES` at this time.

    Raises:
        SettingsError: two gestures of one name, or one without a name.
    """

    def __init__(self, settings: GestureSettings | None = None, gestures: Iterable[Gesture] | None = None) -> None:
        self.settings = settings or GestureSettings()
        self.gestures = tuple(GESTURES.values() if gestures is None else gestures)
        names = [gesture.name for gesture in self.gestures]
        check(len(set(names)) == len(names) and all(names), "gestures", names, "each name once")
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._instants = self._unknown = self._grabs = self._releases = 0
        self._begun: Counter[str] = Counter()
        self._forget()

    def _forget(self) -> None:
        s = self.settings
        self._triggers = {g.name: _Trigger(s.leave, s.enter, s.after_s, s.hold_s) for g in self.gestures}
        self._grab = _Trigger(s.release, s.grab, s.grab_after_s, s.hold_s)
        self._score: dict[str, float] = {}
        self._sure: dict[str, float] = {}
        self._shown = ""
        self._at_s = -math.inf

    @property
    def report(self) -> GesturesReport:
        """Counts since the recognition was made or reset."""
        return GesturesReport(self._instants, self._unknown, dict(self._begun), self._grabs, self._releases)

    def update(self, hand: HandFeatures | None, at_s: float) -> GestureState:
        """Update gesture and grasp with the hand's features at an instant.

        Args:
            hand: the features, of `hand_features`; None where the hand is not seen.
            at_s: capture time [s]; a time before the last one restarts the recognition, but not its counts.

        Returns:
            The state. A reported gesture stays until it ends, or until its score is below ``enter`` while that of
            another active one is not.
        """
        if at_s < self._at_s:
            self._forget()
        self._at_s = at_s
        self._instants += 1
        for gesture in self.gestures:
            self._judge(gesture, hand, at_s)
        before, closed = self._grab.on, math.nan if hand is None else self._closure(hand)
        self._grab.update(closed, at_s)
        event = "" if self._grab.on == before else "grab" if self._grab.on else "release"
        self._grabs += event == "grab"
        self._releases += event == "release"
        known = not math.isnan(closed)
        self._unknown += not known
        name = self._choose()
        return GestureState(name, self._sure_of(name, at_s), self._grab.on, event, known)

    def _judge(self, gesture: Gesture, hand: HandFeatures | None, at_s: float) -> None:
        score = math.nan
        if hand is not None:
            certain = float(hand.certainty[list(gesture.digits)].mean())
            if certain >= self.settings.least_certain:
                score = gesture.score(hand)
            if not math.isnan(score):
                self._score[gesture.name] = score
                self._sure[gesture.name] = min(max(score, 0.0), 1.0) * certain
        self._triggers[gesture.name].update(score, at_s)

    def _closure(self, hand: HandFeatures) -> float:
        certain = float(hand.certainty[1:].mean())
        return closure(hand) if certain >= self.settings.least_certain else math.nan

    def _choose(self) -> str:
        """Keep the shown gesture, unless it ended or only others reach ``enter``; else show the most certain one."""
        on = [name for name, trigger in self._triggers.items() if trigger.on]
        likely = [name for name in on if self._score[name] >= self.settings.enter]
        if self._shown not in on or (likely and self._shown not in likely):
            self._shown = max(likely or on, key=lambda name: self._sure[name], default="")
            if self._shown:
                self._begun[self._shown] += 1
        return self._shown

    def _sure_of(self, name: str, at_s: float) -> float:
        if not name:
            return 0.0
        untold = at_s - self._triggers[name].told_s
        hold = self.settings.hold_s
        return self._sure[name] * (max(1.0 - untold / hold, 0.0) if hold > 0 else float(untold <= 0))
