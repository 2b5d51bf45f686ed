"""Small scenes of painted fingertips, and a profile learnt from one by clicks, for the tests of `sensing`."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sources.simulate.marker_scene import MarkerScene, MarkerShot, marker_scene_settings


@cache
def scene(name: str = "desk", seed: int = 7, **changed: object) -> MarkerScene:
    """A scene of a quarter of the pixels."""
    small = {"size_px": (320, 240), "palm_px": 60.0, "travel_px": (60.0, 25.0)}
    return MarkerScene(dataclasses.replace(marker_scene_settings(name), **{**small, **changed}), seed)


@cache
def shot(at_s: float, name: str = "desk") -> MarkerShot:
    return scene(name).at(at_s)


def sample(at_s: float = 0.0, name: str = "desk") -> ColourSample:
    seen, palm = shot(at_s, name), scene(name).shapes(at_s)[1]
    clicks = {k: (float(x), float(y)) for k, (x, y) in zip(scene(name).names, seen.centres_px, strict=True)}
    return ColourSample(seen.image, {**clicks, "skin": (palm[2] + 6.0, palm[3] + 6.0)})


@cache
def profile(name: str = "desk") -> ColourProfile:
    return learn_colours("left", [sample(name=name)])


def discs(*placed: tuple[float, float, float, tuple[int, int, int]], size: tuple[int, int] = (160, 120)) -> np.ndarray:
    """Anti-aliased discs x, y, radius, colour (b, g, r) on grey, of linear light."""
    width, height = size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    image = np.full((height, width, 3), 0.2)
    for cx, cy, radius, bgr in placed:
        cover = np.clip(radius + 0.5 - np.hypot(x - cx, y - cy), 0, 1)[..., None]
        image += cover * ((np.array(bgr) / 255) ** 2.2 - image)
    return np.asarray(255 * image ** (1 / 2.2) + 0.5, np.uint8)
