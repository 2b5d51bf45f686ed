"""Read and write one person's hand as a JSON file, validated and atomically."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from mocapella.decoding import decode_json, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.model.hand import DIGITS, Handedness, HandShape
from mocapella.model.whole_file import write_whole

VERSION: Final = 1
"""Version of the file's layout."""
_FIX: Final = "measure the hand anew and save it"


class _File(msgspec.Struct, forbid_unknown_fields=True):
    version: int
    person: str
    handedness: Handedness
    lengths_m: dict[str, list[float]]
    bases_m: dict[str, list[float]]
    lengths_sd_m: dict[str, list[float]] | None = None


def encode_hand_shape(shape: HandShape) -> bytes:
    """Encode a hand's shape as the content of a JSON file; numbers are rounded to a micrometre."""
    sd = None if shape.lengths_sd is None else _named(shape.lengths_sd)
    file = _File(VERSION, shape.person, shape.handedness, _named(shape.lengths), _named(shape.bases), sd)
    return msgspec.json.format(msgspec.json.encode(file), indent=1)


def decode_hand_shape(data: bytes, *, file: object = None) -> HandShape:
    """Decode a hand's shape from a JSON file's content.

    Args:
        data: the content; lengths are in metres.
        file: named in errors; None leaves it out.

    Raises:
        InputError: it is not a hand, of another version, or a number is invalid; names the field.
    """
    read = decode_json(data, _File, what="hand", file=file, fix=_FIX)
    if read.version != VERSION:
        fix = f"this program reads version {VERSION}: {_FIX}"
        raise InputError("is a hand of another version", file=file, field="version", value=read.version, fix=fix)
    lengths, bases = _array(read.lengths_m, "lengths_m", file), _array(read.bases_m, "bases_m", file)
    sd = None if read.lengths_sd_m is None else _array(read.lengths_sd_m, "lengths_sd_m", file)
    try:
        return HandShape(read.handedness, lengths, bases, read.person, sd)
    except SettingsError as error:
        raise InputError(str(error), file=file, fix=_FIX) from None


def save_hand_shape(path: Path | str, shape: HandShape) -> None:
    """Write a hand's shape as a JSON file, atomically: the file is complete or unchanged.

    Raises:
        InputError: it cannot be written there.
    """
    write_whole(path, encode_hand_shape(shape))


def load_hand_shape(path: Path | str) -> HandShape:
    """Read a hand's shape from a JSON file of `save_hand_shape`.

    Raises:
        InputError: the file does not exist, or is not a hand.
    """
    return decode_hand_shape(read_whole(path, fix="measure the hand first"), file=path)


def _named(rows: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> dict[str, list[float]]:
    return {name: [round(value, 6) for value in row.tolist()] for name, row in zip(DIGITS, rows, strict=True)}


def _array(
    named: dict[str, list[float]], field: str, file: object
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    for name in DIGITS:
        if len(named.get(name, ())) != 3 or not np.isfinite(named[name]).all():
            raise InputError("is not three finite numbers", file=file, field=f"{field}.{name}", fix=_FIX)
    return np.array([named[name] for name in DIGITS])
