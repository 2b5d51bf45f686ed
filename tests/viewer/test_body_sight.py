"""What is looked at: bodies stay in it wherever they go, and a browser's camera goes along until somebody takes it."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from silhouette_pictures import pose_at, ring, somebody

from mocapella.model.rigged_mesh import posed
from mocapella.viewer.body_browser import LONGEST_STILL_S, STILL_S, BodyBrowser
from mocapella.viewer.body_panel import ALL, BodyViewFrame, EncodedPicture
from mocapella.viewer.body_sight import HEADROOM_M, SLACK_M, Sight
from mocapella.viewer.body_stage import ShownBody
from mocapella.viewer.body_view import BodyView

MESH, RIG = somebody(), ring(2)
HALF, TALL = np.array([0.45, 0.45]), 1.8
LATER = 100.0
metres = st.floats(-20, 20)
boxes = st.lists(
    st.tuples(metres, metres, st.floats(0.2, 4.0), st.floats(0.2, 4.0), st.floats(1.0, 4.0)), min_size=1, max_size=6
)


def corners(box):
    x, z, wide, deep, high = box
    return np.array([x - wide, 0.0, z - deep]), np.array([x + wide, high, z + deep])


@given(boxes)
def test_bodies_are_in_it_once_it_has_settled_and_it_is_no_larger_than_it_need_be(found):
    sight = Sight(HALF, TALL)
    for k, box in enumerate(found):
        low, high = corners(box)
        sight.follow(low, high, LATER * k)
        sight.follow(low, high, LATER * k + LATER / 2)
        ground = [0, 2]
        assert (low[ground] >= sight.middle[ground] - sight.half_m - SLACK_M - 1e-9).all()
        assert (high[ground] <= sight.middle[ground] + sight.half_m + SLACK_M + 1e-9).all()
        assert high[1] <= TALL + HEADROOM_M + sight.middle[1] + 1e-9
        needed = np.maximum(HALF, 0.5 * (high - low)[ground] - SLACK_M)
        np.testing.assert_allclose(sight.half_m, needed, atol=1e-9)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.5, 2.0))
def test_who_moves_about_in_it_does_not_move_it(x, z, high):
    sight = Sight(HALF, TALL)
    sight.follow(*corners((0, 0, 0.4, 0.3, 1.8)), 0.0)
    sight.follow(*corners((x, z, 0.4, 0.3, high)), LATER)
    np.testing.assert_array_equal(sight.middle, 0.0)
    np.testing.assert_array_equal(sight.half_m, HALF)


@given(metres, metres, st.lists(st.floats(0.001, 0.5), min_size=1, max_size=8))
def test_how_fast_it_follows_does_not_depend_on_how_often_it_is_asked(x, z, steps):
    often, once = Sight(HALF, TALL), Sight(HALF, TALL)
    for sight in (often, once):
        sight.follow(*corners((0, 0, 0.4, 0.3, 1.8)), 0.0)
        sight.follow(*corners((x, z, 0.4, 0.3, 1.8)), 0.0)
    now_s = 0.0
    for step in steps:
        now_s += step
        often.rest(now_s)
    once.rest(now_s)
    np.testing.assert_allclose(often.middle, once.middle, atol=1e-9)
    assert (np.abs(often.middle) <= np.abs(often._to_middle) + 1e-9).all()


@pytest.fixture
def view():
    made = BodyView("127.0.0.1", 0, {"": MESH}, RIG, starts={"": pose_at(MESH)}, up=np.array([0.0, 1.0, 0.0]))
    yield made
    made.close()


def shown(k, aside_m, lost=False, pictures=True, at_s=None):
    bodies = {"": ShownBody(pose_at(MESH, aside_m), {}, {}, lost)}
    return BodyViewFrame(
        k, k / 30 if at_s is None else at_s, bodies, {"c1": EncodedPicture(b"%d" % k)} if pictures else {}
    )


def on_screen(look, points, aspect=1.4):
    """(n, 2) from −1 to 1 where in the picture of a camera points (n, 3) are."""
    z = look.target - look.position
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    local = (points - look.position) @ np.stack([x, np.cross(x, z), z], axis=1)
    return local[:, :2] / local[:, 2:] / np.tan(look.fov / 2) / [aspect, 1.0]


def vertices(view, aside_m):
    T = view._stage._space.T_stage_world
    return posed(MESH, pose_at(MESH, aside_m)) @ T[:3, :3].T + T[:3, 3]


@pytest.mark.parametrize("camera", ["", "c2"])
def test_on_a_telephone_all_is_over_the_sheet_that_covers_three_fifths(view, camera):
    aspect = 390 / 844
    look = view._stage.look(aspect, camera)
    planes = [plane.corners for name, plane in view._stage.planes.items() if camera in ("", name)]
    at = on_screen(look, np.concatenate(planes if camera else [*planes, vertices(view, 0.0)]), aspect)
    assert np.abs(at).max() < 1.0
    assert at[:, 1].min() > 1 - 2 * 0.4
    assert max(np.ptp(at[:, 0]) / 2.0, np.ptp(at[:, 1]) / 0.8) > 0.85  # and as large as may be


def test_names_of_cameras_are_not_before_a_picture_that_is_looked_at(view):
    def named():
        return [handle.visible for handle in view._stage._names._handles]

    view.show(1.0)
    assert named() == [True, True]
    view.panel.aim.value = "c1"
    view.show(2.0)
    assert named() == [False, False]
    view.panel.aim.value = ALL
    view.show(3.0)
    assert named() == [True, True]


@pytest.mark.parametrize("aside_m", [0.0, 4.0, -9.0])
def test_the_stages_camera_has_whoever_goes_aside_and_all_boards_in_its_picture(view, aside_m):
    before = view._stage.look(1.4)
    view.add(shown(0, aside_m))
    view.show(1.0)
    look = view._stage.look(1.4)
    at = on_screen(look, vertices(view, aside_m))
    assert np.abs(at).max() < 1.0
    boards = np.concatenate([plane.moved(view._stage.sight.middle).corners for plane in view._stage.planes.values()])
    assert np.abs(on_screen(look, boards)).max() < 1.0
    assert at[:, 1].max() < on_screen(look, boards)[:, 1].min() + 0.01  # no head before a picture
    if aside_m:
        assert np.abs(on_screen(before, vertices(view, aside_m))).max() > 1.0  # it would have gone
    np.testing.assert_allclose(view._stage._boards.position, view._stage.sight.middle, atol=1e-4)
    floor = view._stage._floor._placed
    assert np.abs(floor - view._stage.sight.middle).max() <= 0.5 + 1e-9
    np.testing.assert_array_equal(floor, np.round(floor))


def test_of_whom_nobody_is_there_is_not_gone_after(view):
    view.add(shown(0, 0.0))
    view.show(1.0)
    view.add(shown(1, 8.0, lost=True))
    view.show(50.0)
    np.testing.assert_array_equal(view._stage.sight.middle, 0.0)


def test_a_page_begins_where_the_bodies_are_looked_at_and_with_empty_boards(view):
    begin, home = view._server.initial_camera, view._stage.home
    np.testing.assert_allclose(begin.position, home.position)
    np.testing.assert_allclose(begin.look_at, home.target)
    names = set(view._server.scene._handle_from_node_name)
    assert {"/board/c1/empty", "/board/c2/empty"} <= names
    assert "Getting ready" in view.panel._status.content


class Client:
    """A browser: it says where its camera is when it is told to."""

    def __init__(self):
        self.pictures, self.frusta = [], {}
        self.camera = SimpleNamespace(
            image_width=1400, image_height=1000, fov=1.3, up_direction=None, position=np.full(3, 3.0), look_at=None,
            on_update=self._listen,
        )  # fmt: skip
        self.scene = SimpleNamespace(add_camera_frustum=self._add)

    def _listen(self, callback):
        self._callback = callback

    def _add(self, name, **_):
        self.frusta[name] = SimpleNamespace(visible=False)
        return self.frusta[name]

    def atomic(self):
        return nullcontext()

    def say(self, position=None):
        camera = SimpleNamespace(position=self.camera.position if position is None else position)
        asyncio.run(self._callback(camera))

    def picture(self, name="c1"):
        node = self.frusta.get(f"/board/{name}/picture")
        return node._image_data if node is not None and node.visible else None


def test_a_camera_goes_along_until_somebody_moves_it_and_again_when_the_view_is_reset(view):
    client = Client()
    browser = BodyBrowser(client, view._stage, 0.0)
    now_s, told = 0.0, deque()

    def go(aside_m, beats=90):
        nonlocal now_s
        view.add(shown(len(view.frames), aside_m))
        for _ in range(beats):
            now_s += 1 / 30
            view.show(now_s)
            browser.show("", {}, now_s)
            told.append(np.array(client.camera.position))
            if len(told) > 20:  # a slow browser tells where it was a while ago
                client.say(told.popleft())

    client.say(np.full(3, 3.0))  # where the library puts it first: nobody moved it
    go(0.0)
    begin = np.array(client.camera.position)
    np.testing.assert_allclose(begin, view._stage.look(1.4).position, atol=1e-3)
    go(5.0)
    assert np.abs(client.camera.position - begin).max() > 3.0
    assert not browser.touched
    told.clear()
    by_hand = client.camera.position - np.sign(client.camera.position - begin) * 0.03  # back on the way it came
    client.camera.position = by_hand
    client.say()
    go(-5.0)
    assert browser.touched
    np.testing.assert_array_equal(client.camera.position, by_hand)
    told.clear()
    client.say(view._stage.home.position)  # "Reset view"
    go(-5.0)
    np.testing.assert_allclose(client.camera.position, view._stage.look(1.4).position, atol=2e-3)
    assert not browser.touched
    client.camera.position = by_hand
    client.say()
    browser.show("", {}, now_s)
    assert browser.touched
    browser.show("c2", {}, now_s)  # somebody wants to look at a picture
    np.testing.assert_array_equal(client.camera.position, view._stage.look(1.4, "c2").position)


def test_the_first_pictures_stay_until_a_browser_has_had_time_for_them(view):
    client = Client()
    browser = BodyBrowser(client, view._stage, 0.0)
    first, second = EncodedPicture(b"first"), EncodedPicture(b"second")
    browser.show("", {}, 0.0)
    assert client.picture() is None
    browser.show("", {"c1": first}, 0.1)
    browser.show("", {"c1": second}, 0.2)
    assert client.picture() == b"first"
    client.say()
    browser.show("", {"c1": second}, 1.0)
    browser.show("", {"c1": second}, 1.0 + 0.9 * STILL_S)
    assert client.picture() == b"first"
    browser.show("", {"c1": second}, 1.0 + 1.1 * STILL_S)
    assert client.picture() == b"second"
    browser.show("", {}, 5.0)
    assert client.picture() is None
    silent = Client()
    browser = BodyBrowser(silent, view._stage, 0.0)
    for at_s, picture in ((0.0, first), (0.9 * LONGEST_STILL_S, second)):
        browser.show("", {"c1": picture}, at_s)
    assert silent.picture() == b"first"
    browser.show("", {"c1": second}, 1.1 * LONGEST_STILL_S)
    assert silent.picture() == b"second"


def test_a_camera_that_gave_no_picture_has_its_last_one_shown_while_that_is_new(view):
    view.add(shown(0, 0.0, at_s=0.0))
    view.add(shown(1, 0.0, pictures=False, at_s=0.4))
    assert view._pictures()["c1"].image == b"0"
    view.add(shown(2, 0.0, pictures=False, at_s=0.6))
    assert view._pictures() == {}
    view.place = 0
    assert view._pictures()["c1"].image == b"0"
