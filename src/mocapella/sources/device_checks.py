"""Checks of `mocapella doctor` for cameras and the packages that drive them; no driver is imported."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mocapella.sources.depth_cameras import CAMERAS, camera_class
from mocapella.sources.k4a_libraries import find_libraries, missing
from mocapella.sources.source import Finding

_LONGEST_MODEL: Final = 200
KINECT_SDK: Final = "KINECTSDK20_DIR"
"""Environment variable that the installer of the Kinect for Windows SDK 2.0 sets to its folder."""


def depth_cameras() -> Iterator[Finding]:
    """Yield for each kind of depth camera whether its package or library is installed; cameras are not sought.

    The packages come from the cameras' makers and are no extras of Mocapella.
    """
    for kind in CAMERAS:
        device = camera_class(kind)
        if device.libraries:
            yield from (_library(f"depth camera {kind}:", name) for name in device.libraries)
            continue
        found = next(filter(_is_installed, device.packages), None)
        if found is None:
            names = " or ".join(module.partition(".")[0] for module in device.packages)
            yield Finding(
                f"depth camera {kind}:", "note", f"not installed: {names}", f"only if you have one: {device.install}"
            )
        else:
            yield Finding(f"depth camera {kind}:", "ok", found)


def azure_kinect() -> Iterator[Finding]:
    """Yield for each of the vendor's libraries for an Azure Kinect or Orbbec Femto whether it is found; load none."""
    for name in find_libraries():
        yield _library(f"Azure Kinect lib{name}:", name)


def _library(what: str, name: str) -> Finding:
    """Return whether a vendor's library is found and can be used, as far as its file tells."""
    library = find_libraries()[name]
    if library is None:
        return Finding(what, "note", "not installed", f"only if you have one, or an Orbbec Femto: {missing(name)}")
    found = f"{library.version or 'version unknown'} ({library.path})"
    if library.problem:
        return Finding(what, "note", found, f"it {library.problem}")
    return Finding(what, "ok", found)


def kinect_v2() -> Iterator[Finding]:
    """Yield one finding: whether the SDK of a Kinect v2 is installed, for the client in ``clients/kinect_v2``."""
    what, sdk = "Kinect v2 SDK:", os.environ.get(KINECT_SDK, "")
    library = Path(sdk) / "Assemblies" / "Microsoft.Kinect.dll"
    if sdk and library.is_file():
        yield Finding(what, "ok", str(library))
    elif sdk:
        yield Finding(what, "note", f"{library} is missing", "install the Kinect for Windows SDK 2.0 again")
    else:
        advice = "only if you have one: Kinect for Windows SDK 2.0, on Windows; docs/sensors.md has the steps"
        yield Finding(what, "note", "not installed", advice)


def cameras() -> Iterator[Finding]:
    """Yield one finding: the cameras that Linux lists as ``/dev/video*``; on other systems none is found."""
    found = sorted(str(path) for path in Path("/dev").glob("video*"))
    if found:
        yield Finding("cameras", "ok", ", ".join(found))
    else:
        advice = "none is needed for recordings, simulations and sensors on other machines"
        yield Finding("cameras", "note", "none found", advice)
    yield from pi_cameras()


def pi_cameras(model: Path = Path("/proc/device-tree/model")) -> Iterator[Finding]:
    """Yield on a Raspberry Pi whether the package is installed that reads its own cameras; nothing elsewhere.

    Args:
        model: file with the machine's name.
    """
    try:
        with model.open("rb") as file:
            name = file.read(_LONGEST_MODEL).rstrip(b"\0").decode("ascii", "replace")
    except OSError:
        return
    if not name.startswith("Raspberry Pi"):
        return
    if _is_installed("picamera2"):
        yield Finding("picamera2", "ok", f"{name}: its own cameras are picamera:0, picamera:1")
    else:
        advice = "only for cameras at its ribbon cable: install as docs/markers-rig.md says"
        yield Finding("picamera2", "note", f"{name}: not installed", advice)


def _is_installed(module: str) -> bool:
    """Whether a module is installed; it is not imported, because a driver may have side effects."""
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:  # its package is not installed
        return False
