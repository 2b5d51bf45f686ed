"""Scenes and truths: what goes in comes out, and whatever is not ours is refused with the reason."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.messages import small_scene

from mocapella.errors import SchemaVersionError, WireError
from mocapella.model.limits import COORDINATE
from mocapella.model.scene import Phase, PotentialSkeleton, Scene, SensorPlace, TrackerState
from mocapella.model.topology import topology
from mocapella.model.truth import Truth
from mocapella.schema import MAX_SCENE_BYTES, SceneEncoder, decode_scene, decode_truth, encode_scene, encode_truth
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.people import encode_view


def assert_same(a: Any, b: Any) -> None:
    """Equal to the bit, through nested values."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, strict=True)
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            assert_same(left, right)
    elif isinstance(a, dict):  # of parts; of a type that has none, nothing is written
        there, back = ({name: some for name, some in one.items() if some} for one in (a, b))
        assert there.keys() == back.keys()
        for name, some in there.items():
            assert_same(some, back[name])
    elif isinstance(a, msgspec.Struct):
        for name in a.__struct_fields__:
            assert_same(getattr(a, name), getattr(b, name))
    else:
        assert a == b or (isinstance(a, float) and np.isnan(a) and np.isnan(b))  # NaN is NaN


def small_truth(people: int = 2, bodies: int = 3) -> Truth:
    kind = topology("kinect_v1")
    positions = np.arange(people * 20 * 3, dtype=np.float64).reshape(people, 20, 3)
    body_people = np.arange(bodies) % max(people, 1)
    return Truth("front", 3, -4, kind, np.arange(people), positions, np.eye(4), body_people, np.ones(bodies, np.bool_))


@given(st.integers(0, 4), st.sampled_from(Phase), st.text(max_size=20).filter(str.isprintable))
@settings(max_examples=30)
def test_a_scene_comes_back_as_it_was(people: int, phase: Phase, reason: str) -> None:
    scene = msgspec.structs.replace(small_scene(people), state=TrackerState(phase, 4, 5, 6, reason))
    data = encode_scene(scene)
    assert_same(scene, decode_scene(data))
    assert encode_scene(decode_scene(data)) == data


@given(st.lists(st.sets(st.sampled_from(["place", "view", "person"])), min_size=1, max_size=8))
@settings(max_examples=30)
def test_an_encoder_of_successive_scenes_writes_each_as_it_is_written_alone(changes: list[set[str]]) -> None:
    """Whatever the next scene has anew, or has as the same object, the bytes are those of the scene."""
    encoder, scene = SceneEncoder(), small_scene(2)
    assert encoder.encode(scene) == encode_scene(scene)
    for step, change in enumerate(changes):
        (one, *others), places = scene.people, scene.sensors
        if "view" in change:
            view = msgspec.structs.replace(one.views[0], time_ns=step, positions=one.views[0].positions + step)
            one = msgspec.structs.replace(one, views=(view, *one.views[1:]))
        if "person" in change:
            one = msgspec.structs.replace(one, positions=one.positions + step, views=one.views[::-1])
        if "place" in change:
            places = (*places[1:], SensorPlace(f"new {step}", None))
        scene = msgspec.structs.replace(
            scene, step=step, parts={**scene.parts, "people": (one, *others)}, sensors=places
        )
        assert encoder.encode(scene) == encode_scene(scene)


def test_an_encoder_writes_what_stays_once_and_forgets_what_the_last_scene_had_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    written: list[str] = []

    def noted(view: PotentialSkeleton) -> Any:
        written.append(view.sensor)
        return encode_view(view)

    monkeypatch.setattr("mocapella.schema.people.encode_view", noted)
    encoder, scene = SceneEncoder(), small_scene(1)
    nobody = msgspec.structs.replace(scene, parts={})
    for one in (scene, scene, nobody, scene):
        encoder.encode(one)
    views = [view.sensor for view in scene.people[0].views]
    assert views
    assert written == 2 * views


@given(st.integers(0, 3), st.integers(0, 3))
@settings(max_examples=10)
def test_a_truth_comes_back_as_it_was(people: int, bodies: int) -> None:
    truth = small_truth(people, bodies)
    assert_same(truth, decode_truth(encode_truth(truth)))


def of_scene(change: str, value: Any) -> bytes:
    """A scene with one field changed; ``people.0.id`` is the id of its first person."""
    m: Any = pb.Scene.FromString(encode_scene(small_scene()))
    _set(m, change, value)
    return m.SerializeToString()  # type: ignore[no-any-return]


def of_truth(change: str, value: Any) -> bytes:
    m: Any = pb.Truth.FromString(encode_truth(small_truth()))
    _set(m, change, value)
    return m.SerializeToString()  # type: ignore[no-any-return]


def _set(m: Any, change: str, value: Any) -> None:
    *path, last = change.split(".")
    for part in path:
        m = m[int(part)] if part.isdigit() else getattr(m, part)
    setattr(m, last, value)


def packed(*values: float) -> bytes:
    return np.array(values, "<f8").tobytes()


FAR = packed(*[0.0] * 74, 1.5e6)
MIRROR = packed(-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)
STRETCH = packed(1, 0, 0, 0, 0, 1.01, 0, 0, 0, 0, 1, 0)
NOWHERE = packed(1, 0, 0, np.nan, 0, 1, 0, 0, 0, 0, 1, 0)
AWAY = packed(1, 0, 0, 0, 0, 1, 0, 1.001e6, 0, 0, 1, 0)


