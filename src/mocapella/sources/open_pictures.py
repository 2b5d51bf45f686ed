"""Open an image source by the name that a user writes.

A name is a local camera, a stream, a video, an image, a folder of images, or a rendered scene.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.capture_camera import CaptureCamera, camera_number
from mocapella.sources.paced_pictures import PacedPictures
from mocapella.sources.pi_camera import PI_CAMERA, PiCamera, pi_camera_number
from mocapella.sources.picture_source import PictureSource, SourceState
from mocapella.sources.video import LIVE, Frames, pictures

STREAMS: Final = ("http://", "https://", "rtsp://", "rtmp://", "udp://", "tcp://")
RENDERED: Final = "rendered:"
SETTLED: Final = 30
"""Number of images after which a camera's automatic control has settled, if it cannot be switched off."""
KINDS: Final = (
    "camera:0, /dev/video0, picamera:0, http://… or rtsp://…, a film, a folder of images, or rendered:SCENE/CAMERA"
)


def open_pictures(
    text: str,
    wishes: CameraWishes | None = None,
    *,
    loop: bool = False,
    seed: int = 0,
    rate_option: str = "--fps",
    prerender: int = 0,
) -> PictureSource:
    """Return the image source of a name, without opening it; a name that is no camera, stream or scene is a path.

    Args:
        text: the name, in one of the forms of `KINDS`.
        wishes: requested camera settings; for videos and folders only the frame rate counts, for a rendered scene
            only the controls; None for none.
        loop: whether videos and folders repeat.
        seed: random seed of a rendered scene.
        rate_option: the command's option for the frame rate, named in the note on a video that states none.
        prerender: number of images of a rendered scene that are made beforehand and repeated, at the requested rate; 0
            renders each when it is due, at the scene's rate. No effect on other sources.

    Raises:
        SettingsError: the name is empty, a camera's number is none, or there is no such scene or camera of a scene. A
            missing file or device is noticed only by `PictureSource.open`.
    """
    wishes = wishes or CameraWishes()
    if text.startswith(LIVE):
        number = text.removeprefix(LIVE)
        if not number.isdecimal():
            raise SettingsError(f"source {text!r} cannot be used; write {LIVE}0 for the first camera")
        return CaptureCamera(int(number), text, wishes)
    if (number_of := camera_number(text)) is not None:
        return CaptureCamera(number_of, text, wishes)
    if text.startswith(PI_CAMERA):
        number_of = pi_camera_number(text)
        if number_of is None:
            raise SettingsError(
                f"source {text!r} cannot be used; write {PI_CAMERA}0 for the first camera of a Raspberry Pi"
            )
        return PiCamera(number_of, text, wishes)
    if text.startswith(STREAMS):
        return CaptureCamera(text, text, wishes)
    if text.startswith(RENDERED):
        return _rendered(text, wishes, seed, prerender)
    if not text:
        raise SettingsError(f"no source; name {KINDS}")
    return PacedPictures(text, fps=wishes.fps, loop=loop, rate_option=rate_option)


def _rendered(text: str, wishes: CameraWishes, seed: int, prerender: int) -> PictureSource:
    from mocapella.sources.simulate.hand_scene import load_hand_scene
    from mocapella.sources.simulate.prerendered_camera import PrerenderedCamera
    from mocapella.sources.simulate.rendered_camera import RenderedCamera

    scene, slash, camera = text.removeprefix(RENDERED).partition("/")
    if not slash:
        raise SettingsError(f"source {text!r} cannot be used; write it as {RENDERED}demo/left")
    made = load_hand_scene(scene, seed=seed)
    if prerender:
        return PrerenderedCamera(made, camera, text, prerender, wishes.fps, wanted=wishes.controls)
    return RenderedCamera(made, camera, text, wishes.controls)


def is_live(text: str) -> bool:
    """Whether a name means a camera, a stream or a rendered scene instead of a file or folder."""
    return text.startswith((LIVE, PI_CAMERA, RENDERED, *STREAMS)) or camera_number(text) is not None


def one_picture(
    text: str, frame: int | None = None, wishes: CameraWishes | None = None, *, seed: int = 0
) -> tuple[NDArray[np.uint8], SourceState]:
    """Read one image of a source and close the source, such as to learn colours from it.

    A file's or scene's image is read at once; a camera's earlier images are awaited and discarded.

    Args:
        text: name of the source, in one of the forms of `KINDS`.
        wishes: requested camera settings; None for the camera's present ones.
        seed: random seed of a rendered scene.
        frame: number of the image, from 0; None is number 0 of a video or scene and number `SETTLED` of a camera.

    Returns:
        The image (height, width, 3) uint8 BGR, and the source's state; of a file only its size is known.

    Raises:
        SettingsError: as in `open_pictures`.
        InputError: the source cannot be opened, or has no such image.
    """
    source = open_pictures(text, wishes, seed=seed)
    if isinstance(source, PacedPictures):  # a file is read at once, not in real time
        wanted = frame or 0
        for number, image in pictures(text, Frames(wanted, wanted + 1)):
            if number == wanted:
                return image, SourceState((image.shape[1], image.shape[0]))
        raise InputError("has no such picture", file=text, field="frame", value=wanted, fix="name an earlier one")
    if not isinstance(source, CaptureCamera | PiCamera):  # any instant of a scene can be rendered directly
        from mocapella.sources.simulate.rendered_camera import RenderedCamera

        assert isinstance(source, RenderedCamera)
        state = source.open()
        return np.asarray(source.render((frame or 0) / source.camera.fps), np.uint8), state
    state, stop = source.open(), threading.Event()
    try:
        for _ in range(1 + (SETTLED if frame is None else frame)):
            taken = source.read(stop)
            if taken is None:
                fix = "check that it is plugged in and that no other program uses it"
                raise InputError("gives no picture", file=text, fix=fix)
    finally:
        source.close()
    assert taken is not None
    return np.asarray(taken.image, dtype=np.uint8), replace(state, size_px=taken.size_px)
