"""Libraries that read an Azure Kinect or an Orbbec Femto: find them, and load them with `ctypes`.

``k4a`` reads the camera: the Azure Kinect Sensor SDK 1.4, or Orbbec's K4A wrapper with the same C interface. ``k4abt``
finds bodies in its depth images: the Azure Kinect Body Tracking SDK 1.1. Functions, layouts and values are those of the
headers k4a.h, k4atypes.h, k4abt.h and k4abttypes.h. docs/decisions/0037-azure-kinect-by-ctypes.md says why so.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from ctypes import POINTER, c_bool, c_char_p, c_int, c_int32, c_size_t, c_uint32, c_uint64, c_void_p
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from mocapella.errors import SettingsError

FOLDERS_VARIABLE: Final = "MOCAPELLA_K4A"
"""Environment variable with folders to search first, separated as in PATH."""
OK: Final = 0
TIMEOUT: Final = 2
"""Results of functions; another is a failure."""
DEPTH_MODE: Final = 2
"""Narrow field of view, unbinned: `DEPTH_SIZE_PX` at up to 30 Hz."""
DEPTH_SIZE_PX: Final = (640, 576)
DEPTH_MODES: Final = {(320, 288): 1, DEPTH_SIZE_PX: DEPTH_MODE}
"""Values of the narrow field of view, by the images' size [px]."""
COLOUR_BGRA: Final = 3
COLOUR_720P: Final = 1
"""Values of the colour images' format, and of their size, 1280 × 720 px."""
FPS: Final = {5: 0, 15: 1, 30: 2}
"""Values by frame rate [Hz]."""
PROCESSING: Final = {"gpu": 0, "cpu": 1, "cuda": 2, "tensorrt": 3, "directml": 4}
MOUNTED: Final = {"upright": 0, "clockwise": 1, "counterclockwise": 2, "upside-down": 3}
"""Values of the sensor's orientation, as seen by a person who faces it."""
NO_BODY: Final = 0xFFFFFFFF
"""Id of a body that there is not."""
CALIBRATION_BYTES: Final = 4096
"""Memory for a calibration, which only the library reads; it takes 1032 bytes."""
JOINT: Final = np.dtype(
    [("position", np.float32, (3,)), ("orientation", np.float32, (4,)), ("confidence", np.int32)]
)  # fmt: skip
"""A joint of a skeleton: position [mm], quaternion (w, x, y, z), confidence level."""

_INSTALL: Final = {
    "k4a": "the Azure Kinect Sensor SDK 1.4 (for an Orbbec Femto, Orbbec's K4A wrapper)",
    "k4abt": "the Azure Kinect Body Tracking SDK 1.1",
}
_LEAST: Final = {"k4a": (1, 0), "k4abt": (1, 1)}
"""Oldest usable version: the tracker's configuration has another layout before 1.1."""
_MACHINES: Final = {3: "i686", 40: "armv7l", 62: "x86_64", 183: "aarch64"}
"""Processors by their number in the header of a Linux library."""


class DeviceConfiguration(ctypes.Structure):
    """How a device's cameras run, ``k4a_device_configuration_t``; zero is off."""

    _fields_ = (
        ("color_format", c_int), ("color_resolution", c_int), ("depth_mode", c_int), ("camera_fps", c_int),
        ("synchronized_images_only", c_bool), ("depth_delay_off_color_usec", c_int32), ("wired_sync_mode", c_int),
        ("subordinate_delay_off_master_usec", c_uint32), ("disable_streaming_indicator", c_bool),
    )  # fmt: skip


class TrackerConfiguration(ctypes.Structure):
    """How bodies are found, ``k4abt_tracker_configuration_t``; without a path the library's own model is used."""

    _fields_ = (
        ("sensor_orientation", c_int), ("processing_mode", c_int), ("gpu_device_id", c_int32), ("model_path", c_char_p),
    )  # fmt: skip


