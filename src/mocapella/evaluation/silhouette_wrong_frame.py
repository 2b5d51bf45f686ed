"""Experiment: one wrong frame in a knee bend, tracked with the smoothness prior (penalty on jitter) and without.

After B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007,
figure 1: in a single frame the silhouettes of the legs are wrong. To see the effect of the penalty alone, run it with
`SilhouetteSettings.rejection` none; otherwise the tracker leaves the wrong images out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.evaluation.silhouette_runs import Film, filmed, follow, rough_joints, with_penalty
from mocapella.evaluation.silhouettes import Movement, joint_errors_deg
from mocapella.model.body_meshes import legs_mesh
from mocapella.model.body_proportions import Sex, proportions_of
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.settings import check
from mocapella.sources.simulate.corruption import WRONG, Corruption
from mocapella.sources.simulate.silhouette_scene import SilhouetteScene, silhouette_scene
from mocapella.tracker.silhouette_settings import SilhouetteSettings

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SCENE: Final = "knee-bend"
FRAME: Final = 45
"""Index of the wrong frame: the knees bend fast."""
FRAMES: Final = 81
"""Frames that are tracked, from the scene's first one on."""
BEFORE: Final = 10
"""Frames before the wrong one whose mean error is reported."""
MORE_DEG: Final = 1.0
"""A frame counts as disturbed if its error exceeds that of the same run without the wrong frame by more [deg]."""
GROWN: Final = 0.05
"""Margin of the legs' part of an image, as a fraction of the image's longer side."""
WEIGHTS: Final = (0.0, 1.0)
_LEGS: Final = ("thigh", "shank", "foot")


@dataclass(frozen=True)
class WrongFrameCase:
    """What is tracked, and where the wrong frame's images are wrong.

    Attributes:
        body: legs, tracked as a pelvis with legs; or the whole body.
        where: legs, the rectangle of the image around them; or everywhere.
    """

    body: str
    where: str

    @property
    def words(self) -> str:
        """Description for tables and plots."""
        wrong = "whole frame wrong" if self.where == "everywhere" else "legs' part of the frame wrong"
        return f"{self.body}, {wrong}"


CASES: Final = (
    WrongFrameCase("legs", "everywhere"),
    WrongFrameCase("whole body", "legs"),
    WrongFrameCase("whole body", "everywhere"),
)


class WrongFrameRow(msgspec.Struct, frozen=True):
    """Result of one run. Errors are means over the tracked joints (`joint_errors_deg`).

    Attributes:
        seed, body, where: seed of the scene, and the `WrongFrameCase`.
        wrong: what the wrong frame shows, one of `mocapella.sources.simulate.corruption.WRONG`.
        weight: factor of the penalty on jitter; 0 for none.
        before_deg: mean error of the `BEFORE` frames before the wrong one [deg].
        at_deg: error in the wrong frame [deg].
        most_deg: largest error from the wrong frame on [deg].
        disturbed: number of frames whose error exceeds that of the run without the wrong frame by `MORE_DEG`.
        late_deg: error in the last frame [deg].
        left_out: whether every camera's wrong image was left out by the rejection.
    """

    seed: int
    body: str
    where: str
    wrong: str
    weight: float
    before_deg: float
    at_deg: float
    most_deg: float
    disturbed: int
    late_deg: float
    left_out: bool


class WrongFrameShown(msgspec.Struct, frozen=True, eq=False):
    """Plotted runs, of the first seed.

    Attributes:
        truth: the true movement.
        pictures: the first camera's wrong image (height, width, 3) uint8 BGR, by kind.
        found: tracked movement by case, what the wrong frame shows, and weight.
    """

    truth: Movement
    pictures: dict[str, NDArray[np.uint8]]
    found: dict[tuple[WrongFrameCase, str, float], Movement]


