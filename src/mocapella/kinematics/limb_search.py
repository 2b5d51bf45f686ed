"""Re-acquire a lost limb: compare many of its poses with the foreground of the images.

    of_it = [without(evidence, vertices, limb.other_faces) for evidence in …]    one for each camera
    found = search(limb, local_tree, (vertices, ends), of_it, rng, also_hidden=False)

Gradient steps do not bring back a limb whose outline is far from the image's. But a misplaced limb is projected onto
background. So the score of a pose is the mean of the foreground map over the limb's points and the cameras, at most 1,
negative on background, less penalties for penetrating another limb and for rotation from the present pose. Samples
that the rest of the body covers, and unknown samples, count 0. Poses are drawn about the present one and anywhere
within the limits, and again about the best of these (R. Rubinstein, "The cross-entropy method for combinatorial and
continuous optimization", Methodology and Computing in Applied Probability 1, 1999).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.ball_joints import LocalTree
from mocapella.kinematics.silhouette_fit import Eye
from mocapella.model.body_capsules import Capsules, capsules_of
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose, limbs_of, motions
from mocapella.settings import check

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class LimbSearchSettings:
    """Settings of the search for a limb.

    Attributes:
        points: number of points on a limb's surface that are compared with the images; larger: more accurate scores, at
            more work [points].
        drawn: number of initial poses: a third near the present one, a third farther away, a third anywhere; larger:
            limbs are found more often, at more work [poses].
        near_rad: standard deviation of the joint angles of the first third about the present pose; that of the poses of
            round n is this divided by 2ⁿ [rad].
        farther_rad: standard deviation of the joint angles of the second third about the present pose [rad].
        kept: number of best poses about which new ones are drawn in each round, ever nearer [poses].
        again: number of poses drawn about each of the ``kept`` ones in a round; larger: a better pose, at more work
            [poses].
        rounds: number of rounds, in each of which poses are drawn half as far away; larger: a finer pose, at more work
            [rounds].
        per_rad2: cost of a rotation from the present pose, in units of the score; larger: nearer poses are preferred
            [1/rad²].
        room: weight of a background sample relative to a foreground one; people may look like the background; larger:
            limbs avoid what looks like the background more [ratio].
        against: share of background samples above which a limb may be lost; larger: limbs are searched for more rarely
            [0 to 1].
        astray: score, at most 1, below which a limb that may be lost is searched for; larger: limbs are searched for
            more often [ratio].
        better: gain of the score above which a lost limb moves to the new pose; larger: fewer wrong moves, and more
            limbs stay lost [ratio].
        much_better: gain of the score above which a limb that is not lost moves to the new pose; larger: fewer wrong
            moves, and more limbs stay misplaced [ratio].
        per_m: cost of penetrating limbs, in units of the score; larger: they are avoided more [1/m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    points: int = 40
    drawn: int = 600
    near_rad: float = 0.3
    farther_rad: float = 0.9
    kept: int = 8
    again: int = 20
    rounds: int = 3
    per_rad2: float = 0.03
    room: float = 0.4
    against: float = 0.2
    astray: float = 0.05
    better: float = 0.12
    much_better: float = 0.3
    per_m: float = 5.0

    def __post_init__(self) -> None:
        for name in ("points", "drawn", "kept", "again", "rounds"):
            check(getattr(self, name) >= 1, name, getattr(self, name), "1 or more")
        for name in ("near_rad", "farther_rad", "room", "against", "better", "much_better"):
            check(getattr(self, name) > 0, name, getattr(self, name), "above 0")
        for name in ("per_rad2", "per_m"):
            check(getattr(self, name) >= 0, name, getattr(self, name), "0 or more")


DEFAULT = LimbSearchSettings()
REACH = 3
"""Largest motion of foreground between two images that `lasting` accepts, in samples of the map of `Evidence`."""
TOUCHING_M = 0.03
"""Sum of a limb's penetration depths above which it counts as misplaced [m]."""


class Limb(msgspec.Struct, frozen=True, eq=False):
    """A limb of a body, such as an arm, a leg or a finger, as indices into the mesh and its tree.

    Attributes:
        name: name of its first part.
        parts: (k,) its parts in the tree, each the child of the one before.
        joints: (m,) the joints of these parts.
        vertices: (p,) sampled vertices of its surface, spread over its parts.
        part: (p,) the part of each of these vertices.
        other_faces: (f, 3) the faces of the rest of the mesh.
        capsules: the capsules of the whole body.
        moving: (d,) indices of the capsules that move with the limb.
        pairs: (q, 2) indices of two capsules that can collide, one or both of the limb.
    """

    name: str
    parts: Int64
    joints: Int64
    vertices: Int64
    part: Int64
    other_faces: NDArray[np.int32]
    capsules: Capsules
    moving: Int64
    pairs: Int64


def limbs(mesh: RiggedMesh, settings: LimbSearchSettings = DEFAULT) -> tuple[Limb, ...]:
    """Return the limbs of two parts or more, and their lower parts: each without its first part, and its last part.

    The last part, such as a foot, is searched alone, too, because when misplaced it hardly changes the score of the
    whole leg. So is the limb without its first part, such as a shank with its foot: a knee that bends fast leaves the
    thigh right, and few of the poses of a whole leg that are drawn leave the thigh where it is.

    Args:
        mesh: the body's mesh and its tree.
        settings: only ``points`` is used, the number of sampled vertices of a limb.
    """
    parents, found = mesh.tree.parents, []
    solid = capsules_of(mesh)
    for _, parts in limbs_of(mesh.tree):
        others = np.setdiff1d(np.arange(len(parents)), parts)
        if len(parts) < 2 or np.isin(parents[others], parts).any():
            continue
        lower = (parts, parts[1:], parts[-1:]) if len(parts) > 2 else (parts, parts[-1:])
        found += [_limb(mesh, solid, some, settings.points) for some in lower]
    return tuple(limb for limb in found if len(limb.vertices) and len(limb.joints))


def _limb(mesh: RiggedMesh, solid: Capsules, parts: Int64, points: int) -> Limb:
    owner = mesh.bones[:, 0]
    of_it, chosen = np.flatnonzero(np.isin(owner, parts)), []
    for part in parts:
        some = of_it[owner[of_it] == part]
        count = min(max(points // len(parts), 1), len(some))
        chosen += some[np.unique(np.linspace(0, len(some) - 1, count).astype(int))].tolist()
    vertices = np.array(chosen, np.int64)
    return Limb(
        name=mesh.part_names[parts[0]],
        parts=parts,
        joints=np.flatnonzero(np.isin(mesh.tree.joint_parts, parts)),
        vertices=vertices,
        part=owner[vertices].astype(np.int64),
        other_faces=np.ascontiguousarray(mesh.faces[~np.isin(mesh.faces, of_it).any(axis=1)]),
        capsules=solid,
        moving=np.flatnonzero(np.isin(solid.part, parts)),
        pairs=np.ascontiguousarray(solid.pairs[np.isin(solid.part[solid.pairs], parts).any(axis=1)]),
    )


class Evidence(msgspec.Struct, frozen=True, eq=False):
    """Map of foreground scores of one image; `without` masks the region that the rest of the body covers.

    Attributes:
        eye: the camera.
        origin_px, step_px: the map's sample (row, column) is the image point origin + step·(column, row) [px].
        strange: (rows, columns) the map: from 1 (foreground) to −1 (background); 0 is unknown.
    """

    eye: Eye
    origin_px: tuple[int, int]
    step_px: int
    strange: Float32


def without(evidence: Evidence, vertices: Float64, faces: NDArray[np.int32]) -> Evidence:
    """Return a copy of an image's evidence: 0 where a posed mesh is rendered, and beside it.

    Args:
        evidence: evidence of the whole body; not changed.
        vertices: (n, 3) posed vertices from `rigged_mesh.posed`, world [m].
        faces: (f, 3) faces to render: `Limb.other_faces` leaves the evidence for one limb, and the faces of the whole
            mesh leave the foreground that no part of the body explains.
    """
    by, k = evidence.eye, _seeing()
    pixels, depth = np.empty((len(vertices), 2)), np.empty(len(vertices))
    k.see(vertices, by.T_camera_world, by.lens, by.farthest_r2, pixels, depth)
    mask, sides = np.zeros(evidence.strange.shape, np.uint8), np.empty(len(faces), np.int8)
    k.face_sides(pixels, depth, faces, sides)
    k.cover(pixels, faces, sides, *evidence.origin_px, evidence.step_px, mask)
    strange = evidence.strange.copy()
    _kernels().forget_covered(mask, strange)  # and beside it: flesh is not exactly where the mesh is
    return Evidence(by, evidence.origin_px, evidence.step_px, strange)


def lasting(now: Evidence, before: Evidence) -> Evidence:
    """Cap each foreground score by the largest one within `REACH` samples in the previous image; return a copy.

    This rejects foreground that flashes up in one image only.

    Args:
        now, before: evidence of the present and of the previous image of one camera, with equal ``step_px``.
    """
    strange = now.strange.copy()
    shift = [(a - b) // now.step_px for a, b in zip(now.origin_px, before.origin_px, strict=True)]
    _kernels().only_lasting(before.strange, shift[1], shift[0], REACH, strange)
    return Evidence(now.eye, now.origin_px, now.step_px, strange)


def unknown(evidence: Evidence) -> Evidence:
    """Return the map of an image's unknown samples: 1 where it may show foreground or background, else 0."""
    maybe = (evidence.strange == 0).astype(np.float32)
    return Evidence(evidence.eye, evidence.origin_px, evidence.step_px, maybe)


class FoundLimb(msgspec.Struct, frozen=True, eq=False):
    """Result of the search for a limb.

    Attributes:
        pose: pose of the body's tree, within its limits; only the limb differs from the former one.
        worth, was: scores of ``pose`` and of the former pose, at most 1, as the module defines them.
    """

    pose: TreePose
    worth: float
    was: float


def worth(
    limb: Limb, local: LocalTree, places: tuple[Float64, Float64], evidence: Sequence[Evidence], angles: Float64
) -> tuple[Float64, Float64, Float64]:
    """Evaluate n poses of a limb: evidence for and against each, and the sum of its penetration depths [m], (n,) each.

    Evidence for a pose is the sum of the positive values of `Evidence.strange` at the limb's vertices in all cameras,
    divided by the number of vertices times the number of cameras. Evidence against it is that of the negative values,
    with a positive sign. Both are 0 to 1; vertices behind a camera or outside of its map, and no camera, add 0.

    Args:
        limb: the limb.
        local: local tree of the body's present pose.
        places: (v, 3) vertices and (c, 2, 3) ends of the capsules of the body in that pose, world [m].
        evidence: evidence from `without`, one for each camera.
        angles: (n, m) angles of the limb's joints in the local tree [rad].
    """
    (vertices, ends), k, n, count = places, _kernels(), len(angles), len(limb.vertices)
    part = np.concatenate([limb.part, np.repeat(limb.capsules.part[limb.moving], 2)])
    points = np.concatenate([vertices[limb.vertices], ends[limb.moving].reshape(-1, 3)])
    at = np.empty((n, len(points), 3))
    k.places(*_hung(limb, local), angles, np.searchsorted(limb.parts, part), points, at)
    ends_at = np.repeat(ends[None], n, axis=0)
    ends_at[:, limb.moving], at = at[:, count:].reshape(n, -1, 2, 3), np.ascontiguousarray(at[:, :count])
    counts, depth = np.zeros((n, 2)), np.empty(n)
    for one in evidence:
        by = one.eye
        k.add_worth(at, by.T_camera_world, by.lens, by.farthest_r2, one.strange, *one.origin_px, one.step_px, counts)
    k.depths(ends_at, limb.capsules.radii, limb.pairs, depth)
    counts /= max(len(evidence) * len(limb.vertices), 1)
    return counts[:, 0], counts[:, 1], depth


def scores(
    limb: Limb, local: LocalTree, places: tuple[Float64, Float64], evidence: Sequence[Evidence], angles: Float64,
    *, settings: LimbSearchSettings = DEFAULT,
) -> tuple[Float64, Float64]:  # fmt: skip
    """Return the scores (n,) of n poses of a limb, as the module defines them, and the evidence against each (n,).

    Arguments are those of `worth`; rotations are from the pose of the local tree.
    """
    good, bad, depth = worth(limb, local, places, evidence, angles)
    turned = ((angles - local.at.angles[limb.joints]) ** 2).sum(axis=1)
    return np.asarray(good - settings.room * bad - settings.per_m * depth - settings.per_rad2 * turned), bad


def _hung(limb: Limb, local: LocalTree) -> tuple[Int64, Int64, Float64, Float64, Float64]:
    """Return a limb as a separate tree: parents, joints' parts and twists; its parent's motion (4, 4); its angles."""
    tree = local.tree
    R, t = motions(tree, local.at)
    on, T = tree.parents[limb.parts[0]], np.eye(4)
    T[:3, :3], T[:3, 3] = R[on].reshape(3, 3), t[on]
    joint_parts = np.searchsorted(limb.parts, tree.joint_parts[limb.joints])
    return np.arange(-1, len(limb.parts) - 1), joint_parts, tree.twists[limb.joints], T, local.at.angles[limb.joints]


def search(
    limb: Limb,
    local: LocalTree,
    places: tuple[Float64, Float64],
    evidence: Sequence[Evidence],
    rng: np.random.Generator,
    *,
    also_hidden: bool,
    missed: float | None = None,
    settings: LimbSearchSettings = DEFAULT,
) -> FoundLimb | None:
    """Search for a pose of the limb by the cross-entropy method; return None unless it scores clearly higher than now.

    Args:
        limb, local: the limb, and the local tree of the body's present pose.
        places: (v, 3) vertices and (c, 2, 3) ends of the body's capsules in that pose, world [m].
        evidence: evidence from `without`, one for each camera.
        rng: random generator that draws the poses, and is not used if nothing is searched.
        also_hidden: whether to search also if the images do not contradict the present pose; False: None is returned.
        missed: None, or of a limb within whose reach there is foreground that nothing explains, the share of its
            points at which nothing is known, 0 to 1. It counts as lost if its score is low, also where the images do
            not contradict its pose; it may be where nothing is known, which counts for that pose.
        settings: the settings.
    """
    s, at = settings, local.at.angles[limb.joints]

    def valued(angles: Float64) -> tuple[Float64, Float64]:
        return scores(limb, local, places, evidence, angles, settings=s)

    (was,), (against,) = valued(at[None])
    astray = was < s.astray and (missed is not None or against > s.against)
    if not astray and not also_hidden:
        return None
    limits = _limits(limb, local)
    third = -(-s.drawn // 3)
    drawn = [at + sd * rng.standard_normal((third, len(at))) for sd in (s.near_rad, s.farther_rad)]
    tried = np.concatenate([*drawn, rng.uniform(limits[:, 0], limits[:, 1], (third, len(at)))])
    pose = _with(limb, local, _best(np.clip(tried, *limits.T), lambda angles: valued(angles)[0], limits, rng, s))
    told = local.into(pose).angles[limb.joints]  # within the body's limits, unlike a local tree's angles
    (value,), _ = valued(told[None])
    better = value > was + (missed or 0.0) + (s.better if astray else s.much_better)
    return FoundLimb(pose, float(value), float(was)) if better else None


def traced(
    limb: Limb, local: LocalTree, places: tuple[Float64, Float64], evidence: Sequence[Evidence],
    rng: np.random.Generator, *, settings: LimbSearchSettings = DEFAULT,
) -> TreePose:  # fmt: skip
    """Return the body's pose of another frame with a limb near its present pose, where that frame's images show it.

    Poses are drawn about the present one alone. The limb stays unless its score rises by ``better`` and above
    ``astray``: a limb that is at rest in both frames gets no motion by chance, nor does one that no image shows.

    Args:
        limb, local: the limb, and the local tree of the other frame's pose, but with the limb's found pose.
        places: (v, 3) vertices and (c, 2, 3) ends of the body's capsules in that pose, world [m].
        evidence: evidence of the other frame from `without`, one for each camera.
        rng: random generator that draws the poses.
        settings: the settings.
    """
    s, at = settings, local.at.angles[limb.joints]

    def valued(angles: Float64) -> Float64:
        return scores(limb, local, places, evidence, angles, settings=s)[0]

    limits = _limits(limb, local)
    near = np.clip(at + s.near_rad * rng.standard_normal((-(-s.drawn // 3), len(at))), *limits.T)
    pose = _with(limb, local, _best(near, valued, limits, rng, s))
    was, value = valued(np.stack([at, local.into(pose).angles[limb.joints]]))
    return pose if value > max(was + s.better, s.astray) else local.back(local.at)


def _limits(limb: Limb, local: LocalTree) -> Float64:
    """Return the limits (m, 2) of a limb's joints in a local tree, at most a half turn [rad]."""
    return np.clip(local.tree.limits[limb.joints], -np.pi, np.pi)


def _best(
    tried: Float64, valued: Callable[[Float64], Float64], limits: Float64, rng: np.random.Generator,
    s: LimbSearchSettings,
) -> Float64:  # fmt: skip
    """Return the best angles (m,) that the rounds of the cross-entropy method find from the first ones (n, m) [rad]."""
    values = valued(tried)
    for number in range(s.rounds):
        best = np.argsort(-values, kind="stable")[: s.kept]
        tried, values = tried[best], values[best]
        about = np.repeat(tried, s.again, axis=0)
        sd = s.near_rad / 2 ** (number + 1)
        more = np.clip(about + sd * rng.standard_normal(about.shape), *limits.T)
        tried, values = np.concatenate([tried, more]), np.concatenate([values, valued(more)])
    return np.asarray(tried[np.argmax(values)])


def _with(limb: Limb, local: LocalTree, angles: Float64) -> TreePose:
    """Return the body's pose with a limb's angles (m,) in a local tree, within the limits of the body's own."""
    every = local.at.angles.copy()
    every[limb.joints] = angles
    return local.back(TreePose(local.at.T_world_model, every))


@cache
def _seeing() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import outline_kernels

    return outline_kernels


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import limb_search_kernels

    return limb_search_kernels
