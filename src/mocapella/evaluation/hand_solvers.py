"""Compare the solvers of a hand's inverse kinematics on simulated hands with ground truth.

The tracker of the method ``hands`` follows the same markers with each solver: five fingertips and three markers of the
base, of a hand in smooth random motion within its limits. No image is rendered, and all noise is of points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.hand_chain import hand_chain, landmarks, palm_landmarks
from mocapella.kinematics.hand_solvers import MAP, SOLVER_NAMES
from mocapella.kinematics.hand_tracker import HandTracker, base_layout
from mocapella.model.hand import ANGLES, TIPS, Hand, HandModel, HandPose, HandShape, hand_model
from mocapella.settings import check

Float64 = NDArray[np.float64]

RATE_HZ: Final = 60
SECONDS: Final = 5.0
REACHED_M: Final = 1.001e-4
"""Distance at which a tip has reached its marker: the solvers' tolerance, with a rounding error [m]."""
_LEAST_SD_M: Final = 1e-4
_LEFT_OUT: Final = 20
"""First frames, which are not scored."""


class SolverScene(msgspec.Struct, frozen=True):
    """Errors of the markers in a scene.

    Attributes:
        noise_m: standard deviation of a marker's coordinate [m].
        hidden: share of the time when a fingertip is hidden, in runs of a sixth of a second.
        longer: ratio of the true fingers' lengths to the tracker's; above 1, tips are out of reach.
    """

    noise_m: float
    hidden: float = 0.0
    longer: float = 1.0


SCENES: Final = {
    "exact": SolverScene(0.0),
    "noise": SolverScene(0.002),
    "occlusion": SolverScene(0.001, hidden=0.25),
    "long-fingers": SolverScene(0.001, longer=1.05),
}


class SolverRow(msgspec.Struct, frozen=True):
    """Figures of a solver in a scene.

    Attributes:
        scene: name of the scene.
        solver: name of the solver.
        angle_deg: median error of the fingers' free angles [°].
        angle_p95_deg: 95th percentile of the same [°].
        tip_mm: median distance of the fingertips from the true ones [mm].
        reached_percent: share of the visible tips that are within 0.1 mm of their markers [%].
        within_percent: share of the frames with all angles within the limits [%].
        jitter_mm: RMS change of the landmarks' error from frame to frame [mm].
        iterations: mean number of iterations for a digit; None for ``map``.
        time_ratio: median time of a frame as a multiple of ``map``'s in the same run.
    """

    scene: str
    solver: str
    angle_deg: float
    angle_p95_deg: float
    tip_mm: float
    reached_percent: float
    within_percent: float
    jitter_mm: float
    iterations: float | None
    time_ratio: float


def compare_solvers(
    scenes: Sequence[str] | None,
    seeds: Sequence[int],
    clock: Callable[[], float],
    tell: Callable[[str], None] = lambda text: None,
    frames: int = round(SECONDS * RATE_HZ),
) -> list[SolverRow]:
    """Return a row for each scene and solver, over all seeds.

    Args:
        scenes: names in `SCENES`; None for all.
        seeds: random seeds of motion and noise; odd ones are left hands.
        clock: returns a time [s]; all solvers are timed frame by frame in turns.
        tell: called with the current scene.
        frames: number of frames for each seed.

    Raises:
        SettingsError: no such scene, no seed, or too few frames.
    """
    chosen = list(SCENES) if scenes is None else list(scenes)
    for name in chosen:
        if name not in SCENES:
            raise SettingsError(f"no scene {name!r}; there are {one_of(name, SCENES)}")
    check(bool(seeds), "seeds", seeds, "at least one number")
    check(frames > _LEFT_OUT + 1, "frames", frames, f"{_LEFT_OUT + 2} or more")
    rows: list[SolverRow] = []
    for name in chosen:
        tell(name)
        rows += _scored(name, seeds, clock, frames)
    return rows


