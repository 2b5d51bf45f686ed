"""Notice steps of this machine's wall clock, to explain times in logs and file names. No measurement uses it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

STEP_NS: Final = 100_000_000
"""Smallest step that is noticed [ns]: NTP slews a clock up to an error of 128 ms, and steps it beyond."""
_TRIES: Final = 5


class WallClock:
    """Compares the wall clock with the monotonic one each time `step` is called, which is several times a second.

    Args:
        wall_ns: returns the Unix time [ns].
        monotonic_ns: returns the monotonic time [ns].
    """

    def __init__(
        self, *, wall_ns: Callable[[], int] = time.time_ns, monotonic_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._wall_ns, self._monotonic_ns = wall_ns, monotonic_ns
        self._offset_ns, _ = self._compare()

    def step(self) -> str:
        """Return a message about a step since the last call; empty without one."""
        offset_ns, width_ns = self._compare()
        step_ns = offset_ns - self._offset_ns
        if abs(step_ns) < STEP_NS + width_ns:
            # A clock that is slewed is followed, unless this thread was interrupted at each look at the clocks.
            self._offset_ns = offset_ns if width_ns < STEP_NS else self._offset_ns
            return ""
        self._offset_ns = offset_ns
        return f"the wall clock of this machine stepped by {step_ns / 1e9:+.1f} s; recorded times do not depend on it"

    def _compare(self) -> tuple[int, int]:
        """Return the wall clock minus the monotonic one, and by how much that may be too small [ns]."""
        looks = []
        for _ in range(_TRIES):
            before_ns, wall_ns, after_ns = self._monotonic_ns(), self._wall_ns(), self._monotonic_ns()
            looks.append((after_ns - before_ns, wall_ns - after_ns))
            if after_ns - before_ns < STEP_NS // 100:
                break
        width_ns, offset_ns = min(looks)
        return offset_ns, width_ns
