"""The part of a depth image that may be an arm: its images' laws, and palms that are found on drawn arms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import distance_transform_edt, label
from support.drawn_arms import CAMERA, DISTANCE_M, arm

from mocapella.errors import SettingsError
from mocapella.model.arms import ELBOW, PALM
from mocapella.model.hand import TIPS
from mocapella.sensing import arm_region_kernels as k
from mocapella.sensing.arm_region import (
    ArmRegionSettings,
    Grid,
    evidence,
    grid_about,
    palm_candidates,
    region,
    whole_grid,
)
from mocapella.steps import at_once

SETTINGS = ArmRegionSettings()
LENS = np.array([150.0, 150.0, 40.0, 30.0])
masks = arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 14)))


def test_edges_are_of_the_nearer_thing_across_what_was_not_measured() -> None:
    """Of a surface before others none is theirs, of one that shows between them all, whatever their shadows."""
    front = np.full((20, 30), -1.5)
    front[6:14, 8:22] = 0.7
    assert k.others_edges(front, 0.02) == 0.0
    front[6:14, 4:8] = front[2:6] = 0.0  # shadows on what is behind
    assert k.others_edges(front, 0.02) == 0.0
    between = np.where(front == 0.7, 2.0, -0.9)
    between[6:14, 8:11] = between[6:14, 19:22] = 0.0
    assert k.others_edges(between, 0.02) == 1.0
    half = np.where(front == 0.7, 1.0, -2.0)
    half[:, 15:] = np.where(front[:, 15:] == 0.7, 1.0, -0.5)
    assert 0.3 < k.others_edges(half, 0.02) < 0.7
    assert k.others_edges(np.full((5, 5), 0.8), 0.02) == 0.0
    assert k.others_edges(np.where(front == 0.7, 0.7, -0.69), 0.02) == 0.0


@given(masks)
def test_the_opposite_column_is_the_nearest_in_its_line(mask: np.ndarray) -> None:
    out = np.empty(mask.shape, np.int64)
    k.opposite(np.where(mask, 0.5, -0.7), out)
    for i, j in np.ndindex(mask.shape):
        other = np.flatnonzero(mask[i] != mask[i, j])
        if len(other):
            assert mask[i, out[i, j]] != mask[i, j]
            assert abs(out[i, j] - j) == np.abs(other - j).min()
        else:
            assert out[i, j] == -1


@given(masks)
def test_surfaces_of_one_depth_are_the_connected_parts(mask: np.ndarray) -> None:
    labels, sizes = np.empty(mask.shape, np.int64), np.zeros(4096, np.int64)
    count = k.labelled(np.where(mask, 0.5, 0.0), 0.025, labels, sizes)
    expected, many = label(mask)
    np.testing.assert_array_equal(labels, expected)
    assert count == many
    np.testing.assert_array_equal(sizes[1 : count + 1], np.bincount(expected.ravel(), minlength=count + 1)[1:])


def test_a_jump_in_depth_parts_surfaces_and_a_slope_does_not() -> None:
    slope = np.tile(np.linspace(0.5, 0.9, 41), (3, 1))
    jump = np.where(np.arange(41) < 20, 0.5, 0.514)[None].repeat(3, axis=0)
    labels, sizes = np.empty(slope.shape, np.int64), np.zeros(10, np.int64)
    assert k.labelled(slope, 0.025, labels, sizes) == 1
    assert k.labelled(jump, 0.025, labels, sizes) == 2
    assert sizes[1:3].tolist() == [60, 63]


def test_no_more_surfaces_are_told_than_there_is_room_for() -> None:
    seen = np.where((np.arange(20) % 2 == 0)[None], 0.5, 0.0)
    labels, sizes = np.empty(seen.shape, np.int64), np.zeros(5, np.int64)
    assert k.labelled(seen, 0.025, labels, sizes) == 4
    assert labels.max() == 4


@settings(max_examples=30)
@given(arrays(np.bool_, (17, 19), elements=st.sampled_from([True, True, True, False])))
def test_the_inner_distance_is_that_from_the_edge_as_well_as_chamfers_know_it(mask: np.ndarray) -> None:
    """5-7-11 is right to 2 % in each direction; the edge's own pixels are 1 away. The image's edge is none."""
    seen, out = np.where(mask, 0.6, 0.0), np.empty(mask.shape)
    labels, _ = label(mask)
    k.inner_distance(seen, labels.astype(np.int64), LENS, out)
    assert (out[~mask] == 0).all()
    if mask.all():
        assert out.min() > 1.0
        return
    edge = np.pad(mask, 1, mode="edge")
    at_edge = mask & ~(edge[:-2, 1:-1] & edge[2:, 1:-1] & edge[1:-1, :-2] & edge[1:-1, 2:])
    for part in range(1, labels.max() + 1):
        own = labels == part
        if not (own & at_edge).any():
            continue
        to_edge = distance_transform_edt(~(own & at_edge))
        told = out[own] * LENS[0] / 0.6 - 1
        assert (told >= 0.97 * to_edge[own] - 1e-9).all()
        assert (told[to_edge[own] <= 1] <= to_edge[own][to_edge[own] <= 1] + 1e-9).all()


def test_the_middle_of_a_disc_is_its_radius_from_the_edge() -> None:
    y, x = np.mgrid[:61, :61]
    mask = (y - 30) ** 2 + (x - 30) ** 2 <= 20**2
    out = np.empty(mask.shape)
    k.inner_distance(np.where(mask, 0.75, 0.0), mask.astype(np.int64), LENS, out)
    assert np.unravel_index(out.argmax(), out.shape) == (30, 30)
    assert out.max() == pytest.approx(20 * 0.75 / 150.0, rel=0.05)


def tilted(slope_x: float, slope_y: float, shape: tuple[int, int] = (61, 81)) -> np.ndarray:
    """A plane at 0.6 m, z = 0.6 + slope_x x + slope_y y, as the camera of `LENS` sees it."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(0.6 / (1 - slope_x * (x - LENS[2]) / LENS[0] - slope_y * (y - LENS[3]) / LENS[1]))


