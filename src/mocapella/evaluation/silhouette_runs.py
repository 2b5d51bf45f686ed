"""Run the method ``silhouettes`` on rendered scenes with ground truth, with any body, corruption and penalty.

    film = filmed(silhouette_scene("runner", seed=100))
    joints = rough_joints(film.scene)
    run = follow(film, BODIES["measured"](film.scene, joints), joints, corruption=Corruption(noise=0.15))
    score(run.movement, film.truth)

Images are rendered once, and corrupted when they are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.evaluation.silhouettes import Movement
from mocapella.kinematics.landmark_pose import pose_of
from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.body_meshes import body_mesh
from mocapella.model.body_proportions import Sex, proportions_of
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.silhouettes import overlap
from mocapella.model.twist_tree import TreePose
from mocapella.recording.bodies_file import ALONE
from mocapella.settings import check
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_scene import SilhouetteScene
from mocapella.tracker.frame_sync import FrameSyncSettings
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouette_settings import SilhouetteSettings, Steadiness
from mocapella.tracker.silhouette_views import SeenInstant
from mocapella.tracker.silhouettes import SilhouettesTracker

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Joints = Mapping[str, Float64]

ROUGH_M: Final = 0.02
"""Standard deviation of the initial joints, along each axis [m]."""
EVERY: Final = 10
"""Stride of the frames whose masks are compared."""


class Film(msgspec.Struct, frozen=True, eq=False):
    """A rendered scene.

    Attributes:
        scene: the simulated scene, without corruption.
        images: for each frame, the image (height, width, 3) uint8 BGR of each camera.
        truth: the true motion in these frames.
    """

    scene: SilhouetteScene
    images: Sequence[Mapping[str, UInt8]]
    truth: Movement

    def shown(self, frame: int, corruption: Corruption | None = None) -> Mapping[str, UInt8]:
        """Return the images of a frame by camera, with the corruption applied; if None, the film's own arrays."""
        images = self.images[frame]
        if corruption is None:
            return images
        return {name: corruption.of(image, frame, k) for k, (name, image) in enumerate(images.items())}


class FollowedRun(msgspec.Struct, frozen=True, eq=False):
    """The tracker's result for one body over a film.

    Attributes:
        movement: the estimated poses.
        left_out: indices of the frames where no camera contributed to the fit.
        lost: indices of the frames where the body was lost.
        seconds: (frames,) computing time of each update [s]; 0 without a clock.
    """

    movement: Movement
    left_out: tuple[int, ...]
    lost: tuple[int, ...]
    seconds: Float64


def filmed(scene: SilhouetteScene, seconds: float | None = None) -> Film:
    """Render a scene, or its first ``seconds`` [s], with its ground truth.

    Raises:
        SettingsError: the scene has a corruption, or the duration is below three frames.
    """
    check(scene.corruption is None, "corruption of a scene", scene.corruption, "None; it is given with each run")
    frames, fps = len(scene), 1.0 / float(scene.times_s[1] - scene.times_s[0])
    if seconds is not None:
        # Rounded: the rate is of differences of times, and three frames must not be less than three.
        check(round(seconds * fps, 6) >= 3, "seconds", seconds, f"3 frames or more, {3 / fps:.3f} s")
        frames = min(frames, round(seconds * fps))
    images = [dict(zip(scene.rig.cameras, scene.images(k), strict=True)) for k in range(frames)]
    return Film(scene, images, Movement(scene.mesh, scene.poses(), fps).first(frames))


def rough_joints(scene: SilhouetteScene, sd_m: float = ROUGH_M) -> dict[str, Float64]:
    """Return the landmarks (3,) of the first frame in the world, by name, with noise of sd ``sd_m`` per axis [m]."""
    rng = np.random.default_rng([scene.seed, 61])
    places = scene.landmarks(0)
    return dict(zip(scene.mesh.landmarks, places + rng.normal(0.0, sd_m, places.shape), strict=True))


def own_body(scene: SilhouetteScene, joints: Joints) -> RiggedMesh:
    """Return the mesh of the scene's first person, as an ideal scan would measure it; ``joints`` is not used."""
    return scene.mesh


def measured_body(scene: SilhouetteScene, joints: Joints) -> RiggedMesh:
    """Return a body model of the sex of the scene's first person, with proportions measured from joints.

    Args:
        scene: the simulated scene.
        joints: rough positions (3,) of the landmarks in one frame [m], by name, as of `rough_joints`.
    """
    return body_mesh(cast(Sex, scene.mesh.name), None, proportions_of(joints))


BODIES: Final[dict[str, Callable[[SilhouetteScene, Joints], RiggedMesh]]] = {"own": own_body, "measured": measured_body}
"""Functions that make the tracked body from a scene and rough joints, by name."""


