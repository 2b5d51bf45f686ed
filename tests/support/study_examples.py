"""Study logs as values and as text, for the tests of reading, writing and replaying them."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mocapella.model.study_log import StudyLog, StudyRow
from mocapella.recording.study_columns import HEADER
from mocapella.recording.study_log import read_study_log

FRONT, SIDE = "138.251.213.82", "138.251.207.136"
NOON_MS = 63_562_201_888_998
FRAME_TICKS = 333_333

HEADER_B = {
    "Study_Id": "Study",
    "Kinect_Config": "KinectConfig",
    "Scenario_Id": "Scenario",
    "Person_Id": "Person#",
    "Skeleton_Id": "Skeleton#",
    "Kinect_Id": "Kinect#",
}
ORDER_C = (
    "Scenario_Id",
    "Tracker_Time",
    "Person_Id",
    "Skeleton_Id",
    "Skeleton_Init_Angle",
    "Skeleton_Init_Dist",
    "Skeleton_Time",
    *HEADER[9:],
)


@cache
def real_logs_of(folder: Path) -> dict[str, StudyLog]:
    """Every real log by its file's name, read once for all tests."""
    return {path.name: read_study_log(path) for path in sorted(folder.glob("*.csv.gz"))}


@dataclasses.dataclass
class Rows:
    """Rows of two sensors and one person that walks; each field can be changed before `log` is made."""

    frames: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        random = np.random.default_rng(self.seed)
        count = 2 * self.frames
        second = np.arange(count) % 2
        step = np.arange(count) // 2
        body = random.normal(size=(25, 3)) * [0.3, 0.5, 0.2] + [0, 0, 2.4]
        walk = step[:, None, None] * [0.01, 0.0, -0.02]
        self.fields: dict[str, Any] = {
            "study_id": np.full(count, 7),
            "kinect_config": np.full(count, 2),
            "scenario_id": np.full(count, 3),
            "tracker_time_ms": NOON_MS + step * 33 + second,
            "person_id": np.zeros(count, dtype=np.int64),
            "skeleton_id": second,
            "skeleton_time_ticks": step * FRAME_TICKS + np.where(second, 5_000_000_123, 700),
            "init_angle": np.where(second, -1.4, 0.1),
            "init_dist": np.full(count, 2.4),
            "kinect_id": np.where(second, SIDE, FRONT),
            "tilt_deg": np.zeros(count),
            "height_cm": np.full(count, 100.0),
            "positions": (body + walk).astype(np.float32),
        }

    def __setitem__(self, name: str, values: Any) -> None:
        self.fields[name] = np.asarray(values)

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]

    def set(self, name: str, row: int, value: Any) -> Rows:
        self.fields[name] = self.fields[name].astype(np.array([self.fields[name][0], value]).dtype)
        self.fields[name][row] = value
        return self

    def take(self, order: Any) -> Rows:
        self.fields = {name: values[np.asarray(order)] for name, values in self.fields.items()}
        return self

    def log(self, source: str = "walk.csv") -> StudyLog:
        return StudyLog(source=source, **self.fields)


def same(a: StudyLog, b: StudyLog) -> bool:
    """Whether two logs have the same rows, to the bit."""
    names = [name for name in a.__struct_fields__ if name != "source"]
    return all(np.array_equal(getattr(a, name), getattr(b, name), equal_nan=name != "kinect_id") for name in names)


def in_variant(text: str, variant: str) -> str:
    """Text with header A as the headers B and C have it."""
    header, *rows = [line.split(", ") for line in text.strip().split("\n")]
    order = ORDER_C if variant == "C" else HEADER
    names = HEADER_B if variant in "BC" else {}
    places = [header.index(title) for title in order]
    lines = [[names.get(title, title) for title in order], *([row[i] for i in places] for row in rows)]
    return "".join(", ".join(line) + "\n" for line in lines)


def edited(text: str, row: int, field: str, value: str) -> str:
    """Text with another value in one field; row 1 is the header."""
    lines = [line.split(", ") for line in text.strip().split("\n")]
    lines[row - 1][lines[0].index(field)] = value
    return "".join(", ".join(line) + "\n" for line in lines)


def saved(folder: Path, content: str | bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


_whole = st.integers(-(2**63), 2**63 - 1)
_real = st.floats(allow_nan=False, allow_infinity=False).map(lambda value: np.nan if value == -9999 else value)
_kinects = st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters=',"'), min_size=1, max_size=20)
_coordinates = st.floats(-9998, 9998, width=32)


@st.composite
def study_rows(draw: st.DrawFn) -> StudyRow:
    """Any row that can be written; a joint at the origin would be a missing one, so there is none."""
    positions = draw(arrays.arrays(np.float32, (25, 3), elements=_coordinates))
    missing = draw(arrays.arrays(np.bool_, 25)) | (np.abs(positions) < 1e-6).all(axis=-1)
    positions[missing] = np.nan
    return StudyRow(
        **{name: draw(_whole) for name in StudyRow.__struct_fields__[:7]},
        init_angle=draw(_real),
        init_dist=draw(_real),
        kinect_id=draw(_kinects),
        tilt_deg=draw(_real),
        height_cm=draw(_real),
        positions=positions,
    )