@pytest.mark.parametrize(
    ("change", "value", "parts"),
    [
        ("topology", "kinect", ["topology is 'kinect'", "kinect_v2"]),
        ("sensor", "no name", ["sensor name 'no name'"]),
        ("phase", "trakcing", ["Scene.phase is 'trakcing'", "did you mean tracking?"]),
        ("phase", "x" * 100_000, ["Scene.phase is 'xxx"]),
        ("people.0.positions_m", b"\0" * 8, ["Person.positions_m has 8 bytes", "want 600"]),
        ("people.0.positions_m", FAR, ["Person.positions_m has a 1.5e+06", "±1e+06"]),
        ("people.0.positions_m", packed(*[np.inf] * 75), ["Person.positions_m has a inf"]),
        ("people.0.joint_states", b"\2" * 24, ["Person.joint_states has 24 bytes"]),
        ("people.0.joint_states", b"\2" * 24 + b"\3", ["Person.joint_states has a 3", "0, 1 or 2"]),
        ("people.0.views.1.sensor", "", ["sensor name ''"]),
        ("people.0.views.1.tilt_rad", 4.0, ["PotentialSkeleton.tilt_rad is 4"]),
        ("people.0.views.1.height_m", np.inf, ["PotentialSkeleton", "height_m inf"]),
        ("people.0.views.1.T_world_sensor", b"", ["PotentialSkeleton.T_world_sensor has 0 bytes", "want 96"]),
        ("people.0.views.1.T_world_sensor", MIRROR, ["T_world_sensor is no rigid motion"]),
        ("people.0.views.1.T_world_sensor", STRETCH, ["T_world_sensor is no rigid motion"]),
        ("people.0.views.1.T_world_sensor", NOWHERE, ["T_world_sensor is no rigid motion"]),
        ("people.0.views.1.T_world_sensor", AWAY, ["T_world_sensor is no rigid motion"]),
        ("people.0.views.1.positions_m", FAR, ["PotentialSkeleton.positions_m has a 1.5e+06"]),
        ("people.0.views.1.joint_states", b"\7" * 25, ["PotentialSkeleton.joint_states has a 7"]),
    ],
)
def test_a_scene_that_is_none_is_refused(change: str, value: Any, parts: list[str]) -> None:
    with pytest.raises(WireError) as caught:
        decode_scene(of_scene(change, value))
    assert len(str(caught.value)) < 400
    for part in parts:
        assert part in str(caught.value)


def test_results_may_lie_beyond_the_limits_of_frames() -> None:
    """A point at 1000 m before a sensor at 1000 m above the floor is further away, and predictions go on."""
    far = packed(*[0.0] * 74, 1.5 * COORDINATE.high)
    assert decode_scene(of_scene("people.0.positions_m", far)).people[0].positions[24, 2] == 1500.0
    away = packed(1, 0, 0, 0, 0, 1, 0, 1500.0, 0, 0, 1, 0)
    assert (
        decode_scene(of_scene("people.0.views.1.T_world_sensor", away)).people[0].views[1].T_world_sensor[1, 3] == 1500
    )


@pytest.mark.parametrize(
    ("change", "value", "parts"),
    [
        ("topology", "", ["topology is ''"]),
        ("sensor", "-front", ["sensor name '-front'"]),
        ("people", b"\0" * 15, ["Truth.people has 15 bytes"]),
        ("people", b"\0" * 24, ["Truth.positions_m has 960 bytes", "want 1440"]),
        ("positions_m", packed(*[np.inf] * 120), ["Truth.positions_m has a inf"]),
        ("T_world_sensor", MIRROR, ["Truth.T_world_sensor is no rigid motion"]),
        ("body_people", b"\0" * 8, ["Truth.body_people has 8 bytes", "want 24"]),
        ("mirrored", b"\0\1\2", ["Truth.mirrored has a 2", "0 or 1"]),
    ],
)
def test_a_truth_that_is_none_is_refused(change: str, value: Any, parts: list[str]) -> None:
    with pytest.raises(WireError) as caught:
        decode_truth(of_truth(change, value))
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(("decode", "of"), [(decode_scene, of_scene), (decode_truth, of_truth)])
def test_another_version_is_refused(decode: Any, of: Any) -> None:
    with pytest.raises(SchemaVersionError, match="version 9; this program reads version 1"):
        decode(of("schema_version", 9))


@pytest.mark.parametrize("decode", [decode_scene, decode_truth])
def test_too_long_a_message_is_refused(decode: Any) -> None:
    with pytest.raises(WireError, match=f"at most {MAX_SCENE_BYTES} are read"):
        decode(b"\0" * (MAX_SCENE_BYTES + 1))


def test_a_newer_minor_version_may_add_fields() -> None:
    scene = small_scene()
    assert_same(scene, decode_scene(encode_scene(scene) + b"\xa2\x06\x05hello"))


@given(st.binary(max_size=300))
@settings(max_examples=150)
def test_bytes_that_are_not_ours_are_refused(data: bytes) -> None:
    for decode in (decode_scene, decode_truth):
        with pytest.raises(WireError):
            decode(data)


SCENE = encode_scene(small_scene())
TRUTH = encode_truth(small_truth())


@given(st.data())
@settings(max_examples=150)
def test_damaged_ones_are_refused_or_read(data: st.DataObject) -> None:
    whole, decode = data.draw(st.sampled_from([(SCENE, decode_scene), (TRUTH, decode_truth)]))
    damaged = bytearray(whole)
    for place in data.draw(st.lists(st.integers(0, len(damaged) - 1), min_size=1, max_size=4)):
        damaged[place] = data.draw(st.integers(0, 255))
    try:
        value = decode(bytes(damaged))
    except WireError:
        return
    assert isinstance(value, Scene | Truth)
