"""The controls of a simulated colour camera, which act on its images as a sensor's do.

The exposure is a time: a longer one collects more light and blurs what moves. The gain amplifies signal and noise. The
red and blue white balance are factors after the sensor. Saturation, contrast and brightness change the finished image.

The automatic exposure brings the image's mean to a middle grey. The automatic white balance makes the image grey in the
mean (the grey-world assumption: Buchsbaum, A spatial processor model for object colour perception, Journal of the
Franklin Institute 310, 1980). Both take a part of the step with each image, so that they do not oscillate.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera_controls import ControlDescription, checked
from mocapella.sources.simulate.hand_scene import SimulatedCamera

UNIT_S: Final = 1e-4
"""Unit of the exposure time, as V4L2 has it [s]."""
MIDDLE_GREY: Final = 110.0
"""Mean 8-bit value at which the automatic exposure aims."""
_GAMMA: Final = 2.2
_PART: Final = 0.3
_EVERY_PX: Final = 8
_LEAST_GAIN, _MOST_GAIN = 0.25, 4.0


class RenderedControls:
    """Exposure, gain, white balance, saturation, contrast and brightness of a simulated camera.

    All methods may be called from any thread.

    Args:
        camera: the camera, whose present settings are the defaults.
    """

    def __init__(self, camera: SimulatedCamera) -> None:
        self._own, image = camera, camera.image
        self._lock = threading.Lock()
        self._base = max(1, round(camera.exposure_s / UNIT_S))
        light = image.exposure / self._base  # of a unit of exposure time
        least, most = max(1, math.ceil(0.01 / light)), min(1 / camera.fps / UNIT_S, 100 / light)
        red, _, blue = image.white_balance
        described = (
            ("exposure", "100 µs", least, max(math.floor(most), self._base), 1, self._base, "exposure"),
            ("gain", "dB", 0.0, 24.0, 0.5, 20 * math.log10(image.gain), ""),
            ("white_balance_red", "×", _LEAST_GAIN, _MOST_GAIN, 0.01, red, "white_balance"),
            ("white_balance_blue", "×", _LEAST_GAIN, _MOST_GAIN, 0.01, blue, "white_balance"),
            ("saturation", "×", 0.0, 2.0, 0.01, image.saturation, ""),
            ("contrast", "×", 0.25, 4.0, 0.01, image.contrast, ""),
            ("brightness", "levels", -100, 100, 1, image.brightness, ""),
        )
        self._fixed = tuple(
            ControlDescription(name, unit, least, most, step, default, default, mode)
            for name, unit, least, most, step, default, mode in described
        )
        self._values = {control.name: control.default for control in self._fixed}
        self._automatic = {control.mode: False for control in self._fixed if control.mode}

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return the controls with their present values."""
        with self._lock:
            return tuple(
                replace(control, value=self._values[control.name], automatic=self._automatic.get(control.mode, False))
                for control in self._fixed
            )

    def set_controls(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Switch automatic modes and set values; the result is empty, because nothing that is valid is refused.

        Raises:
            SettingsError: the request is invalid, see `mocapella.model.camera_controls.checked`; nothing is set.
        """
        accepted = checked(self.controls(), values, automatic)
        with self._lock:
            self._values.update(accepted)
            self._automatic.update(automatic)
        return ()

    @property
    def camera(self) -> SimulatedCamera:
        """The camera with the present values; the very same camera as given while all are the defaults."""
        with self._lock:
            now = dict(self._values)
        if all(now[control.name] == control.default for control in self._fixed):
            return self._own
        image = self._own.image
        base = self._own.exposure_s or self._base * UNIT_S
        times = now["exposure"] / self._base
        return replace(
            self._own,
            exposure_s=self._own.exposure_s if times == 1 else base * times,
            image=replace(
                image,
                exposure=image.exposure * times,
                gain=10 ** (now["gain"] / 20),
                white_balance=(now["white_balance_red"], image.white_balance[1], now["white_balance_blue"]),
                saturation=now["saturation"],
                contrast=now["contrast"],
                brightness=now["brightness"],
            ),
        )

    def adapt(self, image: NDArray[np.uint8]) -> None:
        """Let the automatic modes that are on react to an image, (height, width, 3) uint8 BGR; otherwise do nothing."""
        with self._lock:
            exposes, balances = self._automatic["exposure"], self._automatic["white_balance"]
        if not (exposes or balances):
            return
        blue, green, red = (float(mean) for mean in image[::_EVERY_PX, ::_EVERY_PX].reshape(-1, 3).mean(axis=0))
        with self._lock:
            if exposes:
                mean = max(0.114 * blue + 0.587 * green + 0.299 * red, 1.0)
                self._change("exposure", (MIDDLE_GREY / mean) ** _GAMMA)
            if balances:
                self._change("white_balance_red", (max(green, 1.0) / max(red, 1.0)) ** _GAMMA)
                self._change("white_balance_blue", (max(green, 1.0) / max(blue, 1.0)) ** _GAMMA)

    def _change(self, name: str, ratio: float) -> None:
        """Multiply a value by a part of a ratio, within its range, without rounding: small steps would get lost."""
        control = next(known for known in self._fixed if known.name == name)
        self._values[name] = min(max(self._values[name] * ratio**_PART, control.least), control.most)
