"""Tags in pictures: rendered with truth, found to a fraction of a pixel, and what is not there is not told."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.markers import MarkerFrame, joined, marker_frame
from mocapella.model.tags import corner_names, corner_places
from mocapella.schema import decode_frame, encode_frame
from mocapella.sensing.markers import linear_light
from mocapella.sensing.tags import TagDetector, TagSettings, draw_tag, refined_corners
from mocapella.sources.simulate.camera_image import CameraImageSettings, camera_image
from mocapella.sources.simulate.tag_picture import draw_tags

LENS = np.array([265.0, 265, 159.5, 119.5, -0.08, 0.01, 0.001, 0, 0])
SIDE_M = 0.06
FACING = np.diag([1.0, -1.0, -1.0])
"""``R_camera_tag`` of a tag that looks into the camera, upright."""


def placed(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn = exp_twist(np.r_[0, 0, 0, rng.uniform(-0.5, 0.5, 3)])[:3, :3]
    return rigid(turn @ FACING, [rng.uniform(-0.1, 0.1), rng.uniform(-0.06, 0.06), rng.uniform(0.3, 0.5)])


@cache
def picture(seed: int, *numbers: int, dictionary: str = "APRILTAG_36H11", apart_m: float = 0.0) -> np.ndarray:
    linear = np.full((240, 320, 3), 0.25, np.float32)
    T = {n: placed(seed) @ rigid(np.eye(3), [k * apart_m, 0, 0]) for k, n in enumerate(numbers)}
    draw_tags(linear, LENS, T, dictionary=dictionary, side_m=SIDE_M)
    return camera_image(linear, CameraImageSettings(), np.random.default_rng(seed))


@pytest.mark.slow
@pytest.mark.parametrize("dictionary", ["APRILTAG_36h11", "DICT_4X4_50"])
def test_corners_are_where_they_were_drawn_as_nearly_as_is_said(dictionary: str) -> None:
    detector, off, standard = TagDetector("left", TagSettings(dictionary)), [], []
    for seed in range(25):
        frame = detector.update(picture(seed, 7, dictionary=dictionary), seed / 30)
        if not frame.names:  # too slanted to be read, or partly outside
            continue
        assert frame.names == corner_names(7)
        error = frame.positions_px - project(apply(placed(seed), corner_places(SIDE_M)), LENS)
        off.append(np.linalg.norm(error, axis=-1))
        standard.append(error / frame.sd_px[:, None])
    assert np.median(off) < 0.1
    assert np.percentile(off, 95) < 0.3
    assert 0.4 < np.sqrt(np.mean(np.square(standard))) < 2.0
    assert detector.report.images == 25
    assert detector.report.found >= 22


def dark_square(left: float, top: float, width: float, height: float) -> np.ndarray:
    """A dark rectangle on light ground; each pixel has the mean of the linear light on its area."""
    pixels = np.arange(80)[:, None] + np.array([-0.5, 0.5])
    along, down = (
        np.clip(np.minimum(pixels[:, 1], begin + size) - np.maximum(pixels[:, 0], begin), 0, 1)
        for begin, size in ((left, width), (top, height))
    )
    linear = 0.7 - 0.65 * down[:, None] * along
    return np.asarray(np.interp(linear, linear_light(), np.arange(256)).round(), np.uint8)


@pytest.mark.parametrize(("turns", "room"), [(0, 5), (1, 4), (2, 4), (3, 5)])
@pytest.mark.parametrize("seen", [True, False])
def test_a_side_is_measured_if_all_pixels_about_its_profiles_are_in_the_image(
    turns: int, room: int, seen: bool
) -> None:
    """Profiles reach 4 px outwards; to the right and below, interpolation takes one pixel more."""
    room -= not seen
    left, top, side = 20, 20, 40
    right, bottom = left + side, top + side
    whole = dark_square(left, top, side, side)
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], np.float64)
    cut, last = whole[:, : right + room + 1], right + room
    for _ in range(turns):  # a quarter turn takes the side that is cut to the next border
        corners = np.stack([corners[:, 1], last - corners[:, 0]], axis=-1)
        cut, last = np.rot90(cut), cut.shape[0] - 1
    found, sd = refined_corners(np.ascontiguousarray(cut), corners, 8, 4.0, 20.0)
    assert np.isnan(sd).sum() == (0 if seen else 2)
    np.testing.assert_allclose(found, corners, atol=0.02)


SQUARE = np.array([[20.0, 20.0], [60.0, 20.0], [60.0, 60.0], [20.0, 60.0]])


def unmeasured(image: np.ndarray, *, reach_px: float = 4.0, least_contrast: float = 20.0) -> int:
    """How many corners of that square are not refined."""
    return int(np.isnan(refined_corners(image, SQUARE, 8, reach_px, least_contrast)[1]).sum())


def test_a_side_needs_six_profiles_in_the_image() -> None:
    """Those of the left and right sides are 1.03 px apart, from 24 px on."""
    whole = dark_square(20, 20, 40, 40)
    assert unmeasured(whole[:31]) == 2
    assert unmeasured(whole[:30]) == 4


def test_a_side_needs_its_contrast_in_linear_light_and_a_profile_of_a_pixel_to_either_side() -> None:
    whole = dark_square(20, 20, 40, 40)
    contrast = 0.65 * 255
    assert unmeasured(whole, least_contrast=contrast - 2) == 0
    assert unmeasured(whole, least_contrast=contrast + 2) == 4
    assert unmeasured(whole, reach_px=1.0) == 0
    assert unmeasured(whole, reach_px=np.nextafter(1.0, 0)) == 4


@given(
    st.tuples(st.floats(14, 20), st.floats(14, 20), st.floats(36, 46), st.floats(36, 46)),
    st.lists(st.floats(-0.7, 0.7), min_size=8, max_size=8),
    st.integers(0, 3),
)
def test_refined_corners_are_the_squares_wherever_it_lies_between_the_pixels(
    placed: tuple[float, float, float, float], off: list[float], first: int
) -> None:
    left, top, width, height = placed
    corners = np.array([[left, top], [left + width, top], [left + width, top + height], [left, top + height]])
    corners = np.roll(corners, first, axis=0)
    about, _ = refined_corners(dark_square(*placed), corners + np.reshape(off, (4, 2)), 8, 4.0, 20.0)
    found, sd = refined_corners(dark_square(*placed), about, 8, 4.0, 20.0)
    assert np.abs(found - corners).max() < 0.02
    assert (sd < 0.1).all()


@settings(max_examples=10)
@given(st.integers(0, 60), st.integers(0, 60))
def test_a_square_that_is_moved_by_whole_pixels_has_its_corners_moved_by_as_many(right: int, down: int) -> None:
    noise = np.random.default_rng(0).integers(-3, 4, (80, 80))
    square = np.clip(dark_square(17.3, 16.8, 40.4, 38.7) + noise, 0, 255).astype(np.uint8)
    corners = np.array([[17.0, 17], [58, 16.5], [57.5, 56], [17.5, 55]])
    wide = np.full((140, 140), square.max())
    wide[down : down + 80, right : right + 80] = square
    found, sd = refined_corners(square, corners, 8, 4.0, 20.0)
    moved, moved_sd = refined_corners(wide, corners + np.array([right, down]), 8, 4.0, 20.0)
    assert np.isfinite(sd).all()
    np.testing.assert_allclose(moved - [right, down], found, atol=1e-9)
    np.testing.assert_allclose(moved_sd, sd, rtol=1e-6)


def test_a_gray_picture_and_one_of_an_array_that_is_no_copy_give_the_same() -> None:
    image = picture(1, 3)
    wide = np.zeros((240, 640, 3), np.uint8)
    wide[:, 100:420] = image
    one, other = (TagDetector("left").update(i, 0.5) for i in (image, wide[:, 100:420]))
    np.testing.assert_array_equal(one.positions_px, other.positions_px)
    assert (one.time_ns, one.size_px, one.sequence) == (500_000_000, (320, 240), 0)
    decoded = decode_frame(encode_frame(one))
    assert isinstance(decoded, MarkerFrame)
    np.testing.assert_array_equal(decoded.positions_px, one.positions_px)


def test_only_the_wanted_tags_are_told_in_the_order_of_their_numbers() -> None:
    image = picture(2, 9, 4, apart_m=0.09)
    both = TagDetector("left").update(image, 0.0)
    assert both.names == (*corner_names(4), *corner_names(9))
    detector = TagDetector("left", TagSettings(ids=(9,)))
    assert detector.update(image, 0.0).names == corner_names(9)
    assert (detector.report.found, detector.report.unwanted) == (1, 1)


def test_two_tags_of_one_number_are_none() -> None:
    one = picture(1, 5)
    detector = TagDetector("left")
    frame = detector.update(np.hstack([one, one]), 0.0)
    assert (frame.names, detector.report.twice, detector.report.found) == ((), 1, 0)


def test_without_a_tag_there_is_a_frame_without_markers() -> None:
    frame = TagDetector("left").update(np.full((240, 320, 3), 90, np.uint8), 1.0)
    assert (frame.names, frame.positions_px.shape, frame.size_px) == ((), (0, 2), (320, 240))
    decode_frame(encode_frame(frame))


def test_sides_that_cannot_be_measured_leave_corners_where_opencv_sees_them_and_unsure() -> None:
    detector = TagDetector("left", TagSettings(least_contrast=250.0))
    frame = detector.update(picture(3, 7), 0.0)
    assert (frame.sd_px > 0.5).all()
    assert detector.report.unrefined == 4
    error = frame.positions_px - project(apply(placed(3), corner_places(SIDE_M)), LENS)
    assert np.linalg.norm(error, axis=-1).max() < 3.0


@pytest.mark.parametrize(("off_px", "refined"), [(2.0, True), (3.2, False)])
@pytest.mark.parametrize("at_px", [16.0, 24.0])
def test_a_corner_half_a_cell_from_opencvs_belongs_to_another_edge(at_px: float, off_px: float, refined: bool) -> None:
    """A cell of this tag of eight is five pixels wide; where the tag is in the image does not matter."""
    true = np.array([[0, 0], [40, 0], [40, 40], [0, 40]]) + at_px
    near = true + off_px / np.sqrt(2) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    detector = TagDetector("left", TagSettings(reach_px=50.0))
    found, sd = detector._corners(dark_square(at_px, at_px, 40, 40), near)
    np.testing.assert_allclose(found, true if refined else near, atol=0.05)
    assert (sd < 0.2).all() == refined


def test_markers_of_one_picture_are_joined() -> None:
    tags = TagDetector("left").update(picture(4, 7), 0.0)
    colours = marker_frame("left", ["red"], time_ns=5, size_px=(320, 240), positions_px=[[3, 4]], node_id=8, sequence=9)
    colours = type(colours)(**{n: getattr(colours, n) for n in colours.__struct_fields__} | {
        "elongations": np.array([1.5], np.float32), "candidates": np.array([2], np.uint8)})  # fmt: skip
    both = joined(colours, tags)
    assert both.names == ("red", *corner_names(7))
    assert both.key == ("left", 8, 9)
    assert both.time_ns == 5
    np.testing.assert_array_equal(both.positions_px[1:], tags.positions_px)
    np.testing.assert_array_equal(both.sd_px[1:], tags.sd_px)
    assert both.elongations is not None
    assert both.candidates is not None
    assert both.elongations[0] == 1.5
    assert np.isnan(both.elongations[1:]).all()
    assert both.candidates.tolist() == [2, 0, 0, 0, 0]
    with pytest.raises(SettingsError, match="two detectors call a marker 'tag7"):
        joined(tags, tags)
    other = marker_frame("right", [], time_ns=5, size_px=(320, 240), positions_px=np.empty((0, 2)))
    with pytest.raises(SettingsError, match="only those of one picture"):
        joined(colours, other)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"dictionary": "APRILTAG_36H12"}, "DICT_APRILTAG_36H11"),
        ({"ids": (1, 1)}, "each once"),
        ({"ids": (587,)}, "0 to 586"),
        ({"sd_floor_px": 0.0}, "sd_floor_px"),
        ({"reach_px": 0.5}, "reach_px"),
        ({"least_contrast": 255.0}, "least_contrast"),
    ],
)
def test_settings_that_cannot_be_are_refused(changed: dict, said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        TagSettings(**changed)


def test_what_is_no_image_is_refused() -> None:
    for image in (np.zeros((4, 4), np.float32), np.zeros((4, 4, 4), np.uint8), np.zeros(4, np.uint8)):
        with pytest.raises(SettingsError, match="uint8"):
            TagDetector("left").update(image, 0.0)
    with pytest.raises(SettingsError, match="side_px"):
        draw_tag("APRILTAG_36H11", 1, 4)


def test_a_tag_from_behind_is_not_drawn() -> None:
    linear = np.full((40, 40, 3), 0.25, np.float32)
    behind = rigid(np.eye(3), [0, 0, 0.3])
    draw_tags(linear, LENS, {1: behind}, dictionary="APRILTAG_36H11", side_m=SIDE_M)
    assert (linear == np.float32(0.25)).all()
