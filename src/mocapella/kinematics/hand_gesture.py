"""Collect the markers' positions in each phase of the gesture from which a person's finger bones are measured.

The measurement itself is `mocapella.kinematics.hand_bones`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.kinematics.hand_bones import PHASES, Bones, BonesSettings, measure_bones
from mocapella.model.hand import DIGITS, HandModel, HandShape
from mocapella.model.scene import Scene
from mocapella.settings import check

Float64 = NDArray[np.float64]

INSTRUCTIONS: Final[Mapping[str, str]] = {
    "flat": "hold the hand flat: fingers straight, in line with the palm",
    "knuckles": "keep the fingers straight, and bend them at the knuckles, as far as they go and back, again and again",
    "hook": "keep the knuckles straight, and curl the fingers, as far as they go and back, again and again",
}
"""What the person must do in each phase of the gesture."""
_MEASURED: Final = 2
"""Least number of cameras that see a marker now (`TrackedPoints.cameras`); with fewer, its position is predicted."""


class PhaseSpan(NamedTuple):
    """Time interval of a phase of the gesture, in capture time since the first scene [s].

    Attributes:
        phase: one of `PHASES`.
        begin_s, end_s: half-open interval: ``begin_s`` belongs to the phase, ``end_s`` does not.
    """

    phase: str
    begin_s: float
    end_s: float


def spans_of_text(text: str) -> tuple[PhaseSpan, ...]:
    """Parse intervals such as ``flat=0:4,knuckles=4:10,hook=10:16`` [s]; a phase may occur more than once.

    Returns:
        The intervals, sorted by time.

    Raises:
        SettingsError: the text has another form, a phase is missing, or two intervals overlap.
    """
    example = "write it as flat=0:4,knuckles=4:10,hook=10:16, in seconds"
    spans = []
    for part in text.split(","):
        phase, _, times = part.partition("=")
        if phase.strip() not in PHASES:
            raise SettingsError(f"{phase.strip()!r} is no part of the gesture; there are {one_of(phase, PHASES)}")
        begin, _, end = times.partition(":")
        try:
            span = PhaseSpan(phase.strip(), float(begin), float(end))
        except ValueError:
            raise SettingsError(f"{part!r} does not say from when to when; {example}") from None
        if not 0 <= span.begin_s < span.end_s < math.inf:
            raise SettingsError(f"{part!r} does not end after it begins; {example}")
        spans.append(span)
    spans.sort(key=lambda span: span.begin_s)
    for one, other in pairwise(spans):
        if other.begin_s < one.end_s:
            raise SettingsError(f"{one.phase} and {other.phase} are both shown at {other.begin_s:g} s; {example}")
    for phase in PHASES:
        if phase not in {span.phase for span in spans}:
            raise SettingsError(f"the part {phase!r} is missing; {example}")
    return tuple(spans)


def phase_at(spans: Sequence[PhaseSpan], at_s: float) -> str | None:
    """Return the phase at a capture time since the first scene [s]; None outside all intervals."""
    return next((span.phase for span in spans if span.begin_s <= at_s < span.end_s), None)


@dataclass(frozen=True)
class GestureReport:
    """Counts of the scenes of a gesture.

    Attributes:
        scenes: number of scenes given to `GesturePoints.update`.
        kept: number of scenes kept, by phase.
        without_points: number of scenes dropped because the tracker had no markers.
        too_soon: number of scenes dropped because they came too soon after the last one kept.
    """

    scenes: int
    kept: dict[str, int]
    without_points: int
    too_soon: int


class GesturePoints:
    """Collects the markers' positions in each phase of the gesture.

    Args:
        tips: names of the fingertips' markers, thumb to little finger.
        base: names of the markers on the back of the hand, three or more.
        rate_hz: most scenes kept per second, because successive ones hold nearly the same information [Hz].

    Raises:
        SettingsError: not five tips, fewer than three base markers, a name twice, or a rate out of range.
    """

    def __init__(self, tips: Sequence[str], base: Sequence[str], *, rate_hz: float = 30.0) -> None:
        names = (*tips, *base)
        check(len(tips) == len(DIGITS), "tips", tuple(tips), "five markers, thumb to little finger")
        fix = "three or more markers, so that they tell how the palm lies; one is enough afterwards"
        check(len(base) >= 3, "base", tuple(base), fix)
        check(len(set(names)) == len(names) and all(names), "tips and base", names, "each marker's name once")
        check(0 < rate_hz <= 1000, "rate_hz", rate_hz, "above 0, at most 1000 Hz")
        self.tips, self.base = tuple(tips), tuple(base)
        self._least_ns = round(NS_PER_S / rate_hz)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._kept: dict[str, list[tuple[Float64, Float64]]] = {phase: [] for phase in PHASES}
        self._last_ns: int | None = None
        self._scenes = self._without = self._too_soon = 0

    def forget(self, phase: str) -> None:
        """Drop the positions of one phase, so that it can be repeated."""
        self._kept[phase] = []

    @property
    def report(self) -> GestureReport:
        """Counts of the scenes since the collection was made or reset."""
        kept = {phase: len(rows) for phase, rows in self._kept.items()}
        return GestureReport(self._scenes, kept, self._without, self._too_soon)

    def update(self, scene: Scene, phase: str) -> None:
        """Add a scene of a phase of the gesture, unless it has no points or follows the last one too soon.

        A marker that fewer than two cameras see now is kept as NaN.

        Args:
            scene: the tracker's result.
            phase: one of `PHASES`.

        Raises:
            InputError: the scene's points have no marker with a name of ``tips`` or ``base``.
        """
        self._scenes += 1
        points = scene.points
        if points is None:
            self._without += 1
            return
        if self._last_ns is not None and 0 <= scene.at_ns - self._last_ns < self._least_ns:
            self._too_soon += 1
            return
        place = {name: i for i, name in enumerate(points.names)}
        for name in (*self.tips, *self.base):
            if name not in place:
                fix = f"choose of {one_of(name, points.names)}, or serve with --set base=…"
                raise InputError("is not tracked", field="marker", value=name, fix=fix)
        chosen = [place[name] for name in (*self.tips, *self.base)]
        measured = points.cameras[chosen] >= _MEASURED
        positions = np.where(measured[:, None], points.positions[chosen], np.nan)
        self._kept[phase].append((positions, np.where(measured, points.sd[chosen], np.nan)))
        self._last_ns = scene.at_ns

    def missing(self, phase: str, least: int) -> list[str]:
        """Describe, for users, why a phase cannot be used yet; an empty list if it can.

        Args:
            phase: one of `PHASES`.
            least: least number of kept scenes that must show the whole base, and with it each finger's tip. The thumb's
                tip is not needed.
        """
        rows = self._kept[phase]
        if not rows:
            return ["no markers were tracked meanwhile: do two cameras see the hand, and is the method hands?"]
        seen = np.asarray(np.isfinite(np.stack([positions for positions, _ in rows])).all(axis=-1))
        whole = seen[:, 5:].all(axis=1)
        if whole.sum() < least:
            said = ", ".join(f"{name} {count}" for name, count in zip(self.base, seen[:, 5:].sum(axis=0), strict=True))
            fix = f"{least} are wanted: turn them to the cameras"
            return [f"the base's markers were seen together in {whole.sum()} of {len(rows)} instants ({said}); {fix}"]
        found = []
        for digit in range(1, 5):
            count = int((seen[:, digit] & whole).sum())
            if count < least:
                who = f"the tip of the {DIGITS[digit]} finger ({self.tips[digit]})"
                found.append(f"{who} was seen in {count} of {len(rows)} instants; {least} are wanted")
        return found

    def measure(
        self, model: HandModel, start: HandShape, base_markers: Any, settings: BonesSettings | None = None
    ) -> Bones:
        """Measure the bones by `measure_bones`, with the median of the tracker's standard deviations as markers' noise.

        The noise is at most 9 cm.

        Args:
            model, start, base_markers, settings: as in `measure_bones`.

        Raises:
            InputError: the gesture does not determine the bones; the message says what to do.
        """
        rows = [row for phase in PHASES for row in self._kept[phase]]
        phases = [phase for phase in PHASES for _ in self._kept[phase]]
        if not any(np.isfinite(sd).any() for _, sd in rows):
            fix = "show the hand to two cameras or more, with the method hands"
            raise InputError("has no markers that cameras see", field="gesture", fix=fix)
        sd_m = float(np.nanmedian([sd for _, sd in rows]))
        points = np.stack([positions for positions, _ in rows])
        return measure_bones(model, start, base_markers, points, phases, sd_m=min(sd_m, 0.09), settings=settings)
