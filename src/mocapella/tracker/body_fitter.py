"""Fit one body model, parametrised by twists, to the images of several cameras, frame by frame.

    expected = predicted(before, last)                  extrapolate the motion
    contour  = region_contour(image, prior of expected) segment each image, with the model's outline as a prior
    given    = touching(outline, contour)               correspondences of outline and contour
    pose     = fit(given, smoothness(expected))         with the smoothness prior as a part of the estimate

The last three steps are iterated (B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless
Motion Capture", DAGM 2007). Lines of sight of keypoints, if there are any, are further constraints. See
docs/methods/silhouettes.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.geometry.signed_distance import signed_distance
from mocapella.kinematics.contact import apart
from mocapella.kinematics.limb_search import Evidence
from mocapella.kinematics.silhouette_fit import Eye, eye, see
from mocapella.kinematics.twist_fit import Constraints, FitSettings, Prior, fit
from mocapella.kinematics.twist_prediction import looser, predicted, smoothness
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh, farthest_apart_m, posed
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose, motions
from mocapella.sensing.dead_images import DeadImages
from mocapella.sensing.speckles import without_speckles
from mocapella.tracker.image_rejection import hides_the_body, shows_another_scene
from mocapella.tracker.keypoint_fit import KeypointFit
from mocapella.tracker.limb_recovery import LimbRecovery, with_angles
from mocapella.tracker.limb_stillness import HeldPoints, LimbStillness
from mocapella.tracker.limb_support import LimbSupport, OutlineEvidence
from mocapella.tracker.silhouette_body import SilhouetteBody, Standing
from mocapella.tracker.silhouette_camera import COARSE_M, USUAL_STEP_PX, SeenIn, SilhouetteCamera
from mocapella.tracker.silhouette_keypoints import BodyKeypoints
from mocapella.tracker.silhouette_settings import SilhouetteSettings, Steadiness
from mocapella.tracker.surface_prior import SurfacePrior

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

SAMPLES_HIGH = 200
"""Number of samples along the longer side of a body's window; a camera's stride follows from it."""
HALF_LIFE_S = 0.15
"""Half-life of an unseen part's predicted velocity [s]."""
SETTLING = 4
"""Factor of the number of pose fits (`SilhouetteSettings.rounds`) in the first frame, whose pose is rough."""


class FittedBody(msgspec.Struct, frozen=True, eq=False):
    """A body in one frame.

    Attributes:
        time_ns: capture time, on the common clock.
        pose: position and orientation of the body in the world, and its joint angles.
        landmarks: (n, 3) in the world [m], in the order of the mesh's landmarks.
        seen: contour and model outline, by camera whose image was used. Empty: the pose is the predicted one.
        left_out: the reason why an image was rejected, by camera. A camera may be in neither, because it gave no image
            or the body is outside.
        supported: (n,) bool, whether images or keypoints support each landmark (`limb_support.py`, `keypoint_fit.py`);
            None: unknown.
        contradicted: number of landmarks whose keypoints were left out, because every image contradicts them.
    """

    time_ns: int
    pose: TreePose
    landmarks: Float64
    seen: Mapping[str, SeenIn]
    left_out: Mapping[str, str]
    supported: Bool | None = None
    contradicted: int = 0


