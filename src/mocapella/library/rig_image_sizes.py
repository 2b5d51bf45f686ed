"""Check that keypoints are of images of the size that a rig is calibrated for.

Files of keypoints do not state the size of the images. Keypoints outside the image, or cameras that agree only if all
keypoints are scaled, show that the rig is for another size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.association.ray_agreement import AGREES, CONFIDENT, disagreement, shared_instants
from mocapella.errors import InputError
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.keypoints import KeypointFrame

Float64 = NDArray[np.float64]

FEWEST: Final = 60
"""Least number of such keypoints of a camera that tell something."""
OUTSIDE: Final = 0.2
"""Share of them outside the image above which the rig is for another size."""
NORMALISED: Final = 2.0
"""Keypoints that all lie within this many pixels of the corner are parts of the image's width and height."""
MARGIN: Final = 0.05
"""A keypoint is outside if it is farther from the image than this part of its width; detectors guess a little."""
SCALES: Final = (1 / 4, 1 / 3, 3 / 8, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 8 / 3, 3.0, 4.0)
"""Ratios of common image sizes, tried as the size that the rig is for, divided by that of the images."""
BETTER: Final = 2.0
"""The angle without scaling is at least so many times that of the scale that is reported."""


def check_image_sizes(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig, *, file: object) -> None:
    """Check that the images of keypoints have the size that the rig is calibrated for.

    Args:
        frames: the frames by the rig's camera names; frames of one instant have the same ``sequence``.
        rig: the cameras.
        file: named in errors.

    Raises:
        InputError: the keypoints are of images of another size than the rig; names the likely size.
    """
    for name, some in frames.items():
        check_inside(name, some, file=file, stated="the rig has", fix="give a rig for the size of the images")
    scale = _scale(frames, {name: rig.cameras[name] for name in frames})
    if scale is not None:
        name = next(iter(frames))
        width, height = rig.cameras[name].camera.size_px
        raise InputError(
            f"the rig is for images of {width} × {height} px (camera {name}); its cameras agree about people if the "
            f"images have {width / scale:.0f} × {height / scale:.0f} px", file=file,
            fix="give a rig for the size of the images, or detect in images of the rig's size",
        )  # fmt: skip


def check_inside(name: str, frames: Sequence[KeypointFrame], *, file: object, stated: str, fix: str) -> None:
    """Check that the keypoints of a camera are in images of its size.

    Args:
        name: the camera.
        frames: its frames.
        file: named in errors.
        stated: who states the size, such as ``the rig has``.
        fix: the remedy; the place that the keypoints reach to is added.

    Raises:
        InputError: many are outside, or they are no pixels.
    """
    pixels = np.concatenate([np.empty((0, 2)), *(one.positions_px[one.confidences > CONFIDENT] for one in frames)])
    if len(pixels) < FEWEST:
        return
    width, height = frames[0].size_px
    if np.abs(pixels).max() < NORMALISED:
        raise InputError(
            f"its keypoints lie between {pixels.min():.2g} and {pixels.max():.2g}, as parts of the image's size",
            file=file, field=f"camera {name}",
            fix=f"give pixels: multiply x by the width, here {width}, and y by the height, {height}",
        )  # fmt: skip
    outside = ((pixels < -MARGIN * width) | (pixels > np.array([width, height]) + MARGIN * width)).any(axis=-1)
    if outside.mean() > OUTSIDE:
        reach = np.percentile(pixels, 99, axis=0)
        raise InputError(
            f"{outside.mean():.0%} of its keypoints are outside the {width} × {height} px that {stated}", file=file,
            field=f"camera {name}", fix=f"{fix}; the keypoints reach to {reach[0]:.0f}, {reach[1]:.0f}",
        )  # fmt: skip


def _scale(frames: Mapping[str, Sequence[KeypointFrame]], cameras: Mapping[str, PlacedCamera]) -> float | None:
    """Return the factor of the keypoints with which the cameras agree; None if they agree as they are, or never."""
    instants = shared_instants(frames)
    plain = disagreement(instants, cameras)
    if not plain > AGREES:  # also if there is nothing to compare
        return None
    tried = ((disagreement(instants, cameras, scale=scale), scale) for scale in SCALES)
    least, best = min((one for one in tried if np.isfinite(one[0])), default=(np.inf, 1.0))
    return best if least < AGREES and least * BETTER < plain else None
