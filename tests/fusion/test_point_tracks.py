from __future__ import annotations

import numpy as np
import pytest
from support.marker_motion import LENS, hand, pair

from mocapella.errors import InputError, SettingsError
from mocapella.fusion.point_tracks import METHODS, TracksSettings, triangulate_tracks
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.point_tracks import ImageTracks, match_cameras

RIG = pair(readout_s=0.0, clock_s=2.0)
TRUTH = np.stack([hand(t) for t in (0.0, 0.1, 0.2)])
POINTS = tuple("abcde")


def tracks(cameras: tuple[str, ...] = ("left", "right")) -> ImageTracks:
    pixels = np.stack([project(apply(c.T_camera_world, TRUTH), LENS) for c in RIG.cameras.values()], axis=1)
    at_s = np.array([[0.0, 2.0], [0.1, 2.1], [np.nan, np.nan]])
    return ImageTracks(cameras, POINTS, np.arange(3), at_s, pixels, np.ones((3, 2, 5)))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_where_points_were(method: str) -> None:
    space, report = triangulate_tracks(tracks(), RIG, TracksSettings(method))
    np.testing.assert_allclose(space.positions, TRUTH, atol=1e-7)
    assert (space.views == 2).all()
    assert report.counted["seen"] == 15
    assert report.residual_px < 1e-4
    np.testing.assert_allclose(space.at_s, [0.0, 0.1, np.nan], atol=1e-12)  # on the rig's clock
    assert np.isfinite(space.sds).all() == (method == "robust")


def test_an_unsure_detection_is_not_used_and_a_wrong_one_is_counted() -> None:
    seen = tracks()
    seen.confidences[0, 0, 0] = 0.2
    seen.pixels[1, 1, 1, 1] += 60.0
    space, report = triangulate_tracks(seen, RIG)
    assert report.counted == {"seen": 13, "one_view": 1, "parallel": 0, "behind": 0, "inconsistent": 1}
    assert np.isnan(space.positions[0, 0]).all()
    assert np.isnan(space.residuals_px[1, 1])
    assert report.cameras["left"].seen == 13
    assert report.cameras["left"].rejected_share == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_a_camera_that_is_far_wrong_is_left_out_unless_all_cameras_must_agree(method: str) -> None:
    """The third camera stands 0.3 m above the left one."""
    left, up = RIG.cameras["left"], rigid(np.eye(3), [0.0, 0.3, 0.0])
    above = PlacedCamera(left.camera, left.T_camera_world @ up, left.covariance)
    rig = CameraRig({**RIG.cameras, "above": above})
    pixels = np.stack([project(apply(c.T_camera_world, TRUTH), LENS) for c in rig.cameras.values()], axis=1)
    pixels[:, 1, 0] += 200.0
    seen = ImageTracks(tuple(rig.cameras), POINTS, np.arange(3), np.zeros((3, 3)), pixels, np.ones((3, 3, 5)))
    space, report = triangulate_tracks(seen, rig, TracksSettings(method))
    np.testing.assert_allclose(space.positions[:, 1:], TRUTH[:, 1:], atol=1e-6)
    if method == "linear":
        assert np.isnan(space.positions[:, 0]).all()
        assert report.counted["inconsistent"] == 3
    else:
        np.testing.assert_allclose(space.positions[:, 0], TRUTH[:, 0], atol=1e-6)
        assert space.views.tolist() == [[2, 3, 3, 3, 3]] * 3


@pytest.mark.parametrize("method", METHODS)
def test_a_detection_is_used_that_is_surer_than_the_least_confidence(method: str) -> None:
    seen = tracks()
    seen.confidences[0, 0, 0], seen.confidences[0, 0, 1] = 0.25, 0.26
    space, report = triangulate_tracks(seen, RIG, TracksSettings(method, least_confidence=0.25))
    assert np.isfinite(space.positions[0]).all(axis=-1).tolist() == [False, True, True, True, True]
    assert (report.counted["seen"], report.cameras["left"].seen) == (14, 14)


def test_half_as_sure_is_so_much_less_certain() -> None:
    sure, unsure = tracks(), tracks()
    unsure.confidences[:] = 0.5
    one, other = (triangulate_tracks(seen, RIG)[0].sds for seen in (sure, unsure))
    np.testing.assert_allclose(other, one * np.sqrt(2), rtol=1e-6)


def test_the_uncertainty_is_as_large_as_the_error_of_a_coordinate() -> None:
    rng, frames = np.random.default_rng(0), 400
    clean = project(apply(np.stack([c.T_camera_world for c in RIG.cameras.values()])[:, None], TRUTH), LENS)
    pixels = np.tile(clean.transpose(1, 0, 2, 3)[:1], (frames, 1, 1, 1))
    pixels += rng.normal(0, TracksSettings().sd_px, pixels.shape)
    at_s, sure = np.zeros((frames, 2)), np.ones((frames, 2, len(POINTS)))
    space, _ = triangulate_tracks(ImageTracks(("left", "right"), POINTS, np.arange(frames), at_s, pixels, sure), RIG)
    error = np.sqrt(np.nanmean((space.positions - TRUTH[0]) ** 2))
    assert np.sqrt(np.nanmean(space.sds**2)) == pytest.approx(error, rel=0.1)


def test_cameras_are_matched_by_name_and_the_order_does_not_matter() -> None:
    seen = tracks()
    turned = ImageTracks(
        ("Right_json", "left"), POINTS, seen.frames, seen.at_s[:, ::-1], seen.pixels[:, ::-1], seen.confidences
    )
    np.testing.assert_allclose(triangulate_tracks(turned, RIG)[0].positions, TRUTH, atol=1e-9)
    assert match_cameras(["cam01_json", "2", "10"], ["cam_2", "cam_1", "Camera-010"]) == [
        "cam_1",
        "cam_2",
        "Camera-010",
    ]
    assert match_cameras(["0"], ["cam_0", "cam_1"]) == ["cam_0"]


@pytest.mark.parametrize(
    ("seen", "rig", "said"),
    [
        (["cam3"], ["cam1", "cam2"], "'cam3': the rig has no such camera; the rig's are cam1, cam2"),
        (["cam1"], ["cam_1", "camera1"], "the rig has several: cam_1, camera1"),
        (["cam1", "cam_1"], ["cam1"], "two cameras are the same"),
    ],
)
def test_cameras_that_cannot_be_matched_are_said(seen: list[str], rig: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        match_cameras(seen, rig)


@pytest.mark.parametrize(
    ("name", "value"),
    [("method", "magic"), ("sd_px", 0.0), ("gate_sd", 0.0), ("least_confidence", 1.0), ("largest_error_px", 0.0)],
)
def test_settings_out_of_range_are_refused(name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=name):
        TracksSettings(**{name: value})
