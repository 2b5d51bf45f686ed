"""Descriptor of the method ``hands`` (`mocapella.tracker.hands`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.hand_chain import hand_chain, palm_landmarks
from mocapella.kinematics.hand_tracker import base_layout
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.hand import TIPS, hand_model
from mocapella.model.hand_file import decode_hand_shape
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.model.observations import Arrival
from mocapella.model.poses import PoseFrame
from mocapella.model.session import SensorPose
from mocapella.settings import parse
from mocapella.tracker.hands import HandsSettings, HandsTracker
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import Tracker

_RATE_HZ: Final = 30
_SIZE: Final = (640, 480)
_LENS: Final = np.array([530.0, 530.0, 319.5, 239.5, -0.05, 0.0, 0.0, 0.0, 0.0])
_AT: Final = {"warm-up-0": -0.2, "warm-up-1": 0.0, "warm-up-2": 0.2}
"""Positions along x of cameras that look along z [m]."""
_RIG: Final = CameraRig(
    {
        name: PlacedCamera(Camera(name, _SIZE, _LENS), rigid(np.eye(3), (-x, 0.0, 0.5)), np.zeros((6, 6)))
        for name, x in _AT.items()
    }
)
_SETTINGS: Final = HandsSettings(base=("wrist", "index", "little"))


def _make(settings: Mapping[str, Any], sensors_expected: int, sensors: Mapping[str, SensorPose]) -> Tracker:
    values = dict(settings)
    rig, hand = values.pop("rig", None), values.pop("hand", None)
    if rig is None:
        fix = "mocapella serve --method hands --rig RIG.toml, or mocapella serve, and calibrate in the view"
        raise SettingsError(f"the method hands needs the poses of the cameras: {fix}")
    return HandsTracker(
        decode_camera_rig(str(rig)),
        parse(HandsSettings, values, where="settings of hands"),
        shape=None if hand is None else decode_hand_shape(str(hand).encode()),
        sensors_expected=max(sensors_expected, 2),
    )


def _practice() -> tuple[Tracker, Iterable[Arrival]]:
    return HandsTracker(_RIG, _SETTINGS), _hand()


def _hand() -> Iterator[Arrival]:
    """Yield frames of a hand that opens and closes before three cameras; one and then all of them lose it.

    It is found by three markers of its base, which calls more kernels than one does, and then followed by one.
    """
    settings = _SETTINGS
    model = hand_model(settings.constraints)
    shape = model.shape("right")
    chain, base = hand_chain(model, shape), base_layout(shape, len(settings.base))
    for k in range(round(2.0 * _RATE_HZ)):
        t = k / _RATE_HZ
        angles = model.limited(model.natural * (1.0 + 0.8 * np.sin(4.0 * t)))
        markers = np.concatenate([palm_landmarks(chain, angles)[list(TIPS)], base]) - [0.0, 0.0, 0.1]
        for i, (name, camera) in enumerate(_RIG.cameras.items()):
            px = project(apply(camera.T_camera_world, markers), _LENS)
            px[(i == 0) & (0.5 < t < 0.7) | (1.2 < t < 1.4)] = np.nan
            if t > 0.8:
                px[len(TIPS) + 1 :] = np.nan
            at_ns = round(1e9 * (t + 0.003 * i)) + 1
            frame = marker_frame(name, settings.markers, time_ns=at_ns, size_px=_SIZE, positions_px=px, sequence=k)
            yield Arrival(frame, at_ns)


METHOD: Final = Method(
    interface=1,
    name="hands",
    summary="hands with coloured markers on their fingertips, and objects, from two or more calibrated cameras",
    settings=HandsSettings,
    frame_types=(MarkerFrame, PoseFrame),
    parts=("hands", "objects", "points"),
    make=_make,
    warm_up_run=_practice,
    camera_rig="required",
    files={
        "rig": "mocapella.tracker.method_files:camera_rig",
        "hand": "mocapella.tracker.method_files:hand_shape",
        "alignment": "mocapella.tracker.method_files:spaces",
    },
    stages=("mocapella.viewer.stages:HANDS",),
)
"""Two settings in addition to `HandsSettings`: the texts ``rig`` of a camera rig file and ``hand`` of a hand file."""
