"""When a limb is looked for: what two cameras show in two images in a row, and of nobody who leaves."""

from __future__ import annotations

import numpy as np
import pytest
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody

from mocapella.kinematics.limb_search import Evidence, LimbSearchSettings
from mocapella.kinematics.silhouette_fit import eye, seen_at, within
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.limb_recovery import EVERY_LIMB, OTHERS_M, LimbRecovery, _apart
from mocapella.tracker.silhouette_body import SilhouetteBody

MESH = somebody()
RIG = ring(3, size_px=(320, 240))
BODY = SilhouetteBody(MESH)
STEP_PX = 3
SAID = pose_at(MESH)
JOINTS = [MESH.joint_names.index(f"left shoulder {turn}") for turn in ("swing forwards", "raise sidewards")]


def raised(degrees=60.0):
    """As it truly is: the left arm is stretched out, which is said to hang."""
    angles = SAID.angles.copy()
    angles[JOINTS] = np.radians([30.0, degrees])
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
    return [strays.found(said, one, {}, seeing, last=said) for one in images][-1]


def missed_m(pose, true=None):
    """How far the left hand is from where it truly is."""
    hand = list(MESH.landmarks).index("left hand")
    true = raised() if true is None else true
    return float(np.linalg.norm((landmarks_at(MESH, pose) - landmarks_at(MESH, true))[hand]))


def test_an_arm_that_two_images_show_elsewhere_is_found_there():
    found = found_in([masks(raised())] * 2)
    assert found is not None
    assert set(JOINTS) <= set(found.joints)
    assert missed_m(found.pose) < 0.25 * missed_m(SAID)  # from where steps bring it in


def test_an_arm_that_is_found_in_motion_is_where_it_was_in_the_last_frame():
    """Else it had no velocity, and a fast one would be lost again in the next frame."""
    found = found_in([masks(raised(50.0)), masks(raised(64.0))])
    now, then = raised(64.0), raised(50.0)
    assert missed_m(found.pose, now) < 0.3 * missed_m(then, now)
    assert missed_m(found.before, then) < 0.5 * missed_m(then, now)
    others = np.setdiff1d(np.arange(len(SAID.angles)), found.joints)
    np.testing.assert_allclose(found.before.angles[others], SAID.angles[others], atol=1e-12)


def test_an_arm_that_is_found_at_rest_has_no_velocity():
    found = found_in([masks(raised())] * 2)
    np.testing.assert_allclose(found.before.angles[found.joints], found.pose.angles[found.joints], atol=1e-9)


def test_an_arm_of_a_body_that_was_not_fitted_in_the_last_frame_has_no_velocity():
    """As after a restart: its pose is not of the last image, so the arm's would make up for the body's motion."""
    strays, seeing = LimbRecovery(BODY, LimbSearchSettings()), {name: Seeing(name) for name in RIG.cameras}
    films = masks(raised(50.0)), masks(raised(64.0))
    found = [strays.found(SAID, one, {}, seeing, last=None) for one in films][-1]
    assert found.before is found.pose


def test_what_flashes_by_is_no_limb():
    """The first image shows no arm there; where it was said to be, none is in either."""
    before, there, hanging = masks(raised()), masks(raised()), masks(SAID)
    for name, image in before.items():
        image[(there[name] > 0) & (hanging[name] == 0)] = 0
    found = found_in([before, there])
    assert found is None or missed_m(found.pose) > 0.5 * missed_m(SAID)
    assert found_in([there]) is None


@pytest.mark.parametrize("count", [1, 2])
def test_one_cameras_word_is_not_enough(count):
    cameras = list(RIG.cameras)[:count]
    assert (found_in([masks(raised())] * 2, cameras) is None) == (count == 1)


class Hardly(Seeing):
    """A camera whose image hardly contradicts the hanging arm: of the samples there, ``score`` is what is known."""

    def __init__(self, name, score):
        super().__init__(name)
        self._score = score

    def against(self, image, points):
        return np.zeros(len(points), np.float32)

    def evidence(self, image, others, about):
        seen = super().evidence(image, others, about)
        behind = masks(SAID)[self._name][::STEP_PX, ::STEP_PX] > 0
        seen.strange[behind & (image[::STEP_PX, ::STEP_PX] == 0)] = self._score
        return seen


@pytest.mark.parametrize(("score", "known"), [(-0.1, True), (0.0, False)])
def test_an_arm_is_found_by_foreground_that_nothing_explains(score, known):
    """Its turn does not come in these images. Where nothing at all is known of the room behind it, it may be there."""
    strays = LimbRecovery(BODY, LimbSearchSettings())
    seeing = {name: Hardly(name, score) for name in RIG.cameras}
    found = [strays.found(SAID, masks(raised()), {}, seeing, last=SAID) for _ in range(2)][-1]
    assert (found is not None) == known
    assert found is None or missed_m(found.pose) < 0.25 * missed_m(SAID)


