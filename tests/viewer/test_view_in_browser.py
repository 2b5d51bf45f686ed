"""The view in a real browser: every control pressed, colours found on the canvas, two browsers that agree."""

from __future__ import annotations

import base64
import colorsys
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from browser import FLAGS
from stand_in import StandIn
from walkers import Room, in_picture

from mocapella.model.session import RecordingHealth, SensorPose, Setup
from mocapella.viewer.layout import Look
from mocapella.viewer.palette import SENSORS, person_colour
from mocapella.viewer.perspective import Floors, Perspectives
from mocapella.viewer.stages import tracking_drawing

CHROMIUM = shutil.which("chromium")
ARTIFACTS = Path(__file__).resolve().parents[2] / "artifacts"
WAIT_MS = 45_000

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH"),
    # viser warns when something is shown to a browser in the instant in which it leaves; nothing is lost by it.
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning"),
]


class Tab:
    """One browser's page, in a user's words."""

    def __init__(self, page, url):
        self.page = page
        page.set_default_timeout(WAIT_MS)
        page.goto(url)
        page.wait_for_selector(".mocapella-status")

    def button(self, name):
        return self.page.get_by_role("button", name=name, exact=True)

    def field(self, label):
        return (
            self.page.locator("label", has_text=label)
            .first.locator("xpath=../../..")
            .locator("input:not([type=hidden])")
        )

    def choose(self, label, option):
        self.field(label).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def type(self, label, text, place=0):
        self.field(label).nth(place).fill(text)

    def expect(self, text):
        self.page.get_by_text(text).locator("visible=true").first.wait_for()

    def expect_enabled(self, name, enabled=True):
        """Wait until the button can be pressed, or cannot."""
        selector = "button:not([disabled])" if enabled else "button[disabled]"
        self.page.locator(selector).filter(has_text=re.compile(rf"^\s*{name}\s*$")).first.wait_for()

    def pixels(self):
        """(height, width, 3) of the page as it is on the screen, decoded by the browser itself."""
        shot = base64.b64encode(self.page.screenshot()).decode()
        raw, width, height = self.page.evaluate(
            """async (shot) => {
                const image = new Image();
                image.src = "data:image/png;base64," + shot;
                await image.decode();
                const canvas = new OffscreenCanvas(image.width, image.height);
                const context = canvas.getContext("2d");
                context.drawImage(image, 0, 0);
                const data = context.getImageData(0, 0, image.width, image.height).data;
                let text = "";
                for (let i = 0; i < data.length; i += 32768)
                    text += String.fromCharCode(...data.subarray(i, i + 32768));
                return [btoa(text), image.width, image.height];
            }""",
            shot,
        )
        return np.frombuffer(base64.b64decode(raw), np.uint8).reshape(height, width, 4)[..., :3]


@pytest.fixture(scope="module")
def server():
    stand_in = StandIn(Room(people=2, sensors=3, first_id=2))
    yield stand_in
    stand_in.close()


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            args=FLAGS,
            viewport={"width": 1100, "height": 640},
        )
        yield context
        context.close()


@pytest.fixture(scope="module")
def tab(server, chromium):
    return Tab(chromium.pages[0], server.viewer.url)


@pytest.fixture(scope="module")
def tabs(server, chromium, tab):
    """Two browsers; the second is opened late and small, because it draws in software like the first."""
    page = chromium.new_page()
    page.set_viewport_size({"width": 960, "height": 320})
    return tab, Tab(page, server.viewer.url)


@pytest.fixture(autouse=True)
def fresh(server):
    """Each test begins with the same session, stopped, three sensors, nothing recorded."""
    server.answers, server.empty = True, False
    server.change(running=False, phase="stopped", setup=Setup(sensors_expected=3), recording=RecordingHealth())
    server.change(frames_remaining=0, reason="")
    server.commands.clear()


def of_hue(pixels, colour):
    """How many pixels are of that colour, however it is lit."""
    shades, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
    vivid = np.ptp(shades.astype(int), axis=1) > 0.45 * shades.max(axis=1)
    shades, counts = shades[vivid & (shades.max(axis=1) > 90)], counts[vivid & (shades.max(axis=1) > 90)]
    hue = np.array([colorsys.rgb_to_hsv(*shade)[0] for shade in shades / 255])
    wanted = colorsys.rgb_to_hsv(*(channel / 255 for channel in colour))[0]
    return int(counts[np.abs((hue - wanted + 0.5) % 1 - 0.5) < 0.03].sum())


