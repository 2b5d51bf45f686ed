"""Laws of the session: what commands do, and that its memory is all that it is."""

from __future__ import annotations

import base64
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.calibration.sensor_layout import VERSION, SensorLayout, decode_layout, encode_layout
from mocapella.errors import MocapellaError, NotNowError, SettingsError, WireError
from mocapella.geometry.rigid import rigid
from mocapella.live.session import Session
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase
from mocapella.model.session import Setup
from mocapella.schema import encode_scene
from mocapella.sources.simulate import SimulatedSensor, load_scene, merge


@cache
def arrivals() -> list[Arrival]:
    """Two people before three sensors, who stand, are calibrated, walk, and are lost."""
    room = load_scene("obstacle")
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names]
    return [Arrival(item.frame, int(item.due_s * 1e9)) for item in merge(sensors, 0.0, 14.0)]


def new() -> Session:
    return Session(Setup("stand-still", sensors_expected=3))


@pytest.mark.slow
@given(at=st.integers(0, 1250))
@settings(max_examples=6, deadline=None)
def test_a_session_that_restores_another_goes_on_alike_to_the_bit(at: int) -> None:
    first, second = new(), new()
    for arrival in arrivals()[:at]:
        first.step(arrival)
    second.carry_out("restore", first.memory())
    for arrival in arrivals()[at:]:
        one, other = first.step(arrival), second.step(arrival)
        assert one is not None
        assert other is not None
        assert encode_scene(one) == encode_scene(other)


def test_the_scenes_of_this_test_are_worth_comparing() -> None:
    session = new()
    phases = {scene.state.phase for arrival in arrivals() if (scene := session.step(arrival)) is not None}
    assert {Phase.WAITING_FOR_SENSORS, Phase.CALIBRATING, Phase.TRACKING} <= phases


@pytest.mark.parametrize("data", ["", "AAAA", "kpE="])
def test_a_memory_that_is_none_is_refused(data: str) -> None:
    with pytest.raises(WireError, match="no memory of this tracker"):
        new().carry_out("restore", {"tracker": data})


@pytest.mark.parametrize("method", ["default", "stand-still", "arms"])
def test_a_damaged_memory_leaves_a_tracker_that_takes_the_next_one(method: str) -> None:
    """It must not replace what neither a reset nor a later memory sets again."""
    session = Session(Setup(method, sensors_expected=2))
    good = session.memory()
    raw = msgspec.msgpack.decode(base64.b64decode(good["tracker"]))
    own = raw[1][0]
    assert own[0] == "dict"
    for name in vars(session._tracker).keys() - {key for key, _ in own[1]}:
        bad = [raw[0], [["dict", [*own[1], [name, 5]]], *raw[1][1:]]]
        text = base64.b64encode(msgspec.msgpack.encode(bad)).decode()
        with pytest.raises(WireError, match="no memory of this tracker"):
            session.carry_out("restore", {**good, "tracker": text})
        session.carry_out("restore", good)
    assert session.memory() == good


@pytest.mark.parametrize("damage", [{"tracker": "AAAA"}, {"names": {"first": "Ada"}}, {"rig": "{}"}])
def test_a_memory_that_is_refused_changes_nothing(damage: dict[str, object]) -> None:
    session, other = new(), new()
    before = session.memory()
    for arrival in arrivals()[:100]:
        other.step(arrival)
    layout = encode_layout(SensorLayout(VERSION, True, {}, [])).decode()
    memory = {**other.memory(), "names": {"1": "Ada"}, "rig": layout}
    with pytest.raises(WireError):
        session.carry_out("restore", {**memory, **damage})
    assert session.memory() == before
    session.carry_out("restore", memory)
    assert session.memory() == memory


def test_stop_and_start_begin_anew() -> None:
    session = new()
    session.step(arrivals()[0])
    with pytest.raises(NotNowError, match="stop first"):
        session.carry_out("start", {})
    session.carry_out("stop", {})
    assert session.state.phase == Phase.STOPPED
    assert session.step(arrivals()[1]) is None
    for verb in ("stop", "recalibrate"):
        with pytest.raises(NotNowError, match="start first"):
            session.carry_out(verb, {})
    session.carry_out("start", {})
    assert session.next_step == 0
    scene = session.step(arrivals()[2])
    assert scene is not None
    assert scene.step == 0


def test_frames_that_the_tracker_cannot_use_are_counted_by_the_reason() -> None:
    session = new()
    first = arrivals()[0]
    session.step(first)
    assert session.unusable == {}
    session.step(first)
    assert session.unusable == {"repeats the time of the frame before": 1}


def test_recalibrating_says_why() -> None:
    session = new()
    for arrival in arrivals()[:700]:
        session.step(arrival)
    assert session.state.phase == Phase.TRACKING
    session.carry_out("recalibrate", {})
    scene = session.step(arrivals()[700])
    assert scene is not None
    assert scene.state.phase == Phase.CALIBRATING
    assert scene.state.reason == "asked for"


def test_unknown_commands_and_settings_are_refused_with_a_suggestion() -> None:
    with pytest.raises(SettingsError, match="did you mean recalibrate"):
        new().carry_out("recalibrat", {})
    with pytest.raises(SettingsError, match="did you mean sensors_expected"):
        new().carry_out("setup", {"sensors_expcted": 2})
    with pytest.raises(SettingsError, match="placement"):
        new().carry_out("setup", {"placement": "diagonal"})
    with pytest.raises(SettingsError, match="stand-still"):
        new().carry_out("setup", {"method": "stand-stil"})


def test_a_refused_setup_changes_nothing() -> None:
    session = new()
    with pytest.raises(SettingsError):
        session.carry_out("setup", {"method": "magic", "sensors_expected": 7})
    assert session.setup == Setup("stand-still", sensors_expected=3)


