"""Meshes as glTF: ours come back as they were, those of others are read, and what is wrong with a file is said."""

from __future__ import annotations

import base64
import builtins
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rigged_meshes import BOX_FACES, CORNERS, any_pose, worm

from mocapella.errors import InputError, SettingsError
from mocapella.model import gltf
from mocapella.model.body_meshes import body_mesh, legs_mesh
from mocapella.model.hand import hand_model
from mocapella.model.hand_mesh import hand_mesh
from mocapella.model.rigged_mesh import Landmark, RiggedMesh, landmarks_at, posed, rigid_mesh
from mocapella.model.rigged_mesh_file import decode_rigged_mesh, load_rigged_mesh, save_rigged_mesh

BOX = rigid_mesh("box", CORNERS, BOX_FACES, {"corner": (1, 2, 3)})
MESHES: dict[str, Callable[[], RiggedMesh]] = {
    "a body": lambda: body_mesh("female", 1.7),
    "legs": lambda: legs_mesh("male"),
    "a hand": lambda: hand_mesh(hand_model("full").shape("left")),
    "a worm": worm,
    "a box": lambda: BOX,
}


def assert_same(one: RiggedMesh, other: RiggedMesh, atol: float = 1e-6) -> None:
    """Names, degrees of freedom, limits and landmarks exactly; axes to rounding; surfaces to 32 bits."""
    assert one.name == other.name
    assert one.part_names == other.part_names
    assert one.joint_names == other.joint_names
    np.testing.assert_array_equal(one.tree.parents, other.tree.parents)
    np.testing.assert_array_equal(one.tree.joint_parts, other.tree.joint_parts)
    np.testing.assert_allclose(one.tree.twists, other.tree.twists, atol=1e-14)
    np.testing.assert_array_equal(one.tree.limits, other.tree.limits)
    np.testing.assert_array_equal(one.tree.root, other.tree.root)
    assert list(one.landmarks) == list(other.landmarks)
    for a, b in zip(one.landmarks.values(), other.landmarks.values(), strict=True):
        assert a.part == b.part
        np.testing.assert_array_equal(a.point, b.point)
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_allclose(one.vertices, other.vertices, atol=atol)
    at = any_pose(np.random.default_rng(0), one)
    np.testing.assert_allclose(posed(one, at), posed(other, at), atol=10 * atol)
    np.testing.assert_allclose(landmarks_at(one, at), landmarks_at(other, at), atol=1e-12)


