"""Experiments with the smoothness prior (penalty on jitter) on rendered scenes of moving people, and its weight.

After B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007,
section 4: the same images are tracked with the penalty and without.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.evaluation.silhouette_runs import BODIES, Film, filmed, follow, overlaps, rough_joints, with_penalty
from mocapella.evaluation.silhouettes import (
    FEET,
    Movement,
    MovementScore,
    Outcome,
    lag_frames,
    outcome,
    peak_kept,
    score,
)
from mocapella.settings import check
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_scene import silhouette_scene
from mocapella.tracker.silhouette_settings import SilhouetteSettings

NOISE: Final = 0.15
"""Fraction of the pixels that are replaced by random ones, as in the paper."""
WRONG_EACH: Final = 0.15
"""Fraction of each camera's frames that are replaced by wrong images."""
WRONG_FROM: Final = 3
"""Index of the first frame that may be replaced by a wrong image."""
WRONG_FRAME: Final = 60
"""Index of the frame of the knee bend that is replaced by a wrong image in all cameras."""
COVERED_FRAMES: Final = range(60, 108)
"""Indices of the frames with all cameras covered, 0.8 s: longer than a body is extrapolated."""
MOVES_DEG: Final = 1.0
"""The lag is not measured for knees that bend less than this [deg]."""
LEAST_M_PER_S2: Final = 0.1
"""Lower limit of the plotted acceleration of the feet [m/s²]."""
_WITH, _WITHOUT, _TRUTH = "#1f77b4", "#ff7f0e", "black"


@dataclass(frozen=True)
class Experiment:
    """Scenes, corruptions and penalties of an experiment, and the angles of its plot.

    Attributes:
        scenes: names of scenes of `silhouette_scene`.
        images: corruption of the images by name, None for clean images; it uses the scene's seed.
        weights: factors of the penalty on jitter; 0 for none.
        hinges: joints with plotted angles.
        fps: frame rate [Hz].
    """

    scenes: tuple[str, ...]
    images: Mapping[str, Corruption | None]
    hinges: tuple[str, ...]
    weights: tuple[float, ...] = (0.0, 1.0)
    fps: float = field(default=60.0)


STRONG: Final = Experiment(
    ("cartwheel", "flick-flack"),
    {"wrong frames": Corruption(NOISE, wrong_each=WRONG_EACH, wrong_from=WRONG_FROM)},
    ("left knee", "right elbow"),
)
"""Acrobatics with wrong images, whose failed runs `python -m benchmarks silhouettes` counts. `WRONG_EACH` was chosen on
seeds below 100, after 0.2 had been tried on the counted seeds, too."""
EXPERIMENTS: Final[dict[str, Experiment]] = {
    "knee-bend": Experiment(
        ("knee-bend",),
        {"clean": None, "noise": Corruption(NOISE), "one wrong frame": Corruption(NOISE, wrong_frames=(WRONG_FRAME,))},
        ("left knee", "right knee"),
    ),
    "runner": Experiment(
        ("runner",),
        {"noise": Corruption(NOISE), "rectangles": Corruption(NOISE, rectangles=4)},
        ("left knee", "right elbow"),
    ),
    "acrobatics": STRONG,
    "loss": Experiment(
        ("knee-bend", "cartwheel"),
        {"cameras covered": Corruption(wrong_frames=tuple(COVERED_FRAMES), wrong_kind="black")},
        ("left knee", "right elbow"),
    ),
    "weight": Experiment(
        ("knee-bend", "runner"),
        {"clean": None, "noise": Corruption(NOISE)},
        (),
        weights=(0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0),
    ),
}


class RunRow(msgspec.Struct, frozen=True):
    """Result of one run.

    Attributes:
        scene, seed, body, images, weight: the run's scene, seed, tracked body, corruption, and weight of the penalty.
        score, outcome: errors of the movement, and whether the body was tracked to the end.
        overlap: mean intersection over union of the mesh and the true masks.
        blind: number of frames without a usable camera.
        lost: number of frames with a lost body.
        kept: `mocapella.evaluation.silhouettes.peak_kept` of the knees' flexion; None for scenes without knee bends.
        lag: lag of the knees' flexion behind the true one [frames]; None for scenes without knee bends.
    """

    scene: str
    seed: int
    body: str
    images: str
    weight: float
    score: MovementScore
    outcome: Outcome
    overlap: float
    blind: int
    lost: int
    kept: float | None
    lag: float | None


class PlottedScene(msgspec.Struct, frozen=True, eq=False):
    """Plotted runs of a scene: the first seed, the first body, and the last corruption of the experiment.

    Attributes:
        film: the rendered scene.
        corruption: corruption of its images; None for none.
        found: tracked movement by the penalty's weight.
    """

    film: Film
    corruption: Corruption | None
    found: Mapping[float, Movement]


