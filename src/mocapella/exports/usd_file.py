"""Write USD as text (.usda): an animated skeleton with a skin, by the schemas of UsdSkel.

Pixar, *Universal Scene Description*, UsdSkel schemas: SkelRoot, Skeleton, SkelAnimation and SkelBindingAPI.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.exports.animated_skeleton import AnimatedSkeleton, animated_skeleton
from mocapella.model.names import distinct
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]


def write_usd(trajectories: Trajectories, path: Path, *, humanoid: str | None = None) -> list[str]:
    """Write one individual as USD text: a skeleton, its skin, and an animation with root motion; metres, Y up.

    A time code is a frame. Names of prims have letters, digits and underscores only: ``mixamorig:Hips`` becomes
    ``mixamorig_Hips``. The animation's custom data list the frames with held joints and observed twists, as JSON.

    Args:
        trajectories: one individual at a constant rate.
        path: the file.
        humanoid: names of the bones; None for ``vrm``. Hands and arms have the names of their landmarks.

    Returns:
        Sentences about the residual of rigid bones, joints that are held, and twists.

    Raises:
        SettingsError: the individual has no skeleton, or is never known.
        OSError: the file cannot be written.
    """
    one = animated_skeleton(trajectories, humanoid)
    with path.open("w", encoding="utf-8", newline="") as file:
        for piece in _pieces(one, trajectories.rate_hz):
            file.write(piece)
    return one.notes


def joint_paths(one: AnimatedSkeleton) -> list[str]:
    """Return the path of each joint, such as ``hips/spine``, in the names of prims."""
    skeleton = one.motion.skeleton
    paths: list[str] = []
    for name, parent in zip(distinct(map(_prim, skeleton.names)), skeleton.parents.tolist(), strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def _prim(name: str) -> str:
    """Return a name as a prim may have it: ASCII letters, digits and underscores, not a digit first."""
    word = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name) or "_"
    return f"_{word}" if word[0].isdigit() else word


_HEADER: Final = """#usda 1.0
(
    defaultPrim = "{name}"
    upAxis = "Y"
    metersPerUnit = 1
    timeCodesPerSecond = {rate:.9g}
    framesPerSecond = {rate:.9g}
    startTimeCode = 0
    endTimeCode = {last}
)
def SkelRoot "{name}" (
    prepend apiSchemas = ["SkelBindingAPI"]
)
{{
    def Skeleton "Skeleton" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {{
        uniform token[] joints = {joints}
        uniform matrix4d[] bindTransforms = {bind}
        uniform matrix4d[] restTransforms = {local}
        rel skel:animationSource = </{name}/Animation>
    }}
    def SkelAnimation "Animation" (
        customData = {{
            string mocapella = {marks}
        }}
    )
    {{
        uniform token[] joints = {joints}
        half3[] scales = {scales}
"""
_MESH: Final = """    }}
    def Mesh "Skin" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {{
        int[] faceVertexCounts = {counts}
        int[] faceVertexIndices = {faces}
        point3f[] points = {points}
        normal3f[] normals = {normals} (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
        color3f[] primvars:displayColor = [(0.55, 0.6, 0.66)]
        matrix4d primvars:skel:geomBindTransform = {eye}
        int[] primvars:skel:jointIndices = {joints} (
            elementSize = 4
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = {shares} (
            elementSize = 4
            interpolation = "vertex"
        )
        rel skel:skeleton = </{name}/Skeleton>
    }}
}}
"""


def _pieces(one: AnimatedSkeleton, rate_hz: float) -> Iterator[str]:
    """Yield the text in pieces, so that a long motion is never in memory as a whole."""
    skeleton, frames = one.motion.skeleton, len(one.rotations)
    bind = np.tile(np.eye(4), (len(one.rest), 1, 1))
    local = bind.copy()
    bind[:, 3, :3] = one.rest  # rows are vectors
    local[:, 3, :3] = skeleton.offsets
    local[0, 3, :3] = one.rest[0]
    yield _HEADER.format(
        name=_prim(one.name), rate=rate_hz, last=max(frames - 1, 0), joints=_list(map(json.dumps, joint_paths(one))),
        bind=_list(map(_matrix, bind.tolist())), local=_list(map(_matrix, local.tolist())),
        marks=json.dumps(json.dumps(one.marks, separators=(",", ":"))),
        scales=_list(["(1, 1, 1)"] * len(one.rest)),
    )  # fmt: skip
    rest = [_tuple(offset) for offset in skeleton.offsets[1:].tolist()]
    yield "        float3[] translations.timeSamples = {\n"
    for frame, place in enumerate(one.motion.root.tolist()):
        yield f"            {frame}: {_list([_tuple(place), *rest])},\n"
    yield "        }\n        quatf[] rotations.timeSamples = {\n"
    for frame, quaternions in enumerate(one.rotations[..., [3, 0, 1, 2]]):  # the real part is first
        yield f"            {frame}: {_list(map(_tuple, quaternions.tolist()))},\n"
    yield "        }\n"
    skin = one.skin
    yield _MESH.format(
        name=_prim(one.name), counts=_list(["3"] * len(skin.faces)), faces=_list(map(str, skin.faces.ravel().tolist())),
        points=_list(map(_tuple, skin.vertices.tolist())), normals=_list(map(_tuple, skin.normals.tolist())),
        eye=_matrix(np.eye(4).tolist()), shares=_list(f"{share:.7g}" for share in skin.shares.ravel().tolist()),
        joints=_list(map(str, np.where(skin.shares > 0, skin.joints, 0).ravel().tolist())),
    )  # fmt: skip


def _tuple(values: Iterable[Any]) -> str:
    return f"({', '.join([f'{value:.7g}' for value in values])})"


def _matrix(rows: Iterable[Any]) -> str:
    return f"( {', '.join(map(_tuple, rows))} )"


def _list(items: Iterable[str]) -> str:
    return f"[{', '.join(items)}]"
