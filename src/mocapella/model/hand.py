"""Hand models: landmarks, joints with their limits, one person's bones, and a measured hand.

Landmarks are in the order of MediaPipe's hand: the wrist, then of the thumb CMC, MCP, IP and tip, then of index,
middle, ring and little finger MCP, PIP, DIP and tip. The palm's frame of a right hand has its origin at the wrist, x to
the thumb's side, y out of the back of the hand, and z towards the knuckle of the middle finger; a left hand is its
mirror image in x. `hands/human.toml` has the hand's numbers and their sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.resources import files
from itertools import pairwise
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_toml
from mocapella.errors import SettingsError, one_of
from mocapella.settings import check, parse

Float64 = NDArray[np.float64]
Handedness = Literal["left", "right"]
ConstraintSet = Literal["full", "thesis"]

DIGITS: Final = ("thumb", "index", "middle", "ring", "little")
WRIST: Final = 0
TIPS: Final = (4, 8, 12, 16, 20)
BASES: Final = (1, 5, 9, 13, 17)
"""Landmarks of the digits' first joints: the thumb's CMC, the fingers' MCP."""
LANDMARKS: Final = (
    "wrist",
    *(f"thumb {joint}" for joint in ("CMC", "MCP", "IP", "tip")),
    *(f"{finger} {joint}" for finger in DIGITS[1:] for joint in ("MCP", "PIP", "DIP", "tip")),
)
PARENTS: Final = (-1, *(0 if i % 4 == 0 else i for i in range(20)))
"""Index of the landmark at the other, proximal end of each landmark's bone; −1 for the wrist."""
ANGLES: Final = (
    *("thumb CMC flexion", "thumb CMC abduction", "thumb MCP flexion", "thumb MCP abduction", "thumb IP flexion"),
    *(
        f"{finger} {angle}"
        for finger in DIGITS[1:]
        for angle in ("MCP flexion", "MCP abduction", "PIP flexion", "DIP flexion")
    ),
)
DIGIT_ANGLES: Final = np.array(
    [[0, 1, 2, 4, 3], *([5 + 4 * k, 6 + 4 * k, 7 + 4 * k, 8 + 4 * k, -1] for k in range(4))], dtype=np.int64
)
"""(5, 5) indices in `ANGLES`, a row for each digit, thumb to little finger.

The columns are flexion and abduction of its first joint, flexion of its second and third joint, and abduction of its
second joint (-1: none).
"""
_EPSILON: Final = 1e-9


@dataclass(frozen=True)
class Digit:
    """A digit's proportions and limits, as in ``hands/human.toml``; positions and directions are in the palm's frame.

    Attributes:
        base: position of its first joint: x over the hand's breadth, y and z over its length.
        bone: direction of the straight digit at angles 0.
        bends_towards: direction of the tip's motion in flexion; made perpendicular to ``bone``.
        lengths: lengths of its three bones, from the base outwards, over hand length.
        centre_deg: flexion and abduction at the centre of the ellipse that limits the first joint [deg].
        flexion_deg, abduction_deg: least and most of both on that ellipse [deg]; flexion may begin at the centre (half
            an ellipse). Abduction is positive to the thumb's side.
        middle_deg, last_deg: least and most flexion of the second and third joint [deg].
        coupling_thirds: third joint's flexion in a relaxed hand, as a multiple of a third of the second's.
        natural_deg: flexion and abduction of the first joint, and flexion of the second, of a hand at rest [deg].

    Raises:
        SettingsError: a value is out of range, or limits do not fit such an ellipse.
    """

    base: tuple[float, float, float]
    bone: tuple[float, float, float]
    bends_towards: tuple[float, float, float]
    lengths: tuple[float, float, float]
    centre_deg: tuple[float, float]
    flexion_deg: tuple[float, float]
    abduction_deg: tuple[float, float]
    middle_deg: tuple[float, float]
    last_deg: tuple[float, float]
    coupling_thirds: int
    natural_deg: tuple[float, float, float]

    def __post_init__(self) -> None:
        check(min(self.lengths) > 0, "lengths", self.lengths, "above 0")
        check(float(np.linalg.norm(np.cross(self.bone, self.bends_towards))) > 1e-6, "bends_towards",
              self.bends_towards, "no multiple of bone")  # fmt: skip
        for name, (least, most), centre in (
            ("flexion_deg", self.flexion_deg, self.centre_deg[0]),
            ("abduction_deg", self.abduction_deg, self.centre_deg[1]),
        ):
            check(-120 <= least <= centre <= most <= 120, name, (least, most), f"around {centre}, within ±120")
            symmetric = math.isclose(most - centre, centre - least) or least == centre
            check(symmetric, name, (least, most), f"as far to both sides of {centre}, or begin there")
        check(self.abduction_deg[0] + self.abduction_deg[1] == 2 * self.centre_deg[1], "abduction_deg",
              self.abduction_deg, "as far to both sides of its centre")  # fmt: skip
        for name, (least, most) in (("middle_deg", self.middle_deg), ("last_deg", self.last_deg)):
            check(least == 0 < most <= 120, name, (least, most), "from 0 to at most 120")
        check(1 <= self.coupling_thirds <= 4, "coupling_thirds", self.coupling_thirds, "1 to 4")
        most = self.middle_deg[1] * self.coupling_thirds / 3
        check(most <= self.last_deg[1], "coupling_thirds", self.coupling_thirds, "within last_deg")


