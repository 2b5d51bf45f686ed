"""Write binary glTF 2.0 (GLB): an animated skeleton with a skin, which Blender, game engines and browsers read.

Khronos Group, *glTF 2.0 Specification* (2021), sections 3.6 (buffers), 3.7.3 (skins), 3.11 (animations) and 4.4 (GLB).
A file of the humanoid ``vrm`` also is a VRM animation: VRM Consortium, *VRMC_vrm_animation 1.0*.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella import __version__
from mocapella.errors import SettingsError
from mocapella.exports.animated_skeleton import AnimatedSkeleton, animated_skeleton
from mocapella.model.trajectories import Trajectories

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_KINDS: Final = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_MOST_BYTES: Final = (1 << 32) - (1 << 24)
"""Size of a file; its header has 32 bits for it."""
_SKIN_COLOUR: Final = (0.55, 0.60, 0.66, 1.0)


class _Buffer:
    """The numbers of the file, with their accessors."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
        self, values: NDArray[Any], component: int = _FLOAT, *, target: int | None = None, span: bool = False
    ) -> int:
        """Append an array (count, …) of 4-byte aligned rows; return the index of its accessor."""
        kind = {_FLOAT: np.float32, _UINT16: np.uint16, _UINT32: np.uint32}[component]
        array = np.ascontiguousarray(values, dtype=kind)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": array.nbytes}
        accessor: dict[str, Any] = {
            "bufferView": len(self.views), "componentType": component, "count": len(array),
            "type": _KINDS[array.shape[1:]],
        }  # fmt: skip
        if target is not None:
            view["target"] = target
        if span:
            accessor |= {
                "min": np.atleast_1d(array.min(axis=0)).tolist(),
                "max": np.atleast_1d(array.max(axis=0)).tolist(),
            }
        self.views.append(view)
        self.accessors.append(accessor)
        self.parts.append(array.tobytes())
        self.size += array.nbytes
        return len(self.accessors) - 1


def write_glb(trajectories: Trajectories, path: Path, *, humanoid: str | None = None) -> list[str]:
    """Write one individual as GLB: a skeleton, its skin, and an animation with root motion; metres, y up.

    At rest, people and bodies stand in a T pose that looks along +z. The animation's ``extras`` list the
    frames with held joints and observed twists.

    Args:
        trajectories: one individual at a constant rate.
        path: the file.
        humanoid: names of the bones; None for ``vrm``. Hands and arms have the names of their landmarks.

    Returns:
        Sentences about the residual of rigid bones, joints that are held, and twists.

    Raises:
        SettingsError: the individual has no skeleton or is never known, or the file would be larger than 4 GB.
        OSError: the file cannot be written.
    """
    one = animated_skeleton(trajectories, humanoid)
    content, buffer = _content(one, trajectories.times_s - trajectories.times_s[0])
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + buffer.size
    if total > _MOST_BYTES:
        raise SettingsError(f"{one.name}: a GLB of {total >> 30} GB is too large; choose a lower --rate")
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", buffer.size, b"BIN\0"))
        for part in buffer.parts:
            file.write(part)
    return one.notes


def _content(one: AnimatedSkeleton, times_s: NDArray[np.float64]) -> tuple[dict[str, Any], _Buffer]:
    """Return the JSON and the numbers; the joints are the first nodes, then the skin, then the individual."""
    buffer, skeleton = _Buffer(), one.motion.skeleton
    count = len(skeleton.parents)
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(skeleton.names):
        place = one.rest[0] if joint == 0 else skeleton.offsets[joint]
        children = np.flatnonzero(skeleton.parents == joint).tolist()
        nodes.append({"name": name, "translation": place.tolist(), **({"children": children} if children else {})})
    nodes.append({"name": "Skin", "mesh": 0, "skin": 0})
    nodes.append({"name": one.name, "children": [0]})
    bind = np.tile(np.eye(4), (count, 1, 1))
    bind[:, 3, :3] = -one.rest  # columns first
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"Mocapella {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [count, count + 1]}],
        "nodes": nodes,
        "meshes": [{"name": "Skin", "primitives": [_primitive(one, buffer)]}],
        "materials": [{"name": "Skin", "pbrMetallicRoughness": {
            "baseColorFactor": _SKIN_COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.7}}],
        "skins": [{"joints": list(range(count)), "skeleton": 0, "inverseBindMatrices": buffer.add(bind)}],
        "animations": [_animation(one, times_s, buffer)],
    }  # fmt: skip
    if one.marks.get("humanoid") == "vrm":
        bones = {name: {"node": joint} for joint, name in enumerate(skeleton.names)}
        content["extensionsUsed"] = ["VRMC_vrm_animation"]
        content["extensions"] = {"VRMC_vrm_animation": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    content |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": buffer.size}]}
    return content, buffer


def _primitive(one: AnimatedSkeleton, buffer: _Buffer) -> dict[str, Any]:
    skin = one.skin
    return {
        "attributes": {
            "POSITION": buffer.add(skin.vertices, target=_ARRAY, span=True),
            "NORMAL": buffer.add(skin.normals, target=_ARRAY),
            "JOINTS_0": buffer.add(np.where(skin.shares > 0, skin.joints, 0), _UINT16, target=_ARRAY),
            "WEIGHTS_0": buffer.add(skin.shares, target=_ARRAY),
        },
        "indices": buffer.add(skin.faces.ravel(), _UINT32, target=_ELEMENTS),
        "material": 0,
    }


def _animation(one: AnimatedSkeleton, times_s: NDArray[np.float64], buffer: _Buffer) -> dict[str, Any]:
    """Return the animation: the root's translation, and all rotations; constant ones have one key."""
    every, first = buffer.add(times_s, span=True), buffer.add(times_s[:1], span=True)
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []

    def add(node: int, path: str, values: NDArray[np.floating]) -> None:
        constant = bool(np.all(np.abs(values - values[0]) < 1e-9))
        keys = buffer.add(values[:1] if constant else values)
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": first if constant else every, "output": keys, "interpolation": "LINEAR"})

    add(0, "translation", one.motion.root)
    for joint in range(len(one.rest)):
        add(joint, "rotation", one.rotations[:, joint])
    return {"name": one.name, "channels": channels, "samplers": samplers, "extras": {"mocapella": one.marks}}