@pytest.mark.parametrize("which", sorted(MESHES))
@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_what_is_saved_comes_back(tmp_path: Path, which: str, kind: str) -> None:
    mesh, path = MESHES[which](), tmp_path / f"mesh.{kind}"
    save_rigged_mesh(path, mesh)
    once = load_rigged_mesh(path)
    assert_same(mesh, once)
    save_rigged_mesh(path, once)
    again = load_rigged_mesh(path)
    np.testing.assert_array_equal(again.vertices, once.vertices)
    np.testing.assert_allclose(again.shares, once.shares, atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_limits_names_and_landmarks_come_back(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng, mesh = np.random.default_rng(seed), worm()
    least = rng.choice([-np.inf, 0.0, -1.2345], 2)
    limits = np.stack([least, np.where(rng.random(2) < 0.5, np.inf, rng.uniform(0, 3, 2))], axis=1)
    landmarks = {f"é {k}": Landmark(int(rng.integers(3)), rng.normal(size=3)) for k in range(int(rng.integers(4)))}
    mesh = msgspec.structs.replace(
        mesh, tree=msgspec.structs.replace(mesh.tree, limits=limits, root=rng.normal(size=3)), landmarks=landmarks
    )
    path = tmp_path_factory.mktemp("mesh") / "worm.glb"
    save_rigged_mesh(path, mesh)
    assert_same(mesh, load_rigged_mesh(path))


@pytest.mark.parametrize("which", sorted(MESHES))
def test_a_file_has_bones_if_the_mesh_has_parts_that_move(tmp_path: Path, which: str) -> None:
    mesh, path = MESHES[which](), tmp_path / "mesh.gltf"
    save_rigged_mesh(path, mesh)
    content = json.loads(path.read_text(encoding="utf-8"))
    (primitive,) = content["meshes"][0]["primitives"]
    weighted = any(name.startswith(("JOINTS", "WEIGHTS")) for name in primitive["attributes"])
    moves = len(mesh.part_names) > 1
    assert (bool(content.get("skins")), weighted, len(content["nodes"]) > 1) == (moves, moves, moves)


def test_more_than_four_weights_a_vertex_come_back(tmp_path: Path) -> None:
    mesh = worm()
    shares = np.tile([0.3, 0.2, 0.2, 0.15, 0.1, 0.05], (16, 1))
    bones = np.tile(np.array([0, 1, 2, 0, 1, 2], dtype=np.int32), (16, 1))
    mesh = msgspec.structs.replace(mesh, bones=bones, shares=shares)
    save_rigged_mesh(tmp_path / "worm.glb", mesh)
    assert_same(mesh, load_rigged_mesh(tmp_path / "worm.glb"))


# A file of another program: an armature in centimetres, turned; parts named and ordered as it likes.
def foreign(tmp_path: Path, change: Callable[[dict[str, Any]], None] | None = None) -> Path:
    """A column of two bones, z up and in centimetres below a node that puts that right, bound elsewhere."""
    points = np.array([[x, y, z] for z in (0, 50, 100) for x, y in ((0, 0), (10, 0), (0, 10))], dtype="<f4")
    faces = np.array([[0, 2, 1], [6, 7, 8], [0, 1, 4], [0, 4, 3], [3, 4, 7], [3, 7, 6]], dtype="<u2")
    joints = np.zeros((9, 4), dtype="u1")
    weights = np.zeros((9, 4), dtype="<f4")
    weights[:, 0] = 1
    joints[:3] = (1, 0, 0, 0)  # the skin has the lower bone second
    weights[3:6, :2], joints[3:6, :2] = (0.5, 0.5), (0, 1)
    inverse = np.tile(np.eye(4, dtype="<f4"), (2, 1, 1))
    inverse[0, 3, 2] = -50  # by columns
    blob = b"".join(array.tobytes() for array in (points, weights, inverse, faces, joints))
    lengths = [array.nbytes for array in (points, weights, inverse, faces, joints)]
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]]).tolist()
    half = float(np.sqrt(0.5))
    content = {
        "asset": {"version": "2.0"},
        "nodes": [
            {"name": "scene", "children": [1, 4], "rotation": [-half, 0, 0, half], "scale": [0.01, 0.01, 0.01]},
            {"name": "lower", "children": [2]},
            {"name": "upper", "translation": [0, 0, 50], "children": [3]},
            {"name": "no joint"},
            {"name": "skinned", "mesh": 0, "skin": 0},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "WEIGHTS_0": 1, "JOINTS_0": 4}, "indices": 3}]}],
        "skins": [{"joints": [2, 1], "inverseBindMatrices": 2}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 9, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 9, "type": "VEC4"},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "MAT4"},
            {"bufferView": 3, "componentType": 5123, "count": 18, "type": "SCALAR"},
            {"bufferView": 4, "componentType": 5121, "count": 9, "type": "VEC4"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": length}
            for start, length in zip(starts, lengths, strict=True)
        ],
        "buffers": [{"byteLength": len(blob), "uri": "column.bin"}],
    }
    if change is not None:
        change(content)
    (tmp_path / "column.bin").write_bytes(blob)
    (tmp_path / "column.gltf").write_text(json.dumps(content), encoding="utf-8")
    return tmp_path / "column.gltf"


def test_a_rig_of_another_program_stands_as_its_nodes_do(tmp_path: Path) -> None:
    mesh = load_rigged_mesh(foreign(tmp_path))
    assert mesh.name == "column"
    assert mesh.part_names == ("lower", "upper"), "the parent first, whatever the skin's order"
    assert mesh.joint_names == ("upper x", "upper y", "upper z")
    assert mesh.tree.dofs == 9
    assert np.isinf(mesh.tree.limits).all()
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.1, 1.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(mesh.landmarks["upper"].point, [0, 0.5, 0], atol=1e-9)
    np.testing.assert_allclose(mesh.tree.root, 0, atol=1e-9)
    np.testing.assert_array_equal(mesh.bones[:3, 0], 0)
    np.testing.assert_array_equal(mesh.bones[6:, 0], 1)
    np.testing.assert_allclose(mesh.shares[3:6, :2], 0.5)
    # its own z, which is up in the file, is up: a turn about it leaves what lies on it
    np.testing.assert_allclose(mesh.tree.twists[2], [0, 0, 0, 0, 1, 0], atol=1e-9)


