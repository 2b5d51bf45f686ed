"""Clothes of simulated people, as colours on the body in its rest pose, so that cloth moves with the skin.

    clothes = dressed(body_mesh("female"), make_outfit(seed=3))

A `Garment` is a cloth's pattern in two colours. The body's landmarks determine its extent: sleeves and trouser legs end
where the outfit states, hair is on the top and back of the head, and shoes cover the feet. Bodies without a head or
arms omit those garments.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.settings import check

Float64 = NDArray[np.float64]
Colour = tuple[float, float, float]

PATTERNS: Final = ("plain", "hoops", "checks", "print", "dots", "chest", "skin", "hair")
"""Names of the patterns, in the kernels' order."""
_NO_MATERIAL: Final = -1.0
ZONE: Final = 21


@dataclass(frozen=True)
class Garment:
    """A cloth, skin or hair.

    Attributes:
        pattern: one of `PATTERNS`.
        colour: reflectance of red, green and blue, 0 to 1.
        second: reflectance of the pattern's other colour.
        size_m: size of the pattern [m].
        shine: gloss of the surface.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    pattern: str
    colour: Colour
    second: Colour = (0.0, 0.0, 0.0)
    size_m: float = 0.1
    shine: float = 0.0

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise SettingsError(f"unknown pattern {self.pattern!r}; known: {one_of(self.pattern, PATTERNS)}")
        check(all(0 <= c <= 1 for c in (*self.colour, *self.second)), "colours", (self.colour, self.second), "0 to 1")
        check(0.001 <= self.size_m <= 10, "size_m", self.size_m, "from 0.001 to 10 m")
        check(0 <= self.shine <= 1, "shine", self.shine, "from 0 to 1")


@dataclass(frozen=True)
class Outfit:
    """A person's clothes, skin and hair.

    Attributes:
        shirt, trousers, shoes, skin, hair: pattern and colours of each.
        sleeve: length of the sleeves, as a fraction of the arm from shoulder to wrist; 0 for none.
        leg: length of the trousers, as a fraction of the leg from hip to ankle.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    shirt: Garment
    trousers: Garment
    shoes: Garment
    skin: Garment
    hair: Garment
    sleeve: float = 0.3
    leg: float = 1.0

    def __post_init__(self) -> None:
        check(0 <= self.sleeve <= 1, "sleeve", self.sleeve, "from 0 to 1")
        check(0 <= self.leg <= 1, "leg", self.leg, "from 0 to 1")


_SKINS: Final[tuple[Colour, ...]] = ((0.62, 0.40, 0.30), (0.52, 0.31, 0.22), (0.36, 0.20, 0.13), (0.16, 0.085, 0.055))
_HAIRS: Final[tuple[Colour, ...]] = ((0.02, 0.015, 0.012), (0.07, 0.04, 0.02), (0.28, 0.18, 0.08), (0.3, 0.28, 0.27))
_JEANS: Final = Garment("plain", (0.05, 0.08, 0.16))
_BLACK: Final = Garment("plain", (0.025, 0.025, 0.028))
_SNEAKERS: Final = Garment("plain", (0.6, 0.6, 0.6), shine=0.05)
_SKIN: Final = Garment("skin", _SKINS[1], shine=0.03)
_HAIR: Final = Garment("hair", _HAIRS[1], shine=0.04)
OUTFITS: Final = {
    "stripes": Outfit(Garment("hoops", (0.55, 0.55, 0.52), (0.05, 0.07, 0.2), 0.09), _JEANS, _SNEAKERS, _SKIN, _HAIR),
    "checks": Outfit(Garment("checks", (0.4, 0.06, 0.05), (0.04,) * 3, 0.11), _JEANS, _BLACK, _SKIN, _HAIR, 0.96),
    "print": Outfit(Garment("chest", (0.06, 0.25, 0.35), (0.65, 0.6, 0.2), 0.3), _BLACK, _SNEAKERS, _SKIN, _HAIR, 0.35),
    "camouflage": Outfit(
        Garment("print", (0.13, 0.14, 0.07), (0.25, 0.22, 0.13), 0.1),
        Garment("print", (0.13, 0.14, 0.07), (0.25, 0.22, 0.13), 0.12), _BLACK, _SKIN, _HAIR, 0.95,
    ),
    "sports": Outfit(
        Garment("plain", (0.6, 0.12, 0.03)), Garment("plain", (0.03, 0.03, 0.04)), _SNEAKERS, _SKIN, _HAIR, 0.28, 0.42
    ),
    "dots": Outfit(
        Garment("dots", (0.3, 0.32, 0.36), (0.6, 0.55, 0.5), 0.07), Garment("plain", (0.35, 0.28, 0.2)), _BLACK, _SKIN,
        _HAIR, 0.0, 0.55,
    ),
    "black": Outfit(_BLACK, _BLACK, _BLACK, _SKIN, _HAIR, 0.97),
}  # fmt: skip
BACKGROUND: Final = "background"
"""Name of an outfit in the colours of the room's wall and floor."""


