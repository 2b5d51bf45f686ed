"""Guide a person through the alignment of another tracker's space: instructions, missing data, and the result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from mocapella.calibration.space_alignment import Shortfall, SpaceAlignmentSettings, SpaceFit
from mocapella.calibration.space_observations import SpaceObservations
from mocapella.errors import CalibrationError, InputError, NoServerError, SettingsError
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.settings import check

INSTRUCTION: Final = (
    "move it through all of the space that the cameras see, tilting and turning it about every axis, now slowly, now "
    "fast; keep our side towards the cameras"
)
_POLL_S: Final = 0.02


@dataclass(frozen=True)
class AlignGuideSettings:
    """Duration of the guidance, and the precision that ends it early.

    Attributes:
        seconds: longest duration [s].
        least_seconds: shortest duration [s]: standard deviations of a few half-second blocks are unreliable.
        every: interval between attempts to align and reports of missing data [s].
        patience: longest wait for the first scene [s].
        good_m, good_rad, good_delay_s: standard deviations of position [m], rotation [rad] and delay [s] that end it
            early; ``good_m`` also applies to the lever arm. When the time is over, the limits of
            `SpaceAlignmentSettings` suffice.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    seconds: float = 60.0
    least_seconds: float = 10.0
    every: float = 1.0
    patience: float = 10.0
    good_m: float = 0.002
    good_rad: float = 0.005
    good_delay_s: float = 0.003

    def __post_init__(self) -> None:
        check(1 <= self.seconds <= 3600, "seconds", self.seconds, "from 1 to 3600 s")
        check(0 <= self.least_seconds <= 3600, "least_seconds", self.least_seconds, "from 0 to 3600 s")
        check(0.05 <= self.every <= 60, "every", self.every, "from 0.05 to 60 s")
        check(0 < self.patience <= 3600, "patience", self.patience, "above 0 and at most 3600 s")
        for name in ("good_m", "good_rad", "good_delay_s"):
            check(0 < getattr(self, name) < 1e3, name, getattr(self, name), "above 0")


class AlignGuide:
    """Guides a person through the motion that aligns another tracker's space with the cameras' world.

    Args:
        messages: returns all messages received since its last call.
        observations: collects the messages, and computes the alignment.
        settings: duration and precision; the defaults if None.
        alignment: settings of the estimate, with the limits that its precision must meet; the defaults if None.
        say: receives lines for the person.
        show: receives the missing data as text that replaces its last text.
        clock, sleep: in seconds.
    """

    def __init__(
        self,
        messages: Callable[[], Iterable[Scene | SensorFrame]],
        observations: SpaceObservations,
        settings: AlignGuideSettings | None = None,
        alignment: SpaceAlignmentSettings | None = None,
        *,
        say: Callable[[str], None],
        show: Callable[[str], None] = lambda text: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._messages, self._observations = messages, observations
        self._settings, self._alignment = settings or AlignGuideSettings(), alignment or SpaceAlignmentSettings()
        self._say, self._show, self._clock, self._sleep = say, show, clock, sleep

    def run(self) -> SpaceFit:
        """Collect until the alignment is precise, or until the time is over and its precision suffices; return it.

        Raises:
            NoServerError: no scene arrives.
            InputError, SettingsError: the time is over, and the body, its space, the object or the marker is missing.
            CalibrationError: the time is over, and the alignment is not determined; lists the missing data.
        """
        self._wait_for_scenes()
        s = self._settings
        self._say(f"for {s.seconds:g} s at most: {INSTRUCTION}")
        began = self._clock()
        while True:
            self._collect_until(min(self._clock() + s.every, began + s.seconds))
            passed = self._clock() - began
            over = passed >= s.seconds
            try:
                fit, missing = self._observations.attempt(self._alignment)
            except (InputError, SettingsError) as error:
                if over:
                    raise
                self._show(f"{passed:.0f} s: {error}")
                continue
            if fit is not None and not missing and (over or (passed >= s.least_seconds and self._is_good(fit))):
                if not self._is_good(fit):
                    self._say(f"{s.seconds:g} s are over; the alignment could be more precise: {self._so_far(fit)}")
                return fit
            if over:
                raise CalibrationError(f"{s.seconds:g} s were not enough: " + "; ".join(map(str, missing)))
            self._show(f"{passed:.0f} s: {self._so_far(fit) if fit and not missing else _in_brief(missing)}")

    def _is_good(self, fit: SpaceFit) -> bool:
        s = self._settings
        far = max(fit.position_sd_m, fit.lever_sd_m)
        return far <= s.good_m and fit.rotation_sd_rad <= s.good_rad and fit.delay_sd_s <= s.good_delay_s

    def _so_far(self, fit: SpaceFit) -> str:
        s = self._settings
        return (
            f"precise to {1e3 * fit.position_sd_m:.1f} mm (the lever arm to {1e3 * fit.lever_sd_m:.1f}), "
            f"{math.degrees(fit.rotation_sd_rad):.2f}° and {1e3 * fit.delay_sd_s:.1f} ms; good are "
            f"{1e3 * s.good_m:g} mm, {math.degrees(s.good_rad):.2f}° and {1e3 * s.good_delay_s:g} ms"
        )

    def _collect_until(self, end: float) -> None:
        while True:
            self._observations.update(self._messages())
            if self._clock() >= end:
                return
            self._sleep(_POLL_S)

    def _wait_for_scenes(self) -> None:
        end = self._clock() + self._settings.patience
        while not self._observations.scenes:
            if self._clock() > end:
                problem = f"no scene arrived within {self._settings.patience:g} s"
                raise NoServerError(f"{problem}; start the cameras' nodes, and the server with --method hands")
            self._show("waiting for scenes …")
            self._observations.update(self._messages())
            self._sleep(_POLL_S)


def _in_brief(missing: Iterable[Shortfall]) -> str:
    return "; ".join(f"{one.problem} ({one.measured})" for one in missing)
