"""The baseline on drawn arms and real frames: its geometry, its rules, and what it says of images it cannot use."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

cv2 = pytest.importorskip("cv2")

from support.drawn_arms import CAMERA, DISTANCE_M, arm, drawn  # noqa: E402 - only where there is OpenCV

from mocapella.detectors import ArmDetector  # noqa: E402
from mocapella.errors import SettingsError  # noqa: E402
from mocapella.geometry.lens import project  # noqa: E402
from mocapella.model.arms import ARM_JOINTS, PALM  # noqa: E402
from mocapella.model.camera import Camera  # noqa: E402
from mocapella.sensing.line_skeleton import LineSkeleton, LineSkeletonSettings  # noqa: E402
from mocapella.sensing.line_skeleton_joints import _merged, elbow_of, palm_and_wrist  # noqa: E402
from mocapella.sensing.line_skeleton_outline import outline, separated  # noqa: E402
from mocapella.sensing.line_skeleton_sheet import contact_sheet, pictures, write_stages  # noqa: E402

STAGES = [
    *(
        "16 bits",
        "8 bits",
        "median",
        "Gaussian",
        "threshold",
        "mirror",
        "Canny",
        "contours",
        "circular region",
        "noise",
    ),
    *("thinning", "distance transform", "Laplacian, normalised", "dilation", "thin on ridges", "Hough", "grid"),
    *("Harris", "convex hulls", "outer fingers", "blobs", "arm"),
]
FRAMES = Path(__file__).resolve().parents[3] / "shared" / "data" / "depth_hand_sr305" / "frames"
SR305 = Camera("sr305", (640, 480), np.array([476.007, 476.007, 313.683, 242.755, 0, 0, 0, 0, 0]))
UNSEEN = [k for k in range(23) if k not in ARM_JOINTS]


def small(width: int = 160, height: int = 120) -> Camera:
    return Camera("small", (width, height), np.array([120.0, 120.0, (width - 1) / 2, (height - 1) / 2, 0, 0, 0, 0, 0]))


def off_m(seen: Any, truth: Any) -> Any:
    return np.linalg.norm(seen.joints - truth[list(ARM_JOINTS)], axis=-1)


@pytest.mark.parametrize("degrees", [0, 45, -45, -90])
def test_an_open_hand_is_found_where_the_rules_expect_its_arm(degrees: int) -> None:
    scene, detector = arm(rotation_degrees=degrees), LineSkeleton(CAMERA)
    (seen,) = detector.update(scene.depth, 0.0).arms
    assert (off_m(seen, scene.truth)[3:] < 0.012).all()
    assert (off_m(seen, scene.truth)[:3] < 0.05).all()
    assert (seen.joint_states == 2).all()
    assert (seen.id, seen.left, seen.left_sure, seen.T_camera_palm) == (0, False, 0.5, None)
    assert np.isnan(seen.points[UNSEEN]).all()
    assert np.isnan(seen.sd[UNSEEN]).all()
    assert np.isnan(seen.angles).all()
    assert not seen.states[UNSEEN].any()


def test_it_is_an_arm_detector() -> None:
    detector: ArmDetector = LineSkeleton(CAMERA)
    assert detector.name == "line-skeleton"


def test_a_finger_before_the_palm_is_a_blob() -> None:
    scene = arm("before palm", rotation_degrees=-45)
    looked = LineSkeleton(CAMERA).look(scene.depth)
    assert looked.hand is not None
    assert (len(looked.hand.outer), len(looked.hand.blobs)) == (4, 1)
    (seen,) = LineSkeleton(CAMERA).update(scene.depth, 0.0).arms
    assert off_m(seen, scene.truth)[4] < 0.012


def test_without_a_mirror_a_mirrored_picture_gives_the_same_hand_mirrored() -> None:
    """(639 - x) is where a pixel is in the mirror; the drawn camera's axis is half a pixel beside the middle."""
    middle = replace_lens(cx=319.5)
    scene = arm(rotation_degrees=-45, camera=middle)
    (seen,) = LineSkeleton(middle).update(scene.depth, 0.0).arms
    plain = LineSkeleton(middle, LineSkeletonSettings(mirror=False))
    (other,) = plain.update(np.ascontiguousarray(scene.depth[:, ::-1]), 0.0).arms
    np.testing.assert_allclose(other.joints * [-1, 1, 1], seen.joints, atol=1e-9)


