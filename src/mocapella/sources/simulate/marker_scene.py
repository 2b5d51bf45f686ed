"""Rendered images of a hand with painted fingertips, with exact centres of the markers.

    scene = load_marker_scene("desk", seed=1)
    shot = scene.at(2.5)
    shot.image, shot.centres_px, shot.visible

The hand is flat: tapered capsules for arm and fingers, an ellipse for the palm, and an ellipse of paint on each
fingertip and on the hand's base, in front of a cluttered wall. Other markers of fingertips are in `marker_kinds`. All
are shaded as rounded bodies, with highlights, under light of changing strength, colour and direction. Edges are
anti-aliased by exact distances. The image has an exposure time and, optionally, a rolling shutter; `camera_image` then
simulates the camera. Coordinates are OpenCV's: the centre of the first pixel is (0, 0).

A scene is a table of ``data/marker_scenes.toml``. The seed determines the wall, the hand's motion and the noise; the
same scene, seed and time give the same image to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.settings import check, parse
from mocapella.sources.simulate.camera_image import CameraImageSettings, camera_image
from mocapella.sources.simulate.marker_kinds import GREY, MARKER_KINDS

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int8 = NDArray[np.int8]
UInt8 = NDArray[np.uint8]

CAPSULE, ELLIPSE, TUBE = 0.0, 1.0, 2.0
ON_WALL, ON_SKIN, ON_OTHER, MIXED = -1, -2, -3, -4
"""Values of `MarkerScene.labels` off the markers: wall, skin, another thing, and a mixture of several."""
SUB_TIMES: Final = 4
"""Number of instants of one exposure that are averaged."""
_STEP_S: Final = 1e-4
_FINGERS: Final = (  # base x, y; direction from straight up, to the right [deg]; length; widths at base and tip
    (-0.47, -0.45, -52.0, 0.66, 0.15, 0.115),
    (-0.37, -0.98, -14.0, 0.80, 0.12, 0.095),
    (-0.12, -1.06, -3.0, 0.92, 0.12, 0.098),
    (0.13, -1.03, 6.0, 0.86, 0.115, 0.094),
    (0.36, -0.90, 17.0, 0.66, 0.10, 0.085),
)
"""x and y of the base, direction [deg], length and two radii of thumb to little finger, in palm widths; y down."""
_BASE: Final = (0.0, -0.35)


@dataclass(frozen=True)
class Paint:
    """A marker's paint: its name, its reflectance of red, green and blue from 0 to 1, and its gloss.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    albedo: tuple[float, float, float]
    gloss: float = 0.25

    def __post_init__(self) -> None:
        check(all(0 <= a <= 1 for a in self.albedo), f"albedo of {self.name}", self.albedo, "from 0 to 1")
        check(0 <= self.gloss <= 2, f"gloss of {self.name}", self.gloss, "from 0 to 2")