def unprojected(seen: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[: seen.shape[0], : seen.shape[1]]
    return np.stack([(x - LENS[2]) * seen / LENS[0], (y - LENS[3]) * seen / LENS[1], seen], axis=-1)


@settings(max_examples=15)
@given(st.floats(-1, 1), st.floats(-1, 1))
def test_on_a_plane_geodesic_distances_are_straight_ones(slope_x: float, slope_y: float) -> None:
    """Never shorter, and as much longer as eight neighbours make it: a part of 1 / cos 22.5° on a frontal plane."""
    seen = tilted(slope_x, slope_y)
    out = np.empty(seen.shape)
    k.geodesic(seen, LENS, 0.1, 30, 40, 10.0, out)
    points = unprojected(seen)
    straight = np.linalg.norm(points - points[30, 40], axis=-1)
    assert (out >= straight - 1e-9).all()
    assert (out <= straight * 1.6 + 1e-9).all()
    if max(abs(slope_x), abs(slope_y)) < 0.3:
        assert (out <= straight / np.cos(np.pi / 8) * 1.06 + 1e-9).all()


def test_geodesic_distances_go_round_a_jump_and_end_where_they_should() -> None:
    seen = np.full((21, 21), 0.6)
    seen[:15, 10] = 0.0
    out = np.empty(seen.shape)
    k.geodesic(seen, LENS, 0.025, 2, 5, 10.0, out)
    step = 0.6 / 150.0
    assert out[2, 15] > 25 * step  # straight it would be 10
    assert np.isinf(out[2, 10])
    seen[:, 10:] = 0.66
    k.geodesic(seen, LENS, 0.025, 2, 5, 10.0, out)
    assert np.isinf(out[:, 10:]).all()
    k.geodesic(seen, LENS, 0.025, 10, 5, 3.5 * step, out)
    assert out[10, 8] == pytest.approx(3 * step)
    assert np.isinf(out[10, 9])


def test_the_branches_of_a_cross_are_its_arms() -> None:
    seen = np.zeros((61, 81))
    seen[27:34, 10:71] = 0.6  # 30 px to either side of (30, 40)
    seen[10:51, 37:44] = 0.6  # 20 up and down
    step, away = 0.6 / 150.0, np.empty(seen.shape)
    k.geodesic(seen, LENS, 0.025, 30, 40, 10.0, away)
    found = np.empty((24, 8))
    found = found[: k.branches(seen, away, LENS, 0.025, 0.02, found)]
    assert len(found) == 4
    np.testing.assert_allclose(np.sort(found[:, 2]), np.sort([20, 20, 30, 30]) * step, atol=2 * step)
    longest = found[np.argmax(found[:, 3])]
    assert longest[3] == pytest.approx(longest[2])  # nothing reaches farther
    others = np.sort(found[:, 3])[:3]
    np.testing.assert_allclose(others, np.array([17, 17, 27]) * step, atol=3 * step)
    np.testing.assert_allclose(found[:, 4], 7 * step, rtol=0.15)  # as wide as they were drawn
    assert not found[:, 7].any()
    middles = np.hypot(found[:, 5] - 30, found[:, 6] - 40)
    np.testing.assert_allclose(middles, found[:, 2] / step - 5, atol=2.5)


def test_branches_shorter_than_the_least_are_none_and_the_images_edge_is_told() -> None:
    seen = np.zeros((31, 61))
    seen[12:19, :50] = 0.6
    seen[8:12, 29:33] = 0.6
    step, away = 0.6 / 150.0, np.empty(seen.shape)
    k.geodesic(seen, LENS, 0.025, 15, 30, 10.0, away)
    found = np.empty((24, 8))
    assert k.branches(seen, away, LENS, 0.025, 0.02, found) == 2
    at_edge = found[:2][np.argsort(found[:2, 1]), 7]
    assert at_edge.tolist() == [1.0, 0.0]
    assert k.branches(seen, away, LENS, 0.025, 2 * step, found) >= 3
    assert k.branches(seen, away, LENS, 0.025, 0.02, found[:1]) == 1
    assert found[0, 3] == away[np.isfinite(away)].max()


def thin(depth: np.ndarray, step: int = 4) -> np.ndarray:
    height, width = depth.shape
    out = np.empty(((height + step - 1) // step, (width + step - 1) // step))
    k.thinned(depth.astype(np.float32), 0, 0, step, 0.2, 2.0, out)
    return out


@settings(max_examples=20)
@given(st.floats(0.25, 1.9), st.integers(1, 6))
def test_a_flat_surface_stays_what_it_is(distance: float, step: int) -> None:
    np.testing.assert_allclose(thin(np.full((13, 17), distance), step), distance, rtol=1e-6)


def test_holes_are_closed_flying_pixels_and_what_is_out_of_range_left_out() -> None:
    depth = np.full((24, 24), 0.6)
    depth[8, 8] = 0.0  # one pixel: its surroundings say enough
    depth[13:20, 13:20] = 0.0  # all around (16, 16)
    depth[4, 16] = 0.9  # stands alone
    depth[20, 4] = 2.5
    depth[20, 20] = 0.1
    out = thin(depth)
    assert out[2, 2] == pytest.approx(0.6)
    assert out[4, 4] == 0.0
    assert out[1, 4] == 0.0
    assert out[5, 1] == pytest.approx(0.6)  # in range around it
    assert not thin(np.full((8, 8), 2.1)).any()
    assert not thin(np.full((8, 8), 0.19)).any()
    noisy = thin(np.where(np.indices((24, 24)).sum(axis=0) % 2, 0.605, 0.595))
    assert np.abs(noisy - 0.6).max() < 0.002  # the mean of the surroundings


def grown(seen: np.ndarray, balls: np.ndarray, s: ArmRegionSettings = SETTINGS) -> np.ndarray:
    """Where the region is, of a grid whose lens is `LENS`."""
    return region(Grid(seen, LENS, 1), balls, s).front > 0


def test_bands_are_of_the_spheres_and_their_gates() -> None:
    low, high = np.empty((61, 81)), np.empty((61, 81))
    k.bands(
        np.array([[0.0, 0, 0.6, 0.01, 1.0], [0.1, 0.0, 0.6, 0.01, 0.0], [0, 0, 0.05, 0.5, 1]]),
        LENS,
        0.02,
        0.01,
        low,
        high,
    )
    assert (low[30, 40], high[30, 40]) == (pytest.approx(0.57), pytest.approx(0.63))
    assert (low[30, 65], high[30, 65]) == (pytest.approx(0.58), pytest.approx(0.62))
    assert np.isinf(low[0, 0])
    assert high[0, 0] == 0
    reach = np.flatnonzero(high[30, :53]) - 40
    assert abs(reach).max() == 7  # 0.03 m at 0.6 m are 7.5 px


def test_a_finger_before_the_palm_belongs_and_a_torso_behind_does_not() -> None:
    seen = np.full((61, 81), 0.71)  # the torso, 8 cm behind the palm's surface
    seen[20:41, 30:51] = 0.63
    seen[26:40, 38:42] = 0.59  # a finger, 4 cm before it …
    seen[26:40, 42:45] = 0.0  # … with its shadow
    seen[26:40, 36:38] = 0.0
    seen[25, 36:45] = 0.0
    seen[40, 36:45] = 0.0
    seen[2:6, 2:6] = 0.63  # something else
    y, x = np.mgrid[-9:10:3, -9:10:3] * 0.004
    balls = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.64), np.full(x.size, 0.01), np.ones(x.size)], axis=1)
    where = grown(seen, balls)
    assert where[28:39, 38:42].all()
    assert where[21:25, 31:50].all()
    np.testing.assert_array_equal(where, (seen > 0) & (seen < 0.7) & (np.indices(seen.shape)[0] > 10))
    nearer = np.where(seen == 0.59, 0.5, seen)  # 13 cm before the palm it is something else
    assert not grown(nearer, balls)[28:39, 38:42].any()


