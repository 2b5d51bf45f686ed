"""What `mocapella doctor` says of the devices that sources serve; no driver is imported."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

from mocapella.sources.depth_cameras import CAMERAS, camera_class
from mocapella.sources.source import Finding


def depth_cameras() -> Iterator[Finding]:
    """The packages that drive depth cameras, none of which is an extra: they come from the cameras' makers."""
    for kind in CAMERAS:
        device = camera_class(kind)
        found = next(filter(_is_installed, device.packages), None)
        if found is None:
            names = " or ".join(module.partition(".")[0] for module in device.packages)
            yield Finding(
                f"depth camera {kind}:", "note", f"not installed: {names}", f"only if you have one: {device.install}"
            )
        else:
            yield Finding(f"depth camera {kind}:", "ok", found)


def cameras() -> Iterator[Finding]:
    """The cameras that the system names."""
    found = sorted(str(path) for path in Path("/dev").glob("video*"))
    if found:
        yield Finding("cameras", "ok", ", ".join(found))
    else:
        advice = "none is needed for recordings, simulations and sensors on other machines"
        yield Finding("cameras", "note", "none found", advice)


def _is_installed(module: str) -> bool:
    """Whether there is a module of that name, which is not imported: a driver may do things then."""
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:  # not even what it is in
        return False
