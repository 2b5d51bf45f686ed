"""The line skeleton's stages on plates of known depth and size, and the sheet that shows them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

cv2 = pytest.importorskip("cv2")

from mocapella.geometry.lens import project  # noqa: E402 - only where there is OpenCV
from mocapella.model.camera import Camera  # noqa: E402
from mocapella.sensing import line_skeleton, line_skeleton_outline  # noqa: E402
from mocapella.sensing.line_skeleton import LineSkeleton, LineSkeletonSettings, Looked  # noqa: E402
from mocapella.sensing.line_skeleton_joints import HandJoints, PointGrid  # noqa: E402
from mocapella.sensing.line_skeleton_outline import lines, outline, separated  # noqa: E402
from mocapella.sensing.line_skeleton_sheet import contact_sheet, pictures, write_pictures, write_stages  # noqa: E402

SETTINGS = LineSkeletonSettings(
    near_m=0.25, far_m=1.25, reach_m=0.1, mirror=False, least_area_px=0.0, median_px=1, gaussian_px=1
)
"""254 grey levels are a metre."""


def plates(*placed: tuple[int, int, int, int, float], size: tuple[int, int] = (120, 160)) -> Any:
    """A depth image with plates from (x, y), so wide and high, at a depth [m]."""
    depth = np.zeros(size, np.float32)
    for x, y, width, height, z in placed:
        depth[y : y + height, x : x + width] = z
    return depth


@pytest.mark.parametrize(
    ("z", "mm", "gray"),
    [(0.25, 250, 255), (1.25, 1250, 1), (0.75, 750, 128), (0.2499, 250, 0), (1.2501, 1250, 0), (-1.0, 0, 0),
     (65.5351, 65535, 0), (99.0, 65535, 0), (float("nan"), 0, 0)],
)  # fmt: skip
def test_a_depth_is_in_millimetres_and_in_grey_levels_from_the_near_end_to_the_far_one(
    z: float, mm: int, gray: int
) -> None:
    first = separated(plates((20, 20, 40, 40, z)), SETTINGS)
    assert first.millimetres[30, 30] == mm
    assert first.gray[30, 30] == gray
    assert not first.gray[0].any()


@pytest.mark.parametrize(("behind", "kept"), [(0.05, True), (0.095, True), (0.105, False)])
@pytest.mark.parametrize("near", [0.3, 0.8])
def test_what_is_near_reaches_so_far_behind_the_nearest(behind: float, kept: bool, near: float) -> None:
    first = separated(plates((10, 10, 40, 40, near), (80, 10, 40, 40, near + behind)), SETTINGS)
    assert first.near[20, 20] == 255
    assert (first.near[20, 100] == 255) == kept
    assert not first.near[0, 0]


@pytest.mark.parametrize(("behind", "kept"), [(0.095, True), (0.105, False)])
def test_grey_levels_and_reach_are_of_the_range(behind: float, kept: bool) -> None:
    """Half a metre has all levels here."""
    s = replace(SETTINGS, near_m=0.5, far_m=1.0)
    first = separated(plates((10, 10, 40, 40, 0.75), (80, 10, 40, 40, 0.75 + behind), (10, 70, 5, 5, 1.0)), s)
    assert first.gray[20, 20] == 128
    assert first.gray[20, 100] == round(128 - 508 * behind)
    assert first.gray[72, 12] == 1
    assert (first.near[20, 100] == 255) == kept


@pytest.mark.parametrize(("pixels", "kept"), [(15, True), (17, False)])
def test_the_nearest_is_that_of_a_hundredth_of_the_pixels_in_the_region(pixels: int, kept: bool) -> None:
    """Of 1600, 16 are noise."""
    depth = plates((10, 10, 40, 40, 0.8))
    depth[10, 10 : 10 + pixels] = 0.4
    assert (separated(depth, SETTINGS).near[30, 30] == 255) == kept


def test_a_threshold_beyond_the_region_takes_all_that_is_in_it() -> None:
    first = separated(plates((10, 10, 40, 40, 1.24), (80, 10, 40, 40, 0.3)), replace(SETTINGS, reach_m=5.0))
    np.testing.assert_array_equal(first.near > 0, first.gray > 0)
    assert first.near[20, 20]
    assert not separated(plates(), SETTINGS).near.any()


def test_without_blurs_an_image_stays_and_is_mirrored_if_wanted() -> None:
    depth = plates((10, 10, 40, 40, 0.5))
    depth[20, 20] = 0
    first = separated(depth, replace(SETTINGS, mirror=True))
    np.testing.assert_array_equal(first.gaussian, first.gray)
    np.testing.assert_array_equal(first.mirrored, first.near[:, ::-1])
    smooth = separated(depth, replace(SETTINGS, median_px=3))
    assert smooth.median[20, 20] == smooth.median[30, 30]


@pytest.mark.parametrize(("x", "y"), [(0, 0), (50, 30), (120, 90), (120, 0)])
def test_an_outline_is_about_its_plate_and_within_the_image(x: int, y: int) -> None:
    depth = plates((x, y, 40, 30, 0.5))
    found = outline(separated(depth, SETTINGS), SETTINGS)
    assert found is not None
    (line,) = found.outlines
    low, high = line.min(axis=0), line.max(axis=0)
    assert np.abs(low - [x, y]).max() <= 1
    assert np.abs(high - [x + 39, y + 29]).max() <= 1
    assert low.min() >= 0
    assert (high <= [159, 119]).all()
    np.testing.assert_allclose(found.centre, [x + 19.5, y + 14.5], atol=1)
    assert found.radius_px == pytest.approx(np.hypot(20, 15), abs=1.5)
    np.testing.assert_allclose(found.metres[depth > 0], 0.5, atol=5e-4)
    assert (found.arm[depth > 0] == 255).all()
    assert np.count_nonzero(found.arm) < 1.15 * 1200


def test_an_outline_has_the_least_area() -> None:
    first = separated(plates((50, 30, 40, 30, 0.5)), SETTINGS)
    found = outline(first, SETTINGS)
    assert found is not None
    area = cv2.contourArea(found.outlines[0])
    assert area == pytest.approx(1200, rel=0.1)
    assert outline(first, replace(SETTINGS, least_area_px=area)) is not None
    assert outline(first, replace(SETTINGS, least_area_px=float(np.nextafter(area, 1e9)))) is None


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("first_nearer", [False, True])
def test_the_nearest_outline_is_the_arm(mirror: bool, first_nearer: bool) -> None:
    s = replace(SETTINGS, mirror=mirror)
    depth = plates((10, 20, 40, 40, 0.5 if first_nearer else 0.55), (90, 20, 40, 40, 0.55 if first_nearer else 0.5))
    found = outline(separated(depth, s), s)
    assert found is not None
    assert len(found.outlines) == 2
    x = 30 if first_nearer else 110
    assert found.arm[40, 159 - x if mirror else x] == 255
    assert found.centre[0] == pytest.approx(159 - x if mirror else x, abs=2)
    assert found.metres[40, 159 - x if mirror else x] == pytest.approx(0.5, abs=1e-3)
    shown = depth[:, ::-1] if mirror else depth
    np.testing.assert_array_equal(found.noisy, (found.arm > 0) & (shown == 0))
    assert (found.metres[found.noisy] == np.float32(s.noise_m)).all()


def test_holes_do_not_make_the_nearest_outline_farther() -> None:
    depth = plates((10, 20, 40, 40, 0.5), (90, 20, 40, 40, 0.55))
    depth[24:56, 14:46] = 0
    found = outline(separated(depth, SETTINGS), SETTINGS)
    assert found is not None
    assert found.centre[0] == pytest.approx(30, abs=2)
    assert found.noisy[40, 30]


@pytest.mark.parametrize("degrees", [0, 30, 60, 90, 135])
def test_a_bar_has_its_line_along_it_whatever_its_direction(degrees: int) -> None:
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    depth = plates()
    a, b = (np.round([80, 60] + 45 * side * along).astype(int).tolist() for side in (-1, 1))
    cv2.line(depth, a, b, 0.5, 12)
    found = outline(separated(depth, SETTINGS), SETTINGS)
    assert found is not None
    x0, y0, x1, y1 = lines(found, SETTINGS).segments[0]
    line = np.array([x1 - x0, y1 - y0])
    assert np.linalg.norm(line) > 50
    assert abs(along @ line) > 0.99 * np.linalg.norm(line)
    turn = (degrees + 90) % 180  # 0 is upright
    assert abs((lines(found, SETTINGS).rotation_degrees - turn + 90) % 180 - 90) < 3


@given(st.integers(0, 5000))
def test_a_hole_takes_the_median_of_its_measured_neighbours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    metres = np.where(rng.random((7, 8)) < 0.5, rng.uniform(0.5, 1.0, (7, 8)), 0).astype(np.float32)
    metres[:3, :3] *= seed % 2
    holes = metres == 0
    wanted = []
    for y, x in np.argwhere(holes):
        around = metres[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        wanted.append(np.median(around[around > 0]) if (around > 0).any() else 0)
    np.testing.assert_allclose(line_skeleton_outline._medians(metres, holes), wanted, rtol=1e-6)


def test_the_longest_line_is_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    found = outline(separated(plates((50, 30, 40, 60, 0.5)), SETTINGS), SETTINGS)
    assert found is not None
    told = np.array([[[100, 110, 103, 114]], [[10, 9, 10, 19]], [[50, 50, 41, 50]], [[20, 20, 26, 28]]], np.int32)
    monkeypatch.setattr(line_skeleton_outline.cv2, "HoughLinesP", lambda *_: told)
    lengths = [np.hypot(x1 - x0, y1 - y0) for x0, y0, x1, y1 in lines(found, SETTINGS).segments]
    assert lengths == [10, 10, 9, 5]
    monkeypatch.setattr(line_skeleton_outline.cv2, "HoughLinesP", lambda *_: None)
    assert lines(found, SETTINGS).segments.shape == (0, 4)


CAMERA = Camera("depth", (160, 120), np.array([100.0, 140.0, 83.0, 57.0, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize("mirror", [False, True])
def test_joints_are_seen_at_their_pixels_at_the_depth_of_the_nearest_grid_point(mirror: bool) -> None:
    detector = LineSkeleton(CAMERA, replace(SETTINGS, mirror=mirror, palm_forward_m=0.05, longest_m=1.5))
    pixels = np.array([[20.0, 100], [60, 60], [80, 40], [90, 20], [100, 24], [110, 30], [0, 0], [0, 0]])
    depths = np.array([0.9, 0.8, 0.7, 0.6, 0.65, 0.62, 0.9, 0.9])
    points = PointGrid((pixels + 1).astype(np.int32), depths)
    hand = HandJoints(pixels[0], pixels[2], pixels[1], 9.0, np.zeros((0, 2)), (), pixels[3:6], pixels[:0], pixels[3:])
    joints, seen = detector._placed(points, hand)
    at = pixels.copy()
    if mirror:
        at[:, 0] = 159 - at[:, 0]
    np.testing.assert_allclose(joints[:6, 2], [0.9, 0.8, 0.65, 0.6, 0.65, 0.62])
    np.testing.assert_allclose(project(joints[:6], CAMERA.lens), at[:6], atol=1e-6)
    assert seen.tolist() == [True] * 6 + [False] * 2
    np.testing.assert_array_equal(joints[6:], np.tile(joints[2], (2, 1)))


@pytest.mark.parametrize(("more_m", "seen"), [(1e-9, True), (-1e-9, False)])
def test_a_finger_is_as_long_as_the_limit_at_most(more_m: float, seen: bool) -> None:
    """Its tip is 15 cm to the right of the palm and 20 cm farther away."""
    square = Camera("square", (160, 120), np.array([100.0, 100.0, 80.0, 60.0, 0, 0, 0, 0, 0]))
    limit = float(np.hypot(0.95 * 0.16, 0.2))
    detector = LineSkeleton(square, replace(SETTINGS, palm_forward_m=0.0, longest_m=limit + more_m))
    palm, tip = np.array([80.0, 60.0]), np.array([96.0, 60.0])
    points = PointGrid(np.array([palm, tip]).astype(np.int32), np.array([0.75, 0.95]))
    tips = np.array([tip, *np.zeros((4, 2))])
    hand = HandJoints(palm, palm, palm, 9.0, np.zeros((0, 2)), (), tips[:1], tips[:0], tips)
    joints, found = detector._placed(points, hand)
    assert found.tolist() == [True, True, True, seen, False, False, False, False]
    np.testing.assert_array_equal(joints[4], joints[2])


def test_a_hand_is_scaled_by_the_mean_focal_length(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    hand = line_skeleton.hand

    def looked_at(of: Any, found: Any, points: Any, focal_px: float, s: Any) -> Any:
        told.append(focal_px)
        return hand(of, found, points, focal_px, s)

    monkeypatch.setattr(line_skeleton, "hand", looked_at)
    look = LineSkeleton(CAMERA, SETTINGS).look(plates((60, 20, 20, 90, 0.5)))
    assert told == [120.0]
    assert look.joints is not None


def test_what_fills_the_image_up_to_the_share_is_an_arm() -> None:
    depth = plates((60, 20, 20, 90, 0.5))
    whole = LineSkeleton(CAMERA, SETTINGS).look(depth)
    assert whole.outline is not None
    share = np.count_nonzero(whole.outline.arm) / depth.size
    assert LineSkeleton(CAMERA, replace(SETTINGS, fills_most=share)).look(depth).reason == ""
    less = LineSkeleton(CAMERA, replace(SETTINGS, fills_most=float(np.nextafter(share, 0)))).look(depth)
    assert "the near part takes up more than" in less.reason


def test_the_reason_tells_the_nearest_and_the_median_of_what_was_measured() -> None:
    depth = plates((0, 0, 10, 10, 2.0), (20, 0, 10, 10, 3.5), (40, 0, 20, 10, 5.25))
    seen = LineSkeleton(CAMERA, SETTINGS).update(depth, 0.0)
    assert "nothing lies between 0.25 and 1.25 m; the nearest is at 2.00 m, the median at 4.3" in seen.reason


def tile(value: int, width: int, height: int) -> Any:
    return np.full((height, width), value, np.uint8)


@pytest.mark.parametrize(("count", "columns", "rows"), [(1, 5, 1), (5, 5, 1), (6, 5, 2), (7, 3, 3), (4, 2, 2)])
def test_a_sheet_has_its_images_in_rows_of_equal_width_and_height(count: int, columns: int, rows: int) -> None:
    """A tile is 256 px wide, with a line of 18 px above it and a margin of 2 px about it."""
    stages = {f"stage {k}": tile(20 + 10 * k, 128, 96) for k in range(count)}
    sheet = contact_sheet(stages, columns)
    width, height = 260, 192 + 18 + 4
    assert sheet.shape == (rows * height, columns * width, 3)
    for k in range(rows * columns):
        y, x = k // columns * height, k % columns * width
        part = sheet[y + 20 : y + height - 2, x + 2 : x + width - 2]
        assert (part == (20 + 10 * k if k < count else 255)).all()
        title = sheet[y + 2 : y + 20, x + 2 : x + width - 2]
        assert bool((title < 128).any()) == (k < count)
        assert (sheet[y : y + 2, x : x + width] == 255).all()
        assert (sheet[y : y + height, x : x + 2] == 255).all()


@pytest.mark.parametrize(("width", "height", "shown"), [(512, 256, 128), (64, 10, 40), (1000, 1, 1), (256, 100, 100)])
def test_an_image_of_any_size_is_256_pixels_wide_on_a_sheet(width: int, height: int, shown: int) -> None:
    assert contact_sheet({"x": tile(9, width, height)}, 1).shape == (shown + 18 + 4, 260, 3)


def test_stages_are_numbered_from_one_on(tmp_path: Path) -> None:
    stages = {"A b": tile(1, 9, 9), "C, d": tile(2, 9, 9)}
    assert [path.name for path in write_pictures(stages, tmp_path, "x-")] == ["x-01-a-b.png", "x-02-c-d.png"]
    assert [path.name for path in write_stages(stages, tmp_path)][-1] == "stages-sheet.png"


def looked() -> Looked:
    look = LineSkeleton(CAMERA, SETTINGS).look(plates((60, 20, 20, 90, 0.5), (120, 20, 30, 40, 0.55)))
    assert look.hand is not None
    return look


def test_the_circle_of_an_arm_is_drawn_where_it_is() -> None:
    look = looked()
    assert look.outline is not None
    assert look.hand is not None
    shown = pictures(look)["circular region"].astype(int)
    yellow = (np.abs(shown - [60, 220, 255]).max(axis=-1) < 40).nonzero()
    (x, y), radius = look.outline.centre, look.outline.radius_px
    assert len(yellow[0]) > 50
    np.testing.assert_allclose(np.hypot(yellow[1] - x, yellow[0] - y), radius, atol=2)


def test_the_circle_about_a_palm_is_drawn_if_there_is_a_hand() -> None:
    look = looked()
    assert look.hand is not None
    hand = replace(look.hand, palm=np.array([120.0, 95.0]), inside_px=15.0)
    for one, some in ((hand, True), (None, False)):
        shown = pictures(replace(look, hand=one))["circular region"].astype(int)
        green = (np.abs(shown - [80, 220, 80]).max(axis=-1) < 40).nonzero()
        assert (len(green[0]) > 50) == some
        np.testing.assert_allclose(np.hypot(green[1] - 120, green[0] - 95), 15, atol=2)


def test_the_first_outline_is_green_and_others_are_red() -> None:
    shown = pictures(looked())["contours"]
    assert (shown[20:60, 58:82] == [80, 220, 80]).all(axis=-1).any()
    assert not (shown[20:60, 58:82] == [60, 60, 255]).all(axis=-1).any()
    assert (shown[20:60, 118:] == [60, 60, 255]).all(axis=-1).any()


def test_the_arms_joints_are_drawn_at_their_pixels_and_lost_fingers_at_the_palm() -> None:
    look = looked()
    assert look.hand is not None
    assert look.found is not None
    hand = replace(
        look.hand, elbow=np.array([30.0, 100.0]), wrist=np.array([60.0, 60.0]), palm=np.array([80.0, 40.0]),
        tips=np.array([[100.0, 20], [110, 40], [120, 60], [130, 80], [140, 100]]),
    )  # fmt: skip
    found = np.array([True] * 3 + [True, True, False, True, True])
    shown = pictures(replace(look, hand=hand, found=found))["arm"]
    for x, y in (hand.elbow, hand.wrist):
        assert (shown[int(y), int(x)] == 255).all()
    colours = ((60, 60, 255), (60, 220, 255), (80, 220, 80), (255, 180, 60), (255, 80, 220))
    for (x, y), colour, there in zip(hand.tips, colours, found[3:], strict=True):
        assert (shown[int(y), int(x)] == colour).all() == there
    assert shown[40, 80].tolist() == [80, 220, 80]  # the lost one was drawn last there


def test_noise_dots_and_lines_are_drawn_at_their_pixels() -> None:
    look = looked()
    assert look.outline is not None
    assert look.lines is not None
    assert look.hand is not None
    noisy = np.zeros((120, 160), np.bool_)
    noisy[5, 7:9] = True
    made = pictures(
        replace(
            look, outline=replace(look.outline, noisy=noisy),
            lines=replace(look.lines, segments=np.array([[10.0, 100.0, 50.0, 100.0]])),
            hand=replace(look.hand, corners=np.array([[20.0, 30.0]])),
        )
    )  # fmt: skip
    assert (made["noise"][5, 7:9] == 255).all()
    assert not (made["noise"][6] == 255).any()
    assert made["Harris"][30, 20].tolist() == [80, 220, 80]
    assert made["Hough"][100, 40].tolist() == [60, 220, 255]
    assert made["Hough"][100, 10].tolist() == [60, 60, 255]
    assert (made["noise"][50, 70] == 63).all()  # a quarter of the arm's mask
