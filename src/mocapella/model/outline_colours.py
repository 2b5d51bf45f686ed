"""Colours of contours in images, and of their bodies: red, green, blue, 0 to 255."""

from __future__ import annotations

from typing import Final

Colour = tuple[int, int, int]

OUTSIDE: Final[Colour] = (255, 60, 60)
"""Colour of the image's contour where it is outside the model's outline: the model should move outwards there."""
INSIDE: Final[Colour] = (60, 150, 255)
"""Colour of the image's contour where it is inside the model's outline."""
BODIES: Final[tuple[Colour, ...]] = ((60, 255, 90), (255, 214, 64), (226, 120, 255), (255, 150, 40), (64, 240, 220))
"""Colours of models, in the order of the people; neither red nor blue."""


def body_colour(number: int) -> Colour:
    """Return the colour of a body by its index from 0; the colours of `BODIES` repeat after the last."""
    return BODIES[number % len(BODIES)]


def css(colour: Colour) -> str:
    """Return a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
