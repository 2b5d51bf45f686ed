"""The pages of a study, in a real browser and by their socket: what they show, and who may do what."""

from __future__ import annotations

import http.client
import json
import shutil
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from support.browser import FLAGS
from support.programs import wait_until
from websockets.sync.client import connect

from mocapella.errors import BusError
from mocapella.model.session import CommandReply
from mocapella.model.study_status import FloorMap, LiveCheck, MapPoint, PlannedPart, StudyStatus
from mocapella.viewer.page import PageServer, open_page
from mocapella.viewer.study_page import SOCKET

CHROMIUM = shutil.which("chromium")
POINTS = tuple(
    MapPoint(name, x, y)
    for name, x, y in (("start", 0, 0), ("front-left", -0.96, 0.93), ("front-right", 0.96, 0.93), ("back", 0, -0.93))
)
STUDY = StudyStatus(
    "Walking <b>about</b>",
    ("P01", "P02"),
    "P01",
    "right-45",
    phase="running",
    part=1,
    plan=tuple(
        PlannedPart(title, placement, number, 2, state)  # type: ignore[arg-type]
        for title, placement, number, state in (
            ("stand", "right-45", 1, "done"),
            ("walk", "right-45", 1, "now"),
            ("walk", "right-90", 2, "later"),
        )
    ),
    instruction="Walk to the <i>front</i> left corner",
    following="to the front right corner",
    step=2,
    steps=9,
    elapsed_s=72.0,
    minimum_left_s=7.5,
    step_left_s=2.0,
    step_s=5.0,
    block=FloorMap(1.925, 1.87, POINTS, "start", ("start",), ("front-left",)),
    tone=True,
    changes=3,
    logged="logging walk: 87 results",
    actions=("next", "repeat", "pause", "mark", "abort"),
    notes=("the protocol was edited",),
)
CHECK = LiveCheck(1, 2, 1, 1, 4.23, 96.0)


class Session:
    """A page server with what it was asked to do."""

    def __init__(self) -> None:
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.page: PageServer = open_page("127.0.0.1", 0, 400, self._do)

    def _do(self, verb: str, arguments: dict[str, Any]) -> CommandReply:
        self.commands.append((verb, arguments))
        if verb == "study-repeat":
            raise BusError("no server answers")
        return CommandReply(verb != "study-abort", f"{verb}: heard")


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    made = Session()
    yield made
    made.page.stop()


@pytest.fixture
def showing(session: Session) -> Session:
    session.commands.clear()
    session.page.study.show(STUDY, CHECK)
    return session


def socket_of(page: PageServer, *, watch: bool = False) -> Any:
    query = page.door.query(watch=watch)
    return connect(f"ws://127.0.0.1:{page.get_port()}{SOCKET}{query}")


def state_of(socket: Any) -> dict[str, Any]:
    while True:
        message = json.loads(socket.recv(timeout=20))
        if "state" in message:
            found: dict[str, Any] = message["state"]
            return found


def reply_of(socket: Any) -> dict[str, Any]:
    while True:
        message = json.loads(socket.recv(timeout=20))
        if "reply" in message:
            found: dict[str, Any] = message["reply"]
            return found


def test_states_are_pushed_and_an_operators_commands_are_carried_out(showing: Session) -> None:
    with socket_of(showing.page) as socket:
        state = state_of(socket)
        assert state["operates"] is True
        assert state["study"]["instruction"] == STUDY.instruction
        assert state["check"]["apart_cm"] == CHECK.apart_cm
        socket.send(json.dumps({"verb": "study-mark", "arguments": {"note": "a cat"}}))
        assert reply_of(socket) == {"ok": True, "message": "study-mark: heard"}
        socket.send(json.dumps({"verb": "study-repeat"}))
        assert reply_of(socket) == {"ok": False, "message": "no server answers"}
        showing.page.study.show(None, None)
        wait_until("the end of the study is pushed", lambda: state_of(socket)["study"] is None)
    assert showing.commands == [("study-mark", {"note": "a cat"}), ("study-repeat", {})]


def test_who_only_watches_can_do_nothing(showing: Session) -> None:
    with socket_of(showing.page, watch=True) as socket:
        assert state_of(socket)["operates"] is False
        socket.send(json.dumps({"verb": "study-next"}))
        assert "only watches" in reply_of(socket)["message"]
    assert showing.commands == []


