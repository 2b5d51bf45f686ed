"""Choose the surface of each keypoint of a person in a depth image, compiled; importing this module imports numba.

The depths around a keypoint are divided into layers, such as an arm, the trunk behind it and the wall. Of all
combinations of layers, the one of least cost along the tree of limbs is chosen by dynamic programming, for each
distance of the trunk (P. Felzenszwalb, D. Huttenlocher, "Pictorial Structures for Object Recognition", IJCV 61(1),
2005, section 4). A limb costs where it is too long, and where the surface steps away from the line between its ends.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sensing.keypoint_limbs import KeypointLimbs

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

MOST_LAYERS: Final = 4
"""Greatest number of layers at a keypoint; farther ones are left out."""
NONE: Final = -1
"""Choice of a keypoint that is on no layer."""
STATURE_M: Final = 1.75
"""Stature that limbs are judged by [m]."""
_LONGEST: Final = 1.2
"""Greatest length of a limb, relative to that of `STATURE_M`."""
_SHORTEST: Final = 0.75
"""Least length of a limb, relative to the least of `STATURE_M`."""
_SHORT_COST: Final = 1.5
"""Cost of a limb that is too short."""
_LOOSE_M: Final = 0.06
"""Further length that errors of keypoints and flesh add [m]."""
_LENGTH_SD_M: Final = 0.08
"""Excess length of a limb that costs 1 [m]; the cost grows with its square."""
_SAMPLES: Final = 8
"""Number of places along a limb that are searched for steps of depth."""
_STEP_COST: Final = 4.0
"""Cost of a limb with steps everywhere; of a share of its length, that share."""
_RANK_COST: Final = 0.15
"""Cost of each nearer layer at the same keypoint."""
_SHARE_COST: Final = 0.6
"""Cost of a layer without any share of the depths at the keypoint."""
_NONE_COST: Final = 0.9
"""Cost of a keypoint on no layer whose limb begins at a known place."""
_NONE_AFTER_NONE: Final = 0.35
"""That after another one; both costs are multiplied by `_SURE` plus the detector's confidence."""
_SURE: Final = 0.4
"""Part of both costs for a confidence of 0."""
_AGAIN_COST: Final = 0.1
"""Cost of a keypoint on a layer after one on none."""
_REACH: Final = 0.5
"""Distance from the trunk's middle of keypoints whose limb begins at an unknown place, relative to the stature."""
_MOST_SAMPLES: Final = 400
"""Most depths at a keypoint that are sorted into layers."""
_ASIDE: Final = 0.6
"""What a layer's share is worth less if it is not at the keypoint's own pixels."""
_TAKEN_M: Final = 0.06
"""Distance from another person's flesh within which a surface is that person's [m]."""
_LEAST_SHARE: Final = 0.08
"""Least share of a layer in the depths at a keypoint."""
_LOW: Final = 0.3
"""Quantile of a layer's depths that stands for it: its middle is nearer than its sides."""


@njit(cache=True, error_model="numpy")
def gap_m(depth_m: float) -> float:
    """Return the step in depth that divides two layers at a distance [m]; a depth camera's noise grows with it."""
    return 0.05 + 0.006 * depth_m * depth_m


@njit(cache=True, error_model="numpy")
def nearest_about(depth: Float32, x: float, y: float, reach: int) -> float:
    """Return the least depth [m] in the square about a pixel with 2 · ``reach`` + 1 pixels a side; NaN without any."""
    height, width = depth.shape
    column, row, best = round(x), round(y), math.inf
    for v in range(max(row - reach, 0), min(row + reach + 1, height)):
        for u in range(max(column - reach, 0), min(column + reach + 1, width)):
            d = float(depth[v, u])
            if 0.0 < d < best:
                best = d
    return best if best < math.inf else math.nan


@njit(cache=True, error_model="numpy")
def nearest_to(depth: Float32, x: float, y: float, wanted_m: float) -> float:
    """Return the depth [m] next to ``wanted_m`` in the 3 × 3 pixels about a pixel; NaN without any."""
    height, width = depth.shape
    column, row, best = round(x), round(y), math.nan
    for v in range(max(row - 1, 0), min(row + 2, height)):
        for u in range(max(column - 1, 0), min(column + 2, width)):
            d = float(depth[v, u])
            if d > 0.0 and not abs(d - wanted_m) >= abs(best - wanted_m):
                best = d
    return best


