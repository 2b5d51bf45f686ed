"""Serialise snapshots of stateful objects, so that a take can start in the middle of a session.

Only plain types and explicitly listed classes are supported, so that decoding foreign bytes cannot create other objects
(unlike pickle).
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from enum import Enum
from typing import Any, Protocol, TypeVar

import msgspec
import numpy as np

from mocapella.decoding import FAULTS, decode_msgpack
from mocapella.errors import MocapellaError, WireError
from mocapella.model.topology import Topology, topology

_PLAIN = (type(None), bool, int, float, str, bytes)


class _Resettable(Protocol):
    def reset(self) -> None: ...


_Kept = TypeVar("_Kept", bound=_Resettable)
_DTYPE = re.compile(r"[<>|]?[biufcU]\d{1,4}")


def pack(value: Any, kinds: Sequence[type]) -> bytes:
    """Encode a value as bytes; ``kinds`` are the structs, dataclasses and enumerations that it may contain.

    Besides these, it may contain None, bool, int, float, str, bytes, numpy arrays and scalars, topologies, mappings,
    deques, tuples, lists, and sets of sortable items, at any depth.

    Raises:
        TypeError: it contains another type.
    """
    return msgspec.msgpack.encode(_down(value, frozenset(kinds)))


def recorded_name(kind: type) -> str:
    """Return the name of a class in a take: its ``RECORDED_AS``, which a renamed class has, or its own name."""
    name: str = vars(kind).get("RECORDED_AS", kind.__name__)
    return name


def unpack(data: bytes, kinds: Sequence[type]) -> Any:
    """Decode a value encoded by `pack` with the same ``kinds``; its arrays, also scalars, are writable copies.

    Raises:
        WireError: the bytes are not from `pack`, or contain other types.
    """
    try:
        return _up(decode_msgpack(data), {recorded_name(kind): kind for kind in kinds})
    except (*FAULTS, MocapellaError) as error:
        raise WireError(f"{len(data)} bytes that are no memory of this tracker ({error})") from error


def set_memory(part: object, memory: Mapping[str, Any], names: Collection[str] | None = None) -> None:
    """Set attributes of a stateful object, in place, such as from a snapshot; attributes not in ``memory`` stay.

    Args:
        part: the object.
        memory: values of its attributes, by name.
        names: the existing attributes that may be set; None for all. Otherwise a damaged snapshot could replace an
            attribute that neither a reset nor a later snapshot restores.

    Raises:
        ValueError: a name is a method's or an existing attribute's not in ``names``, or the type of ``settings`` or of
            an attribute with a method ``reset`` would change.
    """
    if names is not None and (others := vars(part).keys() & memory.keys() - set(names)):
        raise ValueError(f"{min(others)} is in no snapshot")
    for name, value in memory.items():
        now = vars(part).get(name)
        another = type(value) is not type(now) and (name == "settings" or hasattr(now, "reset"))
        if another or callable(getattr(type(part), name, None)):
            raise ValueError(f"{name} cannot be recalled")
    vars(part).update(memory)


def recalls(restore: Callable[[_Kept, bytes], None]) -> Callable[[_Kept, bytes], None]:
    """Decorate a tracker's ``restore(self, data)``: an invalid snapshot resets the tracker and raises `WireError`.

    Without the decorator, the tracker would keep a part of the snapshot's state. A `WireError`, such as from `unpack`
    or from the ``restore`` of a tracker inside this one, resets the tracker and passes unchanged.
    """

    @functools.wraps(restore)
    def guarded(self: _Kept, data: bytes) -> None:
        before = dict(vars(self))
        try:
            restore(self, data)
        except (*FAULTS, MocapellaError) as error:
            vars(self).clear()
            vars(self).update(before)
            self.reset()
            if isinstance(error, WireError):
                raise
            raise WireError(f"{len(data)} bytes that are no memory of this tracker ({error!r})") from error

    return guarded


def _down(value: Any, kinds: frozenset[type]) -> Any:
    kind = type(value)
    if kind in _PLAIN:
        return value
    if kind in kinds:
        return [recorded_name(kind), _fields(value, kinds)]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return ["array", [array.dtype.str, list(array.shape), array.tobytes()]]
    if kind is Topology:
        return ["topology", value.name]
    return _container(value, kinds)


def _container(value: Any, kinds: frozenset[type]) -> Any:
    kind = type(value)
    if kind is deque:
        return ["deque", [value.maxlen, [_down(item, kinds) for item in value]]]
    if isinstance(value, Mapping):
        name = "counter" if kind is Counter else "dict"
        return [name, [[_down(key, kinds), _down(item, kinds)] for key, item in value.items()]]
    if kind in (tuple, list, set, frozenset):
        items = sorted(value) if kind in (set, frozenset) else value
        return [kind.__name__, [_down(item, kinds) for item in items]]
    raise TypeError(f"a {kind.__name__} cannot be remembered; name it among the kinds")


def _fields(value: Any, kinds: frozenset[type]) -> Any:
    if isinstance(value, Enum):
        return value.value
    names = (
        value.__struct_fields__ if isinstance(value, msgspec.Struct) else [f.name for f in dataclasses.fields(value)]
    )
    return {name: _down(getattr(value, name), kinds) for name in names}


def _up(value: Any, kinds: Mapping[str, type]) -> Any:
    if type(value) in _PLAIN:
        return value
    name, content = value
    if name in kinds:
        kind: Any = kinds[name]
        if issubclass(kind, Enum):
            return kind(content)
        return kind(**{field: _up(item, kinds) for field, item in content.items()})
    return _MAKERS[name](content, lambda item: _up(item, kinds))


def _array(content: Any, _: Callable[[Any], Any]) -> Any:
    dtype, shape, data = content
    if not (isinstance(dtype, str) and _DTYPE.fullmatch(dtype)):  # numpy evaluates others as Python
        raise ValueError("an array of no plain numbers")
    return np.frombuffer(data, np.dtype(dtype)).reshape(shape).copy()


_MAKERS: dict[str, Callable[[Any, Callable[[Any], Any]], Any]] = {
    "array": _array,
    "topology": lambda content, _: topology(content),
    "deque": lambda content, up: deque(map(up, content[1]), maxlen=content[0]),
    "dict": lambda content, up: {up(key): up(item) for key, item in content},
    "counter": lambda content, up: Counter({up(key): up(item) for key, item in content}),
    "tuple": lambda content, up: tuple(map(up, content)),
    "list": lambda content, up: list(map(up, content)),
    "set": lambda content, up: set(map(up, content)),
    "frozenset": lambda content, up: frozenset(map(up, content)),
}