def run_wrong_frame(
    seeds: Sequence[int],
    tell: Callable[[str], None] = lambda _: None,
    *,
    settings: SilhouetteSettings | None = None,
    kinds: Sequence[str] = WRONG,
) -> tuple[list[WrongFrameRow], WrongFrameShown]:
    """Track a knee bend whose frame of index `FRAME` is wrong in all cameras.

    Args:
        seeds: random seeds of the scenes.
        tell: called with the current step, in words.
        settings: settings of the tracker; None for the defaults, which leave wrong images out.
        kinds: what the wrong frame shows, each in runs of its own.

    Returns:
        A row for each run with a wrong frame, by seed, case, kind and weight; and the runs of the first seed, for
        `plot_wrong_frame`.

    Raises:
        SettingsError: no seed, or an unknown kind.
    """
    check(len(seeds) > 0, "seeds", list(seeds), "one or more")
    rows: list[WrongFrameRow] = []
    shown: WrongFrameShown | None = None
    for seed in seeds:
        tell(f"rendering {SCENE}, seed {seed} …")
        film = filmed(silhouette_scene(SCENE, seed=seed), FRAMES / 60)
        legs = legs_box(film.scene, FRAME)
        found: dict[tuple[WrongFrameCase, str, float], Movement] = {}
        for body in dict.fromkeys(case.body for case in CASES):
            mesh = _mesh(film.scene, body)
            for weight in WEIGHTS:
                fit = with_penalty(weight, settings)
                tell(f"following {SCENE}, seed {seed}: {body}, penalty × {weight:g}, no frame wrong …")
                usual = errors_deg(follow(film, mesh, rough_joints(film.scene), fit).movement, film.truth)
                for case in (one for one in CASES if one.body == body):
                    for kind in kinds:
                        tell(f"following {SCENE}, seed {seed}: {case.words} ({kind}), penalty × {weight:g} …")
                        worse = with_wrong_frame(film, FRAME, kind, legs if case.where == "legs" else None)
                        done = follow(worse, mesh, rough_joints(film.scene), fit)
                        found[case, kind, weight] = done.movement
                        off = errors_deg(done.movement, film.truth)
                        rows.append(_row(seed, case, kind, weight, (off, usual), left_out=FRAME in done.left_out))
        if shown is None:
            pictures = {kind: next(iter(with_wrong_frame(film, FRAME, kind).images[FRAME].values())) for kind in kinds}
            shown = WrongFrameShown(film.truth, pictures, found)
    assert shown is not None  # there are seeds
    order = {(case.body, case.where): k for k, case in enumerate(CASES)}
    rows.sort(key=lambda row: (seeds.index(row.seed), order[row.body, row.where], kinds.index(row.wrong), row.weight))
    return rows, shown


def with_wrong_frame(film: Film, frame: int, kind: str, where: Sequence[Bool] | None = None) -> Film:
    """Return a film with one frame that is wrong in all cameras; the other frames are the same arrays.

    Args:
        film: the rendered scene; not changed.
        frame: index of the frame.
        kind: content of the wrong image, one of `mocapella.sources.simulate.corruption.WRONG`.
        where: (height, width) masks, one for each camera: the pixels that are replaced; None for all.

    Raises:
        SettingsError: an unknown kind, or the film has no such frame.
    """
    check(0 <= frame < len(film.images), "frame", frame, f"from 0 to {len(film.images) - 1}")
    worse = Corruption(wrong_frames=(frame,), wrong_kind=kind, seed=film.scene.seed)
    images = dict(film.shown(frame, worse))
    if where is not None:
        for (name, right), mask in zip(film.images[frame].items(), where, strict=True):
            images[name] = np.where(mask[..., None], images[name], right)
    return msgspec.structs.replace(film, images=[*film.images[:frame], images, *film.images[frame + 1 :]])


def legs_box(scene: SilhouetteScene, frame: int) -> list[Bool]:
    """Return for each camera the mask (height, width) of the rectangle around the first person's legs.

    The margin is `GROWN`. A camera that shows no leg has an empty mask.
    """
    parts = [k for k, name in enumerate(scene.mesh.part_names) if name.split(" ")[-1] in _LEGS]
    masks = []
    for seen in scene.covered(frame):
        mask = np.zeros(seen.parts.shape, np.bool_)
        rows, columns = np.nonzero(np.isin(seen.parts, parts) & (seen.people == 0))
        if len(rows):
            grown = round(GROWN * max(mask.shape))
            top, left = max(rows.min() - grown, 0), max(columns.min() - grown, 0)
            mask[top : rows.max() + grown + 1, left : columns.max() + grown + 1] = True
        masks.append(mask)
    return masks