@njit(cache=True, error_model="numpy")
def _middle_of(depth: Float32, x: float, y: float) -> float:
    """Return the median depth [m] of the 3 × 3 pixels about a pixel; NaN without any."""
    height, width = depth.shape
    column, row, count = round(x), round(y), 0
    values = np.empty(9)
    for v in range(max(row - 1, 0), min(row + 2, height)):
        for u in range(max(column - 1, 0), min(column + 2, width)):
            if depth[v, u] > 0:
                values[count] = depth[v, u]
                count += 1
    return np.sort(values[:count])[count // 2] if count else math.nan


@njit(cache=True, error_model="numpy")
def layers_at(depth: Float32, x: float, y: float, radius_px: float, layers: Float64, shares: Float64) -> int:
    """Divide the depths in a disc into layers, the nearest first; return their number.

    Args:
        depth: (height, width) [m]; 0 where not measured.
        x, y: the disc's centre [px].
        radius_px: its radius [px].
        layers: (`MOST_LAYERS`,) written: depth of each layer [m]; NaN beyond the last.
        shares: (`MOST_LAYERS`,) written: its share of the disc's measured pixels, less `_ASIDE` if it is not at the
            centre.
    """
    height, width = depth.shape
    reach = math.ceil(radius_px)
    step = max(1, math.ceil(2.0 * reach / 20.0))
    column, row, count = round(x), round(y), 0
    values = np.empty(_MOST_SAMPLES + 50)
    for v in range(row - reach, row + reach + 1, step):
        for u in range(column - reach, column + reach + 1, step):
            inside = 0 <= v < height and 0 <= u < width and (u - x) ** 2 + (v - y) ** 2 <= radius_px * radius_px + 0.5
            if inside and depth[v, u] > 0 and count < _MOST_SAMPLES:
                values[count] = depth[v, u]
                count += 1
    middle = _middle_of(depth, x, y)
    for k in range(MOST_LAYERS):
        layers[k], shares[k] = math.nan, 0.0
    if count == 0:
        return 0
    found = np.sort(values[:count])
    least, number, first = max(2.0 if count > 3 else 1.0, _LEAST_SHARE * count), 0, 0
    for k in range(1, count + 1):
        if k < count and found[k] - found[k - 1] <= gap_m(found[k - 1]):
            continue
        if k - first >= least and number < MOST_LAYERS:
            layers[number] = found[first + int(_LOW * (k - 1 - first))]
            shares[number] = (k - first) / count - (0.0 if found[first] <= middle <= found[k - 1] else _ASIDE)
            number += 1
        first = k
    return number


@njit(cache=True, error_model="numpy")
def _drop_taken(x: float, y: float, flesh_m: float, taken: Float64, layers: Float64, shares: Float64) -> None:
    """Remove the layers at a keypoint with the ray (x, y, 1) that are limbs of people who were found before."""
    kept = 0
    for j in range(MOST_LAYERS):
        if math.isnan(layers[j]):
            break
        z = layers[j] + flesh_m
        free = True
        for k in range(len(taken)):
            if away_m(x * z, y * z, z, taken[k]) < taken[k, 6] + _TAKEN_M:
                free = False
                break
        if free:
            layers[kept], shares[kept] = layers[j], shares[j]
            kept += 1
    for j in range(kept, MOST_LAYERS):
        layers[j], shares[j] = math.nan, 0.0


@njit(cache=True, error_model="numpy")
def away_m(x: float, y: float, z: float, limb: Float64) -> float:
    """Return the distance [m] of a point from a limb's axis: a segment with the ends ``limb[:3]`` and ``limb[3:6]``."""
    ux, uy, uz = limb[3] - limb[0], limb[4] - limb[1], limb[5] - limb[2]
    px, py, pz = x - limb[0], y - limb[1], z - limb[2]
    squared = ux * ux + uy * uy + uz * uz
    t = min(max((px * ux + py * uy + pz * uz) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return math.sqrt((px - t * ux) ** 2 + (py - t * uy) ** 2 + (pz - t * uz) ** 2)


@njit(cache=True, error_model="numpy")
def steps_along(
    depth: Float32, a_px: Float64, a_m: float, b_px: Float64, b_m: float, width_px: float, tolerance_m: float
) -> float:
    """Return the share, 0 to 1, of the line between two points of a surface at which the surface is somewhere else.

    1 / z is linear along a line's image. At each sample, also its neighbours across the line count.

    Args:
        depth: (height, width) [m]; 0 where not measured; such samples are left out.
        a_px, a_m: (2,) the first end [px], and its depth [m].
        b_px, b_m: the other end.
        width_px: distance of the neighbours [px].
        tolerance_m: greatest deviation in depth [m].
    """
    dx, dy = b_px[0] - a_px[0], b_px[1] - a_px[1]
    length = math.hypot(dx, dy)
    if length < 4.0:
        return 0.0
    across_x, across_y = -dy / length * width_px, dx / length * width_px
    off, seen = 0.0, 0
    for k in range(1, _SAMPLES + 1):
        t = k / (_SAMPLES + 1)
        wanted = 1.0 / ((1.0 - t) / a_m + t / b_m)
        best = math.nan
        for side in (0.0, -1.0, 1.0):
            x, y = a_px[0] + t * dx + side * across_x, a_px[1] + t * dy + side * across_y
            d = nearest_to(depth, x, y, wanted)
            if not math.isnan(d) and not abs(d - wanted) >= abs(best - wanted):
                best = d
        if not math.isnan(best):
            seen += 1
            off += 1.0 if abs(best - wanted) > tolerance_m else 0.0
    return off / seen if seen else 0.0


@njit(cache=True, error_model="numpy")
def _own_cost(rank: int, share: float) -> float:
    return _RANK_COST * rank + _SHARE_COST * (1.0 - share)


@njit(cache=True, error_model="numpy")
def _limb_costs(
    depth: Float32, focal_px: float, limbs: KeypointLimbs, rays: Float64, pixels: Float64, layers: Float64,
    costs: Float64,
) -> None:  # fmt: skip
    """Write the costs (n, layers of the parent, layers) of each limb that begins at a keypoint."""
    for child in range(len(pixels)):
        parent = limbs.parent[child]
        if parent < 0:
            continue
        longest = _LONGEST * limbs.length[child] * STATURE_M + _LOOSE_M
        shortest = _SHORTEST * limbs.shortest[child] * STATURE_M
        flesh = max(limbs.radius[child], limbs.radius[parent]) * STATURE_M
        for i in range(MOST_LAYERS):
            for j in range(MOST_LAYERS):
                a, b = layers[parent, i], layers[child, j]
                if math.isnan(a) or math.isnan(b):
                    costs[child, i, j] = math.inf
                    continue
                x, y = b * rays[child, 0] - a * rays[parent, 0], b * rays[child, 1] - a * rays[parent, 1]
                long = math.sqrt(x * x + y * y + (b - a) ** 2)
                over = long - longest
                cost = (over / _LENGTH_SD_M) ** 2 if over > 0 else 0.0
                cost += _SHORT_COST if long < shortest else 0.0
                if cost < 25.0:
                    tolerance = flesh + gap_m(0.5 * (a + b))
                    width = 0.6 * limbs.radius[child] * STATURE_M * focal_px / b
                    cost += _STEP_COST * steps_along(depth, pixels[parent], a, pixels[child], b, width, tolerance)
                costs[child, i, j] = cost


@njit(cache=True, error_model="numpy")
def _trunk_cost(length: float, depth_m: float, trunk_m: float) -> float:
    """Return the cost of a keypoint that hangs on the trunk, by its distance in depth from the trunk's middle."""
    away = abs(depth_m - trunk_m) / (length * STATURE_M)
    return away * away if away <= 1.0 else 1.0 + 16.0 * (away - 1.0)


@njit(cache=True, error_model="numpy")
def _best_for(
    trunk_m: float, limbs: KeypointLimbs, confidences: Float64, layers: Float64, shares: Float64, costs: Float64,
    chosen: Int64,
) -> float:  # fmt: skip
    """Write the layers of least cost for a distance of the trunk; return the cost."""
    n = len(chosen)
    none = MOST_LAYERS
    best = np.zeros((n, MOST_LAYERS + 1))
    pick = np.full((n, MOST_LAYERS + 1), NONE, np.int64)
    below = np.zeros((n, MOST_LAYERS + 1))
    roots = 0.0
    for k in range(n - 1, -1, -1):
        child = limbs.order[k]
        parent = limbs.parent[child]
        there = not math.isnan(layers[child, 0])
        for i in range(MOST_LAYERS + 1):
            if parent >= 0 and i < none and math.isnan(layers[parent, i]):
                continue
            if parent < 0 and i > 0:
                break
            free = parent >= 0 and i == none
            alone = 0.0 if not there else _NONE_AFTER_NONE if free else _NONE_COST
            least, which = alone * (_SURE + confidences[child]) + below[child, none], NONE
            for j in range(MOST_LAYERS):
                if math.isnan(layers[child, j]):
                    break
                cost = _own_cost(j, shares[child, j]) + below[child, j]
                if parent >= 0 and not free:
                    cost += costs[child, i, j]
                else:
                    length = _REACH if free else limbs.length[child]
                    cost += (_AGAIN_COST if free else 0.0) + _trunk_cost(length, layers[child, j], trunk_m)
                if cost < least:
                    least, which = cost, j
            best[child, i], pick[child, i] = least, which
            if parent >= 0:
                below[parent, i] += least
            else:
                roots += least
    for k in range(n):
        child = limbs.order[k]
        parent = limbs.parent[child]
        at = 0 if parent < 0 else none if chosen[parent] == NONE else chosen[parent]
        chosen[child] = pick[child, at]
    return roots


@njit(cache=True, error_model="numpy")
def choose_layers(
    depth: Float32, focal_px: float, limbs: KeypointLimbs, rays: Float64, pixels: Float64, confidences: Float64,
    taken: Float64, layers: Float64, shares: Float64, chosen: Int64,
) -> float:  # fmt: skip
    """Write the layer of each keypoint of a person; return the depth of the trunk's middle [m], NaN without a trunk.

    Args:
        depth: (height, width) [m], in the camera of the keypoints; 0 where not measured.
        focal_px: focal length of this camera [px].
        limbs: limbs of the topology.
        rays: (n, 2) x/z and y/z of each keypoint.
        pixels: (n, 2) x, y in the image [px].
        confidences: (n,) of the detector.
        taken: (m, 7) limbs of other people, whose surface this person cannot have: both ends and the radius [m].
        layers: (n, `MOST_LAYERS`) written: depths at each keypoint [m], the nearest first; NaN beyond the last.
        shares: (n, `MOST_LAYERS`) written: weight of each layer, see `layers_at`.
        chosen: (n,) written: the keypoint's layer; `NONE` if it is on none.
    """
    n = len(pixels)
    for k in range(n):
        chosen[k] = NONE
        for j in range(MOST_LAYERS):
            layers[k, j], shares[k, j] = math.nan, 0.0
        if math.isnan(pixels[k, 0]) or math.isnan(rays[k, 0]):
            continue
        near = nearest_about(depth, pixels[k, 0], pixels[k, 1], 3)
        if not math.isnan(near):
            radius = 0.8 * max(limbs.radius[k], 0.012) * STATURE_M * focal_px / near
            layers_at(depth, pixels[k, 0], pixels[k, 1], min(max(radius, 1.5), 20.0), layers[k], shares[k])
            _drop_taken(rays[k, 0], rays[k, 1], limbs.radius[k] * STATURE_M, taken, layers[k], shares[k])
    costs = np.full((n, MOST_LAYERS, MOST_LAYERS), math.inf)
    _limb_costs(depth, focal_px, limbs, rays, pixels, layers, costs)
    least, middle = math.inf, math.nan
    trial = np.empty(n, np.int64)
    for k in range(n):
        for j in range(MOST_LAYERS):
            if not limbs.trunk[k] or math.isnan(layers[k, j]):
                continue
            cost = _best_for(layers[k, j], limbs, confidences, layers, shares, costs, trial)
            if cost < least:
                least, middle = cost, layers[k, j]
                for i in range(n):
                    chosen[i] = trial[i]
    return middle
