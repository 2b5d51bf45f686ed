"""Images that are not of what a camera saw before, stored wrong or of another room, and are left out of a frame.

Two tests, each relative to what is usual in this camera: the image behind the body differs from before
(`shows_another_scene`), or the outline found is not the body's although other cameras see the body where it was
expected (`hides_the_body`). The second test catches a mirrored image of the same room, which resembles it everywhere
else. Each camera is judged by itself, because even one remaining camera is enough to continue. An image that differs
for long enough becomes the new reference.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.tracker.silhouette_camera import SilhouetteCamera
from mocapella.tracker.silhouette_settings import SilhouetteSettings

UInt8 = NDArray[np.uint8]


def shows_another_scene(
    cameras: Mapping[str, SilhouetteCamera],
    images: Mapping[str, UInt8],
    left_out: Mapping[str, str],
    settings: SilhouetteSettings,
    time_ns: int,
) -> dict[str, str]:
    """Cameras in whose images what is behind the body is not as it was, and why they are left out.

    One camera must differ much, for somebody may pass; where half of them do at one instant, what does not come by
    chance is enough.

    Args:
        cameras: in whose images the body is expected; they have looked there.
        images: by camera.
        left_out: what is left out already, and why.
        settings: of the tracker.
        time_ns: of capture.
    """
    unlike = {name: camera.unlike(images[name]) for name, camera in cameras.items()}
    much = {name for name, camera in cameras.items() if unlike[name] > camera.usually.much(settings.unlike)}
    some = {name for name, camera in cameras.items() if unlike[name] > camera.usually.most()}
    together = len(some) + len(left_out) >= max(2, (len(cameras) + len(left_out)) / 2)
    reasons = {}
    for name, camera in cameras.items():
        if name not in (much | some if together else much):
            camera.usually.learn(unlike[name])
        elif camera.usually.else_for_ns(time_ns) >= settings.something_else_s * NS_PER_S:
            camera.forget_background()
        else:
            differs = f"{unlike[name]:.0%} of what is behind the body differs from before"
            reasons[name] = f"it shows something else: {differs}"
    return reasons


def hides_the_body(
    cameras: Mapping[str, SilhouetteCamera], left_out: Mapping[str, str], settings: SilhouetteSettings, time_ns: int
) -> dict[str, str]:
    """Cameras in whose images the outline is all at once not that of the body where it was expected, and why they are
    left out. Where it is so in all cameras, and nothing speaks against their images, the body moved.

    Args:
        cameras: whose images were segmented.
        left_out, settings, time_ns: as of `shows_another_scene`.
    """
    common = {name: camera.seen().overlap for name, camera in cameras.items()}
    poor = {name for name, camera in cameras.items() if common[name] < camera.covers.least()}
    if len(poor) == len(cameras) and not left_out:
        poor = set()
    reasons = {}
    for name, camera in cameras.items():
        if name in poor and camera.covers.else_for_ns(time_ns) < settings.something_else_s * NS_PER_S:
            reasons[name] = f"it shows something else: its outline has {common[name]:.0%} in common with the body's"
        else:
            camera.covers.learn(common[name])
    return reasons
