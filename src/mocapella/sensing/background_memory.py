"""Learn a static camera's background from images with people in them: a running Gaussian for each sample.

Wherever no person is near, the image is background. It is learnt there, and used when a person comes later. So a clip
needs no images of the empty room, only people who move. Where people were in every image, the
local densities of `region_contour` are used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.model.memory import set_memory
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.region_contour import Band, RegionSettings
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.sensing.background_memory_kernels import BackgroundSamples, ForegroundBounds, PersonWindow

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class MemorySettings:
    """Parameters of learning and applying a background.

    Attributes:
        guard_steps: samples nearer than this to a person are not learnt; larger: people are learnt as background more
            rarely, and less of the room is known [samples].
        rate: weight of a new image, after the first 1/rate images; larger: changes of the room are learnt sooner, also
            people who stand still [0 to 1].
        least_sd: least standard deviation of a sample; larger: weaker changes are ignored [grey levels].
        window_images: number of images within which all samples near the person are updated once; larger: less work,
            slower learning [images].
        sweep_images: number of images within which the parts far from people are updated once; larger: less work,
            slower learning [images].
        cut_sd: a sample farther than this from its mean has changed, for deciding whether an image shows this room;
            larger: fewer images are rejected [standard deviations].
        strange_sd: a sample farther than this from its mean counts as changed in the foreground score of colour
            images, the vote of five samples; larger: less is foreground [standard deviations].
        strange_gray_sd: ``strange_sd`` for gray images, where shadows cannot be distinguished [standard deviations].
        shadow: least brightness of a sample in shadow, as a share of its usual one; smaller: darker shadows are not
            foreground; 1: no sample is in shadow [0 to 1].
        shadow_sd: largest distance of a sample in shadow from its darkened colour; larger: more is taken for shadow
            [grey levels].
        every: stride between the samples that decide whether an image shows this room; larger: less work, less certain
            [samples].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    guard_steps: float = 6.0
    rate: float = 0.05
    least_sd: float = 10.0
    window_images: int = 8
    sweep_images: int = 32
    cut_sd: float = 4.0
    strange_sd: float = 1.4
    strange_gray_sd: float = 2.5
    shadow: float = 0.4
    shadow_sd: float = 5.0
    every: int = 13

    def __post_init__(self) -> None:
        check(self.guard_steps >= 0, "guard_steps", self.guard_steps, "0 or more")
        check(0 < self.rate <= 1, "rate", self.rate, "above 0 and at most 1")
        check(self.least_sd > 0, "least_sd", self.least_sd, "above 0 grey levels")
        check(self.window_images >= 1, "window_images", self.window_images, "1 or more")
        check(self.sweep_images >= 1, "sweep_images", self.sweep_images, "1 or more")
        check(self.cut_sd > 0, "cut_sd", self.cut_sd, "above 0")
        check(self.strange_sd > 0, "strange_sd", self.strange_sd, "above 0")
        check(self.strange_gray_sd > 0, "strange_gray_sd", self.strange_gray_sd, "above 0")
        check(0 < self.shadow <= 1, "shadow", self.shadow, "above 0 and at most 1")
        check(self.shadow_sd > 0, "shadow_sd", self.shadow_sd, "above 0 grey levels")
        check(self.every >= 1, "every", self.every, "1 or more")


DEFAULT = MemorySettings()
BEHIND_STEPS = 12
"""Margin around a thing within which the background behind and beside a person is unknown [samples]."""
LEAST_THING = 20
"""Least size of the part of a thing that is not near the person [samples]."""

NOISIER = 2.0
"""An image whose noise exceeds this many initial standard deviations of a sample counts as changed everywhere."""
FIRST_SDS = 1.5
"""Initial standard deviation of a sample, in units of the image's noise; it covers the error of a mean of one image."""


