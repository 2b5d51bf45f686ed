"""Frames and parts of types that no installed package reads are kept to the byte."""

from __future__ import annotations

from collections import Counter

import msgspec
from hypothesis import given
from hypothesis import strategies as st
from support.messages import small_scene

from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import UnknownPart
from mocapella.model.sensor_frame import UnknownFrame
from mocapella.schema import decode_frame, decode_scene, encode_frame, encode_scene, format_of
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.envelope import ENVELOPE
from mocapella.schema.scenes import count_parts

NAMES = st.text(min_size=1, max_size=20)
KINDS = NAMES.filter(lambda name: name not in PART_TYPES)
CONTENTS = st.lists(st.binary(max_size=60), min_size=1, max_size=3)


@given(st.dictionaries(KINDS, CONTENTS, max_size=4), st.integers(0, 2))
def test_a_scene_with_unknown_parts_is_written_again_to_the_byte(parts: dict[str, list[bytes]], people: int) -> None:
    known = small_scene(people)
    unknown = {kind: tuple(UnknownPart(kind, content) for content in some) for kind, some in parts.items()}
    scene = msgspec.structs.replace(known, parts={**known.parts, **unknown})
    data = encode_scene(scene)
    again = decode_scene(data)
    assert {kind: again.parts[kind] for kind in unknown} == unknown
    assert encode_scene(again) == data
    counts = {name: len(some) for name, some in scene.parts.items() if some}
    found = Counter[str]()
    count_parts(pb.Scene.FromString(data), found)
    assert dict(found) == counts


@given(NAMES.filter(lambda name: name not in FRAME_TYPES), st.binary(max_size=60), st.integers(0, 2**64 - 1))
def test_an_unknown_frame_is_written_again_to_the_byte(kind: str, content: bytes, node_id: int) -> None:
    frame = UnknownFrame("roof", node_id, 3, 4, 5, kind, content)
    data = encode_frame(frame)
    again = decode_frame(data)
    assert again.kind == kind
    assert again.content == content
    assert again.key == frame.key
    assert encode_frame(again) == data
    assert format_of(data) is ENVELOPE
