"""Long computations in steps: a generator yields after each short piece of work, and returns the result.

The owner of such a generator decides when the next piece is due, such as one with each frame. The pieces are the same
in every run, so results do not depend on the time that they take.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

Result = TypeVar("Result")
Steps = Generator[None, None, Result]
"""A computation in steps."""


def result_of(steps: Steps[Result]) -> Result:
    """Run all steps of a computation, and return its result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result
