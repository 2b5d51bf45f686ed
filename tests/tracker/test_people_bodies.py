"""People from body sensors and bodies from silhouettes in one session: one world, and the scene says who is who."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from functools import cache
from itertools import islice
from typing import Any

import numpy as np
import pytest
from support.silhouette_pictures import Room, pose_at, ring, somebody

from mocapella.errors import SettingsError, WireError
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.images import image_frame
from mocapella.model.memory import pack, unpack
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.scene import Scene
from mocapella.model.topology import topology
from mocapella.schema import decode_scene, encode_scene
from mocapella.tracker import make_tracker
from mocapella.tracker.default import _REMEMBERED
from mocapella.tracker.people_bodies import NOT_CONFIGURED, WALK
from mocapella.tracker.silhouette_start import body_of
from mocapella.tracker.silhouettes_setup import body_setup

KIND = topology("kinect_v2")
T_SENSOR_RIG = inverse(rigid(rotation_about_y(0.5 + np.pi), (1.2, 1.0, 3.0)))
"""The sensor looks at the rig's origin from 3 m."""
HZ, SECONDS = 30, 5.0
OF_JOINT = {
    "SpineBase": "pelvis", "SpineMid": "waist", "Neck": "neck", "Head": "head", "SpineShoulder": "neck",
    **{f"{joint}{side}": f"{side.lower()} {name}" for side in ("Left", "Right") for joint, name in (
        ("Shoulder", "shoulder"), ("Elbow", "elbow"), ("Wrist", "wrist"), ("Hand", "hand"), ("HandTip", "fingertip"),
        ("Thumb", "hand"), ("Hip", "hip"), ("Knee", "knee"), ("Ankle", "ankle"), ("Foot", "toe"))},
}  # fmt: skip


def aside_m(k: int) -> float:
    return 0.45 * float(np.sin(2 * np.pi * k / (HZ * 4.0)))


@cache
def mesh_and_rig() -> Any:
    return somebody(), ring(2, size_px=(160, 130))


def setup() -> dict[str, Any]:
    _, rig = mesh_and_rig()
    body = body_of("male", 1.75, {})
    return {"rig": encode_camera_rig(rig), "bodies": [body_setup("anna", body, pose_at(body.mesh))]}