def test_the_rest_is_how_the_nodes_stand_not_how_the_mesh_was_bound(tmp_path: Path) -> None:
    def bent(content: dict[str, Any]) -> None:
        half = float(np.sqrt(0.5))
        content["nodes"][2]["rotation"] = [half, 0, 0, half]

    mesh = load_rigged_mesh(foreign(tmp_path, bent))
    assert mesh.vertices[6:, 1].max() <= 0.5 + 0.1 + 1e-6, "what is above the bend lies down"
    assert np.abs(mesh.vertices[6:, 2]).max() == pytest.approx(0.5)


def test_what_hangs_on_a_bone_without_weights_moves_with_it(tmp_path: Path) -> None:
    def hat(content: dict[str, Any]) -> None:
        content["nodes"][3]["mesh"] = 1
        content["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}}]})

    mesh = load_rigged_mesh(foreign(tmp_path, hat))
    assert len(mesh.vertices) == 18
    assert len(mesh.faces) == 6 + 3
    hat_first = 0  # the nodes' order
    np.testing.assert_array_equal(mesh.bones[hat_first : hat_first + 9, 0], 1)
    np.testing.assert_allclose(mesh.vertices[:9, 1].min(), 0.5)


def test_axes_and_limits_may_be_written_by_hand(tmp_path: Path) -> None:
    def extras(content: dict[str, Any]) -> None:
        turn = {"name": "nod", "axis": [2, 0, 0], "point": [0, 0.5, 0], "limits_rad": [-1, None]}
        content["nodes"][2]["extras"] = {"mocapella": {"turns": [turn]}, "other": 1}
        place = {"part": "upper", "point": [0, 1, 0]}
        content["skins"][0]["extras"] = {"mocapella": {"root": [0, 0.1, 0], "landmarks": {"top": place}}}

    mesh = load_rigged_mesh(foreign(tmp_path, extras))
    assert mesh.joint_names == ("nod",)
    np.testing.assert_array_equal(mesh.tree.limits, [[-1, np.inf]])
    np.testing.assert_allclose(mesh.tree.twists, [[0, 0, -0.5, 1, 0, 0]])
    assert list(mesh.landmarks) == ["top"]


def test_without_a_skin_it_is_a_rigid_object(tmp_path: Path) -> None:
    def unrigged(content: dict[str, Any]) -> None:
        del content["skins"], content["nodes"][4]["skin"]
        content["accessors"][3]["sparse"] = None

    mesh = load_rigged_mesh(foreign(tmp_path, unrigged))
    assert mesh.tree.dofs == 6
    assert mesh.name == "skinned"
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.1, 1.0, 0.0], atol=1e-7)


def patched(tmp_path: Path, offset: int, values: np.ndarray) -> Path:
    path = foreign(tmp_path)
    blob = bytearray((tmp_path / "column.bin").read_bytes())
    blob[offset : offset + values.nbytes] = values.tobytes()
    (tmp_path / "column.bin").write_bytes(blob)
    return path


WEIGHTS_AT, INVERSE_AT = 9 * 12, 9 * 12 + 9 * 16
FACES_AT = INVERSE_AT + 2 * 64
JOINTS_AT = FACES_AT + 36


