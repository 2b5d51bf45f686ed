"""Bodies that jump: a sensor's last frames of somebody who disappears behind somebody else.

While people walk, the middle of a body moves by at most 11 cm from one frame of a Kinect to the next (99.9 % of the
KinectMultiTrack logs' Walk). Just before it loses somebody, it reports under the same id a body that is thrown about by
decimetres to metres a frame. Such a body is nobody, and must not tell where the person went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import distances
from mocapella.settings import check

Float64 = NDArray[np.float64]
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


class SeenBody(msgspec.Struct, frozen=True, eq=False):
    """Where a sensor last saw a body that did not jump.

    Attributes:
        at_s: when.
        middle: (middle joints, 3) in its own camera space [m].
        jumped: whether the body has jumped since.
    """

    at_s: float
    middle: Float64
    jumped: bool = False


class Jumps:
    """Which bodies cannot be where their sensor reports them. The same frames in the same order give the same answers.

    Attributes:
        seen: by sensor and tracking id.
    """

    def __init__(self, settings: JumpSettings | None = None) -> None:
        self.settings = settings or JumpSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self.seen: dict[str, dict[int, SeenBody]] = {}

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
        s = self.settings
        # Either way, for a sensor's clock may jump.
        before = {body: seen for body, seen in self.seen.get(sensor, {}).items() if abs(at_s - seen.at_s) <= s.doubt_s}
        there = np.ones(len(ids), dtype=np.bool_)
        placed = np.isfinite(middles).all(axis=-1).any(axis=-1)
        known = placed & np.array([body in before for body in ids], dtype=np.bool_)
        if known.any():
            longest = [s.longest_step_s if seen.jumped else s.doubt_s for seen in before.values()]
            steps_s = np.minimum([abs(at_s - seen.at_s) for seen in before.values()], longest)
            apart = distances(middles[known], np.stack([seen.middle for seen in before.values()]))
            there[known] = (apart <= s.step_m + s.fastest_m_s * steps_s).any(axis=1)
        now = {
            body: SeenBody(at_s, middle) for body, middle, ok in zip(ids, middles, there & placed, strict=True) if ok
        }
        away = {
            body: msgspec.structs.replace(before[body], jumped=True)
            for body, ok in zip(ids, there, strict=True)
            if not ok
        }
        self.seen[sensor] = before | now | away
        return there
