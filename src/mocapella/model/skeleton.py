"""The skeleton of tracked people, and the mapping of every sensor's bodies to it.

People have the joints of `SKELETON`, whichever sensors see them. A sensor with another topology is mapped to it by the
weights in its topology's file: each joint is a weighted mean of the sensor's own joints, so it moves with them rigidly.
"""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.topology import Topology, Weights, topology, topology_names

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

SKELETON: Final = topology("kinect_v2")
"""Topology of all tracked people; the learnt models, such as of facing and joint bias, are for it."""


class JointMapping(NamedTuple):
    """How a topology's joints determine the joints of another one, the target.

    Attributes:
        weights: (targets, joints) weight of each joint in each target; a row sums to 1, or is 0 without contributors.
        uses: (targets, joints) whether a joint contributes.
        known: (targets,) whether the target has contributors.
    """

    weights: Float64
    uses: NDArray[np.bool_]
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, own: Topology, target: Topology, table: Weights) -> JointMapping:
        """Return the mapping from the joints of one topology to the joints of another.

        Args:
            own: the topology of the given joints.
            target: the topology of the joints to compute.
            table: weights of ``own`` for ``target``, as in ``own.mappings``.
        """
        weights = np.zeros((len(target), len(own)))
        for joint, terms in table.items():
            for contributor, weight in terms.items():
                weights[joint, contributor] = weight
        uses = weights != 0
        return cls(weights, uses, uses.any(axis=-1))

    def positions(self, positions: Float64) -> Float64:
        """Return the targets (..., targets, 3) of joints at ``positions`` (..., joints, 3) [m].

        A target is NaN if a joint that contributes to it is NaN, or if none contributes.
        """
        missing = np.asarray(np.isnan(positions).any(axis=-1))
        mapped = self.weights @ np.where(missing[..., None], 0.0, positions)
        mapped[~self.known | (missing[..., None, :] & self.uses).any(axis=-1)] = np.nan
        return np.asarray(mapped)

    def states(self, states: UInt8) -> UInt8:
        """Return the `JointState` (..., targets) of the targets, given the joints' ``states`` (..., joints).

        It is the lowest of the contributing joints' states; NOT_TRACKED if none contributes.
        """
        worst = np.where(self.uses, states[..., None, :], JointState.TRACKED).min(axis=-1)
        return np.where(self.known, worst, JointState.NOT_TRACKED).astype(np.uint8)


@cache
def skeleton_mapping(name: str) -> JointMapping | None:
    """Return the mapping of the topology with that name to `SKELETON`; None if it has none.

    Raises:
        SettingsError: unknown topology; lists the known ones.
    """
    own = topology(name)
    table = own.mappings.get(SKELETON.name)
    return None if table is None else JointMapping.of(own, SKELETON, table)


def mapping_problem(own: Topology) -> str:
    """Return why bodies of a topology cannot be mapped to `SKELETON`; empty if they can."""
    if own.name == SKELETON.name or SKELETON.name in own.mappings:
        return ""
    mapped = [name for name in topology_names() if SKELETON.name in topology(name).mappings]
    return f"topology {own.name} has no mapping to {SKELETON.name}; send one of {', '.join((SKELETON.name, *mapped))}"


def to_skeleton(bodies: Bodies) -> Bodies:
    """Return bodies with the joints of `SKELETON`; bodies that have them already, unchanged.

    Raises:
        ValueError: their topology has no mapping, see `mapping_problem`.
    """
    if bodies.topology.name == SKELETON.name:
        return bodies
    mapping = skeleton_mapping(bodies.topology.name)
    if mapping is None:
        raise ValueError(mapping_problem(bodies.topology))
    positions, states = mapping.positions(bodies.positions), mapping.states(bodies.states)
    return Bodies(bodies.sensor, SKELETON, bodies.ids, positions, states)
