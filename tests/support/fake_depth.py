"""Depth cameras behind the interfaces of their packages, with a plug that can be pulled."""

# ruff: noqa: N802, N818 - names of the real packages

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import numpy as np

SIZE = (8, 6)


class FakeCamera:
    """What stays when it is closed and opened again; makes an image whenever it is asked.

    Args:
        unit: what its package says of a unit, in the package's own terms.
    """

    def __init__(self, unit: Any = None) -> None:
        self.unit, self.plugged = unit, True
        self.started = self.stopped = self.frames = 0
        self.asked: dict[str, Any] = {}

    def image(self) -> np.ndarray:
        """The next one: its pixels count from its number, which begins anew with all that is in 16 bits."""
        self.frames += 1
        return (np.arange(SIZE[0] * SIZE[1]) + 700 + self.frames).astype(np.uint16).reshape(SIZE[1], SIZE[0])

    def colour(self) -> np.ndarray:
        """The colour image of the newest depth image, red, green, blue: red is its number."""
        image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
        image[..., 0], image[..., 1] = self.frames % 256, 7
        return image

    @property
    def stamp_ms(self) -> float:
        """Of the newest image, on a clock of the camera's own: 30 a second from 5 s."""
        return 5000 + 1e3 * self.frames / 30


def openni2(camera: FakeCamera, *, mirrored: bool = True, stays_mirrored: bool = False, can_mirror: bool = True,
            registers: bool = True) -> Any:  # fmt: skip
    """``openni.openni2``."""

    class OpenNIError(Exception):
        pass

    class Stream:
        def __init__(self, of_colour: bool = False) -> None:
            self.mirrored, self.of_colour = mirrored, of_colour
            pixels = 200 if of_colour else camera.unit
            self.mode = SimpleNamespace(resolutionX=SIZE[0], resolutionY=SIZE[1], fps=30, pixelFormat=pixels)

        def get_video_mode(self) -> Any:
            return self.mode

        def configure_mode(self, width: int, height: int, fps: int, pixel_format: int) -> None:
            camera.asked = {"size": (width, height), "fps": fps}
            self.mode.pixelFormat = pixel_format

        def set_mirroring_enabled(self, enabled: bool) -> None:
            if not can_mirror:
                raise OpenNIError("property is not supported")
            self.mirrored = enabled or stays_mirrored

        def get_mirroring_enabled(self) -> bool:
            return self.mirrored

        def get_horizontal_fov(self) -> float:
            return 1.0

        def get_vertical_fov(self) -> float:
            return 0.8

        def start(self) -> None:
            if not camera.plugged:
                raise OpenNIError("no device")
            camera.started += 1

        def stop(self) -> None:
            camera.stopped += 1
            if not camera.plugged:
                raise OpenNIError("device is gone")

        def close(self) -> None:
            pass

        def read_frame(self) -> Any:
            if self.of_colour:
                seen = camera.colour()
                data = (ctypes.c_uint8 * seen.size)(*seen.ravel().tolist())
                return SimpleNamespace(width=SIZE[0], height=SIZE[1], get_buffer_as_uint8=lambda: data)
            image = camera.image()
            data = (ctypes.c_uint16 * image.size)(*image.ravel().tolist())
            return SimpleNamespace(
                width=SIZE[0], height=SIZE[1], timestamp=round(1e3 * camera.stamp_ms), get_buffer_as_uint16=lambda: data
            )

    class Device:
        def __init__(self, uri: bytes) -> None:
            self.uri = uri

        @classmethod
        def enumerate_uris(cls) -> list[bytes]:
            return [b"usb://1"] if camera.plugged else []

        def create_depth_stream(self) -> Stream | None:
            return None if camera.unit is None else Stream()

        def create_color_stream(self) -> Stream | None:
            return Stream(of_colour=True) if registers else None

        def is_image_registration_mode_supported(self, mode: int) -> bool:
            return registers and mode == 1

        def set_image_registration_mode(self, mode: int) -> None:
            camera.asked["registration"] = mode

        def close(self) -> None:
            pass

    def wait_for_any_stream(streams: list[Any], timeout: float) -> Any:
        if camera.plugged:
            return streams[0]
        time.sleep(0.001)
        return None

    return SimpleNamespace(
        OpenNIError=OpenNIError, InitializationError=type("InitializationError", (Exception,), {}), Device=Device,
        initialize=lambda: None, wait_for_any_stream=wait_for_any_stream,
        PIXEL_FORMAT_DEPTH_1_MM=100, PIXEL_FORMAT_DEPTH_100_UM=101, PIXEL_FORMAT_RGB888=200,
        IMAGE_REGISTRATION_DEPTH_TO_COLOR=1,
    )  # fmt: skip