class BackgroundMemory:
    """Background model of one camera: mean and variance of each image sample; a `Background` of `region_contour`.

    The first image given to any method but `costs` sets the images' size and channels.

    Args:
        step_px: distance between samples, each the mean of a square of pixels about as wide [px].
        settings: parameters of learning and applying the background.

    Attributes:
        step_px, settings: as given.

    Raises:
        SettingsError: ``step_px`` is below 1.
    """

    def __init__(self, step_px: int, settings: MemorySettings = DEFAULT) -> None:
        check(step_px >= 1, "step_px", step_px, "1 or more")
        self.settings = settings
        self.step_px = step_px
        self.reset()

    def reset(self) -> None:
        """Forget everything, also the images' size."""
        self._mean = np.empty((0, 0, 0), np.float32)
        self._variance = np.empty((0, 0), np.float32)
        self._count = np.empty((0, 0), np.uint8)
        self._next_row, self._learnt = 0, False
        self._shape: tuple[int, ...] = ()
        self._first_sd = self.settings.least_sd

    def memory(self) -> dict[str, Any]:
        """Return the learnt state for `recall`; its arrays are the memory's own, which `update` changes."""
        return {name: getattr(self, name) for name in _MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore a state that `memory` returned, of the same step and settings; its arrays are kept, not copied."""
        set_memory(self, memory)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the background of each sample of the image is learnt, (rows, columns); (0, 0) before an image."""
        return self._count > 0

    def update(
        self, image: UInt8, person: Silhouette | None, others: Bool | None = None, covered: UInt8 | None = None
    ) -> None:
        """Learn the background from an image, except near people.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            person: the person's silhouette in an aligned window, of this memory's step and with a multiple of it as
                origin. Samples inside, and nearer to it than ``guard_steps``, are not learnt. None: no person is seen.
            others: (height, width) bool, True on other people, whose pixels are not learnt either; None: no others.
            covered: (rows, columns) uint8 of the window, another mask of the person, not 0 on samples not to learn;
                None for none.

        Raises:
            InputError: an image of another size than the first, a mask of another size than the image or the window, or
                a window that is not aligned.
        """
        image, (left, top), phi = self._door(image, person)
        for mask, of, shape in ((others, "image", image.shape[:2]), (covered, "window", phi.shape)):
            if mask is not None and mask.shape != shape:
                raise InputError(f"a mask is not of the {of}", field="shape", value=mask.shape, fix=f"make it {shape}")
        s, rows = self.settings, len(self._count)
        if not self._learnt:
            begin, end = 0, rows
            _, _, noise = self._compared(image, phi, left, top)
            self._first_sd = max(s.least_sd, FIRST_SDS * noise)
        else:
            begin, end = self._next_row, self._next_row + -(-rows // s.sweep_images)
            self._next_row = end if end < rows else 0
        _kernels().learn(
            image, self.step_px, self._window(phi, left, top), _NOT_COVERED if covered is None else covered,
            _NO_MASK if others is None else others, begin, end, s.window_images, s.rate, self._first_sd, self._samples,
        )  # fmt: skip
        self._learnt = self._learnt or bool(self._count.any())

    def forget_things(self, image: UInt8, person: Silhouette, others: Bool | None = None) -> int:
        """Forget the background where things stand that came after it was learnt; return the number of samples.

        Such a thing is a region of changed samples that reaches farther from the person than ``guard_steps``. Its
        shadow is one, too. The region is forgotten up to the person, and also behind the person's `BEHIND_STEPS` next
        to it, where the thing may continue. `update` learns it anew where no person is near.

        Args:
            image: (height, width) or (height, width, 3) uint8, with the person at a known pose.
            person: the person's silhouette, aligned as in `update`.
            others: (height, width) bool, True on other people, whose samples stay; None: no others.

        Raises:
            InputError: an image of another size than the first, or a window that is not aligned.
        """
        import cv2

        image, (left, top), phi = self._door(image, person)
        if not self._learnt:
            return 0
        k = _kernels()
        score, bounds = np.zeros(self._count.shape, np.float32), self._bounds()._replace(darkest=1.0)
        k.strange(image, self.step_px, 0, 0, 1, bounds, self._samples, score)
        covered, near = np.zeros(score.shape, np.bool_), np.zeros(score.shape, np.bool_)
        rows, columns = score.shape
        a, b = max(-top, 0), max(-left, 0)
        part = phi[a : max(rows - top, 0), b : max(columns - left, 0)]
        window = np.s_[top + a : top + a + part.shape[0], left + b : left + b + part.shape[1]]
        covered[window], near[window] = part > 0, part >= -self.settings.guard_steps * self.step_px
        if others is not None:
            taken = others[:: self.step_px, :: self.step_px]
            covered |= taken
            near |= taken
        changed = cv2.morphologyEx((score > 0).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        changed[covered] = 0
        _, labels = cv2.connectedComponents(changed)
        far = np.bincount(labels[~near], minlength=labels.max() + 1) >= LEAST_THING
        far[0] = False
        things = far[labels]
        side = np.ones((2 * BEHIND_STEPS + 1,) * 2, np.uint8)
        forgotten = (cv2.dilate(things.astype(np.uint8), side) > 0) & (covered | near)
        forgotten |= things
        if others is not None:
            forgotten &= ~taken
        self._count[forgotten] = 0
        return int(np.count_nonzero(forgotten))

    def unlike(self, image: UInt8, person: Silhouette | None) -> float:
        """Return the share of known samples away from people that have changed, 0 to 1; NaN if there are none.

        It is 1 for an image that is noisier than `NOISIER` allows. Nothing is learnt.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            person: silhouette, aligned as in `update`; samples inside and near it are left out. None: no person.

        Raises:
            InputError: an image of another size than the first, or a window that is not aligned.
        """
        image, (left, top), phi = self._door(image, person)
        differ, known, noise = self._compared(image, phi, left, top)
        if self._learnt and noise > NOISIER * max(self._first_sd, self.settings.least_sd):
            return 1.0
        return differ / known if known else float("nan")

    def _compared(self, image: UInt8, phi: Float32, left: int, top: int) -> tuple[int, int, float]:
        s, window = self.settings, self._window(phi, left, top)
        return tuple(_kernels().unlike(image, self.step_px, window, s.every, s.least_sd, s.cut_sd, self._samples))

    def _window(self, phi: Float32, left: int, top: int) -> PersonWindow:
        window: PersonWindow = _kernels().PersonWindow(phi, left, top, float(self.settings.guard_steps * self.step_px))
        return window

    @property
    def _samples(self) -> BackgroundSamples:
        samples: BackgroundSamples = _kernels().BackgroundSamples(self._mean, self._variance, self._count)
        return samples

    def strange(self, image: UInt8, window: Silhouette, every: int) -> Float32:
        """Return the foreground score at every ``every``-th sample of a window: from 1, foreground, to −1, background.

        Each score is the vote of the sample and its four neighbours. Neighbours that are unknown or probably in shadow
        do not vote; with fewer than three votes, and before any `update`, the score is 0.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            window: the window, aligned as in `update`.
            every: stride between scored samples.

        Returns:
            (rows, columns) float32.

        Raises:
            InputError: the image has another size than the first, or the window is not aligned.
        """
        image, (left, top), phi = self._door(image, window)
        rows, columns = -(-phi.shape[0] // every), -(-phi.shape[1] // every)
        out = np.zeros((rows, columns), np.float32)
        if self._learnt:
            _kernels().strange(image, self.step_px, left, top, every, self._bounds(), self._samples, out)
        return out

    def strange_at(self, image: UInt8, pixels: Float64) -> Float32:
        """Return the foreground score (n,), −1 (background) to 1, at pixels x, y (n, 2) of an image [px]; 0 outside it.

        The sample nearest to a pixel is scored.

        Raises:
            InputError: an image of another size than the first.
        """
        image, _, _ = self._door(image, None)
        out = np.zeros(len(pixels), np.float32)
        if self._learnt:
            _kernels().strange_at(image, self.step_px, pixels, self._bounds(), self._samples, out)
        return out

    def _bounds(self) -> ForegroundBounds:
        s, channels = self.settings, self._mean.shape[2]
        # In a single channel any darker value could be in shadow.
        sd, darkest = (s.strange_gray_sd, 1.0) if channels == 1 else (s.strange_sd, s.shadow)
        bounds: ForegroundBounds = _kernels().ForegroundBounds(
            sd**2 * channels, s.least_sd**2, darkest, s.shadow_sd**2 * channels
        )
        return bounds

    def costs(self, band: Band, settings: RegionSettings) -> Float32:
        """Return (blocks, size) the cost −log p of each sample's value under the background [nats]; NaN where unknown.

        Args:
            band: the samples, of an image of the learnt size.
            settings: not used.

        Raises:
            InputError: the band's window is not aligned as in `update`.
        """
        prior = band.prior
        left, top = self._place(prior)
        if not self._shape:
            return np.full(band.known.shape, np.nan, np.float32)
        out = np.empty(band.known.shape, np.float32)
        _kernels().costs(
            band.values, band.blocks, left - band.pad, top, self.settings.least_sd, self._samples, out
        )  # fmt: skip
        return out

    def _door(self, image: UInt8, person: Silhouette | None) -> tuple[UInt8, tuple[int, int], Float32]:
        image = np.ascontiguousarray(image).reshape(*image.shape[:2], -1)
        if not self._shape:
            self._shape = image.shape
            height, width, channels = image.shape
            rows, columns = -(-height // self.step_px), -(-width // self.step_px)
            self._mean = np.zeros((rows, columns, channels), np.float32)
            self._variance = np.zeros((rows, columns), np.float32)
            self._count = np.zeros((rows, columns), np.uint8)
        if image.shape != self._shape:
            raise InputError(
                "an image's size changed", field="shape", value=image.shape, fix=f"as the first one's, {self._shape}"
            )
        if person is None:
            return image, (0, 0), _NOBODY
        return image, self._place(person), person.phi

    def _place(self, window: Silhouette) -> tuple[int, int]:
        (x, y), step = window.origin_px, self.step_px
        if window.step_px != step or x % step or y % step:
            raise InputError(
                "a window does not fit the memory's samples",
                field="origin_px, step_px",
                value=(window.origin_px, window.step_px),
                fix=f"begin at a multiple of {step} px, with that step",
            )
        return x // step, y // step


_MEMORY: Final = ("_mean", "_variance", "_count", "_next_row", "_learnt", "_shape", "_first_sd")
_NOBODY = np.empty((0, 0), np.float32)
_NOT_COVERED = np.empty((0, 0), np.uint8)
_NO_MASK = np.empty((0, 0), np.bool_)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import background_memory_kernels

    return background_memory_kernels
