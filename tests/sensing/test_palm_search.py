"""The search for palms, part by part: which pixels are looked at, what branches are, and what makes a hand likely."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.drawn_arms import CAMERA, arm

from mocapella.model.arms import ELBOW, PALM
from mocapella.model.hand import TIPS
from mocapella.sensing import arm_region
from mocapella.sensing.arm_region import ArmRegionSettings, Grid, PalmCandidate, grid_about, palm_candidates, within
from mocapella.steps import at_once

SETTINGS = ArmRegionSettings()
LENS = np.array([100.0, 150.0, 40.5, 30.5])
"""Its focal lengths differ, and its axis is in the middle of pixels, so that ends of spheres are not at borders."""
EMPTY = np.zeros((80, 100), np.float32)
GRID_LENS = np.array([150.0, 150.0, 60.0, 40.0])


def corners(grid: Grid | None, lens: np.ndarray = LENS) -> tuple[int, ...]:
    """Columns and rows of the image from which and up to which a grid of step 1 goes."""
    assert grid is not None
    x, y = round(lens[2] - grid.lens[2]), round(lens[3] - grid.lens[3])
    return x, x + grid.seen.shape[1], y, y + grid.seen.shape[0]


def ball(x: float, y: float, z: float, radius: float) -> np.ndarray:
    return np.array([[x, y, z, radius, 1.0]])


def test_a_grid_shows_each_sphere_with_its_margin_whatever_its_distance() -> None:
    """A margin of 8 cm and a radius of 2 cm are 10 px to either side at 1 m, and 15 px down."""
    s = replace(SETTINGS, spacing_m=0.001)
    near, far = ball(0.0, 0.0, 1.0, 0.02), ball(0.32, 0.16, 2.0, 0.02)
    assert corners(grid_about(EMPTY, LENS, near, s)) == (30, 51, 15, 46)
    assert corners(grid_about(EMPTY, LENS, far, s)) == (51, 62, 35, 51)  # (56.5, 42.5) and half as much
    assert corners(grid_about(EMPTY, LENS, np.vstack([near, far]), s)) == (30, 62, 15, 51)
    behind = np.vstack([near, ball(9.0, 9.0, -1.0, 5.0), ball(0.0, 0.0, 0.1, 5.0)])
    assert corners(grid_about(EMPTY, LENS, behind, s)) == (30, 51, 15, 46)
    assert corners(grid_about(EMPTY, LENS, ball(0.0, 0.0, 1.0, 9.0), s)) == (0, 100, 0, 80)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("px", "there"), [(8, True), (7, False)])
def test_less_than_eight_pixels_of_the_image_are_no_grid(axis: int, px: int, there: bool) -> None:
    depth = EMPTY[:px] if axis else EMPTY[:, :px]
    assert (grid_about(depth, LENS, ball(0.0, 0.0, 1.0, 9.0), SETTINGS) is not None) == there


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("there", [True, False])
def test_of_a_sphere_at_the_far_border_eight_pixels_must_be_seen(axis: int, there: bool) -> None:
    lens = LENS.copy()
    lens[2 + axis] = (102.5, 87.5)[axis] + (not there)  # its near end is 10 px or 15 px before that
    assert (grid_about(EMPTY, lens, ball(0.0, 0.0, 1.0, 0.02), SETTINGS) is not None) == there


@pytest.mark.parametrize(("z", "step"), [(1.0, 4), (2.0, 2), (0.5, 8), (0.25, 8), (1.98, 2), (8.0, 1)])
def test_a_grids_points_are_so_far_apart_on_the_arm_but_between_one_and_eight_pixels(z: float, step: int) -> None:
    spheres = np.vstack([ball(0.0, 0.0, z, 1.0), ball(0.0, 0.0, z, 1.0), ball(0.0, 0.0, 19.0, 1.0)])
    grid = grid_about(EMPTY, LENS, spheres, replace(SETTINGS, spacing_m=0.04))
    assert grid is not None
    assert grid.step == step
    np.testing.assert_allclose(grid.lens[:2], LENS[:2] / step)


@given(st.integers(8, 40), st.integers(8, 40), st.integers(1, 5))
def test_a_grids_last_pixels_are_those_of_the_image_that_its_step_meets(width: int, height: int, step: int) -> None:
    grid = arm_region.whole_grid(np.zeros((height, width), np.float32), LENS, step, SETTINGS)
    assert grid.seen.shape == (len(range(0, height, step)), len(range(0, width, step)))
    np.testing.assert_allclose(grid.lens * step, LENS)


def test_a_part_of_an_image_shows_its_points_where_the_whole_shows_them() -> None:
    x0, y0, step = 12, 8, 2
    part = arm_region._grid(EMPTY, LENS, x0, y0, 40, 36, step, SETTINGS)
    at = np.array([0.1, -0.05, 0.8])
    whole = LENS[:2] * at[:2] / at[2] + LENS[2:]
    np.testing.assert_allclose((part.lens[:2] * at[:2] / at[2] + part.lens[2:]) * step + [x0, y0], whole)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.5, 1.9))
def test_the_pixel_of_a_point_shows_that_point(x: float, y: float, z: float) -> None:
    grid = Grid(np.full((80, 120), z), GRID_LENS, 1)
    row, column = arm_region._pixel(grid, np.array([x, y, z]))
    (found,) = arm_region._points(grid, np.array([row]), np.array([column]))
    clipped = np.clip(np.array([x, y]) / z * 150 + [60, 40], 0, [119, 79]) - [60, 40]
    np.testing.assert_allclose(found[:2] / z * 150, clipped, atol=0.5 + 1e-9)
    assert found[2] == z


def test_a_point_is_within_a_ball_up_to_its_surface() -> None:
    balls = np.array([[0.0, 0, 0, 5.0, 1.0], [20.0, 0, 0, 1.0, 0.0]])
    for point, there in (((3.0, 3.9, 0.0), True), ((3.0, 4.0, 0.0), False), ((20.0, 0.0, -0.9), True),
                         ((15.0, 0.0, 0.0), False), ((-3.0, -3.9, 0.0), True)):  # fmt: skip
        assert within(np.array(point), balls) == there


def test_peaks_are_the_largest_distances_within_the_limits_the_largest_first() -> None:
    inner = np.zeros((20, 30))
    peaks = {(0, 0): 0.03, (4, 10): 0.05, (10, 20): 0.02, (19, 29): 0.06, (15, 3): 0.061, (10, 4): 0.019}
    for at, value in peaks.items():
        inner[at] = value
    assert arm_region._peaks(inner, 0.02, 0.06, 9) == [(19, 29), (4, 10), (0, 0), (10, 20)]
    assert arm_region._peaks(inner, 0.02, 0.06, 3) == [(19, 29), (4, 10), (0, 0)]


@pytest.mark.parametrize("down", [-1, 0, 1])
@pytest.mark.parametrize("along", [-1, 0, 1])
def test_a_pixel_beside_a_larger_distance_is_no_peak(down: int, along: int) -> None:
    inner = np.full((11, 13), 0.001)
    inner[5, 6] = 0.03
    for larger in (0.04, 0.09):  # also beside one above the limit
        if down or along:
            inner[5 + down, 6 + along] = larger
            assert (5, 6) not in arm_region._peaks(inner, 0.02, 0.06, 9)


@pytest.mark.parametrize(("off", "kept"), [((3, 0), 1), ((0, 3), 1), ((3, 1), 2), ((1, 3), 2), ((-3, -1), 2)])
def test_of_peaks_within_three_pixels_one_is_kept(off: tuple[int, int], kept: int) -> None:
    inner = np.zeros((20, 20))
    inner[10, 10], inner[10 + off[0], 10 + off[1]] = 0.05, 0.04
    found = arm_region._peaks(inner, 0.02, 0.06, 9)
    assert len(found) == kept
    assert found[0] == (10, 10)


def test_the_width_of_a_strip_is_measured_where_only_the_forearm_can_be() -> None:
    away = np.arange(0.0005, 0.4, 0.001)
    for wide in (0.05, 0.2):
        assert arm_region._width_beyond(away, np.full(len(away), 0.001 * wide), SETTINGS) == pytest.approx(wide)
    inner, outer = SETTINGS.forearm_m
    at = np.array([np.nextafter(inner, 0), inner, np.nextafter(outer, 0), outer])
    for k, counts in enumerate((False, True, True, False)):
        assert (arm_region._width_beyond(at[k : k + 1], np.ones(1), SETTINGS) > 0) == counts


@given(st.integers(0, 1000))
def test_the_normal_of_a_plane_is_at_right_angles_to_it_and_towards_the_camera(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), 1.0])
    first, second = rng.normal(size=(2, 3))
    points = centre + rng.uniform(-0.05, 0.05, (40, 2)) @ np.stack([first, second])
    normal = arm_region._normal(points, centre)
    np.testing.assert_allclose([normal @ first, normal @ second, np.linalg.norm(normal)], [0, 0, 1], atol=1e-9)
    assert normal @ centre <= 0


def branches(*rows: tuple[float, float, float]) -> np.ndarray:
    """Branches of that reach, own length and width [m]."""
    found = np.zeros((len(rows), 8))
    found[:, 2:5] = rows
    return found


FOREARM, FINGER = (0.23, 0.23, 0.06), (0.12, 0.06, 0.018)


@pytest.mark.parametrize(
    ("branch", "kind"),
    [
        (FINGER, "finger"),
        ((0.12, 0.06, 0.027), "finger"),  # as wide as a finger may be
        ((0.12, 0.06, 0.0271), ""),
        ((0.12, 0.021, 0.018), "finger"),
        ((0.12, 0.02, 0.018), ""),
        ((0.051, 0.04, 0.018), "finger"),
        ((0.05, 0.04, 0.018), ""),
        ((0.15, 0.06, 0.018), "arm"),  # fingers do not reach so far
        ((0.149, 0.06, 0.018), "finger"),
    ],
)
def test_beside_a_forearm_a_branch_is_a_finger_if_it_is_as_narrow_and_as_long_as_one(branch: Any, kind: str) -> None:
    kinds = arm_region._branch_kinds(branches(FOREARM, branch), SETTINGS)
    assert kinds is not None
    assert [flags.tolist() for flags in kinds] == [[True, kind == "arm"], [False, kind == "finger"]]


@pytest.mark.parametrize(
    ("branch", "is_arm"),
    [
        ((0.12, 0.06, 0.05), True), ((0.12, 0.06, 0.027), False), ((0.081, 0.06, 0.05), True),
        ((0.08, 0.06, 0.05), False), ((0.12, 0.031, 0.05), True), ((0.12, 0.03, 0.05), False),
    ],
)  # fmt: skip
def test_without_a_long_branch_a_wide_one_is_the_foreshortened_forearm(branch: Any, is_arm: bool) -> None:
    kinds = arm_region._branch_kinds(branches(FINGER, branch), SETTINGS)
    assert kinds is not None
    assert kinds[0].tolist() == [False, is_arm]
    assert kinds[1][0]


@pytest.mark.parametrize(
    ("other", "middle"),
    [
        (FOREARM, True), ((0.15 + 0.02, 0.09, 0.06), True), ((0.169, 0.09, 0.06), False), ((0.2, 0.081, 0.06), True),
        ((0.2, 0.08, 0.06), False), ((0.2, 0.09, 0.0271), True), ((0.2, 0.09, 0.027), False),
    ],
)  # fmt: skip
def test_two_long_wide_branches_are_of_the_middle_of_an_arm(other: Any, middle: bool) -> None:
    assert (arm_region._branch_kinds(branches(FOREARM, other, FINGER), SETTINGS) is None) == middle


def test_the_forearm_is_the_longest_and_widest_branch_and_surely_one_beyond_the_fingers() -> None:
    towards = np.array([[3.0, 0, 0], [0, 4.0, 0], [0, 0, 5.0]])
    every = np.ones(3, np.bool_)

    def chosen(*rows: tuple[float, float, float], arm: Any = every) -> Any:
        found = arm_region._forearm(branches(*rows), arm, -towards, towards, SETTINGS)
        return None if found is None else found.tolist()

    assert chosen((0.16, 0, 0.04), (0.16, 0, 0.05), (0.16, 0, 0.03)) == [0, 1, 0]
    assert chosen((0.16, 0, 0.04), (0.155, 0, 0.04), (0.165, 0, 0.04)) == [0, 0, 1]
    assert chosen((0.16, 0, 0.05), (0.165, 0, 0.5), (0.155, 0, 0.9)) == [0, 1, 0], "above 5 cm width is no more"
    assert chosen((0.165, 0, 0.032), (0.155, 0, 0.04), (0.155, 0, 0.03)) == [0, 1, 0], "width counts like length"
    assert chosen((0.17, 0, 0.01), (0.169, 0, 0.05), (0.169, 0, 0.05)) == [1, 0, 0]
    assert chosen((0.16, 0, 0.04), (0.17, 0, 0.05), (0.2, 0, 0.01), arm=~every | (towards[:, 0] > 0)) == [1, 0, 0]
    assert chosen((0.16, 0, 0.04), (0.17, 0, 0.05), (0.2, 0, 0.01), arm=~every) is None
    shorter = (0.12, 0.06, 0.05), (0.11, 0.06, 0.05), (0.1, 0.06, 0.01)
    assert chosen(*shorter) == [-1, 0, 0], "a foreshortened one leads to its end"


USUAL = PalmCandidate(np.array([0.1, 0.2, 0.7]), 0.038, np.zeros(3), np.zeros(3), np.zeros((4, 3)), np.zeros((0, 5)))


def test_a_candidate_is_likelier_with_more_fingers_a_forearm_a_palms_size_and_nearer() -> None:
    def gain(wide_m: float = 0.08, hidden: float = 0.0, **changed: Any) -> float:
        return arm_region._score(USUAL._replace(**changed), wide_m, hidden) - arm_region._score(USUAL, 0.08, 0.0)

    assert gain(tips=np.zeros((5, 3))) == pytest.approx(0.25)
    assert gain(forearm=None) == pytest.approx(-1)
    assert gain(radius_m=0.048) == gain(radius_m=0.028) == pytest.approx(-0.5)
    assert gain(centre=np.array([0.3, -0.4, 1.2])) == pytest.approx(-0.5)
    assert gain(hidden=0.2) == pytest.approx(-0.6)
    assert gain(wide_m=0.1) == gain(wide_m=0.0) == 0
    assert gain(wide_m=0.15) == pytest.approx(-1)


@given(st.floats(-3, 3), st.floats(0, 6.28), st.floats(0.1, 3), st.floats(0.1, 3))
def test_a_turn_is_the_angle_by_which_the_picture_shows_a_direction_turned(
    at: float, turn: float, size: float, depth: float
) -> None:
    begin = size * np.array([np.cos(at), -np.sin(at), depth])  # y is down
    turned = np.array([np.cos(at + turn), -np.sin(at + turn), -depth])
    assert np.exp(1j * arm_region._turn(turned, begin)) == pytest.approx(np.exp(1j * turn))
    assert 0 <= arm_region._turn(turned, begin) <= 2 * np.pi


def rod(half: int = 45, wide: int = 15) -> Grid:
    """A rod at 0.6 m, 4 mm a pixel, that reaches so many pixels from its thicker middle to both ends, to each side."""
    y, x = np.mgrid[-60:61, -60:61]
    there = (np.abs(y) <= wide // 2) & (np.abs(x) <= half) | (np.hypot(x, y) <= wide // 2 + 2)
    return Grid(np.where(there, 0.6, 0.0), np.array([150.0, 150.0, 60.0, 60.0]), 1)


def ends_of(grid: Grid) -> list[tuple[int, int]]:
    k = arm_region.kernels()
    labels, sizes = np.empty(grid.seen.shape, np.int64), np.zeros(4096, np.int64)
    count = k.labelled(grid.seen, SETTINGS.jump, labels, sizes)
    inner = np.empty(grid.seen.shape)
    k.inner_distance(grid.seen, labels, grid.lens, inner)
    return at_once(arm_region._ends(grid, labels, inner, count, SETTINGS))


@pytest.mark.parametrize("turns", range(4))
def test_palms_are_sought_five_and_ten_centimetres_before_both_ends_of_a_rod(turns: int) -> None:
    """Or as near to it as the rod is thickest, here at 33 and 20 pixels from its middle."""
    grid = rod()
    for column in (20, 33):
        grid.seen[51:70, 60 + column - 2 : 63 + column] = grid.seen[51:70, 58 - column : 63 - column] = 0.6
    places = np.array(ends_of(grid._replace(seen=np.rot90(grid.seen, turns).copy()))) - 60
    along, across = places[:, 1 - turns % 2], places[:, turns % 2]
    assert np.abs(across).max() <= 1
    for side in (-1, 1):
        before = np.sort((45 - side * along[side * along > 0]) * 0.004)
        np.testing.assert_allclose(before, [0.05, 0.10], atol=0.009)


@pytest.mark.parametrize(("half", "wide", "some"), [(32, 9, True), (27, 9, False), (45, 3, True), (40, 1, False)])
def test_an_end_is_twelve_centimetres_from_the_middle_of_a_surface_of_forty_square_ones(
    half: int, wide: int, some: bool
) -> None:
    assert bool(ends_of(rod(half, wide))) == some


@pytest.mark.parametrize(("nearer", "joined"), [(0.035, True), (0.06, False)])
def test_fingers_in_front_of_a_rod_are_its_end_if_the_jump_is_less_than_twice_the_usual(
    nearer: float, joined: bool
) -> None:
    """It reaches 18 cm with its last 6, and else 12, from where a palm 10 cm before the end would be in its middle."""
    grid = rod()
    grid.seen[:, 60 + 31 :] *= 1 - nearer
    columns = [x - 60 for _, x in ends_of(grid)]
    assert (max(columns) > 24) == joined


def candidate_at(centre: np.ndarray) -> PalmCandidate:
    return USUAL._replace(centre=centre)


@pytest.fixture
def looked_at(monkeypatch: pytest.MonkeyPatch) -> list[tuple[np.ndarray, float, ArmRegionSettings]]:
    """Where candidates are examined: all of them are hands there, and the more likely the farther to the right."""
    calls: list[tuple[np.ndarray, float, ArmRegionSettings]] = []

    def examined(depth: Any, lens: Any, centre: np.ndarray, radius: float, s: ArmRegionSettings) -> Any:
        calls.append((centre, radius, s))
        return float(centre[0]), candidate_at(centre)

    monkeypatch.setattr(arm_region, "_candidate", examined)
    return calls


def discs(*centres: tuple[int, int], radius: int = 14) -> np.ndarray:
    """An image of 480 × 360 px with discs of 3.5 cm radius at 1 m, for `WIDE`."""
    y, x = np.mgrid[:360, :480]
    depth = np.zeros((360, 480), np.float32)
    for column, row in centres:
        depth[(x - column) ** 2 + (y - row) ** 2 <= radius**2] = 1.0
    return depth


WIDE = np.array([400.0, 400.0, 240.0, 180.0])
DISCS = (90, 90), (240, 180), (390, 270)
CENTRES = np.array([[-0.375, -0.225, 1.0], [0, 0, 1.0], [0.375, 0.225, 1.0]])


def test_each_disc_of_a_palms_size_is_looked_at_once_and_the_likeliest_is_the_first(looked_at: list[Any]) -> None:
    found = at_once(palm_candidates(discs(*DISCS), WIDE, SETTINGS))
    np.testing.assert_allclose([one.centre for one in found], CENTRES[::-1], atol=0.012)
    assert len(looked_at) == 3
    for _, radius, s in looked_at:
        assert radius == pytest.approx(0.035, abs=0.008)
        assert s == replace(SETTINGS, spacing_m=0.75 * SETTINGS.spacing_m)
    assert len(at_once(palm_candidates(discs(*DISCS), WIDE, SETTINGS, most=2))) == 2


def test_only_discs_near_a_wanted_point_and_in_no_ball_are_looked_at(looked_at: list[Any]) -> None:
    near = CENTRES[1:] + np.array([0.0, 0.1, 0.1])
    found = at_once(palm_candidates(discs(*DISCS), WIDE, SETTINGS, near=near))
    assert len(found) == len(looked_at) == 2
    assert looked_at[0][2] == replace(SETTINGS, spacing_m=1.4 * SETTINGS.spacing_m)
    assert at_once(palm_candidates(discs(*DISCS), WIDE, SETTINGS, near=CENTRES[1] + np.array([0.0, 0.13, 0.13]))) == []
    but = np.array([[*CENTRES[2], 0.05]])
    (left,) = at_once(palm_candidates(discs(*DISCS), WIDE, SETTINGS, near=near, but=but))
    np.testing.assert_allclose(left.centre, CENTRES[1], atol=0.012)


def test_twice_as_many_discs_as_are_wanted_are_looked_at(looked_at: list[Any]) -> None:
    many = [(60 + 60 * (k % 4), 100 + 100 * (k // 4)) for k in range(8)]
    assert len(at_once(palm_candidates(discs(*many), WIDE, SETTINGS, most=3))) == 3
    assert len(looked_at) == 6


def test_places_within_two_centimetres_are_one(looked_at: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """A pixel of the coarse grid is 7.5 mm here."""
    monkeypatch.setattr(arm_region, "_peaks", lambda *_: [(60, 80), (60, 82), (62, 80), (60, 83), (57, 80)])
    at_once(palm_candidates(discs((240, 180)), WIDE, SETTINGS))
    columns_and_rows = [tuple(np.round(centre[:2] * 400 / 3).tolist()) for centre, _, _ in looked_at]
    assert columns_and_rows == [(0, 0), (3, 0), (0, -3)]


def test_a_look_near_a_wanted_point_costs_less(looked_at: list[Any]) -> None:
    everywhere = list(palm_candidates(discs(*DISCS), WIDE, SETTINGS))
    near = list(palm_candidates(discs(*DISCS), WIDE, SETTINGS, near=CENTRES))
    assert len(everywhere) == len(near)
    assert all(there <= here for here, there in zip(everywhere, near, strict=True))
    assert sum(there < here for here, there in zip(everywhere, near, strict=True)) == len(DISCS)


def test_a_region_grows_from_the_hand_alone() -> None:
    grid = Grid(np.full((80, 120), 0.6), GRID_LENS, 1)
    spheres = np.array([[0.0, 0, 0.61, 0.01, 0.0], [0.3, 0, 0.9, 0.01, 1.0]])
    assert not (arm_region.region(grid, spheres, SETTINGS).front > 0).any()
    spheres[0, 4] = 1.0
    assert (arm_region.region(grid, spheres, SETTINGS).front > 0).any()


@pytest.mark.parametrize(("columns", "step"), [(160, 3), (480, 1), (500, 1), (4096, 1), (100, 5)])
def test_the_coarse_grid_has_about_so_many_columns(monkeypatch: pytest.MonkeyPatch, columns: int, step: int) -> None:
    steps: list[int] = []
    whole = arm_region.whole_grid
    monkeypatch.setattr(arm_region, "whole_grid", lambda d, lens, n, s: (steps.append(n), whole(d, lens, n, s))[1])
    at_once(palm_candidates(discs(), WIDE, replace(SETTINGS, columns=columns)))
    assert steps == [step]


def test_a_turned_normal_is_that_of_the_turned_points() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (30, 3)) * [0.05, 0.04, 0.001] + [0, 0, 0.8]
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    here = arm_region._normal(points, points.mean(axis=0))
    there = arm_region._normal(points @ turn.T, turn @ points.mean(axis=0))
    np.testing.assert_allclose(there, turn @ here, atol=1e-9)


def test_a_drawn_hand_is_a_candidate_with_its_forearm_and_fingers() -> None:
    """Its middle is taken 2 cm towards the fingers."""
    scene = arm(rotation_degrees=30)
    centre = scene.truth[PALM] + 0.02 * np.array([0.5, -np.sqrt(0.75), 0]) - [0, 0, 0.014]
    s = replace(SETTINGS, spacing_m=0.003)
    found = arm_region._candidate(scene.depth, CAMERA.lens, centre, 0.038, s)
    assert found is not None
    score, hand = found
    assert hand.forearm is not None
    along = scene.truth[ELBOW] - centre
    assert hand.forearm @ along > 0.98 * np.linalg.norm(along)
    tips = scene.truth[[*TIPS]]
    order = [int(np.linalg.norm(tips - tip, axis=1).argmin()) for tip in hand.tips]
    assert order in ([0, 1, 2, 3, 4], [4, 3, 2, 1, 0])
    assert np.linalg.norm(tips[order] - hand.tips, axis=1).max() < 0.02
    away = np.linalg.norm(hand.spheres[:, :3] - centre, axis=1)
    assert 0.21 < away.max() < 0.23
    assert 300 <= len(hand.spheres) <= 600
    np.testing.assert_array_equal(hand.spheres[:, 3:], np.tile([0.01, 1.0], (len(away), 1)))
    for deeper, some in ((0.01, True), (-0.01, True), (0.03, False), (-0.03, False)):
        other = arm_region._candidate(scene.depth, CAMERA.lens, centre + np.array([0, 0, deeper]), 0.038, s)
        assert (other is not None) == some
    assert score == pytest.approx(1 + 5 * 0.25 - centre[2], abs=0.3)


@pytest.mark.parametrize("forearm_m", [(0.15, 0.23), (0.45, 0.5)])
def test_a_hand_elsewhere_in_the_image_has_the_same_forearm_and_fingers(forearm_m: tuple[float, float]) -> None:
    """Also if its forearm reaches less far than fingers might, as a foreshortened one."""
    scene, s = arm(rotation_degrees=30), replace(SETTINGS, spacing_m=0.003, forearm_m=forearm_m)
    centre = scene.truth[PALM] + 0.02 * np.array([0.5, -np.sqrt(0.75), 0]) - [0, 0, 0.014]
    found = []
    for right in (0, 160):
        moved = np.array([right * centre[2] / CAMERA.lens[0], 0, 0])
        depth = np.roll(scene.depth, right, axis=1)
        candidate = arm_region._candidate(depth, CAMERA.lens, centre + moved, 0.038, s)
        assert candidate is not None
        assert candidate[1].forearm is not None
        found.append((candidate[1].forearm, candidate[1].tips - moved))
    np.testing.assert_allclose(found[1][0], found[0][0], atol=0.06)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=0.01)
    assert found[0][0] @ (scene.truth[ELBOW] - centre) > 0.25


def strip(around_m: float, wide: int = 32) -> np.ndarray:
    """The end of a strip at 1 m, 2.5 mm a pixel, before or behind all around it, as `WIDE` sees it."""
    depth = np.full((360, 480), around_m, np.float32)
    depth[150:, 240 - wide // 2 : 240 + wide // 2] = 1.0
    return depth


@pytest.mark.parametrize(
    ("around_m", "wide", "some"),
    [(1.3, 32, True), (0.8, 32, False), (1.3, 60, True), (1.3, 70, False), (0.0, 32, True)],
)
def test_a_strip_is_an_arm_if_it_is_as_narrow_as_one_and_not_seen_through_a_gap(
    around_m: float, wide: int, some: bool
) -> None:
    """16 cm are 64 pixels."""
    centre = np.array([0.0, 0.0, 1.0])
    found = arm_region._candidate(strip(around_m, wide), WIDE, centre, 0.038, SETTINGS)
    assert (found is not None) == some
    if found is not None:
        assert found[1].forearm is not None
        np.testing.assert_allclose(found[1].forearm, [0, 1, 0], atol=0.1)
        np.testing.assert_allclose(found[1].normal, [0, 0, -1], atol=1e-3)


@pytest.mark.parametrize(("side", "some"), [(8, False), (12, True)])
def test_a_hand_shows_at_least_twelve_points(side: int, some: bool) -> None:
    """They are 4 mm apart, less than two of these pixels."""
    depth = np.zeros((360, 480), np.float32)
    depth[180 - side // 2 : 180 + side // 2, 240 - side // 2 : 240 + side // 2] = 1.0
    s = replace(SETTINGS, spacing_m=0.008)
    assert (arm_region._candidate(depth, WIDE, np.array([0.0, 0, 1.0]), 0.038, s) is not None) == some
