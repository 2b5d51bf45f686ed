"""Fitted bodies in the room: where they stand, what is said of them, and their outlines in cameras' images."""

from __future__ import annotations

import time

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.drawings import Strict, tracking_drawing
from support.fitted_scenes import NO_LINES, SQUARE, WIDER, body, build, left_out, scene, view
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody
from support.walkers import Room

from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist
from mocapella.model.body_builds import mesh_of_build
from mocapella.model.body_meshes import legs_mesh
from mocapella.model.images import image_frame
from mocapella.model.outline_colours import INSIDE, OUTSIDE, body_colour, css
from mocapella.model.rigged_mesh import posed
from mocapella.model.scene import SensorPlace
from mocapella.model.twist_tree import TreePose, part_motions
from mocapella.sensing.outline_lines import border_lines
from mocapella.viewer import layout
from mocapella.viewer.boards import BOARDS_BEHIND, image_lines, picture_row
from mocapella.viewer.body_mesh_cache import BodyMeshCache
from mocapella.viewer.body_panel import outlines_html
from mocapella.viewer.charts import groups
from mocapella.viewer.image_lines import closed_lines, deviations, pieces
from mocapella.viewer.palette import Rgb
from mocapella.viewer.perspective import FREE
from mocapella.viewer.readout import run_html
from mocapella.viewer.room_bodies import LOST_OPACITY, SKIN, body_space, body_tag
from mocapella.viewer.stages import HANDS, ROOM
from mocapella.viewer.timeline import Moment, PlayState
from mocapella.viewer.view_frame import Drawings
from mocapella.viewer.view_state import ViewMemory

MESH, LEGS, RIG = somebody(), legs_mesh("female", 1.7), ring(2)
DEEP = layout.stage_centre()[2]


def legs_at(aside_m):
    return TreePose(pose_at(MESH, aside_m).T_world_model, np.zeros(len(LEGS.joint_names)))


def known_of(*scenes):
    known = ViewMemory(troubles=Strict())
    for one in scenes:
        known.learn(one, {}, None)
    return known


def drawn(one, perspective=FREE, *before):
    known = known_of(*before, one)
    return tracking_drawing(one, perspective, known.seen, known.floors)


