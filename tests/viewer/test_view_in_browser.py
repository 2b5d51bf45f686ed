"""The view in a real browser: every control pressed, colours found on the canvas, two browsers that agree."""

from __future__ import annotations

import colorsys
import dataclasses
import re
import shutil
import time
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from support.browser import DRAW_NOTHING, FLAGS
from support.drawings import tracking_drawing
from support.stand_in_server import StandIn
from support.unsure_scene import MOVED, WALK, placed
from support.walkers import HEIGHT_M, KINECT, Room, in_picture

from mocapella.geometry.rigid import apply
from mocapella.model.part_types import PART_TYPES, PartType
from mocapella.model.session import RecordingHealth, SensorPose, Setup
from mocapella.viewer.gui_guard import may_change
from mocapella.viewer.layout import SENSORS_SCALE, Look, lane_origins
from mocapella.viewer.palette import SENSORS, person_colour
from mocapella.viewer.panel import Aim
from mocapella.viewer.perspective import Floors, Perspectives
from mocapella.viewer.room_people import HEAD_RADIUS_M
from mocapella.viewer.setup_form import PoseField, SetupFields
from mocapella.viewer.setup_panel import HEIGHT_LABEL, TILT_LABEL

CHROMIUM = shutil.which("chromium")
LEFT = 1
"""Place of the sensor ``left`` among those of the room, by name."""
ARTIFACTS = Path(__file__).resolve().parents[2] / "artifacts"
WAIT_MS = 120_000
LARGE, SMALL = {"width": 1100, "height": 640}, {"width": 640, "height": 480}
"""Of a page that is looked at, and of one that is not: it is drawn in software."""

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

    def field(self, label, place=0):
        """The input with that label; with ``place``, one of several of it."""
        row = self.page.locator("label", has_text=label).nth(place).locator("xpath=../../..")
        return row.locator("input:not([type=hidden])")

    def choose(self, label, option):
        self.field(label).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def type(self, label, text):
        self.field(label).fill(text)

    def expect(self, text):
        self.page.get_by_text(text).locator("visible=true").first.wait_for()

    def expect_state(self, state):
        """Wait until the headline says it."""
        self.page.locator(".mocapella-status", has_text=state).wait_for()

    def expect_value(self, label, value):
        """Wait until the field holds it."""
        until(self, lambda: self.field(label).input_value() == value, f"{label} is {value}")

    def expect_enabled(self, name, enabled=True):
        """Wait until the button can be pressed, or cannot."""
        selector = "button:not([disabled])" if enabled else "button[disabled]"
        self.page.locator(selector).filter(has_text=re.compile(rf"^\s*{name}\s*$")).first.wait_for()

    def pixels(self):
        """(height, width, 3) of the page as it is on the screen."""
        shot = np.frombuffer(self.page.screenshot(), np.uint8)
        return cv2.imdecode(shot, cv2.IMREAD_COLOR)[..., ::-1]


def until(tab, holds, what):
    """Wait until it holds; the page goes on meanwhile."""
    deadline = time.monotonic() + WAIT_MS / 1000
    while not holds():
        assert time.monotonic() < deadline, f"waited {WAIT_MS / 1000:g} s until {what}"
        tab.page.wait_for_timeout(50)


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
            viewport=LARGE,
        )
        yield context
        context.close()


@pytest.fixture(scope="module")
def tab(server, chromium):
    return Tab(chromium.pages[0], server.viewer.url)


@pytest.fixture(scope="module")
def tabs(server, chromium, tab):
    """Two browsers; the second is opened late, because it draws in software like the first."""
    page = chromium.new_page()
    page.add_init_script(DRAW_NOTHING)
    page.set_viewport_size(SMALL)
    return tab, Tab(page, server.viewer.url)


