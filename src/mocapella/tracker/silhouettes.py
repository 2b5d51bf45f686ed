"""The method ``silhouettes``: a body model in twists that several cameras' images are fitted with, frame by frame.

    expected = predicted(before, last)                  where it will be if it goes on as it did
    contour  = region_contour(image, prior of expected) in each camera: what the image says, the model's outline in mind
    given    = touching(outline, contour)               where the outlines want the body to be
    pose     = fit(given, smoothness(expected))         with the penalty on jitter inside the estimate

The last three are repeated (B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion
Capture", DAGM 2007). See docs/methods/silhouettes.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.geometry.signed_distance import signed_distance
from mocapella.kinematics.ball_joints import LocalTree, ball_joints, local_tree
from mocapella.kinematics.contact import apart, depth_m
from mocapella.kinematics.limb_search import (
    TOUCHING_M,
    Evidence,
    Limb,
    LimbSearchSettings,
    lasting,
    limbs,
    search,
    without,
)
from mocapella.kinematics.silhouette_fit import (
    CorrespondenceSettings,
    Eye,
    Figure,
    Outline,
    eye,
    figure,
    see,
    seen_at,
    touching,
)
from mocapella.kinematics.twist_fit import FitSettings, InPlanes, Prior, fit
from mocapella.kinematics.twist_prediction import JitterPenalty, predicted, smoothness
from mocapella.model.body_capsules import capsules_of
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh, carried, posed
from mocapella.model.silhouettes import Silhouette, overlap
from mocapella.model.twist_tree import TreePose, motions
from mocapella.sensing.background_memory import BackgroundMemory, MemorySettings
from mocapella.sensing.region_contour import RegionSettings, region_contour
from mocapella.settings import check

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

SAMPLES_HIGH = 200
"""About so many samples a body is high in an image."""
LEAST_CONTRAST = 6
"""An image whose values differ by no more is all of one colour [grey levels]."""
MOST_AT_FIRST = 0.6
"""Before it is known how much of a background differs from image to image, so much may."""
LEAST_JUMP, BEYOND = 0.04, 6.0
"""If in half of the cameras more than this, and so many usual deviations, of a background differs all at once, what was
stored is wrong."""
LEARNT = 0.2
"""How fast what usually differs is learnt."""
HALF_LIFE_S = 0.15
"""How long what nobody sees goes on as it did, until it is half as fast [s]."""
SETTLING = 4
"""How many times as many rounds the first frame has, whose pose is rough."""
WIDE = 2.0
"""In the first half of these, outlines are looked for so many times as far away."""
FARTHER, EVERY = 0.3, 3
"""A limb is looked for in so much more than the body's window, at every so manieth sample."""
EVERY_LIMB = 6
"""After so many frames the next limb is looked for, even if nothing speaks against where it is."""
LOOSE = 1e-3
"""How much the middle of a limb counts against its axes."""
STRETCHED = 1.1
"""How much farther than at rest a limb may reach."""
NEAREST_LIMB_M = 0.3
"""Nearer than this to a camera a limb may be anywhere in its image [m]."""
USUAL_STEP_PX = 2
"""For which a region's settings in pixels hold; other steps have them scaled."""


