"""A body begins where joints are, as large as they say."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.silhouette_pictures import pose_at, ring, somebody

from mocapella.errors import CalibrationError, InputError, SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.point_tracks import ImageTracks
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.tracker.initial_body import LaterJoints
from mocapella.tracker.silhouette_start import (
    APART_M,
    LATER_EVERY_S,
    NEEDED,
    body_of,
    cameras_that_see,
    check_apart,
    check_joints,
    joints_of_points,
    later_joints,
    start_pose,
)

MESH = somebody()
POSE = pose_at(MESH, 0.2, 0.7)
JOINTS = dict(zip(MESH.landmarks, landmarks_at(MESH, POSE), strict=True))
RIG = ring(3)


def keypoints(names=LANDMARKS, rig=RIG):
    """What cameras see of OpenPose's points."""
    placed = rig.cameras
    at = np.array([JOINTS[LANDMARKS.get(name, name)] for name in names])
    pixels = np.array([project(apply(p.T_camera_world, at), p.camera.lens) for p in placed.values()])[None]
    shape = pixels.shape[:3]
    return ImageTracks(tuple(placed), tuple(names), np.array([0]), np.zeros(shape[:2]), pixels, np.ones(shape))


def test_joints_of_points_are_where_they_were():
    for names in (tuple(LANDMARKS), ("left hip", "right hip", "left_knee".replace("_", " "), "neck")):
        found = joints_of_points(keypoints(names), RIG)
        assert len(found) == len(names)
        for name, at in found.items():
            np.testing.assert_allclose(at, JOINTS[name], atol=1e-3)


@pytest.mark.parametrize("first", [0, 2])
def test_later_joints_are_of_their_frames(first):
    """Their numbers tell the time, frames without any point are left out, and of near ones all but the first."""
    one = keypoints()
    numbers = np.array([3, 4, 5, 6, 7, 20, 30])
    count = len(numbers)
    pixels = np.repeat(one.pixels, count, axis=0)
    pixels[5] = np.nan
    shape = (count, *one.confidences.shape[1:])
    tracks = ImageTracks(one.cameras, one.points, numbers, np.zeros(shape[:2]), pixels, np.ones(shape))
    found = later_joints(tracks, RIG, first, 1.5 / LATER_EVERY_S)
    kept = {0: [5, 7, 30], 2: [7, 30]}[first]
    assert [each.at_s for each in found] == pytest.approx([(k - numbers[first]) * LATER_EVERY_S / 1.5 for k in kept])
    for each in found:
        assert set(each.joints) == set(joints_of_points(one, RIG))
        for name, at in each.joints.items():
            np.testing.assert_allclose(at, JOINTS[name], atol=1e-3)
    assert later_joints(one, RIG, 0, 50.0) == []


@given(st.lists(st.floats(0.0, 9.0), max_size=5), st.floats(0.0, 9.0), st.floats(0.0, 1.0))
def test_joints_that_are_known_at_a_time_are_of_the_nearest_instant(times, at_s, within_s):
    later = [LaterJoints(one, {"neck": np.full(3, one)}) for one in times]
    found = body_of("male", 1.75, {}).starting(POSE, later).known_at(at_s, within_s)
    near = [one for one in times if abs(one - at_s) <= within_s]
    assert bool(found) == bool(near)
    assert not near or abs(found["neck"][0] - at_s) == min(abs(one - at_s) for one in near)


def test_openposes_neck_is_not_the_bodys_joint_of_that_name():
    assert set(joints_of_points(keypoints(("LHip", "RHip", "nose", "neck")), RIG)) == {
        "left hip", "right hip", "nose", "neck"
    }  # fmt: skip
    seen = keypoints(("LHip", "RHip", "nose", "neck"))
    called = ImageTracks(seen.cameras, ("LHip", "RHip", "nose", "Neck"), *(
        getattr(seen, name) for name in seen.__struct_fields__[2:]
    ))  # fmt: skip
    assert set(joints_of_points(called, RIG)) == {"left hip", "right hip", "nose"}


def test_two_bodies_in_one_place_are_named():
    aside = pose_at(MESH, 0.2 + 1.2 * APART_M, 0.7)
    check_apart({"anna": (MESH, POSE), "ben": (MESH, aside)})
    near = pose_at(MESH, 0.2 + 0.8 * APART_M, 0.1)
    with pytest.raises(InputError, match="anna and carl start in the same place, 12 cm apart"):
        check_apart({"anna": (MESH, POSE), "ben": (MESH, pose_at(MESH, 3.0)), "carl": (MESH, near)})


def test_points_of_cameras_in_another_order_do_not_meet():
    rig = ring(3, (640, 480))
    seen = keypoints(rig=rig)
    mixed = ImageTracks(("c1", "c3", "c2"), *(getattr(seen, name) for name in seen.__struct_fields__[1:]))
    with pytest.raises(CalibrationError, match=r"do not meet in space|do not agree with the other cameras'"):
        joints_of_points(mixed, rig)


