"""Lengths of a person's segments, average for the height or measured, and breadths of the body's surface.

`mocapella.model.body_meshes` makes a mesh of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final, Literal

import numpy as np

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.settings import check, parse

Sex = Literal["female", "male"]
UPRIGHT: Final = ("ankle_height", "shank", "thigh", "trunk", "head")
"""Segments that add up to the height."""
SPREAD: Final = (0.6, 1.6)
"""Valid range of a segment's length, relative to the average for the height."""
HEEL: Final = (0.12, -0.27)
TOE: Final = (0.08, 0.73)
"""Landmarks of heel and toe, up and forward from the point below the ankle, relative to the foot's length."""
FOOT_SPAN: Final = float(np.hypot(HEEL[0] - TOE[0], HEEL[1] - TOE[1]))
HEIGHTS_M: Final = (0.5, 2.5)


@dataclass(frozen=True)
class Lengths:
    """Lengths of a body's segments [m], or in a table of average people, relative to the height.

    Attributes:
        ankle_height: height of the ankles above the ground.
        shank, thigh: lengths from joint to joint.
        trunk: distance from the midpoint of the hips to the midpoint of the shoulders.
        head: distance from the midpoint of the shoulders to the top of the head.
        shoulder_width, hip_width: distances between the centres of left and right joint.
        upper_arm, forearm: lengths from joint to joint.
        hand: length from the wrist to the fingertips.
        foot: length from heel to toes.

    Raises:
        SettingsError: a length is not finite and above 0.
    """

    ankle_height: float
    shank: float
    thigh: float
    trunk: float
    head: float
    shoulder_width: float
    hip_width: float
    upper_arm: float
    forearm: float
    hand: float
    foot: float

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            check(0 < value < np.inf, name, value, "above 0")

    @property
    def height(self) -> float:
        """The height from the ground to the top of the head, in the unit of the lengths."""
        return float(sum(getattr(self, name) for name in UPRIGHT))


SEGMENTS: Final = tuple(field.name for field in dataclasses.fields(Lengths))


@dataclass(frozen=True)
class BodyProportions:
    """The known lengths of a person's segments, the fields of `Lengths` [m]; None: unknown, so average for the height.

    Attributes:
        girth: breadths, depths and girths, relative to the average for the height.

    Raises:
        SettingsError: a length is not from 0.01 to 1.5 m, or the girth not from 0.75 to 1.5.
    """

    ankle_height: float | None = None
    shank: float | None = None
    thigh: float | None = None
    trunk: float | None = None
    head: float | None = None
    shoulder_width: float | None = None
    hip_width: float | None = None
    upper_arm: float | None = None
    forearm: float | None = None
    hand: float | None = None
    foot: float | None = None
    girth: float = 1.0

    def __post_init__(self) -> None:
        for name, value in self.known.items():
            check(0.01 <= value <= 1.5, name, value, "0.01 to 1.5 m")
        check(0.75 <= self.girth <= 1.5, "girth", self.girth, "0.75 to 1.5")

    @property
    def known(self) -> dict[str, float]:
        """Lengths of the known segments [m], by name."""
        named = {name: getattr(self, name) for name in SEGMENTS}
        return {name: float(value) for name, value in named.items() if value is not None}


AVERAGE: Final = BodyProportions()


@dataclass(frozen=True)
class Flesh:
    """Breadths and depths of an average body's surface, relative to its height.

    A cross section's first number is its position along the segment, 0 at the start and 1 at the end.

    Attributes:
        trunk: cross sections from hips to shoulders: position, half breadth, half depth, and shift forwards.
        thigh: cross sections: position, half breadth, shift forwards, and half depth minus half breadth.
        shank: cross sections: position, radius, and shift forwards.
        upper_arm, forearm: cross sections: position, radius, and shift towards the thumb.
        neck, jaw, breasts, buttocks: radii of these parts.
    """

    trunk: tuple[tuple[float, float, float, float], ...]
    thigh: tuple[tuple[float, float, float, float], ...]
    shank: tuple[tuple[float, float, float], ...]
    upper_arm: tuple[tuple[float, float, float], ...]
    forearm: tuple[tuple[float, float, float], ...]
    neck: float
    jaw: float
    breasts: float
    buttocks: float


@dataclass(frozen=True)
class BodyShape:
    """The average shape of a sex.

    Attributes:
        name: name of the table, ``female`` or ``male``.
        height_m: average height [m].
        lengths, flesh: lengths of segments, and breadths and depths of the surface, relative to the height.
    """

    name: str
    height_m: float
    lengths: Lengths
    flesh: Flesh


@cache
def body_shape(sex: Sex) -> BodyShape:
    """Return the average shape of a sex, from a file of the package; the same object at each call.

    Raises:
        SettingsError: there is no such table; lists the known ones.
    """
    folder = files("mocapella.model").joinpath("body_shapes")
    names = sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    if sex not in names:
        raise SettingsError(f"unknown sex {sex!r}; known: {one_of(sex, names)}")
    return parse(BodyShape, own_toml("mocapella.model", "body_shapes", f"{sex}.toml"), where=f"body shape {sex}")


