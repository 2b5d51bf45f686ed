"""Joints of a person from the surfaces of the keypoints, with their states, compiled; importing it imports numba.

`mocapella.sensing.keypoint_layer_kernels` chooses the surfaces.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sensing.keypoint_layer_kernels import (
    MOST_LAYERS,
    NONE,
    choose_layers,
    gap_m,
    nearest_to,
)
from mocapella.sensing.keypoint_limbs import KeypointLimbs

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

NOT_TRACKED, INFERRED, TRACKED = 0, 1, 2
"""States of `mocapella.model.observations.JointState`."""
VISIBLE, COVERED, BEHIND, FAR, LOST = 0, 1, 2, 3, 4
"""How a keypoint's surface is seen: whole; found beside a thing in front; not, but another part of the body before it;
not, but its own limb, which points at the camera; not at all."""
USUAL_M: Final = 1.7
"""Stature while too few limbs are seen to measure it [m]."""
_STATURES_M: Final = (0.7, 2.3)
"""Least and greatest stature of a person; a body outside is a picture or a mistake [m]."""
_LIMBS_FOR_STATURE: Final = 3
"""Least number of limbs that measure a stature."""
_MORE: Final = 0.2
"""Further confidence of a tracked joint whose limb begins at a joint out of view."""
_STEEP: Final = 0.5
"""Least sine of the angle between limb and line of sight that the flesh is divided by."""
_HEAD: Final = (0.05, 0.043)
"""Distance from the face to the middle of the head, and from there to an ear, relative to the stature."""


@njit(cache=True, error_model="numpy")
def _has_edge(depth: Float32, pixel: Float64, other: Float64, surface_m: float, flesh_m: float, half_px: float) -> bool:
    """Return whether the surface falls off on a side of a limb near a joint, as the outline of a limb in view does.

    Args:
        depth: (height, width) [m]; 0 where not measured.
        pixel: (2,) the joint [px].
        other: (2,) another place on the limb's axis [px].
        surface_m: depth of the joint's surface [m].
        flesh_m: radius of the limb [m].
        half_px: half the limb's breadth [px].
    """
    dx, dy = other[0] - pixel[0], other[1] - pixel[1]
    length = math.hypot(dx, dy)
    if not length > 1.5 * half_px:  # it points at the camera
        return True
    height, width = depth.shape
    fall = max(0.5 * flesh_m, 0.4 * gap_m(surface_m))
    for side in (-1.0, 1.0):
        for far in (1.4, 1.8):
            away = side * (far * half_px + 1.5)
            x, y = pixel[0] - away * dy / length, pixel[1] + away * dx / length
            if not (0 <= x < width and 0 <= y < height):
                return True
            d = nearest_to(depth, x, y, surface_m)
            if math.isnan(d) or d > surface_m + fall:
                return True
    return False


@njit(cache=True, error_model="numpy")
def _is_covered(depth: Float32, pixel: Float64, surface_m: float) -> bool:
    """Return whether most of the 3 × 3 pixels about a keypoint are in front of its surface."""
    height, width = depth.shape
    column, row, front, seen = round(pixel[0]), round(pixel[1]), 0, 0
    for v in range(max(row - 1, 0), min(row + 2, height)):
        for u in range(max(column - 1, 0), min(column + 2, width)):
            if depth[v, u] > 0:
                seen += 1
                front += depth[v, u] < surface_m - gap_m(surface_m)
    return seen > 0 and 2 * front > seen


@njit(cache=True, error_model="numpy")
def _partner(limbs: KeypointLimbs, pixels: Float64, k: int) -> int:
    """Return another keypoint on the axis of a keypoint's limb: its parent, else a child; -1 without."""
    parent = limbs.parent[k]
    if parent >= 0 and not math.isnan(pixels[parent, 0]):
        return int(parent)
    for child in range(len(pixels)):
        if limbs.parent[child] == k and not math.isnan(pixels[child, 0]):
            return child
    return -1


