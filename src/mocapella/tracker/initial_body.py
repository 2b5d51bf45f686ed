"""A body to be tracked, its initial pose, and a description to rebuild its mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping

import msgspec

from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose


class InitialBody(msgspec.Struct, frozen=True, eq=False):
    """A body and its initial pose.

    Attributes:
        mesh: the body's mesh.
        pose: approximate initial pose.
        build: JSON description of the mesh, see `TrackedBody.build`; empty if not given.
    """

    mesh: RiggedMesh
    pose: TreePose
    build: str = ""


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
