"""Corrupt images as in the experiments of the region-based trackers: noise, rectangles, wrong frames.

    worse = Corruption(noise=0.15, rectangles=5, seed=2)
    image = worse.of(image, frame=17, camera=0)

Noise replaces 15 % of the pixels by random ones, and some frames are stored wrong: B. Rosenhahn, T. Brox, H.-P. Seidel,
"Scaled Motion Dynamics for Markerless Motion Capture", CVPR 2007; B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel,
"Online Smoothing for Markerless Motion Capture", DAGM 2007. The corruption depends on seed, camera and frame only, not
on the order of the images.
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
"""Kinds of wrong frames: random pixels; black; smooth random colours; the image itself, shifted and mirrored."""


@dataclass(frozen=True)
class Corruption:
    """The corruption of an image sequence, to test trackers: `of` applies it to an image.

    A wrong frame is replaced as a whole by another image, see `WRONG`.

    Attributes:
        noise: fraction of the pixels that are replaced by random values, 0 to 1.
        rectangles: number of rectangles per image, with random positions, sizes, colours and textures.
        rectangle_share: greatest width and height of a rectangle, relative to the image's longer side.
        wrong: probability that a frame is wrong in all cameras at once.
        wrong_frames: indices of frames that are always wrong, in all cameras.
        wrong_each: probability that a frame is wrong, for each camera independently.
        wrong_from: index of the first frame that may be wrong by these probabilities.
        wrong_kind: one of `WRONG`; None for a random one.
        blocks: quantisation of the frequencies of blocks of 8 × 8 pixels, as of compressed video; 0 for none, 10 is
            weak and 60 strong [grey levels].
        seed: random seed of all choices.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    noise: float = 0.0
    rectangles: int = 0
    rectangle_share: float = 0.25
    wrong: float = 0.0
    wrong_frames: tuple[int, ...] = ()
    wrong_each: float = 0.0
    wrong_from: int = 0
    wrong_kind: str | None = None
    blocks: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check(0 <= self.noise <= 1, "noise", self.noise, "from 0 to 1")
        check(0 <= self.rectangles <= 1000, "rectangles", self.rectangles, "from 0 to 1000")
        check(0.01 <= self.rectangle_share <= 1, "rectangle_share", self.rectangle_share, "from 0.01 to 1")
        check(0 <= self.wrong <= 1, "wrong", self.wrong, "from 0 to 1")
        check(0 <= self.wrong_each <= 1, "wrong_each", self.wrong_each, "from 0 to 1")
        check(self.wrong_from >= 0, "wrong_from", self.wrong_from, "0 or more")
        check(all(k >= 0 for k in self.wrong_frames), "wrong_frames", self.wrong_frames, "0 or more")
        check(0 <= self.blocks <= 255, "blocks", self.blocks, "0 to 255")
        check(self.seed >= 0, "seed", self.seed, "0 or more")
        if self.wrong_kind is not None and self.wrong_kind not in WRONG:
            raise SettingsError(f"unknown wrong_kind {self.wrong_kind!r}; known: {one_of(self.wrong_kind, WRONG)}")

    def is_wrong(self, frame: int, camera: int | None = None) -> bool:
        """Return whether a frame is replaced by a wrong one.

        Args:
            frame: index of the frame.
            camera: index of a camera, to include its own wrong frames; None for frames that are wrong in all cameras.
        """
        if frame in self.wrong_frames or (frame >= self.wrong_from and self._by_chance(self.wrong, 1, frame)):
            return True
        return camera is not None and frame >= self.wrong_from and self._by_chance(self.wrong_each, 3, frame, camera)

    def _by_chance(self, share: float, *of: int) -> bool:
        return share > 0 and bool(np.random.default_rng([self.seed, *of]).random() < share)

    def of(self, image: UInt8, frame: int, camera: int = 0) -> UInt8:
        """Return a corrupted copy of an image (height, width, 3) uint8, with the channels' order kept.

        Args:
            image: the image; not changed.
            frame, camera: indices of the image's frame and camera, which determine the random numbers.
        """
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
        return out if self.blocks == 0 else _in_blocks(out, self.blocks)


def _in_blocks(image: UInt8, levels: float) -> UInt8:
    """Quantise the discrete cosine transforms of blocks of 8 × 8 pixels (G. Wallace, "The JPEG still picture
    compression standard", 1991): the mean by an eighth of ``levels``, higher frequencies by more.
    """
    from scipy.fft import dctn, idctn

    height, width = image.shape[:2]
    padded = np.pad(image.astype(np.float64), ((0, -height % 8), (0, -width % 8), (0, 0)), mode="edge")
    rows, columns = padded.shape[0] // 8, padded.shape[1] // 8
    blocks = padded.reshape(rows, 8, columns, 8, -1)
    order = np.add.outer(np.arange(8), np.arange(8))[:, None, :, None]
    by = levels * (1.0 + order) / 8.0
    waves = dctn(blocks, axes=(1, 3), norm="ortho") / 8.0
    coarse = idctn(8.0 * by * np.round(waves / by), axes=(1, 3), norm="ortho").reshape(padded.shape)
    return np.asarray(np.clip(np.round(coarse), 0, 255)[:height, :width], np.uint8)


def _texture(size: tuple[int, ...], rng: np.random.Generator) -> UInt8:
    """Random texture (rows, columns, 3): one colour, stripes, or noise."""
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
