"""Detect misplaced limbs, and re-acquire them in the foreground by random search (`kinematics/limb_search.py`).

A limb is suspect if images show the background at its points, or if it penetrates another limb. A whole limb is missed
if within its reach there is foreground that no part of the body explains, such as that of an arm that was lost before
the trunk and swings forward. Foreground in one image alone may be transient, so a limb is searched in the foreground of
two consecutive images, from its second suspect image on. A limb that is found is looked for in the first of these, too,
near its new pose, because without a velocity a fast one is lost again in the next frame. Other limbs are searched as
well, one whole limb after the other, because limbs also hide behind a body.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.signed_distance import MOST_REACH, signed_distance
from mocapella.kinematics.contact import depth_m
from mocapella.kinematics.limb_search import (
    TOUCHING_M,
    Evidence,
    Limb,
    LimbSearchSettings,
    lasting,
    limbs,
    scores,
    search,
    traced,
    unknown,
    without,
    worth,
)
from mocapella.kinematics.silhouette_fit import seen_at
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose, motions
from mocapella.tracker.silhouette_body import SilhouetteBody, Standing
from mocapella.tracker.silhouette_camera import Ball, SilhouetteCamera

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

FEWEST_CAMERAS = 2
"""Least number of cameras with evidence of a limb."""
EVERY_LIMB = 12
"""Interval, in frames, at which the next whole limb is searched without a suspicion."""
LOOSE = 1e-3
"""Weight of a limb's centre, relative to its joint axes, in the least squares for its attachment point."""
STRETCHED = 1.1
"""Reach of a limb from its root, as a factor of its length at rest."""

OTHERS_M = 0.15
"""Margin about other people's expected pixels in which nothing is evidence of a lower limb: a limb of theirs that moves
fast is beside them, and a shank is small enough to be placed there [m]."""


class FoundLimbs(msgspec.Struct, frozen=True, eq=False):
    """Limbs that were found elsewhere than the fit had placed them.

    Attributes:
        joints: (k,) indices of their joint angles.
        pose: pose of the body with the limbs where they were found.
        before: the last frame's pose, with the limbs where its images show them; where they show none nearby, as found.
            It is ``pose`` if the last frame's pose is unknown.
    """

    joints: NDArray[np.int64]
    pose: TreePose
    before: TreePose