@dataclass(frozen=True)
class MarkerSceneSettings:
    """Description of a scene: a flat hand with painted markers in one camera's image; see `MarkerScene`.

    Attributes:
        paints: paints of thumb to little finger and of the hand's base.
        kind: of the fingertips' markers, a name in `marker_kinds.MARKER_KINDS`; the base always has a painted disc.
        size_px: (width, height) of the image.
        palm_px: width of the palm; 90 px is a hand half a metre in front of the thesis' camera [px].
        palm_change: relative change of the hand's size, as its distance varies.
        travel_px: greatest displacement of the hand from the centre, in x and y [px].
        sway_hz: frequency of the hand's motion [Hz].
        turn_deg: greatest rotation of the hand [deg].
        curl: relative shortening of the fingers when they bend.
        skin: reflectance of the skin in red, green, blue, 0 to 1.
        skin_gloss: gloss of the skin.
        clutter: colourfulness of the wall, 0 to 1.
        brightness_change: greatest factor by which the light's strength rises and falls.
        colour_change: greatest relative change of the light's red and blue.
        shading: fraction of the light that is directed, 0 to 1.
        light_hz: frequency of the light's changes [Hz].
        exposure_s: exposure time of a row [s].
        readout_s: readout time from the first row to the last; 0 is a global shutter [s].
        hides: whether an object passes in front of the hand.
        hand: whether the hand is in the scene.
        camera: parameters of the simulated camera.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    paints: tuple[Paint, ...]
    kind: str = "painted"
    size_px: tuple[int, int] = (640, 480)
    palm_px: float = 90.0
    palm_change: float = 0.15
    travel_px: tuple[float, float] = (170.0, 70.0)
    sway_hz: float = 0.5
    turn_deg: float = 30.0
    curl: float = 0.3
    skin: tuple[float, float, float] = (0.52, 0.31, 0.22)
    skin_gloss: float = 0.12
    clutter: float = 0.5
    brightness_change: float = 1.3
    colour_change: float = 0.06
    shading: float = 0.5
    light_hz: float = 0.2
    exposure_s: float = 0.006
    readout_s: float = 0.0
    hides: bool = False
    hand: bool = True
    camera: CameraImageSettings = field(default_factory=CameraImageSettings)

    def __post_init__(self) -> None:
        check(len(self.paints) == 6, "paints", len(self.paints), "six: five fingertips and the hand's base")
        check(self.kind in MARKER_KINDS, "kind", self.kind, one_of(self.kind, MARKER_KINDS))
        width, height = self.size_px
        even = width % 2 == 0 and height % 2 == 0
        check(even and 32 <= width <= 8192 and 32 <= height <= 8192, "size_px", self.size_px, "even, 32 to 8192")
        check(10 <= self.palm_px <= 1000, "palm_px", self.palm_px, "from 10 to 1000 px")
        check(0 <= self.palm_change < 0.9, "palm_change", self.palm_change, "from 0 to 0.9")
        check(0 <= self.curl < 0.9, "curl", self.curl, "from 0 to 0.9")
        check(0 <= self.clutter <= 1, "clutter", self.clutter, "from 0 to 1")
        check(1 <= self.brightness_change <= 10, "brightness_change", self.brightness_change, "from 1 to 10")
        check(0 <= self.colour_change < 0.9, "colour_change", self.colour_change, "from 0 to 0.9")
        check(0 <= self.shading <= 1, "shading", self.shading, "from 0 to 1")
        check(0 <= self.exposure_s <= 1, "exposure_s", self.exposure_s, "from 0 to 1 s")
        check(0 <= self.readout_s <= 1, "readout_s", self.readout_s, "from 0 to 1 s")


@dataclass(frozen=True)
class MarkerShot:
    """A rendered image of a hand with painted markers, and its ground truth.

    Attributes:
        at_s: the middle of the first row's exposure, on the scene's clock [s].
        image: (height, width, 3) uint8 BGR.
        centres_px: (markers, 2) x, y of the markers' centres, at the middle of the exposure of their row [px].
        visible: (markers,) fraction of the marker's area that is in the image and not occluded.
        radii_px: (markers,) radius of a disc of the marker's area [px].

    In a scene without the hand, ``centres_px`` and ``radii_px`` are NaN and ``visible`` is 0.
    """

    at_s: float
    image: UInt8
    centres_px: Float64
    visible: Float64
    radii_px: Float64


class MarkerScene:
    """A scene that can be rendered at any time.

    Args:
        settings: description of the scene.
        seed: random seed of the wall, the motion, the light and the noise.
    """

    def __init__(self, settings: MarkerSceneSettings, seed: int = 0) -> None:
        self.settings, self.seed = settings, seed
        rng = np.random.default_rng([seed, 1])
        self._phases = rng.uniform(0, 2 * math.pi, 24)
        self._rates = rng.uniform(0.8, 1.25, 24)
        self._wall = wall(settings.size_px, settings.clutter, rng)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers, in the order of a shot's arrays."""
        return tuple(paint.name for paint in self.settings.paints)

    def at(self, at_s: float) -> MarkerShot:
        """Render the image whose first row's exposure is centred at ``at_s``, on the scene's clock [s]."""
        return self._shot(at_s, self._photograph(at_s), [self.seed, 2, round(1e6 * at_s)])

    def repeats(self, at_s: float, count: int) -> Iterator[MarkerShot]:
        """Yield ``count`` images of one instant ``at_s`` [s] that differ only in the camera's noise."""
        seen = self._photograph(at_s)
        for k in range(count):
            yield self._shot(at_s, seen, [self.seed, 3, round(1e6 * at_s), k])

    def labels(self, at_s: float) -> Int8:
        """Return the thing at each pixel in an instant of the scene [s], without blur: an array (height, width).

        A pixel of marker k has the value k; others are `ON_WALL`, `ON_SKIN` or `ON_OTHER`, or `MIXED` at an edge.
        """
        width, height = self.settings.size_px
        shapes = self.shapes(at_s)
        marker = shapes[:, MARKER]
        skin = (shapes[:, 7:10] == self.settings.skin).all(axis=1) & (marker < 0)
        code = np.where(marker >= 0, marker + 3, np.where(skin, 1, 2))
        shapes[:, 7:11] = np.stack([code, code**2, 0 * code, 0 * code], axis=1)
        seen = np.empty((height, width, 3), np.float32)
        _kernels().photograph(
            np.zeros_like(seen), shapes, np.zeros_like(shapes), np.zeros(1), 0.0, np.ones(3), np.array([0.0, 0.0, 1.0]),
            0.0, seen, np.zeros(len(self.settings.paints)),
        )  # fmt: skip
        value = np.rint(seen[..., 0]).astype(np.int8)
        pure = (seen[..., 0] == value) & (seen[..., 1] == value.astype(np.float32) ** 2)  # else the mean of squares
        of_code = np.array([ON_WALL, ON_SKIN, ON_OTHER, *range(len(self.settings.paints))], np.int8)
        return np.where(pure, of_code[value], np.int8(MIXED))

    def _photograph(self, at_s: float) -> tuple[Float32, Float64, Float64, Float64]:
        """Return the linear light (height, width, 3), and a shot's centres, visible shares and radii."""
        s = self.settings
        width, height = s.size_px
        shapes = self.shapes(at_s)
        rates = (self.shapes(at_s + _STEP_S) - self.shapes(at_s - _STEP_S)) / (2 * _STEP_S)
        linear = np.empty((height, width, 3), np.float32)
        strength, colour, direction = self.light(at_s)
        seen = np.zeros(len(s.paints))
        _kernels().photograph(
            self._wall, shapes, rates, (np.arange(SUB_TIMES) + 0.5) / SUB_TIMES * s.exposure_s - 0.5 * s.exposure_s,
            s.readout_s / height, strength * colour, direction, s.shading, linear, seen,
        )  # fmt: skip
        painted = shapes[:, MARKER] >= 0
        order = np.argsort(shapes[painted, MARKER])
        markers, moving = shapes[painted][order], rates[painted][order]
        centres = np.full((len(s.paints), 2), np.nan)
        radii = np.full(len(s.paints), np.nan)
        if len(markers):
            late_s = s.readout_s / height * markers[:, 1] / (1 - s.readout_s / height * moving[:, 1])
            centres = markers[:, :2] + late_s[:, None] * moving[:, :2]
            radii = np.sqrt(markers[:, 2] * markers[:, 3])
            radii[markers[:, 6] == TUBE] *= math.sqrt(4 / math.pi)
        return linear, centres, seen / np.maximum(math.pi * np.nan_to_num(radii) ** 2, 1e-9), radii

    def _shot(self, at_s: float, seen: tuple[Float32, Float64, Float64, Float64], noise: list[int]) -> MarkerShot:
        """Take the camera's image of what `_photograph` returned; ``noise`` is the seed of its noise."""
        image = camera_image(seen[0], self.settings.camera, np.random.default_rng(noise))
        return MarkerShot(at_s, image, *seen[1:])

    def light(self, at_s: float) -> tuple[float, Float64, Float64]:
        """Return the light at a time of the scene [s]: its strength, colour (3,) as red, green, blue, and direction.

        The direction is the unit vector (3,) towards the light: x right, y down, z towards the camera.
        """
        s = self.settings
        swing = [math.sin(2 * math.pi * s.light_hz * self._rates[k] * at_s + self._phases[k]) for k in range(5)]
        colour = np.array([1 + s.colour_change * swing[1], 1.0, 1 - s.colour_change * swing[1]])
        towards = np.array([0.6 * swing[2], -0.4 + 0.4 * swing[3], 1.0])
        return s.brightness_change ** swing[0], colour, towards / np.linalg.norm(towards)

    def shapes(self, at_s: float) -> Float64:
        """Return the shapes (shapes, 13) in front of the wall at a time of the scene [s], back to front.

        The columns are described in `mocapella.sources.simulate.marker_scene_kernels`.
        """
        s = self.settings
        if not s.hand:
            return np.zeros((0, COLUMNS))

        def swing(k: int, hz: float) -> float:
            return math.sin(2 * math.pi * hz * self._rates[k] * at_s + self._phases[k])

        width, height = s.size_px
        palm = s.palm_px * (1 + s.palm_change * swing(5, 0.6 * s.sway_hz))
        wrist = np.array(
            [
                0.5 * width + s.travel_px[0] * swing(6, s.sway_hz),
                0.5 * height + 0.9 * s.palm_px + s.travel_px[1] * swing(7, 1.3 * s.sway_hz),
            ]
        )
        turn = math.radians(s.turn_deg) * swing(8, 0.8 * s.sway_hz)
        c, d = math.cos(turn), math.sin(turn)

        def place(x: float, y: float) -> tuple[float, float]:
            return wrist[0] + palm * (c * x - d * y), wrist[1] + palm * (d * x + c * y)

        def capsule(a: tuple[float, float], b: tuple[float, float], ra: float, rb: float) -> list[float]:
            return [*place(*a), *place(*b), palm * ra, palm * rb, CAPSULE, *s.skin, s.skin_gloss, 12.0, -1.0]

        def patch(
            at: tuple[float, float], half: tuple[float, float], angle: float, look: tuple[float, ...], form: float
        ) -> list[float]:
            return [*place(*at), palm * half[0], palm * half[1], angle + turn, 0.0, form, *look]

        kind = MARKER_KINDS[s.kind]
        shapes = [capsule((0.0, 2.5), (0.0, 0.0), 0.36, 0.29), capsule((0.0, -0.25), (0.0, -0.62), 0.42, 0.47)]
        for k, (x, y, degrees, length, base, tip) in enumerate(_FINGERS):
            angle = math.radians(degrees + 6 * swing(9 + k, 1.7 * s.sway_hz))
            long = length * (1 - s.curl * (0.5 + 0.5 * swing(14 + k, 1.4 * s.sway_hz)))
            end = (x + long * math.sin(angle), y - long * math.cos(angle))
            shapes.append(capsule((x, y), end, base, tip))
            at = (end[0] - kind.back * tip * math.sin(angle), end[1] + kind.back * tip * math.cos(angle))
            if kind.border:
                half = (kind.border[0] * tip, kind.border[1] * tip)
                shapes.append(patch(at, half, angle, (*GREY, 0.0, 30.0, -1.0), ELLIPSE))
            paint = s.paints[k]
            look = (*paint.albedo, paint.gloss if kind.gloss is None else kind.gloss, kind.shine, float(k))
            half = (kind.half[0] * tip, kind.half[1] * tip)
            shapes.append(patch(at, half, angle, look, TUBE if kind.tube else ELLIPSE))
        paint = s.paints[5]
        shapes.append(patch(_BASE, (0.13, 0.13), 0.0, (*paint.albedo, paint.gloss, 30.0, 5.0), ELLIPSE))
        if s.hides:  # a grey stick, from above
            x = 0.5 * width + 0.45 * width * swing(20, 0.7 * s.sway_hz)
            stick = [x, -60.0, x + 40.0, 0.75 * height, 22.0, 18.0, CAPSULE, 0.2, 0.2, 0.21, 0.3, 20.0, -1.0]
            shapes.append(stick)
        return np.array(shapes)


