"""The method silhouettes made of plain settings, as a take keeps them."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from support.silhouette_pictures import Room, pose_at, ring

from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.model.body_builds import mesh_of_build
from mocapella.model.body_meshes import legs_mesh
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.rigged_mesh_file import decode_rigged_mesh, load_rigged_mesh, save_rigged_mesh
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import LaterJoints
from mocapella.tracker.silhouette_start import Body, body_again
from mocapella.tracker.silhouettes import SilhouettesTracker
from mocapella.tracker.silhouettes_setup import body_setup, make_silhouettes

RIG = ring(3)
BODY = body_again("male", 1.75, {"shank": 0.43})


def settings(*bodies, **more):
    """As they come back from a file."""
    return json.loads(json.dumps({"rig": encode_camera_rig(RIG), "bodies": list(bodies), **more}))


def start(name="", aside_m=0.0):
    return body_setup(name, BODY, pose_at(BODY.mesh, aside_m))


def test_what_is_made_of_settings_follows_as_what_is_made_of_meshes():
    pose = pose_at(BODY.mesh)
    direct = SilhouettesTracker({"": BODY.starting(pose)}, RIG)
    made, room = make_silhouettes(settings(start())), Room(RIG)
    assert made.bodies[""].build == direct.bodies[""].build
    for k in range(3):
        images = room.images(BODY.mesh, pose_at(BODY.mesh, 0.01 * k))
        for arrival in arrivals_of(images, (k + 1) * 33_333_333, number=k):
            ours, theirs = made.update(arrival), direct.update(arrival)
    # The start went through a logarithm.
    np.testing.assert_allclose(ours.bodies[0].landmarks, theirs.bodies[0].landmarks, atol=1e-6)


def test_joints_at_later_instants_go_through_the_settings():
    later = [LaterJoints(at_s, {"neck": np.array([0.1, 1.5, at_s]), "left hip": np.zeros(3)}) for at_s in (0.5, 1.0)]
    told = body_setup("", BODY, pose_at(BODY.mesh), later=later)
    made = make_silhouettes(settings(told)).bodies[""].later
    assert [one.at_s for one in made] == [0.5, 1.0]
    for one, other in zip(made, later, strict=True):
        assert set(one.joints) == set(other.joints)
        assert all(np.array_equal(at, other.joints[name]) for name, at in one.joints.items())
    assert "later" not in start(), "takes without keypoints are as before"
    told["later"][0]["joints"]["neck"] = (0.0, 1.5, float("inf"))
    with pytest.raises(SettingsError, match="later"):
        make_silhouettes({"rig": encode_camera_rig(RIG), "bodies": [told]})


def test_a_build_says_how_the_mesh_is_made_again():
    made = make_silhouettes(settings(start("anna", -0.5), start("ben", 0.5)))
    assert list(made.bodies) == ["anna", "ben"]
    for body in made.bodies.values():
        mesh = mesh_of_build(body.build)
        np.testing.assert_array_equal(mesh.vertices, BODY.mesh.vertices)
        assert mesh.joint_names == BODY.mesh.joint_names
    for wrong in ("", "[]", '{"model": "male"}', '{"model": "anna.glb", "sha256": "00"}'):
        with pytest.raises(SettingsError, match="does not say which body it is"):
            mesh_of_build(wrong)


def test_a_mesh_can_stand_in_the_settings_whole(tmp_path: Path):
    pytest.importorskip("pygltflib")
    path = tmp_path / "legs.glb"
    save_rigged_mesh(path, legs_mesh("male", 1.75))
    mesh = load_rigged_mesh(path)
    np.testing.assert_array_equal(decode_rigged_mesh(path.read_bytes()).vertices, mesh.vertices)
    body = Body("legs.glb", None, BODY.proportions, mesh)
    told = body_setup("", body, TreePose(np.eye(4), np.zeros(len(mesh.joint_names))), path.read_bytes())
    told["proportions"] = {}
    made = make_silhouettes(settings(told)).bodies[""]
    np.testing.assert_array_equal(made.mesh.vertices, mesh.vertices)
    build = json.loads(made.build)
    assert build["model"] == "legs.glb"
    assert len(build["sha256"]) == 64


def test_a_mesh_in_the_settings_reads_nothing_from_the_disk(tmp_path: Path):
    pytest.importorskip("pygltflib")
    path = tmp_path / "legs.gltf"
    save_rigged_mesh(path, legs_mesh("male", 1.75))
    content = json.loads(path.read_text())
    data = base64.b64decode(content["buffers"][0]["uri"].partition("base64,")[2])
    (tmp_path / "legs.bin").write_bytes(data)
    content["buffers"][0]["uri"] = "legs.bin"
    path.write_text(json.dumps(content))
    load_rigged_mesh(path)
    with pytest.raises(InputError, match="is not beside the file"):
        decode_rigged_mesh(path.read_bytes(), str(path))


def changed(**more):
    return {**start(), **more}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"bodys": []}, "unknown key 'bodys'; known: .*did you mean bodies"),
        ({"rounds": 0}, "rounds"),
        ({"region": {"band": 3}}, "unknown key 'band'"),
        ({"bodies": []}, "bodies"),
        ({"bodies": [start(), start("ben", 0.5)]}, "given where there are several"),
        ({"bodies": [start("a", 0.5), start("a", -0.5)]}, "one for each"),
        ({"bodies": [start("a"), start("b")]}, "a and b start in the same place"),
        ({"bodies": [changed(nam="anna")]}, "nam"),
        ({"bodies": [changed(model="mail")]}, "did you mean male"),
        ({"bodies": [changed(proportions={"shin": 0.4})]}, "unknown key 'shin'"),
        ({"bodies": [changed(mesh="no base 64!", height_m=None, proportions={})]}, "mesh is no base64"),
        ({"bodies": [changed(mesh="AAAA", height_m=None, proportions={})]}, "glTF"),
        ({"bodies": [changed(mesh="AAAA")]}, "the mesh has its own size"),
        ({"bodies": [changed(start={"root_twist": [0, 0, 0, 0, 0, 0], "angles": {"left kne": 1}})]}, "no joint"),
        ({"bodies": [changed(start={"root_twist": [0, 0, 0], "angles": {}})]}, "root_twist"),
        ({"rig": "no rig"}, "is no TOML"),
        ({"empty_room_s": -1}, "empty_room_s"),
        ({"sync": {"period_s": 0}}, "period_s"),
    ],
)
def test_settings_that_cannot_be_are_refused(given, said):
    pytest.importorskip("pygltflib")
    with pytest.raises(MocapellaError, match=said):
        make_silhouettes({**settings(start()), **given})


def test_settings_of_the_fit_and_of_the_times_are_taken():
    made = make_silhouettes(
        settings(start(), rounds=4, steadiness=None, sync={"period_s": 0.1}, empty_room_s=2, waiting=True)
    )
    assert made.learning
    assert made.period_s == 0.1
    (fitter,) = made._fitters.fitters.values()
    assert (fitter.settings.rounds, fitter.settings.steadiness) == (4, None)
