"""Detect bodies that jump, as in a sensor's last frames of a person before an occlusion.

This is a gate on speed: a body is rejected as an outlier if no person could have moved there since a recent position of
the same sensor.

While people walk, the middle of a body moves by centimetres between frames. Just before a sensor loses a person, it
reports under the same id a body that moves by decimetres to metres per frame. Such a body is not a person, and must not
determine where the person went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.bodies import id_array
from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt64 = NDArray[np.uint64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class JumpSettings:
    """Thresholds of a jump.

    A body has jumped if its middle is farther than step_m + fastest_m_s · Δt from every position of the last doubt_s of
    any body of the same sensor, whatever its id; Δt is the time since that position.

    Attributes:
        step_m: distance that a body's middle may move at once, by the sensor's own error, without having jumped;
            larger: fewer bodies are rejected [m].
        fastest_m_s: highest speed of a person: a body has jumped if it moved farther than ``step_m`` plus this times
            the elapsed time; larger: fewer bodies are rejected [m/s].
        longest_step_s: upper bound of the elapsed time, from the last position of a body that has jumped since; larger:
            such a body is accepted again farther away [s].
        doubt_s: age at which a position is forgotten; a body whose last position is older is accepted wherever it is,
            so a body that jumped and stays away is accepted after this time [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    step_m: float = 0.05
    fastest_m_s: float = 3.0
    longest_step_s: float = 0.1
    doubt_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("step_m", "fastest_m_s", "longest_step_s", "doubt_s"):
            check(0 <= getattr(self, name) < 1e6, name, getattr(self, name), "0 or more")

    @cached_property
    def limits(self) -> JumpLimits:
        """The settings as floats, for the kernels."""
        return JumpLimits(*map(float, (self.step_m, self.fastest_m_s, self.longest_step_s, self.doubt_s)))


class JumpLimits(NamedTuple):
    """The fields of `JumpSettings`, with the same meaning, as floats [m], [m/s], [s], [s], for the kernels."""

    step_m: float
    fastest_m_s: float
    longest_step_s: float
    doubt_s: float


class KnownBodies(NamedTuple):
    """The arrays of `SeenBodies` themselves, not copies, as a named tuple for the kernels, which change them.

    Attributes:
        ids, at_s, middle, jumped: (bodies,) tracking ids, (bodies,) capture times [s], (bodies, middle joints, 3) last
            positions in camera space [m], and (bodies,) whether the body has jumped since.
    """

    ids: UInt64
    at_s: Float64
    middle: Float64
    jumped: Bools


class SeenBodies(msgspec.Struct, frozen=True, eq=False):
    """Each body's last position in one sensor before any jump. `Jumps.update` changes the arrays in place.

    Attributes:
        ids: (bodies,) tracking ids.
        at_s: (bodies,) capture times of the positions [s]; −inf for a body whose middle was never seen.
        middle: (bodies, middle joints, 3) joints on the body's middle line, in the sensor's camera space [m].
        jumped: (bodies,) whether the body has jumped since that time.
    """

    ids: UInt64
    at_s: Float64
    middle: Float64
    jumped: Bools

    @classmethod
    def new(cls, ids: UInt64, joints: int) -> SeenBodies:
        """Return bodies that were never seen, with these tracking ids (bodies,) and number of middle joints."""
        n = len(ids)
        return cls(ids, np.full(n, -np.inf), np.full((n, joints, 3), np.nan), np.zeros(n, dtype=np.bool_))

    @property
    def arrays(self) -> KnownBodies:
        """The same arrays, not copies, as a named tuple for the kernels."""
        return KnownBodies(self.ids, self.at_s, self.middle, self.jumped)

    def with_these(self, ids: UInt64, kept: Bools) -> SeenBodies:
        """Return a copy with the kept bodies, followed by never seen ones for all other ids of a frame.

        Args:
            ids: (bodies',) the frame's tracking ids.
            kept: (bodies,) whether each known body is kept.
        """
        new = SeenBodies.new(ids[~np.isin(ids, self.ids[kept])], self.middle.shape[1])
        parts = ((getattr(self, name)[kept], getattr(new, name)) for name in self.__struct_fields__)
        return SeenBodies(*(np.concatenate(pair) for pair in parts))


class Jumps:
    """Detects bodies that moved farther than people can, so that a tracker can leave them out.

    The same frames in the same order give the same results.

    Args:
        settings: thresholds; the defaults if None.

    Attributes:
        seen: last positions of each sensor's bodies, by the sensor's name.
    """

    def __init__(self, settings: JumpSettings | None = None) -> None:
        self.settings = settings or JumpSettings()
        self.reset()

    def reset(self) -> None:
        """Forget all bodies."""
        self.seen: dict[str, SeenBodies] = {}

    def update(self, sensor: str, ids: Sequence[int], middles: Float64, at_s: float) -> Bools:
        """Detect bodies that are too far from all recent positions of the sensor's bodies; store the others' positions.

        Args:
            sensor: name of the sensor; the first frame of a sensor has new bodies only.
            ids: (bodies,) tracking ids.
            middles: (bodies, middle joints, 3) joints on the body's middle line, in the sensor's camera space [m]; NaN
                where not seen.
            at_s: capture time [s]; it may be earlier than the last one.

        Returns:
            (bodies,) False for a body that jumped; True for one near a recent position, for a new body, for one without
            a recent position of its own (see ``doubt_s``), and for one without a visible middle joint.
        """
        numbers, there = id_array(ids), np.empty(len(ids), dtype=np.bool_)
        seen = self.seen.get(sensor)
        if seen is None:
            seen = self.seen[sensor] = SeenBodies.new(numbers, middles.shape[1])
        middles = np.ascontiguousarray(middles)
        changed = _kernels().stay_and_follow(at_s, numbers, middles, self.settings.limits, seen.arrays, there)
        if changed:  # Times may decrease, because a sensor's clock may be set.
            seen = self.seen[sensor] = seen.with_these(numbers, np.abs(at_s - seen.at_s) <= self.settings.doubt_s)
            _kernels().follow(at_s, numbers, middles, there, seen.arrays)
        return there


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.association import track_kernels

    return track_kernels