def replace_lens(cx: float) -> Camera:
    return Camera("middle", CAMERA.size_px, np.array([476.0, 476.0, cx, 239.5, 0, 0, 0, 0, 0]))


def test_the_palm_is_two_centimetres_before_its_pixel() -> None:
    scene = arm()
    (seen,) = LineSkeleton(CAMERA).update(scene.depth, 0.0).arms
    (flat,) = LineSkeleton(CAMERA, LineSkeletonSettings(palm_forward_m=0.0)).update(scene.depth, 0.0).arms
    assert flat.points[PALM, 2] - seen.points[PALM, 2] == pytest.approx(0.02)
    np.testing.assert_allclose(project(flat.points[PALM], CAMERA.lens), project(seen.points[PALM], CAMERA.lens))


points = st.tuples(st.floats(-500, 500), st.floats(-500, 500)).map(np.array)


@given(points, points)
def test_palm_and_wrist_are_on_the_line_from_the_elbow_through_the_centre(elbow: Any, centre: Any) -> None:
    """P = R + (R − E)/2, and the wrist a quarter of the way back from the palm to the elbow."""
    palm, wrist = palm_and_wrist(centre, elbow)
    np.testing.assert_allclose(palm, centre + (centre - elbow) / 2, atol=1e-9)
    np.testing.assert_allclose(wrist, palm + (elbow - palm) / 4, atol=1e-9)


@given(st.lists(st.tuples(*[st.floats(0, 600)] * 4), min_size=1, max_size=6), st.floats(0, 180), points)
def test_the_elbow_is_the_end_that_the_angle_says(rows: list[Any], degrees: float, centre: Any) -> None:
    segments = np.array(rows)
    ends = segments.reshape(-1, 2)
    elbow = elbow_of(segments, degrees, centre)
    lowest, right = ends[:, 1].max(), ends[:, 0].max()
    if degrees < 60:
        assert elbow[1] == lowest
    elif degrees <= 130:
        assert elbow[0] == ends[:, 0].min()
    else:
        assert (elbow[0] == right and elbow[1] >= centre[1]) or elbow[1] == lowest


def test_fingers_that_are_not_found_go_to_the_palm_and_say_so() -> None:
    (seen,) = LineSkeleton(CAMERA).update(arm("fist").depth, 0.0).arms
    lost = seen.joint_states == 1
    assert lost.any()
    assert not lost[:3].any()
    np.testing.assert_array_equal(seen.joints[lost], np.tile(seen.points[PALM], (lost.sum(), 1)))
    assert (seen.sd[list(ARM_JOINTS)][lost] > seen.sd[list(ARM_JOINTS)][~lost].max()).all()


def test_a_joint_where_the_lens_shows_nothing_is_not_known() -> None:
    """The model of this lens folds back before the lower border, where the elbow is."""
    folding = Camera("folding", (640, 480), np.array([476.0, 476.0, 320.0, 140.0, -1.2, 0, 0, 0, 0]))
    (seen,) = LineSkeleton(folding).update(arm().depth, 0.0).arms
    known = np.isfinite(seen.joints).all(axis=-1)
    assert not known[0]
    assert known[1:3].all()
    np.testing.assert_array_equal(seen.joint_states > 0, known)
    np.testing.assert_array_equal(np.isfinite(seen.sd[list(ARM_JOINTS)]), known)


def test_a_finger_that_would_be_too_long_goes_to_the_palm() -> None:
    (seen,) = LineSkeleton(CAMERA, LineSkeletonSettings(longest_m=0.01)).update(arm().depth, 0.0).arms
    assert (seen.joint_states[3:] == 1).all()