def outfit_names() -> tuple[str, ...]:
    """Return the names that `make_outfit` knows."""
    return (*OUTFITS, BACKGROUND)


def make_outfit(name: str | None = None, seed: int = 0, colours: tuple[Colour, Colour] | None = None) -> Outfit:
    """Make an outfit with random skin and hair.

    Args:
        name: one of `outfit_names`; None for a random one, but never `BACKGROUND`.
        seed: random seed.
        colours: reflectances of the room's wall and floor, for `BACKGROUND`; None for other outfits.

    Raises:
        SettingsError: unknown outfit, or the room's colours are missing.
    """
    rng = np.random.default_rng([seed, 21])
    skin, hair = _SKINS[rng.integers(len(_SKINS))], _HAIRS[rng.integers(len(_HAIRS))]
    if name is None:
        name = list(OUTFITS)[rng.integers(len(OUTFITS))]
    if name == BACKGROUND:
        if colours is None:
            raise SettingsError("the outfit background takes the colours of a room; give them")
        wall, floor = colours
        outfit = Outfit(Garment("plain", wall), Garment("plain", floor), Garment("plain", floor), _SKIN, _HAIR, 0.95)
    elif name in OUTFITS:
        outfit = OUTFITS[name]
    else:
        raise SettingsError(f"unknown outfit {name!r}; known: {one_of(name, outfit_names())}")
    return dataclasses.replace(
        outfit,
        skin=dataclasses.replace(outfit.skin, colour=skin),
        hair=dataclasses.replace(outfit.hair, colour=hair),
    )


@dataclass(frozen=True, eq=False)
class Clothes:
    """An outfit on a mesh, as arrays for the kernels.

    Attributes:
        parts: (faces,) index of each face's zone.
        zones, spots, materials: (zones, 21), (n, 5), (m, 10), see `body_paint_kernels.bake`.
    """

    parts: NDArray[np.int32]
    zones: Float64
    spots: Float64
    materials: Float64


def dressed(mesh: RiggedMesh, outfit: Outfit, seed: int = 0) -> Clothes:
    """Put an outfit on a body's mesh, which is not changed; ``seed`` is the random seed of folds and threads."""
    at = {name: landmark.point for name, landmark in mesh.landmarks.items()}
    shirt, trousers, shoes, skin, hair, dark = range(6)
    eyes = Garment("plain", (0.02, 0.015, 0.015), shine=0.2)
    materials = np.array(
        [
            [PATTERNS.index(g.pattern), *g.colour, *g.second, g.size_m, 1000 * seed + 7 * k, g.shine]
            for k, g in enumerate((outfit.shirt, outfit.trousers, outfit.shoes, outfit.skin, outfit.hair, eyes))
        ]
    )
    zones = np.array([_zone(name, at, outfit, (shirt, trousers, shoes, skin, hair)) for name in mesh.part_names])
    spots = [[*at[name], 0.014, dark] for name in ("left eye", "right eye") if name in at]
    for name in [name for name in ("left eye",) if {"nose", "right eye"} <= at.keys() and name in at]:
        mouth = at["nose"] + np.array([0.0, -1.1 * (at[name][1] - at["nose"][1]), -0.02])
        materials = np.vstack([materials, [0, 0.35, 0.1, 0.09, 0, 0, 0, 0.1, 0, 0.05]])
        spots.append([*mouth, 0.026, len(materials) - 1])
    parts = mesh.bones[mesh.faces[:, 0], 0].astype(np.int32)
    return Clothes(parts, zones, np.array(spots, np.float64).reshape(-1, 5), materials)


