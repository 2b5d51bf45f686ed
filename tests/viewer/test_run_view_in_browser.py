"""Fitted bodies in a real browser: mesh, pictures, curves, and frames that are chosen; of a run, and of a session."""

from __future__ import annotations

import itertools
import shutil
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.browser import COARSE, FEW_FRAMES, FLAGS
from support.fitted_scenes import body, left_out, scene, view
from support.silhouette_pictures import Room, pose_at, ring, silhouettes_of, somebody
from support.walkers import health, status

from mocapella.live.silhouette_run import SilhouetteRun
from mocapella.live.silhouette_view import SilhouetteView
from mocapella.model.images import image_frame
from mocapella.model.session import CommandReply, Setup
from mocapella.recording.bodies_file import ALONE
from mocapella.sensing.outline_lines import border_lines
from mocapella.sensing.outline_picture import jpeg
from mocapella.sources.frame_set import FrameSet
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouettes import SilhouettesTracker
from mocapella.viewer import Viewer
from mocapella.viewer.picture_plane import CameraPicture
from mocapella.wire.questions import NodeAnswer

CHROMIUM = shutil.which("chromium")
ARTIFACTS = Path(__file__).resolve().parents[2] / "artifacts"
WAIT_MS = 45_000

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH"),
    # viser warns when something is shown to a browser in the instant in which it leaves; nothing is lost by it.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning"),
]


def of_hue(pixels, low, high):
    """How many pixels (…, 3) BGR are vivid and of a hue between [°]."""
    hsv = cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV)
    hue = hsv[..., 0].astype(int) * 2
    return int(np.count_nonzero((hsv[..., 1] > 130) & (hsv[..., 2] > 120) & (hue >= low) & (hue <= high)))


def picture_of(page):
    """(height, width, 3) BGR of what the page shows of the scene."""
    return cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)[:, :700]


def body_columns(shot):
    """(n,) columns of the pixels below the boards that are of the body."""
    low = shot[330:]
    grey = np.ptp(low.astype(int), axis=-1) < 40
    return np.nonzero(grey & (low.mean(axis=-1) > 110))[1]


def coat(shot):
    """How many pixels are of the red coat of who is in the pictures."""
    return of_hue(shot, 330, 360) + of_hue(shot, 0, 15)


def wait_for(page, what, holds):
    deadline = time.monotonic() + WAIT_MS / 1000
    while not holds():
        if time.monotonic() > deadline:
            page.screenshot(path=ARTIFACTS / "never.png")
            raise AssertionError(what)
        page.wait_for_timeout(200)


