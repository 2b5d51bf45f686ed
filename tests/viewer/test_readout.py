"""The readouts say what the status says, and a text from the wire is never markup."""

import dataclasses
from html.parser import HTMLParser

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import Room, health, status

from mocapella.model.condition_texts import UNFINISHED, WARNINGS
from mocapella.model.scene import Phase, SensorPlace
from mocapella.model.session import RecordingHealth, ServerHealth, Setup, UnknownEnd
from mocapella.model.study_status import StudyStatus
from mocapella.viewer.palette import AMBER, BLUE, RED, SensorColours
from mocapella.viewer.readout import (
    condition_lines,
    notices_html,
    people_html,
    recording_html,
    sensors_html,
    stage_text,
    status_html,
    study_html,
)

NASTY = "<script>alert(1)</script><img src=x onerror='alert(2)'>\"&"


class Reader(HTMLParser):
    """Collects the tags and the text of a page, as a browser would find them."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}

    def handle_data(self, data):
        self.text += data


@given(st.sampled_from([NASTY]) | st.text(max_size=30))
def test_no_text_from_the_wire_becomes_markup(text):
    session = status(
        phase=text,
        reason=text,
        notices=(text,),
        sensors=(health(text, problem=text),),
        recording=RecordingHealth(active=True, path=text, problem=text),
    )
    html = (
        status_html(session)
        + sensors_html(session, SensorColours(), {text: SensorPlace(text, np.eye(4), quality=text, problem=text)})
        + people_html((msgspec.structs.replace(Room(1).scene(0.0, Room(1).frames(0.0)).people[0], name=text),))
        + recording_html(session.recording)
        + notices_html(session)
    )
    page = Reader(html)
    assert page.tags <= {"div", "span", "b", "br"}
    assert page.attributes <= {"class", "style"}


def test_a_sensor_called_script_is_shown_as_it_is_called():
    assert NASTY in Reader(sensors_html(status(sensors=(health(NASTY),)), SensorColours())).text


@pytest.mark.parametrize("phase", list(Phase))
def test_every_phase_is_shown_in_words(phase):
    assert phase.value.capitalize() in Reader(status_html(status(phase=phase.value))).text


def test_the_status_says_what_is_waited_for_and_why():
    waiting = Reader(status_html(status(phase="waiting for sensors", sensors_missing=1))).text
    assert "1 sensor missing" in waiting
    session = status(phase="calibrating", frames_remaining=40, frames_wanted=120, reason="a hand moved 12 cm")
    assert "40 of 120 frames to go: stand still · a hand moved 12 cm" in Reader(status_html(session)).text
    assert "No server" in Reader(status_html(None)).text


GREEN = "#3ddc97"
GONE = {"silent": True, "connected": False, "problem": "gone", "rate_hz": 0.0}


def test_while_all_sensors_deliver_tracking_is_green_and_names_none():
    html = status_html(status())
    assert GREEN in html
    assert Reader(html).text == "Tracking2 people · 3 sensors · 90 results/s"


def test_while_sensors_are_waited_for_nothing_is_amber():
    assert AMBER.css not in status_html(status(phase="waiting for sensors", sensors_missing=1))


def test_a_sensor_that_delivers_nothing_is_named_and_nothing_is_green():
    sensors = (health("front"), health("left", silent=True, problem="silent for 7 s"), health("right", **GONE))
    html = status_html(status(sensors=sensors, reason="the door; left: silent"))
    assert GREEN not in html
    words = "Trackingthe door · left: silent for 7 s · right: gone2 people · 1 of 3 sensors · 90 results/s"
    assert Reader(html).text == words


def test_when_no_sensor_delivers_the_headline_says_so_names_all_and_counts_nobody():
    sensors = (health("front", silent=True), health("left", **GONE))
    text = Reader(status_html(status(sensors=sensors, reason="left: silent", scenes_hz=0.0))).text
    assert text == "No sensor deliversfront: silent · left: gone0 people · 0 of 2 sensors · 0 results/s"


def test_while_stopped_a_silent_sensor_is_no_matter_of_the_headline():
    text = Reader(status_html(status(running=False, phase="stopped", sensors=(health("left", **GONE),)))).text
    assert "gone" not in text


@pytest.mark.parametrize(
    ("session", "words"),
    [
        (None, "No server"),
        (status(running=False, phase="stopped"), "Stopped: press Start to track"),
        (status(phase="waiting for sensors", sensors_missing=2), "Waiting for sensors: 2 sensors missing"),
        (
            status(phase="calibrating", frames_remaining=40, frames_wanted=120, reason="front: head of body 1 moved"),
            "Calibrating: stand still (40 of 120 frames to go)",
        ),
        (
            status(
                phase="calibrating",
                frames_remaining=120,
                frames_wanted=120,
                reason="no person is in view yet",
                sensors=(health("front", bodies=0), health("left", bodies=1, silent=True)),
            ),
            "Calibrating: no person is in view yet",
        ),
        (
            status(phase="needs recalibration", reason="all people have left"),
            "Needs recalibration: all people have left",
        ),
        (status(), "Nobody is in view"),
        (status(setup=Setup(method="arms"), counts={"arms": 0}), "No arm is in view"),
        (status(setup=Setup(method="hands"), counts={"hands": 0}), "No hand is in view"),
        (status(sensors=(health("left", **GONE),)), "No sensor delivers"),
    ],
)
def test_an_empty_stage_says_why_it_is_empty(session, words):
    assert stage_text(session) == words


def test_a_stop_with_a_reason_is_shown_as_getting_ready():
    reason = "compiling the tracking method; tracking begins by itself"
    session = status(running=False, phase="stopped", reason=reason)
    assert stage_text(session) == "Getting ready: compiling the tracking method · tracking begins by itself"
    html = status_html(session)
    assert "Getting readycompiling the tracking method" in Reader(html).text
    assert "Stopped" not in Reader(html).text
    assert BLUE.css in html
    assert AMBER.css not in html


CALIBRATING = "; ".join(f"{name}: with front: walk a few steps" for name in ("front", "left", "right"))


@pytest.mark.parametrize(
    ("session", "lines"),
    [
        (None, ()),
        (status(), ()),
        (status(running=False, phase="stopped", reason="asked for"), ()),
        (status(reason="left: it was moved: walk"), ("left: it was moved: walk",)),
        (status(phase="calibrating", reason=CALIBRATING), ("Calibrating", "all sensors: walk a few steps")),
        (status(reason="a; b; c; d; e"), ("a", "b", "c", "and 2 more")),
        (status(reason="x" * 200), ("x" * 109 + "…",)),
    ],
)
def test_a_stage_with_people_says_what_is_wrong_in_few_lines(session, lines):
    assert condition_lines(session) == lines


def test_a_method_that_counts_no_frames_says_what_it_wants_on_the_empty_stage():
    assert stage_text(status(phase="calibrating", frames_wanted=0, reason=CALIBRATING)) == (
        "Calibrating: all sensors: walk a few steps"
    )


def test_tracking_is_green_only_while_no_condition_holds():
    html = status_html(status(reason="left: it was moved: walk"))
    assert GREEN not in html
    assert "left: it was moved: walk" in Reader(html).text


@pytest.mark.parametrize("T", [None, np.eye(4)])
@pytest.mark.parametrize(
    ("problem", "warns"), [(text, False) for text in UNFINISHED] + [(text, True) for text in WARNINGS]
)
def test_an_unfinished_calibration_is_never_amber_or_red_and_a_warning_is(T, problem, warns):
    place = SensorPlace("front", T, problem=f"with left: {problem}")
    html = sensors_html(status(sensors=(health("front"),)), SensorColours(), {"front": place})
    assert (AMBER.css in html, RED.css in html) == (warns, warns and T is None)
    assert (AMBER.css in status_html(status(reason=f"front: with left: {problem}"))) == warns


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (SensorPlace("front", np.eye(4), quality="12 mm, 0.4°"), ["place known to 12 mm, 0.4°"]),
        (SensorPlace("front", np.eye(4)), ["reference for the others"]),
        (SensorPlace("front", None, problem="with left: walk"), ["place not known", "walk"]),
    ],
)
def test_how_well_a_sensors_place_is_known_is_said(place, words):
    text = Reader(sensors_html(status(sensors=(health("front"),)), SensorColours(), {"front": place})).text
    for word in words:
        assert word in text
    assert "with left" not in text
    assert "place" not in Reader(sensors_html(status(sensors=(health("front"),)), SensorColours())).text


@pytest.mark.parametrize(
    ("sends", "words"),
    [
        ("skeletons", "2 people"),
        ("markers", "2 markers"),
        ("poses", "2 bodies"),
        ("arms", "2 arms"),
        ("depth", "depth images"),
    ],
)
def test_what_a_sensor_sends_is_counted_under_its_name(sends, words):
    text = Reader(sensors_html(status(sensors=(health("front", sends=sends),)), SensorColours())).text
    assert f"{words} · 30.0 Hz" in text


def test_people_are_listed_by_name_and_number():
    people = Room(2).scene(0.0, Room(2).frames(0.0)).people
    text = Reader(people_html((msgspec.structs.replace(people[0], name="Ada"), people[1]))).text
    assert "Ada" in text
    assert "person 1 · 3 views" in text
    assert "Person 2" in text
    assert "Nobody is in view." in Reader(people_html(())).text


def test_whose_labels_are_swapped_is_shown_beside_the_sensor_and_moves_nothing():
    people = Room(2).scene(0.0, Room(2).frames(0.0)).people
    front, *others = people[0].views
    swapped = msgspec.structs.replace(people[0], views=(msgspec.structs.replace(front, mirrored=True), *others))
    html, plain = people_html((swapped, people[1])), people_html(people)
    assert f"{front.sensor} ⇄ · {others[0].sensor}" in Reader(html).text
    assert "⇄ left/right labels swapped" in Reader(html).text
    assert [Reader(html).text.count("⇄"), Reader(plain).text.count("⇄")] == [2, 1]
    assert html.count("<div") == plain.count("<div")
    assert "⇄" not in people_html(())


def test_every_figure_of_a_sensor_is_shown():
    row = health("front", bodies=2, rate_hz=29.97, latency=0.0021, dropped=3, rejected=1, local=True)
    text = Reader(sensors_html(status(sensors=(row,)), SensorColours())).text
    for figure in (
        "front (this machine)",
        "2 people",
        "30.0 Hz",
        "latency 2.1 ms",
        "4 dropped",
        "+12.3 ± 0.4 ms",
        "good",
    ):
        assert figure in text


MANY = {"frames": 60, "dropped": 40, "rejected": 0}
READY, GETTING_READY = status(), status(running=False, phase="stopped", reason="compiling the tracking method")


@pytest.mark.parametrize(
    ("session", "changes", "amber"),
    [
        (READY, MANY, True),
        (READY, {**MANY, "dropped": 3}, False),
        (GETTING_READY, MANY, False),
        (GETTING_READY, {**MANY, "rejected": 1}, True),
        (READY, {**MANY, "frames_before": 20, "dropped_before": 39}, False),
        (READY, {**MANY, "frames_before": 20, "dropped_before": 30}, True),
        (READY, {**MANY, "frames_before": 60, "dropped_before": 40}, False),
    ],
)
def test_many_drops_are_amber_from_the_begin_of_tracking_on_and_always_counted(session, changes, amber):
    row = health("front", **changes)
    html = sensors_html(dataclasses.replace(session, sensors=(row,)), SensorColours())
    assert (AMBER.css in html) == amber
    assert f"{row.dropped + row.rejected} dropped" in Reader(html).text


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"connected": False}, "gone"),
        ({"silent": True}, "silent"),
        ({"problem": "clock jumped", "connected": False}, "clock jumped"),
    ],
)
def test_what_is_wrong_with_a_sensor_is_said(changes, words):
    assert words in Reader(sensors_html(status(sensors=(health("front", **changes),)), SensorColours())).text


def test_what_is_not_known_yet_is_left_out_and_no_sensor_is_said():
    row = health("front", latency=None, clock_offset=None, clock_bound=None)
    text = Reader(sensors_html(status(sensors=(row,)), SensorColours())).text
    assert "latency" not in text
    assert "clock" not in text
    assert "No sensor yet." in Reader(sensors_html(None, SensorColours())).text


def test_the_drift_of_a_sensor_s_clock_is_shown_once_it_is_known_and_not_broken_into_lines():
    row = health("front", clock_drift_ppm=0.1, clock_drift_bound_ppm=9.27)
    for known, said in (
        (row, "clock +12.3 ± 0.4 ms · drift +0.1 ± 9.3 ppm"),
        (health("front"), "clock +12.3 ± 0.4 ms"),
    ):
        html = sensors_html(status(sensors=(known,)), SensorColours())
        assert said in Reader(html).text
        assert ("drift" in html) == ("drift" in said)
        for fact in said.split(" · "):
            assert "nowrap" in html[: html.index(fact)].rpartition("<")[2]


def test_the_recording_shows_its_name_its_size_and_its_losses():
    take = RecordingHealth(
        active=True, path="/takes/walk-3.mcap", frames=900, scenes=800, lost=2, size_bytes=3_400_000, seconds=75
    )
    text = Reader(recording_html(take)).text
    assert "Recording walk-3.mcap" in text
    assert "1:15 · 3.4 MB · 900 frames · 800 results · 2 lost" in text
    assert "Last: walk-3.mcap" in Reader(recording_html(dataclasses.replace(take, active=False))).text
    assert "no space" in Reader(recording_html(RecordingHealth(problem="no space"))).text
    assert "Not recording." in Reader(recording_html(RecordingHealth())).text
    unsaid = dataclasses.replace(take, active=False, unknown=(UnknownEnd("<front>", 7, 203),))
    assert "<front>: unknown after frame 203" in Reader(recording_html(unsaid)).text


def test_the_newest_notice_is_first_and_old_ones_go():
    text = Reader(notices_html(status(notices=tuple(f"notice {i}" for i in range(9))))).text
    assert text.startswith("notice 8")
    assert "notice 4" not in text
    assert "Nothing to report." in Reader(notices_html(status(notices=()))).text


def test_what_is_wrong_with_the_server_itself_is_shown() -> None:
    health = ServerHealth(
        errors={"frame: ValueError in <x>": 2}, turned_away={"commands": 5}, disk_free_bytes=1_500_000_000,
        reserve_bytes=1_000_000_000, ended=("part",),
    )  # fmt: skip
    text = Reader(notices_html(status(health=health))).text
    for said in ("2 unexpected errors; the first: frame: ValueError in <x>", "turned away: 5 commands",
                 "1.5 GB of disk are left; a recording stops at 1.0 GB", "the part has ended"):  # fmt: skip
        assert said in text
    well = ServerHealth(disk_free_bytes=2_000_000_000, reserve_bytes=1_000_000_000)
    assert well.problems() == ()


def test_the_study_is_named_as_text_and_leads_to_its_pages() -> None:
    assert study_html(None) == ""
    html = study_html(StudyStatus("Walking <about>", ("P01",)))
    assert "Walking &lt;about&gt;" in html
    assert "no participant yet" in html
    assert 'href="/study"' in html
    assert 'href="/participant"' in html
    assert "participant P01, running" in study_html(StudyStatus("t", ("P01",), "P01", phase="running"))