@njit(cache=True, error_model="numpy")
def _views(
    depth: Float32, focal_px: float, limbs: KeypointLimbs, pixels: Float64, confidences: Float64, surfaces: Float64,
    views: UInt8,
) -> None:  # fmt: skip
    """Write how each keypoint's surface is seen."""
    n = len(pixels)
    for k in range(n):
        views[k] = LOST
        if math.isnan(surfaces[k]):
            continue
        views[k] = COVERED if _is_covered(depth, pixels[k], surfaces[k]) else VISIBLE
        half_px = limbs.breadth[k] * USUAL_M * focal_px / surfaces[k]
        other = _partner(limbs, pixels, k)
        if half_px > 0 and other >= 0:
            flesh = limbs.radius[k] * USUAL_M
            if not _has_edge(depth, pixels[k], pixels[other], surfaces[k], flesh, half_px):
                views[k] = BEHIND
    for i in range(n):
        for j in range(i + 1, n):
            if not _on_one_surface(focal_px, limbs, pixels, surfaces, views, i, j):
                continue
            if limbs.trunk[i] != limbs.trunk[j]:  # a limb before the trunk
                views[i if limbs.trunk[i] else j] = BEHIND
            elif abs(confidences[i] - confidences[j]) > 0.1:
                views[i if confidences[i] < confidences[j] else j] = BEHIND
            else:
                views[i] = views[j] = COVERED


@njit(cache=True, error_model="numpy")
def _on_one_surface(
    focal_px: float, limbs: KeypointLimbs, pixels: Float64, surfaces: Float64, views: UInt8, i: int, j: int
) -> bool:
    """Return whether two keypoints of different limbs were taken for the same piece of surface."""
    if views[i] > COVERED or views[j] > COVERED or not (limbs.breadth[i] > 0 or limbs.breadth[j] > 0):
        return False
    pi, pj = limbs.parent[i], limbs.parent[j]
    if pi == j or pj == i or (pi == pj and pi >= 0) or limbs.radius[i] == 0 or limbs.radius[j] == 0:
        return False
    share = 1.4 if limbs.mirror[i] == j else 0.7  # left and right limb at one place are one limb
    near_px = share * max(limbs.radius[i], limbs.radius[j]) * USUAL_M * focal_px / surfaces[i]
    apart = math.hypot(pixels[i, 0] - pixels[j, 0], pixels[i, 1] - pixels[j, 1])
    return bool(apart < near_px and abs(surfaces[i] - surfaces[j]) < gap_m(surfaces[i]))


@njit(cache=True, error_model="numpy")
def _into_flesh(
    limbs: KeypointLimbs, rays: Float64, surfaces: Float64, views: UInt8, stature_m: float, positions: Float64
) -> None:
    """Write the joints' centres: from the surface, along the line of sight, to the limb's axis."""
    n = len(rays)
    for k in range(n):
        if views[k] > COVERED:
            continue
        x, y, s = rays[k, 0], rays[k, 1], surfaces[k]
        norm = math.sqrt(x * x + y * y + 1.0)
        other = limbs.parent[k]
        steep = 1.0
        if other >= 0 and views[other] <= COVERED and limbs.breadth[k] > 0:
            t = surfaces[other]
            bx, by, bz = s * x - t * rays[other, 0], s * y - t * rays[other, 1], s - t
            long = math.sqrt(bx * bx + by * by + bz * bz)
            if long > 0.05:
                along = (bx * x + by * y + bz) / (long * norm)
                steep = max(math.sqrt(max(0.0, 1.0 - along * along)), _STEEP)
        z = s + limbs.radius[k] * stature_m / (steep * norm)
        positions[k, 0], positions[k, 1], positions[k, 2] = x * z, y * z, z


@njit(cache=True, error_model="numpy")
def _apart(positions: Float64, i: int, j: int) -> float:
    """Return the distance of two joints [m]."""
    x, y = positions[i, 0] - positions[j, 0], positions[i, 1] - positions[j, 1]
    return math.sqrt(float(x * x + y * y + (positions[i, 2] - positions[j, 2]) ** 2))


