"""The interface of image sources: a camera, a stream, a video, a folder of images or a rendered scene.

    source = open_pictures("camera:0")     # sources/open_pictures.py; depth images: sources/open_depth.py
    source.open()
    source.begin(time.monotonic())
    picture = source.read(stop)

`mocapella.sources.acquisition.Acquisition` reads a source in its own thread.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.camera_controls import CONTROLS, ControlDescription
from mocapella.sensing.colour_profile import CameraControls

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Picture:
    """One image and its capture time.

    Attributes:
        image: (height, width, 3) uint8 BGR; of a depth camera, (height, width) uint16 distances along the optical axis,
            in the unit of the source's state.
        time_ns: capture time on the source's own clock, above 0 and rising.
        number: number of images that the source has given before this one.
        ready_s: time at which the decoded image was available, on this machine's monotonic clock [s].
        retrieval_s: duration of the decoding, without the wait for the image [s].
        colour: (height, width, 3) uint8 BGR of the same instant, of a depth camera with colour; else None.
    """

    image: Image
    time_ns: int
    number: int
    ready_s: float
    retrieval_s: float
    colour: NDArray[np.uint8] | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the image."""
        return self.image.shape[1], self.image.shape[0]


@dataclass(frozen=True)
class ColourCamera:
    """The colour camera of a depth camera.

    Attributes:
        size_px: (width, height) of its images.
        lens: (9,) its intrinsics, see `mocapella.geometry.lens`.
        T_colour_depth: rows of the (4, 4) motion from the depth camera's frame to the colour camera's, both x right, y
            down, z out of the lens [m]; None if the depth images are registered to the colour images, pixel by pixel.
    """

    size_px: tuple[int, int]
    lens: tuple[float, ...]
    T_colour_depth: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True)
class SourceState:
    """The state of a source after it was opened.

    Attributes:
        size_px: (width, height) that the source states; None if unknown before the first image.
        fps: requested frame rate, or the rate that the source states [Hz]; None if unknown.
        controls: exposure, gain and others, as read back from the camera.
        problems: requested settings that the source did not accept, or values that it had to assume, each a sentence
            with a remedy.
        unit_m: length of a unit of a depth camera's image [m]; None if unknown, or no depth camera.
        lens: (9,) intrinsics of a depth camera, see `mocapella.geometry.lens`; None if unknown, or no depth camera.
        colour: the colour camera of a depth camera that gives colour images, too; else None.
    """

    size_px: tuple[int, int] | None = None
    fps: float | None = None
    controls: CameraControls = field(default_factory=CameraControls)
    problems: tuple[str, ...] = ()
    unit_m: float | None = None
    lens: tuple[float, ...] | None = None
    colour: ColourCamera | None = None


class PictureSource(Protocol):
    """A source of images. It is opened and read by one thread at a time."""

    name: str
    """Name of the source, as the user wrote it."""
    live: bool
    """Whether a missing image means that a camera was lost and must be reopened; otherwise the source has ended."""
    times: str
    """The origin of its capture times, in words."""

    def open(self) -> SourceState:
        """Open the source; it may be opened again after `close`.

        Raises:
            InputError: it cannot be opened; states a remedy.
        """
        ...

    def begin(self, zero_s: float) -> None:
        """Set the source's time 0, on the monotonic clock [s], after `open` and before the first `read`.

        Recordings are played from then on in real time; cameras ignore this, since they have their own clock.
        """
        ...

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait for the next image; None if a recording has ended, a camera is lost, or ``stop`` is set.

        Setting ``stop`` ends the wait early, except in drivers that cannot be interrupted.
        """
        ...

    def close(self) -> None:
        """Release the source's resources; may be called twice, or before `open`."""
        ...


@runtime_checkable
class ControlledSource(Protocol):
    """A source whose controls can be read and set while it gives images, from any thread."""

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return its controls with their present values; empty if it has none, or does not state their ranges."""
        ...

    def set_controls(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Switch automatic modes by name, then set values by name; they hold also after the source is opened again.

        Returns a sentence for each that the camera did not accept.

        Raises:
            SettingsError: the request is invalid, see `mocapella.model.camera_controls.checked`; nothing is set.
        """
        ...


def controls_of(descriptions: Iterable[ControlDescription]) -> CameraControls:
    """Return the present values of described controls, and the automatic modes that are on."""
    known = tuple(descriptions)
    values = {control.name: control.value for control in known if control.name in CONTROLS}
    on = dict.fromkeys(control.mode for control in known if control.automatic)
    return CameraControls(**values, automatic=tuple(on))


def set_at_start(source: ControlledSource, wanted: CameraControls) -> tuple[str, ...]:
    """Set a source's controls as wanted; automatic modes that are not wanted are switched off.

    Values of controls whose automatic mode is wanted are not set. Nothing is raised for a control that the camera does
    not have, or for a value that it refuses: each is a sentence of the result.
    """
    known = source.controls()
    modes = {control.mode for control in known if control.mode}
    problems = list(source.set_controls({}, {mode: mode in wanted.automatic for mode in sorted(modes)}))
    names = {control.name: control for control in known}
    for name, value in wanted.values.items():
        control = names.get(name)
        if control is not None and control.mode and control.mode in wanted.automatic:
            continue
        if control is None:
            problems.append(missing_control(name, value))
            continue
        try:
            problems += source.set_controls({name: value}, {})
        except SettingsError as error:
            problems.append(f"{name.replace('_', ' ')} cannot be set to {value:g}: {error}; learn the colours again")
    problems += [left_automatic(mode) for mode in wanted.automatic if mode in modes]
    return tuple(problems)


def missing_control(name: str, value: float) -> str:
    """Return the sentence about a requested control that a camera does not have."""
    return f"{name.replace('_', ' ')} cannot be set to {value:g}: there is no such control; learn the colours again"


def stuck_automatic(mode: str) -> str:
    """Return the sentence about an automatic mode that the camera does not switch off."""
    return (
        f"automatic {mode.replace('_', ' ')} cannot be switched off: colours may drift; set it with the camera's own "
        "program, keep the light constant, or learn the colours in the brightest and the darkest light"
    )


def left_automatic(mode: str) -> str:
    """Return the sentence about an automatic mode that is on because the profile has it so."""
    return f"automatic {mode.replace('_', ' ')} is on, as saved: colours may drift; switch it off in the view"