@pytest.fixture(autouse=True)
def fresh(server):
    """Each test begins with the same session, stopped, three sensors, nothing recorded; none has a message refused."""
    server.answers, server.empty = True, False
    server.held.clear()
    server.change(running=False, phase="stopped", setup=Setup(sensors_expected=3), recording=RecordingHealth())
    server.change(frames_remaining=0, reason="", next_take="")
    server.commands.clear()
    server.names.clear()
    server.scene = server.room.scene(1.0, server.frames)
    yield
    refused = server.viewer._server.refusals
    assert not {"message", "messages"} & refused._counts.keys(), refused.lines


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
    if tab.page.viewport_size != LARGE:  # it is run again
        tab.page.set_viewport_size(LARGE)
        tab.page.reload()
    server.change(running=True, phase="tracking")
    tab.expect_state("Tracking")
    tab.button("Both").click()

    def all_there(pixels):
        whites = heads(server, pixels)
        return figures(server, pixels).min() > 0.5 and np.ptp(whites, axis=1).max() < 25

    shown = settled(tab, all_there)
    keep_picture(tab, "view-test.png")
    server.empty = True

    def nobody_there(pixels):
        came = np.abs(canvas(shown).astype(int) - canvas(pixels)).max(axis=-1) > 40
        colours = [of_hue(canvas(shown)[came], colour) for colour in SENSORS[:3]]
        return figures(server, pixels).max() < 0.05 and min(colours) > 60

    empty = settled(tab, nobody_there)
    tab.page.set_viewport_size(SMALL)  # the tests below look at no pixels
    tab.page.evaluate(DRAW_NOTHING)
    assert canvas(shown).astype(float).var() > 50
    for colour in (person_colour(2), person_colour(3)):
        assert of_hue(canvas(shown), colour) > 100
        assert of_hue(canvas(empty), colour) < 20
    assert heads(server, shown).shape == (2, 3)


def settled(tab, as_wanted):
    """The page's pixels as soon as they are as wanted; fails where they never are.

    The stages reach a browser in messages of their own, in no order, so a picture can hold one stage of before and
    one of after: ``as_wanted`` has to look at all that the test then asserts of.
    """
    shots = []
    # The note that the browser draws in software; the page shows it late, and only if the browser names its renderer.
    note = tab.page.locator(".mantine-Notification-closeButton")

    def wanted():
        if note.count():
            note.first.click()
        shots[:] = [tab.pixels()]
        return as_wanted(shots[0])

    try:
        until(tab, wanted, "the picture is as wanted")
    except AssertionError:
        keep_picture(tab, "view-not-as-wanted.png")
        raise
    return shots[0]


def keep_picture(tab, name):
    ARTIFACTS.mkdir(exist_ok=True)
    tab.page.screenshot(path=ARTIFACTS / name)


def figures(server, pixels):
    """How much each thing is there, 0 to 1: both fused heads, both people's colours, the skeletons in each lane."""
    fused = (heads(server, pixels).min(axis=-1) - 60) / 120
    people = [of_hue(canvas(pixels), person_colour(person)) / 400 for person in (2, 3)]
    lanes = []
    for sensor, points in lane_points(server).items():
        around = [pixels[y - 4 : y + 5, x - 4 : x + 5].reshape(-1, 3) for x, y in on_page(server, points)]
        lanes.append(sum(of_hue(part, SENSORS[server.room.names.index(sensor)]) > 4 for part in around) / len(around))
    return np.clip([*fused, *people, *lanes], 0, 1)


def heads(server, pixels):
    """(people, 3), the mean colour of the fused heads' tops on the page, from the first browser's camera."""
    seen, floors = Perspectives(), Floors()
    seen.learn(server.scene)
    floors.learn_frame(server.frames["front"])
    joints = tracking_drawing(server.scene, "front", seen, floors).joints
    centres = joints.positions[joints.scales[:, 0] > 0.9 * joints.scales[:, 0].max()]
    tops = centres + np.array([0.0, 0.65 * HEAD_RADIUS_M, 0.0])  # over the eyes
    return np.array([pixels[y - 1 : y + 2, x - 2 : x + 3].mean(axis=(0, 1)) for x, y in on_page(server, tops)])


