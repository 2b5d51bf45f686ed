"""Checks of the codecs of frame types and part types."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from mocapella.errors import WireError
from mocapella.model.frame_types import FRAME_TYPES, frame_type_of
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import Topology, topology
from mocapella.schema import decode_frame, decode_scene, encode_frame, encode_scene

_DAMAGED = 300
_TOLERANCE = 1e-6
"""Relative and absolute tolerance of floats, because types may store them as float32."""


def check_frame_type(frame: SensorFrame) -> None:
    """Check that encoding and decoding preserve a frame, and that damaged bytes raise only `WireError`.

    The decoded frame must have the same class and the same values (floats to 1e-6, relative or absolute; NaN equals
    NaN), and encode to the same bytes. Of 300 inputs, the encoded bytes cut off or with one byte changed, each must
    decode to some frame or raise `WireError`, and nothing else. The damage is the same at each run.

    Args:
        frame: a frame of a registered type, with realistic values in all its fields.

    Raises:
        AssertionError: a check fails, or no installed package registers the frame's class.
    """
    if frame_type_of(frame) is None:
        raise AssertionError(
            f"no frame type has the class {type(frame).__name__}; registered: {', '.join(FRAME_TYPES)}"
        )
    data = encode_frame(frame)
    _check_same(decode_frame(data), frame, encode_frame)
    _check_damage(data, decode_frame)


def check_part_type(name: str, part: Any, skeleton: Topology | None = None) -> None:
    """Check the codec of a part type by a scene that holds one part; the same checks as `check_frame_type`.

    Args:
        name: name of the registered part type.
        part: a part of that type.
        skeleton: topology of the scene; None takes that of the Kinect v2.

    Raises:
        PluginError, SettingsError: no part type of this name can be used.
        AssertionError: a check fails.
    """
    PART_TYPES.find(name)
    state = TrackerState(Phase.TRACKING)
    scene = Scene(0, 1, "sensor", 1, 0, skeleton or topology("kinect_v2"), state, {name: (part,)})
    data = encode_scene(scene)
    again = decode_scene(data)
    _check_same(again.of(name), (part,), lambda _: data)
    if encode_scene(again) != data:
        raise AssertionError(f"a decoded part of {name} encodes to other bytes than before")
    _check_damage(data, decode_scene)


def _check_same(again: Any, before: Any, encode: Callable[[Any], bytes]) -> None:
    for where, one, other in _differences(again, before, type(before).__name__):
        raise AssertionError(f"{where} is {one!r} after decoding; it was {other!r}")
    if encode(again) != encode(before):
        raise AssertionError(f"a decoded {type(before).__name__} encodes to other bytes than before")


def _check_damage(data: bytes, decode: Callable[[bytes], Any]) -> None:
    chance = random.Random(0)  # the same damage at every run
    for k in range(_DAMAGED):
        damaged = bytearray(data)
        if k % 2 and data:
            damaged[chance.randrange(len(data))] = chance.randrange(256)
        else:
            del damaged[chance.randrange(len(data) + 1) :]
        try:
            decode(bytes(damaged))
        except WireError:
            pass
        except Exception as error:
            raise AssertionError(
                f"damaged bytes raise {type(error).__name__} ({error}); WireError is wanted"
            ) from error


def _differences(one: Any, other: Any, where: str) -> Iterator[tuple[str, Any, Any]]:
    """Yield each value that differs: its name, and both values."""
    if type(one) is not type(other) and not (np.isscalar(one) and np.isscalar(other)):
        yield where, one, other
    elif isinstance(one, np.ndarray):
        if one.shape != other.shape or not _close(one, other):
            yield where, one, other
    elif isinstance(one, msgspec.Struct):
        for name in one.__struct_fields__:
            yield from _differences(getattr(one, name), getattr(other, name), f"{where}.{name}")
    elif isinstance(one, (tuple, list)) and len(one) == len(other):
        for k, (mine, yours) in enumerate(zip(one, other, strict=True)):
            yield from _differences(mine, yours, f"{where}[{k}]")
    elif isinstance(one, float):
        if not _close(np.array(one), np.array(other)):
            yield where, one, other
    elif one != other:
        yield where, one, other


def _close(one: Any, other: Any) -> bool:
    if np.issubdtype(one.dtype, np.floating):
        return np.allclose(one, other, rtol=_TOLERANCE, atol=_TOLERANCE, equal_nan=True)
    return np.array_equal(one, other)
