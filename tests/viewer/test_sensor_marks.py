"""Sensors stand where they are, show their true field of view, and say what is wrong with them."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drawings import is_fused, tracking_drawing, tracking_title
from support.unsure_scene import MOVED, WALK, placed
from support.walkers import HEIGHT_M, KINECT, Room, rigid

from mocapella.geometry.rigid import apply
from mocapella.model.scene import SensorPlace
from mocapella.viewer.palette import AMBER, GREY, RED, SENSORS
from mocapella.viewer.perspective import FREE, Floors, Perspectives, upright
from mocapella.viewer.sensor_marks import REACH_M, PlaceState, field_lines, marks, standing, words

DOUBT = "it does not see people where front sees them: walk a few steps where both see you"
ANGLE = st.floats(-3.0, 3.0)


def learned(*scenes):
    seen, floors = Perspectives(), Floors()
    for k, scene in enumerate(scenes):
        seen.learn(msgspec.structs.replace(scene, step=k))
        floors.learn_scene(scene)
    return seen, floors


def positions(drawing):
    """(sensors, 3) and what they say, by name."""
    return {name: mark.T[:3, 3] for name, mark in drawing.sensors.items()}


@pytest.mark.parametrize(
    ("place", "was_placed", "how", "said", "colour"),
    [
        (SensorPlace("left", np.eye(4)), True, PlaceState.GOOD, "left", SENSORS[0]),
        (SensorPlace("left", np.eye(4), problem=DOUBT), True, PlaceState.DOUBTED, "left · in doubt", AMBER),
        (SensorPlace("left", np.eye(4), problem=WALK), True, PlaceState.GOOD, "left", SENSORS[0]),
        (SensorPlace("left", None, problem=MOVED), True, PlaceState.LOST, "left · not used: it was moved", RED),
        (SensorPlace("left", None, problem=WALK), False, PlaceState.UNKNOWN, "left · not calibrated yet", GREY),
        (SensorPlace("left", None), False, PlaceState.UNKNOWN, "left · not calibrated yet", GREY),
    ],
)
def test_each_standing_has_words_and_a_colour(place, was_placed, how, said, colour):
    remembered = {"left": np.eye(4)} if was_placed else {}
    assert standing(place, was_placed) is how
    assert words(place, how) == said
    assert marks((place,), remembered, np.eye(4))["left"].colour(SENSORS[0]) == colour


@given(ANGLE, st.floats(-0.7, 0.7), st.floats(0.3, 3.0))
def test_an_upright_stage_is_under_the_sensor_and_looks_where_it_looks(turn, tilt, height):
    c, s = np.cos(tilt), np.sin(tilt)
    T = rigid(turn, (1.0, height, -2.0))
    T[:3, :3] = T[:3, :3] @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    T_stage = upright(T, 0.25)
    assert T_stage[:3, 3] == pytest.approx([0, height + 0.25, 0], abs=1e-12)
    assert T_stage[:3, 2] == pytest.approx([0, np.sin(tilt), np.cos(tilt)], abs=1e-9)
    up = (T_stage @ np.linalg.inv(T))[:3, 1]
    assert up == pytest.approx([0, 1, 0], abs=1e-12)


@pytest.mark.parametrize("perspective", [FREE, "front", "left", "right"])
def test_sensors_and_people_stand_as_in_the_room_from_every_perspective(perspective):
    """All distances between sensors and joints are those of the room, and the floor is level at y = 0."""
    room = Room()
    scene = placed(room)
    drawing = tracking_drawing(scene, perspective, *learned(scene))
    assert drawing.unseen == ()
    fused = drawing.bones.positions[is_fused(drawing)]
    eyes = np.array([positions(drawing)[name] for name in room.names])
    true_eyes = np.array([T[:3, 3] for T in room.T_world])
    parents = np.array([bone[0] for bone in KINECT.bones])
    raw = room.scene(1.0, room.frames(1.0)).people
    assert np.linalg.norm(eyes[:, None] - eyes, axis=-1) == pytest.approx(
        np.linalg.norm(true_eyes[:, None] - true_eyes, axis=-1), abs=1e-6
    )
    assert eyes[:, 1] == pytest.approx(HEIGHT_M)
    there = [k for k, bone in enumerate(KINECT.bones) if KINECT.index("ThumbLeft") not in bone]
    away = np.linalg.norm(fused[: len(there), None] - eyes, axis=-1)
    true_away = np.linalg.norm(raw[0].positions[parents[there]][:, None] - true_eyes, axis=-1)
    assert away == pytest.approx(true_away, abs=0.05)  # the room draws its noise anew


def test_a_moved_sensor_stays_drawn_where_it_was_and_a_new_one_waits_aside():
    room = Room()
    before, after = placed(room, left=WALK), placed(room, left=WALK, right=MOVED)
    seen, floors = learned(before, after)
    drawing = tracking_drawing(after, FREE, seen, floors)
    assert {name: mark.standing for name, mark in drawing.sensors.items()} == {
        "front": PlaceState.GOOD,
        "left": PlaceState.UNKNOWN,
        "right": PlaceState.LOST,
    }
    was = tracking_drawing(before, FREE, *learned(before))
    assert positions(drawing)["right"] == pytest.approx(positions(was)["right"])
    assert tracking_drawing(after, "right", seen, floors).unseen == ()


def test_from_a_sensor_without_a_place_nobody_is_shown_and_the_title_says_why():
    room = Room()
    scene = placed(room, left=WALK)
    blind = scene.with_parts(
        people=tuple(
            msgspec.structs.replace(p, views=tuple(v for v in p.views if v.sensor != "left")) for p in scene.people
        )
    )
    drawing = tracking_drawing(blind, "left", *learned(blind))
    assert len(drawing.bones) == 0
    assert "not calibrated yet: look from another sensor, or free" in tracking_title(drawing, "left").text


def test_a_world_that_is_laid_anew_forgets_where_sensors_were():
    room = Room()
    before, after = placed(room), placed(room, right=MOVED)
    T = rigid(1.0, (0.0, 0.5, 0.0))
    moved = tuple(
        msgspec.structs.replace(place, T_world_sensor=None if place.problem else T @ place.T_world_sensor)
        for place in after.sensors
    )
    seen, _ = learned(before, msgspec.structs.replace(after, sensors=moved))
    assert set(seen.places) == {"front", "left"}
    assert seen.world == 1
    seen, _ = learned(before, after)
    assert set(seen.places) == {"front", "left", "right"}
    assert seen.world == 0


def test_a_person_who_is_calibrated_anew_has_a_new_world_where_each_has_their_own():
    room = Room()
    scene = room.scene(1.0, room.frames(1.0))
    T = rigid(0.5, (1.0, 0.0, 0.0))
    views = tuple(
        msgspec.structs.replace(view, T_world_sensor=T @ view.T_world_sensor) for view in scene.people[1].views
    )
    anew = (scene.people[0], msgspec.structs.replace(scene.people[1], views=views))
    seen, _ = learned(scene, scene, scene.with_parts(people=scene.people[:1]), scene)
    assert seen.world == 0
    seen, _ = learned(scene, scene.with_parts(people=anew))
    assert seen.world == 1


def test_a_new_tracker_forgets_where_sensors_were():
    room = Room()
    seen, _ = learned(placed(room), placed(room))
    seen.learn(msgspec.structs.replace(placed(room, right=MOVED), step=0))
    assert set(seen.places) == {"front", "left"}


def test_a_floor_that_the_tracker_knows_is_taken_and_another_is_under_the_lowest_joint():
    room = Room()
    scene = placed(room)
    assert learned(scene)[1].height(FREE) == 0.0
    on_sensor = msgspec.structs.replace(room.scene(1.0, room.frames(1.0)), sensors=(SensorPlace("front", np.eye(4)),))
    assert learned(on_sensor)[1].height("front") == pytest.approx(HEIGHT_M, abs=0.1)


@given(st.floats(20, 120), st.floats(20, 120), ANGLE)
def test_the_drawn_field_of_view_has_the_sensors_angles(across, high, turn):
    T = rigid(turn, (1.0, 2.0, 3.0))
    lines = field_lines(T, (across, high)).astype(float)
    assert lines.shape == (8, 2, 3)
    far = apply(np.linalg.inv(T), lines[:4, 1])
    assert lines[:4, 0] == pytest.approx(np.tile(T[:3, 3], (4, 1)), abs=1e-5)
    assert far[:, 2] == pytest.approx(REACH_M, abs=1e-4)
    assert np.degrees(2 * np.arctan2(np.ptp(far[:, 0]) / 2, REACH_M)) == pytest.approx(across, abs=1e-3)
    assert np.degrees(2 * np.arctan2(np.ptp(far[:, 1]) / 2, REACH_M)) == pytest.approx(high, abs=1e-3)
