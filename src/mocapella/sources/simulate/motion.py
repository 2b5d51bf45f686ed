"""Motions of people: poses on a periodic time grid, interpolated at any instant.

A pose is the root's position and a unit direction for each bone, so that interpolation keeps bone lengths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.sources.simulate.body import joint_positions

Float64 = NDArray[np.float64]

PERIOD_NS = 20_000_000
"""Time between two poses [ns]: an integer, so that the repetition is exact."""

POSE_HZ = NS_PER_S / PERIOD_NS


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses every `PERIOD_NS`, repeated periodically.

    Attributes:
        root: (poses, 3) positions of the root joint, world [m].
        directions: (poses, 25, 3) unit vectors along the bones, world; zero for the root joint, which has no bone.
        lengths: (25,) length of the bone that ends at each joint [m].
        radii: (25,) radius of each bone's capsule [m].
    """

    root: Float64
    directions: Float64
    lengths: Float64
    radii: Float64

    def __len__(self) -> int:
        return len(self.root)

    @property
    def duration_ns(self) -> int:
        """The period after which the motion repeats [ns]."""
        return len(self) * PERIOD_NS

    def padded(self, poses: int) -> Motion:
        """Return a copy with a longer period: ``poses`` poses, at least as many as the motion has.

        In the added time, the person stands still in the first pose.
        """
        still = poses - len(self)
        return Motion(
            np.concatenate([self.root, np.repeat(self.root[:1], still, axis=0)]),
            np.concatenate([self.directions, np.repeat(self.directions[:1], still, axis=0)]),
            self.lengths,
            self.radii,
        )


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The motions of several people on one time grid.

    Attributes:
        root: (poses, people, 3) positions of the root joint, world [m].
        directions: (poses, people, 25, 3) unit vectors along the bones, world.
        lengths, radii: (people, 25) of the bones and of the capsules around them [m].
    """

    root: Float64
    directions: Float64
    lengths: Float64
    radii: Float64

    @property
    def duration_ns(self) -> int:
        """The period after which all motions repeat [ns]."""
        return len(self.root) * PERIOD_NS

    def positions_at(self, room_ns: int) -> Float64:
        """Return the joints (people, 25, 3) of `simulate.body.BODY` at a room time [ns], in the world [m].

        All motions repeat after `duration_ns`. Between two poses, root positions and bone directions are interpolated
        linearly; the directions are then normalised, so bones keep their lengths.
        """
        index, rest = divmod(room_ns % self.duration_ns, PERIOD_NS)
        after, weight = (index + 1) % len(self.root), rest / PERIOD_NS
        root = (1 - weight) * self.root[index] + weight * self.root[after]
        directions = (1 - weight) * self.directions[index] + weight * self.directions[after]
        return joint_positions(root, normalised(directions), self.lengths)


def together(motions: list[Motion]) -> Ensemble:
    """Stack motions of several people, padded to the longest: the others then stand still in their first pose."""
    poses = max(len(motion) for motion in motions)
    padded = [motion.padded(poses) for motion in motions]
    return Ensemble(
        np.stack([motion.root for motion in padded], axis=1),
        np.stack([motion.directions for motion in padded], axis=1),
        np.stack([motion.lengths for motion in padded]),
        np.stack([motion.radii for motion in padded]),
    )


def normalised(vectors: Float64) -> Float64:
    """Return vectors (..., n) normalised along the last axis; zero vectors are kept."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return np.asarray(vectors / np.where(length > 1e-9, length, 1.0))


def smooth_step(u: Float64) -> Float64:
    """Return a smooth step (...,) from 0 to 1 for ``u`` from 0 to 1, with zero slope at both ends (cubic Hermite)."""
    v = np.clip(u, 0.0, 1.0)
    return np.asarray(v**2 * (3 - 2 * v))
