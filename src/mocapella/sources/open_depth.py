"""What a user writes → a source of depth images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from mocapella.errors import SettingsError
from mocapella.sources.depth_cameras import CAMERAS, camera_class
from mocapella.sources.depth_files import DepthFiles, DepthRecording
from mocapella.sources.depth_options import KINECT_RAW, DepthOptions
from mocapella.sources.paced_depth import PacedDepth
from mocapella.sources.picture_source import PictureSource

RAW: Final = "freenect"
"""The one that has disparities, too."""
RENDERED: Final = "rendered"
KINDS: Final = (
    "16-bit PNGs or a folder of them, a take, openni:0, freenect:0, realsense:SERIAL, orbbec:0 or rendered:SCENE/SEED"
)


def open_depth(
    text: str,
    options: DepthOptions | None = None,
    *,
    loop: bool = False,
    recorded: Callable[[str], DepthRecording | None] = lambda text: None,
) -> PictureSource:
    """The source of that name; it is not opened yet.

    Args:
        text: one of `KINDS`.
        options: what the user says of the camera.
        loop: recordings begin again.
        recorded: opens what is a recording of another kind, a take; None where it is none.

    Raises:
        SettingsError: it has the form of none, there is no such scene, or it has no disparities where the user says so.
        InputError: files cannot be read.
    """
    options = options or DepthOptions()
    kind, colon, which = text.partition(":")
    if colon and kind in (*CAMERAS, RENDERED) and kind != RAW and options.kinect_raw:
        raise SettingsError(f"--unit {KINECT_RAW}: {kind} gives depths, and says their unit itself; leave --unit out")
    if colon and kind in CAMERAS:
        return camera_class(kind)(which or CAMERAS[kind][2], text, options)
    if colon and kind == RENDERED:
        from mocapella.sources.simulate.rendered_depth import open_rendered

        return open_rendered(which, text, options)
    if (recording := recorded(text)) is not None:
        return PacedDepth(recording, loop=loop)
    if not text or (colon and not Path(text).exists() and len(kind) > 1):  # one letter is a drive
        raise SettingsError(f"source {text!r} cannot be used; name {KINDS}")
    return PacedDepth(DepthFiles([Path(text)], options), loop=loop)