def freenect(camera: FakeCamera) -> Any:
    """``freenect``."""

    def sync_get_depth(index: int = 0, format: int = 0) -> Any:
        if not camera.plugged or index:
            return None
        camera.asked = {"format": format}
        camera.frames += 1
        return np.full((480, 640), 1000 if format == 0 else 3848, np.uint16), camera.frames

    def sync_get_video(index: int = 0, format: int = 0) -> Any:
        if not camera.plugged or index or format != 0:
            return None
        image = np.zeros((480, 640, 3), np.uint8)
        image[..., 0], image[..., 1] = camera.frames % 256, 7
        return image, camera.frames

    def sync_stop() -> None:
        camera.stopped += 1

    return SimpleNamespace(
        sync_get_depth=sync_get_depth, sync_get_video=sync_get_video, sync_stop=sync_stop,
        DEPTH_11BIT=0, DEPTH_REGISTERED=4, DEPTH_MM=5, VIDEO_RGB=0,
    )  # fmt: skip


def pyrealsense2(camera: FakeCamera, *, model: str = "brown_conrady", coeffs: tuple[float, ...] = (0.0,) * 5) -> Any:
    """``pyrealsense2``."""

    class Config:
        def enable_device(self, serial: str) -> None:
            camera.asked["serial"] = serial

        def enable_stream(self, *what: Any) -> None:
            camera.asked["colour" if what[0] == "color" else "stream"] = what

    intrinsics = SimpleNamespace(
        width=SIZE[0], height=SIZE[1], fx=6.0, fy=6.5, ppx=3.25, ppy=2.75, model=model, coeffs=list(coeffs)
    )
    motion = SimpleNamespace(rotation=[0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0], translation=[0.015, 0.0, 0.001])
    video = SimpleNamespace(get_intrinsics=lambda: intrinsics, fps=lambda: 30, get_extrinsics_to=lambda _: motion)
    sensor = SimpleNamespace(get_depth_scale=lambda: camera.unit)
    profile = SimpleNamespace(
        get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor),
        get_stream=lambda _: SimpleNamespace(as_video_stream_profile=lambda: video),
    )

    class Pipeline:
        def start(self, _config: Config) -> Any:
            if not camera.plugged:
                raise RuntimeError("No device connected")
            camera.started += 1
            return profile

        def stop(self) -> None:
            camera.stopped += 1

        def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, Any]:
            assert timeout_ms > 0
            if not camera.plugged:
                time.sleep(0.001)
                return False, None
            image = camera.image()
            stamp = camera.stamp_ms
            depth = SimpleNamespace(get_data=lambda: image, get_timestamp=lambda: stamp)
            seen = camera.colour()[..., ::-1]
            colour = SimpleNamespace(get_data=lambda: seen)
            return True, SimpleNamespace(get_depth_frame=lambda: depth, get_color_frame=lambda: colour)

    return SimpleNamespace(
        config=Config, pipeline=Pipeline, stream=SimpleNamespace(depth="depth", color="color"),
        format=SimpleNamespace(z16="z16", bgr8="bgr8"),
        distortion=SimpleNamespace(brown_conrady="brown_conrady"),
    )  # fmt: skip