@settings(max_examples=25)
@given(
    st.sampled_from([0, 1, 2]), st.sampled_from([-1.0, 1.0]), st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.floats(-3, 3),
)  # fmt: skip
def test_a_body_stands_on_the_floor_and_looks_at_the_viewer_whatever_is_up(axis, sign, place, turn):
    up = np.zeros(3)
    up[axis] = sign
    to = np.cross([0, 1, 0], up)
    R = exp_twist(np.r_[0, 0, 0, turn * up])[:3, :3] @ (
        np.eye(3)
        if up[1] == 1
        else np.diag([1, -1, -1])
        if up[1] == -1
        else exp_twist(np.r_[0, 0, 0, np.pi / 2 * to])[:3, :3]
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, place
    pose = TreePose(T, np.zeros(len(MESH.joint_names)))
    space = body_space((body(MESH, pose),))
    there = apply(space.T_stage_world, posed(MESH, pose))
    assert there[:, 1].min() == pytest.approx(0.0, abs=1e-9)
    assert there[:, 1].max() == pytest.approx(space.tall_m)
    assert space.tall_m == pytest.approx(1.75, abs=0.05)
    np.testing.assert_allclose((space.T_stage_world @ T)[:3, 2], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(space.T_stage_world[:3, :3]), 1.0)
    without = body_space((body(MESH, pose, build=""),))  # by its landmarks
    assert apply(without.T_stage_world, posed(MESH, pose))[:, 1].min() == pytest.approx(0.0, abs=0.02)


def test_several_bodies_stand_about_the_middle_of_one_floor():
    starts = [(MESH, pose_at(MESH, -1.0)), (LEGS, legs_at(1.0))]
    space = body_space(tuple(body(mesh, pose) for mesh, pose in starts))
    vertices = [apply(space.T_stage_world, posed(mesh, pose)) for mesh, pose in starts]
    assert min(one[:, 1].min() for one in vertices) == pytest.approx(0.0)
    assert max(one[:, 1].max() for one in vertices) == pytest.approx(space.tall_m)
    (left, right) = (float(one[:, 0].mean()) for one in vertices)
    assert left == pytest.approx(-right, abs=0.02)
    assert max(abs(left), abs(right)) == pytest.approx(1.0, abs=0.02)
    assert 1.0 < space.half_wide_m < 2.0
    assert body_space((body(*starts[0]),)).half_wide_m < 0.5


def test_a_body_is_its_mesh_in_its_pose_and_pale_where_nobody_is_there():
    first = scene(0, body(MESH, pose_at(MESH)))
    later = scene(1, body(MESH, pose_at(MESH, 0.5)))
    drawing = drawn(later, FREE, first)
    (skin,) = drawing.skins.values()
    assert skin.mesh is MESH
    assert (skin.colour, skin.opacity) == (SKIN, 1.0)
    T = body_space(first.bodies).T_stage_world
    np.testing.assert_allclose(skin.T_stage_parts, T @ part_motions(MESH.tree, pose_at(MESH, 0.5)), atol=1e-12)
    low, high = drawing.extent
    points = apply(T, posed(MESH, pose_at(MESH, 0.5)))
    np.testing.assert_allclose([low, high], [points.min(axis=0), points.max(axis=0)])
    lost = drawn(scene(1, body(MESH, pose_at(MESH), lost=True)))
    (skin,) = lost.skins.values()
    assert skin.opacity == LOST_OPACITY < 0.5
    assert lost.extent is None
    assert lost.there


def test_several_bodies_have_their_outlines_colours_and_their_names():
    pair = (body(MESH, pose_at(MESH, -1.0), name="anna"), body(LEGS, legs_at(1.0), name="ben", lost=True))
    drawing = drawn(scene(0, *pair))
    colours = [skin.colour for skin in drawing.skins.values()]
    assert colours == [Rgb(*((np.array(body_colour(k)) + np.array(SKIN)) // 2).tolist()) for k in range(2)]
    assert [tag.text for tag in drawing.tags] == ["anna", "ben · not there"]
    assert all(tag.position[1] > 1.0 for tag in drawing.tags[:1])


def test_where_no_mesh_can_be_made_lines_are_drawn_between_landmarks():
    known = body(MESH, pose_at(MESH))
    of_file = msgspec.structs.replace(known, build='{"model": "robot.glb", "sha256": "00"}')
    other = msgspec.structs.replace(known, joint_names=known.joint_names[:-1], angles=known.angles[:-1])
    for one in (of_file, other, msgspec.structs.replace(known, build="")):
        drawing = drawn(scene(0, one))
        assert drawing.skins == {}
        assert len(drawing.bones) > 15
        assert len(drawing.joints) == len(MESH.landmarks)
        assert np.isfinite(drawing.bones.positions).all()
        assert drawing.bones.positions[:, 1].min() > -0.01
    gone = msgspec.structs.replace(of_file, landmarks=np.full_like(of_file.landmarks, np.nan))
    assert len(drawn(scene(0, gone)).joints) == 0


def test_a_mesh_is_made_again_from_its_build_once_and_meanwhile_there_is_none():
    shelf = BodyMeshCache()
    assert shelf.mesh("") is None
    assert shelf.mesh(build(1.7)) is None
    deadline = time.monotonic() + 120
    while shelf.mesh(build(1.7)) is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    made = shelf.mesh(build(1.7))
    assert shelf.mesh(build(1.7)) is made
    assert made.joint_names == mesh_of_build(build(1.7)).joint_names
    assert "neck nod" in made.joint_names  # supple, as it is followed
    for text in ('{"model": "robot.glb", "sha256": "00"}', "no JSON", '{"model": "male", "height_m": 99}'):
        assert shelf.mesh(text) is None
        shelf._worker.submit(int).result()  # whatever was begun is done
        assert shelf.mesh(text) is None


def test_a_bodys_tag_says_whose_it_is():
    room = Room(people=1, first_id=4)
    people = room.scene(0.0, room.frames(0.0)).people
    whole = scene(0, body(MESH, pose_at(MESH)), people=people)
    (one,) = whole.bodies
    assert body_tag(one, whole) == ""
    assert body_tag(msgspec.structs.replace(one, person=4), whole) == "Body of person 4"
    assert body_tag(msgspec.structs.replace(one, person=4, name="anna"), whole) == "anna · body of person 4"
    assert body_tag(msgspec.structs.replace(one, person=9, lost=True), whole) == "Body of person 9 · not there"
    named = whole.with_parts(people=tuple(msgspec.structs.replace(person, name="Ada") for person in people))
    assert body_tag(msgspec.structs.replace(one, person=4), named) == "Body of Ada"
    assert body_tag(msgspec.structs.replace(one, person=4, name="Ada"), named) == "Ada"


def test_people_and_bodies_of_one_scene_stand_on_one_stage():
    """The world is the people's: the body stands where the person does, from every perspective."""
    room = Room(people=1)
    frames = room.frames(0.0)
    people = room.scene(0.0, frames).people
    T = np.eye(4)
    T[:3, 3] = np.nanmean(people[0].positions, axis=0) * [1, 0, 1] + [0, np.nanmin(people[0].positions[:, 1]), 0]
    pose = TreePose(T, np.zeros(len(MESH.joint_names)))
    made = scene(0, body(MESH, pose, person=people[0].id))
    both = msgspec.structs.replace(made, parts={"people": people, "bodies": made.bodies})
    places = tuple(SensorPlace(name, room.T_world[k]) for k, name in enumerate(room.names))
    both = msgspec.structs.replace(both, sensors=places)
    known = ViewMemory(troubles=Strict())
    known.learn(both, frames, None)
    assert known.ground.space is None
    for perspective in (FREE, *room.names):
        drawing = tracking_drawing(both, perspective, known.seen, known.floors)
        (skin,) = drawing.skins.values()
        stands = skin.T_stage_parts[0, :3, 3]
        person = drawing.joints.positions.mean(axis=0)
        np.testing.assert_allclose(stands[[0, 2]], person[[0, 2]], atol=0.12)
        assert [tag.text for tag in drawing.tags] == ["Person 1 · 3 views", "Body of person 1"]


def test_cameras_of_the_rig_stand_around_the_body_and_its_perspective_is_theirs():
    first = scene(0, body(MESH, pose_at(MESH)))
    to_sensor = np.diag([-1.0, -1.0, 1.0, 1.0])
    places = tuple(SensorPlace(name, inverse(p.T_camera_world) @ to_sensor) for name, p in RIG.cameras.items())
    one = msgspec.structs.replace(first, sensors=places)
    drawing = drawn(one)
    at = np.array([drawing.sensors[name].T[:3, 3] for name in ("c1", "c2")])
    np.testing.assert_allclose(np.linalg.norm((at - [0, 0, DEEP])[:, [0, 2]], axis=1), 4.0, atol=0.1)
    np.testing.assert_allclose(at[:, 1], [1.0, 1.15], atol=0.03)
    seen = drawn(one, "c1")
    (skin,) = seen.skins.values()
    np.testing.assert_allclose(seen.sensors["c1"].T[:3, 3], [0, at[0, 1], 0], atol=0.03)
    assert skin.T_stage_parts[0, 2, 3] == pytest.approx(4.0, abs=0.2)  # before the camera
    points = apply(skin.T_stage_parts[0], MESH.vertices)
    assert points[:, 1].min() == pytest.approx(0.0, abs=0.1)  # and on the floor


def test_pictures_stand_beside_each_other_above_the_body():
    row = picture_row({"a": (1080, 1920), "b": (640, 480), "c": (640, 480)}, 1.8)
    left = {name: plane.corners[0] for name, plane in row.items()}
    right = {name: plane.corners[1] for name, plane in row.items()}
    assert left["a"][0] > right["a"][0] > left["b"][0] > right["b"][0] > left["c"][0]  # +x is to the left
    assert {round(plane.high_m, 9) for plane in row.values()} == {round(row["a"].high_m, 9)}
    assert all(plane.corners[:, 1].min() > 1.8 for plane in row.values())
    many = picture_row({str(k): (640, 480) for k in range(9)}, 1.8)
    assert sum(plane.wide_m for plane in many.values()) < 6.4


def test_left_and_right_are_in_one_chart():
    assert groups(["waist bend", "left knee", "right knee", "tail"]) == {
        "waist bend": [0], "knee": [1, 2], "tail": [3]
    }  # fmt: skip


def test_closed_lines_are_taken_apart_and_closed():
    both = np.concatenate([SQUARE, [[np.nan, np.nan]], WIDER]).astype(np.float32)
    assert [len(line) for line in closed_lines(both)] == [4, 4]
    ends = pieces(both)
    assert ends.shape == (8, 2, 2)
    np.testing.assert_array_equal(ends[3], [SQUARE[3], SQUARE[0]])
    assert pieces(NO_LINES).shape == (0, 2, 2)


def dense(corners, every=2.0):
    """Samples of a closed line."""
    ends = [(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.concatenate([
        a + (b - a) * np.arange(0, 1, every / np.linalg.norm(b - a))[:, None] for a, b in ends
    ]).astype(np.float32)  # fmt: skip


def test_an_images_outline_is_drawn_where_it_is_outside_or_inside_of_the_models():
    same = dense(SQUARE)
    assert [len(part) for part in deviations(same, same)] == [0, 0]
    outside, inside = deviations(same, dense(WIDER))
    assert len(inside) == 0
    assert (outside[..., 0] <= 20).all()
    assert np.ptp(outside[..., 1]) > 60
    outside, inside = deviations(dense(WIDER), same)
    assert len(outside) == 0
    np.testing.assert_allclose(inside[..., 0], 20, atol=3)
    assert [len(part) for part in deviations(NO_LINES, same)] == [len(same), 0]
    assert [len(part) for part in deviations(same, NO_LINES)] == [0, 0]


def test_a_hole_in_the_model_is_outside_of_it():
    ring_of = np.concatenate([dense(SQUARE), [[np.nan] * 2], dense(SQUARE * 0.3 + 38)]).astype(np.float32)
    within_hole = dense(SQUARE * 0.1 + 48)
    outside, inside = deviations(ring_of, within_hole)
    assert len(outside) == len(within_hole)
    assert len(inside) == 0


@pytest.mark.parametrize("shift_px", [0, 6])
def test_outlines_of_rendered_bodies_deviate_only_where_they_are_apart(shift_px):
    silhouette = silhouettes_of(MESH, RIG, pose_at(MESH))["c1"]
    outline = border_lines(silhouette)
    outside, inside = deviations(outline, outline + np.float32([shift_px, 0]))
    if shift_px:
        assert min(len(outside), len(inside)) > 20
    else:
        assert len(outside) + len(inside) < 8


def test_what_is_wrong_is_said_and_cannot_make_markup():
    views = (view("c1"), left_out("c2", "its <image> is black"), left_out("<c3>", ""))
    said = outlines_html([body(MESH, pose_at(MESH), *views)])
    assert "90%" in said
    assert "its &lt;image&gt; is black" in said
    assert "&lt;c3&gt;" in said
    assert "not in the image" in said
    assert "<c3>" not in said
    assert "No body is fitted" in outlines_html([])
    nobody = scene(3, body(MESH, pose_at(MESH), lost=True))
    assert "Nobody is in view" in run_html(PlayState.FOLLOWING, nobody, 0.1, 4, 9)
    someone = run_html(PlayState.FOLLOWING, scene(3, body(MESH, pose_at(MESH))), 0.1, 4, 9)
    assert "frame 3 · 0.10 s · 4 of 9" in someone
    assert "Nobody" not in someone
    assert "waited for" in run_html(PlayState.NOTHING, None, 0.0, 0, 0)


def of_two(k, **bens):
    anna = body(MESH, pose_at(MESH, 0.01 * k), view("c1"), left_out("c2", "its image is black"), name="anna")
    ben = body(LEGS, legs_at(1.0), view("c1", 0.8), view("c2", 0.7), name="ben", **bens)
    return scene(k, anna, ben)


def test_it_is_said_of_whom_each_line_and_figure_is():
    said = outlines_html(of_two(3).bodies)
    assert all(text in said for text in ("anna", "ben", "90%", "80%", "70%", "left out", "its image is black"))
    legend = said[said.index("mocapella-legend") :]
    for colour, words in ((body_colour(0), "anna"), (body_colour(1), "ben"), (OUTSIDE, "outside"), (INSIDE, "inside")):
        assert f'{css(colour)}">▬</span> {words}' in legend
    assert "not there: ben" in outlines_html(of_two(3, lost=True).bodies)
    assert "not there" not in said


def test_the_lines_in_a_picture_are_of_all_bodies_that_it_shows():
    lines = image_lines(of_two(3), Strict())
    assert list(lines) == ["c1", "c2"]
    assert lines["c1"].words == "anna 90% · ben 80%"
    assert lines["c2"].words == "anna left out · ben 70%"
    assert set(lines["c1"].colours) == {Rgb(*body_colour(0)), Rgb(*body_colour(1))}
    assert len(lines["c1"].colours) == len(lines["c1"].ends_px) == 8
    wrong = scene(0, body(MESH, pose_at(MESH), view("c1", outline_px=dense(SQUARE), contour_px=dense(WIDER))))
    colours = image_lines(wrong, Strict())["c1"].colours
    assert Rgb(*OUTSIDE) in colours
    assert Rgb(*INSIDE) not in colours
    assert image_lines(wrong, Strict())["c1"].words == "90%"
    waits = scene(0, body(MESH, pose_at(MESH), view("c1", np.nan, contour_px=NO_LINES), lost=True))
    assert image_lines(waits, Strict())["c1"].words == "not in the image"
    assert len(image_lines(waits, Strict())["c1"].ends_px) == 4


def test_where_the_world_is_the_peoples_pictures_stand_over_the_sensors_gallery():
    room = Room(people=1)
    frames = room.frames(0.0)
    made = scene(0, body(MESH, pose_at(MESH), view("c1")))
    both = msgspec.structs.replace(made, parts={"people": room.scene(0.0, frames).people, "bodies": made.bodies})
    known = ViewMemory(troubles=Strict())
    known.learn(both, {**frames, "c1": image_frame("c1", None, time_ns=0, size_px=(640, 480))}, None)
    boards = Drawings(known).boards(Moment(0.0, both, frames, ROOM, both, known.seen, {}))
    (plane,) = boards.planes.values()
    lanes = layout.sensors_box(3)
    assert (plane.corners + BOARDS_BEHIND)[:, 1].min() > lanes.high[1]
    assert (plane.corners + BOARDS_BEHIND)[:, 2].min() == pytest.approx(lanes.low[2])
    assert boards.shown["c1"].words == "c1 · 90%"
    assert boards.shown["c1"].picture is None
    none = Drawings(known).boards(Moment(0.0, both, frames, HANDS, both, known.seen, {}))
    assert none.planes == {}
