"""A thing's pose from pixels: exact of exact ones, as sure as it says, not misled by a corner or by a mirror pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from mocapella.errors import SettingsError
from mocapella.fusion.marker_rays import RayState
from mocapella.fusion.object_pose_values import ObjectPose
from mocapella.fusion.object_poses import ObjectPoses, ObjectPoseSettings, turned_over
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.tags import corner_places

TAG = corner_places(0.05)
COLOURS = np.array([[0.04, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.04]])
PLANES = ((0, 1, 2, 3),)
LENS = np.array([530.0, 530, 319.5, 239.5, -0.1, 0.02, 0, 0, 0])
HZ = 60.0
Motion = Callable[[float], np.ndarray]


@cache
def rig(readout_s: float = 0.0, clock_s: float = 0.0) -> CameraRig:
    """Two cameras 0.5 m before the origin, 0.3 m apart, towards it; the world's y is up."""
    cameras = {}
    for name, x in (("left", -0.15), ("right", 0.15)):
        z = np.array([-x, 0.0, -0.5]) / np.hypot(x, 0.5)
        right = np.cross(z, [0.0, 1.0, 0.0])
        R = np.stack([right, np.cross(z, right), z])
        camera = Camera(name, (640, 480), LENS, readout_s)
        cameras[name] = PlacedCamera(camera, rigid(R, -R @ [x, 0.0, 0.5]), np.zeros((6, 6)), clock_s)
    return CameraRig(cameras)


def moving(seed: int) -> Motion:
    """A tag or cube that is swung about, its face towards the cameras."""
    rng = np.random.default_rng(seed)
    far, turn, phase = rng.uniform(0.02, 0.05, 3), rng.uniform(0.1, 0.4, 3), rng.uniform(0, 6, (2, 3))
    lean = rng.uniform(-0.4, 0.4, 3)

    def at(t: float) -> np.ndarray:
        return rigid(
            exp_twist(np.r_[np.zeros(3), lean + turn * np.sin(5 * t + phase[0])])[:3, :3],
            far * np.sin(6 * t + phase[1]),
        )

    return at


def pixels(motion: Motion, places: np.ndarray, camera: str, at_s: float, readout_s: float = 0.0) -> np.ndarray:
    """Where a camera whose first row is at ``at_s`` sees the places, each when its row is read."""
    placed = rig(readout_s).cameras[camera]
    px = project(apply(placed.T_camera_world @ motion(at_s), places), LENS)
    for _ in range(6):
        rows = at_s + px[:, 1] * readout_s / 479
        seen = [apply(placed.T_camera_world @ motion(t), p[None])[0] for t, p in zip(rows, places, strict=True)]
        px = project(np.array(seen), LENS)
    return px


def frames(
    motion: Motion, places: np.ndarray, stop: int, cameras: tuple[str, ...] = ("left", "right"), *,
    noise_px: float = 0.0, readout_s: float = 0.0, seed: int = 0, start: int = 0,
) -> Iterator[tuple[str, np.ndarray, float, float]]:  # fmt: skip
    """What `ObjectPoses.update` takes: cameras in turn, the right one half a frame later."""
    rng = np.random.default_rng(seed)
    for k in range(start, stop):
        for camera, at_s in (("left", k / HZ), ("right", (k + 0.5) / HZ)):
            px = pixels(motion, places, camera, at_s, readout_s)
            if camera in cameras:
                yield camera, px + rng.normal(0, noise_px, px.shape), max(noise_px, 0.02), at_s


def off(pose: ObjectPose, motion: Motion) -> tuple[float, float]:
    """How far away [m] and turned [rad]."""
    assert pose.T_world_object is not None
    twist = log_motion(inverse(motion(pose.at_s)) @ pose.T_world_object)
    away = pose.T_world_object[:3, 3] - motion(pose.at_s)[:3, 3]
    return float(np.linalg.norm(away)), float(np.linalg.norm(twist[3:]))


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), tag=st.booleans(), one=st.booleans())
def test_a_thing_that_stands_still_is_where_it_is(seed: int, tag: bool, one: bool) -> None:
    places, planes = (TAG, PLANES) if tag else (COLOURS, ())
    still = moving(seed)(0.3)
    made = ObjectPoses(rig(), places, planes=planes)
    cameras = ("left",) if one and tag else ("left", "right")
    for camera, px, sd, at_s in frames(lambda _: still, places, 25, cameras):
        made.update(camera, px, sd, at_s)
    away, turned = off(made.at(24 / HZ), lambda _: still)
    assert away < 1e-5
    assert turned < 1e-4


