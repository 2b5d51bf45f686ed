"""What the camera goes along with: who moves stays in sight, and a browser's camera goes along until it is taken."""

from __future__ import annotations

import asyncio
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.fitted_scenes import body, scene, view
from support.silhouette_pictures import pose_at, ring, somebody

from mocapella.geometry.rigid import apply
from mocapella.model.images import image_frame
from mocapella.model.rigged_mesh import posed
from mocapella.viewer.boards import BoardNodes, ShownBoard
from mocapella.viewer.browser import look_along, look_at_picture, new_sight
from mocapella.viewer.browser_camera import BrowserCamera
from mocapella.viewer.framing import HEADROOM_M, SLACK_M, Framing
from mocapella.viewer.layout import Look
from mocapella.viewer.page import open_page
from mocapella.viewer.picture_plane import CameraPicture
from mocapella.viewer.room_bodies import body_space
from mocapella.viewer.stages import ROOM
from mocapella.viewer.timeline import LATEST_S, Moment
from mocapella.viewer.view_frame import Drawings
from mocapella.viewer.view_state import ViewMemory
from mocapella.viewer.viewer import Viewer

MESH, RIG = somebody(), ring(2)
SIZES = {name: placed.camera.size_px for name, placed in RIG.cameras.items()}
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
    sight = Framing(HALF, TALL)
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
    sight = Framing(HALF, TALL)
    sight.follow(*corners((0, 0, 0.4, 0.3, 1.8)), 0.0)
    sight.follow(*corners((x, z, 0.4, 0.3, high)), LATER)
    np.testing.assert_array_equal(sight.middle, 0.0)
    np.testing.assert_array_equal(sight.half_m, HALF)


@given(metres, metres, st.lists(st.floats(0.001, 0.5), min_size=1, max_size=8))
def test_how_fast_it_follows_does_not_depend_on_how_often_it_is_asked(x, z, steps):
    often, once = Framing(HALF, TALL), Framing(HALF, TALL)
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


def on_screen(look, points, aspect=1.4):
    """(n, 2) from −1 to 1 where in the picture of a camera points (n, 3) are."""
    z = look.target - look.position
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    local = (points - look.position) @ np.stack([x, np.cross(x, z), z], axis=1)
    return local[:, :2] / local[:, 2:] / np.tan(look.fov / 2) / [aspect, 1.0]


def at(aside_m=0.0, k=0, **changes):
    return scene(k, body(MESH, pose_at(MESH, aside_m), view("c1"), view("c2"), **changes))


class Stand:
    """A body, the boards over it, and what is looked at."""

    def __init__(self):
        self.known, self.now_s = ViewMemory(), 0.0
        frames = {name: image_frame(name, None, time_ns=0, size_px=size) for name, size in SIZES.items()}
        self.known.learn(at(), frames, None)
        self.space = self.known.ground.space
        self.sight = new_sight(self.space, None, free=True)
        self.drawings = Drawings(self.known)

    def go(self, aside_m, after_s=LATER, **changes):
        made = at(aside_m, 1, **changes)
        moment = Moment(0.0, made, {}, ROOM, made, self.known.seen, {})
        drawing, self.now_s = self.drawings.tracking(moment, "free"), self.now_s + after_s
        self.planes = list(self.drawings.boards(moment).planes.values())
        if drawing.extent is None:
            self.sight.rest(self.now_s)
        else:
            self.sight.follow(*drawing.extent, self.now_s)

    def vertices(self, aside_m):
        return apply(self.space.T_stage_world, posed(MESH, pose_at(MESH, aside_m)))


@pytest.fixture
def stand():
    made = Stand()
    made.go(0.0)
    return made


@pytest.mark.parametrize("aside_m", [0.0, 4.0, -9.0])
def test_whoever_goes_aside_and_all_boards_stay_in_the_cameras_picture(stand, aside_m):
    before = look_along(stand.sight, stand.planes, 1.4)
    stand.go(aside_m)
    look = look_along(stand.sight, stand.planes, 1.4)
    seen = on_screen(look, stand.vertices(aside_m))
    assert np.abs(seen).max() < 1.0
    boards = np.concatenate([plane.moved(stand.sight.middle).corners for plane in stand.planes])
    assert np.abs(on_screen(look, boards)).max() < 1.0
    assert seen[:, 1].max() < on_screen(look, boards)[:, 1].min() + 0.01  # no head before a picture
    if aside_m:
        assert np.abs(on_screen(before, stand.vertices(aside_m))).max() > 1.0  # it would have gone


@pytest.mark.parametrize("camera", [None, 1])
def test_on_a_phone_all_is_in_the_picture_and_as_large_as_may_be(stand, camera):
    aspect = 390 / 464
    if camera is None:
        look = look_along(stand.sight, stand.planes, aspect)
        points = [plane.moved(stand.sight.middle).corners for plane in stand.planes] + [stand.vertices(0.0)]
    else:
        look = look_at_picture(stand.sight, stand.planes[camera], aspect)
        points = [stand.planes[camera].moved(stand.sight.middle).corners]
    seen = on_screen(look, np.concatenate(points), aspect)
    assert np.abs(seen).max() < 1.0
    assert np.ptp(seen, axis=0).max() > 1.7


def test_of_whom_nobody_is_there_is_not_gone_after(stand):
    before = stand.sight.middle.copy()
    stand.go(8.0, lost=True)
    np.testing.assert_array_equal(stand.sight.middle, before)


