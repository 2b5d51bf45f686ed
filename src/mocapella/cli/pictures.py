"""Options of the commands that read a camera's images, and their messages about its state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli.command_settings import KeySpec
from mocapella.cli.common import parse_size, say
from mocapella.errors import InputError
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.sensing.colour_profile import CameraControls, ColourProfile
    from mocapella.sources.camera_controls import CameraWishes
    from mocapella.sources.picture_source import PictureSource, SourceState

Source = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="camera:0, /dev/video0, picamera:0, http://… or rtsp://…, a film, a folder of images, or "
        "rendered:SCENE/CAMERA.",
    ),
]
Size = Annotated[
    str | None,
    typer.Option("--size", metavar="WxH", help="Image size in pixels; by default the camera's or profile's."),
]


def _frame_rate(fps: float | None) -> float | None:
    """Return a frame rate [Hz] unchanged; raise `SettingsError` if no camera or film has it."""
    check(fps is None or 0 < fps <= 1000, "--fps", fps, "above 0, at most 1000")
    return fps


Fps = Annotated[
    float | None,
    typer.Option(
        "--fps",
        metavar="HZ",
        callback=_frame_rate,
        help="Frame rate to request from a camera, or to assume for files [Hz].",
    ),
]
Profile = Annotated[
    Path | None,
    typer.Option(
        "--profile",
        metavar="FILE",
        help="Colour profile of the markers (JSON) of `mocapella calibrate colours learn`; without it, none are known.",
    ),
]
FOURCC: Final = KeySpec("Pixel format to request from the camera.", "CODE, such as MJPG")
_DRIVERS: Final = "driver's unit"
EXPOSURE: Final = KeySpec("Exposure; by default the profile's.", _DRIVERS)
GAIN: Final = KeySpec("Gain; by default the profile's.", _DRIVERS)
WHITE_BALANCE: Final = KeySpec("White balance; by default the profile's.", _DRIVERS)
RED: Final = KeySpec("Red white balance; by default the profile's.", _DRIVERS)
BLUE: Final = KeySpec("Blue white balance; by default the profile's.", _DRIVERS)

_LIGHT: Final = ("exposure", "gain")  # one mode sets both in some cameras
_SET_BY: Final = dict.fromkeys(_LIGHT, _LIGHT) | dict.fromkeys(
    ("white_balance", "white_balance_red", "white_balance_blue"), ("white_balance",)
)
"""The automatic modes that may set a control."""


@dataclass(frozen=True)
class CameraKeys:
    """Settings of a colour camera."""

    fourcc: Annotated[str | None, FOURCC] = None
    exposure: Annotated[float | None, EXPOSURE] = None
    gain: Annotated[float | None, GAIN] = None
    white_balance: Annotated[float | None, WHITE_BALANCE] = None
    saturation: Annotated[float | None, KeySpec("Saturation; by default the profile's.", _DRIVERS)] = None
    contrast: Annotated[float | None, KeySpec("Contrast; by default the profile's.", _DRIVERS)] = None
    white_balance_red: Annotated[float | None, RED] = None
    white_balance_blue: Annotated[float | None, BLUE] = None
    brightness: Annotated[float | None, KeySpec("Brightness; by default the profile's.", _DRIVERS)] = None

    @property
    def controls(self) -> CameraControls:
        """The camera controls of these settings; None for those not given."""
        from mocapella.model.camera_controls import CONTROLS
        from mocapella.sensing.colour_profile import CameraControls

        return CameraControls(**{name: getattr(self, name) for name in CONTROLS})


def wishes(
    size: str | None,
    fps: float | None,
    fourcc: str | None,
    given: Any,
    profile: ColourProfile | None,
) -> CameraWishes:
    """Return the size, rate and controls to request of a camera: from the options, else, but for the rate, the profile.

    Args:
        size: such as ``640x480``; None if not given.
        fps: frame rate [Hz]; None if not given.
        fourcc: four-character code of the image format; None if not given.
        given: `CameraControls` with the values of the options; None where an option is not given. A given value
            switches the automatic mode off that the profile has on.
        profile: learnt colours, whose controls and image size were in use; None if there are none.

    Raises:
        SettingsError: an invalid value.
    """
    from mocapella.sources.camera_controls import CameraWishes

    if profile is not None:
        said = given.values
        modes = {mode for name in said for mode in _SET_BY.get(name, ())}
        kept = tuple(mode for mode in profile.controls.automatic if mode not in modes)
        given = replace(profile.controls, **said, automatic=kept)
    size_px = None if profile is None else profile.size_px
    if size is not None:
        size_px = parse_size(size)
    return CameraWishes(size_px, fps, fourcc, given)


def check_state(state: SourceState, known: ColourProfile | None, profile: Path | None, source: str) -> None:
    """Check, before the first image, that the images have the size at which the colours were learnt.

    Args:
        state: the camera's state; nothing is checked if its ``size_px`` is None.
        known: the learnt colours; nothing is checked if there are none.
        profile: file of the learnt colours, named in the error.
        source: name of the images' source, named in the error.

    Raises:
        InputError: the images have another size.
    """
    if known is None or state.size_px is None or tuple(state.size_px) == tuple(known.size_px):
        return
    was, now = (f"{w} × {h}" for w, h in (known.size_px, state.size_px))
    fix = f"set it to {was} px, or learn the colours anew"
    raise InputError(f"{source} gives pictures of {now} px", file=profile, field="size_px", value=was, fix=fix)


def tell_state(sensor: str, pictures: PictureSource, state: SourceState) -> None:
    """Print the name, size, rate and time source of a camera's images, and the problems of its controls."""
    size = "" if state.size_px is None else f", {state.size_px[0]} × {state.size_px[1]} px"
    rate = "" if state.fps is None else f", {state.fps:g} a second"
    say(f"{sensor}: pictures of {pictures.name}{size}{rate}; their time is {pictures.times}")
    for problem in state.problems:
        say(f"{sensor}: {problem}")
