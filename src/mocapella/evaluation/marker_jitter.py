"""Measure the static jitter of found markers, by kind of marker, distance and light.

The RHOT thesis shows the jitter of its detector as figure 7.7; this is its counterpart for a rendered hand that rests,
in images that differ in the camera's noise only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from mocapella.errors import EvaluationError
from mocapella.evaluation.marker_films import learnt_film
from mocapella.evaluation.marker_kind_scores import deviations, root_mean_square, tip_positions
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.settings import check
from mocapella.sources.simulate.marker_kinds import MARKER_KINDS
from mocapella.sources.simulate.marker_scene import MarkerScene, MarkerSceneSettings, marker_scene_settings

DISTANCES_M: Final = (0.25, 0.5, 0.75, 1.0, 1.5)
LEARNT_AT_M: Final = 0.5
PALM_M: Final = 0.085
PALM_PX_M: Final = 45.0
"""Width of the palm in the image times its distance [px m], of the thesis' camera with 640 × 480 pixels."""
LIGHTS: Final = {"bright": 0.8, "dim": 0.25, "dark": 0.1}
"""Signal of white over the sensor's full scale: full light, and less at the same exposure time, gain and noise."""
REPEATS: Final = 20


class JitterRow(msgspec.Struct, frozen=True):
    """Jitter of a kind of marker at a distance in some light, of the five fingertips.

    Attributes:
        kind: name of the kind, in `marker_kinds.MARKER_KINDS`.
        light: name of the light, in `LIGHTS`.
        distance_m: distance of the hand from the camera [m].
        found_percent: markers found within their radius [%]; 0 if the colours cannot be learnt.
        jitter_px: root mean square of a coordinate about its mean [px]; None if no marker is found in half the images.
        jitter_mm: the same across the line of sight, at the hand [mm].
    """

    kind: str
    light: str
    distance_m: float
    found_percent: float
    jitter_px: float | None
    jitter_mm: float | None


def measure_jitter(
    distances_m: Sequence[float],
    seeds: Sequence[int],
    tell: Callable[[str], None] = lambda text: None,
    repeats: int = REPEATS,
) -> list[JitterRow]:
    """Return a row for each light, kind and distance, over all seeds.

    The colours are learnt at `LEARNT_AT_M` in the same light.

    Args:
        distances_m: distances of the hand from the camera [m].
        seeds: random seeds of the wall, of the pose of the fingers and of the noise.
        tell: called with the current light and kind.
        repeats: number of images for each row and seed.

    Raises:
        SettingsError: no distance, no seed, fewer than two images, or a distance outside 0.2 to 3 m.
    """
    check(bool(distances_m), "distances", list(distances_m), "at least one number of metres")
    check(all(0.2 <= d <= 3 for d in distances_m), "distances", list(distances_m), "from 0.2 to 3 m")
    check(bool(seeds), "seeds", list(seeds), "at least one number")
    check(repeats >= 2, "repeats", repeats, "2 or more")
    rows = []
    for light in LIGHTS:
        for kind in MARKER_KINDS:
            tell(f"{light}, {kind}")
            spread = {distance: [np.empty(0)] for distance in distances_m}
            found = dict.fromkeys(distances_m, 0.0)
            for seed in seeds:
                try:
                    profile = learnt_film(MarkerScene(still_scene(kind, light, LEARNT_AT_M), seed)).profile
                except EvaluationError:
                    continue
                for distance in distances_m:
                    shots = list(MarkerScene(still_scene(kind, light, distance), seed).repeats(0.0, repeats))
                    at_px, right = tip_positions(shots, profile)
                    spread[distance].append(deviations(at_px, right))
                    found[distance] += float(right.mean()) / len(seeds)
            for distance in distances_m:
                px = root_mean_square(np.concatenate(spread[distance]))
                mm = None if px is None else 1e3 * px * PALM_M * distance / PALM_PX_M
                rows.append(JitterRow(kind, light, distance, 100 * found[distance], px, mm))
    return rows


def still_scene(kind: str, light: str, distance_m: float) -> MarkerSceneSettings:
    """Return the settings of the scene ``still`` with a kind of marker, a light of `LIGHTS` and a distance [m]."""
    still = marker_scene_settings("still")
    return replace(
        still, kind=kind, palm_px=PALM_PX_M / distance_m, camera=replace(still.camera, exposure=LIGHTS[light])
    )


def plot_jitter(rows: Sequence[JitterRow], path: Path) -> None:
    """Plot the jitter over the distance, a panel for each light and a line for each kind.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    lights, kinds = (list(dict.fromkeys(getattr(row, field) for row in rows)) for field in ("light", "kind"))
    figure = new_figure(path, 3.6 * len(lights) + 0.6, 4)
    for axes, light in zip(figure.subplots(1, len(lights), sharey=True, squeeze=False).flat, lights, strict=True):
        for k, kind in enumerate(kinds):
            of = [row for row in rows if (row.light, row.kind) == (light, kind)]
            y = [math.nan if row.jitter_px is None else row.jitter_px for row in of]
            axes.plot([row.distance_m for row in of], y, "o-", color=f"C{k}", label=kind)
            part = [(row.distance_m, row.jitter_px) for row in of if row.jitter_px and row.found_percent < 99.5]
            if part:
                axes.plot(*zip(*part, strict=True), "o", ms=11, mfc="none", color=f"C{k}")
        axes.set(title=light, xlabel="distance [m]", yscale="log")
        axes.grid(alpha=0.3, which="both")
    figure.axes[0].set(ylabel="static jitter of a coordinate [px]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(kinds))
    figure.supxlabel(
        "ring: less than 99.5 % of the markers found; no point: no marker found in half of the images", fontsize="small"
    )
    save_figure(figure, path)