@dataclass(frozen=True)
class HandModel:
    """A hand's joints, axes, parents, limits and proportions.

    Attributes:
        name: name of the hand's file in ``hands``.
        constraints: ``full``: 21 joint angles. ``thesis``: 15, because DIP = 2/3·PIP, the middle finger does not
            abduct, nor does the thumb's MCP.
        hand_length_m, hand_breadth_m: size of the reference hand: from the wrist to the tip of the middle finger, and
            across the knuckles [m].
        digits: thumb to little finger.
        thumb_mcp_abduction_deg: least and most abduction of the thumb's MCP joint [deg].
        neighbours_deg: standard deviations of the differences between neighbouring fingers' flexions, index to little
            finger [deg].
    """

    name: str
    constraints: ConstraintSet
    hand_length_m: float
    hand_breadth_m: float
    digits: tuple[Digit, Digit, Digit, Digit, Digit]
    thumb_mcp_abduction_deg: tuple[float, float]
    neighbours_deg: tuple[float, float, float]

    @property
    def coupled(self) -> tuple[bool, ...]:
        """(5,) whether the flexion of a digit's third joint is always `coupling` times that of its second."""
        return (False, *[self.constraints == "thesis"] * 4)

    @property
    def coupling(self) -> Float64:
        """(5,) flexion of each digit's third joint over that of its second, in a relaxed hand."""
        return np.array([digit.coupling_thirds / 3 for digit in self.digits])

    @cached_property
    def frames(self) -> Float64:
        """(5, 3, 3) ``R_palm_digit`` at angles 0: z along the bone, -y where flexion moves the tip, x its axis."""
        frames = np.empty((5, 3, 3))
        for frame, digit in zip(frames, self.digits, strict=True):
            z = np.array(digit.bone) / np.linalg.norm(digit.bone)
            y = np.dot(digit.bends_towards, z) * z - digit.bends_towards
            y /= np.linalg.norm(y)
            frame[:] = np.stack([np.cross(y, z), y, z], axis=-1)
        return frames

    @cached_property
    def cones(self) -> Float64:
        """(5, 5) elliptical limits of the digits' first joints, a row for each digit [rad].

        The columns are the ellipse's centre, flexion then abduction, its half axes likewise, and the least flexion.
        """
        rows = []
        for i, digit in enumerate(self.digits):
            abduction = digit.abduction_deg[1] - digit.centre_deg[1]
            if self.constraints == "thesis" and i == DIGITS.index("middle"):
                abduction = 0.0
            flexion = digit.flexion_deg[1] - digit.centre_deg[0]
            rows.append([*digit.centre_deg, flexion, abduction, digit.flexion_deg[0]])
        return np.radians(rows)

    @cached_property
    def limits(self) -> Float64:
        """(21, 2) least and most of each angle [rad]; `cones` limit a first joint's two angles further, together."""
        out = np.zeros((len(ANGLES), 2))
        for row, digit, (f0, a0, F, A, least) in zip(DIGIT_ANGLES, self.digits, self.cones, strict=True):
            out[row[0]] = least, f0 + F
            out[row[1]] = a0 - A, a0 + A
            out[row[2]], out[row[3]] = np.radians(digit.middle_deg), np.radians(digit.last_deg)
        if self.constraints == "full":
            out[DIGIT_ANGLES[0, 4]] = np.radians(self.thumb_mcp_abduction_deg)
        return out

    @cached_property
    def natural(self) -> Float64:
        """(21,) angles of a hand at rest [rad]."""
        out = np.zeros(len(ANGLES))
        for row, digit in zip(DIGIT_ANGLES, self.digits, strict=True):
            flexion, abduction, middle = digit.natural_deg
            out[row[:4]] = np.radians([flexion, abduction, middle, middle * digit.coupling_thirds / 3])
        return out

    def within(self, angles: Float64, tolerance: float = 1e-9) -> NDArray[np.bool_]:
        """Return whether angles are within all limits, including `cones` and the couplings of `coupled` digits.

        Args:
            angles: (..., 21) in the order of `ANGLES` [rad].
            tolerance: allowed excess over a limit [rad].

        Returns:
            (...,) booleans; False where an angle is not finite.
        """
        angles = np.asarray(angles, dtype=np.float64)
        ok = ((angles >= self.limits[:, 0] - tolerance) & (angles <= self.limits[:, 1] + tolerance)).all(axis=-1)
        for row, (f0, a0, F, A, _), coupled, ratio in zip(
            DIGIT_ANGLES, self.cones, self.coupled, self.coupling, strict=True
        ):
            f, a = (angles[..., row[0]] - f0) / F, (angles[..., row[1]] - a0) / max(A, _EPSILON)
            ok &= np.hypot(f, np.where(A > 0, a, 0.0)) <= 1.0 + tolerance / min(F, A or F)
            if coupled:
                ok &= np.abs(angles[..., row[3]] - ratio * angles[..., row[2]]) <= tolerance
        return np.asarray(ok)

    def limited(self, angles: Float64) -> Float64:
        """Return angles clamped to the limits; values that are not finite become `natural`.

        A first joint beyond its ellipse moves towards the ellipse's centre. A coupled third joint follows its second.
        ``angles`` is not changed.

        Args:
            angles: (..., 21) in the order of `ANGLES` [rad].

        Returns:
            (..., 21) angles within the limits [rad].
        """
        angles = np.asarray(angles, dtype=np.float64)
        out = np.clip(np.where(np.isfinite(angles), angles, self.natural), self.limits[:, 0], self.limits[:, 1])
        for row, (f0, a0, F, A, _), coupled, ratio in zip(
            DIGIT_ANGLES, self.cones, self.coupled, self.coupling, strict=True
        ):
            f, a = out[..., row[0]] - f0, out[..., row[1]] - a0
            s = np.maximum(np.hypot(f / F, a / A if A > 0 else np.zeros_like(a)), 1.0)
            out[..., row[0]], out[..., row[1]] = f0 + f / s, a0 + a / s
            if coupled:
                out[..., row[3]] = ratio * out[..., row[2]]
        return out

    def shape(
        self,
        handedness: Handedness,
        *,
        hand_length_m: float | None = None,
        hand_breadth_m: float | None = None,
        person: str = "",
    ) -> HandShape:
        """Return a hand with the reference's proportions, scaled to a size.

        Args:
            handedness: left or right.
            hand_length_m: from the wrist to the tip of the middle finger [m]; None for the reference's.
            hand_breadth_m: across the knuckles [m]; None makes it proportional to the length.
            person: name of the person.

        Raises:
            SettingsError: the size is not human.
        """
        length = self.hand_length_m if hand_length_m is None else hand_length_m
        breadth = self.hand_breadth_m * length / self.hand_length_m if hand_breadth_m is None else hand_breadth_m
        check(0.05 <= length <= 0.35, "hand_length_m", length, "0.05 to 0.35 m")
        check(0.02 <= breadth <= 0.2, "hand_breadth_m", breadth, "0.02 to 0.2 m")
        lengths = length * np.array([digit.lengths for digit in self.digits])
        bases = np.array([digit.base for digit in self.digits]) * [breadth, length, length]
        return HandShape(handedness, lengths, bases, person)

    def with_constraints(self, constraints: ConstraintSet) -> HandModel:
        """Return the same hand with another set of constraints.

        Raises:
            SettingsError: the set does not exist.
        """
        check(constraints in ("full", "thesis"), "constraints", constraints, "full or thesis")
        return replace(self, constraints=constraints)

    def stretched(self, extension_deg: float, abduction_deg: float, apart: float = 1.0) -> HandModel:
        """Return the same hand with other limits of the fingers' first joints; the thumb's become 1.5 times as wide.

        Args:
            extension_deg: how far the fingers extend beyond straight, 0 or more [deg].
            abduction_deg: how far they abduct to either side [deg].
            apart: factor of the standard deviations of the differences between neighbouring fingers' flexions.

        Raises:
            SettingsError: limits beyond a human hand.
        """
        check(0 <= extension_deg <= 45, "extension_deg", extension_deg, "0 to 45")
        check(5 <= abduction_deg <= 40, "abduction_deg", abduction_deg, "5 to 40")
        check(0 < apart <= 100, "apart", apart, "above 0, at most 100")
        thumb, *fingers = self.digits
        centre = 0.5 * (fingers[0].flexion_deg[1] - extension_deg)
        limits = {
            "centre_deg": (centre, 0.0),
            "flexion_deg": (-extension_deg, fingers[0].flexion_deg[1]),
            "abduction_deg": (-abduction_deg, abduction_deg),
        }
        wide = {name: tuple(1.5 * limit for limit in getattr(thumb, name)) for name in ("flexion_deg", "abduction_deg")}
        thumb = replace(thumb, **wide)  # type: ignore[arg-type]
        index, middle, ring, little = (replace(finger, **limits) for finger in fingers)  # type: ignore[arg-type]
        one, two, three = (apart * sd_deg for sd_deg in self.neighbours_deg)
        return replace(self, digits=(thumb, index, middle, ring, little), neighbours_deg=(one, two, three))


