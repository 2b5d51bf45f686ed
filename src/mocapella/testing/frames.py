"""A small example of each frame type that Mocapella ships."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocapella.model.arms import ARM_POINTS, ArmFrame, SeenArm
from mocapella.model.depth import depth_frame
from mocapella.model.hand import ANGLES
from mocapella.model.images import image_frame
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.markers import marker_frame
from mocapella.model.observations import body_frame
from mocapella.model.poses import pose_frame
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import topology

_LENS = np.array([500.0, 500.0, 319.5, 239.5, 0.0, 0.0, 0.0, 0.0, 0.0])
_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000002000000020802000000fdd49a73"
    "0000000b49444154789c63608002000008000197a1a9980000000049454e44ae426082"
)


def example_frames(
    sensor: str = "front", *, node_id: int = 1, sequence: int = 0, time_ns: int = 1
) -> list[SensorFrame]:
    """Return one small frame of each type that Mocapella ships: bodies, markers, poses, depth, arms, image, keypoints.

    Their contents are arbitrary but valid. They serve to test codecs and programs that must handle every type.

    Args:
        sensor: name of the sensor, the same for all frames.
        node_id, sequence: id of the node and number of the frame, the same for all.
        time_ns: capture time, on the sensor's own clock.
    """
    kinect, coco = topology("kinect_v2"), topology("coco_17")
    points = np.linspace(0.0, 1.0, 3 * len(ARM_POINTS)).reshape(-1, 3)
    states = np.full(len(ARM_POINTS), 2, np.uint8)
    sd = np.full(len(ARM_POINTS), 0.003, np.float32)
    arm = SeenArm(7, True, 0.75, points, states, sd, np.zeros(len(ANGLES)), np.eye(4), "open", 0.5)
    common: dict[str, Any] = {"node_id": node_id, "sequence": sequence, "time_ns": time_ns}
    return [
        body_frame(sensor, kinect, positions=np.ones((2, len(kinect), 3)), **common),
        marker_frame(
            sensor, ("red", "blue"), size_px=(640, 480), positions_px=[(10.0, 20.0), (np.nan, np.nan)], **common
        ),
        pose_frame(sensor, "vr", ("wand",), positions=[(0.1, 1.2, 0.3)], orientations=[(1.0, 0.0, 0.0, 0.0)], **common),
        depth_frame(sensor, np.full((3, 4), 700, np.uint16), unit_m=0.001, lens=_LENS, **common),
        ArmFrame(sensor, node_id, sequence, time_ns, 0, (640, 480), _LENS, "default", (arm,)),
        image_frame(sensor, _PNG, format="png", size_px=(2, 2), **common),
        keypoint_frame(
            sensor, coco, size_px=(640, 480), positions_px=np.full((1, len(coco), 2), 99.0), confidences=0.75, **common
        ),
    ]
