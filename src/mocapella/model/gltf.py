"""Read validated arrays and nodes of a glTF 2.0 file, for `mocapella.model.rigged_mesh_file`.

Khronos Group, *glTF 2.0 Specification* (2021), sections 3.5 to 3.7. The JSON is read
by pygltflib, of the extra ``meshes``.
"""

from __future__ import annotations

import base64
import binascii
import math
import struct
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import FAULTS, decode_json, decode_text, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.rigid import rigid

Float64 = NDArray[np.float64]

EXPORT: Final = "export the model anew as glTF 2.0 (.glb)"
_HEADER: Final = 12
_MOST_BYTES: Final = 256 << 20
_DEEPEST: Final = 256
"""Largest number of ancestors of a node."""
_MOST_ITEMS: Final = 4096
"""Largest number of nodes, meshes, accessors and so on."""
_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_BASE64: Final = ";base64,"


@cache
def pygltflib() -> Any:
    """Return the module pygltflib.

    Raises:
        SettingsError: it is not installed; states how to install it.
    """
    try:
        import pygltflib as library
    except ModuleNotFoundError as error:
        raise SettingsError(
            "meshes cannot be read or written, because pygltflib is not installed: uv sync --extra meshes "
            "(elsewhere: install 'mocapella[meshes]')"
        ) from error
    return library


class Gltf:
    """An open glTF file; its content is parsed and its tree of nodes checked at construction.

    Args:
        path: path of the file, which errors name.
        data: its bytes; nothing else is then read from the disk. Without them, ``path`` is read, and buffers beside it.

    Attributes:
        path: path of the file, which errors name.
        content: pygltflib's object.
        parents: (nodes,) index of each node's parent; -1 for none.

    Raises:
        InputError: it cannot be read, is no glTF 2.0, needs an extension, or its nodes are not a tree.
        SettingsError: pygltflib is not installed.
    """

    def __init__(self, path: Path, data: bytes | None = None) -> None:
        self.path, self._alone = path, data is not None
        self.content = _parsed(path, mesh_bytes(path) if data is None else data)
        required = self.content.extensionsRequired or []
        if required:
            raise self.error("cannot be read", "extensionsRequired", required, "export without compression")
        self._buffers: dict[int, bytes] = {}
        self._at_parent: dict[int, Float64] = {}
        self.parents = self._parents()

    def error(self, problem: str, field: str | None = None, value: object = None, fix: str = EXPORT) -> InputError:
        """Return an error about this file, to be raised.

        Args:
            problem: what is wrong, as a clause after the file's name.
            field, value: the field with the fault and its value; None if unknown.
            fix: advice.
        """
        return InputError(problem, file=self.path, field=field, value=value, fix=fix)

    def item(self, kind: str, index: Any) -> Any:
        """Return the element of an index in one of the file's lists, such as ``nodes``, ``meshes`` or ``accessors``.

        Raises:
            InputError: it does not exist.
        """
        items = getattr(self.content, kind) or []
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(items):
            raise self.error(f"is not there; the file has {len(items)}", f"{kind}[{index}]")
        return items[index]

    def array(self, index: Any, field: str, *kinds: str) -> NDArray[Any]:
        """Return an accessor's numbers, int64 or float64: (n,), (n, 2 to 4), or (n, 4, 4) transposed matrices.

        Normalised integers are converted to the floats that they represent.

        Args:
            index: index of the accessor.
            field: name of the accessor's use, which errors name.
            kinds: allowed glTF types, such as ``VEC3``.

        Raises:
            InputError: it is missing, of another type, sparse, beyond its buffer, or has numbers that are not finite.
        """
        accessor = self.item("accessors", index)
        where = f"{field} (accessors[{index}])"
        if accessor.sparse is not None:
            raise self.error("is sparse, which cannot be read", where, fix="export without sparse accessors")
        if accessor.type not in kinds or accessor.componentType not in _TYPES:
            raise self.error(f"is not {' or '.join(kinds)}", where, (accessor.type, accessor.componentType))
        dtype, width = np.dtype(_TYPES[accessor.componentType]), _SIZES[accessor.type]
        view = self.item("bufferViews", accessor.bufferView)
        data = self._buffer(view.buffer)
        first, within = view.byteOffset or 0, accessor.byteOffset or 0
        stride = view.byteStride or width * dtype.itemsize
        numbers = (accessor.count, first, within, stride, view.byteLength)
        if not all(isinstance(number, int) and number >= 0 for number in numbers) or stride < width * dtype.itemsize:
            raise self.error("has a count or offset that cannot be", where, numbers)
        length = within + max(0, accessor.count - 1) * stride + (width * dtype.itemsize if accessor.count else 0)
        if length > view.byteLength or first + view.byteLength > len(data):
            raise self.error(f"ends at byte {first + length} of {len(data)}; the file is damaged or cut short", where)
        rows = np.ndarray((accessor.count, width), dtype, data, first + within, (stride, dtype.itemsize))
        values = rows.astype(np.float64 if dtype.kind == "f" or accessor.normalized else np.int64)
        if accessor.normalized and dtype.kind != "f":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(values).all():
            raise self.error("has numbers that are not finite", where)
        return values[:, 0] if width == 1 else values.reshape(-1, 4, 4) if width == 16 else values

    def name(self, node: int) -> str:
        """Return the name of the node of an index; ``node 3`` without one."""
        return self.item("nodes", node).name or f"node {node}"

    def T_world_node(self, node: int) -> Float64:  # noqa: N802 - the field's notation
        """Return the transform (4, 4) from a node's frame to the world at rest, which may have a scale."""
        T = self._local(node)
        while self.parents[node] >= 0:
            node = self.parents[node]
            T = self._local(node) @ T
        return T

    def _local(self, index: int) -> Float64:
        if index not in self._at_parent:
            self._at_parent[index] = self._read_local(index)
        return self._at_parent[index]

    def _read_local(self, index: int) -> Float64:
        node = self.item("nodes", index)
        parts = {"matrix": (node.matrix, 16), "translation": (node.translation, 3), "rotation": (node.rotation, 4),
                 "scale": (node.scale, 3)}  # fmt: skip
        for name, (value, length) in parts.items():
            if value is not None and (len(value) != length or not all(math.isfinite(number) for number in value)):
                raise self.error(f"is not {length} finite numbers", f"nodes[{index}].{name}", value)
        if node.matrix is not None:
            return np.array(node.matrix, dtype=np.float64).reshape(4, 4).T
        x, y, z, w = node.rotation or (0.0, 0.0, 0.0, 1.0)
        q = np.array([x, y, z, w], dtype=np.float64)
        if abs(np.linalg.norm(q) - 1.0) > 1e-3:
            raise self.error("is no unit quaternion", f"nodes[{index}].rotation", node.rotation)
        x, y, z, w = q / np.linalg.norm(q)
        R = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        return rigid(R * np.array(node.scale or (1.0,) * 3), np.array(node.translation or (0.0,) * 3))

    def _parents(self) -> list[int]:
        nodes = self.content.nodes or []
        parents = [-1] * len(nodes)
        for k, node in enumerate(nodes):
            for child in node.children or []:
                self.item("nodes", child)
                if parents[child] >= 0:
                    raise self.error("has two parents", f"nodes[{child}]", (parents[child], k))
                parents[child] = k
        for k in range(len(nodes)):
            at, depth = parents[k], 0
            while at >= 0:
                at, depth = parents[at], depth + 1
                if depth > _DEEPEST:
                    raise self.error(f"hangs on itself, or deeper than {_DEEPEST}", f"nodes[{k}]")
        return parents

    def _buffer(self, index: Any) -> bytes:
        if index not in self._buffers:
            buffer = self.item("buffers", index)
            self._buffers[index] = self._read_buffer(f"buffers[{index}]", buffer.uri)
            least = buffer.byteLength or 0
            if len(self._buffers[index]) < least:
                raise self.error(f"has {len(self._buffers[index])} bytes of {least}; the file is damaged or cut short",
                                 f"buffers[{index}]")  # fmt: skip
        return self._buffers[index]

    def _read_buffer(self, field: str, uri: str | None) -> bytes:
        if uri is None:
            blob = self.content.binary_blob()
            if blob is None:
                raise self.error("has neither data nor a uri", field)
            return bytes(blob)
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri[uri.index(_BASE64) + len(_BASE64) :], validate=True)
            except (ValueError, binascii.Error) as error:
                raise self.error("is no base64", f"{field}.uri") from error
        other = Path(uri)
        if self._alone or other.is_absolute() or ".." in other.parts or ":" in uri:
            raise self.error("is not beside the file", f"{field}.uri", uri, "export as one .glb file")
        return mesh_bytes(self.path.parent / other, f"it belongs to {self.path}: export as one .glb file")


