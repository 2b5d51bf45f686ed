"""What a user writes → a source of pictures."""

from __future__ import annotations

from typing import Final

from mocapella.errors import SettingsError
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.capture_camera import CaptureCamera, camera_number
from mocapella.sources.paced_pictures import PacedPictures
from mocapella.sources.picture_source import PictureSource
from mocapella.sources.video import LIVE

STREAMS: Final = ("http://", "https://", "rtsp://", "rtmp://", "udp://", "tcp://")
RENDERED: Final = "rendered:"
KINDS: Final = "camera:0, /dev/video0, http://… or rtsp://…, a film, a folder of images, or rendered:SCENE/CAMERA"


def open_pictures(text: str, wishes: CameraWishes | None = None, *, loop: bool = False, seed: int = 0) -> PictureSource:
    """The source of that name; it is not opened yet.

    Args:
        text: one of `KINDS`.
        wishes: how a camera is to be set; of films and folders, the frames a second.
        loop: films and folders begin again.
        seed: of a rendered scene.

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
    return PacedPictures(text, fps=wishes.fps, loop=loop)
