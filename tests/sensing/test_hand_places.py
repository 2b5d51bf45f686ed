"""The joints of the line skeleton's hand, step by step: grid points, elbow, corners, hulls, tips and blobs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

cv2 = pytest.importorskip("cv2")

from mocapella.sensing import line_skeleton_joints as joints  # noqa: E402 - only where there is OpenCV
from mocapella.sensing.line_skeleton_joints import Place, PointGrid, elbow_of, grid, hand, nearest  # noqa: E402
from mocapella.sensing.line_skeleton_outline import ArmOutline, Lines  # noqa: E402
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings  # noqa: E402
from mocapella.sensing.line_skeleton_thinning import Skeleton  # noqa: E402

SETTINGS = LineSkeletonSettings(near_m=0.25, far_m=1.25, tip_radius_m=0.01, least_hull_px2=0.0)
PALM, WRIST, ELBOW = np.array([100.0, 60.0]), np.array([100.0, 90.0]), np.array([100.0, 180.0])
CENTRE = np.array([100.0, 100.0])
PLACE = Place(ELBOW, PALM, WRIST, 20.0, 1000.0)
"""A tip is 10 px in radius here."""


def outline_of(arm: Any, metres: Any = None) -> ArmOutline:
    mask = np.where(arm, np.uint8(255), np.uint8(0))
    depth = np.full(mask.shape, 0.5, np.float32) if metres is None else np.asarray(metres, np.float32)
    return ArmOutline(mask, (), mask, CENTRE, 50.0, depth, np.zeros(mask.shape, np.bool_))


def box(x: slice, y: slice, size: tuple[int, int] = (200, 220)) -> Any:
    mask = np.zeros(size, np.bool_)
    mask[y, x] = True
    return mask


def test_grid_points_are_on_the_arm_and_within_the_cube_region_up_to_its_faces() -> None:
    """From 0.25 to 1.25 m, and as wide as deep: half a metre to each side."""
    metres = np.full((8, 12), 0.5, np.float32)
    metres[0] = [0.25, 0, np.nextafter(np.float32(0.25), np.float32(0)), 0, 1.25, 0, 1.2501, 0, 1.0, 0, 1.0, 0]
    arm = np.ones((8, 12), np.bool_)
    arm[4, 2] = False
    rays = np.zeros((8, 12, 2))
    rays[0, 8], rays[0, 10] = (0.5, 0.0), (0.5001, 0.0)
    rays[2, 0], rays[2, 2], rays[2, 4], rays[2, 6] = (0.0, -1.0), (0.0, -1.0001), (1.0001, 0.0), (-1.0, 1.0)
    found = grid(outline_of(arm, metres), rays, replace(SETTINGS, grid_px=2))
    every = {(x, y) for x in range(0, 12, 2) for y in range(0, 8, 2)}
    without = {(2, 0), (6, 0), (10, 0), (2, 4), (2, 2), (4, 2)}
    assert set(map(tuple, found.pixels.tolist())) == every - without
    np.testing.assert_allclose(found.metres, metres[found.pixels[:, 1], found.pixels[:, 0]])


@pytest.mark.parametrize(
    ("degrees", "right_y", "elbow"),
    [
        (59.9, 50, "lowest"), (60.0, 50, "left"), (130.0, 50, "left"), (130.1, 50, "right"), (130.1, 49, "lowest"),
        (180.0, 51, "right"),
    ],
)  # fmt: skip
def test_the_elbow_is_another_end_from_each_limit_of_the_angle_on(degrees: float, right_y: float, elbow: str) -> None:
    ends = {"lowest": [30.0, 90.0], "left": [1.0, 20.0], "right": [80.0, right_y]}
    segments = np.array([[*ends["left"], *ends["right"]], [*ends["lowest"], 40.0, 40.0]])
    assert elbow_of(segments, degrees, np.array([40.0, 50.0])).tolist() == ends[elbow]


@given(st.integers(0, 4), st.floats(-3, 3), st.floats(-3, 3))
def test_the_nearest_grid_point_is_that_of_the_least_distance(which: int, x: float, y: float) -> None:
    pixels = np.array([[0, 0], [40, 0], [0, 40], [-40, 8], [12, 40]], np.int32)
    assert nearest(PointGrid(pixels, np.ones(5)), pixels[which] + np.array([x, y])) == which


@pytest.mark.parametrize(
    ("palm", "radius"),
    [((2, 1), 12.0), ((0, 0), 1.0), ((3, 2), 23.0), ((-1, 1), 0), ((4, 1), 0), ((2, -1), 0), ((2, 3), 0),
     ((1.6, 0.7), 12.0)],
)  # fmt: skip
def test_the_circle_about_the_palm_is_read_at_its_pixel_if_the_image_has_it(palm: Any, radius: float) -> None:
    distance = np.array([[1, 2, 3, 4], [10, 11, 12, 13], [20, 21, 22, 23]], np.float32)
    assert joints._inside(distance, np.array(palm, np.float64)) == radius


@given(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.floats(0.5, 50), st.floats(-90, 90))
def test_an_angle_is_from_the_direction_clockwise_in_the_picture(
    begin: float, turn: float, size: float, x: float
) -> None:
    at, direction = np.array([x, 2 * x]), size * np.array([np.cos(begin), np.sin(begin)])
    pixel = at + 3 * np.array([np.cos(begin + turn), np.sin(begin + turn)])  # y is down
    np.testing.assert_allclose(joints.angles(pixel[None], at, direction), [turn], atol=1e-6)


PLUS = box(slice(60, 120), slice(50, 70)) | box(slice(80, 100), slice(30, 90))


@given(st.integers(-60, 100), st.integers(-30, 110))
def test_corners_are_where_the_arm_has_them_wherever_it_is(right: int, down: int) -> None:
    found = joints._corners(outline_of(np.roll(PLUS, (down, right), axis=(0, 1))), SETTINGS) - [right, down]
    for corner in ((80, 50), (99, 50), (80, 69), (99, 69)):
        assert np.hypot(*(found - corner).T).min() < 4
    np.testing.assert_array_equal(found, joints._corners(outline_of(PLUS), SETTINGS))
    apart = np.abs(found[:, None] - found).max(axis=-1) + 9 * np.eye(len(found))
    assert apart.min() > 2  # only the strongest pixel of a corner is one


def test_with_a_larger_part_only_the_strongest_corners_are_left() -> None:
    arm = box(slice(60, 90), slice(20, 70)) | box(slice(30, 120), slice(120, 160))
    counts = [len(joints._corners(outline_of(arm), replace(SETTINGS, corner_part=p))) for p in (0.01, 0.5, 1.0)]
    assert counts[0] >= counts[1] > counts[2] == 0


def beyond_wrist(arm: Any, along: Any, wrist: Any) -> Any:
    """(n, 2) x, y of the arm's pixels that are not before the wrist, as the direction to the palm says."""
    y, x = np.nonzero(arm)
    pixels = np.stack([x, y], axis=-1)
    return pixels[(pixels - wrist) @ along >= 0]


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(0, 359))
def test_a_hull_is_about_all_of_a_part_of_the_arm_beyond_the_wrist(seed: int, degrees: int) -> None:
    along = np.round(20 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]))
    wrist = np.array([34.0, 26.0])
    rng = np.random.default_rng(seed)
    arm = cv2.dilate((rng.random((60, 70)) < 0.01).astype(np.uint8), np.ones((5, 7), np.uint8)) > 0
    hulls = joints._hulls(outline_of(arm), replace_place(palm=wrist + along, wrist=wrist), SETTINGS)
    kept = beyond_wrist(arm, along, wrist)
    there = {tuple(pixel) for pixel in kept.tolist()}
    assert all(tuple(corner) in there for hull in hulls for corner in hull.tolist())
    for pixel in kept.tolist():
        inside = any(cv2.pointPolygonTest(hull[:, None], [float(v) for v in pixel], False) >= 0 for hull in hulls)
        assert inside or not is_solid(arm, kept, pixel)


