"""Alignment of another tracker's frame with the cameras' world frame, as a value and a file."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_toml, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.model.whole_file import write_whole
from mocapella.settings import check, parse

Float64 = NDArray[np.float64]

FORMAT: Final = "mocapella space alignment"
VERSION: Final = 1
"""Version of the file's layout."""
_ANEW: Final = "align anew: mocapella calibrate space"
_Row = tuple[float, float, float, float]


@dataclass(frozen=True)
class SpaceAlignment:
    """The pose of another tracker's frame in the cameras' world, and its clock offset, with uncertainties.

    Attributes:
        space: name of the frame, as in that tracker's `mocapella.model.poses.PoseFrame`.
        rows: the upper three rows of ``T_world_space``.
        clock_s: delay of that tracker's poses relative to the cameras' frames, subtracted from their times [s].
        position_sd_m: standard deviation of a point's position where the alignment was made; 0 if unknown [m].
        rotation_sd_rad: standard deviation of the rotation; 0 if unknown [rad].
        clock_sd_s: standard deviation of ``clock_s``; 0 if unknown [s].

    Raises:
        SettingsError: no rigid motion, a delay beyond ±10 s, or an impossible name or standard deviation.
    """

    space: str
    rows: tuple[_Row, _Row, _Row]
    clock_s: float = 0.0
    position_sd_m: float = 0.0
    rotation_sd_rad: float = 0.0
    clock_sd_s: float = 0.0

    def __post_init__(self) -> None:
        check(0 < len(self.space) <= 80, "space", self.space[:80], "1 to 80 characters")
        R = np.array(self.rows)[:, :3]
        rigid = bool(np.isfinite(self.rows).all()) and np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-4)
        check(rigid and np.linalg.det(R) > 0, "rows", self.rows, "the upper rows of a rigid motion")
        check(-10 <= self.clock_s <= 10, "clock_s", self.clock_s, "within ±10 s")
        for name in ("position_sd_m", "rotation_sd_rad", "clock_sd_s"):
            check(0 <= getattr(self, name) < 1e6, name, getattr(self, name), "0 or more")

    @property
    def T_world_space(self) -> Float64:  # noqa: N802 - the field's notation
        """(4, 4) from the other tracker's frame to the world."""
        T = np.eye(4)
        T[:3] = self.rows
        return T


def rows_of(T: Float64) -> tuple[_Row, _Row, _Row]:
    """Return the upper three rows of a transform T (4, 4), as nested tuples."""
    first, second, third = (tuple(map(float, row)) for row in T[:3])
    return first, second, third  # type: ignore[return-value]


def save_space(path: Path | str, alignment: SpaceAlignment) -> None:
    """Write an alignment as TOML atomically: the file is complete or unchanged.

    Raises:
        InputError: it cannot be written there.
    """
    import tomli_w

    values = {"format": FORMAT, "version": VERSION, **as_settings(alignment)}
    write_whole(path, tomli_w.dumps(values).encode())


def as_settings(alignment: SpaceAlignment) -> dict[str, Any]:
    """Convert an alignment to plain values by field name; `mocapella.settings.parse` rebuilds it from them."""
    values = dataclasses.asdict(alignment)
    return values | {"rows": [list(row) for row in alignment.rows]}


def load_space(path: Path | str) -> SpaceAlignment:
    """Read an alignment from a TOML file of `save_space`.

    Raises:
        InputError: the file does not exist, or is not an alignment; states the field, its value and a remedy.
    """
    data = decode_toml(read_whole(path, fix=_ANEW), file=path, fix=_ANEW)
    if data.get("format") != FORMAT or data.get("version") != VERSION:
        told = (data.get("format"), data.get("version"))
        fix = f"this program reads {FORMAT!r}, version {VERSION}; {_ANEW}"
        raise InputError("is something else", file=path, field="format and version", value=told, fix=fix)
    try:
        return parse(SpaceAlignment, {k: v for k, v in data.items() if k not in ("format", "version")}, where=str(path))
    except SettingsError as error:
        raise InputError(str(error), file=path, fix=_ANEW) from None