@pytest.mark.slow
def test_a_page_shows_boards_at_once_and_no_white_ones_and_stays_with_who_goes_aside_until_it_is_moved_by_hand():
    sync_api = pytest.importorskip("playwright.sync_api")
    mesh, rig = somebody(), ring(3)
    run = SilhouetteRun(SilhouettesTracker({ALONE: InitialBody(mesh, pose_at(mesh))}, rig))
    page_of_run, stop = SilhouetteView("127.0.0.1", 0, run), threading.Event()
    viewer, size = page_of_run.viewer, rig.cameras["c1"].camera.size_px
    images = Room(rig).images(mesh, pose_at(mesh))
    pictures = {name: CameraPicture(jpeg(image), size) for name, image in images.items()}
    seen = (view("c1"), *(left_out(name, "") for name in ("c2", "c3")))
    busy, places, shown = threading.Event(), [0.0], dict(pictures)

    def loop():
        for k in itertools.count():
            if stop.wait(1 / 10):
                return
            if not busy.is_set():
                page_of_run.beat()
                continue
            made = scene(k, body(mesh, pose_at(mesh, places[-1]), *seen), at_s=k / 10)
            # No two pictures are the same: a browser that is still at one is given the next.
            given = {name: CameraPicture(one.image, size) for name, one in shown.items()}
            viewer.show(made, {}, None, pictures=given)

    ARTIFACTS.mkdir(exist_ok=True)
    thread = threading.Thread(target=loop)
    thread.start()
    try:
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            page = browser.new_page(viewport={"width": 1100, "height": 640})
            page.set_default_timeout(WAIT_MS)
            page.add_init_script(FEW_FRAMES)
            page.goto(page_of_run.url + COARSE)
            page.locator(".mocapella-status", has_text="Getting ready").wait_for()

            def white(one):
                """How many pixels of the boards' part of a page are white; a few are of letters."""
                return np.count_nonzero((picture_of(one)[115:225] > 235).all(axis=-1))

            wait_for(page, "the body stands there", lambda: len(body_columns(picture_of(page))) > 1500)
            page.screenshot(path=ARTIFACTS / "followed-body-empty.png")
            assert white(page) < 300
            # In the middle of the run, and of a browser that is too busy to decode any picture.
            shown.update(dict.fromkeys(pictures, CameraPicture(b"never decoded", size)))
            busy.set()
            other = browser.new_page(viewport={"width": 1100, "height": 640})
            other.set_default_timeout(WAIT_MS)
            other.add_init_script(FEW_FRAMES)
            other.goto(page_of_run.url + COARSE)
            other.locator(".mocapella-status", has_text="Following").wait_for()
            wait_for(other, "the body stands there", lambda: len(body_columns(picture_of(other))) > 1500)
            assert white(other) < 300
            shown.update(pictures)
            for one in (page, other):
                wait_for(one, "pictures", lambda one=one: coat(picture_of(one)) > 300)
            other.close()
            middle = np.median(body_columns(picture_of(page)))
            assert abs(middle - 370) < 60
            places.append(4.0)  # 4 m are more than the page has to either side
            page.wait_for_timeout(3000)
            wait_for(page, "it is still in sight", lambda: len(body_columns(picture_of(page))) > 1500)
            assert abs(np.median(body_columns(picture_of(page))) - 370) < 150
            page.screenshot(path=ARTIFACTS / "followed-body-aside.png")
            (one,) = viewer._browsers.values()
            page.mouse.move(350, 400)
            page.mouse.down()
            for k in range(20):
                page.mouse.move(350 + 10 * k, 400)
            page.mouse.up()
            wait_for(page, "it is noticed", lambda: one.camera.touched)
            page.wait_for_timeout(1000)
            by_hand = np.array(one.client.camera.position)
            places.append(0.0)
            page.wait_for_timeout(2000)
            np.testing.assert_allclose(one.client.camera.position, by_hand, atol=1e-3)
            assert one.camera.touched
            page.locator("svg.tabler-icon-adjustments").locator("xpath=..").click()
            page.get_by_role("button", name="Reset View").click()
            wait_for(page, "it goes along again", lambda: not one.camera.touched)
            browser.close()
    finally:
        stop.set()
        thread.join()
        page_of_run.close()


@pytest.mark.slow
def test_a_body_its_pictures_and_its_angles_are_seen_and_frames_can_be_chosen(tmp_path):
    sync_api = pytest.importorskip("playwright.sync_api")
    mesh, rig = somebody(), ring(2)
    run, room = SilhouetteRun(SilhouettesTracker({ALONE: InitialBody(mesh, pose_at(mesh))}, rig)), Room(rig)
    page_of_run, stop = SilhouetteView("127.0.0.1", 0, run), threading.Event()
    loop = threading.Thread(target=lambda: page_of_run.stay(stop))
    try:
        for k in range(12):
            images = room.images(mesh, pose_at(mesh, 0.01 * k, 0.4 + 0.1 * k))
            page_of_run.tell(run.step(FrameSet.at_rate(k, 30.0, images)))
        loop.start()
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            page = browser.new_page(viewport={"width": 1100, "height": 640})
            page.set_default_timeout(WAIT_MS)
            page.add_init_script(FEW_FRAMES)
            page.goto(page_of_run.url + COARSE)
            page.locator(".mocapella-status", has_text="End").wait_for()
            page.locator(".mocapella-timeline", has_text="12 of 12").wait_for()
            page.locator(".mocapella-overlaps", has_text="c2").wait_for()
            page.locator(".mocapella-legend", has_text="outside").wait_for()
            page.locator(".uplot").first.wait_for()
            deadline = time.monotonic() + WAIT_MS / 1000
            while True:
                shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)[:, :700]
                red_coat = coat(shot)
                outlines = of_hue(shot, 100, 140)
                grey = np.ptp(shot.astype(int), axis=-1) < 30
                body = int(np.count_nonzero(grey & (shot.mean(axis=-1) > 110)))
                if min(red_coat / 300, outlines / 60, body / 1500) > 1:
                    break
                assert time.monotonic() < deadline, f"coat {red_coat}, outlines {outlines}, body {body} pixels"
                page.wait_for_timeout(200)
            ARTIFACTS.mkdir(exist_ok=True)
            page.screenshot(path=ARTIFACTS / "followed-body.png")
            page.locator("label", has_text="Frame").locator("xpath=../../..").locator("input:not([type=hidden])").fill(
                "4"
            )
            page.keyboard.press("Enter")
            page.locator(".mocapella-status", has_text="Paused").wait_for()
            page.locator(".mocapella-timeline", has_text="5 of 12").wait_for()
            page.get_by_role("button", name="Play", exact=True).click()
            page.locator(".mocapella-status", has_text="End").wait_for()
            browser.close()
    finally:
        stop.set()
        if loop.ident is not None:
            loop.join()
        page_of_run.close()


