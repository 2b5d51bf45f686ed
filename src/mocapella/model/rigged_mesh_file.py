"""Read and write rigged meshes as glTF files: ours without loss, and files of other programs.

    save_rigged_mesh("anna.glb", body)
    dog = load_rigged_mesh("dog.glb")

**Files of others.** The skin's joints become parts; the joint without a parent is the root. Each of the others rotates
about the three axes of its node, "<node> x", "y", "z", without limits, and its position is a landmark of its name. The
rest pose is the nodes' pose in the file, in metres, y up. A file without a skin is a rigid object.

**Our files** have more data in ``extras``, which other programs keep or drop, and which may be written by hand. In a
joint's node::

    {"mocapella": {"turns": [{"name": "left knee flexion", "axis": [1, 0, 0], "point": [0.09, 0.5, 0],
                              "limits_rad": [0, 2.36]}]}}

and in the skin, or in the mesh's node if there is none::

    {"mocapella": {"root": [0, 0.93, 0], "landmarks": {"left knee": {"part": "left thigh", "point": [0.09, 0.5, 0]}}}}

Axes and points are those of the mesh at rest, in metres. Positions and weights are numbers of 32 bits.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import FAULTS, convert
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.geometry.twists import revolute
from mocapella.model.gltf import EXPORT, Gltf, pygltflib
from mocapella.model.rigged_mesh import Landmark, RiggedMesh, rigid_mesh
from mocapella.model.twist_tree import twist_tree
from mocapella.model.whole_file import write_whole

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Triple = tuple[float, float, float]

OURS: Final = "mocapella"
WEIGHTS_WITHIN: Final = 0.01
"""Tolerance of the sum of weights, for the rounding of other programs."""
_MOST_VERTICES: Final = 1 << 20
_MOST_PIECES: Final = 1024
_IDENTITY_WITHIN: Final = 1e-6
_TRIANGLES: Final = 4
_WEIGH: Final = "give each vertex weights that add up to 1 (in Blender: Weights, Normalize All) and export anew"


class _Turn(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    axis: Triple
    point: Triple
    limits_rad: tuple[float | None, float | None] = (None, None)


class _OfNode(msgspec.Struct, forbid_unknown_fields=True):
    turns: list[_Turn] = []


class _Place(msgspec.Struct, forbid_unknown_fields=True):
    part: str
    point: Triple


class _OfMesh(msgspec.Struct, forbid_unknown_fields=True):
    root: Triple
    landmarks: dict[str, _Place] = {}


def load_rigged_mesh(path: Path | str) -> RiggedMesh:
    """Read the mesh of a .glb or .gltf file, written by `save_rigged_mesh` or another program.

    Raises:
        InputError: the file does not exist or is invalid; states the field, its value and a valid one.
        SettingsError: pygltflib is not installed.
    """
    return _loaded(Path(path))


def decode_rigged_mesh(data: bytes, name: str = "mesh.glb") -> RiggedMesh:
    """Decode the content of a self-contained .glb or .gltf file.

    Args:
        data: the content.
        name: name of the file, for errors, and for the mesh if the file does not name it.

    Raises:
        InputError: the content is invalid; states the field, its value and a valid one.
        SettingsError: pygltflib is not installed.
    """
    return _loaded(Path(name), data)


def _loaded(path: Path, data: bytes | None = None) -> RiggedMesh:
    pygltflib()
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are refused later
            return _read(Gltf(path, data))
    except SettingsError as error:
        raise InputError(str(error), file=path, fix="mend the model") from None
    except FAULTS as error:
        # JSON types outside the specification, which the library accepts
        raise InputError(f"is no glTF: {error}", file=path, fix=EXPORT) from error


def _read(gltf: Gltf) -> RiggedMesh:
    skins = gltf.content.skins or []
    if len(skins) > 1:
        names = [skin.name or k for k, skin in enumerate(skins)]
        raise gltf.error(f"has {len(skins)} skins; one can be read", "skins", names, "join the meshes to one armature")
    placed = [(k, node) for k, node in enumerate(gltf.content.nodes or []) if node.mesh is not None]
    if not placed:
        raise gltf.error("has no mesh on a node", "nodes", fix="export the mesh, too")
    return _rigged(gltf, placed, skins[0]) if skins else _rigid(gltf, placed)


def save_rigged_mesh(path: Path | str, mesh: RiggedMesh) -> None:
    """Write a mesh atomically: a .glb file, or a .gltf file with embedded numbers.

    Raises:
        InputError: it cannot be written there, or the suffix is neither .glb nor .gltf.
        SettingsError: pygltflib is not installed.
    """
    path, library = Path(path), pygltflib()
    if path.suffix not in (".glb", ".gltf"):
        raise InputError("is of an unknown kind", file=path, value=path.suffix, fix="choose .glb or .gltf")
    content = _content(library, mesh)
    if path.suffix == ".glb":
        write_whole(path, b"".join(content.save_to_bytes()))
    else:
        content.convert_buffers(library.BufferFormat.DATAURI)
        write_whole(path, content.gltf_to_json().encode("utf-8"))


def _rigid(gltf: Gltf, placed: Sequence[tuple[int, Any]]) -> RiggedMesh:
    vertices, faces, _, _ = _surfaces(gltf, placed, {})
    extras = _ours(gltf, placed[0][1], f"nodes[{placed[0][0]}]", _OfMesh)
    name = gltf.name(placed[0][0])
    if extras is None:
        return rigid_mesh(name, vertices, faces)
    mesh = rigid_mesh(name, vertices, faces, {key: place.point for key, place in extras.landmarks.items()})
    return msgspec.structs.replace(mesh, tree=twist_tree([-1], root=extras.root))


def _rigged(gltf: Gltf, placed: Sequence[tuple[int, Any]], skin: Any) -> RiggedMesh:
    joints, parents = _ordered(gltf, skin.joints)
    part_of = {node: part for part, node in enumerate(joints)}
    names = tuple(gltf.name(node) for node in joints)
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise gltf.error("are names of more than one joint", "nodes", twice, "give each joint a name of its own")
    T = np.array([gltf.T_world_node(node) for node in joints])
    motions = T @ _inverse_bind(gltf, skin, T)[[skin.joints.index(node) for node in joints]]
    vertices, faces, bones, shares = _surfaces(gltf, placed, part_of, skin.joints, motions)
    twists, joint_parts, limits, turn_names = [], [], [], []
    for part, node in enumerate(joints):
        extras = _ours(gltf, gltf.item("nodes", node), f"nodes[{node}]", _OfNode)
        for turn in _default_turns(names[part], T[part]) if part and extras is None else extras.turns if extras else ():
            twists.append(revolute(turn.axis, turn.point))
            joint_parts.append(part)
            bounds = zip(turn.limits_rad, (-np.inf, np.inf), strict=True)
            limits.append([free if limit is None else limit for limit, free in bounds])
            turn_names.append(turn.name)
    whole = _ours(gltf, skin, "skins[0]", _OfMesh)
    if whole is None:
        root = T[0, :3, 3]
        landmarks = {name: Landmark(part, T[part, :3, 3].copy()) for part, name in enumerate(names)}
    else:
        root, landmarks = np.array(whole.root), {}
        for name, place in whole.landmarks.items():
            if place.part not in names:
                field = f"skins[0].extras.{OURS}.landmarks.{name}.part"
                raise gltf.error("is no joint of the skin", field, place.part, f"known: {one_of(place.part, names)}")
            landmarks[name] = Landmark(names.index(place.part), np.array(place.point))
    return RiggedMesh(
        name=skin.name or gltf.path.stem,
        tree=twist_tree(parents, joint_parts, twists, limits, root),
        part_names=names,
        joint_names=tuple(turn_names),
        vertices=vertices,
        faces=faces.astype(np.int32),
        bones=bones.astype(np.int32),
        shares=shares,
        landmarks=landmarks,
    )


def _ordered(gltf: Gltf, nodes: Sequence[int]) -> tuple[list[int], list[int]]:
    """Return the skin's joints, each after its parent, and the parents' indices."""
    if not nodes:
        raise gltf.error("are none", "skins[0].joints", fix="export the mesh with its armature")
    for node in nodes:
        gltf.item("nodes", node)
    if len(set(nodes)) < len(nodes):
        raise gltf.error("has a joint twice", "skins[0].joints", list(nodes))

    place = {node: k for k, node in enumerate(nodes)}

    def above(node: int) -> int:
        at = gltf.parents[node]
        while at >= 0 and at not in place:
            at = gltf.parents[at]
        return at

    roots = [node for node in nodes if above(node) < 0]
    if len(roots) > 1:
        names = [gltf.name(node) for node in roots]
        raise gltf.error("hang on no common joint", "skins[0].joints", names, "let one bone hold all the others")
    over = {node: above(node) for node in nodes}
    below: dict[int, list[int]] = {}
    for node in nodes:
        below.setdefault(over[node], []).append(place[node])
    ready, ordered = sorted(below[-1]), list[int]()
    while ready:  # in the file's order, if possible
        ordered.append(nodes[heapq.heappop(ready)])
        for k in below.get(ordered[-1], ()):
            heapq.heappush(ready, k)
    at = {node: k for k, node in enumerate(ordered)}
    return ordered, [at.get(over[node], -1) for node in ordered]


def _inverse_bind(gltf: Gltf, skin: Any, T: Float64) -> Float64:
    """Return (joints, 4, 4) in the skin's order; identities if there are none, as specified."""
    if skin.inverseBindMatrices is None:
        return np.tile(np.eye(4), (len(T), 1, 1))
    field = "skins[0].inverseBindMatrices"
    inverse = gltf.array(skin.inverseBindMatrices, field, "MAT4")
    if len(inverse) < len(T):
        raise gltf.error(f"is of {len(inverse)} joints; the skin has {len(T)}", field)
    return np.asarray(np.swapaxes(inverse, 1, 2))


