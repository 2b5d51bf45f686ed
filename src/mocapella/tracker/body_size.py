"""Report bodies whose segments are longer or shorter than people's, and the likely scale of the rig.

The size of a body comes from joints in the rig's world. A rig whose lengths are wrong, such as one calibrated with a
wrong size of the board's squares, makes all segments wrong by one factor.
"""

from __future__ import annotations

from typing import Final, cast

import numpy as np

from mocapella.model.body_proportions import Sex, body_shape, proportions_of
from mocapella.model.rigged_mesh import RiggedMesh

SEXES: Final = {"male": "male", "female": "female", "legs": "male"}
"""Table of average segments by the name of a built-in mesh; other meshes are of any size."""
JUDGED: Final = ("thigh", "shank", "trunk", "upper_arm", "forearm")
"""Segments whose ends triangulate well; hands, feet, hips and shoulders differ too much with the detector."""
TALLEST_M: Final = 2.3
"""A segment that is longer than the average of people of this height is impossible [m]."""
HEIGHTS_M: Final = (0.75, 2.15)
"""Range of the height that the median segment stands for; children are in it [m]."""


def size_doubt(mesh: RiggedMesh, whose: str = "the body's") -> str:
    """Return a message if a body's segments are not a person's, with the likely scale; empty if they may be.

    Args:
        mesh: the body's mesh; only the built-in bodies are judged.
        whose: the person in the possessive, for the message.
    """
    if mesh.name not in SEXES:
        return ""
    shape = body_shape(cast(Sex, SEXES[mesh.name]))
    known = proportions_of({name: mark.point for name, mark in mesh.landmarks.items()}).known
    lengths = {name: known[name] for name in JUDGED if name in known}
    if not lengths:
        return ""
    heights = {name: length / getattr(shape.lengths, name) for name, length in lengths.items()}
    height = float(np.median(list(heights.values())))
    worst = max(heights, key=lambda name: abs(np.log(heights[name] / shape.height_m)))
    if heights[worst] <= TALLEST_M and HEIGHTS_M[0] <= height <= HEIGHTS_M[1]:
        return ""
    usual = shape.height_m * getattr(shape.lengths, worst)
    return (
        f"{whose} {worst.replace('_', ' ')} is {lengths[worst]:.2f} m, the average {usual:.2f} m: the rig's lengths "
        f"may be {height / shape.height_m:.2f} times the true ones, or the start's joints are wrong; check the size of "
        "the calibration board, or start with --set height=METRES"
    )
