"""Read C3D, the point file of biomechanics (https://www.c3d.org, user guide of 2021)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import FAULTS, read_whole
from mocapella.errors import InputError
from mocapella.model.names import distinct
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories
from mocapella.recording.trc_file import METRES

Float64 = NDArray[np.float64]

_FIX: Final = "give a .c3d file with points"
_MOST_BYTES: Final = 1 << 30
_BLOCK: Final = 512
_KEY: Final = 0x50
_INTEL, _DEC, _MIPS = 84, 85, 86
_LARGEST_RESIDUAL: Final = 255
_TYPES: Final = {-1: "S1", 1: "i1", 2: "i2", 4: "f4"}
Parameters = dict[str, Any]
"""Values by name, such as ``POINT:RATE``: arrays of numbers, or lists of texts."""


def read_c3d(path: Path) -> Trajectories:
    """Read the points of a C3D as trajectories of the kind ``points``, in metres, in the file's axes.

    The individual has the file's subject name if it has one subject, else the file's. A point with the residual −1 is
    unknown, and one with the residual 0 is inferred, that is interpolated or modelled, unless another program wrote the
    file and no residual in it is above 0. Other residuals are read as standard deviations, but the largest as unknown,
    as `mocapella export c3d` writes them. Analog channels are left out.

    Raises:
        InputError: it cannot be read, is no C3D, or has no points, an unknown unit or an impossible rate.
    """
    data = read_whole(path, fix=_FIX, most_bytes=_MOST_BYTES)
    try:
        file = _parsed(data)
    except (struct.error, *FAULTS) as error:
        raise InputError(f"is no C3D: {error}", file=path, fix=_FIX) from None
    unit = file.unit
    if unit not in METRES:
        known = f"write one of {', '.join(METRES)}"
        raise InputError("is an unknown unit", file=path, field="POINT:UNITS", value=unit, fix=known)
    if not len(file.words) or not file.names or not 0 < file.rate_hz < math.inf:
        raise InputError("has no points, or no frames at a rate", file=path, fix=_FIX)
    last = np.clip(np.nan_to_num(file.words[..., 3], nan=-1.0), -1, 0x7FFF).astype(np.int64)
    known = (last >= 0) & np.all(np.isfinite(file.words[..., :3]), axis=2)
    residuals = (last & 0xFF) * file.scale
    positions = np.where(known[..., None], METRES[unit] * file.words[..., :3], np.nan)
    certain = known & (residuals > 0) & (residuals < _LARGEST_RESIDUAL * file.scale)
    told = file.ours or bool((known & (residuals > 0)).any())
    states = np.where((residuals == 0) & told, JointState.INFERRED, JointState.TRACKED)
    count = len(file.words)
    return Trajectories(
        kind="points",
        times_s=np.arange(count) / file.rate_hz,
        runs=np.zeros(count, np.int64),
        individuals=(file.subject or path.stem,),
        keypoints=file.names,
        positions=positions[:, None],
        states=np.where(known, states, JointState.NOT_TRACKED).astype(np.uint8)[:, None],
        sd=np.where(certain, METRES[unit] * residuals, np.nan).astype(np.float32)[:, None],
        rate_hz=file.rate_hz,
        notes=() if count == file.claimed else (f"its header says {file.claimed} frames, and it has {count}",),
        cut_off=count < file.claimed,
    )


@dataclass(frozen=True, eq=False)
class _File:
    """Content of a C3D.

    Attributes:
        names: labels of the points.
        words: (frames, points, 4) x, y, z in the file's unit, and the fourth word: the residual in its low byte.
        scale: factor of residuals.
        unit, rate_hz, subject: unit of length, frame rate [Hz], and the only subject's name, else empty.
        ours: whether Mocapella wrote it.
        claimed: number of frames by its parameters.
    """

    names: tuple[str, ...]
    words: Float64
    scale: float
    unit: str
    rate_hz: float
    subject: str
    ours: bool
    claimed: int


def _parsed(data: bytes) -> _File:
    if len(data) < 2 * _BLOCK or data[1] != _KEY:
        raise ValueError("it does not begin like a C3D")
    at = (data[0] - 1) * _BLOCK
    processor = data[at + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise ValueError(f"processor type {processor} is unknown; known: {_INTEL}, {_DEC}, {_MIPS}")
    end = ">" if processor == _MIPS else "<"
    parameters = _parameters(data, at + 4, processor, end)
    header = struct.unpack_from(f"{end}HHHHH", data, 2)
    points, analog, first, last = int(header[0]), int(header[1]), int(header[2]), int(header[3])
    scale = float(_number(parameters, "POINT:SCALE", _floats(data[12:16], processor, end)[0]))
    rate_hz = float(_number(parameters, "POINT:RATE", _floats(data[20:24], processor, end)[0]))
    begin = (int(struct.unpack_from(f"{end}H", data, 16)[0]) - 1) * _BLOCK
    points = int(_number(parameters, "POINT:USED", points)) & 0xFFFF
    if begin < _BLOCK or points < 1 or not math.isfinite(scale) or scale == 0:
        raise ValueError("its header has no points, no scale or no data")
    size = 4 if scale < 0 else 2
    row = size * (4 * points + analog)
    claimed = _frame_count(parameters, first, last)
    count = min(claimed, (len(data) - begin) // row)
    raw = np.frombuffer(data, np.uint8, count * row, begin).reshape(count, row)[:, : 4 * size * points]
    if size == 4:
        words = _floats(raw.tobytes(), processor, end).astype(np.float64).reshape(count, points, 4)
    else:
        words = np.frombuffer(raw.tobytes(), f"{end}i2").astype(np.float64).reshape(count, points, 4)
        words[..., :3] *= scale
    labels = [name for key in ("LABELS", "LABELS2", "LABELS3") for name in parameters.get(f"POINT:{key}", [])]
    names = tuple(labels[:points]) + tuple(f"point_{k + 1}" for k in range(len(labels), points))
    subjects = [name for name in parameters.get("SUBJECTS:NAMES", []) if name]
    unit = next(iter(parameters.get("POINT:UNITS", [])), "mm")
    ours = parameters.get("MANUFACTURER:SOFTWARE") == ["Mocapella"]
    subject = subjects[0] if len(subjects) == 1 else ""
    return _File(distinct(names), words, abs(scale), unit, rate_hz, subject, ours, claimed)


def _frame_count(parameters: Parameters, first: int, last: int) -> int:
    """Return the number of frames; beyond 65,535, the header's 16 bits do not suffice."""
    ends = [parameters.get(f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END")]
    if all(one is not None and len(one) == 2 for one in ends):
        low, high = ((int(one[0]) & 0xFFFF) + ((int(one[1]) & 0xFFFF) << 16) for one in ends if one is not None)
        if high >= low > 0:
            return high - low + 1
    return max(0, last - first + 1)


def _number(parameters: Parameters, name: str, otherwise: float) -> float:
    values = parameters.get(name)
    return otherwise if values is None or isinstance(values, list) or not len(values) else values[0]


def _floats(data: bytes, processor: int, end: str) -> NDArray[np.float32]:
    if processor == _DEC:  # the halves are exchanged, and the exponent is larger by 2
        swapped = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1].copy()
        return np.asarray(swapped.view("<f4")[:, 0] / np.float32(4.0))
    return np.frombuffer(data, f"{end}f4")


def _parameters(data: bytes, at: int, processor: int, end: str) -> Parameters:
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Any] = {}
    while at + 4 <= len(data):
        length, group = abs(struct.unpack_from("b", data, at)[0]), struct.unpack_from("b", data, at + 1)[0]
        if length == 0 or group == 0:
            break
        name = data[at + 2 : at + 2 + length].decode("latin-1").upper()
        at += 2 + length
        (step,) = struct.unpack_from(f"{end}h", data, at)
        if group < 0:
            groups[-group] = name
        else:
            found[group, name] = _value(data, at + 2, processor, end)
        if step <= 0:
            break
        at += step
    return {f"{groups.get(group, '')}:{name}": value for (group, name), value in found.items()}


def _value(data: bytes, at: int, processor: int, end: str) -> Any:
    kind = struct.unpack_from("b", data, at)[0]
    if kind not in _TYPES:
        raise ValueError(f"a parameter has the unknown type {kind}")
    sizes = list(data[at + 2 : at + 2 + data[at + 1]])
    count = math.prod(sizes)
    begin = at + 2 + len(sizes)
    raw = data[begin : begin + abs(kind) * count]
    if len(raw) < abs(kind) * count:
        raise ValueError("it ends within its parameters")
    if kind == 4:
        return _floats(raw, processor, end)
    if kind != -1:
        return np.frombuffer(raw, f"{end}{_TYPES[kind]}")
    length = sizes[0] if sizes else 1
    return [raw[k : k + length].decode("latin-1").strip(" \0") for k in range(0, len(raw), length)] if length else []
