"""Measure how colour thresholds of some width keep markers and take skin, for skin that reflects more or less.

Two ways to classify a pixel are compared on the same images. *Threshold*: the chromaticity is within some standard
deviations of the learnt colour (Mahalanobis distance, light changes included), the brightness within the detector's
range. *Likelihood*: the detector's look-up by likelihood ratio to the background, which knows skin and its reflections.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mocapella.evaluation.marker_films import learnt_film
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.sensing.colour_profile import ColourProfile, brightness, chromaticity
from mocapella.sensing.colour_table import TableSettings, classify
from mocapella.settings import check
from mocapella.sources.simulate.marker_scene import MIXED, ON_SKIN, MarkerScene, marker_scene_settings

Float64 = NDArray[np.float64]
Int8 = NDArray[np.int8]
UInt8 = NDArray[np.uint8]

THRESHOLD, LIKELIHOOD = "threshold", "likelihood"
GLOSSES: Final = (0.0, 0.2, 0.5, 1.0)
WIDTHS_SD: Final = (1.0, 1.5, 2.0, 2.5, 3.0, 3.25, 3.5, 3.75, 4.0, 5.0)
MARGINS: Final = (1.0, 3.0, 10.0, 100.0)
SCENES: Final = ("desk", "lamp")
SHADING: Final = 0.85
"""Fraction of the light that is directed; only this part is reflected in highlights."""
INSTANTS: Final = 6


class ThresholdRow(msgspec.Struct, frozen=True):
    """Shares of pixels that a way to classify takes for a marker's colour.

    Attributes:
        scene: name of the scene.
        skin_gloss: specular reflectance of the skin.
        how: ``threshold`` or ``likelihood``.
        width: half width of the threshold [standard deviations], or the least likelihood ratio.
        kept_percent: pixels of markers that have their own marker's label [%].
        skin_percent: pixels of skin that have any marker's label [%].
        shining_percent: the same of the tenth of the skin that is brightest [%].
    """

    scene: str
    skin_gloss: float
    how: str
    width: float
    kept_percent: float
    skin_percent: float
    shining_percent: float


def compare_thresholds(
    scenes: Sequence[str] | None,
    glosses: Sequence[float],
    seeds: Sequence[int],
    tell: Callable[[str], None] = lambda text: None,
    instants: int = INSTANTS,
) -> list[ThresholdRow]:
    """Return a row for each scene and gloss with each width and with each likelihood ratio, over all seeds.

    Pixels whose neighbours within two pixels belong to something else are not counted: the lens mixes their colours.

    Args:
        scenes: names of `marker_scene`; None for `SCENES`. All are lit as `SHADING` says.
        glosses: specular reflectances of the skin; 0 is matt, 1 reflects like a mirror's highlight.
        seeds: random seeds of the scenes.
        tell: called with the current gloss.
        instants: number of images for each gloss and seed, half a second apart.

    Raises:
        SettingsError: no such scene, no gloss, no seed, no image, or a gloss below 0.
        EvaluationError: a scene's colours cannot be learnt.
    """
    check(bool(glosses), "gloss", list(glosses), "at least one number")
    check(all(0 <= gloss <= 2 for gloss in glosses), "gloss", list(glosses), "from 0 to 2")
    check(bool(seeds), "seeds", list(seeds), "at least one number")
    check(instants >= 1, "instants", instants, "1 or more")
    ways = [(THRESHOLD, width) for width in WIDTHS_SD] + [(LIKELIHOOD, margin) for margin in MARGINS]
    rows = []
    for scene, gloss in itertools.product(scenes or SCENES, glosses):
        tell(f"{scene}, skin gloss {gloss:g}")
        settings = replace(marker_scene_settings(scene), skin_gloss=gloss, shading=SHADING)
        counts = np.zeros((len(ways), 3))
        pixels = np.zeros(3)
        for seed in seeds:
            film = learnt_film(MarkerScene(settings, seed))
            for k in range(instants):
                at_s = film.begin_s + 1.0 + 0.5 * k
                truth = whole_surroundings(film.scene.labels(at_s))
                image = film.scene.at(at_s).image
                skin, markers = image[truth == ON_SKIN], image[truth >= 0]
                shining = brightness(skin) >= np.percentile(brightness(skin), 90)
                pixels += len(markers), len(skin), shining.sum()
                own = truth[truth >= 0] + 1
                for way, (how, width) in enumerate(ways):
                    taken = labelled(film.profile, how, width, skin) > 0
                    kept = labelled(film.profile, how, width, markers) == own
                    counts[way] += kept.sum(), taken.sum(), taken[shining].sum()
        for (how, width), shares in zip(ways, 100 * counts / np.maximum(pixels, 1), strict=True):
            rows.append(ThresholdRow(scene, gloss, how, width, *(float(share) for share in shares)))
    return rows


def whole_surroundings(labels: Int8) -> Int8:
    """Return labels (height, width) of `MarkerScene.labels`, `MIXED` where a pixel within 2 px has another label."""
    same = ndimage.maximum_filter(labels, 5) == ndimage.minimum_filter(labels, 5)
    return np.where(same, labels, np.int8(MIXED))


def labelled(profile: ColourProfile, how: str, width: float, bgr: UInt8) -> UInt8:
    """Return labels (n,) of pixels (n, 3) blue, green, red: 0 for none, k for the k-th colour.

    Args:
        profile: the colours.
        how: ``threshold`` or ``likelihood``.
        width: half width of the threshold [standard deviations], or the least likelihood ratio.
        bgr: the pixels. Of several colours whose thresholds hold a pixel, the nearest is its label.
    """
    s = TableSettings()
    if how == LIKELIHOOD:
        return classify(profile, bgr, replace(s, margin=width))
    at, luma = chromaticity(bgr), brightness(bgr)
    distance = np.empty((len(bgr), len(profile.colours)))
    for k, colour in enumerate(profile.colours):
        uu, uv, vv = colour.seen.covariance
        off = at - np.array(colour.seen.mean)
        spread = np.array([[uu + s.light_sd**2, uv], [uv, vv + s.light_sd**2]])
        distance[:, k] = np.sqrt(np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off))
        low, _, high = colour.seen.luma
        distance[(luma < low / s.brightness_range) | (luma > high * s.brightness_range), k] = np.inf
    best = np.argmin(distance, axis=1)
    return np.where(distance.min(axis=1) <= width, best + 1, 0).astype(np.uint8)


def plot_thresholds(rows: Sequence[ThresholdRow], path: Path) -> None:
    """Plot kept marker pixels and taken skin pixels over the thresholds' width, and one over the other.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    scenes, glosses = (list(dict.fromkeys(getattr(row, field) for row in rows)) for field in ("scene", "skin_gloss"))
    figure = new_figure(path, 11, 3.9 * len(scenes))
    for scene, (over, against) in zip(scenes, figure.subplots(len(scenes), 2, squeeze=False), strict=True):
        for k, gloss in enumerate(glosses):
            of = [row for row in rows if (row.scene, row.skin_gloss) == (scene, gloss)]
            wide, ratio = ([row for row in of if row.how == how] for how in (THRESHOLD, LIKELIHOOD))
            x, label, colour = [row.width for row in wide], f"skin gloss {gloss:g}", f"C{k}"
            over.plot(x, [row.kept_percent for row in wide], "-", color=colour, label=f"{label}: markers kept")
            over.plot(x, [row.skin_percent for row in wide], "o:", color=colour, ms=4, label=f"{label}: skin taken")
            for rows_of, style, name in ((wide, "o-", "thresholds"), (ratio, "*", "likelihood ratio")):
                taken, kept = [row.skin_percent for row in rows_of], [row.kept_percent for row in rows_of]
                against.plot(taken, kept, style, ms=4 if style == "o-" else 12, color=colour, label=f"{label}: {name}")
        over.set(title=scene, xlabel="half width of the threshold [standard deviations]", ylabel="pixels [%]")
        against.set_xscale("symlog", linthresh=0.01)
        against.set(title=scene, xlabel="skin pixels taken [%]", ylabel="marker pixels kept [%]", xlim=(-0.001, 110))
        for axes in (over, against):
            axes.grid(alpha=0.3)
            axes.legend(fontsize="x-small")
    save_figure(figure, path)