_OUT: Final = POINTER(c_void_p)
_FUNCTIONS: Final[Mapping[str, Mapping[str, tuple[Any, ...]]]] = {
    "k4a": {
        "k4a_device_get_installed_count": (c_uint32,),
        "k4a_device_open": (c_int, c_uint32, _OUT),
        "k4a_device_get_serialnum": (c_int, c_void_p, c_char_p, POINTER(c_size_t)),
        "k4a_device_start_cameras": (c_int, c_void_p, POINTER(DeviceConfiguration)),
        "k4a_device_get_calibration": (c_int, c_void_p, c_int, c_int, c_void_p),
        "k4a_device_get_capture": (c_int, c_void_p, _OUT, c_int32),
        "k4a_capture_release": (None, c_void_p),
        "k4a_device_stop_cameras": (None, c_void_p),
        "k4a_device_close": (None, c_void_p),
    },
    "k4abt": {
        "k4abt_tracker_create": (c_int, c_void_p, TrackerConfiguration, _OUT),
        "k4abt_tracker_enqueue_capture": (c_int, c_void_p, c_void_p, c_int32),
        "k4abt_tracker_pop_result": (c_int, c_void_p, _OUT, c_int32),
        "k4abt_tracker_shutdown": (None, c_void_p),
        "k4abt_tracker_destroy": (None, c_void_p),
        "k4abt_frame_get_num_bodies": (c_uint32, c_void_p),
        "k4abt_frame_get_body_skeleton": (c_int, c_void_p, c_uint32, c_void_p),
        "k4abt_frame_get_body_id": (c_uint32, c_void_p, c_uint32),
        "k4abt_frame_get_device_timestamp_usec": (c_uint64, c_void_p),
        "k4abt_frame_release": (None, c_void_p),
    },
}
"""Type of the result, then of the arguments, of each function that is called, by library."""
_IMAGE_FUNCTIONS: Final[Mapping[str, tuple[Any, ...]]] = {
    "k4a_capture_get_depth_image": (c_void_p, c_void_p),
    "k4a_capture_get_color_image": (c_void_p, c_void_p),
    "k4a_image_get_buffer": (c_void_p, c_void_p),
    "k4a_image_get_width_pixels": (c_int, c_void_p),
    "k4a_image_get_height_pixels": (c_int, c_void_p),
    "k4a_image_get_stride_bytes": (c_int, c_void_p),
    "k4a_image_get_device_timestamp_usec": (c_uint64, c_void_p),
    "k4a_image_release": (None, c_void_p),
}
"""The same, of the functions of ``k4a`` that are called only to read images."""


class Library(NamedTuple):
    """A library that was found, not loaded.

    Attributes:
        name: ``k4a`` or ``k4abt``.
        path: its file, links resolved.
        version: its version by the names of file and folder; empty if they have none.
    """

    name: str
    path: Path
    version: str

    @property
    def problem(self) -> str:
        """Why it cannot be used, as far as the file tells; empty if nothing is known to be wrong."""
        least = _LEAST[self.name]
        if self.version and tuple(map(int, self.version.split("."))) < least:
            return f"is version {self.version}; install {_INSTALL[self.name]}"
        try:
            with self.path.open("rb") as file:
                head = file.read(20)
        except OSError as error:
            return f"cannot be read ({error.strerror}); allow this user to read it"
        if len(head) == 20 and head[:4] == b"\x7fELF":
            machine = _MACHINES.get(head[18] + 256 * head[19], "another processor")
            if machine != platform.machine():
                return f"is built for {machine}, and this Python runs on {platform.machine()}; install that version"
        return ""


def find_libraries(folders: Iterable[Path] = ()) -> dict[str, Library | None]:
    """Find ``k4a`` and ``k4abt`` without loading them; None for one that is not installed.

    Args:
        folders: folders to search first; then follow the folders of `FOLDERS_VARIABLE`, and where installers put them.
    """
    every = [*folders, *_paths(FOLDERS_VARIABLE), *_usual_folders()]
    return {name: next(_in_folders(name, every), None) for name in _FUNCTIONS}


def missing(*names: str) -> str:
    """Return the remedy if libraries, ``k4a`` or ``k4abt``, are not found."""
    wanted = " and ".join(_INSTALL[name] for name in names)
    return f"install {wanted}, or let {FOLDERS_VARIABLE} name the folder (docs/sensors.md)"


