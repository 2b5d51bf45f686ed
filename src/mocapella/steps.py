"""Divide long computations into steps, between which a caller can process the next image."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")
Steps = Generator[int, None, T]
"""A generator that yields the nominal cost of each step [µs of a present-day processor]: fixed, not measured, so that
equal images always give equal results."""


def at_once(steps: Steps[T]) -> T:
    """Run a divided computation to its end without pauses; return its result.

    Args:
        steps: generator that yields the nominal cost of each step [µs], and returns the result of the computation.
    """
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
