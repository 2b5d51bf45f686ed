"""Rendered images of markers with a learnt colour profile, and scores of the markers that are found in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError, InputError
from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_profile import SKIN, ColourProfile
from mocapella.sources.simulate.marker_scene import MarkerScene, MarkerShot

Float64 = NDArray[np.float64]

RATE_HZ: Final = 30.0
VISIBLE, GONE = 0.9, 0.05
"""A marker must be found where so much of it is seen, and must not where so little is."""
_INSTANTS: Final = 200
_STILL: Final = 4
_STEP_S: Final = 0.5


class MarkerFilm(msgspec.Struct, frozen=True, eq=False):
    """A scene's images, and the profile learnt at its beginning.

    Attributes:
        scene: the scene.
        profile: its colours.
        sample: the image and the clicks that they were learnt from.
        begin_s: the image's time in the scene [s].
    """

    scene: MarkerScene
    profile: ColourProfile
    sample: ColourSample
    begin_s: float

    def shots(self, count: int, rate_hz: float = RATE_HZ) -> Iterator[MarkerShot]:
        """Yield ``count`` images at a rate [Hz], from a second after the colours were learnt."""
        for k in range(count):
            yield self.scene.at(self.begin_s + 1.0 + k / rate_hz)


def learnt_film(scene: MarkerScene) -> MarkerFilm:
    """Learn a scene's colours from a click on every marker, and on the back of the hand, once all are seen.

    If the clicks are refused in an image, a later one is tried.

    Raises:
        EvaluationError: no image has all markers, or all images are refused.
    """
    why = "no image shows all markers"
    for k in range(_INSTANTS):
        shot = scene.at(_STEP_S * k)
        if not (shot.visible > 0.95).all():
            continue
        clicks = {marker: (float(x), float(y)) for marker, (x, y) in zip(scene.names, shot.centres_px, strict=True)}
        palm = scene.shapes(shot.at_s)[1]
        back = (palm[2] + 0.1 * palm[5], palm[3] + 0.1 * palm[5])
        sample = ColourSample(shot.image, {**clicks, SKIN: back})
        try:
            return MarkerFilm(scene, learn_colours("camera", [sample]), sample, shot.at_s)
        except InputError as error:  # such as a marker that is too far away just then
            why = str(error)
            if scene.settings.sway_hz == 0 and k >= _STILL:
                break
    raise EvaluationError(f"seed {scene.seed}: the colours cannot be learnt ({why}); take another seed or scene")


def fingertips(shot: MarkerShot) -> MarkerShot:
    """Return a shot with the ground truth of the five fingertips, without the hand's base."""
    return dataclasses.replace(
        shot, centres_px=shot.centres_px[:5], visible=shot.visible[:5], radii_px=shot.radii_px[:5]
    )


class MarkerScore:
    """Errors of centres, and numbers of found and false markers, collected over images.

    Attributes:
        errors: distances of found markers from the true centres [px].
        over_sd: errors of coordinates over their stated standard deviations.
        seen: number of markers that are visible by more than `VISIBLE`.
        found: number of these that are found within their radius.
        false: number of found markers that are not there, or farther from the true centre than the radius.
        total: number of markers, seen or not.
    """

    def __init__(self) -> None:
        self.errors: list[float] = []
        self.over_sd: list[float] = []
        self.seen = self.found = self.false = self.total = 0

    def add(self, shot: MarkerShot, positions_px: Float64, sd_px: Float64 | None = None) -> None:
        """Add the markers found in an image.

        Args:
            shot: the image's ground truth.
            positions_px: (markers, 2) found centres; NaN where not found [px].
            sd_px: (markers,) stated standard deviations [px]; None for none.
        """
        off = positions_px - shot.centres_px
        far = np.linalg.norm(off, axis=-1)
        told, there = np.isfinite(far), shot.visible > VISIBLE
        false = told & ((shot.visible < GONE) | (far > shot.radii_px))
        right = told & there & ~false
        self.seen += int(there.sum())
        self.found += int(right.sum())
        self.false += int(false.sum())
        self.total += len(far)
        self.errors += far[right].tolist()
        if sd_px is not None:
            self.over_sd += (off[right] / sd_px[right, None]).ravel().tolist()

    def join(self, other: MarkerScore) -> None:
        """Add everything that another score collected."""
        self.errors += other.errors
        self.over_sd += other.over_sd
        self.seen, self.found = self.seen + other.seen, self.found + other.found
        self.false, self.total = self.false + other.false, self.total + other.total

    @property
    def found_share(self) -> float:
        """Share of the visible markers that are found."""
        return self.found / max(self.seen, 1)

    @property
    def false_share(self) -> float:
        """Number of false markers over that of all markers."""
        return self.false / max(self.total, 1)

    @property
    def normalised(self) -> float:
        """Root mean square of ``over_sd``; 1 if the stated standard deviations are right."""
        return float(np.sqrt(np.mean(np.square(self.over_sd))))

    def error_px(self, percent: float) -> float | None:
        """Return a percentile of ``errors`` [px]; None without any."""
        return float(np.percentile(self.errors, percent)) if self.errors else None