def test_what_is_joined_grows_only_so_far_from_where_the_arm_was() -> None:
    seen = np.zeros((61, 81))
    seen[28:33] = 0.6
    balls = np.array([[0.0, 0, 0.61, 0.01, 1.0]])
    reach = np.flatnonzero(grown(seen, balls)[30]) - 40
    assert abs(abs(reach).max() - 0.09 / 0.61 * 150) < 1.5
    short = np.flatnonzero(grown(seen, balls, replace(SETTINGS, grow_m=0.04))[30]) - 40
    assert abs(abs(short).max() - 0.05 / 0.61 * 150) < 1.5


@settings(max_examples=20)
@given(arrays(np.float64, (9, 11), elements=st.sampled_from([0.0, 0.5, -0.6])), st.integers(50, 60))
def test_evidence_is_the_points_of_the_surface_thinned_evenly(front: np.ndarray, points: int) -> None:
    grid = Grid(np.abs(front), LENS, 1)
    told = evidence(grid, front, replace(SETTINGS, points=points))
    there = unprojected(front)[front > 0]
    every = max(-(-len(there) // points), 1)
    np.testing.assert_allclose(told.points, there[::every])
    assert len(told.points) <= points


def test_a_grid_keeps_rays_where_they_are() -> None:
    scene = arm(rotation_degrees=30)
    x, y, z = scene.truth[TIPS[2]]
    about = grid_about(scene.depth, CAMERA.lens, np.array([[x, y, z, 0.02, 1.0]]), SETTINGS)
    assert about is not None
    for grid in (about, whole_grid(scene.depth, CAMERA.lens, 3, SETTINGS)):
        u, v = grid.lens[0] * x / z + grid.lens[2], grid.lens[1] * y / z + grid.lens[3]
        assert grid.seen[round(float(v)), round(float(u))] == pytest.approx(z - 0.0085, abs=0.003)
        assert grid.lens[0] * grid.step == pytest.approx(CAMERA.lens[0])
    assert about.step == 2  # 4 mm at 0.8 m
    assert grid_about(scene.depth, CAMERA.lens, np.array([[3.0, 0, 0.8, 0.02, 1.0]]), SETTINGS) is None
    assert grid_about(scene.depth, CAMERA.lens, np.array([[0.0, 0, 0.05, 0.02, 1.0]]), SETTINGS) is None


@pytest.mark.parametrize("degrees", [0, 50, 90, 135, 180, -70])
@pytest.mark.parametrize("behind_m", [0.0, 1.3])
def test_the_palm_of_a_drawn_arm_is_found(degrees: int, behind_m: float) -> None:
    scene = arm(rotation_degrees=degrees, behind_m=behind_m)
    candidates = at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS))
    best, truth = candidates[0], scene.truth
    off = [np.linalg.norm(one.centre - truth[PALM] + [0, 0, 0.014]) for one in candidates]
    assert off[0] < 0.04  # along the hand its middle is not known well
    assert min(off[:2]) < 0.025
    assert best.forearm is not None
    along = truth[ELBOW] - truth[PALM]
    assert np.degrees(np.arccos(best.forearm @ along / np.linalg.norm(along))) < 10
    assert len(best.tips) >= 4
    order = [int(np.linalg.norm(truth[[*TIPS]] - tip, axis=1).argmin()) for tip in best.tips]
    assert order in (sorted(order), sorted(order, reverse=True))
    assert len(set(order)) == len(order)
    apart = np.linalg.norm(truth[[*TIPS]][order] - best.tips, axis=1)
    assert apart.max() < 0.02
    assert best.normal @ [0, 0, -1] > 0.8
    assert 0.024 < best.radius_m < 0.062
    assert (np.linalg.norm(best.spheres[:, :3] - best.centre, axis=1) < 0.25).all()


