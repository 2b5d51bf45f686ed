"""Hands on the stage: cameras in front, larger than life, and nothing drawn of what is not known."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.model.hand import BASES, DIGIT_ANGLES, TIPS, HandPose, hand_model
from mocapella.model.markers import marker_frame
from mocapella.model.observations import JointState
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedHand, TrackedObject, TrackedPoints, TrackerState
from mocapella.model.topology import topology
from mocapella.sources.simulate.hand_motion import UPRIGHT, landmarks_of
from mocapella.viewer import layout
from mocapella.viewer.marker_lane import lane_picture, marker_colour
from mocapella.viewer.palette import AMBER, FUSED, Rgb
from mocapella.viewer.sensor_marks import PlaceState
from mocapella.viewer.stage import TrackingDrawing
from mocapella.viewer.stage_hands import LARGEST_SCALE, StageOfHands, at_limit, hands_drawing

FULL = hand_model("full")
SHAPE = FULL.shape("right")
WHITE = Rgb(255, 255, 255)
MIDDLE = np.array(layout.stage_centre())
BOX = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.05
angles_about = st.floats(-3.0, 3.0)


def hand(**changed: Any) -> TrackedHand:
    pose = HandPose(FULL.natural, rigid(UPRIGHT, [0.0, -0.1, 0.0]))
    x = landmarks_of(FULL, SHAPE, pose)
    states, sd = np.full(21, JointState.TRACKED, np.uint8), np.full(21, 0.001, np.float32)
    made = TrackedHand(3, False, x, states, sd, FULL.natural, pose.T_world_palm)
    return msgspec.structs.replace(made, **changed)


def cameras(*turns: float, away: float = 0.5) -> tuple[SensorPlace, ...]:
    """Cameras around the origin, which they look at; at no turn it is in front of the hand, on +z."""
    made = []
    for k, turn in enumerate(turns):
        R = rotation_about_y(turn) @ np.diag([-1.0, 1.0, -1.0])
        made.append(SensorPlace(f"c{k}", rigid(R, -away * R[:, 2])))
    return tuple(made)


def scene(*hands: TrackedHand, **changed: Any) -> Scene:
    """A scene with these hands; other parts, and fields of a scene, by name."""
    parts = {name: changed.pop(name) for name in ("objects", "points") if name in changed}
    if "points" in parts:
        parts["points"] = (parts["points"],)
    state, parts = TrackerState(Phase.TRACKING), {"hands": hands, **parts}
    made = Scene(0, 0, "c0", 0, 0, topology("hand"), state, parts, cameras(-0.4, 0.4))
    return msgspec.structs.replace(made, **changed)


def numbers(drawing: TrackingDrawing) -> list[np.ndarray]:
    parts = (drawing.bones, drawing.joints, drawing.halos)
    return [a for s in parts for a in (s.positions, s.wxyzs, s.scales, s.opacities)]


@given(angles_about, st.floats(0.3, 1.2), st.floats(0.4, 0.7))
def test_cameras_stand_in_front_and_what_they_look_at_in_the_middle(turn: float, apart: float, away: float) -> None:
    both = cameras(turn - apart, turn + apart, away=away)
    stage = StageOfHands.of(scene(sensors=both))
    np.testing.assert_allclose(stage.place(np.zeros(3)), MIDDLE, atol=0.03 * stage.scale)
    places = np.array([stage.place_sensor(place.T_world_sensor) for place in both])
    assert (places[:, 2, 3] < MIDDLE[2]).all()
    np.testing.assert_allclose(places[:, :3, 2].sum(axis=0)[:2], 0, atol=1e-9)  # on the whole they look along +z
    np.testing.assert_allclose(np.linalg.det(places[:, :3, :3]), 1.0)
    np.testing.assert_allclose(places[:, 1, 1], 1.0)  # up stays up


@given(st.floats(-3, 3), st.floats(0.05, 5.0))
def test_the_stage_is_as_large_as_the_cameras_allow(x: float, away: float) -> None:
    stage = StageOfHands.of(scene(sensors=cameras(-0.4, 0.4, away=away)))
    assert 0 < stage.scale <= LARGEST_SCALE
    places = [stage.place(place.T_world_sensor[:3, 3]) for place in cameras(-0.4, 0.4, away=away)]
    assert np.linalg.norm(places - MIDDLE, axis=-1).max() <= 3.0 + 1e-9
    # Every length is as many times longer.
    a, b = np.array([x, 0.1, 0.2]), np.array([0.3, -x, 0.1])
    assert np.linalg.norm(stage.place(a) - stage.place(b)) == pytest.approx(stage.scale * np.linalg.norm(a - b))


def test_moving_the_world_level_changes_nothing_on_the_stage() -> None:
    motion = rigid(rotation_about_y(1.1), [3.0, 0.4, -2.0])
    moved = tuple(
        msgspec.structs.replace(p, T_world_sensor=motion @ p.T_world_sensor)  # type: ignore[operator]
        for p in cameras(-0.4, 0.4)
    )
    here = StageOfHands.of(scene()).place(hand().landmarks)
    there = StageOfHands.of(scene(sensors=moved)).place(apply(motion, hand().landmarks))
    np.testing.assert_allclose(there, here, atol=0.02)


def test_cameras_that_look_the_same_way_have_the_stage_half_a_metre_ahead() -> None:
    R = np.diag([-1.0, 1.0, -1.0])
    sensors = tuple(SensorPlace(f"c{k}", rigid(R, [0.04 * (2 * k - 1), 0.1, 0.7])) for k in range(2))
    np.testing.assert_allclose(StageOfHands.of(scene(sensors=sensors)).centre, [0, 0.1, 0.2], atol=1e-9)


def test_without_cameras_the_middle_is_that_of_the_hands_or_the_origin() -> None:
    one = hand(landmarks=np.where(np.arange(21)[:, None] == 4, np.nan, hand().landmarks))
    stage = StageOfHands.of(scene(one, sensors=(SensorPlace("c0", None),)))
    np.testing.assert_allclose(stage.centre, np.nanmean(one.landmarks, axis=0))
    assert stage.scale == LARGEST_SCALE
    np.testing.assert_array_equal(StageOfHands.of(scene(sensors=())).centre, np.zeros(3))


def test_the_thumb_of_a_right_hand_whose_palm_is_shown_points_to_the_right_of_the_picture() -> None:
    """The hand is seen as the cameras see it: +x of the stage is to the left."""
    p = StageOfHands.of(scene()).place(hand().landmarks)
    stage_across = p[TIPS[0], 0] - p[TIPS[4], 0]
    eye = cameras(0.0)[0].T_world_sensor
    assert eye is not None
    seen = apply(np.linalg.inv(eye), hand().landmarks)  # x of a sensor is to the left, too
    assert np.sign(stage_across) == np.sign(seen[TIPS[0], 0] - seen[TIPS[4], 0])
    assert p[TIPS[2], 1] > p[0, 1]


def test_a_hand_is_drawn_with_all_bones_at_its_places_and_a_tag_says_what_it_is() -> None:
    drawing = hands_drawing(scene(hand(holds="cube")))
    assert len(drawing.bones) == len(topology("hand").bones)
    p = StageOfHands.of(scene()).place(hand().landmarks)
    np.testing.assert_allclose(drawing.joints.positions[:21], p, atol=1e-5)
    (tag,) = drawing.tags
    assert tag.text == "Right hand · 21 of 21 measured · holds cube"
    np.testing.assert_allclose(np.array(tag.position)[[0, 2]], p[np.argmax(p[:, 1])][[0, 2]])
    assert tag.position[1] > p[:, 1].max()
    states = np.where(np.arange(21) < 8, JointState.INFERRED, JointState.TRACKED).astype(np.uint8)
    (tag,) = hands_drawing(scene(hand(left=True, states=states))).tags
    assert tag.text == "Left hand · 13 of 21 measured"
    (tag,) = hands_drawing(scene(hand(states=np.full(21, JointState.INFERRED, np.uint8)))).tags
    assert tag.text == "Right hand · predicted: no marker is measured now"


def test_nan_draws_nothing_and_never_reaches_the_browser() -> None:
    nobody = hand(landmarks=np.full((21, 3), np.nan), sd=np.full(21, np.nan, np.float32))
    points = TrackedPoints(
        ("red", "blue"), np.full((2, 3), np.nan), np.full(2, np.nan, np.float32), np.zeros(2, np.uint8)
    )
    unseen = TrackedObject("cube", None, BOX, JointState.NOT_TRACKED)
    drawing = hands_drawing(scene(nobody, points=points, objects=(unseen,)))
    assert [len(s) for s in (drawing.bones, drawing.joints, drawing.halos)] == [0, 0, 0]
    assert drawing.tags == []
    partly = hand(landmarks=np.where(np.arange(21)[:, None] == TIPS[2], np.nan, hand().landmarks))
    drawing = hands_drawing(scene(nobody, partly, points=points))
    assert len(drawing.tags) == 1
    assert len(drawing.bones) == len(topology("hand").bones) - 1
    assert all(np.isfinite(a).all() for a in numbers(drawing))


def test_a_landmark_that_is_unsure_has_a_halo() -> None:
    sd = np.full(21, 0.001, np.float32)
    sd[TIPS[0]] = 0.03
    assert len(hands_drawing(scene(hand())).halos) == 0
    halos = hands_drawing(scene(hand(sd=sd))).halos
    np.testing.assert_allclose(halos.positions, StageOfHands.of(scene()).place(hand().landmarks[[TIPS[0]]]), atol=1e-5)


def test_markers_have_the_colours_that_they_are_called_and_are_larger_where_two_cameras_see_them() -> None:
    x = np.array([[0.0, 0.1, 0.0], [0.05, 0.0, 0.0], [0.0, np.nan, 0.0]])
    points = TrackedPoints(("red", "blue", "green"), x, np.ones(3, np.float32), np.array([2, 1, 0], np.uint8))
    joints = hands_drawing(scene(points=points)).joints
    np.testing.assert_allclose(joints.positions, StageOfHands.of(scene()).place(x[:2]), atol=1e-5)
    np.testing.assert_array_equal(joints.colours, [marker_colour("red").paint, marker_colour("blue").paint])
    assert joints.scales[0, 0] > joints.scales[1, 0]


@given(angles_about)
def test_the_outline_of_a_thing_is_closed_and_goes_with_it(turn: float) -> None:
    T = rigid(rotation_about_x(turn), [0.1, 0.05, 0.0])
    drawing = hands_drawing(scene(objects=(TrackedObject("cube", T, BOX, JointState.TRACKED),)))
    corners = StageOfHands.of(scene()).place(apply(T, BOX))
    np.testing.assert_allclose(drawing.bones.positions, corners, atol=1e-5)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=-1)
    np.testing.assert_allclose(drawing.bones.scales[:, 1], sides, rtol=1e-4)  # four sides, so it is closed
    (tag,) = drawing.tags
    assert tag.text == "cube"
    assert tag.position[1] > corners[:, 1].max()


def test_a_thing_without_an_outline_draws_nothing() -> None:
    drawing = hands_drawing(scene(objects=(TrackedObject("dot", np.eye(4), BOX[:1], JointState.TRACKED),)))
    assert len(drawing.bones) == 0


def test_cameras_without_a_place_stand_aside() -> None:
    sensors = (*cameras(0.0), SensorPlace("lost", None), SensorPlace("too", None))
    marks = hands_drawing(scene(sensors=sensors)).sensors
    assert list(marks) == ["c0", "lost", "too"]
    np.testing.assert_array_equal(marks["lost"].T, layout.aside(0))
    np.testing.assert_array_equal(marks["too"].T, layout.aside(1))
    assert marks["c0"].standing is not marks["lost"].standing is PlaceState.UNKNOWN


def test_a_joint_is_at_its_limit_at_the_end_of_a_range_and_not_at_rest() -> None:
    assert not at_limit(hand()).any()
    for digit, row in enumerate(DIGIT_ANGLES):
        for place, angle in zip((0, 0, 1, 2), row[:4], strict=True):
            least, most = FULL.limits[angle]
            if least == most:
                continue
            angles = FULL.natural.copy()
            angles[angle] = most
            (limited,) = np.flatnonzero(at_limit(hand(angles=angles)))
            assert limited == BASES[digit] + place
            angles[angle] = 0.5 * (least + most)
            assert not at_limit(hand(angles=angles)).any()
            angles[angle] = least  # straight is no strain, but bent back as far as can be is
            assert at_limit(hand(angles=angles)).any() == (least < 0)


def test_what_is_not_known_is_at_no_limit() -> None:
    assert not at_limit(hand(angles=np.full(21, np.nan))).any()


def test_a_joint_at_its_limit_is_drawn_in_amber_and_larger() -> None:
    angles = FULL.natural.copy()
    angles[DIGIT_ANGLES[1, 2]] = FULL.limits[DIGIT_ANGLES[1, 2], 1]
    joints = hands_drawing(scene(hand(angles=angles))).joints
    assert len(joints) == 22
    np.testing.assert_array_equal(joints.colours[21], AMBER.paint)
    np.testing.assert_array_equal(joints.positions[21], joints.positions[6])
    assert joints.scales[21, 0] > joints.scales[6, 0]
    np.testing.assert_array_equal(joints.colours[:21], np.broadcast_to(FUSED, (21, 3)))


@pytest.mark.parametrize("name", ["red", "Red", "thumb red", "red-thumb"])
def test_a_marker_that_is_called_a_colour_has_it(name: str) -> None:
    assert marker_colour(name) == marker_colour("red")
    r, g, b = marker_colour("red").paint
    assert r > 2 * max(g, b)


@given(st.text("aeé -R7", max_size=12))
def test_every_name_has_one_bright_colour(name: str) -> None:
    colour = marker_colour(name)
    assert colour == marker_colour(name)
    assert all(0 <= channel <= 255 for channel in colour.paint)


def test_names_that_are_no_colours_are_told_apart() -> None:
    assert len({marker_colour(f"marker {k}").paint for k in range(20)}) > 15


@given(st.floats(0, 639), st.floats(0, 479), st.floats(0, 5000))
def test_a_cameras_picture_stands_in_its_lane(x: float, y: float, area: float) -> None:
    origin = layout.lane_origins(2)[1]
    frame = marker_frame("c0", ("red", "blue"), time_ns=1, size_px=(640, 480), positions_px=[[x, y], [np.nan, np.nan]],
                         areas_px=area)  # fmt: skip
    edge, balls = lane_picture(frame, origin, WHITE)
    half = 0.5 * layout.LANE_WIDTH_M * layout.SENSORS_SCALE
    corners = edge.positions - origin
    assert len(edge) == 4  # closed
    assert (np.abs(corners[:, 0]) < half).all()
    assert (corners[:, 1] > 0).all()
    assert np.ptp(corners[:, 0]) / np.ptp(corners[:, 1]) == pytest.approx(640 / 480, rel=1e-4)
    assert ((corners[:, 2] > 0) & (corners[:, 2] < layout.LANE_DEPTH_M * layout.SENSORS_SCALE)).all()
    assert len(balls) == 1  # the one that is not found is not drawn
    (ball,) = balls.positions - origin
    assert (corners.min(axis=0) - 1e-5 <= ball).all()
    assert (ball <= corners.max(axis=0) + 1e-5).all()
    px = np.ptp(corners[:, 0]) / 640
    assert balls.scales[0, 0] == pytest.approx(px * max(np.sqrt(area / np.pi), 0.006 * 640), rel=1e-4)


def test_the_pictures_first_pixel_is_at_the_left_of_the_screen_and_above() -> None:
    frame = marker_frame("c0", ("red", "blue"), time_ns=1, size_px=(640, 480), positions_px=[[0, 0], [639, 479]])
    _, balls = lane_picture(frame, np.zeros(3), WHITE)
    assert balls.positions[0, 0] > balls.positions[1, 0]  # +x is to the left
    assert balls.positions[0, 1] > balls.positions[1, 1]