def pyorbbecsdk(camera: FakeCamera, *, obeys: bool = True, silent: bool = False) -> Any:
    """``pyorbbecsdk``."""

    class OBError(Exception):
        pass

    profile = SimpleNamespace(
        get_intrinsic=lambda: SimpleNamespace(fx=6.0, fy=6.5, cx=3.25, cy=2.75, width=SIZE[0], height=SIZE[1]),
        get_extrinsic_to=lambda _: SimpleNamespace(
            rot=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), transform=np.array([15.0, 0.0, 1.0])
        ),
        get_distortion=lambda: SimpleNamespace(k1=0.1, k2=0.2, k3=0.3, p1=0.01, p2=0.02),
        get_fps=lambda: 30,
    )

    class Profiles:
        def get_video_stream_profile(self, width: int, height: int, format: str, fps: int) -> Any:
            camera.asked.update(size=(width, height), format=format, fps=fps)
            if not obeys:
                raise OBError("no such profile")
            return profile

        def get_default_video_stream_profile(self) -> Any:
            return profile

    class Pipeline:
        def __init__(self, device: Any) -> None:
            camera.asked["device"] = device

        def get_stream_profile_list(self, _sensor: str) -> Profiles:
            return Profiles()

        def start(self, _config: Any) -> None:
            camera.started += 1

        def stop(self) -> None:
            camera.stopped += 1

        def wait_for_frames(self, timeout_ms: int) -> Any:
            assert timeout_ms > 0
            if silent or not camera.plugged:
                time.sleep(0.001)
                return None
            image = camera.image()
            stamp = camera.stamp_ms
            depth = SimpleNamespace(
                get_data=image.tobytes, get_width=lambda: SIZE[0], get_height=lambda: SIZE[1],
                get_depth_scale=lambda: camera.unit, get_timestamp=lambda: stamp,
            )  # fmt: skip
            seen = camera.colour()
            colour = SimpleNamespace(get_data=seen.tobytes, get_width=lambda: SIZE[0], get_height=lambda: SIZE[1])
            return SimpleNamespace(get_depth_frame=lambda: depth, get_color_frame=lambda: colour)

    class Devices:
        def get_count(self) -> int:
            return int(camera.plugged)

        def get_device_by_index(self, index: int) -> Any:
            return f"device {index}"

        def get_device_by_serial_number(self, serial: str) -> Any:
            if serial != "CP1234":
                raise OBError(f"no device {serial}")
            return serial

    return SimpleNamespace(
        OBError=OBError, Pipeline=Pipeline, Context=lambda: SimpleNamespace(query_devices=Devices),
        Config=lambda: SimpleNamespace(enable_stream=lambda _: None),
        OBSensorType=SimpleNamespace(DEPTH_SENSOR="depth", COLOR_SENSOR="colour"),
        OBFormat=SimpleNamespace(Y16="y16", RGB="rgb"),
    )  # fmt: skip


def depthai(camera: FakeCamera, *, version: str = "3.12.0", pairs: int = 1, sockets: tuple[str, ...] = ("A", "B", "C"),
            platform: str = "RVC2", silent: bool = False) -> Any:  # fmt: skip
    """``depthai``, version 3. Depth that is not linked to colour has no colour's lens."""

    class QueueException(Exception):
        pass

    class Output:
        def __init__(self, get: Callable[[], Any]) -> None:
            self.get = get

        def link(self, target: Any) -> None:
            target.source = self

        def createOutputQueue(self, maxSize: int = 16, blocking: bool = False) -> Any:
            assert (maxSize, blocking) == (2, False)
            return Queue(self.get)

    class Queue:
        def __init__(self, get: Callable[[], Any]) -> None:
            self.taken = get

        def get(self, timeout: timedelta) -> Any:
            assert timeout > timedelta(0)
            if not camera.plugged:
                raise QueueException("Connection closed")
            if silent:
                time.sleep(0.001)
                return None
            return self.taken()

    def frame(image: np.ndarray, focal: float) -> Any:
        K = [[focal, 0.0, 3.25], [0.0, focal + 0.5, 2.75], [0.0, 0.0, 1.0]]
        stamp = timedelta(milliseconds=camera.stamp_ms)
        return SimpleNamespace(
            getFrame=lambda: image, getCvFrame=lambda: image, getTimestamp=lambda: stamp, getWidth=lambda: SIZE[0],
            getHeight=lambda: SIZE[1], getTransformation=lambda: SimpleNamespace(getIntrinsicMatrix=lambda: K),
        )  # fmt: skip

    class StereoDepth:
        def build(self, *, autoCreateCameras: bool, size: tuple[int, int], fps: float) -> StereoDepth:
            assert autoCreateCameras
            camera.asked.update(size=size, fps=fps)
            self.inputAlignTo = SimpleNamespace(source=None)
            self.depth = Output(lambda: frame(camera.image(), 7.0 if self.inputAlignTo.source else 6.0))
            return self

    class Camera:
        def build(self, socket: str) -> Camera:
            assert socket == "A"
            return self

        def requestOutput(self, size: tuple[int, int], *, fps: float, enableUndistortion: bool) -> Output:
            assert enableUndistortion
            return Output(lambda: frame(np.ascontiguousarray(camera.colour()[..., ::-1]), 7.0))

    class ImageAlign:
        def __init__(self) -> None:
            camera.asked["aligned by"] = "ImageAlign"
            self.input, self.inputAlignTo = SimpleNamespace(), SimpleNamespace()
            self.outputAligned = Output(self._aligned)

        def _aligned(self) -> Any:
            assert self.inputAlignTo.source is not None
            return frame(self.input.source.get().getFrame(), 7.0)

    class Sync:
        def __init__(self) -> None:
            self.inputs = {"depth": SimpleNamespace(), "colour": SimpleNamespace()}
            self.out = Output(lambda: {name: self.inputs[name].source.get() for name in ("depth", "colour")})

        def setSyncThreshold(self, threshold: timedelta) -> None:
            camera.asked["within"] = threshold

    class Pipeline:
        def __init__(self, device: Any) -> None:
            assert isinstance(device, Device)

        def create(self, node: type) -> Any:
            return node()

        def start(self) -> None:
            camera.started += 1

        def stop(self) -> None:
            camera.stopped += 1
            if not camera.plugged:
                raise RuntimeError("device is gone")

    class Device:
        def __init__(self, info: Any) -> None:
            camera.asked["device"] = info
            if not camera.plugged or info == "lost":
                raise RuntimeError(f"Cannot find any device with given deviceInfo {info}")

        @staticmethod
        def getAllAvailableDevices() -> list[str]:
            return ["first"] if camera.plugged else []

        def setMaxReconnectionAttempts(self, attempts: int) -> None:
            assert attempts == 0

        def getAvailableStereoPairs(self) -> list[Any]:
            return [object()] * pairs

        def getConnectedCameras(self) -> list[str]:
            return list(sockets)

        def getPlatform(self) -> str:
            return platform

        def close(self) -> None:
            camera.asked["closed"] = True

    return SimpleNamespace(
        __version__=version, Device=Device, DeviceInfo=lambda name: name, Pipeline=Pipeline,
        node=SimpleNamespace(StereoDepth=StereoDepth, Camera=Camera, ImageAlign=ImageAlign, Sync=Sync),
        CameraBoardSocket=SimpleNamespace(CAM_A="A"), Platform=SimpleNamespace(RVC2="RVC2", RVC4="RVC4"),
        MessageQueue=SimpleNamespace(QueueException=QueueException),
    )  # fmt: skip