def run(
    name: str,
    seeds: Sequence[int],
    seconds: float | None = None,
    bodies: Sequence[str] = tuple(BODIES),
    tell: Callable[[str], None] = lambda _: None,
    *,
    settings: SilhouetteSettings | None = None,
) -> tuple[list[RunRow], list[PlottedScene]]:
    """Run one of `EXPERIMENTS`.

    Args:
        name: key of `EXPERIMENTS`.
        seeds: random seeds of the scenes.
        seconds: duration of each scene [s]; None for the whole scene.
        bodies: keys of `BODIES`: the ways to make the tracked body.
        tell: called with the current step, in words.
        settings: settings of the tracker, whose penalty the weights multiply; None for the defaults.

    Returns:
        A row for each run; and for each scene the runs of the first seed, with the first body and the last of the
        experiment's corruptions, for `plot_movements`.

    Raises:
        SettingsError: no such experiment or body, or no seed.
    """
    if name not in EXPERIMENTS:
        raise SettingsError(f"no {name!r}; there are {one_of(name, EXPERIMENTS)}")
    check_run(seeds, bodies)
    plan, rows, shown = EXPERIMENTS[name], [], []
    for scene in plan.scenes:
        for seed in seeds:
            tell(f"rendering {scene}, seed {seed} …")
            film = filmed(silhouette_scene(scene, seed=seed, fps=plan.fps), seconds)
            for images, corruption in plan.images.items():
                worse = corrupted(corruption, seed)
                found: dict[float, Movement] = {}
                for body in bodies:
                    for weight in plan.weights:
                        tell(f"following {scene}, seed {seed}: {images}, {body} body, penalty × {weight:g} …")
                        row, movement = followed(film, body, images, worse, weight, settings=settings)
                        rows.append(row)
                        found.setdefault(weight, movement)
            if seed == seeds[0]:
                shown.append(PlottedScene(film, worse, found))
    return rows, shown


def check_run(seeds: Sequence[int], bodies: Sequence[str]) -> None:
    """Check that there is something to track, and that the bodies are keys of `BODIES`.

    Raises:
        SettingsError: no seed or no body, or an unknown body.
    """
    for body in bodies:
        if body not in BODIES:
            raise SettingsError(f"no {body!r}; there are {one_of(body, BODIES)}")
    check(len(seeds) > 0 and len(bodies) > 0, "seeds and bodies", (list(seeds), list(bodies)), "one each or more")


def corrupted(corruption: Corruption | None, seed: int) -> Corruption | None:
    """Return a copy of the corruption with the scene's random seed; None if there is no corruption."""
    return None if corruption is None else replace(corruption, seed=seed)


def followed(
    film: Film, body: str, images: str, corruption: Corruption | None, weight: float,
    *, settings: SilhouetteSettings | None = None,
) -> tuple[RunRow, Movement]:  # fmt: skip
    """Track a rendered scene; return the result and the tracked movement.

    Args:
        film: the rendered scene.
        body: key of `BODIES`.
        images: name of the corruption, for the row.
        corruption: corruption of the images; None for none.
        weight: factor of the penalty on jitter; 0 for none.
        settings: settings of the tracker, whose penalty is multiplied; None for the defaults.
    """
    joints = rough_joints(film.scene)
    mesh = BODIES[body](film.scene, joints)
    done = follow(film, mesh, joints, with_penalty(weight, settings), corruption=corruption)
    found, true = done.movement, film.truth
    ours, theirs = (
        np.mean([x.flexion_deg(f"{side} knee") for side in ("left", "right")], axis=0) for x in (found, true)
    )
    moves = np.ptp(theirs) >= MOVES_DEG
    row = RunRow(
        film.scene.name, film.scene.seed, body, images, weight, score(found, true), outcome(found, true),
        float(overlaps(film, found).mean()), len(done.left_out), len(done.lost),
        peak_kept(ours, theirs) if moves else None, lag_frames(ours, theirs) if moves else None,
    )  # fmt: skip
    return row, found


