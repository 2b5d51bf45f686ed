"""OpenVR, by a fake of the package with the shapes of the real one."""

# ruff: noqa: N802 - names of the real package
from __future__ import annotations

import ctypes
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.schema import decode_frame, encode_frame
from mocapella.sources.openvr_poses import OpenVrPoses


class Matrix34(ctypes.Structure):
    """`HmdMatrix34_t`: rows are reached by index, as in the package."""

    _fields_ = (("m", ctypes.c_float * 4 * 3),)

    def __getitem__(self, row: int) -> Any:
        return self.m[row]


class Pose(ctypes.Structure):
    """`TrackedDevicePose_t`."""

    _fields_ = (
        ("mDeviceToAbsoluteTracking", Matrix34),
        ("eTrackingResult", ctypes.c_int),
        ("bPoseIsValid", ctypes.c_bool),
        ("bDeviceIsConnected", ctypes.c_bool),
    )


def pose(rows: Any, result: int = 200, valid: bool = True, connected: bool = True) -> Pose:
    made = Pose(eTrackingResult=result, bPoseIsValid=valid, bDeviceIsConnected=connected)
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            made.mDeviceToAbsoluteTracking.m[i][j] = value
    return made


QUARTER = [[0, 0, 1, 0.5], [0, 1, 0, 1.25], [-1, 0, 0, -2]]
STILL = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]


def fake(poses: list[Pose], runs: bool = True) -> Any:
    class OpenVRError(RuntimeError):
        pass

    classes, serials = [1, 4, 3, 3, 2], ["HMD-1", "LHB-9", "LHR-7", "LHR-8", ""]
    calls: list[Any] = []

    class System:
        def getDeviceToAbsoluteTrackingPose(self, origin: int, ahead_s: float, poses_wanted: Any) -> Any:
            calls.append((origin, ahead_s, poses_wanted))
            return (Pose * len(poses))(*poses)

        def getTrackedDeviceClass(self, device: int) -> int:
            return classes[device]

        def getStringTrackedDeviceProperty(self, device: int, prop: int) -> str:
            assert prop == 1002
            return serials[device]

    def init(application: int) -> System:
        assert application == 3
        if not runs:
            raise OpenVRError("VRInitError_Init_HmdNotFound")
        return System()

    return SimpleNamespace(
        init=init, shutdown=lambda: calls.append("shutdown"), OpenVRError=OpenVRError, VRApplication_Background=3,
        TrackingUniverseStanding=1, k_unMaxTrackedDeviceCount=64, Prop_SerialNumber_String=1002,
        TrackingResult_Running_OK=200, calls=calls,
    )  # fmt: skip


def test_devices_are_told_by_their_serial_numbers() -> None:
    vr = fake([
        pose(STILL), pose(STILL), pose(QUARTER), pose(STILL, valid=False), pose(QUARTER, result=201),
        pose(STILL, connected=False),
    ])  # fmt: skip
    with OpenVrPoses("openvr", "vr", openvr=vr) as source:
        frame = source.poll(5)
    assert vr.calls == [(1, 0.0, 64), "shutdown"]
    assert frame.names == ("HMD-1", "LHR-7", "LHR-8", "device 4")  # no base station
    assert frame.states.tolist() == [2, 2, 0, 1]
    T = frame.T_space_body("LHR-7")
    assert T is not None
    np.testing.assert_allclose(T[:3], QUARTER, atol=1e-6)
    assert frame.T_space_body("LHR-8") is None
    assert source.invalid == 1
    decode_frame(encode_frame(frame))


def test_without_devices_there_is_a_frame_without_bodies() -> None:
    frame = OpenVrPoses("openvr", "vr", openvr=fake([])).poll(1)
    assert (frame.names, frame.positions.shape) == ((), (0, 3))
    decode_frame(encode_frame(frame))


def test_without_steamvr_or_the_package_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingsError, match=r"no OpenVR runs here \(OpenVRError: .*HmdNotFound\): start SteamVR"):
        OpenVrPoses("openvr", "vr", openvr=fake([], runs=False))
    monkeypatch.setitem(sys.modules, "openvr", None)
    with pytest.raises(SettingsError, match="the package openvr is not installed"):
        OpenVrPoses("openvr", "vr")
