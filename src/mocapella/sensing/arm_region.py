"""Find the region of an arm in a depth image: near a predicted arm, or anywhere.

Near a predicted arm, region growing collects connected surfaces within a gate around spheres along the arm. Without a
prediction, palms are found as discs of a palm's radius at the end of a surface as narrow as a forearm, by distance
transform and geodesic distances.

The image is sampled on a grid that is fine enough for fingers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from types import ModuleType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check
from mocapella.steps import Steps

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class ArmRegionSettings:
    """Limits of the regions that may be arms.

    Attributes:
        near_m: least valid depth [m].
        far_m: greatest valid depth; larger: arms are found farther away, at more work [m].
        spacing_m: distance between the grid's points on the arm's surface; larger: less work, and fingers are seen less
            well [m].
        seed_m: surfaces nearer than this to the predicted hand belong to it; larger: faster motion is followed, and
            near things are taken for the hand [m].
        grow_m: surfaces connected to the hand belong to the arm within this distance of the predicted hand [m].
        arm_m: surfaces connected to the hand belong to the arm within this distance of forearm and upper arm [m].
        jump: neighbours whose depths differ by less than this share of the depth are connected; larger: arms are torn
            apart more rarely, and joined to what is behind them more often [ratio].
        palm_radii_m: smallest and largest radius of the largest circle within a palm or fist [m].
        forearm_m: range of distances from the palm along the surface that only the forearm covers [m].
        columns: number of columns of the coarse grid on which palms are searched; larger: smaller hands are found, at
            more work [columns].
        widest_m: greatest width of a forearm; a wider surface is no arm [m].
        finger_m: greatest width of a finger; a wider branch of the surface may be the forearm [m].
        hidden: greatest share of a hand's edges that belong to a nearer surface which occludes it; larger: hands that
            are more hidden are found, also false ones [0 to 1].
        nearer_m: least difference in depth between a hand and a surface that occludes it [m].
        branch_m: least length of a branch of the surface, such as a finger [m].
        points: largest number of points of a region; larger: more accurate, at more work [points].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    near_m: float = 0.2
    far_m: float = 2.0
    spacing_m: float = 0.004
    seed_m: float = 0.025
    grow_m: float = 0.08
    arm_m: float = 0.03
    jump: float = 0.025
    palm_radii_m: tuple[float, float] = (0.024, 0.062)
    forearm_m: tuple[float, float] = (0.15, 0.23)
    columns: int = 160
    widest_m: float = 0.16
    finger_m: float = 0.027
    hidden: float = 0.4
    nearer_m: float = 0.02
    branch_m: float = 0.012
    points: int = 700

    def __post_init__(self) -> None:
        check(0 < self.near_m < self.far_m <= 20, "near_m", self.near_m, "above 0, below far_m, which is at most 20 m")
        for name in (
            "spacing_m",
            "seed_m",
            "grow_m",
            "arm_m",
            "jump",
            "widest_m",
            "finger_m",
            "hidden",
            "nearer_m",
            "branch_m",
        ):
            check(0 < getattr(self, name) < 1, name, getattr(self, name), "above 0, below 1")
        least, most = self.palm_radii_m
        check(0 < least < most < 0.2, "palm_radii_m", self.palm_radii_m, "two lengths in ascending order")
        inner, outer = self.forearm_m
        check(0 < inner < outer < 1, "forearm_m", self.forearm_m, "two lengths in ascending order")
        check(16 <= self.columns <= 4096, "columns", self.columns, "16 to 4096")
        check(50 <= self.points <= 100_000, "points", self.points, "50 to 100000")


class Grid(NamedTuple):
    """A part of a depth image, subsampled.

    Attributes:
        seen: (h, w) depth [m]; 0 where nothing was measured.
        lens: (4,) fx, fy, cx, cy of the grid [grid pixels].
        step: distance between the grid's pixels in the image [px].
    """

    seen: Float64
    lens: Float64
    step: int