def lane_points(server):
    """(people, 3) by sensor, the middle of each person's left shin in the gallery, where no frustum is."""
    points = {}
    for name, origin in zip(sorted(server.frames), lane_origins(len(server.frames)), strict=True):
        frame, floors = server.frames[name], Floors()
        floors.learn_frame(frame)
        shins = frame.positions[:, [KINECT.index("KneeLeft"), KINECT.index("AnkleLeft")]].mean(axis=1)
        points[name] = apply(floors.level(name), shins) * SENSORS_SCALE + origin
    return points


def on_page(server, points):
    """(n, 2) int, where the points (n, 3) are on the first browser's page."""
    camera = min(server.viewer._server.get_clients().items())[1].camera
    look, size = Look(camera.position, camera.look_at, camera.fov), (camera.image_width, camera.image_height)
    return ((in_picture(look, points, size[0] / size[1]) * [1, -1] + 1) / 2 * size).astype(int)


def test_every_control_sends_its_command(server, tab):
    tab.expect_state("Stopped")
    for name, enabled in (("Start", True), ("Stop", False), ("Recalibrate", False), ("Stop recording", False)):
        tab.expect_enabled(name, enabled)
    tab.button("Start").click()
    tab.expect_enabled("Recalibrate")
    tab.expect_enabled("Start", enabled=False)
    tab.button("Recalibrate").click()
    tab.expect("30 of 120 frames to go: stand still · asked for")
    tab.page.locator("[role=progressbar]").first.wait_for()
    tab.button("Stop").click()
    tab.expect_state("Stopped")
    tab.type("Take", "walk-1")
    until(tab, lambda: panels(server)[0]._name.value == "walk-1", "the name has arrived")
    tab.button("Record").click()
    tab.expect("walk-1.mcap")
    tab.expect_enabled("Stop recording")
    tab.expect_enabled("Record", enabled=False)
    tab.button("Stop recording").click()
    tab.expect_enabled("Record")
    tab.expect_value("Take", "walk-2")
    verbs = [("start", {}), ("recalibrate", {}), ("stop", {}), ("record", {"name": "walk-1"}), ("record-stop", {})]
    assert server.commands == verbs


def test_the_setup_form_sends_what_was_typed(server, tab):
    open_setup(tab)
    tab.expect_enabled("Apply setup", enabled=False)
    tab.type("Participant", "7")
    until(tab, lambda: panels(server)[0]._setup._read().participant == "7", "the participant has arrived")
    tab.choose("Placement", "right-45")
    tab.choose("Scenario", "walk")
    tab.field(HEIGHT_LABEL, LEFT).fill("1.4")
    typed = SetupFields("default", 3, "7", "right-45", "walk")
    poses = {name: PoseField(0.0, 1.4 if name == "left" else HEIGHT_M) for name in server.room.names}
    typed = dataclasses.replace(typed, poses=poses)
    until(tab, lambda: panels(server)[0]._setup._read() == typed, "all that was typed has arrived")
    tab.expect_enabled("Apply setup")
    tab.button("Apply setup").click()
    tab.expect_enabled("Apply setup", enabled=False)
    assert [verb for verb, _ in server.commands] == ["setup"]
    wanted = Setup("default", 3, 7, "right-45", "walk", {"left": SensorPose(0.0, 1.4)})
    assert server.status.setup == wanted
    server.answers = False
    tab.page.locator("label", has_text="Participant").locator("xpath=../../..").locator("input[disabled]").wait_for()


def test_edits_that_are_not_applied_stay_when_the_server_changes_and_go_when_reverted(server, tab):
    open_setup(tab)
    tab.type("Participant", "12")
    tab.expect_enabled("Revert edits")
    server.change(setup=Setup(sensors_expected=5))
    tab.page.wait_for_function("[...document.querySelectorAll('input')].some(input => input.value === '5')")
    tab.expect_value("Participant", "12")
    server.change(setup=Setup(sensors_expected=6, placement="side-by-side", scenario="sit-down"))  # names of a study
    tab.page.wait_for_function("[...document.querySelectorAll('input')].some(input => input.value === 'sit-down')")
    tab.expect_value("Participant", "12")
    tab.button("Revert edits").click()
    tab.expect_enabled("Revert edits", enabled=False)
    tab.expect_value("Participant", "")


