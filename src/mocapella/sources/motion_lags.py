"""Estimate the relative latency of cameras from shared motion.

Images of network cameras have only their arrival times, which are late by the delays of the camera and the network.
A person who moves in front of several cameras moves in all of them at the same instant. So the amount of change from
image to image is recorded as a signal over time for each camera, and the shift between two cameras is the one with the
largest normalised cross-correlation (C. H. Knapp and G. C. Carter, "The generalized correlation method for estimation
of time delay", IEEE Trans. ASSP 24, 1976, without weights). Steady motion has no distinct maximum, and periodic motion
several; then no shift is returned.
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
"""Largest lag that is searched [s]."""
OVER_S: Final = 15.0
"""Length of the signals that are compared [s]."""
LEAST_S: Final = 6.0
"""Shortest overlap of two signals that gives an estimate [s]."""
STEP_S: Final = 0.01
"""Sampling interval of the signals, and step of the shift [s]."""
SLOW_S: Final = 1.5
"""Length of the moving average that is subtracted, so that slow changes, such as of the light, do not count [s]."""
ALIKE: Final = 0.5
"""Least correlation at which two signals are taken to show one motion."""
RIVAL: Final = 0.9
"""Share of the best correlation at which a second maximum makes the shift ambiguous."""
AGREE_S: Final = 0.03
"""Largest residual of a pair's shift, given all cameras' lags, at which the shifts are consistent [s]."""
APART_S: Final = 0.1
"""Distance from the best shift beyond which a second maximum is another one [s]."""
GAP_S: Final = 0.4
"""A longer gap between two images of a camera clears its signal [s]."""
_WIDE_PX: Final = 80
_NOISE: Final = 10
"""Change of a pixel that is attributed to noise and subtracted, in grey levels."""


class MotionLags:
    """Estimator of the cameras' lags, from the amount of change in each camera's images of the last `OVER_S` seconds.

    Args:
        cameras: names of the cameras.
    """

    def __init__(self, cameras: Iterable[str]) -> None:
        self._last: dict[str, tuple[float, NDArray[np.int16]]] = {}
        self._courses: dict[str, deque[tuple[float, float]]] = {name: deque() for name in cameras}

    def add(self, camera: str, time_ns: int, image: UInt8) -> None:
        """Add a camera's next image and its capture or arrival time.

        A gap of more than `GAP_S`, or another image size, clears the camera's record.

        Args:
            camera: name of the camera.
            time_ns: capture or arrival time, on one clock for all cameras [ns]; an image that is not newer than the
                last one adds nothing.
            image: (height, width, 3) uint8 BGR; only green is used. It is not kept.
        """
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
        """Estimate each camera's lag [s] behind the camera with the least latency, whose lag is 0.

        Cameras without an estimate are omitted. The result is empty without distinct shared motion, or if the shifts of
        pairs contradict each other.
        """
        names = list(self._courses)
        courses = {name: np.array(course) for name, course in self._courses.items()}
        shifts = {
            (one, other): shift
            for one, other in combinations(names, 2)
            if (shift := _shift(courses[one], courses[other])) is not None
        }
        return _late(shifts)


def _late(shifts: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """Solve for each camera's lag [s] from the shifts of pairs, by least squares; empty if the pairs contradict.

    Args:
        shifts: lag of the second camera behind the first [s]; unknown pairs are missing. Of several groups without a
            pair between them, the largest counts.
    """
    groups: list[set[str]] = []
    for pair in shifts:
        joined = set(pair).union(*(group for group in groups if group & set(pair)))
        groups = [group for group in groups if not group & joined] + [joined]
    largest: set[str] = max(groups, key=len, default=set())
    group = sorted(largest)
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
    """Lag [s] of the signal ``b`` behind ``a``, both (n, 2) times [s] and values; None if it is not distinct."""
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
    """Compress a signal by the square root, and subtract its moving average (high pass)."""
    course = np.sqrt(course)
    wide = min(round(SLOW_S / STEP_S), len(course))
    ones = np.ones(wide)
    return np.asarray(course - np.convolve(course, ones, "same") / np.convolve(np.ones(len(course)), ones, "same"))


def _alike(x: Float64, y: Float64, lag: int) -> float:
    """Correlation of ``x`` with ``y`` shifted by ``lag`` steps."""
    a, b = (x[: len(x) - lag], y[lag:]) if lag >= 0 else (x[-lag:], y[: len(y) + lag])
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
