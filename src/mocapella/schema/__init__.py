"""Encode and decode all protobuf messages of Mocapella: frames, scenes and ground truths.

It is a package of its own because the wire and the recording need it, and neither may import the other.
"""

from mocapella.conventions import SCHEMA_VERSION
from mocapella.schema.checks import MAX_BODIES, MAX_MESSAGE_BYTES, MAX_SCENE_BYTES
from mocapella.schema.frames import decode_frame, encode_frame, format_of
from mocapella.schema.scenes import SceneEncoder, decode_scene, decode_truth, encode_scene, encode_truth

__all__ = [
    "MAX_BODIES",
    "MAX_MESSAGE_BYTES",
    "MAX_SCENE_BYTES",
    "SCHEMA_VERSION",
    "SceneEncoder",
    "decode_frame",
    "decode_scene",
    "decode_truth",
    "encode_frame",
    "encode_scene",
    "encode_truth",
    "format_of",
]
