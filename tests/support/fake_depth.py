"""Depth cameras behind the interfaces of four packages, with a plug that can be pulled."""

from __future__ import annotations

import ctypes
import time
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
