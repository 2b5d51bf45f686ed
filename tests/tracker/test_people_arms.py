"""Arms and people in one scene: a depth camera beside sensors of bodies, and whose arm each is."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.arm_frames import LENS, SIZE

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.kinematics.body_model import body_model
from mocapella.model.arms import ELBOW, PALM, ArmFrame, SeenArm
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.hand import WRIST
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.scene import Scene
from mocapella.model.topology import topology
from mocapella.schema import encode_scene
from mocapella.tracker import make_tracker
from mocapella.tracker.arm_tracks import TO_SENSOR
from mocapella.tracker.protocol import Tracker

Float64 = NDArray[np.float64]
TREE = topology("kinect_v2")
FPS = 30.0
OF_FRONT = {"arms": {"depth_of": {"depth": "front"}}}
T_DEPTH_BESIDE = rigid(rotation_about_y(0.5), [0.4, 0.1, 0.2])
"""From the space of the depth camera that is a part of the sensor to that of another beside it."""


@cache
def rest() -> Float64:
    offsets = body_model(TREE.name).bones
    out = np.zeros((len(TREE), 3))
    for parent, child in TREE.bones:
        out[child] = out[parent] + 1.7 * np.array(offsets[child].offset)
    return out


def body(x: float, at_s: float = 0.0, z: float = 2.0) -> Float64:
    """(25, 3) somebody who faces the sensor and sways a little, in the sensor's space."""
    sway = [x + 0.02 * np.sin(1.3 * at_s), 0.0, z + 0.02 * np.sin(1.7 * at_s)]
    return apply(rigid(rotation_about_y(np.pi), sway), rest())


def arm_of(skeleton: Float64, left: bool, number: int, camera_sensor: Float64 = TO_SENSOR) -> SeenArm:
    """What the depth camera would say of a limb, in its own space."""
    side = "Left" if left else "Right"
    elbow, wrist, hand = (skeleton[TREE.index(f"{joint}{side}")] for joint in ("Elbow", "Wrist", "Hand"))
    points = wrist + np.linspace(0.2, 1.8, 23)[:, None] * (hand - wrist)
    points[ELBOW], points[WRIST], points[PALM] = elbow, wrist, hand
    return SeenArm(
        number, left, 0.9, apply(camera_sensor, points), np.full(23, 2, np.uint8), np.full(23, 0.004, np.float32),
        np.zeros(21), None, "open", 0.5, False,
    )  # fmt: skip


def bodies_at(at_s: float, skeletons: list[Float64], sensor: str = "front") -> Arrival:
    at_ns = round(1e9 * at_s) + 1
    told = body_frame(
        sensor, TREE, time_ns=at_ns, positions=np.array(skeletons).reshape(-1, 25, 3), sequence=round(at_s * FPS)
    )
    return Arrival(told, at_ns)


def arms_at(at_s: float, arms: list[SeenArm], camera: str = "depth") -> Arrival:
    at_ns = round(1e9 * at_s) + 1
    return Arrival(ArmFrame(camera, 5, round(at_s * FPS), at_ns, 0, SIZE, LENS, "m", tuple(arms), ""), at_ns)


def together(tracker: Tracker, k: int, skeletons: list[Float64], arms: list[SeenArm]) -> Scene:
    tracker.update(bodies_at(k / FPS, skeletons))
    return tracker.update(arms_at((k + 0.5) / FPS, arms))


def test_arms_lie_on_the_limbs_of_the_skeletons_and_belong_to_their_people() -> None:
    tracker = make_tracker("default", settings=OF_FRONT)
    for k in range(40):
        t = k / FPS
        two = [body(-0.6, t), body(0.6, t)]
        arms = [arm_of(two[0], True, 3), arm_of(two[1], False, 1), arm_of(two[1], True, 9)]
        scene = together(tracker, k, two, arms)
    assert len(scene.people) == 2
    people = {round(float(np.sign(np.nanmean(person.positions[:, 0])))): person for person in scene.people}
    assert [arm.person for arm in scene.arms] == [people[-1].id, people[1].id, people[1].id]
    for arm, who, left in zip(scene.arms, (-1, 1, 1), (True, False, True), strict=True):
        wrist = people[who].positions[TREE.index("WristLeft" if left else "WristRight")]
        assert np.linalg.norm(arm.points[WRIST] - wrist) < 0.05
        assert arm.cameras == ("depth",)
        assert arm.left == left
    # Frames of bodies show them, too, as measured; and no longer when the depth camera has been silent for a while.
    for k in range(40, 80):
        scene = tracker.update(bodies_at(k / FPS, [body(-0.6, k / FPS), body(0.6, k / FPS)]))
        if k == 41:
            assert [arm.states.min() for arm in scene.arms] == [2, 2, 2]
    assert scene.arms == ()
    assert len(scene.people) == 2


