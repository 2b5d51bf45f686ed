"""What the codec does where the laws of its round trips do not lead."""

from __future__ import annotations

import numpy as np
import pytest
from support.messages import small_scene

from mocapella.decoding import DEEPEST, decode_json, own_toml
from mocapella.errors import WireError
from mocapella.model.part_types import PART_TYPES
from mocapella.schema import decode_scene, encode_frame, encode_scene, format_of, frames
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.bodies import MAX_BUILD, MAX_VIEWS, decode_body
from mocapella.schema.body_frames import decode_body_frame
from mocapella.schema.envelope import ENVELOPE, protobuf_format, seal, unseal
from mocapella.testing.frames import example_frames


def test_a_frame_of_skeletons_is_read_without_a_look_at_its_type() -> None:
    frame = next(one for one in example_frames() if type(one).__name__ == "BodyFrame")
    data = encode_frame(frame)
    assert encode_frame(decode_body_frame(data)) == data
    with pytest.raises(WireError):
        decode_body_frame(data[:-1])


def test_a_body_with_too_long_a_build_is_refused() -> None:
    with pytest.raises(WireError, match=r"Body\.build has"):
        decode_body(pb.Body(build="x" * (MAX_BUILD + 1)))


def test_a_body_seen_by_too_many_cameras_is_refused() -> None:
    body = pb.Body()
    for _ in range(MAX_VIEWS + 1):
        body.views.add()
    with pytest.raises(WireError, match=r"Body\.views has"):
        decode_body(body)


def test_what_is_sealed_comes_back() -> None:
    frame = example_frames()[0]
    data = seal(frame, "thermal", b"content")
    assert unseal(data) == ((frame.sensor, *frame.key[1:], frame.time_ns, frame.sent_ns), b"content")
    assert format_of(data) is ENVELOPE


def test_a_message_without_topology_and_type_has_the_format_of_skeletons() -> None:
    assert format_of(pb.BodyFrame(schema_version=1, sensor="front").SerializeToString()) == protobuf_format("BodyFrame")


def test_a_protobuf_library_that_hides_unknown_fields_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def hides(message: object) -> object:
        raise NotImplementedError("upb of 4.25")

    monkeypatch.setattr(frames, "UnknownFieldSet", hides)
    with pytest.raises(WireError, match=r"upb of 4\.25.*install another"):
        format_of(pb.BodyFrame(schema_version=1, sensor="front").SerializeToString())


@pytest.mark.parametrize("value", [-0.1, np.inf])
@pytest.mark.parametrize("name", ["position_sd_m", "rotation_sd_rad"])
def test_a_sensors_place_with_an_impossible_error_is_refused(name: str, value: float) -> None:
    message = pb.Scene.FromString(encode_scene(small_scene()))
    place = message.sensors.add(sensor="front")
    setattr(place, name, value)
    with pytest.raises(WireError, match=name):
        decode_scene(message.SerializeToString())


def test_a_hand_is_there_if_any_landmark_is() -> None:
    class Hand:
        landmarks = np.full((2, 3), np.nan)

    assert not PART_TYPES["hands"].there(Hand)
    Hand.landmarks = np.array([[np.nan, np.nan, np.nan], [0.0, 1.0, 2.0]])
    assert PART_TYPES["hands"].there(Hand)


def test_a_part_type_of_a_plug_in_travels_in_an_envelope(monkeypatch: pytest.MonkeyPatch) -> None:
    class Kind:
        field = ""

        @staticmethod
        def encode(part: str) -> bytes:
            return part.encode()

    monkeypatch.setattr("mocapella.schema.scenes.PART_TYPES", {"spots": Kind})
    from mocapella.schema.people import encode_anew
    from mocapella.schema.scenes import _encode_parts

    (written,) = _encode_parts({"spots": ("a spot",)}, encode_anew)["parts"]
    assert (written.kind, written.content) == ("spots", b"a spot")


def test_json_may_be_as_deep_as_the_limit_with_more_brackets_than_that() -> None:
    text = b"[" * (DEEPEST - 1) + b"[],[]" + b"]" * (DEEPEST - 1)
    assert str(decode_json(text)).count("[]") == 2


def test_a_file_of_this_program_is_read() -> None:
    assert own_toml("mocapella.sources.simulate", "data", "depth_scenes.toml")["scenes"]
