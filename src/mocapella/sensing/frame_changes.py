"""Detect where a static camera's image changes within a fraction of a second, above the camera's noise.

    changes = FrameChanges(step_px=2)
    density = changes.update(image, time_ns)      # None until there is an earlier image
    near_change(density, 2, pixels)

What does not change does not move, whatever a segmentation finds. Brightness that changes as a whole, as with exposure,
is compensated by its median ratio in each channel. The camera's noise is measured by brightness, as dark parts of coded
images are noisier than bright ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.model.memory import set_memory
from mocapella.sensing.image_samples import image_samples
from mocapella.settings import check

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

SPAN_S: Final = 0.3
"""Largest age of the compared image; older: slower motion is seen, and a part that comes to rest is still later [s]."""
LEAST_LEVELS: Final = 3.5
"""Least difference of a sample that has changed [grey levels]."""
BEYOND: Final = 6.0
"""A sample has changed if it differs by more than this many times the median difference of samples as bright."""
NOISY_LEVELS: Final = 3.0
"""In images whose median difference is larger, motion could be missed: nothing is known of them [grey levels]."""
BINS: Final = 8
"""Number of brightnesses whose noise is measured."""
FEWEST: Final = 30
"""Least number of samples that measure a brightness's noise; of fewer, that of the whole image counts."""
BLUR_STEPS: Final = 3
"""Width of the square over which a sample is averaged, against noise [samples]."""
NEAR_STEPS: Final = 4
"""Half width of the square over which changed samples are counted [samples]."""
_RATIOS: Final = (20, 235)
_EVERY: Final = 6
_MEMORY: Final = ("_older", "_newer", "_older_ns", "_newer_ns")


class FrameChanges:
    """Changes of one camera's image; its memory has two earlier images, at the distance of samples.

    Args:
        step_px: distance between samples, each the mean of a square of pixels as wide [px].

    Raises:
        SettingsError: ``step_px`` is below 1.
    """

    def __init__(self, step_px: int) -> None:
        check(step_px >= 1, "step_px", step_px, "1 or more")
        self.step_px = step_px
        self.reset()

    def reset(self) -> None:
        """Forget all images."""
        self._older = self._newer = np.empty((0, 0, 0), np.uint8)
        self._older_ns = self._newer_ns = 0

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall`; its arrays are shared, and never changed."""
        return {name: getattr(self, name) for name in _MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned, of the same step."""
        set_memory(self, memory)

    def update(self, image: UInt8, time_ns: int) -> Float32 | None:
        """Compare an image with one that is up to `SPAN_S` older; keep it.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            time_ns: capture time, on the common clock; not before that of the last image.

        Returns:
            (rows, columns) share of changed samples in the square about each sample, 0 to 1; None if there is no
            earlier image, or images are too noisy to tell.

        Raises:
            InputError: an image of another type or shape, or of another size than before.
        """
        import cv2

        if image.dtype != np.uint8 or image.ndim not in (2, 3):
            raise InputError(
                "an image is not uint8",
                field="type",
                value=f"{image.dtype} of shape {image.shape}",
                fix="make it uint8, (height, width) or (height, width, 3)",
            )
        samples = image_samples(image, self.step_px)
        rows, columns, _ = samples.shape
        now = np.asarray(cv2.blur(samples, (BLUR_STEPS, BLUR_STEPS)), np.uint8).reshape(rows, columns, -1)
        if not self._older.size:
            self._older, self._newer, self._older_ns, self._newer_ns = now, now, time_ns, time_ns
            return None
        if now.shape != self._older.shape:
            fix = f"send images of {self._older.shape[1]} × {self._older.shape[0]} samples"
            raise InputError("an image is of another size than the first", field="shape", value=now.shape, fix=fix)
        was = self._older
        if time_ns - self._newer_ns >= 0.5 * SPAN_S * NS_PER_S:
            self._older, self._older_ns = self._newer, self._newer_ns
            self._newer, self._newer_ns = now, time_ns
        channels: list[UInt8] = [np.ascontiguousarray(now[..., channel]) for channel in range(now.shape[2])]
        differs: list[UInt8] = [
            np.asarray(cv2.absdiff(of, _as_bright(was[..., channel], of)), np.uint8)
            for channel, of in enumerate(channels)
        ]
        most = _most(channels, differs)
        if most is None:
            return None
        changed = np.zeros(now.shape[:2], np.bool_)
        for of, by in zip(channels, differs, strict=True):
            changed |= by > most[of]
        wide = 2 * NEAR_STEPS + 1
        density = cv2.boxFilter(changed.astype(np.float32), -1, (wide, wide), borderType=cv2.BORDER_CONSTANT)
        return np.asarray(density, np.float32)


def _most(values: Sequence[UInt8], differs: Sequence[UInt8]) -> UInt8 | None:
    """Return the largest difference of an unchanged sample by its brightness, (256,) [grey levels]; None: too noisy."""
    bright = np.concatenate([one[::_EVERY, ::_EVERY].ravel() for one in values])
    by = np.concatenate([one[::_EVERY, ::_EVERY].ravel() for one in differs])
    whole = float(np.median(by))
    if whole > NOISY_LEVELS:
        return None
    most, wide = np.empty(256, np.float64), 256 // BINS
    for number in range(BINS):
        some = by[bright // wide == number]
        most[number * wide : (number + 1) * wide] = np.median(some) if len(some) >= FEWEST else whole
    bound: UInt8 = np.ceil(np.clip(np.maximum(LEAST_LEVELS, BEYOND * most), 0, 255)).astype(np.uint8)
    return bound


def _as_bright(was: UInt8, now: UInt8) -> UInt8:
    """Return one channel of an earlier image (rows, columns), as bright as that of the present one."""
    import cv2

    before, after = was[::_EVERY, ::_EVERY], now[::_EVERY, ::_EVERY]
    fit = (before > _RATIOS[0]) & (before < _RATIOS[1])
    ratio = float(np.median(after[fit] / before[fit])) if fit.any() else 1.0
    scaled = cv2.convertScaleAbs(np.ascontiguousarray(was), alpha=ratio) if ratio != 1.0 else was
    return np.asarray(scaled, np.uint8)


def near_change(density: Float32, step_px: int, pixels: Float64) -> Float32:
    """Return the share of changed samples about pixels x, y (n, 2) of an image (n,); NaN for those outside of it.

    Args:
        density: (rows, columns), of `FrameChanges.update`.
        step_px: distance between its samples [px].
        pixels: (n, 2) [px].
    """
    column, row = np.floor((pixels + 0.5) / step_px).astype(np.int64).T
    inside = (row >= 0) & (row < density.shape[0]) & (column >= 0) & (column < density.shape[1])
    out = np.full(len(pixels), np.nan, np.float32)
    out[inside] = density[row[inside], column[inside]]
    return out