class HandShape(msgspec.Struct, frozen=True, eq=False):
    """One person's hand. Positions are a right hand's, also for a left hand, in the palm's frame.

    Attributes:
        handedness: left or right.
        lengths: (5, 3) lengths of the digits' bones, from the base outwards [m].
        bases: (5, 3) positions of the digits' first joints in the palm's frame [m].
        person: name of the person; may be empty.
        lengths_sd: (5, 3) standard deviations of ``lengths`` [m]; None if not measured.

    Raises:
        SettingsError: a wrong shape, or a length, position or standard deviation beyond a human hand's.
    """

    handedness: Handedness
    lengths: Float64
    bases: Float64
    person: str = ""
    lengths_sd: Float64 | None = None

    def __post_init__(self) -> None:
        check(self.handedness in ("left", "right"), "handedness", self.handedness, "left or right")
        for name, array, least in (("lengths", self.lengths, 0.0), ("bases", self.bases, -0.5)):
            good = array.shape == (5, 3) and bool(((array > least) & (array < 0.5)).all())
            check(good, name, array.tolist(), f"(5, 3) between {least} and 0.5 m")
        if self.lengths_sd is not None:
            sd = self.lengths_sd
            good = sd.shape == (5, 3) and bool(((sd >= 0) & (sd < 0.5)).all())
            check(good, "lengths_sd", sd.tolist(), "(5, 3) from 0 to below 0.5 m")

    @property
    def mirror(self) -> Float64:
        """(3,) factors of positions in the palm's frame: (1, 1, 1), or for a left hand (−1, 1, 1)."""
        return np.array([-1.0 if self.handedness == "left" else 1.0, 1.0, 1.0])