class LimbRecovery:
    """Finds and corrects misplaced limbs of one body, such as an arm fitted to the wrong place; one call per frame.

    Args:
        body: the body whose limbs are checked.
        settings: settings of the search.
    """

    def __init__(self, body: SilhouetteBody, settings: LimbSearchSettings) -> None:
        self._body, self._settings = body, settings
        self._limbs = limbs(body.mesh, settings)
        parts = {limb.name: set(limb.part.tolist()) for limb in self._limbs}
        self._whole = [name for name, some in parts.items() if not any(some < more for more in parts.values())]
        self._lower = {name for name in parts if name not in self._whole and len(parts[name]) > 1}
        whole = [limb for limb in self._limbs if limb.name in self._whole]
        self._hung = tuple(_hung(body.mesh, limb) for limb in whole)
        self._sizes_m2 = [_silhouette_m2(body.mesh, limb) for limb in whole]
        self._points = np.concatenate([np.empty(0, np.int64), *(limb.vertices for limb in self._limbs)])
        self._limb_of = np.repeat(np.arange(len(self._limbs)), [len(limb.vertices) for limb in self._limbs])
        self.reset()

    def reset(self) -> None:
        """Forget the suspect limbs and the evidence."""
        self._rng, self._rng_of_lower = np.random.default_rng(0), np.random.default_rng(1)
        self._frame = 0
        self._asked: set[str] = set()
        self._evidence: dict[str, Evidence] = {}

    def memory(self) -> list[Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        # The generator's integers exceed the range of most formats.
        chance = [json.dumps(rng.bit_generator.state) for rng in (self._rng, self._rng_of_lower)]
        return [chance, self._frame, self._asked, self._evidence]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same body."""
        chance, self._frame, self._asked, self._evidence = memory
        self._rng.bit_generator.state, self._rng_of_lower.bit_generator.state = (json.loads(one) for one in chance)

    def found(
        self,
        pose: TreePose,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        cameras: Mapping[str, SilhouetteCamera],
        settled: Bool | None = None,
        *,
        last: TreePose | None,
    ) -> FoundLimbs | None:
        """Search the suspect limbs; return the moved limbs, the corrected pose, and where they were before.

        Args:
            pose: fitted pose of the body in this frame.
            images: (height, width) or (height, width, 3) uint8 BGR, of each camera of ``cameras``, by name.
            others: (height, width) masks of other people, by camera, where nothing is known of this body.
            cameras: the cameras in whose images the body was segmented, by name.
            settled: (parts,) bool, whether a part is not to be moved; a limb is not searched if all of its parts are.
                None: no part.
            last: fitted pose of the body in the last frame; None: unknown, as is the limbs' motion.

        Returns:
            The result; None if no limb was moved.
        """
        self._frame += 1
        stands = self._body.standing(pose)
        # A limb that is merely outside the image would look suspect.
        seeing = {
            name: camera
            for name, camera in cameras.items()
            if camera.background is not None and camera.shows_all(stands.vertices)
        }
        reach = self._about(pose)
        now = {name: one.evidence(images[name], others.get(name), reach) for name, one in seeing.items() if reach}
        doubtful, due = self._doubtful(images, seeing, stands), self._due(self._frame)
        missed = self._missed([*now.values()], stands, reach)
        if settled is not None:
            at_rest = {limb.name for limb in self._limbs if settled[self._body.figure.part[limb.vertices]].all()}
            doubtful, due = doubtful - at_rest, due - at_rest
            missed = {name: share for name, share in missed.items() if name not in at_rest}
        wanted = (doubtful | due | missed.keys()) & self._asked
        self._asked = doubtful | missed.keys() | self._due(self._frame + 1)
        then, self._evidence = self._evidence, now if self._asked else {}
        of_two = {name: lasting(one, then[name]) for name, one in now.items() if name in then}
        evidence = [*of_two.values()]
        if len(evidence) < FEWEST_CAMERAS:
            return None
        these = [limb for limb in self._limbs if limb.name in wanted]
        apart = evidence
        if wanted & self._lower:
            apart = [_apart(one, others.get(name), stands.vertices) for name, one in of_two.items()]
        found, moved = self._searched(these, pose, evidence, due, missed, apart=apart)
        if len(moved) > 1:
            # The first one may have taken the place of the second, as one leg that of the other.
            other, also = self._searched(these[::-1], pose, evidence, due, missed, apart=apart)
            if self._value(these, pose, other, evidence) > self._value(these, pose, found, evidence):
                found, moved = other, also
        if not moved:
            return None
        joints = np.concatenate(moved)
        before = found if last is None else with_angles(last, joints, found.angles)
        for limb in these:
            if last is not None and np.isin(limb.joints, joints).all():
                before = self._traced(limb, before, [then[name] for name in now if name in then])
        return FoundLimbs(joints, found, before)

    def _searched(
        self,
        order: Sequence[Limb],
        pose: TreePose,
        evidence: Sequence[Evidence],
        due: set[str],
        missed: Mapping[str, float],
        *,
        apart: Sequence[Evidence],
    ) -> tuple[TreePose, list[NDArray[np.int64]]]:
        """Search limbs one after the other; return the pose with the found ones, and their joints.

        Lower limbs are searched in the evidence ``apart`` from other people.
        """
        moved: list[NDArray[np.int64]] = []
        for limb in order:
            stands, lower = self._body.standing(pose), limb.name in self._lower
            of_it = [without(one, stands.vertices, limb.other_faces) for one in (apart if lower else evidence)]
            places = stands.vertices, stands.landmarks[self._body.solid.ends]
            # Own random numbers: whether a lower limb is searched changes no other search.
            found = search(
                limb, self._body.local(pose), places, of_it, self._rng_of_lower if lower else self._rng,
                also_hidden=limb.name in due, missed=missed.get(limb.name), settings=self._settings,
            )  # fmt: skip
            if found is not None:
                pose, moved = found.pose, [*moved, limb.joints]
        return pose, moved

    def _traced(self, limb: Limb, pose: TreePose, evidence: Sequence[Evidence]) -> TreePose:
        """Return the last frame's pose with a limb, found in this frame, where the last frame's images show it."""
        stands = self._body.standing(pose)
        of_it = [without(one, stands.vertices, limb.other_faces) for one in evidence]
        places = stands.vertices, stands.landmarks[self._body.solid.ends]
        return traced(limb, self._body.local(pose), places, of_it, self._rng, settings=self._settings)

    def _value(self, some: Sequence[Limb], was: TreePose, pose: TreePose, evidence: Sequence[Evidence]) -> float:
        """Return the sum of the limbs' scores in a pose, less the cost of their rotations from the pose ``was``."""
        stands, local, total = self._body.standing(pose), self._body.local(pose), 0.0
        places = stands.vertices, stands.landmarks[self._body.solid.ends]
        turned = self._body.local(was).into(pose).angles
        for limb in some:
            of_it = [without(one, stands.vertices, limb.other_faces) for one in evidence]
            angles = local.at.angles[limb.joints][None]
            (score,), _ = scores(limb, local, places, of_it, angles, settings=self._settings)
            total += float(score) - self._settings.per_rad2 * float(np.square(turned[limb.joints]).sum())
        return total

    def _due(self, frame: int) -> set[str]:
        """Return the limb that is due for a search in this frame, if any."""
        turn, rest = divmod(frame, EVERY_LIMB)
        return {self._whole[turn % len(self._whole)]} if self._whole and rest == 0 else set()

    def _doubtful(
        self, images: Mapping[str, UInt8], seeing: Mapping[str, SilhouetteCamera], stands: Standing
    ) -> set[str]:
        """Return limbs placed where images show the background, or inside other limbs.

        Every other point is tested; the others follow in the next frame.
        """
        these = slice(self._frame % 2, None, 2)
        points, limb_of = stands.vertices[self._points[these]], self._limb_of[these]
        against = np.zeros(len(points))
        for name, camera in seeing.items():
            against += camera.against(images[name], points)
        most = self._settings.against * len(seeing) * np.bincount(limb_of, minlength=len(self._limbs))
        room = np.bincount(limb_of, against, len(self._limbs)) > most
        return {
            limb.name
            for k, limb in enumerate(self._limbs)
            if room[k] or depth_m(self._body.solid, limb.pairs, stands.landmarks) > TOUCHING_M
        }

    def _missed(self, evidence: Sequence[Evidence], stands: Standing, reach: Sequence[Ball]) -> dict[str, float]:
        """Return whole limbs that could gain `LimbSearchSettings.better` in foreground that nothing explains.

        A limb's gain is at most the share of it that this foreground covers, as a mean over the cameras.

        Args:
            evidence: of each camera.
            stands: the body.
            reach: the ball that each whole limb can reach, in the order of ``self._whole``.
        """
        gain = np.zeros(len(self._whole))
        for one in evidence:
            left = without(one, stands.vertices, self._body.mesh.faces)
            at = np.argwhere(left.strange > 0)
            pixels = at[:, ::-1] * left.step_px + np.array(left.origin_px)
            centres, T = np.array([ball.centre for ball in reach]), left.eye.T_camera_world
            depth_px = left.eye.lens[0] / (centres @ T[2, :3] + T[2, 3])
            middles = seen_at(centres, left.eye)
            for k, ball in enumerate(reach):
                near = np.square(pixels - middles[k]).sum(axis=1) < (ball.radius_m * depth_px[k]) ** 2
                gain[k] += near.sum() * (left.step_px / depth_px[k]) ** 2 / self._sizes_m2[k]
        fewest = self._settings.better * len(evidence)
        names = {name for name, some in zip(self._whole, gain, strict=True) if evidence and some > fewest}
        return {limb.name: self._unknown(limb, stands, evidence) for limb in self._limbs if limb.name in names}

    def _unknown(self, limb: Limb, stands: Standing, evidence: Sequence[Evidence]) -> float:
        """Return the share of a limb's points, 0 to 1, at which images know nothing of the background."""
        local, places = self._body.local(stands.pose), (stands.vertices, stands.landmarks[self._body.solid.ends])
        of_it = [without(unknown(one), stands.vertices, limb.other_faces) for one in evidence]
        (share,), _, _ = worth(limb, local, places, of_it, local.at.angles[limb.joints][None])
        return float(share)

    def _about(self, pose: TreePose) -> Sequence[Ball]:
        """Return the ball that each whole limb can reach, about its attachment point."""
        R, t = motions(self._body.mesh.tree, pose)
        return [Ball(R[part].reshape(3, 3) @ ball.centre + t[part], ball.radius_m) for part, ball in self._hung]


def _apart(evidence: Evidence, others: Bool | None, vertices: Float64) -> Evidence:
    """Return an image's evidence without that within `OTHERS_M` of the pixels of other people.

    Args:
        evidence: the evidence.
        others: (height, width) mask of other people; None for none.
        vertices: (n, 3) of the body, for its distance from the camera, world [m].
    """
    if others is None or not others.any():
        return evidence
    (left, top), step, T = evidence.origin_px, evidence.step_px, evidence.eye.T_camera_world
    away_m = float(np.median(vertices @ T[2, :3] + T[2, 3]))
    margin_px = OTHERS_M * float(evidence.eye.lens[0]) / max(away_m, OTHERS_M)
    near = signed_distance(others[::step, ::step], min(margin_px + step, MOST_REACH * step), step) > -margin_px
    rows, columns = evidence.strange.shape
    near = near[top // step : top // step + rows, left // step : left // step + columns]
    strange = evidence.strange.copy()
    strange[: near.shape[0], : near.shape[1]][near] = 0.0
    return Evidence(evidence.eye, evidence.origin_px, step, strange)


def with_angles(pose: TreePose, joints: NDArray[np.int64], angles: Float64) -> TreePose:
    """Return a copy of a pose where the joints of index ``joints`` (k,) have their ``angles`` (all joints,) [rad]."""
    changed = pose.angles.copy()
    changed[joints] = angles[joints]
    return TreePose(pose.T_world_model, changed)


def _silhouette_m2(mesh: RiggedMesh, limb: Limb) -> float:
    """Return a limb's mean projected area [m²], a quarter of its surface, as if it were convex (A. Cauchy, 1832)."""
    rest = {tuple(face) for face in limb.other_faces.tolist()}
    own = np.array([face for face in mesh.faces.tolist() if tuple(face) not in rest], np.int64).reshape(-1, 3)
    a, b, c = np.moveaxis(mesh.vertices[own], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 8.0)


def _hung(mesh: RiggedMesh, limb: Limb) -> tuple[int, Ball]:
    """Return the part that a limb starts with, and the ball that the limb can reach, in the rest pose.

    The ball's centre is the attachment point: nearest to that part's joint axes, and of these nearest to the limb.
    """
    part, points = int(limb.part.min()), mesh.vertices[limb.vertices]
    axes = mesh.tree.twists[mesh.tree.joint_parts == part]
    middle = points.mean(axis=0)
    A, b = LOOSE * np.eye(3), LOOSE * middle
    for twist in axes:
        across = np.eye(3) - np.outer(twist[3:], twist[3:])
        A, b = A + across, b + np.cross(twist[3:], twist[:3])
    centre = np.linalg.solve(A, b)
    return part, Ball(centre, STRETCHED * float(np.linalg.norm(points - centre, axis=1).max()))
