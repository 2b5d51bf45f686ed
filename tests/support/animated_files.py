"""Read animated skeletons back from GLB and USD text, as another program would."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mocapella.model.gltf import Gltf


@dataclass
class Animated:
    """Joints: positions (frames, joints, 3), transforms from the bind pose (frames, joints, 4, 4), and a skin."""

    names: list[str]
    positions: np.ndarray
    skinning: np.ndarray
    rotations: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    shares: np.ndarray
    times_s: np.ndarray
    extra: Any

    def posed(self, frame: int) -> np.ndarray:
        """The skin's vertices in a frame, by linear blend skinning."""
        T = np.einsum("nk,nkij->nij", self.shares, self.skinning[frame][self.joints])
        return np.einsum("nij,nj->ni", T, np.column_stack([self.vertices, np.ones(len(self.vertices))]))[:, :3]


def _animated(
    names: list[str], parents: list[int], t: np.ndarray, q: np.ndarray, bind: np.ndarray, **more: Any
) -> Animated:
    """Forward kinematics of local translations (frames, joints, 3) and quaternions (frames, joints, 4)."""
    local = np.tile(np.eye(4), (*q.shape[:2], 1, 1))
    local[..., :3, :3] = Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:2], 3, 3)
    local[..., :3, 3] = t
    T = np.empty_like(local)
    for joint, parent in enumerate(parents):
        T[:, joint] = local[:, joint] if parent < 0 else T[:, parent] @ local[:, joint]
    return Animated(names, T[..., :3, 3], T @ np.linalg.inv(bind), q, **more)


def read_glb(path: Path) -> Animated:
    gltf = Gltf(path)
    content = gltf.content
    (skin,), (animation,) = content.skins, content.animations
    joints = skin.joints
    (every,) = {len(gltf.array(s.input, "times", "SCALAR")) for s in animation.samplers} - {1} or {1}
    t = np.array([content.nodes[k].translation for k in joints])
    t, q = np.tile(t, (every, 1, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (every, len(joints), 1))
    times = np.zeros(1)
    for channel in animation.channels:
        sampler = animation.samplers[channel.sampler]
        own = gltf.array(sampler.input, "times", "SCALAR")
        times = own if len(own) == every else times
        to = t if channel.target.path == "translation" else q
        to[:, joints.index(channel.target.node)] = gltf.array(sampler.output, "values", "VEC3", "VEC4")
    attributes = content.meshes[0].primitives[0].attributes
    return _animated(
        [content.nodes[k].name for k in joints], [gltf.parents[k] if gltf.parents[k] in joints else -1 for k in joints],
        t, q, np.linalg.inv(np.swapaxes(gltf.array(skin.inverseBindMatrices, "bind", "MAT4"), 1, 2)),
        vertices=gltf.array(attributes.POSITION, "positions", "VEC3"),
        faces=gltf.array(content.meshes[0].primitives[0].indices, "faces", "SCALAR").reshape(-1, 3),
        joints=gltf.array(attributes.JOINTS_0, "joints", "VEC4"),
        shares=gltf.array(attributes.WEIGHTS_0, "weights", "VEC4"), times_s=times, extra=content,
    )  # fmt: skip


def read_usd(path: Path) -> Animated:
    text = path.read_text(encoding="utf-8")

    def numbers(name: str, width: int = 0) -> np.ndarray:
        (found,) = re.findall(rf"{re.escape(name)} = (\[.*?\]) ?(?:\(|\n)", text)
        values = np.array([float(word) for word in re.findall(r"[-+0-9.e]+", found)])
        return values.reshape(-1, width) if width else values

    def samples(name: str, width: int) -> np.ndarray:
        (block,) = re.findall(rf"{name}\.timeSamples = \{{\n(.*?)\n        \}}", text, re.S)
        rows = [row.split(": ", 1)[1] for row in block.split("\n")]
        return np.array([[float(word) for word in re.findall(r"[-+0-9.e]+", row)] for row in rows]).reshape(
            len(rows), -1, width
        )

    paths = re.findall(r'"([^"]+)"', re.findall(r"uniform token\[\] joints = \[(.*)\]", text)[0])
    parents = [paths.index(path.rpartition("/")[0]) if "/" in path else -1 for path in paths]
    bind = numbers("bindTransforms").reshape(-1, 4, 4)
    return _animated(
        [path.rpartition("/")[2] for path in paths], parents, samples("translations", 3),
        samples("rotations", 4)[..., [1, 2, 3, 0]], np.swapaxes(bind, 1, 2), vertices=numbers("points", 3),
        faces=numbers("faceVertexIndices", 3).astype(int), joints=numbers("skel:jointIndices", 4).astype(int),
        shares=numbers("skel:jointWeights", 4),
        times_s=np.arange(len(samples("translations", 3))) / float(re.findall(r"timeCodesPerSecond = (\S+)", text)[0]),
        extra=text,
    )  # fmt: skip