def _default_turns(name: str, T: Float64) -> list[_Turn]:
    """Return the joint's rotations about the node's axes."""
    axes = [(float(a[0]), float(a[1]), float(a[2])) for a in T[:3, :3].T]
    point = (float(T[0, 3]), float(T[1, 3]), float(T[2, 3]))
    return [_Turn(f"{name} {letter}", axis, point) for letter, axis in zip("xyz", axes, strict=True)]


def _surfaces(
    gltf: Gltf,
    placed: Sequence[tuple[int, Any]],
    part_of: Mapping[int, int],
    joints: Sequence[int] = (),
    motions: Float64 | None = None,
) -> tuple[Float64, Int64, Int64, Float64]:
    """Join all meshes at rest: return vertices, faces, bones and shares."""
    pieces = []
    for node, placement in placed:
        mesh = gltf.item("meshes", placement.mesh)
        if placement.skin is not None:
            gltf.item("skins", placement.skin)
        for k, primitive in enumerate(mesh.primitives):
            field = f"meshes[{placement.mesh}].primitives[{k}]"
            points, faces = _triangles(gltf, primitive, field)
            if placement.skin is None or motions is None:
                at = node
                while at >= 0 and at not in part_of:
                    at = gltf.parents[at]
                T = gltf.T_world_node(node)
                bones, shares = np.full((len(points), 1), max(0, part_of.get(at, 0))), np.ones((len(points), 1))
                points = points @ T[:3, :3].T + T[:3, 3]
            else:
                indices, shares = _weights(gltf, primitive, field, len(points), len(joints))
                bones = np.array([part_of[joint] for joint in joints])[indices]
                points = _at_rest(points, bones, shares, motions)
            pieces.append((points, faces, bones, shares))
            if (total := sum(len(piece[0]) for piece in pieces)) > _MOST_VERTICES or len(pieces) > _MOST_PIECES:
                raise gltf.error(f"are more than {_MOST_VERTICES} vertices or {_MOST_PIECES} primitives", "meshes",
                                 (total, len(pieces)), "export a coarser model")  # fmt: skip
    most = max(piece[2].shape[1] for piece in pieces)
    starts = itertools.accumulate((len(piece[0]) for piece in pieces[:-1]), initial=0)
    return (
        np.concatenate([piece[0] for piece in pieces]),
        np.concatenate([piece[1] + start for piece, start in zip(pieces, starts, strict=True)]),
        np.concatenate([np.pad(piece[2], ((0, 0), (0, most - piece[2].shape[1]))) for piece in pieces]),
        np.concatenate([np.pad(piece[3], ((0, 0), (0, most - piece[3].shape[1]))) for piece in pieces]),
    )


