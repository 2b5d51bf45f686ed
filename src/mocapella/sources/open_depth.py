"""Open a source of depth images by the name that a user writes.

A name is a kind of depth camera, a folder of PNG files, a take's sensor, or a rendered scene.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from mocapella.errors import InputError, SettingsError
from mocapella.sources.colour_depth_files import ColourDepthFiles
from mocapella.sources.depth_cameras import CAMERAS, camera_class
from mocapella.sources.depth_files import DepthFiles, DepthRecording
from mocapella.sources.depth_options import KINECT_RAW, DepthOptions
from mocapella.sources.paced_depth import PacedDepth
from mocapella.sources.picture_source import PictureSource

RAW: Final = "freenect"
"""The only kind of depth camera that can also give its raw disparities instead of depths."""
RENDERED: Final = "rendered"
KINDS: Final = (
    "16-bit PNGs or a folder of them, a take, openni:0, freenect:0, freenect2:0, realsense:SERIAL, orbbec:0, oak:0, "
    "k4a:0 or rendered:SCENE/SEED"
)


def open_depth(
    text: str,
    options: DepthOptions | None = None,
    *,
    loop: bool = False,
    recorded: Callable[[str], DepthRecording | None] = lambda text: None,
) -> PictureSource:
    """Return the source of depth images of a name, without opening it; of files, the first is read.

    Args:
        text: the name, in one of the forms of `KINDS`.
        options: the camera's parameters as the user gives them; None if none is given.
        loop: whether recordings repeat.
        recorded: opens other recordings (takes) by their name; returns None if the name is not such a recording. It is
            asked before the name is taken for a file.

    Raises:
        SettingsError: the name has none of these forms, there is no such scene, or the options ask for disparities of a
            source without them.
        InputError: files cannot be read, or colour is wanted of a recording without it.
    """
    options = options or DepthOptions()
    kind, colon, which = text.partition(":")
    if colon and kind in (*CAMERAS, RENDERED) and kind != RAW and options.kinect_raw:
        raise SettingsError(f"--unit {KINECT_RAW}: {kind} gives depths in its own unit; leave --unit out")
    if colon and kind in CAMERAS:
        return camera_class(kind)(which or CAMERAS[kind][2], text, options)
    if colon and kind == RENDERED:
        from mocapella.sources.simulate.rendered_depth import open_rendered

        return open_rendered(which, text, options)
    if (recording := recorded(text)) is not None:
        if options.colour:
            fix = "name a folder with depth images and colour images"
            raise InputError("is a take, whose depth images have no colour images beside them", file=text, fix=fix)
        return PacedDepth(recording, loop=loop)
    if not text or (colon and not Path(text).exists() and len(kind) > 1):  # a single letter is a drive of Windows
        raise SettingsError(f"source {text!r} cannot be used; name {KINDS}")
    if options.colour:
        return PacedDepth(ColourDepthFiles(Path(text), options), loop=loop)
    return PacedDepth(DepthFiles([Path(text)], options), loop=loop)
