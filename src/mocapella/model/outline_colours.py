"""The colours of outlines in pictures, and of the bodies that they are of: red, green, blue, 0 to 255."""

from __future__ import annotations

from typing import Final

Colour = tuple[int, int, int]

OUTSIDE: Final[Colour] = (255, 60, 60)
"""The image's outline where it lies outside of the model's: the body should move or bend out to there."""
INSIDE: Final[Colour] = (60, 150, 255)
"""The image's outline where it lies inside of the model's."""
BODIES: Final[tuple[Colour, ...]] = ((60, 255, 90), (255, 214, 64), (226, 120, 255), (255, 150, 40), (64, 240, 220))
"""Of models, in the order in which people are named; neither red nor blue."""


def body_colour(number: int) -> Colour:
    """Of the body of that number, from 0."""
    return BODIES[number % len(BODIES)]


def css(colour: Colour) -> str:
    """``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
