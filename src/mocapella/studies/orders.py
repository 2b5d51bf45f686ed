"""Orders of conditions for each participant: fixed, counterbalanced, or random by a seed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Literal, TypeVar

T = TypeVar("T")
Order = Literal["fixed", "counterbalanced", "random"]


def balanced_square(conditions: int) -> tuple[tuple[int, ...], ...]:
    """Return the rows of a balanced Latin square of ``conditions`` numbers from 0: each row is one participant's order.

    Each number is in each row once, equally often at each place, and each number directly follows each other one
    equally often. An even number of conditions needs as many rows; an odd one needs twice as many, where the second
    half is the first with each row reversed.

    Source:
        E. J. Williams, "Experimental designs balanced for the estimation of residual effects of treatments",
        Australian Journal of Scientific Research A 2 (1949) 149–168.
    """
    first = [(place + 1) // 2 if place % 2 else (conditions - place // 2) % conditions for place in range(conditions)]
    rows = [tuple((number + row) % conditions for number in first) for row in range(conditions)]
    if conditions % 2:
        rows += [row[::-1] for row in rows]
    return tuple(rows)


def square_rows(participant: int, placements: int, tasks: int) -> tuple[int, int]:
    """Return the rows of the placements' and of the tasks' square for one participant.

    Over each run of as many participants as both squares' rows have in common (least common multiple), either square is
    used evenly; over the product of their numbers of rows, each row of one meets each row of the other once.

    Args:
        participant: the participant's place in the study's list, from 0.
        placements, tasks: the numbers of rows of the two squares, at least 1.
    """
    return participant % placements, (participant + participant // math.lcm(placements, tasks)) % tasks


def ordered(items: Sequence[T], order: Order, *, row: int, seed: str) -> tuple[T, ...]:
    """Return the items in the order of one participant.

    Args:
        items: the conditions, in the protocol's order.
        order: ``fixed`` keeps their order, ``counterbalanced`` takes a row of `balanced_square`, ``random`` a
            permutation that depends on ``seed`` and the number of items only.
        row: row of the square; rows beyond the last begin again.
        seed: text that determines the random order.
    """
    if order == "counterbalanced" and items:
        square = balanced_square(len(items))
        return tuple(items[number] for number in square[row % len(square)])
    if order == "random":
        keys = [hashlib.sha256(f"{seed}/{place}".encode()).digest() for place in range(len(items))]
        return tuple(items[place] for place in sorted(range(len(items)), key=keys.__getitem__))
    return tuple(items)
