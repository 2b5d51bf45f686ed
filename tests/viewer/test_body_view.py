"""The view of a followed body: where things stand, what is said, and how frames are played."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from silhouette_pictures import pose_at, ring, somebody

from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist
from mocapella.model.body_meshes import legs_mesh
from mocapella.model.outline_colours import INSIDE, OUTSIDE, body_colour, css
from mocapella.model.rigged_mesh import posed
from mocapella.model.twist_tree import TreePose
from mocapella.viewer import body_view
from mocapella.viewer.body_panel import BodyViewFrame, EncodedPicture, cameras_html, groups, status_html
from mocapella.viewer.body_stage import ShownBody, picture_row, stage_space
from mocapella.viewer.body_view import BodyView, _words

MESH, LEGS, RIG = somebody(), legs_mesh("female", 1.7), ring(2)


def legs_at(aside_m):
    return TreePose(pose_at(MESH, aside_m).T_world_model, np.zeros(len(LEGS.joint_names)))


def a_frame(k, image=b"jpeg", **changes):
    what = {"overlap": {"c1": 0.9}, "left_out": {"c2": "its <image> is black"}, "lost": False} | changes
    return BodyViewFrame(k, k / 30, {"": ShownBody(pose_at(MESH, 0.01 * k), **what)}, {"c1": EncodedPicture(image)})


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
    space = stage_space([(MESH, pose)], up)
    there = apply(space.T_stage_world, posed(MESH, pose))
    assert there[:, 1].min() == pytest.approx(0.0, abs=1e-9)
    assert there[:, 1].max() == pytest.approx(space.tall_m)
    assert space.tall_m == pytest.approx(1.75, abs=0.05)
    np.testing.assert_allclose((space.T_stage_world @ T)[:3, 2], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(space.T_stage_world[:3, :3]), 1.0)


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


def test_what_is_wrong_is_said_and_cannot_make_markup():
    said = cameras_html(a_frame(3), ["c1", "c2", "<c3>"])
    assert "90%" in said
    assert "its &lt;image&gt; is black" in said
    assert "&lt;c3&gt;" in said
    assert "not in the image" in said
    assert "<c3>" not in said
    assert "Nobody is there" in status_html("Following", a_frame(3, lost=True), 3, 9)
    assert "frame 3 · 0.10 s · 4 of 9" in status_html("Following", a_frame(3), 3, 9)


@pytest.fixture
def view():
    made = BodyView("127.0.0.1", 0, {"": MESH}, RIG, starts={"": pose_at(MESH)}, up=np.array([0.0, 1.0, 0.0]))
    yield made
    made.close()


def test_the_newest_is_shown_until_somebody_stops_it_and_then_it_is_played(view):
    now_s = 100.0
    for k in range(5):
        view.add(a_frame(k))
        view.show(now_s + 0.03 * k)
    assert view.place == 4
    view.panel.playing, view.panel.wish = False, 1
    view.show(now_s + 1)
    view.add(a_frame(5))
    view.show(now_s + 2)
    assert view.place == 1
    view.panel.playing = True
    places = []
    for k in range(12):
        view.show(now_s + 3 + k / 60)
        places.append(view.place)
    assert places == sorted(places)
    assert places[0] == 1
    assert places[-1] == 5
    assert places.count(3) in (1, 2, 3)  # 30 frames a second, shown 60 times
    view.end()
    view.show(now_s + 4)
    assert not view.panel.playing
    view.show(now_s + 5)
    view.panel.playing = True
    view.show(now_s + 6)
    assert view.place == 0


def test_old_pictures_are_let_go_where_there_are_many(view, monkeypatch):
    monkeypatch.setattr(body_view, "KEPT_BYTES", 1000)
    for k in range(10):
        view.add(a_frame(k, image=bytes(300)))
    kept = [len(frame.pictures) for frame in view.frames]
    assert kept == [0] * 7 + [1] * 3
    assert [frame.frame for frame in view.frames] == list(range(10))


def a_frame_of_two(k, **bens):
    ben = {"overlap": {"c1": 0.8, "c2": 0.7}, "left_out": {}, "lost": False} | bens
    anna = ShownBody(pose_at(MESH, 0.01 * k), {"c1": 0.9}, {"c2": "its image is black"}, lost=False)
    return BodyViewFrame(k, k / 30, {"anna": anna, "ben": ShownBody(legs_at(1.0), **ben)}, {})


def test_several_bodies_stand_about_the_middle_of_one_floor():
    starts = [(MESH, pose_at(MESH, -1.0)), (LEGS, legs_at(1.0))]
    space = stage_space(starts, np.array([0.0, 1.0, 0.0]))
    vertices = [apply(space.T_stage_world, posed(mesh, pose)) for mesh, pose in starts]
    assert min(one[:, 1].min() for one in vertices) == pytest.approx(0.0)
    assert max(one[:, 1].max() for one in vertices) == pytest.approx(space.tall_m)
    (left, right) = (float(one[:, 0].mean()) for one in vertices)
    assert left == pytest.approx(-right, abs=0.02)
    assert max(abs(left), abs(right)) == pytest.approx(1.0, abs=0.02)
    assert 1.0 < space.half_wide_m < 2.0
    assert stage_space(starts[:1], np.array([0.0, 1.0, 0.0])).half_wide_m < 0.5


def test_it_is_said_of_whom_each_line_and_figure_is():
    said = cameras_html(a_frame_of_two(3), ["c1", "c2"])
    assert all(text in said for text in ("anna", "ben", "90%", "80%", "70%", "left out", "its image is black"))
    legend = said[said.index("mocapella-legend") :]
    for colour, words in ((body_colour(0), "anna"), (body_colour(1), "ben"), (OUTSIDE, "outside"), (INSIDE, "inside")):
        assert f'{css(colour)}">▬</span> {words}' in legend
    assert "not there: ben" in status_html("Following", a_frame_of_two(3, lost=True), 3, 9)
    assert "not there" not in status_html("Following", a_frame_of_two(3), 3, 9)
    assert _words("c2", a_frame_of_two(3)) == "c2 · anna left out · ben 70%"
    assert _words("c1", a_frame(3)) == "c1 · 90%"


def test_angles_are_of_who_is_chosen():
    up, starts = np.array([0.0, 1.0, 0.0]), {"anna": pose_at(MESH), "ben": legs_at(1.0)}
    view = BodyView("127.0.0.1", 0, {"anna": MESH, "ben": LEGS}, RIG, starts=starts, up=up)
    try:
        view.add(a_frame_of_two(0))
        view.show(100.0)
        assert (view.panel.whose, view._lately()[1].shape) == ("anna", (1, len(MESH.joint_names)))
        view.panel._whose.value = "ben"
        view.add(a_frame_of_two(1, lost=True))
        view.show(101.0)
        assert (view.panel.whose, view._lately()[1].shape) == ("ben", (2, len(LEGS.joint_names)))
        assert [chart._names for chart in view.panel._charts] == [tuple(LEGS.joint_names)] * 2
    finally:
        view.close()


def test_the_oldest_frames_are_let_go_and_who_looks_at_one_goes_on_looking_at_it(view, monkeypatch):
    monkeypatch.setattr(body_view, "KEPT_FRAMES", 20)
    monkeypatch.setattr(body_view, "LET_GO", 5)
    monkeypatch.setattr(body_view, "KEPT_BYTES", 3500)
    for k in range(24):
        view.add(a_frame(k, image=bytes(300)))
    view.panel.playing, view.place = False, 12
    view.add(a_frame(24, image=bytes(300)))
    assert [frame.frame for frame in view.frames] == list(range(5, 25))
    assert view.frames[view.place].frame == 12
    for k in range(25, 2000):
        view.add(a_frame(k, image=bytes(300)))
    assert len(view.frames) == len(view._at_s) == len(view._angles[""]) <= 25
    assert view._at_s[-1] == pytest.approx(1999 / 30)
    kept = [len(frame.pictures) for frame in view.frames]
    assert kept == sorted(kept)
    assert sum(kept) == 11
    assert view._bytes == 11 * 300
    view.show(1.0)
