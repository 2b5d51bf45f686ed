"""What a user writes → a source of pictures."""

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
from mocapella.sources.picture_source import PictureSource, SourceState
from mocapella.sources.video import LIVE, Frames, pictures

STREAMS: Final = ("http://", "https://", "rtsp://", "rtmp://", "udp://", "tcp://")
RENDERED: Final = "rendered:"
SETTLED: Final = 30
"""Pictures after which a camera's own regulation, as far as it cannot be switched off, has come to rest."""
KINDS: Final = "camera:0, /dev/video0, http://… or rtsp://…, a film, a folder of images, or rendered:SCENE/CAMERA"


def open_pictures(
    text: str, wishes: CameraWishes | None = None, *, loop: bool = False, seed: int = 0, rate_option: str = "--fps"
) -> PictureSource:
    """The source of that name; it is not opened yet.

    Args:
        text: one of `KINDS`.
        wishes: how a camera is to be set; of films and folders, the frames a second.
        loop: films and folders begin again.
        seed: of a rendered scene.
        rate_option: how the command calls the frames a second, for what is said of a film without.

    Raises:
        SettingsError: it has the form of none, or there is no such scene or camera.
    """
    wishes = wishes or CameraWishes()
    if text.startswith(LIVE):
        number = text.removeprefix(LIVE)
        if not number.isdecimal():
            raise SettingsError(f"source {text!r} cannot be used; write {LIVE}0 for the first camera")
        return CaptureCamera(int(number), text, wishes)
    if (number_of := camera_number(text)) is not None:
        return CaptureCamera(number_of, text, wishes)
    if text.startswith(STREAMS):
        return CaptureCamera(text, text, wishes)
    if text.startswith(RENDERED):
        from mocapella.sources.simulate.hand_scene import load_hand_scene
        from mocapella.sources.simulate.rendered_camera import RenderedCamera

        scene, slash, camera = text.removeprefix(RENDERED).partition("/")
        if not slash:
            raise SettingsError(f"source {text!r} cannot be used; write it as {RENDERED}demo/left")
        return RenderedCamera(load_hand_scene(scene, seed=seed), camera, text)
    if not text:
        raise SettingsError(f"no source; name {KINDS}")
    return PacedPictures(text, fps=wishes.fps, loop=loop, rate_option=rate_option)


def is_live(text: str) -> bool:
    """Whether a source of that name gives pictures in real time only; of others there is a file."""
    return text.startswith((LIVE, RENDERED, *STREAMS)) or camera_number(text) is not None


def one_picture(
    text: str, frame: int | None = None, wishes: CameraWishes | None = None, *, seed: int = 0
) -> tuple[NDArray[np.uint8], SourceState]:
    """One picture of a source, as fast as it can be had, and how the source was set.

    Args:
        text, wishes, seed: as `open_pictures`.
        frame: which, from 0; None is the first one of a film, and of a camera the `SETTLED`-th.

    Raises:
        SettingsError: as `open_pictures`.
        InputError: it cannot be opened, or has no such picture.
    """
    source = open_pictures(text, wishes, seed=seed)
    if isinstance(source, PacedPictures):  # they need not be waited for
        wanted = frame or 0
        for number, image in pictures(text, Frames(wanted, wanted + 1)):
            if number == wanted:
                return image, SourceState((image.shape[1], image.shape[0]))
        raise InputError("has no such picture", file=text, field="frame", value=wanted, fix="name an earlier one")
    if not isinstance(source, CaptureCamera):  # any instant of a scene can be rendered directly
        from mocapella.sources.simulate.rendered_camera import RenderedCamera

        assert isinstance(source, RenderedCamera)
        return source.scene.at(source.camera.name, (frame or 0) / source.camera.fps).image, source.open()
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
