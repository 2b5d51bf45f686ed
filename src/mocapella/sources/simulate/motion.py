"""How a person moves: poses on a time grid that wraps around, read at any instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.sources.simulate.body import joint_positions

Float64 = NDArray[np.float64]

PERIOD_NS = 20_000_000
"""Distance of the poses in time: a whole number of nanoseconds, so that wrapping around is exact."""

POSE_HZ = NS_PER_S / PERIOD_NS


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses every `PERIOD_NS`; after the last comes the first.

    Attributes:
        root: (poses, 3), world [m].
        directions: (poses, 25, 3) unit vectors along the bones, world; zero for the root joint, which ends no bone.
        lengths: (25,) of the bones [m].
        radii: (25,) of the bones' capsules [m].
    """

    root: Float64
    directions: Float64
    lengths: Float64
    radii: Float64

    def __len__(self) -> int:
        return len(self.root)

    @property
    def duration_ns(self) -> int:
        """After which it begins again."""
        return len(self) * PERIOD_NS

    def padded(self, poses: int) -> Motion:
        """The same, with the first pose held still at the end until there are so many poses."""
        still = poses - len(self)
        return Motion(
            np.concatenate([self.root, np.repeat(self.root[:1], still, axis=0)]),
            np.concatenate([self.directions, np.repeat(self.directions[:1], still, axis=0)]),
            self.lengths,
            self.radii,
        )


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The motions of several people on one grid, so that one reading gives everybody.

    Attributes:
        root: (poses, people, 3); directions: (poses, people, 25, 3); lengths, radii: (people, 25).
    """

    root: Float64
    directions: Float64
    lengths: Float64
    radii: Float64

    @property
    def duration_ns(self) -> int:
        """After which everything begins again."""
        return len(self.root) * PERIOD_NS

    def positions_at(self, room_ns: int) -> Float64:
        """(people, 25, 3) joints [m]. Between two poses, directions are blended and made unit length again."""
        index, rest = divmod(room_ns % self.duration_ns, PERIOD_NS)
        after, weight = (index + 1) % len(self.root), rest / PERIOD_NS
        root = (1 - weight) * self.root[index] + weight * self.root[after]
        directions = (1 - weight) * self.directions[index] + weight * self.directions[after]
        return joint_positions(root, normalised(directions), self.lengths)


def together(motions: list[Motion]) -> Ensemble:
    """All on the grid of the longest; the others stand still at the end until it is over."""
    poses = max(len(motion) for motion in motions)
    padded = [motion.padded(poses) for motion in motions]
    return Ensemble(
        np.stack([motion.root for motion in padded], axis=1),
        np.stack([motion.directions for motion in padded], axis=1),
        np.stack([motion.lengths for motion in padded]),
        np.stack([motion.radii for motion in padded]),
    )


def normalised(vectors: Float64) -> Float64:
    """Vectors of length 1 along the last axis; what has no length stays as it is."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return np.asarray(vectors / np.where(length > 1e-9, length, 1.0))


def smooth_step(u: Float64) -> Float64:
    """From 0 to 1 as ``u`` goes from 0 to 1, beginning and ending at rest (cubic Hermite)."""
    v = np.clip(u, 0.0, 1.0)
    return np.asarray(v**2 * (3 - 2 * v))