@dataclass(frozen=True)
class Steadiness:
    """The penalty on jitter, as the accelerations that people have: what is more costs.

    Attributes:
        root_m_per_s2: of the body's place [m/s²].
        root_rad_per_s2: of its orientation [rad/s²].
        angle_rad_per_s2: of a joint [rad/s²].
        turn_rad_per_s: of a limb about itself, which hardly shows where it is straight: not the acceleration, the speed
            [rad/s].
    """

    root_m_per_s2: float = 20.0
    root_rad_per_s2: float = 150.0
    angle_rad_per_s2: float = 150.0
    turn_rad_per_s: float = 3.0

    def __post_init__(self) -> None:
        for name in ("root_m_per_s2", "root_rad_per_s2", "angle_rad_per_s2", "turn_rad_per_s"):
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
        region: how an image is segmented, for samples of two pixels.
        closer: the same where the body is nearly where it should be: the last time that a frame is segmented.
        background: how what is behind people is learnt; None: it is not, as where cameras move.
        limbs: how a limb that went astray is looked for; None: it is not.
        correspondences: how outlines are brought together.
        step_px: images are looked at in squares of so many pixels; 0: so that a body is about 200 of them high.
        margin_steps: how far from where the body is expected its outline is looked for.
        rounds: how often a pose is fitted to a frame; once less where the first time did not move the body.
        segmented: in how many of these rounds, the first ones, the images are segmented; once where that did not move
            the body.
        expected_steps: a body that is so near to where it was expected, in samples, is as expected.
        usual_per_rad: how little angles that nothing shows stray from the resting pose [1/rad].
        unlike: a camera of whose background more than this share of what usually is as it was is not, shows something
            else.
        something_else_s: after so long it is taken for a new background: the light changed, or the camera moved [s].
    """

    steadiness: Steadiness | None = field(default_factory=Steadiness)
    region: RegionSettings = field(default_factory=lambda: RegionSettings(band_px=16.0, length_weight=3.0))
    closer: RegionSettings = field(
        default_factory=lambda: RegionSettings(prior_weight=0.2, band_px=8.0, window_px=16.0, length_weight=3.0)
    )
    background: MemorySettings | None = field(default_factory=MemorySettings)
    limbs: LimbSearchSettings | None = field(default_factory=LimbSearchSettings)
    correspondences: CorrespondenceSettings = field(default_factory=CorrespondenceSettings)
    step_px: int = 0
    margin_steps: int = 12
    rounds: int = 3
    segmented: int = 2
    expected_steps: float = 1.0
    usual_per_rad: float = 3.0
    unlike: float = 0.2
    something_else_s: float = 0.5

    def __post_init__(self) -> None:
        check(self.step_px >= 0, "step_px", self.step_px, "0 or more")
        check(2 <= self.margin_steps <= 100, "margin_steps", self.margin_steps, "2 to 100")
        check(self.rounds >= 1, "rounds", self.rounds, "1 or more")
        check(1 <= self.segmented <= self.rounds, "segmented", self.segmented, f"1 to {self.rounds}")
        check(self.expected_steps >= 0, "expected_steps", self.expected_steps, "0 or more")
        check(self.usual_per_rad >= 0, "usual_per_rad", self.usual_per_rad, "0 or more")
        check(0 < self.unlike <= 1, "unlike", self.unlike, "above 0 and at most 1")
        check(self.something_else_s > 0, "something_else_s", self.something_else_s, "above 0 s")


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
        seen: by camera.
        left_out: by camera, why its image did not count.
    """

    time_ns: int
    pose: TreePose
    landmarks: Float64
    seen: Mapping[str, SeenIn]
    left_out: Mapping[str, str]


