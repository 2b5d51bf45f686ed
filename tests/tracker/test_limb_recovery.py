"""When a limb is looked for: what two cameras show in two images in a row, and of nobody who leaves."""

from __future__ import annotations

import numpy as np
import pytest
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody

from mocapella.kinematics.limb_search import Evidence, LimbSearchSettings
from mocapella.kinematics.silhouette_fit import eye, seen_at, within
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.limb_recovery import EVERY_LIMB, LimbRecovery
from mocapella.tracker.silhouette_body import SilhouetteBody

MESH = somebody()
RIG = ring(3, size_px=(320, 240))
BODY = SilhouetteBody(MESH)
STEP_PX = 3
SAID = pose_at(MESH)
JOINTS = [MESH.joint_names.index(f"left shoulder {turn}") for turn in ("swing forwards", "raise sidewards")]


def raised():
    """As it truly is: the left arm is stretched out, which is said to hang."""
    angles = SAID.angles.copy()
    angles[JOINTS] = np.radians([30.0, 60.0])
    return TreePose(SAID.T_world_model, angles)


class Seeing:
    """A camera that sees exactly what there is: 1 where somebody is, −1 the room."""

    background = object()

    def __init__(self, name):
        self._name, self._eye = name, eye(RIG.cameras[name])

    def shows_all(self, vertices):
        return within(vertices, self._eye)

    def against(self, image, points):
        pixels = np.clip(np.rint(seen_at(points, self._eye)).astype(int), 0, np.subtract(self._eye.size_px, 1))
        return (image[pixels[:, 1], pixels[:, 0]] == 0).astype(np.float32)

    def evidence(self, image, _others, _about):
        strange = np.where(image[::STEP_PX, ::STEP_PX] > 0, np.float32(1), np.float32(-1))
        return Evidence(self._eye, (0, 0), STEP_PX, strange)


def masks(pose):
    """By camera, 255 where the body is."""
    return {
        name: np.uint8(255) * one.mask(RIG.cameras[name].camera.size_px).astype(np.uint8)
        for name, one in silhouettes_of(MESH, RIG, pose).items()
    }


def found_in(images, cameras=RIG.cameras, said=SAID):
    """What is found in the last of these images, one after the other."""
    strays = LimbRecovery(BODY, LimbSearchSettings())
    seeing = {name: Seeing(name) for name in cameras}
    return [strays.found(said, one, {}, seeing) for one in images][-1]


def missed_m(pose):
    """How far the left hand is from where it truly is."""
    hand = list(MESH.landmarks).index("left hand")
    return float(np.linalg.norm((landmarks_at(MESH, pose) - landmarks_at(MESH, raised()))[hand]))


def test_an_arm_that_two_images_show_elsewhere_is_found_there():
    found = found_in([masks(raised())] * 2)
    assert found is not None
    joints, pose = found
    assert set(JOINTS) <= set(joints)
    assert missed_m(pose) < 0.25 * missed_m(SAID)  # from where steps bring it in


def test_what_flashes_by_is_no_limb():
    """The first image shows no arm there; where it was said to be, none is in either."""
    before, there, hanging = masks(raised()), masks(raised()), masks(SAID)
    for name, image in before.items():
        image[(there[name] > 0) & (hanging[name] == 0)] = 0
    found = found_in([before, there])
    assert found is None or missed_m(found[1]) > 0.5 * missed_m(SAID)
    assert found_in([there]) is None


@pytest.mark.parametrize("count", [1, 2])
def test_one_cameras_word_is_not_enough(count):
    cameras = list(RIG.cameras)[:count]
    assert (found_in([masks(raised())] * 2, cameras) is None) == (count == 1)


def test_limbs_take_turns_and_no_part_of_one_has_its_own():
    strays = LimbRecovery(BODY, LimbSearchSettings())
    every = {limb.name: set(limb.part) for limb in strays._limbs}
    turns = [name for frame in range(EVERY_LIMB * 8) for name in strays._due(frame)]
    assert len(turns) == 8
    assert set(turns) == {name for name, parts in every.items() if len(parts) > 1}
    assert len(set(turns)) == 4 < len(every)
    assert turns[:4] == turns[4:]


def test_of_who_leaves_the_images_no_limb_is_looked_for():
    T = SAID.T_world_model.copy()
    T[1, 3] += 1.6  # the head is outside of all of them
    up = TreePose(T, raised().angles)
    assert found_in([masks(up)] * 2, said=TreePose(T, SAID.angles)) is None
