"""The marker colours of one camera: learnt once from clicks, stored as JSON, made into a look-up table at the start.

Colours are distinguished by logarithmic chromaticity, u = ln (R + 8)/(G + 8), v = ln (B + 8)/(G + 8), of 8-bit values:
brightness multiplies all three and changes neither, and gamma only scales both.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_json, read_whole
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.model.camera_controls import CONTROLS
from mocapella.model.observations import check_sensor_name
from mocapella.model.whole_file import write_whole
from mocapella.settings import check, parse

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

VERSION: Final = 1
"""Version of the file's layout."""
OFFSET: Final = 8.0
"""Added to a value before the logarithm, so that the noise of dark pixels does not look like colour."""
BINS: Final = 56
SPAN: Final = 3.5
"""The histogram of chromaticities has BINS × BINS cells from -SPAN to SPAN in u and v; no 8-bit pixel lies outside."""
SKIN: Final = "skin"
"""Name of the skin sample among the clicks."""


def chromaticity(bgr: NDArray[Any]) -> Float64:
    """Return the log-chromaticity (..., 2) of 8-bit blue, green, red (..., 3): u = log R − log G, v = log B − log G."""
    logs = np.log(np.asarray(bgr, np.float64) + OFFSET)
    return np.stack([logs[..., 2] - logs[..., 1], logs[..., 0] - logs[..., 1]], axis=-1)


def brightness(bgr: NDArray[Any]) -> Float64:
    """Return the luma (...) by ITU-R BT.601, 0 to 255, of 8-bit blue, green, red (..., 3)."""
    return np.asarray(np.asarray(bgr, np.float64) @ np.array([0.114, 0.587, 0.299]))


@dataclass(frozen=True)
class CameraControls:
    """Values of a camera's controls, in its driver's units; None for a missing control.

    The fields are named as in `mocapella.model.camera_controls.CONTROLS`.

    Attributes:
        automatic: names of the automatic modes that are on, since they cannot be switched off or were left on.
    """

    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    saturation: float | None = None
    contrast: float | None = None
    automatic: tuple[str, ...] = ()
    brightness: float | None = None
    white_balance_red: float | None = None
    white_balance_blue: float | None = None

    @property
    def values(self) -> dict[str, float]:
        """The values by name, without the missing ones."""
        found = {name: getattr(self, name) for name in CONTROLS}
        return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True)
class Chromaticities:
    """Distribution of a colour's pixels; u and v are as in the module.

    Attributes:
        mean: (u, v).
        covariance: (uu, uv, vv).
        luma: percentiles 5, 50 and 95 of luma, 0 to 255.
        pixels: number of pixels.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    mean: tuple[float, float]
    covariance: tuple[float, float, float]
    luma: tuple[float, float, float]
    pixels: int

    def __post_init__(self) -> None:
        check(bool(np.isfinite(self.mean).all()), "mean", self.mean, "two finite numbers")
        uu, uv, vv = self.covariance
        definite = bool(np.isfinite(self.covariance).all()) and uu > 0 and uu * vv > uv * uv
        check(definite, "covariance", self.covariance, "uu, uv, vv of a positive definite matrix")
        low, middle, high = self.luma
        check(0 <= low <= middle <= high <= 255, "luma", self.luma, "three rising numbers from 0 to 255")
        check(self.pixels > 0, "pixels", self.pixels, "1 or more")


@dataclass(frozen=True)
class Colour:
    """A marker's colour.

    Attributes:
        name: the marker's name.
        seen: distribution of its pixels.
        area_px: median area of the regions around the clicks on the marker [px²].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    seen: Chromaticities
    area_px: float

    def __post_init__(self) -> None:
        check(bool(self.name) and self.name != SKIN, "name", self.name, f"a name, and not {SKIN!r}")
        check(0 < self.area_px < 1e9, "area_px", self.area_px, "above 0 px")