@njit(cache=True, error_model="numpy")
def _stature_m(limbs: KeypointLimbs, views: UInt8, positions: Float64) -> float:
    """Return the median stature that the visible limbs tell [m]; NaN with fewer than three."""
    n, count = len(views), 0
    found = np.empty(n)
    for k in range(n):
        parent = limbs.parent[k]
        if limbs.scaled[k] and views[k] == VISIBLE and views[parent] == VISIBLE:
            found[count] = _apart(positions, k, parent) / limbs.length[k]
            count += 1
    if count < _LIMBS_FOR_STATURE:
        return math.nan
    values = np.sort(found[:count])
    return float(0.5 * (values[(count - 1) // 2] + values[count // 2]))


@njit(cache=True, error_model="numpy")
def _hide_short(limbs: KeypointLimbs, confidences: Float64, stature_m: float, positions: Float64, views: UInt8) -> None:
    """Update how ends of limbs are seen that would be too short: the surface at the far end is another object's."""
    n = len(views)
    for step in range(n):
        k = limbs.order[step]
        parent = limbs.parent[k]
        least = limbs.shortest[k] * stature_m
        if parent < 0 or least == 0 or views[k] > COVERED or views[parent] > COVERED:
            continue
        if _apart(positions, k, parent) < least:
            if limbs.scaled[k] and positions[k, 2] < positions[parent, 2] - 0.05:
                views[parent] = FAR
            else:
                views[k] = BEHIND
    for k in range(n):
        other = limbs.mirror[k]
        if not limbs.trunk[k] or other <= k or views[k] > COVERED or views[other] > COVERED:
            continue
        if _apart(positions, k, other) < 0.6 * limbs.width[k] * stature_m:
            if abs(confidences[k] - confidences[other]) > 0.1:
                views[k if confidences[k] < confidences[other] else other] = BEHIND
            else:
                views[k] = views[other] = COVERED


@njit(cache=True, error_model="numpy")
def _reached(ray: Float64, start: Float64, length_m: float, least_m: float) -> float:
    """Return the depth [m] on a ray at which a limb of a length ends that begins at ``start``.

    It is next to the middle of what the limb reaches, but at least ``least_m`` as far as the limb reaches.
    """
    rr = ray[0] * ray[0] + ray[1] * ray[1] + 1.0
    middle = (ray[0] * start[0] + ray[1] * start[1] + start[2]) / rr
    aside = start[0] * start[0] + start[1] * start[1] + start[2] * start[2] - middle * middle * rr
    free = length_m * length_m - aside
    far = middle + math.sqrt(free / rr) if free > 0 else middle
    return float(max(middle, min(least_m, far)))


@njit(cache=True, error_model="numpy")
def _beside(limbs: KeypointLimbs, rays: Float64, views: UInt8, positions: Float64, k: int, stature_m: float) -> float:
    """Return the depth [m] of a shoulder or hip behind its mirror image, by their distance; NaN without one in view."""
    other = limbs.mirror[k]
    if not limbs.trunk[k] or other == k or views[other] > COVERED:
        return math.nan
    z = positions[other, 2]
    wide, apart = limbs.width[k] * stature_m, math.hypot(rays[k, 0] - rays[other, 0], rays[k, 1] - rays[other, 1]) * z
    return float(z + math.sqrt(max(0.0, wide * wide - apart * apart)))


@njit(cache=True, error_model="numpy")
def _behind_child(
    limbs: KeypointLimbs, rays: Float64, views: UInt8, positions: Float64, k: int, stature_m: float
) -> float:
    """Return the depth [m] of a joint behind the other end of its limb; NaN if that is not in view."""
    for child in range(len(views)):
        if limbs.parent[child] == k and views[child] <= COVERED and limbs.scaled[child]:
            return float(_reached(rays[k], positions[child], limbs.length[child] * stature_m, math.inf))
    return math.nan


@njit(cache=True, error_model="numpy")
def _infer(
    limbs: KeypointLimbs, rays: Float64, surfaces: Float64, views: UInt8, stature_m: float, middle_m: float,
    positions: Float64,
) -> None:  # fmt: skip
    """Write the places of keypoints without a surface of their own: on their rays, from the joints next to them."""
    n = len(rays)
    trunk_m, count = 0.0, 0
    for k in range(n):
        if limbs.trunk[k] and views[k] <= COVERED:
            trunk_m += positions[k, 2]
            count += 1
    trunk_m = trunk_m / count if count else middle_m
    for step in range(n):
        k = limbs.order[step]
        if views[k] <= COVERED or math.isnan(rays[k, 0]):
            continue
        least = surfaces[k] + 2.0 * limbs.radius[k] * stature_m if views[k] == BEHIND else -math.inf
        parent, z = limbs.parent[k], math.nan
        length = limbs.length[k] * stature_m
        if views[k] == FAR:
            z = _behind_child(limbs, rays, views, positions, k, stature_m)
        elif parent < 0:
            z = _beside(limbs, rays, views, positions, k, stature_m)
            z = max(trunk_m, min(least, trunk_m + length)) if math.isnan(z) else z
        elif not math.isnan(positions[parent, 2]):
            z = _reached(rays[k], positions[parent], length, least)
            for child in range(n):
                if limbs.parent[child] == k and views[child] <= COVERED and limbs.scaled[child]:
                    z = 0.5 * (positions[parent, 2] + positions[child, 2])
        if not math.isnan(z):
            positions[k, 0], positions[k, 1], positions[k, 2] = rays[k, 0] * z, rays[k, 1] * z, z


@njit(cache=True, error_model="numpy")
def _place_head(
    limbs: KeypointLimbs, rays: Float64, surfaces: Float64, stature_m: float, middle_m: float, views: UInt8,
    positions: Float64,
) -> None:  # fmt: skip
    """Write the ears, at both sides of the middle of the head, and hide the far ear, or the face of a back view.

    The ears of a head turned aside lie behind each other; the nose tells which of them is near.
    """
    nose, left, right = limbs.head[0], limbs.head[1], limbs.head[2]
    if left < 0 or right < 0 or math.isnan(rays[left, 0]) or math.isnan(rays[right, 0]):
        return
    face = math.inf
    for k in (nose, left, right):
        if k >= 0 and views[k] <= COVERED and abs(surfaces[k] - middle_m) < 0.3 * stature_m:
            face = min(face, surfaces[k])
    if face == math.inf:
        return
    dx, dy = rays[left, 0] - rays[right, 0], rays[left, 1] - rays[right, 1]
    centre = face + _HEAD[0] * stature_m
    wide, apart = 2.0 * _HEAD[1] * stature_m, math.hypot(dx, dy) * centre
    behind = 0.5 * math.sqrt(max(0.0, wide * wide - apart * apart))
    aside = 0.0 if nose < 0 else rays[nose, 0] - 0.5 * (rays[left, 0] + rays[right, 0])
    if math.isnan(aside):
        aside = 0.0
    near_left = aside < 0
    if behind > 0.4 * wide:
        views[right if near_left else left] = BEHIND
        eye = limbs.head[4] if near_left else limbs.head[3]
        if eye >= 0 and views[eye] <= COVERED:
            views[eye] = BEHIND
    for k, sign in ((left, -1.0 if near_left else 1.0), (right, 1.0 if near_left else -1.0)):
        z = centre + sign * behind
        positions[k, 0], positions[k, 1], positions[k, 2] = rays[k, 0] * z, rays[k, 1] * z, z
    if dx < 0.1 * wide / centre:  # the left ear is at the left: the face looks away
        for k in range(len(rays)):
            if limbs.parent[k] < 0 and limbs.radius[k] == 0 and k not in (left, right) and views[k] <= COVERED:
                views[k] = BEHIND
                z = centre + _HEAD[0] * stature_m
                positions[k, 0], positions[k, 1], positions[k, 2] = rays[k, 0] * z, rays[k, 1] * z, z


@njit(cache=True, error_model="numpy")
def lift_person(
    depth: Float32, focal_px: float, limbs: KeypointLimbs, rays: Float64, pixels: Float64, confidences: Float64,
    taken: Float64, sure: float, positions: Float64, states: UInt8,
) -> float:  # fmt: skip
    """Find a person's keypoints in space; return the stature [m], NaN if the person is not found.

    Args:
        depth: (height, width) [m], in the camera of the keypoints; 0 where not measured.
        focal_px: focal length of this camera [px].
        limbs: limbs of the topology.
        rays: (n, 2) x/z and y/z of each keypoint; NaN where not seen.
        pixels: (n, 2) x, y in the image [px]; NaN where not seen.
        confidences: (n,) of the detector.
        taken: (m, 7) limbs of people who were found before, see `limbs_of`.
        sure: least confidence of a tracked joint; one whose limb begins at a hidden joint needs `_MORE` more.
        positions: (n, 3) written: camera frame, x right, y down, z out of the lens [m]; NaN where not tracked.
        states: (n,) written.
    """
    n = len(pixels)
    layers, shares = np.empty((n, MOST_LAYERS)), np.empty((n, MOST_LAYERS))
    chosen, surfaces, views = np.empty(n, np.int64), np.full(n, math.nan), np.empty(n, np.uint8)
    for k in range(n):
        positions[k, 0] = positions[k, 1] = positions[k, 2] = math.nan
        states[k] = NOT_TRACKED
    middle_m = choose_layers(depth, focal_px, limbs, rays, pixels, confidences, taken, layers, shares, chosen)
    if math.isnan(middle_m):
        return math.nan
    for k in range(n):
        if chosen[k] != NONE:
            surfaces[k] = layers[k, chosen[k]]
    _views(depth, focal_px, limbs, pixels, confidences, surfaces, views)
    stature = USUAL_M
    _into_flesh(limbs, rays, surfaces, views, stature, positions)
    measured = _stature_m(limbs, views, positions)
    if not math.isnan(measured):
        if not _STATURES_M[0] <= measured <= _STATURES_M[1]:
            for k in range(n):
                positions[k, 0] = positions[k, 1] = positions[k, 2] = math.nan
            return math.nan
        stature = measured
    _hide_short(limbs, confidences, stature, positions, views)
    for k in range(n):
        positions[k, 0] = positions[k, 1] = positions[k, 2] = math.nan
    _into_flesh(limbs, rays, surfaces, views, stature, positions)
    _infer(limbs, rays, surfaces, views, stature, middle_m, positions)
    _place_head(limbs, rays, surfaces, stature, middle_m, views, positions)
    for k in range(n):
        if not math.isnan(positions[k, 2]):
            parent = limbs.parent[k]
            wanted = sure + (_MORE if parent >= 0 and views[parent] != VISIBLE else 0.0)
            states[k] = TRACKED if views[k] == VISIBLE and confidences[k] >= wanted else INFERRED
    return stature


@njit(cache=True, error_model="numpy")
def limbs_of(limbs: KeypointLimbs, positions: Float64, stature_m: float, out: Float64) -> int:
    """Write a person's limbs, in the form that `lift_person` takes for other people; return their number.

    Args:
        limbs: limbs of the topology.
        positions: (n, 3) joints [m]; NaN where not tracked.
        stature_m: the person's stature [m].
        out: (m, 7) written: both ends and the radius [m]; (n + 36, 7) is large enough.
    """
    n, count = len(positions), 0
    for k in range(n):
        for other in range(n):
            joined = limbs.parent[k] == other or (limbs.trunk[k] and limbs.trunk[other] and other < k)
            if not joined or math.isnan(positions[k, 2]) or math.isnan(positions[other, 2]) or count >= len(out):
                continue
            for axis in range(3):
                out[count, axis], out[count, 3 + axis] = positions[k, axis], positions[other, axis]
            out[count, 6] = max(limbs.radius[k], limbs.radius[other]) * stature_m
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def register(
    depth: Float32, rays: Float64, T_colour_depth: Float64, focal_px: Float64, splat: int, out: Float32
) -> None:
    """Draw a depth image as a pinhole camera elsewhere would see it; nearer surfaces hide farther ones.

    Args:
        depth: (height, width) [m]; 0 where not measured.
        rays: (height, width, 2) x/z and y/z of its pixels; NaN outside its lens model.
        T_colour_depth: (4, 4) from the depth camera's frame to the other one's.
        focal_px: (4,) fx, fy, cx, cy of the other camera, without distortion [px].
        splat: side of the square that a pixel covers in the other image [px].
        out: (height, width) written [m]; 0 where nothing is seen.
    """
    height, width = out.shape
    for v in range(height):
        for u in range(width):
            out[v, u] = np.float32(0.0)
    T = T_colour_depth
    low = (splat - 1) // 2
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = float(depth[v, u])
            a, b = rays[v, u, 0], rays[v, u, 1]
            if not d > 0.0 or math.isnan(a):
                continue
            z = d * (T[2, 0] * a + T[2, 1] * b + T[2, 2]) + T[2, 3]
            if not z > 0.0:
                continue
            x = (d * (T[0, 0] * a + T[0, 1] * b + T[0, 2]) + T[0, 3]) / z
            y = (d * (T[1, 0] * a + T[1, 1] * b + T[1, 2]) + T[1, 3]) / z
            column, row = round(focal_px[0] * x + focal_px[2]) - low, round(focal_px[1] * y + focal_px[3]) - low
            for j in range(max(row, 0), min(row + splat, height)):
                for i in range(max(column, 0), min(column + splat, width)):
                    if out[j, i] == 0.0 or z < out[j, i]:
                        out[j, i] = np.float32(z)