@pytest.mark.slow
def test_a_layout_is_used_by_every_new_tracker_and_kept_in_the_memory_until_somebody_recalibrates() -> None:
    walked = Session(Setup(method="default", sensors_expected=3))
    assert walked.layout_now() is None
    for arrival in arrivals():
        walked.step(arrival)
    layout = walked.layout_now()
    assert layout is not None
    assert len(layout.sensors) == 3
    session = Session(Setup(method="default", sensors_expected=3), layout=layout)
    for verb in ("stop", "start"):
        session.carry_out(verb, {})
    other = Session(Setup(method="default", sensors_expected=3))
    assert decode_layout(session.memory()["rig"].encode()) == layout  # the key that takes hold
    other.carry_out("restore", session.memory())
    assert other.layout == layout
    for arrival in arrivals()[:120]:  # everybody stands: nothing but the layout can know
        one, same = session.step(arrival), other.step(arrival)
        assert one is not None
        assert same is not None
        assert encode_scene(one) == encode_scene(same)
    assert one.state.phase == Phase.TRACKING
    for each in (session, other):
        each.carry_out("recalibrate", {})
        assert each.layout is None
        assert "rig" not in each.memory()


def test_a_layout_is_refused_by_a_method_that_keeps_none() -> None:
    with pytest.raises(SettingsError, match="'stand-still' keeps no sensor layout; methods that do: arms, default"):
        Session(Setup("stand-still"), layout=SensorLayout(1, False, {}, []))
    assert new().layout_now() is None


def people_named(session: Session, arrival: Arrival) -> dict[int, str]:
    scene = session.step(arrival)
    assert scene is not None
    return {person.id: person.name for person in scene.people}


def test_a_name_stays_with_the_number_is_remembered_and_is_taken_away_by_an_empty_one() -> None:
    session = new()
    for arrival in arrivals()[:700]:
        session.step(arrival)
    assert people_named(session, arrivals()[700]) == {0: "", 1: ""}
    assert session.carry_out("name", {"person": 1, "name": "Ada"}) == "person 1 is called Ada"
    assert people_named(session, arrivals()[701]) == {0: "", 1: "Ada"}
    other = new()
    other.carry_out("restore", session.memory())
    assert people_named(other, arrivals()[702]) == {0: "", 1: "Ada"}
    session.carry_out("name", {"person": 1, "name": ""})
    assert people_named(session, arrivals()[702]) == {0: "", 1: ""}
    session.carry_out("name", {"person": 0, "name": "Grace"})
    session.carry_out("recalibrate", {})
    assert session.names == {0: "Grace"}


def test_a_new_tracker_numbers_people_anew_and_nobody_has_a_name() -> None:
    session = new()
    for anew in (["stop", "start"], ["setup"]):
        session.carry_out("name", {"person": 0, "name": "Ada"})
        for verb in anew:
            session.carry_out(verb, {})
        assert session.names == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"person": -1, "name": "Ada"}, "person is -1; it must be a person's number"),
        ({"person": 2**64, "name": "Ada"}, "person is 18446744073709551616"),
        ({"person": "1", "name": "Ada"}, "name: .*int"),
        ({"person": 1}, "name"),
        ({"person": 1, "nam": "Ada"}, "did you mean name"),
        ({"person": 1, "name": "a\nb"}, "on one line"),
        ({"person": 1, "name": " Ada"}, "without space around"),
        ({"person": 1, "name": "a" * 41}, "up to 40 characters"),
        ({"person": 1, "name": "\ud800"}, "up to 40 characters on one line"),
    ],
)
def test_a_name_that_cannot_be_shown_is_refused(arguments: dict[str, object], message: str) -> None:
    session = new()
    with pytest.raises(SettingsError, match=message):
        session.carry_out("name", arguments)
    assert session.names == {}


def test_while_stopped_nobody_can_be_named() -> None:
    session = Session(Setup(), running=False)
    with pytest.raises(NotNowError, match="start first"):
        session.carry_out("name", {"person": 1, "name": "Ada"})


def rig_text(*names: str) -> str:
    """A rig of cameras that stand side by side."""
    lens = np.array([500.0, 500, 320, 240, 0, 0, 0, 0, 0])
    placed = {
        name: PlacedCamera(Camera(name, (640, 480), lens), rigid(np.eye(3), np.array([-0.1 * k, 0, 0])), np.eye(6))
        for k, name in enumerate(names)
    }
    return encode_camera_rig(CameraRig(placed))


def test_a_rig_begins_the_tracking_of_hands_and_stays_while_another_method_is_set_up() -> None:
    session = Session(Setup("stand-still", participant=7), {"frames": 60})
    text = rig_text("left", "right", "top")
    assert session.carry_out("use-rig", {"rig": text}) == "tracking hands with left, right, top"
    assert (session.setup.method, session.setup.sensors_expected, session.setup.participant) == ("hands", 3, 7)
    assert session.method_settings == {"rig": text}
    session.carry_out("setup", {"method": "stand-still"})
    assert session.method_settings == {"frames": 60}
    session.carry_out("setup", {"method": "hands"})
    assert session.method_settings == {"rig": text}


def test_a_rig_that_cannot_be_used_changes_nothing() -> None:
    session = Session(Setup())
    for arguments, says in (
        ({}, "rig"),
        ({"rig": 1}, "rig"),
        ({"rig": "no = 'rig'"}, "holds no cameras"),
        ({"rig": rig_text("a", "b"), "hand": "x"}, "unknown key 'hand'"),
    ):
        with pytest.raises(MocapellaError, match=says):
            session.carry_out("use-rig", arguments)
    assert (session.setup, session.method_settings) == (Setup(), {})