class HandPose(msgspec.Struct, frozen=True, eq=False):
    """The posture of a hand.

    Attributes:
        angles: (..., 21) in the order of `ANGLES` [rad].
        T_world_palm: (..., 4, 4) pose of the palm.
    """

    angles: Float64
    T_world_palm: Float64


class Hand(msgspec.Struct, frozen=True, eq=False):
    """A measured hand at an instant, with uncertainties.

    Attributes:
        at_s: capture time, on the clock of the observations [s].
        handedness: left or right.
        landmarks: (21, 3), world [m]; NaN if unknown.
        states: (21,) `JointState`: tracked where this instant's markers determine the landmark, inferred where
            limits, proportions, priors or earlier instants do.
        sd_m: (21,) standard deviation of a coordinate [m].
        angles: (21,) in the order of `ANGLES` [rad].
        angles_sd: (21,) standard deviations of ``angles`` [rad].
        T_world_palm: (4, 4) pose of the palm.
        residuals_m: (markers,) distance of each marker from its place on the fitted hand [m]; NaN if not seen.
    """

    at_s: float
    handedness: Handedness
    landmarks: Float64
    states: NDArray[np.uint8]
    sd_m: Float64
    angles: Float64
    angles_sd: Float64
    T_world_palm: Float64
    residuals_m: Float64


