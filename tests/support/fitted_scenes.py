"""Fitted bodies as scenes have them, and a room that draws them."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.scene import Phase, Scene, TrackedBody, TrackedBodyView, TrackerState
from mocapella.model.topology import topology
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.initial_body import build_of
from mocapella.viewer.body_mesh_cache import SHELF

SQUARE = np.array([[20, 20], [80, 20], [80, 90], [20, 90]], np.float32)
WIDER = np.array([[10, 20], [80, 20], [80, 90], [10, 90]], np.float32)
NO_LINES = np.zeros((0, 2), np.float32)


def view(camera: str, overlap: float = 0.9, **changes: Any) -> TrackedBodyView:
    made = TrackedBodyView(camera, overlap, "", SQUARE, SQUARE)
    return msgspec.structs.replace(made, **changes)


def left_out(camera: str, why: str) -> TrackedBodyView:
    return TrackedBodyView(camera, np.nan, why, NO_LINES, NO_LINES)


def body(mesh: RiggedMesh, pose: TreePose, *views: TrackedBodyView, **changes: Any) -> TrackedBody:
    """Of a mesh that the shelf has, under a build of its own."""
    build = f"test {mesh.name} {len(mesh.joint_names)}"
    SHELF.put(build, mesh)
    landmarks = landmarks_at(mesh, pose)
    made = TrackedBody(
        0, "", build, pose.T_world_model, pose.angles, mesh.joint_names, tuple(mesh.landmarks), landmarks,
        np.full(len(landmarks), 2, np.uint8), lost=False, views=views,
    )  # fmt: skip
    return msgspec.structs.replace(made, **changes)


def scene(k: int, *bodies: TrackedBody, at_s: float | None = None, **parts: Any) -> Scene:
    """The k-th of 30 a second."""
    at_ns = round((k / 30 if at_s is None else at_s) * NS_PER_S)
    numbered = tuple(msgspec.structs.replace(one, id=n) for n, one in enumerate(bodies))
    state = TrackerState(Phase.TRACKING)
    return Scene(k, at_ns, "c1", 0, k, topology("kinect_v2"), state, {"bodies": numbered, **parts})


def build(height_m: float) -> str:
    return build_of("male", height_m, {})