def test_a_tip_that_is_too_thick_is_none() -> None:
    looked = LineSkeleton(CAMERA, LineSkeletonSettings(tip_fill_most=0.05)).look(arm().depth)
    assert looked.hand is not None
    assert len(looked.hand.outer) == 0


def test_small_hulls_and_small_outlines_are_filtered() -> None:
    looked = LineSkeleton(CAMERA, LineSkeletonSettings(least_hull_px2=1e6)).look(arm().depth)
    assert looked.hand is not None
    assert (looked.hand.hulls, len(looked.hand.outer)) == ((), 0)
    seen = LineSkeleton(CAMERA, LineSkeletonSettings(least_area_px=1e6)).update(arm().depth, 0.0)
    assert seen.arms == ()
    assert "no outline is larger than 1e+06 px²" in seen.reason


@pytest.mark.parametrize("angle_at", ["palm", "wrist"])
def test_the_angle_of_fingers_may_be_measured_at_either(angle_at: Any) -> None:
    scene = arm(rotation_degrees=-45)
    (seen,) = LineSkeleton(CAMERA, LineSkeletonSettings(angle_at=angle_at)).update(scene.depth, 0.0).arms
    assert (off_m(seen, scene.truth)[3:] < 0.012).all()


def test_noise_is_set_far_away_or_to_its_neighbours_median() -> None:
    depth, s = arm().depth.copy(), LineSkeletonSettings()
    hole = 300, 320
    assert depth[hole] > 0
    depth[hole] = 0
    for noise, wanted in (("far", 3.0), ("median", DISTANCE_M - 0.03)):
        chosen = replace(s, noise=noise)  # type: ignore[arg-type]
        made = outline(separated(depth, chosen), chosen)
        assert made is not None
        assert made.noisy[hole[0], 639 - hole[1]]
        assert made.metres[hole[0], 639 - hole[1]] == pytest.approx(wanted, abs=0.01)
        (seen,) = LineSkeleton(CAMERA, chosen).update(depth, 0.0).arms
        assert (off_m(seen, arm().truth)[3:] < 0.012).all()


def test_a_body_behind_is_beyond_the_threshold_and_one_too_near_is_not() -> None:
    scene = arm(behind_m=1.1, rotation_degrees=-45)
    (seen,) = LineSkeleton(CAMERA).update(scene.depth, 0.0).arms
    assert (off_m(seen, scene.truth)[3:] < 0.012).all()
    near = LineSkeleton(CAMERA, LineSkeletonSettings(reach_m=0.5)).update(scene.depth, 0.0)
    assert near.arms == ()
    assert "more than 60% of the image" in near.reason


@pytest.mark.parametrize("grid_px", [1, 2, 4, 5, 8, 10])
def test_a_coarser_grid_has_fewer_points(grid_px: int) -> None:
    looked = LineSkeleton(CAMERA, LineSkeletonSettings(grid_px=grid_px)).look(arm().depth)
    assert looked.grid is not None
    assert looked.outline is not None
    assert not (looked.grid.pixels % grid_px).any()
    area = np.count_nonzero(looked.outline.arm) / grid_px**2
    assert len(looked.grid.pixels) == pytest.approx(area, rel=0.1)


def test_the_cube_region_ends_at_its_sides_too() -> None:
    scene = arm()
    for far_m, some in ((1.4, True), (0.85, False)):  # 0.325 m to each side of the axis: the elbow's end is beyond
        looked = LineSkeleton(CAMERA, LineSkeletonSettings(far_m=far_m)).look(scene.depth)
        assert looked.grid is not None
        beyond = np.abs((looked.grid.pixels[:, 1] - 240) / 476) * looked.grid.metres > 0.325
        assert beyond.any() == some


def test_stages_are_in_order_and_can_be_written(tmp_path: Path) -> None:
    stages = LineSkeleton(CAMERA).stages(arm().depth)
    assert list(stages) == STAGES
    for picture in stages.values():
        assert picture.dtype == np.uint8
        assert picture.shape[:2] == (480, 640)
        assert picture.any() or picture is stages["blobs"]
    files = write_stages(stages, tmp_path / "new", name="frame-7")
    assert [path.name for path in files[:2]] == ["frame-7-01-16-bits.png", "frame-7-02-8-bits.png"]
    assert len(files) == len(STAGES) + 1
    np.testing.assert_array_equal(cv2.imread(str(files[5]), cv2.IMREAD_UNCHANGED), stages["mirror"])
    np.testing.assert_array_equal(cv2.imread(str(files[-1])), contact_sheet(stages))