@cache
def hand_model(constraints: ConstraintSet = "thesis", name: str = "human") -> HandModel:
    """Return the hand model of a name, from a file of the package; the same object at each call with these arguments.

    Raises:
        SettingsError: unknown hand or set of constraints; lists the known ones.
    """
    folder = files("mocapella.model").joinpath("hands")
    names = sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    if name not in names:
        raise SettingsError(f"unknown hand {name!r}; known: {one_of(name, names)}")
    model = hand_model_from_toml(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    return model.with_constraints(constraints)


def hand_model_from_toml(text: str) -> HandModel:
    """Read and validate a hand model with all 21 angles from the text of its TOML file, such as ``hands/human.toml``.

    Raises:
        InputError: the text is no TOML.
        SettingsError: a key or digit that is unknown or missing, or a value out of range.
    """
    data = decode_toml(text)
    known = ("name", "hand_length_m", "hand_breadth_m", "thumb_mcp_abduction_deg", "digits", "neighbours_deg")
    _same_keys(data, known, "hand")
    _same_keys(data["digits"], DIGITS, "hand, digits")
    pairs = [f"{one}_{other}" for one, other in pairwise(DIGITS[1:])]
    _same_keys(data["neighbours_deg"], pairs, "hand, neighbours_deg")
    thumb, index, middle, ring, little = (
        parse(Digit, data["digits"][name], where=f"hand, digit {name}") for name in DIGITS
    )
    least, most = (float(limit) for limit in data["thumb_mcp_abduction_deg"])
    check(-90 <= least <= 0 <= most <= 90, "thumb_mcp_abduction_deg", (least, most), "around 0, within ±90")
    one, two, three = (float(data["neighbours_deg"][pair]) for pair in pairs)
    check(min(one, two, three) > 0, "neighbours_deg", (one, two, three), "above 0")
    length, breadth = float(data["hand_length_m"]), float(data["hand_breadth_m"])
    digits = (thumb, index, middle, ring, little)
    return HandModel(data["name"], "full", length, breadth, digits, (least, most), (one, two, three))


def _same_keys(data: dict[str, object], known: tuple[str, ...] | list[str], where: str) -> None:
    for key in data:
        if key not in known:
            raise SettingsError(f"{where}: unknown key {key!r}; known: {one_of(key, known)}")
    for key in known:
        if key not in data:
            raise SettingsError(f"{where}: {key} is missing; there must be {', '.join(known)}")
