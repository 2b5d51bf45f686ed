"""Keypoints beside the images of silhouettes: whose they are, which image they belong to, and what they do to a fit."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.silhouette_room import FRAME_NS, Room, bent

from mocapella.kinematics.keypoint_lines import KeypointLineSettings
from mocapella.kinematics.silhouette_fit import eye, seen_at
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import Arrival
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.topology import topology
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouette_keypoints import (
    MOST_WAITING,
    SeenKeypoints,
    WaitingKeypoints,
    keypoints_of_bodies,
    landmark_joints,
    seen_keypoints,
)
from mocapella.tracker.silhouettes import SilhouettesTracker

HALPE = topology("halpe_26")
ROOM = Room()
MARKS = tuple(ROOM.mesh.landmarks)
EYES = {name: eye(placed) for name, placed in ROOM.rig.cameras.items()}


def frame_of(camera, places, time_ns=1, moved_px=None):
    """A camera's keypoints of people whose landmarks are at these places."""
    rows = []
    for some in places:
        at = seen_at(some, EYES[camera]) + (0.0 if moved_px is None else moved_px)
        of = [MARKS.index(LANDMARKS[name]) if LANDMARKS.get(name) in MARKS else -1 for name in HALPE.joints]
        rows.append([at[k] if k >= 0 else [np.nan, np.nan] for k in of])
    size = ROOM.rig.cameras[camera].camera.size_px
    return keypoint_frame(camera, HALPE, time_ns=time_ns, size_px=size, positions_px=rows, confidences=0.9)


def seen_of(places):
    return {name: seen_keypoints(frame_of(name, places), 1) for name in EYES}


def none_at(at_ns):
    return SeenKeypoints(at_ns, np.empty((0, 26, 2)), np.empty((0, 26)))


def test_limbs_have_keypoints_and_head_and_neck_have_none():
    joints = dict(zip(MARKS, landmark_joints(MARKS).tolist(), strict=True))
    assert HALPE.joints[joints["left knee"]] == "LKnee"
    assert HALPE.joints[joints["right wrist"]] == "RWrist"
    assert {joints[name] for name in MARKS if name in ("nose", "head", "neck", "pelvis", "left ear")} == {-1}


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_each_body_gets_its_own_keypoints_in_whatever_order_they_are_seen(order):
    places = [landmarks_at(ROOM.mesh, bent(ROOM.mesh, {}, (x, 0.0, 0.0))) for x in (-0.5, 0.5)]
    seen = seen_of([places[k] for k in order])
    found = keypoints_of_bodies(seen, {"a": (MARKS, places[0]), "b": (MARKS, places[1])}, EYES, KeypointLineSettings())
    for name, truth in zip("ab", places, strict=True):
        for c, by in enumerate(EYES.values()):
            there = np.isfinite(found[name].pixels[:, c]).all(axis=1)
            assert there.sum() >= 12
            np.testing.assert_allclose(found[name].pixels[there, c], seen_at(truth, by)[there], atol=1e-2)


def test_people_elsewhere_are_no_bodys():
    here = landmarks_at(ROOM.mesh, bent(ROOM.mesh, {}))
    there = landmarks_at(ROOM.mesh, bent(ROOM.mesh, {}, (1.0, 0.0, 0.0)))
    seen = {"camera 1": seen_keypoints(frame_of("camera 1", [there]), 1)}
    assert keypoints_of_bodies(seen, {"": (MARKS, here)}, EYES, KeypointLineSettings()) == {}
    nobody = {name: none_at(1) for name in EYES}
    assert keypoints_of_bodies(nobody, {"": (MARKS, here)}, EYES, KeypointLineSettings()) == {}


def test_keypoints_wait_for_the_image_of_their_time():
    waiting = WaitingKeypoints()
    for at_ns in (100, 200, 300):
        waiting.add("left", none_at(at_ns))
    assert waiting.take("right", 100, 20) is None
    assert waiting.take("left", 210, 20).at_ns == 200
    assert waiting.take("left", 210, 20) is None, "each is used once, and older ones are dropped"
    again = WaitingKeypoints()
    again.recall(waiting.memory())
    assert again.take("left", 295, 20).at_ns == 300