def test_people_who_cross_keep_their_arms() -> None:
    tracker = make_tracker("default", settings=OF_FRONT)
    owners: dict[int, set[int]] = {0: set(), 1: set()}
    for k in range(120):
        t = k / FPS
        x = 0.9 - 0.45 * t  # side by side at 2 s, one behind the other
        two = [body(x, t, 2.0), body(-x, t, 2.7)]
        scene = together(tracker, k, two, [arm_of(two[0], True, 0), arm_of(two[1], True, 1)])
        if k > 30:
            for arm in scene.arms:
                owners[arm.id].add(arm.person)
            by_id = {person.id: person for person in scene.people}
            for arm in scene.arms:
                wrists = by_id[arm.person].positions[[TREE.index("WristLeft"), TREE.index("WristRight")]]
                assert np.linalg.norm(arm.points[WRIST] - wrists, axis=-1).min() < 0.15  # it may repair labels
    assert [len(found) for found in owners.values()] == [1, 1]
    assert owners[0] != owners[1]


def test_an_arm_far_from_everybody_is_nobodys() -> None:
    tracker = make_tracker("default", settings=OF_FRONT)
    for k in range(40):
        t = k / FPS
        scene = together(tracker, k, [body(-0.8, t)], [arm_of(body(0.8, t), True, 0)])
    assert len(scene.people) == 1
    assert [arm.person for arm in scene.arms] == [-1]


def test_a_side_that_the_sensor_of_bodies_swaps_is_the_same_persons() -> None:
    tracker = make_tracker("default", settings=OF_FRONT)
    for k in range(40):
        now = body(0.0, k / FPS)
        arm = arm_of(now, True, 0)
        scene = together(tracker, k, [now], [arm if k % 2 else arm_of(now, False, 1)])
    assert {arm.person for arm in scene.arms} == {scene.people[0].id}


def test_a_rig_places_a_depth_camera_beside_the_one_that_is_the_sensors() -> None:
    def placed(name: str, T: Float64) -> PlacedCamera:
        return PlacedCamera(Camera(name, SIZE, LENS), T, np.zeros((6, 6)))

    # In the rig's own world neither of them is the origin.
    T_depth_world = rigid(rotation_about_y(-1.1), [0.3, -0.2, 0.9])
    rig = CameraRig(
        {"depth": placed("depth", T_depth_world), "beside": placed("beside", T_DEPTH_BESIDE @ T_depth_world)}
    )
    settings = {"arms": {"depth_of": {"depth": "front"}, "rig": encode_camera_rig(rig)}}
    tracker = make_tracker("default", settings=settings)
    for k in range(20):
        now = body(0.0, k / FPS)
        tracker.update(bodies_at(k / FPS, [now]))
        arm = arm_of(now, True, 0, T_DEPTH_BESIDE @ TO_SENSOR)
        scene = tracker.update(arms_at((k + 0.5) / FPS, [arm], "beside"))
    assert [(told.cameras, told.person) for told in scene.arms] == [(("beside",), scene.people[0].id)]
    T_world_sensor = scene.sensors[0].T_world_sensor
    assert T_world_sensor is not None
    wrist = apply(inverse(T_world_sensor), scene.arms[0].points)[WRIST]
    np.testing.assert_allclose(wrist, now[TREE.index("WristLeft")], atol=1e-6)
    with pytest.raises(SettingsError, match="depth_of"):
        make_tracker("default", settings={"arms": {"rig": encode_camera_rig(rig)}})


def test_a_depth_camera_whose_place_nobody_knows_says_what_to_do() -> None:
    tracker = make_tracker("default", settings=OF_FRONT)
    tracker.update(arms_at(0.0, []))
    tracker.update(arms_at(0.1, [], "other"))
    tracker.update(bodies_at(0.2, [body(0.0)]))
    tracker.update(arms_at(0.3, []))
    tracker.update(arms_at(0.3, []))
    tracker.update(arms_at(0.2, []))
    words = list(tracker.report.rejected)
    assert words[0] == "it sends arms, and the pose of front is not known yet"
    assert """--set 'arms.depth_of={"other": "SENSOR"}'""" in words[1]
    assert words[2:] == ["repeats the time of the frame before", "time goes backwards"]
    assert tracker.report.kept == 2


def test_a_snapshot_goes_on_to_the_bit() -> None:
    whole, half = (make_tracker("default", settings=OF_FRONT) for _ in range(2))

    def arrivals(first: int, last: int) -> list[Arrival]:
        out = []
        for k in range(first, last):
            now = body(0.3, k / FPS)
            out += [bodies_at(k / FPS, [now]), arms_at((k + 0.5) / FPS, [arm_of(now, True, 0)] if k % 9 else [])]
        return out

    for arrival in arrivals(0, 30):
        whole.update(arrival)
    half.restore(whole.snapshot())
    scenes = [whole.update(arrival) for arrival in arrivals(30, 45)]
    assert [encode_scene(scene) for scene in scenes] == [encode_scene(half.update(x)) for x in arrivals(30, 45)]
    assert any(arm.person >= 0 for scene in scenes for arm in scene.arms)
