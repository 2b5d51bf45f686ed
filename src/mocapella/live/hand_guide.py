"""Guide a person through the gesture that measures hand bones: instructions, a countdown, and missing data."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from mocapella.errors import InputError, NoServerError
from mocapella.kinematics.hand_bones import PHASES, Bones
from mocapella.kinematics.hand_gesture import INSTRUCTIONS, GesturePoints
from mocapella.model.scene import Scene
from mocapella.settings import check

_POLL_S: Final = 0.005


@dataclass(frozen=True)
class GuideSettings:
    """Durations and tries of the guidance.

    Attributes:
        flat, knuckles, hook: duration of each phase [s].
        prepare: pause before each phase [s].
        tries: largest number of attempts: at each phase, until enough frames show its markers, and at the whole
            gesture, until the bones are determined [attempts].
        patience: longest wait for the first scene [s].
        least_frames: least number of frames of each phase that show the required markers, see `GesturePoints.missing`
            [frames].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    flat: float = 4.0
    knuckles: float = 6.0
    hook: float = 6.0
    prepare: float = 3.0
    tries: int = 3
    patience: float = 10.0
    least_frames: int = 20

    def __post_init__(self) -> None:
        for name in PHASES:
            check(0.5 <= getattr(self, name) <= 120, name, getattr(self, name), "from 0.5 to 120 s")
        check(0 <= self.prepare <= 60, "prepare", self.prepare, "from 0 to 60 s")
        check(1 <= self.tries <= 100, "tries", self.tries, "from 1 to 100")
        check(0 < self.patience <= 3600, "patience", self.patience, "above 0 and at most 3600 s")
        check(self.least_frames >= 3, "least_frames", self.least_frames, "3 or more")


class HandGuide:
    """Guides a person through the phases of the gesture from whose marker positions hand bones are measured.

    Args:
        newest: returns the newest scene once; None if there is no new one.
        gesture: collects the markers' positions.
        settings: durations and tries; the defaults if None.
        say: receives lines for the person.
        show: receives the countdown as text that replaces its last text.
        clock, sleep: in seconds.
    """

    def __init__(
        self,
        newest: Callable[[], Scene | None],
        gesture: GesturePoints,
        settings: GuideSettings | None = None,
        *,
        say: Callable[[str], None],
        show: Callable[[str], None] = lambda text: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._newest, self._gesture, self._settings = newest, gesture, settings or GuideSettings()
        self._say, self._show, self._clock, self._sleep = say, show, clock, sleep

    def run(self, measure: Callable[[GesturePoints], Bones]) -> Bones:
        """Guide through each phase until it is usable, then measure; repeat the gesture if the bones stay undetermined.

        Args:
            measure: returns the bones; raises `InputError` if they are undetermined.

        Returns:
            The result of ``measure``.

        Raises:
            NoServerError: no scene arrives.
            InputError: a phase has too few frames, or the bones stay undetermined, after all tries; or the tracker
                tracks no marker of a required name.
        """
        self._wait_for_scenes()
        for left in range(self._settings.tries - 1, -1, -1):
            self._gesture.reset()
            for phase in PHASES:
                self._part(phase)
            try:
                return measure(self._gesture)
            except InputError as error:
                if not left:
                    raise
                self._say(f"the bones are not determined yet: {error}. Once more, from the beginning")
        raise AssertionError

    def _part(self, phase: str) -> None:
        s = self._settings
        for left in range(s.tries - 1, -1, -1):
            self._say(f"{phase}: {INSTRUCTIONS[phase]}")
            self._during(s.prepare, "in {:.0f} s …", lambda scene: None)
            self._say(f"{phase}: now, for {getattr(s, phase):g} s")
            self._during(getattr(s, phase), f"{phase}: {{:.0f}} s", lambda scene: self._gesture.update(scene, phase))
            missing = self._gesture.missing(phase, s.least_frames)
            if not missing:
                return
            if not left:
                fix = "keep all markers in view of the cameras all the time, and measure again"
                raise InputError("; ".join(missing), field=phase, fix=fix)
            for problem in missing:
                self._say(f"{phase}: {problem}")
            self._say(f"{phase}: once more")
            self._gesture.forget(phase)

    def _during(self, seconds: float, countdown: str, take: Callable[[Scene], None]) -> None:
        """Pass on every scene for a duration."""
        end = self._clock() + seconds
        while (left := end - self._clock()) > 0:
            self._show(countdown.format(left + 0.5))
            scene = self._newest()
            if scene is not None:
                take(scene)
            self._sleep(_POLL_S)

    def _wait_for_scenes(self) -> None:
        end = self._clock() + self._settings.patience
        while self._newest() is None:
            if self._clock() > end:
                problem = f"no scene arrived within {self._settings.patience:g} s"
                raise NoServerError(f"{problem}; start the cameras' nodes, and the server with --method hands")
            self._show("waiting for scenes …")
            self._sleep(_POLL_S)