def is_solid(arm: Any, kept: Any, pixel: list[int]) -> bool:
    """Whether a pixel is the first of a square of four that are kept: these have an area."""
    there = {tuple(other) for other in kept.tolist()}
    return all((pixel[0] + a, pixel[1] + b) in there for a in (0, 1) for b in (0, 1))


def replace_place(**changed: Any) -> Place:
    return replace(PLACE, **changed)


@pytest.mark.parametrize(("least", "kept"), [(600.0, True), (600.5, False)])
def test_a_hull_of_the_least_area_is_one(least: float, kept: bool) -> None:
    """The corners of a box of 31 × 21 pixels are 30 and 20 apart."""
    arm = box(slice(90, 121), slice(30, 51))
    hulls = joints._hulls(outline_of(arm), PLACE, replace(SETTINGS, least_hull_px2=least))
    assert len(hulls) == kept


def test_a_line_has_no_hull_and_a_triangle_has() -> None:
    line, triangle = (
        box(slice(90, 121), slice(30, 31)),
        np.tril(np.ones((200, 220), np.bool_)) & box(slice(40, 60), slice(40, 60)),
    )
    assert joints._hulls(outline_of(line), PLACE, SETTINGS) == ()
    (hull,) = joints._hulls(outline_of(triangle), PLACE, SETTINGS)
    assert len(hull) == 3


