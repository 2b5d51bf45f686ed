"""Convert the tables of a study's files to values: an unknown key or a wrong value is named with its place."""

from __future__ import annotations

import re
import types
import typing
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from mocapella.decoding import convert, decode_json, read_whole
from mocapella.errors import InputError, one_of

T = TypeVar("T")
_PLACE: Final = re.compile(r" - at `\$(?P<path>[^`]*)`$")
_STEP: Final = re.compile(r"\.?([^.\[\]]+)|\[(\d+)\]")


def of_tables(data: Any, kind: type[T], *, what: str, file: object, fix: str) -> T:
    """Convert decoded TOML or JSON to a `msgspec.Struct`, strictly.

    Args:
        data: the decoded tables.
        kind: type of the result.
        what: noun for the content in errors, such as ``study protocol``.
        file, fix: the file and the advice that errors name.

    Raises:
        InputError: an unknown key at any depth (with a suggestion), a missing key, a wrong type, or a value out of
            range; names the field, such as ``tasks[2].steps[0].seconds``, and its value.
    """
    _refuse_unknown(data, kind, "", file)
    try:
        return convert(data, kind, what=what, file=file, fix=fix)
    except InputError as error:
        found = _PLACE.search(error.problem)
        if found is None:
            raise
        path = found["path"].lstrip(".")
        value = _at(data, path)
        raise InputError(
            error.problem[: found.start()],
            file=file,
            field=path,
            value=None if isinstance(value, dict | list) else value,
            fix=fix,
        ) from None


def read_json(path: Path, kind: type[T], *, what: str, fix: str) -> T:
    """Return the value of a JSON file of a study, as `of_tables` converts it.

    Raises:
        InputError: the file cannot be read, is no JSON, or its content is refused as in `of_tables`.
    """
    data = decode_json(read_whole(path, fix=fix), what=what, file=path, fix=fix)
    return of_tables(data, kind, what=what, file=path, fix=fix)


def _refuse_unknown(data: Any, kind: Any, path: str, file: object) -> None:
    struct = _struct_of(kind)
    if struct is None:
        return
    if isinstance(data, list):
        for place, one in enumerate(data):
            _refuse_unknown(one, struct, f"{path}[{place}]", file)
    if not isinstance(data, dict):
        return
    fields = {field.encode_name: field for field in msgspec.structs.fields(struct)}
    for key, inner in data.items():
        field = f"{path}.{key}" if path else str(key)
        if key not in fields:
            raise InputError(
                "this key is unknown", file=file, field=field, fix=f"known keys: {one_of(str(key), fields)}"
            )
        _refuse_unknown(inner, fields[key].type, field, file)


def _struct_of(kind: Any) -> type[msgspec.Struct] | None:
    """Return the struct in a type such as ``Step``, ``tuple[Step, ...]`` or ``Step | None``; None if there is none."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return kind
    if typing.get_origin(kind) in {tuple, typing.Union, types.UnionType, typing.Annotated}:
        return next((found for one in typing.get_args(kind) if (found := _struct_of(one)) is not None), None)
    return None


def _at(data: Any, path: str) -> Any:
    """Return the value at a path such as ``tasks[2].steps``; None if there is none."""
    for name, number in _STEP.findall(path):
        try:
            data = data[int(number)] if number else data[name]
        except (LookupError, TypeError):
            return None
    return data
