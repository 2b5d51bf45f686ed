"""Small ONNX models, written byte by byte: protobuf messages of the public format, without the package onnx."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def varint(number: int) -> bytes:
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def field(number: int, value: int | bytes | str) -> bytes:
    """One field of a protobuf message."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def value_info(name: str, shape: Sequence[int | str]) -> bytes:
    """A float tensor's name and shape; a text is a size that is not fixed."""
    dims = b"".join(field(1, field(1, size) if isinstance(size, int) else field(2, size)) for size in shape)
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dims)))


def tensor(name: str, values: np.ndarray) -> bytes:
    kinds = {"f": (1, np.float32), "i": (7, np.int64)}
    kind, dtype = kinds[values.dtype.kind]
    dims = b"".join(field(1, int(size)) for size in values.shape)
    return dims + field(2, kind) + field(8, name) + field(9, np.ascontiguousarray(values, dtype).tobytes())


def node(kind: str, inputs: Sequence[str], outputs: Sequence[str], attributes: bytes = b"") -> bytes:
    parts = [field(1, name) for name in inputs] + [field(2, name) for name in outputs]
    return b"".join(parts) + field(4, kind) + attributes


def model(size_px: tuple[int, int], outputs: dict[str, np.ndarray], *, channels: int = 3, fixed: bool = True,
          free: bool = False) -> bytes:  # fmt: skip
    """A model that takes an image and gives constant outputs, plus 0 times the image's mean.

    Args:
        size_px: (width, height) of its input.
        outputs: values by name.
        channels: of the image.
        fixed: whether the input's size is fixed.
        free: whether the file names the outputs' sizes instead of stating them, as exports of RTMPose do.
    """
    width, height = size_px
    shape = [1, channels, *((height, width) if fixed else ("h", "w"))]
    nodes, constants = [node("ReduceMean", ["image"], ["mean"], field(5, _attribute("keepdims", 0)))], []
    nodes.append(node("Mul", ["mean", "zero"], ["nothing"]))
    constants.append(tensor("zero", np.array(0.0, np.float32)))
    for name, values in outputs.items():
        constants.append(tensor(f"{name}.c", values.astype(np.float32)))
        nodes.append(node("Add", [f"{name}.c", "nothing"], [name]))
    graph = b"".join(field(1, one) for one in nodes) + field(2, "graph") + b"".join(field(5, one) for one in constants)
    graph += field(11, value_info("image", shape))
    for name, values in outputs.items():
        sizes = [f"MatMul{name}_dim_{k}" for k in range(values.ndim)] if free else values.shape
        graph += field(12, value_info(name, sizes))
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13))


def _attribute(name: str, value: int) -> bytes:
    return field(1, name) + field(3, value) + field(20, 2)
