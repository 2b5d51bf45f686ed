"""How long each stage of a camera's node takes, and how still the markers of a hand at rest are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

STAGES: Final = ("retrieval", "rectification", "detection", "sending", "all")
"""Decoding a picture that has come; undistorting the points; finding them; encoding and sending; from a picture that
has come to its markers sent."""


class StageTimes:
    """Takes the times of so many frames, and the markers in them."""

    def __init__(self, frames: int, markers: int) -> None:
        self._seconds = np.full((frames, len(STAGES)), np.nan)
        self._px = np.full((frames, markers, 2), np.nan)
        self.count = 0

    @property
    def full(self) -> bool:
        """Whether there are as many as were wanted."""
        return self.count >= len(self._seconds)

    def add(self, seconds: Mapping[str, float], positions_px: NDArray[Any]) -> None:
        """A frame's stages [s], those that it had, and its markers (markers, 2), NaN where not seen."""
        if self.full or positions_px.shape != self._px.shape[1:]:
            return
        for k, stage in enumerate(STAGES):
            self._seconds[self.count, k] = seconds.get(stage, np.nan)
        self._px[self.count] = positions_px
        self.count += 1

    def table(self) -> dict[str, dict[str, float]]:
        """Of every stage that was there: mean, median, sd, p99 and max [ms], and of how many frames."""
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
        """Of every marker: standard deviation in x and y [px], and in how many frames it was seen.

        It is the static jitter of the thesis' figure 7.7 where nothing moves.
        """
        out = {}
        for k, name in enumerate(names):
            px = self._px[: self.count, k]
            px = px[np.isfinite(px).all(axis=-1)]
            sd = px.std(axis=0) if len(px) > 1 else (float("nan"), float("nan"))
            out[name] = {"x_px": float(sd[0]), "y_px": float(sd[1]), "seen": len(px)}
        return out
