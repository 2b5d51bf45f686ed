"""Accuracy of legs that images hardly show: people who sit still among dark things, in the scenes of `SEATED_SCENES`.

    legs = follow_seated("table", seed=100)
    legs.score("knee").median_mm, legs.score("ankle").unsaid

The empty room is filmed first, the person sits on a chair that came later, and the start is of triangulated keypoints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.keypoints_of_scenes import drawn_keypoints
from mocapella.evaluation.silhouette_runs import measured_body, rough_joints, seen_at
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.landmark_pose import pose_of
from mocapella.kinematics.silhouette_fit import eye
from mocapella.kinematics.silhouette_fit import seen_at as pixels_of
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.twist_tree import TreePose, limbs_of
from mocapella.recording.bodies_file import ALONE
from mocapella.settings import check
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_scene import CameraLook, SilhouetteScene, silhouette_scene
from mocapella.tracker.frame_sync import FrameSyncSettings
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.limb_support import NEAR_M, LimbSupport
from mocapella.tracker.silhouette_settings import SilhouetteSettings
from mocapella.tracker.silhouettes import SilhouettesTracker

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

START_SD_M: Final = 0.01
"""Standard deviation of the start's joints, along each axis [m]."""
SIZE_PX: Final = (644, 486)
FPS: Final = 25.0
EMPTY_IMAGES: Final = 3
"""Number of images of the empty room, of each camera."""
FAR_M: Final = 0.1
"""Error of a joint that must be doubted [m]."""
RIGHT_M: Final = 0.05
"""Error of a joint that must not be doubted if an image shows it in truth [m]."""
HIDDEN: Final = 0.02
"""A joint is hidden if every image shows a smaller share of the limb's skin about it."""


@dataclass(frozen=True)
class SeatedScene:
    """What is hard about a scene.

    Attributes:
        surroundings: one of `later_things.SURROUNDINGS`.
        look: exposure and noise of the cameras.
        corruption: corruption of the images; None for none.
        interlaced: whether every second row is of the image before.
        motion: one of `silhouette_scene.SEATED`.
        outfit: name of the clothes; None for dark trousers.
        arc_deg: arc about the person along which the cameras stand [deg].
        start_sd_m: standard deviation of the start's joints, along each axis [m].
        loose_m: distance of the trousers from the legs, which the tracked body does not have [m].
        rig_sd_rad: standard deviation of the rotation errors of the tracker's cameras, about each axis [rad].
        misplaced_rad: standard deviation of the errors of the angles of limbs at the start, of `misplaced` [rad].
    """

    surroundings: str = "chair"
    look: CameraLook = field(default_factory=CameraLook)
    corruption: Corruption | None = None
    interlaced: bool = False
    motion: str = "sits"
    outfit: str | None = None
    arc_deg: float = 360.0
    start_sd_m: float = START_SD_M
    loose_m: float = 0.0
    rig_sd_rad: float = 0.0
    misplaced_rad: float = 0.0


SEATED_SCENES: Final[Mapping[str, SeatedScene]] = {
    **{name: SeatedScene(name) for name in ("chair", "table", "screen", "dark", "skirt", "later")},
    "light": SeatedScene(look=CameraLook(drift=0.2, flicker=0.01)),
    "interlaced": SeatedScene(interlaced=True),
    "compressed": SeatedScene(corruption=Corruption(blocks=30.0)),
    **{name: SeatedScene(name) for name in ("desk", "armchair", "stool")},
    "arc": SeatedScene(arc_deg=150.0),
    "black": SeatedScene(outfit="black"),
    "rough": SeatedScene(start_sd_m=0.03),
    "loose": SeatedScene(loose_m=0.03),
    "rig": SeatedScene(rig_sd_rad=0.003),
    "clip": SeatedScene(loose_m=0.025, rig_sd_rad=0.002, start_sd_m=0.025),
    "clip-desk": SeatedScene("desk", loose_m=0.025, rig_sd_rad=0.002, start_sd_m=0.025),
    "shifts": SeatedScene(motion="shifts"),
    "shifts-desk": SeatedScene("desk", motion="shifts"),
    **{f"misplaced-{name}": SeatedScene(name, misplaced_rad=0.3) for name in ("chair", "desk", "armchair", "skirt")},
}
"""Scenes by name. All have a chair, a bag and a mask, which came after the empty room was filmed, and their shadows."""


class JointScore(msgspec.Struct, frozen=True):
    """Errors of one kind of joint over a scene.

    Attributes:
        median_mm, p95_mm, worst_mm: distances from the truth [mm].
        doubted: share of the joints that are reported as not supported by the images, over all frames.
        unsaid: share of the joints that are farther off than `FAR_M` and are not reported, over all frames.
        hidden: share of the joints that no image shows in truth, over all frames.
        hidden_unsaid: share of the hidden joints that are not reported; 0 if none is hidden.
        shown_doubted: share of the other joints that are reported; 0 if all are hidden.
    """

    median_mm: float
    p95_mm: float
    worst_mm: float
    doubted: float
    unsaid: float
    hidden: float
    hidden_unsaid: float
    shown_doubted: float