def mesh_bytes(path: Path, fix: str = "choose a .glb or .gltf file") -> bytes:
    """Read the content of a mesh file; errors advise ``fix``.

    Raises:
        InputError: it cannot be read, or is too large.
    """
    return read_whole(path, fix=fix, most_bytes=_MOST_BYTES)


def _parsed(path: Path, data: bytes) -> Any:
    """Parse the file with pygltflib."""
    text, blob = _chunks(path, data) if data[:4] == b"glTF" else (data, None)
    told = decode_json(text, dict[str, Any], what="glTF", file=path, fix=EXPORT)
    for kind, items in told.items():
        if isinstance(items, list) and len(items) > _MOST_ITEMS:
            raise InputError(f"are more than {_MOST_ITEMS}", file=path, field=kind, value=len(items), fix=EXPORT)
    try:
        content = pygltflib().GLTF2.gltf_from_json(decode_text(text))
    except (*FAULTS, Warning) as error:
        raise InputError(f"is no glTF: {error}", file=path, fix=EXPORT) from error
    if not str(getattr(content.asset, "version", "")).startswith("2."):
        raise InputError("does not say that it is glTF 2", file=path, field="asset.version", fix=EXPORT)
    if blob is not None:
        content.set_binary_blob(blob)
    return content


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON and the numbers of a .glb file; None without numbers."""
    version, length = struct.unpack("<II", data[4:_HEADER]) if len(data) >= _HEADER else (0, 0)
    if len(data) < _HEADER or length != len(data):
        problem = f"has {len(data)} bytes of {length}; it is damaged or cut short"
        raise InputError(problem, file=path, fix=EXPORT)
    if version != 2:
        raise InputError("is not of version 2", file=path, field="version", value=version, fix=EXPORT)
    found: dict[bytes, bytes] = {}
    at = _HEADER
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<I4s", data, at)
        if at + 8 + size > len(data):
            raise InputError(f"has a chunk at byte {at} that is cut short", file=path, fix=EXPORT)
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in found:
        raise InputError("is no glTF: it has no JSON", file=path, fix=EXPORT)
    return found[b"JSON"], found.get(b"BIN\0")