def outer(hull: list[tuple[int, int]], corners: list[tuple[float, float]], arm: Any = None) -> list[list[float]]:
    of = outline_of(np.zeros((200, 220), np.bool_) if arm is None else arm)
    hulls = (np.array(hull, np.int32),) if hull else ()
    return joints._outer(of, np.reshape(np.array(corners, np.float64), (-1, 2)), hulls, PLACE, SETTINGS).tolist()


def test_a_tip_is_a_hulls_corner_within_half_a_tip_of_a_corner() -> None:
    assert outer([(100, 20)], [(103, 24)]) == [[100, 20]]
    assert outer([(100, 20)], [(103, 24.1)]) == []
    assert outer([(100, 20)], [(0, 0), (97, 16)]) == [[100, 20]]
    assert outer([(100, 20)], []) == []
    assert outer([], [(100, 20)]) == []


def test_a_tip_is_outside_the_circle_about_the_palm() -> None:
    assert outer([(112, 44)], [(112, 44)]) == []  # 20 px from the palm
    assert outer([(113, 44)], [(113, 44)]) == [[113, 44]]


def test_of_tips_within_a_tips_radius_the_farthest_from_the_palm_is_kept() -> None:
    near, far, other = (106, 28), (100, 20), (100, 9)
    assert outer([near, far], [near, far]) == outer([far, near], [near, far]) == [list(map(float, far))]
    assert outer([far, other], [far, other]) == [[100, 20], [100, 9]]
    assert outer([(60, 60), (140, 60)], [(60, 60), (140, 60)]) == [[60, 60], [140, 60]]
    level = [(94, 20), (104, 20)]  # 10 px apart: the same group, and the second is nearer
    assert outer(level, [(94.0, 20.0), (104.0, 20.0)]) == [[94, 20]]
    for first, second in (((95, 20), (105, 20)), ((105, 20), (95, 20))):  # as far: the first
        assert outer([first, second], [first, second]) == [list(map(float, first))]
    mirrored = [(106, 20), (94, 20)]
    assert outer(mirrored, [(106.0, 20.0), (94.0, 20.0)]) == [[106, 20], [94, 20]], "12 px apart"


def test_a_tip_where_the_arm_fills_half_of_the_disc_is_blunt() -> None:
    less, more = box(slice(0, 220), slice(0, 20)), box(slice(0, 220), slice(0, 22))
    assert outer([(100, 20)], [(100, 20)], less) == [[100, 20]]
    assert outer([(100, 20)], [(100, 20)], more) == []