def _scored(name: str, seeds: Sequence[int], clock: Callable[[], float], frames: int) -> list[SolverRow]:
    """Return a scene's rows."""
    model, scene = hand_model("thesis"), SCENES[name]
    fingers = [i for i in range(5, len(ANGLES)) if model.limits[i, 0] < model.limits[i, 1]]
    figures: dict[str, list[list[Float64]]] = {solver: [[] for _ in range(7)] for solver in SOLVER_NAMES}
    for seed in seeds:
        shape = model.shape("left" if seed % 2 else "right")
        truth = HandShape(shape.handedness, shape.lengths * scene.longer, shape.bases)
        angles, T, points = simulated_markers(model, truth, scene, seed, frames)
        x = landmarks(hand_chain(model, truth), HandPose(angles, T))
        chain, layout = hand_chain(model, shape), base_layout(shape, 3)
        trackers = {solver: HandTracker(model, shape, layout, solver=solver) for solver in SOLVER_NAMES}
        sd = np.full(points.shape[1], max(scene.noise_m, _LEAST_SD_M))
        hands: dict[str, list[Hand]] = {solver: [] for solver in SOLVER_NAMES}
        for k in range(frames):
            for solver, tracker in trackers.items():
                begin = clock()
                hands[solver].append(tracker.update(points[k], k / RATE_HZ, sd))
                figures[solver][6].append(np.array(clock() - begin))
                if k >= _LEFT_OUT and tracker.fingers is not None:
                    figures[solver][5].append(tracker.fingers.iterations[tracker.fingers.measured].astype(float))
        for solver, found in hands.items():
            scored, of = found[_LEFT_OUT:], figures[solver]
            q = np.array([hand.angles for hand in scored])
            palm = np.array([hand.T_world_palm for hand in scored])
            tips = palm_landmarks(chain, q)[:, list(TIPS)]
            away = np.linalg.norm(tips - apply(inverse(palm), points[_LEFT_OUT:, :5]), axis=-1)
            error = np.array([hand.landmarks for hand in scored]) - x[_LEFT_OUT:]
            of[0].append(np.degrees(np.abs(q - angles[_LEFT_OUT:]))[:, fingers].ravel())
            of[1].append(np.linalg.norm(error[:, list(TIPS)], axis=-1).ravel())
            of[2].append((away <= REACHED_M)[np.isfinite(away)])
            of[3].append(np.asarray(model.within(q)))
            of[4].append(np.linalg.norm(np.diff(error, axis=0), axis=-1).ravel() ** 2)
    usual = float(np.median(figures[MAP][6]))
    rows = []
    for solver, of in figures.items():
        angle, tip, reached, within, jitter = (np.concatenate(part) for part in of[:5])
        rows.append(
            SolverRow(
                name, solver, float(np.median(angle)), float(np.quantile(angle, 0.95)), 1e3 * float(np.median(tip)),
                100 * float(reached.mean()), 100 * float(within.mean()), 1e3 * float(np.sqrt(jitter.mean())),
                float(np.concatenate(of[5]).mean()) if of[5] else None, float(np.median(of[6])) / usual,
            )
        )  # fmt: skip
    return rows


def simulated_markers(
    model: HandModel, shape: HandShape, scene: SolverScene, seed: int, frames: int
) -> tuple[Float64, Float64, Float64]:
    """Simulate a hand in smooth random motion, and its markers.

    Each angle is spread evenly over its limits; a third of the flexions' variance is common to all fingers.

    Args:
        model: the hand's limits and couplings.
        shape: its true lengths.
        scene: errors of the markers.
        seed: of motion, noise and occlusion.
        frames: number of frames at `RATE_HZ`.

    Returns:
        Angles (frames, 21) [rad], T_world_palm (frames, 4, 4), and markers (frames, 8, 3), world [m]: tips, NaN where
        hidden, then three of the base.
    """
    rng = np.random.default_rng(seed)

    def smooth(columns: int, sd_s: float) -> Float64:
        path = gaussian_filter1d(rng.normal(size=(frames, columns)), sd_s * RATE_HZ, axis=0, mode="wrap")
        return np.asarray(path / path.std(axis=0))

    common = np.where(["flexion" in name for name in ANGLES], 1 / 3, 0.0)
    mixed = np.sqrt(1 - common) * smooth(len(ANGLES), 0.35) + np.sqrt(common) * smooth(1, 0.35)
    low, high = model.limits.T
    angles = model.limited(low + ndtr(mixed) * (high - low))
    T = exp_twist(np.concatenate([0.15 * smooth(3, 0.5), np.radians(40) * smooth(3, 0.5)], axis=1))
    tips = landmarks(hand_chain(model, shape), HandPose(angles, T))[:, list(TIPS)]
    layout = base_layout(shape, 3) * shape.mirror
    points = np.concatenate([tips, apply(T, np.broadcast_to(layout, (frames, *layout.shape)))], axis=1)
    points += rng.normal(0, 1, points.shape) * scene.noise_m
    run = RATE_HZ // 6
    hidden = np.repeat(rng.random((frames // run + 1, 5)) < scene.hidden, run, axis=0)[:frames]
    points[:, :5][hidden] = np.nan
    return angles, T, points


def plot_solvers(rows: Sequence[SolverRow], path: Path) -> None:
    """Plot angles, jitter, reached tips and time of the solvers, for each scene.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    scenes = list(dict.fromkeys(row.scene for row in rows))
    figure = new_figure(path, 10, 6.5)
    panels = {
        "angle_deg": "median error of finger angles [°]",
        "jitter_mm": "jitter [mm]",
        "reached_percent": "tips within 0.1 mm of markers [%]",
        "time_ratio": "time of a frame [× map]",
    }
    at = np.arange(len(SOLVER_NAMES))
    for axes, (field, label) in zip(figure.subplots(2, 2).flat, panels.items(), strict=True):
        for i, scene in enumerate(scenes):
            values = [getattr(row, field) for row in rows if row.scene == scene]
            axes.bar(at + (i - (len(scenes) - 1) / 2) * 0.8 / len(scenes), values, 0.8 / len(scenes), label=scene)
        axes.set_xticks(at, SOLVER_NAMES, rotation=30, ha="right")
        axes.set(ylabel=label)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(scenes))
    save_figure(figure, path)