def canvas(pixels):
    """The part of the page in which nothing but the 3D scene is."""
    return pixels[:420, :740]


def test_the_canvas_shows_people_in_their_colours_sensors_in_theirs_and_the_fused_skeleton_white(server, tab):
    server.change(running=True, phase="tracking")
    tab.expect("Tracking")
    tab.button("Both").click()
    tab.page.locator(".mantine-Notification-closeButton").first.click()  # the note that the browser draws in software
    shot = settled(tab, lambda pixels: heads(server, pixels).min() > 150)
    picture = canvas(shot)
    ARTIFACTS.mkdir(exist_ok=True)
    tab.page.screenshot(path=ARTIFACTS / "view-test.png")
    server.empty = True
    nobody = settled(tab, lambda pixels: heads(server, pixels).max() < 80)
    empty = canvas(nobody)
    assert picture.astype(float).var() > 50
    for colour in (person_colour(2), person_colour(3)):
        assert of_hue(empty, colour) < 20
        assert of_hue(picture, colour) > 100
    came = np.abs(picture.astype(int) - empty).max(axis=-1) > 40
    for colour in SENSORS[:3]:
        assert of_hue(picture[came], colour) > 60
    white = heads(server, shot)
    assert len(white) == 2
    assert white.min() > 150
    assert np.ptp(white, axis=1).max() < 25
    assert heads(server, nobody).max() < 80


def settled(tab, as_wanted, tries=8):
    """The page's pixels as soon as they are as wanted, or the last that were tried."""
    for _ in range(tries):
        pixels = tab.pixels()
        if as_wanted(pixels):
            break
        tab.page.wait_for_timeout(500)
    return pixels


def heads(server, pixels):
    """(people, 3), the mean colour of the page where the fused heads are, seen from the first browser's camera."""
    seen, floors = Perspectives(), Floors()
    seen.learn(server.scene)
    floors.learn_frame(server.frames["front"])
    joints = tracking_drawing(server.scene, "front", seen, floors).joints
    centres = joints.positions[joints.scales[:, 0] > 0.9 * joints.scales[:, 0].max()]
    camera = min(server.viewer._server.get_clients().items())[1].camera
    look, size = Look(camera.position, camera.look_at, camera.fov), (camera.image_width, camera.image_height)
    places = (in_picture(look, centres, size[0] / size[1]) * [1, -1] + 1) / 2 * size
    return np.array([pixels[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3].mean(axis=(0, 1)) for x, y in places])


def test_every_control_sends_its_command(server, tab):
    tab.expect("Stopped")
    for name, enabled in (("Start", True), ("Stop", False), ("Recalibrate", False), ("Stop recording", False)):
        assert tab.button(name).is_enabled() == enabled
    tab.button("Start").click()
    tab.expect_enabled("Recalibrate")
    assert not tab.button("Start").is_enabled()
    tab.button("Recalibrate").click()
    tab.expect("30 of 120 frames to go: stand still · asked for")
    tab.page.locator("[role=progressbar]").first.wait_for()
    tab.button("Stop").click()
    tab.expect("Stopped")
    tab.type("Take", "walk-1")
    tab.page.wait_for_timeout(300)
    tab.button("Record").click()
    tab.expect("walk-1.mcap")
    tab.expect_enabled("Stop recording")
    assert not tab.button("Record").is_enabled()
    tab.button("Stop recording").click()
    tab.expect_enabled("Record")
    assert tab.field("Take").input_value() == "walk-2"
    verbs = [("start", {}), ("recalibrate", {}), ("stop", {}), ("record", {"name": "walk-1"}), ("record-stop", {})]
    assert server.commands == verbs


def test_the_setup_form_sends_what_was_typed(server, tab):
    open_setup(tab)
    assert not tab.button("Apply setup").is_enabled()
    tab.type("Participant", "7")
    tab.choose("Placement", "right-45")
    tab.choose("Scenario", "walk")
    tab.type("left °, m", "1.4", place=1)
    tab.field("left °, m").nth(1).blur()
    tab.expect_enabled("Apply setup")
    tab.button("Apply setup").click()
    tab.expect_enabled("Apply setup", enabled=False)
    assert [verb for verb, _ in server.commands] == ["setup"]
    wanted = Setup("stand-still", 3, 7, "right-45", "walk", {"left": SensorPose(0.0, 1.4)})
    assert server.status.setup == wanted
    server.answers = False
    tab.page.locator("label", has_text="Participant").locator("xpath=../../..").locator("input[disabled]").wait_for()


