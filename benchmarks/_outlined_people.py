"""Images of a drawn person with a known outline, before easy and hard backgrounds, and wrong priors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from mocapella.model.silhouettes import Silhouette

UInt8 = NDArray[np.uint8]
Float64 = NDArray[np.float64]

SIZE_PX: Final = (640, 480)
REACH_PX: Final = 16.0
KINDS: Final = ("easy", "clutter", "similar", "shadow", "noise", "salt")


@dataclass(frozen=True)
class Shot:
    """An image and its ground truth.

    Attributes:
        image: (height, width, 3) uint8.
        phi: (height, width) the person's true signed distance [px], above 0 inside.
        prior_phi: (height, width) that of a pose that is off by some pixels.
    """

    image: UInt8
    phi: Float64
    prior_phi: Float64

    @property
    def mask(self) -> NDArray[np.bool_]:
        return np.asarray(self.phi > 0)

    def prior(self, step_px: int, around_px: int = 16) -> Silhouette:
        """In a window about it."""
        return window_of(self.prior_phi, step_px, around_px)


def window_of(phi: Float64, step_px: int, around_px: int = 16) -> Silhouette:
    """Convert distances to a silhouette, in a window with a margin around the inside."""
    ys, xs = np.nonzero(phi > 0)
    height, width = phi.shape
    x0, y0 = max(int(xs.min()) - around_px, 0), max(int(ys.min()) - around_px, 0)
    x1, y1 = min(int(xs.max()) + around_px + 1, width), min(int(ys.max()) + around_px + 1, height)
    part = np.clip(phi[y0:y1:step_px, x0:x1:step_px], -REACH_PX, REACH_PX)
    return Silhouette((x0, y0), step_px, np.ascontiguousarray(part, dtype=np.float32))


def at_every_pixel(silhouette: Silhouette, size_px: tuple[int, int] = SIZE_PX) -> NDArray[np.bool_]:
    """(height, width) what a silhouette covers, its distances being linear between samples."""
    width, height = size_px
    out = np.zeros((height, width), dtype=np.bool_)
    step, phi = silhouette.step_px, silhouette.phi.astype(float)
    rows, columns = phi.shape
    x = np.minimum(np.arange((columns - 1) * step + 1) / step, columns - 1 - 1e-9)
    y = np.minimum(np.arange((rows - 1) * step + 1) / step, rows - 1 - 1e-9)
    i, j = y.astype(int), x.astype(int)
    v, u = (y - i)[:, None], (x - j)[None, :]
    upper = phi[i][:, j] * (1 - u) + phi[i][:, j + 1] * u
    lower = phi[i + 1][:, j] * (1 - u) + phi[i + 1][:, j + 1] * u
    full = (upper * (1 - v) + lower * v) > 0
    x0, y0 = silhouette.origin_px
    left, top = max(x0, 0), max(y0, 0)
    part = full[top - y0 : max(height - y0, 0), left - x0 : max(width - x0, 0)]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out


def shot(kind: str, seed: int, *, off_px: float = 5.0) -> Shot:
    """A picture of one of `KINDS`.

    Args:
        kind: how hard it is.
        seed: of pose, clothes and background.
        off_px: by how much the prior is shifted; its limbs are turned a little, too.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    pose = np.array([0.0, 0.35, 0.25, -0.35, -0.25, 0.16, 0.05, -0.16, -0.05])
    pose += rng.normal(0, [0.05, 0.5, 0.5, 0.5, 0.5, 0.15, 0.15, 0.15, 0.15])
    middle = np.array([320.0, 250.0]) + rng.uniform(-40, 40, 2) * (1, 0.1)
    angle = rng.uniform(0, 2 * np.pi)
    away = off_px * np.array([np.cos(angle), np.sin(angle)])
    parts = _parts(pose, middle)
    phi, which = _distance(parts)
    turned = rng.normal(0, [0.01, *[0.03] * 4, *[0.015] * 4])
    prior_phi, _ = _distance(_parts(pose + turned, middle + away))
    body, back = _textures(kind, rng, which)
    cover = np.clip(phi + 0.5, 0, 1)[..., None]
    picture = cover * body + (1 - cover) * back
    width, height = SIZE_PX
    if kind == "shadow":
        ramp = 0.45 + 0.75 * np.linspace(0, 1, width)[None, :, None]
        dark = gaussian_filter((_distance(_parts(pose, middle + np.array([25.0, 8.0])))[0] > 0).astype(float), 4)[
            ..., None
        ]
        picture = picture * ramp * np.where(phi[..., None] > 0, 1.0, 1 - 0.45 * dark)
    picture = gaussian_filter(picture, (0.5, 0.5, 0))
    picture += rng.normal(0, 25.0 if kind == "noise" else 4.0, picture.shape)
    image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    if kind == "salt":
        wrong = rng.random((height, width)) < 0.15
        image[wrong] = np.where(rng.random(int(wrong.sum())) < 0.5, 0, 255)[:, None]
    return Shot(image, phi, prior_phi)