def load_libraries(folders: Iterable[Path] = ()) -> tuple[Any, Any]:
    """Load ``k4a`` and ``k4abt``, and declare the functions that are called.

    Args:
        folders: folders to search first, as in `find_libraries`.

    Returns:
        The two libraries.

    Raises:
        SettingsError: a library is not installed, too old, for another processor, cannot be loaded, or lacks a
            function; names it and the remedy.
    """
    found = find_libraries(folders)
    absent = [name for name, library in found.items() if library is None]
    if absent:
        names = " and ".join(f"lib{name}" for name in absent)
        raise SettingsError(f"{names} {'is' if len(absent) == 1 else 'are'} not installed: {missing(*absent)}")
    # In this order: k4abt calls k4a, and must get this one, also where another is installed.
    k4a, k4abt = (_loaded(library) for library in found.values() if library is not None)
    return k4a, k4abt


def load_camera_library(folders: Iterable[Path] = ()) -> Any:
    """Load ``k4a`` alone, with the functions that read images.

    Args:
        folders: folders to search first, as in `find_libraries`.

    Raises:
        SettingsError: as `load_libraries`.
    """
    found = find_libraries(folders)["k4a"]
    if found is None:
        raise SettingsError(f"libk4a is not installed: {missing('k4a')}")
    return _loaded(found, _IMAGE_FUNCTIONS)


def _loaded(library: Library, more: Mapping[str, tuple[Any, ...]] = MappingProxyType({})) -> Any:
    if library.problem:
        raise SettingsError(f"{library.path} {library.problem}")
    mode = ctypes.RTLD_GLOBAL if library.name == "k4a" else ctypes.DEFAULT_MODE
    try:
        loaded = ctypes.CDLL(str(library.path), mode)
    except OSError as error:
        fix = f"install {_INSTALL[library.name]} completely, with what it needs"
        raise SettingsError(f"{library.path} cannot be loaded ({error}): {fix}") from error
    for name, (result, *arguments) in {**_FUNCTIONS[library.name], **more}.items():
        try:
            function = getattr(loaded, name)
        except AttributeError as error:
            raise SettingsError(f"{library.path} has no {name}: install {_INSTALL[library.name]}") from error
        function.restype, function.argtypes = result, arguments
    return loaded


def _in_folders(name: str, folders: Iterable[Path]) -> Iterator[Library]:
    pattern = f"{name}.dll" if sys.platform == "win32" else f"lib{name}.so*"
    for folder in folders:
        files = [path.resolve() for path in folder.glob(pattern) if path.is_file()]
        found = [Library(name, path, _version(path)) for path in files]
        yield from sorted(found, key=lambda one: [int(part) for part in one.version.split(".") if part], reverse=True)


def _version(path: Path) -> str:
    """Return such as 1.4.1 of ``libk4a.so.1.4.1`` or ``Azure Kinect SDK v1.4.1/…/k4a.dll``."""
    versions = re.findall(r"(?:\.so\.|SDK v?)(\d+(?:\.\d+)+)", str(path))
    return versions[-1] if versions else ""


def _paths(variable: str) -> list[Path]:
    return [Path(folder) for folder in os.environ.get(variable, "").split(os.pathsep) if folder]


def _usual_folders() -> Iterator[Path]:
    """Yield where the installers of Windows and Linux put the libraries."""
    if sys.platform == "win32":
        programs = Path(os.environ.get("PROGRAMFILES", r"C:\Program Files"))
        for kind in ("Azure Kinect SDK*", "Azure Kinect Body Tracking SDK*"):
            for folder in sorted(programs.glob(kind), reverse=True):
                yield folder / "sdk" / "windows-desktop" / "amd64" / "release" / "bin"
                yield folder / "tools"
    else:
        yield from _paths("LD_LIBRARY_PATH")
        yield from (Path("/usr/local/lib"), Path(f"/usr/lib/{platform.machine()}-linux-gnu"), Path("/usr/lib"))