def plot_movements(shown: Sequence[PlottedScene], hinges: Sequence[str], path: Path) -> None:
    """Plot joint angles and the feet's acceleration over time, with the penalty and without, beside a corrupted image.

    Args:
        shown: the scenes of `run`, one or more.
        hinges: names of the hinge joints to plot.
        path: file of the plot, .png or .svg.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure(path, 11, 2.0 * (len(hinges) + 1) * len(shown))
    parts = np.atleast_1d(figure.subfigures(len(shown), 1))
    for part, one in zip(parts, shown, strict=True):
        true, rows = one.film.truth, len(hinges) + 1
        axes = part.subplots(rows, 2, width_ratios=(3, 1.1), squeeze=False)
        part.suptitle(f"{one.film.scene.name}, seed {one.film.scene.seed}")
        at = np.arange(len(true)) / true.fps
        wrong, middle = _wrong_share(one), len(true) // 2
        marked = max(range(len(true)), key=lambda k: (wrong[k], -abs(k - middle)))
        for left in axes[:, 0]:
            for k in np.flatnonzero(wrong).tolist():
                left.axvspan((k - 0.5) / true.fps, (k + 0.5) / true.fps, color="0.5", alpha=0.4 * wrong[k], lw=0)
            left.axvline(marked / true.fps, color="0.4", lw=0.8, ls=":")
        for left, hinge in zip(axes, hinges, strict=False):
            for weight, found in one.found.items():
                left[0].plot(at, found.flexion_deg(hinge), color=_colour(weight), lw=1.4, label=_penalty(weight))
            left[0].plot(at, true.flexion_deg(hinge), color=_TRUTH, lw=0.7, label="truth")
            left[0].set(ylabel=f"{hinge} [°]", xlim=(at[0], at[-1]))
        last = axes[-1, 0]
        for weight, found in one.found.items():
            last.plot(at[1:-1], _feet(found), color=_colour(weight), lw=1.0)
        last.plot(at[1:-1], _feet(true), color=_TRUTH, lw=0.7)
        last.set(ylabel="feet [m/s²]", xlabel="time [s]", xlim=(at[0], at[-1]))
        last.set_yscale("log")
        last.set_ylim(bottom=max(LEAST_M_PER_S2, last.get_ylim()[0]))
        part.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=8)
        for k, right in enumerate(axes[:, 1]):
            right.axis("off")
            if k < 2:
                camera = list(one.film.images[marked])[k]
                right.imshow(one.film.shown(marked, one.corruption)[camera][..., ::-1])
                right.set_title(f"{camera} at {marked / true.fps:.2f} s (dotted)", fontsize=8)
    save_figure(figure, path)


def _wrong_share(one: PlottedScene) -> Any:
    """Return the share (frames,) of cameras whose image is a wrong one, 0 to 1."""
    cameras, worse = len(one.film.scene.rig.cameras), one.corruption or Corruption()
    return np.array([np.mean([worse.is_wrong(k, c) for c in range(cameras)]) for k in range(len(one.film.truth))])


def plot_weights(rows: Sequence[RunRow], path: Path) -> None:
    """Plot error and jitter over the penalty's weight, for clean and noisy images.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure(path, 9, 3.4)
    error, jitter = figure.subplots(1, 2)
    weights = sorted({row.weight for row in rows})
    for k, scene in enumerate(sorted({row.scene for row in rows})):
        for images, style in zip(sorted({row.images for row in rows}), ("o-", "s--", "^:"), strict=False):
            for axes, figure_of in ((error, "angle_deg"), (jitter, "jitter")):
                mean = [_mean(rows, scene, images, weight, figure_of) for weight in weights]
                axes.plot(range(len(weights)), mean, style, color=f"C{k}", label=f"{scene}, {images}")
    for axes, label in ((error, "mean joint angle error [°]"), (jitter, "RMS acceleration of the error [m/s²]")):
        axes.set(xlabel="penalty, times the usual", ylabel=label, ylim=(0, None))
        axes.set_xticks(range(len(weights)), [f"{weight:g}" for weight in weights])
        axes.axvline(weights.index(1.0) if 1.0 in weights else 0, color="0.6", lw=0.8, ls=":")
    error.legend(fontsize=8)
    save_figure(figure, path)


def _mean(rows: Sequence[RunRow], scene: str, images: str, weight: float, name: str) -> float:
    chosen = [r.score for r in rows if (r.scene, r.images, r.weight) == (scene, images, weight)]
    return float(np.mean([getattr(one, name) for one in chosen]))


def _feet(movement: Movement) -> Any:
    """Return the magnitude (frames − 2,) of the feet's acceleration, mean over `FEET` [m/s²]."""
    places = np.stack([movement.landmarks[name] for name in FEET])
    return np.linalg.norm(np.diff(places, 2, axis=1), axis=-1).mean(axis=0) * movement.fps**2


def _penalty(weight: float) -> str:
    return {0.0: "without the penalty", 1.0: "with the penalty"}.get(weight, f"penalty × {weight:g}")


def _colour(weight: float) -> str:
    return _WITHOUT if weight == 0 else _WITH