def test_waiting_keypoints_are_bounded():
    waiting = WaitingKeypoints()
    for k in range(MOST_WAITING + 5):
        waiting.add("left", none_at(k))
    assert len(waiting.memory()["left"]) == MOST_WAITING
    assert waiting.memory()["left"][0].at_ns == 5


def tracker_at(pose):
    return SilhouettesTracker({"": InitialBody(ROOM.mesh, pose)}, ROOM.rig)


def test_keypoints_that_cannot_be_used_are_counted_with_the_reason():
    tracker, places = tracker_at(bent(ROOM.mesh, {})), [landmarks_at(ROOM.mesh, bent(ROOM.mesh, {}))]
    good = frame_of("camera 1", places)
    for wrong, why in (
        (msgspec.structs.replace(good, sensor="camera 9"), "has no camera"),
        (msgspec.structs.replace(good, size_px=(640, 480)), "are of images of 640 × 480"),
        (keypoint_frame("camera 1", topology("kinect_v2"), time_ns=1, size_px=(320, 240), positions_px=[]), "halpe_26"),
    ):
        before = tracker.report.rejected
        tracker.update(Arrival(wrong, 1))
        (reason,) = tracker.report.rejected.keys() - before.keys()
        assert why in reason
    before = dict(tracker.report.rejected)
    tracker.update(Arrival(good, 1))
    assert tracker.report.rejected == before


def run_leg(keypoints_of):
    """Track a person from a stand to a lifted leg, which all images show at once; keypoints stand beside them."""
    stands, lifted = bent(ROOM.mesh, {}), bent(ROOM.mesh, {"left hip flexion": 50.0, "left knee flexion": 60.0})
    tracker, places = tracker_at(stands), landmarks_at(ROOM.mesh, lifted)
    for arrival in arrivals_of(ROOM.walls(), 0, cameras=EYES, empty_room=True):
        tracker.update(arrival)
    for k in range(6):
        at_ns = (k + 1) * FRAME_NS
        for name in EYES:
            for frame in keypoints_of(name, places, at_ns):
                tracker.update(Arrival(frame, at_ns))
        for arrival in arrivals_of(ROOM.images(lifted, k), at_ns, cameras=EYES, number=k):
            tracker.update(arrival)
    return tracker, places


@pytest.mark.slow
def test_keypoints_move_a_leg_and_without_any_results_are_the_same_to_the_bit():
    none, places = run_leg(lambda name, places, at_ns: [])
    empty, _ = run_leg(lambda name, places, at_ns: [frame_of(name, [], at_ns)])
    given, _ = run_leg(lambda name, places, at_ns: [frame_of(name, [places], at_ns)])
    fits = [one.seen.bodies[""].fit for one in (none, empty, given)]
    np.testing.assert_array_equal(fits[0].pose.angles, fits[1].pose.angles)
    np.testing.assert_array_equal(fits[0].pose.T_world_model, fits[1].pose.T_world_model)
    legs = [MARKS.index(name) for name in ("left knee", "left ankle")]
    off = [np.linalg.norm(fit.landmarks[legs] - places[legs], axis=1).max() for fit in fits]
    assert off[2] < 0.06
    assert off[2] <= off[0] + 0.01
    assert fits[2].supported[legs].all()
    assert fits[2].contradicted == 0


@pytest.mark.slow
def test_a_snapshot_keeps_waiting_keypoints():
    stands = bent(ROOM.mesh, {})
    one, two = tracker_at(stands), tracker_at(stands)
    places = landmarks_at(ROOM.mesh, stands)
    for name in EYES:
        one.update(Arrival(frame_of(name, [places], FRAME_NS), FRAME_NS))
    two.restore(one.snapshot())
    for tracker in (one, two):
        for arrival in arrivals_of(ROOM.images(stands), FRAME_NS, cameras=EYES):
            tracker.update(arrival)
    fits = [tracker.seen.bodies[""].fit for tracker in (one, two)]
    np.testing.assert_array_equal(fits[0].pose.angles, fits[1].pose.angles)