class Region(NamedTuple):
    """A region that may be an arm, in the form of `mocapella.kinematics.arm_fit.ArmEvidence`.

    Attributes:
        points: (m, 3) points of the arm's surface, camera frame [m].
        front: (h, w) depth of the arm's surface, the negative depth of other surfaces, 0 where not measured [m].
        opposite: (h, w) in the same row, the column of the nearest arm pixel for a pixel off the arm, and of the
            nearest pixel off the arm for an arm pixel; −1 for none.
        lens: (4,) fx, fy, cx, cy of the grid [px].
    """

    points: Float64
    front: Float64
    opposite: Int64
    lens: Float64


class PalmCandidate(NamedTuple):
    """A possible palm or fist, with its forearm and fingers, in the camera frame.

    Attributes:
        centre: (3,) point on its surface [m].
        radius_m: radius of the largest circle in it [m].
        normal: (3,) unit normal of its surface, towards the camera.
        forearm: (3,) unit vector from it along the forearm; None if no forearm is visible.
        tips: (k, 3) ends of at most five branches as narrow as a finger [m], anticlockwise in the image from the
            forearm, or from the downward direction without a forearm.
        spheres: (n, 5) spheres of 1 cm around points of the surface within a hand's reach, as for `region`.
    """

    centre: Float64
    radius_m: float
    normal: Float64
    forearm: Float64 | None
    tips: Float64
    spheres: Float64


def whole_grid(depth: Float32, lens: Float64, step: int, s: ArmRegionSettings) -> Grid:
    """Subsample a whole depth image.

    A sample is the mean depth of the surface around its pixel, see `arm_region_kernels.thinned`.

    Args:
        depth: (height, width) [m].
        lens: (4,) fx, fy, cx, cy of the image [px], or (9,) with the distortion, which is not used.
        step: distance between the grid's pixels in the image [px].
        s: range of depths.
    """
    height, width = depth.shape
    return _grid(depth, lens, 0, 0, width, height, step, s)


def grid_about(depth: Float32, lens: Float64, spheres: Float64, s: ArmRegionSettings) -> Grid | None:
    """Subsample the part of a depth image that shows an arm, as finely as ``s.spacing_m`` requires.

    Args:
        depth: (height, width) [m].
        lens: (4,) fx, fy, cx, cy of the image [px], or (9,) with the distortion, which is not used.
        spheres: (k, 5) along the arm: centre and radius in the camera frame [m], and 1 for the hand or 0 for the arm.
        s: spacing, range of depths, and margin around the spheres.

    Returns:
        The grid; None if no sphere is farther than 0.1 m along the optical axis, or if the spheres with their margin
        cover less than 8 px of the image along an axis.
    """
    height, width = depth.shape
    z = spheres[:, 2]
    there = z > 0.1
    if not there.any():
        return None
    x, y = spheres[there, 0] / z[there], spheres[there, 1] / z[there]
    reach = (spheres[there, 3] + s.grow_m) / z[there]
    x0, x1 = lens[0] * (x - reach).min() + lens[2], lens[0] * (x + reach).max() + lens[2]
    y0, y1 = lens[1] * (y - reach).min() + lens[3], lens[1] * (y + reach).max() + lens[3]
    x0, x1, y0, y1 = max(int(x0), 0), min(int(x1) + 1, width), max(int(y0), 0), min(int(y1) + 1, height)
    if x1 - x0 < 8 or y1 - y0 < 8:
        return None
    step = int(np.clip(round(s.spacing_m * lens[0] / float(np.median(z[there]))), 1, 8))
    return _grid(depth, lens, x0, y0, x1, y1, step, s)


