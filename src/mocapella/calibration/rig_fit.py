"""Check whether a rig still fits its cameras' images: detect exchanged cameras and moved ones.

Two cameras that see the same point determine one number that does not depend on the point's position: the distance of
their rays (Hartley, Zisserman: Multiple View Geometry, 2nd ed. 2004, section 9.6). Here it is measured in pixels, from
both observations to the projections of the best point. The pixels of the camera that came last are interpolated to the
time of the other's frame. Its mean square is kept for each pair of cameras, both as calibrated and with the two
cameras exchanged. Exchanged cameras that face each other see the scene mirrored in depth, which fits nearly as well if
only a small part of the image is used, so several points and instants are combined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.triangulation import EVERY_CAMERA, Views, triangulate, views
from mocapella.model.camera import CameraRig
from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class RigFitSettings:
    """When a rig is reported as not fitting.

    Attributes:
        memory_s: time constant of the mean square distance of each pair of cameras; larger: fewer false alarms, later
            ones [s].
        every_s: interval at which each pair of cameras is compared; larger: less work, later results [s].
        least_points: least number of compared markers in memory before a pair of cameras is judged; larger: fewer false
            alarms, later ones [markers].
        longest_gap_s: largest gap between a camera's frames across which its pixels are interpolated [s].
        largest_px: largest root mean square distance of the pixels from a rig that fits; beyond it, the rig is reported
            [px].
        swapped_ratio: two cameras are reported as exchanged, rather than as moved, if exchanging them reduces the
            distance by this factor [ratio].
        cap_px: upper bound of one marker's distance; larger: a single wrong marker weighs more [px].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    memory_s: float = 3.0
    every_s: float = 0.05
    least_points: float = 40.0
    longest_gap_s: float = 0.1
    largest_px: float = 3.0
    swapped_ratio: float = 2.0
    cap_px: float = 30.0

    def __post_init__(self) -> None:
        for name in ("memory_s", "least_points", "longest_gap_s", "largest_px", "cap_px"):
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "above 0")
        check(0 <= self.every_s < 1e6, "every_s", self.every_s, "0 s or more")
        check(1 <= self.swapped_ratio < 1e6, "swapped_ratio", self.swapped_ratio, "1 or more")


class RigFit:
    """Monitors the cameras of one rig; `problem` describes errors.

    Args:
        rig: the calibrated cameras; its lenses and poses are copied.
        points: number of markers in each frame.
        settings: when the rig is reported as not fitting.

    The state is the two newest frames of each camera, and for each pair the number of points, the sums of their squared
    distances as calibrated and with the two cameras exchanged [px²], and the time of the last comparison.
    """

    def __init__(self, rig: CameraRig, points: int, settings: RigFitSettings | None = None) -> None:
        self.settings = settings or RigFitSettings()
        self._order = list(rig.cameras)
        self._pairs = list(combinations(range(len(self._order)), 2))
        placed = list(rig.cameras.values())
        self._row_s = [c.camera.readout_s / max(c.camera.size_px[1] - 1, 1) for c in placed]
        lenses, places = [c.camera.lens for c in placed], [c.T_camera_world for c in placed]
        self._views: list[Views] = [views([lenses[i], lenses[j]], [places[i], places[j]]) for i, j in self._pairs]
        self._points = points
        self.reset()

    def reset(self) -> None:
        """Forget all frames and statistics; the rig stays."""
        cameras = len(self._order)
        self._times = np.full((cameras, 2), -np.inf)
        self._pixels = np.full((cameras, 2, self._points, 2), np.nan)
        self._sums, self._looked_s = np.zeros((len(self._pairs), 3)), np.full(len(self._pairs), -np.inf)

    def update(self, camera: str, pixels: Any, at_s: float) -> None:
        """Update the statistics with a camera's frame; one that is not newer than the camera's last is ignored.

        Args:
            camera: its name in the rig.
            pixels: (points, 2) pixels of the markers, the same ones in every camera [px]; NaN where a marker is not
                seen.
            at_s: capture time of its first row, on the common clock [s].
        """
        k, s = self._order.index(camera), self.settings
        if not at_s > self._times[k, 1]:
            return
        self._times[k] = self._times[k, 1], at_s
        self._pixels[k] = self._pixels[k, 1], pixels
        if at_s - self._times[k, 0] > s.longest_gap_s:
            return
        for n, (i, j) in enumerate(self._pairs):
            if k not in (i, j):
                continue
            other_s = self._times[j if k == i else i, 1]
            if self._times[k, 0] <= other_s <= at_s and other_s - self._looked_s[n] >= s.every_s:
                self._look(n, k, j if k == i else i)

    def _look(self, pair: int, newer: int, older: int) -> None:
        s, at_s = self.settings, self._times[older, 1]
        self._sums[pair] *= math.exp(-max(0.0, at_s - self._looked_s[pair]) / s.memory_s)
        self._looked_s[pair] = at_s
        there = self._pixels[older, 1]
        first, last = self._pixels[newer]
        captured_s = at_s + self._row_s[older] * there[:, 1]
        first_s = self._times[newer, 0] + self._row_s[newer] * first[:, 1]
        last_s = self._times[newer, 1] + self._row_s[newer] * last[:, 1]
        part = ((captured_s - first_s) / (last_s - first_s))[:, None]
        here = first + part * (last - first)
        i, j = (here, there) if newer < older else (there, here)
        seen = np.isfinite(i + j).all(axis=1)
        if not seen.any():
            return
        both = np.stack([i, j], axis=1)[seen]
        self._sums[pair] += len(both), self._squares(pair, both), self._squares(pair, both[:, ::-1])

    def _squares(self, pair: int, pixels: Float64) -> float:
        residuals = triangulate(pixels, self._views[pair], settings=EVERY_CAMERA).residuals_px
        squares = np.square(residuals).mean(axis=1)
        return float(np.minimum(np.nan_to_num(squares, nan=np.inf), self.settings.cap_px**2).sum())

    def rms_px(self, exchanged: bool = False) -> Float64:
        """Return the root mean square distance of pixels from the epipolar geometry of each pair of cameras.

        The pairs are in the order of ``itertools.combinations`` over the rig's cameras.

        Args:
            exchanged: whether to return it for the pair's cameras exchanged, instead of as calibrated.

        Returns:
            (pairs,) [px]; NaN with too few observations.
        """
        sums = np.where(self._sums[:, :1] >= self.settings.least_points, self._sums, np.nan)
        rms: Float64 = np.sqrt(sums[:, 1 + exchanged] / sums[:, 0])
        return rms

    @property
    def problem(self) -> str:
        """The errors and their remedies; empty if none is known."""
        s, problems = self.settings, list[str]()
        for (i, j), now, exchanged in zip(self._pairs, self.rms_px(), self.rms_px(exchanged=True), strict=True):
            if not now > s.largest_px:
                continue
            one, other = self._order[i], self._order[j]
            if exchanged * s.swapped_ratio < now:
                problems.append(
                    f"{one} and {other} seem to be swapped (off by {now:.1f} px, exchanged by {exchanged:.1f}): "
                    "give each the other's name, or exchange them"
                )
            else:
                problems.append(
                    f"{one} and {other} do not fit the rig (off by {now:.1f} px): one was moved, or its picture is "
                    "mirrored or cropped; calibrate anew"
                )
        return "; ".join(problems)
