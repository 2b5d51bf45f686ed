"""The JSON from which a reader rebuilds a fitted body's mesh (`mocapella.model.scene.TrackedBody.build`).

{"model": "female", "height_m": 1.68, "proportions": {"thigh": 0.43}}
{"model": "robot.glb", "sha256": "…"}      a mesh file, whose contents are not in the JSON
"""

from __future__ import annotations

from typing import Final

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import InputError, SettingsError
from mocapella.model.body_meshes import body_mesh, legs_mesh
from mocapella.model.body_proportions import BodyProportions, Sex
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.settings import parse

MODELS: Final = ("male", "female", "legs")


class BodyBuild(msgspec.Struct, frozen=True, omit_defaults=True):
    """The parameters of a body's mesh.

    Attributes:
        model: one of `MODELS`, or the name of a mesh file.
        height_m: subject height; None if not given [m].
        proportions: fields of `BodyProportions` by name: known lengths [m] and girth; None for a mesh file.
        sha256: hash of the mesh file, in hexadecimal digits; empty for one of `MODELS`.
    """

    model: str
    height_m: float | None = None
    proportions: dict[str, float] | None = None
    sha256: str = ""


def mesh_of_build(build: str) -> RiggedMesh:
    """Rebuild the mesh that was fitted to a person, from the JSON `TrackedBody.build`; equal texts give equal meshes.

    Raises:
        SettingsError: the text is no build, its values are impossible, or its mesh comes from a file.
    """
    try:
        told = decode_json(build, BodyBuild)
    except InputError as error:
        raise SettingsError(f"{build[:80]!r} does not say which body it is: {error}") from None
    if told.sha256 or told.model not in MODELS or told.proportions is None:
        wanted = "a model and its proportions; a mesh's file is not in it"
        raise SettingsError(f"{build[:80]!r} does not say which body it is: it must have {wanted}")
    proportions = parse(BodyProportions, told.proportions, where="proportions of a body's build")
    return built_mesh(told.model, told.height_m, proportions)


def built_mesh(model: str, height_m: float | None, proportions: BodyProportions) -> RiggedMesh:
    """Return the mesh of one of `MODELS` for a subject height [m], None if unknown, and proportions.

    A ``male`` or ``female`` body has 29 degrees of freedom: its neck moves and its waist turns. The ``legs`` are a
    man's. A name that is none of `MODELS` counts as ``male``.

    Raises:
        SettingsError: implausible height or proportions.
    """
    if model == "legs":
        return legs_mesh("male", height_m, proportions)
    # Real people nod and turn: without these joints, the head pulls the trunk.
    sex: Sex = "female" if model == "female" else "male"
    return body_mesh(sex, height_m, proportions, supple=True)
