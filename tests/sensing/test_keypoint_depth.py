"""Keypoints that are lifted by a depth image: joints of a rendered person, things in front, and the background."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import JointState
from mocapella.model.topology import topology
from mocapella.sensing.keypoint_depth import KeypointLift, LiftSettings, body_frame_of
from mocapella.sensing.keypoint_limbs import NO_PARENT, keypoint_limbs
from mocapella.sources.simulate.room_depth import WALL_M, RoomDepthScene, RoomShot, room_depth_scene
from mocapella.sources.simulate.room_keypoints import KeypointErrors, RoomKeypoints

COCO = topology("coco_17")
NO_ERRORS = KeypointErrors(0.0, 0.0, 0.0)
TRACKED, INFERRED, NOT_TRACKED = JointState.TRACKED, JointState.INFERRED, JointState.NOT_TRACKED
LEFT_ARM = [COCO.index("left_elbow"), COCO.index("left_wrist")]
LEGS = [COCO.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("knee", "ankle")]


class Seen:
    """One image of a scene: keypoints, truth, and the depth image, which tests change."""

    def __init__(self, scene: RoomDepthScene, at_s: float, errors: KeypointErrors = NO_ERRORS) -> None:
        shot: RoomShot = scene.at(at_s)
        seen = RoomKeypoints(scene, COCO, errors)
        self.frame = seen.of(shot, "front", time_ns=1)
        self.truth, self.visible = seen.truth(shot)
        self.depth_m = shot.depth * np.float32(shot.unit_m)
        self.lift = KeypointLift(scene.lens, scene.sensor.size_px)

    def joints(self) -> Any:
        return self.lift.joints(self.frame, self.depth_m)

    @property
    def pixels(self) -> np.ndarray:
        return np.asarray(self.frame.positions_px[0]).round().astype(int)


@pytest.fixture(scope="module")
def standing() -> RoomDepthScene:
    return room_depth_scene("stand", seed=1, sensor="exact")


def test_joints_of_a_person_in_view_are_where_they_are(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    joints = seen.joints()
    assert joints.detection.tolist() == [0]
    apart = np.linalg.norm(joints.positions[0] - seen.truth[0], axis=-1)
    tracked = joints.states[0] == TRACKED
    assert tracked[5:].mean() > 0.9
    assert np.median(apart[tracked]) < 0.03
    assert apart[tracked].max() < 0.12
    assert joints.statures_m[0] == pytest.approx(standing.room.settings.people[0].stature, rel=0.06)


def test_a_thing_in_front_of_the_legs_is_not_taken_for_them(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    knees = seen.pixels[LEGS[0], 1]
    near = seen.depth_m[seen.pixels[5, 1], seen.pixels[5, 0]] - 0.5
    seen.depth_m[knees - 25 :] = near
    joints = seen.joints()
    assert (joints.states[0, LEGS] != TRACKED).all()
    assert (joints.states[0, [5, 6, 7, 8, 9, 10]] == TRACKED).all()
    placed = joints.states[0, LEGS] == INFERRED
    assert (joints.positions[0, LEGS][placed][:, 2] > near + 0.2).all()


@pytest.mark.parametrize("ahead_m", [0.25, 0.4, 0.8])
def test_a_thing_in_front_of_a_hand_is_not_taken_for_it(standing: RoomDepthScene, ahead_m: float) -> None:
    seen = Seen(standing, 8.0)
    x, y = seen.pixels[LEFT_ARM[1]]
    seen.depth_m[y - 30 : y + 60, x - 30 : x + 30] = seen.truth[0, LEFT_ARM[1], 2] - ahead_m
    assert seen.joints().states[0, LEFT_ARM[1]] != TRACKED


def test_a_keypoint_without_depth_is_inferred_from_its_limb(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    x, y = seen.pixels[LEFT_ARM[1]]
    seen.depth_m[y - 25 : y + 25, x - 25 : x + 25] = 0
    joints = seen.joints()
    assert joints.states[0, LEFT_ARM[1]] == INFERRED
    assert np.linalg.norm(joints.positions[0, LEFT_ARM[1]] - seen.truth[0, LEFT_ARM[1]]) < 0.25


@settings(max_examples=25)
@given(joint=st.sampled_from([7, 8, 9, 10, 15, 16]), away=st.integers(60, 120), side=st.sampled_from([-1, 1]))
def test_a_keypoint_on_the_background_is_never_tracked(joint: int, away: int, side: int) -> None:
    seen = Seen(room_depth_scene("stand", seed=1, sensor="exact"), 8.0)
    moved = np.array(seen.frame.positions_px)
    moved[0, joint, 0] += side * away
    x, y = moved[0, joint].round().astype(int)
    on_person = seen.depth_m[y - 4 : y + 5, x - 4 : x + 5].min() < seen.truth[0, :, 2].max() + 0.2
    frame = keypoint_frame("front", COCO, time_ns=1, size_px=seen.frame.size_px, positions_px=moved,
                           confidences=seen.frame.confidences)  # fmt: skip
    joints = seen.lift.joints(frame, seen.depth_m)
    if not on_person:
        assert joints.states[0, joint] != TRACKED
        assert not joints.positions[0, joint, 2] > WALL_M - 1.0


def test_an_arm_behind_the_back_is_not_tracked(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    moved = np.array(seen.frame.positions_px)
    middle = 0.5 * (moved[0, 11] + moved[0, 12]) - (0, 40)  # on the belly
    moved[0, LEFT_ARM[1]] = middle
    frame = keypoint_frame("front", COCO, time_ns=1, size_px=seen.frame.size_px, positions_px=moved,
                           confidences=seen.frame.confidences)  # fmt: skip
    joints = seen.lift.joints(frame, seen.depth_m)
    assert joints.states[0, LEFT_ARM[1]] != TRACKED


def test_an_unsure_keypoint_is_inferred_and_one_without_confidence_is_not_used(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    confidences = np.array(seen.frame.confidences)
    confidences[0, LEFT_ARM] = (0.3, 0.05)
    frame = keypoint_frame("front", COCO, time_ns=1, size_px=seen.frame.size_px,
                           positions_px=seen.frame.positions_px, confidences=confidences)  # fmt: skip
    joints = seen.lift.joints(frame, seen.depth_m)
    assert joints.states[0, LEFT_ARM].tolist() == [INFERRED, NOT_TRACKED]
    assert np.isnan(joints.positions[0, LEFT_ARM[1]]).all()


def test_a_picture_of_a_person_is_nobody(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    small = (seen.frame.positions_px - (320, 240)) * 0.25 + (320, 100)  # a quarter of the size, on the wall
    frame = keypoint_frame("front", COCO, time_ns=1, size_px=seen.frame.size_px, positions_px=small)
    seen.depth_m[:] = 3.0
    assert len(seen.lift.joints(frame, seen.depth_m).detection) == 0


def test_an_empty_depth_image_has_nobody(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    seen.depth_m[:] = 0
    joints = seen.joints()
    assert joints.positions.shape == (0, 17, 3)


def test_a_depth_camera_beside_the_colour_camera_gives_the_same_joints(standing: RoomDepthScene) -> None:
    """The keypoints are seen by a camera 5 cm to the side and turned by 2 degrees, with another lens."""
    seen = Seen(standing, 8.0)
    direct = seen.joints()
    T = rigid(rotation_about_y(np.deg2rad(2.0)), np.array([0.05, 0.0, 0.01]))
    lens = np.array([700.0, 700.0, 400.0, 300.0, 0.05, -0.02, 0.0, 0.0, 0.0])
    pixels = project(apply(T, seen.truth), lens)
    frame = keypoint_frame("front", COCO, time_ns=1, size_px=(800, 600), positions_px=pixels,
                           confidences=seen.frame.confidences)  # fmt: skip
    beside = KeypointLift(lens, (800, 600), depth_lens=standing.lens, T_colour_depth=T)
    joints = beside.joints(frame, seen.depth_m)
    both = (direct.states[0] == TRACKED) & (joints.states[0] == TRACKED)
    assert both.sum() > 10
    apart = np.linalg.norm(apply(T, direct.positions[0][both]) - joints.positions[0][both], axis=-1)
    assert np.median(apart) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["walk", "sit", "bend", "obstacle"])
def test_errors_in_rendered_rooms_with_a_kinects_noise(name: str) -> None:
    scene = room_depth_scene(name, seed=100, sensor="kinect")
    errors, found, there = [], 0, 0
    for at_s in np.linspace(7, scene.period_s - 0.5, 15):
        seen = Seen(scene, float(at_s), KeypointErrors())
        joints = seen.joints()
        there, found = there + len(seen.frame.ids), found + len(joints.detection)
        for row, detection in enumerate(joints.detection):
            apart = np.linalg.norm(joints.positions[row] - seen.truth[seen.frame.ids[detection]], axis=-1)
            errors += apart[(joints.states[row] == TRACKED) & np.isfinite(apart)].tolist()
    assert found >= 0.95 * there
    assert np.median(errors) < 0.035
    assert np.mean(np.array(errors) > 0.3) < 0.03


def test_the_frame_is_that_of_a_body_sensor(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    joints = seen.joints()
    frame = body_frame_of(joints, seen.frame, [7])
    assert (frame.sensor, frame.time_ns, frame.topology, frame.tracking_ids.tolist()) == ("front", 1, COCO, [7])
    left, right = frame.positions[0, 5], frame.positions[0, 6]
    assert left[0] < right[0]  # the person faces the sensor, and x is to the sensor's left
    assert frame.positions[0, 0, 1] > frame.positions[0, 15, 1]  # y is up
    assert (frame.positions[0][frame.states[0] > 0][:, 2] > 0).all()


def test_sizes_and_motions_that_do_not_fit_are_refused(standing: RoomDepthScene) -> None:
    seen = Seen(standing, 8.0)
    with pytest.raises(SettingsError, match="register them"):
        seen.lift.joints(seen.frame, seen.depth_m[::2, ::2])
    with pytest.raises(SettingsError, match="size_px"):
        KeypointLift(standing.lens, (320, 240)).joints(seen.frame, seen.depth_m)
    with pytest.raises(SettingsError, match="without depth_lens"):
        KeypointLift(standing.lens, (640, 480), T_colour_depth=np.eye(4))
    with pytest.raises(SettingsError, match="shape"):
        KeypointLift(standing.lens, (640, 480), depth_lens=standing.lens, T_colour_depth=np.eye(3))
    with pytest.raises(SettingsError, match="sure"):
        LiftSettings(sure=1.5)


@pytest.mark.parametrize("name", ["coco_17", "halpe_26", "mediapipe_pose", "body_25", "body_25b", "coco_wholebody_133"])
def test_limbs_of_each_topology_begin_at_joints_before_them(name: str) -> None:
    own = topology(name)
    limbs = keypoint_limbs(own)
    assert sorted(limbs.order.tolist()) == list(range(len(own)))
    place = {joint: i for i, joint in enumerate(limbs.order.tolist())}
    assert all(place[p] < place[k] for k, p in enumerate(limbs.parent.tolist()) if p != NO_PARENT)
    assert limbs.trunk.sum() == 4
    assert (limbs.scaled & (limbs.parent == NO_PARENT)).sum() == 0
    assert (limbs.length > 0).all()


def test_the_surface_of_a_person_in_front_is_not_that_of_the_person_behind(standing: RoomDepthScene) -> None:
    """A second detection, less sure, lies on the body of the person in view: nobody else is found there."""
    seen = Seen(standing, 8.0)
    both = np.concatenate([seen.frame.positions_px + np.array([6.0, 3.0]), seen.frame.positions_px])
    sure = np.concatenate([0.7 * seen.frame.confidences, seen.frame.confidences])
    frame = keypoint_frame("front", COCO, time_ns=1, size_px=seen.frame.size_px, positions_px=both, confidences=sure)
    joints = seen.lift.joints(frame, seen.depth_m)
    assert joints.detection.tolist() == [1]
    assert np.array_equal(joints.positions[0], seen.joints().positions[0], equal_nan=True)


def test_people_in_a_crowd_are_not_taken_for_each_other() -> None:
    scene = room_depth_scene("crowd", seed=100, sensor="kinect")
    far, tracked = 0, 0
    for at_s in (8.0, 12.0, 16.0, 20.0):
        seen = Seen(scene, at_s, KeypointErrors())
        joints = seen.joints()
        for row, detection in enumerate(joints.detection):
            apart = np.linalg.norm(joints.positions[row] - seen.truth[seen.frame.ids[detection]], axis=-1)
            sure = joints.states[row] == TRACKED
            far, tracked = far + int((apart[sure] > 0.5).sum()), tracked + int(sure.sum())
    assert tracked > 100
    assert far <= 0.02 * tracked