@given(arrays(np.bool_, (9, 12)), st.integers(-2, 13), st.integers(-2, 10), st.floats(0.2, 6))
def test_the_filled_share_is_of_the_pixels_within_the_radius_in_whole_pixels(
    arm: Any, x: int, y: int, radius: float
) -> None:
    rows, columns = np.nonzero(arm)
    whole = max(np.ceil(radius), 1)
    within = np.count_nonzero(np.hypot(columns - x, rows - y) <= whole)
    share = joints._fill(outline_of(arm).arm, np.array([x + 0.3, y - 0.3]), radius)
    assert share == pytest.approx(within / (np.pi * whole**2))


def points(nearer: Any, by_m: float = 0.05) -> PointGrid:
    """Points 4 px apart about the palm, 0.5 m away, and some of them nearer by so much."""
    y, x = np.mgrid[20:101:4, 60:141:4]
    pixels = np.stack([x.ravel(), y.ravel()], axis=-1).astype(np.int32)
    return PointGrid(pixels, np.where([tuple(p) in nearer for p in pixels.tolist()], 0.5 - by_m, 0.5))


def square(x: int, y: int, side: int) -> set[tuple[int, int]]:
    return {(x + 4 * i, y + 4 * j) for i in range(side) for j in range(side)}


WIDE_PLACE = Place(ELBOW, PALM, WRIST, 32.0, 400.0)
BLOBS = replace(SETTINGS, grid_px=4, blob_nearer_m=0.02, blob_least_m2=9e-4)
"""A point is a square centimetre."""


@pytest.mark.parametrize(("x", "y"), [(96, 56), (84, 44), (104, 64)])
def test_a_blob_is_at_the_middle_of_the_nearer_points(x: int, y: int) -> None:
    assert joints._blobs(points(square(x, y, 3)), WIDE_PLACE, BLOBS).tolist() == [[x + 4, y + 4]]


def test_a_blob_has_the_least_area() -> None:
    less = square(96, 56, 3) - {(96, 56)}
    assert len(joints._blobs(points(less), WIDE_PLACE, BLOBS)) == 0
    assert len(joints._blobs(points(less), WIDE_PLACE, replace(BLOBS, blob_least_m2=8e-4))) == 1
    assert len(joints._blobs(points({(96, 56)}), WIDE_PLACE, replace(BLOBS, blob_least_m2=0.0))) == 1


def test_a_blob_is_nearer_than_the_palm_by_the_limit_and_in_the_hand() -> None:
    for by_m, count in ((0.019, 0), (0.021, 1), (-0.05, 0)):
        assert len(joints._blobs(points(square(96, 56, 3), by_m), WIDE_PLACE, BLOBS)) == count
    at_edge = replace(BLOBS, blob_least_m2=0.0)
    assert len(joints._blobs(points({(132, 60)}), WIDE_PLACE, at_edge)) == 1
    assert len(joints._blobs(points({(136, 60)}), WIDE_PLACE, at_edge)) == 0
    two = joints._blobs(points(square(84, 56, 3) | square(108, 56, 3)), WIDE_PLACE, BLOBS)
    assert sorted(two.tolist()) == [[88, 60], [112, 60]]