def _zone(part: str, at: dict[str, Float64], outfit: Outfit, which: tuple[int, ...]) -> list[float]:
    """One row of `Clothes.zones`."""
    shirt, trousers, shoes, skin, hair = which
    side, _, kind = part.rpartition(" ")
    side = part.split(" ", maxsplit=1)[0]
    origin, direction = np.zeros(3), np.array([0.0, 1.0, 0.0])
    ends: list[float] = []
    worn = [trousers]
    plane, behind = np.zeros(4), _NO_MATERIAL
    if part.endswith("arm") and {f"{side} shoulder", f"{side} wrist"} <= at.keys():
        origin = at[f"{side} shoulder"]
        arm = at[f"{side} wrist"] - origin
        length = float(np.linalg.norm(arm))
        direction, ends, worn = arm / length, [outfit.sleeve * length], [shirt, skin]
    elif kind in ("thigh", "shank", "foot") and {f"{side} hip", f"{side} ankle"} <= at.keys():
        origin, direction = at[f"{side} hip"], -direction
        length = float(np.linalg.norm(at[f"{side} ankle"] - origin))
        ends, worn = [max(outfit.leg, 0.12) * length, 0.93 * length], [trousers, skin, shoes]
        if outfit.leg >= 0.9:
            ends, worn = [1.0 * length], [trousers, shoes]
    elif "waist" in at:
        belt, neck = at["waist"][1] - 0.05, np.inf
        if {"neck", "nose"} <= at.keys():  # a collar, above the shoulders
            neck = at["neck"][1] + 0.35 * (at["nose"][1] - at["neck"][1])
        if outfit.shirt.pattern == "chest":  # the kernel places the print's middle at along = 1 m
            middle = 0.68 * min(neck, belt + 0.5) + 0.32 * belt
            origin = np.array([0.0, middle - 1.0, 0.0])
        ends, worn = [belt - origin[1], neck - origin[1]], [trousers, shirt, skin]
        if {"left eye", "left ear", "head"} <= at.keys():
            eye, ear = at["left eye"], at["left ear"]
            normal = np.array([0.0, 0.75, -0.66])  # up and back; through the forehead, behind the ears
            brow = np.array([0.0, 0.45 * eye[1] + 0.55 * at["head"][1], eye[2]])
            plane, behind = np.array([*normal, max(normal @ brow, normal @ ear + 0.01)]), float(hair)
    ends = (ends + [np.inf] * 4)[:4]
    filled = (worn + [worn[-1]] * 5)[:5]
    return [*origin, *direction, float(len(worn)), *ends, *map(float, filled), *plane, behind]


def plain_clothes(mesh: RiggedMesh, cloth: Garment) -> Clothes:
    """Cover a whole mesh, such as a chair, with one material."""
    row = [PATTERNS.index(cloth.pattern), *cloth.colour, *cloth.second, cloth.size_m, 0, cloth.shine]
    zone = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, *[np.inf] * 4, *[0.0] * 5, *[0.0] * 4, _NO_MATERIAL]
    parts = mesh.bones[mesh.faces[:, 0], 0].astype(np.int32)
    zones = np.array([zone] * len(mesh.part_names))
    return Clothes(parts, zones, np.empty((0, 5)), np.array([row], np.float64))
