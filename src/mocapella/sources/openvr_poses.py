"""Poses of a headset's trackers and controllers from OpenVR (SteamVR), through the optional package ``openvr``.

OpenVR's standing universe is right-handed, x right, y up, z to the back, in metres; a pose is the upper three rows of
``T_space_device``. A device's name is its serial number, which never changes.
"""

from __future__ import annotations

import importlib
from typing import Any, Final

import numpy as np

from mocapella.errors import SettingsError
from mocapella.model.poses import PoseFrame, pose_frame, quaternion_of

_NOT_FOLLOWED: Final = 4
"""`TrackedDeviceClass_TrackingReference`: a base station."""


class OpenVrPoses:
    """The devices of a running OpenVR (headset, controllers, trackers; not base stations). A context manager.

    The constructor connects to OpenVR; leaving the context disconnects.

    Args:
        sensor: name of the sensor, for the frames.
        space: name of the tracking system's coordinate system, for the frames.
        openvr: the package ``openvr``; imported if None.

    Attributes:
        sensor, space: as given.
        invalid: number of poses that OpenVR marked as invalid so far.

    Raises:
        SettingsError: the package is not installed, or OpenVR is not running; states a remedy.
    """

    def __init__(self, sensor: str, space: str, *, openvr: Any = None) -> None:
        self.sensor, self.space, self.invalid = sensor, space, 0
        self._openvr = openvr if openvr is not None else _package()
        try:
            self._system = self._openvr.init(self._openvr.VRApplication_Background)
        except self._openvr.OpenVRError as error:
            fix = "start SteamVR with the devices switched on, on this computer"
            raise SettingsError(f"no OpenVR runs here ({type(error).__name__}: {error}): {fix}") from error
        self._serials: dict[int, str] = {}

    def poll(self, at_ns: int) -> PoseFrame:
        """Read the newest poses of all connected devices, without prediction.

        A device with an invalid pose is in the frame as not tracked, with NaN; one that OpenVR does not report as
        running well is inferred. The frame has no bodies if no device is connected.

        Args:
            at_ns: the present time, which becomes the frame's capture time [ns].
        """
        vr = self._openvr
        poses = self._system.getDeviceToAbsoluteTrackingPose(
            vr.TrackingUniverseStanding, 0.0, vr.k_unMaxTrackedDeviceCount
        )
        found: dict[str, tuple[Any, Any, int]] = {}
        for k, pose in enumerate(poses):
            if not pose.bDeviceIsConnected or self._system.getTrackedDeviceClass(k) == _NOT_FOLLOWED:
                continue
            name = self._serial(k)
            if not pose.bPoseIsValid:
                self.invalid += 1
                found[name] = np.full(3, np.nan), np.full(4, np.nan), 0
                continue
            rows = pose.mDeviceToAbsoluteTracking
            T = np.array([[float(rows[i][j]) for j in range(4)] for i in range(3)])
            state = 2 if pose.eTrackingResult == vr.TrackingResult_Running_OK else 1
            found[name] = T[:, 3], quaternion_of(T[:, :3]), state
        p, q, states = zip(*found.values(), strict=True) if found else ((), (), ())
        return pose_frame(
            self.sensor, self.space, list(found), time_ns=at_ns, positions=np.reshape(p, (-1, 3)),
            orientations=np.reshape(q, (-1, 4)), states=np.array(states, dtype=int),
        )  # fmt: skip

    def _serial(self, device: int) -> str:
        if device not in self._serials:
            vr = self._openvr
            text = self._system.getStringTrackedDeviceProperty(device, vr.Prop_SerialNumber_String)
            serial = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
            self._serials[device] = serial[:80] or f"device {device}"
        return self._serials[device]

    def close(self) -> None:
        """Disconnect from OpenVR."""
        self._openvr.shutdown()

    def __enter__(self) -> OpenVrPoses:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _package() -> Any:
    try:
        return importlib.import_module("openvr")
    except ImportError as error:
        fix = "install it into the same environment (the extra openvr of mocapella)"
        raise SettingsError(f"the package openvr is not installed ({error}): {fix}") from error
