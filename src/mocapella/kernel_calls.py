"""Calls of a kernel with many arguments without numba's type resolution; numba is imported by the first call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

_ARRAY: Final = 0x1 | 0x100 | 0x400
"""Flags of a C-contiguous array that belong to its numba type: C-contiguous, aligned, writeable."""
_FORTRAN: Final = 0x2
"""Flag that belongs to the type of any other array."""
_SCALARS: Final = frozenset({type(None), bool, int, float, np.bool_, np.int64, np.float64})
_UNKNOWN: Final = None
_ENTRIES: Final[dict[tuple[Any, tuple[Any, ...]], Callable[..., Any]]] = {}
"""Entry points found so far, by kernel and kinds of arguments: numba takes milliseconds to derive a hundred types."""


class KernelCall:
    """Calls one kernel by its entry point if each argument is that of the last call, or of the same type.

    numba's dispatcher derives the types of all arguments in each call, also of each item of a named tuple. State
    consists of the same arrays from frame to frame, so comparing identities is cheaper where most arguments are state;
    it is dearer where most are new arrays. Arguments of other types go through the dispatcher, so the result is always
    that of the kernel itself.

    The arguments of the last call stay alive. Threads may share a call: the known types are replaced as one value.

    Args:
        kernel: a function of `mocapella.compiled.njit`.
    """

    def __init__(self, kernel: Callable[..., Any]) -> None:
        self._kernel = kernel
        self._known: tuple[tuple[Any, ...], tuple[Any, ...], Callable[..., Any]] = ((), (), kernel)

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel, and return its result."""
        last, kinds, entry = self._known
        if len(arguments) != len(last):
            return self._resolve(arguments)
        for value, before, kind in zip(arguments, last, kinds, strict=True):
            if value is not before and not _is_alike(value, before, kind):
                return self._resolve(arguments)
        self._known = arguments, kinds, entry
        return entry(*arguments)

    def _resolve(self, arguments: tuple[Any, ...]) -> Any:
        """Call the kernel by its dispatcher, and remember the entry point for arguments of these types."""
        from mocapella.compiled import entry_point

        result = self._kernel(*arguments)
        kinds = tuple(map(_kind, arguments))
        if _UNKNOWN in kinds:
            return result
        entry = _ENTRIES.get((self._kernel, kinds)) or entry_point(self._kernel, arguments)
        if entry is not None:
            _ENTRIES[self._kernel, kinds] = entry
            self._known = arguments, kinds, entry
        return result


def _kind(value: Any) -> Any:
    """Return what determines the numba type of an argument; of a tuple, its class and its items' kinds.

    It is `_UNKNOWN` if the class does not determine the type.
    """
    cls = type(value)
    if cls is np.ndarray:
        flags = value.flags.num
        mask = _ARRAY if flags & 1 else _ARRAY | _FORTRAN
        return value.dtype, value.ndim, mask, flags & mask
    if issubclass(cls, tuple):
        kinds = tuple(map(_kind, value))
        return _UNKNOWN if _UNKNOWN in kinds else (cls, kinds)
    return (cls, cls is int and _is_long(value)) if cls in _SCALARS else _UNKNOWN


def _is_long(number: int) -> bool:
    """Return whether numba takes a whole number for another type than a signed one of 64 bits."""
    return not -(2**63) <= number < 2**63


def _is_alike(value: Any, before: Any, kind: Any) -> bool:
    """Return whether a value is of the kind of the one before; a tuple with the same items is not looked into."""
    cls = type(value)
    if cls is not type(before):
        return False
    if cls is np.ndarray:
        dtype, ndim, mask, flags = kind
        return bool(value.dtype == dtype and value.ndim == ndim and value.flags.num & mask == flags)
    if cls in _SCALARS:
        return cls is not int or _is_long(value) is kind[1]
    if len(value) != len(before):
        return False
    for part, old, own in zip(value, before, kind[1], strict=True):
        if part is not old and not _is_alike(part, old, own):
            return False
    return True