def with_penalty(weight: float, settings: SilhouetteSettings | None = None) -> SilhouetteSettings:
    """Return the settings (None: the defaults) with the penalty on jitter multiplied by ``weight``; 0 for none.

    The result is a copy.

    Raises:
        SettingsError: the weight is negative or infinite.
    """
    check(0 <= weight < np.inf, "weight", weight, "0 or more")
    settings = settings or SilhouetteSettings()
    usual = settings.steadiness or Steadiness()
    if weight == 0:
        return replace(settings, steadiness=None)
    return replace(settings, steadiness=usual.times(weight))


def follow(
    film: Film,
    mesh: RiggedMesh,
    joints: Joints,
    settings: SilhouetteSettings | None = None,
    *,
    corruption: Corruption | None = None,
    clock: Callable[[], float] = lambda: 0.0,
) -> FollowedRun:
    """Track the first person of a film by the method ``silhouettes``.

    Args:
        film: the rendered scene.
        mesh: the body model.
        joints: rough positions (3,) in the first frame, world [m], by name.
        settings: settings of the tracker; None for the defaults.
        corruption: corruption of the images; None for none.
        clock: function that measures the computing time, such as `time.perf_counter` [s].
    """
    between_ns = round(NS_PER_S / film.truth.fps)
    tracker = alone(mesh, joints, film.scene.rig, settings, period_s=between_ns / NS_PER_S)
    poses, blind, lost, took = [], [], [], []
    for k in range(len(film.images)):
        images = film.shown(k, corruption)
        begin = clock()
        body = seen_at(tracker, images, k * between_ns, k).bodies[ALONE]
        took.append(clock() - begin)
        poses.append(body.fit.pose)
        blind += [] if body.fit.seen else [k]
        lost += [k] if body.lost else []
    batch = TreePose(np.array([pose.T_world_model for pose in poses]), np.array([pose.angles for pose in poses]))
    return FollowedRun(Movement(mesh, batch, film.truth.fps), tuple(blind), tuple(lost), np.array(took))


def alone(
    mesh: RiggedMesh, joints: Joints, rig: CameraRig, settings: SilhouetteSettings | None = None, *, period_s: float
) -> SilhouettesTracker:
    """Make a tracker of the method ``silhouettes`` for one body, named `ALONE`, whose initial pose is fitted to joints.

    Args:
        mesh: the body's mesh.
        joints: positions (3,) in the world [m], by name; joints that are no landmarks of the mesh are ignored.
        rig: the cameras.
        settings: settings of the fit; None for the defaults.
        period_s: time between two frames [s].
    """
    pose = pose_of(mesh, {name: at for name, at in joints.items() if name in mesh.landmarks})
    return SilhouettesTracker({ALONE: InitialBody(mesh, pose)}, rig, settings, sync=FrameSyncSettings(period_s))


def seen_at(
    tracker: SilhouettesTracker,
    images: Mapping[str, UInt8],
    time_ns: int,
    number: int,
    keypoints: Sequence[KeypointFrame] = (),
) -> SeenInstant:
    """Pass the images of all cameras at one instant to the tracker, and return its result.

    Args:
        tracker: the tracker, which is updated.
        images: (height, width, 3) uint8 BGR, by camera.
        time_ns: capture time, on the common clock.
        number: number of the frame.
        keypoints: people's keypoints in these images.
    """
    for frame in keypoints:
        tracker.update(Arrival(frame, time_ns))
    for arrival in arrivals_of(images, time_ns, cameras=tracker.rig.cameras, number=number):
        tracker.update(arrival)
    assert tracker.seen is not None  # every camera has given its image
    return tracker.seen


def overlaps(film: Film, movement: Movement, every: int = EVERY) -> Float64:
    """Return the intersection over union (compared frames, cameras) of the posed mesh and the true mask.

    Frames 0, ``every``, 2 · ``every``, … are compared. A camera that sees neither has 1, one that sees one of them 0.
    """
    body, out = figure(movement.mesh), []
    for k in range(0, len(movement), every):
        vertices = posed(movement.mesh, TreePose(movement.poses.T_world_model[k], movement.poses.angles[k]))
        row = []
        for placed, true in zip(film.scene.rig.cameras.values(), film.scene.masks(k), strict=True):
            outline = see(body, vertices, eye(placed), step_px=1, margin_px=2)
            mesh = np.zeros_like(true) if outline is None else outline.silhouette.mask((true.shape[1], true.shape[0]))
            row.append(overlap(mesh, true) if mesh.any() or true.any() else 1.0)
        out.append(row)
    return np.array(out)
