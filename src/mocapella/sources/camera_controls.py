"""Set a camera's exposure, gain, white balance and others through OpenCV at its start, and read them back.

Drivers differ: many accept a value and keep another, or ignore it and report success. So only the values read back
count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

import cv2

from mocapella.sensing.colour_profile import CameraControls
from mocapella.settings import check
from mocapella.sources.picture_source import SourceState, left_automatic, missing_control, stuck_automatic

_VALUES: Final = {
    "exposure": cv2.CAP_PROP_EXPOSURE,
    "gain": cv2.CAP_PROP_GAIN,
    "white_balance": cv2.CAP_PROP_WB_TEMPERATURE,
    "white_balance_red": cv2.CAP_PROP_WHITE_BALANCE_RED_V,
    "white_balance_blue": cv2.CAP_PROP_WHITE_BALANCE_BLUE_U,
    "saturation": cv2.CAP_PROP_SATURATION,
    "contrast": cv2.CAP_PROP_CONTRAST,
    "brightness": cv2.CAP_PROP_BRIGHTNESS,
}
_AUTOMATIC: Final = {
    "exposure": cv2.CAP_PROP_AUTO_EXPOSURE,
    "white_balance": cv2.CAP_PROP_AUTO_WB,
    "focus": cv2.CAP_PROP_AUTOFOCUS,
}
_MANUAL_EXPOSURE: Final = {"V4L2": (1.0,), "DSHOW": (0.25,), "MSMF": (0.0,)}
"""Values that switch automatic exposure off, by OpenCV's back end; in V4L2's menu 1 is manual."""
_AUTOMATIC_EXPOSURE: Final = {"V4L2": (3.0, 0.0), "DSHOW": (0.75,), "MSMF": (1.0,)}
"""Values that switch it on; in V4L2's menu 3 is aperture priority, and 0 automatic."""
_SET_BY: Final = {
    "exposure": "exposure",
    "white_balance": "white_balance",
    "white_balance_red": "white_balance",
    "white_balance_blue": "white_balance",
}
"""The automatic mode of a control."""
_NONE: Final = -1.0
"""OpenCV's value of a control that does not exist."""


@dataclass(frozen=True)
class CameraWishes:
    """The requested settings of a camera; None keeps the present value.

    Attributes:
        size_px: (width, height) of the images.
        fps: frame rate [Hz].
        fourcc: pixel format on the cable, such as MJPG, which many cameras need for a high rate.
        controls: exposure, gain and others, in the driver's own units, as OpenCV takes them; automatic exposure, white
            balance and focus are switched off, also without any request, but for those in ``controls.automatic``.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    size_px: tuple[int, int] | None = None
    fps: float | None = None
    fourcc: str | None = None
    controls: CameraControls = field(default_factory=CameraControls)

    def __post_init__(self) -> None:
        size = self.size_px
        check(size is None or (len(size) == 2 and 2 <= min(size) <= max(size) <= 65_536), "size_px", size,
              "width and height from 2 to 65536 px")  # fmt: skip
        check(self.fps is None or 0 < self.fps <= 10_000, "fps", self.fps, "above 0, at most 10000 Hz")
        good = self.fourcc is None or (len(self.fourcc) == 4 and self.fourcc.isascii())
        check(good, "fourcc", self.fourcc, "four letters, such as MJPG or YUYV")


def set_camera(capture: Any, wishes: CameraWishes) -> SourceState:
    """Apply settings to an open `cv2.VideoCapture`, switch automatic modes off, and read the result back.

    Nothing is raised for a setting that the driver refuses: it is one of the state's ``problems``.
    """
    if wishes.fourcc is not None:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*wishes.fourcc))
    if wishes.size_px is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, wishes.size_px[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wishes.size_px[1])
    if wishes.fps is not None:
        capture.set(cv2.CAP_PROP_FPS, wishes.fps)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # no queue of old images
    problems = list(_format_problems(capture, wishes))
    kept = tuple(name for name in _AUTOMATIC if name in wishes.controls.automatic and _switched_on(capture, name))
    problems += [left_automatic(name) for name in kept]
    stuck = tuple(name for name in _AUTOMATIC if name not in kept and not _switched_off(capture, name))
    problems += [stuck_automatic(name) for name in stuck]
    for name, value in _VALUES.items():
        wished = getattr(wishes.controls, name)
        if wished is None or _SET_BY.get(name) in kept:
            continue
        capture.set(value, wished)
        got = float(capture.get(value))
        if got == _NONE != wished:
            problems.append(missing_control(name, wished))
        elif not math.isclose(got, wished, rel_tol=0.02, abs_tol=1e-6):
            reason = f"it stays {got:g}"
            problems.append(f"{name.replace('_', ' ')} cannot be set to {wished:g}: {reason}; learn the colours again")
    width, height = (int(capture.get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    stated = float(capture.get(cv2.CAP_PROP_FPS))
    return SourceState(
        size_px=(width, height) if width > 0 and height > 0 else None,
        fps=wishes.fps or (stated if 0 < stated < math.inf else None),
        controls=CameraControls(
            **{name: _read(capture, prop) for name, prop in _VALUES.items()},
            automatic=tuple(name for name in _AUTOMATIC if name in kept + stuck),
        ),
        problems=tuple(problems),
    )


def _format_problems(capture: Any, wishes: CameraWishes) -> list[str]:
    problems = []
    if wishes.fourcc is not None and int(capture.get(cv2.CAP_PROP_FOURCC)) != cv2.VideoWriter.fourcc(*wishes.fourcc):
        problems.append(f"it does not support the pixel format {wishes.fourcc}; leave fourcc out, or try YUYV or MJPG")
    stated = float(capture.get(cv2.CAP_PROP_FPS))
    if wishes.fps is not None and stated > 0 and not math.isclose(stated, wishes.fps, rel_tol=0.02):
        problems.append(
            f"it reports {stated:g} frames a second, not the requested {wishes.fps:g}; try another size, "
            "or --set fourcc=MJPG"
        )
    return problems


def _switched_off(capture: Any, name: str) -> bool:
    """Switch an automatic mode off; whether it is off. Of modes unknown to the driver, only the focus counts as off."""
    prop = _AUTOMATIC[name]
    offs = _MANUAL_EXPOSURE.get(_back_end(capture), (1.0, 0.25, 0.0)) if name == "exposure" else (0.0,)
    for off in offs:
        if capture.set(prop, off) and float(capture.get(prop)) == off:
            return True
    return name == "focus" and float(capture.get(prop)) in (_NONE, 0.0)


def _switched_on(capture: Any, name: str) -> bool:
    """Switch an automatic mode on; whether it is on."""
    prop = _AUTOMATIC[name]
    ons = _AUTOMATIC_EXPOSURE.get(_back_end(capture), (3.0, 0.75, 1.0)) if name == "exposure" else (1.0,)
    return any(capture.set(prop, on) and float(capture.get(prop)) == on for on in ons)


def _back_end(capture: Any) -> str:
    try:
        return str(capture.getBackendName())
    except (AttributeError, cv2.error):
        return ""


def _read(capture: Any, prop: int) -> float | None:
    value = float(capture.get(prop))
    return None if value == _NONE or not math.isfinite(value) else value
