"""From a sensor's perspective, people stand where that sensor saw them."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drawings import is_fused, tracking_drawing, tracking_title
from support.walkers import HEIGHT_M, KINECT, Room

from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState, body_frame
from mocapella.model.session import SensorPose
from mocapella.viewer.lanes import LaneSpace, lane_bones
from mocapella.viewer.palette import FILLED, FUSED, INFERRED, SENSORS, SensorColours, person_colour
from mocapella.viewer.perspective import FREE, Floors, Perspectives, level
from mocapella.viewer.room_people import joint_colours

ANGLE = st.floats(-1.5, 1.5)


def each_on_itself(scene):
    """The scene as ``stand-still`` has it: every person in a world of its own, centred on itself."""
    people = []
    for person in scene.people:
        T = np.eye(4)
        T[:3, 3] = -person.positions.mean(axis=0)
        views = tuple(
            msgspec.structs.replace(v, positions=apply(T, v.positions), T_world_sensor=T @ v.T_world_sensor)
            for v in person.views
        )
        people.append(msgspec.structs.replace(person, positions=apply(T, person.positions), views=views))
    return scene.with_parts(people=tuple(people))


def learned(scene, frames):
    seen, floors = Perspectives(), Floors()
    seen.learn(scene)
    floors.learn_scene(scene)
    for frame in frames.values():
        floors.learn_frame(frame)
    return seen, floors


@given(ANGLE)
def test_a_level_stage_keeps_up_up(tilt):
    """A sensor tilted up by t sees a point straight ahead of it, at its own height, at −sin t of its own up axis."""
    ahead = np.array([[0.0, -np.sin(tilt), np.cos(tilt)]]) * 2.0
    assert apply(level(tilt, 1.5), ahead)[0] == pytest.approx([0.0, 1.5, 2.0], abs=1e-12)


@pytest.mark.parametrize("sensor", ["front", "left", "right"])
def test_people_of_stand_still_stand_where_the_perspectives_sensor_saw_them(sensor):
    room = Room()
    frames = room.frames(1.0)
    scene = each_on_itself(room.scene(1.0, frames))
    seen, _ = learned(scene, frames)
    for k, person in enumerate(scene.people):
        view = person.view_of(sensor)
        back = apply(seen.from_world(person, sensor), view.positions)
        assert back == pytest.approx(frames[sensor].positions[k].astype(float), abs=1e-5)


def test_two_people_of_stand_still_are_in_one_place_when_free_and_apart_from_a_sensor():
    room = Room()
    frames = room.frames(1.0)
    scene = each_on_itself(room.scene(1.0, frames))
    seen, floors = learned(scene, frames)

    def apart(perspective):
        a, b = (tag.position for tag in tracking_drawing(scene, perspective, seen, floors).tags)
        return np.hypot(a[0] - b[0], a[2] - b[2])

    assert apart(FREE) < 0.3
    assert apart("front") > 1.0


def test_a_person_that_the_sensor_lost_stays_and_one_that_it_never_saw_is_named():
    room = Room()
    frames = room.frames(1.0)
    scene = room.scene(1.0, frames)
    seen, floors = learned(scene, frames)
    blind = scene.with_parts(
        people=tuple(
            msgspec.structs.replace(p, views=tuple(v for v in p.views if v.sensor != "front")) for p in scene.people
        )
    )
    seen.learn(blind)
    drawing = tracking_drawing(blind, "front", seen, floors)
    assert drawing.unseen == ()
    fresh, _ = learned(blind, frames)
    drawing = tracking_drawing(blind, "front", fresh, floors)
    assert drawing.unseen == ("person 1", "person 2")
    assert len(drawing.bones) == 0
    assert tracking_title(drawing, "front").text == "Scene · camera frame of front (never saw person 1, person 2)"


@pytest.mark.parametrize("perspective", [FREE, "front"])
def test_a_person_without_a_known_joint_is_named_and_the_others_are_drawn(perspective):
    room = Room(people=2)
    frames = room.frames(1.0)
    scene = room.scene(1.0, frames)
    nowhere, shown = scene.people
    for positions, states in (
        (np.full_like(nowhere.positions, np.nan), nowhere.states),
        (nowhere.positions, np.full_like(nowhere.states, JointState.NOT_TRACKED)),
    ):
        person = msgspec.structs.replace(nowhere, positions=positions, states=states)
        both = scene.with_parts(people=(person, shown))
        drawing = tracking_drawing(both, perspective, *learned(both, frames))
        assert is_fused(drawing).sum() == 24
        assert tracking_title(drawing, perspective).text.endswith("(no joint is known of person 1)")


def test_the_condition_of_a_person_is_in_the_title():
    room = Room(people=2)
    frames = room.frames(1.0)
    scene = room.scene(1.0, frames)
    bent, other = scene.people
    bent = msgspec.structs.replace(bent, name="Ada", condition="left knee: sensors and body model disagree by 50°")
    both = scene.with_parts(people=(bent, other))
    title = tracking_title(tracking_drawing(both, FREE, *learned(both, frames)), FREE).text
    assert title == "Scene · world frame (Ada: left knee: sensors and body model disagree by 50°)"


def test_who_is_gone_is_forgotten():
    room = Room()
    frames = room.frames(1.0)
    scene = room.scene(1.0, frames)
    seen, _ = learned(scene, frames)
    seen.learn(scene.with_parts(people=()))
    assert seen.from_world(scene.people[0], "front") is None


def test_a_drawing_has_the_fused_skeleton_and_every_view_in_the_persons_colour():
    room = Room(people=2, sensors=3)
    frames = room.frames(0.5)
    scene = room.scene(0.5, frames)
    drawing = tracking_drawing(scene, "front", *learned(scene, frames))
    assert is_fused(drawing).sum() == 2 * 24
    for person in scene.people:
        own = (drawing.bones.colours == person_colour(person.id).paint).all(axis=1)
        assert own.sum() == 3 * 24
    assert set(drawing.sensors) == {"front", "left", "right"}
    assert drawing.sensors["front"].T[:3, 3] == pytest.approx([0, HEIGHT_M, 0])


def test_joints_that_the_perspectives_sensor_misses_are_green_where_another_measures_them_and_grey_where_none_does():
    room = Room(people=1, sensors=2)
    frames = room.frames(0.5)
    (person,) = room.scene(0.5, frames).people
    wrist, thumb = KINECT.index("WristLeft"), KINECT.index("ThumbRight")
    views = {view.sensor: view.states.copy() for view in person.views}
    for states in views.values():
        states[:] = JointState.TRACKED
    views["front"][wrist], views["front"][thumb], views["left"][thumb] = (JointState.INFERRED,) * 3
    states = np.full(25, JointState.TRACKED, np.uint8)
    states[thumb] = JointState.INFERRED
    person = msgspec.structs.replace(
        person, states=states, views=tuple(msgspec.structs.replace(v, states=views[v.sensor]) for v in person.views)
    )

    def colours(perspective, who=person):
        return [tuple(joint_colours(who, perspective, KINECT)[k]) for k in (wrist, thumb, KINECT.index("Head"))]

    assert colours("front") == [FILLED.paint, INFERRED.paint, FUSED]
    assert colours("left") == colours(FREE) == [FUSED, INFERRED.paint, FUSED]
    assert colours("unknown") == [FILLED.paint, INFERRED.paint, FILLED.paint]
    swapped = msgspec.structs.replace(
        person, views=tuple(msgspec.structs.replace(v, mirrored=v.sensor == "front") for v in person.views)
    )
    assert colours("front", swapped)[0] == FUSED
    assert tuple(joint_colours(swapped, "front", KINECT)[KINECT.mirror[wrist]]) == FILLED.paint


def test_without_a_scene_the_stage_is_empty():
    drawing = tracking_drawing(None, FREE, Perspectives(), Floors())
    assert len(drawing.bones) == 0
    assert drawing.tags == []
    assert tracking_title(drawing, FREE).text == "Scene · world frame"


def test_a_known_height_is_taken_and_an_unknown_one_is_the_lowest_joint():
    frame = Room().frames(0.0)["front"]
    floors = Floors()
    floors.learn_frame(frame)
    assert floors.height("front") == HEIGHT_M
    floors.learn_frame(frame, SensorPose(tilt=0.1, height=0.8))
    assert (floors.tilt("front"), floors.height("front")) == (0.1, 0.8)
    unknown = msgspec.structs.replace(frame, sensor="left", height=0.0)
    floors.learn_frame(unknown)
    assert floors.height("left") == pytest.approx(-np.nanmin(frame.positions[..., 1]))


def test_a_frame_without_anybody_teaches_nothing_of_the_floor():
    floors = Floors()
    floors.learn_frame(body_frame("front", KINECT, time_ns=0, positions=[]))
    assert floors.height("front") == 0.0


def test_a_lane_shows_the_sensors_own_skeletons_in_its_colour():
    frame = Room().frames(0.0)["front"]
    strokes = lane_bones(frame, LaneSpace(np.zeros(3), np.eye(4), SENSORS[0]))
    assert len(strokes) == 2 * 24
    inferred = (np.asarray(frame.states)[:, np.array(KINECT.bones)] == JointState.INFERRED).any(axis=-1).ravel()
    assert inferred.any()
    assert (strokes.colours[~inferred] == SENSORS[0].paint).all()
    assert (strokes.colours[inferred] == SENSORS[0].faint).all()


@given(st.permutations(["front", "left", "right", "back"]))
def test_the_same_sensors_have_the_same_colours_in_whatever_order_they_come(names):
    colours = SensorColours()
    for name in names:
        colours.learn({name})
    assert colours.sensors == ("back", "front", "left", "right")
    assert [colours.of(name) for name in colours.sensors] == list(SENSORS[:4])
