"""Small rigged meshes, poses of any, and what is true of closed surfaces, for the tests of several rooms."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import revolute
from mocapella.model.rigged_mesh import Landmark, RiggedMesh
from mocapella.model.twist_tree import TreePose, twist_tree

Float64 = NDArray[np.float64]

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])
BOX_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
"""Of a box with these corners, outwards anticlockwise."""


def worm() -> RiggedMesh:
    """Two boxes' length of three parts in a row along x, the joints between them about z and y."""
    vertices = np.concatenate([CORNERS, np.add(CORNERS, [1.0, 0.0, 0.0])])
    shares = np.zeros((16, 2))
    shares[:, 0] = 1.0
    shares[4:8] = 0.75, 0.25
    bones = np.zeros((16, 2), dtype=np.int32)
    bones[4:8] = 1, 0
    bones[8:12, 0], bones[12:, 0] = 1, 2
    twists = revolute([[0, 0, 1], [0, 1, 0]], [[1, 0, 0], [2, 0, 0]])
    return RiggedMesh(
        name="worm",
        tree=twist_tree([-1, 0, 1], [1, 2], twists, [[-1, 2], [-np.inf, np.inf]], root=[0.5, 1, 1.5]),
        part_names=("tail", "middle", "head"),
        joint_names=("bend", "nod"),
        vertices=vertices,
        faces=np.concatenate([BOX_FACES, BOX_FACES + 8]).astype(np.int32),
        bones=bones,
        shares=shares,
        landmarks={"waist": Landmark(0, np.array([1.0, 0, 0])), "snout": Landmark(2, np.array([3.0, 1, 1.5]))},
    )


def any_motion(rng: np.random.Generator) -> Float64:
    return rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))


def any_pose(rng: np.random.Generator, mesh: RiggedMesh, share: float = 1.0) -> TreePose:
    """Within so much of the limits, those that are infinite being of half a turn."""
    limits = share * np.clip(mesh.tree.limits, -np.pi, np.pi)
    return TreePose(any_motion(rng), rng.uniform(*limits.T))


def volume(mesh: RiggedMesh) -> float:
    """Inside a closed surface [m³]; negative where its triangles look inwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def is_closed(mesh: RiggedMesh) -> bool:
    """Whether each edge has one triangle on each side, and every vertex a triangle."""
    edges = Counter(zip(mesh.faces.ravel().tolist(), np.roll(mesh.faces, -1, axis=1).ravel().tolist(), strict=True))
    once = all(count == 1 for count in edges.values())
    return once and all((b, a) in edges for a, b in edges) and len(np.unique(mesh.faces)) == len(mesh.vertices)


def is_own_mirror_image(mesh: RiggedMesh) -> bool:
    """Whether x → −x brings vertices onto vertices, and triangles onto triangles that are turned round."""
    order = {tuple(vertex): k for k, vertex in enumerate(mesh.vertices.tolist())}
    image = np.array([order.get((-x, y, z) if x else (0.0, y, z), -1) for x, y, z in mesh.vertices.tolist()])
    if (image < 0).any():
        return False

    def turned(faces: NDArray[np.int32]) -> set[tuple[int, ...]]:
        return {min(tuple(np.roll(face, k).tolist()) for k in range(3)) for face in faces}

    return turned(mesh.faces) == turned(image[mesh.faces][:, ::-1])
