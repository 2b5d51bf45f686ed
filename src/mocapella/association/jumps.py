"""Bodies that jump: a sensor's last frames of somebody who disappears behind somebody else.

While people walk, the middle of a body moves by centimetres from one frame of a sensor to the next. Just before it
loses somebody, it reports under the same id a body that is thrown about by decimetres to metres a frame. Such a body is
nobody, and must not tell where the person went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt64 = NDArray[np.uint64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class JumpSettings:
    """When a body jumps.

    Attributes:
        step_m: nobody's middle is moved farther than this between two frames by the sensor's own error …
        fastest_m_s: … and, beyond that, by walking faster than this.
        longest_step_s: for a body that has jumped, walking counts for so long at most.
        doubt_s: a body that jumped and stays away is taken for somebody after so long.
    """

    step_m: float = 0.05
    fastest_m_s: float = 3.0
    longest_step_s: float = 0.1
    doubt_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("step_m", "fastest_m_s", "longest_step_s", "doubt_s"):
            check(0 <= getattr(self, name) < 1e6, name, getattr(self, name), "0 or more")


class JumpLimits(NamedTuple):
    """The fields of `JumpSettings`, for the kernels."""

    step_m: float
    fastest_m_s: float
    longest_step_s: float
    doubt_s: float


class KnownBodies(NamedTuple):
    """The arrays of `SeenBodies`, for the kernels."""

    ids: UInt64
    at_s: Float64
    middle: Float64
    jumped: Bools


class SeenBodies(msgspec.Struct, frozen=True, eq=False):
    """Where a sensor last saw bodies that did not jump.

    Attributes:
        ids: (bodies,) tracking ids.
        at_s: (bodies,) when; −inf for a body whose middle was never seen.
        middle: (bodies, middle joints, 3) in its own camera space [m].
        jumped: (bodies,) whether the body has jumped since.
    """

    ids: UInt64
    at_s: Float64
    middle: Float64
    jumped: Bools

    @classmethod
    def new(cls, ids: UInt64, joints: int) -> SeenBodies:
        """Bodies that were never seen."""
        n = len(ids)
        return cls(ids, np.full(n, -np.inf), np.full((n, joints, 3), np.nan), np.zeros(n, dtype=np.bool_))

    @property
    def arrays(self) -> KnownBodies:
        """The fields, for the kernels."""
        return KnownBodies(self.ids, self.at_s, self.middle, self.jumped)

    def with_these(self, ids: UInt64, kept: Bools) -> SeenBodies:
        """The ``kept`` ones, and those of ``ids`` that are not among them."""
        new = SeenBodies.new(ids[~np.isin(ids, self.ids[kept])], self.middle.shape[1])
        parts = ((getattr(self, name)[kept], getattr(new, name)) for name in self.__struct_fields__)
        return SeenBodies(*(np.concatenate(pair) for pair in parts))


class Jumps:
    """Which bodies cannot be where their sensor reports them. The same frames in the same order give the same answers.

    Attributes:
        seen: by sensor.
    """

    def __init__(self, settings: JumpSettings | None = None) -> None:
        self.settings = settings or JumpSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self.seen: dict[str, SeenBodies] = {}

    def update(self, sensor: str, ids: Sequence[int], middles: Float64, at_s: float) -> Bools:
        """Whether each body is where its sensor saw it, or another one (it may swap ids), just before.

        Args:
            sensor: whose frame it is.
            ids: (bodies,) its tracking ids.
            middles: (bodies, middle joints, 3), the sensor's own camera space [m]; NaN where not seen.
            at_s: when it was captured.

        Returns:
            (bodies,) false for a body that jumped; true for one that is new.
        """
        s, numbers, there = self.settings, np.array(ids, dtype=np.uint64), np.empty(len(ids), dtype=np.bool_)
        seen = self.seen.get(sensor)
        if seen is None:
            seen = self.seen[sensor] = SeenBodies.new(numbers, middles.shape[1])
        middles = np.ascontiguousarray(middles)
        limits = JumpLimits(*map(float, (s.step_m, s.fastest_m_s, s.longest_step_s, s.doubt_s)))
        changed = _kernels().stay(at_s, numbers, middles, limits, seen.arrays, there)
        if changed:  # Times may go back, for a sensor's clock may jump.
            seen = self.seen[sensor] = seen.with_these(numbers, np.abs(at_s - seen.at_s) <= s.doubt_s)
        _kernels().follow(at_s, numbers, middles, there, seen.arrays)
        return there


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.association import track_kernels

    return track_kernels
