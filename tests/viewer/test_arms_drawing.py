"""Arms on the stage: three views of the same arm, hollow where it is inferred, and the cloth with it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.model.arm_quality import ArmQuality, Misdetections
from mocapella.model.arms import ARM_BONES, ARM_JOINTS, ArmFrame, SeenArm
from mocapella.model.hand import DIGITS, TIPS
from mocapella.model.observations import JointState
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedArm, TrackerState
from mocapella.model.topology import topology
from mocapella.viewer import layout
from mocapella.viewer.arm_panel import quality_html
from mocapella.viewer.arm_strokes import COLOURS, lane_arms
from mocapella.viewer.palette import Rgb
from mocapella.viewer.perspective import Floors, Perspectives
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.stage import StageView
from mocapella.viewer.stage_arms import PANELS, SCALE, ArmsShown, arms_drawing, centre_of, cloth_mesh
from mocapella.viewer.stages import ARMS, ROOM
from mocapella.viewer.tracking_stage import tracking_title

POINTS = np.random.default_rng(4).normal(0, 0.1, (23, 3)) + np.array([0.0, 0.0, 0.8])
CENTRE = POINTS.mean(axis=0)
GRID = np.stack(np.meshgrid([0.0, 0.1, 0.2, 0.3], [0.0, 0.1], [0.8]), axis=-1)[:, :, 0]


def arm(**changed: Any) -> TrackedArm:
    made = TrackedArm(2, True, POINTS, np.full(23, JointState.TRACKED, np.uint8), np.full(23, 0.004, np.float32),
                      np.zeros(21), None, "fist", 0.93, True, -1, ("arm",))  # fmt: skip
    return msgspec.structs.replace(made, **changed)


def scene(*arms: TrackedArm, **changed: Any) -> Scene:
    state, place = TrackerState(Phase.TRACKING), SensorPlace("arm", np.eye(4))
    made = Scene(0, 0, "arm", 0, 0, topology("hand"), state, {"arms": arms}, (place,))
    return msgspec.structs.replace(made, **changed)


def test_every_view_has_all_joints_at_their_distances_and_the_front_is_what_the_camera_sees() -> None:
    drawing = arms_drawing(scene(arm()), ArmsShown(CENTRE))
    assert len(drawing.joints) == 3 * 8
    assert len(drawing.halos) == 0
    assert len(drawing.bones) == 3 * (4 + len(ARM_BONES)) + 5  # and the frames, and those that lead to names
    views = drawing.joints.positions.reshape(3, 8, 3)
    joints = POINTS[list(ARM_JOINTS)]
    apart = np.linalg.norm(joints[:, None] - joints[None], axis=-1)
    for view in views:
        np.testing.assert_allclose(np.linalg.norm(view[:, None] - view[None], axis=-1), SCALE * apart, atol=1e-5)
    front = views[0] - PANELS[0].middle
    aside = rotation_about_y(np.arctan2(PANELS[0].left_m, 6.5))
    np.testing.assert_allclose(front @ aside, SCALE * (joints - CENTRE), atol=1e-5)
    np.testing.assert_array_equal(drawing.joints.colours[:8], [colour.paint for colour in COLOURS])
    assert len({tuple(colour) for colour in COLOURS[2:]}) == 6


def test_the_views_are_beside_each_other_and_on_the_stage() -> None:
    box = layout.arms_box()
    middles = np.array([panel.middle for panel in PANELS])
    assert (np.diff(middles[:, 0]) < -1.5).all()  # +x is to the left of the screen
    assert ((box.low[:2] < middles[:, :2]) & (middles[:, :2] < box.high[:2])).all()
    for panel in PANELS:
        np.testing.assert_allclose(panel.R @ panel.R.T, np.eye(3), atol=1e-12)


def test_turning_the_world_with_its_camera_changes_nothing() -> None:
    T = rigid(rotation_about_y(1.3), [1.0, 0.2, -3.0])
    moved = POINTS @ T[:3, :3].T + T[:3, 3]
    here = arms_drawing(scene(arm()), ArmsShown(CENTRE))
    there = arms_drawing(scene(arm(points=moved), sensors=(SensorPlace("arm", T),)), ArmsShown(moved.mean(axis=0)))
    np.testing.assert_allclose(there.joints.positions, here.joints.positions, atol=1e-5)


def test_what_is_inferred_is_hollow_and_what_is_not_known_is_not_there() -> None:
    states = np.full(23, JointState.TRACKED, np.uint8)
    states[8], states[12] = JointState.INFERRED, JointState.NOT_TRACKED
    points = POINTS.copy()
    points[16] = np.nan
    drawing = arms_drawing(scene(arm(states=states, points=points)), ArmsShown(CENTRE))
    assert len(drawing.joints) == 3 * 5
    assert len(drawing.halos) == 3
    assert (drawing.halos.opacities < 0.6).all()
    assert len(drawing.bones) == 3 * (4 + len(ARM_BONES) - 2) + 3
    for strokes in (drawing.bones, drawing.joints, drawing.halos):
        assert all(np.isfinite(a).all() for a in (strokes.positions, strokes.wxyzs, strokes.scales))
    names = {tag.text: tag.visible for tag in drawing.tags}
    assert not names["middle"]
    assert not names["ring"]
    assert "Left arm · fist 93 % · grabbing · 5 of 8 measured" in names


def test_fingertips_have_their_names_wherever_they_are_and_others_as_far_as_there_is_room() -> None:
    drawing = arms_drawing(scene(arm(points=np.tile(CENTRE, (23, 1)))), ArmsShown(CENTRE))
    visible = {tag.text: tag.visible for tag in drawing.tags}
    assert [visible[name] for name in ("elbow", "wrist", "palm")] == [True, False, False]
    places = np.array([tag.position for tag in drawing.tags if tag.text in DIGITS])
    assert all(visible[name] for name in DIGITS)
    assert np.abs(np.diff(places[:, 0])).min() > 0.2  # so wide is a name


@pytest.mark.parametrize("turned", [False, True])
def test_the_row_of_names_begins_on_the_thumbs_side_and_each_arm_has_its_own(turned: bool) -> None:
    points = POINTS.copy()
    points[TIPS, :] = CENTRE + np.outer(np.linspace(0.1, -0.1, 5) * (-1 if turned else 1), [1.0, 0.0, 0.0])
    drawing = arms_drawing(scene(arm(points=points), arm(points=points, id=3)), ArmsShown(CENTRE))
    rows = np.array([tag.position for tag in drawing.tags if tag.text in DIGITS]).reshape(2, 5, 3)
    for row in rows:
        assert (np.diff(row[:, 0]) * (1 if turned else -1) > 0).all()
    assert (rows[0, :, 1] - rows[1, :, 1] > 0.075).all()


def test_the_cloth_is_in_every_view_and_closed_to_its_edges() -> None:
    drawing = arms_drawing(scene(arm()), ArmsShown(CENTRE, cloth=GRID))
    area = 0.0
    assert list(drawing.surfaces) == ["cloth/0", "cloth/1"]
    for mesh in (surface.mesh for surface in drawing.surfaces.values()):
        assert mesh.vertices.shape == (3 * GRID.shape[0] * GRID.shape[1], 3)
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
        assert areas.min() > 0
        area += areas.sum()
    assert area == pytest.approx(3 * SCALE**2 * 0.3 * 0.1, rel=1e-5)
    for one, other in zip(cloth_mesh(GRID[None]), cloth_mesh(GRID[None] + 1), strict=True):
        assert one.faces is other.faces
    assert arms_drawing(None, ArmsShown(CENTRE)).surfaces == {}


def test_what_is_looked_at_stays_while_the_hand_is_near_and_follows_when_it_goes_away() -> None:
    assert centre_of((), None) is None
    first = centre_of((arm(),), None)
    assert first is not None
    np.testing.assert_array_equal(centre_of((arm(points=POINTS + 0.05),), first), first)
    away, centre = arm(points=POINTS + np.array([0.6, 0.0, 0.0])), first
    for _ in range(200):
        centre = centre_of((away,), centre)
        assert centre is not None
    assert 0.3 < centre[0] - first[0] < 0.6
    np.testing.assert_array_equal(centre_of((), first), first)
    np.testing.assert_array_equal(centre_of((arm(points=np.full((23, 3), np.nan)),), first), first)


def test_the_title_is_at_the_edge_of_what_the_picture_has() -> None:
    view = StageView("arm", Perspectives(), Floors(), PluginErrors())
    for stage, shown in ((ARMS, ArmsShown(CENTRE)), (ROOM, None)):
        title = tracking_title(stage, stage.draw(scene(arm()), shown, view), "arm")
        assert (np.array(title.position) >= stage.box.low).all()
        assert (np.array(title.position) <= stage.box.high).all()
        assert title.position[0] > max(panel.middle[0] for panel in PANELS)
        assert ("2.3 times as large" in title.text) == (stage is ARMS)


def test_an_image_in_its_lane_has_the_arm_where_the_camera_sees_it() -> None:
    seen = SeenArm(0, False, 1.0, np.tile([0.0, 0.0, 0.8], (23, 1)), np.full(23, 2, np.uint8), np.zeros(23, np.float32),
                   np.zeros(21))  # fmt: skip
    frame = ArmFrame("arm", 0, 0, 0, 0, (640, 480), np.array([500.0, 500, 320, 240, 0, 0, 0, 0, 0]), "default", (seen,))
    lines, balls = lane_arms(frame, np.zeros(3), Rgb(255, 255, 255))
    assert len(lines) == 4  # the edge; all bones are points
    np.testing.assert_allclose(balls.positions, np.tile(lines.positions.mean(axis=0), (8, 1)), atol=1e-5)
    gone = msgspec.structs.replace(seen, points=np.full((23, 3), np.nan))
    assert len(lane_arms(msgspec.structs.replace(frame, arms=(gone,)), np.zeros(3), Rgb(1, 2, 3))[1]) == 0


def test_the_readout_has_every_joints_noise_and_says_when_there_is_none() -> None:
    noise = np.array([0.001, np.nan, *[0.0005] * 6])
    quality = ArmQuality(
        noise, noise, True, 12.5, Misdetections(3, 1, 2, 4, 5), Misdetections(3, 1, 2, 4, 5), 60.0, 5.0
    )
    html = quality_html(scene(arm(gesture="<b>")), quality)
    assert "1.00 mm" in html
    assert html.count("0.50 mm") == 6
    assert "12.5" in html
    assert "3 jumped · 1 appeared · 2 vanished · 4 swapped · 5 arms lost" in html
    assert "<b> 93" not in html
    nothing = ArmQuality(np.full(8, np.nan), noise, False, np.nan, Misdetections(), Misdetections(), 0.0, 0.0)
    html = quality_html(None, nothing)
    assert "hold an arm still" in html
    assert "No arm is seen" in html
