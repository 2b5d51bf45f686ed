"""Compare sizes of the search window of the marker detection: time, markers found, errors of the centres."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from mocapella.evaluation.marker_films import RATE_HZ, MarkerScore, learnt_film
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.sensing.markers import MarkerDetector, MarkerSettings
from mocapella.settings import check
from mocapella.sources.simulate.marker_scene import load_marker_scene

SIZES_PX: Final = (10.0, 16.0, 24.0, 32.0, 40.0, 60.0, 80.0, 120.0, 200.0)
SCENES: Final = ("desk", "fast", "colourful")
FRAMES: Final = 60


class WindowRow(msgspec.Struct, frozen=True):
    """Figures of a window size in a scene.

    Attributes:
        scene: name of the scene.
        window_px: side of the window [px]; None for a search of every whole image.
        time_us: median time of an image [µs].
        time_ratio: the same as a multiple of that of a search of every whole image.
        whole_percent: images that were searched as a whole, because a marker was lost [%].
        found_percent: visible markers that were found [%].
        error_px: median distance of their centres from the true ones [px].
        error_p95_px: 95th percentile of the same [px].
        false_percent: found markers that are none, of all markers [%].
    """

    scene: str
    window_px: float | None
    time_us: float
    time_ratio: float
    whole_percent: float
    found_percent: float
    error_px: float | None
    error_p95_px: float | None
    false_percent: float


def compare_windows(
    scenes: Sequence[str] | None,
    seeds: Sequence[int],
    sizes_px: Sequence[float],
    clock: Callable[[], float],
    *,
    tell: Callable[[str], None] = lambda text: None,
    rate_hz: float = RATE_HZ,
    frames: int = FRAMES,
) -> list[WindowRow]:
    """Return a row for each scene and size, then one for whole images, over all seeds.

    All sizes see the same images, image by image in turns. A window is doubled where the marker is not in it, and after
    two times the whole image is searched, so that a small window costs time and not markers.

    Args:
        scenes: names of `marker_scene`; None for `SCENES`.
        seeds: random seeds of the scenes.
        sizes_px: window sizes [px].
        clock: returns a time [s].
        tell: called with the current scene.
        rate_hz: frame rate; at a lower one a marker moves farther between two images, and the window grows [Hz].
        frames: number of images for each seed.

    Raises:
        SettingsError: no such scene, no seed, no image, or a size or rate out of range.
        EvaluationError: a scene's colours cannot be learnt.
    """
    check(bool(seeds), "seeds", list(seeds), "at least one number")
    check(1 <= rate_hz <= 1000, "rate", rate_hz, "from 1 to 1000 Hz")
    check(frames >= 1, "frames", frames, "1 or more")
    check(bool(sizes_px), "sizes", list(sizes_px), "at least one number of pixels")
    ways: dict[float | None, MarkerSettings] = {None: MarkerSettings(whole_image_s=0.0, light_s=1e6)}
    ways |= {size: MarkerSettings(window_px=size, whole_image_s=1e6, light_s=1e6) for size in sizes_px}
    ways[None] = ways.pop(None)  # at the end
    rows = []
    for name in scenes or SCENES:
        tell(name)
        scores = {way: MarkerScore() for way in ways}
        times: dict[float | None, list[float]] = {way: [] for way in ways}
        whole = dict.fromkeys(ways, 0)
        for seed in seeds:
            film = learnt_film(load_marker_scene(name, seed=seed))
            detectors = {way: MarkerDetector(film.profile, chosen) for way, chosen in ways.items()}
            for shot in film.shots(frames, rate_hz):
                for way, detector in detectors.items():
                    begin = clock()
                    frame = detector.update(shot.image, shot.at_s)
                    times[way].append(clock() - begin)
                    scores[way].add(shot, frame.positions_px.astype(np.float64))
            for way, detector in detectors.items():
                whole[way] += detector.report.whole_images
        of_whole = float(np.median(times[None]))
        for way, score in scores.items():
            time_s = float(np.median(times[way]))
            rows.append(
                WindowRow(
                    name, way, 1e6 * time_s, time_s / of_whole if of_whole > 0 else math.nan,
                    100 * whole[way] / len(times[way]), 100 * score.found_share, score.error_px(50),
                    score.error_px(95), 100 * score.false_share,
                )
            )  # fmt: skip
    return rows


def plot_windows(rows: Sequence[WindowRow], path: Path) -> None:
    """Plot time, whole images, markers found and errors over the window's size, a line for each scene.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure(path, 10, 6.4)
    panels = {
        "time_us": "time of an image, median [µs]",
        "whole_percent": "images searched as a whole [%]",
        "found_percent": "markers found [%]",
        "error_px": "error of the centre [px]",
    }
    for axes, (field, label) in zip(figure.subplots(2, 2).flat, panels.items(), strict=True):
        for k, scene in enumerate(dict.fromkeys(row.scene for row in rows)):
            of = [row for row in rows if row.scene == scene and row.window_px is not None]
            whole = next(row for row in rows if row.scene == scene and row.window_px is None)
            x, colour = [row.window_px for row in of], f"C{k}"
            axes.plot(x, [_number(getattr(row, field)) for row in of], "o-", color=colour, label=scene)
            if field == "error_px":
                axes.plot(x, [_number(row.error_p95_px) for row in of], "o:", color=colour, label=f"{scene}, 95 %")
            if field != "whole_percent":
                axes.axhline(_number(getattr(whole, field)), color=colour, ls="--", lw=1, label=f"{scene}, no window")
        low = min(100.0, *(row.found_percent for row in rows))
        axes.set_ylim(*((min(99.0, low - 0.1), 100.05) if field == "found_percent" else (0, None)))
        axes.set(xlabel="side of the window [px]", ylabel=label)
        axes.grid(alpha=0.3)
    legend = figure.axes[-1].get_legend_handles_labels()
    figure.legend(*legend, loc="outside upper center", ncols=len({row.scene for row in rows}), fontsize="small")
    save_figure(figure, path)


def _number(value: float | None) -> float:
    return math.nan if value is None else value