def test_no_limb_is_missed_where_the_body_explains_the_foreground():
    strays = LimbRecovery(BODY, LimbSearchSettings())
    seeing = {name: Seeing(name) for name in RIG.cameras}
    for pose, missed in ((raised(), set()), (SAID, {"left upper arm"})):
        stands = BODY.standing(pose)
        reach = strays._about(pose)
        evidence = [one.evidence(masks(raised())[name], None, reach) for name, one in seeing.items()]
        assert strays._missed(evidence, stands, reach).keys() >= missed
        assert bool(strays._missed(evidence, stands, reach)) == bool(missed)
        assert strays._missed([], stands, reach) == {}


def test_a_limb_of_which_images_have_evidence_is_not_lost_by_what_else_is_unexplained():
    """A thing beside a person is no reason to move an arm that stands where images show one."""
    image = masks(SAID)
    for name, there in masks(raised()).items():
        image[name] |= there
    assert found_in([image] * 2) is None


@pytest.mark.parametrize("first_is_better", [True, False])
def test_of_two_orders_of_search_the_better_arrangement_counts(monkeypatch, first_is_better):
    strays, ways = LimbRecovery(BODY, LimbSearchSettings()), []

    def searched(order, *_, **_apart):
        ways.append([limb.name for limb in order])
        pose = raised() if (len(ways) % 2 == 1) == first_is_better else SAID
        return pose, [limb.joints for limb in order]

    monkeypatch.setattr(strays, "_searched", searched)
    monkeypatch.setattr(strays, "_doubtful", lambda *_: {"left upper arm", "left thigh"})
    seeing = {name: Seeing(name) for name in RIG.cameras}
    found = [strays.found(SAID, masks(raised()), {}, seeing, last=SAID) for _ in range(2)][-1]
    assert len(ways) >= 2
    assert ways[-1] == ways[-2][::-1]
    assert found is not None
    assert missed_m(found.pose) == 0.0


def test_limbs_take_turns_and_no_part_of_one_has_its_own():
    strays = LimbRecovery(BODY, LimbSearchSettings())
    every = {limb.name: set(limb.part) for limb in strays._limbs}
    turns = [name for frame in range(EVERY_LIMB * 8) for name in strays._due(frame)]
    assert len(turns) == 8
    assert set(turns) == {name for name, parts in every.items() if not any(parts < more for more in every.values())}
    assert len(set(turns)) == 4 < len(every)
    assert turns[:4] == turns[4:]


def bent_knee(degrees=70.0):
    """The left knee is bent, which is said to be straight."""
    angles = SAID.angles.copy()
    angles[MESH.joint_names.index("left knee flexion")] = np.radians(degrees)
    return TreePose(SAID.T_world_model, angles)


def test_a_shank_that_images_show_elsewhere_is_found_with_the_thigh_where_it_is():
    found = found_in([masks(bent_knee())] * 2)
    assert found is not None
    ankle = list(MESH.landmarks).index("left ankle")
    true = landmarks_at(MESH, bent_knee())[ankle]
    missed = [np.linalg.norm(landmarks_at(MESH, pose)[ankle] - true) for pose in (found.pose, SAID)]
    assert missed[0] < 0.3 * missed[1]


def test_nothing_near_other_people_is_evidence_of_a_lower_limb():
    by = eye(RIG.cameras[next(iter(RIG.cameras))])
    width, height = by.size_px
    vertices = BODY.standing(SAID).vertices
    one = Evidence(by, (30, 12), STEP_PX, np.ones((60, 50), np.float32))
    others = np.zeros((height, width), np.bool_)
    assert _apart(one, None, vertices) is one
    assert _apart(one, others, vertices) is one
    others[60:90, 90:120] = True
    left = _apart(one, others, vertices)
    (x, y), (rows, columns) = one.origin_px, np.indices(one.strange.shape)
    across, down = x + STEP_PX * columns, y + STEP_PX * rows
    away_px = np.hypot(np.maximum(90 - across, across - 119).clip(0), np.maximum(60 - down, down - 89).clip(0))
    away_m = float(np.median(vertices @ by.T_camera_world[2, :3] + by.T_camera_world[2, 3]))
    margin_px = OTHERS_M * by.lens[0] / away_m
    assert (left.strange[away_px < margin_px - STEP_PX] == 0).all()
    assert (left.strange[away_px > margin_px + 2 * STEP_PX] == 1).all()
    assert (one.strange == 1).all()


def test_of_who_leaves_the_images_no_limb_is_looked_for():
    T = SAID.T_world_model.copy()
    T[1, 3] += 1.6  # the head is outside of all of them
    up = TreePose(T, raised().angles)
    assert found_in([masks(up)] * 2, said=TreePose(T, SAID.angles)) is None
