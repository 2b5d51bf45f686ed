"""Estimate the pose of a camera rig in the world of body sensors, from people that both see.

A body fitted to images is in the rig's frame, a person tracked by body sensors is in the world. If both are the same
person, one rigid motion maps the body's joints to the person's in all postures and positions:

    T_world_rig = argmin Σ |p_person − T p_body|        over the joints of several seconds (`robust_align`)

Two people who stand still are alike, so a pair counts only if both have moved, and only if it agrees much better than
the body does with any other person.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import robust_align
from mocapella.geometry.rigid import apply
from mocapella.settings import check

Float64 = NDArray[np.float64]

_SCALE_M: Final = 0.05
"""Typical difference of joints between the two kinds of measurement [m]."""
_FEWEST: Final = 4
"""Fewest joints of a sample, known in both the body and the person."""


@dataclass(frozen=True)
class RigInWorldSettings:
    """Requirements of an accepted pose of the rig.

    Attributes:
        every_s: interval between samples; larger: more motion between them, and a later estimate [s].
        samples: number of samples kept per pair of a body and a person, the newest ones; larger: more accurate, but
            slower after a change [samples].
        fewest: least number of samples for an estimate; larger: a later estimate [samples].
        moved_m: least extent of the motion of both body and person; larger: people must walk farther, and are confused
            more rarely [m].
        within_m: largest median distance between the joints of a body and a person who are the same [m].
        beyond: largest ratio of that distance to the body's distance from any other person; smaller: people are
            confused more rarely, and matched later [ratio].
        again_s: interval between estimates [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    every_s: float = 0.1
    samples: int = 80
    fewest: int = 20
    moved_m: float = 0.4
    within_m: float = 0.1
    beyond: float = 0.6
    again_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("every_s", "moved_m", "within_m", "again_s"):
            check(0 < getattr(self, name) <= 10, name, getattr(self, name), "above 0 and at most 10")
        check(2 <= self.fewest <= self.samples <= 10_000, "fewest", self.fewest, "from 2 to samples, up to 10000")
        check(0 < self.beyond <= 1, "beyond", self.beyond, "above 0 and at most 1")


class RigInWorld(msgspec.Struct, frozen=True, eq=False):
    """The estimated pose of the rig.

    Attributes:
        T_world_rig: (4, 4).
        residual_m: median distance of matching joints [m].
        pairs: person of each body, by the body's name.
    """

    T_world_rig: Float64
    residual_m: float
    pairs: dict[str, int]


class RigAlignment:
    """Estimates the rig's pose in the world from simultaneous bodies and people.

    Args:
        settings: requirements of an accepted pose; the defaults if None.

    Attributes:
        found: the estimate; None before there is one.
    """

    def __init__(self, settings: RigInWorldSettings | None = None) -> None:
        self.settings = settings or RigInWorldSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.found: RigInWorld | None = None
        self._samples: dict[tuple[str, int], deque[tuple[Float64, Float64]]] = {}
        self._taken_s = self._tried_s = -np.inf

    def memory(self) -> list[Any]:
        """Return all state, not copied, for `recall`."""
        return [self.found, self._samples, float(self._taken_s), float(self._tried_s)]

    def recall(self, memory: list[Any]) -> None:
        """Restore the state that `memory` returned, without a copy."""
        self.found, self._samples, self._taken_s, self._tried_s = memory

    def update(self, bodies: Mapping[str, Float64], people: Mapping[int, Float64], at_s: float) -> None:
        """Take a sample of the bodies and people at one time, and renew `found` if it is due.

        It also decides which person a body is. A call sooner than ``every_s`` after the last sample does nothing; an
        estimate stays until a better one replaces it. A time before that of the last sample resets everything, because
        the clock was set back.

        Args:
            bodies: (joints, 3) of each body by its name, in the rig's frame [m]; NaN where not known. Joints 2k and 2k
                + 1 are a pair of left and right.
            people: (joints, 3) of each person by id, in the world [m]; the same joints, NaN where not known. Left and
                right may be swapped.
            at_s: capture time of both, on the common clock [s].
        """
        s = self.settings
        if at_s < self._taken_s:
            self.reset()  # the clock was set back
        if at_s - self._taken_s < s.every_s:
            return
        self._taken_s = at_s
        self._samples = {pair: kept for pair, kept in self._samples.items() if pair[0] in bodies and pair[1] in people}
        for name, body in bodies.items():
            for person, joints in people.items():
                known = np.asarray(np.isfinite(body).all(axis=-1) & np.isfinite(joints).all(axis=-1))
                if np.count_nonzero(known) >= _FEWEST:
                    kept = self._samples.setdefault((name, person), deque(maxlen=s.samples))
                    kept.append((np.where(known[:, None], joints, np.nan), np.where(known[:, None], body, np.nan)))
        if at_s - self._tried_s >= s.again_s:
            self._tried_s = at_s
            self._estimate()

    def _estimate(self) -> None:
        """Match bodies with people, and estimate the one motion that aligns all of them."""
        s, agreeing = self.settings, dict[str, tuple[int, float]]()
        residuals: dict[str, dict[int, float]] = {}
        for (name, person), kept in self._samples.items():
            if len(kept) >= s.fewest and min(_moved(kept, 0), _moved(kept, 1)) >= s.moved_m:
                residuals.setdefault(name, {})[person] = _residual(*_joined([kept]))[1]
        for name, of in residuals.items():
            best, *others = sorted(of, key=lambda person: of[person])
            if of[best] <= s.within_m and all(of[best] <= s.beyond * of[other] for other in others):
                agreeing[name] = best, of[best]
        if len({person for person, _ in agreeing.values()}) < len(agreeing):  # two bodies cannot be one person
            return
        if agreeing:
            T, residual = _residual(*_joined([self._samples[name, person] for name, (person, _) in agreeing.items()]))
            if residual <= s.within_m:
                self.found = RigInWorld(T, residual, {name: person for name, (person, _) in agreeing.items()})


def _joined(samples: list[deque[tuple[Float64, Float64]]]) -> tuple[Float64, Float64]:
    """Stack samples: (n, joints, 3) of persons, and of bodies."""
    p, q = (np.stack([one[k] for kept in samples for one in kept]) for k in (0, 1))
    return p, q


def _residual(p: Float64, q: Float64) -> tuple[Float64, float]:
    """Return ``T_p_q``, and the median residual distance [m].

    Sensors swap left and right at times. So the midpoints of left and right joints are aligned first, then all joints,
    at each time with the labels that agree better.
    """
    T = _aligned(0.5 * (p[:, ::2] + p[:, 1::2]), 0.5 * (q[:, ::2] + q[:, 1::2]))
    swapped = np.stack([p[:, 1::2], p[:, ::2]], axis=2).reshape(p.shape)
    for _ in range(2):
        moved = apply(T, q)
        as_reported, other = (np.nanmean(np.linalg.norm(one - moved, axis=-1), axis=1) for one in (p, swapped))
        chosen = np.where((other < as_reported)[:, None, None], swapped, p)
        T = _aligned(chosen, q)
    return T, float(np.nanmedian(np.linalg.norm(chosen - apply(T, q), axis=-1)))


def _aligned(p: Float64, q: Float64) -> Float64:
    known = np.isfinite(p).all(axis=-1) & np.isfinite(q).all(axis=-1)
    return robust_align(p[known], q[known], scale=_SCALE_M, iterations=10)


def _moved(kept: deque[tuple[Float64, Float64]], which: int) -> float:
    """Return the extent of the samples' centres [m]."""
    middles = np.array([np.nanmean(one[which], axis=0) for one in kept])
    return float(np.linalg.norm(np.ptp(middles, axis=0)))


REMEMBERED: Final = (RigInWorld,)
"""Classes in the state of a `RigAlignment`, see `mocapella.model.memory`."""