MARKER, COLUMNS = 12, 13


def wall(size_px: tuple[int, int], clutter: float, rng: np.random.Generator) -> Float32:
    """Return the reflectance (height, width, 3) of a cluttered wall in red, green and blue, 0 to 1.

    It consists of smooth noise and rectangles.

    Args:
        size_px: (width, height) of the image.
        clutter: colourfulness and number of rectangles, 0 to 1.
        rng: random numbers.
    """
    width, height = size_px
    picture = np.full((height, width, 3), 0.30)
    for cells in (4, 12, 50):
        coarse = rng.normal(0, 1, (cells, cells, 1)) + 0.25 * clutter * rng.normal(0, 1, (cells, cells, 3))
        picture *= np.exp(0.22 * _stretched(coarse, height, width))
    for _ in range(round(30 * clutter)):  # books, boxes, pictures
        w, h = int(rng.integers(width // 30, width // 5)), int(rng.integers(height // 30, height // 4))
        x, y = int(rng.integers(0, width - w)), int(rng.integers(0, height - h))
        grey = rng.uniform(0.05, 0.6)
        picture[y : y + h, x : x + w] = grey * np.exp(0.45 * clutter * rng.normal(0, 1, 3))
        for line in range(y + 2, y + h - 1, max(4, h // 6)):  # print on them
            picture[line : line + 1, x + 2 : x + w - 2] *= 0.6
    picture *= np.exp(0.05 * rng.normal(0, 1, (height, width, 1)))
    return np.asarray(np.clip(picture, 0.01, 0.9), np.float32)


def _stretched(coarse: Float64, height: int, width: int) -> Float64:
    """Interpolate (n, n, 3) bilinearly to (height, width, 3)."""
    n = len(coarse)
    r, c = np.linspace(0, n - 1.001, height), np.linspace(0, n - 1.001, width)
    i, j = r.astype(int), c.astype(int)
    u, v = (r - i)[:, None, None], (c - j)[None, :, None]
    top = (1 - v) * coarse[i][:, j] + v * coarse[i][:, j + 1]
    low = (1 - v) * coarse[i + 1][:, j] + v * coarse[i + 1][:, j + 1]
    return np.asarray((1 - u) * top + u * low)


def marker_scene_names() -> tuple[str, ...]:
    """Return the names that `load_marker_scene` knows."""
    return tuple(_data()["scenes"])


def marker_scene_settings(name: str) -> MarkerSceneSettings:
    """Look up a scene's settings by name; change them with `dataclasses.replace`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    data = _data()
    if name not in data["scenes"]:
        raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, data['scenes'])}")
    return scene_of(data, name)


def scene_of(data: Mapping[str, Any], name: str) -> MarkerSceneSettings:
    """Parse the settings of the scene ``name`` from a file's tables ``common``, the defaults, and ``scenes``.

    Raises:
        KeyError: there is no such scene.
        SettingsError: a value is invalid.
    """
    scene = {**data["common"], **data["scenes"][name]}
    return parse(MarkerSceneSettings, scene, where=f"scene {name}")


def load_marker_scene(name: str, *, seed: int = 0) -> MarkerScene:
    """Load a scene by name, with a random seed as in `MarkerScene`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    return MarkerScene(marker_scene_settings(name), seed)


@cache
def _data() -> dict[str, Any]:
    return own_toml("mocapella.sources.simulate", "data", "marker_scenes.toml")


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import marker_scene_kernels

    return marker_scene_kernels