def test_a_tilt_out_of_range_stays_as_it_was_typed_and_is_refused_in_its_unit(server, tab):
    open_setup(tab)
    tab.field(TILT_LABEL, LEFT).fill("200")
    tab.field(TILT_LABEL, LEFT).blur()
    tab.expect_enabled("Apply setup")
    tab.button("Apply setup").click()
    tab.expect('tilt of sensor "left" is 200°; it must be from -180 to 180°')
    assert tab.field(TILT_LABEL, LEFT).input_value() == "200"
    tab.button("Revert edits").click()
    until(tab, lambda: tab.field(TILT_LABEL, LEFT).input_value() == "0", "the edit is gone")
    assert server.commands == []


def test_a_participant_that_is_no_number_is_refused_in_the_page(server, tab):
    open_setup(tab)
    tab.type("Participant", "Ada")
    tab.expect_enabled("Apply setup")
    tab.button("Apply setup").click()
    tab.expect("participant is 'Ada'; it must be a whole number, or empty")
    tab.button("Revert edits").click()
    assert server.commands == []


def test_start_is_disabled_while_the_server_gets_ready_and_the_page_says_why(server, tab):
    server.change(reason="compiling the tracking method; tracking begins by itself")
    tab.expect_enabled("Start", False)
    tab.expect_state("Getting ready")
    tab.expect_state("compiling the tracking method")
    server.change(reason="")
    tab.expect_enabled("Start")


def test_a_slow_server_does_not_hold_up_the_view(server, tab):
    server.gate.clear()
    tab.button("Start").click()
    server.change(reason="still drawing")
    tab.expect("still drawing")
    assert server.status.running is False
    server.gate.set()
    tab.expect_enabled("Stop")


def test_an_empty_stage_says_why(server, tab):
    server.empty = True
    until(tab, lambda: stage_text(server) == ["Stopped: press Start to track"], "the stage says it")
    server.change(running=True, phase="calibrating", frames_remaining=90, frames_wanted=120)
    until(tab, lambda: stage_text(server) == ["Calibrating: stand still (90 of 120 frames to go)"], "the stage says it")
    server.empty = False
    until(tab, lambda: stage_text(server) == [], "the text makes room for the people")


def test_sensors_say_on_the_stage_and_in_the_panel_where_they_are_and_what_is_wrong(server, tab):
    server.change(running=True, phase="tracking")
    server.scene = placed(server.room)
    until(tab, lambda: labels(stage(server)._names) == ["front", "left", "right"], "all sensors are placed")
    server.change()
    tab.expect("place known to 12 mm, 0.4°")
    tab.expect("reference for the others")
    server.scene = msgspec.structs.replace(placed(server.room, left=MOVED, right=WALK), step=server.scene.step + 1)
    server.change(reason=server.scene.state.reason)
    said = ["front", "left · not used: it was moved", "right · not used: walk a few steps"]
    until(tab, lambda: labels(stage(server)._names) == said, "the moved sensor says so")
    lines = [f"left: {MOVED}", "right: walk a few steps"]
    until(tab, lambda: labels(stage(server)._conditions) == lines, "the stage says what to do")
    server.change()
    tab.expect("place not known")
    tab.page.locator(".mocapella-sensors").get_by_text(MOVED).wait_for()
    tab.expect_state(f"left: {MOVED} · right: walk a few steps")


def test_unsure_joints_have_halos_and_sure_ones_none(server, tab):
    server.change(running=True, phase="tracking")
    tab.expect_state("Tracking")
    until(tab, lambda: shown(stage(server)._halos) == 0, "nobody says how sure a joint is")
    server.scene = placed(server.room)
    until(tab, lambda: shown(stage(server)._halos) == 2 * 4, "four joints of each person are unsure")
    server.scene = server.room.scene(1.0, server.frames)
    until(tab, lambda: shown(stage(server)._halos) == 0, "the halos are gone")