def _grid(depth: Float32, lens: Float64, x0: int, y0: int, x1: int, y1: int, step: int, s: ArmRegionSettings) -> Grid:  # noqa: PLR0917 - corners
    seen = np.empty(((y1 - y0 + step - 1) // step, (x1 - x0 + step - 1) // step))
    kernels().thinned(depth, x0, y0, step, s.near_m, s.far_m, seen)
    fx, fy, cx, cy = lens[:4]
    return Grid(seen, np.array([fx / step, fy / step, (cx - x0) / step, (cy - y0) / step]), step)


def region(grid: Grid, spheres: Float64, s: ArmRegionSettings) -> Region:
    """Segment an arm by region growing: seeds are surfaces near spheres along it, grown over connected surfaces.

    Args:
        grid: the depth image, from `grid_about` or `whole_grid`.
        spheres: (k, 5) centre and radius in the camera frame [m], and 1 for the hand or 0 for the arm.
        s: distances of the surfaces from the spheres.

    Returns:
        The region, in new arrays; it has no points if no surface is near the hand.
    """
    k, shape = kernels(), grid.seen.shape
    low, high, wide_low, wide_high = (np.empty(shape) for _ in range(4))
    hand = np.ascontiguousarray(spheres[spheres[:, 4] > 0])
    k.bands(hand, grid.lens, s.seed_m, s.seed_m, low, high)
    k.bands(np.ascontiguousarray(spheres[::_COARSER]), grid.lens, s.grow_m, s.arm_m, wide_low, wide_high)
    front = np.empty(shape)
    typical = float(np.median(spheres[:, 2]))
    k.grown(grid.seen, low, high, wide_low, wide_high, s.jump * typical, front)
    return evidence(grid, front, s)


def evidence(grid: Grid, front: Float64, s: ArmRegionSettings) -> Region:
    """Compute the points and the silhouette map of a segmented surface, and return them as a `Region`.

    Args:
        grid: the grid on which it was segmented; only its lens is used.
        front: (h, w) as in `Region`, which keeps this array, not a copy.
        s: largest number of points.
    """
    k = kernels()
    opposite = np.empty(front.shape, np.int64)
    k.opposite(front, opposite)
    points = np.empty((s.points, 3))
    count = k.unprojected(front, grid.lens, points)
    return Region(points[:count], front, opposite, grid.lens)


def others_edges(front: Float64, s: ArmRegionSettings) -> float:
    """Return the share of a surface's edges, 0 to 1, at which a nearer surface occludes it.

    Args:
        front: (h, w) as in `Region`.
        s: least difference in depth to a nearer surface.

    Returns:
        The share; 0 without edges.
    """
    return float(kernels().others_edges(front, s.nearer_m))


def palm_candidates(  # noqa: PLR0917 - of an image, in this order
    depth: Float32, lens: Float64, s: ArmRegionSettings, most: int = 6, near: Float64 | None = None,
    but: Float64 | None = None,
) -> Steps[list[PalmCandidate]]:  # fmt: skip
    """Search a depth image for palms and fists, in steps: surfaces as wide as a palm, at the end of an arm.

    Args:
        depth: (height, width) [m].
        lens: (4,) fx, fy, cx, cy [px], or (9,) with the distortion, which is not used.
        s: limits.
        most: greatest number of candidates.
        near: (3,) or (k, 3) points in the camera frame [m]; only candidates within 15 cm of one are returned, found on
            a coarser grid; None: the whole image is searched.
        but: None, or (k, 4) spheres, centre and radius in the camera frame [m]; candidates centred in one are left out.

    Returns:
        Steps (see `mocapella.steps`) whose result is the list of candidates, the likeliest first.
    """
    grid = whole_grid(depth, lens, max(round(depth.shape[1] / s.columns), 1), s)
    k, (height, width) = kernels(), grid.seen.shape
    labels = np.empty((height, width), np.int64)
    sizes = np.zeros(4096, np.int64)
    count = k.labelled(grid.seen, s.jump, labels, sizes)
    inner = np.empty((height, width))
    k.inner_distance(grid.seen, labels, grid.lens, inner)
    least, most_m = s.palm_radii_m
    yield _GRID
    places = [*(yield from _ends(grid, labels, inner, count, s)), *_peaks(inner, least, most_m, 2 * most)]
    finer = replace(s, spacing_m=(_FINE if near is None else _COARSE) * s.spacing_m)
    found: list[tuple[float, PalmCandidate]] = []
    for y, x in places:
        centre = _points(grid, np.array([y]), np.array([x]))[0]
        if near is not None and np.linalg.norm(near - centre, axis=-1).min() > _NEAR_M:
            continue
        if but is not None and within(centre, but):
            continue
        if all(np.linalg.norm(other.centre - centre) > 0.02 for _, other in found):
            candidate = _candidate(depth, lens, centre, float(inner[y, x]), finer)
            if candidate is not None:
                found.append(candidate)
            yield _LOOKED_AT if near is None else _LOOKED_AT_COARSELY
    found.sort(key=lambda pair: -pair[0])
    return [candidate for _, candidate in found[:most]]


def within(point: Float64, balls: Float64) -> bool:
    """Return whether a point (3,) is in any sphere of ``balls`` (k, 4 or more): centre (3), radius [m]; rest unused."""
    return bool((np.linalg.norm(balls[:, :3] - point, axis=1) < balls[:, 3]).any())


def _ends(grid: Grid, labels: Int64, inner: Float64, count: int, s: ArmRegionSettings) -> Steps[list[tuple[int, int]]]:
    """Return (row, column) of possible palms: 5 and 10 cm before the ends of surfaces, for fist and open hand."""
    k, places = kernels(), []
    pixel = (grid.seen / grid.lens[0]) ** 2
    areas = np.bincount(labels.ravel(), pixel.ravel(), count + 1)
    areas[0] = 0.0
    away, found = np.empty(grid.seen.shape), np.empty((_BRANCHES, 8))
    for label in np.argsort(-areas, kind="stable")[:_SURFACES]:
        if areas[label] < _LEAST_AREA_M2:
            break
        y, x = np.unravel_index(int(np.argmax(np.where(labels == label, inner, -1.0))), labels.shape)
        k.geodesic(grid.seen, grid.lens, _WIDE_JUMP * s.jump, y, x, 3.0, away)
        for end in found[: k.branches(grid.seen, away, grid.lens, _WIDE_JUMP * s.jump, 0.04, found)]:
            if end[2] < 0.12:
                continue
            for back in _BEFORE_END_M:
                # The thickest pixel at this distance from the end.
                ys, xs = np.nonzero((away > end[2] - back - 0.02) & (away < end[2] - back + 0.02))
                if len(ys):
                    at = _points(grid, ys, xs) - _points(grid, end[:1].astype(int), end[1:2].astype(int))
                    near = np.linalg.norm(at, axis=1) < 1.3 * back + 0.02
                    if near.any():
                        best = np.argmax(np.where(near, inner[ys, xs], -1.0))
                        places.append((int(ys[best]), int(xs[best])))
        yield _SURFACE
    return places


def _peaks(inner: Float64, least: float, most: float, count: int) -> list[tuple[int, int]]:
    """Return (row, column) of local maxima of the distance to the edge within least and most, the largest first."""
    height, width = inner.shape
    padded = np.pad(inner, 1)
    peak = (inner >= least) & (inner <= most)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            peak &= inner >= padded[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
    ys, xs = np.nonzero(peak)
    order = np.argsort(-inner[ys, xs], kind="stable")
    kept: list[tuple[int, int]] = []
    for i in order:
        y, x = int(ys[i]), int(xs[i])
        if all((y - a) ** 2 + (x - b) ** 2 > 9 for a, b in kept):
            kept.append((y, x))
        if len(kept) == count:
            break
    return kept


def _candidate(  # noqa: PLR0911 - each rejects for its own reason
    depth: Float32, lens: Float64, centre: Float64, radius: float, s: ArmRegionSettings
) -> tuple[float, PalmCandidate] | None:
    _, outer_m = s.forearm_m
    grid = grid_about(depth, lens, np.array([[*centre, outer_m, 1.0]]), s)
    if grid is None:
        return None
    k, (y, x) = kernels(), _pixel(grid, centre)
    if abs(grid.seen[y, x] - centre[2]) > 0.02:
        return None
    away = np.empty(grid.seen.shape)
    k.geodesic(grid.seen, grid.lens, s.jump, y, x, outer_m + 0.07, away)
    ys, xs = np.nonzero(away < np.inf)
    points, d = _points(grid, ys, xs), away[ys, xs]
    if (d < 0.05).sum() < 12:
        return None
    # The wall between two people can be as wide as a hand, but its edges belong to them.
    hidden = others_edges(np.where(away < np.inf, grid.seen, -grid.seen), s)
    if hidden > s.hidden:
        return None
    wide = _width_beyond(d, (points[:, 2] / grid.lens[0]) ** 2, s)
    if wide > s.widest_m:
        return None
    found = np.empty((_BRANCHES, 8))
    found = found[: k.branches(grid.seen, away, grid.lens, s.jump, s.branch_m, found)]
    kinds = _branch_kinds(found, s)
    if kinds is None:
        return None
    arm, finger = kinds
    ends, middles = _points(grid, *found[:, :2].T.astype(int)), _points(grid, *found[:, 5:7].T.astype(int))
    forearm = _forearm(found, arm, ends - centre, middles - centre, s)
    tips = ends[finger][np.argsort(-found[finger, 3], kind="stable")][:5]
    begin = np.array([0.0, 1.0, 0.0]) if forearm is None else forearm
    tips = tips[np.argsort([_turn(tip - centre, begin) for tip in tips], kind="stable")] if len(tips) else tips
    reach = d < (outer_m if forearm is not None else 0.2)
    chosen = points[reach][:: max(int(reach.sum()) // 300, 1)]
    spheres = np.ascontiguousarray(np.hstack([chosen, np.tile([0.01, 1.0], (len(chosen), 1))]))
    candidate = PalmCandidate(centre, radius, _normal(points[d < 0.05], centre), forearm, tips, spheres)
    return _score(candidate, wide, hidden), candidate


def _pixel(grid: Grid, point: Float64) -> tuple[int, int]:
    """Return (row, column) of the grid's pixel nearest to where a point (3,) is seen."""
    height, width = grid.seen.shape
    x = min(max(round(float(grid.lens[0] * point[0] / point[2] + grid.lens[2])), 0), width - 1)
    y = min(max(round(float(grid.lens[1] * point[1] / point[2] + grid.lens[3])), 0), height - 1)
    return y, x


def _width_beyond(away: Float64, area: Float64, s: ArmRegionSettings) -> float:
    """Return the mean width of a surface where there is only the forearm, beyond the fingers' reach [m].

    Args:
        away: (n,) distances of its pixels from the palm [m].
        area: (n,) their areas [m²].
        s: range of distances of the forearm; if the surface is as wide there as a body, this is no hand.
    """
    inner_m, outer_m = s.forearm_m
    return float(area[(away >= inner_m) & (away < outer_m)].sum() / (outer_m - inner_m))


def _normal(around: Float64, centre: Float64) -> Float64:
    """Return the unit normal of a surface's points (n, 3), towards the camera."""
    normal: Float64 = np.linalg.svd(around - around.mean(axis=0), full_matrices=False)[2][2]
    return -normal if normal @ centre > 0 else normal


def _branch_kinds(found: Float64, s: ArmRegionSettings) -> tuple[Bool, Bool] | None:
    """Return (n,) which branches of a surface are a forearm, and which fingers; None in the middle of an arm or body.

    Args:
        found: (n, 8) branches, as of `arm_region_kernels.branches`.
        s: reach and width of fingers.
    """
    long, own, wide = found[:, 2], found[:, 3], found[:, 4]
    # Fingers do not reach that far; a foreshortened forearm is still wider than a finger.
    arm = long >= s.forearm_m[0]
    if ((long >= s.forearm_m[0] + _SURELY_M) & (own > 0.08) & (wide > s.finger_m)).sum() > 1:
        return None
    if not arm.any():
        arm = (wide > s.finger_m) & (long > 0.08) & (own > 0.03)
    return arm, ~arm & (wide <= s.finger_m) & (own > 0.02) & (long > 0.05)


def _forearm(found: Float64, arm: Bool, ends: Float64, middles: Float64, s: ArmRegionSettings) -> Float64 | None:
    """Return the unit vector (3,) along the likeliest forearm; None without one.

    Args:
        found: (n, 8) branches, as of `arm_region_kernels.branches`.
        arm: (n,) which of them may be the forearm.
        ends, middles: (n, 3) from the palm to the branches' ends, and to the middles of their last 4 cm [m].
        s: reach of the fingers.
    """
    if not arm.any():
        return None
    long, wide = found[:, 2], found[:, 4]
    likely = long * np.minimum(wide, 0.05) + (long >= s.forearm_m[0] + _SURELY_M)
    which = int(np.argmax(np.where(arm, likely, -1.0)))
    towards = (middles if long[which] > s.forearm_m[0] else ends)[which]
    return np.asarray(towards / np.linalg.norm(towards))


def _score(of: PalmCandidate, wide_m: float, hidden: float) -> float:
    """Return how likely a candidate is a hand, by the width of its forearm and the hidden share of its edges."""
    score = 0.25 * len(of.tips) + (of.forearm is not None) - abs(of.radius_m - 0.038) / 0.02
    score -= max(wide_m - 0.10, 0.0) / 0.05
    return score - (3.0 * hidden + float(of.centre[2]))


def _points(grid: Grid, ys: Int64, xs: Int64) -> Float64:
    """Return (n, 3) points of pixels, camera [m]."""
    z = grid.seen[ys, xs]
    return np.stack([(xs - grid.lens[2]) * z / grid.lens[0], (ys - grid.lens[3]) * z / grid.lens[1], z], axis=-1)


def _turn(direction: Float64, begin: Float64) -> float:
    """Return the anticlockwise angle in the image, 0 to 2π; y is down."""
    angle = np.arctan2(-direction[1], direction[0]) - np.arctan2(-begin[1], begin[0])
    return float(angle % (2 * np.pi))


_GRID: Final = 1500
_SURFACE: Final = 2000
_LOOKED_AT: Final = 3000
_LOOKED_AT_COARSELY: Final = 1000
"""Cost of each step [µs]: the grid, a surface's ends, and a candidate on a fine and on a coarse grid."""
_SURFACES: Final = 6
"""Number of the largest surfaces that are searched for arms."""
_LEAST_AREA_M2: Final = 0.004
_WIDE_JUMP: Final = 1.8
"""Factor on the jump towards an arm's end, so that fingers in front of the palm stay connected to it."""
_BEFORE_END_M: Final = (0.05, 0.10)
_FINE: Final = 0.75
_COARSE: Final = 1.4
"""Factors on the spacing of a candidate's grid: anywhere, and near given points."""
_NEAR_M: Final = 0.15
_COARSER: Final = 3
"""Stride between spheres of the wide bands."""
_BRANCHES: Final = 24
_SURELY_M: Final = 0.02
"""A branch that reaches so much farther than fingers is surely no finger."""


@cache
def kernels() -> ModuleType:
    """Return the module `arm_region_kernels`; the first call imports it, and with it numba."""
    from mocapella.sensing import arm_region_kernels

    return arm_region_kernels