class BodyFitter:
    """Fits one body to images, starting from a rough pose: call `start`, then `update` for each frame.

    Args:
        mesh: the body's mesh.
        rig: the cameras' intrinsics and poses.
        settings: the settings of every stage; the defaults if None.

    Attributes:
        settings: the settings of every stage.
        mesh: the body's mesh.
        body: the mesh, with values for rendering and collisions that all frames share.
        eyes: intrinsics and extrinsics of the rig's cameras as arrays for rendering, by name.
    """

    def __init__(self, mesh: RiggedMesh, rig: CameraRig, settings: SilhouetteSettings | None = None) -> None:
        self.settings = settings or SilhouetteSettings()
        self.mesh = mesh
        self.body = SilhouetteBody(mesh)
        self._support = LimbSupport(mesh)
        self._stillness = LimbStillness(self.body)
        self._keypoints = KeypointFit(self.body, self.settings.keypoints)
        self._limb_recovery = None if self.settings.limbs is None else LimbRecovery(self.body, self.settings.limbs)
        self.eyes: dict[str, Eye] = {name: eye(placed) for name, placed in rig.cameras.items()}
        self._usual = np.clip(0.0, *mesh.tree.limits.T)
        self.reset()

    def reset(self) -> None:
        """Forget the pose and the backgrounds; `start` must follow."""
        self._past: list[tuple[int, TreePose]] = []
        self._cameras: dict[str, SilhouetteCamera] = {}
        self._dead = DeadImages()
        self._missed = self._as_expected = self._there = False
        self._hidden_parts = np.zeros(len(self.mesh.tree.parents), np.bool_)
        self._just_found = np.zeros(len(self.mesh.tree.joint_parts), np.bool_)
        self._stillness.reset()
        if self._limb_recovery is not None:
            self._limb_recovery.reset()

    def memory(self) -> list[Any]:
        """Return all state between two frames, for `recall` and a tracker's snapshot; after `start`.

        Its mutable values are shared, not copied.
        """
        limbs = None if self._limb_recovery is None else self._limb_recovery.memory()
        cameras = {name: camera.memory() for name, camera in self._cameras.items()}
        state = [self._past, self._missed, self._as_expected, self._there, self._hidden_parts, self._just_found]
        return [state, self._dead.memory(), self._surface.memory(), self._stillness.memory(), limbs, cameras]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same mesh, rig and settings."""
        state, dead, surface, stillness, limbs, cameras = memory
        self._past, self._missed, self._as_expected, self._there, self._hidden_parts, self._just_found = state
        self._dead.recall(dead)
        self._surface = SurfacePrior(self.body, self.settings.steadiness or Steadiness())
        self._surface.recall(surface)
        self._stillness.recall(stillness)
        if self._limb_recovery is not None:
            self._limb_recovery.recall(limbs)
        self._cameras = {
            name: SilhouetteCamera(self.eyes[name], one[0], self.settings) for name, one in cameras.items()
        }
        for name, camera in self._cameras.items():
            camera.recall(cameras[name])

    def start(self, pose: TreePose, time_ns: int, *, there: bool = False) -> None:
        """Begin to track from an approximate pose, without motion.

        Called again, for a lost body, it restarts there and keeps the cameras' strides and backgrounds.

        Args:
            pose: the approximate pose.
            time_ns: time of the pose, on the common clock; before that of the next frame.
            there: whether the person is certainly there: then whatever else differs from the learnt background in the
                next frame is a thing that came later, such as a chair, and no evidence of the body.

        Raises:
            SettingsError: no camera sees the body there, at the first start.
        """
        self._past, self._missed, self._as_expected, self._there = [(time_ns, pose)], False, False, there
        self._hidden_parts = np.zeros(len(self.mesh.tree.parents), np.bool_)
        self._just_found = np.zeros(len(self.mesh.tree.joint_parts), np.bool_)
        self._stillness.reset()
        self._surface = SurfacePrior(self.body, self.settings.steadiness or Steadiness())
        vertices, s = self.body.standing(pose).vertices, self.settings
        steps = {name: camera.step_px for name, camera in self._cameras.items()}
        for name, by in self.eyes.items():
            outline = None if name in steps else see(self.body.figure, vertices, by, step_px=1, margin_px=1)
            if outline is not None:
                steps[name] = s.step_px or max(1, round(max(outline.mask.shape) / SAMPLES_HIGH))
        if not steps:
            raise SettingsError("no camera of the rig sees a body that stands there; is the pose in the rig's space?")
        # It may walk into the other cameras' images.
        usual = round(float(np.median(list(steps.values()))))
        self._cameras = {
            name: self._cameras.get(name) or SilhouetteCamera(by, steps.get(name, usual), s)
            for name, by in self.eyes.items()
        }
        # While it was fitted elsewhere, the person was a thing in these images.
        for camera in self._cameras.values():
            camera.things.reset()
            camera.room_edges.reset()

    def learn_background(self, images: Mapping[str, UInt8]) -> None:
        """Learn the background from images of the empty room; after `start`. Moving cameras learn nothing.

        ``images`` are (height, width) or (height, width, 3) uint8 BGR, by camera; unknown cameras are ignored.

        Raises:
            InputError: an image of another size than before.
        """
        for name, image in images.items():
            background = self._cameras[name].background if name in self._cameras else None
            if background is not None:
                background.update(without_speckles(image), None)

    def expected(self, time_ns: int) -> TreePose:
        """Predict the pose at the time ``time_ns`` on the common clock, by extrapolating the motion; after `start`.

        Until the second frame with the body, the prediction is the last pose. The joint angles are within their limits.
        """
        (last_ns, last) = self._past[-1]
        if len(self._past) < 2:
            return last
        before_ns, before = self._past[-2]
        since_s, before_s = (time_ns - last_ns) / NS_PER_S, (last_ns - before_ns) / NS_PER_S
        # The predicted velocity of a part that is unseen for longer than usual decays.
        slowing = max(since_s - before_s, 0.0)
        since_s += HALF_LIFE_S / np.log(2) * (1.0 - 0.5 ** (slowing / HALF_LIFE_S)) - slowing
        local = self.body.local(last)
        pose = local.back(predicted(local.into(before), local.at, since_s / before_s))
        return TreePose(pose.T_world_model, np.clip(pose.angles, *self.mesh.tree.limits.T))

    def update(
        self,
        images: Mapping[str, UInt8],
        time_ns: int,
        others: Mapping[str, Bool] | None = None,
        *,
        keypoints: BodyKeypoints | None = None,
    ) -> FittedBody:
        """Fit the body to the next frame.

        Args:
            images: simultaneous images (height, width) or (height, width, 3) uint8 BGR, by camera; some may be missing.
            time_ns: capture time, on the common clock; after that of the last frame.
            others: (height, width) masks, by camera: pixels of other people, if any, which are no evidence for
                this body.
            keypoints: this body's keypoints at that time; None for none.

        Returns:
            The fitted body; if no image shows it, its pose is the predicted one, and ``seen`` is empty.

        Raises:
            InputError, SettingsError: an image of another type or shape, or of another size than before.
        """
        others = others or {}
        s = self.settings
        expected = pose = self.expected(time_ns)
        first = len(self._past) == 1
        wide = self._missed or (first and not self._known_at_start(self.body.standing(expected).vertices))
        rejects = s.rejection != "none"
        left_out = self._dead.update(images) if rejects else {}
        images = {name: without_speckles(image) for name, image in images.items()}
        held = self._held(images, left_out, time_ns, keypoints)
        usual, steady = self._priors(expected, time_ns, held)
        expected_at = self.body.standing(expected).vertices
        for camera in self._cameras.values():
            camera.forget_frame()
            camera.wide = wide
        there = {
            name: camera
            for name, camera in self._cameras.items()
            if name in images and name not in left_out and camera.look(self.body.figure, expected_at, s)
        }
        left_out |= shows_another_scene(there, images, left_out, s, time_ns) if rejects else {}
        usable = {name: image for name, image in images.items() if name in self._cameras and name not in left_out}
        there = {name: camera for name, camera in there.items() if name in usable}
        rounds, segmented = (s.rounds * SETTLING, s.rounds * SETTLING - 1) if first else (s.rounds, s.segmented)
        if self._missed and not first:
            rounds, segmented = 2 * rounds, 2 * rounds - 1
        sure = self._there
        if sure:
            self._stillness.certain(self.body.standing(expected))
            for name, camera in there.items():
                camera.forget_things(usable[name], others.get(name))
            self._there = not usable
        people, others = others, {**others, **_ignored(there, usable, others)}
        if not first:
            for name, camera in there.items():
                camera.segment(usable[name], others.get(name), near=self._as_expected or segmented == 1)
            hidden = hides_the_body(self._segmented(), left_out, s, time_ns) if rejects else {}
            for name, reason in hidden.items():
                left_out[name] = reason
                there[name].forget_frame()
                del usable[name]
        pose = self._fitted(
            usable, others, pose, priors=(usual, steady), rounds=rounds, segmented=segmented, begun=not first
        )
        if first and sure:
            pose = self._fitted_as_started(usable, others, pose, expected, rounds=rounds, segmented=segmented)
        pose = self._with_limbs_found(usable, others, pose, expected, time_ns, held=held)
        stands, seen = self.body.standing(pose), {}
        evidence = self._evidence(stands, people)
        shown, supported = self._supported(stands, evidence)
        self._as_expected = self._near(expected_at, stands.vertices, s.expected_steps)
        for name, one in evidence.items():
            camera, taken = self._cameras[name], people.get(name)
            seen[name] = msgspec.structs.replace(camera.seen(), shown=one.shown, stands_out=camera.stands_out(taken))
            camera.learn(images[name], taken)
        if seen:
            # The initial pose was rough: assume rest until motion is observed.
            last_ns, last = self._past[-1]
            self._past = [(last_ns, pose if first else last), (time_ns, pose)]
            self._surface.learn(stands)
        self._missed = not seen
        self._hidden_parts = self._support.hidden_parts(shown)
        return FittedBody(time_ns, pose, stands.landmarks, seen, left_out, supported, self._keypoints.contradicted)

    def _fitted(
        self,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        pose: TreePose,
        *,
        priors: tuple[Prior, Sequence[Prior]],
        rounds: int,
        segmented: int,
        begun: bool = False,
    ) -> TreePose:
        """Alternate segmentation and pose fit; initial segmentations may be given."""
        s, (usual, steady) = self.settings, priors
        beside_surface = steady
        if s.steadiness is not None and steady:
            beside_surface = (looser(steady[0], s.steadiness.beside_skin), *steady[1:])
        wide = any(camera.wide for camera in self._cameras.values())
        near, looked = self._as_expected and segmented == s.segmented, self.body.standing(pose).vertices
        number = 0
        while number < rounds:
            if (
                number == 1
                and segmented == s.segmented
                and self._near(looked, self.body.standing(pose).vertices, s.settled_steps)
            ):
                segmented, rounds = 1, max(rounds - 1, 2)
            again = number < segmented and not (begun and number == 0)
            for camera in self._cameras.values():
                camera.wide = wide and number < rounds // 2
            stands, local = self.body.standing(pose), self.body.local(pose)
            moved = motions(local.tree, local.at)
            given: list[Constraints] = []
            seeing = [name for name in images if self._cameras[name].look(self.body.figure, stands.vertices, s)]
            for name in seeing if again else ():
                self._cameras[name].segment(images[name], others.get(name), near=near or number == segmented - 1)
            if again or number == 0:
                self._keypoints.judge(self._segmented())
            given += [
                self._keypoints.counting(self._cameras[name].planes(moved), stands)
                for name in seeing
                if self._cameras[name].segmented
            ]
            held, outlines = steady, bool(given)
            if given and s.steadiness is not None:
                alone = len(given) == 1
                held = steady if alone else beside_surface
                given.append(self._surface.steady(stands, moved, held_alone=alone))
            given.append(apart(self.body.solid, stands.landmarks, moved))
            if outlines:
                given += self._keypoints.constraints(stands, moved)
            # An unseen part keeps its predicted motion; it is not drawn to its usual pose.
            local_priors = [local.into_prior(one) for one in held] + (
                [local.into_usual(usual)] if len(given) > 1 else []
            )
            pose = local.back(fit(local.tree, local.at, given, local_priors, FitSettings(most_steps=3)).pose)
            number += 1
        return pose

    def _with_limbs_found(
        self,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        pose: TreePose,
        expected: TreePose,
        time_ns: int,
        *,
        held: HeldPoints,
    ) -> TreePose:
        """Return the frame's pose with misplaced limbs recovered, except limbs that are as at a certain start."""
        s, recovery = self.settings, self._limb_recovery
        if recovery is None:
            return pose
        last = self._past[-1][1]
        # The pose of a start is not of the last image, and until the second fit the body is taken to be at rest.
        moving = not np.array_equal(last.angles, self._past[0][1].angles)
        found = recovery.found(
            pose, images, others, self._segmented(), self._settled(pose), last=last if moving else None,
        )  # fmt: skip
        if found is None:
            self._just_found = np.zeros_like(self._just_found)
            return pose
        joints, pose = found.joints, found.pose
        parts = self.mesh.tree.joint_parts[joints]
        self._stillness.release(parts)
        free = np.isin(self.body.figure.part[self.body.skin], parts)
        held = msgspec.structs.replace(held, points=held.points & ~free)
        # The wrong positions of a lost limb carry no information about its motion; one where it was found does, and
        # where the last images show it.
        unknown = joints[~self._just_found[joints]]
        self._past = [(at_ns, with_angles(past, unknown, found.before.angles)) for at_ns, past in self._past]
        self._just_found = np.isin(np.arange(len(self._just_found)), joints)
        priors = self._priors(with_angles(expected, joints, pose.angles), time_ns, held)
        return self._fitted(images, others, pose, priors=priors, rounds=s.rounds, segmented=s.segmented)

    def _settled(self, pose: TreePose) -> Bool:
        """Return the parts (parts,) that need no search: as at a certain start, or supported by keypoints."""
        by_keypoints = self._keypoints.supported_parts(self.body.standing(pose).landmarks)
        return (self._stillness.as_started & ~self._hidden_parts) | by_keypoints

    def _known_at_start(self, vertices: Float64) -> bool:
        """Return whether the person is certainly where the start says, in fine pictures of a room that is known.

        Then outlines farther away from the start's body are those of things that came later, not of limbs.

        Args:
            vertices: (n, 3) of the start's body, world [m].
        """
        middle, finest_m = vertices.mean(axis=0), np.inf
        for camera in self._cameras.values():
            if camera.background is not None and camera.background.known.any():
                finest_m = min(finest_m, camera.sample_at_m(middle))
        return self._there and finest_m <= COARSE_M

    def _fitted_as_started(
        self,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        pose: TreePose,
        started: TreePose,
        *,
        rounds: int,
        segmented: int,
    ) -> TreePose:
        """Return the first frame's pose, with parts that no image shows as at the start, which is certain."""
        stands = self.body.standing(pose)
        evidence = [*self._evidence(stands, {}).values()]
        shown = self._support.shown(stands.landmarks, evidence) | self._keypoints.supported(stands.landmarks)
        hidden = self._support.hidden_parts(shown)
        if not hidden.any():
            return pose
        points = hidden[self.body.figure.part[self.body.skin]]
        held = HeldPoints(points, self.body.standing(started).vertices[self.body.skin])
        priors = self._priors(started, self._past[-1][0], held)
        return self._fitted(images, others, started, priors=priors, rounds=rounds, segmented=segmented)

    def _supported(self, stands: Standing, evidence: Mapping[str, OutlineEvidence]) -> tuple[Bool, Bool]:
        """Return whether images show, and support, each landmark (n,), or keypoints do.

        Remember which images show which parts.
        """
        self._stillness.witness(
            {name: self._support.shown_parts(stands.landmarks, one) for name, one in evidence.items()}
        )
        shown = self._support.shown(stands.landmarks, [*evidence.values()])
        if not evidence:
            return shown, shown
        supported = self._support.supported(stands.landmarks, [*evidence.values()])
        free, known = ~self._keypoints.contested(stands.landmarks), self._keypoints.supported(stands.landmarks)
        return np.asarray((shown & free) | known), np.asarray((supported & free) | known)

    def _evidence(self, stands: Standing, people: Mapping[str, Bool]) -> dict[str, OutlineEvidence]:
        """Return how clearly each segmented image shows the body's outline, after a `look` for it where it stands.

        ``people`` are the masks (height, width) of other people, by camera.
        """
        return {
            name: camera.support(people.get(name), self._support.arms)
            for name, camera in self._segmented().items()
            if camera.look(self.body.figure, stands.vertices, self.settings)
        }

    def _segmented(self) -> dict[str, SilhouetteCamera]:
        """Return the cameras whose images of this frame were segmented and show the body."""
        return {name: camera for name, camera in self._cameras.items() if camera.segmented}

    def _near(self, these: Float64, those: Float64, steps: float) -> bool:
        """Return whether two vertex sets are at most ``steps`` samples of the segmentation apart."""
        nearest_m = min((camera.sample_m for camera in self._segmented().values()), default=0.0)
        return farthest_apart_m(these, those) <= steps * nearest_m

    def covered(self, pose: TreePose, grown_px: int = 0) -> dict[str, Bool]:
        """Return the mask (height, width) of the posed body in each camera, by name, dilated by ``grown_px`` [px].

        Where the body is outside the image, the mask is all False. The state does not change.
        """
        vertices, out = posed(self.mesh, pose), {}
        for name, by in self.eyes.items():
            step = self._cameras[name].step_px if name in self._cameras else USUAL_STEP_PX
            seen = see(self.body.figure, vertices, by, step_px=step, margin_px=grown_px + 2 * step)
            if seen is None:
                out[name] = np.zeros(by.size_px[::-1], np.bool_)
            else:
                phi = signed_distance(seen.mask, grown_px + step, step) + np.float32(grown_px)
                out[name] = Silhouette(seen.origin_px, step, phi).mask(by.size_px)
        return out

    def foreground(self, name: str, image: UInt8, others: Bool | None = None) -> Silhouette | None:
        """Segment the largest object that differs from a camera's background as learnt during tracking; after `start`.

        Args:
            name: name of the camera.
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) mask of other people, who are left out; None for none.

        Returns:
            The object, see `SilhouetteCamera.foreground`; None if there is none, or nothing is known.
        """
        camera = self._cameras.get(name)
        return None if camera is None else camera.foreground(without_speckles(image), others)

    def _held(
        self,
        images: Mapping[str, UInt8],
        left_out: Mapping[str, str],
        time_ns: int,
        keypoints: BodyKeypoints | None,
    ) -> HeldPoints:
        """Return the points of the body that are still, by the changes of the images; take the frame's keypoints.

        Parts that keypoints show elsewhere are not held.
        """
        expected = None if keypoints is None else self.body.standing(self.expected(time_ns))
        self._keypoints.begin(keypoints, expected)
        last = self.body.standing(self._past[-1][1])
        misplaced = self._keypoints.misplaced_parts(last)
        if len(misplaced):
            self._stillness.release(misplaced)
        used = {name: self._cameras[name] for name in images if name in self._cameras and name not in left_out}
        changes = {name: camera.changed(images[name], time_ns) for name, camera in used.items()}
        known = {name: one for name, one in changes.items() if one is not None}
        return self._stillness.update(last, known, len(used))

    def _priors(self, expected: TreePose, time_ns: int, held: HeldPoints) -> tuple[Prior, Sequence[Prior]]:
        """Return the prior of usual angles, and the priors of smooth motion."""
        s = self.settings
        weak = np.full(len(self._usual), s.usual_per_rad)
        # A limb that no image shows comes to rest where it is: a seated person's legs are not drawn to a stand.
        hidden = self._hidden_parts[self.mesh.tree.joint_parts]
        centre = np.where(hidden, self._past[-1][1].angles, self._usual)
        usual = Prior(TreePose(expected.T_world_model, centre), 0.0, 0.0, weak)
        if s.steadiness is None:
            return usual, ()
        if len(self._past) < 2:
            self._surface.hold(held)
            return usual, ()
        (before_ns, _), (last_ns, last) = self._past
        since_s, before_s = (time_ns - last_ns) / NS_PER_S, (last_ns - before_ns) / NS_PER_S
        per_s2 = 2.0 / (since_s * (since_s + before_s))
        stands = self.body.standing(expected)
        self._surface.expect(stands, since_s, per_s2, self._keypoints.away_m(stands))
        self._surface.hold(held)
        penalty = s.steadiness.penalty(per_s2)
        turns = np.zeros(len(self._usual))
        turns[self.body.balls.first + 2] = 1.0 / (s.steadiness.turn_rad_per_s * since_s)
        return usual, (smoothness(self.mesh.tree, expected, penalty), Prior(last, 0.0, 0.0, turns))


def _ignored(
    cameras: Mapping[str, SilhouetteCamera], images: Mapping[str, UInt8], people: Mapping[str, Bool]
) -> dict[str, Bool]:
    """Return the pixels (height, width) that are no evidence, of other people and passing things, by camera."""
    found = {name: camera.ignored(images[name], people.get(name)) for name, camera in cameras.items()}
    return {name: mask for name, mask in found.items() if mask is not None}


REMEMBERED: Final[tuple[type, ...]] = (TreePose, Evidence, Eye)
"""Classes in the state that `BodyFitter.memory` returns, for `mocapella.model.memory`."""