@pytest.mark.parametrize("alone", [0, 5, len(LANDMARKS) - 4])
def test_points_that_do_not_meet_are_counted_where_two_cameras_see_them(alone):
    """One of three cameras sees nothing, one is tilted, and so many points are seen by one camera alone."""
    rig = ring(3, (640, 480))
    seen = keypoints(rig=rig)
    pixels, confidences = seen.pixels.copy(), seen.confidences.copy()
    pixels[:, 0, :, 1] += 40.0
    confidences[:, 1] = 0.0
    confidences[:, 2, :alone] = 0.0
    tilted = ImageTracks(seen.cameras, seen.points, seen.frames, seen.at_s, pixels, confidences)
    wanted = f"do not meet in space: of {len(LANDMARKS) - alone} that two cameras or more see, 0 do"
    with pytest.raises(CalibrationError, match=wanted):
        joints_of_points(tilted, rig)


def test_one_camera_whose_points_are_of_another_is_named():
    four = ring(4)
    seen = keypoints(rig=four)
    pixels = seen.pixels.copy()
    pixels[:, 1, :, 1] += 30.0
    moved = ImageTracks(
        seen.cameras, seen.points, seen.frames, seen.at_s, pixels, *(getattr(seen, n) for n in ("confidences", "notes"))
    )
    with pytest.raises(CalibrationError, match="the points of c2 do not agree with the other cameras'"):
        joints_of_points(moved, four)


def test_points_that_are_none_of_a_body_or_of_no_frame_are_named():
    seen = keypoints()
    other = ImageTracks(
        seen.cameras, tuple(f"p{k}" for k in range(22)), *(getattr(seen, name) for name in seen.__struct_fields__[2:])
    )
    with pytest.raises(InputError, match=r"p0, p1.*no point is called like a joint"):
        joints_of_points(other, RIG)
    with pytest.raises(InputError, match="frame: 4: the points have no such frame; there are 1"):
        joints_of_points(seen, RIG, 4)


def test_a_body_is_as_large_as_its_joints_and_stands_where_they_are():
    joints = {name: JOINTS[name] for name in LANDMARKS.values()}
    body = body_of("male", None, joints)
    pose = start_pose(body.mesh, joints)
    at = dict(zip(body.mesh.landmarks, landmarks_at(body.mesh, pose), strict=True))
    assert max(np.linalg.norm(at[name] - joints[name]) for name in NEEDED["male"]) < 0.02
    assert np.ptp(body.mesh.vertices[:, 1]) == pytest.approx(np.ptp(MESH.vertices[:, 1]), rel=0.05)
    np.testing.assert_allclose(pose.T_world_model[:3, 1], [0, 1, 0], atol=0.2)  # upright
    assert cameras_that_see(body.mesh, pose, RIG) == ["c1", "c2", "c3"]


def test_what_does_not_say_how_large_somebody_is_asks_for_a_height():
    few = {name: JOINTS[name] for name in NEEDED["male"]}
    with pytest.raises(
        InputError, match="how long shank and thigh are; say how tall the person is with --set height=METRES"
    ):
        body_of("male", None, few)
    assert np.ptp(body_of("female", 1.6, few).mesh.vertices[:, 1]) == pytest.approx(1.6, abs=0.02)


def test_missing_joints_are_named():
    with pytest.raises(InputError, match=r"j\.json: field right hip: is missing; a start needs left hip, right hip"):
        check_joints("male", {"left hip": JOINTS["left hip"]}, "j.json")
    with pytest.raises(InputError, match="field left knee"):
        check_joints("legs", {name: JOINTS[name] for name in ("left hip", "right hip")})
    with pytest.raises(SettingsError, match=r"'mail'.*did you mean male"):
        body_of("mail", None, JOINTS)
    with pytest.raises(SettingsError, match="has 1 joints"):
        start_pose(MESH, {"nose": JOINTS["nose"], "thing": JOINTS["nose"]})


def test_joints_in_millimetres_or_feet_are_no_persons():
    for factor in (1000.0, 1 / 0.3048):
        with pytest.raises(CalibrationError, match="are they in metres"):
            body_of("male", None, {name: at * factor for name, at in JOINTS.items()})
    with pytest.raises(CalibrationError, match=r"no pose of the model is near.*are they in metres"):
        start_pose(MESH, {name: at * 3.28 for name, at in JOINTS.items() if name in LANDMARKS.values()})


def test_a_start_outside_of_all_images_is_seen_by_nobody():
    assert cameras_that_see(MESH, pose_at(MESH, 40.0), RIG) == []


@pytest.mark.parametrize("edge", [0, 1])
def test_a_camera_sees_a_body_in_any_pixel_of_its_image_and_not_beyond_the_edge(edge):
    """The centres of pixels are integers. Of a mesh without landmarks, the origin counts."""
    size_px, beside = (64, 48), 1 / 64
    lens = np.array([64.0, 64.0, 32.0, 24.0, 0, 0, 0, 0, 0])
    rig = CameraRig({"c1": PlacedCamera(Camera("c1", size_px, lens), np.eye(4), np.full((6, 6), np.nan))})
    bare = msgspec.structs.replace(MESH, landmarks={})

    def seen(pixel):
        pose = pose_at(MESH)
        pose.T_world_model[:3, 3] = (*((np.array([20.0, 20.0]) - lens[2:4]) / lens[:2]), 1.0)
        pose.T_world_model[edge, 3] = (pixel - lens[2 + edge]) / lens[edge]
        return cameras_that_see(bare, pose, rig) == ["c1"]

    first, beyond = -0.5, size_px[edge] - 0.5
    assert [seen(pixel) for pixel in (first - beside, first, beyond - beside, beyond)] == [False, True, True, False]