def test_stages_that_are_not_reached_are_left_out(tmp_path: Path) -> None:
    stages = LineSkeleton(CAMERA).stages(np.zeros((480, 640), dtype=np.float32))
    assert list(stages) == STAGES[:6]
    assert write_stages(stages, tmp_path)[-1].is_file()


def test_stages_are_not_written_where_a_file_is(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(SettingsError, match="name a folder that can be written to"):
        write_stages({"x": np.zeros((4, 4), dtype=np.uint8)}, tmp_path / "taken")
    (tmp_path / "stages-01-x.png").mkdir()
    with pytest.raises(SettingsError, match=r"stages-01-x.png: .*name a folder that can be written to"):
        write_stages({"x": np.zeros((4, 4), dtype=np.uint8)}, tmp_path)


def filled(value: float, shape: tuple[int, int] = (120, 160)) -> Any:
    return np.full(shape, value, dtype=np.float32)


@pytest.mark.parametrize(
    ("depth", "reason"),
    [
        (filled(0.0), "nothing was measured"),
        (filled(np.nan), "nothing was measured"),
        (filled(-1.0), "nothing was measured"),
        (filled(600.0), "the nearest is at 65.5"),  # millimetres that were given as metres
        (filled(0.0006), "give the right unit"),
        (filled(np.inf), "nothing lies between 0.2 and 1.4 m"),
        (filled(0.5), "takes up more than 60% of the image"),
    ],
)
def test_images_without_an_arm_have_a_reason(depth: Any, reason: str) -> None:
    seen = LineSkeleton(small(), LineSkeletonSettings(least_area_px=200)).update(depth, 0.0)
    assert seen.arms == ()
    assert reason in seen.reason


def test_a_ball_is_no_arm() -> None:
    camera = small()
    ball = drawn([(np.array([0, 0, 0.6]), np.array([0, 0.001, 0.6]), 0.06)], camera)
    seen = LineSkeleton(camera, LineSkeletonSettings(least_area_px=200)).update(ball, 0.0)
    assert (seen.arms, seen.reason) == ((), "no line in the skeleton: the nearest object is not an arm")


def test_an_arm_of_which_no_point_is_in_the_cube_region_says_so() -> None:
    camera = small(width=320)
    aside = drawn([(np.array([0.6, -0.2, 0.6]), np.array([0.6, 0.2, 0.6]), 0.03)], camera)
    detector = LineSkeleton(camera, LineSkeletonSettings(least_area_px=200, far_m=0.8))
    assert "no point of the grid" in detector.update(aside, 0.0).reason


@given(st.integers(1, 24), st.integers(1, 24), st.integers(0, 2**32 - 1))
def test_no_tiny_image_is_too_much_for_it(width: int, height: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random((height, width)) < 0.8, rng.uniform(0.1, 1.5, (height, width)), np.nan)
    detector = LineSkeleton(small(width, height), LineSkeletonSettings(least_area_px=0, reach_m=1.0, fills_most=1.0))
    seen = detector.update(depth.astype(np.float32), 0.0)
    assert bool(seen.arms) != bool(seen.reason)


@pytest.mark.parametrize("shape", [(119, 160), (160, 120), (120,), (120, 160, 1)])
def test_an_image_of_another_size_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(SettingsError, match="camera small has 160 × 120 px"):
        LineSkeleton(small()).update(np.zeros(shape, dtype=np.float32), 0.0)


def test_an_arm_that_comes_back_is_another_and_reset_forgets() -> None:
    scene, detector = arm(), LineSkeleton(CAMERA)
    nothing = np.zeros_like(scene.depth)
    ids = [[one.id for one in detector.update(d, 0.0).arms] for d in (nothing, scene.depth, scene.depth, nothing)]
    assert ids == [[], [0], [0], []]
    assert detector.update(scene.depth, 0.0).arms[0].id == 1
    detector.reset()
    assert detector.update(scene.depth, 0.0).arms[0].id == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("near_m", 1.4), ("near_m", 0.0), ("far_m", 21.0), ("reach_m", 0.0), ("noise_m", -1.0), ("median_px", 7),
        ("gaussian_px", 4), ("canny_low", 200.0), ("least_area_px", -1.0), ("noise", "near"), ("angle_at", "elbow"),
        ("ridge_least", 256), ("hough_votes", 0), ("corner_part", 0.0), ("tip_fill_most", 1.5), ("fills_most", 0.0),
        ("finger_degrees", 181.0), ("palm_forward_m", 0.2), ("grid_px", 0), ("longest_m", 0.0), ("tip_radius_m", 0.0),
        ("blob_nearer_m", 0.0), ("hough_gap_px", -1.0), ("hough_length_px", -1.0), ("least_hull_px2", -1.0),
        ("blob_least_m2", -1.0),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(name: str, value: Any) -> None:
    assert name in {field.name for field in fields(LineSkeletonSettings)}
    with pytest.raises(SettingsError, match="must be"):
        LineSkeletonSettings(**{name: value})


@pytest.mark.skipif(not FRAMES.is_dir(), reason="needs depth_hand_sr305")
def test_real_frames_give_an_arm_and_all_stages() -> None:
    detector = LineSkeleton(SR305)
    files = sorted(FRAMES.glob("*.png"))
    assert files
    for path in files:
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32) * np.float32(0.000125)
        (seen,) = detector.update(depth, 0.0).arms
        assert np.isfinite(seen.joints).all()
        assert (seen.joint_states > 0).all()
        assert (np.linalg.norm(seen.joints[3:] - seen.points[PALM], axis=-1) <= 1.5).all()
    assert list(detector.stages(depth)) == STAGES


