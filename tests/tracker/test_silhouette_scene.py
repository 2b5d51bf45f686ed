"""Fitted bodies as scene parts: which landmarks count as tracked."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.silhouette_pictures import pose_at, ring, somebody

from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.camera import Camera, PlacedCamera
from mocapella.model.observations import JointState
from mocapella.model.rigged_mesh import posed
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouette_camera import SeenIn
from mocapella.tracker.silhouette_scene import BodyScenes
from mocapella.tracker.silhouette_views import SeenBody

MESH = somebody()
POSE = pose_at(MESH)
WIDTH, HEIGHT = SIZE_PX = (64, 48)
LENS = np.array([64.0, 64.0, 32.0, 24.0, 0, 0, 0, 0, 0])
EYE = eye(PlacedCamera(Camera("c1", SIZE_PX, LENS), np.eye(4), np.full((6, 6), np.nan)))
BESIDE = 1 / 64
"""A part of a pixel that is exact in binary."""
LEFT, TOP, RIGHT, BOTTOM = -0.5, -0.5, WIDTH - 0.5, HEIGHT - 0.5
"""Edges of the outermost pixels, whose centres are integers."""
INSIDE = [
    (LEFT, 20.0), (20.0, TOP), (RIGHT - BESIDE, 20.0), (20.0, BOTTOM - BESIDE), (LEFT, TOP),
    (RIGHT - BESIDE, BOTTOM - BESIDE),
]  # fmt: skip
OUTSIDE = [
    (LEFT - BESIDE, 20.0), (20.0, TOP - BESIDE), (RIGHT, 20.0), (20.0, BOTTOM), (LEFT - BESIDE, TOP - BESIDE),
    (RIGHT, BOTTOM),
]  # fmt: skip


def seen_with(landmarks):
    """A body that a camera sees, with these landmarks."""
    outline = see(figure(MESH), posed(MESH, POSE), eye(ring(1).cameras["c1"]), step_px=4)
    fit = FittedBody(0, POSE, landmarks, {"c1": SeenIn(outline.silhouette, outline, 1.0)}, {})
    return SeenBody(fit, False)


def states(one, *, eyes=None, looked_for=True):
    (body,) = BodyScenes({"": InitialBody(MESH, POSE)}, eyes or {"c1": EYE}).tracked({"": one}, looked_for=looked_for)
    return body.states.tolist()


def at(pixels, depth_m=1.0):
    """Points that the camera sees there."""
    return np.array([(*((np.array(one) - LENS[2:4]) / LENS[:2] * depth_m), depth_m) for one in pixels])


@pytest.mark.parametrize("depth_m", [1.0, 4.0])
def test_landmarks_in_any_pixel_of_the_image_are_tracked_and_those_beyond_its_edge_inferred(depth_m):
    assert states(seen_with(at(INSIDE, depth_m))) == [JointState.TRACKED] * len(INSIDE)
    assert states(seen_with(at(OUTSIDE, depth_m))) == [JointState.INFERRED] * len(OUTSIDE)


def test_landmarks_behind_the_camera_are_inferred():
    assert states(seen_with(at([(32.0, 24.0)], -1.0))) == [JointState.INFERRED]


def test_a_landmark_is_tracked_if_one_camera_that_was_used_sees_it():
    one, turned = seen_with(at([INSIDE[0], OUTSIDE[0]])), np.diag([-1.0, 1.0, -1.0, 1.0])
    away = eye(PlacedCamera(Camera("c2", SIZE_PX, LENS), turned, np.full((6, 6), np.nan)))
    both = msgspec.structs.replace(one.fit, seen={"c1": one.fit.seen["c1"], "c2": one.fit.seen["c1"]})
    eyes, wanted = {"c1": EYE, "c2": away}, [JointState.TRACKED, JointState.INFERRED]
    assert states(SeenBody(both, False), eyes=eyes) == states(one, eyes=eyes) == wanted
    none = msgspec.structs.replace(one.fit, seen={})
    assert states(SeenBody(none, False), eyes=eyes) == [JointState.INFERRED] * 2


def test_of_a_lost_body_nothing_is_tracked_and_before_anybody_looks_nothing_is_known():
    lost = SeenBody(seen_with(at(INSIDE)).fit, True)
    assert states(lost) == [JointState.INFERRED] * len(INSIDE)
    assert states(lost, looked_for=False) == [JointState.NOT_TRACKED] * len(INSIDE)