def test_where_the_method_makes_arms_alone_no_people_are_listed(server, tab):
    server.empty = True
    server.change(running=True, phase="tracking")
    tab.expect("Nobody is in view.")
    server.change(setup=Setup(method="arms"), counts={"arms": 0})
    tab.page.locator(".mocapella-people").locator("visible=true").wait_for(state="detached")
    assert not tab.field("Who").is_visible()
    server.change(setup=Setup(), counts={"people": 0})
    tab.expect("Nobody is in view.")


def test_whom_to_name_is_chosen_and_stays_so_while_nobody_sees_them(server, tab):
    server.change(running=True, phase="tracking")
    tab.expect_value("Who", "Person 2")
    tab.choose("Who", "Person 3")
    until(tab, lambda: panels(server)[0]._part_panels["people"]._chosen == 3, "the choice has arrived")
    tab.type("Name", "Lin")
    until(tab, lambda: panels(server)[0]._part_panels["people"]._text.value == "Lin", "the name has arrived")
    server.empty = True
    server.change()
    tab.expect("Nobody is in view.")
    tab.expect_value("Name", "Lin")
    tab.button("Set name").click()
    until(tab, lambda: server.commands == [("name", {"person": 3, "name": "Lin"})], "the name was sent")
    server.empty = False
    server.change()
    tab.page.locator(".mocapella-people", has_text="Lin").wait_for()
    tab.expect_value("Who", "Lin (person 3)")
    server.change(running=False, phase="stopped")
    tab.expect_enabled("Set name", enabled=False)


def stage(server, k=0):
    """The Scene stage of a browser, as the view's loop has it."""
    return sorted(server.viewer._browsers.items())[k][1]._stage


def labels(tags):
    """The texts that are shown."""
    return [handle.text for handle in tags._handles if handle.visible]


def shown(strokes):
    """How many strokes have a size and can be seen."""
    handle = strokes._handle
    return (
        0 if handle is None else int(((handle.batched_scales > 0).all(axis=1) & (handle.batched_opacities > 0)).sum())
    )


def drawn(lines):
    """Whether any line is shown."""
    return lines._handle is not None and lines._handle.visible


def stage_text(server):
    """What stands on the first browser's Scene stage instead of people."""
    _, browser = min(server.viewer._browsers.items())
    return [handle.text for handle in browser._stage._empty._handles if handle.visible]


class Balloon(msgspec.Struct, frozen=True, eq=False):
    """A plug-in's scene part."""


def burst(parts, scene, room):
    raise ZeroDivisionError("it <b>burst</b>")


def test_a_plug_ins_drawing_that_raises_is_told_in_the_panel_and_all_else_is_drawn(server, tab, monkeypatch):
    kind = PartType(1, "balloons", Balloon, None, None, drawing=f"{__name__}:burst")
    monkeypatch.setitem(PART_TYPES, "balloons", kind)
    server.change(running=True, phase="tracking")
    server.scene = placed(server.room).with_parts(balloons=(Balloon(),))  # where sensors have places
    tab.expect("scene part balloons cannot be drawn: ZeroDivisionError: it <b>burst</b>")
    until(tab, lambda: len(labels(stage(server)._tags)) == 2, "the people are drawn")
    assert len(server.viewer._known.troubles.lines) == 1