def errors_deg(found: Movement, true: Movement) -> Float64:
    """Return the error (frames,), the mean of `joint_errors_deg` over the joints that both bodies have [deg]."""
    return np.asarray(np.mean(list(joint_errors_deg(found, true).values()), axis=0))


def plot_wrong_frame(shown: WrongFrameShown, path: Path) -> None:
    """Plot a joint angle over time: the truth, without the penalty and with it; a row for each kind of wrong frame.

    Each curve is of the angle that the wrong frame changes most without the penalty (`most_disturbed`).

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure(path, 12, 0.5 + 2.0 * len(shown.pictures))
    widths = (0.9, *(1.3 for _ in CASES))
    axes = figure.subplots(len(shown.pictures), len(widths), width_ratios=widths, squeeze=False)
    at = np.arange(len(shown.truth)) / shown.truth.fps
    for (picture, *curves), (kind, image) in zip(axes, shown.pictures.items(), strict=True):
        picture.imshow(image[..., ::-1])
        picture.set(xticks=(), yticks=(), ylabel=kind)
        for one, case in zip(curves, CASES, strict=True):
            joint = most_disturbed(shown.found[case, kind, 0.0], shown.truth)
            one.axvline(FRAME / shown.truth.fps, color="0.5", lw=0.8, ls=":")
            for weight, colour, label in ((0.0, "C1", "without the penalty"), (1.0, "C0", "with the penalty")):
                one.plot(at, angle_deg(shown.found[case, kind, weight], joint), colour, lw=1.5, label=label)
            one.plot(at, angle_deg(shown.truth, joint), "k", lw=0.8, label="truth")
            one.set_xlim(at[FRAME // 2], at[-1])
            one.set_title(f"{joint} [°]", fontsize=8, loc="left")
    for one, case in zip(axes[0, 1:], CASES, strict=True):
        one.set_title(f"{case.words}\n{one.get_title('left')}", fontsize=8, loc="left")
    axes[0, 0].set_title("the wrong frame, first camera", fontsize=8)
    for one in axes[-1, 1:]:
        one.set_xlabel("time [s]; dotted: the wrong frame", fontsize=8)
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=8)
    save_figure(figure, path)


def angle_deg(movement: Movement, joint: str) -> Float64:
    """Return a joint angle (frames,) by its name in the mesh [deg]."""
    return np.degrees(movement.poses.angles[:, movement.mesh.joint_names.index(joint)])


def most_disturbed(found: Movement, true: Movement) -> str:
    """Return the joint angle, among the angles of both bodies, with the largest error in the frame of index `FRAME`."""
    common = [name for name in found.mesh.joint_names if name in true.mesh.joint_names]
    return max(common, key=lambda name: abs(angle_deg(found, name)[FRAME] - angle_deg(true, name)[FRAME]))


def _mesh(scene: SilhouetteScene, body: str) -> RiggedMesh:
    """Return the subject's own mesh, or legs with the subject's own proportions."""
    if body != "legs":
        return scene.mesh
    return legs_mesh(cast(Sex, scene.mesh.name), None, proportions_of(rough_joints(scene, 0.0)))


def _row(
    seed: int, case: WrongFrameCase, kind: str, weight: float, errors: tuple[Float64, Float64], *, left_out: bool
) -> WrongFrameRow:
    """Summarise the errors (frames,) of a run, and of the same run without a wrong frame [deg]."""
    off, usual = errors
    return WrongFrameRow(
        seed, case.body, case.where, kind, weight, float(off[FRAME - BEFORE : FRAME].mean()), float(off[FRAME]),
        float(off[FRAME:].max()), int((off[FRAME:] > usual[FRAME:] + MORE_DEG).sum()), float(off[-1]), left_out,
    )  # fmt: skip
