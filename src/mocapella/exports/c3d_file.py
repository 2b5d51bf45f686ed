"""Write C3D, the point file of biomechanics (https://www.c3d.org, user guide of 2021): Intel format, floating point."""

from __future__ import annotations

import struct
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from mocapella.errors import SettingsError
from mocapella.exports.run_labels import in_words, label_changes
from mocapella.model.names import distinct
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

MM_PER_M: Final = 1000.0
LARGEST_RESIDUAL_MM: Final = 255
MOST_POINTS: Final = 255
MOST_EVENTS: Final = 255
_BLOCK: Final = 512
_KEY: Final = 0x50
_INTEL: Final = 84
_GROUPS: Final = ("POINT", "ANALOG", "TRIAL", "SUBJECTS", "MANUFACTURER", "EVENT")


def write_c3d(trajectories: Trajectories, path: Path) -> list[str]:
    """Write one individual as C3D, in millimetres, with Y up (POINT:X_SCREEN is +X, Y_SCREEN is +Y).

    A point's residual is its standard deviation in whole millimetres, from 1 to 254; 255 is larger or unknown. As the
    format wants, an inferred point has the residual 0, which marks interpolated points, and an unknown one −1. The name
    of the individual is in SUBJECTS:NAMES. Labels of the take's runs are events, one at the first frame and one at each
    change: EVENT:DESCRIPTIONS has participant, placement and scenario.

    Args:
        trajectories: one individual at a constant rate.
        path: the file.

    Returns:
        A sentence if the labels change more often than a C3D can tell.

    Raises:
        SettingsError: there are more than `MOST_POINTS` keypoints.
        OSError: the file cannot be written.
    """
    frames, points = len(trajectories), len(trajectories.keypoints)
    if points > MOST_POINTS:
        raise SettingsError(f"{path.name}: a C3D has at most {MOST_POINTS} points, and these are {points}")
    positions, states, sd = trajectories.positions[:, 0], trajectories.states[:, 0], trajectories.sd[:, 0]
    known = np.all(np.isfinite(positions), axis=2)
    residuals = np.clip(np.rint(MM_PER_M * np.where(np.isfinite(sd), sd, np.inf)), 1, LARGEST_RESIDUAL_MM)
    words = np.zeros((frames, points, 4), "<f4")
    words[..., :3] = np.where(known[..., None], MM_PER_M * positions, 0.0)
    words[..., 3] = np.where(known, np.where(states == JointState.INFERRED, 0.0, residuals), -1.0)
    with path.open("wb") as file:
        file.write(_head(trajectories, frames, points))
        file.write(words.tobytes())
        file.write(bytes(-4 * words.size % _BLOCK))
    changes = len(label_changes(trajectories))
    return [f"has the first {MOST_EVENTS} of {changes} labels; a C3D holds no more"] if changes > MOST_EVENTS else []


def _head(trajectories: Trajectories, frames: int, points: int) -> bytes:
    """Return the header and the parameters, in whole blocks."""
    low, high = frames & 0xFFFF, frames >> 16
    most = min(frames, 0xFFFF)

    labels, names = distinct(map(_plain, trajectories.keypoints)), [_plain(name) for name in trajectories.individuals]

    def records(data_start: int) -> bytes:
        own = [
            _group(1 + number, name) for number, name in enumerate(_GROUPS)
        ] + [
            _numbers(1, "USED", "h", points), _numbers(1, "SCALE", "f", -1.0),
            _numbers(1, "RATE", "f", trajectories.rate_hz), _numbers(1, "DATA_START", "h", data_start),
            _numbers(1, "FRAMES", "H", most), _texts(1, "LABELS", labels), _texts(1, "UNITS", ["mm"]),
            _texts(1, "DESCRIPTIONS", [""] * points), _texts(1, "X_SCREEN", ["+X"]), _texts(1, "Y_SCREEN", ["+Y"]),
            _numbers(2, "USED", "h", 0), _numbers(2, "GEN_SCALE", "f", 1.0), _numbers(2, "RATE", "f", 0.0),
            _numbers(3, "ACTUAL_START_FIELD", "H", 1, 0), _numbers(3, "ACTUAL_END_FIELD", "H", low, high),
            _numbers(4, "USED", "h", 1), _texts(4, "NAMES", names),
            _texts(5, "SOFTWARE", ["Mocapella"]), *_events(trajectories),
        ]  # fmt: skip
        return b"".join(own) + bytes(2)

    blocks = -(-(4 + len(records(0))) // _BLOCK)
    data_start = 2 + blocks
    parameters = struct.pack("<BBBB", 1, _KEY, blocks, _INTEL) + records(data_start)
    header = struct.pack(
        "<BBHHHHHfHHf", 2, _KEY, points, 0, 1, most, 0, -1.0, data_start, 0, trajectories.rate_hz
    )  # fmt: skip
    return header.ljust(_BLOCK, b"\0") + parameters.ljust(_BLOCK * blocks, b"\0")


def _events(trajectories: Trajectories) -> list[bytes]:
    """Return the parameters of the events at which labels begin or change; only their number if none are given.

    TIMES has minutes and seconds since the first frame.
    """
    changes = [(frame, in_words(labels)) for frame, labels in label_changes(trajectories)[:MOST_EVENTS]]
    if not any(text for _, text in changes):
        return [_numbers(6, "USED", "h", 0)]
    times = [float(trajectories.times_s[frame] - trajectories.times_s[0]) for frame, _ in changes]
    minutes = struct.pack(f"<{2 * len(times)}f", *(part for time in times for part in divmod(time, 60.0)))
    count = len(changes)
    return [
        _numbers(6, "USED", "h", count), _texts(6, "CONTEXTS", ["General"] * count),
        _texts(6, "LABELS", ["Labels"] * count), _texts(6, "DESCRIPTIONS", [_plain(text) for _, text in changes]),
        _parameter(6, "TIMES", 4, [2, count], minutes),
    ]  # fmt: skip


def _group(number: int, name: str) -> bytes:
    return struct.pack("<bb", len(name), -number) + name.encode("ascii") + struct.pack("<hB", 3, 0)


def _parameter(group: int, name: str, kind: int, sizes: Sequence[int], data: bytes) -> bytes:
    body = struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + data + b"\0"
    return struct.pack("<bb", len(name), group) + name.encode("ascii") + struct.pack("<h", 2 + len(body)) + body


def _numbers(group: int, name: str, form: str, *values: float) -> bytes:
    sizes = [] if len(values) == 1 else [len(values)]
    return _parameter(group, name, 4 if form == "f" else 2, sizes, struct.pack(f"<{len(values)}{form}", *values))


def _plain(text: str) -> str:
    """Return a text as printable ASCII: letters without their marks, ``?`` for others."""
    letters = "".join(one for one in unicodedata.normalize("NFKD", text) if not unicodedata.combining(one))
    return "".join(one if one.isascii() and one.isprintable() else "?" for one in letters)


def _texts(group: int, name: str, texts: Sequence[str]) -> bytes:
    raw = [text.encode("ascii", "replace")[:127] for text in texts]
    length = max(1, *map(len, raw))
    return _parameter(group, name, -1, [length, len(raw)], b"".join(one.ljust(length) for one in raw))