def test_a_browser_that_is_stopped_stays_where_it_is_and_follows_again(server, tab):
    server.change(running=True, phase="tracking")
    begun = server.scene
    tab.expect_state("Tracking")
    (browser,) = server.viewer._browsers.values()

    def go_on():
        step, at_ns = server.scene.step + 1, server.scene.at_ns + 100_000_000
        people = tuple(msgspec.structs.replace(p, positions=p.positions + 0.02) for p in server.scene.people)
        server.scene = msgspec.structs.replace(server.scene.with_parts(people=people), at_ns=at_ns, step=step)

    for _ in range(5):
        shown, _ = server.viewer.timeline.last, go_on()
        until(tab, lambda shown=shown: server.viewer.timeline.last > shown, "the scene is kept")
    tab.button("Pause").click()
    until(tab, lambda: not browser.live, "it is stopped")
    stopped = browser.playhead.shown
    tags = [tag.position for tag in stage(server)._tags._shown]
    for _ in range(5):
        shown, _ = server.viewer.timeline.last, go_on()
        until(tab, lambda shown=shown: server.viewer.timeline.last > shown, "the scene is kept")
    tab.page.locator(".mocapella-timeline", has_text=re.compile("Paused · 0.[45] s ago")).wait_for()
    assert browser.playhead.shown == stopped
    assert [tag.position for tag in stage(server)._tags._shown] == tags
    assert any("Paused" in text for text in labels(stage(server)._conditions))
    tab.button("Newest").click()
    until(tab, lambda: browser.live, "it follows again")
    until(tab, lambda: [tag.position for tag in stage(server)._tags._shown] != tags, "the people have moved")
    server.scene = begun


def test_a_take_gets_the_name_that_the_server_proposes_unless_one_was_typed(server, tab):
    tab.type("Take", "take-3")
    until(tab, lambda: panels(server)[0]._name.value == "take-3", "the name has arrived")
    server.change(next_take="take-3")
    until(tab, lambda: panels(server)[0]._status.next_take == "take-3", "it is the proposed one")
    server.change(next_take="take-4")
    tab.expect_value("Take", "take-4")
    tab.type("Take", "walk-1")
    until(tab, lambda: panels(server)[0]._name.value == "walk-1", "the name has arrived")
    server.change(next_take="take-5", reason="a take of somebody else")
    tab.expect("a take of somebody else")
    tab.expect_value("Take", "walk-1")


def test_the_page_that_is_cut_off_says_so_and_goes_on_when_it_is_not(server, tab):
    lost = tab.page.locator(".mocapella-lost")
    lost.wait_for(state="hidden")
    server.held.set()
    lost.wait_for(state="visible")
    box = lost.bounding_box()
    assert (box["x"], box["y"], box["width"], box["height"]) == (0, 0, *tab.page.viewport_size.values())
    server.held.clear()
    lost.wait_for(state="hidden")


def test_without_a_server_all_is_disabled(server, tab):
    server.answers = False
    tab.expect_state("No server")
    for name in ("Start", "Stop", "Recalibrate", "Record", "Stop recording"):
        tab.expect_enabled(name, enabled=False)


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
    # Until the page has the setup of `fresh`: what is typed before is drawn over.
    tab.page.wait_for_function("[...document.querySelectorAll('input')].some(input => input.value === '3')")


def test_two_browsers_with_opposite_commands_both_show_the_final_state(server, tabs):
    first, second = tabs
    first.page.bring_to_front()
    first.button("Start").click()
    second.expect_enabled("Stop")
    second.button("Stop").click()
    first.expect_enabled("Start")
    server.gate.clear()
    first.button("Start").click()
    until(first, lambda: len(server.commands) == 3, "the third command has come")
    server.gate.set()
    second.expect_enabled("Stop")
    for tab in tabs:
        tab.expect_state("Tracking")
        tab.expect_enabled("Start", enabled=False)
    assert [verb for verb, _ in server.commands] == ["start", "stop", "start"]


def test_a_refused_command_is_explained_in_the_browser_that_gave_it(server, tabs):
    first, second = tabs
    first.page.bring_to_front()
    first.type("Take", "taken")
    until(first, lambda: panels(server)[0]._name.value == "taken", "the name has arrived")
    first.button("Record").click()
    first.expect("taken is taken; take another name")
    assert second.page.get_by_text("taken is taken").count() == 0


def give_name(server, tabs, k, name):
    tabs[k].type("Name", name)
    until(tabs[k], lambda: panels(server)[k]._part_panels["people"]._text.value == name, "the name has arrived")
    tabs[k].button("Set name").click()