@pytest.mark.parametrize("readout_s", [0.0, 0.015])
@pytest.mark.parametrize(("places", "planes"), [(TAG, PLANES), (COLOURS, ())])
def test_a_thing_that_moves_is_followed_between_cameras_and_rows(
    places: np.ndarray, planes: tuple[tuple[int, ...], ...], readout_s: float
) -> None:
    motion = moving(4)
    made, errors = ObjectPoses(rig(readout_s), places, planes=planes), []
    for camera, px, sd, at_s in frames(motion, places, 60, readout_s=readout_s, noise_px=0.1):
        made.update(camera, px, sd, at_s)
        if at_s > 0.2:
            pose = made.at(at_s)
            assert pose.state == RayState.TRACKED
            errors.append(off(pose, motion))
    away, turned = np.percentile(errors, 95, axis=0)
    assert away < 0.0012
    assert turned < np.radians(0.8)
    assert made.report.refused == made.report.outliers == made.report.lost == 0
    assert made.report.found == 1


def test_without_the_readout_a_rolling_shutter_misleads() -> None:
    motion, made = moving(4), ObjectPoses(rig(), TAG, planes=PLANES)
    errors = []
    for camera, px, sd, at_s in frames(motion, TAG, 60, readout_s=0.015, noise_px=0.1):
        made.update(camera, px, sd, at_s)
        if at_s > 0.2:
            errors.append(off(made.at(at_s), motion)[0])
    assert np.percentile(errors, 95) > 0.002


def test_errors_are_as_large_as_the_covariance_says() -> None:
    squares = []
    for seed in range(12):
        still = moving(seed)(0.3)
        made = ObjectPoses(rig(), TAG, planes=PLANES)
        for camera, px, sd, at_s in frames(lambda _, T=still: T, TAG, 12, noise_px=0.2, seed=seed):  # type: ignore[misc]
            made.update(camera, px, sd, at_s)
        pose = made.at(11.5 / HZ)
        assert pose.T_world_object is not None
        turn = log_motion(rigid(pose.T_world_object[:3, :3] @ still[:3, :3].T, np.zeros(3)))[3:]
        error = np.r_[pose.T_world_object[:3, 3] - still[:3, 3], turn]
        squares.append(error @ np.linalg.solve(pose.covariance, error))
    # A thing that does not move is nearer than one of which it is expected that it may; never much farther.
    assert 0.5 < np.mean(squares) < 9.0


def test_one_camera_is_enough_for_a_tag_and_three_colours_in_one_are_not() -> None:
    motion = moving(2)
    tag, colours = ObjectPoses(rig(), TAG, planes=PLANES), ObjectPoses(rig(), COLOURS)
    for k, (camera, px, sd, at_s) in enumerate(frames(motion, TAG, 40, ("left",), noise_px=0.05)):
        tag.update(camera, px, sd, at_s)
        colours.update(camera, pixels(motion, COLOURS, camera, at_s), sd, at_s)
        if k > 20:
            away, turned = off(tag.at(at_s), motion)
            assert away < 0.004
            assert turned < 0.05
    assert tag.at(at_s).state == RayState.TRACKED
    assert colours.at(at_s).T_world_object is None
    assert colours.at(at_s).state == RayState.LOST


def test_three_colours_that_were_found_are_kept_by_one_camera_and_inferred() -> None:
    motion, made = moving(2), ObjectPoses(rig(), COLOURS)
    for frame in frames(motion, COLOURS, 20, noise_px=0.05):
        made.update(*frame)
    for frame in frames(motion, COLOURS, 40, ("left",), noise_px=0.05, start=20):
        made.update(*frame)
    pose = made.at(39 / HZ)
    assert pose.state == RayState.INFERRED
    assert off(pose, motion)[0] < 0.01


