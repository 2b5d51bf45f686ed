"""A body to be tracked, its initial pose, where it is known to be later, and a description to rebuild its mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose

Float64 = NDArray[np.float64]


class LaterJoints(msgspec.Struct, frozen=True, eq=False):
    """Joints of a body that are known at one instant, such as of triangulated keypoints.

    Attributes:
        at_s: time since the first frame [s].
        joints: positions (3,) in the world [m], by landmark name.
    """

    at_s: float
    joints: Mapping[str, Float64]


class InitialBody(msgspec.Struct, frozen=True, eq=False):
    """A body and its initial pose.

    Attributes:
        mesh: the body's mesh.
        pose: approximate initial pose.
        build: JSON description of the mesh, see `TrackedBody.build`; empty if not given.
        later: joints at later instants, to find a lost body again; in any order.
    """

    mesh: RiggedMesh
    pose: TreePose
    build: str = ""
    later: Sequence[LaterJoints] = ()

    def known_at(self, at_s: float, within_s: float) -> Mapping[str, Float64]:
        """Return the joints of the instant of ``later`` nearest to a time; none if it is farther away.

        Args:
            at_s: time since the first frame [s].
            within_s: largest distance in time [s].
        """
        nearest = min(self.later, key=lambda one: abs(one.at_s - at_s), default=None)
        return {} if nearest is None or abs(nearest.at_s - at_s) > within_s else nearest.joints


def build_of(model: str, height_m: float | None, proportions: Mapping[str, float], sha256: str = "") -> str:
    """Return the JSON description of a body's mesh, for a reader to rebuild it; see `TrackedBody.build`.

    Args:
        model: male, female, legs, or the name of a mesh file.
        height_m: subject height; None if not given [m].
        proportions: known lengths of segments, by name [m].
        sha256: hash of the mesh file, in hexadecimal digits; empty without one. With it, only model and hash are
            stored.
    """
    if sha256:
        return json.dumps({"model": model, "sha256": sha256})
    return json.dumps({"model": model, "height_m": height_m, "proportions": dict(proportions)})