@pytest.mark.parametrize(
    ("offset", "values", "said"),
    [
        (
            JOINTS_AT + 8, np.array([5], "u1"),
            r"column.gltf: field meshes\[0\].primitives\[0\].attributes.JOINTS_0 of vertex 2: 5: is a joint that the "
            r"skin does not have; it has 2: 0 to 1; export the mesh with the armature",
        ),
        (
            WEIGHTS_AT + 16, np.array([0.5], "<f4"),
            r"WEIGHTS_0 of vertex 1: \[0.5, 0.0, 0.0, 0.0\]: add up to 0.5, not 1; give each vertex weights",
        ),
        (WEIGHTS_AT + 16, np.array([0.0], "<f4"), "WEIGHTS_0 of vertex 1: .* add up to 0, not 1"),
        (WEIGHTS_AT, np.array([2, -1], "<f4"), "WEIGHTS_0 of vertex 0"),
        (WEIGHTS_AT, np.array([np.nan], "<f4"), r"WEIGHTS_0 \(accessors\[1\]\): has numbers that are not finite"),
        (FACES_AT, np.array([9], "<u2"), r"indices: 9: names a vertex that is not there; there are 9"),
    ],
)  # fmt: skip
def test_weights_and_faces_that_do_not_match_are_said(
    tmp_path: Path, offset: int, values: np.ndarray, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        load_rigged_mesh(patched(tmp_path, offset, values))


def test_a_joint_that_moves_nothing_may_be_any(tmp_path: Path) -> None:
    assert load_rigged_mesh(patched(tmp_path, JOINTS_AT + 1, np.array([77], "u1"))).bones.max() == 1


def test_weights_that_miss_one_by_rounding_are_made_to_fit(tmp_path: Path) -> None:
    mesh = load_rigged_mesh(patched(tmp_path, WEIGHTS_AT + 16, np.array([0.996], "<f4")))
    np.testing.assert_allclose(mesh.shares.sum(axis=1), 1.0)


def put(value: object, *where: str | int) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        at: Any = content
        for key in where[:-1]:
            at = at[key]
        at[where[-1]] = value

    return change


def gone(*where: str | int) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        at: Any = content
        for key in where[:-1]:
            at = at[key]
        del at[where[-1]]

    return change


ATTRIBUTES = ("meshes", 0, "primitives", 0, "attributes")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (gone("skins"), r"field skins\[0\]: is not there; the file has 0"),
        (put(1, "nodes", 4, "skin"), r"field skins\[1\]: is not there; the file has 1"),
        (gone("nodes", 4, "mesh"), "field nodes: has no mesh on a node; export the mesh, too"),
        (put([{"joints": [1]}] * 2, "skins"), "field skins: .* has 2 skins; one can be read; join the meshes"),
        (gone(*ATTRIBUTES, "WEIGHTS_0"), r"attributes.WEIGHTS_0: is missing; export the mesh with its weights"),
        (gone(*ATTRIBUTES, "JOINTS_0"), r"attributes.JOINTS_0: is missing"),
        (gone(*ATTRIBUTES, "POSITION"), r"attributes.POSITION: is missing"),
        (put(9, *ATTRIBUTES, "POSITION"), r"field accessors\[9\]: is not there; the file has 5"),
        (put(-1, *ATTRIBUTES, "POSITION"), r"field accessors\[-1\]: is not there"),
        (put("0", *ATTRIBUTES, "POSITION"), r"field accessors\[0\]: is not there"),
        (put(1, *ATTRIBUTES, "POSITION"), r"POSITION \(accessors\[1\]\): \('VEC4', 5126\): is not VEC3"),
        (put(1, "meshes", 0, "primitives", 0, "mode"), r"primitives\[0\].mode: 1: are no triangles"),
        (put(8, "accessors", 1, "count"), "WEIGHTS_0: is of 8 vertices; there are 9"),
        (put(17, "accessors", 3, "count"), "indices: 17: is no whole number of triangles"),
        (
            put({"count": 1, "indices": {"bufferView": 0, "componentType": 5123}, "values": {"bufferView": 0}},
                "accessors", 0, "sparse"),
            r"POSITION \(accessors\[0\]\): is sparse, which cannot be read; export without sparse accessors",
        ),
        (put(9999, "accessors", 0, "count"), r"ends at byte 119988 of \d+; the file is damaged or cut short"),
        (put(-9, "accessors", 0, "count"), r"has a count or offset that cannot be"),
        (put(4, "bufferViews", 0, "byteStride"), r"has a count or offset that cannot be"),
        (put(10**6, "bufferViews", 4, "byteLength"), "the file is damaged or cut short"),
        (gone("accessors", 0, "bufferView"), r"bufferViews\[None\]: is not there"),
        (put(10**6, "buffers", 0, "byteLength"), r"buffers\[0\]: has \d+ bytes of 1000000; the file is damaged"),
        (put("missing.bin", "buffers", 0, "uri"), "missing.bin: cannot be read"),
        (put("../other.bin", "buffers", 0, "uri"), r"buffers\[0\].uri: '../other.bin': is not beside the file"),
        (put("/other.bin", "buffers", 0, "uri"), "is not beside the file"),
        (put("http://there/x.bin", "buffers", 0, "uri"), "is not beside the file"),
        (put("data:;base64,????", "buffers", 0, "uri"), "is no base64"),
        (put("data:,hello", "buffers", 0, "uri"), "is no base64"),
        (gone("buffers", 0, "uri"), r"buffers\[0\]: has neither data nor a uri"),
        (put([1, 99], "skins", 0, "joints"), r"nodes\[99\]: is not there; the file has 5"),
        (put([2, 2], "skins", 0, "joints"), r"skins\[0\].joints: \[2, 2\]: has a joint twice"),
        (put([], "skins", 0, "joints"), r"skins\[0\].joints: are none"),
        (put([1, 4], "skins", 0, "joints"), r"\['lower', 'skinned'\]: hang on no common joint"),
        (put(1, "accessors", 2, "count"), "is of 1 joints; the skin has 2"),
        (put("lower", "nodes", 2, "name"), r"\['lower'\]: are names of more than one joint"),
        (put([1, 4, 2], "nodes", 0, "children"), r"nodes\[\d\]: .*has two parents"),
        (put([0], "nodes", 3, "children"), "hangs on itself"),
        (put([99], "nodes", 3, "children"), r"nodes\[99\]: is not there"),
        (put([0, 0, 0, 2], "nodes", 0, "rotation"), "is no unit quaternion"),
        (put([0, 0], "nodes", 2, "translation"), r"nodes\[2\].translation: \[0.0, 0.0\]: is not 3 finite numbers"),
        (put(["KHR_draco_mesh_compression"], "extensionsRequired"), "extensionsRequired: .*export without compression"),
        (put("1.0", "asset", "version"), "asset.version: does not say that it is glTF 2"),
        (put({"mocapella": {"turns": [{"axis": [1, 0, 0]}]}}, "nodes", 2, "extras"),
         r"nodes\[2\].extras.mocapella: Object missing required field `name`"),
        (put({"mocapella": {"turns": [{"name": "a", "axis": [0, 0, 0], "point": [0, 0, 0]}]}}, "nodes", 2, "extras"),
         "twists is .*; it must be unit axes"),
        (put({"mocapella": {"turns": [{"name": "a", "axis": [1, 0, 0], "point": [0, 0, 0], "limits_rad": [1, 0]}]}},
             "nodes", 2, "extras"), "limits is .*; it must be least, then most"),
        (put({"mocapella": {"root": [0, 0, 0], "landmarks": {"top": {"part": "uper", "point": [0, 0, 0]}}}},
             "skins", 0, "extras"), r"'uper': is no joint of the skin; known: lower, upper \(did you mean upper\?\)"),
        (put("many", "nodes", 2, "scale"), "column.gltf"),
        (put(5, "nodes", 2, "children"), "column.gltf"),
        (put(5, "nodes"), "column.gltf: is no glTF"),
        (put({"a": 1}, "meshes", 0, "primitives"), "column.gltf"),
    ],
)  # fmt: skip
def test_a_file_with_a_fault_says_where_it_is(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        load_rigged_mesh(foreign(tmp_path, change))


def test_a_file_that_is_cut_anywhere_is_refused(tmp_path: Path) -> None:
    save_rigged_mesh(tmp_path / "worm.glb", worm())
    whole = (tmp_path / "worm.glb").read_bytes()
    for end in (0, 3, 4, 11, 12, 20, 500, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.glb").write_bytes(whole[:end])
        with pytest.raises(InputError, match=r"cut.glb: "):
            load_rigged_mesh(tmp_path / "cut.glb")


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_damaged_file_is_refused_or_read_but_nothing_else_happens(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    save_rigged_mesh(folder / "worm.glb", worm())
    rng = np.random.default_rng(seed)
    data = bytearray((folder / "worm.glb").read_bytes())
    for _ in range(int(rng.integers(1, 4))):
        data[int(rng.integers(12, len(data)))] = int(rng.integers(256))
    (folder / "worm.glb").write_bytes(data)
    assert_refused_or_read(folder / "worm.glb")


def assert_refused_or_read(path: Path) -> None:
    refused = None
    try:
        mesh = load_rigged_mesh(path)
    except InputError as error:
        refused = error
    assert path.stem in str(refused) if refused else np.isfinite(mesh.vertices).all()


def leaves(at: Any) -> list[tuple[Any, Any]]:
    """Where something stands in JSON: what holds it, and its key there."""
    keys = list(at) if isinstance(at, dict) else range(len(at)) if isinstance(at, list) else []
    return [place for key in keys for place in [(at, key), *leaves(at[key])]]


SCALARS = st.none() | st.booleans() | st.integers(-3, 40) | st.floats(allow_nan=False) | st.text(max_size=3)
VALUES = SCALARS | st.lists(SCALARS, max_size=4) | st.dictionaries(st.text(max_size=3), SCALARS, max_size=2)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.data())
def test_whatever_stands_in_the_json_is_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    def change(content: dict[str, Any]) -> None:
        holder, key = data.draw(st.sampled_from(leaves(content)))
        holder[key] = data.draw(VALUES)

    assert_refused_or_read(foreign(tmp_path_factory.mktemp("odd"), change))


def test_a_binary_file_of_another_version_is_refused(tmp_path: Path) -> None:
    save_rigged_mesh(tmp_path / "worm.glb", worm())
    data = bytearray((tmp_path / "worm.glb").read_bytes())
    data[4] = 1
    (tmp_path / "worm.glb").write_bytes(data)
    with pytest.raises(InputError, match=r"worm.glb: field version: 1: is not of version 2"):
        load_rigged_mesh(tmp_path / "worm.glb")


@pytest.mark.parametrize("data", [b"", b"{}", b"[]", b"not a mesh", b"\xff\xfe", b'{"asset": 5}', b"solid cube"])
def test_what_is_no_gltf_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "mesh.gltf").write_bytes(data)
    with pytest.raises(InputError, match=r"mesh.gltf: "):
        load_rigged_mesh(tmp_path / "mesh.gltf")


def test_files_that_are_not_there_or_of_another_kind_are_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nobody.glb: cannot be read: .*; choose a .glb or .gltf file"):
        load_rigged_mesh(tmp_path / "nobody.glb")
    with pytest.raises(InputError, match=r"worm.obj: '.obj': is of an unknown kind; choose .glb or .gltf"):
        save_rigged_mesh(tmp_path / "worm.obj", worm())
    with pytest.raises(InputError, match="cannot be written"):
        save_rigged_mesh(tmp_path / "nowhere" / "worm.glb", worm())


def test_without_the_library_it_is_said_what_brings_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "pygltflib":
            raise ModuleNotFoundError(name)
        return real(name, *args, **kwargs)

    gltf.pygltflib.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(SettingsError, match=r"uv sync --extra meshes \(elsewhere: install 'mocapella\[meshes\]'\)"):
        save_rigged_mesh(tmp_path / "worm.glb", worm())
    gltf.pygltflib.cache_clear()


def test_a_file_within_a_file_is_read(tmp_path: Path) -> None:
    path = foreign(tmp_path)
    content = json.loads(path.read_text(encoding="utf-8"))
    blob = base64.b64encode((tmp_path / "column.bin").read_bytes()).decode()
    content["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{blob}"
    (tmp_path / "inside.gltf").write_text(json.dumps(content), encoding="utf-8")
    one, other = load_rigged_mesh(path), load_rigged_mesh(tmp_path / "inside.gltf")
    np.testing.assert_array_equal(one.vertices, other.vertices)


def gltf_of(**content: object) -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, **content}).encode()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (gltf_of(nodes=[{}] * 5000), "field nodes: 5000: are more than"),
        (gltf_of(nodes=[{"children": [k + 1]} for k in range(300)] + [{"mesh": 0}]), "deeper than"),
        (gltf_of(extras=1).replace(b"1", b"1" * 5000), "is no glTF"),
        (gltf_of(extras=1).replace(b"1", b"[" * 5000), "is no glTF"),
        (b"glTF" + struct.pack("<IIII", 2, 28, 100, 0x4E4F534A) + bytes(8), "chunk at byte 12 that is cut short"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 0, 0x004E4942), "has no JSON"),
    ],
)
def test_a_file_that_asks_for_too_much_is_refused(data: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        decode_rigged_mesh(data)


def test_meshes_that_repeat_one_buffer_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "worm.glb"
    save_rigged_mesh(path, worm())
    monkeypatch.setattr("mocapella.model.rigged_mesh_file._MOST_VERTICES", 15)
    with pytest.raises(InputError, match="more than 15 vertices"):
        load_rigged_mesh(path)
