"""A limb that was found goes on as it moved between the last frame and this one."""

from __future__ import annotations

import numpy as np
import pytest
from support.silhouette_room import FRAME_NS, Room, bent

from mocapella.model.twist_tree import TreePose
from mocapella.tracker.body_fitter import BodyFitter
from mocapella.tracker.limb_recovery import FoundLimbs, with_angles

ROOM = Room()
ELBOW = ROOM.mesh.joint_names.index("left elbow flexion")
JOINTS = np.array([ELBOW])


@pytest.mark.parametrize("degrees", [0.0, 10.0])
def test_the_prediction_of_a_found_limb_has_its_motion_since_the_last_frame(
    monkeypatch: pytest.MonkeyPatch, degrees: float
) -> None:
    stands, fitter = bent(ROOM.mesh, {"left elbow flexion": 40}), BodyFitter(ROOM.mesh, ROOM.rig)
    fitter.start(stands, -FRAME_NS)
    for k in range(3):
        fitter.update(ROOM.images(stands, k), k * FRAME_NS)
    before = stands.angles.copy()
    before[ELBOW] -= np.radians(degrees)

    def found(pose: TreePose, *_: object, last: TreePose, **__: object) -> FoundLimbs:
        return FoundLimbs(JOINTS, with_angles(pose, JOINTS, stands.angles), with_angles(last, JOINTS, before))

    monkeypatch.setattr(fitter._limb_recovery, "found", found)
    fitted = fitter.update(ROOM.images(stands, 3), 3 * FRAME_NS).pose.angles[ELBOW]
    next_one = fitter.expected(4 * FRAME_NS).angles[ELBOW]
    assert np.degrees(next_one - fitted) == pytest.approx(np.degrees(fitted - before[ELBOW]), abs=0.2)
    assert abs(np.degrees(fitted - stands.angles[ELBOW])) < 3


def test_nothing_is_known_of_limbs_motion_until_a_body_was_fitted_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lost body starts anew where this frame's images show it, and is taken to be at rest there."""
    stands, fitter = bent(ROOM.mesh, {"left elbow flexion": 40}), BodyFitter(ROOM.mesh, ROOM.rig)
    given: list[TreePose | None] = []

    def found(*_: object, last: TreePose | None, **__: object) -> None:
        given.append(last)

    monkeypatch.setattr(fitter._limb_recovery, "found", found)
    poses = []
    for k in range(6):
        if k in {0, 3}:
            fitter.start(stands, (k - 1) * FRAME_NS)
        poses.append(fitter.update(ROOM.images(stands, k), k * FRAME_NS).pose)
    assert given == [None, None, poses[1], None, None, poses[4]]
