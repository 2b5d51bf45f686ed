"""Chairs, bags and masks that came after the empty room was filmed."""

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.model.body_meshes import body_mesh
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.sources.simulate.body_motion import body_motion
from mocapella.sources.simulate.later_things import SURROUNDINGS, boxes, seated_things
from mocapella.sources.simulate.silhouette_scene import loosely_dressed, silhouette_scene

MESH = body_mesh("male", 1.78)
MOTION = body_motion("sits", MESH, 2.0)


def test_a_box_is_closed_and_its_faces_look_outwards():
    centre, half = np.array([0.3, 1.0, -2.0]), np.array([0.1, 0.2, 0.3])
    mesh = boxes("box", [(centre, half)], 0.4)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = np.einsum("ni,ni->", a - centre, np.cross(b - centre, c - centre)) / 6
    assert volume == pytest.approx(8 * half.prod())


def test_the_chair_stands_on_the_floor_below_the_hips_and_the_mask_goes_with_the_head():
    chair, bag, mask = seated_things(MESH, MOTION)
    at = dict(zip(MESH.landmarks, landmarks_at(MESH, MOTION.pose(0.0)), strict=True))
    hips = 0.5 * (at["left hip"] + at["right hip"])
    for thing in (chair, bag):
        assert thing.vertices(0.0)[:, 1].min() == pytest.approx(0.0, abs=1e-9)
        assert np.array_equal(thing.vertices(0.0), thing.vertices(1.9))
    seat = chair.vertices(0.0)
    assert (np.abs((seat.mean(axis=0) - hips)[[0, 2]]) < 0.3).all()
    for at_s in (0.0, 1.5):
        head = landmarks_at(MESH, MOTION.pose(at_s))[list(MESH.landmarks).index("nose")]
        assert np.linalg.norm(mask.vertices(at_s).mean(axis=0) - head) < 0.2


def test_things_are_in_the_images_and_neither_in_the_empty_room_nor_in_the_masks():
    scene = silhouette_scene("sits", seed=3, size_px=(160, 120), fps=10, seconds=0.3)
    people = len(scene.meshes)
    for image, empty, mask, covered in zip(
        scene.images(0), scene.background(), scene.masks(0), scene.covered(0), strict=True
    ):
        thing = covered.people >= people
        assert np.count_nonzero(thing) > 200
        assert not (thing & mask).any()
        assert np.array_equal(mask, (covered.people >= 0) & ~thing)
        differs = np.abs(image.astype(int) - empty).max(axis=-1) > 20
        assert differs[thing].mean() > 0.5


@pytest.mark.parametrize("name", SURROUNDINGS)
def test_surroundings_are_about_the_legs_and_not_in_the_body(name):
    for thing in seated_things(MESH, MOTION, name)[3:]:
        vertices = thing.vertices(1.9)
        assert vertices[:, 1].min() > -1e-9
        assert vertices[:, 1].max() < 1.0
        assert np.linalg.norm(vertices.mean(axis=0)[[0, 2]]) < 1.5


def test_what_comes_later_is_not_there_before_and_moves_to_its_place():
    pushed, put = seated_things(MESH, MOTION, "later")[3:]
    for thing in (pushed, put):
        assert np.ptp(thing.vertices(thing.comes_s - 0.01), axis=0).max() == 0.0
        begin, end = (thing.vertices(thing.comes_s + late) for late in (0.0, thing.lasts_s))
        assert np.allclose((begin - end)[0], thing.begin_m)
        assert np.allclose(end, thing.vertices(9.0))


def test_unknown_surroundings_are_refused_and_the_known_ones_named():
    with pytest.raises(SettingsError, match=r"'tabel'.*'?table"):
        silhouette_scene("sits", size_px=(64, 48), fps=10, seconds=0.3, surroundings="tabel")
    with pytest.raises(SettingsError, match="surroundings"):
        silhouette_scene("walk", size_px=(64, 48), fps=10, seconds=0.3, surroundings="table")


def test_a_dark_room_is_dark_and_the_person_is_not():
    dark, usual = (
        silhouette_scene("sits", seed=3, size_px=(160, 120), fps=10, seconds=0.3, surroundings=name)
        for name in ("dark", "chair")
    )
    assert np.mean(dark.background()[0]) < 0.5 * np.mean(usual.background()[0])
    mask = dark.masks(0)[0]
    assert np.mean(dark.images(0)[0][mask]) > 0.8 * np.mean(usual.images(0)[0][mask])


def test_scenes_of_other_motions_have_no_things():
    assert silhouette_scene("walk", size_px=(64, 48), fps=10, seconds=0.3).things == ()


def test_a_desk_hides_less_of_the_legs_than_a_table_with_a_cloth():
    hidden = {}
    for name in ("chair", "desk", "table"):
        scene = silhouette_scene("sits", seed=3, size_px=(160, 120), fps=10, seconds=0.3, surroundings=name)
        hidden[name] = sum(int((one.people == 0).sum()) for one in scene.covered(0))
    assert hidden["table"] < hidden["desk"] < hidden["chair"]


def test_a_stool_has_no_back():
    chair, stool = (seated_things(MESH, MOTION, name)[0].vertices(0.0) for name in ("chair", "stool"))
    assert stool[:, 1].max() < chair[:, 1].max() - 0.3


def test_who_shifts_moves_once_and_stays_on_the_seat():
    motion = body_motion("shifts", MESH, 2.0, seed=3)
    at = [landmarks_at(MESH, motion.pose(second)) for second in (0.0, 0.5, 1.5, 2.0)]
    assert np.abs(at[1] - at[0]).max() < 0.005
    assert np.abs(at[3] - at[2]).max() < 0.005
    assert 0.05 < np.linalg.norm(at[2] - at[1], axis=1).max() < 0.6
    hip = list(MESH.landmarks).index("left hip")
    assert np.linalg.norm(at[2][hip] - at[1][hip]) < 0.15


def test_cameras_on_an_arc_stand_on_one_side():
    middles = []
    for arc in (360.0, 120.0):
        rig = silhouette_scene("sits", seed=3, size_px=(64, 48), fps=10, seconds=0.3, arc_deg=arc).rig
        eyes = np.array([np.linalg.inv(placed.T_camera_world)[:3, 3] for placed in rig.cameras.values()])
        middles.append(np.linalg.norm(eyes[:, [0, 2]].mean(axis=0)))
    assert middles[0] < 1.5 < middles[1]
    with pytest.raises(SettingsError, match="arc_deg"):
        silhouette_scene("sits", size_px=(64, 48), fps=10, seconds=0.3, arc_deg=20.0)


def test_loose_trousers_are_wider_at_the_legs_alone():
    loose = loosely_dressed(MESH, 0.04)
    moved = np.linalg.norm(loose.vertices - MESH.vertices, axis=1)
    legs = np.isin(MESH.bones[:, 0], [k for k, n in enumerate(MESH.part_names) if n.endswith(("thigh", "shank"))])
    assert moved[~legs].max() == 0.0
    assert 0.019 < moved[legs].min() <= moved[legs].max() < 0.041
    assert np.abs(loose.vertices[legs, 0]).max() > np.abs(MESH.vertices[legs, 0]).max()
    assert loosely_dressed(MESH, 0.0) is MESH
    with pytest.raises(SettingsError, match="loose_m"):
        silhouette_scene("sits", size_px=(64, 48), fps=10, seconds=0.3, loose_m=0.2)
