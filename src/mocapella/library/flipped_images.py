"""Find cameras whose images are mirrored or upside down, by the people that they see.

Programs of webcams mirror their images for the user, and a camera may hang upside down. Its keypoints then agree with
the other cameras only if they are turned back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import msgspec
import numpy as np

from mocapella.association.ray_agreement import disagreement, shared_instants
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame

Instant = Mapping[str, KeypointFrame]

DISAGREES: Final = 0.12
"""Least median angle between two cameras' rays at which images may be flipped, as part of the spread of the rays."""
AGREES: Final = 0.1
"""Largest such angle of images that are turned back."""
BETTER: Final = 2.0
"""The angle as the images are is at least so many times that of the images that are turned back."""
FEWEST: Final = 5
"""Least number of instants that tell something."""
REMEDIES: Final = {
    "mirrored": "switch mirroring off in the camera's program, or mirror the images back",
    "upside down": "turn the images by 180°",
}


def flipped_images(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig) -> str:
    """Return a sentence that names the cameras whose images are mirrored or upside down, with the remedy, or no text.

    Args:
        frames: the frames by the rig's camera names; frames of one instant have the same ``sequence``.
        rig: the cameras.
    """
    instants = shared_instants({name: some for name, some in frames.items() if name in rig.cameras})
    names = sorted({name for seen in instants for name in seen})
    if len(instants) < FEWEST:
        return ""
    found = [(*one, [name]) for name in names if (one := _best(instants, rig, [name]))]
    together = _best(instants, rig, names)
    if together and all(together[0] <= angle for angle, _, _ in found):
        found = [(*together, names)]
    elif len(names) == 2:  # to flip the one or the other may fit
        found = sorted(found)[:1]
    said = [f"the images of {', '.join(which)} are {how}: {REMEDIES[how]}" for _, how, which in found]
    return "; ".join(said)


def _best(instants: Sequence[Instant], rig: CameraRig, names: Sequence[str]) -> tuple[float, str] | None:
    """Return the angle and kind of the best flip of some cameras, all or one; None if no flip explains their images."""
    only = names[0] if len(names) == 1 else None
    plain = disagreement(instants, rig.cameras, only=only)
    tried = [
        (disagreement([_flipped(seen, names, how, swap=swap) for seen in instants], rig.cameras, only=only), how)
        for how, swap in (("mirrored", True), ("mirrored", False), ("upside down", False))
    ]
    least, how = min((one for one in tried if np.isfinite(one[0])), default=(np.inf, ""))
    if not (plain > DISAGREES and least < AGREES and least * BETTER < plain):
        return None
    return least, how


def _flipped(seen: Instant, cameras: Sequence[str], how: str, *, swap: bool) -> Instant:
    """Return an instant with the images of some cameras turned back; ``swap`` exchanges left and right."""
    turned = dict(seen)
    for name in set(cameras) & set(seen):
        frame = seen[name]
        width, height = frame.size_px
        pixels = np.array(frame.positions_px)
        pixels[..., 0] = width - 1 - pixels[..., 0]
        if how == "upside down":
            pixels[..., 1] = height - 1 - pixels[..., 1]
        order = list(frame.topology.mirror) if swap else slice(None)
        turned[name] = msgspec.structs.replace(
            frame, positions_px=pixels[:, order], confidences=frame.confidences[:, order]
        )
    return turned