def _parts(pose: Float64, middle: Float64) -> list[tuple[Float64, Float64, float, float]]:
    """Capsules (from, to, radius at either [px]): trunk, head, arms, legs, of about a tenth of the image."""

    def along(begin: Float64, angle: float, length: float) -> Float64:
        return np.asarray(begin + length * np.array([np.sin(angle), np.cos(angle)]))

    lean = pose[0]
    hip = middle + np.array([0.0, 25.0])
    neck = along(hip, lean + np.pi, 120.0)
    head = along(neck, lean + np.pi, 38.0)
    parts = [(hip, along(neck, lean, 14.0), 36.0, 42.0), (neck, head, 14.0, 25.0)]
    for side, upper, lower in ((1, pose[1], pose[2]), (-1, pose[3], pose[4])):
        shoulder = along(neck, lean, 12.0) + side * np.array([36.0, 0.0])
        elbow = along(shoulder, upper, 72.0)
        parts += [(shoulder, elbow, 15.0, 12.0), (elbow, along(elbow, upper + lower, 78.0), 12.0, 8.0)]
    for side, upper, lower in ((1, pose[5], pose[6]), (-1, pose[7], pose[8])):
        top = hip + side * np.array([18.0, 8.0])
        knee = along(top, upper, 85.0)
        parts += [(top, knee, 22.0, 15.0), (knee, along(knee, upper - abs(lower), 85.0), 15.0, 10.0)]
    return parts


def _distance(parts: list[tuple[Float64, Float64, float, float]]) -> tuple[Float64, NDArray[np.intp]]:
    """(height, width) signed distance to the parts together, and the part that is nearest."""
    width, height = SIZE_PX
    y, x = np.mgrid[:height, :width].astype(float)
    inside = []
    for begin, end, first, second in parts:
        axis = end - begin
        t = np.clip(((x - begin[0]) * axis[0] + (y - begin[1]) * axis[1]) / (axis @ axis), 0, 1)
        inside.append(first + t * (second - first) - np.hypot(x - begin[0] - t * axis[0], y - begin[1] - t * axis[1]))
    return np.max(inside, axis=0), np.argmax(inside, axis=0)


def _noise(rng: np.random.Generator, sd: float, smooth_px: float, channels: int = 1) -> Float64:
    width, height = SIZE_PX
    field = gaussian_filter(rng.normal(size=(height, width, channels)), (smooth_px, smooth_px, 0))
    return np.asarray(sd * field / field.std())


def _textures(kind: str, rng: np.random.Generator, which: NDArray[np.intp]) -> tuple[Float64, Float64]:
    """(height, width, 3) what the person and what the background would look like without the other."""
    width, height = SIZE_PX
    y, x = np.mgrid[:height, :width]
    wear = np.array([0, 1, 0, 2, 0, 2, 3, 3, 3, 3])[which]  # shirt, head, arms, trousers
    skin = np.array([150.0, 170, 205])
    if kind == "similar":
        wall = np.array([118.0, 112, 105])
        shirt, trousers = wall + rng.choice([-1, 1], 3) * 14.0, wall + rng.choice([-1, 1], 3) * 14.0
        body = np.stack([shirt, wall + 20.0, wall + np.array([10.0, 18, 25]), trousers])[wear]
        return body + _noise(rng, 5, 3, 3), wall + _noise(rng, 5, 12, 3) + _noise(rng, 5, 2)
    shirt, trousers = (np.array([60.0, 60, 190]), np.array([120.0, 70, 45])) if kind != "clutter" else (
        rng.uniform(40, 220, 3), rng.uniform(40, 220, 3)
    )  # fmt: skip
    body = np.stack([shirt, skin, skin, trousers])[wear] + _noise(rng, 8, 3)
    back = np.array([175.0, 180, 178]) + _noise(rng, 8, 30) + _noise(rng, 5, 2)
    if kind == "clutter":
        back = np.full((height, width, 3), 120.0)
        for _ in range(140):
            cx, cy, turn = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0, np.pi)
            a, b = rng.uniform(8, 70, 2)
            u, v = np.cos(turn) * (x - cx) + np.sin(turn) * (y - cy), np.cos(turn) * (y - cy) - np.sin(turn) * (x - cx)
            back[(abs(u) < a) & (abs(v) < b)] = rng.uniform(30, 230, 3)
        back = back + _noise(rng, 8, 3)
    return body, back