def test_a_palm_beside_the_arm_or_between_grid_points_has_no_blobs() -> None:
    for inside_px, palm in ((0.0, PALM), (-1.0, PALM), (1.0, PALM + 2)):
        place = replace(WIDE_PLACE, inside_px=inside_px, palm=palm)
        assert joints._blobs(points(square(96, 56, 3)), place, BLOBS).shape == (0, 2)


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the steps find that `hand` joins: outer tips and blobs; and the place that they were given."""
    made: dict[str, Any] = {"outer": np.zeros((0, 2)), "blobs": np.zeros((0, 2))}

    def outer_tips(of: Any, corners: Any, hulls: Any, at: Place, s: Any) -> Any:
        made["place"] = at
        return np.asarray(made["outer"], np.float64).reshape(-1, 2)

    monkeypatch.setattr(joints, "_corners", lambda *_: np.zeros((0, 2)))
    monkeypatch.setattr(joints, "_hulls", lambda *_: ())
    monkeypatch.setattr(joints, "_outer", outer_tips)
    monkeypatch.setattr(joints, "_blobs", lambda *_: np.asarray(made["blobs"], np.float64).reshape(-1, 2))
    return made


Y, X = np.mgrid[0:200, 0:220]
PIXELS = PointGrid(
    np.stack([X.ravel(), Y.ravel()], axis=-1).astype(np.int32), np.where(Y.ravel() == 60, 0.8, 0.5).astype(np.float64)
)


def joined(settings_: LineSkeletonSettings = SETTINGS) -> Any:
    distance = np.zeros((200, 220), np.float32)
    distance[60, 100] = 17.0
    skeleton = Skeleton(np.zeros((200, 220), np.uint8), distance, *[np.zeros((200, 220), np.uint8)] * 3)
    lines = Lines(skeleton, np.array([[100.0, 180.0, 100.0, 100.0]]), 0.0)
    return hand(outline_of(np.zeros((200, 220), np.bool_)), lines, PIXELS, 400.0, settings_)


def at_degrees(*turns: float, far: float = 40.0) -> list[list[float]]:
    """Pixels about the palm, from the upward direction clockwise."""
    radians = np.radians(turns)
    return np.round(PALM + far * np.stack([np.sin(radians), -np.cos(radians)], axis=-1)).tolist()


def test_a_hand_is_placed_by_its_elbow_and_circle_and_scaled_by_the_palms_depth(found: dict[str, Any]) -> None:
    made = joined()
    place = found["place"]
    np.testing.assert_allclose([made.elbow, made.palm, made.wrist], [ELBOW, PALM, WRIST])
    assert (place.inside_px, place.px_per_m) == (17.0, 400.0 / 0.8)
    assert not made.tips.any()


def test_tips_are_in_the_order_of_their_angles_and_none_is_turned_too_far(found: dict[str, Any]) -> None:
    found["outer"] = at_degrees(100, -100, 0, 30, 120, -120)
    made = joined(replace(SETTINGS, finger_degrees=110.0))
    assert made.tips.tolist() == [*at_degrees(-100, 0, 30, 100), [0, 0]]
    wrist = joined(replace(SETTINGS, finger_degrees=45.0, angle_at="wrist"))
    seen = np.degrees(np.arctan2(*((np.array(found["outer"]) - WRIST) * [1, -1]).T))
    assert sorted(map(tuple, wrist.outer.tolist())) == sorted(
        tuple(tip) for tip, turn in zip(found["outer"], seen, strict=True) if abs(turn) <= 45
    )
    assert 0 < len(wrist.outer) < 6


def test_of_many_tips_the_five_farthest_from_the_palm_are_fingers(found: dict[str, Any]) -> None:
    turns = (-60, -40, -20, 0, 20, 40, 60)
    found["outer"] = [at_degrees(turn, far=30 + 3 * k)[0] for k, turn in enumerate(turns)]
    assert joined().tips.tolist() == found["outer"][2:]
    found["outer"] = [*at_degrees(-90, -70, -50, -30, -10), *at_degrees(90, far=30)]
    assert joined().tips.tolist() == found["outer"][:5]


def test_a_blob_beside_a_tip_is_the_tip_within_twice_its_radius(found: dict[str, Any]) -> None:
    found["outer"] = [[100.0, 20.0]]
    found["blobs"] = [[106.0, 28.0]]  # 10 px: twice 1 cm of 500 px/m
    assert len(joined().outer) == 1
    assert np.count_nonzero(joined().tips.any(axis=1)) == 1
    found["blobs"] = [[107.0, 28.0]]
    assert joined().tips[:2].tolist() == [[100, 20], [107, 28]]
