"""A camera's controls as its driver describes them: exposure, gain, white balance and others, each in its own range."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from mocapella.errors import SettingsError, one_of
from mocapella.settings import check

CONTROLS: Final = (
    "exposure", "gain", "white_balance", "white_balance_red", "white_balance_blue", "saturation", "contrast",
    "brightness",
)  # fmt: skip
"""Names of the controls, in the order of the view; ``white_balance`` is a colour temperature."""
LONGEST: Final = 80
"""Longest name of a control, of a mode and of a unit, in characters."""
LARGEST: Final = 1e10
LEAST_STEP: Final = 1e-6
"""Largest magnitude of a value, and smallest step: a description comes over the bus, and a slider counts its steps."""


@dataclass(frozen=True)
class ControlDescription:
    """One control of a camera, and its present value.

    Attributes:
        name: its name, one of `CONTROLS` if it has the same meaning.
        unit: unit of all numbers here; empty if the driver does not state it.
        least, most: smallest and largest value.
        step: distance of neighbouring values, counted from ``least``.
        default: the driver's default.
        value: the present value.
        mode: name of the automatic mode that sets it; empty if there is none. Several controls can share one.
        automatic: whether that mode is on.
        read_only: whether it cannot be set.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    unit: str
    least: float
    most: float
    step: float
    default: float
    value: float
    mode: str = ""
    automatic: bool = False
    read_only: bool = False

    def __post_init__(self) -> None:
        check(0 < len(self.name) <= LONGEST, "name", self.name[:LONGEST], f"1 to {LONGEST} characters")
        check(len(self.unit) <= LONGEST, "unit", self.unit[:LONGEST], f"at most {LONGEST} characters")
        check(len(self.mode) <= LONGEST, "mode", self.mode[:LONGEST], f"at most {LONGEST} characters")
        for field in ("least", "most", "default", "value"):
            check(abs(getattr(self, field)) <= LARGEST, field, getattr(self, field), f"within ±{LARGEST:g}")
        check(self.least <= self.most, "least", self.least, f"at most {self.most:g}, the largest value")
        check(LEAST_STEP <= self.step <= LARGEST, "step", self.step, f"from {LEAST_STEP:g} to {LARGEST:g}")
        check(not self.automatic or bool(self.mode), "automatic", self.automatic, "False without a mode")

    @property
    def range_text(self) -> str:
        """The valid values in words, such as ``from 1 to 500 (100 µs)``."""
        return f"from {self.least:g} to {self.most:g}" + (f" ({self.unit})" if self.unit else "")

    def accepted(self, value: float) -> float:
        """Return the value on the control's grid that is nearest to ``value``.

        Raises:
            SettingsError: the control is read-only, or the value is out of range or not finite.
        """
        if self.read_only:
            raise SettingsError(f"{self.name} is read-only in this camera; it is {self.value:g}")
        check(self.least <= value <= self.most, self.name, value, self.range_text)  # also False of NaN
        steps = min(round((value - self.least) / self.step), math.floor((self.most - self.least) / self.step + 1e-9))
        return round(self.least + steps * self.step, 9)


def checked(
    controls: Sequence[ControlDescription], values: Mapping[str, float], automatic: Mapping[str, bool]
) -> dict[str, float]:
    """Return the requested values on the grids of their controls, or refuse the whole request.

    Args:
        controls: the camera's controls.
        values: requested values by name of the control.
        automatic: automatic modes to switch on or off, by name of the mode.

    Raises:
        SettingsError: an unknown control or mode; a value that its control refuses; or a value of a control whose
            automatic mode is, or would be, on.
    """
    known = {control.name: control for control in controls}
    modes = {control.mode: control.automatic for control in controls if control.mode}
    for mode in automatic:
        if mode not in modes:
            raise SettingsError(
                f"the camera has no automatic {mode[:LONGEST]!r}; it has {one_of(mode, modes) or 'none'}"
            )
    on = {**modes, **automatic}
    out = {}
    for name, value in values.items():
        if name not in known:
            raise SettingsError(f"the camera has no control {name[:LONGEST]!r}; it has {one_of(name, known) or 'none'}")
        control = known[name]
        if on.get(control.mode, False):
            raise SettingsError(f"{name} is set by the automatic {control.mode}; switch that off first")
        out[name] = control.accepted(value)
    return out
