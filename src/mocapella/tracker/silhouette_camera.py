"""State of one camera while a body is tracked: outlines of the body and the image in this frame, and the background.

One frame goes through rendering of the model's outline, segmentation with it as shape prior, correspondences, rejection
of corrupted images, and background update.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.signed_distance import signed_distance
from mocapella.kinematics.limb_search import Evidence
from mocapella.kinematics.silhouette_fit import Eye, Figure, Outline, alike, see, seen_at, touching, within
from mocapella.kinematics.twist_fit import InPlanes
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background_memory import BackgroundMemory
from mocapella.sensing.edges_elsewhere import edges_in_excess
from mocapella.sensing.frame_changes import FrameChanges
from mocapella.sensing.image_samples import image_samples
from mocapella.sensing.largest_object import largest_object
from mocapella.sensing.passing_things import PassingThings
from mocapella.sensing.region_contour import RegionSettings, region_contour
from mocapella.sensing.room_edges import RoomEdges
from mocapella.tracker.limb_stillness import ChangedImage
from mocapella.tracker.limb_support import ELSEWHERE_M, OutlineEvidence, evidence_at
from mocapella.tracker.silhouette_settings import SilhouetteSettings

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

MOST_AT_FIRST = 0.6
"""Threshold of a changed fraction before the first value of `Usually`."""
LEAST_JUMP, BEYOND = 0.04, 6.0
"""A changed fraction is an outlier if it is above the mean by more than this and `BEYOND` mean deviations."""
LEAST_LOSS = 0.25
"""An overlap is an outlier if it is below the mean by more than this and `BEYOND` mean deviations."""
LEARNT = 0.2
"""Learning rate of the mean and the mean deviation of `Usually`."""
WIDE = 2.0
"""Factor of the search distance of outlines if the pose is rough, as in the first frame."""
FARTHER = 0.3
"""Margin around the body's window for the search of limbs, as a fraction of the window."""
EVERY = 3
"""Stride of the foreground scores of an image [samples]."""
NEAREST_LIMB_M = 0.3
"""A limb that is nearer to a camera may be anywhere in the camera's image [m]."""
FOREGROUND_PX = 4
"""Sampling step of a whole image's foreground, at least [px]."""
MOST_FOREGROUND = 0.4
"""An image with more foreground than this fraction shows something else, and no person."""
ALIKE = 0.02
"""Share of the body's colours that must be like a pixel's; a limb has more, and misjudged pixels of the edge less."""
BODY_COLOURS = 512
"""Number of pixels of the segmented region whose colours are the body's."""
LEVELS = 24.0
"""Least difference of unlike colours, in any channel [8-bit levels]."""
COARSE_M = 0.0125
"""Largest distance between samples at which edges at an outline are compared with those elsewhere: there these are few
samples away, where edges of the same body are [m]."""
KNOWN_ELSEWHERE = 0.5
"""Edges at an outline are compared with those elsewhere if the background is known at this share of the places there:
else edges of a patterned room count as those of things."""
USUAL_STEP_PX = 2
"""Stride for which `RegionSettings` give lengths and areas; they are scaled to a camera's stride [px]."""


class SeenIn(msgspec.Struct, frozen=True, eq=False):
    """A body in one camera's image.

    Attributes:
        contour: the segmented region.
        outline: outline of the posed mesh.
        overlap: intersection over union of the region and the mesh's silhouette, 0 to 1. The region is segmented with
            the mesh's silhouette as a prior, so it is the mesh's own where the image says nothing.
        shown: share of the mesh's outline for which the image has evidence, 0 to 1 (`limb_support.py`).
        stands_out: share of the region that differs from the background learnt so far, 0 to 1; NaN if that is unknown
            at half of the region or more.
    """

    contour: Silhouette
    outline: Outline
    overlap: float
    shown: float = float("nan")
    stands_out: float = float("nan")


class Ball(msgspec.Struct, frozen=True, eq=False):
    """Sphere that bounds the reach of a limb, in the world: its centre (3,) and radius [m]."""

    centre: Float64
    radius_m: float


