"""The method ``silhouettes``: a body model in twists that several cameras' images are fitted with, frame by frame.

    expected = predicted(before, last)                  where it will be if it goes on as it did
    contour  = region_contour(image, prior of expected) in each camera: what the image says, the model's outline in mind
    given    = touching(outline, contour)               where the outlines want the body to be
    pose     = fit(given, smoothness(expected))         with the penalty on jitter inside the estimate

The last three are repeated (B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion
Capture", DAGM 2007). See docs/methods/silhouettes.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.geometry.distance_field import signed_distance
from mocapella.kinematics.silhouette_fit import (
    CorrespondenceSettings,
    Eye,
    Outline,
    eye,
    figure,
    see,
    touching,
)
from mocapella.kinematics.twist_fit import FitSettings, InPlanes, Prior, fit
from mocapella.kinematics.twist_prediction import JitterPenalty, predicted, smoothness
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, posed
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose, part_motions
from mocapella.sensing.region_contour import RegionSettings, region_contour
from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Steadiness:
    """The penalty on jitter, as the accelerations that people have: what is more costs.

    Attributes:
        root_m_per_s2: of the body's place [m/s²].
        root_rad_per_s2: of its orientation [rad/s²].
        angle_rad_per_s2: of a joint [rad/s²].
    """

    root_m_per_s2: float = 12.0
    root_rad_per_s2: float = 60.0
    angle_rad_per_s2: float = 90.0

    def __post_init__(self) -> None:
        for name in ("root_m_per_s2", "root_rad_per_s2", "angle_rad_per_s2"):
            check(0 < getattr(self, name) < np.inf, name, getattr(self, name), "above 0")

    def penalty(self, since_s: float, before_s: float) -> JitterPenalty:
        """For a frame ``since_s`` after the last, which was ``before_s`` after the one before [s]."""
        f = 2.0 / (since_s * (since_s + before_s))
        return JitterPenalty(f / self.root_m_per_s2, f / self.root_rad_per_s2, f / self.angle_rad_per_s2)


@dataclass(frozen=True)
class SilhouetteSettings:
    """The settings of every stage.

    Attributes:
        steadiness: the penalty on jitter; None: there is none.
        region: how an image is segmented.
        correspondences: how outlines are brought together.
        step_px: images are segmented at every so manieth pixel.
        margin_px: how far from where the body is expected its outline is looked for [px].
        rounds: how often a pose is fitted to a frame.
        segmented: in how many of these rounds, the first ones, the images are segmented.
        usual_per_rad: how little angles that nothing shows stray from the resting pose [1/rad].
    """

    steadiness: Steadiness | None = field(default_factory=Steadiness)
    region: RegionSettings = field(default_factory=RegionSettings)
    correspondences: CorrespondenceSettings = field(default_factory=CorrespondenceSettings)
    step_px: int = 2
    margin_px: int = 24
    rounds: int = 3
    segmented: int = 1
    usual_per_rad: float = 0.5

    def __post_init__(self) -> None:
        check(self.step_px >= 1, "step_px", self.step_px, "1 or more")
        check(self.margin_px >= 4, "margin_px", self.margin_px, "4 px or more")
        check(self.rounds >= 1, "rounds", self.rounds, "1 or more")
        check(1 <= self.segmented <= self.rounds, "segmented", self.segmented, f"1 to {self.rounds}")
        check(self.usual_per_rad >= 0, "usual_per_rad", self.usual_per_rad, "0 or more")


class SeenIn(msgspec.Struct, frozen=True, eq=False):
    """A body in one camera's image.

    Attributes:
        contour: what was segmented.
        outline: of the posed mesh.
        overlap: intersection over union of both.
    """

    contour: Silhouette
    outline: Outline
    overlap: float


class Followed(msgspec.Struct, frozen=True, eq=False):
    """A body in one frame.

    Attributes:
        time_ns: of capture.
        pose: see there.
        landmarks: (n, 3) [m], in the order of the mesh's.
        seen: by camera; those that see nothing of it are left out.
        steps: of all fits.
    """

    time_ns: int
    pose: TreePose
    landmarks: Float64
    seen: Mapping[str, SeenIn]
    steps: int


class SilhouetteTracker:
    """One body, from a pose in which it roughly is."""

    def __init__(self, mesh: RiggedMesh, rig: CameraRig, settings: SilhouetteSettings | None = None) -> None:
        self.settings = settings or SilhouetteSettings()
        self.mesh = mesh
        self._figure = figure(mesh)
        self._eyes: dict[str, Eye] = {name: eye(placed) for name, placed in rig.cameras.items()}
        self._usual = np.clip(0.0, *mesh.tree.limits.T)
        self.reset()

    def reset(self) -> None:
        """Forget where it is."""
        self._past: list[tuple[int, TreePose]] = []
        self._contours: dict[str, Silhouette] = {}

    def start(self, pose: TreePose, time_ns: int) -> None:
        """It is about there, and at rest."""
        self.reset()
        self._past = [(time_ns, pose)]

    def expected(self, time_ns: int) -> TreePose:
        """Where it will be if it goes on as it did."""
        (last_ns, last) = self._past[-1]
        if len(self._past) < 2:
            return last
        before_ns, before = self._past[-2]
        pose = predicted(before, last, (time_ns - last_ns) / (last_ns - before_ns))
        return TreePose(pose.T_world_model, np.clip(pose.angles, *self.mesh.tree.limits.T))

    def update(self, images: Mapping[str, UInt8], time_ns: int) -> Followed:
        """The body in the next frame: images of one instant, by camera."""
        s, tree = self.settings, self.mesh.tree
        expected = pose = self.expected(time_ns)
        priors = self._priors(expected, time_ns)
        contours: dict[str, tuple[Silhouette, NDArray[np.float32]]] = {}
        windows: dict[str, Outline] = {}
        steps = 0
        for number in range(s.rounds):
            seen = self._see(pose, windows)
            windows = windows or seen
            if number < s.segmented:
                contours = self._segment(images, seen)
            given = self._touching(pose, seen, contours)
            found = fit(tree, pose, given, priors, FitSettings(most_steps=3))
            pose, steps = found.pose, steps + found.steps
        seen = self._see(pose, windows)
        self._past = [*self._past[-1:], (time_ns, pose)]
        self._contours = {name: contour for name, (contour, _) in contours.items()}
        return Followed(time_ns, pose, landmarks_at(self.mesh, pose), _overlaps(seen, contours), steps)

    def _priors(self, expected: TreePose, time_ns: int) -> list[Prior]:
        s = self.settings
        usual = Prior(
            TreePose(expected.T_world_model, self._usual), 0.0, 0.0, np.full(len(self._usual), s.usual_per_rad)
        )
        if s.steadiness is None or len(self._past) < 2:
            return [usual]
        (before_ns, _), (last_ns, _) = self._past
        penalty = s.steadiness.penalty((time_ns - last_ns) / NS_PER_S, (last_ns - before_ns) / NS_PER_S)
        return [usual, smoothness(self.mesh.tree, expected, penalty)]

    def _see(self, pose: TreePose, windows: Mapping[str, Outline]) -> dict[str, Outline]:
        vertices = posed(self.mesh, pose)
        s, found = self.settings, {}
        for name, by in self._eyes.items():
            outline = see(
                self._figure, vertices, by, s.step_px, s.margin_px, s.correspondences.spacing_px, windows.get(name)
            )
            if outline is not None:
                found[name] = outline
        return found

    def _segment(
        self, images: Mapping[str, UInt8], seen: Mapping[str, Outline]
    ) -> dict[str, tuple[Silhouette, NDArray[np.float32]]]:
        s, found = self.settings, {}
        for name, outline in seen.items():
            if name not in images:
                continue
            phi = signed_distance(outline.mask, s.margin_px / s.step_px) * np.float32(s.step_px)
            prior = Silhouette(outline.origin_px, s.step_px, phi)
            if images[name].dtype == np.bool_:
                raise NotImplementedError
            contour = region_contour(images[name], prior, settings=s.region)
            found[name] = (contour.silhouette, contour.surety)
        return found

    def _touching(
        self,
        pose: TreePose,
        seen: Mapping[str, Outline],
        contours: Mapping[str, tuple[Silhouette, NDArray[np.float32]]],
    ) -> list[InPlanes]:
        T = part_motions(self.mesh.tree, pose)
        motions = np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 9), np.ascontiguousarray(T[:, :3, 3])
        s, given = self.settings, []
        for name, (contour, surety) in contours.items():
            if name in seen:
                given.append(
                    touching(
                        seen[name], motions, contour.phi, surety, self._eyes[name], float(s.margin_px), s.correspondences
                    )
                )
        return given


def _overlaps(
    seen: Mapping[str, Outline], contours: Mapping[str, tuple[Silhouette, NDArray[np.float32]]]
) -> dict[str, SeenIn]:
    found = {}
    for name, (contour, _) in contours.items():
        if name in seen:
            a, b = contour.phi > 0, seen[name].mask > 0
            union = np.count_nonzero(a | b)
            found[name] = SeenIn(contour, seen[name], np.count_nonzero(a & b) / union if union else 0.0)
    return found
