"""Work that can be done a little at a time, so that an image does not wait for what takes longer than it may."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")
Steps = Generator[int, None, T]
"""Yields how much was done since it last did, in microseconds of a processor of today: told, not measured, so that the
same images always come to the same."""


def at_once(steps: Steps[T]) -> T:
    """Do all of it; what comes out."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
