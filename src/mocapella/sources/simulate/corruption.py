"""Pictures made worse, as in the experiments of the region-based trackers: noise, rectangles, frames that are wrong.

    worse = Corruption(noise=0.15, rectangles=5, seed=2)
    image = worse.of(image, frame=17, camera=0)

15 % of the pixels replaced by random ones, and frames that are stored wrong: B. Rosenhahn, T. Brox, H.-P. Seidel,
"Scaled Motion Dynamics for Markerless Motion Capture", CVPR 2007; B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel,
"Online Smoothing for Markerless Motion Capture", DAGM 2007. What is wrong follows from the seed, the camera and the
frame alone, in whatever order pictures come.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.settings import check

UInt8 = NDArray[np.uint8]

WRONG: Final = ("garbage", "black", "rubbish", "shifted")
"""What a wrong frame is: random pixels; nothing; smooth colours of nothing; the picture itself, torn and mirrored."""


@dataclass(frozen=True)
class Corruption:
    """What is wrong with a sequence of pictures.

    Attributes:
        noise: share of the pixels that are replaced by random values.
        rectangles: how many in a picture, of random places, sizes, colours and textures.
        rectangle_share: a rectangle's longest side, of the picture's.
        wrong: share of the frames that are something else altogether, by chance, in all cameras at once.
        wrong_frames: frames that are so in any case, in all cameras.
        wrong_each: share of a camera's frames that are so, by chance, whatever those of the other cameras are.
        wrong_from: no frame before this one is so by chance.
        wrong_kind: one of `WRONG`; None: one of them by chance.
        seed: of it all.
    """

    noise: float = 0.0
    rectangles: int = 0
    rectangle_share: float = 0.25
    wrong: float = 0.0
    wrong_frames: tuple[int, ...] = ()
    wrong_each: float = 0.0
    wrong_from: int = 0
    wrong_kind: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check(0 <= self.noise <= 1, "noise", self.noise, "from 0 to 1")
        check(0 <= self.rectangles <= 1000, "rectangles", self.rectangles, "from 0 to 1000")
        check(0.01 <= self.rectangle_share <= 1, "rectangle_share", self.rectangle_share, "from 0.01 to 1")
        check(0 <= self.wrong <= 1, "wrong", self.wrong, "from 0 to 1")
        check(0 <= self.wrong_each <= 1, "wrong_each", self.wrong_each, "from 0 to 1")
        check(self.wrong_from >= 0, "wrong_from", self.wrong_from, "0 or more")
        check(all(k >= 0 for k in self.wrong_frames), "wrong_frames", self.wrong_frames, "0 or more")
        check(self.seed >= 0, "seed", self.seed, "0 or more")
        if self.wrong_kind is not None and self.wrong_kind not in WRONG:
            raise SettingsError(f"unknown wrong_kind {self.wrong_kind!r}; known: {one_of(self.wrong_kind, WRONG)}")

    def is_wrong(self, frame: int, camera: int | None = None) -> bool:
        """Whether a frame is something else altogether, in a camera, or in all of them at once."""
        if frame in self.wrong_frames or (frame >= self.wrong_from and self._by_chance(self.wrong, 1, frame)):
            return True
        return camera is not None and frame >= self.wrong_from and self._by_chance(self.wrong_each, 3, frame, camera)

    def _by_chance(self, share: float, *of: int) -> bool:
        return share > 0 and bool(np.random.default_rng([self.seed, *of]).random() < share)

    def of(self, image: UInt8, frame: int, camera: int = 0) -> UInt8:
        """What is stored instead of a picture, (height, width, 3); the picture itself stays as it is."""
        rng = np.random.default_rng([self.seed, 2, frame, camera])
        out = image.copy()
        if self.is_wrong(frame, camera):
            return _instead(out, self.wrong_kind or WRONG[rng.integers(len(WRONG))], rng)
        height, width = image.shape[:2]
        for _ in range(self.rectangles):
            w, h = np.maximum(rng.uniform(0.15, 1.0, 2) * self.rectangle_share * max(image.shape[:2]), 2).astype(int)
            x, y = rng.integers(-w // 2, width - w // 2), rng.integers(-h // 2, height - h // 2)
            part = out[max(y, 0) : y + h, max(x, 0) : x + w]
            part[:] = _texture(part.shape[:2], rng)
        if self.noise > 0:
            hit = rng.random((height, width)) < self.noise
            out[hit] = rng.integers(0, 256, (int(hit.sum()), 3), dtype=np.uint8)
        return out


def _texture(size: tuple[int, ...], rng: np.random.Generator) -> UInt8:
    """(rows, columns, 3): one colour, stripes, or noise."""
    one, other = rng.integers(0, 256, (2, 3), dtype=np.uint8)
    rows, columns = np.indices(size)
    kind = rng.integers(3)
    if kind == 0:
        return np.broadcast_to(one, (*size, 3)).astype(np.uint8)
    if kind == 1:
        first = ((rng.integers(-3, 4) * rows + rng.integers(1, 4) * columns) // rng.integers(4, 16)) % 2 == 0
        return np.asarray(np.where(first[..., None], one, other), np.uint8)
    return np.asarray(rng.integers(0, 256, (*size, 3), dtype=np.uint8))


def _instead(image: UInt8, kind: str, rng: np.random.Generator) -> UInt8:
    height, width = image.shape[:2]
    if kind == "garbage":
        return np.asarray(rng.integers(0, 256, image.shape, dtype=np.uint8))
    if kind == "black":
        return np.zeros_like(image)
    if kind == "shifted":
        return np.ascontiguousarray(np.roll(image[:, ::-1], (height // 3, width // 2), axis=(0, 1)))
    from scipy.ndimage import zoom

    coarse = rng.uniform(0, 255, (6, 8, 3))
    smooth = zoom(coarse, (height / 6, width / 8, 1), order=1)
    return np.asarray(smooth[:height, :width], np.uint8)