class DoubtScore(msgspec.Struct, frozen=True):
    """How doubt agrees with the errors of one kind of joint over several runs.

    Attributes:
        far: number of joints that are farther off than `FAR_M`, over all frames.
        far_doubted: share of these that are reported as not supported by the images; NaN if there are none.
        right: number of joints that are at most `RIGHT_M` off and shown by an image in truth, over all frames.
        right_doubted: share of these that are reported; NaN if there are none.
    """

    far: int
    far_doubted: float
    right: int
    right_doubted: float


class SeatedRun(msgspec.Struct, frozen=True, eq=False):
    """The tracker's result over a scene.

    Attributes:
        landmarks: names of the landmarks.
        errors_m: (frames, landmarks) distances from the truth [m].
        supported: (frames, landmarks) whether images support each landmark.
        visible: (frames, landmarks) share of the skin about each landmark that the image shows in truth that shows
            most of it, 0 to 1, of `visible_share`.
        overlap: mean intersection over union of the model and its own segmentation.
        left_out: number of images that were left out.
    """

    landmarks: tuple[str, ...]
    errors_m: Float64
    supported: Bool
    visible: Float64
    overlap: float
    left_out: int

    def score(self, joint: str) -> JointScore:
        """Return the errors of the landmarks whose names end with ``joint``, such as ``knee``."""
        these = [k for k, name in enumerate(self.landmarks) if name.endswith(joint)]
        check(len(these) > 0, "joint", joint, "the end of a landmark's name, such as knee")
        errors, said = self.errors_m[:, these], ~self.supported[:, these]
        median, p95 = np.percentile(1e3 * errors, [50, 95])
        unsaid = (errors > FAR_M) & ~said
        worst = 1e3 * float(errors.max())
        hidden = self.visible[:, these] < HIDDEN
        return JointScore(
            float(median), float(p95), worst, float(said.mean()), float(unsaid.mean()), float(hidden.mean()),
            _share(~said, hidden), _share(said, ~hidden),
        )  # fmt: skip


def doubt_score(runs: Sequence[SeatedRun], joint: str) -> DoubtScore:
    """Return how doubt agrees with errors, of the landmarks whose names end with ``joint``, such as ``knee``.

    Args:
        runs: runs of bodies with the same landmarks, one or more.
        joint: end of the landmarks' names.
    """
    these = [k for k, name in enumerate(runs[0].landmarks) if name.endswith(joint)]
    check(len(these) > 0, "joint", joint, "the end of a landmark's name, such as knee")
    errors, supported, visible = (
        np.concatenate([getattr(run, of)[:, these] for run in runs]) for of in ("errors_m", "supported", "visible")
    )
    far, right = errors > FAR_M, (errors <= RIGHT_M) & (visible >= HIDDEN)
    shares = [float((~supported[some]).mean()) if some.any() else float("nan") for some in (far, right)]
    return DoubtScore(int(far.sum()), shares[0], int(right.sum()), shares[1])


