"""By how much what moves is seen later in one camera's pictures than in the others': what network cameras do not tell.

Their pictures have no time but that at which they came, and that is late by what the camera and the network took. But
whoever moves before several cameras moves in all of them at once, and stops in all of them at once. So it is asked how
much changes from picture to picture, a course over time of each camera, and by which shift two such courses are most
alike: the largest normalised cross-correlation (C. H. Knapp and G. C. Carter, "The generalized correlation method
for estimation of time delay", IEEE Trans. ASSP 24, 1976, without weights). What goes on evenly, or again and again, has
no such shift, or several, and is left open.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

LONGEST_S: Final = 0.6
"""Of a lag that is looked for."""
OVER_S: Final = 15.0
"""So much of the past is compared."""
LEAST_S: Final = 6.0
"""Of fewer seconds nothing is said."""
STEP_S: Final = 0.01
"""Courses are sampled so closely, and shifted by so much."""
SLOW_S: Final = 1.5
"""What changes more slowly than this does not count: light, and how much of somebody is in the picture."""
ALIKE: Final = 0.5
"""Correlation from which on two courses are of the same movement."""
RIVAL: Final = 0.9
"""Another shift whose correlation is so much of the best one's leaves it open which it is."""
AGREE_S: Final = 0.03
"""So well all pairs of cameras have to agree."""
APART_S: Final = 0.1
"""Shifts that are nearer than this are the same."""
GAP_S: Final = 0.4
"""A camera that was silent for longer begins anew."""
_WIDE_PX: Final = 80
_NOISE: Final = 10
"""Grey levels that a pixel changes by itself."""


class MotionLags:
    """Remembers how much changed in the last pictures of each camera."""

    def __init__(self, cameras: Iterable[str]) -> None:
        self._last: dict[str, tuple[float, NDArray[np.int16]]] = {}
        self._courses: dict[str, deque[tuple[float, float]]] = {name: deque() for name in cameras}

    def add(self, camera: str, time_ns: int, image: UInt8) -> None:
        """A camera's next picture (height, width, 3), with its time."""
        at_s, step = time_ns / NS_PER_S, max(1, image.shape[1] // _WIDE_PX)
        small = image[::step, ::step, 1].astype(np.int16)
        before_s, before = self._last.get(camera, (at_s, small))
        self._last[camera] = at_s, small
        course = self._courses[camera]
        if at_s - before_s > GAP_S or before.shape != small.shape:
            course.clear()
        elif at_s > before_s:
            changed = float(np.maximum(np.abs(small - before) - _NOISE, 0).mean())
            course.append((0.5 * (at_s + before_s), changed / (at_s - before_s)))
            while course[-1][0] - course[0][0] > OVER_S:
                course.popleft()

    def measure(self) -> dict[str, float]:
        """By how much each camera is later than the earliest [s]; those of which it can be told, two at least."""
        names = list(self._courses)
        courses = {name: np.array(course) for name, course in self._courses.items()}
        shifts = {
            (one, other): shift
            for one, other in combinations(names, 2)
            if (shift := _shift(courses[one], courses[other])) is not None
        }
        return _late(shifts)


def _late(shifts: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """Later than the earliest [s], each by what agrees with all pairs; nothing where pairs contradict each other.

    Args:
        shifts: by how much the second is later than the first; pairs of which it is not known are missing. Of several
            groups without a pair between them the largest counts.
    """
    groups: list[set[str]] = []
    for pair in shifts:
        joined = set(pair).union(*(group for group in groups if group & set(pair)))
        groups = [group for group in groups if not group & joined] + [joined]
    group = sorted(max(groups, key=len)) if groups else []
    pairs = {pair: shift for pair, shift in shifts.items() if pair[0] in group}
    if not pairs:
        return {}
    A = np.array([[(name == later) - (name == earlier) for name in group] for earlier, later in pairs], np.float64)
    wanted = np.array(list(pairs.values()))
    found = np.linalg.lstsq(A, wanted)[0]
    if np.abs(A @ found - wanted).max() > AGREE_S:
        return {}
    return dict(zip(group, (found - found.min()).tolist(), strict=True))


def _shift(a: Float64, b: Float64) -> float | None:
    """By how much the course ``b`` (n, 2) [s, any unit] is later than ``a`` [s]; None where it cannot be told."""
    if min(len(a), len(b)) < 2:
        return None
    begin, end = max(a[0, 0], b[0, 0]), min(a[-1, 0], b[-1, 0])
    if end - begin < LEAST_S:
        return None
    grid = np.arange(begin, end, STEP_S)
    x, y = _quick(np.interp(grid, *a.T)), _quick(np.interp(grid, *b.T))
    most = round(LONGEST_S / STEP_S)
    found = np.array([_alike(x, y, lag) for lag in range(-most, most + 1)])
    best = int(np.argmax(found))
    far = np.abs(np.arange(len(found)) - best) * STEP_S > APART_S
    peaks = far[1:-1] & (found[1:-1] >= found[:-2]) & (found[1:-1] >= found[2:])
    rival = float(found[1:-1][peaks].max(initial=-1.0))
    if not found[best] >= ALIKE or rival > RIVAL * found[best] or best in (0, len(found) - 1):
        return None
    low, middle, high = found[best - 1 : best + 2]
    bend = low - 2 * middle + high
    return float((best - most + (0.5 * (low - high) / bend if bend < 0 else 0.0)) * STEP_S)


def _quick(course: Float64) -> Float64:
    """How fast it changes, evened out, without what is slow."""
    course = np.sqrt(course)
    wide = min(round(SLOW_S / STEP_S), len(course))
    ones = np.ones(wide)
    return np.asarray(course - np.convolve(course, ones, "same") / np.convolve(np.ones(len(course)), ones, "same"))


def _alike(x: Float64, y: Float64, lag: int) -> float:
    """Correlation of ``x`` with what is ``lag`` steps later in ``y``."""
    a, b = (x[: len(x) - lag], y[lag:]) if lag >= 0 else (x[-lag:], y[: len(y) + lag])
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