def test_edits_that_are_not_applied_stay_when_the_server_changes_and_go_when_reverted(server, tab):
    open_setup(tab)
    tab.type("Participant", "12")
    tab.expect_enabled("Revert edits")
    server.change(setup=Setup(sensors_expected=5))
    tab.page.wait_for_function("[...document.querySelectorAll('input')].some(input => input.value === '5')")
    assert tab.field("Participant").input_value() == "12"
    tab.button("Revert edits").click()
    tab.expect_enabled("Revert edits", enabled=False)
    assert tab.field("Participant").input_value() == ""


def test_a_participant_that_is_no_number_is_refused_in_the_page(server, tab):
    open_setup(tab)
    tab.type("Participant", "Ada")
    tab.expect_enabled("Apply setup")
    tab.button("Apply setup").click()
    tab.expect("participant is 'Ada'; it must be a whole number, or empty")
    tab.button("Revert edits").click()
    assert server.commands == []


def test_a_slow_server_does_not_hold_up_the_view(server, tab):
    server.gate.clear()
    tab.button("Start").click()
    server.change(reason="still drawing")
    tab.expect("still drawing")
    assert server.status.running is False
    server.gate.set()
    tab.expect_enabled("Stop")


def test_without_a_server_all_is_disabled(server, tab):
    server.answers = False
    tab.expect("No server")
    for name in ("Start", "Stop", "Recalibrate", "Record", "Stop recording"):
        assert not tab.button(name).is_enabled()


def test_a_sensor_called_script_is_harmless(server, tab):
    before = server.status.sensors
    nasty = "<img src=x onerror='window.hurt=1'>"
    server.change(sensors=(*before, before[0].__class__(**{**vars(before[0]), "name": nasty, "problem": nasty})))
    tab.page.locator(".mocapella-sensors").get_by_text(nasty).first.wait_for()
    assert tab.page.evaluate("window.hurt") is None
    server.change(sensors=before)


def open_setup(tab):
    """The folder is closed at first."""
    if not tab.page.get_by_text("Participant").first.is_visible():
        tab.page.get_by_text("Setup", exact=True).first.click()
        tab.page.get_by_text("Participant").first.wait_for()


def test_two_browsers_with_opposite_commands_both_show_the_final_state(server, tabs):
    first, second = tabs
    first.page.bring_to_front()
    first.button("Start").click()
    second.expect_enabled("Stop")
    second.button("Stop").click()
    first.expect_enabled("Start")
    server.gate.clear()
    first.button("Start").click()
    first.page.wait_for_timeout(200)
    server.gate.set()
    second.expect_enabled("Stop")
    for tab in tabs:
        tab.expect("Tracking")
        assert not tab.button("Start").is_enabled()
    assert [verb for verb, _ in server.commands] == ["start", "stop", "start"]


def test_a_refused_command_is_explained_in_the_browser_that_gave_it(server, tabs):
    first, second = tabs
    first.page.bring_to_front()
    first.type("Take", "taken")
    first.page.wait_for_timeout(300)
    first.button("Record").click()
    first.expect("taken is taken; take another name")
    assert second.page.get_by_text("taken is taken").count() == 0


def cameras(server):
    """(browsers, 3), where their cameras are."""
    return np.array([client.camera.position for _, client in sorted(server.viewer._server.get_clients().items())])


def test_a_perspective_moves_the_camera_of_its_own_browser_to_the_sensor(server, tabs):
    first, _ = tabs
    first.page.bring_to_front()
    before = cameras(server)
    first.choose("Perspective", "left")
    wanted = [0.0, server.frames["left"].height, 0.0]
    for _ in range(40):
        first.page.wait_for_timeout(100)
        if np.allclose(cameras(server)[0], wanted, atol=1e-2):
            break
    assert cameras(server)[0] == pytest.approx(wanted, abs=1e-2)
    assert cameras(server)[1] == pytest.approx(before[1])
    for aim in ("Tracking", "Sensors", "Sensor's eyes"):
        first.button(aim).click()
    first.choose("Perspective", "free")
    for _ in range(40):
        first.page.wait_for_timeout(100)
        if cameras(server)[0, 2] < -1:
            break
    assert cameras(server)[0, 2] < -1