@pytest.mark.parametrize(
    "text",
    [
        "", "no JSON", "[]", '{"verb": "stop"}', '{"verb": "study-NEXT"}', '{"verb": "study-next", "more": 1}',
        '{"verb": "study-mark", "arguments": {"note": 1}}', "[" * 5000,
        json.dumps({"verb": "study-mark", "arguments": {"note": "x" * 501}}),
    ],
)  # fmt: skip
def test_a_message_that_cannot_be_used_is_counted_and_ends_nothing(showing: Session, text: str) -> None:
    before = sum(showing.page.refusals._counts.values())
    with socket_of(showing.page) as socket:
        socket.send(text)
        wait_until("it is counted", lambda: sum(showing.page.refusals._counts.values()) == before + 1)
        socket.send(json.dumps({"verb": "study-next"}))
        assert reply_of(socket)["ok"]
    assert showing.commands == [("study-next", {})]


@pytest.mark.parametrize("path", ["/study", "/participant"])
def test_pages_need_a_token(session: Session, path: str) -> None:
    for query, status in (("", 403), ("?token=wrong", 403), (session.page.door.query(watch=True), 200)):
        link = http.client.HTTPConnection("127.0.0.1", session.page.get_port(), timeout=20)
        link.request("GET", f"{path}{query}")
        assert link.getresponse().status == status
        link.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("needs chromium on the PATH")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield made
        made.close()


def opened(browser: Any, url: str, width: int = 1280, height: int = 720) -> tuple[Any, list[str]]:
    page = browser.new_page(viewport={"width": width, "height": height})
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(url)
    return page, errors


def test_the_researchers_page_shows_all_and_obeys_keys(showing: Session, browser: Any) -> None:
    page, errors = opened(browser, showing.page.study_url("study"))
    page.wait_for_function("document.querySelector('#instruction').textContent.includes('left corner')")
    assert page.inner_text("#instruction") == STUDY.instruction  # as text: what a protocol says is no HTML
    assert page.inner_text("#title") == STUDY.title
    assert page.inner_text("#time") == "1:12, can end in 8 s"
    assert page.locator("#plan b").all_inner_texts() == ["right-45", "right-90"]
    checks = page.inner_text("#checks")
    for words in (
        "1 of 2 sensors",
        "Δd 4.2 cm",
        "96 % of views whole",
        "1 inside the block",
        "logging walk: 87 results",
    ):
        assert words in checks
    assert page.locator("#checks li.bad").all_inner_texts() == ["1 of 2 sensors"]
    assert page.locator("#plan .now").inner_text() == "walk 1"
    assert page.inner_text("#notes") == "the protocol was edited"
    assert page.locator("#begin").is_disabled()
    for key in ("n", "r", "p", "Shift+N"):
        page.keyboard.press(key)
    page.keyboard.press("m")
    page.keyboard.type("next, please")
    page.keyboard.press("Enter")
    wait_until("all are heard", lambda: len(showing.commands) == 5)
    assert showing.commands == [
        ("study-next", {}), ("study-repeat", {}), ("study-pause", {}), ("study-next", {"forced": "yes"}),
        ("study-mark", {"note": "next, please"}),
    ]  # fmt: skip
    page.wait_for_function("document.querySelector('#reply').textContent === 'study-mark: heard'")
    page.on("dialog", lambda dialog: dialog.accept())
    page.keyboard.press("Shift+A")
    page.wait_for_function("document.querySelector('#reply').classList.contains('bad')")
    assert errors == []
    page.close()


def test_the_participants_screen_is_read_from_four_metres_and_shows_where_to_go(showing: Session, browser: Any) -> None:
    page, errors = opened(browser, showing.page.study_url("participant"))
    page.wait_for_function("document.querySelector('#instruction').textContent.includes('left corner')")
    size = page.evaluate("parseFloat(getComputedStyle(document.querySelector('#instruction')).fontSize)")
    assert size >= 0.08 * 720  # 24 mm on a screen 30 cm high; 4 m / 200 is 20 mm
    words = page.evaluate(
        "[...document.querySelectorAll('#map text')].map(word => word.getBoundingClientRect().toJSON())"
    )
    assert len(words) == 3  # sensors, you (on the start), next
    for word in words:
        assert word["height"] >= 0.06 * 720  # 18 mm or more on that screen
        assert 0 <= word["left"] < word["right"] <= 1280
        assert 0 <= word["top"] < word["bottom"] <= 720
    assert not page.locator("header").is_visible()
    assert not page.locator("footer").is_visible()
    assert page.locator("#map circle.here").count() == page.locator("#map circle.next").count() == 1
    here, then = (page.locator(f"#map circle.{name}").bounding_box() for name in ("here", "next"))
    assert then["x"] < here["x"]  # to the left, and towards the sensors, which are above
    assert then["y"] < here["y"]
    page.keyboard.press("n")
    long = StudyStatus("t", (), "P01", phase="running", instruction="Walk around the obstacle, then wait. " * 4)
    showing.page.study.show(long, CHECK)
    page.wait_for_function("document.querySelector('#instruction').textContent.startsWith('Walk around')")
    assert not page.locator("#map").is_visible()
    words = page.locator("#instruction").bounding_box()
    assert words["y"] >= 0
    assert words["y"] + words["height"] <= 720
    showing.page.study.show(None, None)
    page.wait_for_function("document.querySelector('#instruction').textContent === 'Please wait'")
    assert showing.commands == []
    assert errors == []
    page.close()