def test_a_name_that_one_browser_gives_is_seen_in_all_and_the_last_of_two_holds(server, tabs):
    first = tabs[0]
    first.page.bring_to_front()
    server.change(running=True, phase="tracking")
    for panel in panels(server):
        until(first, lambda panel=panel: not panel._part_panels["people"]._text.disabled, "somebody can be named")
    who = [panel._part_panels["people"]._chosen for panel in panels(server)]
    give_name(server, tabs, 0, "Ada")
    for k, tab in enumerate(tabs):
        until(tab, lambda k=k: "Ada · 3 views" in labels(stage(server, k)._tags), "the name is over the person")
        server.change()
        tab.page.locator(".mocapella-people", has_text="Ada").wait_for()
    server.gate.clear()
    give_name(server, tabs, 0, "Grace")
    until(first, lambda: len(server.commands) == 2, "the first command waits for the server")
    give_name(server, tabs, 1, "Edith")
    server.gate.set()
    sent = [("name", {"person": who[k], "name": name}) for k, name in ((0, "Ada"), (0, "Grace"), (1, "Edith"))]
    until(first, lambda: server.commands == sent, "both commands were served, in their order")
    server.change()
    for k, tab in enumerate(tabs):
        until(tab, lambda k=k: "Edith · 3 views" in labels(stage(server, k)._tags), "the last name holds")
        tab.page.locator(".mocapella-people", has_text="Edith").wait_for()
    nasty = "<img src=x onerror='window.hurt=1'>"
    server.names[who[0]] = nasty
    server.change()
    first.page.locator(".mocapella-people").get_by_text(nasty).wait_for()
    assert first.page.evaluate("window.hurt") is None


def test_trails_and_fields_of_view_are_shown_in_the_browser_that_wants_them(server, tabs):
    first, _ = tabs
    first.page.bring_to_front()
    server.change(running=True, phase="tracking")
    begun = server.scene = placed(server.room)
    fields = first.page.locator("label", has_text="Fields of view").locator("xpath=../../..").locator("input")
    first.choose("Trails", "on the floor")
    fields.check()

    def walks_and_is_followed():
        step = server.scene.step + 1
        people = tuple(msgspec.structs.replace(p, positions=p.positions + 0.02) for p in server.scene.people)
        at_ns = begun.at_ns + (step - begun.step) * 100_000_000
        server.scene = msgspec.structs.replace(begun.with_parts(people=people), at_ns=at_ns, step=step)
        return drawn(stage(server)._trails) and drawn(stage(server)._field_lines)

    until(first, walks_and_is_followed, "both are there")
    assert not drawn(stage(server, 1)._trails)
    assert not drawn(stage(server, 1)._field_lines)
    points = stage(server)._trails._handle.points
    assert np.isfinite(points).all()
    assert np.abs(points[..., 1]).max() < 0.05
    first.choose("Trails", "off")
    fields.uncheck()
    until(first, lambda: not drawn(stage(server)._trails) and not drawn(stage(server)._field_lines), "both are gone")


def panels(server):
    """The panel of each browser, as the view's loop has it."""
    return [browser._panel for _, browser in sorted(server.viewer._browsers.items())]


def cameras(server):
    """(browsers, 3), where their cameras are."""
    return np.array([client.camera.position for _, client in sorted(server.viewer._server.get_clients().items())])


def test_a_perspective_moves_the_camera_of_its_own_browser_to_the_sensor(server, tabs):
    first, _ = tabs
    first.page.bring_to_front()
    before = cameras(server)
    first.choose("Perspective", "left")
    wanted = [0.0, server.frames["left"].height, 0.0]
    until(first, lambda: np.allclose(cameras(server)[0], wanted, atol=1e-2), "the camera is at the sensor")
    assert cameras(server)[1] == pytest.approx(before[1], abs=1e-2)
    for aim, far in (("Scene", True), ("Sensors", True), ("Sensor's eyes", False)):
        first.button(aim).click()  # each is waited for: one that comes late would undo what follows
        until(first, lambda far=far: (cameras(server)[0, 2] < -1) == far, f"the camera is where {aim} wants it")
    first.choose("Perspective", "free")
    until(first, lambda: cameras(server)[0, 2] < -1, "the camera is before the stages")
    first.button("Sensor's eyes").click()
    first.expect_value("Perspective", "front")
    wanted = [0.0, server.frames["front"].height, 0.0]
    until(first, lambda: np.allclose(cameras(server)[0], wanted, atol=1e-2), "the camera is at the default sensor")


