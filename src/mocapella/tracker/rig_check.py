"""Check whether the cameras are at the rig's poses, in the first frames, from motion and from the empty room.

The outlines alone cannot show it, because they are searched at the predicted body. So the foreground relative to the
empty room, where that is known, and the motion in the images are compared with the bodies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.visual_cones import disagreements, meetings
from mocapella.model.camera import CameraRig
from mocapella.model.silhouettes import overlap
from mocapella.sensing.empty_room import EmptyRoom, MovedSince
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.silhouette_views import covered_by_all

UInt8 = NDArray[np.uint8]

DOUBTED_BELOW: Final = 0.4
"""Overlap of the body and the foreground below which a camera is reported."""
MOVES_WITH: Final = 0.85
"""Least fraction of the moving pixels that must be at the body."""
JUDGED_BY: Final = 5
"""Number of images with motion for the test of a camera; later motion may be unrelated to the body."""


class RigCheck:
    """Checks, while all bodies are visible, whether the cameras are at the rig's poses; see the module.

    Args:
        rig: the cameras' intrinsics and poses.

    Attributes:
        said: messages about all disagreements so far.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self.reset()

    def reset(self) -> None:
        """Forget all comparisons and messages."""
        self.said: list[str] = []
        self._moved, self._shares = MovedSince(), dict[str, list[float]]()
        self._compared = False

    def memory(self) -> list[Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return [self.said, self._moved.memory(), self._shares, self._compared]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same rig."""
        self.said, moved, self._shares, self._compared = memory
        self._moved.recall(moved)

    def update(self, found: Mapping[str, FittedBody], images: Mapping[str, UInt8], empty: EmptyRoom) -> list[str]:
        """Return messages about new disagreements, after a frame with all bodies visible; usually empty.

        The first call compares the foreground. The first `JUDGED_BY` images of each camera with motion are compared by
        motion.

        Args:
            found: the fitted bodies, by name.
            images: (height, width, 3) uint8 BGR, by camera; of every camera that sees a body.
            empty: background models of the cameras whose empty room is known.
        """
        new = self._judge_motion(found, images)
        if not self._compared:
            self._compared = True
            new += rig_faults(found, images, empty, self._rig)
        self.said += new
        return new

    def _judge_motion(self, found: Mapping[str, FittedBody], images: Mapping[str, UInt8]) -> list[str]:
        said = []
        for name, covered in covered_by_all(found, self._rig).items():
            shares = self._shares.setdefault(name, [])
            if len(shares) >= JUDGED_BY:
                continue
            share = self._moved.at_body(name, images[name], covered)
            shares += [share] if np.isfinite(share) else []
            if len(shares) == JUDGED_BY and np.median(shares) < MOVES_WITH:
                who = "the body is" if len(found) == 1 else "the bodies are"
                said.append(
                    f"{name}: only {np.median(shares):.0%} of what moves in its images is where {who}: is "
                    f"this the video of {name}, does it begin with the others, and stands it where the rig says?"
                )
        return said


def rig_faults(
    found: Mapping[str, FittedBody], images: Mapping[str, UInt8], empty: EmptyRoom, rig: CameraRig
) -> list[str]:
    """Return messages about cameras that contradict the rig in one frame; only known empty rooms are compared.

    Args:
        found: the fitted bodies, by name.
        images: (height, width, 3) uint8 BGR, by camera; of every camera that sees a body.
        empty: background models of the cameras whose empty room is known.
        rig: the cameras' intrinsics and poses.

    Returns:
        Messages for the user; empty without disagreements.
    """
    said, silhouettes = [], {}
    covers = "the body covers" if len(found) == 1 else "the bodies cover"
    for name, covered in covered_by_all(found, rig).items():
        silhouette = empty.silhouette(name, images[name], len(found))
        if silhouette is None:
            continue
        silhouettes[name] = silhouette
        size = rig.cameras[name].camera.size_px
        shared = overlap(silhouette.mask(size), covered.mask(size))
        if shared < DOUBTED_BELOW:
            said.append(
                f"{name}: {covers} other parts of the image than the foreground (overlap "
                f"{shared:.0%}): is this the video of {name}, and does the camera stand where the rig says?"
            )
    return disagreements(meetings(silhouettes, rig)) + said
