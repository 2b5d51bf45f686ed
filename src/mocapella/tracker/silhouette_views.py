"""Fits of all bodies in one frame, for scores and images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera import CameraRig
from mocapella.model.silhouettes import Silhouette
from mocapella.tracker.body_fitter import FittedBody

UInt8 = NDArray[np.uint8]

NO_PICTURE: Final = "it gives no picture"
DAMAGED: Final = "its image is damaged"


class SeenBody(msgspec.Struct, frozen=True, eq=False):
    """One body in one frame.

    Attributes:
        fit: pose, landmarks, and outlines by camera; for a lost body in its waiting pose, see `body_presence`.
        lost: whether the person is absent: not yet arrived, or gone.
        waits: silhouette of a lost body's mesh in its waiting pose, by camera; without the cameras whose images do not
            contain that pose. Empty for a present body.
    """

    fit: FittedBody
    lost: bool
    waits: Mapping[str, Silhouette] = {}


class SeenInstant(msgspec.Struct, frozen=True, eq=False):
    """All bodies in one frame.

    Attributes:
        number: number of the frame, if all cameras' frames have the same number, as in files; otherwise a counter.
        time_ns: capture time, on the common clock.
        images: (height, width, 3) uint8 BGR by camera; a camera without an image, or with a damaged one, is missing.
        bodies: the fitted bodies, by name.
    """

    number: int
    time_ns: int
    images: Mapping[str, UInt8]
    bodies: Mapping[str, SeenBody]


def covered_by_all(found: Mapping[str, FittedBody], rig: CameraRig) -> dict[str, Silhouette]:
    """Return the union of the bodies' silhouettes, by camera whose image was used for at least one body.

    ``found`` are the fitted bodies, by name. The silhouettes are of the posed meshes, not of the segmented images.
    """
    out: dict[str, Silhouette] = {}
    for name, placed in rig.cameras.items():
        masks = [one.seen[name].outline.silhouette for one in found.values() if name in one.seen]
        if len(masks) == 1:
            out[name] = masks[0]
        elif masks:
            union = np.logical_or.reduce([mask.mask(placed.camera.size_px) for mask in masks])
            out[name] = Silhouette((0, 0), 1, union.astype(np.float32) - np.float32(0.5))
    return out


def unsupported(fit: FittedBody, landmarks: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a fitted body's ``landmarks`` that images do not support; empty if that is unknown."""
    if fit.supported is None:
        return ()
    return tuple(name for name, has in zip(landmarks, fit.supported.tolist(), strict=True) if not has)


def called(name: str) -> str:
    """Return the phrase for a body in messages: its name, or ``the body`` if that is empty."""
    return name or "the body"