def test_a_perspective_that_is_chosen_while_the_view_is_drawn_has_its_own_eyes(server, tabs):
    first, _ = tabs
    first.page.bring_to_front()
    first.choose("Perspective", "free")
    until(first, lambda: cameras(server)[0, 2] < -1, "the camera is before the stages")
    _, browser = min(server.viewer._browsers.items())
    draw = browser._stage.draw

    def chosen_meanwhile(*args, **kwargs):
        browser._stage.draw = draw
        browser._panel._chosen = "front"
        browser._want(Aim.EYES)
        draw(*args, **kwargs)

    browser._stage.draw = chosen_meanwhile
    wanted = [0.0, server.frames["front"].height, 0.0]
    until(first, lambda: np.allclose(cameras(server)[0], wanted, atol=1e-2), "the camera is at the sensor")


@pytest.mark.slow
def test_who_has_the_watchers_address_sees_all_and_controls_nothing(server, chromium, tab):
    server.change(running=True, phase="tracking")
    with urllib.request.urlopen(server.viewer.url) as answer:
        assert answer.status == 200
    with pytest.raises(urllib.error.HTTPError):
        urllib.request.urlopen(server.viewer.url.partition("?")[0])
    tab.expect("the view refused 1 request, the latest because the token is missing or wrong")
    page = chromium.new_page()
    page.add_init_script(DRAW_NOTHING)
    watcher = Tab(page, server.viewer.watch_url)
    watcher.expect_state("Tracking")
    watcher.expect("You watch.")
    for name in ("Start", "Stop", "Recalibrate", "Record", "Stop recording", "Setup"):
        assert watcher.button(name).count() == 0, name
    assert page.get_by_text("the view refused").count() == 0
    until(watcher, lambda: len(panels(server)) > 1, "it is there")
    panel = panels(server)[-1]
    assert not panel._operates
    for control in (panel._start, panel._stop, panel._record, panel._record_stop, panel._name):
        assert not may_change(control, control.value)
    panel._send("stop", {})
    panel._send_setup({"participant": 3})
    watcher.choose("Perspective", "free")  # its own view is its own
    watcher.page.wait_for_timeout(500)
    assert server.commands == []
    page.close()


PHONE = {"width": 390, "height": 844}
PLACES = """() => ["canvas", ".mantine-Paper-root:has(.mocapella-status)"].map(one => {
  const {left, right, top, bottom} = document.querySelector(one).getBoundingClientRect();
  return [left, right, top, bottom];
})"""
"""Left, right, top and bottom of the 3D scene and of the panel [px]."""


@pytest.mark.slow
def test_on_a_phone_the_panel_is_below_the_scene_and_folds_away(server, chromium):
    page = chromium.new_page()
    page.add_init_script(DRAW_NOTHING)
    page.set_viewport_size(PHONE)
    phone = Tab(page, server.viewer.url)
    try:
        until(phone, lambda: phone.page.evaluate(PLACES)[0][3] < 500, "the scene ends above the panel")
        scene, panel = phone.page.evaluate(PLACES)
        assert scene[:3] == [0, 390, 0]
        assert panel[:2] == [0, 390]
        assert (scene[3], panel[3]) == (panel[2], 844)
        assert scene[3] > 0.54 * 844
        phone.page.get_by_text("Mocapella", exact=True).click()
        until(phone, lambda: phone.page.evaluate(PLACES)[0][3] > 700, "the scene fills the page")
        scene, panel = phone.page.evaluate(PLACES)
        assert (scene[3], panel[3]) == (panel[2], 844)
    finally:
        page.close()
