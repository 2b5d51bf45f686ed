"""Detect misplaced limbs, and re-acquire them in the foreground by random search (`kinematics/limb_search.py`).

A limb is suspect if images show the background at its points, or if it penetrates another limb. Foreground in one
image alone may be transient, so a limb is searched in the foreground of two consecutive images, from its second suspect
image on. Other limbs are searched as well, one whole limb after the other, because limbs also hide behind a body.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.contact import depth_m
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
        self._hung = tuple(_hung(body.mesh, limb) for limb in self._limbs)
        self._points = np.concatenate([np.empty(0, np.int64), *(limb.vertices for limb in self._limbs)])
        self._limb_of = np.repeat(np.arange(len(self._limbs)), [len(limb.vertices) for limb in self._limbs])
        self.reset()

    def reset(self) -> None:
        """Forget the suspect limbs and the evidence."""
        self._rng = np.random.default_rng(0)
        self._frame = 0
        self._asked: set[str] = set()
        self._evidence: dict[str, Evidence] = {}

    def memory(self) -> list[Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        # The generator's integers exceed the range of most formats.
        chance = json.dumps(self._rng.bit_generator.state)
        return [chance, self._frame, self._asked, self._evidence]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same body."""
        chance, self._frame, self._asked, self._evidence = memory
        self._rng.bit_generator.state = json.loads(chance)

    def found(
        self,
        pose: TreePose,
        images: Mapping[str, UInt8],
        others: Mapping[str, Bool],
        cameras: Mapping[str, SilhouetteCamera],
        settled: Bool | None = None,
    ) -> tuple[NDArray[np.int64], TreePose] | None:
        """Search the suspect limbs; return the joints of the moved limbs, and the corrected pose.

        Args:
            pose: fitted pose of the body in this frame.
            images: (height, width) or (height, width, 3) uint8 BGR, of each camera of ``cameras``, by name.
            others: (height, width) masks of other people, by camera, where nothing is known of this body.
            cameras: the cameras in whose images the body was segmented, by name.
            settled: (parts,) bool, whether a part is not to be moved; a limb is not searched if all of its parts are.
                None: no part.

        Returns:
            Indices (k,) of the joint angles that changed, and the new pose; None if no limb was moved.
        """
        self._frame += 1
        stands = self._body.standing(pose)
        # A limb that is merely outside the image would look suspect.
        seeing = {
            name: camera
            for name, camera in cameras.items()
            if camera.background is not None and camera.shows_all(stands.vertices)
        }
        doubtful, due = self._doubtful(images, seeing, stands), self._due(self._frame)
        if settled is not None:
            at_rest = {limb.name for limb in self._limbs if settled[self._body.figure.part[limb.vertices]].all()}
            doubtful, due = doubtful - at_rest, due - at_rest
        wanted = (doubtful | due) & self._asked
        self._asked = doubtful | self._due(self._frame + 1)
        about = self._about(self._asked | wanted, pose)
        now = {name: one.evidence(images[name], others.get(name), about) for name, one in seeing.items() if about}
        then, self._evidence = self._evidence, now
        evidence = [lasting(one, then[name]) for name, one in now.items() if name in then]
        moved: list[NDArray[np.int64]] = []
        for limb in self._limbs if len(evidence) >= FEWEST_CAMERAS else ():
            if limb.name not in wanted:
                continue
            of_it = [without(one, self._body.figure, stands.vertices, limb) for one in evidence]
            places = stands.vertices, stands.landmarks[self._body.solid.ends]
            found = search(
                limb, self._body.local(pose), places, of_it, self._rng,
                also_hidden=limb.name in due, settings=self._settings,
            )  # fmt: skip
            if found is not None:
                pose, moved = found.pose, [*moved, limb.joints]
                stands = self._body.standing(pose)
        return (np.concatenate(moved), pose) if moved else None

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

    def _about(self, names: Collection[str], pose: TreePose) -> Sequence[Ball]:
        """Return balls that limbs can reach, about their attachment points."""
        if not names:
            return []
        R, t = motions(self._body.mesh.tree, pose)
        chosen = [hung for limb, hung in zip(self._limbs, self._hung, strict=True) if limb.name in names]
        return [Ball(R[part].reshape(3, 3) @ ball.centre + t[part], ball.radius_m) for part, ball in chosen]


def with_angles(pose: TreePose, joints: NDArray[np.int64], angles: Float64) -> TreePose:
    """Return a copy of a pose where the joints of index ``joints`` (k,) have their ``angles`` (all joints,) [rad]."""
    changed = pose.angles.copy()
    changed[joints] = angles[joints]
    return TreePose(pose.T_world_model, changed)


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