def _triangles(gltf: Gltf, primitive: Any, field: str) -> tuple[Float64, Int64]:
    """Return (n, 3) positions and (m, 3) corners."""
    if primitive.mode not in (None, _TRIANGLES):
        raise gltf.error("are no triangles", f"{field}.mode", primitive.mode, "export triangles (mode 4)")
    if primitive.attributes.POSITION is None:
        raise gltf.error("is missing", f"{field}.attributes.POSITION")
    points = gltf.array(primitive.attributes.POSITION, f"{field}.attributes.POSITION", "VEC3")
    corners = np.arange(len(points))
    if primitive.indices is not None:
        corners = gltf.array(primitive.indices, f"{field}.indices", "SCALAR").astype(np.int64)
    beyond = corners[(corners < 0) | (corners >= len(points))]
    if len(beyond):
        raise gltf.error(f"names a vertex that is not there; there are {len(points)}", f"{field}.indices",
                         int(beyond[0]))  # fmt: skip
    if len(corners) % 3:
        raise gltf.error("is no whole number of triangles", f"{field}.indices", len(corners))
    return np.asarray(points, dtype=np.float64), corners.reshape(-1, 3)


def _weights(gltf: Gltf, primitive: Any, field: str, count: int, joints: int) -> tuple[Int64, Float64]:
    """Return (n, 4 or more) the skin's joints that move each vertex, and their weights: descending, with sum 1."""
    attributes, sets = vars(primitive.attributes), []
    for k in itertools.count():
        names = (f"JOINTS_{k}", f"WEIGHTS_{k}")
        given = [attributes.get(name) for name in names]
        if k and given == [None, None]:
            break
        for name, index in zip(names, given, strict=True):
            if index is None:
                raise gltf.error("is missing", f"{field}.attributes.{name}", fix="export the mesh with its weights")
        pair = [
            gltf.array(index, f"{field}.attributes.{name}", "VEC4") for name, index in zip(names, given, strict=True)
        ]
        for name, rows in zip(names, pair, strict=True):
            if len(rows) != count:
                raise gltf.error(f"is of {len(rows)} vertices; there are {count}", f"{field}.attributes.{name}")
        sets.append(pair)
    bones = np.concatenate([np.asarray(pair[0], dtype=np.int64) for pair in sets], axis=1)
    shares = np.concatenate([np.asarray(pair[1], dtype=np.float64) for pair in sets], axis=1)
    wrong = np.argwhere((shares > 0) & (bones >= joints))
    if len(wrong):
        vertex, k = wrong[0].tolist()
        raise gltf.error(
            f"is a joint that the skin does not have; it has {joints}: 0 to {joints - 1}",
            f"{field}.attributes.JOINTS_{k // 4} of vertex {vertex}", int(bones[vertex, k]),
            "export the mesh with the armature that it was weighted for",
        )  # fmt: skip
    total = shares.sum(axis=1)
    bad = np.flatnonzero((np.abs(total - 1.0) > WEIGHTS_WITHIN) | (shares < 0).any(axis=1))
    if len(bad):
        where = f"{field}.attributes.WEIGHTS_0 of vertex {bad[0]}"
        raise gltf.error(f"add up to {total[bad[0]]:.3g}, not 1", where, shares[bad[0]].tolist(), _WEIGH)
    order = np.argsort(-shares, axis=1, kind="stable")
    shares = np.take_along_axis(shares, order, axis=1)
    bones = np.where(shares > 0, np.take_along_axis(bones, order, axis=1), 0)
    return bones, shares / total[:, None]


