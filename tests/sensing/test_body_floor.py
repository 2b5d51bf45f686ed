"""The floor and the bodies of a depth image, step by step: planes of known heights, plates of known areas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

cv2 = pytest.importorskip("cv2")

from mocapella.geometry.lens import project  # noqa: E402 - only where there is OpenCV
from mocapella.model.camera import Camera  # noqa: E402
from mocapella.sensing import body_lines as lines  # noqa: E402
from mocapella.sensing.body_lines import BodyLinesSettings, body_lines, floor_plane, pictures  # noqa: E402

CAMERA = Camera("depth", (160, 120), np.array([100.0, 110.0, 83.0, 57.0, 0, 0, 0, 0, 0]))
SETTINGS = BodyLinesSettings()
Y, X = np.mgrid[:120, :160]
RAYS = np.stack([(X - 83.0) / 100.0, (Y - 57.0) / 110.0, np.ones((120, 160))], axis=-1)


def normal_of(tilt: float, roll: float = 0.0) -> np.ndarray:
    """The direction upwards of a camera that looks down by a tilt, and is rolled [°]; y is down."""
    t, r = np.radians(tilt), np.radians(roll)
    return np.array([np.cos(t) * np.sin(r), -np.cos(t) * np.cos(r), -np.sin(t)])


def plane_depth(n: np.ndarray, d: float, far_m: float = 6.0) -> np.ndarray:
    """Depth of the plane n·x + d = 0, 0 where it is not in front of the camera or too far."""
    with np.errstate(divide="ignore"):
        z = -d / (RAYS @ n)
    return np.where((z > 0) & (z < far_m), z, 0.0).astype(np.float32)


@pytest.mark.parametrize("tilt", [0, 12, 35])
@pytest.mark.parametrize("roll", [-10, 5])
@pytest.mark.parametrize("height_m", [0.6, 1.8])
def test_a_floor_is_found_where_it_is(tilt: float, roll: float, height_m: float) -> None:
    n = normal_of(tilt, roll)
    found = floor_plane(plane_depth(n, height_m, far_m=15.0), CAMERA, SETTINGS)
    assert found is not None
    np.testing.assert_allclose(found, [*n, height_m], atol=1e-5)


def test_things_on_a_floor_do_not_lift_it() -> None:
    n = normal_of(20)
    depth = plane_depth(n, 1.2)
    depth[60:100, 30:70] = np.minimum(depth[60:100, 30:70], 1.6)
    carpet = plane_depth(n, 1.17)
    depth[70:, 130:] = carpet[70:, 130:]
    found = floor_plane(depth, CAMERA, SETTINGS)
    assert found is not None
    np.testing.assert_allclose(found, [*n, 1.2], atol=1e-4)


def test_a_table_has_points_below_it_and_is_no_floor() -> None:
    n = normal_of(20)
    table, floor = plane_depth(n, 0.6), plane_depth(n, 1.2)
    depth = np.where((X > 15) & (X < 140) & (Y > 70), table, floor)
    found = floor_plane(depth, CAMERA, SETTINGS)
    assert found is not None
    np.testing.assert_allclose(found, [*n, 1.2], atol=1e-4)


def test_a_ceiling_and_a_wall_are_no_floor() -> None:
    ceiling = plane_depth(normal_of(-20), -1.2)
    assert (ceiling > 0).mean() > 0.3
    assert floor_plane(ceiling, CAMERA, SETTINGS) is None
    assert floor_plane(np.full((120, 160), 2.0, np.float32), CAMERA, SETTINGS) is None


@pytest.mark.parametrize(("tilt", "found"), [(29, True), (31, False), (-10, True)])
def test_a_floor_is_tilted_up_to_the_limit(tilt: float, found: bool) -> None:
    depth = plane_depth(normal_of(tilt), 1.2, far_m=20.0)
    assert (floor_plane(depth, CAMERA, BodyLinesSettings(tilt_deg=30)) is not None) == found


@pytest.mark.parametrize(("rows", "found"), [(5, True), (4, False)])
def test_a_floor_needs_a_hundred_measured_points(rows: int, found: bool) -> None:
    """Twenty are in a row of samples, eight pixels apart."""
    depth = plane_depth(normal_of(30), 1.2)
    depth[: 120 - 8 * rows] = 0
    assert np.count_nonzero(depth[4::8, 4::8]) == 20 * rows
    assert (floor_plane(depth, CAMERA, SETTINGS) is not None) == found


@pytest.mark.parametrize(("columns", "found"), [(24, False), (120, True)])
def test_a_floor_is_at_least_a_twentieth_of_what_is_seen(columns: int, found: bool) -> None:
    """Of 300 samples, 6 or 30 are the floor's; the rest is of no plane, but some are near one by chance."""
    depth = plane_depth(normal_of(30), 1.2)
    rng = np.random.default_rng(0)
    scattered = rng.uniform(0.3, 1.15, depth.shape).astype(np.float32)
    lower = (Y >= 104) & (columns > X)
    assert (floor_plane(np.where(lower, depth, scattered), CAMERA, SETTINGS) is not None) == found


