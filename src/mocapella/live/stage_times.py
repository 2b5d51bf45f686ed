"""Measure the duration of each stage of a camera's node, and the jitter of markers at rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

STAGES: Final = ("retrieval", "rectification", "detection", "sending", "all")
"""Decoding an image; undistorting the points; detecting the markers; encoding and sending them; the sum of these."""


class StageTimes:
    """Collects stage times and marker positions of a given number of frames.

    Args:
        frames: number of frames to collect.
        markers: number of markers in each frame.

    Attributes:
        count: number of frames collected so far.
    """

    def __init__(self, frames: int, markers: int) -> None:
        self._seconds = np.full((frames, len(STAGES)), np.nan)
        self._px = np.full((frames, markers, 2), np.nan)
        self.count = 0

    @property
    def full(self) -> bool:
        """Whether the given number of frames has been collected."""
        return self.count >= len(self._seconds)

    def add(self, seconds: Mapping[str, float], positions_px: NDArray[Any]) -> None:
        """Add a frame; one that comes when `full`, or has another number of markers, is ignored.

        Args:
            seconds: duration of each measured stage [s], by name in `STAGES`.
            positions_px: (markers, 2) x, y in the image [px]; NaN where a marker is not seen.
        """
        if self.full or positions_px.shape != self._px.shape[1:]:
            return
        for k, stage in enumerate(STAGES):
            self._seconds[self.count, k] = seconds.get(stage, np.nan)
        self._px[self.count] = positions_px
        self.count += 1

    def table(self) -> dict[str, dict[str, float]]:
        """Return mean, median, sd, p99 and max [ms], and number of frames, by stage; unmeasured stages are left out."""
        out = {}
        for k, stage in enumerate(STAGES):
            ms = 1e3 * self._seconds[: self.count, k]
            ms = ms[np.isfinite(ms)]
            if len(ms):
                out[stage] = {
                    "mean_ms": float(ms.mean()),
                    "median_ms": float(np.median(ms)),
                    "sd_ms": float(ms.std()),
                    "p99_ms": float(np.percentile(ms, 99)),
                    "max_ms": float(ms.max()),
                    "frames": len(ms),
                }
        return out

    def jitter(self, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """Return each marker's standard deviation in x and y [px], and the number of frames in which it was seen.

        The standard deviation is NaN if a marker was seen less than twice. ``names`` has the markers in their order.

        For a scene at rest, this is the static jitter of the thesis' figure 7.7.
        """
        out = {}
        for k, name in enumerate(names):
            px = self._px[: self.count, k]
            px = px[np.isfinite(px).all(axis=-1)]
            sd = px.std(axis=0) if len(px) > 1 else (float("nan"), float("nan"))
            out[name] = {"x_px": float(sd[0]), "y_px": float(sd[1]), "seen": len(px)}
        return out
