"""Compare kinds of fingertip markers in rendered scenes: found markers, errors of their centres, and jitter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.evaluation.marker_films import RATE_HZ, MarkerFilm, MarkerScore, fingertips, learnt_film
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.markers import MarkerDetector
from mocapella.settings import check
from mocapella.sources.simulate.marker_kinds import MARKER_KINDS
from mocapella.sources.simulate.marker_scene import MarkerScene, MarkerShot, marker_scene_settings

Float64 = NDArray[np.float64]

SCENES: Final = ("desk", "lamp")
FRAMES: Final = 60
_INSTANTS, _REPEATS = 3, 12


class MarkerKindRow(msgspec.Struct, frozen=True):
    """Figures of a kind of marker in a scene, of the five fingertips.

    Attributes:
        scene: name of the scene.
        kind: name of the kind, in `marker_kinds.MARKER_KINDS`.
        refused: number of seeds whose colours could not be learnt; they count as not found.
        area_px: median area of a marker in the profile [px²]; None if all seeds were refused.
        found_percent: visible markers that were found [%].
        false_percent: found markers that are none, of all markers [%].
        error_px: median distance of their centres from the true ones [px].
        error_p95_px: 95th percentile of the same [px].
        jitter_px: root mean square of a coordinate about its mean, over images that differ in noise only [px].
    """

    scene: str
    kind: str
    refused: int
    area_px: float | None
    found_percent: float
    false_percent: float
    error_px: float | None
    error_p95_px: float | None
    jitter_px: float | None


def compare_kinds(
    scenes: Sequence[str] | None,
    seeds: Sequence[int],
    tell: Callable[[str], None] = lambda text: None,
    frames: int = FRAMES,
) -> list[MarkerKindRow]:
    """Return a row for each scene and kind, over all seeds. Motion, wall and light are the same for all kinds.

    Args:
        scenes: names of `marker_scene`; None for `SCENES`.
        seeds: random seeds of the scenes.
        tell: called with the current scene and kind.
        frames: number of images for each seed, at 30 Hz.

    Raises:
        SettingsError: no such scene, no seed, or no image.
    """
    check(bool(seeds), "seeds", list(seeds), "at least one number")
    check(frames >= 1, "frames", frames, "1 or more")
    rows = []
    for name in scenes or SCENES:
        for kind in MARKER_KINDS:
            tell(f"{name}, {kind}")
            score, areas, spread, refused = MarkerScore(), [], [], 0
            settings = replace(marker_scene_settings(name), kind=kind)
            for seed in seeds:
                scene = MarkerScene(settings, seed)
                try:
                    film = learnt_film(scene)
                except EvaluationError:
                    refused += 1
                    continue
                areas += [colour.area_px for colour in film.profile.colours[:5]]
                detector = MarkerDetector(film.profile)
                for shot in film.shots(frames):
                    frame = detector.update(shot.image, shot.at_s)
                    score.add(fingertips(shot), frame.positions_px[:5].astype(np.float64))
                spread.append(_jitter(film))
            share = 100 * score.found_share * (len(seeds) - refused) / len(seeds)
            rows.append(
                MarkerKindRow(
                    name, kind, refused, float(np.median(areas)) if areas else None, share, 100 * score.false_share,
                    score.error_px(50), score.error_px(95), root_mean_square(np.concatenate([[], *spread])),
                )
            )  # fmt: skip
    return rows


def _jitter(film: MarkerFilm) -> Float64:
    """Return the deviations of coordinates from their means in some instants of a film [px]."""
    parts = [np.empty(0)]
    for k in range(_INSTANTS):
        shots = list(film.scene.repeats(film.begin_s + 0.7 * k, _REPEATS))
        parts.append(deviations(*tip_positions(shots, film.profile)))
    return np.concatenate(parts)


def deviations(found_px: Float64, right: NDArray[np.bool_]) -> Float64:
    """Return the deviations of the fingertips' coordinates from their means over images of one instant [px].

    Args:
        found_px, right: (images, 5, 2) and (images, 5), of `tip_positions`.

    Returns:
        (n,) of the markers that are found rightly in at least half of the images.
    """
    kept = np.where(right[..., None], found_px, np.nan)[:, right.mean(axis=0) >= 0.5]
    off = kept - np.nanmean(kept, axis=0)
    return np.asarray(off[np.isfinite(off)])


def tip_positions(shots: Sequence[MarkerShot], profile: ColourProfile) -> tuple[Float64, NDArray[np.bool_]]:
    """Return the fingertips' found centres (shots, 5, 2) [px], and which are within their markers (shots, 5)."""
    detector = MarkerDetector(profile)
    found = np.array([detector.update(shot.image, k / RATE_HZ).positions_px[:5] for k, shot in enumerate(shots)])
    away = np.linalg.norm(found - shots[0].centres_px[:5], axis=-1)
    return found.astype(np.float64), away <= shots[0].radii_px[:5]


def root_mean_square(values: Float64) -> float | None:
    """Return the root mean square of values (n,); None without any."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def plot_kinds(rows: Sequence[MarkerKindRow], path: Path) -> None:
    """Plot found markers, errors and jitter of the kinds, for each scene.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure(path, 10, 6)
    scenes, kinds = (list(dict.fromkeys(getattr(row, field) for row in rows)) for field in ("scene", "kind"))
    panels = {
        "found_percent": "markers found [%]",
        "error_px": "error of the centre, median [px]",
        "error_p95_px": "error of the centre, 95 % [px]",
        "jitter_px": "jitter of a coordinate [px]",
    }
    at = np.arange(len(kinds))
    for axes, (field, label) in zip(figure.subplots(2, 2).flat, panels.items(), strict=True):
        for i, scene in enumerate(scenes):
            values = [getattr(row, field) or 0.0 for row in rows if row.scene == scene]
            axes.bar(at + (i - (len(scenes) - 1) / 2) * 0.8 / len(scenes), values, 0.8 / len(scenes), label=scene)
        axes.set_xticks(at, kinds)
        axes.set(ylabel=label)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(scenes))
    save_figure(figure, path)