class SilhouetteTracker:
    """One body, from a pose in which it roughly is."""

    def __init__(self, mesh: RiggedMesh, rig: CameraRig, settings: SilhouetteSettings | None = None) -> None:
        self.settings = settings or SilhouetteSettings()
        self.mesh = mesh
        self._figure = figure(mesh)
        self._balls = ball_joints(mesh.tree)
        self._solid = capsules_of(mesh)
        self._limbs = () if self.settings.limbs is None else limbs(mesh, self.settings.limbs)
        self._eyes: dict[str, Eye] = {name: eye(placed) for name, placed in rig.cameras.items()}
        self._usual = np.clip(0.0, *mesh.tree.limits.T)
        marks, count = mesh.landmarks.values(), len(mesh.landmarks)
        self._marks = (
            np.array([mark.point for mark in marks], np.float64).reshape(count, 3),
            np.array([[mark.part] for mark in marks], np.int32).reshape(count, 1),
            np.ones((count, 1)),
        )
        self._hung = tuple(_hung(mesh, limb) for limb in self._limbs)
        asked = [limb.vertices for limb in self._limbs]
        self._asked = np.concatenate(asked) if asked else np.empty(0, np.int64)
        self._asked_from = np.cumsum([0, *(len(some) for some in asked)])
        self.reset()

    def reset(self) -> None:
        """Forget where it is, and what is behind it."""
        self._rng = np.random.default_rng(0)
        self._turn = 0
        self._doubted: set[str] = set()
        self._evidence: dict[str, Evidence] = {}
        self._past: list[tuple[int, TreePose]] = []
        self._stood: _Standing | None = None
        self._cameras: dict[str, _Camera] = {}
        self._missed = False
        self._as_expected = False

    def start(self, pose: TreePose, time_ns: int) -> None:
        """It is about there, and at rest.

        Raises:
            SettingsError: no camera sees it there.
        """
        self._past, self._missed, self._as_expected = [(time_ns, pose)], False, False
        vertices, s = self._standing(pose).vertices, self.settings
        steps = {name: camera.step_px for name, camera in self._cameras.items()}
        for name, by in self._eyes.items():
            outline = None if name in steps else see(self._figure, vertices, by, step_px=1, margin_px=1)
            if outline is not None:
                steps[name] = s.step_px or max(1, round(max(outline.mask.shape) / SAMPLES_HIGH))
        if not steps:
            raise SettingsError("no camera of the rig sees a body that stands there; is the pose in the rig's space?")
        # Into the images of others it may walk.
        usual = round(float(np.median(list(steps.values()))))
        self._cameras = {
            name: self._cameras.get(name) or _Camera(by, steps.get(name, usual), s) for name, by in self._eyes.items()
        }

    def learn_background(self, images: Mapping[str, UInt8]) -> None:
        """Take in images of the empty room, by camera; after `start`. Cameras that move learn nothing.

        Raises:
            InputError: an image of another size than before.
        """
        for name, image in images.items():
            memory = self._cameras[name].memory if name in self._cameras else None
            if memory is not None:
                memory.update(image, None)

    def expected(self, time_ns: int) -> TreePose:
        """Where it will be if it goes on as it did."""
        (last_ns, last) = self._past[-1]
        if len(self._past) < 2:
            return last
        before_ns, before = self._past[-2]
        since_s, before_s = (time_ns - last_ns) / NS_PER_S, (last_ns - before_ns) / NS_PER_S
        # What nobody sees for longer than usual goes on ever more slowly.
        slowing = max(since_s - before_s, 0.0)
        since_s += HALF_LIFE_S / np.log(2) * (1.0 - 0.5 ** (slowing / HALF_LIFE_S)) - slowing
        local = self._local(last)
        pose = local.back(predicted(local.into(before), local.at, since_s / before_s))
        return TreePose(pose.T_world_model, np.clip(pose.angles, *self.mesh.tree.limits.T))

    def update(self, images: Mapping[str, UInt8], time_ns: int, others: Mapping[str, Bool] | None = None) -> Followed:
        """The body in the next frame.

        Args:
            images: of one instant, by camera: (height, width) or (height, width, 3) uint8.
            time_ns: of capture.
            others: (height, width) by camera, where other people are: what is seen there says nothing of this one.
        """
        others = others or {}
        s = self.settings
        expected = pose = self.expected(time_ns)
        expected_at = self._standing(expected).vertices
        usual, steady = self._priors(expected, time_ns)
        first = len(self._past) == 1
        wide = first or self._missed
        left_out = self._unusable(images)
        for camera in self._cameras.values():
            camera.forget_frame()
            camera.wide = wide
        left_out |= self._something_else(images, left_out, expected_at, time_ns)
        rounds, segmented = (s.rounds * SETTLING, s.rounds * SETTLING - 1) if first else (s.rounds, s.segmented)
        if self._missed and not first:
            rounds, segmented = 2 * rounds, 2 * rounds - 1
        pose = self._fitted(images, others, left_out, pose, priors=(usual, steady), rounds=rounds, segmented=segmented)
        found = self._strays(images, others, left_out, pose)
        if found is not None:
            joints, pose = found
            # Where such a limb was says nothing of how it moves.
            self._past = [(at_ns, _with(past, joints, pose.angles)) for at_ns, past in self._past]
            usual, steady = self._priors(_with(expected, joints, pose.angles), time_ns)
            pose = self._fitted(
                images, others, left_out, pose, priors=(usual, steady), rounds=s.rounds, segmented=s.segmented
            )
        stands, seen = self._standing(pose), {}
        self._as_expected = self._near(expected_at, stands.vertices)
        for name, camera in self._cameras.items():
            if name in images and camera.segmented and camera.look(self._figure, stands.vertices, s):
                seen[name] = camera.seen()
                camera.learn(images[name], others.get(name))
        if seen:
            # Where it was thought to be before the first frame was rough: it is at rest, until it is seen to move.
            last_ns, last = self._past[-1]
            self._past = [(last_ns, pose if first else last), (time_ns, pose)]
        self._missed = not seen
        return Followed(time_ns, pose, stands.landmarks, seen, left_out)

    def _fitted(
        self,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        left_out: Mapping[str, str],
        pose: TreePose,
        *,
        priors: tuple[Prior, Sequence[Prior]],
        rounds: int,
        segmented: int,
    ) -> TreePose:
        """Outlines, and the pose that they want, again and again."""
        s, (usual, steady) = self.settings, priors
        wide = any(camera.wide for camera in self._cameras.values())
        near, looked = self._as_expected and segmented == s.segmented, self._standing(pose).vertices
        for number in range(rounds):
            again = number < segmented
            if number == 1 and segmented == s.segmented and self._near(looked, self._standing(pose).vertices):
                segmented, rounds, again = 1, max(rounds - 1, 2), False
            for camera in self._cameras.values():
                camera.wide = wide and number < rounds // 2
            stands, local = self._standing(pose), self._local(pose)
            moved = motions(local.tree, local.at)
            given = []
            for name, camera in self._cameras.items():
                if name not in images or name in left_out or not camera.look(self._figure, stands.vertices, s):
                    continue
                if again:
                    camera.segment(images[name], others.get(name), near=near or number == segmented - 1)
                if camera.segmented:
                    given.append(camera.planes(moved))
            given.append(apart(self._solid, stands.landmarks, moved))
            # What nobody sees goes on as it did, not to where it usually is.
            local_priors = [local.into_prior(one) for one in steady] + (
                [local.into_usual(usual)] if len(given) > 1 else []
            )
            pose = local.back(fit(local.tree, local.at, given, local_priors, FitSettings(most_steps=3)).pose)
        return pose

    def _near(self, these: Float64, those: Float64) -> bool:
        """Whether vertices are about as far as samples are apart, of what was segmented."""
        away_m = float(np.sqrt(((these - those) ** 2).sum(axis=1).max()))
        nearest_m = min((camera.sample_m for camera in self._cameras.values() if camera.segmented), default=0.0)
        return away_m <= self.settings.expected_steps * nearest_m

    def _strays(
        self,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        left_out: Mapping[str, str],
        pose: TreePose,
    ) -> tuple[NDArray[np.int64], TreePose] | None:
        """Joints of limbs that are rather elsewhere, and where.

        What the images before showed is asked, too; so only limbs that were doubtful there are looked for.
        """
        s = self.settings
        if s.limbs is None or not self._limbs:
            return None
        self._turn += 1
        stands = self._standing(pose)
        seeing = {
            name: camera
            for name, camera in self._cameras.items()
            if name in images
            and name not in left_out
            and camera.segmented
            and camera.memory is not None
            # Of who leaves an image limbs are doubtful that are only outside of it.
            and camera.shows_all(stands.vertices)
        }
        doubtful = self._doubtful(images, seeing, stands)
        # One after the other is looked for where it need not be: limbs hide behind a body, too.
        in_turn = self._limbs[self._turn // EVERY_LIMB % len(self._limbs)].name if self._turn % EVERY_LIMB == 0 else ""
        wanted, before = doubtful | {in_turn}, self._doubted
        self._doubted = (
            doubtful | {self._limbs[(self._turn + 1) // EVERY_LIMB % len(self._limbs)].name}
            if ((self._turn + 1) % EVERY_LIMB == 0)
            else doubtful
        )
        now = (
            {name: camera.evidence(images[name], others.get(name), about) for name, camera in seeing.items()}
            if (about := self._about(self._doubted | (wanted & before), pose))
            else {}
        )
        then, self._evidence = self._evidence, now
        evidence = [lasting(one, then[name]) for name, one in now.items() if name in then]
        moved: list[NDArray[np.int64]] = []
        for limb in self._limbs if len(evidence) > 1 else ():  # one camera's word is not enough
            if limb.name not in wanted & before:
                continue
            of_it = [without(one, self._figure, stands.vertices, limb) for one in evidence]
            places = stands.vertices, stands.landmarks[self._solid.ends]
            hidden = limb.name == in_turn
            found = search(limb, self._local(pose), places, of_it, self._rng, also_hidden=hidden, settings=s.limbs)
            if found is not None:
                pose, moved = found.pose, [*moved, limb.joints]
                stands = self._standing(pose)
        return (np.concatenate(moved), pose) if moved else None

    def _about(self, names: set[str], pose: TreePose) -> Sequence[_Ball]:
        """Where limbs can be: about where they hang, as far as they reach."""
        if not names:
            return []
        R, t = motions(self.mesh.tree, pose)
        chosen = [hung for limb, hung in zip(self._limbs, self._hung, strict=True) if limb.name in names]
        return [_Ball(R[part].reshape(3, 3) @ ball.centre + t[part], ball.radius_m) for part, ball in chosen]

    def _doubtful(self, images: Mapping[str, UInt8], seeing: Mapping[str, _Camera], stands: _Standing) -> set[str]:
        """Limbs where images show the room where they are said to be, or that are in others."""
        assert self.settings.limbs is not None
        points, against = stands.vertices[self._asked], np.zeros(len(self._asked))
        for name, camera in seeing.items():
            against += camera.against(images[name], points)
        found, most = set(), 0.75 * self.settings.limbs.against * len(seeing)
        for k, limb in enumerate(self._limbs):
            begin, end = self._asked_from[k : k + 2]
            room = bool(seeing) and against[begin:end].sum() > most * (end - begin)
            if room or depth_m(self._solid, limb.pairs, stands.landmarks) > TOUCHING_M:
                found.add(limb.name)
        return found

    def covered(self, pose: TreePose, grown_px: int = 0) -> dict[str, Bool]:
        """(height, width) by camera: what the body covers in a pose, and so much around it."""
        vertices, out = posed(self.mesh, pose), {}
        for name, by in self._eyes.items():
            step = self._cameras[name].step_px if name in self._cameras else USUAL_STEP_PX
            seen = see(self._figure, vertices, by, step_px=step, margin_px=grown_px + 2 * step)
            if seen is None:
                out[name] = np.zeros(by.size_px[::-1], np.bool_)
            else:
                phi = signed_distance(seen.mask, grown_px + step, step) + np.float32(grown_px)
                out[name] = Silhouette(seen.origin_px, step, phi).mask(by.size_px)
        return out

    def _unusable(self, images: Mapping[str, UInt8]) -> dict[str, str]:
        """Why images do not count that show nothing, or nothing new, by camera."""
        reasons, same = {}, []
        for name, camera in self._cameras.items():
            if name in images:
                thinned = images[name][:: camera.sparse_px, :: camera.sparse_px]
                if camera.thinned is not None and np.array_equal(thinned, camera.thinned):
                    same.append(name)
                if int(thinned.max()) - int(thinned.min()) <= LEAST_CONTRAST:
                    reasons[name] = "it is all of one colour, as of a covered or broken camera"
                camera.thinned = thinned.copy()
        if len(same) < len(images):  # else the recording stands still
            reasons |= dict.fromkeys(
                (name for name in same if name not in reasons), "it is frozen: the same image as before"
            )
        return reasons

    def _something_else(
        self, images: Mapping[str, UInt8], left_out: Mapping[str, str], expected_at: Float64, time_ns: int
    ) -> dict[str, str]:
        """Cameras whose images are of something else; where half of them are, all are: what was stored is wrong.

        One camera must differ much, for somebody may pass; half of them, at one instant, only beyond chance.
        """
        s, asked, much, some = self.settings, {}, [], []
        for name, camera in self._cameras.items():
            if name in images and name not in left_out and camera.look(self._figure, expected_at, s):
                asked[name] = unlike = camera.unlike(images[name])
                if unlike > camera.usually.much(s.unlike):
                    much.append(name)
                if unlike > camera.usually.beyond_chance():
                    some.append(name)
        together = len(some) + len(left_out) >= max(2, (len(asked) + len(left_out)) / 2) and bool(some)
        reasons = {}
        for name, unlike in asked.items():
            camera = self._cameras[name]
            if not (together or name in much):
                camera.as_usual(unlike)
            elif camera.since_ns(time_ns) >= s.something_else_s * NS_PER_S:
                camera.forget_background()
            elif name in much or name in some:
                reasons[name] = f"it shows something else: {unlike:.0%} of what is behind the body differs from before"
            else:
                reasons[name] = "at least half of the cameras show something else"
        return reasons

    def _priors(self, expected: TreePose, time_ns: int) -> tuple[Prior, Sequence[Prior]]:
        """How angles usually are, and how steady the body is."""
        s = self.settings
        weak = np.full(len(self._usual), s.usual_per_rad)
        usual = Prior(TreePose(expected.T_world_model, self._usual), 0.0, 0.0, weak)
        if s.steadiness is None or len(self._past) < 2:
            return usual, ()
        (before_ns, _), (last_ns, last) = self._past
        since_s = (time_ns - last_ns) / NS_PER_S
        penalty = s.steadiness.penalty(since_s, (last_ns - before_ns) / NS_PER_S)
        turns = np.zeros(len(self._usual))
        turns[self._balls.first + 2] = 1.0 / (s.steadiness.turn_rad_per_s * since_s)
        return usual, (smoothness(self.mesh.tree, expected, penalty), Prior(last, 0.0, 0.0, turns))

    def _local(self, pose: TreePose) -> LocalTree:
        return local_tree(self.mesh.tree, self._balls, pose)

    def _standing(self, pose: TreePose) -> _Standing:
        """Of the last pose that was asked, it is known already."""
        if self._stood is None or self._stood.pose is not pose:
            mesh, moved = self.mesh, motions(self.mesh.tree, pose)
            vertices = carried(mesh.vertices, mesh.bones, mesh.shares, moved)
            self._stood = _Standing(pose, vertices, carried(*self._marks, moved))
        return self._stood


class _Ball(msgspec.Struct, frozen=True, eq=False):
    """A place (3,) and how far about it [m]."""

    centre: Float64
    radius_m: float


class _Standing(msgspec.Struct, frozen=True, eq=False):
    """Where a body is in a pose: its vertices (n, 3) and landmarks (m, 3) [m]."""

    pose: TreePose
    vertices: Float64
    landmarks: Float64


class _Camera:
    """What is known of a camera's images."""

    def __init__(self, by: Eye, step_px: int, settings: SilhouetteSettings) -> None:
        self._eye, self.step_px, self._settings = by, step_px, settings
        self._region, self._closer = (_scaled(region, step_px) for region in (settings.region, settings.closer))
        self._wide_region = dataclasses.replace(
            self._region, band_px=WIDE * self._region.band_px, prior_weight=self._region.prior_weight / WIDE**2
        )
        soft = settings.correspondences.soft_steps
        self._wide_correspondences = dataclasses.replace(settings.correspondences, soft_steps=WIDE * soft)
        self._usual_reach = float(settings.margin_steps * step_px)
        self.memory = None if settings.background is None else BackgroundMemory(step_px, settings.background)
        self.wide = False
        self.sparse_px = 8 * step_px
        self.thinned: UInt8 | None = None
        self.usually = _Usually()
        self._else_since_ns: int | None = None
        self.forget_frame()

    def forget_frame(self) -> None:
        self._window: Outline | None = None
        self._looked: tuple[Float64, float] | None = None
        self._outline: Outline | None = None
        self._prior: Silhouette | None = None
        self._found: tuple[Silhouette, Float32] | None = None

    @property
    def _reach(self) -> float:
        return WIDE * self._usual_reach if self.wide else self._usual_reach

    @property
    def segmented(self) -> bool:
        """Whether this frame's image was, and the body is in it."""
        return self._found is not None and self._outline is not None

    @property
    def sample_m(self) -> float:
        """How far samples are apart, at the distance of the body's nearest outline [m]."""
        assert self._outline is not None
        return float(self._outline.depth.min(initial=np.inf) * self.step_px / self._eye.lens[0])

    def look(self, body: Figure, vertices: Float64, s: SilhouetteSettings) -> bool:
        """See the body; all of a frame's looks have one window. False where it is not in the image."""
        if self._looked is not None and self._looked[0] is vertices and self._looked[1] == self._reach:
            return self._outline is not None
        self._looked = vertices, self._reach
        seen = see(
            body, vertices, self._eye, step_px=self.step_px, margin_px=int(self._reach),
            spacing_px=s.correspondences.spacing_steps * self.step_px, window=self._window,
        )  # fmt: skip
        self._window, self._outline, self._prior = self._window or seen, seen, None
        return seen is not None

    def unlike(self, image: UInt8) -> float:
        """How much of what is behind the body is not as it was; NaN where nobody knows."""
        return float("nan") if self.memory is None else self.memory.unlike(image, self._expected())

    def as_usual(self, unlike: float) -> None:
        """It shows what it did before, but for so much."""
        self.usually.learn(unlike)
        self._else_since_ns = None

    def since_ns(self, time_ns: int) -> int:
        """For how long it has shown something else."""
        if self._else_since_ns is None:
            self._else_since_ns = time_ns
        return time_ns - self._else_since_ns

    def forget_background(self) -> None:
        """What it shows is how things are now."""
        assert self.memory is not None
        self.memory.reset()
        self.usually, self._else_since_ns = _Usually(), None

    def segment(self, image: UInt8, others: Bool | None, *, near: bool) -> None:
        """What the image says, the body's outline in mind, which may be ``near`` to it."""
        settings = self._wide_region if self.wide else self._closer if near else self._region
        found = region_contour(image, self._expected(), ignore=others, background=self.memory, settings=settings)
        self._found = found.silhouette, found.surety

    def planes(self, motions: tuple[Float64, Float64]) -> InPlanes:
        """Where the outlines want the body to be."""
        assert self._outline is not None
        assert self._found is not None
        contour, surety = self._found
        return touching(
            self._outline, motions, contour.phi, surety, self._eye,
            reach_px=self._reach,
            settings=self._wide_correspondences if self.wide else self._settings.correspondences,
        )  # fmt: skip

    def seen(self) -> SeenIn:
        """The outcome of a frame."""
        assert self._outline is not None
        assert self._found is not None
        contour = self._found[0]
        return SeenIn(contour, self._outline, overlap(contour.phi > 0, self._outline.mask > 0))

    def shows_all(self, vertices: Float64) -> bool:
        """Whether all of a body (n, 3) is within the image."""
        pixels = seen_at(vertices, self._eye)
        return bool((pixels >= 0).all() and (pixels < self._eye.size_px).all())

    def against(self, image: UInt8, points: Float64) -> Float32:
        """(n,) how much the image shows the room at points (n, 3) of the body, 0 to 1."""
        assert self.memory is not None
        return np.maximum(-self.memory.strange_at(image, seen_at(points, self._eye)), 0.0)

    def evidence(self, image: UInt8, others: Bool | None, about: Sequence[_Ball]) -> Evidence:
        """What of the image is not the room, about the body, as far as some limbs reach."""
        assert self._outline is not None
        assert self.memory is not None
        (x, y), (rows, columns), step = self._outline.origin_px, self._outline.mask.shape, self.step_px
        width, height = self._eye.size_px
        grid, around = step * EVERY, step * round(FARTHER * max(rows, columns))
        left, top = (max(at - around, 0) // grid * grid for at in (x, y))
        right, bottom = min(x + step * columns + around, width), min(y + step * rows + around, height)
        bounds = self._bounds(about)
        if bounds is not None:
            left, top = max(left, bounds[0] // grid * grid), max(top, bounds[1] // grid * grid)
            right, bottom = min(right, bounds[2]), min(bottom, bounds[3])
        # At least a sample, beyond the image where limbs are.
        right, bottom = max(right, left + 1), max(bottom, top + 1)
        shape = (-(-(bottom - top) // step), -(-(right - left) // step))
        strange = self.memory.strange(image, Silhouette((left, top), step, np.empty(shape, np.float32)), EVERY)
        if others is not None:
            apart_from = others[top:bottom:grid, left:right:grid]
            strange[: apart_from.shape[0], : apart_from.shape[1]][apart_from] = 0.0
        return Evidence(self._eye, (left, top), grid, strange)

    def _bounds(self, about: Sequence[_Ball]) -> tuple[int, int, int, int] | None:
        """What part of the image shows balls: left, top, right, bottom [px]; None where one is about the camera."""
        centres, radii = np.array([ball.centre for ball in about]), np.array([ball.radius_m for ball in about])
        T = self._eye.T_camera_world
        nearest = centres @ T[2, :3] + T[2, 3] - radii
        if nearest.min() <= NEAREST_LIMB_M:
            return None
        pixels, reach = seen_at(centres, self._eye), self._eye.lens[:2] * (radii / nearest)[:, None]
        left, top = (pixels - reach).min(axis=0).astype(int).tolist()
        right, bottom = (pixels + reach).max(axis=0).astype(int).tolist()
        return left, top, right, bottom

    def learn(self, image: UInt8, others: Bool | None) -> None:
        """Take in what is behind the body."""
        if self.memory is not None and self._outline is not None and self._found is not None:
            # Without another distance: what is near the contour or in the body is not learnt.
            contour = self._found[0]
            phi = np.where(self._outline.mask > 0, np.float32(self.step_px), contour.phi)
            self.memory.update(image, Silhouette(contour.origin_px, self.step_px, phi), others)

    def _expected(self) -> Silhouette:
        if self._prior is None:
            assert self._outline is not None
            phi = signed_distance(self._outline.mask, self._reach, self.step_px)
            self._prior = Silhouette(self._outline.origin_px, self.step_px, phi)
        return self._prior


class _Usually:
    """How much of a background differs from image to image."""

    def __init__(self) -> None:
        self._mean: float | None = None
        self._deviation = 0.0

    def much(self, share: float) -> float:
        """More than this is something else, of one camera."""
        return MOST_AT_FIRST if self._mean is None else self._mean + share * (1.0 - self._mean)

    def beyond_chance(self) -> float:
        """More than this does not come by chance."""
        return MOST_AT_FIRST if self._mean is None else self._mean + max(LEAST_JUMP, BEYOND * self._deviation)

    def learn(self, unlike: float) -> None:
        """Take in what was nothing else."""
        if self._mean is None:
            self._mean = None if np.isnan(unlike) else unlike
        elif not np.isnan(unlike):
            change = unlike - self._mean
            self._mean += LEARNT * change
            self._deviation += LEARNT * (abs(change) - self._deviation)


def _hung(mesh: RiggedMesh, limb: Limb) -> tuple[int, _Ball]:
    """The part that a limb begins with, and the ball that it stays in, as of that part at rest: about the point that is
    nearest to that part's axes, and to the limb.
    """
    part, points = int(limb.part.min()), mesh.vertices[limb.vertices]
    axes = mesh.tree.twists[mesh.tree.joint_parts == part]
    middle = points.mean(axis=0)
    A, b = LOOSE * np.eye(3), LOOSE * middle
    for twist in axes:
        across = np.eye(3) - np.outer(twist[3:], twist[3:])
        A, b = A + across, b + np.cross(twist[3:], twist[:3])
    centre = np.linalg.solve(A, b)
    return part, _Ball(centre, STRETCHED * float(np.linalg.norm(points - centre, axis=1).max()))


def _with(pose: TreePose, joints: NDArray[np.int64], angles: Float64) -> TreePose:
    """The pose with other angles of some joints."""
    changed = pose.angles.copy()
    changed[joints] = angles[joints]
    return TreePose(pose.T_world_model, changed)


def _scaled(region: RegionSettings, step_px: int) -> RegionSettings:
    """Settings for samples of `USUAL_STEP_PX` for those of others."""
    scale = step_px / USUAL_STEP_PX
    return dataclasses.replace(
        region,
        prior_weight=region.prior_weight / scale**2,
        window_px=region.window_px * scale,
        band_px=region.band_px * scale,
        unsure_px=region.unsure_px * scale,
        fewest_px2=region.fewest_px2 * scale**2,
    )