@pytest.mark.parametrize(("below", "found"), [(9, True), (10, False)])
def test_three_hundredths_of_what_is_seen_may_be_below_a_floor(below: int, found: bool) -> None:
    """Of 300 samples; reflections on a floor are below it."""
    n = normal_of(35)
    depth = plane_depth(n, 1.2, far_m=50.0)
    assert (depth[4::8, 4::8] > 0).all()
    depth[60, 4 : 4 + 8 * below : 8] *= 1.5
    plane = floor_plane(depth, CAMERA, SETTINGS)
    assert (plane is not None and bool(np.abs(plane - [*n, 1.2]).max() < 1e-4)) == found


def test_points_are_those_of_every_eighth_pixel_from_the_fourth_on() -> None:
    metres = np.random.default_rng(0).uniform(-1, 3, (120, 160)).astype(np.float32)
    found = lines._points(metres, CAMERA)
    y, x = np.nonzero(metres[4::8, 4::8] > 0)
    np.testing.assert_allclose(project(found, CAMERA.lens), np.stack([8 * x + 4, 8 * y + 4], axis=-1))
    np.testing.assert_allclose(found[:, 2], metres[4::8, 4::8][y, x])


vectors = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)


@given(vectors, vectors, vectors)
def test_a_plane_goes_through_its_three_points_and_its_normal_is_upwards(a: Any, b: Any, c: Any) -> None:
    found = lines._plane(np.stack([a, b, c]))
    if found is None:
        assert np.linalg.norm(np.cross(b - a, c - a)) < 1e-6
        return
    assert np.linalg.norm(found[:3]) == pytest.approx(1)
    assert found[1] <= 0
    spread = np.linalg.norm(np.cross(b - a, c - a))
    np.testing.assert_allclose(np.stack([a, b, c]) @ found[:3] + found[3], 0, atol=1e-6 + 1e-12 / spread)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.floats(-2, 2))
def test_a_height_is_the_distance_of_a_pixels_point_from_the_plane(a: float, b: float, c: float, d: float) -> None:
    metres = np.random.default_rng(0).uniform(0.5, 3, (120, 160))
    found = lines._height(metres.astype(np.float32), np.array([a, b, c, d]), CAMERA)
    np.testing.assert_allclose(found, (metres[..., None] * RAYS) @ [a, b, c] + d, atol=1e-5)


@given(st.integers(0, 10_000), st.integers(0, 19), st.integers(0, 15))
def test_a_pixels_place_is_at_the_median_of_the_measured_ones_within_three_pixels(seed: int, x: int, y: int) -> None:
    rng = np.random.default_rng(seed)
    metres = np.where(rng.random((16, 20)) < 0.3, rng.uniform(1, 3, (16, 20)), 0).astype(np.float32)
    metres[:8, :9] *= seed % 2
    around = metres[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]
    wanted = np.median(around[around > 0]) if (around > 0).any() else 7.0
    pixels = np.array([[[x + 0.4, y - 0.4], [x, y]]])
    found = lines._on_surface(pixels, metres, 7.0, CAMERA)
    np.testing.assert_allclose(found[..., 2], wanted, rtol=1e-6)
    np.testing.assert_allclose(project(found, CAMERA.lens), pixels, atol=1e-6)


def plate(z: float, columns: slice = slice(60, 100), rows: slice = slice(20, 100)) -> np.ndarray:
    depth = np.zeros((120, 160), np.float32)
    depth[rows, columns] = z
    return depth


NO_FLOOR = BodyLinesSettings(near_m=0.75, far_m=4.0, floor=False, least_m2=0.0)


@pytest.mark.parametrize(("z", "seen"), [(0.75, True), (0.749, False), (2.0, True), (4.0, True), (4.001, False)])
def test_a_body_is_in_the_range_up_to_its_ends(z: float, seen: bool) -> None:
    found = body_lines(plate(z), CAMERA, NO_FLOOR)
    assert [body.distance_m for body in found.bodies] == ([pytest.approx(z)] if seen else [])
    if not seen:
        assert found.reason.startswith("nothing lies between 0.75 and 4 m")