def test_the_order_of_tips_is_the_same_however_the_arm_is_turned() -> None:
    rising = set()
    for degrees in (0, 90, 120, 180, -120):
        scene = arm(rotation_degrees=degrees)
        tips = at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS))[0].tips
        order = [int(np.linalg.norm(scene.truth[[*TIPS]] - tip, axis=1).argmin()) for tip in tips]
        rising.add(order == sorted(order))
    assert len(rising) == 1


def test_a_fist_has_a_palm_and_hardly_tips() -> None:
    scene = arm("fist", rotation_degrees=-45)
    best = at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS))[0]
    assert np.linalg.norm((best.centre - scene.truth[PALM])[:2]) < 0.03
    assert len(best.tips) <= 1


def test_where_nothing_is_like_a_hand_there_is_no_candidate() -> None:
    nothing = np.zeros((480, 640), np.float32)
    wall = np.full((480, 640), 1.0, np.float32)
    ball = nothing.copy()
    ball[238:243, 318:323] = 0.8
    for depth in (nothing, wall, ball):
        assert at_once(palm_candidates(depth, CAMERA.lens, SETTINGS)) == []


def test_candidates_are_near_where_they_are_wanted_and_so_many_at_most() -> None:
    scene = arm()
    everywhere = at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS))
    assert len(at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS, most=1))) == 1
    assert len(everywhere) >= 1
    here = at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS, near=scene.truth[PALM]))
    assert here
    assert all(np.linalg.norm(one.centre - scene.truth[PALM]) <= 0.15 for one in here)
    assert at_once(palm_candidates(scene.depth, CAMERA.lens, SETTINGS, near=np.array([0.6, 0.0, DISTANCE_M]))) == []


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("near_m", (0.0, 2.0, -1.0)), ("far_m", (0.2, 20.1)),
        *((name, (0.0, 1.0)) for name in ("spacing_m", "seed_m", "grow_m", "arm_m", "jump", "widest_m", "finger_m",
          "branch_m")),
        ("palm_radii_m", ((0.0, 0.05), (0.05, 0.04), (0.05, 0.2))), ("forearm_m", ((0.0, 0.2), (0.2, 0.1), (0.2, 1.0))),
        ("columns", (15, 4097)), ("points", (49, 100_001)),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(name: str, values: tuple[Any, ...]) -> None:
    for value in values:
        with pytest.raises(SettingsError, match="near_m" if name == "far_m" else name):
            replace(SETTINGS, **{name: value})