def test_two_poses_of_a_small_flat_tag_are_said_to_be_ambiguous_until_another_camera_decides() -> None:
    small = corner_places(0.012)
    still = rigid(exp_twist([0, 0, 0, 0.3, 0.25, 0.0])[:3, :3], [0.0, 0.0, 0.0])
    made = ObjectPoses(rig(), small, planes=PLANES)
    for camera, px, _, at_s in frames(lambda _: still, small, 3, ("left",), noise_px=0.15, seed=3):
        made.update(camera, px, 0.15, at_s)
    pose = made.at(2 / HZ)
    assert pose.ambiguous
    assert pose.state == RayState.INFERRED
    for camera, px, _, at_s in frames(lambda _: still, small, 40, noise_px=0.15, seed=3, start=3):
        made.update(camera, px, 0.15, at_s)
    pose = made.at(39.5 / HZ)
    assert not pose.ambiguous
    assert pose.state == RayState.TRACKED
    assert off(pose, lambda _: still)[1] < 0.2


def test_the_other_pose_of_a_plane_has_nearly_the_same_picture() -> None:
    T = rigid(exp_twist([0, 0, 0, 0.5, 0.2, 0.1])[:3, :3] @ np.diag([1.0, -1, -1]), [0.02, -0.03, 0.6])
    other = turned_over(T)
    np.testing.assert_allclose(other[:3, :3] @ other[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(other[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(turned_over(other), T, atol=1e-12)
    places = corner_places(0.01)
    apart = project(apply(T, places), LENS) - project(apply(other, places), LENS)
    assert np.abs(apart).max() < 0.2
    assert np.linalg.norm(log_motion(inverse(T) @ other)[3:]) > 0.5


@pytest.mark.parametrize(("places", "planes", "cameras"), [(TAG, PLANES, ("left",)), (COLOURS, (), ("left", "right"))])
def test_an_outlier_is_left_out(
    places: np.ndarray, planes: tuple[tuple[int, ...], ...], cameras: tuple[str, ...]
) -> None:
    motion, made = moving(6), ObjectPoses(rig(), places, planes=planes)
    errors = []
    for k, (camera, px, sd, at_s) in enumerate(frames(motion, places, 60, cameras, noise_px=0.1)):
        if k > 20 and k % 3 == 0:
            px[k % len(px)] += [25.0, -18.0]
        made.update(camera, px, sd, at_s)
        if k > 20:
            errors.append(off(made.at(at_s), motion)[0])
    assert np.max(errors) < 0.006
    assert made.report.outliers >= 10
    assert made.report.lost == 0


@pytest.mark.slow
def test_a_sudden_turn_is_followed() -> None:
    def motion(t: float) -> np.ndarray:
        x = 0.2 * abs((2.0 * t) % 1.0 - 0.5) - 0.05  # 0.4 m/s, to and fro
        return rigid(exp_twist([0, 0, 0, 0.2, 4.0 * x, 0.0])[:3, :3], [x, 0.5 * x, 0.0])

    made, errors = ObjectPoses(rig(), TAG, planes=PLANES), []
    for camera, px, sd, at_s in frames(motion, TAG, 120, noise_px=0.1):
        made.update(camera, px, sd, at_s)
        if at_s > 0.2:
            errors.append(off(made.at(at_s), motion)[0])
    assert made.report.lost == 0
    assert np.percentile(errors, 95) < 0.003


def test_a_frame_that_comes_late_is_put_where_it_belongs() -> None:
    motion = moving(8)
    given = list(frames(motion, TAG, 30, noise_px=0.1))
    swapped = [frame for k in range(0, len(given), 2) for frame in (given[k + 1], given[k])]
    one, other = (ObjectPoses(rig(), TAG, planes=PLANES) for _ in range(2))
    for frame in given:
        one.update(*frame)
    for frame in swapped:
        other.update(*frame)
    here, there = one.at(29.5 / HZ), other.at(29.5 / HZ)
    assert here.T_world_object is not None
    np.testing.assert_allclose(here.T_world_object, there.T_world_object, atol=1e-9)
    np.testing.assert_allclose(here.covariance, there.covariance, atol=1e-12)
    assert one.report.used == other.report.used
    other.update("left", given[0][1], 0.1, given[0][3])
    assert other.report.late == 1


def test_frames_of_one_instant_are_used_in_the_order_in_which_they_come() -> None:
    """The first camera's frame finds the thing; the second's, of the same instant, corrects it."""
    still = moving(3)(0.3)
    made = ObjectPoses(rig(), TAG, planes=PLANES)
    for count, camera in enumerate(("left", "right")):
        made.update(camera, pixels(lambda _: still, TAG, camera, 0.0), 0.05, 0.0)
        assert (made.report.found, made.report.used) == (1, 1 + count)


@pytest.mark.parametrize("points", [1, 4, 12])
def test_the_gate_is_so_many_standard_deviations_above_the_mean_cost_of_right_pixels(points: int) -> None:
    """Each point has two coordinates; the squares of so many normal numbers add up to the cost."""
    cost = chi2(2 * points)
    for gate_sd in (0.5, 3.0):
        made = ObjectPoses(rig(), TAG, ObjectPoseSettings(gate_sd=gate_sd))
        assert made._gate(points) == pytest.approx(cost.mean() + gate_sd * cost.std())


def test_what_is_gone_is_lost_and_found_again() -> None:
    motion, made = moving(9), ObjectPoses(rig(), TAG, planes=PLANES)
    for frame in frames(motion, TAG, 20, noise_px=0.05):
        made.update(*frame)
    assert made.at(19.5 / HZ + 0.2).state == RayState.INFERRED
    assert made.at(19.5 / HZ + 0.4).state == RayState.LOST
    for frame in frames(motion, TAG, 80, noise_px=0.05, start=60):
        made.update(*frame)
    assert off(made.at(79.5 / HZ), motion)[0] < 0.002
    assert (made.report.found, made.report.lost) == (2, 1)


def test_another_thing_that_comes_suddenly_is_found_anew() -> None:
    motion, made = moving(9), ObjectPoses(rig(), TAG, planes=PLANES)
    for frame in frames(motion, TAG, 20, noise_px=0.05):
        made.update(*frame)
    there = rigid(exp_twist([0, 0, 0, 0.1, -0.9, 1.5])[:3, :3], [0.1, 0.08, -0.3])
    for frame in frames(lambda _: there, TAG, 40, noise_px=0.05, start=20):
        made.update(*frame)
    assert off(made.at(39.5 / HZ), lambda _: there)[0] < 0.003


def test_a_cameras_clock_is_heeded() -> None:
    motion, made = moving(5), ObjectPoses(rig(0.0, 0.25), TAG, planes=PLANES)
    for camera, px, sd, at_s in frames(motion, TAG, 20, noise_px=0.05):
        made.update(camera, px, sd, at_s + 0.25)
    assert off(made.at(19.5 / HZ), motion)[0] < 0.002


def test_frames_in_which_nothing_can_be_used_change_nothing() -> None:
    made = ObjectPoses(rig(), TAG, planes=PLANES)
    made.update("left", np.full((4, 2), np.nan), 0.1, 0.0)
    made.update("left", np.zeros((4, 2)), np.nan, 0.0)
    assert made.report.received == 0
    made.update("left", np.full((4, 2), 100.0), 0.1, 0.0)  # four corners in one place
    assert made.at(0.0).T_world_object is None


def test_what_cannot_be_is_refused() -> None:
    made = ObjectPoses(rig(), TAG)
    with pytest.raises(SettingsError, match="camera 'lft' is not of the rig"):
        made.update("lft", np.zeros((4, 2)), 1.0, 0.0)
    with pytest.raises(SettingsError, match="there are 4 points"):
        made.update("left", np.zeros((3, 2)), 1.0, 0.0)
    for places in (TAG[:2], TAG[:, :2], np.full((3, 3), np.nan)):
        with pytest.raises(SettingsError, match="places_m"):
            ObjectPoses(rig(), places)
    for name in ("acceleration_density", "gate_sd", "largest_sd_m", "manoeuvre"):
        with pytest.raises(SettingsError, match=name):
            ObjectPoseSettings(**{name: 0.0})
    for name in ("keep_s", "undecided_cost"):
        with pytest.raises(SettingsError, match=name):
            ObjectPoseSettings(**{name: -1.0})