@pytest.mark.parametrize("factor", [1, 7])
def test_the_picture_of_the_range_is_as_bright_as_far_and_the_farthest_is_white(factor: int) -> None:
    looked = LineSkeleton(CAMERA).look(arm().depth)
    separated_mm = looked.separated.millimetres
    first = replace(looked.separated, millimetres=(separated_mm // factor).astype(separated_mm.dtype))
    shown, far = pictures(replace(looked, separated=first))["16 bits"].astype(float), first.millimetres.astype(float)
    assert shown.max() == 255
    assert (shown[far == far.max()] == 255).all()
    assert (shown[far == 0] == 0).all()
    np.testing.assert_allclose(shown / 255, far / far.max(), atol=1 / 255)


def test_the_picture_of_distances_is_brightest_where_the_arm_is_thickest() -> None:
    looked = LineSkeleton(CAMERA).look(arm().depth)
    assert looked.lines is not None
    distance = looked.lines.skeleton.distance
    shown = pictures(looked)["distance transform"]
    np.testing.assert_allclose(shown / 255, distance / distance.max(), atol=1.01 / 255)
    assert distance.max() > 10


def test_a_blob_is_a_tip_if_it_is_farther_from_all_outer_tips_than_the_limit_up_to_five_tips() -> None:
    outer = np.array([[0.0, 0.0], [20.0, 0.0]])
    for blob, apart_px, kept in (((3, 4), 4.99, True), ((3, 4), 5, False), ((17, 4), 5, False), ((10, 0), 9.99, True)):
        found = _merged(outer, np.array([blob], np.float64), apart_px)
        assert found.tolist() == [*outer.tolist(), *([list(blob)] if kept else [])]
    many = np.array([[50.0, 0.0], [51.0, 0.0], [0.0, 1.0], [52.0, 0.0], [53.0, 0.0]])
    assert _merged(outer, many, 5).tolist() == [*outer.tolist(), *many[[0, 1, 3]].tolist()], "blobs may be near another"
    assert _merged(np.zeros((0, 2)), np.zeros((0, 2)), 5).shape == (0, 2)
