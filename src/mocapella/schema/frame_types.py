"""The frame types that ship with Mocapella."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final, TypeVar

from mocapella.model.arms import ArmFrame
from mocapella.model.depth import DepthFrame
from mocapella.model.frame_types import FrameType
from mocapella.model.images import ImageFrame
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.markers import MarkerFrame
from mocapella.model.observations import BodyFrame
from mocapella.model.poses import PoseFrame
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.arms import arm_frame_of, encode_arm_frame
from mocapella.schema.body_frames import decode_body_frame, encode_body_frame
from mocapella.schema.checks import MAX_MESSAGE_BYTES, parse
from mocapella.schema.depth import depth_frame_of, encode_depth_frame
from mocapella.schema.envelope import protobuf_format
from mocapella.schema.images import encode_image_frame, image_frame_of
from mocapella.schema.keypoints import encode_keypoint_frame, keypoint_frame_of
from mocapella.schema.markers import encode_marker_frame, marker_frame_of
from mocapella.schema.poses import encode_pose_frame, pose_frame_of

T = TypeVar("T")


def _read(message: Any, frame_of: Callable[[Any], T], data: bytes) -> T:
    return frame_of(parse(message, data, MAX_MESSAGE_BYTES))


SKELETONS: Final = FrameType(
    interface=1, name="skeletons", type=BodyFrame, encode=encode_body_frame, decode=decode_body_frame,
    format=protobuf_format("BodyFrame"), field=7, counted=("person", "people"), lane="mocapella.viewer.lanes:SKELETONS",
)  # fmt: skip
MARKERS: Final = FrameType(
    interface=1, name="markers", type=MarkerFrame, encode=encode_marker_frame,
    decode=partial(_read, pb.MarkerFrame, marker_frame_of), format=protobuf_format("MarkerFrame"), field=20,
    counted=("marker", "markers"), lane="mocapella.viewer.lanes:MARKERS", pictures=True,
)  # fmt: skip
POSES: Final = FrameType(
    interface=1, name="poses", type=PoseFrame, encode=encode_pose_frame,
    decode=partial(_read, pb.PoseFrame, pose_frame_of), format=protobuf_format("PoseFrame"), field=40,
    counted=("body", "bodies"), pictures=True,
)  # fmt: skip
DEPTH: Final = FrameType(
    interface=1, name="depth", type=DepthFrame, encode=encode_depth_frame,
    decode=partial(_read, pb.DepthFrame, depth_frame_of), format=protobuf_format("DepthFrame"), field=60,
    shown="depth images", hint="`mocapella node arm` finds the arms in them and sends those, under a name of their own",
    history_frames=600,  # each takes a hundred times as much as other frames: twenty seconds at 30 a second
    depth_images=True,
)  # fmt: skip
ARMS: Final = FrameType(
    interface=1, name="arms", type=ArmFrame, encode=encode_arm_frame,
    decode=partial(_read, pb.ArmFrame, arm_frame_of), format=protobuf_format("ArmFrame"), field=80,
    counted=("arm", "arms"), lane="mocapella.viewer.lanes:ARMS",
)  # fmt: skip
IMAGES: Final = FrameType(
    interface=1, name="images", type=ImageFrame, encode=encode_image_frame,
    decode=partial(_read, pb.ImageFrame, image_frame_of), format=protobuf_format("ImageFrame"), field=90,
    lane="mocapella.viewer.lanes:IMAGES", pictures=True,
    resolver="mocapella.sources.referenced_images:ReferencedImages",
    history_frames=600,  # each takes a hundred times as much as other frames: twenty seconds at 30 a second
)  # fmt: skip
KEYPOINTS: Final = FrameType(
    interface=1, name="keypoints", type=KeypointFrame, encode=encode_keypoint_frame,
    decode=partial(_read, pb.KeypointFrame, keypoint_frame_of), format=protobuf_format("KeypointFrame"), field=70,
    counted=("person", "people"), lane="mocapella.viewer.lanes:KEYPOINTS", pictures=True,
)  # fmt: skip
