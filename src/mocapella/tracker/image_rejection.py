"""Reject images that show something else: corrupted ones, or another scene.

Two tests compare with adaptive thresholds of the camera, from mean and deviation of earlier values
(`silhouette_camera.Usually`): the image behind the body differs from before (`shows_another_scene`), or the segmented
outline is not the body's although other cameras see the body at its predicted pose (`hides_the_body`). The second test
detects a mirrored image of the same room. Each camera is judged separately, because one remaining camera is enough to
continue. An image that differs for long enough becomes the new reference.
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
    """Return cameras whose background has changed, with the reasons; empty if none has.

    One camera must differ much, because a person may pass; if half of them differ at the same time, a significant
    change is enough. The thresholds of the other cameras are updated. After ``something_else_s`` a camera is accepted
    again, and its background is forgotten.

    Args:
        cameras: the cameras in whose images the body is expected, by name, after `SilhouetteCamera.look`.
        images: (height, width) or (height, width, 3) uint8 BGR, of each of these cameras, by name.
        left_out: reasons for the cameras whose images were rejected before, by name.
        settings: settings of the tracker.
        time_ns: capture time, on the common clock.
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
            differs = f"{unlike[name]:.0%} of the background differs from before"
            reasons[name] = f"it shows something else: {differs}"
    return reasons


def hides_the_body(
    cameras: Mapping[str, SilhouetteCamera], left_out: Mapping[str, str], settings: SilhouetteSettings, time_ns: int
) -> dict[str, str]:
    """Return cameras whose outline suddenly is not that of the body at its predicted pose, with the reasons.

    If the outlines differ in all cameras, and no image is rejected otherwise, the body moved: the result is empty. The
    thresholds of the accepted cameras are updated; a camera is accepted again after ``something_else_s``.

    Args:
        cameras: the cameras whose images were segmented, by name.
        left_out: reasons for the cameras whose images were rejected before, by name.
        settings: settings of the tracker.
        time_ns: capture time, on the common clock.
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