@dataclass(frozen=True)
class BackgroundColours:
    """Colours of everything but the markers.

    Attributes:
        counts: (BINS, BINS) numbers of pixels by u and v.
        luma: median luma of the pixels, 0 to 255.
        chromaticity: medians of u and v; they drift with the colour of the light.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    counts: tuple[tuple[int, ...], ...]
    luma: float
    chromaticity: tuple[float, float]

    def __post_init__(self) -> None:
        square = len(self.counts) == BINS and all(len(row) == BINS for row in self.counts)
        check(square, "counts", f"{len(self.counts)} rows", f"{BINS} rows of {BINS}")
        check(all(n >= 0 for row in self.counts for n in row), "counts", "below 0", "0 or more")
        check(0 <= self.luma <= 255, "luma", self.luma, "from 0 to 255")
        check(bool(np.isfinite(self.chromaticity).all()), "chromaticity", self.chromaticity, "two finite numbers")


@dataclass(frozen=True)
class ColourProfile:
    """The colours learnt for one camera.

    Attributes:
        camera: the camera's name.
        size_px: (width, height) of its images.
        colours: 1 to 100, in the order of their labels, which start at 1.
        background: colours of the rest of the scene.
        skin: distribution of skin; None if it was not clicked.
        controls: values of the camera's controls while the colours were learnt.
        version: version of the file's layout.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    camera: str
    size_px: tuple[int, int]
    colours: tuple[Colour, ...]
    background: BackgroundColours
    skin: Chromaticities | None = None
    controls: CameraControls = field(default_factory=CameraControls)
    version: int = VERSION

    def __post_init__(self) -> None:
        check(self.version == VERSION, "version", self.version, f"{VERSION}: learn the colours anew and save")
        check_sensor_name(self.camera)
        check(min(self.size_px) >= 2, "size_px", self.size_px, "at least 2 × 2")
        check(1 <= len(self.colours) <= 100, "colours", len(self.colours), "1 to 100")
        names = self.names
        check(len(set(names)) == len(names), "colours", names, "of different names")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers, in the order of their labels."""
        return tuple(colour.name for colour in self.colours)

    def check_camera(self, camera: str, size_px: tuple[int, int]) -> None:
        """Check that camera and image size are the profile's.

        Raises:
            SettingsError: they differ; states both.
        """
        learn = "load that camera's profile, or learn the colours anew"
        if camera != self.camera:
            raise SettingsError(f"the colours are of the camera {self.camera!r}, not of {camera!r}; {learn}")
        if tuple(size_px) != tuple(self.size_px):
            was, now = (f"{w} × {h}" for w, h in (self.size_px, size_px))
            raise SettingsError(
                f"the colours of {camera!r} were learnt at {was} px, its images have {now} px; set it to {was}, "
                "or learn the colours anew"
            )


def encode_profile(profile: ColourProfile) -> bytes:
    """Encode a profile as JSON in UTF-8."""
    return msgspec.json.encode(asdict(profile)) + b"\n"


def decode_profile(data: bytes, *, file: object = None) -> ColourProfile:
    """Decode a profile from a JSON file's content.

    Args:
        data: the content.
        file: named in errors; None leaves it out.

    Raises:
        InputError: it is not a profile; states the field, its value and a valid one.
    """
    fix = "learn the colours anew and save"
    read = decode_json(data, dict[str, Any], what="colour profile", file=file, fix=fix)
    try:
        return parse(ColourProfile, read, where="colour profile")
    except MocapellaError as error:
        raise InputError(str(error), file=file, fix=fix) from None


def save_profile(path: Path | str, profile: ColourProfile) -> None:
    """Write a profile atomically: the file is complete or unchanged.

    Raises:
        InputError: it cannot be written there.
    """
    write_whole(path, encode_profile(profile))


def load_profile(path: Path | str) -> ColourProfile:
    """Read a profile.

    Raises:
        InputError: the file does not exist, or is not a profile.
    """
    return decode_profile(read_whole(path, fix="learn the colours first"), file=path)