@pytest.mark.parametrize("z", [1.0, 2.0])
def test_a_body_is_of_the_least_area_at_its_distance(z: float) -> None:
    """The plate has 40 × 80 pixels of a centimetre and more, each as wide as its distance makes it."""
    (body,) = body_lines(plate(z), CAMERA, NO_FLOOR).bodies
    area = np.count_nonzero(body.mask) * (z / 100.0) ** 2
    assert area == pytest.approx(0.32 * z**2, rel=0.2)
    at_limit = BodyLinesSettings(near_m=0.75, floor=False, least_m2=area)
    above = BodyLinesSettings(near_m=0.75, floor=False, least_m2=float(np.nextafter(area, 1e9)))
    assert len(body_lines(plate(z), CAMERA, at_limit).bodies) == 1
    none = body_lines(plate(z), CAMERA, above)
    assert none.bodies == ()
    assert none.reason.startswith("nothing in the range is larger than")


def test_bodies_are_in_the_order_of_their_distance_and_have_their_ends() -> None:
    depth = plate(3.0, slice(20, 32)) + plate(1.5, slice(70, 82)) + plate(2.2, slice(120, 132))
    found = body_lines(depth, CAMERA, NO_FLOOR)
    assert [body.distance_m for body in found.bodies] == [pytest.approx(z) for z in (1.5, 2.2, 3.0)]
    for body, middle in zip(found.bodies, (75.5, 125.5, 25.5), strict=True):
        ends = body.ends_px[np.argsort(body.ends_px[:, 1])]
        assert len(ends) == 2
        assert np.abs(ends[:, 0] - middle).max() < 8
        assert ends[0, 1] < 32
        assert ends[1, 1] > 88
        assert body.mask[60, round(middle)] == 255
        np.testing.assert_allclose(body.ends[:, 2], body.distance_m, rtol=1e-5)
        np.testing.assert_allclose(body.segments[..., 2], body.distance_m, rtol=1e-5)
        assert body.segments_px.shape[1:] == (2, 2)


def test_all_within_the_clearance_goes_with_the_floor() -> None:
    n = normal_of(25)
    floor, low, high = (plane_depth(n, d) for d in (1.2, 1.17, 1.1))
    box = (X > 60) & (X < 100) & (Y > 70) & (Y < 100)
    for top, seen in ((low, False), (high, True)):
        depth = np.where(box, top, floor)
        found = body_lines(depth, CAMERA, BodyLinesSettings(near_m=0.5, far_m=5.0, least_m2=0.0))
        assert found.floor is not None
        assert bool(found.bodies) == seen
        if not seen:
            assert found.reason == "nothing but the floor lies in the range"


@pytest.mark.parametrize(
    ("depths", "said"),
    [
        ((0.0,), "nothing was measured"), ((0.8,), "nothing but the floor"), ((4.0,), "nothing but the floor"),
        ((4.001, 5.0, 7.0), "nothing lies between 0.8 and 4 m; the nearest is at 4.00 m, the median at 5.00 m"),
        ((0.799,), "nothing lies between 0.8 and 4 m"), ((0.5, 6.0, 2.0), "nothing but the floor"),
    ],
)  # fmt: skip
def test_a_reason_says_whether_anything_was_in_the_range(depths: tuple[float, ...], said: str) -> None:
    assert lines._nothing(np.array(depths), SETTINGS).startswith(said)


def test_the_pictures_are_as_bright_as_far_and_show_lines_and_ends() -> None:
    depth = plate(3.0, slice(20, 32)) + plate(1.5, slice(70, 82))
    found = body_lines(depth, CAMERA, NO_FLOOR)
    shown = pictures(found)
    assert (shown["16 bits above the floor"][depth == 3.0] == 255).all()
    np.testing.assert_allclose(shown["16 bits above the floor"][depth == 1.5], 127, atol=1)
    mask = np.bitwise_or.reduce([body.mask for body in found.bodies])
    np.testing.assert_array_equal(shown["outlines"], mask)
    lit = (shown["thinning"] == 255).all(axis=-1)
    assert lit.any()
    assert (lit[np.bitwise_or.reduce([body.thinned for body in found.bodies]) > 0]).all()
    assert (shown["thinning"][mask == 0] == 0).mean() > 0.9
    for body in found.bodies:
        for x, y in body.ends_px.astype(int):
            assert shown["lines"][y, x].tolist() == [80, 220, 80]