def pylibfreenect2(camera: FakeCamera, *, opens: bool = True) -> Any:
    """``pylibfreenect2``: a Kinect v2, whose registered image has the colour of each pixel of the depth image."""

    class Frame:
        def __init__(self, width: int, height: int, pixel_bytes: int) -> None:
            assert (width, height, pixel_bytes) == (512, 424, 4)
            self.values: Any = None

        def asarray(self, dtype: Any) -> np.ndarray:
            assert self.values.dtype == dtype
            return self.values  # type: ignore[no-any-return]

    class Listener:
        def __init__(self, kinds: int) -> None:
            assert kinds == 7

        def waitForNewFrame(self, frame_map: Any = None, milliseconds: int = -1) -> dict[str, Any] | None:
            assert frame_map is None
            assert milliseconds > 0
            if not camera.plugged:
                time.sleep(0.001)
                return None
            camera.frames += 1
            camera.asked["held"] = camera.asked.get("held", 0) + 1
            depth = np.full((424, 512), 700.4 + camera.frames, np.float32)
            depth[0, 1], depth[0, 2], depth[0, 3] = np.nan, np.inf, 1e9
            return {"color": camera.frames, "depth": depth}

        def release(self, _frames: Any) -> None:
            camera.asked["held"] -= 1

    class Registration:
        def __init__(self, infrared: Any, colour: Any) -> None:
            assert (infrared.fx, colour) == (365.5, "colour")

        def apply(self, colour: int, depth: np.ndarray, undistorted: Frame, registered: Frame) -> None:
            undistorted.values = depth
            registered.values = np.zeros((424, 512, 4), np.uint8)
            registered.values[..., 1], registered.values[..., 2] = 7, colour

    class Device:
        def setColorFrameListener(self, listener: Listener) -> None: ...

        def setIrAndDepthFrameListener(self, listener: Listener) -> None: ...

        def start(self) -> None:
            camera.started += 1

        def stop(self) -> None:
            camera.stopped += 1

        def close(self) -> None:
            camera.asked["closed"] = True

        def getIrCameraParams(self) -> Any:
            return SimpleNamespace(fx=365.5, fy=365.6, cx=256.5, cy=205.5, k1=0.1, k2=-0.2, k3=0.1, p1=0.0, p2=0.0)

        def getColorCameraParams(self) -> str:
            return "colour"

    class Freenect2:
        def enumerateDevices(self) -> int:
            return int(camera.plugged)

        def getDeviceSerialNumber(self, index: int) -> bytes:
            assert index == 0
            return b"0123456747"

        def openDevice(self, serial: bytes) -> Device | None:
            assert serial == b"0123456747", "the real driver crashes"
            camera.asked["device"] = serial
            return Device() if opens and camera.plugged else None

    return SimpleNamespace(
        Freenect2=Freenect2, SyncMultiFrameListener=Listener, Registration=Registration, Frame=Frame,
        FrameType=SimpleNamespace(Color=1, Ir=2, Depth=4),
    )  # fmt: skip