LINES = """() => {
  const text = document.querySelector("#instruction").firstChild;
  return [...text.data.matchAll(/\\S+/g)].map(word => {
    const range = new Range();
    range.setStart(text, word.index);
    range.setEnd(text, word.index + word[0].length);
    return new Set([...range.getClientRects()].map(one => Math.round(one.top))).size;
  });
}"""
"""The number of lines on which each word of the instruction is."""


@pytest.mark.parametrize("path", ["study", "participant"])
@pytest.mark.parametrize(("width", "height"), [(320, 568), (390, 844), (768, 1024), (844, 390), (1280, 720)])
def test_no_word_is_broken_and_nothing_is_cut_off_on_any_screen(
    showing: Session, browser: Any, path: str, width: int, height: int
) -> None:
    page, errors = opened(browser, showing.page.study_url(path), width, height)
    page.wait_for_function("document.querySelector('#instruction').textContent.includes('left corner')")
    assert set(page.evaluate(LINES)) == {1}
    words, then, plan = (page.locator(one).bounding_box() for one in ("#instruction", "#following", "#map"))
    assert words["x"] >= 0
    assert words["x"] + words["width"] <= width
    assert words["y"] + words["height"] <= then["y"]
    assert plan["y"] >= 0
    assert plan["y"] + plan["height"] <= height
    if width <= 800:
        assert then["y"] + then["height"] <= plan["y"]
    if path == "study":
        assert words["y"] >= page.locator("header").bounding_box()["height"]
        next_one = page.locator("#next").bounding_box()
        assert plan["y"] + plan["height"] <= next_one["y"]
        assert next_one["y"] + next_one["height"] <= height  # without scrolling
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert errors == []
    page.close()


HEARD = """
window.heard = [];
window.AudioContext = class {
  currentTime = 0; destination = {};
  resume() {}
  createGain() { return { gain: { setValueAtTime() {}, exponentialRampToValueAtTime() {} }, connect: next => next }; }
  createOscillator() {
    const frequency = { value: 0 };
    return { frequency, connect: next => next, start: () => window.heard.push(frequency.value), stop() {} };
  }
};
"""
"""An audio device of a browser that keeps the frequencies of its tones."""


def test_each_change_sounds_with_the_tone_of_the_protocol(showing: Session, browser: Any) -> None:
    page = browser.new_page()
    page.add_init_script(HEARD)
    page.goto(showing.page.study_url("participant"))
    page.locator("#sound").click()
    for number, tone_hz in enumerate((660.0, None, 880.0), start=10):
        text = f"change {number}"
        showing.page.study.show(
            msgspec.structs.replace(STUDY, changes=number, instruction=text, tone_hz=tone_hz), CHECK
        )
        page.wait_for_function("text => document.querySelector('#instruction').textContent === text", arg=text)
    assert page.evaluate("window.heard") == [660, 880]
    page.close()


def test_a_page_without_its_server_says_so_and_goes_on(browser: Any) -> None:
    session = Session()
    session.page.study.show(STUDY, CHECK)
    page, _ = opened(browser, session.page.study_url("participant"))
    page.wait_for_function("document.querySelector('#instruction').textContent.includes('left corner')")
    port = session.page.get_port()
    session.page.stop()
    page.wait_for_function("getComputedStyle(document.querySelector('#lost')).display === 'flex'", timeout=30_000)
    again = open_page("127.0.0.1", port, 400)
    again.study.show(STUDY, CHECK)
    page.wait_for_function("getComputedStyle(document.querySelector('#lost')).display === 'none'", timeout=30_000)
    page.close()
    again.stop()