def follow_seated(
    name: str,
    seed: int,
    seconds: float = 1.2,
    settings: SilhouetteSettings | None = None,
    *,
    size_px: tuple[int, int] = SIZE_PX,
    fps: float = FPS,
    keypoints: bool = False,
) -> SeatedRun:
    """Track the person of one of `SEATED_SCENES`, with a body whose proportions are of the start's joints.

    Args:
        name: name of the scene.
        seed: random seed of the scene.
        seconds: duration [s].
        settings: settings of the tracker; None for the defaults.
        size_px: (width, height) of the images.
        fps: frame rate [Hz].
        keypoints: whether keypoints of the person are given beside the images, of `drawn_keypoints`.

    Raises:
        SettingsError: no such scene; names the known ones.
    """
    if name not in SEATED_SCENES:
        raise SettingsError(f"no scene {name!r}; known: {one_of(name, SEATED_SCENES)}")
    hard = SEATED_SCENES[name]
    scene = silhouette_scene(
        hard.motion, seed=seed, size_px=size_px, fps=fps, seconds=seconds, look=hard.look, corruption=hard.corruption,
        surroundings=hard.surroundings, outfit=hard.outfit, arc_deg=hard.arc_deg, loose_m=hard.loose_m,
    )  # fmt: skip
    joints, cameras = rough_joints(scene, hard.start_sd_m), list(scene.rig.cameras)
    mesh, between_ns = measured_body(scene, joints), round(NS_PER_S / fps)
    body = InitialBody(mesh, misplaced(mesh, pose_of(mesh, joints), hard.misplaced_rad, seed))
    rig = turned_rig(scene.rig, hard.rig_sd_rad, seed)
    tracker = SilhouettesTracker({ALONE: body}, rig, settings, sync=FrameSyncSettings(1.0 / fps))
    for k in range(EMPTY_IMAGES):
        empty = dict(zip(cameras, scene.background(k), strict=True))
        for arrival in arrivals_of(empty, 0, cameras=scene.rig.cameras, empty_room=True):
            tracker.update(arrival)
    errors, supported, visible, overlaps, left_out = [], [], [], list[float](), 0
    before: list[UInt8] = []
    for k in range(len(scene)):
        images = scene.images(k)
        shown = (
            [_interlaced(*pair) for pair in zip(before or images, images, strict=True)] if hard.interlaced else images
        )
        before = images
        points = drawn_keypoints(scene, k, k * between_ns) if keypoints else []
        fit = seen_at(tracker, dict(zip(cameras, shown, strict=True)), k * between_ns, k, points).bodies[ALONE].fit
        assert fit.supported is not None  # the tracker always tells
        errors.append(np.linalg.norm(fit.landmarks - scene.landmarks(k), axis=1))
        supported.append(fit.supported)
        visible.append(visible_share(scene, k))
        overlaps += [seen.overlap for seen in fit.seen.values()]
        left_out += len(fit.left_out)
    overlap = float(np.mean(overlaps)) if overlaps else float("nan")
    return SeatedRun(tuple(mesh.landmarks), np.array(errors), np.array(supported), np.array(visible), overlap, left_out)


def turned_rig(rig: CameraRig, sd_rad: float, seed: int) -> CameraRig:
    """Return a rig whose cameras are rotated by random errors about their own centres, of ``sd_rad`` an axis [rad]."""
    rng, placed = np.random.default_rng([seed, 62]), {}
    for name, one in rig.cameras.items():
        error = exp_twist(np.concatenate([np.zeros(3), sd_rad * rng.standard_normal(3)]))
        placed[name] = msgspec.structs.replace(one, T_camera_world=error @ one.T_camera_world)
    return CameraRig(placed)


def misplaced(mesh: RiggedMesh, pose: TreePose, sd_rad: float, seed: int) -> TreePose:
    """Return a pose with random errors of the angles of whole limbs, of ``sd_rad`` each; every second limb has errors.

    Args:
        mesh: the body's mesh.
        pose: the right pose.
        sd_rad: standard deviation of the errors; 0 for none [rad].
        seed: random seed of the scene.
    """
    rng, tree = np.random.default_rng([seed, 63]), mesh.tree
    angles = pose.angles.copy()
    for _, parts in limbs_of(tree):
        of_it = np.isin(tree.joint_parts, parts)
        if len(parts) > 1 and rng.random() < 0.5:
            angles[of_it] += sd_rad * rng.standard_normal(int(of_it.sum()))
    return TreePose(pose.T_world_model, np.clip(angles, *tree.limits.T))


def visible_share(scene: SilhouetteScene, k: int) -> Float64:
    """Return the share (landmarks,) of the first person's skin about each landmark that an image shows in truth.

    Of the images, that counts which shows most. The skin is that within `NEAR_M` of the landmark on the parts whose
    outline counts for it (`LimbSupport.parts`); the half that faces away is never shown. A landmark that is on no limb
    has 1.

    Args:
        scene: the simulated scene.
        k: index of the frame.
    """
    mesh = scene.mesh
    vertices, owner = posed(mesh, scene.pose(k)), mesh.bones[:, 0]
    parts_of, landmarks = LimbSupport(mesh).parts, scene.landmarks(k)
    out = np.array([0.0 if parts else 1.0 for parts in parts_of])
    for shown, placed in zip(scene.covered(k), scene.rig.cameras.values(), strict=True):
        height, width = shown.people.shape
        column, row = np.rint(pixels_of(vertices, eye(placed))).astype(np.int64).T
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
        part = np.where(inside & (shown.people[row, column] == 0), shown.parts[row, column], -1)
        for number, parts in enumerate(parts_of):
            if parts:
                near = np.isin(owner, parts) & (np.linalg.norm(vertices - landmarks[number], axis=1) < NEAR_M)
                out[number] = max(out[number], float(np.isin(part[near], parts).mean()))
    return out


def _share(these: Bool, of: Bool) -> float:
    """Return the share of ``these`` among ``of``; 0 if there are none."""
    return float(these[of].mean()) if of.any() else 0.0


def _interlaced(before: UInt8, image: UInt8) -> UInt8:
    """Return an image (height, width, 3) whose every second row is of the image before."""
    out = image.copy()
    out[1::2] = before[1::2]
    return out
