"""Measures how well one camera alone determines a body, with the smoothness prior (penalty on jitter) and without.

Rotations out of the image plane, and the body's distance, hardly move an outline: in these directions the outlines'
equations are nearly singular (C. Bregler, J. Malik, "Tracking people with twists and exponential maps", CVPR 1998,
section 4, on one view). The same images of one camera are tracked with the penalty and without; errors are given along
the camera's axis, where they are large, and across it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.evaluation.silhouette_experiments import RunRow, check_run, followed
from mocapella.evaluation.silhouette_runs import Film, filmed, with_penalty
from mocapella.evaluation.silhouettes import Movement
from mocapella.geometry.rigid import apply
from mocapella.geometry.signed_distance import signed_distance
from mocapella.kinematics.silhouette_fit import eye, see, touching
from mocapella.kinematics.twist_fit import Prior, normal_equations
from mocapella.kinematics.twist_prediction import smoothness
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose, part_motions
from mocapella.sources.simulate.silhouette_scene import silhouette_scene
from mocapella.tracker.silhouette_body import SilhouetteBody
from mocapella.tracker.silhouette_settings import SilhouetteSettings

Float64 = NDArray[np.float64]

SCENES: Final = ("knee-bend", "walk", "runner")
WEIGHTS: Final = (0.0, 1.0)
"""Factors of the penalty on jitter; 0 for none."""
HELD_BY: Final = {0.0: "… and the resting pose", 1.0: "… and the penalty"}
FPS: Final = 60.0
AWAY_M: Final = 0.5
"""Median landmark error above which a body has lost the person [m]."""
ASKED: Final = 8
"""Number of frames of a scene for which the uncertainty is computed."""
STEP_PX: Final = 2
REACH_PX: Final = 24.0
MANY_CAMERAS: Final = 4
"""Number of cameras of the comparison."""


class OneCameraRow(msgspec.Struct, frozen=True):
    """One run with one camera.

    Attributes:
        run: result as in the other experiments.
        depth_mm, depth_p95_mm: median and 95th percentile of the landmarks' errors along the camera's axis [mm].
        across_mm, across_p95_mm: median and 95th percentile of their errors perpendicular to the axis [mm].
        depth_jitter, across_jitter: root mean square acceleration of these errors [m/s²].
        away: share of frames with a median error of the landmarks above `AWAY_M`, 0 to 1.
        free: standard deviation of the pose's least certain direction (eigenvector of the normal matrix), with 1 m
            counted as 1 rad; median over frames.
        outlines: ``free`` from the outlines alone, without the weak prior of the resting pose.
        outlines_of_many: ``outlines`` with four cameras.
    """

    run: RunRow
    depth_mm: float
    depth_p95_mm: float
    across_mm: float
    across_p95_mm: float
    depth_jitter: float
    across_jitter: float
    away: float
    free: float
    outlines: float
    outlines_of_many: float


class OneCameraShown(msgspec.Struct, frozen=True, eq=False):
    """Plotted runs of a scene.

    Attributes:
        film: the rendered scene.
        found: tracked movement by the penalty's weight.
        freedoms: `median_freedoms` (dofs,) by a description of the constraints: outlines of one camera or of many,
            without priors; for one camera, also with the prior of the resting pose, and with the penalty.
    """

    film: Film
    found: dict[float, Movement]
    freedoms: dict[str, Float64]


def run_one_camera(
    seeds: Sequence[int],
    seconds: float | None = None,
    bodies: Sequence[str] = ("own",),
    tell: Callable[[str], None] = lambda _: None,
    settings: SilhouetteSettings | None = None,
) -> tuple[list[OneCameraRow], list[OneCameraShown]]:
    """Track `SCENES` with one camera, with the penalty and without.

    Args:
        seeds: random seeds of the scenes, which also place the camera.
        seconds: duration of each scene [s]; None for the whole scene.
        bodies: keys of `BODIES`: the ways to make the tracked body.
        tell: called with the current step, in words.
        settings: settings of the tracker; None for the defaults.

    Returns:
        A row for each run; and for each scene the runs of the first seed with the first body, for `plot_one_camera`.

    Raises:
        SettingsError: no seed, or no such body.
    """
    check_run(seeds, bodies)
    rows, shown = [], []
    for scene in SCENES:
        for seed in seeds:
            tell(f"rendering {scene}, seed {seed} …")
            film = filmed(silhouette_scene(scene, seed=seed, fps=FPS, cameras=1), seconds)
            many = silhouette_scene(scene, seed=seed, fps=FPS, cameras=MANY_CAMERAS).rig
            alone = replace(with_penalty(0.0, settings), usual_per_rad=0.0)
            free = {
                f"outlines of {MANY_CAMERAS} cameras": median_freedoms(film.truth, many, alone),
                "outlines of one camera": median_freedoms(film.truth, film.scene.rig, alone),
            }
            most = [float(sizes[0]) for sizes in free.values()]
            held = {
                weight: median_freedoms(film.truth, film.scene.rig, with_penalty(weight, settings))
                for weight in WEIGHTS
            }
            free |= {HELD_BY[weight]: sizes for weight, sizes in held.items()}
            found: dict[float, Movement] = {}
            for body, weight in product(bodies, WEIGHTS):
                tell(f"following {scene}, seed {seed}: {body} body, penalty × {weight:g} …")
                run, movement = followed(film, body, "clean", None, weight, settings=settings)
                found.setdefault(weight, movement)
                told = errors_m(movement, film.truth, film.scene.rig)
                rows.append(_row(run, told, film.truth.fps, (float(held[weight][0]), most[1], most[0])))
            if seed == seeds[0]:
                shown.append(OneCameraShown(film, found, free))
    return rows, shown


def errors_m(found: Movement, true: Movement, rig: CameraRig) -> Float64:
    """Return the landmarks' errors (frames, landmarks, 3) in the first camera's frame: x, y, and along its axis [m].

    An error is the estimated minus the true position, of each landmark that both bodies have.
    """
    (placed, *_) = rig.cameras.values()
    names = [name for name in true.landmarks if name in found.landmarks]
    at = [
        apply(placed.T_camera_world, np.stack([one.landmarks[name] for name in names], axis=1)) for one in (found, true)
    ]
    return np.asarray(at[0] - at[1])


def freedoms(mesh: RiggedMesh, pose: TreePose, rig: CameraRig, settings: SilhouetteSettings, fps: float) -> Float64:
    """Compute how observable a pose is: the uncertainty of its principal directions, from exact outlines in one frame.

    The directions are the eigenvectors of the normal matrix with the tracker's weights, with a metre for a radian; a
    standard deviation is 1/√eigenvalue.

    Args:
        mesh: the body's mesh.
        pose: the true pose.
        rig: the cameras.
        settings: settings of the tracker, with the penalty on jitter or without.
        fps: frame rate [Hz].

    Returns:
        (dofs,) standard deviations [m, rad], falling; infinite if undetermined.
    """
    body = SilhouetteBody(mesh)
    stands = body.standing(pose)
    T = part_motions(mesh.tree, pose)
    motions = np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 9), np.ascontiguousarray(T[:, :3, 3])
    given = []
    for placed in rig.cameras.values():
        by = eye(placed)
        seen = see(body.figure, stands.vertices, by, step_px=STEP_PX, margin_px=int(REACH_PX))
        if seen is not None:
            phi = signed_distance(seen.mask, REACH_PX, STEP_PX)
            sure = np.full(phi.shape, settings.correspondences.sure_nats, np.float32)
            given.append(touching(seen, motions, phi, sure, by, reach_px=REACH_PX, settings=settings.correspondences))
    resting = TreePose(pose.T_world_model, np.clip(0.0, *mesh.tree.limits.T))
    priors = [Prior(resting, 0.0, 0.0, np.full(len(pose.angles), settings.usual_per_rad))]
    if settings.steadiness is not None:
        priors.append(smoothness(mesh.tree, pose, settings.steadiness.penalty(fps**2)))
    sizes = np.linalg.eigvalsh(normal_equations(mesh.tree, pose, given, priors).H)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(np.clip(sizes, 0.0, None)))


def median_freedoms(true: Movement, rig: CameraRig, settings: SilhouetteSettings) -> Float64:
    """Return the standard deviations (dofs,) of `freedoms` [m, rad], each the median over `ASKED` frames of a movement.

    ``true`` is the true movement; ``rig`` and ``settings`` are as in `freedoms`.
    """
    frames = np.unique(np.linspace(0, len(true) - 1, ASKED).round().astype(int))
    poses = [TreePose(true.poses.T_world_model[k], true.poses.angles[k]) for k in frames]
    return np.asarray(np.median([freedoms(true.mesh, pose, rig, settings, true.fps) for pose in poses], axis=0))


def plot_one_camera(shown: Sequence[OneCameraShown], path: Path) -> None:
    """Plot errors along the camera's axis and across it over time, and the uncertainty of the directions.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    drawing = new_figure(path, 11, 2.6 * len(shown))
    axes = drawing.subplots(len(shown), 3, squeeze=False)
    colours = {0.0: "C1", 1.0: "C0"}
    for (depth, across, free), one in zip(axes, shown, strict=True):
        true = one.film.truth
        at = np.arange(len(true)) / true.fps
        for weight, found in one.found.items():
            off = np.abs(errors_m(found, true, one.film.scene.rig))
            label = "with the penalty" if weight else "without the penalty"
            sizes = off[..., 2], np.linalg.norm(off[..., :2], axis=-1)
            for left, size in zip((depth, across), sizes, strict=True):
                left.plot(at, np.median(size, axis=1), color=colours[weight], lw=1.4, label=label)
        for (words, sizes_of), line in zip(one.freedoms.items(), ("k:", "k-", "C1-", "C0-"), strict=True):
            free.plot(sizes_of, line, lw=1.4, label=words)
        for left, words in ((depth, "along the axis"), (across, "across it")):
            left.set(ylabel=f"{words} [m]", yscale="log", ylim=(1e-3, 10), xlim=(at[0], at[-1]))
        free.set(ylabel="uncertainty [m, rad]", yscale="log")
        depth.set_title(f"{one.film.scene.name}, seed {one.film.scene.seed}", fontsize=9)
    axes[-1, 0].set_xlabel("time [s]")
    axes[-1, 1].set_xlabel("time [s]")
    axes[-1, 2].set_xlabel("directions, the least certain first")
    axes[0, 0].legend(fontsize=8)
    axes[0, 2].legend(fontsize=7)
    save_figure(drawing, path)


def _row(run: RunRow, off: Float64, fps: float, free: tuple[float, float, float]) -> OneCameraRow:
    depth, across = np.abs(off[..., 2]), np.linalg.norm(off[..., :2], axis=-1)
    jitter = np.diff(off, 2, axis=0) * fps**2
    away = np.median(np.linalg.norm(off, axis=-1), axis=1) > AWAY_M
    return OneCameraRow(
        run,
        1e3 * float(np.median(depth)), 1e3 * float(np.percentile(depth, 95)),
        1e3 * float(np.median(across)), 1e3 * float(np.percentile(across, 95)),
        float(np.sqrt(np.mean(jitter[..., 2] ** 2))),
        float(np.sqrt(np.mean(np.sum(jitter[..., :2] ** 2, axis=-1)))),
        float(away.mean()), *free,
    )  # fmt: skip
