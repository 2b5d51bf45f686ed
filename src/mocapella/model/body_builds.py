"""The JSON of which a reader makes a fitted body's mesh again (`mocapella.model.scene.TrackedBody.build`).

{"model": "female", "height_m": 1.68, "proportions": {"thigh": 0.43}}
{"model": "robot.glb", "sha256": "…"}      the mesh is a file's, which is not in the JSON
"""

from __future__ import annotations

from typing import Final

import msgspec

from mocapella.errors import SettingsError
from mocapella.model.body_meshes import body_mesh, legs_mesh
from mocapella.model.body_proportions import BodyProportions, Sex
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.settings import parse

MODELS: Final = ("male", "female", "legs")


class BodyBuild(msgspec.Struct, frozen=True, omit_defaults=True):
    """How a body's mesh is made.

    Attributes:
        model: of `MODELS`, or the name of a mesh's file.
        height_m: where it was given.
        proportions: lengths of segments [m] and girth, by name; those that were measured.
        sha256: of the mesh's file, in hexadecimal digits; empty of `MODELS`.
    """

    model: str
    height_m: float | None = None
    proportions: dict[str, float] = {}
    sha256: str = ""

    def encode(self) -> str:
        """As JSON."""
        return msgspec.json.encode(self).decode()


def mesh_of_build(build: str) -> RiggedMesh:
    """The mesh that a body was fitted with; of the same text the same mesh.

    Raises:
        SettingsError: the text is no build, its values are nobody's, or its mesh is a file's.
    """
    try:
        told = msgspec.json.decode(build, type=BodyBuild)
    except msgspec.DecodeError as error:
        raise SettingsError(f"build {build[:80]!r} cannot be read: {error}") from None
    if told.sha256 or told.model not in MODELS:
        raise SettingsError(f"the mesh {told.model!r} is a file's, which is not here")
    proportions = parse(BodyProportions, told.proportions, where="proportions of a body's build")
    if told.model == "legs":
        return legs_mesh("male", told.height_m, proportions)
    sex: Sex = "female" if told.model == "female" else "male"
    return body_mesh(sex, told.height_m, proportions, supple=True)