@pytest.mark.slow
def test_keypoints_that_every_image_contradicts_are_left_out_and_counted():
    def wrong(name, places, at_ns):
        moved = places.copy()
        moved[MARKS.index("left wrist")] += [0.35, 0.35, 0.0]
        return [frame_of(name, [moved], at_ns)]

    tracker, places = run_leg(wrong)
    fit = tracker.seen.bodies[""].fit
    wrist = MARKS.index("left wrist")
    assert fit.contradicted == 1
    assert np.linalg.norm(fit.landmarks[wrist] - places[wrist]) < 0.08


def dark_below_hips(images, pose, walls):
    """Legs and all that is behind them in one dark colour: below the hips, an image shows nothing."""
    at = landmarks_at(ROOM.mesh, pose)[[MARKS.index("left hip"), MARKS.index("right hip")]]
    rng = np.random.default_rng(1)
    for name, by in EYES.items():
        row = int(seen_at(at, by)[:, 1].mean())
        for image in (images[name], walls[name]):
            below = image[row:]
            below[:] = np.clip(30.0 + rng.normal(0.0, 3.0, below.shape), 0, 255)
    return images


def run_merged(*, keypoints):
    """Bend both legs in 0.4 s, which no outline shows; keypoints have an offset and scatter. Errors at last [m]."""
    joints = ("hip flexion", "knee flexion")
    poses = [
        bent(ROOM.mesh, {f"{side} {joint}": share * 70.0 for side in ("left", "right") for joint in joints})
        for share in 0.5 - 0.5 * np.cos(np.pi * np.clip(np.linspace(0.0, 1.1, 26), 0.0, 1.0))
    ]
    tracker, rng = tracker_at(poses[0]), np.random.default_rng(2)
    offset = rng.normal(0.0, 0.015, (len(MARKS), 3))
    walls = {name: image.copy() for name, image in ROOM.walls().items()}
    dark_below_hips({name: image.copy() for name, image in walls.items()}, poses[0], walls)
    for arrival in arrivals_of(walls, 0, cameras=EYES, empty_room=True):
        tracker.update(arrival)
    for k, pose in enumerate(poses):
        at_ns = (k + 1) * FRAME_NS
        places = landmarks_at(ROOM.mesh, pose) + offset
        if keypoints:
            for name in EYES:
                scatter = rng.normal(0.0, 1.5, (len(MARKS), 2))
                tracker.update(Arrival(frame_of(name, [places], at_ns, scatter), at_ns))
        images = dark_below_hips(ROOM.images(pose, k), poses[0], {name: image.copy() for name, image in walls.items()})
        for arrival in arrivals_of(images, at_ns, cameras=EYES, number=k):
            tracker.update(arrival)
    fit = tracker.seen.bodies[""].fit
    off = np.linalg.norm(fit.landmarks - landmarks_at(ROOM.mesh, poses[-1]), axis=1)
    found = {
        joint: max(off[MARKS.index(f"{side} {joint}")] for side in ("left", "right")) for joint in ("knee", "ankle")
    }
    return found, fit


@pytest.mark.slow
def test_legs_that_no_outline_shows_follow_their_keypoints():
    off, fit = run_merged(keypoints=True)
    legs = [k for k, name in enumerate(MARKS) if name.endswith(("knee", "ankle"))]
    assert off["knee"] <= 0.1
    assert off["ankle"] <= 0.15
    assert fit.supported[legs].all()
    assert fit.contradicted == 0
    off, fit = run_merged(keypoints=False)
    assert off["ankle"] > 0.15, "the images alone do not show it"
