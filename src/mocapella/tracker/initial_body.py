"""A body that is to be followed, where it begins, and how its mesh is made again."""

from __future__ import annotations

import json
from collections.abc import Mapping

import msgspec

from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose


class InitialBody(msgspec.Struct, frozen=True, eq=False):
    """A body and where it begins.

    Attributes:
        mesh: of the body.
        pose: about where it is at first.
        build: JSON from which a reader rebuilds the mesh, see `TrackedBody.build`; empty if not given.
    """

    mesh: RiggedMesh
    pose: TreePose
    build: str = ""


def build_of(model: str, height_m: float | None, proportions: Mapping[str, float], sha256: str = "") -> str:
    """`TrackedBody.build` of a body.

    Args:
        model: male, female, legs, or the name of a mesh's file.
        height_m: where it was given.
        proportions: known lengths of segments [m], by name.
        sha256: of the mesh's file, in hexadecimal digits; empty where there is none.
    """
    if sha256:
        return json.dumps({"model": model, "sha256": sha256})
    return json.dumps({"model": model, "height_m": height_m, "proportions": dict(proportions)})