def arrivals(*, images: bool = True, other: bool = False) -> Iterator[Arrival]:
    """Somebody who goes to and fro, before one sensor and two cameras; another person whom no camera sees."""
    mesh, rig = mesh_and_rig()
    room, rng, names = Room(rig), np.random.default_rng(4), list(mesh.landmarks)
    columns = [names.index(OF_JOINT[joint]) for joint in KIND.joints]
    for k in range(round(HZ * SECONDS)):
        at_ns = round(1e9 * k / HZ) + 1_000_000_000
        pose = pose_at(mesh, aside_m(k))
        joints = landmarks_at(mesh, pose)[columns] + rng.normal(0, 0.01, (len(KIND), 3))
        seen = [apply(T_SENSOR_RIG, joints)]
        if other:
            seen.append(apply(T_SENSOR_RIG, joints[:] * [1, 1, 1] + [1.2 + 0.3 * aside_m(3 * k), 0, 0.9 - 0.01 * k]))
        yield Arrival(body_frame("kinect", KIND, time_ns=at_ns, positions=np.array(seen), sequence=k), at_ns)
        if images and k % 2 == 0:
            for name, image in room.images(mesh, pose).items():
                yield Arrival(image_frame(name, image, time_ns=at_ns, sequence=k // 2), at_ns)


def tracker() -> Any:
    return make_tracker("default", settings={"bodies": {"silhouettes": setup()}})


@cache
def tracked(*, other: bool) -> tuple[Scene, ...]:
    one = tracker()
    return tuple(one.update(arrival) for arrival in arrivals(other=other))


@pytest.mark.slow
@pytest.mark.parametrize("other", [False, True])
def test_bodies_are_in_the_world_of_the_sensors_and_say_whose_they_are(other: bool) -> None:
    mesh, _ = mesh_and_rig()
    scenes = tracked(other=other)
    assert scenes[40].bodies == ()
    assert WALK in scenes[40].state.reason
    last = scenes[-1]
    (body,) = last.bodies
    person = next(one for one in last.people if one.id == body.person)
    k = round(HZ * SECONDS) - 2
    true = apply(T_SENSOR_RIG, landmarks_at(mesh, pose_at(mesh, aside_m(k))))
    assert np.median(np.linalg.norm(body.landmarks - true, axis=-1)) < 0.1
    assert np.linalg.norm(person.positions[KIND.index("SpineBase")] - true[list(mesh.landmarks).index("pelvis")]) < 0.15
    assert WALK not in last.state.reason
    assert len(last.people) == 1 + other


@pytest.mark.slow
def test_the_cameras_places_are_told_beside_the_sensors() -> None:
    _, rig = mesh_and_rig()
    last = tracked(other=False)[-1]
    places = {place.sensor: place for place in last.sensors}
    assert places.keys() == {"kinect", *rig.cameras}
    for name, placed in rig.cameras.items():
        T = places[name].T_world_sensor
        assert T is not None
        true = apply(T_SENSOR_RIG, inverse(placed.T_camera_world)[None, :3, 3])[0]
        assert np.linalg.norm(T[:3, 3] - true) < 0.3
        assert "by people" in places[name].quality


@pytest.mark.slow
def test_such_a_scene_travels_and_a_snapshot_goes_on_to_the_bit() -> None:
    one, half, memory = tracker(), 0, b""
    scenes = []
    for half, arrival in enumerate(arrivals()):
        if half == 250:
            memory = one.snapshot()
        scenes.append(one.update(arrival))
    assert encode_scene(decode_scene(encode_scene(scenes[-1]))) == encode_scene(scenes[-1])
    other = tracker()
    other.restore(memory)
    again = [other.update(arrival) for k, arrival in enumerate(arrivals()) if k >= 250]
    assert [encode_scene(scene) for scene in again] == [encode_scene(scene) for scene in scenes[250:]]


def test_a_snapshot_with_a_damaged_memory_of_the_bodies_is_refused_and_the_tracker_is_reset() -> None:
    one = tracker()
    for arrival in islice(arrivals(images=False), 5):
        one.update(arrival)
    *parts, (_, alignment, own) = unpack(one.snapshot(), _REMEMBERED)
    with pytest.raises(WireError):
        one.restore(pack([*parts, [b"damaged", alignment, own]], _REMEMBERED))
    assert one.snapshot() == tracker().snapshot()


@pytest.mark.slow
def test_people_are_the_same_with_cameras_and_without() -> None:
    with_images = [scene for scene in tracked(other=False) if scene.sensor == "kinect"]
    alone = make_tracker("default")
    for scene, arrival in zip(with_images, arrivals(images=False), strict=True):
        for one, other in zip(scene.people, alone.update(arrival).people, strict=True):
            np.testing.assert_array_equal(one.positions, other.positions)


def test_images_are_refused_where_nobody_said_whom_they_show() -> None:
    one = make_tracker("default")
    one.update(Arrival(image_frame("c1", np.zeros((4, 4, 3), np.uint8), time_ns=1), 1))
    assert list(one.report.rejected) == [NOT_CONFIGURED]


def test_an_image_that_the_rig_does_not_have_is_refused_with_why() -> None:
    one = tracker()
    one.update(Arrival(image_frame("c9", np.zeros((4, 4, 3), np.uint8), time_ns=1), 1))
    assert "the rig has no camera 'c9'" in " ".join(one.report.rejected)


def test_settings_that_cannot_be_used_are_refused_when_it_is_made() -> None:
    with pytest.raises(SettingsError, match="unknown key 'rigg'"):
        make_tracker("default", settings={"bodies": {"silhouettes": {"rigg": ""}}})
    wrong = {**setup()["bodies"][0], "mesh": base64.b64encode(b"no mesh").decode()}
    with pytest.raises(SettingsError):
        make_tracker("default", settings={"bodies": {"silhouettes": {**setup(), "bodies": [wrong]}}})
    with pytest.raises(SettingsError, match="take_m"):
        make_tracker("default", settings={"bodies": {"take_m": 0}})