def lengths_of(sex: Sex, height_m: float | None, proportions: BodyProportions) -> Lengths:
    """Return a person's segments [m]: known ones unchanged, the others average for the height.

    If a height is given, the unknown ones among `UPRIGHT` are scaled so that these segments add up to it.

    Args:
        sex: selects the table of average segments, for the unknown ones.
        height_m: from the ground to the top of the head [m]; None: the median of the known segments' estimates.
        proportions: lengths of the known segments.

    Raises:
        SettingsError: an implausible height, neither a height nor a segment, or segments that do not fit the height.
    """
    table, known = dataclasses.asdict(body_shape(sex).lengths), proportions.known
    if height_m is None:
        check(bool(known), "height_m", height_m, "given, where no segment is")
        height = float(np.median([value / table[name] for name, value in known.items()]))
        scale = 1.0
    else:
        height = height_m
        check(HEIGHTS_M[0] <= height <= HEIGHTS_M[1], "height_m", height, f"{HEIGHTS_M[0]} to {HEIGHTS_M[1]} m")
        left = height - sum(value for name, value in known.items() if name in UPRIGHT)
        unknown = sum(table[name] for name in UPRIGHT if name not in known)
        scale = left / (height * unknown) if unknown else 1.0
        check(bool(unknown) or abs(left) < 1e-6, "height_m", height_m,
              f"{height - left:.4f}, the sum of {', '.join(UPRIGHT)}, or not given")  # fmt: skip
        check(bool(SPREAD[0] <= scale <= SPREAD[1]), "height_m", height_m,
              f"such that, with {_told(known)}, the rest is shared by the other segments")  # fmt: skip
    check(HEIGHTS_M[0] <= height <= HEIGHTS_M[1], "height_m", height, f"{HEIGHTS_M[0]} to {HEIGHTS_M[1]} m")
    for name, value in known.items():
        least, most = (round(bound * table[name] * height, 3) for bound in SPREAD)
        check(least <= value <= most, name, value, f"{least} to {most} m of a person {height:.2f} m high")
    filled = {name: height * value * (scale if name in UPRIGHT else 1.0) for name, value in table.items()}
    return Lengths(**{**filled, **known})


_SPANS: Final = {
    "shank": ("{} knee", "{} ankle"),
    "thigh": ("{} hip", "{} knee"),
    "trunk": ("middle hip", "middle shoulder"),
    "head": ("middle shoulder", "head"),
    "shoulder_width": ("left shoulder", "right shoulder"),
    "hip_width": ("left hip", "right hip"),
    "upper_arm": ("{} shoulder", "{} elbow"),
    "forearm": ("{} elbow", "{} wrist"),
    "hand": ("{} wrist", "{} fingertip"),
    "foot": ("{} heel", "{} toe"),
}
"""The landmarks of `body_mesh` at a segment's ends; {}: of both sides."""


def proportions_of(joints: Mapping[str, Any], girth: float = 1.0) -> BodyProportions:
    """Measure a person's segments from the joints of one frame, such as a T-pose, or of several frames.

    A length is the median over frames and over both sides, so that both sides are equal and single wrong frames have no
    effect; for the trunk this is correct for people who mostly stand upright. A segment whose ends are never seen
    together is unknown, and so is the height of the ankles, which would need the floor.

    Args:
        joints: positions [m], (3,) or (frames, 3) each, by the names of the landmarks of `body_mesh`; NaN: not
            seen. Other names are ignored.
        girth: breadths and depths, relative to the average for the height; 0.75 to 1.5.

    Raises:
        SettingsError: arrays of other shapes, no visible segment, or an implausible length.
    """
    seen = {name: np.atleast_2d(np.asarray(place, dtype=np.float64)) for name, place in joints.items()}
    shapes = {place.shape for place in seen.values()}
    right = len(shapes) <= 1 and all(len(shape) == 2 and shape[1] == 3 for shape in shapes)
    check(right, "shapes of joints", sorted(shapes), "all (3,), or all (frames, 3) of as many frames")
    for kind in ("hip", "shoulder"):
        if f"left {kind}" in seen and f"right {kind}" in seen:
            seen[f"middle {kind}"] = 0.5 * (seen[f"left {kind}"] + seen[f"right {kind}"])
    found = {}
    for segment, (start, end) in _SPANS.items():
        sides = [(start.format(side), end.format(side)) for side in ("left", "right")]
        pairs = [seen[a] - seen[b] for a, b in sides if a in seen and b in seen]
        spans = np.linalg.norm(np.concatenate([np.empty((0, 3)), *pairs]), axis=1)
        if np.isfinite(spans).any():
            found[segment] = float(np.nanmedian(spans)) / (FOOT_SPAN if segment == "foot" else 1.0)
    check(bool(found), "joints", sorted(joints), f"such that both ends of a segment are seen together, as {_SPANS}")
    return BodyProportions(**found, girth=girth)


def _told(known: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.3f} m" for name, value in known.items())