@pytest.mark.slow
def test_a_session_shows_bodies_and_asks_for_the_pictures_that_are_shown_and_can_be_looked_at_later():
    sync_api = pytest.importorskip("playwright.sync_api")
    mesh, rig = somebody(), ring(2)
    size, lines = rig.cameras["c1"].camera.size_px, {}
    for name, one in silhouettes_of(mesh, rig, pose_at(mesh)).items():
        lines[name] = border_lines(one)
    images = {name: jpeg(image) for name, image in Room(rig).images(mesh, pose_at(mesh)).items()}
    asked, stop, places = [], threading.Event(), [0.0]

    def ask(camera, question, timeout_s):
        asked.append((camera, question["ask"]))
        if question["ask"] == "report":
            return NodeAnswer(True, report={})
        return NodeAnswer(True, time_ns=1, size_px=size, image=images[camera], format="jpeg", names=[])

    sensors = tuple(health(name, sends="images", pictures=True, bodies=0) for name in rig.cameras)
    setup = Setup(method="silhouettes", sensors_expected=2)
    now = status(sensors=sensors, setup=setup, counts={"bodies": 1})
    viewer = Viewer("127.0.0.1", 0, command=lambda verb, arguments: CommandReply(True), ask=ask)
    frames = {name: image_frame(name, None, time_ns=1, size_px=size) for name in rig.cameras}

    def loop():
        for k in itertools.count():
            if stop.wait(1 / 10):
                return
            views = [view(name, outline_px=line, contour_px=line) for name, line in lines.items()]
            viewer.show(scene(k, body(mesh, pose_at(mesh, places[-1]), *views, name="anna")), frames, now)

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        time.sleep(0.5)
        assert asked == []  # nobody looks
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            page = browser.new_page(viewport={"width": 1100, "height": 640})
            page.set_default_timeout(WAIT_MS)
            page.add_init_script(FEW_FRAMES)
            page.goto(viewer.url + COARSE)
            page.locator(".mocapella-status", has_text="Tracking").wait_for()
            page.locator(".mocapella-overlaps", has_text="c2").wait_for()
            for what, holds in (
                ("pictures", lambda: coat(picture_of(page)) > 200),
                ("the model's outline", lambda: of_hue(picture_of(page), 100, 150) > 60),
                ("the body", lambda: len(body_columns(picture_of(page))) > 1500),
            ):
                wait_for(page, what, holds)
            ARTIFACTS.mkdir(exist_ok=True)
            page.screenshot(path=ARTIFACTS / "session-bodies.png")
            assert {camera for camera, kind in asked if kind == "picture"} == set(rig.cameras)
            (one,) = viewer._browsers.values()
            page.get_by_role("button", name="Pause", exact=True).click()
            wait_for(page, "it is paused", lambda: one.playhead.number is not None)
            stopped = one.playhead.shown
            page.locator(".mocapella-timeline", has_text="Paused").wait_for()
            places.append(2.0)
            wait_for(page, "time goes on", lambda: viewer.timeline.last > stopped + 20)
            assert one.playhead.shown == stopped
            wait_for(page, "its pictures stay", lambda: coat(picture_of(page)) > 200)
            before = len(asked)
            page.wait_for_timeout(1500)
            assert [kind for _, kind in asked[before + 2 :] if kind == "picture"] == []  # nobody looks at now
            page.get_by_role("button", name="Newest", exact=True).click()
            wait_for(page, "it follows", lambda: one.live)
            browser.close()
    finally:
        stop.set()
        thread.join()
        viewer.close()