class SilhouetteCamera:
    """One camera's part in the fit of one body: outline, segmentation and background. `BodyFitter` has one per camera.

    In each frame `forget_frame` comes first, then `look` (again after each change of the pose), `segment`, `planes` or
    `seen`, and `learn`. Images are uint8, gray (height, width) or BGR (height, width, 3), of the camera's size.

    Args:
        by: the camera, prepared for rendering.
        step_px: stride of the sampled pixels [px].
        settings: settings of the tracker.

    Attributes:
        step_px: the stride [px].
        background: model of the background; None for moving cameras.
        changes: where the image changes, from instant to instant.
        things: foreground that is none of the body.
        room_edges: edges of the room beside the body.
        wide: whether to search farther from the outline, for a rough pose; set by the fitter.
        usually: adaptive threshold for the share of changed background, see `unlike`.
        covers: adaptive threshold for the overlap of contour and model outline, see `seen`.
    """

    def __init__(self, by: Eye, step_px: int, settings: SilhouetteSettings) -> None:
        self._eye, self.step_px, self._settings = by, step_px, settings
        self._region, self._closer = (_scaled(region, step_px) for region in (settings.region, settings.closer))
        self._wide_region = dataclasses.replace(
            self._region, band_px=WIDE * self._region.band_px, prior_weight=self._region.prior_weight / WIDE**2
        )
        soft = settings.correspondences.soft_steps
        self._wide_correspondences = dataclasses.replace(settings.correspondences, soft_steps=WIDE * soft)
        self._usual_reach = float(settings.margin_steps * step_px)
        self.background = None if settings.background is None else BackgroundMemory(step_px, settings.background)
        self.changes, self.things, self.room_edges = FrameChanges(step_px), PassingThings(), RoomEdges(step_px)
        self.wide = False
        self.usually, self.covers = Usually(), Usually()
        self.forget_frame()

    def forget_frame(self) -> None:
        """Prepare for the next frame: drop outline and segmentation; background and thresholds stay."""
        self._window: Outline | None = None
        self._looked: tuple[Float64, float] | None = None
        self._outline: Outline | None = None
        self._prior: Silhouette | None = None
        self._found: tuple[Silhouette, Float32] | None = None
        self._image: UInt8 | None = None
        self._scored: tuple[UInt8, Float32] | None = None

    def memory(self) -> list[Any]:
        """Return all state between two frames, for `recall`; its mutable values are shared, not copied."""
        background = None if self.background is None else self.background.memory()
        others = [self.usually.memory(), self.covers.memory(), self.changes.memory(), self.things.memory()]
        others.append(self.room_edges.memory())
        return [self.step_px, background, *others]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same ``step_px``, its first element."""
        _, background, usually, covers, changes, things, edges = memory
        self._scored = None
        self.changes.recall(changes)
        self.things.recall(things)
        self.room_edges.recall(edges)
        if self.background is not None:
            self.background.recall(background)
        self.usually.recall(usually)
        self.covers.recall(covers)

    @property
    def _reach(self) -> float:
        return WIDE * self._usual_reach if self.wide else self._usual_reach

    @property
    def segmented(self) -> bool:
        """Whether this frame's image was segmented and shows the body."""
        return self._found is not None and self._outline is not None

    @property
    def sample_m(self) -> float:
        """Distance between samples at the body's nearest outline [m]; after a successful `look`."""
        assert self._outline is not None
        return float(self._outline.depth.min(initial=np.inf) * self.step_px / self._eye.lens[0])

    def sample_at_m(self, point: Float64) -> float:
        """Return the distance between samples at a point (3,) in the world [m]."""
        T = self._eye.T_camera_world
        return float(T[2, :3] @ point + T[2, 3]) * self.step_px / float(self._eye.lens[0])

    def look(self, body: Figure, vertices: Float64, s: SilhouetteSettings) -> bool:
        """Project the outline of a posed body into the image, and keep it; return False if it is outside.

        All outlines of one frame are sampled in the same window of the image, that of the first.

        Args:
            body: model whose outline is projected.
            vertices: (n, 3) vertices of its mesh in the world [m]; the same array object again costs nothing.
            s: settings of the tracker.
        """
        if self._looked is not None and self._looked[0] is vertices and self._looked[1] == self._reach:
            return self._outline is not None
        self._looked = vertices, self._reach
        seen = see(
            body, vertices, self._eye, step_px=self.step_px, margin_px=int(self._reach),
            spacing_px=s.correspondences.spacing_steps * self.step_px, window=self._window,
        )  # fmt: skip
        self._window, self._outline, self._prior = self._window or seen, seen, None
        return seen is not None

    def changed(self, image: UInt8, time_ns: int) -> ChangedImage | None:
        """Return where an image has changed lately; None if that is unknown, and for moving cameras.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            time_ns: capture time, on the common clock.
        """
        if self.background is None:
            return None
        density = self.changes.update(image, time_ns)
        return None if density is None else ChangedImage(self._eye, self.step_px, density)

    def unlike(self, image: UInt8) -> float:
        """Return the fraction of the background that has changed in an image, 0 to 1; NaN if the background is unknown.

        The image is compared outside of the body's outline, so `look` comes first. ``image`` (height, width) or
        (height, width, 3) uint8.
        """
        return float("nan") if self.background is None else self.background.unlike(image, self._expected())

    def forget_background(self) -> None:
        """Forget the background; the next learnt image becomes the new one. `background` must not be None."""
        assert self.background is not None
        self.background.reset()
        self._scored, self.usually = None, Usually()

    def forget_things(self, image: UInt8, others: Bool | None) -> None:
        """Forget the background where things came after it was learnt; the body is where it was `look`-ed for.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) mask of other people, where the background stays; None for none.
        """
        if self.background is not None and self._outline is not None:
            self.background.forget_things(image, self._expected(), others)
            self._scored = None

    def ignored(self, image: UInt8, others: Bool | None) -> Bool | None:
        """Return the pixels (height, width) that are no evidence: of other people, and of things that passed by.

        After a successful `look`, once a frame.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) mask of other people; None for none.
        """
        if self.background is None or self._outline is None:
            return others
        (height, width), grid = image.shape[:2], self._grid_px
        scores = self._scores(image)
        foreground, unknown = scores > 0, scores == 0
        body = self._scored_in(self._outline.silhouette, foreground.shape)
        if others is not None:
            apart_from = others[::grid, ::grid]
            foreground, unknown = foreground & ~apart_from, unknown & ~apart_from
        found = self.things.update(foreground, unknown, body)
        if not found.any():
            return others
        wide = np.kron(found, np.ones((grid, grid), np.bool_))[:height, :width]
        return wide if others is None else wide | others

    def segment(self, image: UInt8, others: Bool | None, *, near: bool) -> None:
        """Segment the image, with the body's projected outline of `look` as a prior, and keep the contour.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) pixels of other people, which are ignored; None for none.
            near: whether the outline is near the final one, so that a narrower search suffices.
        """
        settings = self._wide_region if self.wide else self._closer if near else self._region
        found = region_contour(image, self._expected(), ignore=others, background=self.background, settings=settings)
        self._found = found.silhouette, found.surety
        self._image = image

    def planes(self, motions: tuple[Float64, Float64]) -> InPlanes:
        """Return the correspondences of outline and contour, as constraints of the pose; only if it is `segmented`.

        Args:
            motions: R (parts, 9) and t (parts, 3) of the kinematic tree in the pose of the outline.
        """
        assert self._outline is not None
        assert self._found is not None
        contour, surety = self._found
        return touching(
            self._outline, motions, contour.phi, surety, self._eye,
            reach_px=self._reach,
            settings=self._wide_correspondences if self.wide else self._settings.correspondences,
        )  # fmt: skip

    def seen(self) -> SeenIn:
        """Return the body in this frame's image: contour, outline and their overlap; only if it is `segmented`."""
        assert self._outline is not None
        assert self._found is not None
        contour = self._found[0]
        return SeenIn(contour, self._outline, alike(self._outline, contour.phi))

    def stands_out(self, others: Bool | None) -> float:
        """Return the share of the segmented region that differs from the background learnt so far, see `SeenIn`.

        Only if it is `segmented`, and before `learn`.

        Args:
            others: (height, width) mask of other people, whose pixels do not count; None for none.
        """
        assert self._found is not None
        assert self._image is not None
        if self.background is None:
            return float("nan")
        scores = self._scores(self._image)
        counts = self._scored_in(self._found[0], scores.shape)
        whole = int(counts.sum())
        if others is not None:
            counts &= ~others[:: self._grid_px, :: self._grid_px]
        score = scores[counts]
        known = score[score != 0]
        enough = 2 * len(known) > len(score) and 3 * len(known) > whole
        return float((known > 0).mean()) if enough else float("nan")

    def support(self, people: Bool | None, arms: Bool | None = None) -> OutlineEvidence:
        """Return how clearly this frame's image shows the model's outline; only if it is `segmented`.

        Args:
            people: (height, width) mask of other people, who may hide the body; None for none.
            arms: (parts,) bool, the parts at whose outline edges are compared with those elsewhere; None for none.
        """
        assert self._outline is not None
        assert self._found is not None
        assert self._image is not None
        (contour, surety), outline, (height, width) = self._found, self._outline, self._image.shape[:2]
        lengths = np.linalg.norm(outline.normals, axis=1) * outline.depth / self._eye.lens[0]
        column, row = np.rint(outline.at).astype(np.int64).T
        free = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        if people is not None:
            free &= ~people[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        room = None
        if self.background is not None:
            room = self.room_edges.of_room(self._image, outline.at, outline.normals, self.background)
        excess = None if arms is None else self._excess(outline, free & arms[outline.part])
        return OutlineEvidence(outline, evidence_at(outline, contour.phi, surety), lengths, free, room, excess)

    def _excess(self, outline: Outline, these: Bool) -> Float64:
        """Return `OutlineEvidence.excess` (n,) of the points ``these`` (n,) of the outline; NaN for the others."""
        assert self._image is not None
        image, out = self._image, np.full(len(these), np.nan)
        if not these.any() or self.sample_m > COARSE_M:
            return out
        points, step = outline.points[these], self.step_px
        moved = (points + ELSEWHERE_M[:, None]).reshape(-1, 3)
        elsewhere = seen_at(moved, self._eye).reshape(len(ELSEWHERE_M), -1, 2) - seen_at(points, self._eye)
        background, places = self.background, outline.at[these] + elsewhere
        if background is None:
            return out
        if (background.strange_at(image, places.reshape(-1, 2)) != 0).mean() < KNOWN_ELSEWHERE:
            return out
        out[these] = edges_in_excess(
            image_samples(image, step), step, outline.at[these], outline.normals[these], elsewhere,
            is_room=lambda pixels: background.strange_at(image, pixels) < 0,
        )  # fmt: skip
        return out

    def contradicts(self, pixels: Float64, margins_rad: Float64) -> Bool:
        """Return whether the image shows that pixels (n,) are not the body's; only if it is `segmented`.

        Such a pixel is outside the contour by more than the margin, is no foreground by the background learnt so far,
        and has a colour that hardly anything in the contour has. False for moving cameras.

        Args:
            pixels: (n, 2) x, y [px]; NaN gives False.
            margins_rad: (n,) margins outside the contour, as angles [rad].
        """
        out = np.zeros(len(pixels), np.bool_)
        if self.background is None or self._found is None or self._image is None:
            return out
        contour, (height, width) = self._found[0], self._image.shape[:2]
        at = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64)
        inside = np.asarray(((at >= 1) & (at < [width - 1, height - 1])).all(axis=1))
        rows, columns = np.nonzero(contour.phi > 0)
        x, y = contour.origin_px[0] + contour.step_px * columns, contour.origin_px[1] + contour.step_px * rows
        there = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        x, y = x[there], y[there]
        if not (inside.any() and len(x)):
            return out
        some = np.linspace(0, len(x) - 1, BODY_COLOURS).astype(np.int64)
        colours = self._image[y[some], x[some]].reshape(len(some), -1).astype(np.float64)
        background = self.background.strange_at(self._image, np.where(inside[:, None], at, 0).astype(np.float64)) <= 0
        for k in np.flatnonzero(np.asarray(inside & background)).tolist():
            u, v = at[k]
            own = np.median(self._image[v - 1 : v + 2, u - 1 : u + 2].reshape(9, -1), axis=0)
            away_px = np.sqrt(((x - u) ** 2 + (y - v) ** 2).min())
            unlike = np.abs(colours - own).max(axis=1) > LEVELS
            out[k] = unlike.mean() > 1.0 - ALIKE and away_px > margins_rad[k] * self._eye.lens[0]
        return out

    def shows_all(self, vertices: Float64) -> bool:
        """Return whether all vertices (n, 3) of a body in the world [m] are within the image."""
        return within(vertices, self._eye)

    def against(self, image: UInt8, points: Float64) -> Float32:
        """Return for each point the confidence (n,) float32, 0 to 1, that its pixel shows background, not the body.

        The background must not be None.

        Args:
            image: (height, width, 3) uint8.
            points: (n, 3) on the body, in the world [m].
        """
        assert self.background is not None
        return np.maximum(-self.background.strange_at(image, seen_at(points, self._eye)), 0.0)

    def evidence(self, image: UInt8, others: Bool | None, about: Sequence[Ball]) -> Evidence:
        """Return the foreground evidence of the image around the body, for the search of limbs.

        It needs a background, and comes after a successful `look`.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) mask of other people, where nothing is known; None for none.
            about: balls that limbs can reach; the evidence is limited to them.
        """
        assert self._outline is not None
        assert self.background is not None
        (x, y), (rows, columns), step = self._outline.origin_px, self._outline.mask.shape, self.step_px
        width, height = self._eye.size_px
        grid, around = self._grid_px, step * round(FARTHER * max(rows, columns))
        left, top = (max(at - around, 0) // grid * grid for at in (x, y))
        right, bottom = min(x + step * columns + around, width), min(y + step * rows + around, height)
        bounds = self._bounds(about)
        if bounds is not None:
            left, top = max(left, bounds[0] // grid * grid), max(top, bounds[1] // grid * grid)
            right, bottom = min(right, bounds[2]), min(bottom, bounds[3])
        # At least one sample, even if limbs are outside the image.
        left, top = (min(at, (side - 1) // grid * grid) for at, side in ((left, width), (top, height)))
        right, bottom = max(right, left + 1), max(bottom, top + 1)
        strange = self._scores(image)[top // grid : -(-bottom // grid), left // grid : -(-right // grid)].copy()
        if others is not None:
            apart_from = others[top:bottom:grid, left:right:grid]
            strange[: apart_from.shape[0], : apart_from.shape[1]][apart_from] = 0.0
        return Evidence(self._eye, (left, top), grid, strange)

    def foreground(self, image: UInt8, others: Bool | None) -> Silhouette | None:
        """Segment the largest object of an image that differs from the background learnt during tracking.

        Nothing is learnt. Pixels with unknown background, where people were in every image, are no foreground.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) mask of other people, who are left out; None for none.

        Returns:
            A silhouette in the whole image, with phi of 0.5 on the object and −0.5 elsewhere instead of signed
            distances; None if nothing differs, nothing is known, or more than `MOST_FOREGROUND` of the image differs.
        """
        if self.background is None:
            return None
        step, (height, width) = self.step_px, image.shape[:2]
        every = max(1, -(-FOREGROUND_PX // step))
        window = Silhouette((0, 0), step, np.empty((-(-height // step), -(-width // step)), np.float32))
        changed = self.background.strange(image, window, every) > 0
        if changed.mean() > MOST_FOREGROUND:
            return None
        if others is not None:
            changed &= ~others[:: every * step, :: every * step]
        return largest_object(changed, every * step)

    @property
    def _grid_px(self) -> int:
        """Distance between the foreground scores of `_scores` [px]."""
        return EVERY * self.step_px

    def _scores(self, image: UInt8) -> Float32:
        """Return an image's foreground scores (rows, columns), of `BackgroundMemory.strange`.

        They are computed once for an image and a background.
        """
        assert self.background is not None
        if self._scored is None or self._scored[0] is not image:
            (height, width), step = image.shape[:2], self.step_px
            whole = Silhouette((0, 0), step, np.empty((-(-height // step), -(-width // step)), np.float32))
            self._scored = image, self.background.strange(image, whole, EVERY)
        return self._scored[1]

    def _scored_in(self, silhouette: Silhouette, shape: tuple[int, ...]) -> Bool:
        """Return which samples (rows, columns) of `_scores`, of a ``shape``, are in a silhouette in this stride."""
        out = np.zeros(shape, np.bool_)
        (left, top) = (at // self.step_px for at in silhouette.origin_px)
        row, column = (max(-at, 0) + -max(at, 0) % EVERY for at in (top, left))
        part = out[(top + row) // EVERY :, (left + column) // EVERY :]
        inside = silhouette.phi[row::EVERY, column::EVERY][: part.shape[0], : part.shape[1]] > 0
        part[: inside.shape[0], : inside.shape[1]] = inside
        return out

    def _bounds(self, about: Sequence[Ball]) -> tuple[int, int, int, int] | None:
        """Return the part of the image that shows balls: left, top, right, bottom [px]; None if one is too near."""
        centres, radii = np.array([ball.centre for ball in about]), np.array([ball.radius_m for ball in about])
        T = self._eye.T_camera_world
        nearest = centres @ T[2, :3] + T[2, 3] - radii
        if nearest.min() <= NEAREST_LIMB_M:
            return None
        pixels, reach = seen_at(centres, self._eye), self._eye.lens[:2] * (radii / nearest)[:, None]
        left, top = (pixels - reach).min(axis=0).astype(int).tolist()
        right, bottom = (pixels + reach).max(axis=0).astype(int).tolist()
        return left, top, right, bottom

    def learn(self, image: UInt8, others: Bool | None) -> None:
        """Update the background outside the body; does nothing without a background or a segmented image.

        Args:
            image: (height, width) or (height, width, 3) uint8.
            others: (height, width) mask of other people, which are not learnt; None for none.
        """
        if self.background is not None and self._outline is not None and self._found is not None:
            # Neither the contour's neighbourhood nor the body is learnt; no further distance is kept.
            self.background.update(image, self._found[0], others, self._outline.mask)
            self.room_edges.keep(image, self._outline.silhouette)
            self._scored = None

    def _expected(self) -> Silhouette:
        if self._prior is None:
            assert self._outline is not None
            phi = signed_distance(self._outline.mask, self._reach, self.step_px)
            self._prior = Silhouette(self._outline.origin_px, self.step_px, phi)
        return self._prior


class Usually:
    """Adaptive threshold for one fraction, 0 to 1, such as the share of background that changed in a camera.

    Mean and mean absolute deviation of accepted values are averaged exponentially; values far from the mean, in
    deviations, are outliers. It also measures for how long the fraction has been an outlier. Before the first
    value, the thresholds are constants. `mocapella.tracker.image_rejection` uses it.
    """

    def __init__(self) -> None:
        self._mean: float | None = None
        self._deviation = 0.0
        self._else_since_ns: int | None = None

    def memory(self) -> list[Any]:
        """Return all state of the adaptive threshold, for `recall`."""
        return [self._mean, self._deviation, self._else_since_ns]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned."""
        self._mean, self._deviation, self._else_since_ns = memory

    def much(self, share: float) -> float:
        """Return the threshold of a large change: mean m + ``share`` · (1 − m), where ``share`` is 0 to 1."""
        return MOST_AT_FIRST if self._mean is None else self._mean + share * (1.0 - self._mean)

    def most(self) -> float:
        """Return the upper threshold, mean plus a multiple of the deviation: above it, the fraction is an outlier."""
        return MOST_AT_FIRST if self._mean is None else self._mean + max(LEAST_JUMP, BEYOND * self._deviation)

    def least(self) -> float:
        """Return the lower threshold, mean minus a multiple of the deviation: below it, the fraction is an outlier."""
        return 0.0 if self._mean is None else self._mean - max(LEAST_LOSS, BEYOND * self._deviation)

    def learn(self, share: float) -> None:
        """Update mean and deviation by an inlier ``share`` (exponential averages); NaN (unknown) changes neither.

        The time for which the fraction has been an outlier, `else_for_ns`, restarts at 0.
        """
        self._else_since_ns = None
        if np.isnan(share):
            return
        if self._mean is None:
            self._mean = share
            return
        change = share - self._mean
        self._mean += LEARNT * change
        self._deviation += LEARNT * (abs(change) - self._deviation)

    def else_for_ns(self, time_ns: int) -> int:
        """Return for how long the fraction has been an outlier [ns], counted from the first call after `learn`.

        ``time_ns`` is the capture time on the common clock.
        """
        if self._else_since_ns is None:
            self._else_since_ns = time_ns
        return time_ns - self._else_since_ns


def _scaled(region: RegionSettings, step_px: int) -> RegionSettings:
    """Scale settings for a stride of `USUAL_STEP_PX` to another stride."""
    scale = step_px / USUAL_STEP_PX
    return dataclasses.replace(
        region,
        prior_weight=region.prior_weight / scale**2,
        window_px=region.window_px * scale,
        band_px=region.band_px * scale,
        unsure_px=region.unsure_px * scale,
        fewest_px2=region.fewest_px2 * scale**2,
    )