def _at_rest(points: Float64, bones: Int64, shares: Float64, motions: Float64) -> Float64:
    """Move bound vertices with their nodes; unchanged if the nodes are at their bind pose."""
    if np.abs(motions - np.eye(4)).max() < _IDENTITY_WITHIN:
        return points
    moved = np.einsum("nkij,nj->nki", motions[bones][..., :3, :3], points) + motions[bones][..., :3, 3]
    return np.asarray((shares[..., None] * moved).sum(axis=1))


def _ours(gltf: Gltf, holder: Any, field: str, kind: Any) -> Any:
    """Return our data in the extras; None without any."""
    extras = holder.extras or {}
    if OURS not in extras:
        return None
    fix = "docs/bodies.md says what may stand there"
    return convert(extras[OURS], kind, what=f"{field}.extras.{OURS}", file=gltf.path, fix=fix)


def _content(library: Any, mesh: RiggedMesh) -> Any:
    """Return the mesh as glTF: an unrotated node for each part at its first joint; then the mesh's own node."""
    tree, parts, blob = mesh.tree, len(mesh.part_names), bytearray()
    content = library.GLTF2(asset=library.Asset(generator="Mocapella"))
    content.scene, content.bufferViews, content.accessors = 0, [], []

    def add(values: NDArray[Any], kind: str, component: int, target: int | None = None) -> int:
        content.bufferViews.append(
            library.BufferView(buffer=0, byteOffset=len(blob), byteLength=values.nbytes, target=target)
        )
        blob.extend(values.tobytes())
        blob.extend(b"\0" * (-len(blob) % 4))
        extent = {}
        if kind == "VEC3":
            extent = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        content.accessors.append(library.Accessor(
            bufferView=len(content.bufferViews) - 1, componentType=component, count=len(values), type=kind, **extent
        ))  # fmt: skip
        return len(content.accessors) - 1

    whole = {"root": tree.root.tolist(), "landmarks": {
        name: {"part": mesh.part_names[landmark.part], "point": landmark.point.tolist()}
        for name, landmark in mesh.landmarks.items()
    }}  # fmt: skip
    array, element = library.ARRAY_BUFFER, library.ELEMENT_ARRAY_BUFFER
    attributes = {"POSITION": add(mesh.vertices.astype("<f4"), "VEC3", library.FLOAT, array)}
    faces = add(mesh.faces.astype("<u4").ravel(), "SCALAR", library.UNSIGNED_INT, element)
    rigged = parts > 1 or len(mesh.joint_names) > 0
    if rigged:
        width = -mesh.bones.shape[1] % 4
        bones, shares = (np.pad(rows, ((0, 0), (0, width))) for rows in (mesh.bones, mesh.shares))
        for k in range(bones.shape[1] // 4):
            four = slice(4 * k, 4 * k + 4)
            attributes[f"JOINTS_{k}"] = add(bones[:, four].astype("<u2"), "VEC4", library.UNSIGNED_SHORT, array)
            attributes[f"WEIGHTS_{k}"] = add(shares[:, four].astype("<f4"), "VEC4", library.FLOAT, array)
        pivots = _pivots(mesh)
        inverse = np.tile(np.eye(4, dtype="<f4"), (parts, 1, 1))
        inverse[:, 3, :3] = -pivots  # by columns
        content.skins = [library.Skin(
            name=mesh.name, joints=list(range(parts)), inverseBindMatrices=add(inverse.reshape(-1, 16), "MAT4",
            library.FLOAT), extras={OURS: whole},
        )]  # fmt: skip
        content.nodes = [_node(library, mesh, part, pivots) for part in range(parts)]
        content.nodes.append(library.Node(name=mesh.name, mesh=0, skin=0))
        content.scenes = [library.Scene(nodes=[0, parts])]
    else:
        content.nodes = [library.Node(name=mesh.name, mesh=0, extras={OURS: whole})]
        content.scenes = [library.Scene(nodes=[0])]
    primitive = library.Primitive(attributes=library.Attributes(**attributes), indices=faces)
    content.meshes = [library.Mesh(name=mesh.name, primitives=[primitive])]
    content.buffers = [library.Buffer(byteLength=len(blob))]
    content.set_binary_blob(bytes(blob))
    return content


def _pivots(mesh: RiggedMesh) -> Float64:
    """Return (parts, 3) a point on the axis of each part's first joint: where the landmark that is nearest to the axis
    projects to; the root for a part without joints."""
    pivots = np.tile(mesh.tree.root, (len(mesh.part_names), 1))
    v, w = mesh.tree.twists[:, :3], mesh.tree.twists[:, 3:]
    for part in np.unique(mesh.tree.joint_parts):
        first = int(np.flatnonzero(mesh.tree.joint_parts == part)[0])
        foot, axis = np.cross(w[first], v[first]), w[first]
        points = np.array([landmark.point for landmark in mesh.landmarks.values()]).reshape(-1, 3)
        onto = foot + ((points - foot) @ axis)[:, None] * axis
        pivots[part] = onto[np.linalg.norm(points - onto, axis=1).argmin()] if len(points) else foot
    return pivots


def _node(library: Any, mesh: RiggedMesh, part: int, pivots: Float64) -> Any:
    tree, turns = mesh.tree, []
    for k in np.flatnonzero(tree.joint_parts == part).tolist():
        v, w = tree.twists[k, :3], tree.twists[k, 3:]
        limits = [float(limit) if np.isfinite(limit) else None for limit in tree.limits[k]]
        turns.append({"name": mesh.joint_names[k], "axis": w.tolist(), "point": np.cross(w, v).tolist(),
                      "limits_rad": limits})  # fmt: skip
    parent = int(tree.parents[part])
    return library.Node(
        name=mesh.part_names[part],
        translation=(pivots[part] - (pivots[parent] if parent >= 0 else 0.0)).tolist(),
        children=np.flatnonzero(tree.parents == part).tolist(),
        extras={OURS: {"turns": turns}},
    )