def test_in_a_cameras_perspective_it_begins_where_the_body_is():
    low, high = np.array([1.0, 0.0, 5.0]), np.array([2.0, 1.8, 6.0])
    sight = new_sight(body_space(at().bodies), (low, high), free=False)
    np.testing.assert_allclose(sight.middle, [1.5, 0.0, 5.5])


class Client:
    """A browser: it says where its camera is when it is told to."""

    def __init__(self):
        self.camera = SimpleNamespace(
            image_width=1400, image_height=1000, fov=1.3, up_direction=None, position=np.full(3, 3.0), look_at=None,
            on_update=self._listen,
        )  # fmt: skip

    def _listen(self, callback):
        self._callback = callback

    def say(self, position=None):
        camera = SimpleNamespace(position=self.camera.position if position is None else position)
        asyncio.run(self._callback(camera))


@pytest.mark.slow
def test_a_camera_goes_along_until_somebody_moves_it_and_again_when_the_view_is_reset(stand):
    client, told = Client(), deque()
    camera = BrowserCamera(client)
    home = look_along(new_sight(stand.space, None, free=True), stand.planes, 1.4)
    camera.home = home.position

    def look():
        return look_along(stand.sight, stand.planes, 1.4)

    def go(aside_m, beats=90):
        for _ in range(beats):
            stand.go(aside_m, 1 / 30)
            camera.beat(stand.now_s)
            camera.follow(look())
            told.append(np.array(client.camera.position))
            if len(told) > 20:  # a slow browser tells where it was a while ago
                client.say(told.popleft())

    client.say(np.full(3, 3.0))  # where the library puts it first: nobody moved it
    go(0.0)
    begin = np.array(client.camera.position)
    np.testing.assert_allclose(begin, look().position, atol=1e-3)
    go(5.0)
    assert np.abs(client.camera.position - begin).max() > 3.0
    assert not camera.touched
    told.clear()
    by_hand = client.camera.position - np.sign(client.camera.position - begin) * 0.03  # back on the way it came
    client.camera.position = by_hand
    client.say()
    go(-5.0)
    assert camera.touched
    np.testing.assert_array_equal(client.camera.position, by_hand)
    told.clear()
    client.say(home.position)  # "Reset view"
    go(-5.0)
    np.testing.assert_allclose(client.camera.position, look().position, atol=2e-3)
    assert not camera.touched
    client.camera.position = by_hand
    client.say()
    camera.beat(stand.now_s)
    assert camera.touched
    picture = look_at_picture(stand.sight, stand.planes[1], 1.4)
    camera.put(picture)  # somebody wants to look at a picture
    np.testing.assert_array_equal(client.camera.position, picture.position)
    assert not camera.touched


def test_a_camera_that_stands_still_is_touched_when_it_is_elsewhere_for_long():
    client = Client()
    camera = BrowserCamera(client)
    camera.put(Look(np.array([0.0, 1.0, -5.0]), np.zeros(3), 0.6))
    client.camera.position = np.array([1.0, 1.0, -5.0])
    camera.beat(0.0)
    assert not camera.touched  # it may be from before
    for _ in range(40):
        camera.beat(0.0)
    assert camera.touched


@pytest.fixture
def page():
    server = open_page("127.0.0.1", 0, 340)
    yield server
    server.stop()


def shown_image(nodes, name="c1"):
    handle = nodes._nodes[name]._picture._handle
    return handle._image_data if handle is not None and handle.visible else None


def test_boards_are_there_at_once_and_a_first_picture_stays_until_there_is_time_for_another(page, stand):
    nodes = BoardNodes(page.scene)
    planes = dict(zip(SIZES, stand.planes, strict=True))

    def draw(image, *, new_pictures):
        picture = None if image is None else CameraPicture(image, SIZES["c1"])
        boards = {name: ShownBoard(name, picture if name == "c1" else None, None) for name in planes}
        nodes.draw(planes, boards, new_pictures=new_pictures)

    draw(None, new_pictures=False)
    assert {"/board/c1/empty", "/board/c2/empty"} <= set(page.scene._handle_from_node_name)
    draw(b"first", new_pictures=False)
    assert shown_image(nodes) == b"first"
    draw(b"second", new_pictures=False)
    assert shown_image(nodes) == b"first"
    draw(b"third", new_pictures=True)
    assert shown_image(nodes) == b"third"
    draw(None, new_pictures=True)
    assert shown_image(nodes) is None
    nodes.place(np.array([1.0, 0.0, 2.0]))
    np.testing.assert_array_equal(nodes._root.position, [1.0, 0.0, 2.0])


def test_a_page_of_a_run_begins_where_the_bodies_are_looked_at_and_keeps_a_cameras_last_picture_a_while():
    viewer = Viewer("127.0.0.1", 0, command=None)
    try:
        frames = {name: image_frame(name, None, time_ns=0, size_px=size) for name, size in SIZES.items()}
        for at_s, given in (
            (0.0, {"c1": CameraPicture(b"0", SIZES["c1"])}),
            (0.8 * LATEST_S, {}),
            (1.2 * LATEST_S, {}),
        ):
            made = scene(round(30 * at_s), *at().bodies, at_s=at_s)
            viewer.show(made, frames, None, pictures=given)
        assert [list(viewer.timeline[k].pictures) for k in range(3)] == [["c1"], ["c1"], []]
        look = viewer._look_home(viewer._moment)
        np.testing.assert_allclose(viewer._server.initial_camera.position, look.position)
        np.testing.assert_allclose(viewer._server.initial_camera.look_at, look.target)
    finally:
        viewer.close()
