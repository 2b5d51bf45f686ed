"""Descriptor of the method ``one-webcam`` (`mocapella.tracker.one_webcam`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from mocapella.errors import SettingsError
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.observations import Arrival
from mocapella.model.session import SensorPose
from mocapella.model.topology import topology
from mocapella.settings import parse
from mocapella.tracker.method import Method
from mocapella.tracker.one_webcam import OneWebcamSettings, OneWebcamTracker
from mocapella.tracker.protocol import Tracker


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = dict(settings)
    rig = values.pop("rig", None)
    own = parse(OneWebcamSettings, values, where="settings of one-webcam")
    if rig is None:
        return OneWebcamTracker(own)
    cameras = list(decode_camera_rig(str(rig)).cameras.values())
    if len(cameras) != 1:
        raise SettingsError(f"the rig has {len(cameras)} cameras; the method webcams tracks with two or more")
    return OneWebcamTracker(own, np.array(cameras[0].camera.lens, np.float64))


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    kind = topology("mediapipe_pose")
    body = np.random.default_rng(1).uniform(-0.5, 0.5, (1, len(kind), 3))
    seen = 320 + 500 * body[..., :2] / (3 + body[..., 2:])
    arrivals = []
    for k in range(3):
        at_ns = 1 + 33_000_000 * k
        frame = keypoint_frame(
            "warm-up", kind, time_ns=at_ns, size_px=(640, 640), positions_px=seen, relative=body, sequence=k
        )
        arrivals.append(Arrival(frame, at_ns))
    return OneWebcamTracker(), arrivals


METHOD: Final = Method(
    interface=1,
    name="one-webcam",
    summary="people before a single webcam: distances are inferred from their height, nothing is measured",
    settings=OneWebcamSettings,
    frame_types=(KeypointFrame,),
    parts=("people",),
    make=_make,
    warm_up_run=_practice,
    kernels=4,
    camera_rig="optional",
    files={"rig": "mocapella.tracker.method_files:camera_rig"},
)
"""A setting in addition to `OneWebcamSettings`: the text ``rig`` of a camera rig file with one camera, for its lens."""
