"""Read HDF5 files and the pickled texts in them within limits; see `mocapella.decoding`."""

from __future__ import annotations

import io
import pickletools
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Self

from mocapella.decoding import FAULTS, FREE_UNPACKED, MOST_RATIO, MOST_TABLE_BYTES, read_whole
from mocapella.errors import InputError, SettingsError

_PICKLED_VALUES: Final = frozenset(
    ["NONE", "INT", "BININT", "BININT1", "BININT2", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"]
)


class Hdf5:
    """The arrays of an HDF5 file, within limits. A context manager.

    Links to other places and other files are not followed.

    Args:
        path: the file.
        fix: advice that errors name.

    Raises:
        InputError: the file cannot be read or is no HDF5.
        SettingsError: h5py is not installed; says how to install it.
    """

    def __init__(self, path: Path, *, fix: str) -> None:
        self._path, self._fix = path, fix
        data = read_whole(path, fix=fix, most_bytes=MOST_TABLE_BYTES)
        if find_spec("h5py") is None:
            raise SettingsError(
                f"{path.name} needs h5py: uv sync --extra keypoints (elsewhere: install 'mocapella[keypoints]')"
            )
        self._h5py: Any = import_module("h5py")
        self._most = max(FREE_UNPACKED, MOST_RATIO * len(data))
        try:
            self._file: Any = self._h5py.File(io.BytesIO(data), "r")
        except (*FAULTS, OSError, RuntimeError) as error:
            raise self._fault(error) from None

    def names(self, group: str = "") -> tuple[str, ...]:
        """Return the names in a group, sorted; the whole file's by default.

        Raises:
            InputError: there is no such group.
        """
        found = self._at(group)
        try:
            return tuple(sorted(str(name) for name in found))
        except (*FAULTS, OSError, RuntimeError) as error:
            raise self._fault(error, group) from None

    def array(self, name: str) -> Any:
        """Return the values of a dataset as an array.

        Raises:
            InputError: there is no such dataset, it is elsewhere than in the file, or it unpacks to more than
                `FREE_UNPACKED` and `MOST_RATIO` times the file's size.
        """
        found = self._at(name)
        try:
            if found.is_virtual or found.external:
                raise ValueError("its values are in another file")
            if found.nbytes > self._most:
                raise ValueError(f"it unpacks to {found.nbytes >> 20} MiB")
            return found[()]
        except (*FAULTS, OSError, RuntimeError) as error:
            raise self._fault(error, name) from None

    def attribute(self, name: str, key: str) -> bytes | None:
        """Return an attribute of a group or dataset as bytes; None if it has none of this name.

        Raises:
            InputError: there is no such group or dataset, or the attribute cannot be read.
        """
        found = self._at(name)
        try:
            value = found.attrs.get(key)
            return value.encode() if isinstance(value, str) else None if value is None else bytes(value)
        except (*FAULTS, OSError, RuntimeError) as error:
            raise self._fault(error, name) from None

    def _at(self, name: str) -> Any:
        found: Any = self._file
        try:
            for part in filter(None, name.split("/")):
                if not isinstance(found.get(part, getlink=True), self._h5py.HardLink):
                    raise ValueError("there is none of this name")
                found = found[part]
        except (*FAULTS, OSError, RuntimeError) as error:
            raise self._fault(error, name) from None
        return found

    def _fault(self, error: Exception, field: str | None = None) -> InputError:
        said = str(error).replace("\n", " ")
        return InputError(f"cannot be read as HDF5: {said}", file=self._path, field=field or None, fix=self._fix)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def decode_pickled_texts(data: bytes, *, file: object = None, fix: str | None = None) -> Any:
    """Return lists, tuples, texts and whole numbers of a pickle, as PyTables has in attributes; nothing is executed.

    Args:
        data: the pickle.
        file, fix: the file and the advice that errors name; None to leave them out.

    Raises:
        InputError: it is no pickle, or has a value of another type.
    """
    stack: list[Any] = []
    marks: list[int] = []
    memo: dict[int, Any] = {}
    try:
        for code, argument, _ in pickletools.genops(data):  # raises a ValueError where there is no STOP
            if code.name != "STOP":
                _apply_pickled(code.name, argument, stack, marks, memo)
        return stack.pop()
    except FAULTS as error:
        raise InputError(f"has names that cannot be read: {error}", file=file, fix=fix) from None


def _apply_pickled(name: str, argument: Any, stack: list[Any], marks: list[int], memo: dict[int, Any]) -> None:
    """Carry out one operation of a pickle that builds lists, tuples, texts or whole numbers."""
    if name in _PICKLED_VALUES:
        stack.append(argument)
    elif name in ("EMPTY_LIST", "EMPTY_TUPLE"):
        stack.append([] if name == "EMPTY_LIST" else ())
    elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
        count = int(name[-1])
        stack[-count:] = [tuple(stack[-count:])]
    elif name == "MARK":
        marks.append(len(stack))
    elif name in ("LIST", "TUPLE", "APPENDS", "APPEND"):
        at = len(stack) - 1 if name == "APPEND" else marks.pop()
        rest = stack[at:]
        del stack[at:]
        if name in ("LIST", "TUPLE"):
            stack.append(rest if name == "LIST" else tuple(rest))
        else:
            stack[-1].extend(rest)
    elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
        memo[len(memo) if argument is None else argument] = stack[-1]
    elif name in ("GET", "BINGET", "LONG_BINGET"):
        stack.append(memo[argument])
    elif name not in ("PROTO", "FRAME"):
        raise ValueError(f"{name} is neither text, whole number, list nor tuple")
